"""Falls of the guards of many lanes inside a step: `integrators.events` in rows.

Every value is the guard at the end of a true, shorter step from the same start, so a root needs no
polish, and none is looked for at the start of a lane that begins on its guard.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zeno_orbits.arrays import Rows, Vector
from zeno_orbits.integrators.events import (
    FRACTIONS,
    HALVINGS,
    TINY,
    inner_coefficients,
    is_cubic,
)
from zeno_orbits.simulation.batch.lanes import Mask, true_rows

Dense = Callable[[Rows, Vector], Vector]
"""From rows and offsets in their steps to guards and their rates there, ``(n, 2)``."""

_SQUARED = 1e-10
"""After a correction of this part of the step, Newton's next one is rounding."""
_MOST = 100
"""Evaluations of a root search; bisection alone needs half of them."""
_GUESSES = 5
"""Newton steps on the cubic through the ends: a guess, so their number hardly matters."""


def may_fall(size: Vector, before: Vector, after: Vector, on_guard: Mask) -> Mask:
    """Return which guards may have fallen through zero within their steps, ``(n,)``.

    The cubic through values and rates at both ends lies in the hull of its Bernstein coefficients.

    Args:
        size: Of the steps, ``(n,)``.
        before: Guard and its rate at the starts, ``(n, 2)``.
        after: The same at the ends.
        on_guard: Whether the start is on the guard, a root that does not count.
    """
    second, third = inner_coefficients(size, before.T, after.T)
    started = (before[:, 0] > 0.0) | (on_guard & (before[:, 0] == 0.0) & (before[:, 1] > 0.0))
    dips = (before[:, 1] < 0.0) & (after[:, 1] > 0.0)
    return ~(started & (second > 0.0) & (third > 0.0) & (after[:, 0] > 0.0) & ~dips)


def first_falls(
    dense: Dense, size: Vector, before: Vector, after: Vector, on_guard: Mask
) -> Vector:
    """Return where in their steps the guards of all rows first fall, NaN where they do not.

    Args:
        dense: The guards inside the steps.
        size: As for `may_fall`.
        before: As for `may_fall`.
        after: As for `may_fall`.
        on_guard: As for `may_fall`.
    """
    n = len(size)
    second, third = inner_coefficients(size, before.T, after.T)
    once = ~on_guard & (before[:, 0] > 0.0) & (after[:, 0] < 0.0) & ((second > 0) | (third < 0))
    rows = true_rows(once)
    if len(rows):
        middle = dense(rows, size[rows] / 2)[:, 0]
        once[rows[~is_cubic(middle, size[rows], before[rows].T, after[rows].T)]] = False
    left, low = np.zeros(n), before.copy()
    right, high = size.copy(), after.copy()
    bracketed = once.copy()
    _search(dense, true_rows(~once), (left, low, right, high), bracketed, on_guard, size)
    rows = true_rows(bracketed)
    falls = np.full(n, np.nan)
    falls[rows] = _roots(dense, rows, left[rows], low[rows], right[rows], high[rows])
    return falls


def _search(
    dense: Dense,
    rows: Rows,
    bracket: tuple[Vector, Vector, Vector, Vector],
    bracketed: Mask,
    on_guard: Mask,
    size: Vector,
) -> None:
    """Look at eighths of the steps and write the first bracket of a fall, or of a short rise."""
    left, low, right, high = bracket
    if not len(rows):
        return
    armed = ~on_guard[rows]
    at, here = np.zeros(len(rows)), low[rows].copy()
    end = high[rows].copy()
    open_ = np.ones(len(rows), dtype=bool)
    offsets = np.array([*FRACTIONS, 1.0])[:, None] * size[rows]
    # One call for all eighths: a call costs as much as many rows.
    inside = dense(np.tile(rows, len(FRACTIONS)), offsets[:-1].ravel())
    pairs = np.concatenate([inside, end]).reshape(len(FRACTIONS) + 1, len(rows), 2)
    for offset, pair in zip(offsets, pairs, strict=True):
        falls = open_ & armed & (pair[:, 0] < 0.0)
        dips = open_ & armed & ~falls & (here[:, 1] < 0.0) & (pair[:, 1] > 0.0)
        dips &= ~_stays_above(here, pair, offset - at)
        to, value = offset.copy(), pair.copy()
        for k in true_rows(dips).tolist():
            to[k], value[k] = _lowest(dense, rows[k], at[k], offset[k])
            falls[k] = value[k, 0] < 0.0
        found = rows[falls]
        left[found], low[found] = at[falls], here[falls]
        right[found], high[found] = to[falls], value[falls]
        bracketed[found] = True
        open_ &= ~falls
        armed |= pair[:, 0] > 0.0
        at, here = offset, pair
    for k in true_rows(~armed & (end[:, 0] < 0.0)).tolist():
        _short_rise(dense, rows[k], bracket, bracketed)


