r"""Measured inputs: samples over time as a force, a voltage, a set point or a moving ground.

A record is a table of time. It runs once over a `Time` and is held at its ends, or it is repeated
with a period over a `Clock`, one turn of which is the period.

A cell of the phase :math:`\varphi` around :math:`m` is a polynomial of

.. math:: \delta = \arcsin(s \cos m - c \sin m) = \varphi - m,\qquad (c, s) = (\cos\varphi,
    \sin\varphi)

so the input is smooth at the end of a turn, where an angle jumps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, shown
from zeno_orbits.integrators import TABLE_HEAD, CellTable
from zeno_orbits.model.clock import Clock, Time
from zeno_orbits.model.expressions.spans import reach, reach_of_cells
from zeno_orbits.model.expressions.tables import finite, held_in_doubles, horner, numbers_in, table
from zeno_orbits.work import ByValue, checked

_TURN = 2 * math.pi
_FEWEST = 16
"""Cells of a turn at least: the arc sine of half a cell is far from its ends."""
_SAME = 1e-9
"""Relative difference of two periods, and of the first and last sample, that is rounding."""
_MOST = 2_000_000
"""Number of samples of a record at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record(ByValue):
    """A measured input: samples at given times.

    Attributes:
        time: Times of the samples, increasing, ``(n,)`` [s].
        samples: The samples, ``(n,)``, in SI units.
        period: Period with which the record is repeated [s], or ``None`` for a record that is held
            at its ends.
        kind: Course between samples: ``linear``, ``cubic`` or ``monotone``.
        name: Name in messages.
    """

    time: Vector
    samples: Vector
    period: float | None = None
    kind: str = "linear"
    name: str = "record"

    @property
    def frequency(self) -> float:
        """The frequency of a clock that turns once per period [rad/s].

        Raises:
            InputError: If the record lacks a period.
        """
        if self.period is None:
            raise InputError(
                f"Argument `period` of the record `{self.name}` is missing: with a clock, "
                "a record must be periodic."
            )
        return _TURN / self.period

    @checked
    def at(self, clock: Clock | Time) -> ca.SX:
        """Return the record as a formula of a clock.

        Args:
            clock: A `Time` for a record without a period, or a `Clock` with the record's
                ``frequency`` for a record that is repeated.

        Raises:
            InputError: If the clock does not fit the record.
        """
        if isinstance(clock, Time):
            if self.period is not None:
                raise InputError(
                    f"Argument `clock`: the record `{self.name}` is repeated and needs "
                    "`zo.Clock.at(record.frequency)`, but it is a `zo.Time`."
                )
            return table(
                clock.state, self.time, self.samples, self.kind, outside="hold", name=self.name
            )
        frequency = ca.SX(clock.frequency)
        off = float(frequency) / self.frequency - 1.0 if frequency.is_constant() else math.inf
        if not abs(off) < _SAME:
            raise InputError(
                f"Argument `clock` must turn once in {self.period:g} s, the period of the record "
                f"`{self.name}`, but its frequency is {frequency}: use `record.frequency`."
            )
        return _repeated(self, clock)


@checked
def record(
    time: Sequence[float] | Vector,
    samples: Sequence[float] | Vector,
    *,
    period: float | None = None,
    kind: str = "linear",
    name: str = "record",
) -> Record:
    """Return a measured input.

    A linear or monotone record has an event without a reset at every sample, a cubic record has
    none.

    Args:
        time: Times of the samples, increasing, ``(n,)`` [s], up to two million of them.
        samples: The samples in SI units, ``(n,)``.
        period: Period with which the record is repeated [s]. Its last sample must be the first one
            if they are one period apart. Without a period the ends are held.
        kind: Course between samples: ``linear``, ``cubic`` or ``monotone``.
        name: Name in messages.

    Raises:
        InputError: If times do not increase, a number is not finite, or the period is shorter than
            the record.
    """
    try:
        return _checked(
            Record(
                time=numbers_in(time, "time", 1),
                samples=numbers_in(samples, "samples", 1),
                period=period,
                kind=kind,
                name=name,
            )
        )
    except ValueError as error:
        raise InputError(str(error)) from None


def _checked(given: Record) -> Record:
    """Return a record that is sound, closed if it is repeated.

    Raises:
        ValueError: If it is not sound.
    """
    time, samples, n = given.time, given.samples, len(given.time)
    if given.kind not in ("linear", "cubic", "monotone"):
        raise ValueError(
            "Argument `kind` must be 'linear', 'cubic' or 'monotone', but it is "
            f"{shown(given.kind)}."
        )
    least = 4 if given.kind == "cubic" else 2
    if not least <= n <= _MOST:
        raise ValueError(
            f"Argument `time` of a {given.kind} record must hold {least} to {_MOST} times, but it "
            f"holds {n}."
        )
    if len(samples) != n:
        raise ValueError(
            f"Arguments `time` and `samples` must fit, but there are {n} times and {len(samples)} "
            "samples."
        )
    for k in np.flatnonzero(np.diff(time) <= 0.0)[:1].tolist():
        raise ValueError(
            f"Argument `time` must increase, but entry {k + 1} ({time[k + 1]:g} s) is not above "
            f"entry {k} ({time[k]:g} s)."
        )
    if given.period is None:
        return given
    return _closed(given, given.period)


