"""Consequences of a proved passage: existence, uniqueness, stability, enclosures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
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
    linear_solution,
    middles,
    numbers,
    require,
)
from zeno_orbits.proof.checker.enclosure import Enclosure
from zeno_orbits.proof.checker.section import Box
from zeno_orbits.work import decimal_above, enclosing_disc


@dataclass(frozen=True, kw_only=True)
class Passage:
    """A proved passage: from a box of the section over one period to its image.

    Attributes:
        places: States that are the section's coordinates.
        word: Mode sequence of the return map: number of releases and switches, and of impacts after
            the last of them.
        releases: Number of releases.
        events: Number of individually proved impacts, number of Zeno points, and True for plastic
            impacts.
        box: The box.
        box_number: Number of the box in the certificate, from 1.
        end: The set at the end of the passage.
        told: Events in order, in words, for a machine with several stops, switches or kinks.
        enclosed: Times of events, keyed by name, and the state at the start. For each event, rows
            of the value at the centre and its derivative.
    """

    places: Sequence[int]
    word: tuple[int, int]
    releases: int
    events: tuple[int, int, bool]
    box: Box
    box_number: int
    end: Enclosure
    enclosed: Mapping[str, Sequence[Array]]
    told: tuple[str, ...] = ()

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
        """Derivative of the return map with respect to coordinates and parameters, ``(d, D)``."""
        return self.end.whole[list(self.places), 1:]

    @property
    def shift(self) -> Array:
        """Image of the centre under the return map, minus the centre, ``(d,)``."""
        return self.end.whole[list(self.places), 0] - self.box.centre[: self.d]

    @cached_property
    def fixed_points(self) -> tuple[Array, Array]:
        """Fixed points minus the centre, enclosed by one and two steps of Krawczyk's operator."""
        once = self._krawczyk(self.box.spread)
        return once, self._krawczyk(once)

    def state_at(self, offset: Array) -> Array:
        """Return the states of the fixed points at some values of the parameters, ``(n_x,)``.

        Args:
            offset: The parameters minus those of the centre, within the box, as balls.
        """
        d, (rows,) = self.d, self.enclosed["start_state"]
        inside = np.concatenate([self.box.spread[:d], offset])
        for _ in range(2):
            inside = np.concatenate([self._krawczyk(inside)[:d], offset])
        return rows[:, 0] + rows[:, 1:] @ inside

    def _krawczyk(self, spread: Array) -> Array:
        d, one = self.d, exactly(np.eye(self.d, dtype=int), self.bits)
        off = one - self.slope[:, :d]
        Y = middles(linear_solution(middles(off), one))
        found = (one - Y @ off) @ spread[:d] + Y @ (self.shift + self.slope[:, d:] @ spread[d:])
        return np.concatenate([found, self.box.spread[d:]])

    def discs(self, basis: Any) -> list[tuple[int, int, int]]:
        """Return Gershgorin's discs of ``T^-1 DP T``: both parts of the centre, radius, in units.

        The disc of a row is centred at its diagonal entry, and its radius includes all other
        entries.
        """
        d = self.d
        re, im = (numbers(part, (d, d), self.bits) for part in entries(basis, "re", "im"))
        both = np.concatenate([np.concatenate([re, -im], axis=1), np.concatenate([im, re], axis=1)])
        J = self.slope[:, :d]
        inverse = linear_solution(both, exactly(np.eye(2 * d, dtype=int), self.bits))
        found = inverse @ np.concatenate([J @ both[:d], J @ both[d:]])
        re, im = found[:d, :d], found[d:, :d]
        beside = _moduli(re, im)
        np.fill_diagonal(beside, 0)
        parts = ((re[k, k], im[k, k], int(beside[k].sum())) for k in range(d))
        return [(x.m, y.m, x.r + y.r + r) for x, y, r in parts]

    def leaves(self, by: str) -> str:
        """Return the image that leaves the interior of the box, as text.

        Args:
            by: `inclusion` or `krawczyk`.

        Returns:
            The coordinate that leaves the box under the return map or Krawczyk's operator. An empty
            text if the image lies inside: then exactly one fixed point exists. With `inclusion`,
            the return map also contracts the box, in the maximum norm weighted by its radii.
        """
        spread = self.box.spread[: self.d]
        images = self.shift + self.slope @ self.box.spread
        if by == "krawczyk":
            images = self.fixed_points[0][: self.d]
        for k, (image, bound) in enumerate(zip(images, spread, strict=True)):
            if image.size >= bound.r:
                return f"coordinate {k} leaves the box: {image.shown()}"
        return ""

    def leaves_both(self) -> str:
        """Return the image that leaves the box under both maps, or an empty text."""
        return self.leaves("krawczyk") and self.leaves("inclusion")

    def norm(self, basis: Any) -> Fraction:
        """Return a bound of the norm ``|T^-1 DP T|`` by rows, over the whole box."""
        # The largest absolute value on the disc of a row is the sum of the row's absolute values.
        discs = self.discs(basis)
        norm = max((isqrt(x * x + y * y) + 1 + r for x, y, r in discs), default=0)
        return Fraction(norm, 1 << self.bits)


