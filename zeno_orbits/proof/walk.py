"""From a set on the release section once around the period, record by record.

Steps are as long as their remainders allow. On each it is proved that the motions touch the stop
where they should and nowhere else.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from flint import arb

from zeno_orbits.errors import ProofError
from zeno_orbits.proof.ball_system import BallSystem
from zeno_orbits.proof.balls import Ball
from zeno_orbits.proof.crossing import cross
from zeno_orbits.proof.flow import BallFlow, FlowStep, enclose
from zeno_orbits.proof.impacts import settle, strike
from zeno_orbits.proof.program import Series
from zeno_orbits.proof.stage import BallTime, Departure, ProofRecord, Stage

_SHORTEST = 1e-5
"""Least step in flight off the stop and on it, as a part of the longest, before it is given up."""
_BEYOND = 1 + 2.0**-6
"""How far beyond a crossing its step reaches, as a multiple of its time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkSettings:
    """How a period is followed.

    Attributes:
        orders: Of Taylor's method for a point, and for the derivative.
        rest: Largest remainder of a step for a point, per size of a state.
        derivative_rest: Largest remainder of its derivative.
        first: First step that is tried [s].
        longest: Longest step [s].
        slowest: Gap rate below which impacts are summed up.
        most_impacts: Impacts in a flight phase beyond which it is given up.
    """

    orders: tuple[int, int] = (30, 22)
    rest: float = 1e-21
    derivative_rest: float = 3e-13
    first: float = 2e-3
    longest: float = 0.1
    slowest: float = 1e-19
    most_impacts: int = 5000


@dataclass(frozen=True, slots=True, kw_only=True)
class Passage:
    """A set once around.

    Attributes:
        records: What led from set to set.
        impact_times: Of the impacts that were resolved one by one.
        zeno_times: Of the Zeno points, or plastic impacts that held.
        release_times: Of the releases, the last of which ends the period.
        end: The set at the end.
    """

    records: tuple[ProofRecord, ...]
    impact_times: tuple[BallTime, ...]
    zeno_times: tuple[BallTime, ...]
    release_times: tuple[BallTime, ...]
    end: Stage


@dataclass(slots=True, kw_only=True)
class _Pace:
    """The next step's length, from the remainders of the last."""

    size: float
    most: float
    tried: list[float] = field(default_factory=list[float])


Tell = Callable[[str, float], None]


def walk(
    system: BallSystem, start: Stage, releases: int, settings: WalkSettings, tell: Tell
) -> Passage:
    """Follow a set once around.

    Args:
        system: The problem.
        start: Where it is released.
        releases: How many releases end the period.
        settings: How.
        tell: Called with what is being done and the time that was reached [s].

    Raises:
        ProofError: If something is not proved; its claim says what.
    """
    records: list[ProofRecord] = []
    impacts: list[BallTime] = []
    zenos: list[BallTime] = []
    ends: list[BallTime] = []
    stage, pace = start, _Pace(size=settings.first, most=settings.longest)
    while len(ends) < releases:
        for record, stage in _arc(system, stage, pace, settings):
            records.append(record)
            tell(stage.departure.value, float(stage.time.middle.mid()))
        if stage.departure is Departure.RELEASED:
            ends.append(stage.time)
            continue
        impacts.append(stage.time)
        record, stage = strike(system, stage)
        records.append(record)
        slow = bool(stage.at.box[system.rate] < settings.slowest)
        if stage.departure is Departure.STRUCK and slow:
            record, stage = settle(system, stage)
            records.append(record)
        if stage.departure is Departure.LOCKED:
            zenos.append(stage.time)
            pace.size = settings.first
        elif len(impacts) > settings.most_impacts:
            raise ProofError("zeno_point", f"impacts do not accumulate in {len(impacts)} of them")
    return Passage(
        records=tuple(records),
        impact_times=tuple(impacts),
        zeno_times=tuple(zenos),
        release_times=tuple(ends),
        end=stage,
    )


