"""Ranges of a branch: one box of the section over each range of the parameter.

A branch is traced from an orbit in points, by Newton's method on the return map. Between two points
it is covered by ranges, from the first point on. Over each range the return map has exactly one
fixed point in a box, for every value of the parameter. The middle of the box and its sides are
extrapolated from the last range.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb

from zeno_orbits.errors import ProofError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.proof.arithmetic.balls import Ball, exact_fraction, product
from zeno_orbits.proof.claims import claims_of, own_state, proof_bounds
from zeno_orbits.proof.fixed_point import JudgedBox, judge
from zeno_orbits.proof.integration.ball_system import BallSystem
from zeno_orbits.proof.integration.orbit_walk import (
    LEAST_SIZE,
    ProofStart,
    ball_machine,
    prover_state,
    walk_period,
)
from zeno_orbits.proof.integration.section import SectionStart, section_places, start_on_section
from zeno_orbits.proof.integration.walk import WalkSettings
from zeno_orbits.proof.proof_file import certificate, check_bits
from zeno_orbits.work import silent

_ATTEMPTS = 3
"""Largest number of boxes that are tried over a range."""
_SMALL = 1e-9
"""Radius of the first box around a point, relative to the size of each coordinate."""
_SPARE = 1.5
"""Factor by which a box is taken larger than extrapolated."""
_WIDEST = 0.05
"""Largest side of a box that is tried, relative to the size of each coordinate."""
_ULPS = 2.0**-50
"""Rounding of the ends of ranges, relative to the unit of the parameter."""
_CLAIMS = ("exists", "unique", "stable", "repelling", "multipliers", "period")


@dataclass(frozen=True, slots=True, kw_only=True)
class BranchSettings:
    """Settings of the proof of a branch.

    Attributes:
        walk: Settings of the steps. A Zeno tail replaces impacts much earlier than in the proof of
            a single orbit, since boxes over a range are wide.
        bits: Precision of the ball arithmetic [bits].
        parts: Number of parts of the interval, which workers prove separately.
        least: Smallest range and smallest step of the trace, relative to the interval.
    """

    walk: WalkSettings = field(default_factory=lambda: WalkSettings(slowest=1e-12))
    bits: int = 96
    parts: int = 32
    least: float = 2.0**-16


@dataclass(frozen=True, slots=True, kw_only=True)
class RangePoint:
    """A point of a branch, in doubles.

    Attributes:
        value: Value of the parameter.
        state: States at the section, in the order of the problem.
        slope: Derivative of the states with respect to the parameter.
        period: Period [s].
        width: Half-width of the last range, 0 before the first range.
        spread: Largest distance of the fixed points of that range from its middle, for each state.
    """

    value: float
    state: tuple[float, ...]
    slope: tuple[float, ...]
    period: float
    width: float = 0.0
    spread: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofRange:
    """A proved range.

    Attributes:
        low: Lower end of the parameter, exactly.
        high: Upper end.
        middle: The branch at its middle.
        data: Its part of the certificate: value, radius, pass and claims.
        common: Entries of the certificate that all ranges share.
        stability: 1 for a stable fixed point, -1 for an unstable one, 0 if neither is proved.
        ends: Enclosures of the states of the fixed point at both ends: pairs of lower and upper
            bounds.
        box: Intervals of the coordinates and other states of the box, by index of the state.
    """

    low: Fraction
    high: Fraction
    middle: RangePoint
    data: dict[str, Any]
    common: dict[str, Any]
    stability: int
    ends: tuple[list[tuple[Fraction, Fraction]], list[tuple[Fraction, Fraction]]]
    box: dict[int, tuple[Fraction, Fraction]]

    def meets(self, other: ProofRange) -> str:
        """Return why this range and the next one are not shown to hold the same orbit.

        Args:
            other: The next range. It contains the upper end of this range.

        Returns:
            The state that leaves the box of the next range, or an empty text.
        """
        if not other.low <= self.high:
            return "the ranges leave a gap"
        if _shared(self) != _shared(other):
            return "the orbits of the ranges have different events"
        out = _leaves(self.ends[1], other.box)
        if out and _leaves(other.ends[0], self.box):
            return f"{out} leaves the box of the next range"
        return ""


def _leaves(
    state: Sequence[tuple[Fraction, Fraction]], box: Mapping[int, tuple[Fraction, Fraction]]
) -> str:
    """Return the first state that leaves the interior of a box, in words, or an empty text."""
    for k, (low, high) in box.items():
        if not low < state[k][0] <= state[k][1] < high:
            return f"state {k} of the orbit"
    return ""


@dataclass(frozen=True, slots=True, kw_only=True)
class BranchTask:
    """The branch of an orbit in one parameter.

    Attributes:
        problem: The problem.
        given: The section and the orbit.
        name: Name of the parameter.
        settings: Settings of the proof.
        smallest: Smallest width of a range.
    """

    problem: Problem
    given: ProofStart
    name: str
    settings: BranchSettings
    smallest: float

    def values(self, value: float) -> ParameterValues:
        """Return the gains and parameters of the orbit with one value of the parameter."""
        orbit = self.given.orbit
        gains, parameters = dict(orbit.gains), dict(orbit.parameters)
        (gains if self.name in gains else parameters)[self.name] = value
        return self.problem.values(gains=gains, parameters=parameters)

    def point(self, value: float, known: RangePoint) -> RangePoint:
        """Return the branch at a value, by Newton's method from a known point.

        Raises:
            ProofError: If the motion is not enclosed, or Newton's method does not converge.
        """
        return self._judged(value, 0.0, known)[1]

    def proved(self, low: float, high: float, known: RangePoint) -> ProofRange:
        """Return the range between two values, with proof.

        Args:
            low: Lower end.
            high: Upper end.
            known: A point of the branch near the range.

        Raises:
            ProofError: If the range is not proved.
        """
        value, radius = centred(low, high, upward=known.value <= low)
        judged, middle, (values, machine, system) = self._judged(value, radius, known)
        problem, start = self.problem, judged.start
        bits = check_bits(system, [float(x) for x in values.vector])
        claims = claims_of([judged], proof_bounds(problem, system, judged, bits), system.units)
        ways = [(start, judged.passage)]
        written = certificate(problem, values, {self.name: radius}, machine, system, ways, claims)
        own = ("passes", "claims", "over", "parameters")
        texts = written["parameters"][self.name], written["over"][self.name]
        stable = bool(start.places) and (judged.discs.stable or judged.returned.included)
        stable = stable or not start.places
        return ProofRange(
            low=Fraction(value) - Fraction(radius),
            high=Fraction(value) + Fraction(radius),
            middle=middle,
            data={
                "value": texts[0],
                "radius": texts[1],
                "pass": written["passes"][0],
                "claims": [one for one in written["claims"] if one["name"] in _CLAIMS],
            },
            common={name: x for name, x in written.items() if name not in own}
            | {"parameters": written["parameters"]},
            stability=1 if stable else -1 if judged.discs.repelling else 0,
            ends=(
                _fixed_point(problem, system, judged, -1),
                _fixed_point(problem, system, judged, 1),
            ),
            box=_box(system, start),
        )

    def _judged(
        self, value: float, radius: float, known: RangePoint
    ) -> tuple[JudgedBox, RangePoint, tuple[ParameterValues, Any, BallSystem]]:
        """Return a box with one fixed point for all values of a range, and its middle."""
        problem, given = self.problem, self.given
        values, moved = self.values(value), value - known.value
        state = [x + slope * moved for x, slope in zip(known.state, known.slope, strict=True)]
        named = dict(zip(problem.state_names, state, strict=True))
        orbit = replace(given.orbit, start_state=named, period=known.period)
        # The derivative with respect to the parameter is enclosed over a range without width, too.
        over = {self.name: radius}
        here = replace(given, orbit=orbit)
        machine, system = ball_machine(here, problem, values, over)
        y = prover_state(system, problem, orbit)
        places, others = section_places(system, y)
        middle, radii = [arb(x) for x in y], self._sides(system, y, places, radius, known)
        varied = [radius / system.units[-1]]
        reason = "no box was tried"
        for _ in range(_ATTEMPTS + 1):
            start = start_on_section(system, middle, places, others, [*radii, *varied])
            passage = walk_period(here, machine, system, start, self.settings.walk, silent)
            attempt = judge(start, passage)
            if attempt.judged is not None:
                found = _middle(problem, system, attempt.judged, value, radius)
                return attempt.judged, found, (values, machine, system)
            reason = attempt.reason
            if not attempt.next:
                break
            step, radii = attempt.next[0]
            middle = list(start.at.m)
            for k, change in zip(places, step, strict=True):
                middle[k] = (middle[k] + change).mid()
        raise ProofError("exists", reason)

    @staticmethod
    def _sides(
        system: BallSystem,
        y: Sequence[float],
        places: Sequence[int],
        radius: float,
        known: RangePoint,
    ) -> list[float]:
        """Return the radii of the first box over a range, in the prover's units."""
        sizes = [max(abs(y[k]), LEAST_SIZE) for k in places]
        sides = [_SMALL * size for size in sizes]
        if radius and known.width:
            shares = [known.spread[k] / system.units[k] * radius / known.width for k in places]
            sides = [max(a, _SPARE * b) for a, b in zip(sides, shares, strict=True)]
        elif radius:
            shares = [abs(known.slope[k]) / system.units[k] * radius for k in places]
            sides = [max(a, _SPARE * b) for a, b in zip(sides, shares, strict=True)]
        return [min(a, _WIDEST * size) for a, size in zip(sides, sizes, strict=True)]