_moduli: Any = np.frompyfunc(lambda x, y: isqrt(x.size**2 + y.size**2) + 1, 2, 1)
"""Upper bounds of the absolute values of complex numbers, in units."""


def of_one_orbit(passages: Sequence[Passage | str]) -> list[Passage]:
    """Return passages whose claims concern the same orbit.

    The first box contains exactly one fixed point of the return map, by Krawczyk's operator or by
    inclusion in the mean value form, which implies contraction. All other boxes lie in the first
    box and belong to the same return map, so that a fixed point in another box is the same fixed
    point.

    Args:
        passages: The passages, or the reason why a passage is not proved.
    """
    proved = [one for one in passages if isinstance(one, Passage)]
    failed = next((one for one in passages if isinstance(one, str)), None)
    require(failed is None, f"the motion is not proved: {failed}")
    first = proved[0]
    away = first.leaves_both() if len(proved) > 1 else ""
    require(not away, f"more than one fixed point may lie in the first box, as {away}")
    same = all(one.word == first.word for one in proved)
    require(same, "the passes belong to different return maps")
    return proved


def _exists(passage: Passage, by: Any) -> str:
    """Show that the return map has a fixed point in the box."""
    if by not in ("inclusion", "krawczyk"):
        raise InputError("The certificate's `by` must be inclusion or krawczyk.")
    away = passage.leaves(by)
    require(not away, away)
    what = "the return map" if by == "inclusion" else "Krawczyk's operator"
    return f"{what} takes the box into its interior"


def _unique(passage: Passage) -> str:
    away = passage.leaves_both()
    require(not away, away)
    by = "Krawczyk's operator" if not passage.leaves("krawczyk") else "the return map"
    return f"{by} takes the box into its interior"


def _stable(passage: Passage, basis: Any) -> str:
    norm = passage.norm(basis)
    told = f"On box {passage.box_number}, the norm of the return map's derivative in the basis of "
    told += f"the certificate is at most {decimal_above(norm, 6)}"
    require(norm < 1, told)
    return told


def _is_apart(discs: Sequence[tuple[int, int, int]], k: int) -> bool:
    """Return True if a disc is disjoint from the others. Then one multiplier lies in it."""
    (x, y, r), others = discs[k], [*discs[:k], *discs[k + 1 :]]
    return all((x - a) ** 2 + (y - b) ** 2 > (r + c) ** 2 for a, b, c in others)


def _repelling(passage: Passage, basis: Any) -> str:
    discs, one = passage.discs(basis), 1 << passage.bits
    for k, (x, y, r) in enumerate(discs):
        if _is_apart(discs, k) and x * x + y * y > (one + r) ** 2:
            return _disc(passage, x, y, r)
    raise NotProved("no multiplier is outside the unit circle for certain")


def _disc(passage: Passage, *units: int) -> str:
    return enclosing_disc(*(Fraction(x, 1 << passage.bits) for x in units))


def _multipliers(passage: Passage, basis: Any, discs: Any) -> str:
    given = numbers(discs, (passage.d, 3), passage.bits)
    for (x, y, r), disc in zip(passage.discs(basis), given, strict=True):
        a, b, c = (ball.m for ball in disc)
        require(c >= r and (x - a) ** 2 + (y - b) ** 2 <= (c - r) ** 2, "a disc is too small")
    found = passage.discs(basis)
    shown = ", ".join(_disc(passage, *disc) for disc in found) or "of no coordinate"
    if all(_is_apart(found, k) for k in range(len(found))):
        return f"One multiplier lies in each of the discs {shown}"
    return f"The multipliers lie in the union of the discs {shown}"


def _within(found: Array, low: Any, high: Any) -> str:
    """Show that values lie between the ends in the certificate: a text each, or lists of texts."""
    ends = ([one] if isinstance(one, str) else one for one in (low, high))
    lows, highs = (numbers(one, found.shape, found[0].bits) for one in ends)
    for a, x, b in zip(lows, found, highs, strict=True):
        if a.m > x.low or x.high > b.m:
            raise NotProved(f"it is {x.shown()}")
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
"""Kinds of claims: the function that proves it, or None for an enclosure, and the entries."""


def show(passage: Passage, claim: Mapping[str, Any]) -> str:
    """Prove a claim about a passage, and return the evidence.

    Raises:
        NotProved: If the claim is not proved.
        InputError: If the claim is unknown or malformed.
    """
    name = claim["name"]
    if name not in CLAIMS:
        raise InputError("The certificate has a claim with an unknown name.")
    shown, names = CLAIMS[name]
    given = entries(claim, "name", "pass", *names)[2:]
    away = passage.leaves_both()
    require(not away, away)
    if shown is not None:
        return shown(passage, *given)
    low, high, which = (*given, 0)[:3]
    known = passage.enclosed[name]
    if type(which) is not int or not 0 <= which < len(known):
        raise InputError(f"The certificate's `which` must be one of {len(known)} events.")
    found = known[which]
    return _within(found[:, 0] + found[:, 1:] @ passage.fixed_points[1], low, high)
