r"""Bounded least squares over a horizon that grows from impact to impact, from several starts.

A whole trial has many local optima, since a phase error grows from impact to impact. A fit up to
the first impact has one, and each longer horizon starts near its optimum. A weak prior of a factor
2 holds unknowns that the short horizons do not determine, and is dropped at the end.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.transients.shooting import Prediction, Shooting
from zeno_orbits.work import Progress

_PRIOR = 0.7
"""Standard deviation of the logarithm of a parameter on short horizons, a factor of 2."""
_STEPS, _LAST_STEPS = 10, 40
_STARTS = 6
_AROUND = 0.6
"""Largest change of the logarithm of a parameter at a further start, a factor of 1.8."""
_QUIET = 1.3
"""Mean square of residuals in units of the noise that no wrong optimum has."""
_SAME = 1e-3
"""Relative difference of sums of squares of starts that agree, next to 3.84 noise units."""
_DIFFERENCE = 3.84
_SAME_PLACE = 1.0
"""Squared standard errors between two ends of one optimum."""
_FAILED = 1e4
"""Residual of a trial that cannot be simulated."""
_CLOSE, _ROUGH = 1e-9, 1e-4
"""Relative change of the unknowns or the sum of squares at the end of a fit, and on the way."""
_INSIDE, _EDGE = 1e-9, 1e-6
_NOTHING = 1e-2
"""Squared standard errors of a step that is negligible."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StagedFit:
    """A local optimum.

    Attributes:
        z: Unknowns, ``(n_z,)``.
        rest: Residuals, ``(n_r,)``.
        jacobian: Their derivatives, ``(n_r, n_z)``.
        converged: Whether the iteration converged.
        agreed: Number of starts that led to this optimum.
        starts: Number of starts.
        others: Unknowns of other optima that fit as well.
        found: Unknowns of the different optima that the starts led to, the best first.
        shares: Number of starts that led to each of them.
    """

    z: Vector
    rest: Vector
    jacobian: Vector
    converged: bool
    agreed: int = 1
    starts: int = 1
    others: tuple[Vector, ...] = ()
    found: tuple[Vector, ...] = ()
    shares: tuple[int, ...] = ()

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.rest @ self.rest)


class _Evaluated:
    """Residuals of one simulation and their derivatives, kept until the unknowns change."""

    def __init__(self, shooting: Shooting, stage: int | None, prior: Vector | None) -> None:
        self._shooting, self._stage, self._prior = shooting, stage, prior
        self._at: Vector | None = None
        self._found: list[Prediction] | None = None
        self._rest: Vector = np.zeros(0)

    def _move(self, z: Vector) -> None:
        if self._at is not None and np.array_equal(self._at, z):
            return
        self._at, self._found = z.copy(), self._shooting.predictions(z, self._stage)
        if self._found is None:
            if not len(self._rest):
                raise LostStartError
            self._rest = np.full(len(self._rest), _FAILED)
            return
        self._rest = self._shooting.rests(self._found)
        if self._prior is not None:
            own = (z[: self._shooting.n_shared] - self._prior) / _PRIOR
            self._rest = np.concatenate([self._rest, own])

    def rest(self, z: Vector) -> Vector:
        self._move(z)
        return self._rest

    def rows(self, z: Vector) -> Vector:
        self._move(z)
        if self._found is None:
            return np.zeros((len(self._rest), len(z)))
        rows = self._shooting.rows(self._found)
        if not np.isfinite(rows).all():
            raise LostStartError
        if self._prior is None:
            return rows
        return np.concatenate([rows, np.eye(self._shooting.n_shared, len(z)) / _PRIOR])


class LostStartError(Exception):
    """The motion at the start of a fit cannot be simulated."""


def fitted(
    shooting: Shooting,
    z: Vector,
    *,
    stage: int | None = None,
    prior: Vector | None = None,
    fixed: int | None = None,
    steps: int = _LAST_STEPS,
) -> StagedFit:
    """Return the optimum near a start.

    Args:
        shooting: The trials.
        z: Start, ``(n_z,)``.
        stage: Index of the horizon, the whole trials by default.
        prior: Shared unknowns of a weak prior, none by default.
        fixed: Index of an unknown that keeps its value.
        steps: Largest number of steps.

    Raises:
        LostStartError: If the motion at the start cannot be simulated.
    """
    from scipy.optimize import least_squares

    low, high = shooting.bounds
    z = np.clip(z, low + _INSIDE, high - _INSIDE)
    free = np.array([k for k in range(len(z)) if k != fixed])
    at = _Evaluated(shooting, stage, prior)

    def whole(part: Vector) -> Vector:
        full = z.copy()
        full[free] = part
        return full

    found = least_squares(
        lambda part: at.rest(whole(part)),
        z[free],
        jac=lambda part: at.rows(whole(part))[:, free],
        bounds=(low[free], high[free]),
        x_scale="jac",
        max_nfev=steps,
        xtol=_CLOSE if prior is None else _ROUGH,
        ftol=_CLOSE if prior is None else _ROUGH,
        gtol=1e-12,
    )
    z = whole(np.asarray(found.x, dtype=np.float64))
    rest, rows = at.rest(z), at.rows(z)
    # A further step along the interior that gains nothing also ends the iteration.
    inner = free[(z[free] > low[free] + _EDGE) & (z[free] < high[free] - _EDGE)]
    converged = found.status > 0 or _gain(rest, rows[:, inner]) < _NOTHING
    return StagedFit(z=z, rest=rest, jacobian=rows, converged=converged)


