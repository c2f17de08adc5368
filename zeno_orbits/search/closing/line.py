"""Orbits along a straight line of values, up to its end or to an extrapolated loss (theory (5.4)).

The orbit is closed at each point of the line, from the secant through the last two. Its
margins vanish where the orbit is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import ParameterValues
from zeno_orbits.orbits import EventReturn, PathStep, StepControl, follow_path

_GONE = 0.02
"""A margin below this part of its first value vanishes at the end of a path."""
_ALIKE = 0.75
"""Ratio of the logarithmic decreases of two margins above which they vanish in proportion."""
_TOGETHER = 0.25
"""The same for a margin that vanishes as a power of another margin."""
_EXTRAPOLATED = 4
"""Number of orbits from which the end of a path is extrapolated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinePoint:
    """An orbit on a line.

    Attributes:
        part: Position on the line, from 0 to 1.
        start: Start of the period, ``(n_x,)``.
        orbit: The orbit.
        margins: Name to distance to a loss of existence.
    """

    part: float
    start: Vector
    orbit: EventReturn
    margins: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Followed:
    """Last orbit on a straight line between two sets of parameter values.

    Attributes:
        orbit: The last orbit, or ``None`` without a first orbit.
        values: Values of the last orbit.
        arrived: True if these are the target values.
        ending: Point and reason of the end, as a sentence. Empty if the target was reached.
        loss: The reason alone, as a clause.
        refusal: Reason why the last step was rejected, as a sentence without a full stop.
        left: Remaining part of the line.
        end: Extrapolated part of the line at which the family ends, or 1 at the target.
        end_error: Estimated error of ``end``.
    """

    orbit: EventReturn | None
    values: ParameterValues
    arrived: bool
    ending: str = ""
    loss: str = ""
    refusal: str = ""
    left: float = 0.0
    end: float = 1.0
    end_error: float = 0.0


def values_on_line(first: ParameterValues, last: ParameterValues, part: float) -> ParameterValues:
    r"""Return the values :math:`p(s) = (1 - s)\,p_0 + s\,p_1` at a position on a line.

    Args:
        first: :math:`p_0`.
        last: :math:`p_1`.
        part: :math:`s`.
    """
    numbers = {n: (1 - part) * x + part * last.number(n) for n, x in first.numbers.items()}
    return first.replaced(numbers)


def follow_line(
    first: LinePoint,
    closed: Callable[[float, Vector, LinePoint], LinePoint],
    easy: ParameterValues,
    wanted: ParameterValues,
    *,
    steps: StepControl,
    losses: Mapping[str, str],
    tell: Callable[[str], object],
) -> Followed:
    """Continue an orbit along a straight line of values.

    Args:
        first: The first orbit. If it is at the end of the line, nothing is followed.
        closed: Function that closes an orbit: of its part of the line, a guess of its start, and
            the last orbit. It raises `SimulationError` or `StepError` to reject the step.
        easy: Values at the start of the line.
        wanted: Values at its end.
        steps: Lengths of steps, as parts of the line.
        losses: Name of each margin to the loss where it vanishes, as a clause. A cause precedes the
            margins that vanish in proportion to it (theory (5.8)).
        tell: Receives progress reports.
    """
    refusal = ""

    def advance(points: Sequence[LinePoint], step: float) -> PathStep[LinePoint, bool]:
        here, before = points[-1], points[-2:][0]
        part = min(1.0, here.part + step)
        guess = here.start
        if before.part < here.part:
            ratio = (part - here.part) / (here.part - before.part)
            guess = guess + ratio * (here.start - before.start)
        tell(f"following orbits: {100 * part:.0f} % of the way")
        there = closed(part, guess, here)
        return PathStep(points=(there,), easy=True, end=True if part >= 1.0 else None)

    def give_up(_points: Sequence[LinePoint], reason: str) -> PathStep[LinePoint, bool]:
        nonlocal refusal
        refusal = reason
        return PathStep(end=False)

    points: tuple[LinePoint, ...] = (first,)
    if first.part < 1.0:
        points = follow_path(first, steps, advance, give_up=give_up).points
    last = points[-1]
    if last.part >= 1.0:
        return Followed(orbit=last.orbit, values=wanted, arrived=True)
    cause, end, error = _end_of(points, losses, steps.shortest)
    loss = "the orbit is followed no farther" if cause is None else losses[cause]
    where = _place(easy, wanted, end, 0.0 if cause is None else error)
    reached = f"Orbits could be followed to {where}, not beyond"
    return Followed(
        orbit=last.orbit,
        values=values_on_line(easy, wanted, last.part),
        arrived=False,
        ending=f"{reached}." if cause is None else f"{reached}: there {loss}.",
        loss=loss,
        refusal=refusal,
        left=1 - last.part,
        end=end,
        end_error=error,
    )


