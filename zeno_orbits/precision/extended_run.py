r"""One completed execution in numbers of a given length, event by event.

The laws are the simulator's: reset, rescaled flights and Zeno limit of theory (7), (14), (15). What
is done in doubles there is done in full length here: the guard's root is found on the Taylor
series of each step, and the limit is extrapolated from more impacts, until it holds to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal

from zeno_orbits.errors import ChatterError, InputError, SimulationError
from zeno_orbits.precision.extended_system import ExtendedSystem, State
from zeno_orbits.precision.multiprecision import Real, SeriesStep
from zeno_orbits.simulation import Mode, limit_weights, tail_time

_CONTACT = 1e-12
"""A state this close to the stop is moved onto it, as the simulator does."""
_NODES = 10
"""Impacts that the extrapolation uses at most."""
_NODE_RATIO = 0.5
_MAY_BEND = 0.1
"""Largest relative change of d2h/dt2 over a Zeno tail; beyond it the tail is not geometric yet."""
_MOST_IMPACTS = 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Trace:
    """Events and samples of an execution.

    Attributes:
        impacts: Time and approach rate of each impact that was resolved.
        zeno_points: Time and state of each.
        releases: Time and state of each.
        samples: States at the times that were asked for.
    """

    impacts: list[tuple[Real, Real]] = field(default_factory=list[tuple[Real, Real]])
    zeno_points: list[tuple[Real, State]] = field(default_factory=list[tuple[Real, State]])
    releases: list[tuple[Real, State]] = field(default_factory=list[tuple[Real, State]])
    samples: list[State] = field(default_factory=list[State])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Start:
    """Start of the next arc.

    Attributes:
        mode: Its mode.
        time: When [s].
        state: Where, ``(n_x,)``.
        order: Order of the guard's root at the start, which does not count.
        speed: Gap rate just after the impact that it comes from; ``None`` for any other start.
    """

    mode: Mode
    time: Real
    state: State
    order: int = 0
    speed: Real | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Node:
    """The Zeno point, time last, to first order in the speed after an impact."""

    speed: Real
    point: State
    gap_acceleration: Real


class ExtendedRun:
    """One execution, followed event by event."""

    def __init__(
        self,
        system: ExtendedSystem,
        until: Real,
        times: Sequence[Real] = (),
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
        self.until = until
        self.times = times
        self.most_releases = releases
        self.trace = Trace()
        self._nodes: list[_Node] = []

    def follow(self, state: Sequence[float | Decimal | Real]) -> Trace:
        """Return what happens from an admissible state, at time 0."""
        here = self._admit(self.system.arithmetic.numbers(state))
        while here is not None:
            here = self._carry(here) if here.mode is Mode.LOCKED else self._fly(here)
        return self.trace

    def _admit(self, x: State) -> _Start | None:
        system, zero = self.system, self.system.arithmetic.number(0.0)
        gap, rate = system.contact(x)[:2]
        if gap < -_CONTACT:
            message = f"Argument `state` must have a gap >= 0, but it is {float(gap):.6g}."
            raise InputError(message)
        if gap > _CONTACT:
            return _Start(mode=Mode.FREE, time=zero, state=x)
        if abs(rate) <= _CONTACT:
            return self._rest(zero, system.on_stop(x))
        return (
            _Start(mode=Mode.FREE, time=zero, state=x, speed=rate, order=1)
            if rate > 0
            else self._hit(zero, x, rate)
        )

    def _rest(self, time: Real, x: State) -> _Start:
        """Return the mode that holds on the stop at zero gap rate."""
        _, _, acceleration, _, multiplier_rate = self.system.contact(x)
        if abs(acceleration) > self.system.smallest:
            mode = Mode.LOCKED if acceleration < 0 else Mode.FREE
            return _Start(mode=mode, time=time, state=x, order=0 if acceleration < 0 else 2)
        if multiplier_rate > 0:
            return _Start(mode=Mode.LOCKED, time=time, state=x, order=1)
        return _Start(mode=Mode.FREE, time=time, state=x, order=3)

    def _carry(self, start: _Start) -> _Start | None:
        """Follow the locked flow to the release."""
        multiplier = self.system.contact(start.state).multiplier
        order, remaining = start.order, self.until - start.time
        for step in self.system.locked.steps([*start.state, multiplier], remaining):
            root = step.fall(-1, order)
            order = 0
            self._sample(step, start.time, 1, root, remaining)
            if root is not None:
                time = start.time + step.start + root
                state = self.system.on_stop(step.state(root)[:-1])
                self.trace.releases.append((time, state))
                if len(self.trace.releases) >= self.most_releases:
                    return None
                # The multiplier falls through zero, so the gap grows with the cube of time.
                return _Start(mode=Mode.FREE, time=time, state=state, order=3)
        return None

    def _fly(self, start: _Start) -> _Start | None:
        """Follow a flight, rescaled if it comes from an impact, to the next impact."""
        system, number = self.system, self.system.arithmetic.number
        if start.speed is None:
            unit, gap = number(1.0), system.contact(start.state)[:2]
            self._nodes.clear()
            if start.order > 0:
                gap = [number(0.0), number(0.0)]
        else:
            unit, gap = start.speed, [number(0.0), number(1.0)]
        system.flight.set_parameter(system.n_values, unit)
        order, remaining = start.order, (self.until - start.time) / unit
        for step in system.flight.steps([*start.state, *gap], remaining):
            root = step.fall(-2, order)
            order = 0
            self._sample(step, start.time, unit, root, remaining)
            if root is not None:
                *x, _, rate = step.state(root)
                return self._hit(start.time + unit * (step.start + root), x, unit * rate)
        return None

    def _hit(self, time: Real, x: State, approach_rate: Real) -> _Start | None:
        """Apply the reset map and return what follows it."""
        if not approach_rate < 0:
            raise SimulationError(
                f"An impact must close the gap, but the gap rate is {float(approach_rate):.3g}",
                time=float(time),
                state=tuple(float(value) for value in x),
            )
        self.trace.impacts.append((time, approach_rate))
        after, resting, speed, restitution = self.system.reset(x, approach_rate)
        if speed == 0:
            start = self._rest(time, resting)
            if start.mode is Mode.LOCKED:
                self.trace.zeno_points.append((time, resting))
            return start
        acceleration = self.system.contact(resting).gap_acceleration
        if (self._nodes and speed >= self._nodes[-1].speed) or not acceleration < 0:
            self._nodes.clear()
        if acceleration < 0:
            remaining = tail_time(speed, acceleration, restitution)
            point = [*self.system.locked_on(resting, remaining), time + remaining]
            self._nodes.append(_Node(speed=speed, point=point, gap_acceleration=acceleration))
        return self._complete(time, resting) or _Start(
            mode=Mode.FREE, time=time, state=after, order=1, speed=speed
        )

    def _complete(self, time: Real, resting: State) -> _Start | None:
        """Return the start of the locked arc if the impacts so far tell the Zeno point."""
        limit = self._limit()
        if len(self._nodes) > _MOST_IMPACTS:
            raise ChatterError(
                f"More than {_MOST_IMPACTS} impacts came without a Zeno point",
                time=float(time),
                state=tuple(float(value) for value in resting),
            )
        if limit is None or limit[-1] >= self.until:
            return None
        within = [t for t in self.times[len(self.trace.samples) :] if t < limit[-1]]
        if within and self._nodes[-1].speed > self.system.smallest:
            return None
        for t in within:
            self.trace.samples.append(self.system.locked_on(resting, t - time))
        state = self.system.on_stop(limit[:-1])
        after = self._rest(limit[-1], state)
        if after.mode is Mode.FREE:
            return None
        self.trace.zeno_points.append((limit[-1], state))
        self._nodes.clear()
        return after

    def _limit(self) -> State | None:
        """Return the Zeno point, time last, once it holds as far as its numbers do."""
        chosen = _spread(self._nodes)
        if len(chosen) < 3:
            return None
        best = _combined([self._nodes[k] for k in chosen])
        before = self._nodes[: chosen[-2] + 1]
        earlier = _combined([before[k] for k in _spread(before)])
        last = self._nodes[-1].gap_acceleration
        now = self.system.contact(best[:-1]).gap_acceleration
        if abs(now - last) > _MAY_BEND * abs(last):
            return None
        off = max(abs(a - b) / (1 + abs(a)) for a, b in zip(best, earlier, strict=True))
        return best if off <= self.system.smallest else None

    def _sample(
        self, step: SeriesStep, origin: Real, unit: Real, root: Real | None, duration: Real
    ) -> None:
        """Keep the states at the wanted times within a step, up to the guard's root."""
        last = root is None and not step.start + step.size < duration
        end = origin + unit * (step.start + (step.size if root is None else root))
        while len(self.trace.samples) < len(self.times):
            time = self.times[len(self.trace.samples)]
            if not (time < end or last):
                return
            state = step.state((time - origin) / unit - step.start)
            self.trace.samples.append(state[: self.system.n_x])


def _spread(nodes: Sequence[_Node]) -> list[int]:
    """Return which impacts to extrapolate from: the last, and faster ones well apart before."""
    chosen = [len(nodes) - 1] if nodes else []
    for k in range(len(nodes) - 2, -1, -1):
        if len(chosen) == _NODES:
            break
        if nodes[chosen[-1]].speed <= _NODE_RATIO * nodes[k].speed:
            chosen.append(k)
    return chosen[::-1]


def _combined(nodes: Sequence[_Node]) -> State:
    weights = limit_weights([node.speed for node in nodes])
    terms = zip(*(node.point for node in nodes), strict=True)
    return [sum(w * value for w, value in zip(weights, row, strict=True)) for row in terms]
