"""Follow orbits along a straight line of numbers, from where there is one (theory (33))."""

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
    follow_path,
    placed,
)
from zeno_orbits.search.fixed_point import ClosedCycle, close_cycle
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.simulation import SimulationSettings, scale_of

_STEPS = StepControl(first=0.25, shortest=1e-4)
"""Parts of the way: the first that is tried, and the least before it is given up."""

_LOST = {
    "locked_time": "the locked arc shrinks to nothing",
    "gap_acceleration": "d2h/dt2 at the Zeno point goes to zero: the stop no longer attracts",
    "first_impact_speed": "the first impact grazes",
}

_GONE = 0.02
"""A margin that has fallen to this part of what it was names the end of a family."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Followed:
    """Last orbit on a line of numbers.

    Attributes:
        cycle: The last orbit; ``None`` if there was none to start from.
        values: Its numbers.
        arrived: True if they are the ones that were wanted.
        ending: Place and reason of the end, as a sentence, if it did not arrive.
        left: Part of the way that is left.
    """

    cycle: Cycle | None
    values: ParameterValues
    arrived: bool
    ending: str = ""
    left: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Line:
    r"""The straight line between two sets of numbers: :math:`p(s) = (1 - s)\,p_0 + s\,p_1`.

    Attributes:
        search: The search.
        first: :math:`p_0`.
        last: :math:`p_1`.
        shape: The shape of the orbits.
    """

    search: SearchProblem
    first: ParameterValues
    last: ParameterValues
    shape: OrbitShape


@dataclass(frozen=True, slots=True, kw_only=True)
class _Point:
    """An orbit on the line.

    Attributes:
        part: :math:`s`.
        values: Its numbers.
        closed: The orbit.
        margins: Name to distance from losing it.
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
    search: SearchProblem, near: Cycle | ZenoOrbit, easy: ParameterValues, wanted: ParameterValues
) -> Followed:
    """Follow an orbit along a straight line of numbers.

    The next start is predicted by the secant of the last two and closed by simulation.

    Args:
        search: The search.
        near: An orbit, exactly or nearly.
        easy: Its numbers.
        wanted: The numbers to reach.
    """
    if isinstance(near, Cycle):
        start, scale = near.start.state, near.scale_at_events()
    else:
        start, *others = map(np.array, map(search.problem.state_vector, near.states_at_events))
        scale = scale_of([start, *others], search.problem.state_units)
    line = _Line(search=search, first=easy, last=wanted, shape=near.shape)
    try:
        first = _closed(line, 1.0 if easy == wanted else 0.0, start, scale, near.period)
    except (SimulationError, StepError):
        return Followed(cycle=None, values=easy, arrived=False)

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
        points = follow_path(first, _STEPS, advance, give_up=give_up).points
    cycle, reached = points[-1].closed.cycle, points[-1].part >= 1.0
    if reached:
        return Followed(cycle=cycle, values=wanted, arrived=True)
    ending = _ending(first, points[-1], easy, wanted)
    last = points[-1]
    return Followed(
        cycle=cycle, values=last.values, arrived=False, ending=ending, left=1 - last.part
    )


def _closed(line: _Line, part: float, guess: Vector, scale: Vector, period: float) -> _Point:
    """Return the orbit at a part of a line that closes near a guess.

    Args:
        line: The line.
        part: Place on it, from 0 to 1.
        guess: A state near its start, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Of the orbit, roughly [s].

    Raises:
        SimulationError: If none closes.
        StepError: If no motion can start there.
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
        # These numbers make no machine, or the guess is no state of it.
        raise StepError(str(error)) from error
    margins = _margins(dynamics, closed.cycle)
    return _Point(part=part, values=values, closed=closed, margins=margins)


def _margins(dynamics: HybridDynamics, cycle: Cycle) -> dict[str, float]:
    held = [(phase.zeno, phase.end) for phase in cycle.phases if phase.zeno is not None]
    margins = {"first_impact_speed": min(-p.impacts[0].approach_rate for p in cycle.phases)}
    if held:
        margins["locked_time"] = min(end.time - zeno.time for zeno, end in held)
        margins["gap_acceleration"] = min(-dynamics.gap_acceleration(z.state) for z, _ in held)
    return margins


def _ending(first: _Point, last: _Point, easy: ParameterValues, wanted: ParameterValues) -> str:
    """Return the end of a path and the margin that is lost there, as a sentence."""
    names = [n for n in easy.numbers if easy.number(n) != wanted.number(n)]
    numbers = ", ".join(f"{name} = {last.values.number(name):.5g}" for name in names)
    where = f"Orbits could be followed to {numbers}, not beyond"
    shares = {name: last.margins[name] / first.margins[name] for name in last.margins}
    name = min(shares, key=lambda one: shares[one])
    return f"{where}: there {_LOST[name]}." if shares[name] < _GONE else f"{where}."
