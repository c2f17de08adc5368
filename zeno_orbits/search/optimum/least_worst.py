r"""The least worst case of an objective over free values in the unit box, in boxes of trust.

Over corners `c` of uncertain parameters the program is the epigraph form

.. math:: \min_{u, t} t \quad\text{subject to}\quad J_{cj}(u) \le t,\quad g_c(u) \ge 0

where `j` counts the peaks of a signal, and has one value for other objectives. SciPy's SLSQP
[Kraft1988]_ solves it with exact derivatives in a box around the best values so far. Where a motion
cannot be followed, the method ends, and the next box is smaller.

Where an impact begins to exist by grazing, the objective has an edge, at which SLSQP stops. From
there a bundle method goes on: it minimises the largest of all linear models of near trials, a
linear program, in a box of trust [Makela2002]_.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.orbits import PathStep, StepControl, StepError, follow_path
from zeno_orbits.search.measures import Slope
from zeno_orbits.search.optimum.points import OrbitAtValues

_BOXES = StepControl(first=0.25, longest=1.0, shortest=1e-3, most=12, growth=2.0, shrinkage=0.25)
"""Half widths of boxes in units of the ranges."""
_ITERATIONS = 25
"""Iterations in one box."""
_MOST_IN_BOX = 30
"""Number of trials in one box. At an edge of the objective the method would take many."""
_HEIGHT = 10.0
"""Unit of the worst case in the program, over its first value. The first quadratic model bends by
one in every unknown, and with a large unit hardly in this one. A bend would take weight from the
rows."""
PRECISION = 1e-9
"""Change of the objective over its first value, below which the method has converged."""
_KEPT = 1e-9
"""Violation of a row that counts as none, in units of its bound: SLSQP leaves as much."""
_TRUSTED, _LEAST_TRUSTED = 1e-3, 1e-8
"""First and least half width of the box of trust of the bundle method."""
_NEAR = 4.0
"""Trials within this many half widths have a linear model."""
_MOST_MODELS, _MOST_TRIALS = 12, 60
"""Number of near trials with a model, and of trials of the bundle method."""
_SERIOUS, _GOOD = 0.1, 0.5
"""Parts of the predicted decrease from which a step is taken, and from which the box grows."""
_SMALL = 1e-6
"""Predicted decrease, relative, below which the bundle method has converged."""
_NOTHING = 1e-8
"""Part of its first value below which the objective is zero."""
_TOUCHES = 1e-6
"""Distance from a side of a box, over its half width, at which a value is held by the side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """Objective and rows at free values.

    Attributes:
        u: The free values in the unit box, ``(k,)``.
        points: The orbits, the first at the search's own parameters.
        costs: For each orbit the numbers whose largest is the objective there, with derivatives
            with respect to `u`. Every trial has as many.
        rows: Numbers that must not be negative.
        equal: Residuals, zero at an orbit.
    """

    u: Vector
    points: tuple[OrbitAtValues, ...]
    costs: tuple[tuple[Slope, ...], ...]
    rows: tuple[Slope, ...] = ()
    equal: tuple[Slope, ...] = ()

    @property
    def value(self) -> float:
        """The worst value of the objective."""
        return max(cost.value for cost in self.heights)

    @property
    def heights(self) -> tuple[Slope, ...]:
        """The numbers of all orbits, whose largest is the objective."""
        return tuple(cost for costs in self.costs for cost in costs)

    @property
    def violation(self) -> float:
        """Largest violation of a constraint, zero if all constraints hold."""
        worst = max(
            [0.0, *(-row.value for row in self.rows), *(abs(row.value) for row in self.equal)]
        )
        return worst if worst > _KEPT else 0.0

    @property
    def rank(self) -> tuple[float, float]:
        """Order of trials: first the violation, then the objective."""
        return self.violation, self.value


@dataclass(frozen=True, slots=True, kw_only=True)
class Optimum:
    """The best trial.

    Attributes:
        trial: The trial.
        converged: True if no box limits it and no motion failed.
        reason: Reason why the search ended otherwise.
    """

    trial: Sample
    converged: bool
    reason: str = ""


