"""Completed executions, event by event: flights, impacts, Zeno point, locked arc, release, again.

A flight after an impact is integrated in the scaled variables of theory (14), so none is missed
and none invented however slow the impact was. Source: [OrAmes2011]_ for the completion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import (
    ChatterError,
    InputError,
    PenetrationError,
    RunawayError,
    SimulationError,
)
from zeno_orbits.integrators import Automatic, Engine, Leg, Outcome, Trajectory
from zeno_orbits.integrators.engine import Watch
from zeno_orbits.integrators.events import SteppedTrajectory
from zeno_orbits.integrators.flow import GuardedFlow, Tolerance
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.simulation.completion import Completion, ZenoPassage
from zeno_orbits.simulation.execution import (
    Arc,
    Ending,
    Event,
    Execution,
    Impact,
    Mode,
    Release,
    ZenoPoint,
)
from zeno_orbits.simulation.zeno_limit import TailEstimate, ZenoLimit, estimate_tail
from zeno_orbits.work.progress import Progress, silent


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationSettings:
    """How accurately to simulate.

    Attributes:
        engine: The integrator.
        tolerance: Its local error.
        completion: How a Zeno point is reached.
        contact: A gap or gap rate below this counts as zero.
        far: A coordinate beyond this ends the execution with an error.
        most_impacts: Impacts in one sequence before it is given up.
        most_steps: Steps of all arcs before the execution is given up; each is kept for dense
            output, at about 400 bytes.
    """

    engine: Engine = field(default_factory=Automatic)
    tolerance: Tolerance = field(default_factory=Tolerance)
    completion: Completion = field(default_factory=ZenoPassage)
    contact: float = 1e-12
    far: float = math.inf
    most_impacts: int = 100_000
    most_steps: int = 2_000_000


def simulate(
    dynamics: HybridDynamics,
    state: Sequence[float] | Vector,
    *,
    until: float,
    releases: int | None = None,
    impacts: int | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> Execution:
    """Return the completed execution from an admissible state, locked or free.

    Args:
        dynamics: The system at fixed numbers.
        state: Initial state, ``(n_x,)``, at time 0.
        until: When to stop [s].
        releases: Stop earlier, at this many releases; never by default.
        impacts: Stop earlier, just after this many impacts that end flights; likewise.
        settings: Accuracy; the defaults aim at 1e-11 a period.
        on_progress: Called with the part of the time that is simulated.

    Raises:
        InputError: If the state is not admissible or the horizon is not a positive number.
        SimulationError: If the execution cannot be continued; it says where and why.
    """
    if not (math.isfinite(until) and until > 0.0):
        raise InputError(
            f"Argument `until` must be a positive number of seconds, but it is {until}."
        )
    most = _Most(
        releases=math.inf if releases is None else releases,
        impacts=math.inf if impacts is None else impacts,
    )
    run = _Run(dynamics, settings or SimulationSettings(), until, most, on_progress)
    run.follow(run.admit(np.array(state, dtype=np.float64)))
    return Execution(
        state_names=dynamics.state_names, arcs=tuple(run.arcs), events=tuple(run.events)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Start:
    """Where the next arc starts.

    Attributes:
        mode: Its mode.
        time: When [s].
        state: Where, ``(n_x,)``.
        speed: Gap rate of a start from the stop, exactly; ``None`` for any other start.
        impact: The impact that it comes from, if any.
    """

    mode: Mode
    time: float
    state: Vector
    speed: float | None = None
    impact: Impact | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Most:
    """Events at which an execution ends."""

    releases: float
    impacts: float


_FIRST_LOOK = 25_000
"""Steps before the first look at the pace of an execution; good motions take some 150 a second."""

_ROUNDING = 4 * 2.0**-52
"""Of the largest coordinate: what the gap may be off by."""

_RISING, _RISE = 4, 1.5
"""Looks in a row between which a speed grows by this factor or more: that is no oscillation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """How far an execution has come.

    Attributes:
        steps: Steps so far.
        time: When [s].
        speed: Largest velocity.
    """

    steps: int
    time: float
    speed: float


