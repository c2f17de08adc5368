r"""Jitter of event times and scatter of the restitution, by restricted likelihood.

The deviation of the event times from a motion has the covariance

.. math:: V = \sigma_t^2\,1 + \sigma_e^2\,D D^\mathsf{T}

with the jitter :math:`\sigma_t` [s] and the relative scatter :math:`\sigma_e` of the restitution
from impact to impact. `D` is the exact derivative of the times with respect to the logarithm of the
restitution at single impacts. Scatter at one impact moves all later ones, so errors of the times
are far from independent. The restricted likelihood accounts for the fitted unknowns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.experiment.transients.motion import TransientMotion
from zeno_orbits.experiment.transients.shooting import Shooting, matched
from zeno_orbits.experiment.transients.staged_fit import StagedFit
from zeno_orbits.simulation import Impact

_LEAST, _LEAST_KNOWN = 4, 1
"""Events more than unknowns from which both variances are estimated, or the scatter alone."""
_USUAL, _SPREAD = math.log(0.05), 1.5
"""Logarithm of the scatter of real impacts, 1 to 10 %, and its spread."""
_BELOW, _ABOVE, _HELD = 10.0, 3.0, 1.001
"""Factors below and above a known jitter within which it is estimated, or around it, held. Impacts
in a gap are seen to a twentieth of a sampling time, or to a whole one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EventNoise:
    """Noise of event times.

    Attributes:
        jitter: Standard deviation of the recorded times [s].
        scatter: Standard deviation of the restitution per impact, relative to its value.
        estimated: Whether the events are enough to estimate both.
        longest: Longest interval between two events [s].
    """

    jitter: float
    scatter: float
    estimated: bool
    longest: float


def event_noise(
    shooting: Shooting, z: Vector, expected: float | None = None
) -> tuple[EventNoise, tuple[Vector, ...]] | None:
    """Return the noise of event times and the matrices that whiten them for each trial.

    Args:
        shooting: The trials.
        z: Unknowns at an optimum.
        expected: Size of the jitter if it is known roughly and other tests show that impacts
            differ [s]. The scatter alone is estimated from few events.

    Returns:
        The noise, or ``None`` if a trial cannot be simulated.
    """
    parts = [_linear(shooting, z, k) for k in range(len(shooting.trials))]
    if any(one is None for one in parts):
        return None
    known = [one for one in parts if one is not None]
    rest = np.concatenate([one[0] for one in known])
    rows = np.concatenate([one[1] for one in known])
    blocks = [one[2] for one in known]
    beside = _samples(shooting, z)
    if beside is None:
        return None
    floor = min((max(one.error, 0.0) for t in shooting.trials for one in t.series), default=0.0)
    every = np.concatenate([rows, beside[1]])
    moved = np.any(rows != 0.0, axis=0)
    free = _rank(every[:, moved]) - _rank(beside[1][:, moved])
    known = expected is not None and len(rest) - free >= _LEAST_KNOWN
    if len(rest) - free < _LEAST and not known:
        jitter = max(floor, 2e-3 * _longest(shooting))
        noise = EventNoise(jitter=jitter, scatter=0.0, estimated=False, longest=_longest(shooting))
    else:
        bounds = None
        if expected is not None:
            few = len(rest) - free < _LEAST
            bounds = expected / (_HELD if few else _BELOW), expected * (_HELD if few else _ABOVE)
        likely = _likely((rest, beside[0]), every[:, moved], blocks, floor, bounds)
        noise = replace(likely, longest=_longest(shooting))
    return noise, tuple(_whitening(noise, block) for block in blocks)


def _rank(rows: Vector) -> int:
    size = np.linalg.norm(rows, axis=0)
    used = rows[:, size > 0.0] / size[size > 0.0]
    return int(np.linalg.matrix_rank(used)) if used.size else 0


