r"""Optima of a fit over the stated ranges, and intervals from the profile of the likelihood.

Fits begin at several starts, and each chooses its samples at its own orbits. Optima are compared
by one measure over all samples, :math:`\sum_i \min(r_i^2, c^2)` in units of one noise, because
sums over different samples cannot be compared (theory (6.12)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.experiment.comparison.folding import Folded
from zeno_orbits.experiment.identification.contact_rows import NO_CONTACTS, ContactRows
from zeno_orbits.experiment.identification.least_squares import (
    Fit,
    Weighed,
    deviation,
    fit,
    rough_fit,
)
from zeno_orbits.experiment.identification.predictions import Predictions
from zeno_orbits.experiment.identification.unknowns import Unknowns
from zeno_orbits.experiment.recordings.periodicity import Periodicity
from zeno_orbits.work import Progress

_STARTS = 4
"""Number of starts in the ranges, in addition to the known starts."""
_WIDE = 2.0
"""Factor around a start that is searched in a range that spans more than a decade."""
_DECADE = 10.0
_NEAR = 1.3
"""The same around a value that the recording shows."""
_CLIP = 4.0
"""Residual, in units of the noise, above which the size of a sample's misfit does not matter."""
_SAME = 5.0
"""Optima that differ by fewer standard errors are one."""
_RIVAL = 0.1
"""Relative excess of the measure up to which another optimum is reported."""
_ROUNDS = 3
"""Rounds of starts around the best optimum at most."""
_ASIDE = 0.1
"""Relative distance of these starts."""
_BETTER = 1e-3
"""Relative decrease of the measure that makes an optimum a better one."""
_FEWEST = 1e-7
"""Noise at least, in parts of a signal's range."""
_PROFILE = 6
"""Steps to an end of an interval at most."""
_CLOSE = 0.02


def starts_of(
    unknowns: Unknowns, known: Sequence[Vector], seen: Mapping[int, float]
) -> list[Vector]:
    """Return initial unknowns: the known unknowns, then points spread over the ranges.

    Args:
        unknowns: The unknowns and their ranges.
        known: Probable unknowns, ``(k + 1,)`` each.
        seen: Values from the recorded contacts, by the index of the unknown.
    """
    from scipy.stats import qmc

    low, high = (bound[:-1].copy() for bound in unknowns.bounds)
    first = unknowns.first[:-1]
    for k, value in enumerate(first):
        wide = high[k] > _DECADE * max(low[k], 0.0) and value > 0.0
        if wide:
            low[k], high[k] = max(low[k], value / _WIDE), min(high[k], value * _WIDE)
    for k, value in seen.items():
        low[k], high[k] = max(low[k], value / _NEAR), min(high[k], value * _NEAR)
    for k, readings in enumerate(unknowns.readings):
        if readings:
            # The prediction is linear in errors of instruments, so one start serves.
            low[k] = high[k] = first[k]
    points = qmc.Sobol(d=len(first), seed=0).random(_STARTS)
    spread = [np.append(low + point * (high - low), 0.0) for point in points]
    return [*known, *spread]


Orbits = TypeVar("Orbits", bound=Predictions)


def global_fit(
    orbits: Orbits,
    samples: Folded,
    found: Periodicity,
    starts: Sequence[Vector],
    on_progress: Progress,
    contacts: ContactRows = NO_CONTACTS,
) -> tuple[Fit, Orbits, tuple[Vector, ...]]:
    """Return the best fit, its orbits, and the unknowns of other optima that fit nearly as well.

    Args:
        orbits: Predictions of orbits at unknowns.
        samples: The recording, folded.
        found: Period of the recording.
        starts: Initial unknowns, the user's first.
        on_progress: Called with each stage and the part that is done.
        contacts: The edges of the contact channels.

    Raises:
        SimulationError: If no start leads to an orbit.
    """

    def rough(start: Vector) -> list[tuple[Vector, Orbits]]:
        try:
            own = orbits.starting_at(start)
            x, _ = rough_fit(own, samples, found, start, contacts)
            own.table(x)
        except SimulationError:
            return []
        return [(x, own)]

    tried: list[tuple[Vector, Orbits]] = []
    for number, start in enumerate(starts):
        on_progress("looking for optima", number / len(starts))
        tried += rough(start)
    if not tried:
        raise SimulationError("No start leads to an orbit", time=0.0, state=())
    noise = np.min([_noise(own, samples, x) for x, own in tried], axis=0)
    measures = [_measure(own, samples, found, x, noise, contacts) for x, own in tried]
    for number in range(_ROUNDS):
        on_progress("looking for optima near the best", number / _ROUNDS)
        best, least = tried[int(np.argmin(measures))][0], min(measures)
        near = [one for start in _beside(best, orbits.unknowns) for one in rough(start)]
        tried += near
        measures += [_measure(own, samples, found, x, noise, contacts) for x, own in near]
        if min(measures) > (1.0 - _BETTER) * least:
            break
    order: list[int] = [int(k) for k in np.argsort(measures)]
    best_x, best_orbits = tried[order[0]]
    answer = fit(best_orbits, samples, found, best_x, on_progress, contacts)
    least = _measure(best_orbits, samples, found, answer.x, noise, contacts)
    rivals: list[tuple[Vector, float]] = []
    for k in order[1:]:
        x, own = tried[k]
        others = [answer.x, *(one for one, _ in rivals)]
        if measures[k] < (1.0 + _RIVAL) * least and _is_new(x, others, answer):
            final = fit(own, samples, found, x, on_progress, contacts)
            measure = _measure(own, samples, found, final.x, noise, contacts)
            rival = final.x
            if measure < least:
                rival, answer, best_orbits = answer.x, final, own
                measure, least = least, measure
            if _is_new(rival, [answer.x, *(one for one, _ in rivals)], answer):
                rivals.append((rival, measure))
    answer = _with_deviation_before(answer, orbits, samples, starts[0])
    near = [x for x, measure in rivals if measure < (1.0 + _RIVAL) * least]
    return answer, best_orbits, tuple(x for x in near if _is_new(x, [answer.x], answer))


