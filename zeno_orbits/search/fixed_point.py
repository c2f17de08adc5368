r"""Periods that repeat: Newton's method on the return map, its slope told by the returns.

On its section the orbit is the root of :math:`P(y) - y` (theory (18), (45)). The slope of
:math:`P` is taken from the returns themselves, a rank-one correction each [Broyden1965]_: a return
costs a few times less than an exact slope. Where that does not converge, as on an orbit that
repels, the exact slope is taken (theory (27)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits import (
    ONE_ZENO,
    Cycle,
    OrbitShape,
    Section,
    cycle_between,
    cycle_of,
    follow_each_other,
    kinds_of,
    phases_of,
    placed,
    return_slope,
    rows_of,
    section_around,
)
from zeno_orbits.simulation import SimulationSettings, simulate

_REPEATS = 1e-12
"""Change of the release over a period that counts as none, relative."""
_STALLED = 1e-8
"""Change that rounding may leave where the flow is stiff; more than this is no orbit."""
_OWN = 1e-6
"""The same, relative to the size of the period itself: a motion that dies out repeats, too."""
_MOST_RETURNS = 16
_SHORTER = 4.0
"""Divisor of a step that did not help although its slope was exact."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosedCycle:
    """A period that repeats.

    Attributes:
        cycle: The period, simulated from its release.
        miss: Change of the release over it, relative.
        returns: Returns that it took, those for a slope not counted.
    """

    cycle: Cycle
    miss: float
    returns: int


def close_cycle(
    dynamics: HybridDynamics,
    release: Vector,
    *,
    scale: Vector,
    period: float,
    settings: SimulationSettings,
    slope: Vector | None = None,
    shape: OrbitShape = ONE_ZENO,
) -> ClosedCycle:
    r"""Return the period of a shape that repeats, near a state where one starts.

    With :math:`r_k = P(y_k) - y_k`, steps :math:`(1 - J) s_k = r_k`, and after each
    :math:`J \leftarrow J + (r_{k+1} - r_k - (J - 1) s_k) s_k^\top / s_k^\top s_k`. Where a step
    does not halve the residual, the next one starts from the better point with the exact slope
    there (theory (27)), and is shortened if that does not help.

    Args:
        dynamics: The system.
        release: A state near the orbit's start, mostly a release, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Of the orbit, roughly [s].
        settings: Engine and accuracy.
        slope: Derivative of the return map in the section around ``release``, if it is known.
        shape: The shape.

    Raises:
        SimulationError: If a start does not return, no return repeats, or only rest does.
    """
    rows = rows_of(shape, dynamics.restitution)
    section = section_around(dynamics, rows, placed(dynamics, shape, release), scale)
    one, at = np.eye(section.dimension), np.zeros(section.dimension)
    j = np.zeros_like(one) if slope is None else slope
    best: _Trial | None = None
    exact, share = slope is not None, 1.0
    for count in range(1, _MOST_RETURNS + 1):
        trial = _tried(dynamics, section, at, shape, period, settings, needed=best is None)
        if trial is not None and trial.change <= _REPEATS:
            return _sized(trial, count)
        if trial is not None and best is not None:
            if trial.change <= _STALLED and trial.change >= best.change:
                return _sized(best, count)
            j = _broyden(j, best, trial)
        if trial is not None and (best is None or trial.change < best.change / 2):
            # A slope that was known beforehand counts for the first point only.
            best, exact, share = trial, exact and best is None, 1.0
        elif best is not None:
            # Returns alone do not close in: the orbit repels, or attracts hardly.
            if trial is not None and trial.change < best.change:
                best, exact, share = trial, False, 1.0
            if exact:
                share /= _SHORTER
            else:
                start = best.cycle.start.state
                j = return_slope(
                    dynamics, start, scale=scale, period=period, settings=settings, shape=shape
                )
                exact = True
        if best is not None:
            # Least squares: at a fold of a family the matrix is singular, and that is no crash.
            at = best.at + share * np.linalg.lstsq(one - j, best.miss, rcond=None)[0]
    raise SimulationError(
        f"No return repeats; the last one differs by {np.inf if best is None else best.change:.1e}",
        time=period,
        state=tuple(release.tolist()),
    )


