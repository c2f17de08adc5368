"""A set of a certificate: a point and a derivative enclosed, and what a record makes of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    entries,
    exactly,
    numbers,
    radii,
    require,
    solved,
)


@dataclass(frozen=True, slots=True)
class Enclosure:
    """A set handed on: ``z(u_c)`` in ``m + Q r``, ``dz/du`` in ``C + Q R``, over a box of u.

    ``r`` and ``R`` are balls around zero, ``spread`` is the box of ``u - u_c``.
    """

    m: Array
    C: Array
    Q: Array
    r: Array
    R: Array
    spread: Array

    @classmethod
    def of(cls, data: Any, spread: Array, n: int, bits: int) -> Enclosure:
        """Return a set of a certificate: its numbers rounded down to units, wherever it is used."""
        m, C, Q, r, R = entries(data, "m", "C", "Q", "r", "R")
        D = len(spread)
        return cls(
            m=numbers(m, (n,), bits, exact=False),
            C=numbers(C, (n, D), bits, exact=False),
            Q=numbers(Q, (n, n), bits, exact=False),
            r=radii(r, (n,), bits, exact=False),
            R=radii(R, (n, D), bits, exact=False),
            spread=spread,
        )

    @property
    def derivative(self) -> Array:
        """A set that holds ``dz/du``, ``(N, D)``."""
        return self.C + self.Q @ self.R

    @property
    def hull(self) -> Array:
        """A box that holds all states, ``(N,)``."""
        return self.m + self.Q @ self.r + self.derivative @ self.spread


class Mapped(NamedTuple):
    """What a record makes of a set: of its point m, of its neighbours, and the time it takes."""

    point: Array
    slope: Array
    time: Ball
    time_slope: Array


def require_enclosed(old: Enclosure, mapped: Mapped, new: Enclosure) -> None:
    """Check that a set holds what a record makes of the one before it.

    Args:
        old: The set before the record.
        mapped: What the record makes of it.
        new: The set after the record.
    """
    slope = mapped.slope
    parts = [(mapped.point - new.m)[:, None], slope @ old.C - new.C, slope @ old.Q]
    # Elimination on intervals would wrap them at every row: it is done on numbers alone.
    inverse = solved(new.Q, exactly(np.eye(len(new.m), dtype=int), new.m[0].bits))
    found = inverse @ np.concatenate(parts, axis=1)
    point, drift, noise = np.split(found, [1, 1 + len(old.spread)], axis=1)
    images = {"r": point[:, 0] + noise @ old.r, "R": drift + noise @ old.R}
    for name, image in images.items():
        for place, x in np.ndenumerate(image):
            bound = getattr(new, name)[place]
            failure = f"{name}[{place[0]}] must hold {x.shown()}, but is {bound.shown()}"
            require(x.size <= bound.r, failure)
