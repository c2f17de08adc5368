r"""The attractor of a motion: one definition for searches, maps, families and rigs (theory (4.7)).

A motion is described by its *returns*: the states in which it meets a section. They are usually its
releases, or its impacts if it is never released. `outcome_of` classifies the motion from its
returns and the events between them. This module does not simulate, and all its quantities are
relative: states are relative to their own size, times are relative to the clock or the returns.

* ``GONE``: a coordinate is beyond its bound (`bounds_of`), or has diverged (`has_left`).
* ``RESTS``: all states except the clock are constant, and contact persists in every phase of the
  clock (`is_still`, `keeps_holding`).
* ``REPEATS``: the last returns, or the impacts, equal the returns or impacts of a period before
  (`repetitions`).
* ``QUASI_PERIODIC``, ``CHAOTIC``: the largest Lyapunov exponent is zero, or positive, and the
  motion does not repeat (`settling`).
* ``DIES_OUT``, ``GROWS``: the amplitude decays to zero, or grows at every return (`growth_of`).
* ``HELD``: the motion continues in contact and has not left the stop for long.
* ``UNDECIDED``: none of these so far.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.model import CharacteristicScales

Flags = NDArray[np.bool_]

PERIODS = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16)
"""Numbers of returns after which a motion may repeat."""

TEN_TURNS = 20 * math.pi
"""An angle beyond this value [rad] counts as diverged, if the problem does not declare a bound."""

WAITING = 300
"""Default settling time of a motion, in periods of the clock."""

OSCILLATIONS = 115
"""The same without a clock: oscillations, the slowest of the problem."""

STEADY = 1e-3
"""Relative change per return below which a motion neither grows nor decays."""

_NEAR_ZERO = 1e-3
"""A state smaller than this part of the largest of its unit is measured against that part."""
_ROUNDING = 1e-7
"""A state smaller than this part of all others is zero but for the error of an impact's time."""
_STILL = 1e-6
"""Rates below this part of the largest rates belong to a motion at rest."""
_LEFT = 1e3
"""A coordinate that is this many times as far as it ever was before does not come back."""
_OVERFLOW = 1e100
"""Part of its size beyond which powers of a coordinate overflow."""
LOOK_BACK = 8
"""Number of returns that determine the size of each state."""
_FADED = 1e-3
"""A motion with less than this part of its largest amplitude decays to zero."""
_WINDOW = 6
"""Growth factors that a law of growth is fitted to."""
_CLEARLY = 3e-3
"""A logarithm of a growth factor beyond this is decay, not error."""
_FALL = 4.0
"""Factor of the decay over which the law has to hold."""
_SCATTER = 0.2
"""Largest misfit of the law, for a unit of the logarithm at rest."""


class AttractorKind(Enum):
    """Kinds of attractors. The value completes the sentence "The motion ..."."""

    REPEATS = "repeats"
    QUASI_PERIODIC = "is quasi-periodic"
    CHAOTIC = "is chaotic"
    RESTS = "comes to rest"
    HELD = "stays in permanent contact"
    DIES_OUT = "decays"
    GROWS = "grows"
    GONE = "diverges"
    UNDECIDED = "has not settled"


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionReturn:
    """A state in which a motion meets its section.

    Attributes:
        time: Time of the return [s].
        state: State at the return, ``(n_x,)``.
        size: Largest modulus of each state at the events since the previous return, ``(n_x,)``, by
            default the modulus of `state`.
    """

    time: float
    state: Vector
    size: Vector | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """A motion so far.

    Attributes:
        units: Unit of each state, ``(n_x,)``. States with the same unit share a scale.
        usual: Size that each state usually has in the problem, ``(n_x,)``.
        returns: The last returns, in order, on a single section.
        amplitudes: Scalar size of every return so far.
        gone: Name of the diverged coordinate, or an empty string.
        still: Whether all states except the clock are constant, and contact persists forever.
        held: Whether contact has lasted longer than any period of the motion.
    """

    units: Sequence[str]
    usual: Vector | float = 1.0
    returns: Sequence[SectionReturn] = ()
    amplitudes: Sequence[float] = ()
    gone: str = ""
    still: bool = False
    held: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Settling:
    """Result of the classification.

    Attributes:
        outcome: Kind of the attractor.
        repetitions: Numbers of returns after which the motion repeats, the shortest first.
        trend: Growth factor of the motion per return, NaN if it cannot be determined.
        escaped: Name of the diverged coordinate.
    """

    outcome: AttractorKind
    repetitions: tuple[Repetition, ...] = ()
    trend: float = math.nan
    escaped: str = ""


