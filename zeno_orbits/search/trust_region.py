"""A search in small steps: each in a box around the last orbit, as wide as earlier steps allow.

A program is transcribed around one orbit and is valid only near it. If the whole distance is too
large for one program, each step solves a new program around the simulated solution of the last
step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from zeno_orbits.model import ParameterValues
from zeno_orbits.orbits import Cycle, PathStep, StepControl, StepError, follow_path
from zeno_orbits.search.outcome import StartOutcome
from zeno_orbits.search.refinement import ON_THE_WAY
from zeno_orbits.search.search_problem import SearchProblem

_BOXES = StepControl(first=0.1, shortest=2e-3, most=40, growth=2.0, shrinkage=0.25)
"""Half widths of boxes in units of the whole range."""

_TOUCHES = 1e-3
"""Distance below which a value is limited by a side of its box, in units of the half width."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LastStep:
    """The end of a sequence of steps.

    Attributes:
        values: Values at the end.
        cycle: One simulated period at these values.
        outcome: Outcome of the last accepted step, or ``None`` without an accepted step.
        converged: True at an optimum, False if a further step failed.
    """

    values: ParameterValues
    cycle: Cycle
    outcome: StartOutcome | None = None
    converged: bool = False


def trust_region_steps(
    search: SearchProblem,
    values: ParameterValues,
    cycle: Cycle,
    solve: Callable[[SearchProblem, ParameterValues, Cycle], StartOutcome],
) -> LastStep:
    """Solve a sequence of programs, each in a box around the last orbit, and return the last step.

    Args:
        search: The search. All steps stay in its box.
        values: Values of the first orbit.
        cycle: One simulated period of the first orbit.
        solve: Function that computes a step, given the search in a smaller box.
    """

    def advance(steps: Sequence[LastStep], half: float) -> PathStep[LastStep, bool]:
        last = steps[-1]
        box = _box_around(search, last.values, half)
        outcome = solve(replace(search, free=box), last.values, last.cycle)
        there = outcome.solution
        if there is None or not outcome.agreement < ON_THE_WAY:
            raise StepError(outcome.detail)
        converged = not _is_held(search, there.values, box)
        step = LastStep(
            values=there.values, cycle=there.cycle, outcome=outcome, converged=converged
        )
        return PathStep(points=(step,), easy=True, end=True if converged else None)

    def give_up(_steps: Sequence[LastStep], _reason: str) -> PathStep[LastStep, bool]:
        return PathStep(end=False)

    start = LastStep(values=values, cycle=cycle)
    return follow_path(start, _BOXES, advance, give_up=give_up).points[-1]


def _box_around(
    search: SearchProblem, values: ParameterValues, half: float
) -> dict[str, tuple[float, float]]:
    box: dict[str, tuple[float, float]] = {}
    for name, (low, high) in search.free.items():
        here, reach = values.number(name), half * (high - low)
        box[name] = (max(low, here - reach), min(high, here + reach))
    return box


def _is_held(
    search: SearchProblem, values: ParameterValues, box: dict[str, tuple[float, float]]
) -> bool:
    """Return True if a value is at a side of its small box that is not a side of the whole box."""
    for name, (low, high) in box.items():
        here, near = values.number(name), _TOUCHES * (high - low)
        whole = search.free[name]
        if (here - low < near and low > whole[0]) or (high - here < near and high < whole[1]):
            return True
    return False
