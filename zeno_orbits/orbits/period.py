"""Simulations of one period between passages of the section: evaluations of the return map."""

from __future__ import annotations

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits.cycle import Cycle, first_cycles
from zeno_orbits.orbits.phases import kinds_of, phases_of
from zeno_orbits.orbits.shape import EventSequence
from zeno_orbits.simulation import Execution, Mode, Release, SimulationSettings, simulate


def to_next_release(
    dynamics: HybridDynamics, x: Vector, *, horizon: float, settings: SimulationSettings
) -> Execution:
    """Return the execution from a release to the next release, or to the horizon.

    A start may be in contact for a short time, by rounding or because it belongs to other
    parameters. It is then released first. That release does not count as the next release.

    Args:
        dynamics: The system.
        x: A release state, on the stop, ``(n_x,)``.
        horizon: Longest time to wait [s].
        settings: Accuracy.

    Raises:
        SimulationError: If the execution cannot be continued so far.
    """
    return to_release(dynamics, x, 1, horizon=horizon, settings=settings)


def to_release(
    dynamics: HybridDynamics,
    x: Vector,
    count: int,
    *,
    horizon: float,
    settings: SimulationSettings,
) -> Execution:
    """Return the execution from a release to a later release, as in `to_next_release`.

    Args:
        dynamics: The system.
        x: A release state, on the stop, ``(n_x,)``.
        count: Number of releases after the start.
        horizon: Longest time to wait [s].
        settings: Accuracy.

    Raises:
        SimulationError: If the execution cannot be continued so far.
    """
    execution = simulate(dynamics, x, until=horizon, releases=count, settings=settings)
    if len(execution.releases) == count and len(later_releases(execution)) < count:
        execution = simulate(dynamics, x, until=horizon, releases=count + 1, settings=settings)
    return execution


def later_releases(execution: Execution) -> tuple[Release, ...]:
    """Return the releases that follow a flight."""
    flight = next((arc for arc in execution.arcs if arc.mode is Mode.FREE), None)
    if flight is None:
        return ()
    return tuple(r for r in execution.releases if r.time > flight.start_time)


def first_return(execution: Execution) -> Release | None:
    """Return the first release that follows a flight, or ``None``."""
    return next(iter(later_releases(execution)), None)


def place_on_section(dynamics: HybridDynamics, shape: EventSequence, x: Vector) -> Vector:
    """Return the state moved onto the section at the start of a shape, to rounding, ``(n_x,)``.

    At a release, and just after a plastic impact, the gap and the gap rate are set to zero. After
    another impact only the gap is set to zero.

    Args:
        dynamics: The system.
        shape: The shape.
        x: A state near the section, ``(n_x,)``.
    """
    if shape.starts_at_release or dynamics.restitution == 0.0:
        return dynamics.on_stop(x)
    gap, n_q = dynamics.gap(x), dynamics.n_q
    if gap == 0.0:
        return x
    moved = x.copy()
    moved[:n_q] -= gap * dynamics.impulse_direction(x)[n_q : 2 * n_q]
    return moved


def followed(
    dynamics: HybridDynamics,
    x: Vector,
    shape: EventSequence,
    *,
    horizon: float,
    settings: SimulationSettings,
    n_periods: int = 1,
) -> Execution:
    """Return the execution from a start, over the expected phases of a number of periods.

    Args:
        dynamics: The system.
        x: State at the start of a period, on its section, ``(n_x,)``.
        shape: Expected shape of a period, at the coefficient of restitution of the system.
        horizon: Longest time to wait [s].
        settings: Accuracy.
        n_periods: Number of periods.

    Raises:
        SimulationError: If the execution cannot be continued so far.
    """
    if shape.starts_at_release:
        count = n_periods * shape.n_releases
        return to_release(dynamics, x, count, horizon=horizon, settings=settings)
    count = n_periods * shape.n_phases
    return simulate(dynamics, x, until=horizon, impacts=count, settings=settings)


def cycle_of(
    dynamics: HybridDynamics,
    x: Vector,
    shape: EventSequence,
    *,
    horizon: float,
    settings: SimulationSettings,
) -> Cycle:
    """Return the period of a shape that starts at a state of its section.

    Args:
        dynamics: The system.
        x: The state, ``(n_x,)``.
        shape: The shape. Plastic impacts and accumulations are exchanged if the coefficient of
            restitution requires it.
        horizon: Longest time to wait for its end [s].
        settings: Accuracy.

    Raises:
        SimulationError: If the motion has a different shape, or does not finish within the horizon.
    """
    return cycle_and_run(dynamics, x, shape, horizon=horizon, settings=settings)[0]


def cycle_and_run(
    dynamics: HybridDynamics,
    x: Vector,
    shape: EventSequence,
    *,
    horizon: float,
    settings: SimulationSettings,
) -> tuple[Cycle, Execution]:
    """Return the period as from `cycle_of`, and the execution that contains it.

    Args:
        dynamics: The system.
        x: The state, ``(n_x,)``.
        shape: The shape.
        horizon: Longest time to wait for its end [s].
        settings: Accuracy.

    Raises:
        SimulationError: If the motion has a different shape, or does not finish within the horizon.
    """
    wanted = shape.at_restitution(dynamics.restitution)
    execution = followed(dynamics, x, wanted, horizon=horizon, settings=settings)
    found = first_cycles(execution, x, wanted)
    if found:
        return found[0], execution
    phases = phases_of(execution, x, held=wanted.starts_at_release)[: wanted.n_phases]
    seen = ", ".join(kind.value for kind in kinds_of(phases)) or "no phase"
    raise SimulationError(
        f"The shape of the motion is not `{wanted.text}`: {seen}",
        time=phases[-1].end.time if phases else horizon,
        state=tuple(x.tolist()),
    )
