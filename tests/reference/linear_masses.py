"""When linear masses on stops come to rest, in 45 digits: Taylor series from impact to impact.

Between impacts ``M dv/dt = -C v - K q - w + J' p``, where ``p`` holds the closed stops.
The gaps are the first coordinates. Nothing here knows the package.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np

mp: Any = mpmath
_DIGITS, _REST, _STEP = 45, "1e-24", "0.02"


@dataclass(frozen=True, kw_only=True)
class LinearMasses:
    """Masses with the stops ``q[k] >= 0``.

    Attributes:
        inverse: Inverse of the mass matrix, ``(n, n)``; no entry joins two stops.
        damping: ``C``, ``(n, n)``.
        stiffness: ``K``, ``(n, n)``.
        weight: ``w``, ``(n,)``.
        restitutions: Of the stops, which may be fewer than masses.
    """

    inverse: Any
    damping: Any
    stiffness: Any
    weight: Any
    restitutions: Sequence[float]

    def rests(self, heights: Sequence[float]) -> list[Any]:
        """Return when each stop comes to rest for good, from rest at some coordinates."""
        with mp.workdps(_DIGITS):
            return self._rests([mp.mpf(float(one)) for one in heights])

    def _rests(self, q: list[Any]) -> list[Any]:
        n, time, v = len(q), mp.mpf(0), [mp.mpf(0)] * len(q)
        e = [mp.mpf(float(one)) for one in self.restitutions]
        inverse = mp.matrix(np.asarray(self.inverse).tolist())
        found: dict[int, Any] = {}
        projected = inverse
        while len(found) < len(e):
            open_stops = [k for k in range(len(e)) if k not in found]
            rows = self._series(projected, q, v, 3)
            step = mp.mpf(_STEP)
            for k in open_stops:
                root = v[k] ** 2 - 4 * rows[2][k] * q[k]
                if rows[2][k] < 0 <= root:
                    step = min(step, 1.3 * (v[k] + mp.sqrt(root)) / (-2 * rows[2][k]))
            order = 10
            while step ** (order - 4) > mp.mpf(10) ** (-1 - _DIGITS) and order < 44:
                order += 2
            rows = self._series(projected, q, v, order)
            hits = [(self._root(rows, k, step), k) for k in open_stops if _at(rows, k, step)[0] < 0]
            step, struck = min(hits, default=(step, -1))
            q, v = map(list, zip(*(_at(rows, k, step) for k in range(n)), strict=True))
            time += step
            for k in found:
                q[k] = v[k] = mp.mpf(0)
            if struck < 0:
                continue
            impulse = -(1 + e[struck]) * v[struck] / inverse[struck, struck]
            v = [v[k] + inverse[k, struck] * impulse for k in range(n)]
            q[struck] = mp.mpf(0)
            if v[struck] < mp.mpf(_REST):
                found[struck], v[struck] = time, mp.mpf(0)
                closed = sorted(found)
                part = mp.matrix([[inverse[i, j] for j in closed] for i in closed])
                side = mp.matrix([[inverse[i, j] for j in closed] for i in range(n)])
                projected = inverse - side * part**-1 * side.T
        return [found[k] for k in sorted(found)]

    def _series(self, projected: Any, q: Any, v: Any, order: int) -> list[list[Any]]:
        """Return the coefficients of all coordinates, by power."""
        n, rows = len(q), [list(q), list(v)]
        k, c, w = (
            projected * mp.matrix(np.asarray(one).tolist())
            for one in (self.stiffness, self.damping, self.weight)
        )
        for m in range(order - 1):
            rows.append(
                [
                    -mp.fsum(
                        [
                            k[i, j] * rows[m][j] + c[i, j] * (m + 1) * rows[m + 1][j]
                            for j in range(n)
                        ]
                        + [w[i] if m == 0 else 0]
                    )
                    / ((m + 1) * (m + 2))
                    for i in range(n)
                ]
            )
        return rows

    def _root(self, rows: Any, k: int, step: Any) -> Any:
        x = step
        for _ in range(200):
            value, slope = _at(rows, k, x)
            new = x - value / slope
            new = new if 0 < new <= step else x / 2
            if abs(new - x) < mp.mpf(10) ** (3 - _DIGITS) * new:
                return new
            x = new
        raise ArithmeticError("no root")


def _at(rows: Any, k: int, x: Any) -> tuple[Any, Any]:
    """Return a coordinate and its rate at a time."""
    slopes = [m * rows[m][k] for m in range(len(rows) - 1, 0, -1)]
    return mp.polyval([row[k] for row in reversed(rows)], x), mp.polyval(slopes, x)
