"""An attempt at the orbit that a motion goes to, by Newton's method (theory (29)).

The loop is the same on both sections; `Crossing` says what differs.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.maps.approach import all_come_nearer, is_approached, places_on_the_way
from zeno_orbits.maps.attractors import Attractor, Fate
from zeno_orbits.maps.newton import (
    RELEASES,
    Crossing,
    DisplacedStates,
    FixedPoint,
    bundle_at,
    newton_step,
)
from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation import Ended, LaneEvent, Released, Struck

_MOST_ITERATIONS = 12
_SHRINKS = 0.9
"""Newton's steps shrink at least by this, or the orbit is not near."""
_STRAIGHT = 0.05
"""Step over the distance of the multipliers from 1 up to which the derivative serves again."""
_LOCAL_ERRORS = 10.0
"""Local errors that a period of a motion adds up to."""
SAME_PERIOD = 1e-4
"""Relative difference of times up to which two accuracies tell the same period."""
_LATER = 2.0
"""Relative difference of the time of a return, for a unit of the distance from the orbit."""
_NEAR, _REPELS = 0.05, 1.2
"""An orbit this near with multipliers beyond this is not one that the motion goes to."""
_VANISHED = 0.02
"""Part of the amplitude below which there is no orbit: the motion dies out."""
_COARSE = 3e-4
"""Newton's steps above this are repeated at the accuracy of the motion first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """Accuracy with which motions are followed to their attractors.

    Attributes:
        motion: Local error while a motion settles.
        orbit: Local error of the orbit that is reported.
        near: Change of a return up to which Newton's method is tried, relative.
        exact: Last step of Newton's method; what remains is its square, the multipliers' error
            itself.
        repeats: Change that counts as repeating where Newton's method is not available.
    """

    motion: float = 1e-6
    orbit: float = 1e-8
    near: float = 0.02
    exact: float = 2e-6
    repeats: float = 1e-7

    @property
    def reached(self) -> float:
        """Distance of a motion from its orbit that its local errors do not tell from none."""
        return _LOCAL_ERRORS * self.motion


class Request(NamedTuple):
    """Lanes that a point asks for, in place of those it has.

    Attributes:
        states: Where they start, ``(n, n_x)``.
        tolerance: Local error.
        released: Whether they start at a release.
        until: How long they run [s].
        led: Whether the first leads the others.
    """

    states: Vector
    tolerance: float
    released: bool
    until: float
    led: bool = True


SAME = 1e-8
"""A release that soon after the last one, for a unit of the time given, is the same one.

