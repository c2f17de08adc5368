"""Characteristic scales of a problem, relative to which small values are small in any units."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from zeno_orbits.arrays import Vector

_NOTHING = 1e-12
"""Largest size of a state, in its characteristic scale, that is zero to rounding.

Such a state is not a unit of its error.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class CharacteristicScales:
    """Characteristic scales of a problem, which are powers of a thousand and by default 1.

    Attributes:
        time: Scale of times [s].
        gap: Scale of the gap.
        gap_rate: Scale of the gap rate.
        gap_acceleration: Scale of the gap acceleration.
        multiplier: Scale of the multiplier.
        sizes: Scales of the states, coordinates and velocities first. Omitted states have the scale
            1.
    """

    time: float = 1.0
    gap: float = 1.0
    gap_rate: float = 1.0
    gap_acceleration: float = 1.0
    multiplier: float = 1.0
    sizes: tuple[float, ...] = ()

    @property
    def energy(self) -> float:
        """Size of energies: of the work of the stop along the gap."""
        return self.multiplier * self.gap

    @property
    def least(self) -> float:
        """The smallest scale of a state, at most 1, for absolute local errors."""
        return min([1.0, *self.sizes])

    def weights(self, n_x: int) -> tuple[float, ...]:
        """Return the size of each state relative to the smallest size, the unit of local errors."""
        return tuple((self.states(n_x) / self.least).tolist())

    def flight_weights(self, n_x: int) -> tuple[float, ...]:
        """Return the same of a rescaled flight: the states, the scaled gap and its rate."""
        # A gap acceleration may be so small that the product is zero.
        size = max(self.gap_acceleration * self.least, sys.float_info.min)
        return (*self.weights(n_x), 1 / size, 1 / self.least)

    def rates(self, n_q: int, n_x: int) -> Vector:
        """Return the size of the rate of each state, ``(n_x,)``.

        Args:
            n_q: Number of coordinates.
            n_x: Number of states.
        """
        sizes, pace = self.states(n_x), self.gap_rate / self.gap
        velocities, further = sizes[n_q : 2 * n_q], sizes[2 * n_q :]
        return np.concatenate([velocities, velocities * pace, further / self.time])

    def not_small(self, sizes: Vector, part: float) -> Vector:
        """Return sizes of states, those that are next to nothing replaced by the largest.

        Args:
            sizes: Sizes of the states of a motion, ``(n_x,)``.
            part: Part of the largest, measured in the problem's own sizes, that is next to nothing.
        """
        usual = self.states(len(sizes))
        shares = sizes / usual
        largest = float(np.max(shares)) or 1.0
        return np.where(shares > part * largest, shares, largest) * usual

    def not_zero(self, sizes: Vector) -> Vector:
        """Return sizes of states, those that are zero to rounding replaced by the scale.

        Args:
            sizes: Sizes of the states of a motion, ``(n_x,)``.
        """
        usual = self.states(len(sizes))
        return np.where(sizes > _NOTHING * usual, sizes, usual)

    def states(self, n_x: int) -> Vector:
        """Return the size of each state, ``(n_x,)``."""
        return _filled(self.sizes, n_x)


@lru_cache(maxsize=64)
def _filled(first: tuple[float, ...], n: int) -> Vector:
    sizes = np.ones(n)
    sizes[: len(first)] = first
    sizes.flags.writeable = False
    return sizes


UNIT_SCALES = CharacteristicScales()
"""The scale of a system without information on sizes."""


def usual() -> CharacteristicScales:
    """Return the default sizes, for a system without information on sizes."""
    return UNIT_SCALES
