r"""One completed execution in numbers of a given length, event by event.

The laws are the simulator's: reset and rescaled flights of theory (1.7), (2.6). What is done in
doubles there is done in full length here: each arc ends where its guard is zero to all digits.
Nothing is extrapolated: impacts are resolved until the square of their speed is below rounding, and
the Zeno point follows to first order (15).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal

from flint import arb, ctx

from tests.reference.many_digits.gauss import GaussFlow, followed_no_further
from tests.reference.many_digits.gauss_scheme import Real
from tests.reference.many_digits.system import (
    ExtendedSystem,
    State,
    along,
)
from zeno_orbits.errors import ChatterError, InputError
from zeno_orbits.simulation import Mode, tail_time

_CONTACT = 1e-12
"""A state this close to the stop is moved onto it, as the simulator does."""
_MOST_IMPACTS = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace:
    """Events and samples of an execution.

    Attributes:
        impacts: Time and approach rate of each impact that was resolved.
        zeno_points: Time and state of each.
        releases: Time and state of each.
        samples: Time and state where it was asked for.
    """

    impacts: list[tuple[Real, Real]] = field(default_factory=list[tuple[Real, Real]])
    zeno_points: list[tuple[Real, State]] = field(default_factory=list[tuple[Real, State]])
    releases: list[tuple[Real, State]] = field(default_factory=list[tuple[Real, State]])
    samples: list[tuple[Real, State]] = field(default_factory=list[tuple[Real, State]])

    def points(self) -> tuple[list[tuple[Real, State]], ...]:
        """Return everything that has a time and a state, by its kind."""
        return self.zeno_points, self.releases, self.samples

    def sequences(self) -> list[list[State]]:
        """Return the impacts in the sequences that the Zeno points part."""
        ends = [time for time, _ in self.zeno_points]
        parts: list[list[State]] = [[] for _ in range(len(ends) + 1)]
        for time, rate in self.impacts:
            parts[sum(end < time for end in ends)].append([time, rate])
        return parts


@dataclass(frozen=True, slots=True, kw_only=True)
class _Start:
    """Start of the next arc.

    Attributes:
        mode: Its mode.
        time: When [s].
        state: Where, ``(n_x,)``.
        order: Order of the guard's root at the start, which does not count.
        speed: Gap rate just after the impact that it comes from; ``None`` for any other start.
        expected: Duration that is expected, in units of the speed.
    """

    mode: Mode
    time: Real
    state: State
    order: int = 0
    speed: Real | None = None
    expected: float = math.inf


class ExtendedRun:
    """One execution, followed event by event."""

    def __init__(
        self,
        system: ExtendedSystem,
        until: float | Decimal,
        times: Sequence[float | Decimal] = (),
        releases: float = math.inf,
    ) -> None:
        """Prepare an execution.

        Args:
            system: The problem.
            until: When to stop [s].
            times: Where the state is wanted, rising [s].
            releases: Stop earlier, at this many.
        """
        self.system = system
        with ctx.workprec(system.bits):
            self.until, *self.times = system.numbers([until, *times])
        self.most_releases = releases
        self.trace = Trace()

    def follow(self, state: Sequence[float | Decimal | Real]) -> Trace:
        """Return what happens from an admissible state, at time 0."""
        with ctx.workprec(self.system.bits):
            here = self._admit(self.system.numbers(state))
            while here is not None:
                here = self._carry(here) if here.mode is Mode.LOCKED else self._fly(here)
        return self.trace

    def _admit(self, x: State) -> _Start | None:
        own, zero = self.system.own, arb(0)
        gap, rate, *_ = self.system.contact(x)
        if gap < -_CONTACT * own.gap:
            message = f"Argument `state` must have a gap >= 0, but it is {float(gap):.6g}."
            raise InputError(message)
        if gap > _CONTACT * own.gap:
            return _Start(mode=Mode.FREE, time=zero, state=x)
        if abs(rate) <= _CONTACT * own.gap_rate:
            return self._rest(zero, self.system.resting(x)[0])
        if rate > 0:
            return _Start(mode=Mode.FREE, time=zero, state=x, speed=rate, order=1)
        return self._hit(zero, x, rate)

    def _rest(self, time: Real, x: State) -> _Start:
        """Return the mode that holds on the stop at zero gap rate."""
        _, _, acceleration, _, multiplier_rate = self.system.contact(x)
        if abs(acceleration) > self.system.smallest * self.system.own.gap_acceleration:
            mode = Mode.LOCKED if acceleration < 0 else Mode.FREE
            return _Start(mode=mode, time=time, state=x, order=0 if acceleration < 0 else 2)
        if multiplier_rate > 0:
            return _Start(mode=Mode.LOCKED, time=time, state=x, order=1)
        return _Start(mode=Mode.FREE, time=time, state=x, order=3)

    def _carry(self, start: _Start) -> _Start | None:
        """Follow the constrained flow to the release."""
        multiplier = self.system.contact(start.state).multiplier if start.order == 0 else arb(0)
        fell = self._arc(self.system.locked, start, [multiplier])
        if fell is None:
            return None
        time, y = fell
        state = self.system.resting(y[:-1])[0]
        self.trace.releases.append((time, state))
        if len(self.trace.releases) >= self.most_releases:
            return None
        # The multiplier falls through zero, so the gap grows with the cube of time.
        return _Start(mode=Mode.FREE, time=time, state=state, order=3)

    def _fly(self, start: _Start) -> _Start | None:
        """Follow a flight, rescaled if it comes from an impact, to the next impact."""
        if start.speed is not None:
            gap = [arb(0), arb(1)]
        else:
            gap = [arb(0), arb(0)] if start.order else [*self.system.contact(start.state)[:2]]
        unit = arb(1) if start.speed is None else start.speed
        fell = self._arc(self.system.flight, start, gap, unit, [unit])
        if fell is None:
            return None
        time, (*x, _, rate) = fell
        return self._hit(time, x, (unit * rate).mid())

    def _arc(
        self,
        flow: GaussFlow,
        start: _Start,
        guard: State,
        unit: Real = 1,
        constants: Sequence[Real] = (),
    ) -> tuple[Real, State] | None:
        """Follow a flow to its guard; None if the time is over before.

        Args:
            flow: The flow, of the problem's states and those of the guard.
            start: The start.
            guard: The guard's states there.
            unit: Unit of the flow's time [s].
            constants: Numbers of the flow.
        """
        time, y = start.time, [*start.state, *guard]
        order, expected = start.order, start.expected
        n_x, samples = len(start.state), self.trace.samples
        while True:
            waiting = self.times[len(samples) :]
            stop = waiting[0] if waiting else self.until
            duration, y, fell = flow.advance(
                y,
                ((stop - time) / unit).mid(),
                order=order,
                constants=constants,
                unit=float(unit),
                expected=expected,
            )
            if duration > 0:
                time, order, expected = (time + unit * duration).mid(), 0, math.inf
            if fell:
                return time, y
            if not waiting:
                return None
            time = stop
            samples.append((stop, y[:n_x]))

    def _hit(self, time: Real, x: State, approach_rate: Real) -> _Start | None:
        """Apply the reset map and return what follows it."""
        if not approach_rate < 0:
            reason = f"An impact must close the gap, but the gap rate is {float(approach_rate):.3g}"
            raise followed_no_further(reason, time, x)
        self.trace.impacts.append((time, approach_rate))
        if len(self.trace.impacts) > _MOST_IMPACTS:
            reason = f"There are more than {_MOST_IMPACTS} impacts"
            raise followed_no_further(reason, time, x, ChatterError)
        after, law = self.system.strike(x, approach_rate)
        speed = law.speed_after(approach_rate).mid()
        resting, acceleration, rate = self.system.resting(after)
        least = self.system.smallest_speed
        if speed == 0 or (speed < least and acceleration < 0):
            left = tail_time(speed, acceleration, law.restitution).mid() if speed > 0 else speed
            return self._settle(time, left, resting, rate)
        expected = float(-2 / acceleration) if acceleration < 0 else math.inf
        return _Start(
            mode=Mode.FREE, time=time, state=after, order=1, speed=speed, expected=expected
        )

    def _settle(self, time: Real, left: Real, resting: State, rate: State) -> _Start | None:
        """Return what follows impacts too slow to be told apart; they take what time is left."""
        end = (time + left).mid()
        for t in self.times[len(self.trace.samples) :]:
            if t < end:
                self.trace.samples.append((t, along(resting, t - time, rate)))
        if end > self.until:
            return None
        start = self._rest(end, self.system.resting(along(resting, left, rate))[0])
        if start.mode is Mode.LOCKED:
            self.trace.zeno_points.append((end, start.state))
        return start
