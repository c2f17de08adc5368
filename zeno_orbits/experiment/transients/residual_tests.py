r"""Tests of the residuals of a fit: is structure left, and does every impact have the same law?

The score test asks whether a deviation of the restitution at single impacts would improve the fit.
With the derivative `D` of the residuals with respect to these deviations, projected off the
Jacobian of the fit,

.. math:: F = \frac{|P_D r|^2 / q}{|r - P_D r|^2 / (n - p - q)}, \qquad q = \operatorname{rank} D

has an F distribution if the law is right. Neighbouring residuals that are alike are found by the
ratio of von Neumann, :math:`\sum (r_{i+1} - r_i)^2 / \sum r_i^2`, which is 2 for white residuals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, cast

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.experiment.comparison.instruments import instruments_of
from zeno_orbits.experiment.transients.shooting import Shooting, event_times, matched
from zeno_orbits.experiment.transients.staged_fit import StagedFit
from zeno_orbits.simulation import Impact

_MOST = 8
"""Impacts per stop and trial with a deviation of their own."""
_RESOLVED = 3.0
"""Sampling times of a flight that is resolved."""
_RARE = 1e-3
"""Probability below which a test finds structure."""
_LARGE_SCATTER, _LARGE_JITTER = 0.2, 0.02
"""Scatter and jitter that no ball and no microphone has: the events follow another law."""
_MANY = 0.4
"""Missed and false events relative to the recorded ones, from which the events are other ones."""
_LOUD = 1.25
"""Ratio of the residuals to the noise from which structure is left."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualTests:
    """Tests of the residuals.

    Attributes:
        misfit: Ratio of the residuals of the samples to the noise of the channels by their third
            differences. NaN without samples.
        alike: Probability of neighbouring residuals as alike as these, if they are white.
        law: Probability of a score as large as this by stop, if every impact has the same law.
        speed: The same by stop for one deviation in proportion to the impact speed.
        part: Part of the score of single restitutions that this deviation explains, by stop.
        inflation: Ratio of the errors to those for independent residuals.
        scatter: Scatter of the restitution per impact by event times, relative, or NaN.
        jitter: Jitter of event times relative to their longest interval, or NaN.
        odd: Missed and false events relative to the recorded events.
        ends: Determined parameters that reached an end of their range.
    """

    misfit: float
    alike: float
    law: dict[str, float]
    speed: dict[str, float]
    part: dict[str, float]
    inflation: float
    scatter: float = math.nan
    jitter: float = math.nan
    odd: float = 0.0
    ends: tuple[str, ...] = ()

    @property
    def law_differs(self) -> tuple[str, ...]:
        """Stops whose impacts do not have the same law."""
        return tuple(stop for stop, p in self.law.items() if p < _RARE)

    @property
    def speed_matters(self) -> tuple[str, ...]:
        """Stops whose restitution changes with the impact speed."""
        return tuple(stop for stop, p in self.speed.items() if p < _RARE)

    @property
    def has_structure(self) -> bool:
        """True if the model does not explain the recording."""
        tests = (*self.law_differs, *self.speed_matters)
        is_loud = self.misfit > _LOUD or self.is_loose
        return is_loud or self.alike < _RARE or bool(tests or self.ends)

    @property
    def is_loose(self) -> bool:
        """True if the event times hardly follow the model."""
        is_large = self.scatter > _LARGE_SCATTER or self.jitter > _LARGE_JITTER
        return is_large or self.odd > _MANY


def tested(
    shooting: Shooting, fit: StagedFit, noise: tuple[Vector, ...], scatter: float, jitter: float
) -> ResidualTests:
    """Return the tests of the residuals of a fit.

    Args:
        shooting: The trials.
        fit: The optimum.
        noise: Noise of the channels of each trial by their third differences, ``(n_s,)``.
        scatter: Scatter of the restitution by event times, or NaN.
        jitter: Jitter of event times relative to their longest interval, or NaN.
    """
    channels = _channels(shooting, fit)
    squares, count = 0.0, 0
    for (k, s), row in channels.items():
        ratio = shooting.trials[k].noise[s] / noise[k][s]
        squares += float(row @ row) * ratio**2
        count += len(row)
    lost = count / max(count - len(fit.z), 1)
    law, speed, part = _laws(shooting, fit)
    return ResidualTests(
        misfit=math.sqrt(squares / count * lost) if count else math.nan,
        alike=_alike(list(channels.values())),
        law=law,
        speed=speed,
        part=part,
        scatter=scatter,
        jitter=jitter,
        odd=_odd(shooting),
        inflation=_inflation(list(channels.values())),
    )


