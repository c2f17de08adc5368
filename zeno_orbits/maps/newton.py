r"""Newton's step to a periodic orbit on its section, from one return and its exact derivative.

A motion over a period determines the return map :math:`P`, and the derivatives of its events
determine :math:`P'` (theory (4.2)), and therefore the fixed point to second order and the
multipliers (theory (3.3)).
The section contains the releases. If an orbit does not have a Zeno point and hence a release, it
contains the states just after an impact (theory (5.9)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues
from zeno_orbits.errors import SimulationError
from zeno_orbits.maps.crossings import Follower, Released, Struck, crossings_of
from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits import (
    IMPACT_ROWS,
    RELEASE_ROWS,
    Section,
    differentials_of,
    projected,
    section_around,
)
from zeno_orbits.simulation import (
    Event,
    Execution,
    Impact,
    Perturbations,
    Release,
    ZenoPoint,
    event_shifts,
    transient_settings,
)

_OFF = 3e-7
"""Largest distance of a state from its section, in scaled states."""

SAME = 1e-8
"""Two releases are the same if they differ by less than this part of the period or the time limit.

Rounding has then put the start in contact.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeriodReturn:
    """A return over a period: its end, its duration and its margins.

    Attributes:
        state: State at the end, ``(n_x,)``.
        numbers: Period, then the margins of a certificate in order, ``(n,)``.
    """

    state: Vector
    numbers: Vector


@dataclass(frozen=True, kw_only=True)
class FixedPoint:
    """Newton's step towards a fixed point of the return map.

    Attributes:
        distance: Length of the step in section coordinates. The remaining error is about its
            square.
        jacobian: Derivative of the return map, ``(m, m)``.
        state: The fixed point, ``(n_x,)``.
        cycle: Function that returns the period from the fixed point.
    """

    distance: float
    jacobian: Vector
    state: Vector
    cycle: Callable[[], PeriodReturn]

    @cached_property
    def numbers(self) -> Vector:
        """Period and margins at the fixed point. They need the derivative of the motion."""
        return self.cycle().numbers

    @cached_property
    def multipliers(self) -> tuple[complex, ...]:
        """Eigenvalues of the derivative, the largest first."""
        return eigenvalues(self.jacobian)

    @cached_property
    def spectral_radius(self) -> float:
        """Largest modulus of a multiplier."""
        return max((abs(value) for value in self.multipliers), default=0.0)


def chart_at(dynamics: HybridDynamics, rows: tuple[int, ...], x: Vector, scale: Vector) -> Section:
    """Return a chart of a section around a state.

    The state may be off its section by the drift of the flow from the stop. If this distance is not
    small, the centre of the chart is the projected state.

    Args:
        dynamics: The system.
        rows: Rows of the contact that vanish on the section.
        x: The state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.

    Raises:
        SimulationError: If a section does not exist near the state.
    """
    x = x if rows == RELEASE_ROWS else projected(dynamics, rows, x, scale)
    section = section_around(dynamics, rows, x, scale)
    centre = section.state(dynamics, np.zeros(section.dimension))
    if not np.max(np.abs(centre - x) / scale) < _OFF:
        return replace(section, centre=centre)
    return section


def _of_releases(dynamics: HybridDynamics, events: Sequence[Released]) -> PeriodReturn:
    """Return the period and the smallest margins over the releases of one period."""
    margins = np.array(
        [
            (
                math.nan
                if event.zeno_state is None
                else -dynamics.gap_acceleration(event.zeno_state),
                -event.struck,
                -dynamics.multiplier_rate(event.state),
                event.time - event.zeno_time,
            )
            for event in events
        ]
    )
    numbers = np.append(events[-1].time, margins.min(axis=0))
    return PeriodReturn(state=events[-1].state, numbers=numbers)


