r"""Characteristic scales of a problem, relative to which small values are small in any units.

Every threshold for zero and every local error is relative to one of these scales. With
:math:`|q|, |v|, |a|` at the problem's initial states and the time :math:`T` of its clock, or
:math:`\sqrt{|q| / |a|}`, a coordinate has the scale :math:`s = \max(|q|, |v| T, |a| T^2)`, and the
largest scale among coordinates with the same unit. The scale of an angle is 1. The scale of a
velocity is :math:`s / T`, but at most :math:`\max(|v|, |a| T, \sqrt{|a| s})`, since a clock may be
far faster than the mechanism. If it is far slower, :math:`T` is ten times the time of the slowest
oscillation. :math:`T` is at most a hundred times the longest time in which an open gap of an
initial state closes, :math:`\sqrt{h / |\ddot h|}`, as a clock or a spring may be far slower than a
mass on its way to a stop. A start just off a stop counts as one on it: coordinates and velocities
below 1e-15 are rounding, and a coordinate below 1e-12 and a millionth of :math:`|v|^2 / |a|` counts
as this way. The scale of the gap is its change over such a displacement. Scales far from 1 are
rounded to powers of a thousand, and all other scales to 1, so a mechanism of usual size has the
scale 1 in SI units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.model.contact import GAP
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.scale import CharacteristicScales

START_OFF = 1e-9
"""Part of the size of a constraint, a gap or a gap rate by which a first state may miss zero.

