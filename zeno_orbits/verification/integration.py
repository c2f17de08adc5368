"""An orbit as claimed, and as an integration from its start sees it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits.orbit import OrbitPhase, ZenoOrbit
from zeno_orbits.orbits.period import RoundTrip, followed, placed
from zeno_orbits.orbits.phases import Moment, Phase, follow_each_other, kinds_of
from zeno_orbits.orbits.shape import OrbitShape, PhaseKind
from zeno_orbits.simulation.completion import ZenoExtrapolation
from zeno_orbits.simulation.execution import Arc, Execution, Impact, Mode
from zeno_orbits.simulation.simulator import SimulationSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class ClaimedPhase:
    """What an orbit says of a phase, as vectors.

    Attributes:
        start_time: [s].
        start: ``(n_x,)``.
        impacts: Time [s] and state before it, ``(n_x,)``, of every resolved impact.
        zeno: Zeno time [s] and state, ``(n_x,)``, if the stop holds.
    """

    start_time: float
    start: Vector
    impacts: tuple[tuple[float, Vector], ...]
    zeno: tuple[float, Vector] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """What an orbit says, as vectors.

    Attributes:
        shape: Its shape.
        period: [s].
        phases: Its phases.
    """

    shape: OrbitShape
    period: float
    phases: tuple[ClaimedPhase, ...]

    @property
    def start(self) -> Vector:
        """Where the period starts, ``(n_x,)``."""
        return self.phases[0].start


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstCycle:
    """The first period as integrated.

    Attributes:
        execution: The execution that it is the beginning of.
        phases: Its phases.
        arcs: Its arcs, and the tails of accumulations.
        scale: Size of each state over it, ``(n_x,)``.
        gap_scale: Largest gap.
        force_scale: Largest multiplier.
    """

    execution: Execution
    phases: tuple[Phase, ...]
    arcs: tuple[Arc, ...]
    scale: Vector
    gap_scale: float
    force_scale: float

    @property
    def impacts(self) -> tuple[Impact, ...]:
        """Its resolved impacts."""
        return tuple(impact for phase in self.phases for impact in phase.impacts)

    @property
    def end(self) -> Moment:
        """Where it ends: at a release, or just after an impact."""
        return self.phases[-1].end

    @property
    def zeno_error(self) -> float:
        """Largest estimated error of a Zeno limit, its impacts taken as exact; 0 without one."""
        return max((p.zeno.limit_error for p in self.phases if p.zeno is not None), default=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What the integration saw.

    Attributes:
        cycle: The first period, if it has the phases of the claim.
        impacts: All impacts.
        returns: Where all periods end.
        integration_error: Difference that a looser integration makes, relative.
        trouble: Why the integration ended early; empty if it did not.
    """

    cycle: FirstCycle | None
    impacts: tuple[Impact, ...]
    returns: tuple[Moment, ...]
    integration_error: float
    trouble: str


LOOSER = 100.0
"""Factor of the second integration's tolerance; the difference bounds the first one's error."""


def claim_of(orbit: ZenoOrbit, problem: Problem) -> Claim:
    """Return an orbit's numbers as vectors.

    Raises:
        InputError: If the orbit is of another problem, or its names are not the problem's.
    """
    if orbit.problem != problem.name:
        message = (
            f"Argument `orbit` must be of problem `{problem.name}`, but it is of `{orbit.problem}`."
        )
        raise InputError(message)
    for k, phase in enumerate(orbit.phases):
        _require_impacts(phase, "" if len(orbit.phases) == 1 else f" in phase {k + 1}")
    for name, values, known in (
        ("gains", orbit.gains, [gain.name for gain in problem.gains]),
        ("parameters", orbit.parameters, [quantity.name for quantity in problem.parameters]),
    ):
        if set(values) != set(known):
            odd = ", ".join(sorted(set(values) ^ set(known)))
            message = (
                f"Argument `orbit` must have the {name} of its problem, but these differ: {odd}."
            )
            raise InputError(message)

    def vector(named: Mapping[str, float], where: str) -> Vector:
        if set(named) != set(problem.state_names):
            odd = ", ".join(sorted(set(named) ^ set(problem.state_names)))
            message = (
                f"Argument `orbit` must have all states in `{where}`, but these differ: {odd}."
            )
            raise InputError(message)
        return np.array(problem.state_vector(named))

    one = orbit.shape.has_one_release
    return Claim(
        shape=orbit.shape,
        period=orbit.period,
        phases=tuple(
            ClaimedPhase(
                start_time=phase.start_time,
                start=vector(phase.start_state, "release_state" if one else "start_state"),
                impacts=tuple((i.time, vector(i.state_minus, "impacts")) for i in phase.impacts),
                zeno=None
                if phase.zeno_time is None or phase.zeno_state is None
                else (phase.zeno_time, vector(phase.zeno_state, "zeno_state")),
            )
            for phase in orbit.phases
        ),
    )


def _require_impacts(phase: OrbitPhase, where: str) -> None:
    """Refuse a phase without an impact, or with several where the first one ends it."""
    if not phase.impacts:
        raise InputError(f"Argument `orbit` must have an impact{where}, but it has none.")
    if phase.kind is not PhaseKind.ZENO and len(phase.impacts) > 1:
        wanted = f"must have one impact{where}, which is `{phase.kind.value}`"
        raise InputError(f"Argument `orbit` {wanted}, but it has {len(phase.impacts)}.")


