r"""The sizes of a problem's own numbers, against which small numbers are small in any units.

Everything that counts as zero, and every local error, is a part of one of these. With
:math:`|q|, |v|, |a|` where the problem starts and the time :math:`T` of its clock, or
:math:`\sqrt{|q| / |a|}`, a coordinate has the size :math:`\max(|q|, |v| T, |a| T^2)`, the largest
among those of its unit; an angle has the size 1, and the gap that of its change over such a way.
Sizes far from 1 are rounded to powers of a thousand, all others to 1: a machine of everyday size
has the size 1 in SI units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.scale import OwnScale

_DAMPED = 1e-3
"""An eigenvalue whose imaginary part is less than this part of it does not oscillate."""
_BAND, _WIDE = 3, 5
"""Decades around 1 in which a size is an everyday one; of accelerations and forces more."""
_DECADES = 3
"""Other sizes are rounded to powers of ten with exponents that this divides."""
_PHASES = 4
_FIXED = ("rad", "1")
"""Units of coordinates that have the size 1 whatever the problem."""


def own_time(dynamics: HybridDynamics, state: Vector) -> float:
    r"""Return the slowest time scale of a problem [s]: of its clock or its oscillations.

    It is :math:`2 \pi / |\mu|` with the smallest oscillating eigenvalue :math:`\mu` of the free
    flow, which has those of the clock. Where nothing oscillates it is
    :math:`2 \pi \sqrt{|q| / |\ddot q|}`.

    Args:
        dynamics: The system.
        state: Where to look, ``(n_x,)``.
    """
    n_q = dynamics.n_q
    eigenvalues = np.linalg.eigvals(dynamics.free.jacobian(state))
    turning = np.abs(eigenvalues[np.abs(eigenvalues.imag) > _DAMPED * np.abs(eigenvalues)])
    if turning.size:
        return float(2 * math.pi / np.min(turning))
    size = float(np.max(np.abs(state[:n_q])))
    pull = float(np.max(np.abs(dynamics.free.rate(state)[n_q : 2 * n_q])))
    return 2 * math.pi * math.sqrt(size / pull) if size > 0.0 and pull > 0.0 else 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """How far a problem goes from where it starts, in its own units and not rounded.

    Attributes:
        states: Sizes of coordinates, then of their velocities, ``(2 n_q,)``.
        gap: Of the gap.
        time: [s].
    """

    states: Vector
    gap: float
    time: float

    def sizes(self, n_x: int) -> Vector:
        """Return the size of each state, ``(n_x,)``; 1 where there is none."""
        sizes = np.ones(n_x)
        sizes[: len(self.states)] = _usable(self.states)
        return sizes


def own_scale(
    dynamics: HybridDynamics,
    starts: Sequence[Sequence[float]],
    units: Sequence[str],
    clock: Sequence[int] = (),
) -> OwnScale:
    """Return the sizes of a problem's numbers, from where it starts.

    Args:
        dynamics: The system.
        starts: States at which the problem starts, each ``(n_x,)``.
        units: Unit of each state; coordinates of one unit are measured alike.
        clock: Places of the clock in the state; it is looked at in four phases.
    """
    with np.errstate(all="ignore"):
        # What overflows has no size, and counts as 1.
        reach = reach_of(dynamics, starts, units, clock)
        states = _in_phases(np.array(starts, dtype=np.float64), clock)
        inertia = max(abs(dynamics.normal_inertia(x)) for x in states)
        gap, time = np.float64(reach.gap), np.float64(reach.time)
        return OwnScale(
            time=_rounded(float(time)),
            gap=_rounded(float(gap)),
            gap_rate=_rounded(float(gap / time)),
            gap_acceleration=_rounded(float(gap / time / time), _WIDE),
            multiplier=_rounded(float(gap / time / time * inertia), _WIDE),
            sizes=tuple(map(_rounded, reach.states.tolist())),
        )


def _in_phases(states: Vector, clock: Sequence[int]) -> Vector:
    """Return states with their clock turned to four phases, if there is one."""
    if clock:
        turns = np.tile(2 * math.pi * np.arange(_PHASES) / _PHASES, len(states))
        states = np.repeat(states, _PHASES, axis=0)
        states[:, clock[0]], states[:, clock[1]] = np.cos(turns), np.sin(turns)
    return states


def reach_of(
    dynamics: HybridDynamics,
    starts: Sequence[Sequence[float]],
    units: Sequence[str],
    clock: Sequence[int] = (),
) -> Reach:
    """Return how far a problem goes, as the sizes of `own_scale` before they are rounded.

    Args:
        dynamics: The system.
        starts: States at which the problem starts, each ``(n_x,)``.
        units: Unit of each state; coordinates of one unit are measured alike.
        clock: Places of the clock in the state; it is looked at in four phases.
    """
    states, n_q = _in_phases(np.array(starts, dtype=np.float64), clock), dynamics.n_q
    rates = np.array([dynamics.free.rate(x) for x in states])
    places = _alike(np.max(np.abs(states[:, :n_q]), axis=0), units)
    velocities = _alike(np.max(np.abs(rates[:, :n_q]), axis=0), units, fixed=0.0)
    accelerations = _alike(np.max(np.abs(rates[:, n_q : 2 * n_q]), axis=0), units, fixed=0.0)
    if clock:
        time = 1 / np.linalg.norm(rates[0, list(clock)])
    else:
        time = np.float64(_swing(places, accelerations) or _slowest(dynamics, states[0]))
    largest = np.maximum(np.maximum(places, velocities * time), accelerations * time * time)
    largest = _alike(largest, units)
    gap = np.float64(max(_gap_reach(dynamics, x, largest) for x in states))
    return Reach(states=np.append(largest, largest / time), gap=float(gap), time=float(time))


def _alike(sizes: Vector, units: Sequence[str], fixed: float = 1.0) -> Vector:
    """Return the largest size among the coordinates of one unit, for each, ``(n_q,)``.

    Args:
        sizes: Of the coordinates.
        units: Their units, and those of further states.
        fixed: Least size of an angle.
    """
    found = sizes.copy()
    for unit in dict.fromkeys(units[: len(sizes)]):
        same = [k for k in range(len(sizes)) if units[k] == unit]
        found[same] = np.max(sizes[same])
        if unit in _FIXED:
            found[same] = fixed or found[same]
    return found


def _swing(places: Vector, accelerations: Vector) -> float:
    """Return the longest time in which a coordinate goes as far as it is; 0 if none moves."""
    moves = (places > 0.0) & (accelerations > 0.0)
    return float(np.max(np.sqrt(places[moves] / accelerations[moves]), initial=0.0))


def _slowest(dynamics: HybridDynamics, x: Vector) -> float:
    """Return the slowest time scale of the linearized flow, over a turn; 1 if it has none."""
    try:
        return own_time(dynamics, x) / (2 * math.pi)
    except np.linalg.LinAlgError:
        return 1.0


def constraint_sizes(
    dynamics: HybridDynamics, x: Vector, own_sizes: Vector | None = None
) -> Vector:
    """Return how much the holonomic constraints change where states do by their size, ``(n,)``.

    At most by that a state may be off; 1 for a system without formulas.

    Args:
        dynamics: The system.
        x: A state, ``(n_x,)``.
        own_sizes: Least size of each state, ``(n_x,)``; by default the system's own.
    """
    derivable = dynamics.differentiation
    if derivable is None:
        return np.ones_like(dynamics.holonomic(x))
    least = dynamics.own.states(len(x)) if own_sizes is None else own_sizes
    sizes = np.maximum(np.abs(x), least)
    found = np.abs(derivable.by(()).holonomic(x)) @ sizes
    return np.where(found > 0.0, found, 1.0)


def _usable(sizes: Vector) -> Vector:
    """Return sizes, 1 where there is none."""
    return np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, 1.0)


def _gap_reach(dynamics: HybridDynamics, x: Vector, sizes: Vector) -> float:
    """Return how far the gap goes if a coordinate goes as far as it does."""
    gap, moved = dynamics.gap(x), np.tile(x, (len(sizes), 1))
    moved[:, : len(sizes)] += np.diag(sizes)
    return max(abs(gap), *(abs(dynamics.gap(one) - gap) for one in moved))


def _rounded(size: float, band: int = _BAND) -> float:
    """Return 1 for an everyday size, else the nearest power of a thousand; 1 where there is none.

    Args:
        size: The size.
        band: Decades around 1 that are everyday ones.
    """
    if not (math.isfinite(size) and size > 0.0) or abs(math.log10(size)) <= band:
        return 1.0
    return 10.0 ** (_DECADES * round(math.log10(size) / _DECADES))