def _arc(
    system: BallSystem, stage: Stage, pace: _Pace, settings: WalkSettings
) -> Iterator[tuple[ProofRecord, Stage]]:
    """Yield the records of steps until the guard is met, the crossing last."""
    locked = stage.departure is Departure.LOCKED
    flow = system.locked if locked else system.free
    least = pace.size * _SHORTEST
    while True:
        record, stage, met = _move(system, flow, stage, pace, settings, least)
        yield record, stage
        if met:
            return


def _move(
    system: BallSystem,
    flow: BallFlow,
    stage: Stage,
    pace: _Pace,
    settings: WalkSettings,
    least: float,
) -> tuple[ProofRecord, Stage, bool]:
    """Return one record, a step or a crossing, the stage after it, and whether it is the latter."""
    size, orders = min(pace.size, pace.most), settings.orders
    points = flow.point_series(stage.at.m, orders[0])
    guess = _meeting(system, stage, points, 1.5 * size)
    if guess is not None:
        size = guess * _BEYOND if guess * _BEYOND <= size else guess / 2
        orders = _orders(size, pace.size, settings)
        least = min(least, guess / 64)
    over = flow.series(stage.at.box, orders[1])
    reason = "no box holds the motions over a step"
    while size >= least:
        exact = _dyadic(size)
        meets = guess is not None and guess < float(exact)
        step = enclose(flow, over, exact, orders)
        if step is None:
            size = size / 2
            continue
        excess = _excess(step, settings)
        if excess > 1.0 and size > least:
            size = max(least, size * max(0.25, 0.9 * excess ** (-1 / (orders[1] + 1))))
            continue
        reason = _contact(system, flow, stage, step, meets=meets)
        if reason:
            size = guess / 2 if meets and guess is not None else size / 2
            continue
        if meets and guess is not None:
            record, after = cross(system, stage, step, points, arb(guess))
            return record, after, True
        if orders == settings.orders:
            pace.size = size * max(0.5, min(4.0, 0.9 * excess ** (-1 / (orders[1] + 1))))
        locked = stage.departure is Departure.LOCKED
        groups = system.groups["beside" if locked else "all"]
        result = stage.at.mapped(step.point(points, exact), step.derivative(exact), groups)
        record = ProofRecord(kind="step", numbers={"h": exact}, orders=orders, result=result)
        departure = Departure.LOCKED if locked else Departure.FLYING
        return record, stage.next(result, departure, stage.time.later(exact)), False
    raise ProofError(_CLAIMS[stage.departure], reason)


_CLAIMS = {
    Departure.FLYING: "flight",
    Departure.RELEASED: "leaves",
    Departure.STRUCK: "flight",
    Departure.LOCKED: "locked",
}
"""Name of the claim that a step serves."""


def _dyadic(size: float) -> Ball:
    """Return a number of few bits just below a size."""
    mantissa, exponent = math.frexp(size)
    return arb(math.ldexp(math.floor(mantissa * 4096), exponent - 12))


