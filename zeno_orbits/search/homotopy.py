"""Continue orbits along a straight line of values, from values with a known orbit (theory (33))."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import HybridDynamics, ParameterValues
from zeno_orbits.orbits import (
    Cycle,
    OrbitShape,
    PathStep,
    StepControl,
    StepError,
    ZenoOrbit,
    floquet_multipliers,
    follow_path,
    placed,
)
from zeno_orbits.search.fixed_point import ClosedCycle, close_cycle
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.simulation import SimulationSettings, scale_of

_STEPS = StepControl(first=0.25, shortest=1e-4)
"""First and smallest step, as parts of the line."""

_LOST = {
    "amplitude": "the amplitude is zero",
    "locked_time": "the locked arc vanishes",
    "gap_acceleration": "d2h/dt2 at the Zeno point is zero",
    "first_impact_speed": "the first impact grazes",
    "release_rate": "the release is not transversal",
    "attraction": "the orbit loses stability",
}
"""Ends of a family. A cause precedes the margins that vanish in proportion to it (theory (40))."""

_GONE = 0.02
"""A margin below this part of its first value vanishes at the end of a path."""
_ALIKE = 0.75
"""Ratio of the logarithmic decreases of two margins above which they vanish in proportion."""
_TOGETHER = 0.25
"""The same for a margin that vanishes as a power of another margin."""
_EXTRAPOLATED = 4
"""Number of orbits from which the end of a path is extrapolated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Followed:
    """Last orbit on a straight line between two sets of parameter values.

    Attributes:
        cycle: The last orbit, or ``None`` without a first orbit.
        values: Values of the last orbit.
        arrived: True if these are the target values.
        ending: Point and reason of the end, as a sentence. Empty if the target was reached.
        loss: The reason alone, as a clause.
        left: Remaining part of the line.
        end: Extrapolated part of the line at which the family ends, or 1 at the target.
        end_error: Estimated error of ``end``.
    """

    cycle: Cycle | None
    values: ParameterValues
    arrived: bool
    ending: str = ""
    loss: str = ""
    left: float = 0.0
    end: float = 1.0
    end_error: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Line:
    r"""The straight line between two sets of values: :math:`p(s) = (1 - s)\,p_0 + s\,p_1`.

    Attributes:
        search: The search.
        first: :math:`p_0`.
        last: :math:`p_1`.
        shape: The shape of the orbits.
        attracting: True if orbits that are not stable are rejected.
    """

    search: SearchProblem
    first: ParameterValues
    last: ParameterValues
    shape: OrbitShape
    attracting: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class _Point:
    """An orbit on the line.

    Attributes:
        part: :math:`s`.
        values: Values of the gains and parameters there.
        closed: The orbit.
        margins: Name to distance to a loss of existence.
    """

    part: float
    values: ParameterValues
    closed: ClosedCycle
    margins: Mapping[str, float]

    @property
    def start(self) -> Vector:
        """Start of the period, ``(n_x,)``."""
        return self.closed.cycle.start.state