Rounding has locked the start.
"""


@dataclass(frozen=True, slots=True)
class Lost:
    """There is no orbit that the motion goes to, as far as this attempt tells."""


class _Look(NamedTuple):
    """A look along the way from the motion to an orbit.

    Attributes:
        point: The orbit.
        places: Places on the way whose returns are waited for, from the orbit, ``(n, m)``.
        shorter: Returns after which the orbit repeats.
    """

    point: FixedPoint
    places: Vector
    shorter: int


@dataclass(slots=True, kw_only=True)
class Attempt:
    """Newton's method under way for orbits of a period.

    Attributes:
        dynamics: The system.
        accuracy: How accurately.
        crossing: The events that make its section.
        span: Time of a period, about [s].
        period: Returns a period.
        bundle: Where its lanes started.
        final: Whether they run at the accuracy of the orbit.
        origin: The state of the motion from which it started, ``(n_x,)``.
        earlier: That a period before, ``(n_x,)``.
        before: Length of the step before; the first is allowed anything.
        jacobian: Derivative from the bundle before, for a lane without neighbours.
        returns: Events of the section on each lane so far.
        iterations: Steps made.
        contracts: Whether the return map contracts wherever a step began, and none turned back.
        last_step: The last step, in scaled states, ``(n_x,)``.
        look: What returns are waited for once Newton's method is at its end.
        doubtful: Whether the motion took another time than it takes more accurately.
        approached: Whether the motion itself is known to be on its way to the orbit.
    """

    dynamics: HybridDynamics
    accuracy: Accuracy
    crossing: Crossing = RELEASES
    span: float
    period: int
    bundle: DisplacedStates
    final: bool = False
    origin: Vector
    earlier: Vector
    before: float = np.inf
    jacobian: Vector | None = None
    returns: dict[int, list[Released | Struck]] = field(
        default_factory=dict[int, list[Released | Struck]]
    )
    iterations: int = 0
    contracts: bool = True
    last_step: Vector | None = None
    look: _Look | None = None
    doubtful: bool = False
    approached: bool = False

    def request(self, *, neighbours: bool) -> Request:
        """Return the lanes of the next step: the bundle, or its leader where `A` is known."""
        accuracy = self.accuracy
        states = self.bundle.states if neighbours else self.bundle.states[:1]
        self.returns = {rank: [] for rank in range(len(states))}
        tolerance = accuracy.orbit if self.final else accuracy.motion
        return Request(states, tolerance, True, 2 * self.span)

    def hear(self, rank: int, event: LaneEvent) -> Request | Attractor | Lost | None:
        """Take an event of one of the lanes; once all have returned, make a step."""
        if isinstance(event, Ended):
            return Lost()
        if not isinstance(event, self.crossing.event):
            return None
        returns = self.returns[rank]
        if len(returns) < self.period and event.time > SAME * self.span:
            returns.append(event)
        if any(len(events) < self.period for events in self.returns.values()):
            return None
        if self.look is not None:
            return self._looked(self.look)
        cycles = [self.crossing.cycle(self.dynamics, self.returns[k]) for k in sorted(self.returns)]
        try:
            point = newton_step(self.dynamics, self.bundle.section, cycles, self.jacobian)
        except (np.linalg.LinAlgError, ZenoOrbitsError):
            return Lost()
        return self._stepped(point)

    def _stepped(self, point: FixedPoint) -> Request | Attractor | Lost | None:
        """Go on from a step of Newton's method: again, more accurately, or to a conclusion."""
        accuracy = self.accuracy
        self.iterations += 1
        if not (np.all(np.isfinite(point.jacobian)) and np.isfinite(point.distance)):
            return Lost()
        shrinks = point.distance <= max(_SHRINKS * self.before, accuracy.exact)
        near = point.distance < self.crossing.far and self.iterations <= _MOST_ITERATIONS
        if not (shrinks and near):
            return Lost()
        if point.distance < _NEAR and point.spectral_radius > _REPELS:
            return Lost()
        if self.final and point.distance <= accuracy.exact:
            return self._accepted(point)
        self._note_contraction(point)
        if self.contracts and self._vanishes(point):
            return Attractor(fate=Fate.REST, trend=point.spectral_radius)
        coarse = not self.final and point.distance > _COARSE
        least = min((abs(1 - value) for value in point.multipliers), default=1.0)
        straight = coarse and point.distance < _STRAIGHT * least
        try:
            scale = self.bundle.section.scale
            self.bundle = bundle_at(self.dynamics, self.crossing.rows, point.state, scale)
        except ZenoOrbitsError:
            return Lost()
        # The fixed point moves with the accuracy: the first step at another one says nothing.
        self.before = point.distance if self.final != coarse else np.inf
        self.final = not coarse
        self.jacobian = point.jacobian if straight else None
        return self.request(neighbours=not straight)

    def _note_contraction(self, point: FixedPoint) -> None:
        """Note whether the way to the orbit so far is one that the motion takes as well.

        Where the return map contracts all along a straight way, the motion follows it to its end.
        """
        section = self.bundle.section
        step = (point.state - section.centre) / section.scale
        before = self.last_step
        turns = before is not None and float(step @ before) < 0.0 and point.distance > _COARSE
        self.contracts &= point.spectral_radius < 1.0 and not turns
        self.last_step = step

    def _vanishes(self, point: FixedPoint) -> bool:
        """Return True if the way leads to an amplitude of zero."""
        scale = self.bundle.section.scale
        left = float(np.max(np.abs(point.state) / scale))
        return left < _VANISHED * float(np.max(np.abs(self.origin) / scale))

    def _accepted(self, point: FixedPoint) -> Request | Attractor | Lost:
        """Return the orbit if it attracts and the motion is on its way to it."""
        if not point.spectral_radius < 1.0:
            return Lost()
        shorter = self._shorter_period()
        if not self.approached:
            section, jacobian = self.bundle.section, point.jacobian
            centre = section.coordinates(point.state)
            before = section.coordinates(self.earlier) - centre
            after = section.coordinates(self.origin) - centre
            away = float(np.max(np.abs([before, after]), initial=0.0))
            late = abs(float(point.numbers[0]) - self.span)
            close = max(SAME_PERIOD, self.accuracy.reached, _LATER * away)
            self.doubtful = late > close * self.span
            if self.doubtful and not self.accuracy.motion > self.accuracy.orbit:
                return Lost()
            if not is_approached(before, after, jacobian, self.accuracy.reached):
                places = places_on_the_way(after, jacobian)
                return self._look_along_the_way(_Look(point, places, shorter))
        return self._concluded(point, shorter)

    def _concluded(self, point: FixedPoint, shorter: int) -> Request | Attractor:
        """Return the orbit that the motion goes to, or look for it again after fewer returns."""
        self.approached = True
        if shorter < self.period:
            self.period, self.before = shorter, np.inf
            return self.request(neighbours=True)
        return self._orbit(point)

    def _look_along_the_way(self, look: _Look) -> Request | Lost:
        """Ask for returns from between the motion and the orbit, where it would take long."""
        if not (self.contracts and len(look.places)):
            return Lost()
        section = self.bundle.section
        rows = section.coordinates(look.point.state) + look.places
        try:
            states = np.array([section.state(self.dynamics, row) for row in rows])
        except ZenoOrbitsError:
            return Lost()
        self.look = look
        self.returns = {rank: [] for rank in range(len(states))}
        return Request(states, self.accuracy.orbit, True, 2 * self.span, led=False)

    def _looked(self, look: _Look) -> Request | Attractor | Lost:
        """Return the orbit if returns lead to it from all the way."""
        section = self.bundle.section
        centre = section.coordinates(look.point.state)
        ends = [self.returns[rank][-1].state for rank in sorted(self.returns)]
        images = np.array([section.coordinates(end) - centre for end in ends])
        if not all_come_nearer(look.places, images, look.point.jacobian):
            return Lost()
        self.look = None
        return self._concluded(look.point, look.shorter)

    def _shorter_period(self) -> int:
        """Return after how many returns Newton's method is at its end already.

        The returns of the last step lie beside the orbit, as its start did: that one is near that
        start does not tell alone. Nor do coordinates: of a return from elsewhere there may be none.
        """
        lanes = [self.returns[rank] for rank in sorted(self.returns)]
        start, scale = self.bundle.section.centre, self.bundle.section.scale
        for period in range(1, self.period):
            away = float(np.max(np.abs(lanes[0][period - 1].state - start) / scale))
            if self.period % period or not away < self.accuracy.near:
                continue
            cycles = [self.crossing.cycle(self.dynamics, events[:period]) for events in lanes]
            try:
                point = newton_step(self.dynamics, self.bundle.section, cycles, None)
            except (np.linalg.LinAlgError, ZenoOrbitsError):
                continue
            if point.distance <= self.accuracy.exact:
                return period
        return self.period

    def _orbit(self, point: FixedPoint) -> Attractor:
        period, *margins = point.numbers.tolist()
        releases = self.crossing is RELEASES
        fate = Fate.ZENO if self.dynamics.restitution > 0.0 else Fate.SIMPLE
        if not (releases and np.all(np.isfinite(margins))):
            fate = Fate.NO_ZENO
        named = dict(zip(self.crossing.margins, margins, strict=True))
        return Attractor(
            fate=fate,
            returns=self.period if releases else 0,
            period=period,
            multipliers=point.multipliers,
            margins={name: value for name, value in named.items() if np.isfinite(value)},
            state=dict(zip(self.dynamics.state_names, point.state.tolist(), strict=True)),
        )
