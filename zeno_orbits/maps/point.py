"""One point of a map as it follows its motion: what it asks of the batch, what it concludes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.maps.approach import Way, steps_towards
from zeno_orbits.maps.attempt import SAME, Accuracy, Attempt, Lost, Request
from zeno_orbits.maps.attractors import Attractor, Fate
from zeno_orbits.maps.newton import IMPACTS, RELEASES, Crossing, bundle_at
from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation import (
    LOOK_BACK,
    AttractorKind,
    Ended,
    LaneEvent,
    Motion,
    Reason,
    Repetition,
    SectionReturn,
    Settling,
    Struck,
    changes,
    outcome_of,
    scale_of,
)

_REMEMBERED = 40
"""Returns that are looked back on."""
_CLOSE = 1e-4
"""Change of an impact that is a period later below which Newton's method is tried."""
_DISTINCT = 1e-3
"""States nearer than this are taken for one another, relative."""
_MUCH_NEARER, _LATER = 0.3, 8
"""Newton's method is tried again if a motion is this much nearer, or this many returns later."""
_PATIENCE = 4
"""Failures of Newton's method after which a motion that has come nearer has to wait like others."""
_APART = 0.2
"""A motion repeats after more returns only if it is that much nearer after them than before."""


class Point:
    """A motion that settles; it is told events and answers with requests or a conclusion."""

    def __init__(
        self,
        dynamics: HybridDynamics,
        units: Sequence[str],
        start: Vector,
        until: float,
        accuracy: Accuracy,
        usual: Vector | float = 1.0,
    ) -> None:
        self._dynamics = dynamics
        self._units = units
        self._usual = usual
        self._start = start
        self._until = until
        self._accuracy = accuracy
        self._times: dict[Crossing, list[float]] = {RELEASES: [], IMPACTS: []}
        self.way: Way | None = None
        self._origin = 0.0
        self._tolerance = accuracy.motion
        self._returns: list[SectionReturn] = []
        self._strikes: list[Struck] = []
        self._amplitudes: list[float] = []
        self._unit: Vector | None = None
        self._failures = 0
        self._tried: dict[int, tuple[float, int]] = {}
        self._looked: dict[int, float] = {}
        self._attempt: Attempt | None = None

    def begin(self) -> Request:
        """Return the first lane to run."""
        return Request(self._start[None, :], self._tolerance, False, self._until)

    def hear(self, rank: int, event: LaneEvent) -> Request | Attractor | None:
        """Take an event of one of the point's lanes.

        Args:
            rank: Which of the lanes it asked for last.
            event: What happened to it.

        Returns:
            Other lanes to run in place of these, or the conclusion, or ``None`` to go on.
        """
        if self._attempt is not None:
            answer = self._attempt.hear(rank, event)
            if isinstance(answer, Attractor) and answer.state:
                self._note_way(self._attempt, answer)
            return self._give_up(self._attempt) if isinstance(answer, Lost) else answer
        time = self._origin + event.time
        if isinstance(event, Ended):
            return self._ended(event)
        if isinstance(event, Struck):
            return self._struck(replace(event, time=time))
        if self._returns and time - self._returns[-1].time < SAME * self._until:
            return None
        return self._returned(time, event.state)

    def _returned(self, time: float, state: Vector) -> Request | Attractor | None:
        """Look back from a new release."""
        self._strikes.clear()
        self._returns.append(SectionReturn(time=time, state=state))
        self._times[RELEASES].append(time)
        del self._returns[:-_REMEMBERED]
        if self._unit is None:
            self._unit = scale_of([state], self._units, self._usual)
        self._amplitudes.append(float(np.max(np.abs(state) / self._unit)))
        if len(self._returns) < 2:
            return None
        settling = self._outcome()
        if settling.outcome is AttractorKind.DIES_OUT:
            return Attractor(fate=Fate.REST, trend=settling.trend)
        for repeated in settling.repetitions:
            if self._is_worth_it(repeated):
                return self._begin_attempt(repeated)
        return None

    def _outcome(self, *, gone: str = "", still: bool = False, held: bool = False) -> Settling:
        """Return what the releases so far and the end of the motion tell."""
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
        """Return True if Newton's method may reach an orbit, if it did not the last time."""
        before, at = self._tried.get(repeated.returns, (np.inf, -np.inf))
        # A motion that never settles comes near many orbits: it is looked at ever less often.
        later = len(self._amplitudes) >= at + _LATER * 2 ** max(self._failures - 1, 0)
        return later or (repeated.change < _MUCH_NEARER * before and self._failures < _PATIENCE)

    def _begin_attempt(self, repeated: Repetition) -> Request | None:
        """Begin Newton's method from releases that nearly repeat."""
        period = repeated.returns
        self._tried[period] = repeated.change, len(self._amplitudes)
        now, before = self._returns[-1], self._returns[-1 - period]
        sizes = [one.state for one in self._returns[-LOOK_BACK:]]
        scale = scale_of(sizes, self._units, self._usual)
        bundle = bundle_at(self._dynamics, RELEASES.rows, now.state, scale)
        if not np.all(np.isfinite(bundle.states)):
            return None
        self._attempt = Attempt(
            dynamics=self._dynamics,
            accuracy=self._accuracy,
            span=now.time - before.time,
            period=period,
            bundle=bundle,
            origin=now.state,
            earlier=before.state,
        )
        return self._attempt.request(neighbours=True)

    def _note_way(self, attempt: Attempt, found: Attractor) -> None:
        """Note how the motion came to what an attempt found."""
        state = np.array([found.state[name] for name in self._dynamics.state_names])
        events = self._returns if attempt.crossing is RELEASES else self._strikes
        scale = attempt.bundle.section.scale
        way = self._way(attempt.crossing, events, attempt.period, state, scale)
        self.way = replace(way, doubtful=attempt.doubtful)

    def _way(
        self,
        crossing: Crossing,
        events: Sequence[SectionReturn | Struck],
        period: int,
        state: Vector,
        scale: Vector,
    ) -> Way:
        """Return how the motion came to an orbit.

        Args:
            crossing: The events at which it came back.
            events: The last of them.
            period: How many of them make a period.
            state: The orbit there, ``(n_x,)``.
            scale: Size of each state, ``(n_x,)``.
        """
        times, passed = self._times[crossing], [one.state for one in events]
        on_the_way = steps_towards(passed[::-period], state, scale, self._accuracy.reached)
        return Way(times=tuple(times), captured=len(times) - 1 - period * on_the_way)

    def _give_up(self, attempt: Attempt) -> Request:
        """Return to the motion, from its last event on that section."""
        self._attempt = None
        if attempt.crossing is RELEASES:
            self._failures += 1
            return self._go_on_from(self._returns[-1])
        return self._go_on_from(self._strikes[-1])

    def _go_on_from(self, last: SectionReturn | Struck) -> Request:
        """Follow the motion from a state on the stop that leaves it."""
        self._origin = last.time
        return Request(last.state[None, :], self._tolerance, True, self._until - last.time)

    def _named(self, state: Vector) -> dict[str, float]:
        return dict(zip(self._dynamics.state_names, state.tolist(), strict=True))

    def _struck(self, impact: Struck) -> Request | Attractor | None:
        """Look back from the first impact of a sequence, where no release comes."""
        self._strikes.append(impact)
        self._times[IMPACTS].append(impact.time)
        del self._strikes[:-_REMEMBERED]
        if len(self._strikes) < LOOK_BACK:
            return None
        states = [one.state for one in self._strikes]
        scale = scale_of(states[-LOOK_BACK:], self._units, self._usual)
        repeats = self._accuracy.repeats
        for period, change in changes(states, scale).items():
            earlier = changes(states[:-period], scale).get(period, np.inf)
            if change < _CLOSE and earlier < 10 * _CLOSE:
                answer = self._look_around(period, change, scale)
                if answer is not None:
                    return answer
            if change < repeats and earlier < 10 * repeats:
                return self._repeated(period, scale)
            if change < _DISTINCT:
                # It is on its way to repeat after so many; more would repeat that.
                return None
        return None

    def _repeated(self, period: int, scale: Vector) -> Request | Attractor:
        """Go on more accurately from impacts that repeat, then conclude."""
        last = self._strikes[-1]
        if not self._tolerance > self._accuracy.orbit:
            self.way = self.way or self._way(IMPACTS, self._strikes, period, last.state, scale)
            return self._without_zeno(period)
        self.way = self._way(IMPACTS, self._strikes, period, last.state, scale)
        self._tolerance = self._accuracy.orbit
        self._strikes.clear()
        return self._go_on_from(last)

    def _look_around(self, period: int, change: float, scale: Vector) -> Request | None:
        """Begin Newton's method from impacts that nearly repeat, if it has not failed there."""
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
        self._attempt = Attempt(
            dynamics=self._dynamics,
            accuracy=self._accuracy,
            crossing=IMPACTS,
            span=last.time - before.time,
            period=period,
            bundle=bundle,
            final=True,
            origin=last.state,
            earlier=before.state,
        )
        return self._attempt.request(neighbours=True)

    def _without_zeno(self, period: int) -> Attractor:
        last, first = self._strikes[-1], self._strikes[-1 - period]
        return Attractor(
            fate=Fate.NO_ZENO,
            period=last.time - first.time,
            margins={"first_impact_speed": min(-one.rate for one in self._strikes[-period:])},
            state=self._named(last.state),
        )

    def _ended(self, event: Ended) -> Attractor:
        if event.reason is Reason.FAILURE:
            return Attractor(fate=Fate.FAILED, detail=event.detail, state=self._named(event.state))
        settling = self._outcome(
            gone=event.detail if event.reason is Reason.ESCAPE else "",
            still=event.reason is Reason.REST,
            held=event.reason is Reason.HELD,
        )
        match settling.outcome:
            case AttractorKind.GONE:
                return Attractor(fate=Fate.ESCAPE, escaped=settling.escaped)
            case AttractorKind.RESTS | AttractorKind.DIES_OUT:
                return Attractor(fate=Fate.REST)
            case AttractorKind.HELD:
                return Attractor(fate=Fate.HELD)
            case _:
                reason = "" if self._amplitudes else "no release comes"
                return Attractor(fate=Fate.UNSETTLED, trend=settling.trend, detail=reason)
