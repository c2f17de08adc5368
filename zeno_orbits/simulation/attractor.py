r"""The attractor of a motion: one definition for searches, maps, families and rigs (theory (29)).

A motion is known by its *returns*: the states in which it meets a section, mostly its releases,
and impacts where no release comes. `outcome_of` goes from them and what happened in between to one
answer. Nothing is simulated here, and no number has a unit: states are measured against their own
size, times against the clock or the returns.

* ``GONE``: a coordinate is beyond its bound (`bounds_of`), or has left for good (`has_left`).
* ``RESTS``: nothing but the clock moves, and the stop does not let go in any phase of the clock
  (`is_still`, `keeps_holding`).
* ``REPEATS``: the last returns are those of a period before (`repetitions`).
* ``DIES_OUT``, ``GROWS``: its amplitude falls to zero, or grows by every return (`growth_of`).
* ``HELD``: it moves on its stop and has not left it for long.
* ``UNDECIDED``: none of these, so far.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Rows, Vector

Flags = NDArray[np.bool_]

PERIODS = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16)
"""Numbers of returns after which a motion may repeat."""

TEN_TURNS = 20 * math.pi
"""An angle beyond this [rad] is gone, where the problem says nothing of it."""

WAITING = 300
"""Periods of the clock in which a motion has to settle, where nobody says how long to wait."""

OSCILLATIONS = 115
"""The same without a clock: oscillations, the slowest of the problem."""

STEADY = 1e-3
"""A motion that changes less than this part of itself a return neither grows nor dies."""

_NEAR_ZERO = 1e-3
"""A state smaller than this part of the largest of its unit is measured against that part."""
_ROUNDING = 1e-9
"""A state smaller than this part of all others is zero but for rounding."""
_STILL = 1e-6
"""Rates that have fallen to this part of the largest ones are those of a motion at rest."""
_LEFT = 1e3
"""A coordinate that is this many times as far as it ever was before does not come back."""
LOOK_BACK = 8
"""Returns that tell the size of each state."""
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


class AttractorKind(Enum):
    """Kinds of attractors. The value completes the sentence "The motion ..."."""

    REPEATS = "repeats"
    RESTS = "comes to rest"
    HELD = "stays on its stop"
    DIES_OUT = "dies out"
    GROWS = "grows"
    GONE = "runs away"
    UNDECIDED = "has not settled"


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionReturn:
    """A state in which a motion meets its section.

    Attributes:
        time: When [s].
        state: Where, ``(n_x,)``.
        size: Largest modulus of each state at the events since the return before, ``(n_x,)``; by
            default that of `state`.
    """

    time: float
    state: Vector
    size: Vector | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """A motion as far as it has been seen.

    Attributes:
        units: Unit of each state, ``(n_x,)``: states of one unit are measured alike.
        usual: Size that each state usually has in the problem, ``(n_x,)``.
        returns: Its last returns, in order, on one section.
        amplitudes: Size of each return so far as one number, of all of them.
        gone: Name of the coordinate that is gone; empty if there is none.
        still: Whether nothing but the clock moves, and the stop holds for ever.
        held: Whether it has been on its stop for longer than any of its periods.
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
    """The answer.

    Attributes:
        outcome: Its kind.
        repetitions: Numbers of returns after which it repeats, the shortest first.
        trend: Factor by which the motion grows a return; NaN where nothing can be said.
        escaped: Name of the coordinate that is gone.
    """

    outcome: AttractorKind
    repetitions: tuple[Repetition, ...] = ()
    trend: float = math.nan
    escaped: str = ""