def _closed(given: Record, period: float) -> Record:
    """Return a repeated record with its first sample once more at the end.

    Raises:
        ValueError: If the record does not fit its period.
    """
    time, samples = given.time, given.samples
    span = float(time[-1] - time[0])
    if not (math.isfinite(period) and period > 0.0):
        raise ValueError(f"Argument `period` must be positive and finite, but it is {period:g} s.")
    if span > period * (1.0 + _SAME):
        raise ValueError(
            f"Argument `period` must not be shorter than the record ({span:g} s), but it is "
            f"{period:g} s."
        )
    if span < period * (1.0 - _SAME):
        time, samples = np.append(time, time[0] + period), np.append(samples, samples[0])
    elif abs(samples[-1] - samples[0]) > _SAME * float(np.max(np.abs(samples))):
        raise ValueError(
            f"Argument `samples` of a repeated record must end where it begins, but it begins with "
            f"{samples[0]:g} and ends with {samples[-1]:g} one period later."
        )
    else:
        samples = np.append(samples[:-1], samples[0])
    return Record(time=time, samples=samples, period=period, kind=given.kind, name=given.name)


def _repeated(given: Record, clock: Clock) -> ca.SX:
    """Return a record as a table of the phase of a clock."""
    period = float(given.period or 0.0)
    phases = (given.time - given.time[0]) * (_TURN / period)
    from scipy.interpolate import CubicSpline, PchipInterpolator, PPoly

    is_kinked = given.kind != "cubic"
    if given.kind == "cubic":
        made = held_in_doubles(CubicSpline, phases, given.samples, bc_type="periodic")
    elif given.kind == "monotone":
        # The slope at a sample depends on its neighbours alone, also across the end of a turn.
        around = np.concatenate([[phases[-2] - _TURN], phases, [phases[1] + _TURN]])
        samples = given.samples[[-2, *range(len(phases)), 1]]
        made = held_in_doubles(PchipInterpolator, around, samples)
    else:
        with np.errstate(all="ignore"):
            slopes = np.diff(given.samples) / np.diff(phases)
        made = PPoly(finite(np.stack([slopes, given.samples[:-1]])), phases)
    offset = float(np.mod(given.time[0] / period, 1.0)) * _TURN
    knots = _knots(phases, offset, is_kinked=is_kinked)
    middles, halves = (knots[1:] + knots[:-1]) / 2, np.diff(knots) / 2
    at = np.mod(middles - offset, _TURN)
    order = made.c.shape[0]
    rows = [made(at, nu=k) / math.factorial(k) for k in range(order)]
    if is_kinked:
        lengths = reach_of_cells(knots, turns=True)
    else:
        lengths = reach(knots, _from_knots(np.array(rows), halves)[:, :, None], turns=True)
    quarter = np.tan(halves / 2)
    guard = np.stack([np.cos(middles), np.sin(middles), quarter, 1.0 / quarter])
    cells = CellTable(
        name=f"the record `{given.name}`",
        knots=knots,
        columns=np.vstack([guard, 2 * halves, lengths[0] + halves, lengths[1] - halves, *rows]),
        is_kinked=is_kinked,
        turns=True,
    )
    found = cells.numbers_of(cells.cell(clock.cosine, clock.sine))
    way = ca.asin(clock.sine * found[0] - clock.cosine * found[1])
    return horner(found[TABLE_HEAD:], way)


def _from_knots(rows: Vector, halves: Vector) -> Vector:
    """Return coefficients in powers of the way from the knot in place of the middle of a cell."""
    moved = np.zeros_like(rows)
    for k, one in enumerate(rows):
        for j in range(k + 1):
            moved[j] += math.comb(k, j) * one * (-halves) ** (k - j)
    return moved


def _knots(phases: Vector, offset: float, *, is_kinked: bool) -> Vector:
    """Return the knots of a turn from 0 to its end: an even number of cells, none of them wide.

    A knot that is added inside of a cell changes nothing but the number of events.
    """
    inner = np.mod(phases[:-1] + offset, _TURN)
    kept = np.sort(inner)
    near = _SAME * float(np.min(np.diff(phases)))
    kept = kept[(kept > near) & (kept < _TURN - near)]
    knots = np.concatenate([[0.0], kept, [_TURN]])
    parts = np.ceil(np.diff(knots) / (_TURN / _FEWEST)).astype(int)
    if is_kinked and parts.sum() % 2:
        parts[int(np.argmax(np.diff(knots) / parts))] += 1
    pieces: list[Vector] = [knots[:-1]]
    if parts.max() > 1:
        cells: Any = zip(knots[:-1].tolist(), knots[1:].tolist(), parts.tolist(), strict=True)
        pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in cells]
    return np.append(np.concatenate(pieces), _TURN)
