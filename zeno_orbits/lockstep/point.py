"""One point of a map as it follows its motion: what it asks of the batch, what it concludes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zeno_orbits.attractors import Attractor, Fate
from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.lockstep.events import Ended, Event, Reason, Released, Struck
from zeno_orbits.lockstep.newton import (
    MARGINS,
    Bundle,
    FixedPoint,
    bundle_at,
    cycle_of,
    newton_step,
)
from zeno_orbits.lockstep.returns import Growth, changes, growth_of, scale_of

_AT_ONCE = 1e-6
"""A release that soon after the last one [s] is the same: rounding locked the start."""

_REMEMBERED = 40
"""Returns that are looked back on."""
_RECENT = 8
"""Returns that tell the size of each state."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """How accurately motions are followed to what they settle to.

    Attributes:
        motion: Local error while a motion settles.
        orbit: Local error of the orbit that is reported.
        near: Change of a return up to which Newton's method is tried, relative.
        far: Longest step of Newton's method from the motion, relative; the orbit has to be here.
        exact: Last step of Newton's method; what remains is its square, the multipliers' error
            itself.
        repeats: Change that counts as repeating where Newton's method is not available.
    """

    motion: float = 1e-6
    orbit: float = 1e-8
    near: float = 0.02
    far: float = 0.8
    exact: float = 2e-6
    repeats: float = 1e-7


_DISTINCT = 1e-3
"""States nearer than this are taken for one another, relative."""


class Request(NamedTuple):
    """Lanes that a point asks for, in place of those it has.

    Attributes:
        states: Where they start, ``(n, n_x)``; the first leads the others.
        tolerance: Local error.
        released: Whether they start at a release.
        until: How long they run [s].
    """

    states: Vector
    tolerance: float
    released: bool
    until: float


@dataclass(slots=True, kw_only=True)
class _Attempt:
    """Newton's method under way for orbits of a period.

    Attributes:
        period: Returns a period.
        bundle: Where its lanes started.
        final: Whether they run at the accuracy of the orbit.
        origin: The release of the motion from which it started, ``(n_x,)``.
        earlier: That a period before, ``(n_x,)``.
        before: Length of the step before; the first is allowed anything.
        jacobian: Derivative from the bundle before, for a lane without neighbours.
        returns: Releases of each lane so far.
        iterations: Steps made.
        contracts: Whether the return map contracts wherever a step began, and none turned back.
        last_step: The last step, in scaled states, ``(n_x,)``.
    """

    period: int
    bundle: Bundle
    final: bool
    origin: Vector
    earlier: Vector
    before: float = np.inf
    jacobian: Vector | None = None
    returns: dict[int, list[Released]]
    iterations: int = 0
    contracts: bool = True
    last_step: Vector | None = None


_MOST_ITERATIONS = 12
_SHRINKS = 0.9
"""Newton's steps shrink at least by this, or the orbit is not near."""
_STRAIGHT = 0.05
"""Step over the distance of the multipliers from 1 up to which the derivative serves again."""
_AGREES = 0.5
"""Part by which the motion's last step may differ from what the derivative at the orbit says."""
_MUCH_NEARER, _LATER = 0.3, 8
"""Newton's method is tried again if a motion is this much nearer, or this many returns later."""
_NEAR, _REPELS = 0.05, 1.2
"""An orbit this near with multipliers beyond this is not one that the motion goes to."""
_VANISHED = 0.02
"""Part of its amplitude that an orbit would have that is none: the motion dies out."""
_PATIENCE = 4
"""Failures of Newton's method after which a motion that has come nearer has to wait like others."""
_APART = 0.2
"""A motion repeats after more returns only if it is that much nearer after them than before."""


