"""The section that an orbit starts and ends on, as a graph over its coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import (
    Ball,
    Matrix,
    Vector,
    added,
    around_zero,
    dot,
    entries,
    identity,
    middles,
    require,
    solved,
    times,
    vector,
)
from zeno_orbits.proof.checker.motion import Enclosure, Mapped, require_enclosed
from zeno_orbits.proof.checker.system import CONTACT, HOLONOMIC, System

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

    centre: Vector
    spread: Vector
    others: Vector
    others_spread: Vector

    @classmethod
    def of(
        cls, system: System, section: Section, data: Any, over: Sequence[tuple[Ball, Ball]]
    ) -> Box:
        """Return the box of a certificate, its parameters appended."""
        bits, d, n = system.bits, len(section.places), len(section.others)
        centre, radius, others = entries(data, "centre", "radius", "others")
        middle, reach = entries(others, "centre", "radius")
        return cls(
            [*vector(centre, d, bits), *(ball for ball, _ in over)],
            around_zero([*vector(radius, d, bits), *(radius for _, radius in over)]),
            vector(middle, n, bits),
            around_zero(vector(reach, n, bits)),
        )

    def holds(self, other: Box) -> bool:
        """Return True if another box lies in this one."""
        mine = zip((*self.centre, *self.others), (*self.spread, *self.others_spread), strict=True)
        its = zip(
            (*other.centre, *other.others), (*other.spread, *other.others_spread), strict=True
        )
        return all(abs(c.m - a.m) + e.r <= b.r for (a, b), (c, e) in zip(mine, its, strict=True))


def require_start(system: System, section: Section, box: Box, start: Enclosure) -> None:
    """Check that a set holds every point of the section whose coordinates are in a box.

    Krawczyk's operator on the conditions, for all coordinates at once, proves that there is just
    one such point with its other states where they are looked for.
    """
    bits, n = system.bits, len(section.others)
    ones, zero = identity(n, bits), Ball(0, 0, bits)
    u = [*section.places, *range(len(system.z) - system.n_over, len(system.z))]

    def state(coordinates: Vector, others: Vector) -> Vector:
        z = [zero] * len(system.z)
        if system.is_pinned:
            z[system.gap_row] = system.stop
        for k, value in zip((*u, *section.others), (*coordinates, *others), strict=True):
            z[k] = value
        return z

    def slopes(z: Vector) -> tuple[Matrix, Matrix]:
        rows = [system.gradient(output, z, row) for output, row in section.equations]
        return [[row[k] for k in section.others] for row in rows], [
            [row[k] for k in u] for row in rows
        ]

    inside = [a + b for a, b in zip(box.centre, box.spread, strict=True)]
    middle, free = state(box.centre, box.others), box.others_spread
    by_others, by_u = slopes(state(inside, [a + b for a, b in zip(box.others, free, strict=True)]))
    inverse = middles(solved(middles(by_others), ones))
    residual = [[system.value(output, middle)[row]] for output, row in section.equations]
    newton = [[-x for x in row] for row in times(inverse, residual)]

    def moved(by_others: Matrix, by_u: Matrix, free: Vector, spread: Vector) -> Vector:
        rest = added(ones, [[-x for x in row] for row in times(inverse, by_others)])
        rows = zip(newton, rest, times(inverse, by_u), strict=True)
        return [x + dot((*y, *(-v for v in z)), (*free, *spread)) for (x,), y, z in rows]

    found = moved(by_others, by_u, free, box.spread)
    for k, x, y in zip(section.others, found, free, strict=True):
        require(x.size < y.r, f"state {k} of the section is not found: {x.shown()}")
    by_others, by_u = slopes(state(inside, [a + b for a, b in zip(box.others, found, strict=True)]))
    turned = solved(times(inverse, by_others), times(inverse, by_u))
    still = [zero] * len(u)
    for _ in range(4):
        point = state(box.centre, [a + b for a, b in zip(box.others, found, strict=True)])
        found = moved(*slopes(point), found, still)
    point = state(box.centre, [a + b for a, b in zip(box.others, found, strict=True)])
    slope = [[zero] * len(u) for _ in point]
    for k, row in zip(u, identity(len(u), bits), strict=True):
        slope[k] = row
    for k, row in zip(section.others, turned, strict=True):
        slope[k] = [-x for x in row]
    if not system.is_pinned and not section.settled:
        point[system.rate_row] = system.value(CONTACT, point)[1]
        wide = state(inside, [a + b for a, b in zip(box.others, free, strict=True)])
        slope[system.rate_row] = times([system.gradient(CONTACT, wide, 1)], slope)[0]
    nothing = [zero] * len(point)
    exact = Enclosure(
        point, slope, identity(len(point), bits), nothing, [still] * len(point), still
    )
    identical = Mapped(point, identity(len(point), bits), zero, nothing)
    require_enclosed(exact, identical, start)
