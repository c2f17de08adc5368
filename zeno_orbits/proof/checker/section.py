"""The section that an orbit starts and ends on, as a graph over its coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    around_zero,
    entries,
    exactly,
    middles,
    numbers,
    radii,
    require,
    solved,
)
from zeno_orbits.proof.checker.enclosure import Enclosure, Mapped, require_enclosed
from zeno_orbits.proof.checker.system import CONTACT, HOLONOMIC, System

_SWEEPS = 4
"""How often an enclosure of the other states is made narrower."""
_CONDITIONS = {"gap": 0, "gap_rate": 1, "multiplier": 3}


class Section(NamedTuple):
    """Where some contact quantities vanish.

    Attributes:
        places: States that are its coordinates.
        others: States that follow from them.
        equations: What must vanish, as output and row.
        settled: Whether the gap rate vanishes on it.
        mode: The mode that starts on it.
        end: The kind of record that ends on it.
    """

    places: list[int]
    others: list[int]
    equations: list[tuple[int, int]]
    settled: bool
    mode: str
    end: str

    @classmethod
    def of(cls, system: System, data: Any) -> Section:
        """Return the section of a certificate."""
        conditions, places = entries(data, "conditions", "places")
        pinned = {"gap": system.gap_row, "gap_rate": system.rate_row} if system.is_pinned else {}
        fixed = {row for name, row in pinned.items() if name in conditions}
        others = [k for k in range(system.n_x) if k not in places and k not in fixed]
        equations = [(CONTACT, _CONDITIONS[x]) for x in conditions if x not in pinned]
        equations += [(HOLONOMIC, k) for k in range(len(system.outputs[HOLONOMIC]))]
        known = len(set(conditions)) == len(conditions) and set(conditions) <= set(_CONDITIONS)
        sound = set(places) <= set(range(system.n_x)) - fixed and len(set(places)) == len(places)
        if not (known and sound and "gap" in conditions and len(others) == len(equations)):
            raise InputError(
                "The certificate's `section` must have as many unknowns as conditions."
            )
        settled = "gap_rate" in conditions
        released = "multiplier" in conditions
        if released and not settled:
            raise InputError("The certificate's `section` must be of release, impact or rest.")
        mode = "locked" if settled and not released else "free"
        return cls(places, others, equations, settled, mode, "cross" if released else "impact")


class Box(NamedTuple):
    """A box of the section: its coordinates and parameters, and where the others are looked for."""

    centre: Array
    spread: Array
    others: Array
    others_spread: Array

    @classmethod
    def of(
        cls, system: System, section: Section, data: Any, over: Sequence[tuple[Ball, Ball]]
    ) -> Box:
        """Return the box of a certificate, its parameters appended."""
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

    def holds(self, other: Box) -> bool:
        """Return True if another box lies in this one."""
        centres, spreads, others, reaches = zip(self, other, strict=True)
        pairs = [*zip(*centres, *spreads, strict=True), *zip(*others, *reaches, strict=True)]
        return all(abs(c.m - a.m) + d.r <= b.r for a, c, b, d in pairs)


def require_start(system: System, section: Section, box: Box, start: Enclosure) -> None:
    """Check that a set holds every point of the section whose coordinates are in a box.

    Krawczyk's operator on the conditions, for all coordinates at once, proves that there is just
    one such point with its other states where they are looked for.

    Args:
        system: What the certificate is about.
        section: Its section.
        box: The box.
        start: The set.
    """
    n, D = len(section.others), len(box.spread)
    inner = [*section.places, *system.inner[system.n_x :]]

    def state(coordinates: Array, others: Array) -> Array:
        z = system.nothing
        z[system.gap_row] = system.stop
        z[inner], z[section.others] = coordinates, others
        return z

    def slopes(z: Array) -> tuple[Array, Array]:
        rows = np.array([system.gradient(k, z)[row] for k, row in section.equations], dtype=object)
        rows = rows.reshape(n, len(z))
        return rows[:, section.others], rows[:, inner]

    def near_inverse(matrix: Array) -> Array:
        return middles(solved(middles(matrix), exactly(np.eye(n, dtype=int), system.bits)))

    def newton(middle: Array, reach: Array, spread: Array) -> Array:
        """Return what holds the other states, less a middle, if they are within reach of it."""
        by_others, by_u = slopes(state(box.centre + spread, middle + reach))
        at, inverse = state(box.centre, middle), near_inverse(by_others)
        residual = [system.value(k, at)[row] for k, row in section.equations]
        rest = exactly(np.eye(n, dtype=int), system.bits) - inverse @ by_others
        return rest @ reach - inverse @ np.array(residual, dtype=object) - inverse @ by_u @ spread

    def narrowed(spread: Array) -> Array:
        middle, left = box.others, found
        for _ in range(_SWEEPS):
            step = middles(left)
            middle, left = middle + step, newton(middle + step, around_zero(left - step), spread)
        return middle + left

    found = newton(box.others, box.others_spread, box.spread)
    for k, x, y in zip(section.others, found, box.others_spread, strict=True):
        require(x.size < y.r, f"state {k} of the section is not found: {x.shown()}")
    everywhere = state(box.centre + box.spread, narrowed(box.spread))
    by_others, by_u = slopes(everywhere)
    inverse = near_inverse(by_others)
    slope = exactly(np.zeros((len(system.z), D), dtype=int), system.bits)
    slope[inner] = exactly(np.eye(D, dtype=int), system.bits)
    slope[section.others] = -solved(inverse @ by_others, inverse @ by_u)
    still = exactly(np.zeros(D, dtype=int), system.bits)
    point = state(box.centre, narrowed(still))
    if not system.is_pinned and not section.settled:
        point[system.rate_row] = system.value(CONTACT, point)[1]
        slope[system.rate_row] = system.gradient(CONTACT, everywhere)[1] @ slope
    one = system.identity
    nothing = exactly(np.zeros(slope.shape, dtype=int), system.bits)
    exact = Enclosure(point, slope, one, system.nothing, nothing, still)
    require_enclosed(exact, Mapped(point, one, Ball(0, 0, system.bits), system.nothing), start)