def _odd(shooting: Shooting) -> float:
    """Return the number of missed and false events relative to the recorded events."""
    series = [one for trial in shooting.trials for one in trial.series]
    false = sum(len(one.false) for one in series)
    recorded = sum(len(one.times) for one in series) + false
    return (sum(len(one.missed) for one in series) + false) / max(recorded, 1)


def _channels(shooting: Shooting, fit: StagedFit) -> dict[tuple[int, int], Vector]:
    """Return the residuals of every channel of every trial in order of time."""
    found: dict[tuple[int, int], Vector] = {}
    at = 0
    for k, trial in enumerate(shooting.trials):
        n = int(trial.seen.sum())
        rows: Vector = np.full((len(trial.time), trial.values.shape[1]), np.nan)
        rows[trial.seen] = fit.rest[at : at + n]
        at += n + trial.n_events
        for s in range(rows.shape[1]):
            channel = rows[:, s]
            found[k, s] = channel[np.isfinite(channel)]
    return found


def _alike(channels: list[Vector]) -> float:
    """Return the probability of the ratio of von Neumann, over all channels."""
    from scipy.stats import norm

    score, weight = 0.0, 0.0
    for row in channels:
        power = float(row @ row)
        if len(row) < 10 or power == 0.0:
            continue
        steps = np.diff(row)
        score += (1.0 - float(steps @ steps) / (2.0 * power)) * len(row)
        weight += len(row)
    return float(norm.sf(score / math.sqrt(weight))) if weight else 1.0