def _of_impacts(_: HybridDynamics, events: Sequence[Struck]) -> PeriodReturn:
    """Return the period and the slowest impact over the impacts of one period."""
    slowest = min(-event.rate for event in events)
    return PeriodReturn(state=events[-1].state, numbers=np.array([events[-1].time, slowest]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """The events at which motions cross a section.

    Attributes:
        event: Kind of the events.
        rows: Rows of the contact that vanish on the section.
        margins: Names of the margins, as in a certificate.
        cycle: Function of the system and the events of one period, with times from its start. It
            returns the end, the period and the margins.
        far: Largest relative distance of the orbit from the motion in a Newton step.
    """

    event: type[Released | Struck]
    rows: tuple[int, ...]
    margins: tuple[str, ...]
    cycle: Callable[[HybridDynamics, Sequence[Any]], PeriodReturn]
    far: float


RELEASES = Crossing(
    event=Released,
    rows=RELEASE_ROWS,
    margins=("gap_acceleration", "first_impact_speed", "release_transversality", "locked_time"),
    cycle=_of_releases,
    far=0.8,
)
IMPACTS = Crossing(
    event=Struck,
    rows=IMPACT_ROWS,
    margins=("first_impact_speed",),
    cycle=_of_impacts,
    far=0.02,
)


@dataclass(frozen=True, kw_only=True)
class PeriodRun:
    """A motion over a period from a state of the section.

    Attributes:
        dynamics: The system.
        crossing: The events that define the section.
        state: The initial state, ``(n_x,)``.
        execution: The motion. It may extend beyond the period.
        returns: The returns of the period, in order.
        error: Relative local error of a step.
    """

    dynamics: HybridDynamics
    crossing: Crossing
    state: Vector
    execution: Execution
    returns: Sequence[Released | Struck]
    error: float

    @cached_property
    def _shifts(self) -> Vector:
        """Derivatives of the events, ``(n, 2, 2 + n_x, n_x)``."""
        perturbations = Perturbations(
            dynamics=self.dynamics,
            differentials=differentials_of(self.dynamics, ()),
            n_parameters=0,
            tolerance=transient_settings(self.error).tolerance,
        )
        execution, first = self.execution, 0
        start = perturbations.at_start()
        if self.crossing is IMPACTS:
            start = perturbations.launched(self.state)
        elif execution.events[0].time < SAME * self.returns[-1].time:
            # The free flow carries a perturbation of a start that rounding has put in contact.
            first = 1
        return event_shifts(perturbations, execution, start, first=first)

    def by_state(self, n: int) -> Vector:
        """Return the derivative of a return by the initial state, ``(n_x, n_x)``.

        Args:
            n: Number of the return, from 1.

        Raises:
            SimulationError: If the stop is touched without an impact before.
        """
        time = self.returns[n - 1].time
        place = [event.time for event in self.execution.events].index(time)
        found = self._shifts[place, 1, 2:]
        if not np.all(np.isfinite(found)):
            raise SimulationError(
                "The derivative of the return is undefined",
                time=time,
                state=tuple(self.state.tolist()),
            )
        return found

    def cycle(self, n: int, step: Vector) -> PeriodReturn:
        """Return the first returns as a period of the motion from a neighbouring state.

        Args:
            n: Number of returns.
            step: Difference of the neighbouring state, ``(n_x,)``. The period and the events change
                to first order.
        """
        returns = self.returns[:n]
        if not np.any(step):
            return self.crossing.cycle(self.dynamics, returns)
        end, pairs = returns[-1].time, zip(self.execution.events, self._shifts @ step, strict=True)
        events = [_moved(event, *moves) for event, moves in pairs if event.time <= end]
        moved = crossings_of(self.dynamics, events, self.state, strikes=self.crossing is IMPACTS)
        kept = [one for one in moved if isinstance(one, self.crossing.event)][-n:]
        return self.crossing.cycle(self.dynamics, kept)


def _moved(event: Impact | ZenoPoint | Release, before: Vector, after: Vector) -> Event:
    """Return an event of the motion from a neighbouring state.

    Args:
        event: The event.
        before: Change of its time, its gap rate and its state before it, ``(2 + n_x,)``.
        after: The same after it.
    """
    time = event.time + float(after[0])
    if isinstance(event, Impact):
        return Impact(
            time=time,
            state_minus=event.state_minus + before[2:],
            state_plus=event.state_plus + after[2:],
            approach_rate=event.approach_rate + float(before[1]),
        )
    return replace(event, time=time, state=event.state + after[2:])


def period_run(
    follower: Follower, crossing: Crossing, state: Vector, count: int, *, span: float, error: float
) -> PeriodRun | None:
    """Return the motion over a period, or ``None`` if it returns fewer times in twice a span.

    Args:
        follower: Simulator of the motions.
        crossing: The events that define the section.
        state: Initial state, ``(n_x,)``.
        count: Number of returns per period.
        span: Approximate time of a period [s].
        error: Relative local error of a step.
    """
    releases = crossing is RELEASES
    follow = partial(follower.executed, state, until=2 * span, error=error)
    for more in (0, 1) if releases else (0,):
        execution = follow(releases=count + more if releases else None)
        if execution is None:
            return None
        found = crossings_of(follower.dynamics, execution.events, state, strikes=not releases)
        returns = [
            one for one in found if isinstance(one, crossing.event) and one.time > SAME * span
        ]
        if len(returns) >= count:
            return PeriodRun(
                dynamics=follower.dynamics,
                crossing=crossing,
                state=state,
                execution=execution,
                returns=returns[:count],
                error=error,
            )
        if len(returns) < count - 1:
            return None
        # Rounding has put the start in contact, which adds an immediate release.
    return None


def newton_step(section: Section, run: PeriodRun, n: int, jacobian: Vector | None) -> FixedPoint:
    """Return Newton's step from the centre of a section.

    Args:
        section: The chart around the state that returned.
        run: The motion from this state.
        n: Number of returns per period.
        jacobian: Derivative of the return map in this chart, or ``None`` to compute it.

    Raises:
        SimulationError: If the derivative is undefined, or the section ends before the fixed point.
        LinAlgError: If a multiplier is one.
    """
    image = section.coordinates(run.returns[n - 1].state)
    if jacobian is None and section.dimension == 0:
        jacobian = np.zeros((0, 0))
    elif jacobian is None:
        jacobian = section.components(run.by_state(n) @ section.lift)
    solved = np.linalg.solve(np.eye(section.dimension) - jacobian, image)
    z = np.asarray(solved, dtype=np.float64)
    return FixedPoint(
        distance=float(np.max(np.abs(z), initial=0.0)),
        jacobian=jacobian,
        state=section.state(run.dynamics, z),
        cycle=partial(run.cycle, n, section.lift @ z),
    )
