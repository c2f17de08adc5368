"""From where a period starts to where it ends: the execution that the return map is made of."""

from __future__ import annotations

from dataclasses import dataclass

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.orbits.phases import Phase, follow_each_other, kinds_of, phases_of
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.simulation.execution import Arc, Execution, Mode, Release
from zeno_orbits.simulation.simulator import SimulationSettings, simulate


@dataclass(frozen=True, slots=True, kw_only=True)
class RoundTrip:
    """One period or several, from a start.

    Attributes:
        execution: The execution.
        phases: Its phases.
        first_lock: The locked arc before the first flight, if the start is locked.
    """

    execution: Execution
    phases: tuple[Phase, ...]
    first_lock: Arc | None


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

    At a release, and just after a plastic impact, the gap rate is zero; after another impact it is
    what it is, and the gap alone is taken away.
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
    turns: int = 1,
) -> RoundTrip:
    """Return what is seen from a start until the phases of a shape should have passed.

    Args:
        dynamics: The system.
        x: Where a period starts, on its section, ``(n_x,)``.
        shape: What to wait for.
        horizon: Longest time to wait [s].
        settings: Accuracy.
        turns: Periods to wait for.

    Raises:
        SimulationError: If the execution cannot be continued so far.
    """
    if shape.starts_at_release:
        count = turns * shape.n_releases
        run = to_release(dynamics, x, count, horizon=horizon, settings=settings)
    else:
        count = turns * shape.n_phases
        run = simulate(dynamics, x, until=horizon, impacts=count, settings=settings)
    first = run.arcs[0]
    return RoundTrip(
        execution=run,
        phases=phases_of(run, x, held=shape.starts_at_release),
        first_lock=first if first.mode is Mode.LOCKED else None,
    )


def round_trip(
    dynamics: HybridDynamics,
    x: Vector,
    shape: OrbitShape,
    *,
    horizon: float,
    settings: SimulationSettings,
) -> RoundTrip:
    """Return the first period from a start, if it has a shape.

    Args:
        dynamics: The system.
        x: Where it starts, on its section, ``(n_x,)``.
        shape: Its shape; with another restitution, plastic impacts and accumulations are the same.
        horizon: Longest time to wait [s].
        settings: Accuracy.

    Raises:
        SimulationError: If it has another shape, or does not come to its end within the horizon.
    """
    wanted = shape.at_restitution(dynamics.restitution)
    trip = followed(dynamics, x, wanted, horizon=horizon, settings=settings)
    phases = trip.phases[: wanted.n_phases]
    begins = bool(phases) and trip.phases[0].flight is _first_flight(trip.execution)
    if not begins or kinds_of(phases) != wanted.phases or not follow_each_other(phases):
        seen = ", ".join(kind.value for kind in kinds_of(phases)) or "no phase"
        raise SimulationError(
            f"The motion has another shape than `{wanted.text}`: {seen}",
            time=phases[-1].end.time if phases else horizon,
            state=tuple(x.tolist()),
        )
    return RoundTrip(execution=trip.execution, phases=phases, first_lock=trip.first_lock)


def _first_flight(execution: Execution) -> Arc | None:
    return next((arc for arc in execution.arcs if arc.mode is Mode.FREE), None)
