"""The section at the start and end of an orbit, as a graph over its coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    NotProved,
    around_zero,
    entries,
    exactly,
    linear_solution,
    middles,
    numbers,
    radii,
)
from zeno_orbits.proof.checker.enclosure import Enclosure, Mapped, require_enclosed
from zeno_orbits.proof.checker.system import System
from zeno_orbits.work import decimal_between, enclosing_decimal

_SWEEPS = 4
"""Number of times that an enclosure of the other states is narrowed."""
_CONDITIONS = {"gap": "gap", "gap_rate": "gap_rate", "multiplier": "acceleration"}
_KINDS = (
    {"gap", "gap_rate", "multiplier"},
    {"gap"},
    {"guard"},
    {"gap", "gap_rate", "guard"},
)
"""Conditions of the sections: of releases, of impacts, of a switch in flight and in contact."""


_TEXTS = {
    True: "the release{}, where the gap, its rate and its acceleration vanish",
    False: "the states just after an impact{}, where the gap vanishes",
}


class ContactSection(NamedTuple):
    """The set of states at which some contact quantities vanish.

    Attributes:
        places: Indices of the states that are its coordinates.
        others: Indices of the states that follow from the coordinates.
        equations: Expressions that must vanish, by name and row.
        settled: True if the gap rate vanishes on the section, as at a release.
        end: Kind of the record that ends on the section.
        text: Description of the section.
        switch: The switch just before which the states of the section are, or -1.
    """

    places: list[int]
    others: list[int]
    equations: list[tuple[str, int]]
    settled: bool
    end: str
    text: str
    switch: int = -1

    @property
    def in_flight(self) -> bool:
        """True if no stop is closed or struck on the section."""
        return self.switch >= 0 and not self.settled

    @classmethod
    def of(
        cls, system: System, data: Any, names: tuple[Sequence[str], Sequence[str]] = ((), ())
    ) -> ContactSection:
        """Return the section of a certificate.

        Args:
            system: The system on the section.
            data: The entry of the certificate.
            names: Names of the stops, and of the switches.
        """
        further = ("switch",) if isinstance(data, dict) and "switch" in data else ()
        stops, switches = names
        conditions, places, *switch = entries(data, "conditions", "places", *further)
        k = switch[0] if switch else -1
        pinned = {"gap": system.gap_row, "gap_rate": system.rate_row} if system.is_pinned else {}
        fixed = {row for name, row in pinned.items() if name in conditions}
        others = [k for k in range(system.n_x) if k not in places and k not in fixed]
        equations = [(_CONDITIONS[x], 0) for x in conditions if x not in {*pinned, "guard"}]
        equations += [("guards", k)] if "guard" in conditions else []
        equations += [("constraints", k) for k in range(len(system.nodes["constraints"]))]
        first = system.held_row - system.n_x
        equations += [("stops", k) for k in (first, first + 1) if system.held_row >= 0]
        known = len(set(conditions)) == len(conditions) and set(conditions) in _KINDS
        known = known and ("guard" in conditions) == bool(switch)
        known = known and (not switch or (type(k) is int and 0 <= k < len(system.signs)))
        sound = all(type(k) is int for k in places) and len(set(places)) == len(places)
        sound = sound and set(places) <= set(range(system.n_x)) - fixed
        if not (known and sound and len(others) == len(equations)):
            raise InputError(
                "The certificate's `section` must have as many unknowns as conditions."
            )
        settled = "gap_rate" in conditions
        if switch:
            text = _text_of_switch(system, k, switches)
        else:
            own = f" of `{stops[_own_stop(system)]}`" if len(stops) > 1 else ""
            text = _TEXTS[settled].format(own)
        closed = _closed_stops(system, stops, own=bool(switch) and settled)
        # Other states of a box, with other stops closed, do not belong to the section.
        text += f", in contact with {' and '.join(closed)}" if closed else ""
        text += ", in flight" if switch and not closed else ""
        end = "cross" if settled or switch else "impact"
        return cls(places, others, equations, settled, end, text, k)


def _own_stop(system: System) -> int:
    """Return the index of the stop of a system."""
    return 0 if system.is_pinned else (system.gap_row - system.n_x) // 2


def _text_of_switch(system: System, switch: int, switches: Sequence[str]) -> str:
    """Return the description of the section of a switch."""
    if switch < system.n_declared:
        return f"the states just before the switch `{switches[switch]}`, where its guard vanishes"
    side = "positive" if system.signs[switch] > 0 else "negative"
    return f"the states just before `{switches[switch]}` leaves its {side} side"


def _closed_stops(system: System, stops: Sequence[str], *, own: bool) -> list[str]:
    """Return the names of the stops in contact on a section, in quotes."""
    held = [(system.held_row - system.n_x) // 2] if system.held_row >= 0 else []
    return [f"`{stops[k]}`" for k in ([_own_stop(system)] * own + held)]


class Box(NamedTuple):
    """A box of the section: coordinates and parameters, and the search box of the other states."""

    centre: Array
    spread: Array
    others: Array
    others_spread: Array

    @classmethod
    def of(
        cls, system: System, section: ContactSection, data: Any, over: Sequence[tuple[Ball, Ball]]
    ) -> Box:
        """Return the box of a certificate, followed by its parameters."""
        bits, d, n = system.bits, (len(section.places),), (len(section.others),)
        centre, radius, others = entries(data, "centre", "radius", "others")
        middle, reach = entries(others, "centre", "radius")
        varied = np.array([*over], dtype=object).reshape(-1, 2)
        return cls(
            np.concatenate([numbers(centre, d, bits), varied[:, 0]]),
            np.concatenate([radii(radius, d, bits), around_zero(varied[:, 1])]),
            numbers(middle, n, bits),
            radii(reach, n, bits),
        )

    def leaves(self, section: ContactSection, image: Array) -> str:
        """Return how a box of states leaves the interior of this box, or an empty text.

        Args:
            section: The section.
            image: The states, ``(N,)``.
        """
        for k, x, centre, reach in zip(
            section.places, image[section.places], self.centre, self.spread, strict=False
        ):
            if (x - centre).size >= reach.r:
                return f"state {k} leaves the set: {(x - centre).shown()}"
        parts = image[section.others], self.others, self.others_spread
        for k, x, centre, reach in zip(section.others, *parts, strict=True):
            if (x - centre).size > reach.r:
                return f"state {k} does not return to the section: {(x - centre).shown()}"
        return ""

    def holds(self, other: Box) -> bool:
        """Return True if another box lies in this box."""
        centres, spreads, others, reaches = zip(self, other, strict=True)
        pairs = [*zip(*centres, *spreads, strict=True), *zip(*others, *reaches, strict=True)]
        return all(abs(c.m - a.m) + d.r <= b.r for a, c, b, d in pairs)


def newton_of(system: System, section: ContactSection, box: Box) -> tuple[Any, Any]:
    """Return Newton's operator on the conditions of a section, and the map to all states.

    The operator returns the other states minus a middle, if within reach of it, and their
    derivative, for all coordinates together. Its arguments are the middle, the reach, and the
    coordinates minus those of the centre of the box.

    Args:
        system: The system of the certificate.
        section: Its section.
        box: The box.
    """
    n = len(section.others)
    inner = [*section.places, *system.varied]

    def state(coordinates: Array, others: Array) -> Array:
        z = system.nothing
        z[system.gap_row] = system.stop
        z[inner], z[section.others] = coordinates, others
        return z

    def newton(middle: Array, reach: Array, spread: Array) -> tuple[Array, Array]:
        around, at = state(box.centre + spread, middle + reach), state(box.centre, middle)
        rows = [system.gradient(k, around)[row] for k, row in section.equations]
        slopes = np.array(rows, dtype=object).reshape(n, len(around))
        rest = np.array([system.value(k, at)[row] for k, row in section.equations], dtype=object)
        by_u = slopes[:, inner]
        right = np.concatenate([(rest + by_u @ spread)[:, None], by_u], axis=1)
        found = -linear_solution(slopes[:, section.others], right)
        return found[:, 0], found[:, 1:]

    return newton, state


def reached_others(section: ContactSection, box: Box, newton: Any) -> Array:
    """Return the other states of all points of the section over a box, minus those of its centre.

    Args:
        section: The section.
        box: The box.
        newton: Newton's operator on the conditions of the section.

    Raises:
        NotProved: If the operator does not lead into the interior of the box of the other states.
    """
    found, _ = newton(box.others, box.others_spread, box.spread)
    for k, x, y in zip(section.others, found, box.others_spread, strict=True):
        if x.size >= y.r:
            raise NotProved(f"state {k} of the section is not found: {x.shown()}")
    return found


def shown_others(system: System, section: ContactSection, box: Box) -> dict[int, str]:
    """Return the states of a box that are not its coordinates, as decimal intervals.

    The intervals contain the values at all points of the box, and lie in the box of the other
    states. So the box is the set of the section's states in these intervals. If its points are not
    found, the box of the other states is returned, rounded outward.

    Args:
        system: The system of the certificate.
        section: Its section.
        box: The box.
    """
    fixed = {row for row in (system.gap_row, system.rate_row) if row < system.n_x}
    fixed -= {*section.places, *section.others}
    values = {system.gap_row: system.stop, system.rate_row: Ball(0, 0, system.bits)}
    texts = {k: values[k].shown() for k in sorted(fixed)}
    parts = zip(section.others, box.others, box.others_spread, strict=True)
    around = {k: (middle + reach).ends() for k, middle, reach in parts}
    try:
        newton, _ = newton_of(system, section, box)
        found = box.others + reached_others(section, box, newton)
        reached = dict(zip(section.others, (x.ends() for x in found), strict=True))
        shown = {k: decimal_between(*reached[k], *around[k]) for k in section.others}
    except NotProved:
        shown = {k: enclosing_decimal(*ends) for k, ends in around.items()}
    return shown | texts


def require_on_section(system: System, section: ContactSection, box: Box, start: Enclosure) -> None:
    """Check that a set contains every point of the section whose coordinates are in a box.

    Newton's operator on the conditions, for all coordinates together, proves that exactly one such
    point has its other states in their search box.

    Args:
        system: The system of the certificate.
        section: Its section.
        box: The box.
        start: The set.
    """
    D, inner = len(box.spread), [*section.places, *system.varied]
    newton, state = newton_of(system, section, box)

    def narrowed(spread: Array) -> tuple[Array, Array]:
        middle, left, slope = box.others, *newton(box.others, box.others_spread, box.spread)
        for _ in range(_SWEEPS):
            step = middles(left)
            middle, reach = middle + step, around_zero(left - step)
            left, slope = newton(middle, reach, spread)
        return middle + left, slope

    reached_others(section, box, newton)
    others, by_u = narrowed(box.spread)
    everywhere = state(box.centre + box.spread, others)
    slope = exactly(np.zeros((len(system.z), D), dtype=int), system.bits)
    slope[inner] = exactly(np.eye(D, dtype=int), system.bits)
    slope[section.others] = by_u
    still = exactly(np.zeros(D, dtype=int), system.bits)
    point = state(box.centre, narrowed(still)[0])
    kept = {system.rate_row} if section.settled else set[int]()
    kept |= set[int]() if section.in_flight else {system.gap_row}
    kept |= {system.held_row, system.held_row + 1} if system.held_row >= 0 else set[int]()
    computed = [k for k in range(system.n_x, len(system.z) - len(system.varied)) if k not in kept]
    values, slopes = system.value("stops", point), system.gradient("stops", everywhere)
    for k in computed:
        point[k], slope[k] = values[k - system.n_x], slopes[k - system.n_x] @ slope
    whole, one = np.concatenate([point[:, None], slope], axis=1), system.identity
    exact = Enclosure(whole, one, exactly(np.zeros(whole.shape, dtype=int), system.bits), still)
    require_enclosed(exact, Mapped(point, one, Ball(0, 0, system.bits), system.nothing), start)
