"""Bounds of a proved orbit, the claims of its certificate, and their comparison with the orbit."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from flint import arb

from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof.arithmetic.balls import Ball, exact_fraction, fraction_text, product
from zeno_orbits.proof.fixed_point import JudgedBox
from zeno_orbits.proof.integration.ball_system import BallSystem, require_proved
from zeno_orbits.proof.integration.section import SectionStart
from zeno_orbits.proof.integration.walk import PassageKind, ProofPassage
from zeno_orbits.proof.theorem import (
    Bounds,
    MultiplierDisc,
    ProvedBox,
    ProvedInterval,
    SectionBox,
    double_above,
)

CLOSE = 1e-8
"""Largest distance between values of the orbit and proved values, relative to their size."""
_DISCS_WIDER = 1.25
_TIMES_WIDER = 1.5
"""Factor by which a claimed time is widened, so that the checker's arithmetic also confirms it."""


def proof_bounds(problem: Problem, system: BallSystem, found: JudgedBox, bits: int) -> Bounds:
    """Return the enclosures of the fixed point in a box.

    Args:
        problem: The problem.
        system: The problem in balls.
        found: The evaluated box.
        bits: The ends of intervals are integer multiples of ``2^-bits``.
    """
    offset, passage = found.orbit, found.passage
    start = found.start.at
    moved = product(start.derivative, offset) if offset else [arb(0)] * system.n
    state = [a + b for a, b in zip(start.middle_box, moved, strict=True)]
    state = own_state(system, state)
    return Bounds(
        period=_claimed(passage.period.at(offset), bits),
        zeno_times=tuple(_claimed(one.at(offset), bits) for one in passage.zeno_times),
        impact_times=tuple(_claimed(one.at(offset), bits) for one in passage.impact_times),
        start_state={
            name: _claimed(value, bits)
            for name, value in zip(problem.state_names, state, strict=False)
        },
        multipliers=tuple(
            MultiplierDisc(centre=c, radius=float(r) * _DISCS_WIDER + 1e-15)
            for c, r in zip(found.discs.centres, found.discs.radii, strict=True)
        ),
        norm=double_above(exact_fraction(found.discs.norm.upper().mid())),
    )


def own_state(system: BallSystem, y: Sequence[Ball]) -> list[Ball]:
    """Convert a state of the prover to the states and units of the problem.

    Args:
        system: The problem in balls.
        y: The state, in balls, ``(n,)``.
    """
    coordinate = system.expressions.coordinate
    state = [value * unit for value, unit in zip(y, system.units, strict=True)]
    if coordinate is not None:
        state[system.gap] = (state[system.gap] - system.gap_offset) * coordinate.sign
        state[system.rate] *= coordinate.sign
    return state


