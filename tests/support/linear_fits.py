"""Fits of a signal that is linear in its parameters: their errors are known in closed form."""

from __future__ import annotations

import numpy as np

from zeno_orbits.experiment.comparison.folding import Folded
from zeno_orbits.experiment.identification.least_squares import Fit
from zeno_orbits.experiment.identification.uncertainty import Spread, spread_of


def shapes(phases: np.ndarray) -> np.ndarray:
    """Return the derivatives of a signal by two parameters and its shift in phase, ``(n, 3)``."""
    angle = 2 * np.pi * phases
    return np.stack([np.cos(angle), np.cos(2 * angle), np.sin(3 * angle)], axis=1)


def samples(cycles: int, per_cycle: int) -> Folded:
    """Return samples of whole cycles, their values zero."""
    whole = np.arange(cycles * per_cycle) / per_cycle
    groups = np.floor(whole + 1e-9).astype(np.int64)
    seen = np.ones((len(whole), 1), dtype=bool)
    return Folded(
        phases=np.mod(whole + 1e-9, 1.0),
        values=np.zeros((len(whole), 1)),
        counts=seen.astype(np.float64),
        seen=seen,
        groups=groups,
        turns=groups.astype(np.float64),
    )


def fit_of(data: Folded, values: np.ndarray, period_tells: float = 0.0) -> Fit:
    """Return the least-squares fit of values in units of their noise.

    Args:
        data: Where they were taken.
        values: The values, ``(n,)``; the truth is zero.
        period_tells: What the period tells of the first parameter: one over its standard error.
    """
    jacobian = np.concatenate([-shapes(data.phases), [[-period_tells, 0.0, 0.0]]])
    target = np.append(values, 0.0)
    x = np.linalg.lstsq(jacobian, -target, rcond=None)[0]
    residuals = target + jacobian @ x
    spread: Spread = spread_of(jacobian, residuals, data)
    return Fit(
        x=x,
        data=data,
        jacobian=jacobian,
        residuals=residuals,
        spread=spread,
        before=0.0,
        after=0.0,
        repeating=0.0,
        converged=True,
    )
