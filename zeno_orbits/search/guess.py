"""First guesses by simulation: follow a problem until its motion repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import RunawayError, SimulationError
from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.quantities import RUNAWAY
from zeno_orbits.orbits.cycle import Cycle, cycles
from zeno_orbits.orbits.period import cycle_of, placed, to_next_release
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.search.recurrence import Recurrence, Recurring
from zeno_orbits.simulation.completion import ZenoExtrapolation
from zeno_orbits.simulation.execution import Execution, Mode
from zeno_orbits.simulation.simulator import SimulationSettings, simulate

_FADED = 1e-3
"""A motion whose first impacts have slowed down to this part of its fastest is dying out."""

_DIFFERENCE = 1e-6
"""Step of a derivative; its error is that part of a correction that is small itself."""

_STILL = 1e-6
"""Speeds and accelerations below this are rest, in the problem's units."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SettlingSettings:
    """How long to wait for a motion to repeat.

    Attributes:
        horizon: Longest simulated time from one start [s].
        chunk: Longest simulated time between two looks [s]; there is one at every release, too.
            A motion that does not come back to its release so soon is waited for twice as long.
        settled: Change of the release state over a period that counts as repeating, relative.
        usable: Change up to which the last period still serves as a guess.
        simulation: Accuracy; looser than a verification.
    """

    horizon: float = 200.0
    chunk: float = 10.0
    settled: float = 1e-6
    usable: float = 0.1
    simulation: SimulationSettings = field(
        default_factory=lambda: SimulationSettings(
            tolerance=Tolerance(relative=1e-8, absolute=1e-10),
            completion=ZenoExtrapolation(tolerance=1e-11),
            far=RUNAWAY,
        )
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Settling:
    """Where a simulation went.

    Attributes:
        cycle: Its last period, if it is fit for a guess.
        reason: Why there is none, as a clause; empty if there is one.
    """

    cycle: Cycle | None
    reason: str = ""


def settle(
    dynamics: HybridDynamics,
    starts: Sequence[Vector | tuple[float, ...]],
    settings: SettlingSettings | None = None,
    shape: OrbitShape | None = None,
) -> Settling:
    """Return the last period of the first start whose motion repeats.

    Args:
        dynamics: The system.
        starts: Initial states, tried in order.
        settings: How long to wait.
        shape: The shape of the period; by default whatever the motion settles to. If it settles to
            another one, the period of this shape on the way that came nearest to repeating.
    """
    settings = settings or SettlingSettings()
    wanted = None if shape is None else shape.at_restitution(dynamics.restitution)
    reasons: list[str] = []
    for start in starts:
        settling = _settle_from(dynamics, np.array(start, dtype=np.float64), settings, wanted)
        if settling.cycle is not None:
            return settling
        reasons.append(settling.reason)
    return Settling(cycle=None, reason=" / ".join(dict.fromkeys(reasons)))


def _settle_from(
    dynamics: HybridDynamics, state: Vector, settings: SettlingSettings, wanted: OrbitShape | None
) -> Settling:
    elapsed, fastest, at_release, patience = 0.0, 0.0, False, settings.chunk
    recurrence = Recurrence(settled=settings.settled, wanted=wanted)
    while elapsed < settings.horizon:
        try:
            run = _to_next_look(dynamics, state, settings, patience, at_release=at_release)
        except RunawayError as error:
            return Settling(cycle=None, reason=error.reason)
        except SimulationError as error:
            clause = error.reason[0].lower() + error.reason[1:]
            return Settling(cycle=None, reason=f"the simulation stops: {clause}")
        found = cycles(run, start=state if at_release else None)
        recurrence = recurrence.after(run, found, since=elapsed)
        elapsed += run.end_time
        if at_release and not run.releases:
            # Whoever comes back later than this is waited for the next time.
            patience *= 2
        speeds = [-cycle.impacts[0].approach_rate for cycle in found]
        fastest = max(fastest, *speeds, 0.0)
        settled = recurrence.settled_to()
        if settled is not None and wanted in (None, settled.shape):
            return _period(dynamics, settled, settings)
        if settled is not None:
            break
        if speeds and speeds[-1] < _FADED * fastest:
            return Settling(cycle=None, reason="the motion dies out")
        if not run.events and _is_at_rest(dynamics, run.end_state):
            return Settling(cycle=None, reason="the motion dies out")
        at_release = run.releases[-1:] != () and run.releases[-1].time == run.end_time
        state = run.releases[-1].state if at_release else run.end_state
        state = _repaired(dynamics, state, locked=run.arcs[-1].mode is Mode.LOCKED)
    nearest = recurrence.nearest(settings.usable)
    if nearest is not None:
        return _period(dynamics, nearest, settings)
    return Settling(cycle=None, reason=recurrence.reason(settings.horizon))


def _period(dynamics: HybridDynamics, found: Recurring, settings: SettlingSettings) -> Settling:
    """Return the period itself: made anew, unless it was followed from its start to its end."""
    if found.cycle is not None:
        return Settling(cycle=found.cycle)
    try:
        return Settling(
            cycle=cycle_of(
                dynamics,
                _repaired(dynamics, placed(dynamics, found.shape, found.start), locked=False),
                found.shape,
                horizon=2 * found.period,
                settings=settings.simulation,
            )
        )
    except SimulationError as error:
        return Settling(cycle=None, reason=error.reason[0].lower() + error.reason[1:])


def _to_next_look(
    dynamics: HybridDynamics,
    state: Vector,
    settings: SettlingSettings,
    patience: float,
    *,
    at_release: bool,
) -> Execution:
    """Return the execution to the next release, or over a chunk without any."""
    simulation = settings.simulation
    if at_release:
        return to_next_release(dynamics, state, horizon=patience, settings=simulation)
    return simulate(dynamics, state, until=settings.chunk, releases=1, settings=simulation)


def _repaired(dynamics: HybridDynamics, state: Vector, *, locked: bool) -> Vector:
    """Return the nearest state on what a loose integration drifts off: stop and constraints.

    On the constraints it is a Newton step of least length, its derivatives by differences.
    """
    state = dynamics.on_stop(state) if locked else state
    off = dynamics.holonomic(state)
    if off.size == 0:
        return state
    steps = _DIFFERENCE * np.eye(state.size)
    slopes = [(dynamics.holonomic(state + step) - off) / _DIFFERENCE for step in steps]
    return state - np.linalg.lstsq(np.array(slopes).T, off, rcond=None)[0]


def _is_at_rest(dynamics: HybridDynamics, state: Vector) -> bool:
    """Tell whether velocities and accelerations have all but vanished."""
    motion = dynamics.free.rate(state)[: 2 * dynamics.n_q]
    if dynamics.gap(state) <= _STILL:
        motion = dynamics.locked.rate(state)[: 2 * dynamics.n_q]
    return float(np.max(np.abs(motion))) < _STILL
