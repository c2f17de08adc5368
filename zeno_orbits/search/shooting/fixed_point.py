r"""Periods that repeat: a quasi-Newton method on the return map.

On its section the orbit is the root of :math:`P(y) - y` (theory (3.3), (3.6)). The derivative of
:math:`P` is estimated from the returns, by a rank-one update per return [Broyden1965]_: a return
costs a few times less than an exact derivative. If this iteration does not converge, for example on
an unstable orbit, the exact derivative is computed (theory (4.5)).
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
    EventSequence,
    Section,
    cycle_between,
    cycle_of,
    follow_each_other,
    kinds_of,
    phases_of,
    place_on_section,
    poincare_jacobian,
    rows_of,
    section_around,
)
from zeno_orbits.simulation import SimulationSettings, simulate

_REPEATS = 1e-12
"""Relative change of the release over a period that counts as zero."""
_STALLED = 1e-8
"""Largest change that rounding may leave in a stiff flow. A larger change is not an orbit."""
_OWN = 1e-6
"""The same, relative to the size of the period itself, since a decayed motion also repeats."""
_MOST_RETURNS = 16
_SHORTER = 4.0
"""Divisor of a step that did not reduce the residual although its derivative was exact."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeriodicCycle:
    """A period that repeats.

    Attributes:
        cycle: The period, simulated from its release.
        miss: Relative change of the release over the period.
        returns: Number of simulated returns, without the returns for an exact derivative.
    """

    cycle: Cycle
    miss: float
    returns: int


def newton_on_return_map(
    dynamics: HybridDynamics,
    release: Vector,
    *,
    scale: Vector,
    period: float,
    settings: SimulationSettings,
    slope: Vector | None = None,
    shape: EventSequence = ONE_ZENO,
) -> PeriodicCycle:
    r"""Return the period of a shape that repeats, near a given initial state.

    With :math:`r_k = P(y_k) - y_k`, the steps solve :math:`(1 - J) s_k = r_k`. After each step,
    :math:`J \leftarrow J + (r_{k+1} - r_k - (J - 1) s_k) s_k^\top / s_k^\top s_k`. If a step does
    not halve the residual, the next step starts from the better point with the exact derivative
    there (theory (4.5)). If that does not help either, the step is shortened.

    Args:
        dynamics: The system.
        release: A state near the orbit's start, mostly a release, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Approximate period of the orbit [s].
        settings: Engine and accuracy.
        slope: Derivative of the return map in the section around ``release``, if available.
        shape: The shape.

    Raises:
        SimulationError: If a motion does not return, no return repeats, or only an equilibrium
            repeats.
    """
    rows = rows_of(shape, dynamics.restitution)
    section = section_around(dynamics, rows, place_on_section(dynamics, shape, release), scale)
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
            # A given derivative is valid for the first point only.
            best, exact, share = trial, exact and best is None, 1.0
        elif best is not None:
            # Returns alone do not converge: the orbit is unstable or only weakly stable.
            if trial is not None and trial.change < best.change:
                best, exact, share = trial, False, 1.0
            if exact:
                share /= _SHORTER
            else:
                start = best.cycle.start.state
                j = poincare_jacobian(
                    dynamics, start, scale=scale, period=period, settings=settings, shape=shape
                )
                exact = True
        if best is not None:
            # Least squares, since the matrix is singular at a fold of a family.
            at = best.at + share * np.linalg.lstsq(one - j, best.miss, rcond=None)[0]
    raise SimulationError(
        "No return repeats. The last return differs by "
        f"{np.inf if best is None else best.change:.1e}",
        time=period,
        state=tuple(release.tolist()),
    )


def newton_from_cycle(
    dynamics: HybridDynamics, cycle: Cycle, settings: SimulationSettings
) -> PeriodicCycle:
    """Return the period of the same shape that repeats, near a period that repeats roughly.

    Args:
        dynamics: The system.
        cycle: A period near the orbit.
        settings: Engine and accuracy.

    Raises:
        SimulationError: If `newton_on_return_map` raises it.
    """
    return newton_on_return_map(
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
        miss: Coordinates of the return's end minus the coordinates of the point.
    """

    at: Vector
    cycle: Cycle
    miss: Vector

    @property
    def change(self) -> float:
        """Largest coordinate of the residual."""
        return float(np.max(np.abs(self.miss), initial=0.0))


def _sized(trial: _Trial, count: int) -> PeriodicCycle:
    """Return the closed cycle of a return that repeats, unless the return has shrunk to a point.

    Raises:
        SimulationError: If the return does not repeat in units of its own size.
    """
    cycle = trial.cycle
    if cycle.drift(cycle.scale_at_events()) > _OWN:
        raise SimulationError(
            "The motion that repeats shrinks to a point",
            time=cycle.period,
            state=tuple(cycle.start.state.tolist()),
        )
    return PeriodicCycle(cycle=cycle, miss=trial.change, returns=count)


def _tried(
    dynamics: HybridDynamics,
    section: Section,
    at: Vector,
    shape: EventSequence,
    period: float,
    settings: SimulationSettings,
    *,
    needed: bool,
) -> _Trial | None:
    """Simulate one return from section coordinates.

    If the motion does not return, the result is None, or with `needed` the error is raised.
    """
    start = place_on_section(dynamics, shape, section.state(dynamics, at))
    try:
        cycle = cycle_of(dynamics, start, shape, horizon=2 * period, settings=settings)
    except SimulationError:
        if needed:
            raise
        return None
    return _Trial(at=at, cycle=cycle, miss=section.coordinates(cycle.end.state) - at)


def _broyden(j: Vector, before: _Trial, after: _Trial) -> Vector:
    """Return the derivative after the rank-one update of a step."""
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
    shape: EventSequence = ONE_ZENO,
) -> Cycle:
    """Return the first period of a shape in the motion from a state near the start of a period.

    Args:
        dynamics: The system.
        x: A state on the stop, mostly at a release or near it, ``(n_x,)``.
        period: Approximate period [s].
        settings: Engine and accuracy.
        shape: The shape.

    Raises:
        SimulationError: If such a period does not begin within two periods.
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
