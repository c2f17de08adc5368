r"""A second file of the same motion on another clock: its offset and its rate are unknowns.

With the time `t` of the motion, the second clock shows :math:`(1 + c)\,(t + b)` since its first
sample. The first file alone determines the motion. The offset `b` at which the second file
correlates best with it begins a fit of both files, in which `b` and `c` are free.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.identification.prepared import refusal
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.experiment.transients.intervals import covariance_of, degrees
from zeno_orbits.experiment.transients.motion import moved
from zeno_orbits.experiment.transients.shooting import (
    Shooting,
    event_times,
    independent_whitening,
)
from zeno_orbits.experiment.transients.staged_fit import LostStartError, StagedFit, fitted
from zeno_orbits.experiment.transients.trial import (
    OFFSET,
    RATE,
    FreeStart,
    TrialData,
    prepared_trial,
)
from zeno_orbits.model import ParameterValues
from zeno_orbits.simulation import EventKind

_PERCENT, _MOST_PERCENT = 0.01, 5.0
"""Scale of a clock rate, and its bound in this scale."""
_MOST_OFFSETS, _SAMPLES = 20_000, 400
_ALIKE = 0.5
"""Mean correlation of two files of one motion, at least."""
_CANDIDATES = 3
_APART = 0.02
"""Least distance of two offsets that are tried, relative to the length of the file."""
_DIFFERENCE = 3.84
_UNSURE = 0.01
"""Standard error of a clock rate that is not determined: quartz is 1000 times better."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SecondFile:
    """A second file of the motion of a trial.

    Attributes:
        label: Name of the file in messages.
        recording: Its recording.
    """

    label: str
    recording: Recording


def with_second(
    shooting: Shooting, found: StagedFit, begin: ParameterValues, second: SecondFile
) -> tuple[Shooting, Vector, tuple[str, ...]]:
    """Return the trials with a second file of the first one's motion, the unknowns and remarks.

    Args:
        shooting: The first file as the only trial.
        found: Its optimum.
        begin: Parameter values at the start of the fit.
        second: The second file.

    Raises:
        UnfittableError: If the second file does not show the motion of the first file.
    """
    trial = _twin(shooting, begin, second)
    found_shifts = list(_shifts(shooting, found, trial))
    tried: list[tuple[float, Shooting, Vector, StagedFit]] = []
    for shift in found_shifts:
        joined = _joined(shooting, replace(trial, shift=shift))
        try:
            one = fitted(joined, np.concatenate([found.z, np.zeros(2)]))
        except LostStartError:
            continue
        tried.append((one.cost / max(degrees(one), 1), joined, one.z, one))
    if not tried:
        raise refusal(f"{second.label} does not show the motion of {shooting.trials[0].label}")
    tried.sort(key=lambda row: row[0])
    _, joined, z, best = tried[0]
    remarks = [
        f"{second.label}: another offset of its clock fits nearly as well, "
        f"{_offset(joined, other[2]) - _offset(joined, z):+.4g} s away"
        for other in tried[1:]
        if _as_good(best, other[3]) and abs(_offset(other[1], other[2]) - _offset(joined, z)) > 1e-6
    ]
    return joined, z, tuple(remarks)


def _as_good(best: StagedFit, other: StagedFit) -> bool:
    return other.cost - best.cost < _DIFFERENCE * best.cost / degrees(best)


def _offset(shooting: Shooting, z: Vector) -> float:
    return shooting.start_of(len(shooting.trials) - 1, z)[1]


def _joined(shooting: Shooting, trial: TrialData) -> Shooting:
    """Return the trials with a second file, whose samples before the motion do not count."""
    if len(trial.time):
        step = float(np.median(np.diff(trial.time)))
        trial = replace(trial, seen=trial.seen & (trial.time > trial.shift + 2 * step)[:, None])
    whitening = (*shooting.whitening, independent_whitening(trial))
    return replace(shooting, trials=(*shooting.trials, trial), whitening=whitening)


def _twin(shooting: Shooting, begin: ParameterValues, second: SecondFile) -> TrialData:
    """Return a second file as a trial with the motion of the first one."""
    problem, first = shooting.problem, shooting.trials[0]
    known = {
        name: float(first.start[k])
        for k, name in enumerate(problem.state_names)
        if k not in problem.clock
    }
    trial = prepared_trial(
        problem, begin, second.recording, label=second.label, start=known, free=()
    )
    none = np.zeros(len(first.start))
    step = float(np.median(np.diff(trial.time))) if len(trial.time) > 1 else 0.01
    free = (
        FreeStart(name=OFFSET, direction=none, scale=step, reach=math.inf),
        FreeStart(name=RATE, direction=none, scale=_PERCENT, reach=_MOST_PERCENT),
    )
    return replace(trial, start=first.start, free=free, twin=0)


