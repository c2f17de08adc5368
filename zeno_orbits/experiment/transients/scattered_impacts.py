r"""A mixed model of transients whose restitution scatters from impact to impact.

With a deviation :math:`u_k` of the restitution at every impact, samples after the first impact
follow the motion of the mean restitution only roughly: least squares of the samples takes the
deviations of the few impacts of a drop for knowledge, and its intervals are far too short. So the
samples count up to the first impact, and the times of the seen impacts after it. Their covariance
has the scatter as a component of variance, by restricted likelihood (`event_noise`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.transients.event_noise import (
    EventNoise,
    event_noise,
    scatter_freedom,
)
from zeno_orbits.experiment.transients.event_record import labelled_series
from zeno_orbits.experiment.transients.shooting import Shooting, independent_whitening
from zeno_orbits.experiment.transients.staged_fit import LostStartError, StagedFit, fitted
from zeno_orbits.experiment.transients.trial import TrialData
from zeno_orbits.simulation import EventKind

_FEWEST_SAMPLES, _FEWEST_IMPACTS = 6, 2
"""Samples before the first impact, and impacts of a trial, at least."""
_BESIDE = 1.5
"""Sampling times before the first impact from which samples do not count."""
_ERROR = 0.3
"""First guess of the error of a seen impact, in sampling times."""
_SCATTER = 0.15
"""Scatter of the ratio of two flights that does not show a missed impact: a gap shows most."""
_LARGEST = 0.25
"""Scatter of no ball: the impacts were mistaken for others."""
_ROUNDS = 4
_SAME = 1e-3
"""Relative change of the noise at the end of the rounds."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MixedFit:
    """The fit of a mixed model.

    Attributes:
        shooting: The trials: samples up to the first impact, and times of the impacts.
        found: The optimum.
        noise: Jitter of the seen times, and scatter of the restitution.
        freedom: Degrees of freedom of the errors of the unknowns, ``(n_z,)``.
    """

    shooting: Shooting
    found: StagedFit
    noise: EventNoise
    freedom: Vector


def mixed_fit(shooting: Shooting, found: StagedFit, noise: Sequence[Vector]) -> MixedFit | None:
    """Return the fit of a mixed model, or ``None`` if the trials show too few impacts for it.

    Args:
        shooting: The trials, with samples.
        found: Their optimum by least squares.
        noise: Noise of the channels of each trial by themselves, ``(n_s,)``.
    """
    trials = [_by_impacts(one) for one in shooting.trials]
    known = [one for one in trials if one is not None]
    if len(known) < len(trials):
        return None
    whitening = tuple(independent_whitening(one) for one in known)
    # The weights of the least squares contain the deviations of the impacts.
    mixed = replace(shooting, trials=tuple(known)).reweighted(noise, whitening)
    try:
        return _converged(mixed, fitted(mixed, found.z))
    except LostStartError:
        return None


def _converged(mixed: Shooting, found: StagedFit) -> MixedFit | None:
    """Return the fit with weights by its own noise, ``None`` if both variances are not known."""
    noise: EventNoise | None = None
    noises = [one.noise for one in mixed.trials]
    for _ in range(_ROUNDS):
        told = event_noise(mixed, found.z, min(min(one.event_errors) for one in mixed.trials))
        if told is None or not told[0].estimated or told[0].scatter > _LARGEST:
            return None
        former, (noise, whitening) = noise, told
        # The first flight may deviate from the model by more than the noise.
        pairs = zip(noises, mixed.channel_noise(found.z), strict=True)
        mixed = mixed.reweighted([np.maximum(a, b) for a, b in pairs], whitening)
        found = fitted(mixed, found.z)
        if former is not None and abs(noise.scatter / former.scatter - 1.0) < _SAME:
            break
    if noise is None:
        return None
    freedom = scatter_freedom(mixed, found, noise)
    return MixedFit(shooting=mixed, found=found, noise=noise, freedom=freedom)


def _by_impacts(trial: TrialData) -> TrialData | None:
    """Return a trial with its samples up to the first impact, and the times of its impacts."""
    series = [
        labelled_series(EventKind.IMPACT, stop, np.sort(times), _SCATTER)
        for stop, times in trial.every_impact.items()
        if len(times)
    ]
    if trial.n_events or sum(len(one.times) for one in series) < _FEWEST_IMPACTS:
        return None
    step = float(np.median(np.diff(trial.time)))
    first = min(float(one.times[0]) for one in series)
    n = int(np.searchsorted(trial.time, first - _BESIDE * step))
    if trial.seen[:n].any(axis=1).sum() < _FEWEST_SAMPLES:
        return None
    return replace(
        trial,
        time=trial.time[:n],
        values=trial.values[:n],
        seen=trial.seen[:n],
        series=tuple(series),
        event_errors=(_ERROR * step,) * len(series),
    )