def _with_deviation_before(answer: Fit, orbits: Predictions, samples: Folded, start: Vector) -> Fit:
    """Return a fit with the deviation at the user's start, if an orbit is there.

    Otherwise the deviation at the start of the fit stands for it.
    """
    try:
        own = orbits.starting_at(start)
        before = deviation(own, samples.without_jumps(own.table(start)), start)
    except SimulationError:
        return answer
    return replace(answer, before=before)


def _beside(x: Vector, unknowns: Unknowns) -> list[Vector]:
    """Return unknowns on both sides of a point along each unknown, at its phase.

    An orbit whose jumps are one bounce off has a local optimum of its own.
    """
    low, high = unknowns.bounds
    found: list[Vector] = []
    for k, readings in enumerate(unknowns.readings):
        for factor in () if readings else (1.0 - _ASIDE, 1.0 + _ASIDE):
            other = x.copy()
            other[k] = np.clip(factor * x[k], low[k], high[k])
            found.append(other)
    return found


def _is_new(x: Vector, known: Sequence[Vector], answer: Fit) -> bool:
    """Return True if an optimum differs from all others by more than the errors of the best."""
    return all(answer.spread.apart(x - one, _SAME) for one in known)


def _noise(orbits: Predictions, samples: Folded, x: Vector) -> Vector:
    """Return the noise of each signal from the median of its residuals, ``(n_s,)``."""
    values = orbits.fold(x, samples).values
    rest = np.abs(samples.values - values) * np.sqrt(samples.counts)
    found = [np.median(row[seen]) for row, seen in zip(rest.T, samples.seen.T, strict=True)]
    return np.maximum(1.4826 * np.array(found), _FEWEST * np.ptp(values, axis=0))


def _measure(
    orbits: Predictions,
    samples: Folded,
    found: Periodicity,
    x: Vector,
    noise: Vector,
    contacts: ContactRows,
) -> float:
    """Return the sum of the clipped squares over all samples, and of the edges' and the period's.

    One edge of a contact channel tells as much as many samples, so its square is limited only
    where edges lack a counterpart.
    """
    fold = orbits.fold(x, samples)
    square = samples.counts * ((samples.values - fold.values) / noise) ** 2
    clipped = np.minimum(square, _CLIP**2)
    events = orbits.events(x)
    period = (found.period - events.period) / found.error
    edges = contacts.residuals(events, float(x[-1]))
    sample_sum = float(np.sum(np.where(samples.seen, clipped, 0.0)))
    return sample_sum + float(edges @ edges) + min(period**2, 1e4)


def profile_interval(answer: Fit, number: int) -> tuple[float, float]:
    """Return the interval of an unknown from the profile of the likelihood, relative to its size.

    Its ends are where the least squares over all other unknowns have risen by as much as at the
    ends of an interval of a linear model with correlated noise.

    Args:
        answer: The fit.
        number: Index of the unknown.
    """
    stage, x, spread = answer.stage, answer.x, answer.spread
    if stage is None:
        raise ValueError("Argument `answer` must have the residuals as functions, as `fit` gives.")
    information = answer.jacobian.T @ answer.jacobian
    inverse: Vector = np.asarray(
        np.linalg.pinv(information, rcond=1e-14, hermitian=True), dtype=np.float64
    )
    plain = math.sqrt(max(float(inverse[number, number]), np.finfo(float).tiny))
    half = float(spread.half[number])
    least = float(answer.residuals @ answer.residuals)
    low, high = (bound[number] for bound in stage.orbits.unknowns.bounds)
    ends: list[float] = []
    for sign in (-1.0, 1.0):

        def rise(at: float) -> float:
            try:
                found = _least_at(stage, x, number, at, inverse)
            except SimulationError:
                # An end without an orbit is too far.
                return math.inf
            return math.sqrt(max(found - least, 0.0))

        end = _end_of(rise, float(x[number]), sign * half, half / plain)
        ends.append(float(np.clip(end, low, high)))
    return ends[0], ends[1]


def _end_of(rise: Callable[[float], float], at: float, step: float, wanted: float) -> float:
    """Return the point where the root of the rise has a given value, by the secant method."""
    size = 1.0
    for _ in range(_PROFILE):
        found = rise(at + size * step)
        if abs(found - wanted) < _CLOSE * wanted:
            break
        size *= float(np.clip(wanted / max(found, 1e-3 * wanted), 0.4, 2.5))
    return at + size * step


def _least_at(stage: Weighed, x: Vector, number: int, value: float, inverse: Vector) -> float:
    """Return the least squares over all unknowns but one."""
    from scipy.optimize import least_squares

    free = [k for k in range(len(x)) if k != number]
    # The others follow the correlation first.
    moved = x + inverse[:, number] / inverse[number, number] * (value - x[number])
    low, high = stage.orbits.unknowns.bounds
    margin = 1e-9 * (high - low)
    moved = np.clip(moved, low + margin, high - margin)

    def whole(y: Vector) -> Vector:
        z = moved.copy()
        z[number], z[free] = value, y
        return z

    answer = least_squares(
        lambda y: stage.residuals(whole(y)),
        moved[free],
        jac=lambda y: stage.jacobian(whole(y))[:, free],
        bounds=(low[free], high[free]),
        x_scale="jac",
        xtol=1e-5,
        ftol=1e-5,
        max_nfev=8,
    )
    return 2.0 * float(answer.cost)
