"""From a set on the release section once around the period, record by record.

Steps are as long as their remainders allow. On each it is proved that the motions touch the stop
where they should and nowhere else.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from flint import arb

from zeno_orbits.errors import ProofError
from zeno_orbits.proof.ball_system import BallSystem
from zeno_orbits.proof.balls import ZERO, Ball, product
from zeno_orbits.proof.crossing import cross, meeting_guess
from zeno_orbits.proof.flow import BallFlow, FlowStep, enclose
from zeno_orbits.proof.impacts import settle_impacts, strike
from zeno_orbits.proof.stage import BallTime, Departure, ProofRecord, ProofStage

_SHORTEST = 1e-5
"""Least step in flight off the stop and on it, as a part of the longest, before it is given up."""
_JUST_BEYOND = 1 + 2.0**-6
_BEYOND = 1 + 2.0**-3
"""How far beyond a crossing its step reaches, as a multiple of its time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkSettings:
    """How a period is followed.

    Attributes:
        orders: Of Taylor's method for a point, and for the derivative.
        rest: Largest remainder of a step for a point, per size of a state.
        derivative_rest: Largest remainder of its derivative.
        first: First step that is tried, per period.
        longest: Longest step, per period.
        slowest: Gap rate below which impacts are summed up, per that of the fastest impact.
        most_impacts: Impacts in a flight phase beyond which it is given up.
    """

    orders: tuple[int, int] = (34, 28)
    rest: float = 1e-21
    derivative_rest: float = 3e-13
    first: float = 1e-3
    longest: float = 0.125
    slowest: float = 1e-19
    most_impacts: int = 5000


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofPassage:
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
    end: ProofStage


@dataclass(slots=True, kw_only=True)
class _Pace:
    """The next step's length, from the remainders of the last."""

    size: float
    most: float


Tell = Callable[[str, float], None]


def walk(
    system: BallSystem, start: ProofStage, releases: int, settings: WalkSettings, tell: Tell
) -> ProofPassage:
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
    first, fastest = settings.first * system.period, ZERO
    stage, pace = start, _Pace(size=first, most=settings.longest * system.period)
    while len(ends) < releases:
        locked = stage.departure is Departure.LOCKED
        flow, least = system.locked if locked else system.free, pace.size * _SHORTEST
        met = False
        while not met:
            record, stage, met = _move(system, flow, stage, pace, settings, least)
            records.append(record)
            tell(stage.departure.value, float(stage.time.middle.mid()))
        if stage.departure is Departure.RELEASED:
            ends.append(stage.time)
            continue
        impacts.append(stage.time)
        fastest = fastest.max(stage.at.box[system.rate].abs_upper())
        record, stage = strike(system, stage)
        records.append(record)
        slow = bool(stage.at.box[system.rate] < settings.slowest * fastest)
        if stage.departure is Departure.STRUCK and slow:
            record, stage = settle_impacts(system, stage)
            records.append(record)
        if stage.departure is Departure.LOCKED:
            zenos.append(stage.time)
            pace.size = first
        elif len(impacts) > settings.most_impacts:
            raise ProofError("zeno_point", f"impacts do not accumulate in {len(impacts)} of them")
    return ProofPassage(
        records=tuple(records),
        impact_times=tuple(impacts),
        zeno_times=tuple(zenos),
        release_times=tuple(ends),
        end=stage,
    )


def _move(
    system: BallSystem,
    flow: BallFlow,
    stage: ProofStage,
    pace: _Pace,
    settings: WalkSettings,
    least: float,
) -> tuple[ProofRecord, ProofStage, bool]:
    """Return one record, a step or a crossing, the stage after it, and whether it is the latter."""
    size, orders = min(pace.size, pace.most), settings.orders
    points = flow.point_series(stage.at.m, orders[0])
    guess = meeting_guess(system, stage, points, 1.5 * size)
    if guess is not None:
        size = guess * _BEYOND if guess * _JUST_BEYOND <= size else guess / 2
        orders = _orders(size, pace.size, settings, flow.n)
        least = min(least, guess / 64)
    shortened = guess is not None
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
        image, derivative = step.point(points, exact), step.derivative(exact)
        end = image[system.gap] + product(derivative, stage.at.deviation)[system.gap]
        reason = _contact(system, flow, stage, step, None if meets else end)
        if reason:
            shortened = True
            size = guess / 2 if meets and guess is not None else size / 2
            continue
        if meets and guess is not None:
            record, after = cross(system, stage, step, points, arb(guess))
            return record, after, True
        if not shortened:
            pace.size = size * max(0.5, min(4.0, 0.9 * excess ** (-1 / (orders[1] + 1))))
        locked = stage.departure is Departure.LOCKED
        groups = system.groups["beside" if locked else "all"]
        result = stage.at.mapped(image, derivative, groups)
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


def _orders(size: float, usual: float, settings: WalkSettings, n: int) -> tuple[int, int]:
    """Return the orders that are enough for a short step, where the usual step has the usual.

    None is below the number of states: what a state comes to depend on through the others only
    must show in the series, or the box of the step has no room for it.
    """
    reach = 4.0 * size / usual

    def enough(allowed: float, most: int) -> int:
        for k in range(min(n, most), most):
            if reach**k / math.factorial(k + 1) < allowed * 1e-3:
                return k
        return most

    k = enough(settings.derivative_rest, settings.orders[1])
    return max(k, enough(settings.rest, settings.orders[0])), k


def _contact(
    system: BallSystem, flow: BallFlow, stage: ProofStage, step: FlowStep, end: Ball | None
) -> str:
    """Return what is not proved of the stop on a step, or nothing.

    Args:
        system: The problem.
        flow: The flow of the mode.
        stage: Where the step starts.
        step: The step.
        end: Gap at its end; None if the guard is to be met in it.
    """
    if stage.departure is Departure.LOCKED:
        multiplier, gradient, speeds = flow.guard(step.box)
        slope = sum((g * f for g, f in zip(gradient, speeds, strict=True)), ZERO)
        if end is None:
            holds, what = bool(slope < 0), f"to fall at the release ({slope})"
        else:
            holds, what = bool(multiplier > 0), f"positive on the stop ({multiplier})"
        return "" if holds else f"`multiplier` is not proved {what}"
    if stage.departure is Departure.RELEASED:
        jerk = _jerk(flow, step.box, system.rate)
        left = bool(jerk > 0) and end is not None
        return "" if left else f"`d3h/dt3` is not proved positive at the release ({jerk})"
    gap, rate = step.box[system.gap], step.box[system.rate]
    struck, start = stage.departure is Departure.STRUCK, stage.at.box
    away = bool(start[system.rate if struck else system.gap] > 0)
    hump = away and bool(flow.rate(step.box)[system.rate] < 0)
    if end is None:
        once = hump or (away and not struck and bool(rate < 0))
        return "" if once else "`gap` is not proved to fall once only before an impact"
    clear = bool(rate > 0) if struck else bool(gap > 0)
    over = hump and bool(end > 0)
    return "" if clear or over else "`gap` is not proved positive in flight"


def _jerk(flow: BallFlow, box: list[Ball], rate: int) -> Ball:
    """Return the third derivative of the gap over a box."""
    return 2 * flow.point_series(box, 2)[rate][2]
