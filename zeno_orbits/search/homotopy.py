"""Orbits followed along a straight line of settings, from one that has an orbit (theory (33))."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import ParameterValues
from zeno_orbits.orbits.cycle import Cycle
from zeno_orbits.orbits.path import Step, StepControl, StepError, follow_path
from zeno_orbits.orbits.period import placed
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.search.closing import ClosedCycle, close_cycle
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.simulation.simulator import SimulationSettings

_STEPS = StepControl(first=0.25, shortest=1e-4)
"""Steps in parts of the way."""

_LOST = {
    "locked_time": "the locked arc shrinks to nothing",
    "gap_acceleration": "the stop stops attracting at the Zeno point: d2h/dt2 comes to zero",
    "first_impact_speed": "the first impact comes to graze",
}

_GONE = 0.02
"""A margin that has fallen to this part of what it was names the end of a family."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Path:
    """How far orbits could be followed.

    Attributes:
        cycle: The last orbit; ``None`` if there was none to start from.
        values: Its numbers.
        arrived: Whether they are the ones that were wanted.
        ending: Where and why the path ends, as a sentence, if it did not arrive.
    """

    cycle: Cycle | None
    values: ParameterValues
    arrived: bool
    ending: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Point:
    part: float
    values: ParameterValues
    closed: ClosedCycle
    margins: Mapping[str, float]

    @property
    def start(self) -> Vector:
        """Where the period starts, ``(n_x,)``."""
        return self.closed.cycle.start.state


def follow(
    search: SearchProblem,
    easy: ParameterValues,
    start: Vector,
    wanted: ParameterValues,
    shape: OrbitShape,
) -> Path:
    r"""Follow an orbit from one setting to another: :math:`p(s) = (1 - s)\,p_0 + s\,p_1`.

    The next release is predicted by the secant of the last two and closed by simulation.

    Args:
        search: The search.
        easy: Numbers of an orbit, exactly or nearly.
        start: Where its period starts, ``(n_x,)``.
        wanted: Where to go.
        shape: Its shape.
    """
    period = search.settings.settling.chunk
    here = _closed(search, 0.0, easy, wanted, start, period, shape)
    if here is None:
        return Path(cycle=None, values=easy, arrived=False)
    first = here
    if easy != wanted:

        def advance(points: Sequence[_Point], step: float) -> Step[_Point, bool]:
            last = points[-1]
            part = min(1.0, last.part + step)
            guess = last.start
            if len(points) > 1:
                before = points[-2]
                ratio = (part - last.part) / (last.part - before.part)
                guess = guess + ratio * (last.start - before.start)
            search.tell(f"following orbits: {100 * part:.0f} % of the way")
            there = _closed(search, part, easy, wanted, guess, last.closed.cycle.period, shape)
            if there is None:
                raise StepError("no orbit closes")
            return Step(points=(there,), easy=True, end=True if part >= 1.0 else None)

        def give_up(_points: Sequence[_Point], _reason: str) -> Step[_Point, bool]:
            return Step(end=False)

        path = follow_path(here, _STEPS, advance, give_up=give_up)
        here = path.points[-1]
    if here.part >= 1.0 or easy == wanted:
        return Path(cycle=here.closed.cycle, values=wanted, arrived=True)
    return Path(
        cycle=here.closed.cycle,
        values=here.values,
        arrived=False,
        ending=_ending(first, here, easy, wanted),
    )


def _closed(
    search: SearchProblem,
    part: float,
    easy: ParameterValues,
    wanted: ParameterValues,
    guess: Vector,
    period: float,
    shape: OrbitShape,
) -> _Point | None:
    """Return the orbit at a part of the way, if one closes near a guess."""
    numbers = {n: (1 - part) * x + part * wanted.number(n) for n, x in easy.numbers.items()}
    values = wanted if part == 1.0 else easy.replaced(numbers)
    try:
        dynamics = search.dynamics(values)
        start = placed(dynamics, shape, guess)
        closed = close_cycle(
            dynamics,
            start,
            scale=np.maximum(np.abs(start), 1.0),
            period=period,
            settings=SimulationSettings(),
            shape=shape,
        )
    except (ZenoOrbitsError, ValueError):
        return None
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
    """Return where a path ends and which margin is lost there."""
    names = [n for n in easy.numbers if easy.number(n) != wanted.number(n)]
    numbers = ", ".join(f"{name} = {last.values.number(name):.5g}" for name in names)
    where = f"Orbits could be followed to {numbers}, not beyond"
    shares = {name: last.margins[name] / first.margins[name] for name in last.margins}
    name = min(shares, key=lambda one: shares[one])
    return f"{where}: there {_LOST[name]}." if shares[name] < _GONE else f"{where}."
