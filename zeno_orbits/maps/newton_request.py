"""What a point of a map may ask for, and how accurately."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from zeno_orbits.arrays import Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """How accurately motions are followed to what they settle to.

    Attributes:
        motion: Local error while a motion settles.
        orbit: Local error of the orbit that is reported.
        near: Change of a return up to which Newton's method is tried, relative.
        far: Longest step of Newton's method from the motion, relative; the orbit has to be here.
        exact: Last step of Newton's method; what remains is its square, the multipliers' error
            itself.
        repeats: Change that counts as repeating where Newton's method is not available.
    """

    motion: float = 1e-6
    orbit: float = 1e-8
    near: float = 0.02
    far: float = 0.8
    exact: float = 2e-6
    repeats: float = 1e-7


class Request(NamedTuple):
    """Lanes that a point asks for, in place of those it has.

    Attributes:
        states: Where they start, ``(n, n_x)``; the first leads the others.
        tolerance: Local error.
        released: Whether they start at a release.
        until: How long they run [s].
    """

    states: Vector
    tolerance: float
    released: bool
    until: float


SAME = 1e-8
"""A release that soon after the last one, for a unit of the time given, is the same one.

Rounding has locked the start.
"""
