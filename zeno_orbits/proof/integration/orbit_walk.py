"""An orbit of a file for the prover: consistency with its problem, its start, and one period."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from flint import arb

from zeno_orbits.errors import ProofError
from zeno_orbits.model import ParameterValues, Problem, watched
from zeno_orbits.orbits import Orbit, other_equations
from zeno_orbits.proof.arithmetic.balls import ZERO, Ball
from zeno_orbits.proof.arithmetic.expressions import stop_identities
from zeno_orbits.proof.arithmetic.program import BallProgram
from zeno_orbits.proof.integration.ball_system import (
    BallSystem,
    PeriodStart,
    SectionKind,
    require_proved,
)
from zeno_orbits.proof.integration.machine import BallMachine
from zeno_orbits.proof.integration.section import SectionStart
from zeno_orbits.proof.integration.sets import Departure, ProofStage
from zeno_orbits.proof.integration.walk import ProofPassage, WalkSettings, walk
from zeno_orbits.work import Progress

LEAST_SIZE = 1e-3
"""Smallest size of a coordinate near zero, in its unit."""
_PATIENCE = 1.5
"""Longest time to return, in periods."""
_TRIALS = 3
_NEAREST = 30
"""Largest number of halvings of the distance of a trial state."""
_ON_STOP = 1e-7
"""Largest gap and gap rate of a closed stop, relative to their sizes."""
_SAME_TIME = 1e-9
"""Difference of the times of two events at the same time, relative to the period."""
_PLASTIC = "each plastic impact of the orbit is followed by a flight"
_ROUNDING = 1e-8
"""Rounding error of an identity of the stop, relative to the size of its terms."""


def require_fit(orbit: Orbit, problem: Problem, values: ParameterValues) -> None:
    """Raise an error for orbits that do not fit the problem, or of a kind that cannot be proved.

    Args:
        orbit: The orbit.
        problem: The problem.
        values: Gains and parameters of the orbit.

    Raises:
        ProofError: If the orbit does not fit, or is of another kind.
        InputError: If the restitution is 1.
    """
    if other_equations(orbit.problem_digest, problem):
        raise ProofError("problem", "the orbit was computed from other equations")
    problem.require_zeno_points(values)
    if orbit.has_phases:
        _require_stop(orbit, problem, values)
    for k, event in enumerate(orbit.events):
        before = orbit.events[k - 1]
        if event.word == before.word == "release" and _is_caused(orbit, k):
            both = " and ".join(f"`{one.name.partition(' ')[2]}`" for one in (before, event))
            reason = f"stops {both} open at the same time, and one opening at a time is proved"
            raise ProofError("shape", reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofStart:
    """The section of a proof, and the orbit from there.

    Attributes:
        orbit: The orbit, whose period starts on the section.
        kind: The states of the section.
        event: Name of the stop of the section, or of its switch.
        count: Number of releases of this stop in the period, of impacts on it, or of passages of
            the switch.
    """

    orbit: Orbit
    kind: SectionKind
    event: str
    count: int


def proof_start(orbit: Orbit) -> ProofStart:
    """Return the section of a proof: a release if there is one, then an impact, then a switch.

    Args:
        orbit: The orbit.

    Raises:
        ProofError: If no event of the orbit is a section of a proof.
    """
    if orbit.has_phases:
        struck = not orbit.shape.n_releases
        count = orbit.shape.n_phases if struck else orbit.shape.n_releases
        kind = SectionKind.IMPACT if struck else SectionKind.RELEASE
        return ProofStart(orbit=orbit, kind=kind, event="stop", count=count)
    names = [event.name for event in orbit.events]
    free = [
        k
        for k, event in enumerate(orbit.events)
        if event.word == "release" and not _is_caused(orbit, k)
    ]
    struck = not free and not any(event.word in ("release", "zeno") for event in orbit.events)
    if struck:
        free = [
            k
            for k, event in enumerate(orbit.events)
            if event.word == "impact" and (k == len(names) - 1 or event.after is not None)
        ]
    kind = SectionKind.IMPACT if struck else SectionKind.RELEASE
    if not free:
        kind = SectionKind.SWITCH
        free = [k for k, event in enumerate(orbit.events) if event.word == "switch"]
    if not free:
        reason = "no contact of the orbit ends by its own force, and it lacks a switch"
        raise ProofError("shape", f"{reason} ({', '.join(orbit.sequence)})")
    last = names[free[-1]]
    turned = _turned(orbit, free[-1], struck=kind is SectionKind.IMPACT)
    if kind is SectionKind.SWITCH:
        turned = replace(turned, start_state=orbit.events[free[-1]].state)
    event = last.partition(" ")[2]
    return ProofStart(orbit=turned, kind=kind, event=event, count=names.count(last))


def _is_caused(orbit: Orbit, k: int) -> bool:
    """Return True if a release has the time of the event before it."""
    before = orbit.events[k - 1].time - (orbit.period if k == 0 else 0.0)
    return abs(orbit.events[k].time - before) < _SAME_TIME * orbit.period


def _turned(orbit: Orbit, k: int, *, struck: bool) -> Orbit:
    """Return an orbit whose period starts just after one of its events."""
    if k == len(orbit.events) - 1:
        return orbit
    start = orbit.events[k]
    state = start.after if struck and start.after is not None else start.state
    later = [replace(event, time=event.time - start.time) for event in orbit.events[k + 1 :]]
    rest = orbit.period - start.time
    wrapped = [replace(event, time=event.time + rest) for event in orbit.events[: k + 1]]
    return replace(orbit, start_state=state, events=(*later, *wrapped))


def ball_machine(
    start: ProofStart, problem: Problem, values: ParameterValues, over: Mapping[str, float]
) -> tuple[BallMachine, BallSystem]:
    """Return the machine of an orbit in balls, and its system at the start.

    Args:
        start: The section and the orbit.
        problem: The problem.
        values: Gains and parameters.
        over: Gains or parameters that become states of rate zero.

    Raises:
        ProofError: If the machine or the start has a property that is not proved.
    """
    is_graph = not start.orbit.has_phases
    section, closed, stop = PeriodStart(start.kind), list[int](), 0
    if is_graph:
        closed = _closed_at_start(start, problem, values)
    if start.kind is SectionKind.SWITCH:
        section, stop = _before_switch(start, problem, closed)
    period = start.orbit.period
    machine = BallMachine(problem, values, over, period, section=section, is_graph=is_graph)
    if start.kind is not SectionKind.SWITCH:
        stop = machine.stop_names.index(start.event)
    others = [k for k in closed if k != stop]
    require_proved(len(others) < 2, "shape", "three stops meet at the start of the period")
    held = others[0] if others else -1
    sides = (True,) * (len(machine.switch_names) - machine.n_declared)
    if sides:
        system = machine.view(stop, sides, held)
        y = [arb(value) for value in prover_state(system, problem, start.orbit)]
        sides = _sides_before(machine, stop, sides, y)
    return machine, machine.view(stop, sides, held)


def _closed_at_start(start: ProofStart, problem: Problem, values: ParameterValues) -> list[int]:
    """Return the stops whose gap and gap rate are zero at the start of the period."""
    graph = problem.graph_dynamics(values)
    x = np.asarray(problem.state_vector(start.orbit.start_state))
    views = [graph.view(graph.open_mode, k) for k in range(len(graph.stop_names))]
    return [
        k
        for k, view in enumerate(views)
        if abs(view.gap(x)) < _ON_STOP * view.own.gap
        and abs(view.gap_rate(x)) < _ON_STOP * view.own.gap_rate
    ]


def _before_switch(
    start: ProofStart, problem: Problem, closed: Sequence[int]
) -> tuple[PeriodStart, int]:
    """Return the section of the states just before a switch, and the stop that was met last."""
    graph, orbit = problem.compiled_graph().graph, start.orbit
    names = [one.name for one in watched(graph.stops)]
    met = [event for event in orbit.events if event.word in ("impact", "zeno", "release")]
    last = met[-1].name.partition(" ")[2] if met else ""
    stop, switch = names.index(last) if last else 0, graph.switch_names.index(start.event)
    section = PeriodStart(SectionKind.SWITCH, switch, locked=bool(closed))
    return section, stop if stop in closed or not closed else closed[0]


def _sides_before(
    machine: BallMachine, stop: int, sides: tuple[bool, ...], y: Sequence[Ball]
) -> tuple[bool, ...]:
    """Return the sides of the kinks at the start, before a kink that is crossed there.

    Both sides of this kink are consistent. Its condition falls on the side before it.
    """
    kink = machine.section.switch - machine.n_declared
    if machine.section.switch < 0 or kink < 0:
        return machine.sides_at(stop, sides, y)
    for after in (sides, tuple(k != kink for k in range(len(sides)))):
        before = machine.sides_at(stop, after, y, kink)
        system = machine.view(stop, before)
        flow = system.locked if machine.section.locked else system.free
        gradient = system.guards(y)[machine.section.switch][1]
        slope = sum((g * f for g, f in zip(gradient, flow.rate(y), strict=True)), ZERO)
        if bool(slope < 0):
            return before
    raise ProofError("switch", "the kink at the start is not crossed transversally")


def _require_stop(orbit: Orbit, problem: Problem, values: ParameterValues) -> None:
    """Check the identities of the stop at a few states near the orbit's start."""
    own = problem.dynamics(values).own
    function, sizes = stop_identities(problem, own)
    program = BallProgram(function, [arb(float(value)) for value in values.vector])
    state = problem.state_vector(orbit.start_state)
    usual = own.states(len(state))
    for k in range(_TRIALS):
        # Irrational multiples spread the states evenly. Any state would be suitable.
        moves = [
            (size + abs(x)) * math.sin(3.0 * (k + 1) * (j + 1))
            for j, (x, size) in enumerate(zip(state, usual, strict=True))
        ]
        for (name, size), terms in zip(sizes.items(), _near(program, state, moves), strict=True):
            # Constants that CasADi has folded cause rounding errors.
            off, allowed = sum(terms), _ROUNDING * sum((abs(x) for x in terms), arb(size))
            require_proved(
                bool(abs(off) < allowed), "model", f"violated identity: {name} (error {off})"
            )