def _lowest(dense: Dense, row: int, left: float, right: float) -> tuple[float, Vector]:
    """Return where in between a guard that falls and then rises is negative, and its value there.

    If it is nowhere negative, so is the value.
    """
    rows = np.array([row])
    pair = np.zeros(2)
    for _ in range(HALVINGS):
        middle = (left + right) / 2
        pair = dense(rows, np.array([middle]))[0]
        if pair[0] < 0.0:
            return middle, pair
        if pair[1] < 0.0:
            left = middle
        else:
            right = middle
        if pair[0] > abs(pair[1]) * (right - left):
            break
    return left, pair


def _stays_above(left: Vector, right: Vector, width: Vector) -> Mask:
    """Tell where a guard that falls and then rises stays positive: a tangent lies below it."""
    return (left[:, 0] > -left[:, 1] * width) | (right[:, 0] > right[:, 1] * width)


def _short_rise(
    dense: Dense, row: int, bracket: tuple[Vector, Vector, Vector, Vector], bracketed: Mask
) -> None:
    """Write the bracket of the fall after a rise from the guard far shorter than the step."""
    left, low, right, high = bracket
    rows = np.array([row])
    to, value = right[row], high[row].copy()
    for _ in range(HALVINGS):
        at = to / 2
        pair = dense(rows, np.array([at]))[0]
        if pair[0] > 0.0:
            left[row], low[row], right[row], high[row] = at, pair, to, value
            bracketed[row] = True
            return
        to, value = at, pair


def _roots(
    dense: Dense, rows: Rows, left: Vector, low: Vector, right: Vector, high: Vector
) -> Vector:
    """Return the roots of guards that are positive at the left and negative at the right."""
    size = right - left
    at = left + size * _hermite_root(low[:, 0], size * low[:, 1], high[:, 0], size * high[:, 1])
    last = size.copy()
    open_ = np.arange(len(rows))
    left, right = left.copy(), right.copy()
    for _ in range(_MOST):
        if not len(open_):
            break
        pair = dense(rows[open_], at[open_])
        value, rate = pair[:, 0], pair[:, 1]
        above = value > 0.0
        left[open_[above]] = at[open_[above]]
        right[open_[~above]] = at[open_[~above]]
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.where(value == 0.0, 0.0, -value / rate)
        inside = (at[open_] + change >= left[open_]) & (at[open_] + change <= right[open_])
        newton = inside & (np.abs(change) < last[open_] / 2)
        # A last Newton step may leave the bracket by rounding: it is put back.
        done = (np.abs(change) <= _SQUARED * size[open_]) & (rate < 0.0)
        middle = (left[open_] + right[open_]) / 2
        target = np.where(newton | done, at[open_] + change, middle)
        last[open_] = np.where(newton, np.abs(change), (right[open_] - left[open_]) / 2)
        at[open_] = np.clip(target, left[open_], right[open_])
        rounding = TINY * np.maximum(size[open_], right[open_])
        done |= right[open_] - left[open_] <= rounding
        open_ = open_[~done]
    return at


def _hermite_root(low: Vector, low_rate: Vector, high: Vector, high_rate: Vector) -> Vector:
    """Return about where in ``[0, 1]`` the cubic with these ends falls through zero."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        place = low / (low - high)
        square = -3 * low - 2 * low_rate + 3 * high - high_rate
        cube = 2 * low + low_rate - 2 * high + high_rate
        left, right = np.zeros_like(place), np.ones_like(place)
        for _ in range(_GUESSES):
            value = low + place * (low_rate + place * (square + place * cube))
            slope = low_rate + place * (2 * square + 3 * place * cube)
            left, right = np.where(value > 0, place, left), np.where(value > 0, right, place)
            better = place - value / slope
            inside = (better >= left) & (better <= right)
            place = np.where(inside, better, (left + right) / 2)
    return place