def follow(
    search: SearchProblem,
    near: Cycle | ZenoOrbit,
    easy: ParameterValues,
    wanted: ParameterValues,
    *,
    steps: StepControl = _STEPS,
    attracting: bool = False,
) -> Followed:
    """Continue an orbit along a straight line of values.

    The next initial state is predicted by the secant through the last two orbits, and corrected by
    closing the orbit by simulation.

    Args:
        search: The search.
        near: An orbit, exact or approximate.
        easy: Values of this orbit.
        wanted: Target values.
        steps: Lengths of steps, as parts of the line.
        attracting: Reject orbits that are not stable.
    """
    if isinstance(near, Cycle):
        start, scale = near.start.state, near.scale_at_events()
    else:
        start, *others = map(np.array, map(search.problem.state_vector, near.states_at_events))
        scale = scale_of([start, *others], search.problem.state_units)
    line = _Line(search=search, first=easy, last=wanted, shape=near.shape, attracting=attracting)
    try:
        first = _closed(line, 1.0 if easy == wanted else 0.0, start, scale, near.period)
    except (SimulationError, StepError):
        return Followed(cycle=None, values=easy, arrived=False, left=1.0, end=0.0)

    def advance(points: Sequence[_Point], step: float) -> PathStep[_Point, bool]:
        here, before = points[-1], points[-2:][0]
        part = min(1.0, here.part + step)
        guess = here.start
        if before.part < here.part:
            ratio = (part - here.part) / (here.part - before.part)
            guess = guess + ratio * (here.start - before.start)
        search.tell(f"following orbits: {100 * part:.0f} % of the way")
        cycle = here.closed.cycle
        there = _closed(line, part, guess, cycle.scale_at_events(), cycle.period)
        return PathStep(points=(there,), easy=True, end=True if part >= 1.0 else None)

    def give_up(_points: Sequence[_Point], _reason: str) -> PathStep[_Point, bool]:
        return PathStep(end=False)

    points: tuple[_Point, ...] = (first,)
    if first.part < 1.0:
        points = follow_path(first, steps, advance, give_up=give_up).points
    cycle, reached = points[-1].closed.cycle, points[-1].part >= 1.0
    if reached:
        return Followed(cycle=cycle, values=wanted, arrived=True)
    last, cause = points[-1], _cause(points)
    end, error = (last.part, steps.shortest)
    if cause is not None:
        end, error = _end_of(points, cause, steps.shortest)
    return Followed(
        cycle=cycle,
        values=last.values,
        arrived=False,
        ending=_ending(line, points),
        loss="the orbit is followed no farther" if cause is None else _LOST[cause],
        left=1 - last.part,
        end=end,
        end_error=error,
    )


def _closed(line: _Line, part: float, guess: Vector, scale: Vector, period: float) -> _Point:
    """Return the orbit at a point of a line, closed from a guess.

    Args:
        line: The line.
        part: Position on the line, from 0 to 1.
        guess: A state near the orbit's start, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Approximate period of the orbit [s].

    Raises:
        SimulationError: If no orbit closes.
        StepError: If the values or the guess are not valid.
    """
    first, last = line.first, line.last
    numbers = {n: (1 - part) * x + part * last.number(n) for n, x in first.numbers.items()}
    values = first.replaced(numbers)
    try:
        dynamics = line.search.dynamics(values)
        start = placed(dynamics, line.shape, guess)
        closed = close_cycle(
            dynamics,
            start,
            scale=scale,
            period=period,
            settings=SimulationSettings(),
            shape=line.shape,
        )
    except (InputError, np.linalg.LinAlgError) as error:
        # These values are not valid for the problem, or the guess is not a valid state.
        raise StepError(str(error)) from error
    margins = _margins(dynamics, closed.cycle)
    if line.attracting:
        margins["attraction"] = _attraction(dynamics, closed.cycle)
    return _Point(part=part, values=values, closed=closed, margins=margins)


def _margins(dynamics: HybridDynamics, cycle: Cycle) -> dict[str, float]:
    held = [(phase.zeno, phase.end) for phase in cycle.phases if phase.zeno is not None]
    margins = {
        "amplitude": _amplitude(dynamics, cycle),
        "first_impact_speed": min(-p.impacts[0].approach_rate for p in cycle.phases),
    }
    if held:
        margins["locked_time"] = min(end.time - zeno.time for zeno, end in held)
        margins["gap_acceleration"] = min(-dynamics.gap_acceleration(z.state) for z, _ in held)
        margins["release_rate"] = min(-dynamics.multiplier_rate(end.state) for _, end in held)
    return margins


