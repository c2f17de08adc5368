"""An attempt to find the attracting orbit of a motion by Newton's method (theory (4.7)).

The loop is the same on both sections. `Crossing` contains their differences.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.maps.approach import all_come_nearer, is_approached, places_on_the_way
from zeno_orbits.maps.attractors import Attractor, AttractorClass
from zeno_orbits.maps.crossings import Follower, ImpactRecord, ReleaseRecord
from zeno_orbits.maps.newton import (
    RELEASES,
    Crossing,
    DisplacedStates,
    FixedPoint,
    bundle_at,
    displaced,
    newton_step,
)
from zeno_orbits.model import HybridDynamics

_MOST_ITERATIONS = 12
_SHRINKS = 0.9
"""Largest ratio of successive Newton steps near an orbit."""
_LOCAL_ERRORS = 10.0
"""Error of a period of a motion, in units of the local error."""
SAME_PERIOD = 1e-4
"""Relative difference below which the periods at two accuracies agree."""
_LATER = 2.0
"""Relative difference of return times per unit of distance from the orbit."""
_NEAR = 0.05
"""Distance of an orbit that counts as near. The derivative is reused after a step below this part
of the multipliers' distance to 1."""
_REPELS = 1.2
"""Spectral radius: a motion does not converge to a near orbit of larger radius."""
_VANISHED = 0.02
"""An amplitude below this part of the motion's amplitude means decay to an equilibrium."""
_COARSE = 3e-4
"""After a larger Newton step, the next bundle also uses the accuracy of the motion."""
_FALLS = 0.3
"""Ratio of successive steps below which a derivative is reused once more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """Accuracy with which motions are simulated up to their attractors.

    Attributes:
        motion: Local error while a motion converges.
        orbit: Local error of the reported orbit.
        near: Largest relative change of a return with which Newton's method is tried.
        exact: Largest last step of Newton's method. The error of the orbit is about the square of
            this step, and the error of the multipliers is about the step itself.
        repeats: Change that counts as repeating if Newton's method is not available.
    """

    motion: float = 1e-8
    orbit: float = 1e-10
    near: float = 0.02
    exact: float = 2e-6
    repeats: float = 1e-7

    @property
    def reached(self) -> float:
        """Distance that the accumulated local errors of a motion can account for."""
        return _LOCAL_ERRORS * self.motion


SAME = 1e-8
"""Two releases are the same if they differ by less than this part of the period or the time limit.

