r"""Parameters of a machine from a recording of it, through the closed orbit and its derivatives.

A machine that has settled shows the periodic orbit of its parameters, whatever it started from. So
the prediction is the orbit itself, :math:`Y(\varphi; p)`, and its period: no initial state has to
be fitted, a recording of hours is folded into one cycle before the first iteration, and
derivatives come from the implicit function theorem on the return map (theory (58)). Fitting the
recorded time instead would need the state at its beginning, and would carry every impact of it.

The residuals are the samples in units of their noise, and the period in units of its own error.
What remains after the fit is correlated, by noise of the machine and by what the model does not
know, and intervals take that into account (theory (59)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.experiment.comparison.comparison import compare
from zeno_orbits.experiment.comparison.overlay import Overlay
from zeno_orbits.experiment.identification.folding import folded
from zeno_orbits.experiment.identification.least_squares import Fit, fit
from zeno_orbits.experiment.identification.predictions import Predictions
from zeno_orbits.experiment.identification.stationarity import unsteady
from zeno_orbits.experiment.identification.uncertainty import Unseen, unseen_combinations
from zeno_orbits.experiment.identification.unknowns import (
    Unknown,
    Unknowns,
    begin_of,
    unknowns_of,
)
from zeno_orbits.experiment.orbit_table import measurement
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.search import close_orbit, orbit_of
from zeno_orbits.work import Progress, silent

__all__ = ["Fitted", "Identification", "UnfittableError", "identify"]

_LEAST_CYCLES = 2.0
_MISFIT = 2.0
"""What repeats of the residuals, over what noise makes repeat, where the model falls short."""
_ALIEN = 0.05
"""What all cycles have in common of the deviations, in parts of the ranges, in a machine that is
the problem's, at most."""
_MOVED = 5e-3
"""Relative change of a number between cycles up to which it is given, with a word of that."""
_WORTH = 1e-6
"""Relative change of a number between cycles that is worth a word."""
_LATE = 5.0
"""Standard errors by which a period may be off that a model follows."""
_EDGE = 1e-6
_PART = 0.1
"""Part that a number has at least in a combination that hides it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fitted:
    """A number that was found.

    Attributes:
        unknown: The parameter, or parameters, that it is the value of.
        start: Where the fit began.
        value: The number.
        error: Its standard error; infinite if the recording does not tell it.
        low: Lower end of its 95 % interval.
        high: Upper end.
    """

    unknown: Unknown
    start: float
    value: float
    error: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identification:
    """Parameters from a recording.

    Attributes:
        problem: Name of the problem.
        values: All numbers, the fitted ones among them.
        fitted: The fitted ones.
        correlation: Between them, ``(k, k)``.
        unseen: Combinations of them that the recording does not tell.
        orbit: The orbit at these numbers.
        before: Root mean square of the residuals at the start, in units of the noise.
        after: The same after the fit.
        misfit: What repeats of the residuals, over what noise alone makes repeat; about 1 for a
            model that is right.
        remarks: What else is to be said.
    """

    problem: str
    values: ParameterValues
    fitted: tuple[Fitted, ...]
    correlation: Vector
    unseen: tuple[Unseen, ...]
    orbit: ZenoOrbit
    before: float
    after: float
    misfit: float
    remarks: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "format": 1,
            "problem": self.problem,
            "gains": dict(self.values.gains),
            "parameters": dict(self.values.parameters),
            "fitted": {
                one.unknown.label: {
                    "value": one.value,
                    "standard_error": one.error if math.isfinite(one.error) else None,
                    "interval": [one.low, one.high] if math.isfinite(one.error) else None,
                    "start": one.start,
                }
                for one in self.fitted
            },
            "correlation": self.correlation.tolist(),
            "unseen": [{"direction": dict(one.direction), "text": one.text} for one in self.unseen],
            "period": self.orbit.period,
            "residual_before": self.before,
            "residual_after": self.after,
            "misfit": self.misfit,
            "remarks": list(self.remarks),
        }


class UnfittableError(ZenoOrbitsError):
    """A recording gives no parameters: it shows no such orbit, or none comes near it."""


def identify(
    problem: Problem,
    values: ParameterValues,
    recording: Recording,
    sought: Sequence[Unknown],
    *,
    on_progress: Progress = silent,
) -> Identification:
    """Return the parameters at which a problem's orbit is nearest to a recording.

    Args:
        problem: The problem.
        values: Its numbers: gains and what is not fitted as known, the others roughly.
        recording: Of a machine that has settled, over two periods at least.
        sought: What to fit.
        on_progress: Called with each stage, and with the part done of the fit.

    Raises:
        InputError: If a name or a range cannot be.
        UnfittableError: If there is no orbit at the start, or the recording shows none like it.
    """
    begin = begin_of(problem, values, sought)
    on_progress("looking for the orbit at the start", None)
    closing = close_orbit(problem, begin)
    if closing.orbit is None:
        raise _refusal(f"at the start there is no orbit to fit: {closing.detail.rstrip('.')}")
    on_progress("laying the recording over it", None)
    first = compare(closing.orbit, problem, recording)
    laid = first.overlay
    if not first.agrees or laid is None:
        raise _refusal("; ".join(first.reasons))
    if laid.found.n_cycles < _LEAST_CYCLES:
        raise _refusal(f"{laid.found.n_cycles:.4g} periods were recorded, and two are needed")
    unknowns = unknowns_of(problem, begin, sought)
    orbits = Predictions(problem, unknowns, measurement(problem, laid.names), laid.table.cycle)
    found = replace(laid.found, period=laid.where.period, error=laid.where.period_error)
    answer = fit(orbits, folded(laid.time, laid.values, laid.where), found, on_progress)
    remarks = [*first.remarks, *_unsettled(answer, laid)]
    if answer.repeating > _ALIEN:
        off = f"the nearest orbit is {100 * answer.repeating:.2g} % of the signals' ranges off"
        raise _refusal(f"{off}, in every cycle")
    labels = [one.label for one in sought]
    unseen = unseen_combinations(labels, answer.spread.information, answer.spread.inflation)
    fitted = _fitted(unknowns, sought, answer, unseen)
    parameters = dict(begin.parameters)
    for one in fitted:
        parameters |= dict.fromkeys(one.unknown.names, one.value)
    at = problem.values(gains=begin.gains, parameters=parameters)
    return Identification(
        problem=problem.name,
        values=at,
        fitted=fitted,
        correlation=answer.spread.correlation,
        unseen=unseen,
        orbit=orbit_of(orbits.table(answer.x).cycle, problem, at),
        before=answer.before,
        after=answer.after,
        misfit=answer.spread.misfit,
        remarks=(*remarks, *_remarks(fitted, answer)),
    )


def _refusal(reason: str) -> UnfittableError:
    return UnfittableError(f"No parameters were found: {reason}.")


def _unsettled(answer: Fit, laid: Overlay) -> list[str]:
    """Return in words how cycles differ by more than noise, if that hardly moves the numbers.

    Raises:
        UnfittableError: If it does, with the reason and from when on the cycles are alike.
    """
    found, where = unsteady(answer), laid.where
    if found is None or found.size < _WORTH:
        return []
    hint = ""
    if found.first:
        begun = np.floor(where.phases(laid.time[[0, -1]]))
        in_group = max(float(begun[1] - begun[0] + 1) / answer.data.n_groups, 1.0)
        since = where.release + where.period * (begun[0] + found.skip * in_group)
        hint = f"; leave the beginning out with --from {since:.4g}"
    if found.size > _MOVED:
        raise _refusal(f"{found.reason}{hint}")
    return [f"{found.reason}, by {100 * found.size:.1g} % of the numbers{hint}"]


def _fitted(
    unknowns: Unknowns, sought: Sequence[Unknown], found: Fit, unseen: Sequence[Unseen]
) -> tuple[Fitted, ...]:
    """Return the numbers with their errors, without those of what is not seen."""
    numbers, spread = unknowns.numbers(found.x), found.spread
    hidden = {name for one in unseen for name, part in one.direction.items() if abs(part) > _PART}
    answers: list[Fitted] = []
    for k, one in enumerate(sought):
        known = one.label not in hidden
        half = float(spread.half[k] * unknowns.scale[k]) if known else math.inf
        value = float(numbers[k])
        answers.append(
            Fitted(
                unknown=one,
                start=float(unknowns.start[k]),
                value=value,
                error=float(spread.errors[k] * unknowns.scale[k]) if known else math.inf,
                low=value - half,
                high=value + half,
            )
        )
    return tuple(answers)


def _remarks(fitted: Sequence[Fitted], found: Fit) -> list[str]:
    """Return what else is to be said of a fit."""
    remarks: list[str] = []
    for one in fitted:
        low, high = one.unknown.lower, one.unknown.upper
        if min(one.value - low, high - one.value) < _EDGE * (high - low):
            remarks.append(f"`{one.unknown.label}` reached an end of its range")
    if not found.converged:
        remarks.append("the fit did not converge: better values may exist")
    if found.spread.misfit > _MISFIT:
        remarks.append(
            f"the model does not follow the recording: what repeats of the deviations is "
            f"{math.sqrt(found.spread.misfit):.2g} times noise, and the numbers may be biased "
            f"by more than their intervals say"
        )
    late = abs(float(found.residuals[-1]))
    if late > _LATE:
        remarks.append(
            f"the model does not follow the period: it is off by {late:.2g} standard errors, and "
            f"the numbers may be biased by more than their intervals say"
        )
    return remarks
