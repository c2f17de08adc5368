"""What a proved passage around the orbit says: existence, uniqueness, stability, enclosures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isqrt
from typing import Any

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import (
    Array,
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
        places: States that are the section's coordinates.
        box: The box.
        end: The set that it has become.
        enclosed: Times of events by their name, and the start's state: rows of the centre's
            number and its derivative, for each event.
    """

    places: Sequence[int]
    box: Box
    end: Enclosure
    enclosed: Mapping[str, Sequence[Array]]

    @property
    def bits(self) -> int:
        """The unit is ``2^-bits``."""
        return self.end.m[0].bits

    @property
    def d(self) -> int:
        """Number of section coordinates."""
        return len(self.places)

    @property
    def slope(self) -> Array:
        """Derivative of the return map by coordinates and parameters, ``(d, D)``."""
        return self.end.whole[list(self.places), 1:]

    @property
    def shift(self) -> Array:
        """What the centre returns to, less the centre, ``(d,)``."""
        return self.end.whole[list(self.places), 0] - self.box.centre[: self.d]

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

    def discs(self, basis: Any) -> list[tuple[int, int, int]]:
        """Return Gershgorin's discs of ``T^-1 DP T``: centre, its imaginary part, radius, in units.

        The disc of a row holds its diagonal entry with all others around it.
        """
        d = self.d
        re, im = (numbers(part, (d, d), self.bits) for part in entries(basis, "re", "im"))
        both = np.concatenate([np.concatenate([re, -im], axis=1), np.concatenate([im, re], axis=1)])
        J = self.slope[:, :d]
        inverse = solved(both, exactly(np.eye(2 * d, dtype=int), self.bits))
        found = inverse @ np.concatenate([J @ both[:d], J @ both[d:]])
        re, im = found[:d, :d], found[d:, :d]
        beside = _moduli(re, im)
        np.fill_diagonal(beside, 0)
        parts = ((re[k, k], im[k, k], int(beside[k].sum())) for k in range(d))
        return [(x.m, y.m, x.r + y.r + r) for x, y, r in parts]


_moduli: Any = np.frompyfunc(lambda x, y: isqrt(x.size**2 + y.size**2) + 1, 2, 1)
"""Upper bounds of the absolute values of complex numbers, in units."""


def _exists(passage: Passage, by: Any) -> str:
    """Show that the return map has a fixed point in the box."""
    if by not in ("inclusion", "krawczyk"):
        raise InputError("The certificate's `by` must be inclusion or krawczyk.")
    spread = passage.box.spread[: passage.d]
    images = passage.fixed_points[0][: passage.d]
    if by == "inclusion":
        images = passage.shift + passage.slope @ passage.box.spread
    for k, (image, bound) in enumerate(zip(images, spread, strict=True)):
        require(image.size < bound.r, f"coordinate {k} leaves the box: {image.shown()}")
    largest = max((x.size / u.r for x, u in zip(images, spread, strict=True)), default=0.0)
    return f"the image takes {largest:.2g} of the box"


def _unique(passage: Passage) -> str:
    return _exists(passage, "krawczyk")


def _stable(passage: Passage, basis: Any) -> str:
    # A row's disc reaches as far from zero as the sizes of the row sum up to.
    one = 1 << passage.bits
    norm = max((isqrt(x * x + y * y) + 1 + r for x, y, r in passage.discs(basis)), default=0)
    told = f"the norm of the derivative is {norm / one:.6g}"
    require(norm < one, told)
    return told


def _repelling(passage: Passage, basis: Any) -> str:
    discs, one = passage.discs(basis), 1 << passage.bits
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


def _within(found: Array, low: Any, high: Any) -> str:
    """Show that numbers lie between those of the certificate, a text for one, a list for more."""
    ends = ([one] if isinstance(one, str) else one for one in (low, high))
    lows, highs = (numbers(one, found.shape, found[0].bits) for one in ends)
    for a, x, b in zip(lows, found, highs, strict=True):
        require(a.m <= x.low and x.high <= b.m, f"it is {x.shown()}")
    return ", ".join(x.shown() for x in found)


CLAIMS: dict[str, tuple[Callable[..., str] | None, tuple[str, ...]]] = {
    "exists": (_exists, ("by",)),
    "unique": (_unique, ()),
    "stable": (_stable, ("basis",)),
    "repelling": (_repelling, ("basis",)),
    "multipliers": (_multipliers, ("basis", "discs")),
    "period": (None, ("low", "high")),
    "zeno_time": (None, ("low", "high", "which")),
    "impact_time": (None, ("low", "high", "which")),
    "start_state": (None, ("low", "high")),
}
"""Kinds of claims: what shows one, if it is no enclosure, and its entries."""


def show(passage: Passage, claim: Mapping[str, Any]) -> str:
    """Prove a claim about a passage, and return what proves it.

    Raises:
        NotProved: If it is not proved.
        InputError: If it is no claim.
    """
    name = claim["name"]
    shown, names = CLAIMS[name]
    given = entries(claim, "name", "pass", *names)[2:]
    if shown not in (_exists, _unique):
        try:
            _exists(passage, "krawczyk")
        except NotProved:
            _exists(passage, "inclusion")
    if shown is not None:
        return shown(passage, *given)
    low, high, which = (*given, 0)[:3]
    known = passage.enclosed[name]
    if type(which) is not int or not 0 <= which < len(known):
        raise InputError(f"The certificate's `which` must be one of {len(known)} events.")
    found = known[which]
    return _within(found[:, 0] + found[:, 1:] @ passage.fixed_points[1], low, high)
