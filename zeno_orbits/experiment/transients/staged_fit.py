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
from zeno_orbits.experiment.transients.shooting import Shooting
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
_FAILED = 1e4
"""Residual of a trial that cannot be simulated."""
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
        found: Unknowns that all starts led to.
    """

    z: Vector
    rest: Vector
    jacobian: Vector
    converged: bool
    agreed: int = 1
    starts: int = 1
    others: tuple[Vector, ...] = ()
    found: tuple[Vector, ...] = ()

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.rest @ self.rest)


class _Evaluated:
    """Residuals and derivatives of one simulation, kept until the unknowns change."""

    def __init__(self, shooting: Shooting, stage: int | None, prior: Vector | None) -> None:
        self._shooting, self._stage, self._prior = shooting, stage, prior
        self._at: Vector | None = None
        self._found: tuple[Vector, Vector] | None = None
        self._shape: tuple[int, int] | None = None

    def _of(self, z: Vector) -> tuple[Vector, Vector]:
        if self._at is None or self._found is None or not np.array_equal(self._at, z):
            self._at, self._found = z.copy(), self._evaluated(z)
        return self._found

    def _evaluated(self, z: Vector) -> tuple[Vector, Vector]:
        found = self._shooting.residuals(z, self._stage)
        if found is None:
            if self._shape is None:
                raise LostStartError
            return np.full(self._shape[0], _FAILED), np.zeros(self._shape)
        rest, rows = found
        if self._prior is not None:
            k = self._shooting.n_shared
            rest = np.concatenate([rest, (z[:k] - self._prior) / _PRIOR])
            rows = np.concatenate([rows, np.eye(k, len(z)) / _PRIOR])
        self._shape = rows.shape
        return rest, rows

    def rest(self, z: Vector) -> Vector:
        return self._of(z)[0]

    def rows(self, z: Vector) -> Vector:
        return self._of(z)[1]


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
        xtol=1e-9,
        ftol=1e-9,
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

    Two starts that agree are enough, and one whose residuals are as small as the noise of samples.

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
    return _best_of(found, shooting, tried)


def _is_noise(shooting: Shooting, best: StagedFit) -> bool:
    """Return True if only samples are fitted, and their residuals are no larger than the noise."""
    freedom = len(best.rest) - len(best.z)
    only_samples = not any(one.n_events for one in shooting.trials)
    return only_samples and freedom > 0 and best.cost < _QUIET * freedom


def _best_of(found: Sequence[StagedFit], shooting: Shooting, tried: int) -> StagedFit:
    """Return the best of some optima, with the number of those that agree and the others."""
    best = min(found, key=lambda one: one.cost)
    alike = [one for one in found if _as_good(one, best)]
    others = tuple(one.z for one in alike if _apart(one, best, shooting.n_shared))
    return replace(
        best,
        agreed=len(alike) - len(others),
        starts=tried,
        others=others,
        found=tuple(one.z for one in found),
    )


def refitted(shooting: Shooting, found: StagedFit) -> StagedFit:
    """Return the best optimum near those of all starts, for other weights or masks.

    Args:
        shooting: The trials with the other weights or masks.
        found: The fit with the former ones.
    """
    again: list[StagedFit] = []
    for z in found.found:
        try:
            again.append(fitted(shooting, z))
        except LostStartError:
            continue
    return _best_of(again, shooting, found.starts) if again else found


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
