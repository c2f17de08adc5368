"""One arc of an execution: a flow followed to its guard, within limits of time, steps and reach."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import (
    Engine,
    FlowWithEvent,
    RungeKutta,
    Segment,
    SegmentResult,
    Termination,
    Tolerance,
    fast_dataclass,
)
from zeno_orbits.model import ContactProjection, HybridDynamics
from zeno_orbits.simulation.event_rules import ROUNDING, late_before
from zeno_orbits.simulation.events import Impact
from zeno_orbits.simulation.execution import Arc, Ending, Mode
from zeno_orbits.simulation.interruptions import (
    grows_without_end,
    leaves_set,
    runs_away,
    too_many_steps,
)
from zeno_orbits.simulation.small_hops import SmallHop

_FIRST_LOOK = 25_000
"""Steps before the first check of the pace of an execution. Regular motions take about 150 steps
per second."""
_BRIEF = 1e-3
"""Longest duration of a flight of which the tolerance depends on rounding, in the problem's own
time."""
_HOPPING = RungeKutta()
"""The integrator of a flight that is lower than the rounding of the gap: far shorter than anything
that its rates change over."""
_RISING, _RISE = 4, 1.5
"""Number of consecutive checks with a growth of speed by this factor. Such a growth excludes an
oscillation."""


@fast_dataclass
class ArcStart:
    """The start of the next arc.

    Attributes:
        mode: Its mode.
        time: Start time [s].
        state: Start state, ``(n_x,)``.
        speed: Exact gap rate of a start from the stop, which is the unit of a rescaled flight, or
            ``None`` for any other start.
        height: Scaled gap at the start of a rescaled flight: above zero within a flight.
        launch: Scaled gap rate there.
        impact: The impact at the start, if there is one.
        resting: The state projected onto the stop, after an impact.
        hop: A flight that is lower than the rounding of the gap. Its `speed` is only the unit of
            time.
    """

    mode: Mode
    time: float
    state: Vector
    speed: float | None = None
    height: float = 0.0
    launch: float = 1.0
    impact: Impact | None = None
    resting: ContactProjection | None = None
    hop: SmallHop | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """A look at how far an execution has come.

    Attributes:
        steps: Steps so far.
        time: Time so far [s].
        speed: Largest velocity since the look before.
    """

    steps: int
    time: float
    speed: float


class Pace(NamedTuple):
    """The steps of an execution so far, by which one that will not end is recognized.

    Attributes:
        n_steps: Number of steps.
        next_look: Number of steps at the next look.
        looks: Steps, time and largest velocity of the last looks.
        fastest: Largest velocity since the last look.
        which: Index of that velocity.
    """

    n_steps: int
    next_look: int
    looks: tuple[tuple[float, float, float], ...]
    fastest: float
    which: int


@dataclass(slots=True, kw_only=True)
class ArcFollower:
    """Follows the arcs of one execution and counts their steps.

    Attributes:
        dynamics: The system.
        engine: The integrator.
        tolerance: Its local error.
        until: When to stop [s].
        window: When the present arc stops at the latest [s].
        apart: Time by which two events differ at least [s].
        contact: Part of the problem's own sizes below which a guard counts as zero.
        far: A coordinate beyond this ends the execution with an error: one bound for all
            coordinates, or one for each.
        most_steps: Steps of all arcs before the execution is given up.
    """

    dynamics: HybridDynamics
    engine: Engine
    tolerance: Tolerance
    until: float
    contact: float
    far: float | tuple[float, ...]
    most_steps: int
    window: float = math.inf
    apart: float = 0.0
    _start: float = 0.0
    _unit: float = 1.0
    _n_steps: int = 0
    _next_look: int = _FIRST_LOOK
    _looks: list[_Look] = field(default_factory=list[_Look])
    _fastest: float = 0.0
    _which: int = 0
    _reach: Vector | None = None

    def __post_init__(self) -> None:
        """Give the bound of every coordinate, if there is one."""
        if np.min(self.far) < math.inf:
            far = np.asarray(self.far, dtype=np.float64)
            self._reach = np.broadcast_to(far, (self.dynamics.n_q,))

    @property
    def late(self) -> float:
        """Time before the end in which no event counts [s]."""
        return late_before(self.until, self.apart)

    @property
    def pace(self) -> Pace:
        """The steps so far."""
        looks = [(float(one.steps), one.time, one.speed) for one in self._looks[-_RISING:]]
        return Pace(self._n_steps, self._next_look, tuple(looks), self._fastest, self._which)

    @pace.setter
    def pace(self, pace: Pace) -> None:
        self._n_steps, self._next_look, looks, self._fastest, self._which = pace
        self._looks = [_Look(steps=int(n), time=time, speed=speed) for n, time, speed in looks]

    def _over_rounding(self, lift: float, speed: float) -> Tolerance:
        """Return the tolerance of a flight after an impact, not below what rounding permits.

        The rounding of the gap acceleration changes the scaled gap rate by its ratio to that
        acceleration. Steps with a smaller error would be many. Only a brief flight keeps its
        acceleration, and other states hardly change during it.

        Args:
            lift: Gap acceleration at the start of the flight.
            speed: Gap rate there.
        """
        size, tolerance = self.dynamics.own.gap_acceleration, self.tolerance
        if not 2.0 * speed <= _BRIEF * self.dynamics.own.time * abs(lift):
            return tolerance
        rounding = ROUNDING * size / max(abs(lift), self.contact * size)
        return replace(tolerance, absolute=rounding) if rounding > tolerance.relative else tolerance

    def follow(
        self,
        start: ArcStart,
        flow: FlowWithEvent,
        natural: Ending,
        *,
        impact_index: int,
        on_guard: bool,
    ) -> tuple[Arc, Vector]:
        """Follow a flow until its guard crosses zero downwards or the horizon is reached.

        Args:
            start: Start of the arc. With a speed the flight is rescaled.
            flow: The flow.
            natural: Kind of ending at a zero crossing of the guard.
            impact_index: Number of previous impacts.
            on_guard: Whether the start is a root of the guard that does not count.

        Returns:
            The arc, and the last state of the flow itself.

        Raises:
            SimulationError: If a limit is reached, or the state leaves the admissible set.
        """
        n_x, own = len(start.state), self.dynamics.own
        unit = 1.0 if start.speed is None else start.speed
        size = own.multiplier if start.mode is Mode.LOCKED else own.gap
        if start.speed is not None:
            size = 1 / own.gap_acceleration
        launch, tolerance, hop = start.launch, self.tolerance, start.hop
        height = start.height
        if hop is not None:
            height = hop.height
            launch, tolerance = hop.launch, replace(tolerance, absolute=hop.error)
        elif start.speed is not None and start.height > 0.0:
            lift = self.dynamics.gap_acceleration(start.state)
            tolerance = self._over_rounding(lift, start.speed)
        elif start.resting is not None and start.speed is not None:
            tolerance = self._over_rounding(start.resting.gap_acceleration, start.speed)
        limit = min(self.until, self.window)
        leg = Segment(
            flow=flow,
            y=start.state if start.speed is None else launched(start.state, launch, height),
            horizon=(limit - start.time) / unit,
            tolerance=tolerance,
            on_guard=on_guard,
            rounding=0.0 if hop else self.contact * size,
            late=self.late / unit if limit == self.until else 0.0,
            watch=self._watch,
            reach=self._reach,
            is_low=hop is not None,
        )
        self._start, self._unit = start.time, unit
        passage = (_HOPPING if hop else self.engine).follow(leg)
        time = start.time + unit * passage.duration
        if passage.outcome is Termination.LEFT:
            raise leaves_set(time, passage.state[:n_x])
        over = passage.outcome is Termination.HORIZON
        arc = Arc(
            mode=start.mode,
            start_time=start.time,
            end_time=limit if over else time,
            start_state=start.state,
            end_state=passage.state[:n_x],
            ending=Ending.HORIZON if over else natural,
            impact_index=impact_index,
            time_unit=unit,
            trajectory=passage.trajectory,
        )
        return arc, passage.state

    def beside(
        self,
        flow: FlowWithEvent,
        y: Vector,
        *,
        horizon: float,
        late: float,
        on_guard: bool,
        rounding: float,
    ) -> SegmentResult:
        """Follow another guard along an arc that has been followed.

        Args:
            flow: The flow of the arc, with the other guard.
            y: State of the flow at the start, ``(n_y,)``.
            horizon: Duration of the arc, in the flow's own time.
            late: Part of it at its end in which a zero of the guard does not count.
            on_guard: Whether the start is a root of the guard that does not count.
            rounding: Rounding level of the guard.
        """
        leg = Segment(
            flow=flow,
            y=y,
            horizon=horizon,
            tolerance=self.tolerance,
            on_guard=on_guard,
            rounding=rounding,
            late=late,
        )
        return self.engine.follow(leg)

    def _watch(self, steps: int, offset: float, y: Vector) -> None:
        """End a leg that takes too long or goes too far."""
        self._n_steps += steps
        n_q = self.dynamics.n_q
        rates = np.abs(y[n_q : 2 * n_q])
        # A velocity that is no longer a number counts as largest.
        if not rates.max() <= self._fastest:
            self._fastest, self._which = float(rates.max()), int(np.argmax(rates))
        if self._n_steps >= self._next_look:
            self._look(self._start + self._unit * offset, y)
        if self._n_steps > self.most_steps:
            raise too_many_steps(self.most_steps, self._start + self._unit * offset, y)
        if self._reach is None:
            return
        parts = np.abs(y[:n_q]) / self._reach
        if float(parts.max()) > 1.0:
            name = self.dynamics.state_names[int(np.argmax(parts))]
            raise runs_away(name, self._start + self._unit * offset, y)

    def _look(self, time: float, y: Vector) -> None:
        """End a motion that accelerates so much that its steps will not last to the horizon.

        A check occurs at every doubling of the steps. Growing speeds at successive checks, and the
        pace since the last check, predict the result of all steps from a tenth of them. The speed
        is the largest since the check before: of an oscillation, a single value shows its phase.
        """
        self._next_look *= 2
        self._looks.append(_Look(steps=self._n_steps, time=time, speed=self._fastest))
        self._fastest = 0.0
        last = self._looks[-_RISING:]
        if len(last) < _RISING or any(b.speed < _RISE * a.speed for a, b in pairwise(last)):
            return
        before = last[-2]
        steps, passed = self._n_steps - before.steps, time - before.time
        needed = (self.until - time) * steps / passed if passed > 0.0 else math.inf
        if self._n_steps + needed > self.most_steps:
            name = self.dynamics.state_names[self.dynamics.n_q + self._which]
            raise grows_without_end(name, steps, needed, time, y)


def launched(x: Vector, rate: float, height: float = 0.0) -> Vector:
    """Return the state of a rescaled flight at its start, ``(x, height, rate)``.

    Args:
        x: The state, ``(n_x,)``.
        rate: The scaled gap rate, 1 on the stop.
        height: The scaled gap, 0 on the stop.
    """
    return np.concatenate([x, (height, rate)])