A state at an event of another run carries the error of that run.
"""
_DAMPED = 1e-3
"""An eigenvalue whose imaginary part is less than this part of it does not oscillate."""
_EPSILON, _UNSURE, _SWEEPS = 2.0**-52, 1e-3, 4
"""Rounding. Relative error above which an eigenvalue is rounding. Sweeps that balance a matrix."""
_ROUNDED = 1e-6
"""Part of the way of a start within its own time below which its coordinates are rounding."""
_LEAST = 1e-15
"""Coordinates and velocities of a start below this are rounding of numbers of usual size."""
_OFF = 1e-12
"""Largest coordinate of a start that its speed makes one on a stop."""
_BAND, _WIDE = 3, 5
"""Decades around 1 within which a scale is rounded to 1, for accelerations and forces the second
value."""
_DECADES = 3
"""Other sizes are rounded to powers of ten with exponents that this divides."""
_SLOWER = 10.0
"""Largest time of a clock that sets the scales, in times of the slowest oscillation."""
_FALLS = 100.0
"""Largest time that sets the scales, in times in which the gap of an initial state closes."""
_AHEAD = 1e-6
"""Part of a time along the flow, over which the gap rate is differentiated."""
_PARAMETER = 4 * _EPSILON
"""Relative rounding of a parameter."""
_PHASES, _MANY_PHASES = 4, 64
"""Phases of the clock at which the scales are evaluated, of smooth formulas and with kinks."""
_FIXED = ("rad", "1")
"""Units of coordinates whose scale is 1 in every problem."""


def own_time(dynamics: HybridDynamics, state: Vector) -> float:
    r"""Return the slowest time scale of a problem [s]: of its clock or its oscillations.

    It is :math:`2 \pi / |\mu|` with the smallest oscillating eigenvalue :math:`\mu` of the free
    flow, which includes the eigenvalues of the clock. Without an oscillation it is
    :math:`2 \pi \sqrt{|q| / |\ddot q|}`, or :math:`2 \pi |\dot q| / |\ddot q|` if the coordinates
    are zero or rounding, or 1 s if the velocities are also zero.

    Args:
        dynamics: The system.
        state: State of the linearisation, ``(n_x,)``.
    """
    n_q = dynamics.n_q
    slopes, clock = _slopes(dynamics, state), list(dynamics.clock)
    # The clock does not depend on the mechanism.
    turns = np.linalg.eigvals(slopes[np.ix_(clock, clock)])
    values = np.append(_values_without_clock(dynamics, slopes), turns)
    slowest = _slowest_turn(np.asarray(values, dtype=np.complex128))
    if slowest:
        return 2 * math.pi * slowest
    size = float(np.max(np.abs(state[:n_q])))
    pull = float(np.max(np.abs(dynamics.free.rate(state)[n_q : 2 * n_q])))
    # Coordinates at an impact are rounding, if they are zero.
    speed = float(np.max(np.abs(state[n_q : 2 * n_q])))
    if pull > 0.0 and size > _ROUNDED * speed**2 / pull:
        return 2 * math.pi * math.sqrt(size / pull)
    return 2 * math.pi * speed / pull if pull > 0.0 and speed > 0.0 else 1.0


def _slopes(dynamics: HybridDynamics, state: Vector) -> Vector:
    """Return the Jacobian of the free flow, with zeros for entries that are not finite.

    At an empty vessel the slope of the root of the pressure is infinite and gives no time scale.
    """
    return np.nan_to_num(dynamics.free.jacobian(state), nan=0.0, posinf=0.0, neginf=0.0)


def _values_without_clock(dynamics: HybridDynamics, slopes: Vector) -> NDArray[np.complex128]:
    r"""Return the eigenvalues of the mechanism without its clock, without those that are rounding.

    A double eigenvalue zero, of a mechanism that moves freely as a whole or along a constraint, is
    rounded to the root of the rounding. The error of an eigenvalue :math:`\mu` of a matrix `A` is
    :math:`\varepsilon |A| \kappa`, with its condition number :math:`\kappa`.

    Args:
        dynamics: The system.
        slopes: Jacobian of the free flow, ``(n_x, n_x)``.
    """
    clock = list(dynamics.clock)
    matrix = _balanced(np.delete(np.delete(slopes, clock, 0), clock, 1))
    values, right = np.linalg.eig(matrix)
    with np.errstate(all="ignore"):
        # Of an exact double eigenvalue the condition number is infinite.
        left = np.linalg.norm(np.linalg.pinv(right, rcond=0.0), axis=1)
        error = _EPSILON * np.linalg.norm(matrix) * left
    return np.asarray(values[error < _UNSURE * np.abs(values)], dtype=np.complex128)


def _balanced(matrix: Vector) -> Vector:
    """Return a similar matrix whose rows and columns are of like size, whatever the units."""
    balanced, n = matrix.copy(), len(matrix)
    others = [np.delete(np.arange(n), k) for k in range(n)]
    for k in list(range(n)) * _SWEEPS:
        row, column = balanced[k, others[k]], balanced[others[k], k]
        length, height = math.sqrt(row @ row), math.sqrt(column @ column)
        if length > 0.0 and height > 0.0:
            factor = math.sqrt(length / height)
            balanced[k] /= factor
            balanced[:, k] *= factor
    return balanced


def _slowest_turn(eigenvalues: NDArray[np.complex128]) -> float:
    """Return the inverse of the smallest oscillating eigenvalue, or 0 without one."""
    turning = np.abs(eigenvalues[np.abs(eigenvalues.imag) > _DAMPED * np.abs(eigenvalues)])
    return float(1 / np.min(turning)) if turning.size else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleReach:
    """Distance that a problem covers from its start, in its own units and not rounded.

    Attributes:
        states: Sizes of coordinates, then of their velocities, ``(2 n_q,)``.
        gap: Scale of the gap.
        time: Time scale [s].
        pace: Largest velocity relative to its coordinate [1/s], at most the inverse of the time.
    """

    states: Vector
    gap: float
    time: float
    pace: float

    def sizes(self, n_x: int) -> Vector:
        """Return the scale of each state, ``(n_x,)``, by default 1."""
        sizes = np.ones(n_x)
        sizes[: len(self.states)] = _usable(self.states)
        return sizes


def own_scale(
    dynamics: HybridDynamics,
    starts: Sequence[Sequence[float]],
    units: Sequence[str],
    clock: Sequence[int] = (),
    further: Sequence[int] = (),
    branch: Callable[[Vector], HybridDynamics] | None = None,
    stops: Sequence[HybridDynamics] = (),
    resets: Callable[[Vector], Sequence[tuple[Vector, Vector]]] = lambda _: (),
) -> CharacteristicScales:
    """Return the characteristic scales of a problem, from its initial states.

    Args:
        dynamics: The system.
        starts: Initial states of the problem, each ``(n_x,)``.
        units: Unit of each state. Coordinates with the same unit share a scale.
        clock: Indices of the clock in the state. The scales are evaluated at four phases of the
            clock.
        further: Indices of the states of circuits and of additional states.
        branch: Function that returns the system on the branch of its kinks at a state. The default
            is the system itself, which is free of kinks.
        stops: The systems of all stops. The default is the system itself.
        resets: Function that returns the state after each reset of states, and its derivative.
    """
    with np.errstate(all="ignore"):
        # A value that overflows gets the scale 1.
        reach = reach_of(dynamics, starts, units, clock, branch, stops)
        states = _in_phases(_exact(starts, dynamics.n_q), clock, branch is not None)
        inertia = max(abs(dynamics.normal_inertia(x)) for x in states)
        gap, time, pace = (np.float64(one) for one in (reach.gap, reach.time, reach.pace))
        return CharacteristicScales(
            time=_rounded(float(time)),
            gap=_rounded(float(gap)),
            gap_rate=_rounded(float(gap * pace)),
            gap_acceleration=_rounded(float(gap * pace * pace), _WIDE),
            multiplier=_rounded(float(gap * pace * pace * inertia), _WIDE),
            sizes=(
                *map(_rounded, reach.states.tolist()),
                *_further_sizes(
                    dynamics, states, further, reach.states, float(time), branch, resets
                ),
            ),
        )


def _further_sizes(
    dynamics: HybridDynamics,
    states: Vector,
    further: Sequence[int],
    mechanism: Vector,
    time: float,
    branch: Callable[[Vector], HybridDynamics] | None,
    resets: Callable[[Vector], Sequence[tuple[Vector, Vector]]],
) -> list[float]:
    r"""Return the scales of the states after the velocities, up to the last additional state.

    Such a state has the scale :math:`\max(|z|, \min(|\dot z| T, |\dot z / \partial_z \dot z|))`. If
    this is rounding beside :math:`\max(|R|, \sum_j |\partial R / \partial x_j|\, s_j)` of a reset
    `R` that sets it, it has that scale.
    """
    first = 2 * dynamics.n_q
    sizes = np.ones(max(states.shape[1], max(further, default=0) + 1))
    sizes[:first] = _usable(mechanism)
    for k in further:
        found = 0.0
        for x in states:
            flow = dynamics.free if branch is None else branch(x).free
            rate, slope = flow.rate(x)[k], flow.jacobian(x)[k, k]
            way = min(abs(rate) * time, abs(rate / slope) if slope != 0.0 else math.inf)
            found = max(found, abs(float(x[k])), float(way))
        sizes[k] = found
    is_zero = any(sizes[k] <= _LEAST for k in further)
    known = [one for x in states for one in resets(x)] if is_zero else []
    # A state may be set from another one that is set.
    for _ in further:
        for k in further:
            set_to = [
                max(abs(after[k]), float(np.abs(by[k]) @ sizes))
                for after, by in known
                if np.any(by[k] != np.eye(1, len(by), k)[0])
            ]
            reach = float(np.max([one for one in set_to if math.isfinite(one)], initial=0.0))
            sizes[k] = sizes[k] if sizes[k] > _ROUNDED * reach else reach
    return [_rounded(size) for size in sizes[first : max(further, default=first - 1) + 1].tolist()]


def _exact(starts: Sequence[Sequence[float]], n_q: int) -> Vector:
    """Return states with zero for coordinates and velocities that are rounding, ``(n, n_x)``."""
    states = np.array(starts, dtype=np.float64)
    mechanism = states[:, : 2 * n_q]
    mechanism[np.abs(mechanism) < _LEAST] = 0.0
    return states


def _in_phases(states: Vector, clock: Sequence[int], has_kinks: bool) -> Vector:
    """Return states with their clock turned to several phases, if there is one."""
    if clock:
        n = _MANY_PHASES if has_kinks else _PHASES
        turns = np.tile(2 * math.pi * np.arange(n) / n, len(states))
        states = np.repeat(states, n, axis=0)
        states[:, clock[0]], states[:, clock[1]] = np.cos(turns), np.sin(turns)
    return states


def reach_of(
    dynamics: HybridDynamics,
    starts: Sequence[Sequence[float]],
    units: Sequence[str],
    clock: Sequence[int] = (),
    branch: Callable[[Vector], HybridDynamics] | None = None,
    stops: Sequence[HybridDynamics] = (),
) -> ScaleReach:
    """Return the reach of a problem, which is the scales of `own_scale` before rounding.

    Args:
        dynamics: The system.
        starts: Initial states of the problem, each ``(n_x,)``.
        units: Unit of each state. Coordinates with the same unit share a scale.
        clock: Indices of the clock in the state. The scales are evaluated at four phases of the
            clock.
        branch: As for `own_scale`.
        stops: As for `own_scale`.
    """
    n_q = dynamics.n_q
    states = _in_phases(_exact(starts, n_q), clock, branch is not None)
    flows = [dynamics.free if branch is None else branch(x).free for x in states]
    rates = np.array([flow.rate(x) for flow, x in zip(flows, states, strict=True)])
    places = _alike(np.max(np.abs(states[:, :n_q]), axis=0), units)
    velocities = _alike(np.max(np.abs(rates[:, :n_q]), axis=0), units, fixed=0.0)
    accelerations = _alike(np.max(np.abs(rates[:, n_q : 2 * n_q]), axis=0), units, fixed=0.0)
    # A start just off a stop, with a speed, reaches as far as one on it.
    ways = np.divide(velocities**2, accelerations, out=np.zeros(n_q), where=accelerations > 0.0)
    places = np.where((places > 0.0) & (places <= np.minimum(_ROUNDED * ways, _OFF)), ways, places)
    if clock:
        turn, own = 1 / np.linalg.norm(rates[0, list(clock)]), _oscillation(dynamics, states[0])
        time = min(turn, np.float64(_SLOWER * own)) if own else turn
    else:
        time = np.float64(_swing(places, accelerations) or _slowest(dynamics, states[0]))
    seen = slice(None, None, max(1, len(states) // (_PHASES * len(starts))))
    fall = max(
        _closing_time(one, x, rate, _alike(places, units), float(time))
        for x, rate in zip(states[seen], rates[seen], strict=True)
        for one in stops or (dynamics,)
    )
    time = np.float64(min(time, _FALLS * fall) if fall else time)
    largest = np.maximum(np.maximum(places, velocities * time), accelerations * time * time)
    largest = _alike(largest, units)
    gap = np.float64(max(_gap_reach(dynamics, x, largest) for x in states))
    reached = np.maximum(
        velocities, np.maximum(accelerations * time, (accelerations * largest) ** 0.5)
    )
    speeds = np.where(reached > 0.0, np.minimum(largest / time, reached), largest / time)
    moves = largest > 0.0
    return ScaleReach(
        states=np.append(largest, speeds),
        gap=float(gap),
        time=float(time),
        pace=float(np.max(speeds[moves] / largest[moves], initial=0.0) or 1 / time),
    )


def _alike(sizes: Vector, units: Sequence[str], fixed: float = 1.0) -> Vector:
    """Return the largest scale among the coordinates with the same unit, for each, ``(n_q,)``.

    Args:
        sizes: Scales of the coordinates.
        units: Units of the coordinates and of additional states.
        fixed: Smallest scale of an angle.
    """
    found = sizes.copy()
    for unit in dict.fromkeys(units[: len(sizes)]):
        same = [k for k in range(len(sizes)) if units[k] == unit]
        found[same] = np.max(sizes[same])
        if unit in _FIXED:
            found[same] = fixed or found[same]
    return found


def _closing_time(
    dynamics: HybridDynamics, x: Vector, rate: Vector, places: Vector, time: float
) -> float:
    """Return the time in which an open gap closes [s], or 0 for a closed gap or without motion.

    A gap is closed if it is rounding relative to its coordinates or its parameters.

    Args:
        dynamics: The system.
        x: A state, ``(n_x,)``.
        rate: The rate of the state, ``(n_x,)``.
        places: Sizes of the coordinates, ``(n_q,)``.
        time: A time that is long if it is much longer [s].
    """
    if not 0.0 < time < math.inf:
        return 0.0
    gap, speed, after = dynamics.gap(x), abs(dynamics.gap_rate(x)), _AHEAD * time * rate
    moved = np.tile(x, (len(places), 1))
    moved[:, : len(places)] += np.diag(places)
    if not gap > START_OFF * max(abs(dynamics.gap(one) - gap) for one in moved):
        return 0.0
    change = abs(dynamics.gap_rate(x + after) - dynamics.gap_rate(x - after))
    lift = change / (2 * _AHEAD * time)
    fall = min(
        math.sqrt(gap / lift) if lift > 0.0 else math.inf, gap / speed if speed else math.inf
    )
    if not fall < math.inf or (_FALLS * fall < time and not gap > _rounding(dynamics, x)):
        return 0.0
    return fall


def _rounding(dynamics: HybridDynamics, x: Vector) -> float:
    """Return the change of the gap at a state by the rounding of the parameters."""
    if dynamics.formulas is None:
        return 0.0
    system, p = dynamics.formulas.system, np.asarray(dynamics.formulas.values, dtype=np.float64)
    gap, total = dynamics.gap(x), 0.0
    for k in np.flatnonzero(p):
        near = p.copy()
        near[k] *= 1.0 + _PARAMETER
        total += abs(float(system.contact(x, near).full()[GAP, 0]) - gap)
    return total


def _swing(places: Vector, accelerations: Vector) -> float:
    """Return the longest time in which a coordinate moves by its own size, or 0 without motion."""
    moves = (places > 0.0) & (accelerations > 0.0)
    return float(np.max(np.sqrt(places[moves] / accelerations[moves]), initial=0.0))


def _oscillation(dynamics: HybridDynamics, x: Vector) -> float:
    """Return the time of the slowest oscillation of the mechanism without its clock, or 0."""
    try:
        return _slowest_turn(_values_without_clock(dynamics, _slopes(dynamics, x)))
    except np.linalg.LinAlgError:
        return 0.0


def _slowest(dynamics: HybridDynamics, x: Vector) -> float:
    """Return the slowest period of the linearised flow, or 1 without an oscillation."""
    try:
        return own_time(dynamics, x) / (2 * math.pi)
    except np.linalg.LinAlgError:
        return 1.0


def constraint_sizes(
    dynamics: HybridDynamics, x: Vector, own_sizes: Vector | None = None
) -> Vector:
    """Return the change of the holonomic constraints for state changes of their scale, ``(n,)``.

    It is the scale of constraint violations. It is 1 for a system without formulas.

    Args:
        dynamics: The system.
        x: A state, ``(n_x,)``.
        own_sizes: Smallest scale of each state, ``(n_x,)``, by default the system's own scales.
    """
    derivable = dynamics.differentiation
    if derivable is None:
        return np.ones_like(dynamics.holonomic(x))
    least = dynamics.own.states(len(x)) if own_sizes is None else own_sizes
    sizes = np.maximum(np.abs(x), least)
    found = np.abs(derivable.by(()).holonomic(x)) @ sizes
    return np.where(found > 0.0, found, 1.0)


def _usable(sizes: Vector) -> Vector:
    """Return the scales, with 1 in place of invalid scales."""
    return np.where(np.isfinite(sizes) & (sizes > 0.0), sizes, 1.0)


def _gap_reach(dynamics: HybridDynamics, x: Vector, sizes: Vector) -> float:
    """Return the change of the gap for a displacement of each coordinate by its scale."""
    gap, moved = dynamics.gap(x), np.tile(x, (len(sizes), 1))
    moved[:, : len(sizes)] += np.diag(sizes)
    return max(abs(gap), *(abs(dynamics.gap(one) - gap) for one in moved))


def _rounded(size: float, band: int = _BAND) -> float:
    """Return 1 for an everyday or invalid scale, else the nearest power of a thousand.

    Args:
        size: The scale.
        band: Decades around 1 that count as everyday.
    """
    if not (math.isfinite(size) and size > 0.0) or abs(math.log10(size)) <= band:
        return 1.0
    return 10.0 ** (_DECADES * round(math.log10(size) / _DECADES))