def _samples(shooting: Shooting, z: Vector) -> tuple[Vector, Vector] | None:
    """Return what the samples say of the unknowns: few rows with the same normal equations.

    They are in units of the noise: residuals, ``(n,)``, and derivatives, ``(n, n_z)``.
    """
    rests, rows = [np.zeros(0)], [np.zeros((0, len(z)))]
    for k, trial in enumerate(shooting.trials):
        found = shooting.predicted(k, z, math.inf)
        if found is None:
            return None
        rests.append(((trial.values - found.signals) / trial.noise)[trial.seen])
        rows.append((found.by_signals / trial.noise[:, None])[trial.seen])
    basis, few = np.linalg.qr(np.concatenate(rows))
    return basis.T @ np.concatenate(rests), few


def _longest(shooting: Shooting) -> float:
    steps = [
        float(np.max(np.diff(one.times)))
        for trial in shooting.trials
        for one in trial.series
        if len(one.times) > 1
    ]
    return max(steps, default=1.0)


def scatter_freedom(shooting: Shooting, fit: StagedFit, noise: EventNoise) -> Vector:
    r"""Return the degrees of freedom of the errors of the unknowns, ``(n_z,)``.

    The scatter is estimated from few impacts, and the noise of samples from many. With the part `a`
    of a variance that the scatter makes, and :math:`m = \sum q / (1 + q)` impacts whose deviations
    are seen above the jitter, Satterthwaite's approximation is
    :math:`1 / f = a^2 / (m - 1) + (1 - a)^2 / f_0`.

    Args:
        shooting: The trials with event times.
        fit: The optimum.
        noise: The noise of the event times.
    """
    size = np.maximum(np.linalg.norm(fit.jacobian, axis=0), 1e-150)
    scaled = fit.jacobian / size
    covariance: Vector = np.asarray(
        np.linalg.pinv(scaled.T @ scaled, rcond=1e-13, hermitian=True), dtype=np.float64
    )
    estimator: Vector = covariance @ scaled.T
    part, seen, at = np.zeros(len(fit.z)), 0.0, 0
    for k, trial in enumerate(shooting.trials):
        linear = _linear(shooting, fit.z, k)
        at += int(trial.seen.sum())
        if linear is None or not trial.n_events:
            continue
        own = slice(at, at + trial.n_events)
        at = own.stop
        moved = noise.scatter * shooting.whitening[k] @ linear[2]
        part += np.sum((estimator[:, own] @ moved) ** 2, axis=1)
        sizes = np.asarray(np.linalg.svd(linear[2], compute_uv=False), dtype=np.float64)
        strength: Vector = (noise.scatter / noise.jitter * sizes) ** 2
        seen += float(np.sum(strength / (1.0 + strength)))
    share = np.clip(part / np.maximum(np.diag(covariance), 1e-300), 0.0, 1.0)
    rest = max(len(fit.rest) - len(fit.z), 1)
    return 1.0 / (share**2 / max(seen - 1.0, 1.0) + (1.0 - share) ** 2 / rest)


def _linear(shooting: Shooting, z: Vector, k: int) -> tuple[Vector, Vector, Vector] | None:
    """Return the event residuals [s], their derivatives, and those by single restitutions."""
    trial = shooting.trials[k]
    if not trial.n_events:
        return np.zeros(0), np.zeros((0, len(z))), np.zeros((0, 0))
    found = shooting.predicted(k, z, math.inf)
    if found is None:
        return None
    models = [found.motion.events(one.kind, one.stop) for one in trial.series]
    places = [matched(one, model) for one, model in zip(trial.series, models, strict=True)]
    # Scatter may shift the fitted events far from the recorded ones.
    last = max(
        (
            float(model.times[j])
            for own, model in zip(places, models, strict=True)
            for j in own
            if j is not None
        ),
        default=0.0,
    )
    columns: list[Vector] = []
    for impact in found.motion.execution.impacts:
        if impact.time >= last:
            break
        column = _column(shooting, k, found.motion, impact, places)
        if column is not None:
            columns.append(column)
    deviations = np.stack(columns, axis=1) if columns else np.zeros((trial.n_events, 0))
    slopes = found.event_slopes
    return -found.event_rests, slopes @ found.by_events, slopes @ deviations


