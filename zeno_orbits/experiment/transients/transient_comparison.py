"""Transients compared with the motion of a problem, impact by impact and flight by flight.

Only the initial values are fitted, so the deviations belong to the model and its parameters. The
flights are those between the impacts of the fitted motion, counted from 0 before the first impact.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.estimate import Estimate, instruments_json
from zeno_orbits.experiment.comparison.instruments import Instruments, instruments_of
from zeno_orbits.experiment.identification.unknowns import FitParameter
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.experiment.transients.second_clock import SecondFile
from zeno_orbits.experiment.transients.seen_impacts import impacts_in_gap, recorded_gaps
from zeno_orbits.experiment.transients.transient_fit import (
    FittedTrial,
    TransientFit,
    fit_transients,
)
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.work import ByValue, Columns, Progress, TableRepr, silent

_NEAR = 0.5
"""Part of the shorter flight beside a fitted impact within which a recorded one belongs to it."""
_FEWEST = 3
"""Samples of a flight that has a row."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactDeviation:
    """An impact of a recording beside the fitted motion.

    Attributes:
        trial: Name of the trial.
        number: Number of the impact in the fitted motion, from 1.
        recorded: Recorded time [s], NaN if the recording does not show the impact.
        fitted: Time of the fitted motion [s].
    """

    trial: str
    number: int
    recorded: float
    fitted: float

    @property
    def deviation(self) -> float:
        """Recorded minus fitted time [s]."""
        return self.recorded - self.fitted


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightDeviation:
    """Deviation of a signal in one flight.

    Attributes:
        trial: Name of the trial.
        signal: Name of the signal.
        unit: Its unit.
        flight: Number of impacts before the flight.
        begin: Beginning of the flight [s].
        end: End of the flight [s].
        mean: Mean of the recorded minus the fitted signal.
        rms: Root mean square of this deviation.
        n: Number of samples.
    """

    trial: str
    signal: str
    unit: str
    flight: int
    begin: float
    end: float
    mean: float
    rms: float
    n: int


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TransientComparison(TableRepr, ByValue):
    """Transients compared with the motion of a problem.

    Attributes:
        problem: Name of the problem.
        values: Gains and parameters of the motion.
        fit: The trials beside the fitted motions, and the verdict.
        impacts: The impacts of all trials.
        flights: Deviations of the signals by flight.
        rms: Root mean square deviation relative to the ranges of the signals.
        remarks: Further remarks.
        instruments: Fitted errors of instruments, by their names.
    """

    problem: str
    values: ParameterValues
    fit: TransientFit
    impacts: tuple[ImpactDeviation, ...]
    flights: tuple[FlightDeviation, ...]
    rms: float
    remarks: tuple[str, ...]
    instruments: Mapping[str, Estimate] = field(default_factory=dict[str, Estimate])

    def __repr__(self) -> str:
        """Return one line: the size of the deviations, and the verdict."""
        part = f"{100 * self.rms:.3g} % of the signals' ranges"
        return f"<TransientComparison with {self.problem}: {part}, {self.fit.verdict}>"

    def _columns(self) -> Columns:
        """Return the deviations by flight."""
        return {
            "trial": [one.trial for one in self.flights],
            "signal": [one.signal for one in self.flights],
            "flight": [one.flight for one in self.flights],
            "mean": [one.mean for one in self.flights],
            "rms": [one.rms for one in self.flights],
        }

    @property
    def agrees(self) -> bool:
        """True if the residuals are noise: the model explains the recordings."""
        return not self.fit.tests.has_structure

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as plain data."""
        return {
            "format": 1,
            "problem": self.problem,
            "agrees": self.agrees,
            "rms": self.rms,
            **self.fit.as_json(),
            "impacts": [
                {
                    "trial": one.trial,
                    "number": one.number,
                    "recorded": one.recorded if math.isfinite(one.recorded) else None,
                    "fitted": one.fitted,
                }
                for one in self.impacts
            ],
            "flights": [
                {
                    "trial": one.trial,
                    "signal": one.signal,
                    "flight": one.flight,
                    "begin": one.begin,
                    "end": one.end,
                    "mean": one.mean,
                    "rms": one.rms,
                    "samples": one.n,
                }
                for one in self.flights
            ],
            "remarks": list(self.remarks),
            "instruments": instruments_json(self.instruments),
        }


def compare_transients(
    problem: Problem,
    values: ParameterValues,
    recordings: Sequence[tuple[str, Recording]],
    sought: Sequence[FitParameter] = (),
    *,
    start: Mapping[str, float] | None = None,
    free: Collection[str] = (),
    second: SecondFile | None = None,
    on_progress: Progress = silent,
) -> TransientComparison:
    """Compare transients with the motion of a problem.

    Args:
        problem: The problem.
        values: Gains and parameters of the motion.
        recordings: Label and recording of each trial.
        sought: Errors of instruments to determine.
        start: Known initial values of all trials.
        free: Further initial values to determine: states, `clock`, `offset`.
        second: A second file of the motion of a single trial, on another clock.
        on_progress: Called with each stage.

    Raises:
        InputError: If a name is invalid, or a recording holds nothing of the problem.
        UnfittableError: If no simulation follows the recordings.
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
    errors = {
        one.label: Estimate(value=own.value, error=own.error)
        for one, own in zip(sought, found.shared, strict=True)
    }
    numbers = np.array([own.value for own in found.shared])
    return TransientComparison(
        problem=problem.name,
        values=values,
        fit=found.fit,
        instruments=errors,
        impacts=tuple(
            row
            for one in found.fit.trials
            for row in impact_deviations(
                problem, values, one, instruments_of(found.unknowns.readings, one.names), numbers
            )
        ),
        flights=tuple(row for one in found.fit.trials for row in flight_deviations(one)),
        rms=found.after,
        remarks=found.remarks,
    )