def _shared(one: ProofRange) -> tuple[Any, ...]:
    """Return the entries that must agree for ranges of one return map."""
    records = one.data["pass"]["records"]
    names = ("digest", "section", "machine", "gap_row")
    kinds = [record.get("meets") for record in records if record["kind"] == "cross"]
    counted = [kind for kind in kinds if kind is not None and kind[0] != "stop"]
    releases = sum(kind is None for kind in kinds) and 1
    return (*(one.common.get(name) for name in names), counted, releases)


def plain_range(one: ProofRange) -> dict[str, Any]:
    """Return a range as plain data."""
    ends = [[[str(x) for x in pair] for pair in side] for side in one.ends]
    box = {str(k): [str(x) for x in pair] for k, pair in one.box.items()}
    return {
        "low": str(one.low),
        "high": str(one.high),
        "middle": asdict(one.middle),
        "data": one.data,
        "common": one.common,
        "stability": one.stability,
        "ends": ends,
        "box": box,
    }


def read_proof_range(data: Mapping[str, Any]) -> ProofRange:
    """Return a range from plain data."""

    def pair(texts: Sequence[str]) -> tuple[Fraction, Fraction]:
        low, high = map(Fraction, texts)
        return low, high

    low, high = ([pair(texts) for texts in side] for side in data["ends"])
    return ProofRange(
        low=Fraction(data["low"]),
        high=Fraction(data["high"]),
        middle=RangePoint(**data["middle"]),
        data=data["data"],
        common=data["common"],
        stability=data["stability"],
        ends=(low, high),
        box={int(k): pair(texts) for k, texts in data["box"].items()},
    )


