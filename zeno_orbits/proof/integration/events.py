r"""Events of a set: crossings of the guard, impacts, and Zeno tails.

All motions of a set cross in a window ``[a, b]`` if the guard is positive at `a`, negative at `b`
and falls in between. Let :math:`\tau` be the time and `g` the guard. Then
:math:`\partial\tau = -\partial g\,\partial\varphi / (\partial g\, f)`, and the derivative of the
map to the guard is :math:`\partial\varphi + f\,\partial\tau`.

Lemma. Consider a complex polydisc of states around the set and of rates :math:`|w| \le \bar w`. On
a box `B` around it, let :math:`\ddot h` lie in a disc with centre :math:`a_0` and radius
:math:`r_a`, and let :math:`|f_i| \le F_i`, :math:`|d_i| \le D_i`. A flight from rate `w` then lasts
at most `S w`, with :math:`S = 2 / (|a_0| - r_a)`. The next rate is at most :math:`\rho = e \kappa`
times the last rate, with :math:`\kappa = 1 + 4 r_a / (|a_0| - r_a)`. A state moves by at most
:math:`c_i w` from impact to impact, with :math:`c_i = S F_i + (1 + e) \kappa D_i`. If
:math:`\rho < 1`, impacts accumulate. The Zeno point is then analytic and within
:math:`c_i w / (1 - \rho)` of the state. Its derivatives are bounded by Cauchy's estimate on the
polydisc.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from flint import acb, arb

from zeno_orbits.errors import ProofError
from zeno_orbits.proof.arithmetic.balls import (
    ONE,
    ZERO,
    Ball,
    Matrix,
    column,
    identity,
    joined,
    matrix,
    product,
    symmetric,
)
from zeno_orbits.proof.arithmetic.recurrences import Series
from zeno_orbits.proof.integration.ball_system import BallSystem, require_proved
from zeno_orbits.proof.integration.flow import FlowStep
from zeno_orbits.proof.integration.sets import Departure, ProofRecord, ProofStage

_SPARE = 1.25
"""Factor by which a window is widened, so that the checker's arithmetic also confirms it."""
_SPARE_OF_POINT = 16.0
"""The same factor for the window of a point, whose width results from the remainders alone."""
_LEAST_WINDOW = arb(2) ** -80
"""Smallest half width of a window, per period, so that the fixed-point checker separates the
guard from 0. Its remainders are larger than those of the prover."""
_CLEAR = 1.5
"""Smallest distance from zero of an interval on the box of a step, as a multiple of its radius.

The box of the checker's arithmetic is another box.
"""
_TRIES = 12
_GRID = 16
"""Number of intervals of the time in which a crossing is located."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Guard:
    """The guard along a step, with its gradient and the flow.

    Attributes:
        value: Function from states to the guard.
        terms: Function from states to the gradient, ``(n,)``, and the flow, ``(n,)``.
    """

    value: Callable[[Sequence[Ball]], Ball]
    terms: Callable[[Sequence[Ball]], tuple[list[Ball], list[Ball]]]


class Meeting(NamedTuple):
    """An event of a flow: a stop is met or released, or a switch.

    Attributes:
        kind: ``stop``, ``release`` or ``switch``.
        number: Index of the stop or of the switch.
    """

    kind: str
    number: int


def _guard(system: BallSystem, departure: Departure, met: Meeting) -> _Guard:
    if met.kind == "switch":
        flow = system.locked if departure is Departure.LOCKED else system.free
        k = met.number
        return _Guard(
            value=lambda y: system.guards(y)[k][0],
            terms=lambda y: (system.guards(y)[k][1], flow.rate(y)),
        )
    if met.kind == "release":
        locked = system.locked
        return _Guard(value=lambda y: locked.guard(y)[0], terms=lambda y: locked.guard(y)[1:])
    gradient = [ZERO] * system.n
    gradient[system.gap] = ONE
    return _Guard(value=lambda y: y[system.gap], terms=lambda y: (gradient, system.free.rate(y)))


def cross(
    system: BallSystem,
    stage: ProofStage,
    step: FlowStep,
    series: list[Series],
    guess: Ball,
    met: Meeting,
) -> tuple[ProofRecord, ProofStage]:
    """Enclose a crossing in a step and return its record and the set on the guard.

    The caller must ensure that the guard falls to zero only once in the step.

    Args:
        system: The problem, with the stop that is met.
        stage: The set at the start of the step.
        step: The step.
        series: Taylor coefficients of the middle of the set.
        guess: Time of the crossing from the start of the step.
        met: The event.

    Raises:
        ProofError: If it is not proved that all motions cross once in the step.
    """
    claim = {"stop": "impact"}.get(met.kind, met.kind)
    guard, locked = _guard(system, stage.departure, met), stage.departure is Departure.LOCKED
    strikes = met.kind == "stop"
    on_stop = locked and not strikes

    def spread(time: Ball) -> list[Ball]:
        return product(step.derivative(time), stage.at.deviation)

    def window_of(others: Callable[[Ball], list[Ball]] | None, half: Ball) -> tuple[Ball, Ball]:
        return _window(guard, step, guess, lambda t: step.point(series, t), others, claim, half)

    a_m, b_m = window_of(None, _LEAST_WINDOW * system.period)
    # The checker rounds the whole set as it rounds the point.
    a, b = window_of(spread, (b_m - a_m) / 2)
    a, b = _lesser(a, a_m), _greater(b, b_m)
    middle = joined(a_m, b_m)
    window = joined(a, b)
    whole = step.derivative(window)
    box = [
        x + dx
        for x, dx in zip(
            step.point(series, window), product(whole, stage.at.deviation), strict=True
        )
    ]
    gradient, rate = guard.terms(box)
    falls = sum((g * f for g, f in zip(gradient, rate, strict=True)), ZERO)
    require_proved(
        bool(falls < 0), claim, f"the guard is not proved to fall where it is met ({falls})"
    )
    n = system.n
    row = matrix([gradient], n) * whole / -falls
    derivative = whole + column(rate) * row
    image = step.point(series, middle)
    if strikes:
        image[system.gap] = ZERO
        derivative = _without_rows(derivative, (system.gap,))
    rows = system.turning_rows(None if on_stop or met.kind == "release" else image[system.rate])
    if met.kind == "switch" and not locked:
        rows = system.moving_rows
    result = stage.at.mapped(image, derivative, rows, stage.metric)
    after = _departure_after(met, stage.departure)
    numbers = {"h": step.size, "window": [a, b], "centre": [a_m, b_m]}
    fields = {"meets": list(met)} if system.view else {}
    record = ProofRecord(
        kind="cross", numbers=numbers, orders=step.orders, result=result, fields=fields
    )
    return record, stage.next(result, after, stage.timed(middle, row))


def _departure_after(met: Meeting, before: Departure) -> Departure:
    """Return how motions leave an event: a switch keeps a stop closed."""
    if met.kind == "switch":
        return before if before is Departure.LOCKED else Departure.FLYING
    return Departure.RELEASED if met.kind == "release" else Departure.STRUCK


def switch_guess(
    system: BallSystem, stage: ProofStage, points: list[Series], within: float
) -> tuple[float, Meeting] | None:
    """Return an approximate time at which the middle of a set meets a switch, and the switch.

    Args:
        system: The problem.
        stage: The set and its mode.
        points: Taylor coefficients of the middle of the set.
        within: Length of the search interval [s].
    """
    if not system.guard_signs:
        return None

    def values(time: float) -> list[float]:
        at = [arb(_horner([float(c.mid()) for c in one], time)) for one in points]
        found = [float(value.mid()) for value, _ in system.guards(at)]
        armed = [float(value.mid()) for value in system.armed(at)]
        # A declared switch that is not armed is far from an event.
        return [x if k >= len(armed) or armed[k] > 0 else 1.0 for k, x in enumerate(found)]

    times = [within * k / _GRID for k in range(_GRID + 1)]
    rows = [values(time) for time in times]
    for j, (left, right) in enumerate(pairwise(rows)):
        crossed = [
            k
            for k, (a, b) in enumerate(zip(left, right, strict=True))
            if a > 0.0 >= b and (j or k != stage.switched)
        ]
        found = [
            (_bisected(lambda time, k=k: values(time)[k], times[j], times[j + 1]), k)
            for k in crossed
        ]
        if found:
            time, k = min(found)
            return time, Meeting("switch", k)
    return None


def switch_reason(
    system: BallSystem,
    stage: ProofStage,
    box: Sequence[Ball],
    end: Sequence[Ball],
    met: Meeting | None,
) -> str:
    """Return why a switch is not proved to be met only as expected on a step, or an empty text.

    Args:
        system: The problem.
        stage: The set at the start of the step.
        box: Box that contains all motions over the step.
        end: States at the end of the step.
        met: The event that ends the step, if there is one.
    """
    if not system.guard_signs:
        return ""
    flow = system.locked if stage.departure is Departure.LOCKED else system.free
    speeds, armed = flow.rate(box), system.armed(box)
    parts = zip(system.guards(box), system.guards(stage.at.box), system.guards(end), strict=True)
    for k, ((value, gradient), (first, _), (last, _)) in enumerate(parts):
        slope = sum((g * f for g, f in zip(gradient, speeds, strict=True)), ZERO)
        recent, declared = stage.switched == k, k < system.n_declared
        falls, rises = is_clear(-slope), is_clear(slope)
        if met == Meeting("switch", k):
            holds = falls and is_clear(first) and (not declared or is_clear(armed[k]))
            if not holds:
                return f"switch {k} is not proved to be met once ({slope})"
            continue
        above = not (recent and declared) and (recent or is_clear(first))
        holds = is_clear(value) or (rises and above) or (falls and is_clear(last))
        if declared and not holds:
            below = is_clear(-first) or recent
            holds = rises or is_clear(-value) or is_clear(-armed[k]) or (falls and below)
        if not holds:
            return f"switch {k} is not proved to keep its side ({value})"
    return ""


def is_clear(x: Ball) -> bool:
    """Return True if an interval is positive even after a widening by `_CLEAR`."""
    return bool(x.mid() > _CLEAR * x.rad())


def _window(
    guard: _Guard,
    step: FlowStep,
    guess: Ball,
    point: Callable[[Ball], list[Ball]],
    spread: Callable[[Ball], list[Ball]] | None,
    claim: str,
    least: Ball,
) -> tuple[Ball, Ball]:
    """Return two exact times around a guess: the guard is positive at the first, then negative."""

    def value(time: Ball) -> Ball:
        at = point(time)
        if spread is not None:
            at = [x + dx for x, dx in zip(at, spread(time), strict=True)]
        return guard.value(at)

    gradient, rate = guard.terms(point(guess))
    speed = sum((g * f for g, f in zip(gradient, rate, strict=True)), ZERO)
    require_proved(
        bool(speed < 0), claim, f"the guard is not proved to fall where it is met ({speed})"
    )
    for _ in range(3):
        guess = (guess - value(guess) / speed).mid()
    here = value(guess)
    spare = _SPARE_OF_POINT if spread is None else _SPARE
    half = abs(here / speed).abs_upper() * spare + least
    for _ in range(_TRIES):
        half = half.mid()
        a, b = (guess - half).mid(), (guess + half).mid()
        inside = bool(a > 0) and bool(b <= step.size)
        if inside and bool(value(a) > 0) and bool(value(b) < 0):
            return a, b
        half = half * 2
    reason = f"not all motions of the set are proved to cross near {float(guess.mid()):.3g} s"
    raise ProofError(claim, f"{reason} from the start of the last step")


def _lesser(a: Ball, b: Ball) -> Ball:
    return a if bool(a <= b) else b


def _greater(a: Ball, b: Ball) -> Ball:
    return a if bool(a >= b) else b


def _without_rows(m: Matrix, rows: Sequence[int]) -> Matrix:
    """Return a matrix with zeros in some rows."""
    table = m.table()
    for row in rows:
        table[row] = [ZERO] * m.ncols()
    return matrix(table, m.ncols())


def meeting_guess(
    system: BallSystem, departure: Departure, points: list[Series], within: float
) -> float | None:
    """Return an approximate time at which the middle of a set meets its guard, or None.

    Args:
        system: The problem.
        departure: Mode, and position relative to the stop.
        points: Taylor coefficients of the middle of the set.
        within: Length of the search interval [s].
    """
    if departure is Departure.LOCKED:
        return _release_guess(system, points, within)
    coefficients = [float(c.mid()) for c in points[system.gap]]
    return _first_root(coefficients[_LEADING_ZEROS[departure] :], within)


def _release_guess(system: BallSystem, points: list[Series], within: float) -> float | None:
    def multiplier(time: float) -> float:
        at = [_horner([float(c.mid()) for c in one], time) for one in points]
        return float(system.locked.guard([arb(x) for x in at])[0].mid())

    times = [within * k / _GRID for k in range(_GRID + 1)]
    values = [multiplier(time) for time in times]
    for k in range(_GRID):
        if values[k] > 0.0 >= values[k + 1]:
            return _bisected(multiplier, times[k], times[k + 1])
    return None


def _first_root(coefficients: list[float], within: float) -> float | None:
    def value(time: float) -> float:
        return _horner(coefficients, time)

    grid = [within * k / (2 * _GRID) for k in range(2 * _GRID + 1)]
    if coefficients[0] > 0.0 and len(coefficients) > 2:
        # A flight near a Zeno point is far shorter than a step.
        short = -coefficients[0] / coefficients[1] if coefficients[1] < 0 else within
        grid = sorted({*grid, *(short * k / 8 for k in range(1, 17) if short * k / 8 < within)})
    for left, right in pairwise(grid):
        if value(left) > 0.0 >= value(right):
            return _bisected(value, left, right)
    return None


def _bisected(value: Callable[[float], float], left: float, right: float) -> float:
    for _ in range(100):
        middle = (left + right) / 2
        if not left < middle < right:
            break
        if value(middle) > 0.0:
            left = middle
        else:
            right = middle
    return (left + right) / 2


def _horner(coefficients: list[float], time: float) -> float:
    value = 0.0
    for one in reversed(coefficients):
        value = value * time + one
    return value


_LEADING_ZEROS = {
    Departure.FLYING: 0,
    Departure.STRUCK: 1,
    Departure.OPENED: 2,
    Departure.RELEASED: 3,
}
"""Number of Taylor coefficients of the gap that are zero at the start."""
_SPEED_SHARE = 0.25
"""Part of the polydisc that the tail with the highest speed may cross."""
_RADII = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
"""Trial radii of the polydisc, relative to the size of each state."""
_USUAL, _ROOM = 1e-4, 1e3
"""First trial radius for slow impacts, and as a multiple of the gap rate for faster ones."""


def strike(system: BallSystem, stage: ProofStage) -> tuple[ProofRecord, ProofStage]:
    """Apply an impact and return its record and the set after it.

    Args:
        system: The problem.
        stage: The set at the impact.
    """
    at, box = stage.at, stage.at.box
    derivative = system.reset_derivative(box)
    # The gap rate after a plastic impact is zero, so its row stays zero and keeps a separate axis.
    rows = system.turning_rows(None if system.plastic else box[system.rate])
    result = at.mapped(system.reset(at.m), derivative, rows, stage.metric)
    # An impact moves the state along a straight line.
    moved = [a.union(b) for a, b in zip(box, system.reset(box), strict=True)]
    reason = system.undefined(moved) or system.light(moved) or system.opening(box)
    require_proved(not reason, "impact", reason)
    record = ProofRecord(kind="impact", numbers={}, orders=(), result=result)
    after = Departure.LOCKED if system.plastic else Departure.STRUCK
    return record, stage.next(result, after, stage.time)


def settle_impacts(
    system: BallSystem, stage: ProofStage, closed: Sequence[BallSystem] = ()
) -> tuple[ProofRecord, ProofStage]:
    """Enclose a Zeno tail and return its record and the set of Zeno points.

    Args:
        system: The problem.
        stage: The set just after an impact.
        closed: The system of the other stop that is closed, if there is one.

    Raises:
        ProofError: If the accumulation of impacts is not proved.
    """
    n, gap, rate = system.n, system.gap, system.rate
    at, box = stage.at, stage.at.box
    reason = f"the gap rate after an impact is not proved positive ({box[rate]})"
    require_proved(is_clear(box[rate]), "zeno_point", reason)
    found = polydisc(system, box, closed)
    c, speed, speed_now = found.c, found.speed, box[rate].abs_upper()
    left, off = 1 - found.rho, speed - speed_now
    image = list(at.m)
    w = at.middle_box[rate].abs_upper()
    rows = identity(n).table()
    for i in range(n):
        rows[i][gap] = ZERO
        reach = c[i] / left
        image[i] = image[i] + symmetric(reach * w)
        for j in range(n):
            if j == rate:
                rows[i][j] = symmetric(reach * (1 + speed_now / off))
            elif j != gap and not c[i].is_zero():
                rows[i][j] = rows[i][j] + symmetric(reach * speed_now / found.delta[j])
    for i in (gap, rate):
        rows[i], image[i] = [ZERO] * n, ZERO
    result = at.mapped(image, matrix(rows, n), system.turning_rows(None), stage.metric)
    time = stage.time.later((found.longest * speed_now / left).union(ZERO))
    places = [k for k in range(n) if k not in (gap, rate) or k < system.n_x]
    numbers = {"radius": [found.radius[k] for k in places], "speed": speed}
    record = ProofRecord(kind="tail", numbers=numbers, orders=(), result=result, places=places)
    return record, stage.next(result, Departure.LOCKED, time)


@dataclass(frozen=True, slots=True, kw_only=True)
class Polydisc:
    """A polydisc on which all further impacts are bounded.

    Attributes:
        radius: Radii around the states, ``(n,)``.
        speed: Largest gap rate.
        c: Bounds of the motion from impact to impact, per gap rate, ``(n,)``.
        rho: Bound of the ratio of successive gap rates.
        longest: Bound of the duration of a flight, per gap rate.
        delta: Remaining part of the radii, ``(n,)``.
    """

    radius: list[Ball]
    speed: Ball
    c: list[Ball]
    rho: Ball
    longest: Ball
    delta: list[Ball]


def polydisc(
    system: BallSystem, box: Sequence[Ball], closed: Sequence[BallSystem] = ()
) -> Polydisc:
    """Return a polydisc around states just after an impact.

    Args:
        system: The problem.
        box: The states, ``(n,)``.
        closed: The system of the other stop that is closed, if there is one.

    Raises:
        ProofError: If the accumulation of impacts is not proved.
    """
    reason, wanted = "", max(_USUAL, _ROOM * float(box[system.rate].abs_upper()))
    # Wide polydiscs have wide bounds, and narrow ones have wide bounds of the derivatives.
    wide = sorted(share for share in _RADII if share >= wanted)
    for share in (*wide, *(one for one in _RADII if one < wanted)):
        try:
            return _polydisc(system, box, share, closed)
        except ProofError as error:
            reason = error.reason
    raise ProofError("zeno_point", reason)


def _polydisc(
    system: BallSystem, box: Sequence[Ball], share: float, closed: Sequence[BallSystem]
) -> Polydisc:
    gap, rate = system.gap, system.rate
    speed_now = box[rate].abs_upper()
    radius = [arb(share) * (1 + x.abs_upper()) for x in box]
    radius = [arb(float(one.mid())) for one in radius]
    speed, e = arb(share * 0.1), system.impact(box).restitution.upper()
    for _ in range(40):
        # In all flights the gap and its rate stay far within these bounds, as `_bounds` checks.
        radius[gap] = speed
        radius[rate] = arb(float((speed * (8 + 16 / (1 - e))).mid()))
        found = _bounds(system, box, radius, speed)
        if found is not None:
            break
        speed = speed / 4
        require_proved(bool(speed > 2 * speed_now), "zeno_point", "no polydisc holds the tail")
    else:
        raise ProofError("zeno_point", "no polydisc holds the tail")
    c, rho, longest, delta = found
    faster = bool(speed - speed_now > 0)
    require_proved(faster, "zeno_point", "the gap rate exceeds that of the polydisc")
    real = [x + arb(0, r) for x, r in zip(box, radius, strict=True)]
    reason = system.light(real) or system.opening(real)
    require_proved(not reason, "zeno_point", reason)
    pressed = all(bool(one.locked.guard(real)[0] > 0) for one in closed)
    require_proved(pressed, "zeno_point", "another closed stop is not proved to press in the tail")
    for other in range(system.n_x, system.n_x + len(system.carried_stops), 2):
        apart = other == gap or other in system.held_rows or bool(real[other] > 0)
        require_proved(apart, "zeno_point", "another gap is not proved positive in the tail")
    kept = all(bool(value != 0) for value, _ in system.guards(real)[: system.n_declared])
    kept = kept and all(bool(value > 0) for value, _ in system.guards(real)[system.n_declared :])
    require_proved(kept, "zeno_point", "a switch is not proved to keep its side in the tail")
    lowest = system.impact(real).restitution
    require_proved(bool(lowest > 0), "zeno_point", "the restitution is not proved to be positive")
    return Polydisc(radius=radius, speed=speed, c=c, rho=rho, longest=longest, delta=delta)


def _bounds(
    system: BallSystem, box: Sequence[Ball], radius: Sequence[Ball], speed: Ball
) -> tuple[list[Ball], Ball, Ball, list[Ball]] | None:
    """Return `c`, `rho`, `S` and the remaining part of the polydisc, or None if it is too small."""
    gap, rate = system.gap, system.rate
    wide = [acb(x + arb(0, r), arb(0, r)) for x, r in zip(box, radius, strict=True)]
    reason = system.undefined(wide)
    if reason:
        raise ProofError("zeno_point", reason)
    flow, direction, e = system.free_values(wide)
    e = e.abs_upper()
    a = flow[rate]
    a0 = a.real.mid()
    spread = (a - a0).abs_upper()
    slack = -a0 - spread
    if not bool(slack > 0):
        raise ProofError("zeno_point", f"`gap_acceleration` is not proved negative there ({a})")
    longest = 2 / slack
    kappa = 1 + 4 * spread / slack
    rho = e * kappa
    if not bool(rho < 1):
        raise ProofError("zeno_point", f"impacts are not proved to shrink (ratio {rho})")
    c: list[Ball] = []
    delta: list[Ball] = []
    for i in range(system.n):
        moved = longest * flow[i].abs_upper()
        reach = moved + (1 + e) * kappa * direction[i].abs_upper()
        delta.append(radius[i] - speed * (moved + reach / (1 - rho)))
        crossed = 0.75 if i in (gap, rate) else _SPEED_SHARE
        if not reach.is_zero() and not bool(delta[i] > (1 - crossed) * radius[i]):
            return None
        if i in (gap, rate):
            reach, delta[i] = ZERO, ONE
        elif reach.is_zero():
            delta[i] = radius[i]
        c.append(reach)
    # In flight the rate is at most (2 + kappa) w, and the gap at most this rate times S w.
    high, fast = longest * speed * flow[gap].abs_upper(), speed * (2 + kappa)
    if not (bool(high < radius[gap]) and bool(fast < radius[rate])):
        return None
    return c, rho, longest, delta