class _Run:
    """One execution in the making."""

    def __init__(
        self,
        dynamics: HybridDynamics,
        settings: SimulationSettings,
        until: float,
        most: _Most,
        on_progress: Progress,
    ) -> None:
        self.dynamics = dynamics
        self.settings = settings
        self.engine = settings.engine
        self.until = until
        self.most = most
        self.on_progress = on_progress
        self.arcs: list[Arc] = []
        self.events: list[Event] = []
        self.n_impacts = 0
        self.n_steps = 0
        self.looks: list[_Look] = []
        self.n_releases = 0

    def follow(self, start: _Start | None) -> None:
        """Follow the execution from an admitted start to its end."""
        here = start
        while here is not None:
            if here.mode is Mode.LOCKED:
                here = self.carry(here)
            elif here.speed is None:
                here = self.fly(here)
            else:
                here = self.bounce(here)
            reached = self.arcs[-1].end_time if self.arcs else 0.0
            self.on_progress("simulating", reached / self.until)

    def admit(self, x: Vector) -> _Start | None:
        """Return the first start, or say why the state is not admissible."""
        dynamics, small = self.dynamics, self.settings.contact
        names = dynamics.state_names
        if x.shape != (len(names),):
            message = (
                f"Argument `state` must have {len(names)} entries, but its shape is {x.shape}."
            )
            raise InputError(message)
        if not np.all(np.isfinite(x)):
            raise InputError("Argument `state` must be finite, but it holds NaN or infinity.")
        off = dynamics.holonomic(x)
        if off.size and float(np.max(np.abs(off))) > 1e-9:
            message = "Argument `state` must keep the holonomic constraints, but it is off by"
            raise InputError(f"{message} {float(np.max(np.abs(off))):.3g}.")
        gap, rate = dynamics.gap(x), dynamics.gap_rate(x)
        if gap < -small:
            raise InputError(f"Argument `state` must have a gap >= 0, but it is {gap:.6g}.")
        if gap > small:
            return _Start(mode=Mode.FREE, time=0.0, state=x)
        if rate > small:
            return _Start(mode=Mode.FREE, time=0.0, state=x, speed=rate)
        if rate < -small:
            return self.hit(0.0, x, rate)
        return self.rest(0.0, dynamics.on_stop(x))

    def rest(self, time: float, x: Vector) -> _Start:
        """Return the mode that holds on the stop at zero gap rate: locked, or released at once."""
        holds = -self.dynamics.gap_acceleration(x)
        if self._slack(x):
            holds = self.dynamics.multiplier_rate(x)
        return _Start(mode=Mode.LOCKED if holds > 0.0 else Mode.FREE, time=time, state=x)

    def _slack(self, x: Vector) -> bool:
        """Tell whether the stop neither holds nor repels, to rounding.

        With ``a = d2h/dt2 > 0`` that falls at the rate ``b`` the gap would open to
        ``2 a^3 / (3 b^2)`` and close again: no flight, where that is lost in the gap's rounding.
        """
        lift = self.dynamics.gap_acceleration(x)
        if abs(lift) <= self.settings.contact:
            return True
        if not lift > 0.0:
            return False
        fall = self.dynamics.multiplier_rate(x) / self.dynamics.normal_inertia(x)
        lost = _ROUNDING * float(np.max(np.abs(x[: self.dynamics.n_q])))
        return fall > 0.0 and 2.0 * lift**3 <= 3.0 * lost * fall**2

    def carry(self, start: _Start) -> _Start | None:
        """Follow the locked flow to the release."""
        slack = self._slack(start.state)
        arc, _ = self._arc(start, self.dynamics.locked, Ending.RELEASE, on_guard=slack)
        if arc.ending is Ending.HORIZON:
            return None
        state = self.dynamics.on_stop(arc.end_state)
        self.events.append(Release(time=arc.end_time, state=state))
        self.n_releases += 1
        if self.n_releases >= self.most.releases:
            return None
        return _Start(mode=Mode.FREE, time=arc.end_time, state=state)

    def fly(self, start: _Start) -> _Start | None:
        """Follow the free flow to an impact, not coming from one."""
        released = self.dynamics.gap(start.state) <= self.settings.contact
        arc, _ = self._arc(start, self.dynamics.free, Ending.IMPACT, on_guard=released)
        if arc.ending is Ending.HORIZON:
            return None
        rate = self.dynamics.gap_rate(arc.end_state)
        if abs(rate) <= self.settings.contact:
            # The gap closes no faster than rounding: the stop is touched, not struck.
            return self.rest(arc.end_time, self.dynamics.on_stop(arc.end_state))
        return self.hit(arc.end_time, arc.end_state, rate)

    def bounce(self, start: _Start) -> _Start | None:
        """Follow a sequence of impacts to its Zeno point, or until it turns into a free flight."""
        estimates: list[TailEstimate] = []
        first = self.n_impacts
        here: _Start | None = start
        while here is not None and here.speed is not None:
            zeno = self._zeno_point(here, here.speed, estimates)
            if zeno is not None:
                return zeno
            if self.n_impacts - first > self.settings.most_impacts:
                raise ChatterError(
                    f"More than {self.settings.most_impacts} impacts came without a Zeno point",
                    time=here.time,
                    state=tuple(here.state.tolist()),
                )
            here = self._hop(here, here.speed)
        return here

    def hit(self, time: float, state_minus: Vector, approach_rate: float) -> _Start | None:
        """Apply the reset map and return what follows it, if anything is to."""
        dynamics = self.dynamics
        if not approach_rate < 0.0:
            raise SimulationError(
                f"An impact must close the gap, but the gap rate is {approach_rate:.3g}",
                time=time,
                state=tuple(state_minus.tolist()),
            )
        state_plus = dynamics.reset_map(state_minus, approach_rate)
        speed = dynamics.speed_after(approach_rate)
        if dynamics.gap_rate(state_plus) < -1e-9 * (1.0 - approach_rate):
            raise PenetrationError(
                "The reset map sends the state into the stop",
                time=time,
                state=tuple(state_minus.tolist()),
            )
        impact = Impact(
            time=time,
            state_minus=state_minus,
            state_plus=state_plus,
            approach_rate=approach_rate,
        )
        self.events.append(impact)
        self.n_impacts += 1
        if self.arcs and self.n_impacts >= self.most.impacts:
            return None
        if speed <= self.settings.contact:
            state = dynamics.on_stop(state_plus)
            after = self.rest(time, state)
            if after.mode is Mode.FREE:
                # The stop lets go: whatever is left of the speed, the flight is the free flow's.
                return after
            if speed == 0.0:
                self._reach(ZenoLimit(time=time, state=state, error=0.0), impact, 0.0)
                return after
        return _Start(mode=Mode.FREE, time=time, state=state_plus, speed=speed, impact=impact)

    def _hop(self, start: _Start, speed: float) -> _Start | None:
        """Follow one rescaled flight from an impact to the next (theory (14))."""
        flight = self.dynamics.flight(speed)
        arc, end = self._arc(start, flight, Ending.IMPACT, on_guard=True)
        if arc.ending is Ending.HORIZON:
            return None
        return self.hit(arc.end_time, arc.end_state, speed * float(end[-1]))

    def _zeno_point(
        self, start: _Start, speed: float, estimates: list[TailEstimate]
    ) -> _Start | None:
        """Return the start of the locked arc if the impacts so far tell the Zeno point."""
        if start.impact is None:
            return None
        if estimates and speed >= estimates[-1].speed:
            estimates.clear()
        estimate = estimate_tail(self.dynamics, start.time, start.state, speed)
        if estimate is None:
            estimates.clear()
            return None
        estimates.append(estimate)
        limit = self.settings.completion.limit(self.dynamics, estimates)
        if limit is None or limit.time >= self.until:
            return None
        after = self.rest(limit.time, limit.state)
        if after.mode is Mode.FREE:
            return None
        self._reach(limit, start.impact, speed)
        return after

    def _reach(self, limit: ZenoLimit, last: Impact, last_speed: float) -> None:
        """Record a Zeno point, and the tail that leads to it as an arc without steps."""
        self.events.append(
            ZenoPoint(
                time=limit.time,
                state=limit.state,
                limit_error=limit.error,
                tail=limit.time - last.time,
                last_speed=last_speed,
            )
        )
        if limit.time > last.time:
            self.arcs.append(
                Arc(
                    mode=Mode.FREE,
                    start_time=last.time,
                    end_time=limit.time,
                    start_state=self.dynamics.on_stop(last.state_plus),
                    end_state=limit.state,
                    ending=Ending.ZENO,
                    impact_index=self.n_impacts,
                    time_unit=1.0,
                    trajectory=self._tail_of(limit, last.time),
                )
            )

    @staticmethod
    def _tail_of(limit: ZenoLimit, start: float) -> Trajectory | None:
        """Return the way to a limit if it was followed, along the curve of the impacts."""
        if not limit.path:
            return None
        return SteppedTrajectory(steps=limit.path, duration=limit.time - start, end=limit.state)

    def _watch(self, unit: float, start: float) -> Watch:
        """Return what ends a leg that takes too long or goes too far."""
        settings, n_q = self.settings, self.dynamics.n_q

        def watch(steps: int, offset: float, y: Vector) -> None:
            self.n_steps += steps
            if self.n_steps >= _FIRST_LOOK * 2 ** len(self.looks):
                self._look(start + unit * offset, y)
            if self.n_steps > settings.most_steps:
                raise SimulationError(
                    f"The execution takes more than {settings.most_steps} steps",
                    time=start + unit * offset,
                    state=tuple(y.tolist()),
                )
            if settings.far < math.inf and float(np.abs(y[:n_q]).max()) > settings.far:
                name = self.dynamics.state_names[int(np.argmax(np.abs(y[:n_q])))]
                raise RunawayError(
                    f"{name} runs away", time=start + unit * offset, state=tuple(y.tolist())
                )

        return watch

    def _look(self, time: float, y: Vector) -> None:
        """End a motion that speeds up so much that its steps will not last to the horizon.

        A look comes at every doubling of the steps. Speeds that grow from look to look, and the
        pace since the last one, tell in a tenth of the steps what all of them would.
        """
        n_q = self.dynamics.n_q
        rates = np.abs(y[n_q : 2 * n_q])
        self.looks.append(_Look(steps=self.n_steps, time=time, speed=float(rates.max())))
        last = self.looks[-_RISING:]
        if len(last) < _RISING or any(b.speed < _RISE * a.speed for a, b in pairwise(last)):
            return
        before = last[-2]
        steps, passed = self.n_steps - before.steps, time - before.time
        needed = (self.until - time) * steps / passed if passed > 0.0 else math.inf
        if self.n_steps + needed > self.settings.most_steps:
            name = self.dynamics.state_names[n_q + int(np.argmax(rates))]
            raise RunawayError(
                f"{name} grows without end: at the pace of its last {steps} steps, "
                f"{needed:.1g} more would be needed",
                time=time,
                state=tuple(y.tolist()),
            )

    def _arc(
        self, start: _Start, flow: GuardedFlow, natural: Ending, *, on_guard: bool
    ) -> tuple[Arc, Vector]:
        """Follow a flow until its guard falls through zero or the horizon comes.

        Args:
            start: Where it starts; its speed makes it a rescaled flight.
            flow: The flow.
            natural: What the guard means.
            on_guard: The start is a root of the guard that does not count.

        Returns:
            The arc, recorded, and the last state of the flow itself.
        """
        n_x = len(start.state)
        unit = 1.0 if start.speed is None else start.speed
        leg = Leg(
            flow=flow,
            y=start.state if start.speed is None else _launched(start.state),
            horizon=(self.until - start.time) / unit,
            tolerance=self.settings.tolerance,
            on_guard=on_guard,
            contact=self.settings.contact,
            watch=self._watch(unit, start.time),
        )
        passage = self.engine.follow(leg)
        time = start.time + unit * passage.duration
        if passage.outcome is Outcome.LEFT:
            raise PenetrationError(
                "The state leaves the admissible set from its boundary",
                time=time,
                state=tuple(passage.state[:n_x].tolist()),
            )
        over = passage.outcome is Outcome.HORIZON
        arc = Arc(
            mode=start.mode,
            start_time=start.time,
            end_time=self.until if over else time,
            start_state=start.state,
            end_state=passage.state[:n_x],
            ending=Ending.HORIZON if over else natural,
            impact_index=self.n_impacts,
            time_unit=unit,
            trajectory=passage.trajectory,
        )
        self.arcs.append(arc)
        return arc, passage.state


def _launched(x: Vector) -> Vector:
    """Return the state of a rescaled flight at its start, ``(x, 0, 1)``."""
    y = np.zeros(x.size + 2)
    y[:-2], y[-1] = x, 1.0
    return y