def centred(low: float, high: float, *, upward: bool) -> tuple[float, float]:
    """Return middle and radius, both doubles, of a range that contains two values.

    If ``upward``, the upper end is exact and the lower end may lie slightly lower. Otherwise the
    lower end is exact, and the upper end may lie slightly higher.

    Args:
        low: The lower value.
        high: The upper value.
        upward: The direction in which the branch is followed.
    """
    half = (Fraction(low) + Fraction(high)) / 2
    value = float(half)
    if upward and Fraction(value) > half:
        value = math.nextafter(value, -math.inf)
    if not upward and Fraction(value) < half:
        value = math.nextafter(value, math.inf)
    wanted = Fraction(high) - Fraction(value) if upward else Fraction(value) - Fraction(low)
    radius = float(wanted)
    if Fraction(radius) < wanted:
        radius = math.nextafter(radius, math.inf)
    return value, radius


def _krawczyk(judged: JudgedBox, side: int) -> list[Ball]:
    """Return the fixed points over a range, or at one end, minus the middle of the box."""
    returned, d = judged.returned, len(judged.start.places)
    parameters = judged.start.at.U[d:]
    if side == 0 or not d:
        offsets = parameters if side == 0 else [arb(side * float(u.rad())) for u in parameters]
        return [*judged.orbit[:d], *offsets]
    # A neighbouring range ends within a few units in the last place of this end.
    rounding = arb(float(parameters[0].rad()) * 2.0**-40 + _ULPS)
    at = [arb(float(u.rad()) * side) - side * rounding / 2 + arb(0, rounding) for u in parameters]
    end = judged.passage.end.at
    slopes, middle = end.derivative, end.middle_box
    shift = [
        middle[k] - centre + sum((slopes[k, d + j] * p for j, p in enumerate(at)), arb(0))
        for k, centre in zip(judged.start.places, judged.start.centre, strict=True)
    ]
    there = replace(returned, shift=shift)
    found = there.krawczyk(there.krawczyk(returned.box))
    return [*found, *at]


