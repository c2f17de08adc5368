"""A flat follower on a turning cam, by flights and contacts in 40 digits.

The lift of a flat follower on a cam of circular arcs is ``c . u + rho`` on the arc with centre `c`
and radius `rho`, whose normal is `u`. A falling follower meets the cam no sooner than under
the greatest acceleration of the gap, so steps to that instant pass no impact, and near an impact
they are the steps of Newton's method.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from mpmath import mp, mpf

DIGITS = 40
_SOON = mpf(10) ** -25
_SLOW = mpf(10) ** -10
"""Speed of a rebound from which on the rest of the bouncing is a geometric series [m/s]."""

Curve = Callable[[mpf], mpf]


@dataclass(frozen=True, slots=True)
class Arc:
    """A part of the lift over the time in a turn, whose acceleration is monotone."""

    start: mpf
    lift: Curve
    rate: Curve
    acceleration: Curve


@dataclass(slots=True)
class Course:
    """Times at which the follower leaves the cam, strikes it, and ends its bouncing."""

    releases: list[mpf] = field(default_factory=list)
    impacts: list[mpf] = field(default_factory=list)
    zeno_points: list[mpf] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Cam:
    """A cam that turns at constant speed below a follower.

    Attributes:
        arcs: Parts of the lift, in the order of their starts; the first one starts at zero.
        turn: Time of a turn [s].
        gravity: Gravity [m/s^2].
        steepest: Bound of the acceleration of the lift [m/s^2].
    """

    arcs: Sequence[Arc]
    turn: mpf
    gravity: mpf
    steepest: mpf

    def at(self, time: mpf) -> tuple[Arc, mpf]:
        """Return the arc at a time, and the time in the turn."""
        within = time - self.turn * mp.floor(time / self.turn)
        starts = [one.start for one in self.arcs]
        return self.arcs[bisect_right(starts, within) - 1], within

    def follow(self, until: float, restitution: float) -> Course:
        """Return the course of a follower that rests on the cam at first."""
        with mp.workdps(DIGITS):
            course, t, e = Course(), mpf(0), mpf(restitution)
            while True:
                t = self._release(t, until)
                if t > until:
                    return course
                course.releases.append(t)
                t = self._bounced(t, e, until, course)
                if t > until:
                    return course
                course.zeno_points.append(t)

    def _bounced(self, t: mpf, e: mpf, until: float, course: Course) -> mpf:
        """Return the end of the bouncing after a release."""
        arc, s = self.at(t)
        place, speed = arc.lift(s), arc.rate(s)
        while True:
            t, place, speed = self._impact(t, place, speed)
            if t > until:
                return t
            course.impacts.append(t)
            arc, s = self.at(t)
            rebound = e * (arc.rate(s) - speed)
            if rebound < _SLOW:
                return t + 2 * rebound / (self._pressure(arc, s) * (1 - e))
            place, speed = arc.lift(s), arc.rate(s) + rebound

    def _impact(self, t: mpf, place: mpf, speed: mpf) -> tuple[mpf, mpf, mpf]:
        """Return time, place and speed at which a falling follower meets the cam."""
        bound, dt, far = self.gravity + self.steepest, mp.inf, mpf(10) ** -5
        while abs(dt) > _SOON:
            arc, s = self.at(t)
            gap, rate = place - arc.lift(s), speed - arc.rate(s)
            # At a release the pressure vanishes, so the gap grows with the third power of the time.
            away = (rate + mp.sqrt(rate**2 + 2 * bound * gap)) / bound
            dt = far if gap == 0 and rate == 0 else away
            place += speed * dt - self.gravity * dt**2 / 2
            speed -= self.gravity * dt
            t += dt
        return t, place, speed

    def _release(self, t: mpf, until: float) -> mpf:
        """Return the next time at which the cam no longer presses, or one after the end."""
        arc, s = self.at(t)
        turns, k = t - s, self.arcs.index(arc)
        while turns + s <= until:
            arc, last = self.arcs[k], k + 1 == len(self.arcs)
            end = self.turn if last else self.arcs[k + 1].start
            if self._pressure(arc, s) <= 0:
                return turns + s
            if self._pressure(arc, end) < 0:
                return turns + self._pressure_ends(arc, s, end)
            turns, k, s = (turns + self.turn, 0, mpf(0)) if last else (turns, k + 1, end)
        return turns + s

    def _pressure(self, arc: Arc, s: mpf) -> mpf:
        """Return the acceleration with which the cam presses."""
        return self.gravity + arc.acceleration(s)

    def _pressure_ends(self, arc: Arc, low: mpf, high: mpf) -> mpf:
        """Return the time on an arc at which its pressure ends, by halving."""
        while high - low > _SOON:
            middle = (low + high) / 2
            low, high = (middle, high) if self._pressure(arc, middle) > 0 else (low, middle)
        return high
