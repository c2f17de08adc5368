r"""Enclosure of one period in polynomials of the start coordinates.

A polynomial set is :math:`z(s) \in p(s) + Q [-r, r]` over :math:`s \in [-1, 1]^D`. Only the small
remainder travels with an enclosed derivative, in a frame `Q` that turns with the flow, so boxes may
be larger by orders of magnitude than those of an enclosed derivative over the whole box. Durations
of steps are polynomials too: all motions of a phase reach its event after the same number of
steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from flint import arb

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ProofError
from zeno_orbits.proof.arithmetic.balls import UNIT, ZERO, Ball, Matrix, matrix
from zeno_orbits.proof.arithmetic.polynomials import Basis, Polynomial, PolynomialSeries
from zeno_orbits.proof.arithmetic.program import BallProgram
from zeno_orbits.proof.integration.ball_system import BallSystem, require_proved
from zeno_orbits.proof.integration.events import polydisc
from zeno_orbits.proof.integration.flow import BallFlow, FlowSeries, FlowStep, enclose
from zeno_orbits.proof.integration.section import SectionStart
from zeno_orbits.proof.integration.sets import Departure, balanced, orthogonal
from zeno_orbits.proof.integration.walk import Tell, contact_reason, excess_of, is_clear

_ORDERS = (20, 12)
_LOW_DEGREE = 2
"""Degree of the enclosure of a derivative, which only moves the small remainder."""
_REST, _DERIVATIVE_REST = 1e-12, 1e-5
"""Largest remainder of a step for a point and for the derivative, relative to their sizes."""
_WIDER, _NEW_WIDER = 1 + 1e-3, 2.0
"""Factors of propagated and new remainders, so that the checker's arithmetic confirms them."""
_REST_WIDER = 8.0
"""Factor of Taylor remainders of points: the checker's a-priori box is another box."""
_LEAST = 4e-15
"""Rounding of doubles, relative to the states before and after a record."""
_SLOWEST = 1e-13
"""Gap rate below which the Zeno tail replaces the remaining impacts, relative to the fastest."""
_CLOSE = 1.25
"""Longest step of a crossing, relative to the usual step."""
_SHORTEST = 1e-5
"""Smallest step, relative to the longest step and the phase."""
_SPARE_TIME = 1 + 2.0**-4
_NEWTON_STEPS = 6


class PolynomialFlow:
    """A flow with its derivative, for series of polynomials."""

    def __init__(self, system: BallSystem, rate: ca.SX, ball: BallFlow) -> None:
        """Translate a flow.

        Args:
            system: The problem.
            rate: ``f``, ``(n,)``.
            ball: The same flow in balls.
        """
        e, n = system.expressions, system.n
        self.n, self.ball = n, ball
        V = ca.SX.sym("V", n, n)
        slopes = ca.jacobian(rate, e.states)
        moved = ca.vec(ca.mtimes(slopes, V).T)
        both = ca.vertcat(e.states, ca.vec(V.T))
        self._point = _program(e.states, e.numbers, rate, system.numbers, n)
        self._both = _program(both, e.numbers, ca.vertcat(rate, moved), system.numbers, n + n * n)

    def point(self, x: Sequence[Polynomial], order: int) -> list[Any]:
        """Return the series of the motions from states, ``(n,)``."""
        basis = x[0].basis
        found = self._point.flow_series(x, order, lambda: PolynomialSeries(basis, order + 1))
        return found[: self.n]

    def both(self, x: Sequence[Polynomial], order: int) -> list[Any]:
        """Return the series of the motions and of their derivative by rows, ``(n + n * n,)``."""
        basis, n = x[0].basis, self.n
        eye = [Polynomial.constant(basis, float(k % (n + 1) == 0)) for k in range(n * n)]
        series = self._both.flow_series(
            [*x, *eye], order, lambda: PolynomialSeries(basis, order + 1)
        )
        return series[: n + n * n]


def _program(
    states: ca.SX, numbers: ca.SX, rate: ca.SX, values: Sequence[Ball], n_flow: int
) -> BallProgram:
    function = ca.Function("flow", [states, numbers], [ca.densify(rate)], {"cse": True})
    return BallProgram(function, values, n_flow=n_flow)