def along_edges(evaluate: Callable[[Vector], Sample], found: Optimum, size: float) -> Optimum:
    """Return the least worst value near another, where the objective may have edges.

    Args:
        evaluate: Function of the free values in the unit box, as for `least_worst`.
        found: The best trial so far.
        size: Size of the objective.
    """
    best, half = found.trial, _TRUSTED
    known = [best]
    for _ in range(_MOST_TRIALS):
        if abs(best.value) <= _NOTHING * size:
            return Optimum(trial=best, converged=True)
        near = [one for one in known if float(np.max(np.abs(one.u - best.u))) <= _NEAR * half]
        u, decrease = _least_of_models(best, near[-_MOST_MODELS:], half)
        if decrease <= _SMALL * abs(best.value):
            return Optimum(trial=best, converged=True)
        try:
            there = evaluate(u)
        except (SimulationError, StepError) as error:
            half /= 4.0
            if half < _LEAST_TRUSTED:
                return Optimum(trial=best, converged=False, reason=str(error))
            continue
        known.append(there)
        gained = best.value - there.value
        if there.violation <= best.violation and gained > _SERIOUS * decrease:
            best = there
            half *= 2.0 if gained > _GOOD * decrease else 1.0
        else:
            half /= 2.0
        if half < _LEAST_TRUSTED:
            return Optimum(trial=best, converged=True)
    return Optimum(trial=best, converged=False, reason="the objective still decreases")


def _least_of_models(best: Sample, near: Sequence[Sample], half: float) -> tuple[Vector, float]:
    """Return the minimum of the models in a box, and the predicted decrease of the objective.

    The unknowns of the linear program are the step over the half width, and the decrease over the
    objective, because the solver has absolute tolerances.
    """
    # SciPy's optimizers take a while to import.
    from scipy.optimize import linprog

    k, size = len(best.u), abs(best.value)
    left: list[Vector] = []
    right: list[float] = []
    for trial in {id(one): one for one in (best, *near)}.values():
        for cost in trial.heights:
            left.append(np.append(cost.by * half / size, [1.0]))
            # A model of another trial must not lie above the objective here.
            here = cost.value + float(cost.by @ (best.u - trial.u))
            right.append(max(best.value - here, 0.0) / size)
    for row in best.rows:
        left.append(np.append(-row.by * half, [0.0]))
        right.append(row.value)
    fixed = [np.append(row.by * half, [0.0]) for row in best.equal]
    low, high = np.maximum(-best.u / half, -1.0), np.minimum((1.0 - best.u) / half, 1.0)
    solved: Any = linprog(
        -np.eye(k + 1)[k],
        A_ub=np.array(left),
        b_ub=np.array(right),
        A_eq=np.array(fixed) if fixed else None,
        b_eq=np.array([-row.value for row in best.equal]) if fixed else None,
        bounds=[*zip(low, high, strict=True), (0.0, None)],
    )
    if solved.x is None:
        return best.u, 0.0
    return np.clip(best.u + half * solved.x[:k], 0.0, 1.0), size * float(solved.x[k])


class _Refused(Exception):  # noqa: N818 (it ends a method, and is no error)
    """A motion could not be followed."""


def least_worst(
    evaluate: Callable[[Vector], Sample], first: Sample, *, precision: float = PRECISION
) -> Optimum:
    """Return the least worst value near a first trial.

    Args:
        evaluate: Function of the free values in the unit box. It raises `SimulationError` or
            `StepError` where orbits do not exist.
        first: The trial at which the search starts.
        precision: Change of the objective over its first value, below which it has converged.
    """
    reasons: list[str] = []

    def advance(trials: Sequence[Sample], half: float) -> PathStep[Sample, bool]:
        best = trials[-1]
        box = np.clip(np.stack([best.u - half, best.u + half], axis=1), 0.0, 1.0)
        found, ended, reason = _in_box(evaluate, best, box, abs(first.value) or 1.0, precision)
        better = found.rank < best.rank
        if reason:
            reasons.append(reason)
            if not better:
                raise StepError(reason)
            return PathStep(points=(found,))
        held = _is_held(found.u, box)
        points = (found,) if better else ()
        if ended and not held:
            return PathStep(points=points, end=True)
        if not better and best.violation and half >= 1.0:
            return PathStep(end=False)
        if not better:
            raise StepError("the objective cannot be decreased")
        return PathStep(points=points, easy=held)

    def give_up(_trials: Sequence[Sample], reason: str) -> PathStep[Sample, bool]:
        reasons.append(reason)
        return PathStep(end=False)

    control = _BOXES if first.violation == 0.0 else _WHOLE
    path = follow_path(first, control, advance, give_up=give_up)
    converged = path.end is True
    reason = "" if converged or not reasons else reasons[-1]
    return Optimum(trial=path.points[-1], converged=converged, reason=reason)