class Point:
    """A motion that settles; it is told events and answers with requests or a conclusion."""

    def __init__(
        self, dynamics: HybridDynamics, start: Vector, until: float, accuracy: Accuracy
    ) -> None:
        self._dynamics = dynamics
        self._start = start
        self._until = until
        self._accuracy = accuracy
        self._origin = 0.0
        self._tolerance = accuracy.motion
        self._returns: list[tuple[float, Vector]] = []
        self._strikes: list[tuple[float, Vector, float]] = []
        self._amplitudes: list[float] = []
        self._unit: Vector | None = None
        self._failures = 0
        self._tried: dict[int, tuple[float, int]] = {}
        self._attempt: _Attempt | None = None

    def begin(self) -> Request:
        """Return the first lane to run."""
        return Request(self._start[None, :], self._tolerance, False, self._until)

    def hear(self, rank: int, event: Event) -> Request | Attractor | None:
        """Take an event of one of the point's lanes.

        Args:
            rank: Which of the lanes it asked for last.
            event: What happened to it.

        Returns:
            Other lanes to run in place of these, or the conclusion, or nothing to go on.
        """
        if self._attempt is not None:
            return self._hear_attempt(self._attempt, rank, event)
        time = self._origin + event.time
        if isinstance(event, Ended):
            return self._ended(event)
        if isinstance(event, Struck):
            return self._struck(event, time)
        if self._returns and time - self._returns[-1][0] < _AT_ONCE:
            return None
        return self._returned(time, event.state)

    def _returned(self, time: float, state: Vector) -> Request | Attractor | None:
        """Look back from a new release."""
        self._strikes.clear()
        self._returns.append((time, state))
        del self._returns[:-_REMEMBERED]
        if self._unit is None:
            self._unit = scale_of([state], self._dynamics.n_q)
        self._amplitudes.append(float(np.max(np.abs(state) / self._unit)))
        if len(self._returns) < 2:
            return None
        states = [x for _, x in self._returns]
        growth = growth_of(self._amplitudes)
        if growth.dies_out:
            return Attractor(fate=Fate.REST, trend=growth.factor)
        scale = scale_of(states[-_RECENT:], self._dynamics.n_q)
        nearest = np.inf
        for period, change in changes(states, scale).items():
            if change < _APART * nearest and self._is_worth_it(period, change):
                return self._begin_attempt(period, change, scale)
            nearest = min(nearest, change)
        return None

    def _is_worth_it(self, period: int, change: float) -> bool:
        """Tell whether Newton's method may reach an orbit, if it did not the last time."""
        if change >= self._accuracy.near:
            return False
        before, at = self._tried.get(period, (np.inf, -np.inf))
        # A motion that never settles comes near many orbits: it is looked at ever less often.
        later = len(self._amplitudes) >= at + _LATER * 2 ** max(self._failures - 1, 0)
        return later or (change < _MUCH_NEARER * before and self._failures < _PATIENCE)

    def _begin_attempt(self, period: int, change: float, scale: Vector) -> Request | None:
        self._tried[period] = change, len(self._amplitudes)
        _, state = self._returns[-1]
        bundle = bundle_at(self._dynamics, state, scale)
        if not np.all(np.isfinite(bundle.states)):
            return None
        self._attempt = _Attempt(
            period=period,
            bundle=bundle,
            final=False,
            origin=state,
            earlier=self._returns[-1 - period][1],
            returns={},
        )
        return self._request(self._attempt, neighbours=True)

    def _request(self, attempt: _Attempt, *, neighbours: bool) -> Request:
        accuracy = self._accuracy
        states = attempt.bundle.states if neighbours else attempt.bundle.states[:1]
        attempt.returns = {rank: [] for rank in range(len(states))}
        span = self._returns[-1][0] - self._returns[-1 - attempt.period][0]
        tolerance = accuracy.orbit if attempt.final else accuracy.motion
        return Request(states, tolerance, True, 2 * span)

    def _hear_attempt(
        self, attempt: _Attempt, rank: int, event: Event
    ) -> Request | Attractor | None:
        if isinstance(event, Ended):
            return self._give_up()
        if not isinstance(event, Released):
            return None
        returns = attempt.returns[rank]
        if len(returns) < attempt.period and event.time > _AT_ONCE:
            returns.append(event)
        if any(len(events) < attempt.period for events in attempt.returns.values()):
            return None
        cycles = [cycle_of(self._dynamics, attempt.returns[k]) for k in sorted(attempt.returns)]
        try:
            point = newton_step(self._dynamics, attempt.bundle.section, cycles, attempt.jacobian)
        except (np.linalg.LinAlgError, ZenoOrbitsError):
            return self._give_up()
        return self._stepped(attempt, point)

    def _stepped(self, attempt: _Attempt, point: FixedPoint) -> Request | Attractor | None:
        """Go on from a step of Newton's method: again, more accurately, or to a conclusion."""
        accuracy = self._accuracy
        attempt.iterations += 1
        if not (np.all(np.isfinite(point.jacobian)) and np.isfinite(point.distance)):
            return self._give_up()
        shrinks = point.distance <= max(_SHRINKS * attempt.before, accuracy.exact)
        near = point.distance < accuracy.far and attempt.iterations <= _MOST_ITERATIONS
        if not (shrinks and near):
            return self._give_up()
        if point.distance < _NEAR and point.spectral_radius > _REPELS:
            return self._give_up()
        if attempt.final and point.distance <= accuracy.exact:
            return self._accepted(attempt, point)
        self._look_along(attempt, point)
        if attempt.contracts and self._vanishes(attempt, point):
            return Attractor(fate=Fate.REST, trend=point.spectral_radius)
        coarse = not attempt.final and point.distance > _COARSE
        least = min((abs(1 - value) for value in point.multipliers), default=1.0)
        straight = coarse and point.distance < _STRAIGHT * least
        scale = attempt.bundle.section.scale
        attempt.bundle = bundle_at(self._dynamics, point.state, scale)
        attempt.before = point.distance
        attempt.final = not coarse
        attempt.jacobian = point.jacobian if straight else None
        return self._request(attempt, neighbours=not straight)

    def _look_along(self, attempt: _Attempt, point: FixedPoint) -> None:
        """Note whether the way to the orbit so far is one that the motion takes as well.

        Where the return map contracts all along a straight way, the motion follows it to its end.
        """
        section = attempt.bundle.section
        step = (point.state - section.centre) / section.scale
        before = attempt.last_step
        turns = before is not None and float(step @ before) < 0.0 and point.distance > _COARSE
        attempt.contracts &= point.spectral_radius < 1.0 and not turns
        attempt.last_step = step

    def _vanishes(self, attempt: _Attempt, point: FixedPoint) -> bool:
        """Tell whether the way leads to an amplitude of zero."""
        scale = attempt.bundle.section.scale
        left = float(np.max(np.abs(point.state) / scale))
        return left < _VANISHED * float(np.max(np.abs(attempt.origin) / scale))

    def _accepted(self, attempt: _Attempt, point: FixedPoint) -> Request | Attractor:
        """Return the orbit if it attracts and the motion is on its way to it."""
        shorter = self._shorter_period(attempt)
        leads_there = attempt.contracts or self._is_approached(attempt, point)
        if not (point.spectral_radius < 1.0 and leads_there):
            return self._give_up()
        if shorter < attempt.period:
            attempt.period, attempt.before = shorter, np.inf
            attempt.earlier = attempt.origin
            return self._request(attempt, neighbours=True)
        return self._orbit(attempt, point)

    def _shorter_period(self, attempt: _Attempt) -> int:
        """Return after how many returns the orbit repeats already."""
        state, scale = attempt.bundle.section.centre, attempt.bundle.section.scale
        for period, event in enumerate(attempt.returns[0], start=1):
            away = float(np.max(np.abs(event.state - state) / scale))
            if attempt.period % period == 0 and away < self._accuracy.repeats:
                return period
        return attempt.period

    def _is_approached(self, attempt: _Attempt, point: FixedPoint) -> bool:
        """Tell whether the last step of the motion was the one that leads to the orbit."""
        section = attempt.bundle.section
        centre = section.coordinates(point.state)
        before = section.coordinates(attempt.earlier) - centre
        after = section.coordinates(attempt.origin) - centre
        expected = point.jacobian @ before
        miss = float(np.max(np.abs(after - expected), initial=0.0))
        step = float(np.max(np.abs(before - expected), initial=0.0))
        return miss <= max(_AGREES * step, self._accuracy.repeats)

    def _give_up(self) -> Request:
        """Return to the motion, from its last release on."""
        self._attempt = None
        self._failures += 1
        time, state = self._returns[-1]
        self._origin = time
        return Request(state[None, :], self._tolerance, True, self._until - time)

    def _orbit(self, attempt: _Attempt, point: FixedPoint) -> Attractor:
        period, *margins = point.numbers.tolist()
        fate = Fate.ZENO if self._dynamics.restitution > 0.0 else Fate.SIMPLE
        if not np.all(np.isfinite(margins)):
            fate = Fate.NO_ZENO
        named = dict(zip(MARGINS, margins, strict=True))
        return Attractor(
            fate=fate,
            returns=attempt.period,
            period=period,
            multipliers=point.multipliers,
            margins={name: value for name, value in named.items() if np.isfinite(value)},
            state=self._named(point.state),
        )

    def _named(self, state: Vector) -> dict[str, float]:
        return dict(zip(self._dynamics.state_names, state.tolist(), strict=True))

    def _struck(self, event: Struck, time: float) -> Request | Attractor | None:
        """Look back from the first impact of a sequence, where no release comes."""
        self._strikes.append((time, event.state, event.rate))
        del self._strikes[:-_REMEMBERED]
        if len(self._strikes) < _RECENT:
            return None
        states = [x for _, x, _ in self._strikes]
        scale = scale_of(states[-_RECENT:], self._dynamics.n_q)
        for period, change in changes(states, scale).items():
            earlier = changes(states[:-period], scale).get(period, np.inf)
            repeats = self._accuracy.repeats
            if change < repeats and earlier < 10 * repeats:
                return self._repeated(period)
            if change < _DISTINCT:
                # It is on its way to repeat after so many; more would repeat that.
                return None
        return None

    def _repeated(self, period: int) -> Request | Attractor:
        """Go on more accurately from impacts that repeat, then conclude."""
        if self._tolerance == self._accuracy.orbit:
            return self._without_zeno(period)
        time, state, _ = self._strikes[-1]
        self._tolerance, self._origin = self._accuracy.orbit, time
        self._strikes.clear()
        # The state is on the stop and leaves it, as after a release.
        return Request(state[None, :], self._tolerance, True, self._until - time)

    def _without_zeno(self, period: int) -> Attractor:
        last, first = self._strikes[-1], self._strikes[-1 - period]
        rates = [rate for _, _, rate in self._strikes[-period:]]
        return Attractor(
            fate=Fate.NO_ZENO,
            period=last[0] - first[0],
            margins={"first_impact_speed": min(-rate for rate in rates)},
            state=self._named(last[1]),
        )

    def _ended(self, event: Ended) -> Attractor:
        if event.reason is Reason.FAILURE:
            return Attractor(fate=Fate.FAILED, detail=event.detail, state=self._named(event.state))
        if event.reason is Reason.ESCAPE:
            return Attractor(fate=Fate.ESCAPE, escaped=event.detail)
        if event.reason is Reason.REST:
            return Attractor(fate=Fate.REST)
        growth = (
            growth_of(self._amplitudes)
            if self._amplitudes
            else Growth(factor=float("nan"), dies_out=False)
        )
        reason = "" if self._amplitudes else "no release comes"
        return Attractor(fate=Fate.UNSETTLED, trend=growth.factor, detail=reason)


_COARSE = 3e-4
"""Newton's steps above this are repeated at the accuracy of the motion first."""
