"""A set of a certificate: enclosures of a point and a derivative, and its image under a record."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    NotProved,
    entries,
    exactly,
    linear_solution,
    numbers,
    radii,
)


@dataclass(frozen=True, slots=True)
class Enclosure:
    """A propagated set: ``(z(u_c), dz/du)`` in ``Z + Q E``, over a box of u.

    Attributes:
        Z: The matrix ``(m, C)`` of a certificate, ``(N, 1 + D)``.
        Q: Directions of the uncertainty, ``(N, N)``.
        E: Balls around zero with the radii ``(r, R)``, ``(N, 1 + D)``.
        spread: The box of ``u - u_c``, ``(D,)``.
    """

    Z: Array
    Q: Array
    E: Array
    spread: Array

    @classmethod
    def of(cls, data: Any, spread: Array, n: int, bits: int) -> Enclosure:
        """Return a set of a certificate, whose numbers are rounded down to units for every use."""
        m, C, Q, r, R = entries(data, "m", "C", "Q", "r", "R")
        D = len(spread)
        Z = numbers(m, (n,), bits, exact=False), numbers(C, (n, D), bits, exact=False)
        E = radii(r, (n,), bits, exact=False), radii(R, (n, D), bits, exact=False)
        return cls(
            Z=np.concatenate([Z[0][:, None], Z[1]], axis=1),
            Q=numbers(Q, (n, n), bits, exact=False),
            E=np.concatenate([E[0][:, None], E[1]], axis=1),
            spread=spread,
        )

    @property
    def m(self) -> Array:
        """A point near the image of the centre, ``(N,)``."""
        return self.Z[:, 0]

    @property
    def whole(self) -> Array:
        """A set that contains ``(z(u_c), dz/du)``, ``(N, 1 + D)``."""
        return self.Z + self.Q @ self.E

    @property
    def hull(self) -> Array:
        """A box that contains all states, ``(N,)``."""
        return self.m + self.moved(exactly(np.eye(len(self.Q), dtype=int), self.m[0].bits))

    def moved(self, slope: Array) -> Array:
        """Return the image of all states minus m under a linear map, ``(..., N)``."""
        return slope @ self.Q @ self.E[:, 0] + slope @ self.whole[:, 1:] @ self.spread


class Mapped(NamedTuple):
    """Image of a set under a record: of its point m, the derivative, and the duration."""

    point: Array
    slope: Array
    time: Ball
    time_slope: Array


def require_enclosed(old: Enclosure, mapped: Mapped, new: Enclosure) -> None:
    """Check that a set contains the image of the set before a record.

    Args:
        old: The set before the record.
        mapped: The image of this set under the record.
        new: The set after the record.
    """
    n = len(old.Z)
    image = np.concatenate([mapped.point[:, None], mapped.slope @ old.Z[:, 1:]], axis=1) - new.Z
    # Elimination uses numbers only, since intervals would widen at every row.
    inverse = linear_solution(new.Q, exactly(np.eye(n, dtype=int), new.m[0].bits))
    found = inverse @ image + inverse @ (mapped.slope @ old.Q) @ old.E
    for (i, j), x in np.ndenumerate(found):
        if x.size > new.E[i, j].r:
            what = f"{'R' if j else 'r'}[{i}] must hold {x.shown()}"
            raise NotProved(f"{what}, but is {new.E[i, j].shown()}")