_WHOLE = StepControl(first=1.0, longest=1.0, shortest=1e-3, most=12, growth=2.0, shrinkage=0.25)
"""The same from values that violate a bound: the first box is the whole range."""


def _in_box(
    evaluate: Callable[[Vector], Sample], first: Sample, box: Vector, size: float, precision: float
) -> tuple[Sample, bool, str]:
    """Return the best trial in a box, whether the method converged, and why a motion failed."""
    # SciPy's optimizers take a while to import.
    from scipy.optimize import minimize

    k, several = len(first.u), len(first.heights) > 1
    known: dict[bytes, Sample] = {first.u.tobytes(): first}

    def at(z: Vector) -> Sample:
        u = np.clip(np.array(z[:k]), box[:, 0], box[:, 1])
        key = u.tobytes()
        if key not in known:
            if len(known) > _MOST_IN_BOX:
                raise _Refused("the objective has an edge")
            try:
                known[key] = evaluate(u)
            except (SimulationError, StepError) as error:
                raise _Refused(str(error)) from error
        return known[key]

    def row(slope: Slope, above: float) -> Vector:
        return np.append(slope.by, [above]) if several else slope.by

    def value(z: Vector) -> float:
        return _HEIGHT * float(z[k]) if several else at(z).heights[0].value / size

    def gradient(z: Vector) -> Vector:
        return _HEIGHT * np.eye(k + 1)[k] if several else at(z).heights[0].by / size

    def rows(z: Vector) -> Vector:
        here = at(z)
        under = [_HEIGHT * z[k] - cost.value / size for cost in here.heights] if several else []
        return np.array([*under, *(one.value for one in here.rows)])

    def rows_by(z: Vector) -> Vector:
        here = at(z)
        under = [row(cost.scaled(-1 / size), _HEIGHT) for cost in here.heights] if several else []
        return np.array([*under, *(row(one, 0.0) for one in here.rows)])

    def equal(z: Vector) -> Vector:
        return np.array([one.value for one in at(z).equal])

    def equal_by(z: Vector) -> Vector:
        return np.array([row(one, 0.0) for one in at(z).equal])

    constraints: list[Any] = []
    if several or first.rows:
        constraints.append({"type": "ineq", "fun": rows, "jac": rows_by})
    if first.equal:
        constraints.append({"type": "eq", "fun": equal, "jac": equal_by})
    begin = np.append(first.u, [first.value / size / _HEIGHT]) if several else first.u
    sides: list[Any] = [*map(tuple, box), *([(None, None)] if several else [])]
    ended, reason = False, ""
    try:
        solved: Any = minimize(
            value,
            begin,
            jac=gradient,
            bounds=sides,
            constraints=constraints,
            method="SLSQP",
            options={"maxiter": _ITERATIONS, "ftol": precision},
        )
        ended = bool(solved.success)
    except _Refused as error:
        reason = str(error)
    return min(known.values(), key=lambda trial: trial.rank), ended, reason


def _is_held(u: Vector, box: Vector) -> bool:
    """Return True if a value is at a side of its box that is not a side of the whole range."""
    near = _TOUCHES * (box[:, 1] - box[:, 0])
    low = (u - box[:, 0] <= near) & (box[:, 0] > 0.0)
    high = (box[:, 1] - u <= near) & (box[:, 1] < 1.0)
    return bool(np.any(low | high))
