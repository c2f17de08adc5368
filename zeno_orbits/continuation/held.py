r"""The repelling orbits of a family, each kept by the feedback of least effort.

With the least sum of squares of the inputs, each relative to its own value, a disturbance `y` costs
:math:`y^\top P y`. The effort of an orbit is the root of the largest eigenvalue of `P`: the change
of the inputs that a disturbance of the coordinates' largest values needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector, spectral_radius
from zeno_orbits.continuation.families import Continuation, Family, FamilyPoint, finite_or_none
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.maps import Feedback, feedback_of
from zeno_orbits.model import Problem
from zeno_orbits.orbits import return_map_of
from zeno_orbits.search import orbit_by_shooting
from zeno_orbits.work import Columns, Progress, TableRepr, silent

_ELSEWHERE = 1e-6
"""Relative difference of a period from which a shot orbit is not that of its family."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldPoint:
    """A repelling orbit of a family, and the feedback of least effort.

    Attributes:
        value: Value of the parameter of the family.
        period: Period [s].
        spectral_radius: Largest modulus of a multiplier without feedback.
        effort: Change of the inputs, relative to their own values, per disturbance of the largest
            values of the coordinates. NaN without a feedback.
        held_radius: The same radius with the feedback.
        gain: Matrix of the feedback, ``(m, d)``, empty without one.
        reason: Why the orbit lacks a feedback, or an empty text.
    """

    value: float
    period: float
    spectral_radius: float
    effort: float
    held_radius: float
    gain: Vector
    reason: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return the point as plain data."""
        return {
            "value": self.value,
            "period": self.period,
            "spectral_radius": self.spectral_radius,
            "effort": finite_or_none(self.effort),
            "held_radius": finite_or_none(self.held_radius),
            "gain": self.gain.tolist(),
            "reason": self.reason,
        }


@dataclass(frozen=True, kw_only=True, repr=False)
class HeldFamilies(TableRepr):
    """The repelling orbits of families, each with the feedback of least effort.

    Attributes:
        found: The families.
        inputs: Names of the gains and parameters that are set at each return.
        points: The repelling orbits, family by family.
    """

    found: Continuation
    inputs: tuple[str, ...]
    points: tuple[tuple[HeldPoint, ...], ...]

    def __repr__(self) -> str:
        """Return one line: how many orbits are held, and the range of the effort."""
        every = [point for family in self.points for point in family]
        efforts = [point.effort for point in every if not point.reason]
        told = f", effort={min(efforts):.4g} to {max(efforts):.4g}" if efforts else ""
        by = ", ".join(self.inputs)
        return f"<HeldFamilies by {by}: repelling={len(every)}, held={len(efforts)}{told}>"

    def _columns(self) -> Columns:
        """Return the repelling orbits."""
        rows = [(k, point) for k, family in enumerate(self.points) for point in family]
        return {
            "family": [k for k, _ in rows],
            self.found.families[0].parameter: [point.value for _, point in rows],
            "period": [point.period for _, point in rows],
            "spectral_radius": [point.spectral_radius for _, point in rows],
            "effort": [point.effort for _, point in rows],
            "held_radius": [point.held_radius for _, point in rows],
            "reason": [point.reason for _, point in rows],
        }

    def as_json(self) -> dict[str, Any]:
        """Return the families as plain data, with the repelling orbits as ``held``."""
        held = [[point.as_json() for point in family] for family in self.points]
        return {**self.found.as_json(), "inputs": list(self.inputs), "held": held}


def effort_of(feedback: Feedback) -> float:
    r"""Return the effort of a feedback: the root of the largest eigenvalue of `P`.

    .. math:: P = \sum_k (A_c^k)^\top K^\top K A_c^k,\qquad A_c = A - B K

    Coordinates are relative to their largest values and inputs relative to their own.

    Args:
        feedback: A feedback that keeps its orbit.
    """
    # The import takes a fifth of a second.
    from scipy.linalg import solve_discrete_lyapunov

    loop, gain = feedback.scaled_loop
    if not len(loop):
        return 0.0
    cost = np.asarray(solve_discrete_lyapunov(loop.T, gain.T @ gain), dtype=np.float64)
    return float(np.sqrt(max(np.linalg.eigvalsh((cost + cost.T) / 2)[-1], 0.0)))


def held_families(
    problem: Problem,
    found: Continuation,
    inputs: Sequence[str],
    *,
    on_progress: Progress = silent,
) -> HeldFamilies:
    """Return the least feedback that keeps each repelling orbit of families.

    Args:
        problem: The problem.
        found: The families.
        inputs: Gains and parameters that are set at each return.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If an input is unknown, or is the parameter of the families.
    """
    names = tuple(inputs)
    for name in names:
        problem.quantity(name, argument="inputs")
        if name == found.families[0].parameter:
            raise InputError(f"Argument `inputs`: `{name}` is the parameter of the families.")
    if not names:
        raise InputError("Argument `inputs` must name at least one gain or parameter.")
    every: list[tuple[HeldPoint, ...]] = []
    total = sum(not one.stable for family in found.families for one in family.points)
    done = 0
    for family in found.families:
        points: list[HeldPoint] = []
        for point in (one for one in family.points if not one.stable):
            on_progress("designing feedbacks", done / total)
            points.append(_held_point(problem, family, point, names))
            done += 1
        every.append(tuple(points))
    return HeldFamilies(found=found, inputs=names, points=tuple(every))


def _held_point(
    problem: Problem, family: Family, point: FamilyPoint, names: tuple[str, ...]
) -> HeldPoint:
    """Return a repelling orbit with its feedback, or the reason why the feedback is missing."""
    reason, gain, effort, radius = "", np.zeros((0, 0)), np.nan, np.nan
    numbers = {**family.gains, **family.parameters, family.parameter: point.value}
    try:
        values = problem.values(numbers=numbers)
        orbit = orbit_by_shooting(problem, values, start=point.state).unwrap()
        if abs(orbit.period - point.period) <= _ELSEWHERE * point.period:
            feedback = feedback_of(return_map_of(problem, orbit), names, weight=0.0)
            gain, effort = feedback.gain, effort_of(feedback)
            radius = spectral_radius(feedback.multipliers)
        else:
            reason = "The motion from the state of the family leads to another orbit."
    except ZenoOrbitsError as error:
        reason = str(error)
    return HeldPoint(
        value=point.value,
        period=point.period,
        spectral_radius=point.spectral_radius,
        effort=effort,
        held_radius=radius,
        gain=gain,
        reason=reason,
    )
