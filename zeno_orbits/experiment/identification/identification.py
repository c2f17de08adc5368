r"""Parameters of a machine from a recording, by the periodic orbit and its derivatives.

A settled machine shows the periodic orbit of its parameters for any initial state. So the
prediction is the orbit itself, :math:`Y(\varphi; p)`, and its period. No initial state has to be
fitted, and a recording of hours is folded into one cycle before the first iteration. Derivatives
follow from the implicit function theorem for the return map (theory (6.11)). A fit of the recorded
time series would need the initial state and would propagate derivatives through every impact.

The residuals are the samples in units of their noise, and the period in units of its standard
error. The final residuals are correlated by noise of the machine and by unmodelled effects, and the
intervals take this correlation into account (theory (6.12)).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.experiment.comparison.folding import Folded
from zeno_orbits.experiment.identification.contact_rows import UNMATCHED
from zeno_orbits.experiment.identification.least_squares import Fit, stretch_of
from zeno_orbits.experiment.identification.optima import (
    global_fit,
    profile_interval,
    starts_of,
)
from zeno_orbits.experiment.identification.predictions import Predictions
from zeno_orbits.experiment.identification.prepared import (
    Prepared,
    UnfittableError,
    prepared,
    prepared_together,
    refusal,
)
from zeno_orbits.experiment.identification.stationarity import unsteady
from zeno_orbits.experiment.identification.uncertainty import Unseen, unseen_combinations
from zeno_orbits.experiment.identification.unknowns import (
    FitParameter,
    Unknowns,
    begin_of,
    unknowns_of,
)
from zeno_orbits.experiment.recordings.contacts import CONTACT
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.experiment.transients.second_clock import SecondFile
from zeno_orbits.experiment.transients.transient_fit import TransientFit, fit_transients
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import event_orbit_of
from zeno_orbits.work import ByValue, Progress, silent

__all__ = ["FittedParameter", "Identification", "UnfittableError", "fit_parameters"]

_MISFIT = 2.0
"""Ratio of the periodic part of the residuals to its expected size from noise, above which the
model is reported as inadequate."""
_ALIEN = 0.05
"""Largest common deviation of all cycles, relative to the ranges, at which the machine is accepted
as the problem's machine."""
_MOVED = 5e-3
"""Relative change of a number between cycles up to which it is given, with a word of that."""
_WORTH = 1e-6
"""Relative change of a number between cycles that is worth a word."""
_LATE = 5.0
"""Standard errors by which a period may be off that a model follows."""
_EDGE = 1e-6
_PART = 0.1
"""Part that a number has at least in a combination that hides it."""
_DELAY = FitParameter(names=("delay of the second file",), lower=-0.5, upper=0.5)
_TINY = 1e-300
_SMALLEST = 1e-6
"""Least size of a fitted value, in units of its start, of which a change is a part."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedParameter:
    """A fitted value.

    Attributes:
        unknown: The fitted parameter, or several tied parameters.
        start: Initial value of the fit.
        value: The fitted value.
        error: Standard error of the value. It is infinite if the recording does not determine the
            value.
        low: Lower end of its 95 % interval.
        high: Upper end.
    """

    unknown: FitParameter
    start: float
    value: float
    error: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Identification(ByValue):
    """Result of an identification: parameter values from a recording.

    Attributes:
        problem: Name of the problem.
        values: All parameter values, including the fitted values.
        fitted: The fitted values.
        correlation: Correlation matrix of the fitted values, ``(k, k)``.
        unseen: Combinations of parameters that the recording does not determine.
        closed_orbit: The orbit at these parameter values, or ``None`` for transients.
        before: Root mean square deviation of the signals at the start, in parts of their ranges.
        after: The same after the fit.
        misfit: Ratio of the periodic part of the residuals to its expected size from noise. It is
            about 1 for an adequate model.
        edges: Number of edges of contact channels that were fitted.
        edge_misfit: Root mean square of the residuals of the edges, in units of their errors, or
            NaN without edges.
        converged: Whether the fit converged. Intervals exist only for a converged fit.
        optima: Parameter values of other optima that fit nearly as well.
        remarks: Further remarks.
        transient: Trials, tests of the residuals and verdict of a fit of transients, or ``None``
            for a settled orbit.
    """

    problem: str
    values: ParameterValues
    fitted: tuple[FittedParameter, ...]
    correlation: Vector
    unseen: tuple[Unseen, ...]
    closed_orbit: Orbit | None
    before: float
    after: float
    misfit: float
    remarks: tuple[str, ...]
    converged: bool = True
    optima: tuple[Mapping[str, float], ...] = ()
    edges: int = 0
    edge_misfit: float = math.nan
    transient: TransientFit | None = None

    @property
    def orbit(self) -> Orbit:
        """The orbit at these parameter values.

        Raises:
            InputError: If transients were fitted, which show no orbit.
        """
        if self.closed_orbit is None:
            raise InputError("Argument `orbit`: transients were fitted, which show no orbit.")
        return self.closed_orbit

    def __repr__(self) -> str:
        """Return one line: the fitted values with their errors."""
        found = ", ".join(
            f"{one.unknown.label}={one.value:.7g} +- {one.error:.2g}" for one in self.fitted
        )
        return (
            f"<Identification of {self.problem}: {found}, residuals of {100 * self.after:.3g} % of "
            f"the signals' ranges, converged={self.converged}>"
        )

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
            "period": None if self.closed_orbit is None else self.closed_orbit.period,
            "residual_before": self.before,
            "residual_after": self.after,
            "misfit": self.misfit if math.isfinite(self.misfit) else None,
            "transient": None if self.transient is None else self.transient.as_json(),
            "edges": self.edges,
            "edge_misfit": self.edge_misfit if self.edges else None,
            "converged": self.converged,
            "optima": [dict(one) for one in self.optima],
            "remarks": list(self.remarks),
        }


def fit_parameters(
    problem: Problem,
    values: ParameterValues,
    recording: Recording,
    sought: Sequence[FitParameter],
    *,
    second: SecondFile | None = None,
    on_progress: Progress = silent,
) -> Identification:
    """Fit parameters of a problem to a recording.

    Args:
        problem: The problem.
        values: Parameter values of the problem. Gains and parameters that are not fitted must be
            accurate, while the others are rough initial values.
        recording: Recording of a settled machine, of at least two periods.
        sought: The parameters to fit.
        second: A second file of the same settled motion on another clock, with signals alone.
        on_progress: Called with each stage, and with the part done of the fit.

    Raises:
        InputError: If a name or a range is invalid, or the second file has contact channels.
        UnfittableError: If no orbit exists at the start, or the recording does not resemble any.
    """
    begin = begin_of(problem, values, sought)
    asked = [*sought] if second is None else [*sought, _DELAY]
    unknowns = unknowns_of(problem, begin, asked)
    files = _prepared(problem, begin, unknowns, recording, second, on_progress)
    whole = files[0][1] if second is None else prepared_together(files[0][1], files[1][1])
    unknowns = whole.orbits.unknowns
    labels = [one.label for one in sought]
    seen = _restitution_seen(unknowns, sought, whole.restitution)
    notes = [f"{label}{word}" for label, one in files for word in one.remarks]
    try:
        answer, orbits, optima = _nearest(whole, seen, on_progress)
    except UnfittableError as error:
        if not notes:
            raise
        raise UnfittableError(f"{error} Note: {'; '.join(notes)}.") from error
    for clock, (label, one) in enumerate(files):
        notes += [f"{label}{word}" for word in _unsettled(answer.part(clock), one, label)]
    edges = _fitted_edges(whole, answer, [one.label for one in asked])
    unseen = _unseen(labels, unknowns, answer)
    on_progress("computing the intervals", 0.97)
    fitted = _fitted(unknowns, sought, answer, unseen)
    others = tuple(
        dict(zip(labels, unknowns.numbers(one).tolist(), strict=False)) for one in optima
    )
    at = _values_of(problem, begin, fitted, unknowns)
    n_edges, k = whole.contacts.n_edges, len(sought)
    if second is not None:
        notes += _clock_words(answer, files[0][1], files[1][1], second.label)
    return Identification(
        problem=problem.name,
        values=at,
        fitted=fitted,
        correlation=answer.spread.correlation[:k, :k],
        unseen=unseen,
        closed_orbit=event_orbit_of(problem, at, orbits.table(answer.x).found),
        before=answer.before,
        after=answer.after,
        misfit=answer.spread.misfit,
        converged=answer.converged,
        optima=others,
        remarks=(*notes, *_remarks(fitted, unknowns, answer), *map(_rival, others)),
        edges=n_edges,
        edge_misfit=float(np.sqrt(np.mean(edges**2))) if n_edges else math.nan,
    )


def _prepared(
    problem: Problem,
    begin: ParameterValues,
    unknowns: Unknowns,
    recording: Recording,
    second: SecondFile | None,
    on_progress: Progress,
) -> list[tuple[str, Prepared]]:
    """Return the beginning of a fit for each file, with the words before its remarks.

    Raises:
        InputError: If the second file has contact channels, or both files have a channel whose gain
            or offset is sought.
        UnfittableError: If a file does not show the orbit.
    """
    if second is None:
        return [("", prepared(problem, begin, unknowns, recording, on_progress))]
    names, others = ([one.name for one in file.signals] for file in (recording, second.recording))
    contacts = [name for name in others if name.partition(".")[0] == CONTACT]
    if contacts:
        wanted = f"has the contact channel `{contacts[0]}`: give the file with contacts first"
        raise InputError(f"Argument `second_file` {wanted}.")
    for reading in (one for own in unknowns.readings for one in own):
        if reading.channel in names and reading.channel in others:
            named = f"`{reading.channel}.{reading.kind.value}`"
            wanted = f"must name a channel of one file, but both files have that of {named}"
            raise InputError(f"Argument `fit` {wanted}: rename one of the columns.")
    first = prepared(
        problem, begin, replace(unknowns, elsewhere=tuple(others)), recording, on_progress
    )
    known = replace(first.orbits.unknowns, elsewhere=tuple(names))
    try:
        other = prepared(problem, begin, known, second.recording, on_progress)
    except UnfittableError as error:
        reason = str(error).partition(": ")[2].rstrip(".")
        raise refusal(f"{second.label}: {reason}") from error
    return [("", first), (f"{second.label}: ", other)]


def _unseen(labels: Sequence[str], unknowns: Unknowns, answer: Fit) -> tuple[Unseen, ...]:
    """Return the combinations that are not determined, whatever the delay of a second file."""
    k = len(labels)
    # Of changes relative to the fitted values, which are negative where a negative value grows.
    signs = np.where(unknowns.numbers(answer.x) < 0.0, -1.0, 1.0)
    sizes = np.where(unknowns.additive, 1.0, np.maximum(np.abs(answer.x[:-1]), _SMALLEST))
    information = answer.spread.information * np.outer(signs * sizes, signs * sizes)
    for late in range(k, len(information)):
        across = information[:k, late]
        information[:k, :k] -= np.outer(across, across) / max(information[late, late], _TINY)
    additive = [name for name, mark in zip(labels, unknowns.additive, strict=False) if mark]
    return unseen_combinations(labels, information[:k, :k], answer.spread.inflation, additive)


def _clock_words(answer: Fit, first: Prepared, second: Prepared, label: str) -> list[str]:
    """Return what a fit tells of the clock of a second file.

    A settled motion repeats, so the offset is known up to whole periods.
    """
    stage, delay = answer.stage, float(answer.x[-2])
    if stage is None:
        return []
    factors = [stretch_of(stage, answer.x, clock).error for clock in (0, 1)]
    periods = stage.found.period, second.where.period * answer.data.slower
    rate = periods[1] / periods[0] - 1.0
    turns = (float(first.time[0]) - first.where.release) / periods[0]
    ahead = turns + delay
    origin = (float(second.time[0]) - second.where.release) / periods[1]
    ahead += math.ceil(origin - ahead)
    shows = second.where.release + periods[1] * ahead
    errors = float(answer.spread.errors[-1]), turns * factors[0], ahead * factors[1]
    late, unsure = periods[1] * math.hypot(*errors), (1.0 + rate) * math.hypot(*factors)
    return [
        f"{label}: its clock shows {shows:.7g} +- {late:.2g} s at the beginning of the first file, "
        f"up to whole periods of {periods[1]:.5g} s",
        f"{label}: its clock is faster by the part {rate:.3g} +- {unsure:.2g}",
    ]


def _values_of(
    problem: Problem,
    begin: ParameterValues,
    fitted: Sequence[FittedParameter],
    unknowns: Unknowns,
) -> ParameterValues:
    """Return the parameter values of a machine after a fit, without errors of instruments."""
    parameters = dict(begin.parameters)
    for one, readings in zip(fitted, unknowns.readings, strict=False):
        if not readings:
            parameters |= dict.fromkeys(one.unknown.names, one.value)
    return problem.values(gains=begin.gains, parameters=parameters)


def _rival(optimum: Mapping[str, float]) -> str:
    """Return the remark on another optimum."""
    values = ", ".join(f"`{name}` = {value:.6g}" for name, value in optimum.items())
    return f"another optimum fits nearly as well: {values}"


def fit_transient_parameters(
    problem: Problem,
    values: ParameterValues,
    recordings: Sequence[tuple[str, Recording]],
    sought: Sequence[FitParameter],
    *,
    start: Mapping[str, float] | None = None,
    free: Collection[str] = (),
    second: SecondFile | None = None,
    on_progress: Progress = silent,
) -> Identification:
    """Fit parameters of a problem to transients: parts of motions that need not repeat.

    Args:
        problem: The problem.
        values: Parameter values of the problem. Those that are fitted are rough initial values.
        recordings: Label and recording of each trial.
        sought: The parameters to fit.
        start: Known initial values of all trials.
        free: Further initial values to determine: states, `clock`, `offset`.
        second: A second file of the motion of a single trial, on another clock.
        on_progress: Called with each stage, and with the part done of the fit.

    Raises:
        InputError: If a name or a range is invalid.
        UnfittableError: If no simulated motion follows the recordings.
    """
    found = fit_transients(
        problem,
        values,
        recordings,
        sought,
        start=start,
        free=free,
        second=second,
        on_progress=on_progress,
    )
    fitted = tuple(
        FittedParameter(
            unknown=one,
            start=begun,
            value=value.value,
            error=value.error,
            low=value.low,
            high=value.high,
        )
        for one, begun, value in zip(
            sought, found.unknowns.start.tolist(), found.shared, strict=True
        )
    )
    return Identification(
        problem=problem.name,
        values=found.values,
        fitted=fitted,
        correlation=found.correlation,
        unseen=found.unseen,
        closed_orbit=None,
        before=found.before,
        after=found.after,
        misfit=found.fit.tests.misfit,
        converged=found.converged,
        optima=found.optima,
        remarks=found.remarks,
        transient=found.fit,
    )


def _nearest(
    whole: Prepared, seen: Mapping[int, float], on_progress: Progress
) -> tuple[Fit, Predictions, tuple[Vector, ...]]:
    """Return the best fit, its predictions, and the other optima.

    Args:
        whole: The beginning of the fit.
        seen: Unknowns with a value from the recorded contacts.
        on_progress: Called with the part that is done.

    Raises:
        UnfittableError: If an orbit on the way is lost.
    """
    unknowns = whole.orbits.unknowns
    likely = [unknowns.first]
    if seen:
        # Values from the recorded contacts are tried before the user's start.
        likely.insert(0, unknowns.first.copy())
        likely[0][list(seen)] = list(seen.values())
    try:
        starts = starts_of(unknowns, likely, seen)
        return global_fit(
            whole.orbits, whole.samples, whole.found, starts, on_progress, whole.contacts
        )
    except SimulationError as error:
        raise refusal("the orbit is lost on the way to the recording's") from error


def _fitted_edges(whole: Prepared, answer: Fit, labels: Sequence[str]) -> Vector:
    """Return the residuals of the contact channels, in units of their errors.

    Raises:
        UnfittableError: If the fitted orbit is not the recorded motion.
    """
    if answer.repeating > _ALIEN or _lost(whole.samples, answer):
        size = answer.after if _lost(whole.samples, answer) else answer.repeating
        off = f"the nearest orbit is {100 * size:.2g} % of the signals' ranges off"
        raise refusal(
            f"{off}, in every cycle{ends_clause(labels, whole.orbits.unknowns, answer.x)}"
        )
    edges = answer.residuals[answer.data.values.size : -1]
    if np.any(np.abs(edges) >= UNMATCHED):
        raise refusal("the nearest orbit lacks contacts of the recording, or has others")
    return edges


def ends_clause(labels: Sequence[str], unknowns: Unknowns, x: Vector) -> str:
    """Return the clause that names values at an end of their ranges, or no text.

    Args:
        labels: Names of the unknowns as the caller knows them.
        unknowns: The unknowns with their ranges.
        x: Their values in the fit, ``(n,)``.
    """
    rows = zip(labels, unknowns.numbers(x), unknowns.lower, unknowns.upper, strict=True)
    ends = [
        f"`{label}` is at the end {value:.6g} of its range"
        for label, value, low, high in rows
        if min(value - low, high - value) < _EDGE * (high - low)
    ]
    return f"; {' and '.join(ends)}: widen it" if ends else ""


def _lost(samples: Folded, answer: Fit) -> bool:
    """Return True if the prediction of no sample is straight: the orbit is another one."""
    return bool(samples.seen.any()) and not answer.data.seen.any()


def _restitution_seen(
    unknowns: Unknowns, sought: Sequence[FitParameter], restitution: float
) -> dict[int, float]:
    """Return the unknown that is the restitution, with the value that the contacts show."""
    if not math.isfinite(restitution):
        return {}
    low, high = unknowns.bounds
    return {
        k: float(np.clip(restitution / unknowns.scale[k], low[k], high[k]))
        for k, one in enumerate(sought)
        if "restitution" in one.names
    }


def _unsettled(answer: Fit, whole: Prepared, label: str) -> list[str]:
    """Return remarks on differences between cycles that hardly change the fitted values.

    Raises:
        UnfittableError: If the differences change the fitted values. The message contains the
            reason and the time from which the cycles agree.
    """
    found, where = unsteady(answer), whole.where
    if found is None or found.size < _WORTH:
        return []
    hint = ""
    if found.first:
        begun = np.floor(where.phases(whole.time[[0, -1]]))
        in_group = max(float(begun[1] - begun[0] + 1) / answer.data.n_groups, 1.0)
        since = where.release + where.period * (begun[0] + found.skip * in_group)
        hint = f"; leave the beginning out with --t-start {since:.4g}"
    if found.size > _MOVED:
        raise refusal(f"{label}{found.reason}{hint}")
    return [f"{found.reason}, by {100 * found.size:.1g} % of the numbers{hint}"]


def _fitted(
    unknowns: Unknowns, sought: Sequence[FitParameter], found: Fit, unseen: Sequence[Unseen]
) -> tuple[FittedParameter, ...]:
    """Return the fitted values with their errors, without undetermined values."""
    numbers, spread = unknowns.numbers(found.x), found.spread
    hidden = {name for one in unseen for name, part in one.direction.items() if abs(part) > _PART}
    answers: list[FittedParameter] = []
    for k, one in enumerate(sought):
        known = one.label not in hidden and found.converged
        low, high = -math.inf, math.inf
        if known:
            low, high = (end * float(unknowns.scale[k]) for end in profile_interval(found, k))
        value = float(numbers[k])
        answers.append(
            FittedParameter(
                unknown=one,
                start=float(unknowns.start[k]),
                value=value,
                error=float(spread.errors[k] * unknowns.scale[k]) if known else math.inf,
                low=low,
                high=high,
            )
        )
    return tuple(answers)


def _remarks(fitted: Sequence[FittedParameter], unknowns: Unknowns, found: Fit) -> list[str]:
    """Return the remarks on a fit."""
    remarks: list[str] = []
    ends = zip(fitted, unknowns.lower, unknowns.upper, strict=False)
    for one, low, high in ends:
        if min(one.value - low, high - one.value) < _EDGE * (high - low):
            remarks.append(f"`{one.unknown.label}` reached an end of its range")
    if not found.converged:
        remarks.append(
            "the fit did not converge: better values may exist, and none has an interval"
        )
    if found.spread.misfit > _MISFIT:
        remarks.append(
            f"systematic misfit: the repeatable part of the residuals is "
            f"{math.sqrt(found.spread.misfit):.2g} times the noise, so the estimates may be biased "
            f"beyond their intervals"
        )
    if found.spread.edge_excess > 1.0:
        remarks.append(
            f"systematic misfit of the contacts: they are off by "
            f"{math.sqrt(found.spread.edge_excess):.2g} times their errors, so the estimates may "
            f"be biased beyond their intervals"
        )
    late = abs(float(found.residuals[-1]))
    if late > _LATE:
        remarks.append(
            f"the model does not follow the period: it is off by {late:.2g} standard errors, and "
            f"the estimates may be biased by more than their intervals"
        )
    return remarks
