r"""Residuals of trials and their exact derivatives, by single shooting over the simulation.

The unknowns `z` are the fitted parameters and errors of instruments, then the free initial values
of every trial. A parameter with a positive range is :math:`\theta = \theta_0 e^z`, any other value
:math:`\theta_0 + s z` with its scale `s`. The residuals are the samples in units of their noise,
and the event times after whitening by their covariance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.instruments import Instruments, instruments_of
from zeno_orbits.experiment.identification.unknowns import Unknowns
from zeno_orbits.experiment.transients.event_labels import sequences_of
from zeno_orbits.experiment.transients.event_record import EventSeries
from zeno_orbits.experiment.transients.motion import (
    MotionTimes,
    StatesAt,
    TransientMotion,
    moved,
)
from zeno_orbits.experiment.transients.trial import OFFSET, RATE, FreeStart, TrialData
from zeno_orbits.model import GraphDynamics, Problem
from zeno_orbits.simulation import EventKind

_PAST = 0.25
"""Part of a trial that the simulation of event times goes on beyond it."""
_CLOCK_SLACK = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shooting:
    """Trials with shared parameters, as a least-squares problem.

    Attributes:
        problem: The problem.
        graph: The machine at the start of the fit.
        unknowns: The fitted parameters and errors of instruments.
        trials: The trials.
        whitening: For each trial, the matrix that whitens its event residuals, ``(n_e, n_e)``.
    """

    problem: Problem
    graph: GraphDynamics
    unknowns: Unknowns
    trials: tuple[TrialData, ...]
    whitening: tuple[Vector, ...]

    @property
    def n_shared(self) -> int:
        """Number of shared unknowns."""
        return len(self.unknowns.start)

    @property
    def n_z(self) -> int:
        """Number of unknowns."""
        return self.n_shared + sum(len(one.free) for one in self.trials)

    @property
    def is_log(self) -> NDArray[np.bool_]:
        """Mask of the shared unknowns that vary by their logarithm, ``(k,)``."""
        own = [not readings for readings in self.unknowns.readings]
        return (
            np.array(own, dtype=np.bool_)
            & (self.unknowns.lower > 0.0)
            & (self.unknowns.start > 0.0)
        )

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        """Bounds of the unknowns, each ``(n_z,)``."""
        at = self.unknowns
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = [np.log(end / at.start) for end in (at.lower, at.upper)]
        linear = [(end - at.start) / at.scale for end in (at.lower, at.upper)]
        low, high = (
            np.where(self.is_log, log, line) for log, line in zip(logs, linear, strict=True)
        )
        reach = np.array([one.reach for trial in self.trials for one in trial.free])
        return np.concatenate([low, -reach]), np.concatenate([high, reach])

    def values(self, z: Vector) -> Vector:
        """Return the values of the shared unknowns, ``(k,)``."""
        at, own = self.unknowns, z[: self.n_shared]
        with np.errstate(over="ignore"):
            return np.where(
                self.is_log,
                at.start * np.exp(np.where(self.is_log, own, 0.0)),
                at.start + at.scale * own,
            )

    def slopes(self, z: Vector) -> Vector:
        """Return the derivatives of the values with respect to their own unknown, ``(k,)``."""
        return np.where(self.is_log, self.values(z), self.unknowns.scale)

    def columns(self, trial: int) -> slice:
        """Return the range of the free initial values of a trial among the unknowns."""
        before = self.n_shared + sum(len(one.free) for one in self.trials[:trial])
        return slice(before, before + len(self.trials[trial].free))

    def start_of(self, trial: int, z: Vector) -> tuple[Vector, float]:
        """Return the initial state of a trial and its time offset [s]."""
        own = self.trials[trial]
        x, offset = own.start.copy(), own.shift
        for column, one in self.motion_columns(trial):
            x += one.direction * one.scale * z[column]
        for column, one in self.free_columns(trial):
            if one.name == OFFSET:
                offset += one.scale * z[column]
        clock = list(self.problem.clock)
        if clock:
            # A change along the tangent is brought back to the circle.
            x[clock] /= np.linalg.norm(x[clock]) / np.linalg.norm(own.start[clock])
        return x, offset

    def parameters(self, z: Vector) -> Vector:
        """Return gains and parameters at unknowns."""
        p = self.unknowns.base.copy()
        p[list(self.unknowns.places)] = self.unknowns.ties @ self.values(z)
        return p

    def predicted(self, trial: int, z: Vector, horizon: float) -> Prediction | None:
        """Return the prediction of a trial up to a horizon, ``None`` if it cannot be simulated.

        Args:
            trial: Index of the trial.
            z: Unknowns, ``(n_z,)``.
            horizon: Last time that counts [s].
        """
        own, p = self.trials[trial], self.parameters(z)
        x, offset = self.start_of(trial, z)
        stretch = self.stretch_of(trial, z)
        end = min(horizon, own.end) / stretch - offset
        if own.n_events:
            end += _PAST * (own.end - min([*own.time[:1].tolist(), *_firsts(own)]))
        try:
            graph = self.graph.at(p)
        except ValueError:
            return None
        motion = moved(graph, x, max(end, 0.0) * (1 + _CLOCK_SLACK) + 1e-12, self.unknowns.places)
        if motion is None:
            return None
        found = Prediction(
            shooting=self, trial=trial, z=z, horizon=horizon, motion=motion, offset=offset
        )
        return found if np.isfinite(found.signals).all() else None

    def stretch_of(self, trial: int, z: Vector) -> float:
        """Return the ratio of recorded times of a trial to times."""
        own = sum(one.scale * z[k] for k, one in self.free_columns(trial) if one.name == RATE)
        return self._instruments(self.trials[trial]).stretch(self.values(z)) * (1.0 + own)

    def _instruments(self, trial: TrialData) -> Instruments:
        return instruments_of(self.unknowns.readings, trial.measured.names)

    def free_columns(self, trial: int) -> Iterator[tuple[int, FreeStart]]:
        """Yield the free initial values of a trial with their indices among the unknowns."""
        columns = self.columns(trial)
        yield from enumerate(self.trials[trial].free, start=columns.start)

    def motion_columns(self, trial: int) -> Iterator[tuple[int, FreeStart]]:
        """Yield the free initial values of the motion of a trial, which may be its twin's."""
        twin = self.trials[trial].twin
        yield from self.free_columns(trial if twin is None else twin)

    def by_unknowns(self, trial: int, z: Vector, by: Vector) -> Vector:
        """Return derivatives with respect to the unknowns, ``(..., n_z)``.

        Args:
            trial: Index of the trial.
            z: Unknowns.
            by: Derivatives with respect to the initial state, then the parameters, ``(..., m)``.
        """
        n_x = len(self.graph.state_names)
        found = np.zeros((*by.shape[:-1], self.n_z))
        ties = self.unknowns.ties * self.slopes(z)
        found[..., : self.n_shared] = by[..., n_x:] @ ties
        for column, one in self.motion_columns(trial):
            found[..., column] = by[..., :n_x] @ (one.direction * one.scale)
        return found

    def predictions(self, z: Vector, stage: int | None = None) -> list[Prediction] | None:
        """Return the predictions of all trials, or ``None`` if one cannot be simulated.

        Args:
            z: Unknowns, ``(n_z,)``.
            stage: Index of the horizon of each trial, the whole trial by default.
        """
        found: list[Prediction] = []
        for k, trial in enumerate(self.trials):
            last = len(trial.horizons) - 1
            horizon = trial.horizons[last if stage is None else min(stage, last)]
            one = self.predicted(k, z, horizon)
            if one is None:
                return None
            found.append(one)
        return found

    def rests(self, predictions: Sequence[Prediction]) -> Vector:
        """Return the residuals of predictions of all trials, ``(n_r,)``."""
        rests = list[Vector]()
        for k, (trial, found) in enumerate(zip(self.trials, predictions, strict=True)):
            n = len(found.signals)
            rest = (found.signals - trial.values[:n]) / trial.noise
            rests.append(rest[trial.seen[:n]])
            if trial.n_events:
                due = event_times(trial) <= found.horizon
                white = self.whitening[k][np.ix_(due, due)]
                rests.append(white @ found.event_rests[due])
        return np.concatenate(rests)

    def rows(self, predictions: Sequence[Prediction]) -> Vector:
        """Return the derivatives of the residuals, ``(n_r, n_z)``.

        Raises:
            SimulationError: If an event lacks a derivative.
        """
        rows = list[Vector]()
        for k, (trial, found) in enumerate(zip(self.trials, predictions, strict=True)):
            n = len(found.signals)
            rows.append((found.by_signals / trial.noise[:, None])[trial.seen[:n]])
            if trial.n_events:
                due = event_times(trial) <= found.horizon
                by = found.event_slopes @ found.by_events
                rows.append(self.whitening[k][np.ix_(due, due)] @ by[due])
        return np.concatenate(rows)

    def channel_noise(self, z: Vector) -> list[Vector]:
        """Return the root mean square residual of each channel, over all trials that have it.

        A second file has instruments of its own.

        Args:
            z: Unknowns, ``(n_z,)``.
        """
        rests: dict[tuple[str, int | None], list[Vector]] = {}
        for k, trial in enumerate(self.trials):
            found = self.predicted(k, z, math.inf)
            if found is None:
                return [one.noise for one in self.trials]
            for s, name in enumerate(trial.measured.names):
                rows = trial.seen[:, s]
                rests.setdefault((name, trial.twin), []).append(
                    found.signals[rows, s] - trial.values[rows, s]
                )
        sizes = {
            name: math.sqrt(float(np.mean(np.concatenate(rows) ** 2))) if rows else 0.0
            for name, rows in rests.items()
        }
        return [
            np.array(
                [
                    max(sizes[name, one.twin], 1e-3 * one.noise[s])
                    for s, name in enumerate(one.measured.names)
                ]
            )
            for one in self.trials
        ]

    def reweighted(self, noise: Sequence[Vector], whitening: Sequence[Vector]) -> Shooting:
        """Return the problem with other errors of samples and events."""
        trials = tuple(replace(one, noise=own) for one, own in zip(self.trials, noise, strict=True))
        return replace(self, trials=trials, whitening=tuple(whitening))


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """The prediction of one trial at given unknowns.

    Derivatives cost several times as much as the motion, so they are computed when they are asked
    for. A rejected step of a fit needs no derivatives.

    Attributes:
        shooting: The trials.
        trial: Index of the trial.
        z: Unknowns, ``(n_z,)``.
        horizon: Last time that counts [s].
        motion: The simulated motion.
        offset: Time offset of the simulation [s].
    """

    shooting: Shooting
    trial: int
    z: Vector
    horizon: float
    motion: TransientMotion
    offset: float

    @cached_property
    def _own(self) -> TrialData:
        return self.shooting.trials[self.trial]

    @cached_property
    def _instruments(self) -> Instruments:
        return instruments_of(self.shooting.unknowns.readings, self._own.measured.names)

    @cached_property
    def stretch(self) -> float:
        """Ratio of recorded times to times."""
        return self.shooting.stretch_of(self.trial, self.z)

    @property
    def _by_rates(self) -> Vector:
        """Derivatives of the stretch with respect to all unknowns, ``(n_z,)``."""
        shooting, found = self.shooting, np.zeros(self.shooting.n_z)
        common = self._instruments.stretch(shooting.values(self.z))
        found[: shooting.n_shared] = (
            self.stretch / common * self._instruments.rate * shooting.slopes(self.z)
        )
        for column, one in shooting.free_columns(self.trial):
            if one.name == RATE:
                found[column] = common * one.scale
        return found

    @cached_property
    def _times(self) -> Vector:
        n = int(np.searchsorted(self._own.time, self.horizon, side="right"))
        return self._own.time[:n]

    @cached_property
    def _at(self) -> StatesAt:
        return self.motion.at(self._times / self.stretch - self.offset)

    @cached_property
    def _channels(self) -> Vector:
        return self._own.measured.values(self._at.states, self.shooting.parameters(self.z))

    @cached_property
    def signals(self) -> Vector:
        """Predicted channels at the samples up to the horizon, ``(n, n_s)``."""
        if not len(self._times):
            return np.zeros((0, self._own.values.shape[1]))
        return self._instruments.read(self._channels, self.shooting.values(self.z))

    @cached_property
    def by_signals(self) -> Vector:
        """Their derivatives with respect to the unknowns, ``(n, n_s, n_z)``.

        Raises:
            SimulationError: If an event lacks a derivative.
        """
        shooting, own, z = self.shooting, self._own, self.z
        if not len(self._times):
            return np.zeros((0, own.values.shape[1], shooting.n_z))
        n_x, k = len(shooting.graph.state_names), shooting.n_shared
        instruments, values = self._instruments, shooting.values(z)
        slopes = own.measured.derivatives(self._at.states, shooting.parameters(z))
        by = slopes[:, :, :n_x] @ self._at.by
        by[:, :, n_x:] += slopes[:, :, n_x:][:, :, list(shooting.unknowns.places)]
        by_z = shooting.by_unknowns(self.trial, z, by)
        rates = np.einsum("nsx,nx->ns", slopes[:, :, :n_x], self._at.rates)
        for column, one in shooting.free_columns(self.trial):
            if one.name == OFFSET:
                by_z[:, :, column] = -rates * one.scale
        scale = shooting.slopes(z)
        late = (self._times / self.stretch**2)[:, None, None] * self._by_rates
        by_z -= rates[:, :, None] * late
        by_z *= instruments.gain(values)[None, :, None]
        by_z[:, :, :k] += instruments.by_numbers(self._channels) * scale
        return by_z

    @cached_property
    def _events(self) -> tuple[Vector, Vector]:
        shooting, own, z, stretch = self.shooting, self._own, self.z, self.stretch
        times, rows = [np.zeros(0)], [np.zeros((0, shooting.n_z))]
        for series in own.series:
            model = self.motion.events(series.kind, series.stop)
            found = matched(series, model)
            own_times, by = placed(found, model, self.motion.execution.end_time)
            by_z = shooting.by_unknowns(self.trial, z, by) * stretch
            for column, one in shooting.free_columns(self.trial):
                if one.name == OFFSET:
                    by_z[:, column] = one.scale * stretch
            by_z += (own_times + self.offset)[:, None] * self._by_rates
            times.append((own_times + self.offset) * stretch)
            rows.append(by_z)
        return np.concatenate(times), np.concatenate(rows)

    @property
    def events(self) -> Vector:
        """Predicted event times since the origin, ``(n_e,)`` [s]."""
        return self._events[0]

    @property
    def by_events(self) -> Vector:
        """Their derivatives, ``(n_e, n_z)``."""
        return self._events[1]

    @cached_property
    def _along_flights(self) -> tuple[Vector, Vector]:
        times, recorded = self.events, event_times(self._own)
        rests, slopes = times - recorded, np.eye(len(times))
        at = 0
        for one in self._own.series:
            for k in range(at + 1, at + len(one.times)):
                flight, seen = times[k] - times[k - 1], recorded[k] - recorded[k - 1]
                if one.kind is EventKind.IMPACT and flight > 0.0 and seen > 0.0:
                    rests[k] = rests[k - 1] + seen * math.log(flight / seen)
                    slopes[k] = slopes[k - 1]
                    slopes[k, k - 1 : k + 1] += np.array([-1.0, 1.0]) * seen / flight
            at += len(one.times)
        return rests, slopes

    @property
    def event_rests(self) -> Vector:
        r"""Predicted minus recorded event times, ``(n_e,)`` [s].

        A deviation of the restitution multiplies all later flights. So the residuals grow by
        :math:`T_r\ln (T / T_r)` from impact to impact, with the flight `T` and the recorded one
        :math:`T_r`: to first order by the difference of both, and linear in the logarithms of the
        restitutions far from the motion too.
        """
        return self._along_flights[0]

    @property
    def event_slopes(self) -> Vector:
        """Their derivatives with respect to the predicted event times, ``(n_e, n_e)``."""
        return self._along_flights[1]


