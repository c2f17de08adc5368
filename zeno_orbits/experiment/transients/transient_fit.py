r"""Parameters of a machine from transients: drops, swing-downs, steps and start-ups.

The initial values of every trial, its time offset and its number of impacts are free. Parameters
are shared by all trials. The stages are: samples, weights and masks from the recordings alone;
bounded least squares over a growing horizon from up to six starts; new weights by the residuals;
tests of the residuals; profile intervals.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import counted
from zeno_orbits.experiment.identification.prepared import UnfittableError, refusal
from zeno_orbits.experiment.identification.uncertainty import Unseen, unseen_combinations
from zeno_orbits.experiment.identification.unknowns import (
    FitParameter,
    Unknowns,
    begin_of,
    unknowns_of,
)
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.experiment.transients.event_noise import EventNoise, event_noise
from zeno_orbits.experiment.transients.event_record import EventSeries
from zeno_orbits.experiment.transients.intervals import (
    covariance_of,
    degrees,
    profile_ends,
    quantile_of,
)
from zeno_orbits.experiment.transients.motion import SETTINGS, TransientMotion
from zeno_orbits.experiment.transients.residual_tests import ResidualTests, tested
from zeno_orbits.experiment.transients.scattered_impacts import MixedFit, mixed_fit
from zeno_orbits.experiment.transients.second_clock import SecondFile, offset_words, with_second
from zeno_orbits.experiment.transients.seen_impacts import held_until
from zeno_orbits.experiment.transients.shooting import (
    Shooting,
    event_times,
    independent_whitening,
    matched,
)
from zeno_orbits.experiment.transients.staged_fit import (
    LostStartError,
    StagedFit,
    best_fit,
    fitted,
    refitted,
)
from zeno_orbits.experiment.transients.trial import (
    OFFSET,
    FreeStart,
    TrialData,
    prepared_trial,
)
from zeno_orbits.model import GraphDynamics, ParameterValues, Problem
from zeno_orbits.simulation import EventKind, simulate
from zeno_orbits.work import ByValue, Progress, silent

_OTHER_WEIGHT = 1.1
"""Ratio of the weights of two channels, or of the noise, from which the fit is repeated."""
_HIDDEN = 0.1
"""Part that a parameter has at least in a combination that hides it."""
_UNLIKE = 0.12
"""Residuals relative to the range of the channels from which the motion is another one."""
_MOSTLY = 0.8
"""Part of the deviations that a law of the speed explains before it is named."""
_WIDE = 3.0
"""Reach of an initial value whose channel has an unknown gain or offset, in its scale."""
_EXACT = 1e-5
"""Residuals relative to the range of the channels that are rounding and no scatter."""
_EDGE = 1e-3
_ROUNDS = 3
_FEW = 3
"""Flights between impacts, whose ratios may agree by chance although impacts scatter."""
_NORMAL = 1.959964
"""Half of a 95 % interval in standard errors of a normal distribution."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FittedTrial(ByValue):
    """A trial of a transient beside its fitted motion.

    Attributes:
        label: Name of the trial.
        start: Initial state by name.
        offset: Time offset of the motion [s].
        origin: Recorded time of the initial state [s].
        time: Recorded times, ``(n,)`` [s].
        names: Names of the recorded signals.
        units: Units of the recorded signals.
        recorded: Samples, ``(n, n_s)``.
        fitted: Signals of the fitted motion, ``(n, n_s)``.
        seen: Mask of the samples that count, 1 or 0, ``(n, n_s)``.
        impacts: Times of the resolved impacts of the fitted motion [s].
        seen_impacts: Number of impacts that the recording shows.
        event_times: Recorded times of true events, ``(n_e,)`` [s].
        event_rests: Recorded minus fitted times of the events, ``(n_e,)`` [s].
        missed: Sentences about impacts that were not recorded.
        false: Sentences about recorded events that the machine did not make.
    """

    label: str
    start: Mapping[str, float]
    offset: float
    origin: float
    time: Vector
    names: tuple[str, ...]
    units: tuple[str, ...]
    recorded: Vector
    fitted: Vector
    seen: Vector
    impacts: Vector
    seen_impacts: int
    event_times: Vector
    event_rests: Vector
    missed: tuple[str, ...]
    false: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the trial as plain data, without its samples."""
        return {
            "label": self.label,
            "start": dict(self.start),
            "offset": self.offset,
            "impacts": self.impacts.tolist(),
            "seen_impacts": self.seen_impacts,
            "missed": list(self.missed),
            "false": list(self.false),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransientFit(ByValue):
    """What a fit of transients found in addition to the parameters.

    Attributes:
        trials: The trials.
        tests: Tests of the residuals.
        verdict: One sentence about the model.
        starts: Number of starts of the fit.
        agreed: Number of starts that led to the optimum.
        jitter: Standard deviation of event times [s], NaN without events.
        scatter: Scatter of the restitution per impact by the event times, relative, or NaN.
    """

    trials: tuple[FittedTrial, ...]
    tests: ResidualTests
    verdict: str
    starts: int
    agreed: int
    jitter: float = math.nan
    scatter: float = math.nan

    def as_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        known = {"jitter": self.jitter, "scatter": self.scatter, "misfit": self.tests.misfit}
        return {
            **{name: value if math.isfinite(value) else None for name, value in known.items()},
            "verdict": self.verdict,
            "structure_left": self.tests.has_structure,
            "same_law": dict(self.tests.law),
            "no_speed_law": dict(self.tests.speed),
            "white": self.tests.alike,
            "starts": self.starts,
            "agreed": self.agreed,
            "trials": [one.as_json() for one in self.trials],
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedValue:
    """A fitted value with its interval.

    Attributes:
        value: The value.
        error: Standard error, infinite if the trials do not determine it. Where few data determine
            it, that of a normal distribution with as wide a 95 % interval.
        low: Lower end of the 95 % interval.
        high: Upper end.
    """

    value: float
    error: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransientResult:
    """Parameters from transients.

    Attributes:
        values: All parameter values, including the fitted values.
        shared: The fitted values, in the order of the unknowns.
        unknowns: The unknowns.
        correlation: Correlation matrix of the fitted values.
        unseen: Combinations that the trials do not determine.
        before: Root mean square deviation at the start, relative to the ranges of the channels.
        after: The same after the fit.
        converged: Whether the fit converged.
        optima: Other optima that fit nearly as well.
        fit: The trials and the verdict.
        remarks: Further remarks.
    """

    values: ParameterValues
    shared: tuple[SharedValue, ...]
    unknowns: Unknowns
    correlation: Vector
    unseen: tuple[Unseen, ...]
    before: float
    after: float
    converged: bool
    optima: tuple[Mapping[str, float], ...]
    fit: TransientFit
    remarks: tuple[str, ...]


def fit_transients(
    problem: Problem,
    values: ParameterValues,
    recordings: Sequence[tuple[str, Recording]],
    sought: Sequence[FitParameter],
    *,
    start: Mapping[str, float] | None = None,
    free: Collection[str] = (),
    second: SecondFile | None = None,
    on_progress: Progress = silent,
) -> TransientResult:
    """Fit parameters to transients.

    Args:
        problem: The problem.
        values: Parameter values, rough for those that are fitted.
        recordings: Label and recording of each trial.
        sought: The parameters and errors of instruments to fit.
        start: Known initial values of all trials.
        free: Further initial values to determine: states, `clock`, `offset`.
        second: A second file of the motion of a single trial, on another clock.
        on_progress: Called with each stage.

    Raises:
        InputError: If a name or a range is invalid, or a recording holds nothing of the problem.
        UnfittableError: If no simulation follows the recordings.
    """
    # Without unknowns, the recordings are compared with the given values.
    begin = begin_of(problem, values, sought) if sought else values
    on_progress("reading the trials", None)
    trials = [
        prepared_trial(problem, begin, one, label=label, start=start or {}, free=free)
        for label, one in recordings
    ]
    begin = _with_seen_restitution(problem, begin, sought, trials)
    shooting = _shooting(problem, begin, sought, trials)
    first = np.zeros(shooting.n_z)
    before = _deviation(shooting, first)
    steady = _without_jumps(shooting)
    found = best_fit(steady, first, on_progress)
    if found is None:
        raise refusal("the motion from the recorded start cannot be simulated at the start values")
    words: tuple[str, ...] = ()
    if second is not None:
        on_progress("laying the second file over the motion", None)
        steady, z, words = with_second(steady, found, begin, second)
        extra = steady.trials[-1]
        shooting = replace(
            shooting,
            trials=(*shooting.trials, extra),
            whitening=(*shooting.whitening, independent_whitening(extra)),
        )
        steady = _without_jumps(shooting)
        found = replace(fitted(steady, z), found=(z,), shares=(1,))
    shooting, found = _masked(shooting, found, is_whole=steady is shooting)
    noise = tuple(one.noise for one in shooting.trials)
    on_progress("weighting the channels", None)
    after = _deviation(shooting, found.z)
    shooting, found, events = _reweighted(shooting, found, noise)
    # With scatter of the restitution, late event times may be far from the most likely motion.
    after = min(after, _deviation(shooting, found.z))
    if _fits_machine(sought) and not after < _UNLIKE:
        heard = not any(len(one.time) for one in shooting.trials)
        remedy = "crop the recording with --t-start and --t-end"
        raise refusal(
            f"the nearest motion is {100 * after:.2g} % of the signals' ranges off: check the "
            f"start values, or {'determine the start by --initial NAME' if heard else remedy}"
        )
    result = _described(shooting, found, noise, events, sought, begin, before, after, on_progress)
    return replace(result, remarks=(*words, *result.remarks))


def _fits_machine(sought: Sequence[FitParameter]) -> bool:
    """Return True if a parameter of the machine is fitted, and not only errors of instruments."""
    return any(not one.readings for one in sought)


def _shooting(
    problem: Problem,
    begin: ParameterValues,
    sought: Sequence[FitParameter],
    trials: Sequence[TrialData],
) -> Shooting:
    unknowns = _with_channel_ranges(unknowns_of(problem, begin, sought), trials)
    graph = problem.graph_dynamics(begin)
    unknown = {channel for own in unknowns.readings for _, channel in own if channel}
    return Shooting(
        problem=problem,
        graph=graph,
        unknowns=unknowns,
        trials=tuple(
            _placed(problem, begin, _with_wide_starts(graph, one, unknown)) for one in trials
        ),
        whitening=tuple(independent_whitening(one) for one in trials),
    )


def _with_wide_starts(
    graph: GraphDynamics, trial: TrialData, channels: Collection[str]
) -> TrialData:
    """Return a trial whose initial values may be far from the samples of some channels.

    Args:
        graph: The machine.
        trial: The trial.
        channels: Names of the channels with an unknown gain or offset.
    """
    names, n_q = graph.state_names, graph.n_q

    def is_rough(one: FreeStart) -> bool:
        places = np.flatnonzero(one.direction).tolist()
        return any(
            names[k] in channels or (n_q <= k < 2 * n_q and names[k - n_q] in channels)
            for k in places
        )

    wide = (replace(one, reach=_WIDE) if is_rough(one) else one for one in trial.free)
    return replace(trial, free=tuple(wide)) if channels else trial


def _with_channel_ranges(unknowns: Unknowns, trials: Sequence[TrialData]) -> Unknowns:
    """Return the unknowns with the scale and range of offsets by the ranges of their channels.

    Raises:
        InputError: If an unknown names a channel that no trial has.
    """
    names = tuple(dict.fromkeys(name for one in trials for name in one.measured.names))
    unknowns.instruments(names)
    scale, lower, upper = unknowns.scale.copy(), unknowns.lower.copy(), unknowns.upper.copy()
    for k, own in enumerate(unknowns.readings):
        for _, channel in own:
            sizes = [
                float(np.nanmax(row) - np.nanmin(row))
                for one in trials
                if channel in one.measured.names
                for row in [one.values[:, one.measured.names.index(channel)]]
            ]
            if math.isinf(lower[k]) and sizes:
                scale[k] = max(sizes) or 1.0
                lower[k], upper[k] = -scale[k], scale[k]
    return replace(unknowns, scale=scale, lower=lower, upper=upper)


def _placed(problem: Problem, begin: ParameterValues, trial: TrialData) -> TrialData:
    """Return a trial of event times alone with its first impact at the simulated one.

    Raises:
        UnfittableError: If no simulated impact follows the start.
    """
    if len(trial.time) or not any(one.name == OFFSET for one in trial.free):
        return trial
    graph = problem.graph_dynamics(begin)
    times = event_times(trial)
    # The first free fall may be longer than the whole recording.
    span = 20.0 * float(np.ptp(times))
    execution = simulate(graph, trial.start, until=span, impacts=1, settings=SETTINGS)
    if not execution.impacts:
        raise refusal(
            f"{trial.label}: no impact follows the initial state: give it by --start NAME=VALUE"
        )
    return replace(trial, shift=float(times.min()) - execution.impacts[0].time)


def _with_seen_restitution(
    problem: Problem,
    begin: ParameterValues,
    sought: Sequence[FitParameter],
    trials: Sequence[TrialData],
) -> ParameterValues:
    """Return the start with the restitution that recorded flights show, if it is fitted."""
    names = [name for one in sought for name in one.names if name == "restitution"]
    boxes = [one for one in sought if "restitution" in one.names]
    ratios = [ratio for one in trials for ratio in _seen_ratios(one)]
    known = [one for one in ratios if math.isfinite(one)]
    if not names or not known or len(boxes) != 1 or len(boxes[0].names) != 1:
        return begin
    box = boxes[0]
    value = float(np.clip(np.median(known), box.lower, box.upper))
    inside = box.lower + _EDGE * (box.upper - box.lower) < value
    if not inside or value > box.upper - _EDGE * (box.upper - box.lower):
        return begin
    return problem.values(gains=begin.gains, parameters={**begin.parameters, "restitution": value})


def _seen_ratios(trial: TrialData) -> list[float]:
    """Return the ratios of neighbouring flights that a trial shows."""
    return [*map(_ratio, trial.impacts.values()), *(one.ratio for one in trial.series)]


def _ratio(impacts: Vector) -> float:
    """Return the ratio of the first two flights, NaN if they do not shrink."""
    flights = np.diff(impacts)
    if len(flights) < 2 or not flights[1] < 0.98 * flights[0]:
        return math.nan
    return float(flights[1] / flights[0])


def _deviation(shooting: Shooting, z: Vector) -> float:
    """Return the root mean square deviation of all channels relative to their ranges.

    For event times it is relative to the longest interval.
    """
    squares: list[float] = []
    for k, trial in enumerate(shooting.trials):
        found = shooting.predicted(k, z, math.inf)
        if found is None:
            return math.inf
        for s in range(trial.values.shape[1]):
            rows = trial.seen[:, s]
            if rows.any():
                size = float(np.ptp(trial.values[rows, s])) or 1.0
                off = found.signals[rows, s] - trial.values[rows, s]
                squares.append(float(np.mean(off**2)) / size**2)
        if trial.n_events > 1:
            off = found.events - event_times(trial)
            steps = [np.max(np.diff(one.times)) for one in trial.series if len(one.times) > 1]
            squares.append(float(np.mean(off**2)) / max([*map(float, steps), 1e-300]) ** 2)
    return math.sqrt(float(np.mean(squares))) if squares else math.inf


def _without_jumps(shooting: Shooting) -> Shooting:
    """Return the fit of the channels that do not jump, or the fit itself if a trial lacks them.

    Samples of a velocity beside an impact that no gap shows lead to wrong optima.
    """
    trials = tuple(
        replace(one, seen=one.seen & ~one.jumping[None, :]) if len(one.time) else one
        for one in shooting.trials
    )
    if not any(one.jumping.any() for one in shooting.trials) or any(
        not one.seen.any() and not one.n_events for one in trials
    ):
        return shooting
    return replace(shooting, trials=trials)


def _masked(shooting: Shooting, found: StagedFit, *, is_whole: bool) -> tuple[Shooting, StagedFit]:
    """Return the fit without jumping channels beside the impacts of its motion.

    A gap may hide impacts of which a velocity has samples. The mask does not move during a fit.

    Args:
        shooting: The trials with all channels.
        found: An optimum.
        is_whole: Whether it is one of all channels.
    """
    if not any(one.jumping.any() for one in shooting.trials):
        return shooting, found
    for _ in range(2):
        trials: list[TrialData] = []
        for k, trial in enumerate(shooting.trials):
            at = shooting.predicted(k, found.z, math.inf)
            if at is None:
                return shooting, found
            for stop in shooting.graph.stop_names:
                own = [one for one in at.motion.execution.impacts if one.stop == stop]
                trial = trial.without(np.array([one.time for one in own]) + at.offset)
            trials.append(trial)
        pairs = zip(trials, shooting.trials, strict=True)
        if is_whole and all(np.array_equal(one.seen, former.seen) for one, former in pairs):
            break
        shooting, is_whole = replace(shooting, trials=tuple(trials)), True
        found = refitted(shooting, found)
    return shooting, found


def _reweighted(
    shooting: Shooting, found: StagedFit, noise: Sequence[Vector]
) -> tuple[Shooting, StagedFit, EventNoise | None]:
    """Return the fit with the weights that its residuals show: channels, then event times."""
    has_events = any(one.n_events for one in shooting.trials)
    events: EventNoise | None = None
    for _ in range(_ROUNDS if has_events else 1):
        own, whitening = shooting.channel_noise(found.z), shooting.whitening
        if has_events:
            told = event_noise(shooting, found.z)
            if told is not None:
                events, whitening = told
        ratios = [a / b for a, b in zip(own, noise, strict=True)]
        flat = np.concatenate([*ratios, np.zeros(0)])
        even = len(flat) == 0 or np.max(flat) < _OTHER_WEIGHT * np.min(flat)
        if even and not has_events:
            return shooting, found, None
        other = shooting.reweighted(own, whitening)
        try:
            again = fitted(other, found.z)
        except LostStartError:
            break
        shooting = other
        found = replace(again, agreed=found.agreed, starts=found.starts, others=found.others)
    return shooting, found, events


def _described(
    shooting: Shooting,
    found: StagedFit,
    noise: tuple[Vector, ...],
    events: EventNoise | None,
    sought: Sequence[FitParameter],
    begin: ParameterValues,
    before: float,
    after: float,
    on_progress: Progress,
) -> TransientResult:
    """Return the result of a fit: intervals, undetermined combinations, and the verdict."""
    known = events if events is not None and events.estimated else None
    scatter = math.nan if known is None else known.scatter
    jitter = math.nan if known is None else known.jitter / known.longest
    tests = tested(shooting, found, noise, scatter, jitter)
    trials = tuple(_fitted_trial(shooting, found, j) for j in range(len(shooting.trials)))
    scattered = _fits_machine(sought) and after > _EXACT and tests.law_differs
    mixed = mixed_fit(shooting, found, noise) if scattered else None
    squares = () if mixed is None else _squares_words(shooting, found, sought)
    if mixed is not None:
        shooting, scatter = mixed.shooting, mixed.noise.scatter
        found = replace(mixed.found, agreed=found.agreed, starts=found.starts)
        tests = _under_scatter(mixed, noise, tests)
    widened = tests.has_structure and mixed is None
    basis = _Basis(
        shooting=shooting,
        found=found,
        inflation=tests.inflation if widened else 1.0,
        freedom=None if mixed is None else mixed.freedom,
        labels=tuple(one.label for one in sought),
    )
    tests = replace(tests, ends=tuple(one for one in basis.at_end if one not in basis.hidden))
    k, covariance = shooting.n_shared, covariance_of(found)
    errors = np.sqrt(np.maximum(np.diag(covariance), 1e-300))[:k]
    determined = _is_determined(found)
    others = tuple(
        dict(zip(basis.labels, shooting.values(z).tolist(), strict=True)) for z in found.others
    )
    return TransientResult(
        values=_values(shooting, found, sought, begin),
        shared=tuple(basis.shared(on_progress)),
        unknowns=shooting.unknowns,
        correlation=covariance[:k, :k] / np.outer(errors, errors),
        unseen=basis.unseen,
        before=before,
        after=after,
        converged=found.converged,
        optima=others,
        fit=TransientFit(
            trials=trials,
            tests=tests,
            verdict=_verdict(
                tests, events, mixed, is_fitted=_fits_machine(sought), determined=determined
            ),
            starts=found.starts,
            agreed=found.agreed,
            jitter=math.nan if events is None else events.jitter,
            scatter=scatter,
        ),
        remarks=tuple(
            _remarks(shooting, found, basis.at_end, trials, tests, others, widened=widened)
        )
        + squares
        + (() if mixed is not None else _few_words(trials, tests, basis)),
    )


def _few_words(
    trials: Sequence[FittedTrial], tests: ResidualTests, basis: _Basis
) -> tuple[str, ...]:
    """Return that the impacts are too few to show a scatter of a fitted restitution."""
    seen = sum(max(one.seen_impacts - 1, 0) for one in trials)
    named = [one for one in basis.labels if "restitution" in one and one not in basis.hidden]
    if not named or not tests.law or seen > _FEW or not math.isnan(tests.scatter):
        return ()
    return (
        f"{counted(seen, 'flight')} between impacts cannot show a scatter of `{named[0]}` from "
        f"impact to impact, 1 to 10 % on real machines: its interval contains none, so record "
        f"several trials",
    )


def _squares_words(
    shooting: Shooting, found: StagedFit, sought: Sequence[FitParameter]
) -> tuple[str, ...]:
    """Return which values the drawn motions have beside those of a mixed model.

    A motion of the mean restitution does not follow the samples of impacts that scatter.
    """
    pairs = zip(sought, shooting.values(found.z).tolist(), strict=True)
    text = ", ".join(f"`{one.label}` = {value:.6g}" for one, value in pairs)
    return (f"deviations and pictures are those of the nearest single motion, with {text}",)


def _under_scatter(
    mixed: MixedFit, noise: tuple[Vector, ...], tests: ResidualTests
) -> ResidualTests:
    """Return the tests of several trials against their scatter, and those of a single trial.

    The impacts of one trial cannot separate a law from scatter, so its tests stay as they are.
    """
    if len(mixed.shooting.trials) < 2:
        return tests
    jitter = mixed.noise.jitter / mixed.noise.longest
    return tested(mixed.shooting, mixed.found, noise, mixed.noise.scatter, jitter)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Basis:
    """The fit that intervals rest on: of all samples, or of a mixed model.

    Attributes:
        shooting: The trials.
        found: The optimum.
        inflation: Ratio of the errors to those for independent residuals.
        freedom: Degrees of freedom of the unknowns, by default of the residuals.
        labels: Labels of the shared unknowns.
    """

    shooting: Shooting
    found: StagedFit
    inflation: float
    freedom: Vector | None
    labels: tuple[str, ...]

    @cached_property
    def _scale(self) -> float:
        return math.sqrt(self.found.cost / degrees(self.found)) * self.inflation

    @cached_property
    def unseen(self) -> tuple[Unseen, ...]:
        """Combinations that the trials do not determine."""
        return _unseen(self.shooting, self.found, self.labels, self._scale)

    @property
    def hidden(self) -> set[str]:
        """Labels of the unknowns in these combinations."""
        parts = (pair for one in self.unseen for pair in one.direction.items())
        return {name for name, part in parts if abs(part) > _HIDDEN}

    @property
    def at_end(self) -> list[str]:
        """Labels of the unknowns at an end of their range."""
        rows = enumerate(self.labels)
        return [label for k, label in rows if _at_end(self.shooting, self.found, k)]

    def shared(self, on_progress: Progress) -> Iterator[SharedValue]:
        """Yield the fitted values, with intervals of those that are determined.

        Args:
            on_progress: Called with the part that is done.
        """
        known = _is_determined(self.found) and self.found.converged
        without = {*self.hidden, *self.at_end} if known else {*self.labels}
        for j, label in enumerate(self.labels):
            on_progress("computing the intervals", j / len(self.labels))
            yield self._unknown(j) if label in without else self._known(j)

    def _unknown(self, j: int) -> SharedValue:
        value = float(self.shooting.values(self.found.z)[j])
        return SharedValue(value=value, error=math.inf, low=-math.inf, high=math.inf)

    def _known(self, j: int) -> SharedValue:
        shooting, z = self.shooting, self.found.z
        freedom = None if self.freedom is None else float(self.freedom[j])
        ends: list[float] = []
        for end in profile_ends(shooting, self.found, j, self.inflation, freedom):
            other = z.copy()
            other[j] = end
            ends.append(float(shooting.values(other)[j]))
        # Few impacts tell their own scatter badly: two errors are then less than 95 %.
        few = quantile_of(self.found, freedom) / _NORMAL
        error = few * self._scale * math.sqrt(max(float(covariance_of(self.found)[j, j]), 1e-300))
        return SharedValue(
            value=float(shooting.values(z)[j]),
            error=abs(float(shooting.slopes(z)[j])) * error,
            low=min(ends),
            high=max(ends),
        )


def _is_determined(found: StagedFit) -> bool:
    """Return True if there are more data than unknowns that matter."""
    return len(found.rest) > int(np.linalg.matrix_rank(found.jacobian))


def _unseen(
    shooting: Shooting, found: StagedFit, labels: Sequence[str], inflation: float
) -> tuple[Unseen, ...]:
    """Return the combinations of shared unknowns that the trials do not determine."""
    k = shooting.n_shared
    if not k:
        return ()
    rows = found.jacobian
    own, others = rows[:, :k], rows[:, k:]
    size = np.linalg.norm(others, axis=0)
    if np.any(size > 0.0):
        basis, _ = np.linalg.qr(others[:, size > 0.0] / size[size > 0.0])
        own = own - basis @ (basis.T @ own)
    # Relative to the fitted values, or to the scales of values without a scale of their own.
    by = shooting.slopes(found.z)
    values = np.abs(shooting.values(found.z))
    additive = np.array(shooting.unknowns.additive, dtype=np.bool_)
    unit = np.where(additive | (values == 0.0), shooting.unknowns.scale, values) / np.abs(by)
    information = (own * unit).T @ (own * unit)
    names = [label for label, mark in zip(labels, additive, strict=True) if mark]
    return unseen_combinations(labels, information, inflation, names)


def _values(
    shooting: Shooting, found: StagedFit, sought: Sequence[FitParameter], begin: ParameterValues
) -> ParameterValues:
    parameters = dict(begin.parameters)
    rows = zip(sought, shooting.unknowns.readings, shooting.values(found.z), strict=True)
    for one, readings, value in rows:
        if not readings:
            parameters |= dict.fromkeys(one.names, float(value))
    return shooting.problem.values(gains=begin.gains, parameters=parameters)


def _fitted_trial(shooting: Shooting, found: StagedFit, k: int) -> FittedTrial:
    """Return a trial beside its fitted motion.

    Raises:
        UnfittableError: If the motion cannot be simulated.
    """
    own = shooting.trials[k]
    at = shooting.predicted(k, found.z, math.inf)
    if at is None:
        raise refusal(f"{own.label}: the fitted motion cannot be simulated")
    state, offset = shooting.start_of(k, found.z)
    impacts = _impacts_of(own, at.motion, offset, at.stretch)
    return FittedTrial(
        label=own.label,
        start=dict(zip(shooting.problem.state_names, state.tolist(), strict=True)),
        offset=offset,
        origin=own.origin,
        time=own.time + own.origin,
        names=own.measured.names,
        units=own.measured.units,
        recorded=own.values,
        fitted=at.signals,
        seen=own.seen.astype(np.float64),
        impacts=impacts + own.origin,
        seen_impacts=_n_seen(own),
        event_times=event_times(own) + own.origin,
        event_rests=event_times(own) - at.events,
        missed=tuple(word for one in own.series for word in one.missed),
        false=tuple(word for one in own.series for word in one.false),
    )


def _impacts_of(trial: TrialData, motion: TransientMotion, offset: float, stretch: float) -> Vector:
    """Return the times of the impacts until the flights are shorter than three samples.

    For event times alone they are all impacts up to the last that was recorded.
    """
    if len(trial.time) < 2:
        rows = [np.zeros(0)]
        for one in trial.series:
            model = motion.events(one.kind, one.stop)
            last = max([k for k in matched(one, model) if k is not None], default=-1)
            if one.kind is EventKind.IMPACT:
                rows.append(stretch * (model.times[: last + 1] + offset))
        return np.sort(np.concatenate(rows))
    times = stretch * np.array([one.time + offset for one in motion.execution.impacts])
    times = times[times <= trial.end + 1e-12]
    step = float(np.median(np.diff(trial.time)))
    flights = np.diff(np.append(times, np.inf))
    return times[(flights > 3.0 * step) | (np.diff(times, prepend=-np.inf) > 3.0 * step)]


def _n_seen(trial: TrialData) -> int:
    heard: list[EventSeries] = [one for one in trial.series if one.kind.word == "impact"]
    if heard:
        return sum(len(one.times) for one in heard)
    return sum(len(row) for row in trial.impacts.values())


def _at_end(shooting: Shooting, found: StagedFit, k: int) -> bool:
    """Return True if an unknown is at an end of its range."""
    low, high = (float(row[k]) for row in shooting.bounds)
    return min(found.z[k] - low, high - found.z[k]) < _EDGE * (high - low)


def _verdict(
    tests: ResidualTests,
    events: EventNoise | None,
    mixed: MixedFit | None,
    *,
    is_fitted: bool,
    determined: bool,
) -> str:
    """Return one sentence about the model, the most specific finding first."""
    if not determined:
        return "the model is not tested: there are no more data than unknowns"
    if tests.law_differs and not is_fitted:
        return (
            f"structure is left: other restitutions at the impacts would explain more "
            f"(probability {min(tests.law[one] for one in tests.law_differs):.1g} by chance)"
        )
    if tests.speed_matters or tests.law_differs:
        return _law_verdict(tests, mixed)
    if tests.is_loose:
        return (
            f"structure is left: the events hardly follow the model, with {100 * tests.odd:.2g} % "
            f"missed or false, a jitter of {100 * tests.jitter:.2g} % of the longest interval and "
            f"a scatter of the restitution of {100 * tests.scatter:.2g} %"
        )
    if tests.misfit > 1.25:
        return (
            f"structure is left: the residuals are {tests.misfit:.3g} times the noise, so the "
            f"model lacks an effect, or the instrument has an error"
        )
    if tests.alike < 1e-3:
        return (
            f"structure is left: neighbouring residuals are alike (probability "
            f"{tests.alike:.1g}), so the model lacks an effect"
        )
    if tests.ends:
        names = ", ".join(f"`{one}`" for one in tests.ends)
        return f"structure is left: {names} reached a limit of the range: not identified"
    if mixed is not None and len(mixed.shooting.trials) > 1:
        return (
            f"no structure is left: one restitution with a scatter of "
            f"{100 * mixed.noise.scatter:.2g} % from impact to impact explains the impacts"
        )
    if events is not None and not math.isfinite(tests.misfit):
        return "no structure is left: one law with its scatter explains the event times"
    return "no structure is left: the residuals are white and as large as the noise"


def _law_verdict(tests: ResidualTests, mixed: MixedFit | None) -> str:
    """Return the sentence about impacts that do not have one restitution."""
    stops = dict.fromkeys((*tests.speed_matters, *tests.law_differs))
    where = f" at {', '.join(f'`{one}`' for one in stops)}"
    part = min(tests.part.get(one, 0.0) for one in stops)
    rare = min([*tests.speed.values(), *tests.law.values()])
    if tests.speed_matters and part > _MOSTLY:
        return (
            f"structure is left: the restitution{where} changes with the impact speed, which "
            f"explains {100 * part:.2g} % of the deviations at impacts (probability {rare:.1g} by "
            f"chance)"
        )
    if not math.isfinite(tests.misfit):
        return (
            f"structure is left: the impacts{where} do not have one restitution beyond its scatter "
            f"(probability {rare:.1g}), so it follows the speed, or the flights have drag"
        )
    size = "" if mixed is None else f" of {100 * mixed.noise.scatter:.2g} %"
    if mixed is not None and len(mixed.shooting.trials) > 1:
        return (
            f"structure is left: the impacts{where} do not have one restitution beyond a scatter"
            f"{size} (probability {rare:.1g}), so it follows a law"
        )
    return (
        f"structure is left: the impacts{where} do not have one restitution (probability "
        f"{rare:.1g}); a law of the speed or scatter{size} may explain this, and a single drop "
        f"cannot separate them"
    )


def _remarks(
    shooting: Shooting,
    found: StagedFit,
    at_end: Sequence[str],
    trials: Sequence[FittedTrial],
    tests: ResidualTests,
    others: Sequence[Mapping[str, float]],
    *,
    widened: bool,
) -> list[str]:
    remarks = [word for one in shooting.trials for word in one.remarks]
    remarks += offset_words(shooting, found)
    many = len(trials) > 1
    for one in trials:
        remarks += [f"{one.label}: {w}" if many else w for w in (*one.missed, *one.false)]
    remarks += [
        f"`{label}` reached an end of its range: its interval is unknown" for label in at_end
    ]
    if tests.has_structure:
        remarks += [word for one in shooting.trials for word in _held_words(one)]
    if not _is_determined(found):
        remarks.append("no value has an interval: there are no more data than unknowns")
    if found.starts > 2 and found.agreed < 2:
        remarks.append(f"only one of {found.starts} starts led to this optimum")
    if not found.converged:
        remarks.append(
            "the fit did not converge: better values may exist, and none has an interval"
        )
    if widened and tests.inflation > 1.0:
        remarks.append(
            f"intervals are {tests.inflation:.2g} times as wide as for independent residuals, and "
            f"the estimates may still be biased beyond them"
        )
    for one in others:
        text = ", ".join(f"`{name}` = {value:.6g}" for name, value in one.items())
        remarks.append(f"another optimum fits nearly as well: {text}")
    return remarks


def _held_words(trial: TrialData) -> Iterator[str]:
    """Yield the advice to leave out samples before the release."""
    if trial.twin is not None or any(one.name == OFFSET for one in trial.free):
        return
    held = held_until(trial.time, trial.values)
    if held is not None:
        at = trial.origin + held
        yield (
            f"{trial.label}: the signals rest until {at:.4g} s: if the machine was held until then,"
            f" leave out that part with --t-start {at:.4g}"
        )


__all__ = ["FittedTrial", "TransientFit", "TransientResult", "UnfittableError", "fit_transients"]