@dataclass(frozen=True, slots=True, kw_only=True)
class PolynomialSet:
    """States over a box of start coordinates.

    Attributes:
        p: The polynomials, ``(n,)``, without remainders.
        frame: `Q`, ``(n, n)``.
        r: Radii of the remainder in the frame, ``(n,)``.
    """

    p: list[Polynomial]
    frame: Vector
    r: Vector

    @property
    def noise(self) -> Vector:
        """Bound of the remainder, ``(n,)``."""
        return np.abs(self.frame) @ self.r

    @property
    def wide(self) -> list[Polynomial]:
        """The states with their remainders, ``(n,)``."""
        return [one.wider(float(r)) for one, r in zip(self.p, self.noise, strict=True)]

    @property
    def box(self) -> list[Ball]:
        """All states, ``(n,)``."""
        return [one.ball for one in self.wide]

    def mapped(
        self, image: Sequence[Polynomial], slopes: Matrix, rows: Sequence[int], metric: Vector
    ) -> PolynomialSet:
        """Return the set after a map.

        Args:
            image: Image of ``p``, with remainders, ``(n,)``.
            slopes: Derivative of the map over the whole set, ``(n, n)``.
            rows: Rows that share a frame. The other rows keep their axes.
            metric: Unit of each state in which directions are orthogonal, ``(n,)``.
        """
        n, basis = len(self.p), self.p[0].basis
        mids = np.array([[float(slopes[i, j].mid()) for j in range(n)] for i in range(n)])
        rads = np.array([[float(slopes[i, j].rad()) for j in range(n)] for i in range(n)])
        moved = mids @ self.frame
        frame, rows = np.eye(n), list(rows)
        directions = moved * self.r / metric[:, None]
        frame[np.ix_(rows, rows)] = metric[rows, None] * orthogonal(directions[rows])
        back = np.linalg.inv(frame)
        sizes = np.array([one.size for one in self.p])
        # Terms may cancel, such as those of the gap acceleration at a release.
        rounding = np.abs(mids) @ sizes + np.array([one.size for one in image])
        new = np.array([one.r for one in image]) + _LEAST * rounding
        around = np.abs(back) @ (_NEW_WIDER * rads @ np.abs(self.frame) @ self.r + _NEW_WIDER * new)
        r = np.abs(back @ moved) @ self.r * _WIDER + around
        return PolynomialSet(p=[Polynomial(basis, one.c, 0.0) for one in image], frame=frame, r=r)