def _column(
    shooting: Shooting,
    k: int,
    motion: TransientMotion,
    impact: Impact,
    places: list[list[int | None]],
) -> Vector | None:
    """Return the derivatives of the events with respect to the logarithm of one restitution."""
    view = shooting.graph.open_views[shooting.graph.stop_names.index(impact.stop)]
    ratio = float(view.speed_after(impact.approach_rate)) / abs(impact.approach_rate)
    parts: list[Vector] = []
    try:
        for one, found in zip(shooting.trials[k].series, places, strict=True):
            late = motion.events_after_deviation(impact, one.kind, one.stop)
            parts.append(np.array([0.0 if j is None else float(late[j]) for j in found]))
    except SimulationError:
        # The last impacts before a Zeno point have no derivative of their own.
        return None
    return ratio * np.concatenate(parts)


def _likely(
    rests: tuple[Vector, Vector],
    rows: Vector,
    blocks: list[Vector],
    floor: float,
    range_of_jitter: tuple[float, float] | None,
) -> EventNoise:
    """Return the noise of the greatest restricted likelihood.

    Args:
        rests: Residuals of the event times [s], and of the samples in units of their noise.
        rows: Derivatives of both.
        blocks: Derivatives of the event times of each trial by single restitutions.
        floor: Least jitter [s].
        range_of_jitter: Range of the jitter [s], if it is known roughly and impacts differ.
    """
    from scipy.optimize import minimize

    rest, n = np.concatenate(rests), len(rests[0])
    size = max(math.sqrt(float(rests[0] @ rests[0]) / n), floor, 1e-9)
    scaled = rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    basis, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    basis = basis[:, sizes > 1e-9 * sizes[0]] if len(sizes) else basis
    low = math.log(max(floor, 1e-3 * size))

    def negative(x: Vector) -> float:
        jitter, scatter = math.exp(x[0]), math.exp(x[1])
        # Few impacts may agree by chance, though others differ.
        total = ((x[1] - _USUAL) / _SPREAD) ** 2 if range_of_jitter else 0.0
        white_rest, white_rows = rest.copy(), basis.copy()
        at = 0
        for block in blocks:
            own = slice(at, at + len(block))
            if not len(block):
                continue
            root = _root(jitter, scatter, block)
            total += 2.0 * float(np.sum(np.log(np.diag(root))))
            white_rest[own] = np.linalg.solve(root, rest[own])
            white_rows[own] = np.linalg.solve(root, basis[own])
            at = own.stop
        information = white_rows.T @ white_rows
        by = white_rows.T @ white_rest
        total += float(np.linalg.slogdet(information)[1])
        return total + float(white_rest @ white_rest - by @ np.linalg.solve(information, by))

    bounds = ((low, math.log(10.0 * size)), (-11.5, 0.0))
    if range_of_jitter is not None:
        least, most = range_of_jitter
        bounds = ((math.log(least), math.log(most)), bounds[1])
    best = min(
        (
            minimize(
                negative,
                np.clip(x, [one[0] for one in bounds], [one[1] for one in bounds]),
                method="Nelder-Mead",
                bounds=bounds,
                options={"xatol": 1e-3, "fatol": 1e-4, "maxiter": 200},
            )
            for x in ([math.log(size), -6.0], [math.log(size) - 3.0, -4.0], [math.log(size), -9.0])
        ),
        key=lambda one: one.fun,
    )
    return EventNoise(
        jitter=math.exp(best.x[0]), scatter=math.exp(best.x[1]), estimated=True, longest=1.0
    )


def _root(jitter: float, scatter: float, block: Vector) -> Vector:
    """Return the lower root of the covariance of the events of a trial, ``(n_e, n_e)``."""
    n = len(block)
    covariance = jitter**2 * np.eye(n) + scatter**2 * block @ block.T
    covariance += 1e-14 * np.trace(covariance) / n * np.eye(n)
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _whitening(noise: EventNoise, block: Vector) -> Vector:
    """Return the inverse root of the covariance of the events of a trial."""
    if not len(block):
        return np.zeros((0, 0))
    root = _root(noise.jitter, noise.scatter, block)
    return np.asarray(np.linalg.inv(root), dtype=np.float64)