def _excess(step: FlowStep, settings: WalkSettings) -> float:
    """Return the largest remainder of a step as a multiple of what is allowed."""
    order, order_v = step.orders
    far, near = step.size ** (order + 1), step.size ** (order_v + 1)
    worst = 1e-12
    for one, x in zip(step.rest, step.box, strict=True):
        allowed = settings.rest * (1e-3 + float(x.abs_upper()))
        worst = max(worst, float((one * far).abs_upper()) / allowed)
    entries = step.derivative_rest.entries()
    scale = [1e-3 + float(x.abs_upper()) for x in step.box]
    n = len(scale)
    for k, one in enumerate(entries):
        allowed = settings.derivative_rest * scale[k // n] / scale[k % n]
        worst = max(worst, float((one * near).abs_upper()) / allowed)
    return worst


def _orders(size: float, usual: float, settings: WalkSettings) -> tuple[int, int]:
    """Return the orders that are enough for a short step, where the usual step has the usual."""
    reach = 4.0 * size / usual

    def enough(allowed: float, most: int) -> int:
        for k in range(3, most):
            if reach**k / math.factorial(k + 1) < allowed * 1e-3:
                return k
        return most

    k = enough(settings.derivative_rest, settings.orders[1])
    return max(k, enough(settings.rest, settings.orders[0])), k


def _meeting(system: BallSystem, stage: Stage, points: list[Series], within: float) -> float | None:
    """Return when the middle of the set meets its guard, if it does soon; not for certain."""
    if stage.departure is Departure.LOCKED:
        return _release_guess(system, points, within)
    coefficients = [float(c.mid()) for c in points[system.gap]]
    skipped = {Departure.FLYING: 0, Departure.STRUCK: 1, Departure.RELEASED: 3}[stage.departure]
    return _first_root(coefficients[skipped:], within)


def _release_guess(system: BallSystem, points: list[Series], within: float) -> float | None:
    def multiplier(time: float) -> float:
        at = [_horner([float(c.mid()) for c in one], time) for one in points]
        return float(system.locked.guard([arb(x) for x in at])[0].mid())

    if multiplier(0.0) <= 0 or multiplier(within) > 0:
        return None
    return _bisected(multiplier, 0.0, within)


def _first_root(coefficients: list[float], within: float) -> float | None:
    def value(time: float) -> float:
        return _horner(coefficients, time)

    grid = [within * k / 48 for k in range(49)]
    if coefficients[0] > 0.0 and len(coefficients) > 2:
        # A flight near a Zeno point is far shorter than a step.
        short = -coefficients[0] / coefficients[1] if coefficients[1] < 0 else within
        grid = sorted({*grid, *(short * k / 8 for k in range(1, 17) if short * k / 8 < within)})
    for left, right in zip(grid, grid[1:], strict=False):
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


def _contact(
    system: BallSystem, flow: BallFlow, stage: Stage, step: FlowStep, *, meets: bool
) -> str:
    """Return what is not proved of the stop on a step, or nothing.

    Args:
        system: The problem.
        flow: The flow of the mode.
        stage: Where the step starts.
        step: The step.
        meets: Whether the guard is to be met in it.
    """
    box, gap, rate = step.box, system.gap, system.rate
    if stage.departure is Departure.LOCKED:
        multiplier, gradient, speeds = flow.guard(box)
        if not meets:
            return "" if bool(multiplier > 0) else f"`multiplier` is not proved positive ({multiplier})"
        slope = sum((g * f for g, f in zip(gradient, speeds, strict=True)), arb(0))
        return "" if bool(slope < 0) else f"`multiplier` is not proved to fall at the release ({slope})"
    acceleration = flow.rate(box)[rate]
    concave = bool(acceleration < 0)
    if meets:
        if concave or (stage.departure is Departure.FLYING and bool(box[rate] < 0)):
            return ""
        return "`gap` is not proved to fall once only before an impact"
    if stage.departure is Departure.RELEASED:
        jerk = _jerk(flow, box, rate)
        return "" if bool(jerk > 0) else f"`d3h/dt3` is not proved positive at the release ({jerk})"
    if stage.departure is Departure.STRUCK and bool(box[rate] > 0):
        return ""
    if stage.departure is Departure.FLYING and bool(box[gap] > 0):
        return ""
    if concave and _positive_at_end(stage, step, gap):
        return ""
    return "`gap` is not proved positive in flight"


def _jerk(flow: BallFlow, box: list[Ball], rate: int) -> Ball:
    """Return the third derivative of the gap over a box."""
    return 2 * flow.point_series(box, 2)[rate][2]


def _positive_at_end(stage: Stage, step: FlowStep, gap: int) -> bool:
    end = step.series.states[gap]
    value = arb(0)
    for one in reversed(end[: step.orders[1] + 1]):
        value = value * step.size + one
    return bool(value > 0)