def observe(
    dynamics: HybridDynamics, claim: Claim, simulation: SimulationSettings, n_periods: int
) -> Observation:
    """Integrate from the claimed start over some periods, and the first again less accurately.

    Args:
        dynamics: The system.
        claim: The orbit as claimed.
        simulation: Accuracy.
        n_periods: Returns to wait for; the claimed period only bounds the waiting.
    """
    shape = claim.shape.at_restitution(dynamics.restitution)
    start = placed(dynamics, shape, claim.start)
    horizon = (n_periods + 0.5) * claim.period
    try:
        trip = followed(
            dynamics, start, shape, horizon=horizon, settings=simulation, turns=n_periods
        )
    except ZenoOrbitsError as error:
        if n_periods == 1:
            return _nothing(str(error))
        # A motion that leaves its orbit later has still told of the first period.
        first = observe(dynamics, claim, simulation, 1)
        return replace(first, trouble=first.trouble or str(error))
    cycle = _first_cycle(dynamics, trip, shape)
    if isinstance(cycle, str):
        observed = _nothing(f"{cycle} within {horizon:.4g} s")
        return replace(observed, impacts=trip.execution.impacts)
    loose = replace(
        simulation,
        tolerance=Tolerance(
            relative=LOOSER * simulation.tolerance.relative,
            absolute=LOOSER * simulation.tolerance.absolute,
        ),
        completion=ZenoExtrapolation(tolerance=1e-10),
    )
    return Observation(
        cycle=cycle,
        impacts=trip.execution.impacts,
        returns=_returns(trip, shape),
        integration_error=_looser_return(dynamics, start, shape, cycle, loose),
        trouble="",
    )


def _returns(trip: RoundTrip, shape: OrbitShape) -> tuple[Moment, ...]:
    """Return where the periods end, as far as they have the phases of the shape."""
    n, found = shape.n_phases, list[Moment]()
    for k in range(0, len(trip.phases) - n + 1, n):
        period = trip.phases[k : k + n]
        if kinds_of(period) != shape.phases or not follow_each_other(trip.phases[: k + n]):
            break
        found.append(period[-1].end)
    return tuple(found)


def _looser_return(
    dynamics: HybridDynamics,
    start: Vector,
    shape: OrbitShape,
    cycle: FirstCycle,
    settings: SimulationSettings,
) -> float:
    """Return how far the first return of a looser integration is from the first one's."""
    try:
        horizon = 1.5 * cycle.end.time
        again = followed(dynamics, start, shape, horizon=horizon, settings=settings)
    except ZenoOrbitsError:
        return math.inf
    later = _returns(again, shape)
    return distance(later[0].state, cycle.end.state, cycle.scale) if later else math.inf


def _nothing(trouble: str) -> Observation:
    return Observation(
        cycle=None, impacts=(), returns=(), integration_error=math.inf, trouble=trouble
    )


def _first_cycle(dynamics: HybridDynamics, trip: RoundTrip, shape: OrbitShape) -> FirstCycle | str:
    """Return the first period, or what is missing."""
    execution, phases = trip.execution, trip.phases[: shape.n_phases]
    if shape.starts_at_release and not execution.returns(execution.end_time):
        return "There is no release"
    if shape.starts_at_release and not execution.zeno_points:
        return "There is no Zeno point"
    if kinds_of(phases) != shape.phases or not follow_each_other(phases):
        seen = ", ".join(kind.value for kind in kinds_of(phases)) or "none"
        return f"There are not the phases `{shape.text}`, but {seen}"
    end = phases[-1].end
    arcs = tuple(arc for arc in execution.arcs if arc.start_time < end.time)
    states = np.concatenate([arc.flow_states[:, : len(end.state)] for arc in arcs])
    sizes = np.max(np.abs(states), axis=0)
    forces = [
        abs(dynamics.multiplier(x))
        for arc in arcs
        if arc.mode is Mode.LOCKED
        for x in arc.flow_states
    ]
    forces += [abs(dynamics.multiplier(p.zeno.state)) for p in phases if p.zeno is not None]
    return FirstCycle(
        execution=execution,
        phases=phases,
        arcs=arcs,
        scale=np.where(sizes > 0.0, sizes, 1.0),
        gap_scale=max(_largest_gap(dynamics, arc) for arc in arcs),
        force_scale=max(forces, default=1.0),
    )


def _largest_gap(dynamics: HybridDynamics, arc: Arc) -> float:
    """Return the largest gap of an arc; a rescaled flight carries it along."""
    states = arc.flow_states
    if arc.mode is Mode.FREE and states.shape[1] > len(arc.start_state):
        return float(np.max(np.abs(states[:, -2]))) * arc.time_unit**2
    return max(abs(dynamics.gap(x)) for x in states)


def distance(a: Vector, b: Vector, scale: Vector) -> float:
    """Return the largest difference of two states, each entry in units of its scale."""
    return float(np.max(np.abs(a - b) / scale))
