"""Bounds of a proved orbit, the claims of its certificate, and whether they are the orbit's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flint import arb

from zeno_orbits.model import Problem
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.proof.ball_system import BallSystem, require_proved
from zeno_orbits.proof.balls import Ball, exact_text, product
from zeno_orbits.proof.fixed_point import JudgedBox
from zeno_orbits.proof.theorem import Bounds, MultiplierDisc, ProvedInterval

CLOSE = 1e-8
"""How far numbers of the orbit may be from those that are proved, per size."""
_DISCS_WIDER = 1.25
_TIMES_WIDER = 1.5
"""How much wider a claimed time is than found, so that another arithmetic finds it, too."""


def proof_bounds(problem: Problem, system: BallSystem, found: JudgedBox) -> Bounds:
    """Return what is enclosed of the orbit that passes through a box.

    Args:
        problem: The problem.
        system: The problem in balls.
        found: The box, judged.
    """
    offset, passage = found.orbit, found.passage
    start = found.start.at
    moved = product(start.derivative, offset) if offset else [arb(0)] * system.n
    state = [a + b for a, b in zip(start.middle_box, moved, strict=True)]
    coordinate = system.expressions.coordinate
    state = [value * unit for value, unit in zip(state, system.units, strict=True)]
    if coordinate is not None:
        state[system.gap] = (state[system.gap] - system.gap_offset) * coordinate.sign
    return Bounds(
        period=_claimed(passage.release_times[-1].at(offset)),
        zeno_times=tuple(_claimed(one.at(offset)) for one in passage.zeno_times),
        impact_times=tuple(_claimed(one.at(offset)) for one in passage.impact_times),
        start_state={
            name: _claimed(value) for name, value in zip(problem.state_names, state, strict=False)
        },
        multipliers=tuple(
            MultiplierDisc(centre=c, radius=float(r) * _DISCS_WIDER + 1e-15)
            for c, r in zip(found.discs.centres, found.discs.radii, strict=True)
        ),
        norm=float(found.discs.norm.upper()),
    )


def _claimed(x: Ball) -> ProvedInterval:
    """Return the ends of an enclosure that is somewhat wider than a ball."""
    if x.is_zero():
        return ProvedInterval(low=x, high=x)
    wide = x + arb(0, x.rad() * (_TIMES_WIDER - 1) + abs(x).upper() * arb(2) ** -85)
    return ProvedInterval(low=wide.lower().mid(), high=wide.upper().mid())


def require_numbers(orbit: ZenoOrbit, bounds: Bounds, sizes: Sequence[float]) -> None:
    """Refuse an orbit whose other numbers are not those of the orbit that is proved.

    Args:
        orbit: The orbit.
        bounds: What is enclosed of the orbit that is proved.
        sizes: Of the states of the problem.
    """
    allowed = CLOSE * orbit.period

    def check(name: str, enclosed: ProvedInterval, value: float, most: float) -> None:
        off = enclosed.misses(value)
        reason = f"the orbit says {value:.12g}, but {enclosed.text} is proved"
        require_proved(off <= most, name, reason)

    check("period", bounds.period, orbit.period, allowed)
    held = [phase for phase in orbit.phases if phase.zeno_time is not None]
    require_proved(len(held) == len(bounds.zeno_times), "shape", "the orbit has other Zeno points")
    for phase, proved in zip(held, bounds.zeno_times, strict=True):
        check("zeno_time", proved, float(phase.zeno_time or 0.0), allowed)
    impacts = [impact.time for impact in orbit.impacts]
    for time in impacts:
        nearest = min(bounds.impact_times, key=lambda one: one.misses(time))
        check("impact_time", nearest, time, allowed)
    for (name, enclosed), size in zip(bounds.start_state.items(), sizes, strict=False):
        value = orbit.start_state[name]
        check("start_state", enclosed, value, CLOSE * max(size, abs(value)))


def claims_of(passes: list[JudgedBox], bounds: Bounds) -> list[dict[str, Any]]:
    """Return the claims of the certificate."""
    last = len(passes) - 1
    claims: list[dict[str, Any]] = []

    def claim(name: str, number: int = last, **fields: Any) -> None:
        claims.append({"name": name, "pass": number, **fields})

    for number, one in enumerate(passes):
        if one.start.places:
            claim("exists", number, by="krawczyk")
        if one.returned.included:
            claim("exists", number, by="inclusion")
    if passes[0].start.places:
        claim("unique", 0)
        discs = passes[-1].discs
        basis = {
            "re": [_exact(*(x.real for x in row)) for row in discs.basis],
            "im": [_exact(*(x.imag for x in row)) for row in discs.basis],
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
    low, high = [exact_text(x.low) for x in state], [exact_text(x.high) for x in state]
    claim("start_state", low=low, high=high)
    return claims


def _ends(one: ProvedInterval) -> dict[str, str]:
    return {"low": exact_text(one.low), "high": exact_text(one.high)}


def _exact(*numbers: float) -> list[str]:
    return [exact_text(arb(x)) for x in numbers]