@dataclass(frozen=True, slots=True, kw_only=True)
class PolynomialRecord:
    """One inclusion, from a set to the next set.

    Attributes:
        kind: ``step``, ``cross``, ``impact`` or ``tail``.
        numbers: Exact numbers of the record.
        orders: Orders of a Taylor step, empty for other records.
        result: The set after it.
        fields: Further entries of the record, none.
        places: Indices of the states with a radius in a tail.
    """

    kind: str
    numbers: dict[str, Any] = field(default_factory=dict[str, Any])
    orders: tuple[int, ...] = ()
    result: PolynomialSet
    fields: dict[str, Any] = field(default_factory=dict[str, Any])
    places: Sequence[int] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class PolynomialPass:
    """The enclosure of one period in polynomials.

    Attributes:
        start: The box of the section.
        first: The set over it.
        records: Inclusions from set to set.
    """

    start: SectionStart
    first: PolynomialSet
    records: tuple[PolynomialRecord, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PhaseDuration:
    """Approximate duration of a phase: at the middle, and its change with each variable.

    Attributes:
        duration: Duration at the middle [s].
        slopes: Derivative with respect to the variables, ``(D,)``.
    """

    duration: float
    slopes: Sequence[float]


class PolynomialWalk:
    """A polynomial set within its period, with the records that led to it."""

    def __init__(
        self,
        system: BallSystem,
        start: PolynomialSet,
        phases: Callable[[bool], PhaseDuration],
        longest: float,
        tell: Tell,
    ) -> None:
        """Start on the release section.

        Args:
            system: The problem.
            start: The set.
            phases: Approximate duration of the next phase, a contact or a flight.
            longest: Longest step [s].
            tell: Called with the stage and the time reached [s].
        """
        e = system.expressions
        self._system, self._tell, self._longest = system, tell, longest
        self._free = PolynomialFlow(system, e.free, system.free)
        self._locked = PolynomialFlow(system, e.locked, system.locked)
        self._phases = phases
        self._fastest, self._pace = 0.0, longest
        self._limited, self._growth, self._reason = False, 1.0, ""
        basis = start.p[0].basis
        self._low = Basis.of(basis.exponents.shape[1], min(_LOW_DEGREE, basis.degree))
        self.set, self.departure, self.time = start, Departure.RELEASED, 0.0
        self.records: list[PolynomialRecord] = []

    @property
    def _flow(self) -> PolynomialFlow:
        return self._locked if self.departure is Departure.LOCKED else self._free

    def follow(self, releases: int) -> None:
        """Follow the set through a number of releases."""
        while releases:
            locked = self.departure is Departure.LOCKED
            self._cross()
            releases -= locked
            if not locked:
                self._strike()

    def _cross(self) -> None:
        """Follow the set through a phase, to its event."""
        phase = self._phases(self.departure is Departure.LOCKED)
        basis = self.set.p[0].basis
        share = Polynomial.constant(basis, 1.0)
        for k, slope in enumerate(phase.slopes):
            share.c[basis.variable(k)] = slope / phase.duration
        left, size = phase.duration, math.inf
        while True:
            close = left <= self._pace * _CLOSE
            if close and self._move(left, share, last=True):
                return
            tried = min(self._pace, size, left / 2)
            done = self._move(tried, share, last=False)
            least = _SHORTEST * min(self._longest, phase.duration)
            require_proved(done or tried > least, self.departure.value, self._reason)
            if done:
                left, size = left - tried, 2 * tried
                if tried == self._pace:
                    self._pace = min(self._longest, tried * self._growth)
            elif self._limited:
                self._pace = tried * self._growth
            else:
                size = tried / 2

    def _move(self, duration: float, share: Polynomial, *, last: bool) -> bool:
        """Add a step or a crossing. Return False if a shorter step is needed."""
        system, flow, n = self._system, self._flow, self._system.n
        order, order_v = _ORDERS
        self._reason, self._growth = "no box holds the motions over a step", 0.5
        self._limited = True
        locked = self.departure is Departure.LOCKED
        time = share * duration
        points = flow.point(self.set.p, order)
        if last:
            try:
                time = self._meeting(points, time)
            except ProofError:
                return False
        whole = flow.both([one.reduced(self._low) for one in self.set.wide], order_v)
        balls = [one.balls for one in whole]
        series = FlowSeries(
            states=balls[:n],
            derivative=[
                matrix([[balls[n + i * n + j][k] for j in range(n)] for i in range(n)], n)
                for k in range(order_v + 1)
            ],
        )
        metric = balanced(series.derivative[1])
        most = (float(time.c[0]) + time.spread) * (_SPARE_TIME if last else 1.0)
        size = _dyadic_above(most)
        step = enclose(flow.ball, series, size, (order, order_v))
        if step is None:
            return False
        excess = excess_of(step, metric, _REST, _DERIVATIVE_REST)
        self._growth = max(0.25, min(2.0, 0.9 * excess ** (-1 / (order_v + 1))))
        if excess > 1.0:
            self._reason = f"the remainder of a step is too large ({excess:.1e})"
            return False
        self._limited = False
        image = _at(points, time, [_REST_WIDER * r.abs_upper() for r in step.rest])
        rest = [r.abs_upper() for r in step.derivative_rest.entries()]
        slopes = _matrix_of(_at(whole[n:], time.reduced(self._low), rest), n)
        start = self.set.box
        end = None
        if not last:
            end = image[system.gap].ball + _moved(slopes, self.set.noise)[system.gap]
        reason = contact_reason(system, flow.ball, self.departure, start, step.box, end)
        if self.departure is Departure.RELEASED and not last and self._leaves(balls, step):
            reason = ""
        reason = reason or system.undefined(step.box) or system.light(step.box)
        if reason:
            self._reason = reason
            return False
        numbers: dict[str, Any] = {"h": size, "time": [arb(float(x)) for x in time.c]}
        if last:
            found = self._met(step, points, whole, time, rest, image, slopes)
            if found is None:
                return False
            image, slopes, numbers["spare"] = found
        if locked or last:
            rate = None if locked else image[system.rate].ball
            rows = system.turning_rows(rate)
        else:
            rows = system.moving_rows
        result = self.set.mapped(image, slopes, rows, metric)
        kind = "cross" if last else "step"
        self._add(PolynomialRecord(kind=kind, numbers=numbers, orders=_ORDERS, result=result))
        if last:
            self.departure = Departure.RELEASED if locked else Departure.FLYING
        else:
            self.departure = Departure.LOCKED if locked else Departure.FLYING
        self.time += float(time.c[0])
        self._tell(self.departure.value, self.time)
        return True

    def _leaves(self, balls: Sequence[Sequence[Ball]], step: FlowStep) -> bool:
        """Return True if the gap opens after a release, by its series without its first terms."""
        gap = self._system.gap
        terms = balls[gap][3 : step.orders[1] + 1]
        rest = step.low_rest[gap]
        total = sum((x * step.size**k * UNIT for k, x in enumerate([*terms, rest]) if k), terms[0])
        return is_clear(total)

    def _guard(self, y: Sequence[Any]) -> tuple[Any, list[Any], list[Any]]:
        """Return the guard, its gradient and the rates at states of balls or polynomials."""
        if self.departure is Departure.LOCKED:
            return self._locked.ball.guard(y)
        gradient = [ZERO] * self._system.n
        gradient[self._system.gap] = arb(1)
        return y[self._system.gap], gradient, self._free.ball.rate(y)

    def _meeting(self, points: list[Any], time: Polynomial) -> Polynomial:
        """Return the time of the event as a polynomial, by Newton's method."""
        for _ in range(_NEWTON_STEPS):
            value, gradient, rate = self._guard(_at(points, time))
            speed = sum((g * f for g, f in zip(gradient, rate, strict=True)), ZERO)
            time = time - value / speed
            time = Polynomial(time.basis, time.c, 0.0)
        return time

    def _met(
        self,
        step: FlowStep,
        points: list[Any],
        whole: list[Any],
        time: Polynomial,
        rest: Sequence[Ball],
        image: list[Polynomial],
        slopes: Matrix,
    ) -> tuple[list[Polynomial], Matrix, Ball] | None:
        """Return image and derivative on the guard, and the spare time around the crossing."""
        system, n = self._system, self._system.n
        locked = self.departure is Departure.LOCKED
        off = _moved(slopes, self.set.noise)
        value, gradient, _ = self._guard([one.wider(0.0) for one in image])
        box = [one.ball + dx for one, dx in zip(image, off, strict=True)]
        spare = ZERO
        for _ in range(3):
            _, gradient, rate = self._guard(box)
            falls = sum((g * f for g, f in zip(gradient, rate, strict=True)), ZERO)
            if not bool(falls < 0):
                self._reason = f"the guard is not proved to fall where it is met ({falls})"
                return None
            row = (matrix([gradient], n) * slopes).entries()
            noise = sum(
                (a.abs_upper() * float(r) for a, r in zip(row, self.set.noise, strict=True)), ZERO
            )
            reach = value.ball.abs_upper() + noise
            spare = arb(float((2.0 * reach / abs(falls).lower()).abs_upper()))
            wide = time.wider(float(spare))
            window = _matrix_of(_at(whole[n:], wide.reduced(self._low), rest), n)
            at = _at(points, wide, [r.abs_upper() for r in step.rest])
            box = [
                one.ball + dx for one, dx in zip(at, _moved(window, self.set.noise), strict=True)
            ]
        low = float(time.c[0]) - time.spread - float(spare)
        if low <= 0 or float(time.c[0]) + time.spread + float(spare) > float(step.size):
            self._reason = "the times of the event spread too far for a step"
            return None
        _, gradient, rate = self._guard(box)
        falls = sum((g * f for g, f in zip(gradient, rate, strict=True)), ZERO)
        row = matrix([gradient], n) * slopes / -falls
        speeds = matrix([[one] for one in rate], 1)
        slopes = slopes + speeds * row
        late = value.ball.abs_upper() / abs(falls).lower()
        image = [
            one.wider(float((late * speed.abs_upper()).abs_upper()))
            for one, speed in zip(image, rate, strict=True)
        ]
        if not locked:
            image[system.gap] = Polynomial.constant(time.basis, 0.0)
            table = slopes.table()
            table[system.gap] = [ZERO] * n
            slopes = matrix(table, n)
        return image, slopes, spare

    def _strike(self) -> None:
        system, x = self._system, self.set.p
        box = self.set.box
        derivative = system.reset_derivative(box)
        _, direction, restitution = system.free_values(x)
        push = (1 + restitution) * x[system.rate]
        image = [a - push * d for a, d in zip(x, direction, strict=True)]
        image[system.gap] = Polynomial.constant(x[0].basis, 0.0)
        image[system.rate] = x[system.rate] * -restitution
        after = image[system.rate].ball
        rows = system.turning_rows(None if system.plastic else after)
        result = self.set.mapped(image, derivative, rows, np.ones(system.n))
        self._add(PolynomialRecord(kind="impact", result=result))
        self._fastest = max(self._fastest, float(box[system.rate].abs_upper()))
        self.departure = Departure.LOCKED if system.plastic else Departure.STRUCK
        if not system.plastic and bool(self.set.box[system.rate] < _SLOWEST * self._fastest):
            self._settle()

    def _settle(self) -> None:
        """Replace all further impacts by a Zeno tail."""
        system, x = self._system, self.set.p
        box = self.set.box
        found = polydisc(system, box)
        w = box[system.rate].abs_upper()
        image = [
            one.wider(float((c * w / (1 - found.rho)).abs_upper()))
            for one, c in zip(x, found.c, strict=True)
        ]
        rows = [[arb(float(i == j)) for j in range(system.n)] for i in range(system.n)]
        for k in (system.gap, system.rate):
            image[k] = Polynomial.constant(x[0].basis, 0.0)
            rows[k] = [ZERO] * system.n
        result = self.set.mapped(
            image, matrix(rows, system.n), system.turning_rows(None), np.ones(system.n)
        )
        n_x, own = system.n_x, (system.gap, system.rate)
        places = [k for k in range(system.n) if k not in own or k < n_x]
        numbers = {"radius": [found.radius[k] for k in places], "speed": found.speed}
        self._add(PolynomialRecord(kind="tail", numbers=numbers, result=result, places=places))
        self.departure = Departure.LOCKED

    def _add(self, record: PolynomialRecord) -> None:
        if not np.all(np.isfinite(record.result.r)):
            raise ProofError("polynomial", "the remainder grows without bound")
        self.records.append(record)
        self.set = record.result


def _at(series: Sequence[Any], time: Polynomial, rest: Sequence[Ball] | None = None) -> list[Any]:
    """Return the sums of series at a time, with the coefficients of their remainders."""
    found = list[Any]()
    for k, one in enumerate(series):
        value: Any = Polynomial.constant(time.basis, 0.0, float(rest[k]) if rest else 0.0)
        for j in range(one.n - 1, -1, -1):
            value = value * time + one[j]
        found.append(value)
    return found


def _matrix_of(entries: Sequence[Polynomial], n: int) -> Matrix:
    return matrix([[entries[i * n + j].ball for j in range(n)] for i in range(n)], n)


def _moved(slopes: Matrix, noise: Vector) -> list[Ball]:
    n = len(noise)
    return [
        arb(
            0, sum((slopes[i, j].abs_upper() * float(noise[j]) for j in range(n)), ZERO).abs_upper()
        )
        for i in range(n)
    ]


def _dyadic_above(size: float) -> Ball:
    mantissa, exponent = math.frexp(size)
    return arb(math.ldexp(math.ceil(mantissa * 4096) + 1, exponent - 12))