def close_near(dynamics: HybridDynamics, cycle: Cycle, settings: SimulationSettings) -> ClosedCycle:
    """Return the period of the same shape that repeats, near one that hardly does.

    Args:
        dynamics: The system.
        cycle: A period near the orbit.
        settings: Engine and accuracy.

    Raises:
        SimulationError: As `close_cycle`.
    """
    return close_cycle(
        dynamics,
        cycle.start.state,
        scale=cycle.scale_at_events(),
        period=cycle.period,
        settings=settings,
        shape=cycle.shape,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Trial:
    """A return from a point of the section.

    Attributes:
        at: Coordinates of the point.
        cycle: The return.
        miss: Coordinates of its end minus those of the point.
    """

    at: Vector
    cycle: Cycle
    miss: Vector

    @property
    def change(self) -> float:
        """Distance of the return from repeating."""
        return float(np.max(np.abs(self.miss), initial=0.0))


def _sized(trial: _Trial, count: int) -> ClosedCycle:
    """Return a return that repeats, unless only its size has gone to zero.

    Raises:
        SimulationError: If it does not repeat in units of its own size.
    """
    cycle = trial.cycle
    if cycle.drift(cycle.scale_at_events()) > _OWN:
        raise SimulationError(
            "The motion that repeats shrinks to a point",
            time=cycle.period,
            state=tuple(cycle.start.state.tolist()),
        )
    return ClosedCycle(cycle=cycle, miss=trial.change, returns=count)


def _tried(
    dynamics: HybridDynamics,
    section: Section,
    at: Vector,
    shape: OrbitShape,
    period: float,
    settings: SimulationSettings,
    *,
    needed: bool,
) -> _Trial | None:
    """Simulate one return from section coordinates.

    Returns None if the motion does not come back; raises if `needed`.
    """
    start = placed(dynamics, shape, section.state(dynamics, at))
    try:
        cycle = cycle_of(dynamics, start, shape, horizon=2 * period, settings=settings)
    except SimulationError:
        if needed:
            raise
        return None
    return _Trial(at=at, cycle=cycle, miss=section.coordinates(cycle.end.state) - at)


def _broyden(j: Vector, before: _Trial, after: _Trial) -> Vector:
    """Return the slope after a step that has told more of it."""
    step = after.at - before.at
    length = float(step @ step)
    if length == 0.0:
        return j
    told = after.miss - before.miss + step
    return j + np.outer(told - j @ step, step) / length


def cycle_near(
    dynamics: HybridDynamics,
    x: Vector,
    *,
    period: float,
    settings: SimulationSettings,
    shape: OrbitShape = ONE_ZENO,
) -> Cycle:
    """Return the first period of a shape of the motion from a state near the start of one.

    Args:
        dynamics: The system.
        x: A state on the stop, mostly near a release or at one, ``(n_x,)``.
        period: Roughly [s].
        settings: Engine and accuracy.
        shape: The shape.

    Raises:
        SimulationError: If there is none within two periods.
    """
    wanted = shape.at_restitution(dynamics.restitution)
    run = simulate(dynamics, x, until=2 * period, settings=settings)
    phases = phases_of(run, x, held=wanted.starts_at_release)
    for k in range(len(phases)):
        some = phases[k : k + wanted.n_phases]
        if kinds_of(some) == wanted.phases and follow_each_other(some):
            return cycle_between(run, some)
    what = "No Zeno point with a later release is reached"
    if not wanted.has_one_release:
        what = f"No period of shape `{wanted.text}` follows"
    raise SimulationError(what, time=2 * period, state=tuple(x.tolist()))
