"""A second motion for comparison with the model's motion: from a virtual rig or a recording.

It holds only values: states over time since a release, and a label. The motion of a rig is always
labelled as simulated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.overlay import lay_over, shared_signals
from zeno_orbits.experiment.recordings.recording import Recording, crop_recording
from zeno_orbits.experiment.rig import settle_rig
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import Progress, silent

RIG = "virtual rig, simulated"
"""Label of a rig's motion in all outputs."""

_BASE = 1.0 / 500.0
"""Part of the period to either side over which missing velocities are differences."""
_LATE = 2
"""Factor of the requested cycles plus one: length of a recording's end that determines its
phase."""
_SLACK = 0.01
"""Part of a period that a recording may begin after a release, or end before one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchedRun:
    """A motion for comparison with the model's motion.

    Attributes:
        label: Label for a legend.
        times: Times since a release, increasing, ``(n,)`` [s].
        states: States of the problem, ``(n, n_x)``. Unknown values are NaN.
        period: Period of the motion [s].
    """

    label: str
    times: Vector
    states: Vector
    period: float


def counterpart_of(
    label: str,
    problem: Problem,
    times: Vector,
    signals: Mapping[str, Vector],
    period: float,
    *,
    base: float = 0.0,
) -> MatchedRun:
    """Return a motion from its signals. Missing velocities are computed as differences.

    Args:
        label: Label for a legend.
        problem: The problem.
        times: Increasing times, ``(n,)`` [s].
        signals: Values by state name, ``(n,)``. Signals with other names are ignored.
        period: Period of the motion [s].
        base: Half width of a difference, at least a sample [s]. A difference over a single step
            would show only the resolution of an encoder.

    Raises:
        InputError: If a coordinate is missing.
    """
    names = problem.state_names
    n_q = problem.model(problem.symbols()).n_q
    missing = [name for name in names[:n_q] if name not in signals]
    if missing:
        wanted = f"must hold the coordinates {', '.join(names[:n_q])}"
        raise InputError(f"Argument `data` {wanted}, but `{missing[0]}` is missing.")
    states = np.full((len(times), len(names)), math.nan)
    for k, name in enumerate(names):
        if name in signals:
            states[:, k] = signals[name]
        elif n_q <= k < 2 * n_q:
            states[:, k] = _differences(times, states[:, k - n_q], base)
    return MatchedRun(label=label, times=times, states=states, period=period)


def rig_counterpart(
    orbit: Orbit,
    problem: Problem,
    n_periods: int,
    on_progress: Progress = silent,
) -> MatchedRun:
    """Return the settled cycles of the problem's virtual rig, at the orbit's parameters.

    Args:
        orbit: The orbit.
        problem: Its problem.
        n_periods: Number of cycles.
        on_progress: Called with the part of the time that is simulated.

    Raises:
        SimulationError: If the rig does not move in such cycles.
    """
    settled = settle_rig(orbit, problem, cycles=n_periods, on_progress=on_progress)
    run = settled.run
    signals = {name: run.of(name) for name in problem.state_names if name in run.state_names}
    # A contact is recorded at its first and last instant twice: once from either side.
    kept = np.concatenate([[True], np.diff(run.times) > 0.0])
    held = {name: values[kept] for name, values in signals.items()}
    period = float(np.mean([cycle.period for cycle in settled.cycles]))
    return counterpart_of(RIG, problem, run.times[kept], held, period)


def recording_counterpart(
    recording: Recording, orbit: Orbit, problem: Problem, n_periods: int
) -> MatchedRun:
    """Return the last whole cycles of a recording, from the release found by the alignment.

    The time is shifted and not scaled. Only the end of the recording is used, because the machine
    may settle before.

    Args:
        recording: The recording.
        orbit: The orbit to align with.
        problem: Its problem.
        n_periods: Largest number of cycles to keep.

    Raises:
        InputError: If the recording lacks a coordinate, is too short, or cannot be aligned with the
            orbit.
        SimulationError: If the orbit is not periodic in simulation.
    """
    whole = float(recording.time[-1] - recording.time[0])
    if whole < 2 * orbit.period:
        wanted = f"must last two periods, {2 * orbit.period:.4g} s, at least"
        raise InputError(f"Argument `data` {wanted}, but it lasts {whole:.4g} s.")
    late = recording.time[-1] - _LATE * (n_periods + 1) * orbit.period
    end, names = crop_recording(recording, late, None), shared_signals(problem, recording)
    overlay = lay_over(orbit, problem, end, names)
    if overlay is None:
        # A wrong unit of time makes the end too short, and the whole recording reveals the mistake.
        end, overlay = recording, lay_over(orbit, problem, recording, names)
    if overlay is None or not overlay.holds:
        why = overlay.reasons()[0] if overlay else "it lacks a recognizable period"
        raise InputError(
            f"Argument `data` must show an orbit of the problem, but {why}. See `compare`."
        )
    where = overlay.where
    kept, start = _last_cycles(end.time, where, n_periods)
    signals = {signal.name: signal.values for signal in end.signals}
    base = where.period * _BASE
    found = counterpart_of(end.label, problem, end.time, signals, where.period, base=base)
    return replace(found, times=found.times[kept] - start, states=found.states[kept])


def _last_cycles(time: Vector, where: Alignment, n_periods: int) -> tuple[slice, float]:
    """Return the samples of at most so many last whole cycles, and the start of the first one."""
    phases = where.phases(time)
    first, last = math.ceil(phases[0] - _SLACK), math.floor(phases[-1] + _SLACK)
    first = max(first, last - n_periods)
    if first >= last:
        raise InputError("Argument `data` lacks a whole cycle from release to release.")
    begin, after = np.searchsorted(phases, [first, last])
    return slice(int(begin), int(after)), where.release + first * where.period


def _differences(times: Vector, values: Vector, base: float) -> Vector:
    """Return the slope from some samples before to as many after, fewer at the ends."""
    reach = max(1, round(base / float(np.median(np.diff(times)))))
    rows = np.arange(len(times))
    before, after = np.maximum(rows - reach, 0), np.minimum(rows + reach, len(times) - 1)
    return (values[after] - values[before]) / (times[after] - times[before])
