"""What a sequence of returns tells: whether it repeats, dies out, or grows. Pure numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector

PERIODS = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16)
"""Numbers of returns after which a motion may repeat."""

_NEAR_ZERO = 1e-3
"""An entry smaller than this part of the largest of its kind is measured against that part."""

_ROUNDING = 1e-9
"""An entry smaller than this part of all others is zero but for rounding."""

_FADED = 1e-3
"""A motion that has fallen to this part of its largest amplitude dies out."""

_WINDOW = 6
"""Growth factors that a law of growth is fitted to."""
_FELL = 0.9
"""The amplitude must have fallen by this factor over them, or their trend is not told."""
_CLEARLY = 3e-3
"""A logarithm of a growth factor beyond this is decay, not error."""
_SCATTER = 0.2
"""Largest misfit of the law, for a unit of the logarithm at rest."""


def scale_of(states: Sequence[Vector], n_q: int) -> Vector:
    """Return the size of each state over some returns; entries that are always zero get a part.

    Args:
        states: States at the returns, each ``(n_x,)``.
        n_q: Number of coordinates: positions, velocities and the rest are measured by themselves.
    """
    largest = np.max(np.abs(np.array(states)), axis=0)
    for kind in (slice(0, n_q), slice(n_q, 2 * n_q), slice(2 * n_q, None)):
        of_kind = float(np.max(largest[kind], initial=0.0))
        largest[kind] = np.maximum(largest[kind], _NEAR_ZERO * of_kind)
    # A coordinate that the stop holds at zero is rounding, if it is the only one of its kind.
    overall = float(np.max(largest)) or 1.0
    return np.where(largest > _ROUNDING * overall, largest, overall)


def changes(states: Sequence[Vector], scale: Vector) -> dict[int, float]:
    """Return how far the last state is from that `n` returns before, by `n`, relative."""
    last = states[-1]
    return {
        n: float(np.max(np.abs(last - states[-1 - n]) / scale)) for n in PERIODS if n < len(states)
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """How the amplitude of a motion changes.

    Attributes:
        factor: Growth over a return, fitted to the last few; NaN with too few.
        dies_out: Whether the motion goes to rest.
    """

    factor: float
    dies_out: bool


def growth_of(amplitudes: Sequence[float]) -> Growth:
    r"""Return how amplitudes at successive returns grow, and whether they fall to zero.

    Near a rest at the stop a system is homogeneous of degree one but for terms of third order, so
    :math:`\log(a_{k+1} / a_k) = c_0 + c_1 a_k^2` nearly. Where that law fits, decays here and
    decays at :math:`a = 0`, it decays everywhere in between: the motion dies out.
    """
    if amplitudes[-1] <= _FADED * max(amplitudes):
        return Growth(factor=_mean_factor(amplitudes), dies_out=True)
    if len(amplitudes) <= _WINDOW + 1:
        return Growth(factor=_mean_factor(amplitudes), dies_out=False)
    recent = np.array(amplitudes[-_WINDOW - 1 :])
    rates = np.log(recent[1:] / recent[:-1])
    squares = recent[:-1] ** 2
    factor = math.exp(float(np.mean(rates)))
    if not (np.all(rates < -_CLEARLY) and recent[-1] < _FELL * recent[0]):
        return Growth(factor=factor, dies_out=False)
    slope, at_rest = np.polyfit(squares, rates, 1)
    misfit = float(np.max(np.abs(rates - at_rest - slope * squares)))
    dies_out = at_rest < -_CLEARLY and misfit < _SCATTER * -at_rest
    return Growth(factor=factor, dies_out=bool(dies_out))


def _mean_factor(amplitudes: Sequence[float]) -> float:
    recent = amplitudes[-_WINDOW - 1 :]
    if len(recent) < 2 or not (recent[0] > 0.0 and recent[-1] > 0.0):
        return math.nan
    return float((recent[-1] / recent[0]) ** (1 / (len(recent) - 1)))
