r"""Profile intervals of the shared unknowns, and the noise that they rest on.

With the sum of squares `S`, its minimum over all other unknowns is the profile
:math:`S_p(z_k)`. The 95 % interval is
:math:`S_p(z_k) - S \le s^2 t^2`, where :math:`s^2 = S / (n - p)` and `t` is the quantile of
Student's distribution with :math:`n - p` degrees of freedom. If the residuals have structure,
:math:`s^2` is multiplied by :math:`n / n_\text{eff}`, with the effective number of samples by their
autocorrelation.
"""

from __future__ import annotations

import math

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.transients.shooting import Shooting
from zeno_orbits.experiment.transients.staged_fit import LostStartError, StagedFit, fitted

_ROUNDS = 3
"""Refits per end of an interval, at most."""
_NEAR = 0.02
"""Relative error of the end of an interval."""
_STEPS = 12


def covariance_of(fit: StagedFit) -> Vector:
    """Return the inverse of the information of a fit, ``(n_z, n_z)``.

    Args:
        fit: The optimum.
    """
    # An unknown without effect has no scale.
    size = np.maximum(np.linalg.norm(fit.jacobian, axis=0), 1e-150)
    scaled = fit.jacobian / size
    inverse: Vector = np.asarray(
        np.linalg.pinv(scaled.T @ scaled, rcond=1e-13, hermitian=True), dtype=np.float64
    )
    return inverse / np.outer(size, size)


def degrees(fit: StagedFit) -> int:
    """Return the degrees of freedom of a fit."""
    return max(len(fit.rest) - int(np.linalg.matrix_rank(fit.jacobian)), 1)


def quantile_of(fit: StagedFit, freedom: float | None = None) -> float:
    """Return the ratio of half a 95 % interval to a standard error.

    Args:
        fit: The optimum.
        freedom: Degrees of freedom of the error, by default of the residuals.
    """
    from scipy.stats import t as student

    return float(student.ppf(0.975, degrees(fit) if freedom is None else freedom))


def profile_ends(
    shooting: Shooting, fit: StagedFit, k: int, inflation: float, freedom: float | None = None
) -> tuple[float, float]:
    """Return the ends of the 95 % interval of an unknown.

    Args:
        shooting: The trials.
        fit: The optimum.
        k: Index of the unknown.
        inflation: Ratio of the errors to those for independent residuals.
        freedom: Degrees of freedom of the error, by default of the residuals.
    """
    limit = quantile_of(fit, freedom) * inflation
    scale = math.sqrt(fit.cost / degrees(fit))
    covariance = covariance_of(fit)
    error = scale * math.sqrt(max(covariance[k, k], 0.0))
    low, high = shooting.bounds
    ends: list[float] = []
    for sign in (-1.0, 1.0):
        far = sign * limit * error
        edge = float((low if sign < 0.0 else high)[k]) - fit.z[k]
        ends.append(_end(shooting, fit, k, far, edge, limit * scale, covariance[k]))
    return fit.z[k] + ends[0], fit.z[k] + ends[1]


def _end(
    shooting: Shooting, fit: StagedFit, k: int, far: float, edge: float, limit: float, row: Vector
) -> float:
    """Return the change of an unknown at which the root of the excess reaches the limit.

    Args:
        shooting: The trials.
        fit: The optimum.
        k: Index of the unknown.
        far: Change by the linearized interval.
        edge: Change up to the bound.
        limit: Root of the excess of the sum of squares at the end.
        row: Row of the unknown in the covariance.
    """
    if far == 0.0 or not math.isfinite(far):
        return edge
    inner, outer = (0.0, 0.0), None
    step = math.copysign(min(abs(far), abs(edge) * 0.999), far)
    z = fit.z.copy()
    for _ in range(_ROUNDS):
        start = z + (fit.z[k] + step - z[k]) * row / max(row[k], 1e-300)
        start[k] = fit.z[k] + step
        try:
            one = fitted(shooting, start, fixed=k, steps=_STEPS)
        except LostStartError:
            return inner[0] or step
        root = math.sqrt(max(one.cost - fit.cost, 0.0))
        if abs(root / limit - 1.0) < _NEAR or (root < limit and abs(step) >= 0.998 * abs(edge)):
            return step
        if root < limit:
            inner, z = (step, root), one.z
        else:
            outer = step, root
        if outer is None:
            step *= min(limit / max(root, 1e-300), 3.0)
        else:
            # The root is nearly linear between an end inside the interval and one beyond it.
            slope = (outer[1] - inner[1]) / (outer[0] - inner[0])
            step = inner[0] + (limit - inner[1]) / slope
        step = math.copysign(min(abs(step), 0.999 * abs(edge)), far)
    return step
