r"""Periodic inputs of a forced machine: levels that switch at given times, and harmonics.

Both are formulas of the clock :math:`(c, s) = (\cos\omega t, \sin\omega t)`, so an input is right
from every phase. A piecewise input has kinks, and the kinks of a machine are its switches.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import casadi as ca

from zeno_orbits.errors import SwitchingTimesError
from zeno_orbits.model.clock import Clock
from zeno_orbits.work import checked

Formula = ca.SX | float
"""A number, or a formula of gains and parameters."""

_DEPTH = 32
"""Depth to which two levels are compared."""
LEAST_PART = 2e-10
"""Part of the period between two switching times at least. The phase has an error of 1e-16 periods,
so an impulse of this length is exact to 1e-6."""


@checked
def piecewise(clock: Clock, levels: Sequence[Formula], times: Sequence[Formula]) -> ca.SX:
    r"""Return a periodic input with constant levels between switching times.

    Let :math:`T = 2\pi/\omega` be the period of the clock and :math:`0 < t_1 < \dots < t_n < T`.
    All of these times are apart by at least ``2e-10 T``. The input is `levels[0]` until
    :math:`t_1`, `levels[k]` until :math:`t_{k+1}`, and `levels[n]` until `T`. It switches at 0 too,
    unless the first and the last level are the same formula.

    Half of the switches open an interval and half of them close one. Switch `i` of `2 h` opens the
    interval up to switch `i + h`, with middle `m` and half length `a` in phase. Its condition

    .. math:: (\tan(a/2)\,|z + z_m|^2 - \cot(a/2)\,|z - z_m|^2)/4 > 0,\qquad z = (c, s)

    compares the distances from the middle :math:`z_m = (\cos m, \sin m)` and from the opposite
    phase. On the circle it equals :math:`(\cos(\omega t - m) - \cos a) / \sin a`, but it has no
    digits to lose in a short interval. It is zero at its two ends only, with slopes of one, and a
    small error of the radius does not move them. So every switch changes one condition, and the
    conditions determine the level. An odd number of switches is completed by one without effect in
    the middle of the last level.

    Args:
        clock: The clock.
        levels: Value of each level, a number or a formula, ``(n + 1,)``.
        times: Switching times, numbers or formulas of gains and parameters, ``(n,)`` [s].

    Raises:
        ValueError: If the numbers of levels and times do not fit, a time depends on the clock, or
            times that are numbers do not increase.
    """
    values, between = [ca.SX(one) for one in levels], [ca.SX(one) for one in times]
    if not between or len(values) != len(between) + 1:
        raise ValueError(
            "Argument `levels` must have one entry more than `times`, and `times` at least one, "
            f"but they have {len(values)} and {len(between)}."
        )
    if any(not one.is_scalar() for one in (*values, *between)):
        raise ValueError("Arguments `levels` and `times` must hold scalars only.")
    if any(ca.depends_on(one, clock.state) for one in between):
        raise ValueError("Argument `times` must hold numbers, gains and parameters only.")
    period = clock.period
    bounds = [ca.SX(0), *between, period]
    for lower, upper in pairwise(bounds):
        for late in (upper <= lower, upper - lower < LEAST_PART * period):
            if late.is_constant() and float(late):
                raise ValueError(_out_of_order(lower, upper, float(lower), float(upper)))
    instants = list(between)
    if not ca.is_equal(values[0], values[-1], _DEPTH):
        instants.insert(0, ca.SX(0))
    else:
        # The level from the last switch goes on to the first switch of the next period.
        values = values[1:]
    if len(instants) % 2:
        instants.append((instants[-1] + instants[0] + period) / 2)
        values.append(values[-1])
    value = _selected(clock, values, instants)
    for lower, upper in pairwise(bounds):
        value = ca.if_else(upper <= lower, math.nan, value)
    return value


def _selected(clock: Clock, values: Sequence[ca.SX], instants: Sequence[ca.SX]) -> ca.SX:
    """Return the level after the last of an even number of instants: `values[k]` after `k`."""
    half = len(instants) // 2
    inside = [_inside(clock, instants[i], instants[i + half]) for i in range(half)]
    # Intervals open in turn, then close in turn.
    opened, closing = values[0], values[-1]
    for i in range(1, half):
        opened = ca.if_else(inside[i], values[i], opened)
    for i in range(half - 1, 0, -1):
        closing = ca.if_else(inside[i], values[half + i - 1], closing)
    return ca.if_else(inside[0], opened, closing)


def _inside(clock: Clock, start: ca.SX, end: ca.SX) -> ca.SX:
    """Return the condition that the clock is between two times."""
    middle, length = clock.frequency * (start + end) / 2, clock.frequency * (end - start) / 2
    phase = ca.vertcat(ca.cos(middle), ca.sin(middle))
    far, near = ca.sumsqr(clock.state + phase), ca.sumsqr(clock.state - phase)
    half = ca.tan(length / 2)
    return (half * far - near / half) / 4 > 0


@checked
def harmonics(clock: Clock, amplitudes: Sequence[tuple[Formula, Formula]]) -> ca.SX:
    r"""Return a sum of harmonics of a clock.

    .. math:: \sum_{k=1}^{n} a_k \cos k\omega t + b_k \sin k\omega t

    Args:
        clock: The clock.
        amplitudes: Pairs :math:`(a_k, b_k)` from the first harmonic on, numbers or formulas.

    Raises:
        ValueError: If amplitudes are missing, or an entry is not a pair.
    """
    try:
        pairs = [(a, b) for a, b in amplitudes]
    except (TypeError, ValueError):
        pairs = []
    if not pairs:
        raise ValueError(
            "Argument `amplitudes` must hold a pair of a cosine's and a sine's amplitude for every "
            "harmonic."
        )
    total, cosine, sine = ca.SX(0), ca.SX(1), ca.SX(0)
    for a, b in pairs:
        cosine, sine = (
            cosine * clock.cosine - sine * clock.sine,
            sine * clock.cosine + cosine * clock.sine,
        )
        total += a * cosine + b * sine
    return total


# The order of switching times at given numbers.


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeOrder:
    """Two times of a piecewise input, of which the lower must be below the upper.

    Attributes:
        lower: The lower time [s].
        upper: The upper time [s].
    """

    lower: ca.SX
    upper: ca.SX

    def require(self, lower: float, upper: float, least: float) -> None:
        """Refuse times out of order.

        Args:
            lower: Value of the lower time [s].
            upper: Value of the upper time [s].
            least: Least value of the upper time [s].

        Raises:
            SwitchingTimesError: If the times do not increase by the least part of the period.
        """
        if not upper > least:
            message = _out_of_order(self.lower, self.upper, lower, upper)
            raise SwitchingTimesError(message, lower, upper)


def _out_of_order(lower: ca.SX, upper: ca.SX, low: float, high: float) -> str:
    if high > low:
        return (
            f"Argument `times` of a waveform must be at least {LEAST_PART:g} of its period apart, "
            f"but {_told(upper, high)} is only {high - low:.2g} s above {_told(lower, low)}."
        )
    return (
        "Argument `times` of a waveform must increase from 0 to its period, but "
        f"{_told(upper, high)} is not above {_told(lower, low)}."
    )


def _told(time: ca.SX, value: float) -> str:
    number = f"{value:.6g} s"
    return number if time.is_constant() else f"`{time}` = {number}"


def time_orders(formulas: Sequence[ca.SX]) -> tuple[TimeOrder, ...]:
    """Return the orders of times that piecewise inputs in formulas require.

    Args:
        formulas: The formulas of a machine.
    """
    found: dict[tuple[int, int], TimeOrder] = {}
    for late in _undefined_where(formulas):
        if late.op() == ca.OP_LE:
            upper, lower = late.dep(0), late.dep(1)
            found[upper.element_hash(), lower.element_hash()] = TimeOrder(lower=lower, upper=upper)
    return tuple(found.values())


def _undefined_where(formulas: Sequence[ca.SX]) -> Iterator[ca.SX]:
    """Yield the conditions under which a formula is NaN, as `piecewise` writes them."""
    seen: set[int] = set()
    waiting: list[Any] = [entry for one in formulas for entry in ca.SX(one).nonzeros()]
    while waiting:
        node = waiting.pop()
        if node.element_hash() in seen or node.is_leaf():
            continue
        seen.add(node.element_hash())
        parts = [node.dep(k) for k in range(node.n_dep())]
        if (
            node.op() == ca.OP_IF_ELSE_ZERO
            and parts[1].is_constant()
            and math.isnan(float(parts[1]))
        ):
            yield parts[0]
        waiting += parts