def _fixed_point(
    problem: Problem, system: BallSystem, judged: JudgedBox, side: int
) -> list[tuple[Fraction, Fraction]]:
    """Return enclosures of the states of the fixed points over a range or at one of its ends."""
    start, offset = judged.start.at, _krawczyk(judged, side)
    moved = product(start.derivative, offset)
    state = own_state(system, [a + b for a, b in zip(start.middle_box, moved, strict=True)])
    return [
        (exact_fraction(x.lower().mid()), exact_fraction(x.upper().mid()))
        for x in state[: len(problem.state_names)]
    ]


def _box(system: BallSystem, start: SectionStart) -> dict[int, tuple[Fraction, Fraction]]:
    """Return the intervals of coordinates and other states of a box, in the problem's units."""
    units = [Fraction(unit) for unit in system.units]
    own = zip(start.places, start.centre, start.at.U, strict=False)
    parts = [(k, centre, u.rad()) for k, centre, u in own]
    parts += [(k, x.mid(), x.rad()) for k, x in zip(start.others, start.around, strict=True)]
    found: dict[int, tuple[Fraction, Fraction]] = {}
    for k, centre, reach in parts:
        m, r = exact_fraction(centre), exact_fraction(reach)
        found[k] = units[k] * (m - r), units[k] * (m + r)
    return found


def _middle(
    problem: Problem, system: BallSystem, judged: JudgedBox, value: float, radius: float
) -> RangePoint:
    """Return the branch at the middle of a range, with its derivative, in doubles."""
    start, d = judged.start.at, len(judged.start.places)
    n, unit = len(problem.state_names), system.units[-1]
    slopes = judged.passage.end.at.derivative
    floats = np.array(
        [[float(slopes[k, j].mid()) for j in range(d + 1)] for k in judged.start.places]
    )
    floats = floats.reshape(d, d + 1)
    by_u: Any = np.linalg.solve(np.eye(d) - floats[:, :d], floats[:, d]) if d else np.zeros(0)
    start_slopes = np.array(
        [[float(start.derivative[i, j].mid()) for j in range(d + 1)] for i in range(system.n)]
    )
    slope = start_slopes @ np.append(by_u, 1.0)
    offset = [float(x.mid()) for x in judged.orbit[:d]] + [0.0]
    state = [float(x.mid()) for x in start.middle_box] + start_slopes @ np.array(offset)
    spread = [float(x.abs_upper()) for x in judged.orbit[:d]]
    reach = dict(zip(judged.start.places, spread, strict=True))
    own = own_state(system, [arb(float(x)) for x in state])
    signs = own_state(system, [arb(float(x)) for x in state + slope])
    return RangePoint(
        value=value,
        state=tuple(float(x.mid()) for x in own[:n]),
        slope=tuple(float((b - a).mid()) / unit for a, b in zip(own[:n], signs[:n], strict=True)),
        period=float(judged.passage.period.at(judged.orbit).mid()),
        width=radius,
        spread=tuple(reach.get(k, 0.0) * system.units[k] for k in range(n)),
    )