def _shifts(shooting: Shooting, found: StagedFit, trial: TrialData) -> Iterator[float]:
    """Yield offsets of a second file at which it is like the motion, the best first.

    Raises:
        UnfittableError: If no shift fits.
    """
    x, first_offset = shooting.start_of(0, found.z)
    graph = shooting.graph.at(shooting.parameters(found.z))
    span = shooting.trials[0].end - first_offset
    motion = moved(graph, x, span + trial.end, shooting.unknowns.places)
    if motion is None:
        raise refusal(f"{trial.label}: the motion cannot be simulated over this file")
    if not len(trial.time):
        impacts = [one.time for one in motion.execution.impacts]
        heard = [one for one in trial.series if one.kind is EventKind.IMPACT and len(one.times)]
        if not heard or not impacts:
            raise refusal(f"{trial.label}: an impact of the motion must be in this file")
        yield float(event_times(trial).min()) - impacts[0]
        return
    step = max(float(np.median(np.diff(trial.time))) / 2, (span + trial.end) / _MOST_OFFSETS)
    at = np.arange(0.0, span + trial.end, step)
    model = trial.measured.values(motion.at(at).states, shooting.parameters(found.z))
    offsets = np.arange(-span, trial.end, step)
    rows = np.unique(np.linspace(0, len(trial.time) - 1, _SAMPLES).astype(np.int64))
    score = np.array([_likeness(trial, rows, at, model, offset) for offset in offsets])
    least = max(int(_APART * trial.end / step), 1)
    for _ in range(_CANDIDATES):
        k = int(np.argmax(score))
        if score[k] < _ALIKE:
            break
        yield float(offsets[k])
        score[max(k - least, 0) : k + least + 1] = -1.0


def _likeness(
    trial: TrialData, rows: NDArray[np.int64], at: Vector, model: Vector, offset: float
) -> float:
    """Return the mean correlation of the channels of a file with a motion at an offset.

    Args:
        trial: The file.
        rows: Indices of the samples that are compared.
        at: Times of the motion, ``(n,)`` [s].
        model: Channels of the motion at these times, ``(n, n_s)``.
        offset: The offset [s].
    """
    times, found = trial.time[rows] - offset, list[float]()
    for s in range(model.shape[1]):
        recorded = trial.values[rows, s]
        known = np.isfinite(recorded)
        own: Vector = np.interp(times[known], at, model[:, s])
        pair = [row - float(np.mean(row)) for row in (own, recorded[known])]
        size = math.sqrt(float(pair[0] @ pair[0]) * float(pair[1] @ pair[1]))
        found.append(float(pair[0] @ pair[1]) / size if size > 0.0 else 0.0)
    return float(np.mean(found))


def offset_words(shooting: Shooting, found: StagedFit) -> Iterator[str]:
    """Yield what a fit tells of the clocks of second files.

    Args:
        shooting: The trials.
        found: The optimum.
    """
    covariance = covariance_of(found)
    scale = math.sqrt(found.cost / degrees(found))
    for k, trial in enumerate(shooting.trials):
        if trial.twin is None:
            continue
        first = shooting.trials[trial.twin].label
        stretch, offset = shooting.stretch_of(k, found.z), shooting.start_of(k, found.z)[1]
        # By the offset and the rate, whose errors are not independent.
        by = {OFFSET: (stretch, 0.0), RATE: (offset, 1.0)}
        slopes = np.zeros((2, len(found.z)))
        for column, one in shooting.free_columns(k):
            slopes[:, column] = np.array(by[one.name]) * one.scale
        sizes: Vector = np.diag(slopes @ covariance @ slopes.T)
        late, error = (scale * math.sqrt(max(float(one), 0.0)) for one in sizes)
        begins, rate = trial.origin + stretch * offset, stretch - 1.0
        yield (
            f"{trial.label}: its clock shows {begins:.7g} +- {late:.2g} s at the beginning of "
            f"{first}"
        )
        if error > _UNSURE or abs(rate) > 0.99 * _PERCENT * _MOST_PERCENT:
            yield f"{trial.label}: the rate of its clock is not determined"
        else:
            yield f"{trial.label}: its clock is faster by the part {rate:.3g} +- {error:.2g}"