def _inflation(channels: list[Vector]) -> float:
    """Return the root of the ratio of all samples to the effective ones, by autocorrelation."""
    total, weight = 0.0, 0.0
    for row in channels:
        n, power = len(row), float(row @ row)
        if n < 10 or power == 0.0:
            continue
        ratio = 1.0
        for lag in range(1, n // 3):
            rho = float(row[lag:] @ row[:-lag]) / power
            if rho < 2.0 / math.sqrt(n):
                break
            ratio += 2.0 * rho
        total += min(ratio, n / 6.0) * n
        weight += n
    return math.sqrt(max(total / weight, 1.0)) if weight else 1.0


_ByStop = dict[str, float]


def _laws(shooting: Shooting, fit: StagedFit) -> tuple[_ByStop, _ByStop, _ByStop]:
    """Return the findings about the restitution by stop.

    Returns:
        The probability of the score of one restitution per impact, that of a deviation in
        proportion to the impact speed, and the part of the former score that the latter explains.
    """
    basis, _ = np.linalg.qr(_scaled(fit.jacobian))
    laws, speeds, parts = _ByStop(), _ByStop(), _ByStop()
    for stop in shooting.graph.stop_names:
        columns, approach = _deviation_rows(shooting, fit, stop)
        if columns.shape[1] < 2:
            continue
        along = (columns @ (approach / np.max(np.abs(approach))))[:, None]
        every, slope = _explained(columns, basis, fit), _explained(along, basis, fit)
        for own, score in ((laws, every), (speeds, slope)):
            if score.probability is not None:
                own[stop] = float(score.probability)
        parts[stop] = slope.power / max(every.power, slope.power, 1e-300)
    return laws, speeds, parts


def _scaled(rows: Vector) -> Vector:
    size = np.linalg.norm(rows, axis=0)
    return np.asarray(rows[:, size > 0.0] / size[size > 0.0], dtype=np.float64)


class _Score(NamedTuple):
    """The squared residuals that deviations explain, and their probability if they are chance."""

    power: float
    probability: float | None


def _explained(columns: Vector, basis: Vector, fit: StagedFit) -> _Score:
    from scipy.special import fdtrc

    columns = _scaled(columns)
    left = columns - basis @ (basis.T @ columns)
    rest = fit.rest - basis @ (basis.T @ fit.rest)
    parts = np.linalg.svd(left, full_matrices=False)
    vectors: Vector = np.asarray(parts[0], dtype=np.float64)
    rank = int(np.sum(parts[1] > 1e-6))
    freedom = len(rest) - basis.shape[1] - rank
    along = vectors[:, :rank].T @ rest
    power = float(along @ along)
    if rank == 0 or freedom < 3:
        return _Score(power, None)
    other = max(float(rest @ rest) - power, 1e-300)
    ratio = power / rank / (other / freedom)
    return _Score(power, cast("float", fdtrc(rank, freedom, ratio)))


def _deviation_rows(shooting: Shooting, fit: StagedFit, stop: str) -> tuple[Vector, Vector]:
    """Return the derivatives of the residuals with respect to single restitutions of a stop.

    Returns:
        The derivatives, ``(n_r, n)``, and the impact speeds, ``(n,)``.
    """
    blocks = [
        deviation_rows_of_trial(shooting, fit.z, k, stop, most=_MOST)
        for k in range(len(shooting.trials))
    ]
    found = np.zeros((sum(len(rows) for rows, _ in blocks), sum(len(v) for _, v in blocks)))
    row = column = 0
    for rows, own in blocks:
        found[row : row + len(rows), column : column + len(own)] = rows
        row += len(rows)
        column += len(own)
    return found, np.concatenate([own for _, own in blocks])


def deviation_rows_of_trial(
    shooting: Shooting, z: Vector, k: int, stop: str, *, most: int | None
) -> tuple[Vector, Vector]:
    """Return the derivatives of the residuals of a trial with respect to single restitutions.

    Args:
        shooting: The trials.
        z: Unknowns.
        k: Index of the trial.
        stop: Name of the stop.
        most: Largest number of impacts.

    Returns:
        The derivatives, ``(n_r, n)``, and the impact speeds, ``(n,)``.
    """
    trial = shooting.trials[k]
    own = shooting.predicted(k, z, math.inf)
    n_rows = int(trial.seen.sum()) + trial.n_events
    if own is None:
        return np.zeros((n_rows, 0)), np.zeros(0)
    impacts = _resolved(shooting, k, own.motion.execution.impacts, stop, own.offset)[:most]
    columns, speeds = list[Vector](), list[float]()
    n_x, p = len(shooting.graph.state_names), shooting.parameters(z)
    instruments = instruments_of(shooting.unknowns.readings, trial.measured.names)
    values = shooting.values(z)
    times = trial.time / own.stretch - own.offset
    slopes = (
        trial.measured.derivatives(own.motion.at(times).states, p)[:, :, :n_x]
        if len(times)
        else None
    )
    for impact in impacts:
        try:
            parts = list[Vector]()
            if slopes is not None:
                states = own.motion.after_deviation(impact, times)
                rows = np.einsum("nsx,nx->ns", slopes, states) * instruments.gain(values)
                parts.append((rows / trial.noise)[trial.seen])
            if trial.n_events:
                late = [
                    _late(own.motion.events_after_deviation(impact, one.kind, one.stop), found)
                    for one in trial.series
                    for found in [matched(one, own.motion.events(one.kind, one.stop))]
                ]
                parts.append(shooting.whitening[k] @ own.event_slopes @ np.concatenate(late))
        except SimulationError:
            # The last impacts before a Zeno point have no derivative of their own.
            continue
        columns.append(np.concatenate(parts))
        speeds.append(abs(impact.approach_rate))
    rows = np.stack(columns, axis=1) if columns else np.zeros((n_rows, 0))
    return rows, np.array(speeds)


def _late(rows: Vector, found: list[int | None]) -> Vector:
    return np.array([0.0 if k is None else float(rows[k]) for k in found])


def _resolved(
    shooting: Shooting, k: int, impacts: tuple[Impact, ...], stop: str, offset: float
) -> list[Impact]:
    """Return the impacts at a stop whose next flight is resolved by the samples or the events."""
    trial = shooting.trials[k]
    own = [one for one in impacts if one.stop == stop]
    last = trial.end - offset
    if len(trial.time) > 1:
        least = _RESOLVED * float(np.median(np.diff(trial.time)))
    else:
        least = 0.0
        last = float(np.max(event_times(trial))) - offset
    found: list[Impact] = []
    for one, then in zip(own, [*own[1:], None], strict=False):
        flight = (last if then is None else min(then.time, last)) - one.time
        if one.time < last and flight > least:
            found.append(one)
    return found