def impact_deviations(
    problem: Problem,
    values: ParameterValues,
    trial: FittedTrial,
    instruments: Instruments,
    numbers: Vector,
) -> Iterator[ImpactDeviation]:
    """Yield the resolved impacts of a fitted motion beside the recorded ones.

    Args:
        problem: The problem.
        values: Gains and parameters of the motion.
        trial: The trial.
        instruments: Errors of its channels.
        numbers: Values of these errors.
    """
    read = (trial.recorded - instruments.offsets @ numbers) / instruments.gain(numbers)
    recorded = _recorded(problem, values, replace(trial, recorded=read))
    flights = np.diff(trial.impacts)
    for k, fitted in enumerate(trial.impacts.tolist()):
        beside = [float(one) for one in flights[max(k - 1, 0) : k + 1]]
        reach = _NEAR * min(beside, default=math.inf)
        off = np.abs(recorded - fitted)
        near = len(off) > 0 and float(off.min()) < reach
        yield ImpactDeviation(
            trial=trial.label,
            number=k + 1,
            recorded=float(recorded[int(np.argmin(off))]) if near else math.nan,
            fitted=fitted,
        )


def _recorded(problem: Problem, values: ParameterValues, trial: FittedTrial) -> Any:
    """Return the times of recorded impacts: event times, or minima of the recorded gaps [s]."""
    if len(trial.event_times):
        return trial.event_times
    names = problem.state_names
    columns = {
        names.index(name): trial.recorded[:, k]
        for k, name in enumerate(trial.names)
        if name in names
    }
    begin = np.array([trial.start[name] for name in names])
    gaps = recorded_gaps(problem.graph_dynamics(values), begin, columns)
    rows = [impacts_in_gap(trial.time, gap) for gap in gaps.values()]
    return np.sort(np.concatenate([*rows, np.zeros(0)]))


def flight_deviations(trial: FittedTrial) -> Iterator[FlightDeviation]:
    """Yield the deviations of the signals of a trial by flight.

    Args:
        trial: The trial.
    """
    if not len(trial.time):
        return
    edges = [float(trial.time[0]), *trial.impacts.tolist(), float(trial.time[-1])]
    for k, (begin, end) in enumerate(itertools.pairwise(edges)):
        inside = (trial.time >= begin) & (trial.time <= end)
        for s, name in enumerate(trial.names):
            rows = inside & (trial.seen[:, s] > 0.0)
            if rows.sum() < _FEWEST:
                continue
            off = trial.recorded[rows, s] - trial.fitted[rows, s]
            yield FlightDeviation(
                trial=trial.label,
                signal=name,
                unit=trial.units[s],
                flight=k,
                begin=begin,
                end=end,
                mean=float(np.mean(off)),
                rms=float(np.sqrt(np.mean(off**2))),
                n=int(rows.sum()),
            )