def outcome_of(motion: Motion, *, close: float, apart: float = 0.01) -> Settling:
    """Return what a motion settles to, as far as can be told.

    Args:
        motion: What has been seen of it.
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
    """Return the size of each state, nowhere near zero, ``(n_x,)``.

    Args:
        states: States of the motion, or their sizes, each ``(n_x,)``.
        units: Unit of each; one that nearly vanishes is measured against the others of its unit.
        usual: Size that each usually has in the problem, ``(n_x,)``: only so can states of
            different units be compared.
    """
    largest = np.max(np.abs(np.array(states)), axis=0) / usual
    for alike in _of_one_unit(tuple(units)):
        largest[alike] = np.maximum(largest[alike], _NEAR_ZERO * np.max(largest[alike]))
    # A coordinate that the stop holds at zero is rounding, if it is the only one of its unit.
    overall = float(np.max(largest)) or 1.0
    return np.where(largest > _ROUNDING * overall, largest, overall) * usual


@lru_cache(maxsize=64)
def _of_one_unit(units: tuple[str, ...]) -> tuple[Rows, ...]:
    """Return the places of each unit."""
    return tuple(
        np.array([k for k, other in enumerate(units) if other == unit], dtype=np.intp)
        for unit in dict.fromkeys(units)
    )


# ------------------------------------------------------------------ it repeats


@dataclass(frozen=True, slots=True, kw_only=True)
class Repetition:
    """A number of returns after which a motion comes back.

    Attributes:
        returns: How many.
        change: How near it comes, relative.
    """

    returns: int
    change: float


def changes(states: Sequence[Vector], scale: Vector) -> dict[int, float]:
    """Return how far the last state is from that `n` returns before, by `n`, relative."""
    last = states[-1]
    return {
        n: float(np.max(np.abs(last - states[-1 - n]) / scale)) for n in PERIODS if n < len(states)
    }


def repetitions(
    returns: Sequence[SectionReturn],
    units: Sequence[str],
    *,
    close: float,
    apart: float,
    usual: Vector | float = 1.0,
) -> tuple[Repetition, ...]:
    """Return the numbers of returns after which a motion repeats, the shortest first.

    Args:
        returns: Its last returns, in order.
        units: Unit of each state.
        close: Change that counts as repeating, relative.
        apart: It repeats after several returns only if these bring it nearer than any fewer do by
            this factor: a motion that throws over as it settles repeats after one.
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


# ------------------------------------------------------------------ it grows or dies out


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """Change of the amplitude of a motion.

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
    if amplitudes and amplitudes[-1] <= _FADED * max(amplitudes):
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


# ------------------------------------------------------------------ it rests


def is_still(rates: Vector, largest: Vector, rounding: Vector | float = 0.0) -> Flags:
    """Return which motions have stopped, ``(n,)``, as flags.

    Args:
        rates: Rates of all states but the clock, now and in the other phases of the clock,
            ``(n, n_phases, m)``: on its stop a link stands still while a current grows.
        largest: The largest that each motion has had, ``(n, m)``.
        rounding: Rates below this are zero, ``(m,)``.
    """
    limit = np.maximum(_STILL * largest, rounding)
    return np.asarray(np.all(np.abs(rates) <= limit[:, None, :], axis=(1, 2)))


def keeps_holding(multiplier: Vector, rate: Vector, step: float | Vector) -> Flags:
    """Return which stops never let go, ``(n,)``, as flags.

    The cubic through values and rates at neighbouring phases lies in the hull of its Bernstein
    coefficients; where all of these are positive the multiplier is.

    Args:
        multiplier: Of the stop at equal steps over a turn of the clock, both ends included,
            ``(n, n_phases)``; a single one where there is no clock.
        rate: Its time derivative there, ``(n, n_phases)``.
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
    """Return the largest modulus of each state of a motion that is not gone, ``(n_x,)``.

    Args:
        names: Name of each state.
        units: Unit of each.
        n_q: Number of coordinates; only these, and what is declared, have bounds.
        declared: Bounds by name: what the problem's `escapes` say.

    Returns:
        What is declared; ten turns for other angles; infinity for the rest, which `has_left` tells.
    """
    turns = [TEN_TURNS if unit == "rad" else math.inf for unit in units[:n_q]]
    usual = np.array([*turns, *([math.inf] * (len(names) - n_q))])
    return np.array([declared.get(name, bound) for name, bound in zip(names, usual, strict=True)])


def has_left(position: Vector, before: Vector) -> Flags:
    """Return which coordinates have left for good since the last return, as flags.

    Args:
        position: Where the motion is at the end of the time given, ``(n_q,)``.
        before: Largest modulus of each coordinate in the first half of that time, ``(n_q,)``.
    """
    return (before > 0.0) & (np.abs(position) > _LEFT * before)
