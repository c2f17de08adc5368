"""One point of a map: its motion is simulated until it converges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.maps.approach import Approach, steps_towards
from zeno_orbits.maps.attempt import SAME, Accuracy, NewtonState, NoOrbit
from zeno_orbits.maps.attractors import Attractor, AttractorClass
from zeno_orbits.maps.crossings import Follower, ImpactRecord
from zeno_orbits.maps.known import KnownOrbit, Recognition
from zeno_orbits.maps.newton import (
    IMPACTS,
    RELEASES,
    Crossing,
    DisplacedStates,
    bundle_at,
    chart_at,
    displaced,
    extrapolated,
)
from zeno_orbits.model import own_time
from zeno_orbits.simulation import (
    LOOK_BACK,
    WAITING,
    AttractorKind,
    Motion,
    MotionEnd,
    MotionLog,
    Reason,
    RepeatedCycle,
    Repetition,
    SectionReturn,
    Settling,
    changes,
    clock_turn,
    outcome_of,
    scale_of,
    verdict,
)

_BETWEEN, _EXACT = 128, 1e-9
"""Impacts between two tests for repetition, and change over a period that counts as zero."""
_REMEMBERED = 40
"""Number of stored returns."""
_CLOSE = 1e-4
"""Change of an impact over a period below which Newton's method is tried."""
_DISTINCT = 1e-3
"""Relative difference below which two states are the same."""
_MUCH_NEARER, _LATER = 0.3, 8
"""Newton's method is repeated if the change decreases by this factor, or after as many returns."""
_PATIENCE = 4
"""Failures of Newton's method after which a decrease of the change does not cause a repetition."""
_APART = 0.2
"""Factor by which a longer period must reduce the change over a shorter period."""