def outcome_of(motion: Motion, *, close: float, apart: float = 0.01) -> Settling:
    """Classify the attractor of a motion, as far as it is determined.

    Args:
        motion: The motion so far.
        close: Change over a period that counts as repeating, relative to the size of the states.
        apart: As for `repetitions`.
    """
    growth = growth_of(motion.amplitudes)
    if motion.gone:
        return Settling(outcome=AttractorKind.GONE, trend=growth.factor, escaped=motion.gone)
    if motion.still:
        return Settling(outcome=AttractorKind.RESTS, trend=growth.factor)
    if growth.dies_out:
        return Settling(outcome=AttractorKind.DIES_OUT, trend=growth.factor)
    found = repetitions(motion.returns, motion.units, close=close, apart=apart, usual=motion.usual)
    if found:
        return Settling(outcome=AttractorKind.REPEATS, repetitions=found, trend=growth.factor)
    if motion.held:
        return Settling(outcome=AttractorKind.HELD)
    grows = growth.factor > 1.0 + STEADY
    outcome = AttractorKind.GROWS if grows else AttractorKind.UNDECIDED
    return Settling(outcome=outcome, trend=growth.factor)


# ------------------------------------------------------------------ sizes


def scale_of(states: Sequence[Vector], units: Sequence[str], usual: Vector | float = 1.0) -> Vector:
    """Return the size of each state, bounded away from zero, ``(n_x,)``.

    Args:
        states: States of the motion, or their sizes, each ``(n_x,)``.
        units: Unit of each state. A state that nearly vanishes gets the scale of the other states
            with its unit.
        usual: Usual size of each state in the problem, ``(n_x,)``. It makes states of different
            units comparable.
    """
    largest = np.max(np.abs(np.array(states)), axis=0) / usual
    alike = np.max(np.where(_same_unit(tuple(units)), largest, 0.0), axis=1)
    largest = np.maximum(largest, _NEAR_ZERO * alike)
    # A coordinate that contact keeps at zero is rounding, if no other state has its unit.
    overall = float(np.max(largest)) or 1.0
    return np.where(largest > _ROUNDING * overall, largest, overall) * usual


@lru_cache(maxsize=64)
def _same_unit(units: tuple[str, ...]) -> Flags:
    """Return for each pair of states whether they have the same unit, ``(n_x, n_x)``."""
    names = np.array(units)
    return np.asarray(names[:, None] == names)


# ------------------------------------------------------------------ it repeats


@dataclass(frozen=True, slots=True, kw_only=True)
class Repetition:
    """A number of returns after which a motion comes back.

    Attributes:
        returns: Number of returns.
        change: How near it comes, relative.
    """

    returns: int
    change: float


def changes(states: Sequence[Vector], scale: Vector) -> dict[int, float]:
    """Return the relative distance of the last state from the state `n` returns before, by `n`."""
    periods = [n for n in PERIODS if n < len(states)]
    if not periods:
        return {}
    before = np.array([states[-1 - n] for n in periods])
    away = np.max(np.abs(before - states[-1]) / scale, axis=1)
    return dict(zip(periods, away.tolist(), strict=True))


def repetitions(
    returns: Sequence[SectionReturn],
    units: Sequence[str],
    *,
    close: float,
    apart: float,
    usual: Vector | float = 1.0,
) -> tuple[Repetition, ...]:
    """Return the counts of returns after which a motion repeats, the shortest first.

    Args:
        returns: Last returns of the motion, in order.
        units: Unit of each state.
        close: Relative change that counts as repeating.
        apart: A repetition after several returns counts only if its change is smaller than after
            fewer returns by this factor. A motion that alternates while it settles repeats after
            one return.
        usual: As for `scale_of`.
    """
    if len(returns) < 2:
        return ()
    sizes = [one.state if one.size is None else one.size for one in returns[-LOOK_BACK:]]
    scale = scale_of(sizes, units, usual)
    nearest = math.inf
    found: list[Repetition] = []
    for n, change in changes([one.state for one in returns], scale).items():
        if change < close and change < apart * nearest:
            found.append(Repetition(returns=n, change=change))
        nearest = min(nearest, change)
    return tuple(found)


# ------------------------------------------------------------------ growth and decay


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """Change of the amplitude of a motion.

    Attributes:
        factor: Growth per return, fitted to the last few returns, NaN with too few returns.
        dies_out: Whether the motion decays to rest.
    """

    factor: float
    dies_out: bool