def _near(program: BallProgram, state: Sequence[float], moves: Sequence[float]) -> list[list[Ball]]:
    """Evaluate formulas at a state near another state, and closer to it if they are undefined."""
    found: list[list[Ball]] = []
    for halvings in range(2, _NEAREST):
        near = [arb(x + move / 2**halvings) for x, move in zip(state, moves, strict=True)]
        found = program(near)
        if all(value.is_finite() for terms in found for value in terms):
            break
    return found


def prover_state(system: BallSystem, problem: Problem, orbit: Orbit) -> list[float]:
    """Return the orbit's start in the prover's states, ``(n,)``.

    Args:
        system: The problem in the prover's units.
        problem: The problem.
        orbit: The orbit.
    """
    own = problem.state_vector(orbit.start_state)
    x = [float(value) / unit for value, unit in zip(own, system.units, strict=False)]
    x += [0.0 for _ in system.carried_stops]
    x += [float(value.mid()) for value in system.carried.values()]
    coordinate = system.expressions.coordinate
    if coordinate is not None:
        x[system.rate] *= coordinate.sign
        offset = float(system.gap_offset.mid())
        x[system.gap] = (coordinate.sign * float(own[coordinate.place]) + offset) / system.units[
            system.gap
        ]
    for k in system.stopped:
        x[k] = 0.0
    return x