class Point:
    """A motion that is simulated until it converges."""

    def __init__(
        self,
        follower: Follower,
        units: Sequence[str],
        start: Vector,
        until: float,
        accuracy: Accuracy,
        usual: Vector | float = 1.0,
        known: Sequence[KnownOrbit] = (),
    ) -> None:
        """Begin at an initial state.

        Args:
            follower: Simulator of motions.
            units: Unit of each state.
            start: Initial state, ``(n_x,)``.
            until: Longest simulated time [s].
            accuracy: Accuracy of the simulation.
            usual: Usual size of each state, ``(n_x,)``.
            known: Orbits with which the motion is compared at every crossing.
        """
        self._follower = follower
        self._dynamics = follower.dynamics
        self._units = units
        self._usual = usual
        self._start = start
        self._until = until
        self._accuracy = accuracy
        self._times: dict[Crossing, list[float]] = {RELEASES: [], IMPACTS: []}
        self.way: Approach | None = None
        self._tolerance = accuracy.motion
        elastic = follower.dynamics.restitution >= 1.0
        self._log = MotionLog(units=units, usual=usual, elastic=elastic)
        self._checked = 0
        self._returns: list[SectionReturn] = []
        self._strikes: list[ImpactRecord] = []
        self._amplitudes: list[float] = []
        self._unit: Vector | None = None
        self._failures = 0
        self._tried: dict[int, tuple[float, int]] = {}
        self._looked: dict[int, float] = {}
        self._known = [Recognition(orbit=one, reached=accuracy.reached) for one in known]

    def attractor(self) -> Attractor:
        """Simulate the motion and return its attractor."""
        origin, start = 0.0, self._start
        while True:
            answer = self._followed(origin, start)
            if isinstance(answer, Attractor):
                return answer
            origin, start = answer.time, answer.state

    def _followed(self, origin: float, start: Vector) -> Attractor | ImpactRecord:
        """Simulate the motion from a state to its attractor, or until it needs more accuracy."""
        crossings = self._follower.crossings(
            start,
            until=self._until - origin,
            error=self._tolerance,
            goes_on=origin > 0.0,
            seen=lambda event: self._log.add(event, origin),
        )
        for crossing in crossings:
            if isinstance(crossing, MotionEnd):
                return self._ended(crossing)
            time = origin + crossing.time
            answer: Attractor | ImpactRecord | None = None
            if isinstance(crossing, ImpactRecord):
                answer = self._struck(replace(crossing, time=time))
            elif not self._has_just_returned(time):
                answer = self._returned(time, crossing.state)
            answer = answer or self._repeating()
            if answer is not None:
                return answer
        raise AssertionError("The run lacks an end.")

    def _has_just_returned(self, time: float) -> bool:
        """Return True if a return is the last one over again."""
        if not self._returns or time - self._returns[-1].time >= SAME * self._until:
            return False
        # A longer limit does not make returns the same.
        usual = WAITING * own_time(self._dynamics, self._start)
        return time - self._returns[-1].time < SAME * min(self._until, usual)

    def _repeating(self) -> Attractor | None:
        """Return the orbit of a motion whose impacts repeat to rounding, tested at intervals."""
        if len(self._log.speeds) < self._checked + _BETWEEN:
            return None
        self._checked = len(self._log.speeds)
        cycle = self._log.cycle(_EXACT)
        return None if cycle is None or self._log.drift() else self._of_cycle(cycle)

    def _of_cycle(self, cycle: RepeatedCycle) -> Attractor:
        """Return the orbit of repeating impacts, with multipliers if Newton's method converges."""
        n = cycle.releases
        if 0 < n < len(self._returns):
            found = self._attempted(Repetition(returns=n, change=0.0))
            if found is not None:
                return found
        fate = AttractorClass.NO_ZENO
        if cycle.zeno_points and n:
            fate = (
                AttractorClass.ZENO if self._dynamics.restitution > 0.0 else AttractorClass.SIMPLE
            )
        state = self._returns[-1].state if n and self._returns else cycle.state
        return Attractor(
            fate=fate,
            returns=n,
            period=cycle.period,
            margins={} if n else {"first_impact_speed": cycle.slowest},
            state=self._named(state),
        )

    def _returned(self, time: float, state: Vector) -> Attractor | None:
        """Compare a new release with earlier releases."""
        self._strikes.clear()
        self._returns.append(SectionReturn(time=time, state=state))
        self._times[RELEASES].append(time)
        del self._returns[:-_REMEMBERED]
        recognized = self._recognized(RELEASES, state)
        if recognized is not None:
            return recognized
        if self._unit is None:
            self._unit = scale_of([state], self._units, self._usual)
        self._amplitudes.append(float(np.max(np.abs(state) / self._unit)))
        if len(self._returns) < 2:
            return None
        settling = self._outcome()
        if settling.outcome is AttractorKind.DIES_OUT:
            return Attractor(fate=AttractorClass.REST, trend=settling.trend)
        if self._may_recognize(RELEASES):
            return None
        for repeated in settling.repetitions:
            if self._is_worth_it(repeated):
                return self._attempted(repeated)
        return None

    def _outcome(self, *, gone: str = "", still: bool = False, held: bool = False) -> Settling:
        """Classify the motion from the releases so far and from its end."""
        motion = Motion(
            units=self._units,
            usual=self._usual,
            returns=self._returns,
            amplitudes=self._amplitudes,
            gone=gone,
            still=still,
            held=held,
        )
        return outcome_of(motion, close=self._accuracy.near, apart=_APART)

    def _is_worth_it(self, repeated: Repetition) -> bool:
        """Return True if another attempt of Newton's method is worthwhile."""
        before, at = self._tried.get(repeated.returns, (np.inf, -np.inf))
        # A motion that never converges passes near many orbits. The attempts become less frequent.
        later = len(self._amplitudes) >= at + _LATER * 2 ** max(self._failures - 1, 0)
        return later or (repeated.change < _MUCH_NEARER * before and self._failures < _PATIENCE)

    def _attempted(self, repeated: Repetition) -> Attractor | None:
        """Return the orbit of Newton's method from releases that nearly repeat."""
        period = repeated.returns
        self._tried[period] = repeated.change, len(self._amplitudes)
        now, before = self._returns[-1], self._returns[-1 - period]
        sizes = [one.state for one in self._returns[-LOOK_BACK:]]
        scale = scale_of(sizes, self._units, self._usual)
        bundle = self._first_bundle(period, scale)
        if not np.all(np.isfinite(bundle.states)):
            return None
        attempt = NewtonState(
            follower=self._follower,
            accuracy=self._accuracy,
            span=now.time - before.time,
            period=period,
            bundle=bundle,
            origin=now.state,
            earlier=before.state,
        )
        found = self._found_by(attempt)
        self._failures += found is None
        return found

    def _first_bundle(self, period: int, scale: Vector) -> DisplacedStates:
        """Return the bundle at the limit of the last returns, or else at the last return."""
        dynamics, last = self._dynamics, self._returns[-1].state
        section = chart_at(dynamics, RELEASES.rows, last, scale)
        if len(self._returns) <= 2 * period:
            return displaced(dynamics, section)
        before, earlier = (self._returns[-1 - k * period].state for k in (1, 2))
        try:
            centre = section.state(dynamics, extrapolated(section, before, earlier))
            return displaced(dynamics, replace(section, centre=centre))
        except SimulationError:
            return displaced(dynamics, section)

    def _found_by(self, attempt: NewtonState) -> Attractor | None:
        """Return the result of an attempt, and record the approach of the motion."""
        found = attempt.run()
        if isinstance(found, NoOrbit):
            return None
        if found.state:
            self._note_way(attempt, found)
        return found

    def _note_way(self, attempt: NewtonState, found: Attractor) -> None:
        """Record the approach of the motion to the result of an attempt."""
        state = np.array([found.state[name] for name in self._dynamics.state_names])
        events = self._returns if attempt.crossing is RELEASES else self._strikes
        scale = attempt.bundle.section.scale
        way = self._way(attempt.crossing, events, attempt.period, state, scale)
        self.way = replace(way, doubtful=attempt.doubtful)

    def _way(
        self,
        crossing: Crossing,
        events: Sequence[SectionReturn | ImpactRecord],
        period: int,
        state: Vector,
        scale: Vector,
    ) -> Approach:
        """Return the approach of the motion to an orbit.

        Args:
            crossing: The events at which it returned.
            events: The last events.
            period: Number of events per period.
            state: State of the orbit on the section, ``(n_x,)``.
            scale: Size of each state, ``(n_x,)``.
        """
        times, passed = self._times[crossing], [one.state for one in events]
        on_the_way = steps_towards(passed[::-period], state, scale, self._accuracy.reached)
        return Approach(times=tuple(times), captured=len(times) - 1 - period * on_the_way)

    def _recognized(self, crossing: Crossing, state: Vector) -> Attractor | None:
        """Return the known orbit to which the motion converges, and record its approach."""
        for one in self._known:
            if one.orbit.at_releases == (crossing is RELEASES) and one.sees(state):
                times = self._times[crossing]
                captured = max(len(times) - len(one.passed), 0)
                self.way = Approach(times=tuple(times), captured=captured)
                return one.orbit.attractor
        return None

    def _may_recognize(self, crossing: Crossing) -> bool:
        """Return True if the motion has recently come near a known orbit."""
        sides = ((one.orbit.at_releases, one.may_see) for one in self._known)
        return (crossing is RELEASES, True) in sides

    def _named(self, state: Vector) -> dict[str, float]:
        # The state of a failure may have further entries.
        names = self._dynamics.state_names
        return dict(zip(names, state[: len(names)].tolist(), strict=True))

    def _struck(self, impact: ImpactRecord) -> Attractor | ImpactRecord | None:
        """Compare the first impact of a sequence with earlier first impacts, without a release."""
        self._strikes.append(impact)
        self._times[IMPACTS].append(impact.time)
        del self._strikes[:-_REMEMBERED]
        recognized = self._recognized(IMPACTS, impact.state)
        if recognized is not None or self._may_recognize(IMPACTS):
            return recognized
        if len(self._strikes) < LOOK_BACK:
            return None
        states = [one.state for one in self._strikes]
        scale = scale_of(states[-LOOK_BACK:], self._units, self._usual)
        repeats = self._accuracy.repeats
        for period, change in changes(states, scale).items():
            if not change < max(_CLOSE, repeats, _DISTINCT):
                continue
            earlier = np.inf
            if 2 * period < len(states):
                earlier = np.max(np.abs(states[-1 - period] - states[-1 - 2 * period]) / scale)
            if change < _CLOSE and earlier < 10 * _CLOSE:
                answer = self._look_around(period, change, scale)
                if answer is not None:
                    return answer
            if change < repeats and earlier < 10 * repeats:
                return self._repeated(period, scale)
            if change < _DISTINCT:
                # It converges to this period, and longer periods are multiples of it.
                return None
        return None

    def _repeated(self, period: int, scale: Vector) -> ImpactRecord | Attractor:
        """Return the impact for a more accurate continuation, or afterwards the attractor."""
        last = self._strikes[-1]
        if not self._tolerance > self._accuracy.orbit:
            self.way = self.way or self._way(IMPACTS, self._strikes, period, last.state, scale)
            return self._without_zeno(period)
        self.way = self._way(IMPACTS, self._strikes, period, last.state, scale)
        self._tolerance = self._accuracy.orbit
        self._strikes.clear()
        return last

    def _look_around(self, period: int, change: float, scale: Vector) -> Attractor | None:
        """Return the orbit of Newton's method from impacts that nearly repeat."""
        if not change < _MUCH_NEARER * self._looked.get(period, np.inf):
            return None
        self._looked[period] = change
        last, before = self._strikes[-1], self._strikes[-1 - period]
        try:
            bundle = bundle_at(self._dynamics, IMPACTS.rows, last.state, scale)
        except (ZenoOrbitsError, np.linalg.LinAlgError):
            return None
        if not np.all(np.isfinite(bundle.states)):
            return None
        attempt = NewtonState(
            follower=self._follower,
            accuracy=self._accuracy,
            crossing=IMPACTS,
            span=last.time - before.time,
            period=period,
            bundle=bundle,
            final=True,
            origin=last.state,
            earlier=before.state,
        )
        return self._found_by(attempt)

    def _without_zeno(self, period: int) -> Attractor:
        last, first = self._strikes[-1], self._strikes[-1 - period]
        return Attractor(
            fate=AttractorClass.NO_ZENO,
            period=last.time - first.time,
            margins={"first_impact_speed": min(-one.rate for one in self._strikes[-period:])},
            state=self._named(last.state),
        )

    def _ended(self, event: MotionEnd) -> Attractor:
        if event.reason is Reason.FAILURE:
            return Attractor(
                fate=AttractorClass.FAILED, detail=event.detail, state=self._named(event.state)
            )
        if event.reason is Reason.HORIZON:
            return self._at_last(event.state)
        settling = self._outcome(
            gone=event.detail if event.reason is Reason.ESCAPE else "",
            still=event.reason is Reason.REST,
            held=event.reason is Reason.HELD,
        )
        match settling.outcome:
            case AttractorKind.GONE:
                return Attractor(fate=AttractorClass.ESCAPE, escaped=settling.escaped)
            case AttractorKind.RESTS | AttractorKind.DIES_OUT:
                return Attractor(fate=AttractorClass.REST)
            case _:
                return Attractor(fate=AttractorClass.HELD)

    def _at_last(self, state: Vector) -> Attractor:
        """Classify a motion that was simulated to its time limit."""
        settling = self._outcome()
        if settling.outcome is AttractorKind.DIES_OUT:
            return Attractor(fate=AttractorClass.REST)
        found = verdict(self._dynamics, self._log, state, self._until, close=self._accuracy.repeats)
        if found.cycle is not None:
            return self._of_cycle(found.cycle)
        if found.kind is AttractorKind.REPEATS:
            turn = clock_turn(self._dynamics, state) or math.nan
            return Attractor(
                fate=AttractorClass.NO_ZENO, period=found.turns * turn, state=self._named(state)
            )
        exponent = found.exponent
        return Attractor(
            fate=AttractorClass.UNSETTLED,
            kind=found.kind,
            trend=settling.trend,
            detail=found.reason,
            exponent=math.nan if exponent is None else exponent.value,
            exponent_error=math.nan if exponent is None else exponent.error,
        )
