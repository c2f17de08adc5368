r"""Where the motions of a set meet their guard: the stop in flight, the release on the stop.

All of them cross in a window ``[a, b]`` if the guard is positive at `a`, negative at `b` and falls
in between. With :math:`\tau` the time and `g` the guard,
:math:`\partial\tau = -\partial g\,\partial\varphi / (\partial g\, f)` and the derivative of the map
to the guard is :math:`\partial\varphi + f\,\partial\tau`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from flint import arb

from zeno_orbits.errors import ProofError
from zeno_orbits.proof.ball_system import BallSystem, require_proved
from zeno_orbits.proof.balls import ONE, ZERO, Ball, Matrix, column, joined, matrix, product
from zeno_orbits.proof.flow import FlowStep
from zeno_orbits.proof.recurrences import Series
from zeno_orbits.proof.stage import Departure, ProofRecord, ProofStage

_SPARE = 1.05
"""How much wider than found a window is given, so that another arithmetic finds it wide enough."""
_LEAST_WINDOW = arb(2) ** -110
"""Least half width of a window, per period: a checker of fixed point must tell the guard from 0."""
_TRIES = 12
_GRID = 16
"""Parts of the time in which a crossing is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Guard:
    """The guard along a step: a value, its gradient and the flow, at states.

    Attributes:
        value: From states to the guard.
        terms: From states to gradient, ``(n,)``, and flow, ``(n,)``.
    """

    value: Callable[[Sequence[Ball]], Ball]
    terms: Callable[[Sequence[Ball]], tuple[list[Ball], list[Ball]]]


def _guard(system: BallSystem, departure: Departure) -> _Guard:
    if departure is Departure.LOCKED:
        locked = system.locked
        return _Guard(value=lambda y: locked.guard(y)[0], terms=lambda y: locked.guard(y)[1:])
    gradient = [ZERO] * system.n
    gradient[system.gap] = ONE
    return _Guard(value=lambda y: y[system.gap], terms=lambda y: (gradient, system.free.rate(y)))


def cross(
    system: BallSystem, stage: ProofStage, step: FlowStep, series: list[Series], guess: Ball
) -> tuple[ProofRecord, ProofStage]:
    """Return the record of a crossing in a step, and the set on the guard.

    That the guard falls to zero once only in the step is for the caller to know.

    Args:
        system: The problem.
        stage: Where the step starts.
        step: The step.
        series: Of the middle of the set.
        guess: Time of the crossing from the start of the step.

    Raises:
        ProofError: If it is not proved that all motions cross once in the step.
    """
    claim = "release" if stage.departure is Departure.LOCKED else "impact"
    guard, locked = _guard(system, stage.departure), stage.departure is Departure.LOCKED
    least = _LEAST_WINDOW * system.period
    a_m, b_m = _window(guard, step, guess, lambda t: step.point(series, t), None, claim, least)
    middle = joined(a_m, b_m)

    def spread(time: Ball) -> list[Ball]:
        return product(step.derivative(time), stage.at.deviation)

    a, b = _window(guard, step, guess, lambda t: step.point(series, t), spread, claim, least)
    a, b = _lesser(a, a_m), _greater(b, b_m)
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
    if not locked:
        image[system.gap] = ZERO
        derivative = _without_rows(derivative, (system.gap,))
    result = stage.at.mapped(image, derivative, system.groups["beside"])
    after = Departure.RELEASED if locked else Departure.STRUCK
    numbers = {"h": step.size, "window": [a, b], "centre": [a_m, b_m]}
    record = ProofRecord(kind="cross", numbers=numbers, orders=step.orders, result=result)
    return record, stage.next(result, after, stage.timed(middle, row))


def _window(
    guard: _Guard,
    step: FlowStep,
    guess: Ball,
    point: Callable[[Ball], list[Ball]],
    spread: Callable[[Ball], list[Ball]] | None,
    claim: str,
    least: Ball,
) -> tuple[Ball, Ball]:
    """Return two exact times around a guess, the guard positive at the first, negative then."""

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
    half = abs(here / speed).abs_upper() * _SPARE + least
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
    system: BallSystem, stage: ProofStage, points: list[Series], within: float
) -> float | None:
    """Return when the middle of a set meets its guard, if it does soon; not for certain.

    Args:
        system: The problem.
        stage: Where the set is.
        points: Taylor coefficients of its middle.
        within: How far to look [s].
    """
    if stage.departure is Departure.LOCKED:
        return _release_guess(system, points, within)
    coefficients = [float(c.mid()) for c in points[system.gap]]
    skipped = {Departure.FLYING: 0, Departure.STRUCK: 1, Departure.RELEASED: 3}[stage.departure]
    return _first_root(coefficients[skipped:], within)


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