def independent_whitening(trial: TrialData) -> Vector:
    """Return the whitening of the event times of a trial with independent errors, ``(n_e, n_e)``.

    Args:
        trial: The trial.
    """
    errors = [
        error
        for one, error in zip(trial.series, trial.event_errors, strict=True)
        for _ in one.times
    ]
    return np.diag(1.0 / np.array(errors)) if errors else np.zeros((0, 0))


def event_times(trial: TrialData) -> Vector:
    """Return all event times of a trial in the order of the residuals, ``(n_e,)`` [s]."""
    return np.concatenate([np.zeros(0), *(one.times for one in trial.series)])


def _firsts(trial: TrialData) -> list[float]:
    return [float(one.times[0]) for one in trial.series if len(one.times)]


def matched(series: EventSeries, model: MotionTimes) -> list[int | None]:
    """Return the index of the event of a motion that belongs to each recorded one.

    Args:
        series: Recorded events.
        model: The events of the motion, of the same kind at the same stop.
    """
    if series.kind is not EventKind.IMPACT:
        return [k if k < len(model.times) else None for k in series.groups]
    parts = sequences_of(model.times)
    found: list[int | None] = []
    for group, number in zip(series.groups, series.numbers, strict=True):
        part = parts[group] if group < len(parts) else slice(0, 0)
        k = part.start + number
        found.append(k if k < part.stop else None)
    return found


def placed(found: Sequence[int | None], model: MotionTimes, end: float) -> tuple[Vector, Vector]:
    """Return the times of matched events and their derivatives. A missing event is at the end.

    Args:
        found: Index of each event.
        model: The events of the motion.
        end: Time of the end of the motion [s].
    """
    m = model.by.shape[1]
    times = [end if k is None else float(model.times[k]) for k in found]
    rows = [np.zeros(m) if k is None else model.by[k] for k in found]
    return np.array(times), np.array(rows).reshape(len(found), m)
