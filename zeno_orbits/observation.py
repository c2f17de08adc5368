"""An orbit as claimed, and as an integration from its release sees it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.completion import ZenoExtrapolation
from zeno_orbits.dynamics import HybridDynamics, Tolerance, Vector
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.execution import Arc, Execution, Impact, Mode, Release, ZenoPoint
from zeno_orbits.orbit import ZenoOrbit
from zeno_orbits.problem import Problem
from zeno_orbits.returns import to_next_release
from zeno_orbits.simulate import SimulationSettings, simulate


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """What an orbit says, as vectors.

    Attributes:
        period: [s].
        release: Release state, ``(n_x,)``.
        impacts: Time [s] and state before it, ``(n_x,)``, of every resolved impact.
        zeno_time: [s].
        zeno: Zeno state, ``(n_x,)``.
    """

    period: float
    release: Vector
    impacts: tuple[tuple[float, Vector], ...]
    zeno_time: float
    zeno: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstCycle:
    """The first period as integrated.

    Attributes:
        execution: The execution that it is the beginning of.
        arcs: Its arcs.
        impacts: Its resolved impacts.
        zeno: Its Zeno point.
        end: The release that ends it.
        scale: Size of each state over it, ``(n_x,)``.
        gap_scale: Largest gap.
        force_scale: Largest multiplier.
    """

    execution: Execution
    arcs: tuple[Arc, ...]
    impacts: tuple[Impact, ...]
    zeno: ZenoPoint
    end: Release
    scale: Vector
    gap_scale: float
    force_scale: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What the integration saw.

    Attributes:
        cycle: The first period, if the release came back.
        impacts: All impacts.
        returns: All returns.
        integration_error: Difference that a looser integration makes, relative.
        trouble: Why the integration ended early; empty if it did not.
    """

    cycle: FirstCycle | None
    impacts: tuple[Impact, ...]
    returns: tuple[Release, ...]
    integration_error: float
    trouble: str


LOOSER = 100.0
"""Factor of the second integration's tolerance; the difference bounds the first one's error."""


def claim_of(orbit: ZenoOrbit, problem: Problem) -> Claim:
    """Return an orbit's numbers as vectors.

    Raises:
        InputError: If the orbit is of another scene, or its names are not the scene's.
    """
    if orbit.problem != problem.name:
        message = (
            f"Argument `orbit` must be of scene `{problem.name}`, but it is of `{orbit.problem}`."
        )
        raise InputError(message)
    if not orbit.impacts:
        raise InputError("Argument `orbit` must have an impact, but it has none.")
    for name, values, known in (
        ("gains", orbit.gains, [gain.name for gain in problem.gains]),
        ("parameters", orbit.parameters, [quantity.name for quantity in problem.parameters]),
    ):
        if set(values) != set(known):
            odd = ", ".join(sorted(set(values) ^ set(known)))
            message = (
                f"Argument `orbit` must have the {name} of its scene, but these differ: {odd}."
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

    return Claim(
        period=orbit.period,
        release=vector(orbit.release_state, "release_state"),
        impacts=tuple((i.time, vector(i.state_minus, "impacts")) for i in orbit.impacts),
        zeno_time=orbit.zeno_time,
        zeno=vector(orbit.zeno_state, "zeno_state"),
    )


def observe(
    dynamics: HybridDynamics, claim: Claim, simulation: SimulationSettings, n_periods: int
) -> Observation:
    """Integrate from the claimed release over some periods, and the first again less accurately.

    Args:
        dynamics: The system.
        claim: The orbit as claimed.
        simulation: Accuracy.
        n_periods: Returns to wait for; the claimed period only bounds the waiting.
    """
    start = dynamics.on_stop(claim.release)
    horizon = (n_periods + 0.5) * claim.period
    try:
        # One release more: a start that is locked by a rounding error is released at once.
        execution = simulate(
            dynamics, start, until=horizon, releases=n_periods + 1, settings=simulation
        )
    except ZenoOrbitsError as error:
        if n_periods == 1:
            return _nothing(str(error))
        # A motion that leaves its orbit later has still told of the first period.
        first = observe(dynamics, claim, simulation, 1)
        return replace(first, trouble=first.trouble or str(error))
    returns = execution.returns(claim.period)
    zenos = [z for z in execution.zeno_points if returns and z.time < returns[0].time]
    if not returns or not zenos:
        what = "release" if not returns else "Zeno point"
        observed = _nothing(f"There is no {what} within {horizon:.4g} s")
        return replace(observed, impacts=execution.impacts)
    cycle = _first_cycle(dynamics, execution, returns[0], zenos[0])
    loose = replace(
        simulation,
        tolerance=Tolerance(
            relative=LOOSER * simulation.tolerance.relative,
            absolute=LOOSER * simulation.tolerance.absolute,
        ),
        completion=ZenoExtrapolation(tolerance=1e-10),
    )
    error = _looser_return(dynamics, start, cycle, loose)
    return Observation(
        cycle=cycle,
        impacts=execution.impacts,
        returns=returns,
        integration_error=error,
        trouble="",
    )


def _looser_return(
    dynamics: HybridDynamics, start: Vector, cycle: FirstCycle, settings: SimulationSettings
) -> float:
    """Return how far the first return of a looser integration is from the first one's."""
    try:
        horizon = 1.5 * cycle.end.time
        again = to_next_release(dynamics, start, horizon=horizon, settings=settings)
    except ZenoOrbitsError:
        return math.inf
    later = again.returns(cycle.end.time)
    return distance(later[0].state, cycle.end.state, cycle.scale) if later else math.inf


def _nothing(trouble: str) -> Observation:
    return Observation(
        cycle=None, impacts=(), returns=(), integration_error=math.inf, trouble=trouble
    )


def _first_cycle(
    dynamics: HybridDynamics, execution: Execution, end: Release, zeno: ZenoPoint
) -> FirstCycle:
    arcs = tuple(arc for arc in execution.arcs if arc.start_time < end.time)
    states = np.concatenate([arc.flow_states[:, : len(end.state)] for arc in arcs])
    sizes = np.max(np.abs(states), axis=0)
    gaps = [_largest_gap(dynamics, arc) for arc in arcs]
    forces = [
        abs(dynamics.multiplier(x))
        for arc in arcs
        if arc.mode is Mode.LOCKED
        for x in arc.flow_states
    ]
    return FirstCycle(
        execution=execution,
        arcs=arcs,
        impacts=tuple(i for i in execution.impacts if i.time < end.time),
        zeno=zeno,
        end=end,
        scale=np.where(sizes > 0.0, sizes, 1.0),
        gap_scale=max(gaps),
        force_scale=max([*forces, abs(dynamics.multiplier(zeno.state))]),
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
