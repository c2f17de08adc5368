"""Simulations of one period, from its section back to it: evaluations of the return map."""

from __future__ import annotations

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits.cycle import Cycle, first_cycles
from zeno_orbits.orbits.phases import kinds_of, phases_of
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.simulation import Execution, Mode, Release, SimulationSettings, simulate


def to_next_release(
    dynamics: HybridDynamics, x: Vector, *, horizon: float, settings: SimulationSettings
) -> Execution:
    """Return the execution from a release until the next one, or to the horizon without any.

    A start that is locked a little, by rounding or as it belongs to other parameters, is released
    first and flies then: that release is not the next one.

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
    """Return the execution from a release until some releases later, as `to_next_release` does.

    Args:
        dynamics: The system.
        x: A release state, on the stop, ``(n_x,)``.
        count: How many releases later.
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
    """Return the releases that come after a flight."""
    flight = next((arc for arc in execution.arcs if arc.mode is Mode.FREE), None)
    if flight is None:
        return ()
    return tuple(r for r in execution.releases if r.time > flight.start_time)


def first_return(execution: Execution) -> Release | None:
    """Return the first release that comes after a flight, if there is one."""
    return next(iter(later_releases(execution)), None)


def placed(dynamics: HybridDynamics, shape: OrbitShape, x: Vector) -> Vector:
    """Return the state moved onto the section that a shape starts on, to rounding, ``(n_x,)``.

    At a release, and just after a plastic impact, gap and gap rate become zero; after another
    impact the gap alone does.

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
    shape: OrbitShape,
    *,
    horizon: float,
    settings: SimulationSettings,
    n_periods: int = 1,
) -> Execution:
    """Return the execution from a start until the phases of some periods should have passed.

    Args:
        dynamics: The system.
        x: Where a period starts, on its section, ``(n_x,)``.
        shape: What to wait for, at the restitution of the system.
        horizon: Longest time to wait [s].
        settings: Accuracy.
        n_periods: Periods to wait for.

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
    shape: OrbitShape,
    *,
    horizon: float,
    settings: SimulationSettings,
) -> Cycle:
    """Return the period of a shape that starts at a state of its section.

    Args:
        dynamics: The system.
        x: The state, ``(n_x,)``.
        shape: The shape; with another restitution, plastic impacts and accumulations are the same.
        horizon: Longest time to wait for its end [s].
        settings: Accuracy.

    Raises:
        SimulationError: If the motion has another shape, or does not come to its end within the
            horizon.
    """
    wanted = shape.at_restitution(dynamics.restitution)
    execution = followed(dynamics, x, wanted, horizon=horizon, settings=settings)
    found = first_cycles(execution, x, wanted)
    if found:
        return found[0]
    phases = phases_of(execution, x, held=wanted.starts_at_release)[: wanted.n_phases]
    seen = ", ".join(kind.value for kind in kinds_of(phases)) or "no phase"
    raise SimulationError(
        f"The motion has another shape than `{wanted.text}`: {seen}",
        time=phases[-1].end.time if phases else horizon,
        state=tuple(x.tolist()),
    )