def _claimed(x: Ball, bits: int) -> ProvedInterval:
    """Return an enclosure that is slightly wider than a ball."""
    if x.is_zero():
        return ProvedInterval(low=Fraction(0), high=Fraction(0))
    wide = x + arb(0, x.rad() * (_TIMES_WIDER - 1) + abs(x).upper() * arb(2) ** -85)
    unit = Fraction(2) ** -bits
    low = exact_fraction(wide.lower().mid()) // unit
    high = -(-exact_fraction(wide.upper().mid()) // unit)
    return ProvedInterval(low=low * unit, high=high * unit)


def section_box(problem: Problem, system: BallSystem, start: SectionStart) -> SectionBox:
    """Return the points of a start on the section, in the states of the problem.

    Args:
        problem: The problem.
        system: The problem in balls.
        start: The start over the box.
    """
    names, units = problem.state_names, [Fraction(unit) for unit in system.units]

    def interval(k: int, middle: Ball, radius: Ball) -> ProvedInterval:
        m, r = exact_fraction(middle), exact_fraction(radius)
        return ProvedInterval(low=units[k] * (m - r), high=units[k] * (m + r))

    own = zip(start.places, start.centre, start.at.U, strict=False)
    others = list(zip(start.others, start.reached, start.around, strict=True))
    stopped = own_state(system, start.at.middle_box)
    on_stop = set(range(len(names))).difference(start.places, start.others)
    return SectionBox(
        coordinates={names[k]: interval(k, centre, u.rad()) for k, centre, u in own},
        others={names[k]: interval(k, x.mid(), x.rad()) for k, x, _ in others}
        | {names[k]: _ends_of(stopped[k]) for k in sorted(on_stop)},
        around={names[k]: interval(k, x.mid(), x.rad()) for k, _, x in others},
    )


def _ends_of(x: Ball) -> ProvedInterval:
    m, r = exact_fraction(x.mid()), exact_fraction(x.rad())
    return ProvedInterval(low=m - r, high=m + r)


def proved_box(problem: Problem, system: BallSystem, found: JudgedBox) -> ProvedBox:
    """Return a box in the states of the problem.

    Args:
        problem: The problem.
        system: The problem in balls.
        found: The evaluated box.
    """
    box = section_box(problem, system, found.start)
    return ProvedBox(
        coordinates=box.coordinates,
        others=box.others,
        around=box.around,
        included=found.returned.included,
        norm=double_above(exact_fraction(found.discs.norm.upper().mid())),
    )


def require_numbers(orbit: Orbit, bounds: Bounds, sizes: Sequence[float]) -> None:
    """Raise an error if the remaining values of an orbit differ from the proved orbit.

    Args:
        orbit: The orbit.
        bounds: Enclosures of the proved orbit.
        sizes: Sizes of the states of the problem.
    """
    allowed = CLOSE * orbit.period

    def check(name: str, enclosed: ProvedInterval, value: float, most: float) -> None:
        off = enclosed.misses(value)
        reason = f"the orbit file has {value!r}, but {enclosed.text} is proved"
        require_proved(off <= most, name, reason)

    check("period", bounds.period, orbit.period, allowed)
    held = [event.time for event in orbit.events if event.word == "zeno"]
    require_proved(len(held) == len(bounds.zeno_times), "shape", "the orbit has other Zeno points")
    for time, proved in zip(held, bounds.zeno_times, strict=True):
        check("zeno_time", proved, time, allowed)
    impacts = [impact.time for impact in orbit.impacts]
    for time in impacts:
        nearest = min(bounds.impact_times, key=lambda one: one.misses(time))
        check("impact_time", nearest, time, allowed)
    for (name, enclosed), size in zip(bounds.start_state.items(), sizes, strict=False):
        value = orbit.start_state[name]
        check("start_state", enclosed, value, CLOSE * max(size, abs(value)))


def require_switches(orbit: Orbit, passage: ProofPassage, *, at_switch: bool) -> None:
    """Raise an error if the switches of an orbit differ from those of the proved motion.

    Args:
        orbit: The orbit.
        passage: The enclosure of its period.
        at_switch: True if the period starts just before a switch.
    """
    found = [f"switch {one.name}" for one in passage.events if one.kind is PassageKind.SWITCH]
    known = [event.name for event in orbit.events if event.word == "switch"]
    if at_switch:
        # The motion starts with the switch that ends the period of the orbit.
        known = known[-1:] + known[:-1]
    require_proved(found == known, "shape", "the motion passes other switches than the orbit file")


def claims_of(
    passes: list[JudgedBox], bounds: Bounds, units: Sequence[float]
) -> list[dict[str, Any]]:
    """Return the claims of the certificate, all about the same fixed point.

    The first box contains exactly one fixed point, which lies in every later box. Enclosures and
    stability are taken from the last box.

    Args:
        passes: The evaluated boxes.
        bounds: Enclosures of the orbit.
        units: Units of the prover's states.
    """
    last = len(passes) - 1
    claims: list[dict[str, Any]] = []

    def claim(name: str, number: int = last, **fields: Any) -> None:
        claims.append({"name": name, "pass": number, **fields})

    first = passes[0]
    if first.by_krawczyk:
        for number in range(len(passes)):
            claim("exists", number, by="krawczyk")
        claim("unique", 0)
    if first.returned.included:
        claim("exists", 0, by="inclusion")
    if first.start.places:
        discs, places = passes[-1].discs, first.start.places
        rows = [[x * units[k] for x in row] for k, row in zip(places, discs.basis, strict=True)]
        basis = {
            "re": [_exact(*(x.real for x in row)) for row in rows],
            "im": [_exact(*(x.imag for x in row)) for row in rows],
        }
        if discs.stable:
            claim("stable", basis=basis)
        elif discs.repelling:
            claim("repelling", basis=basis)
        found = [_exact(one.centre.real, one.centre.imag, one.radius) for one in bounds.multipliers]
        claim("multipliers", basis=basis, discs=found)
    claim("period", last, **_ends(bounds.period))
    for which, one in enumerate(bounds.zeno_times):
        claim("zeno_time", last, which=which, **_ends(one))
    for which, one in enumerate(bounds.impact_times):
        claim("impact_time", last, which=which, **_ends(one))
    state = list(bounds.start_state.values())
    low, high = [fraction_text(x.low) for x in state], [fraction_text(x.high) for x in state]
    claim("start_state", low=low, high=high)
    return claims


def _ends(one: ProvedInterval) -> dict[str, str]:
    return {"low": fraction_text(one.low), "high": fraction_text(one.high)}


def _exact(*numbers: float) -> list[str]:
    return [fraction_text(Fraction(x)) for x in numbers]