def _place(easy: ParameterValues, wanted: ParameterValues, part: float, error: float) -> str:
    """Return the values that change along a line, at a part of it, as text."""
    numbers = {
        name: ((1 - part) * value + part * wanted.number(name), wanted.number(name) - value)
        for name, value in easy.numbers.items()
        if value != wanted.number(name)
    }
    return ", ".join(
        f"{name} = {_digits(value, error * abs(span))}" for name, (value, span) in numbers.items()
    )


def _cause(points: Sequence[LinePoint], losses: Mapping[str, str]) -> str | None:
    """Return the margin whose loss ends a path, among the margins that vanish there.

    The cause decreases slowest: the other margins vanish as a power of it. If several margins
    vanish in proportion, the cause is the first of them in `losses`.
    """
    if len(points) < 2:
        return None
    before, last = points[-2].margins, points[-1].margins
    falls = {
        name: float(np.log(before[name] / value))
        for name, value in last.items()
        if 0.0 < value < before.get(name, 0.0)
    }
    # A margin such as the least gap of a flight may exist on a part of the way only.
    first = {name: next(p.margins[name] for p in points if name in p.margins) for name in falls}
    gone = [name for name in falls if last[name] < _GONE * first[name]]
    if not gone:
        return None
    steepest = max(falls[name] for name in gone)
    together = {name: fall for name, fall in falls.items() if fall > _TOGETHER * steepest}
    slowest = min(together.values())
    alike = [name for name, fall in together.items() if fall * _ALIKE < slowest]
    return next(name for name in losses if name in alike)


def _end_of(
    points: Sequence[LinePoint], losses: Mapping[str, str], shortest: float
) -> tuple[str | None, float, float]:
    """Return the margin whose loss ends a path, the part at which it vanishes, and its error."""
    last = points[-1].part
    cause = _cause(points, losses)
    if cause is not None:
        end, error = _zero_of(points, cause)
        if last <= end <= last + _NEAR * shortest:
            return cause, end, error
    # A margin may fall far and not vanish. The end is within the last rejected step.
    for name in losses:
        used = [point.margins.get(name) for point in points[-_EXTRAPOLATED:]]
        values = [value for value in used if value is not None]
        if 1 < len(values) == len(used) and all(a > b > 0.0 for a, b in pairwise(values)):
            end, error = _zero_of(points, name)
            nearest = max(last, end - error)
            if nearest <= end and nearest <= last + _REJECTED * shortest and error <= shortest:
                return name, end, error
    return cause, last, shortest if cause is None else _NEAR * shortest


def _zero_of(points: Sequence[LinePoint], name: str) -> tuple[float, float]:
    """Return the part of a path at which a margin vanishes, and the last change of the result.

    A polynomial of the margin interpolates the part through the last orbits. It is evaluated at
    zero.
    """
    used = [point for point in points if name in point.margins][-_EXTRAPOLATED:]
    margins = [point.margins[name] for point in used]
    table, change = [point.part for point in used], np.inf
    for order in range(1, len(used)):
        before = table[-1]
        table = [
            (margins[k + order] * table[k] - margins[k] * table[k + 1])
            / (margins[k + order] - margins[k])
            for k in range(len(table) - 1)
        ]
        change = abs(table[-1] - before)
    return table[0], change


_NEAR = 10.0
"""Largest distance of an end from the last orbit, in units of the shortest step."""
_REJECTED = 2.0
"""Largest length of the last rejected step, in units of the shortest step."""
_MOST_DIGITS = 5


def _digits(value: float, error: float) -> str:
    """Format a value with as many digits as its error allows, at most five."""
    unit = 10.0 ** np.floor(np.log10(abs(value) or 1.0))
    digits = _MOST_DIGITS
    while digits > 1 and 0.5 * unit * 10.0 ** (1 - digits) < error:
        digits -= 1
    return f"{value:.{digits}g}"
