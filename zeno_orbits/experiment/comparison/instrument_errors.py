r"""Unknown gains and offsets of recorded channels, determined before a comparison with an orbit.

A track in pixels has an unknown scale and zero. A channel that reads :math:`g\,y + b` is laid over
the orbit in the orbit's own size and mean, and the regression of its samples on the orbit's values
at the same phases gives `g` and `b`. The comparison then sees the corrected channel: its size and
its mean are not evidence any more, but its shape is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, not_known
from zeno_orbits.experiment.comparison.estimate import Estimate
from zeno_orbits.experiment.comparison.instruments import (
    InstrumentReading,
    Instruments,
    ReadingKind,
    corrected,
    instruments_of,
    rough_errors,
)
from zeno_orbits.experiment.comparison.overlay import Overlay, lay_over, shared_signals
from zeno_orbits.experiment.orbit_table import ROUGHLY, beside_jumps
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit

_PHASES = 1000
_CYCLES = 2
"""Cycles whose scatter gives an error, at least."""


def without_errors(
    orbit: Orbit,
    problem: Problem,
    recording: Recording,
    readings: Sequence[InstrumentReading],
    titles: Sequence[str],
) -> tuple[Recording, Mapping[InstrumentReading, Estimate]]:
    """Return a recording without the gains and offsets of some channels, and these errors.

    Args:
        orbit: The orbit.
        problem: Its problem.
        recording: The recording.
        readings: The unknown gains and offsets.
        titles: Names of the contact channels of the machine.

    Returns:
        The corrected recording and the errors, or the recording itself and nothing if no period is
        seen.

    Raises:
        InputError: If a reading is that of a clock, or its channel was not recorded.
    """
    names = shared_signals(problem, recording, titles)
    for one in readings:
        if one.kind is ReadingKind.CLOCK_RATE:
            wanted = "may not name `clock_rate`, which an orbit's unknown period hides"
            raise InputError(f"Argument `fit` {wanted}: use `identify`.")
        if one.channel not in names:
            raise InputError(f"Argument `fit`: channel {not_known(one.channel, names)}")
    instruments = instruments_of([(one,) for one in readings], names)
    overlay = lay_over(orbit, problem, recording, names)
    if overlay is None:
        return recording, {}
    usual = overlay.table.at(np.arange(_PHASES) / _PHASES)[:, : len(names)]
    guess = rough_errors(instruments, names, overlay.values.T, usual)
    rough = np.array([guess[one] for one in readings])
    laid = lay_over(orbit, problem, corrected(recording, names, instruments, rough), names)
    if laid is None:
        return recording, {}
    found = _regressed(laid, overlay.values, instruments, readings)
    numbers = np.array([found[one].value for one in readings])
    return corrected(recording, names, instruments, numbers), found


def _regressed(
    laid: Overlay,
    recorded: Vector,
    instruments: Instruments,
    readings: Sequence[InstrumentReading],
) -> dict[InstrumentReading, Estimate]:
    """Return gains and offsets by least squares on the orbit's values at the phases of the samples.

    Args:
        laid: The overlay of the roughly corrected recording.
        recorded: The channels as they were recorded, ``(n_s, n_t)``.
        instruments: The errors that are unknown.
        readings: Their names.
    """
    turns = laid.where.phases(laid.time)
    usual = laid.table.at(np.mod(turns, 1.0))
    beside = beside_jumps(laid.table, turns, ROUGHLY)
    cycles = np.floor(turns).astype(np.int64)
    found: dict[InstrumentReading, Estimate] = {}
    for s, channel in enumerate(laid.names):
        kinds = [one.kind for one in readings if one.channel == channel]
        if not kinds:
            continue
        rows = np.isfinite(recorded[s]) & ~beside[:, s]
        known = 0.0 if instruments.gains[s].any() else usual[rows, s]
        columns = {ReadingKind.GAIN: usual[rows, s], ReadingKind.OFFSET: np.ones(int(rows.sum()))}
        design = np.stack([columns[kind] for kind in kinds], axis=1)
        values, errors = _least_squares(design, recorded[s, rows] - known, cycles[rows])
        for kind, value, error in zip(kinds, values.tolist(), errors.tolist(), strict=True):
            found[InstrumentReading(kind, channel)] = Estimate(value=value, error=error)
    return found


def _least_squares(
    design: Vector, rest: Vector, cycles: NDArray[np.signedinteger[Any]]
) -> tuple[Vector, Vector]:
    """Return a least-squares solution, and its errors by the scatter of the cycles.

    Args:
        design: ``(n, k)``.
        rest: ``(n,)``.
        cycles: Number of the cycle of each row, ``(n,)``.
    """
    inverse = np.linalg.pinv(design.T @ design)
    solved = inverse @ (design.T @ rest)
    left = design * (rest - design @ solved)[:, None]
    _, place = np.unique(cycles, return_inverse=True)
    n = int(place.max()) + 1
    if n < _CYCLES:
        return solved, np.full(len(solved), math.nan)
    sums = np.stack([np.bincount(place, weights=row, minlength=n) for row in left.T], axis=1)
    covariance = inverse @ (sums.T @ sums) @ inverse * n / (n - 1)
    return solved, np.sqrt(np.diag(covariance))