def _gain(rest: Vector, rows: Vector) -> float:
    """Return the part of a standard error, squared, that a Gauss-Newton step would move."""
    size = np.linalg.norm(rows, axis=0)
    basis, _ = np.linalg.qr(rows[:, size > 0.0] / size[size > 0.0])
    along = basis.T @ rest
    scale = float(rest @ rest) / max(len(rest) - basis.shape[1], 1)
    return float(along @ along) / max(scale, 1e-300)


def staged(shooting: Shooting, z: Vector, on_progress: Progress) -> StagedFit:
    """Return the optimum that a growing horizon leads to from a start.

    Args:
        shooting: The trials.
        z: Start, ``(n_z,)``.
        on_progress: Called with each stage.

    Raises:
        LostStartError: If the motion at the start cannot be simulated.
    """
    prior = z[: shooting.n_shared].copy()
    n = max(len(one.horizons) for one in shooting.trials)
    for stage in range(n - 1):
        on_progress("fitting a growing part of the motion", stage / n)
        found = fitted(shooting, z, stage=stage, prior=prior, steps=_STEPS)
        z = found.z
    return fitted(shooting, z)


def _starts(shooting: Shooting, z: Vector) -> Iterator[Vector]:
    """Yield the starts of a fit: the given one, then changes of the shared unknowns."""
    yield z
    random = np.random.default_rng(len(z))
    for _ in range(_STARTS - 1):
        other = z.copy()
        k = shooting.n_shared
        other[:k] += random.uniform(-_AROUND, _AROUND, k)
        yield other


def best_fit(shooting: Shooting, z: Vector, on_progress: Progress) -> StagedFit | None:
    """Return the best optimum of up to six starts, ``None`` if none can be simulated.

    The search ends when two starts agree, or when the residuals are as small as the noise of the
    samples.

    Args:
        shooting: The trials.
        z: First start, ``(n_z,)``.
        on_progress: Called with each stage.
    """
    found: list[StagedFit] = []
    tried = 0
    for start in _starts(shooting, z):
        tried += 1
        try:
            found.append(staged(shooting, start, on_progress))
        except LostStartError:
            continue
        best = min(found, key=lambda one: one.cost)
        if _is_noise(shooting, best):
            break
        if sum(_as_good(one, best) for one in found) >= 2:
            break
    if not found:
        return None
    return _best_of(found, [1] * len(found), shooting, tried)


def _is_noise(shooting: Shooting, best: StagedFit) -> bool:
    """Return True if only samples are fitted, and their residuals do not exceed the noise."""
    freedom = len(best.rest) - len(best.z)
    only_samples = not any(one.n_events for one in shooting.trials)
    return only_samples and freedom > 0 and best.cost < _QUIET * freedom


def _best_of(
    found: Sequence[StagedFit], shares: Sequence[int], shooting: Shooting, tried: int
) -> StagedFit:
    """Return the best of some optima, with the number of starts that agree and the others."""
    best = min(found, key=lambda one: one.cost)
    alike = [(one, share) for one, share in zip(found, shares, strict=True) if _as_good(one, best)]
    others = tuple(one.z for one, _ in alike if _apart(one, best, shooting.n_shared))
    kept = _merged(found, shares)
    return replace(
        best,
        agreed=sum(share for one, share in alike if not _apart(one, best, shooting.n_shared)),
        starts=tried,
        others=others,
        found=tuple(one.z for one, _ in kept),
        shares=tuple(share for _, share in kept),
    )


def _merged(found: Sequence[StagedFit], shares: Sequence[int]) -> list[tuple[StagedFit, int]]:
    """Return the different optima, the best first, with the number of starts of each."""
    kept: list[tuple[StagedFit, int]] = []
    for one, share in sorted(zip(found, shares, strict=True), key=lambda one: one[0].cost):
        same = next(
            (k for k, (other, _) in enumerate(kept) if _distance(one, other) <= _SAME_PLACE), None
        )
        if same is None:
            kept.append((one, share))
        else:
            kept[same] = kept[same][0], kept[same][1] + share
    return kept


def _distance(one: StagedFit, other: StagedFit) -> float:
    """Return the squared distance of two optima in standard errors of the residuals."""
    off = other.jacobian @ (one.z - other.z)
    scale = other.cost / max(len(other.rest) - len(other.z), 1)
    return float(off @ off) / max(scale, 1e-300)


def refitted(shooting: Shooting, found: StagedFit) -> StagedFit:
    """Return the best optimum near those of all starts, for other weights or masks.

    Args:
        shooting: The trials with the other weights or masks.
        found: The fit with the former values.
    """
    again, shares = list[StagedFit](), list[int]()
    for z, share in zip(found.found, found.shares, strict=True):
        try:
            again.append(fitted(shooting, z))
        except LostStartError:
            continue
        shares.append(share)
    return _best_of(again, shares, shooting, found.starts) if again else found


def _as_good(one: StagedFit, best: StagedFit) -> bool:
    scale = best.cost / max(len(best.rest) - len(best.z), 1)
    return one.cost - best.cost < max(_DIFFERENCE * scale, _SAME * 1e-3 * best.cost)


def _apart(one: StagedFit, best: StagedFit, n_shared: int) -> bool:
    """Return True if two optima as good as each other differ along determined directions."""
    step = one.z - best.z
    off = best.jacobian @ step
    scale = best.cost / max(len(best.rest) - len(best.z), 1)
    is_far = float(off @ off) > 16.0 * _DIFFERENCE * max(scale, 1e-300)
    return is_far and bool(np.any(np.abs(step[:n_shared]) > 1e-3))