def _attraction(dynamics: HybridDynamics, cycle: Cycle) -> float:
    """Return the distance of the spectral radius from 1.

    Raises:
        StepError: If the orbit is not stable.
    """
    multipliers = floquet_multipliers(
        dynamics,
        cycle.start.state,
        scale=cycle.scale_at_events(),
        period=cycle.period,
        settings=SimulationSettings(),
        shape=cycle.shape,
    )
    left = 1.0 - multipliers.spectral_radius
    if not left > multipliers.error:
        raise StepError(f"The orbit is not stable: its spectral radius is {1.0 - left:.6g}")
    return left


_PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Parts of an arc at which states are compared. They are fixed, so the range varies smoothly."""


def _amplitude(dynamics: HybridDynamics, cycle: Cycle) -> float:
    """Return the largest relative range of a state, except the clock's states, over a period."""
    n_x = cycle.start.state.size
    states = [arc.flow_state_at(part * arc.duration)[:n_x] for arc in cycle.arcs for part in _PARTS]
    ranges = np.ptp(np.array(states), axis=0) / dynamics.own.states(n_x)
    return float(np.max(np.delete(ranges, dynamics.clock)))


def _ending(line: _Line, points: Sequence[_Point]) -> str:
    """Return the end of a path and the margin that vanishes there, as a sentence."""
    last = points[-1]
    cause = _cause(points)
    part, error = (last.part, 0.0) if cause is None else _end_of(points, cause, _STEPS.shortest)
    numbers = {
        name: ((1 - part) * value + part * line.last.number(name), line.last.number(name) - value)
        for name, value in line.first.numbers.items()
        if value != line.last.number(name)
    }
    shown = ", ".join(
        f"{name} = {_digits(value, error * abs(span))}" for name, (value, span) in numbers.items()
    )
    where = f"Orbits could be followed to {shown}, not beyond"
    return f"{where}." if cause is None else f"{where}: there {_LOST[cause]}."


def _cause(points: Sequence[_Point]) -> str | None:
    """Return the margin whose loss ends a path, among the margins that vanish there.

    The cause decreases slowest: the other margins vanish as a power of it. If several margins
    vanish in proportion, the cause is the first of them in `_LOST`.
    """
    if len(points) < 2:
        return None
    first, before, last = points[0].margins, points[-2].margins, points[-1].margins
    falls = {
        name: float(np.log(before[name] / value))
        for name, value in last.items()
        if 0.0 < value < before.get(name, 0.0)
    }
    gone = [name for name in falls if last[name] < _GONE * first[name]]
    if not gone:
        return None
    steepest = max(falls[name] for name in gone)
    together = {name: fall for name, fall in falls.items() if fall > _TOGETHER * steepest}
    slowest = min(together.values())
    alike = [name for name, fall in together.items() if fall * _ALIKE < slowest]
    return next(name for name in _LOST if name in alike)


def _end_of(points: Sequence[_Point], cause: str, shortest: float) -> tuple[float, float]:
    """Return the part of a path at which a margin vanishes, and its error.

    A polynomial of the margin interpolates the part through the last orbits. It is evaluated at
    zero.
    """
    used = points[-_EXTRAPOLATED:]
    margins = [point.margins[cause] for point in used]
    table, change = [point.part for point in used], np.inf
    for order in range(1, len(used)):
        before = table[-1]
        table = [
            (margins[k + order] * table[k] - margins[k] * table[k + 1])
            / (margins[k + order] - margins[k])
            for k in range(len(table) - 1)
        ]
        change = abs(table[-1] - before)
    last = points[-1].part
    if not last <= table[0] <= last + _NEAR * shortest:
        return last, _NEAR * shortest
    return table[0], change


_NEAR = 10.0
"""Largest distance of an end from the last orbit, in units of the shortest step."""
_MOST_DIGITS = 5


def _digits(value: float, error: float) -> str:
    """Format a value with as many digits as its error allows, at most five."""
    unit = 10.0 ** np.floor(np.log10(abs(value) or 1.0))
    digits = _MOST_DIGITS
    while digits > 1 and 0.5 * unit * 10.0 ** (1 - digits) < error:
        digits -= 1
    return f"{value:.{digits}g}"