Rounding has then put the start in contact.
"""


@dataclass(frozen=True, slots=True)
class NoOrbit:
    """This attempt found no orbit to which the motion converges."""


@dataclass(slots=True, kw_only=True)
class NewtonState:
    """State of Newton's method for orbits of a period.

    Attributes:
        follower: Simulator of the motions.
        accuracy: Accuracy of the simulations.
        crossing: The events that define the section.
        span: Approximate time of a period [s].
        period: Number of returns per period.
        bundle: Initial states of the lanes: a bundle, or its centre with a known `A`.
        final: True if the lanes run at the accuracy of the orbit.
        origin: The state of the motion at the start of the iteration, ``(n_x,)``.
        earlier: The state of the motion a period before, ``(n_x,)``.
        before: Length of the previous step.
        comparable: True if the next step should be shorter than the previous step.
        jacobian: Derivative from the previous bundle, for a lane without neighbours.
        iterations: Number of steps so far.
        contracts: True if the return map contracts at the start of every step, and no step reverses
            its direction.
        last_step: The last step, in scaled states, ``(n_x,)``.
        doubtful: True if the period of the motion changes at a higher accuracy.
        approached: True if the motion itself converges to the orbit.
    """

    follower: Follower
    accuracy: Accuracy
    crossing: Crossing = RELEASES
    span: float
    period: int
    bundle: DisplacedStates
    final: bool = False
    origin: Vector
    earlier: Vector
    before: float = np.inf
    comparable: bool = False
    jacobian: Vector | None = None
    iterations: int = 0
    contracts: bool = True
    last_step: Vector | None = None
    doubtful: bool = False
    approached: bool = False
    _lanes: list[list[ReleaseRecord | ImpactRecord]] = field(
        init=False, default_factory=list[list[ReleaseRecord | ImpactRecord]]
    )

    def run(self) -> Attractor | NoOrbit:
        """Return the orbit to which the motion converges, or `NoOrbit`."""
        answer: Vector | Attractor | NoOrbit = self.bundle.states
        while isinstance(answer, np.ndarray):
            error = self.accuracy.orbit if self.final else self.accuracy.motion
            lanes = self._periods(answer, error)
            if not all(lanes):
                return NoOrbit()
            self._lanes = lanes
            cycles = [self.crossing.cycle(self.dynamics, events) for events in lanes]
            try:
                point = newton_step(self.dynamics, self.bundle.section, cycles, self.jacobian)
            except (np.linalg.LinAlgError, ZenoOrbitsError):
                return NoOrbit()
            answer = self._stepped(point)
        return answer

    @property
    def dynamics(self) -> HybridDynamics:
        """The system."""
        return self.follower.dynamics

    def _periods(self, states: Vector, error: float) -> list[list[ReleaseRecord | ImpactRecord]]:
        """Return the returns of a period of the motion from each state, or an empty list."""
        if self.crossing is not RELEASES:
            return [self._impacts(state, error) for state in states]
        found = self._releases(states, error, self.period)
        for k, events in enumerate(found):
            if len(events) + 1 == self.period:
                # Rounding has put the start in contact, which adds an immediate release.
                found[k] = self._releases(states[k : k + 1], error, self.period + 1)[0]
        return [events if len(events) == self.period else [] for events in found]

    def _releases(
        self, states: Vector, error: float, count: int
    ) -> list[list[ReleaseRecord | ImpactRecord]]:
        """Return the first releases of the motion from each state, without those at the start."""
        runs = self.follower.releases(states, until=2 * self.span, error=error, count=count)
        return [[one for one in events if one.time > SAME * self.span] for events in runs]

    def _impacts(self, state: Vector, error: float) -> list[ReleaseRecord | ImpactRecord]:
        """Return the impacts of a period that begin a sequence, or an empty list."""
        found = list[ReleaseRecord | ImpactRecord]()
        for event in self.follower.crossings(state, until=2 * self.span, error=error):
            if isinstance(event, ImpactRecord) and event.time > SAME * self.span:
                found.append(event)
                if len(found) == self.period:
                    return found
        return []

    def _stepped(self, point: FixedPoint) -> Vector | Attractor | NoOrbit:
        """Continue after a Newton step: with a further step, a higher accuracy, or a conclusion."""
        accuracy = self.accuracy
        self.iterations += 1
        if not (np.all(np.isfinite(point.jacobian)) and np.isfinite(point.distance)):
            return NoOrbit()
        allowed = max(_SHRINKS * self.before, accuracy.exact) if self.comparable else np.inf
        near = point.distance < self.crossing.far and self.iterations <= _MOST_ITERATIONS
        if not (point.distance <= allowed and near):
            return NoOrbit()
        if point.distance < _NEAR and point.spectral_radius > _REPELS:
            return NoOrbit()
        if self.final and self.jacobian is None and point.distance <= accuracy.exact:
            return self._accepted(point)
        self._note_contraction(point)
        if self.contracts and self._vanishes(point):
            return Attractor(fate=AttractorClass.REST, trend=point.spectral_radius)
        straight = self._reuses(point)
        try:
            self.bundle = self._bundle_around(point, neighbours=not straight)
        except ZenoOrbitsError:
            return NoOrbit()
        final = self.final or straight or point.distance <= _COARSE
        # The fixed point depends on the accuracy, so the first step at a new accuracy is not
        # compared with the previous step.
        self.comparable = self.final == final
        self.before, self.final = point.distance, final
        self.jacobian = point.jacobian if straight else None
        return self.bundle.states

    def _reuses(self, point: FixedPoint) -> bool:
        """Return True if the next step uses the derivative of this step, at the orbit's accuracy.

        One motion then replaces a bundle. Steps with an old derivative become shorter by about the
        same factor, so two of them predict the distance that the last bundle will start from.
        """
        if self.jacobian is not None:
            falls = point.distance < _FALLS * self.before
            return falls and point.distance**2 > self.accuracy.exact * self.before
        least = min((abs(1 - value) for value in point.multipliers), default=1.0)
        near = point.distance < _NEAR * min(1.0, least)
        return near and (not self.final or point.distance > _COARSE)

    def _bundle_around(self, point: FixedPoint, *, neighbours: bool) -> DisplacedStates:
        """Return the bundle of the next step.

        Near the orbit the chart keeps its directions and only its centre moves. The derivative of
        an earlier bundle then holds in it.
        """
        section = self.bundle.section
        if point.distance < _NEAR:
            moved = replace(section, centre=point.state)
            return displaced(self.dynamics, moved, neighbours=neighbours)
        return bundle_at(self.dynamics, self.crossing.rows, point.state, section.scale)

    def _note_contraction(self, point: FixedPoint) -> None:
        """Record whether the motion may follow the path of the iteration to the orbit.

        If the return map contracts all along a straight path, the motion follows it to its end.
        """
        section = self.bundle.section
        step = (point.state - section.centre) / section.scale
        before = self.last_step
        turns = before is not None and float(step @ before) < 0.0 and point.distance > _COARSE
        self.contracts &= point.spectral_radius < 1.0 and not turns
        self.last_step = step

    def _vanishes(self, point: FixedPoint) -> bool:
        """Return True if the iteration leads to an amplitude of zero."""
        scale = self.bundle.section.scale
        left = float(np.max(np.abs(point.state) / scale))
        return left < _VANISHED * float(np.max(np.abs(self.origin) / scale))

    def _accepted(self, point: FixedPoint) -> Vector | Attractor | NoOrbit:
        """Return the orbit if it is stable and the motion converges to it."""
        if not point.spectral_radius < 1.0:
            return NoOrbit()
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
                return NoOrbit()
            if not is_approached(before, after, jacobian, self.accuracy.reached):
                places = places_on_the_way(after, jacobian)
                if not (self.contracts and len(places) and self._leads_there(point, places)):
                    return NoOrbit()
        return self._concluded(point, shorter)

    def _concluded(self, point: FixedPoint, shorter: int) -> Vector | Attractor:
        """Return the orbit of the motion, or repeat the search with fewer returns per period."""
        self.approached = True
        if shorter < self.period:
            self.period, self.comparable = shorter, False
            return self.bundle.states
        return self._orbit(point)

    def _leads_there(self, point: FixedPoint, places: Vector) -> bool:
        """Return True if returns lead to an orbit from all test points on the way to it.

        Args:
            point: The orbit.
            places: Test points relative to the orbit, in section coordinates, ``(n, m)``.
        """
        section = self.bundle.section
        centre = section.coordinates(point.state)
        try:
            states = [section.state(self.dynamics, centre + place) for place in places]
        except ZenoOrbitsError:
            return False
        lanes = self._periods(np.array(states), self.accuracy.orbit)
        if not all(lanes):
            return False
        images = np.array([section.coordinates(events[-1].state) - centre for events in lanes])
        return all_come_nearer(places, images, point.jacobian)

    def _shorter_period(self) -> int:
        """Return the smallest number of returns for which Newton's method has converged.

        The returns of the last step lie near the orbit, as its start does. A small distance between
        a return and this start is therefore not sufficient. Section coordinates alone are also not
        sufficient, since they may not exist for a distant return.
        """
        lanes = self._lanes
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
        fate = AttractorClass.ZENO if self.dynamics.restitution > 0.0 else AttractorClass.SIMPLE
        if not (releases and np.all(np.isfinite(margins))):
            fate = AttractorClass.NO_ZENO
        named = dict(zip(self.crossing.margins, margins, strict=True))
        return Attractor(
            fate=fate,
            returns=self.period if releases else 0,
            period=period,
            multipliers=point.multipliers,
            margins={name: value for name, value in named.items() if np.isfinite(value)},
            state=dict(zip(self.dynamics.state_names, point.state.tolist(), strict=True)),
        )
