"""What a proved passage around the orbit says: existence, uniqueness, stability, enclosures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isqrt
from typing import Any, NamedTuple

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    NotProved,
    entries,
    exactly,
    middles,
    numbers,
    require,
    solved,
)
from zeno_orbits.proof.checker.enclosure import Enclosure
from zeno_orbits.proof.checker.section import Box


@dataclass(frozen=True, kw_only=True)
class Passage:
    """A proved passage: from a box of the section once around to its image.

    Attributes:
        n_x: Number of states.
        places: States that are the section's coordinates.
        box: The box.
        start: The set that the box lies in.
        end: The set that it has become.
        times: When what happens, by its name: the centre's time, and its derivative.
    """

    n_x: int
    places: Sequence[int]
    box: Box
    start: Enclosure
    end: Enclosure
    times: Mapping[str, Sequence[tuple[Ball, Array]]]

    @property
    def bits(self) -> int:
        """The unit is ``2^-bits``."""
        return self.start.m[0].bits

    @property
    def one(self) -> int:
        """The number one, in units."""
        return 1 << self.bits

    @property
    def d(self) -> int:
        """Number of section coordinates."""
        return len(self.places)

    @property
    def slope(self) -> Array:
        """Derivative of the return map by coordinates and parameters, ``(d, D)``."""
        return self.end.derivative[list(self.places)]

    @property
    def shift(self) -> Array:
        """What the centre returns to, less the centre, ``(d,)``."""
        point = self.end.m + self.end.Q @ self.end.r
        return point[list(self.places)] - self.box.centre[: self.d]

    @cached_property
    def fixed_points(self) -> tuple[Array, Array]:
        """Where fixed points are, less the centre, by Krawczyk's operator, once and twice."""
        once = self._krawczyk(self.box.spread)
        return once, self._krawczyk(once)

    def _krawczyk(self, spread: Array) -> Array:
        d, one = self.d, exactly(np.eye(self.d, dtype=int), self.bits)
        off = one - self.slope[:, :d]
        Y = middles(solved(middles(off), one))
        found = (one - Y @ off) @ spread[:d] + Y @ (self.shift + self.slope[:, d:] @ spread[d:])
        return np.concatenate([found, self.box.spread[d:]])

    def turned(self, basis: Any) -> tuple[Array, Array]:
        """Return real and imaginary part of ``T^-1 DP T``, each ``(d, d)``."""
        d = self.d
        re, im = (numbers(part, (d, d), self.bits) for part in entries(basis, "re", "im"))
        both = np.concatenate([np.concatenate([re, -im], axis=1), np.concatenate([im, re], axis=1)])
        J = self.slope[:, :d]
        inverse = solved(both, exactly(np.eye(2 * d, dtype=int), self.bits))
        found = inverse @ np.concatenate([J @ both[:d], J @ both[d:]])
        return found[:d, :d], found[d:, :d]

    def discs(self, basis: Any) -> list[tuple[int, int, int]]:
        """Return Gershgorin's discs: real and imaginary part of the centre, radius, in units."""
        re, im = self.turned(basis)
        beside = _moduli(re, im)
        np.fill_diagonal(beside, 0)
        radii = beside.sum(axis=1)
        parts = ((re[k, k], im[k, k], int(radii[k])) for k in range(self.d))
        return [(x.m, y.m, x.r + y.r + r) for x, y, r in parts]


_moduli: Any = np.frompyfunc(lambda x, y: isqrt(x.size**2 + y.size**2) + 1, 2, 1)
"""Upper bounds of the absolute values of complex numbers, in units."""


def _exists(passage: Passage, by: Any) -> str:
    """Show that the return map has a fixed point in the box."""
    if by not in ("inclusion", "krawczyk"):
        raise InputError("The certificate's `by` must be inclusion or krawczyk.")
    spread = passage.box.spread
    images = passage.fixed_points[0][: passage.d]
    if by == "inclusion":
        images = passage.shift + passage.slope @ spread
    largest = 0.0
    for k, (image, bound) in enumerate(zip(images, spread, strict=False)):
        require(image.size < bound.r, f"coordinate {k} leaves the box: {image.shown()}")
        largest = max(largest, image.size / bound.r)
    return f"the image takes {largest:.2g} of the box"


