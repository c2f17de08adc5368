"""Disturbances of an orbit: the largest impulses, recovery, scatter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from zeno_orbits.api.inputs import (
    Named,
    any_orbit,
    file_of,
    front_door,
    plan_of,
    problem_of,
)
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import ExecutionPlan, Progress, silent

if TYPE_CHECKING:
    from zeno_orbits.maps import (
        Pushes,
        PushSettings,
        Recovery,
        RecoverySettings,
        Scatter,
        ScatterSettings,
    )


@front_door
def largest_push(
    orbit: Orbit | str | Path,
    *,
    problem: Named | None = None,
    directions: Sequence[Mapping[str, float]] = (),
    settings: PushSettings | None = None,
    workers: int = 1,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
) -> Pushes:
    """Return the largest impulses from which the motion returns to an orbit.

    The impulses act at equidistant phases of the period, in both senses of each direction. The
    first lost impulse is located by a scan, which is finer where motions return late.

    Args:
        orbit: The orbit, or its file. It must be stable.
        problem: The orbit's problem. The default is the bundled problem of its name.
        directions: Coordinate to entry of the generalized force of each direction. The default is
            one unit along each coordinate.
        settings: Phases, scan and accuracy.
        workers: Number of processes. Several processes need the name or the file of the problem.
        plan: Executor of the work and folder of finished parts. It overrides ``workers``.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown, a direction moves no coordinate, or the orbit is unstable.
        WorkError: If the work cannot be finished.
    """
    from zeno_orbits import maps

    orbit = any_orbit(orbit)
    known = problem_of(orbit, problem)
    shared = plan_of(workers, plan)
    source = known if shared is None else file_of(known if problem is None else problem)
    return maps.largest_pushes(
        source,
        orbit,
        directions=directions,
        settings=settings,
        plan=shared,
        on_progress=on_progress,
    )


@front_door
def recovery(
    orbit: Orbit | str | Path,
    *,
    problem: Named | None = None,
    settings: RecoverySettings | None = None,
    on_progress: Progress = silent,
) -> Recovery:
    """Return the recovery of an orbit: its time, its norm, and a ball whose samples return into it.

    The ball is tested by sampling. The result states the bound of the share that leaves it.

    Args:
        orbit: The orbit, or its file. It must be stable.
        problem: The orbit's problem. The default is the bundled problem of its name.
        settings: Part of the decay, samples, confidence and accuracy.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If the orbit's problem is not known, or the orbit is not closed or unstable.
        SimulationError: If the motion from its start does not have the events of the orbit.
    """
    from zeno_orbits import maps

    orbit = any_orbit(orbit)
    return maps.recovery_of(
        problem_of(orbit, problem), orbit, settings=settings, on_progress=on_progress
    )


@front_door
def scatter(
    orbit: Orbit | str | Path,
    spread: Mapping[str, float],
    *,
    problem: Named | None = None,
    settings: ScatterSettings | None = None,
    on_progress: Progress = silent,
) -> Scatter:
    """Return the scatter of an orbit whose restitution differs from impact to impact.

    It consists of standard deviations to first order, by exact derivatives, and of those of many
    simulated periods, and of the mean number of periods until a motion leaves the orbit.

    Args:
        orbit: The orbit, or its file. It must be stable.
        spread: Name to standard deviation. ``restitution`` is relative, drawn for every impact on
            every stop, and ``STOP.restitution`` the same for one stop. The name of a state is
            absolute, and its noise is added on the section in every period.
        problem: The orbit's problem. The default is the bundled problem of its name.
        settings: Number of simulated periods, and seed.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown or a value invalid, or the orbit is not closed or unstable.
    """
    from zeno_orbits import maps

    orbit = any_orbit(orbit)
    return maps.scatter_of(
        problem_of(orbit, problem), orbit, spread, settings=settings, on_progress=on_progress
    )


def scatter_settings(*, periods: int, seed: int) -> ScatterSettings:
    """Return the settings of a scatter.

    Args:
        periods: Number of simulated periods.
        seed: Seed of the simulation.
    """
    from zeno_orbits.maps import ScatterSettings

    return ScatterSettings(periods=periods, seed=seed)


def recovery_settings(
    *, part: float, samples: int, confidence: float, error: float, seed: int = 0
) -> RecoverySettings:
    """Return the settings of a recovery.

    Args:
        part: Part to which a disturbance has to decay.
        samples: Number of points of a test.
        confidence: Confidence of the statement.
        error: Relative step of the radius.
        seed: Seed of the points.
    """
    from zeno_orbits.maps import RecoverySettings

    return RecoverySettings(
        part=part, samples=samples, confidence=confidence, error=error, seed=seed
    )


def push_settings(
    *, phases: int, steps: int, reach: float, error: float, until: float | None = None
) -> PushSettings:
    """Return the settings of a search for the largest pushes.

    Args:
        phases: Number of equidistant phases.
        steps: Impulses along a ray of the scan.
        reach: End of the scan, relative to the impulse of the orbit's largest kinetic energy.
        error: Largest relative error of a located impulse.
        until: Longest time for a motion to return [s].
    """
    from zeno_orbits.maps import PushSettings

    return PushSettings(phases=phases, steps=steps, reach=reach, error=error, until=until)