def walk_period(
    given: ProofStart,
    machine: BallMachine,
    system: BallSystem,
    start: SectionStart,
    settings: WalkSettings,
    on_progress: Progress,
) -> ProofPassage:
    """Enclose one period from the set of a start, with an upper bound for the time to return.

    Args:
        given: The section and the orbit, whose period is used.
        machine: The problem in balls.
        system: Its system at the start.
        start: The set.
        settings: Settings of the enclosure.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        ProofError: If a condition is not proved.
    """
    reason = system.light(start.at.box)
    require_proved(not reason, "inertia", reason)
    require_proved(not (system.struck and system.plastic), "shape", _PLASTIC)
    view = 0, tuple[bool, ...](), -1
    if system.view is not None:
        view = system.view.stop, system.view.sides, system.view.held
    departure = {
        SectionKind.RELEASE: Departure.RELEASED,
        SectionKind.IMPACT: Departure.STRUCK,
        SectionKind.SWITCH: Departure.LOCKED if machine.section.locked else Departure.FLYING,
    }[machine.section.kind]
    stage = ProofStage.started(start.at, departure, view)
    period = given.orbit.period
    radius = max((float(u.rad()) for u in start.at.U), default=0.0)
    what = f"follow a box of radius {radius:.0e}" if radius else "follow the orbit"

    def tell(doing: str, time: float) -> None:
        late = time > _PATIENCE * period
        require_proved(not late, "period", f"the motion does not return within {time:.6g} s")
        on_progress(f"{what}, {doing}", min(time / period, 1.0))

    return walk(machine, stage, given.count, settings, tell)