def _unique(passage: Passage) -> str:
    return _exists(passage, "krawczyk")


def _stable(passage: Passage, basis: Any) -> str:
    norm = max(_moduli(*passage.turned(basis)).sum(axis=1), default=0)
    require(norm < passage.one, f"the norm of the derivative is {norm / passage.one:.6g}")
    return f"the norm of the derivative is {norm / passage.one:.6g}"


def _repelling(passage: Passage, basis: Any) -> str:
    discs, one = passage.discs(basis), passage.one
    for k, (x, y, r) in enumerate(discs):
        others = discs[:k] + discs[k + 1 :]
        apart = all((x - a) ** 2 + (y - b) ** 2 > (r + c) ** 2 for a, b, c in others)
        if apart and x * x + y * y > (one + r) ** 2:
            return f"a multiplier is at {x / one:.6g} + {y / one:.6g} i"
    raise NotProved("no multiplier is outside the unit circle for certain")


def _multipliers(passage: Passage, basis: Any, discs: Any) -> str:
    given = numbers(discs, (passage.d, 3), passage.bits)
    for (x, y, r), disc in zip(passage.discs(basis), given, strict=True):
        a, b, c = (ball.m for ball in disc)
        require(c >= r and (x - a) ** 2 + (y - b) ** 2 <= (c - r) ** 2, "a disc is too small")
    return f"{passage.d} discs of Gershgorin"


def _timed(name: str) -> Callable[..., str]:
    def claim(passage: Passage, low: Any, high: Any, which: Any = 0) -> str:
        known = passage.times[name]
        if type(which) is not int or not 0 <= which < len(known):
            raise InputError(f"The certificate's `which` must be one of {len(known)} events.")
        time, slope = known[which]
        return _within(passage, [time + slope @ passage.fixed_points[1]], [low], [high])

    return claim


def _start_state(passage: Passage, low: Any, high: Any) -> str:
    start = passage.start
    point = start.m + start.Q @ start.r + start.derivative @ passage.fixed_points[1]
    return _within(passage, point[: passage.n_x], low, high)


def _within(passage: Passage, found: Sequence[Ball], low: Any, high: Any) -> str:
    lows, highs = (numbers(ends, (len(found),), passage.bits) for ends in (low, high))
    for a, x, b in zip(lows, found, highs, strict=True):
        require(a.m <= x.low and x.high <= b.m, f"it is {x.shown()}")
    return ", ".join(x.shown() for x in found)


class Claim(NamedTuple):
    """A kind of claim: its entries beside name and pass, its proof, and if it needs an orbit."""

    entries: tuple[str, ...]
    shown: Callable[..., str]
    of_orbit: bool = True


CLAIMS = {
    "exists": Claim(("by",), _exists, False),
    "unique": Claim((), _unique, False),
    "stable": Claim(("basis",), _stable),
    "repelling": Claim(("basis",), _repelling),
    "multipliers": Claim(("basis", "discs"), _multipliers),
    "period": Claim(("low", "high"), _timed("period")),
    "zeno_time": Claim(("low", "high", "which"), _timed("zeno_time")),
    "impact_time": Claim(("low", "high", "which"), _timed("impact_time")),
    "start_state": Claim(("low", "high"), _start_state),
}


def show(passage: Passage, claim: Mapping[str, Any]) -> str:
    """Prove a claim about a passage, and return what proves it.

    Raises:
        NotProved: If it is not proved.
        InputError: If it is no claim.
    """
    kind = CLAIMS[claim["name"]]
    given = entries(claim, "name", "pass", *kind.entries)[2:]
    if kind.of_orbit:
        try:
            _exists(passage, "krawczyk")
        except NotProved:
            _exists(passage, "inclusion")
    return kind.shown(passage, *given)