def growth_of(amplitudes: Sequence[float]) -> Growth:
    r"""Return the growth of amplitudes at successive returns, and whether they decay to zero.

    Near a rest at the stop a system is homogeneous of degree one up to terms of third order, so
    approximately :math:`\log(a_{k+1} / a_k) = c_0 + c_1 a_k^2`. If that law fits and decays at the
    present amplitude and at :math:`a = 0`, it decays at all amplitudes between. Then the motion
    decays to rest. The law is fitted to a decay by a factor of four, because the beat of a
    quasi-periodic motion follows the law over a smaller decay.
    """
    if amplitudes and amplitudes[-1] <= _FADED * max(amplitudes):
        return Growth(factor=_mean_factor(amplitudes), dies_out=True)
    if len(amplitudes) <= _WINDOW + 1:
        return Growth(factor=_mean_factor(amplitudes), dies_out=False)
    factor = _mean_factor(amplitudes)
    first = len(amplitudes) - _WINDOW - 1
    fallen = _FALL * amplitudes[-1]
    begun = next((k for k in range(len(amplitudes) - 1, -1, -1) if amplitudes[k] >= fallen), -1)
    if begun < 0 or not _clearly_falls(amplitudes[min(begun, first) :]):
        return Growth(factor=factor, dies_out=False)
    recent = np.array(amplitudes[min(begun, first) :])
    rates, squares = np.log(recent[1:] / recent[:-1]), recent[:-1] ** 2
    slope, at_rest = np.polyfit(squares, rates, 1)
    misfit = float(np.max(np.abs(rates - at_rest - slope * squares)))
    dies_out = at_rest < -_CLEARLY and misfit < _SCATTER * -at_rest
    return Growth(factor=factor, dies_out=bool(dies_out))


def _clearly_falls(amplitudes: Sequence[float]) -> bool:
    """Return True if every amplitude is clearly smaller than the previous one."""
    most = math.exp(-_CLEARLY)
    return all(after < most * before for before, after in pairwise(amplitudes))


def _mean_factor(amplitudes: Sequence[float]) -> float:
    recent = amplitudes[-_WINDOW - 1 :]
    if len(recent) < 2 or not (recent[0] > 0.0 and recent[-1] > 0.0):
        return math.nan
    return float((recent[-1] / recent[0]) ** (1 / (len(recent) - 1)))


# ------------------------------------------------------------------ it rests


def is_still(rates: Vector, largest: Vector, rounding: Vector | float = 0.0) -> Flags:
    """Return the mask of motions that have stopped, ``(n,)``.

    Args:
        rates: Rates of all states except the clock, in the present and the other phases of the
            clock, ``(n, n_phases, m)``. A link at rest on its stop may have a growing current.
        largest: Largest rates of each motion so far, ``(n, m)``.
        rounding: Rates below this value count as zero, ``(m,)``.
    """
    limit = np.maximum(_STILL * largest, rounding)
    return np.asarray(np.all(np.abs(rates) <= limit[:, None, :], axis=(1, 2)))


def keeps_holding(multiplier: Vector, rate: Vector, step: float | Vector) -> Flags:
    """Return the mask of motions whose contact force never vanishes, ``(n,)``.

    The cubic through values and rates at neighbouring phases lies in the hull of its Bernstein
    coefficients. If all of these are positive, the contact force is positive.

    Args:
        multiplier: Contact force at equal steps over a period of the clock, both ends included,
            ``(n, n_phases)``. It is a single value without a clock.
        rate: Time derivative of the contact force, ``(n, n_phases)``.
        step: Time between two phases [s].
    """
    if multiplier.shape[1] == 1:
        return multiplier[:, 0] > 0.0
    third = np.reshape(np.asarray(step) / 3, (-1, 1))
    after = multiplier[:, :-1] + third * rate[:, :-1]
    before = multiplier[:, 1:] - third * rate[:, 1:]
    positive = np.all(multiplier > 0.0, axis=1)
    return np.asarray(positive & np.all((after > 0.0) & (before > 0.0), axis=1))


# ------------------------------------------------------------------ it is gone


def bounds_of(
    names: Sequence[str], units: Sequence[str], n_q: int, declared: Mapping[str, float]
) -> Vector:
    """Return the bounds of the moduli of the states, ``(n_x,)``. Beyond them a motion has diverged.

    Args:
        names: Name of each state.
        units: Unit of each state.
        n_q: Number of coordinates. Only coordinates and states with a declared bound have bounds.
        declared: Bounds by name, from the problem's `escapes`.

    Returns:
        The declared bound, ten turns for other angles, and infinity for the rest, which `has_left`
        tests.
    """
    turns = [TEN_TURNS if unit == "rad" else math.inf for unit in units[:n_q]]
    usual = np.array([*turns, *([math.inf] * (len(names) - n_q))])
    return np.array([declared.get(name, bound) for name, bound in zip(names, usual, strict=True)])


def has_left(position: Vector, before: Vector) -> Flags:
    """Return the mask of coordinates that have diverged since the last return.

    Args:
        position: Position of the motion at the end of the given time, ``(n_q,)``.
        before: Largest modulus of each coordinate in the first half of that time, ``(n_q,)``.
    """
    return (before > 0.0) & (np.abs(position) > _LEFT * before)


def has_overflowed(state: Sequence[float], n_q: int, own: CharacteristicScales) -> Flags:
    """Return the mask of coordinates of a failed simulation that have diverged beyond doubt.

    Args:
        state: State at the failure, at least ``(n_x,)``.
        n_q: Number of coordinates.
        own: Characteristic scales of the problem.
    """
    return np.abs(state[:n_q]) > _OVERFLOW * own.states(len(state))[:n_q]
