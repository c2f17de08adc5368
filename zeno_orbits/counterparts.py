"""Another motion to lay beside that of the model: a virtual rig's, or a recording's.

Values only: states over time, counted from a release, and a word for what they are. What a rig
gave is always called simulated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeno_orbits.dynamics import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.execution import Execution
from zeno_orbits.orbit import ZenoOrbit
from zeno_orbits.problem import Problem
from zeno_orbits.recordings import read_recording
from zeno_orbits.rig import rig_cycles

RIG = "virtual rig, simulated"
"""What a rig's motion is called, wherever it is shown."""

_PHASES = 720
"""Phases that are tried to lay a recording over an orbit."""
_BASE = 1.0 / 500.0
"""Part of the period to either side over which missing velocities are differences."""
_MOST = 20000
"""Rows of a recording that are looked at for its phase."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Counterpart:
    """A motion beside the model's.

    Attributes:
        label: What it is, for a legend.
        times: Since a release, increasing, ``(n,)`` [s].
        states: States of the scene, ``(n, n_x)``; NaN where they are not known.
    """

    label: str
    times: Vector
    states: Vector


def counterpart_of(
    label: str,
    problem: Problem,
    times: Vector,
    signals: Mapping[str, Vector],
    *,
    base: float = 0.0,
) -> Counterpart:
    """Return a motion from its signals; velocities that are missing are differences.

    Args:
        label: What it is.
        problem: The scene.
        times: Increasing, ``(n,)`` [s].
        signals: State name to values, ``(n,)``; what is no state of the scene is left out.
        base: How far to either side a difference reaches, a sample at least [s]. Over a single
            step an encoder's own steps are all that is seen.

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
    return Counterpart(label=label, times=times, states=states)


def rig_counterpart(
    orbit: ZenoOrbit,
    problem: Problem,
    n_periods: int,
    on_progress: Callable[[float], None] | None = None,
) -> Counterpart:
    """Return the cycles that the scene's virtual rig settles to, at the orbit's numbers.

    Args:
        orbit: The orbit.
        problem: Its scene.
        n_periods: How many cycles.
        on_progress: Told of the part that is done, now and then.

    Raises:
        SimulationError: If the rig does not move in such cycles.
    """
    run = rig_cycles(orbit, problem, cycles=n_periods, on_progress=on_progress).run
    signals = {name: run.of(name) for name in problem.state_names if name in run.state_names}
    # A contact is recorded at its first and last instant twice: once from either side.
    kept = np.concatenate([[True], np.diff(run.times) > 0.0])
    held = {name: values[kept] for name, values in signals.items()}
    return counterpart_of(RIG, problem, run.times[kept], held)


def recording_counterpart(
    path: Path, problem: Problem, execution: Execution, period: float, n_periods: int
) -> Counterpart:
    """Return the last periods of a recording, in phase with the model.

    Args:
        path: Of the recording's file.
        problem: The scene.
        execution: The model's motion from its release on, a period at least.
        period: Of the model [s].
        n_periods: How many to keep at most.

    Raises:
        InputError: If it cannot be read, lacks a coordinate or is too short.
    """
    found = read_recording(path, only=problem.state_names)
    signals = {signal.name: signal.values for signal in found.signals}
    base = period * _BASE
    whole = counterpart_of(found.label, problem, found.time, signals, base=base)
    n_q = problem.model(problem.symbols()).n_q
    return in_phase(whole, n_q, execution, period, n_periods)


def _differences(times: Vector, values: Vector, base: float) -> Vector:
    """Return the slope from some samples before to as many after, fewer at the ends."""
    reach = max(1, round(base / float(np.median(np.diff(times)))))
    rows = np.arange(len(times))
    before, after = np.maximum(rows - reach, 0), np.minimum(rows + reach, len(times) - 1)
    return (values[after] - values[before]) / (times[after] - times[before])


def in_phase(
    counterpart: Counterpart, n_q: int, execution: Execution, period: float, n_periods: int
) -> Counterpart:
    """Return the last periods of a motion, counted from where its phase fits the model's best.

    The phase is that at which the coordinates, each over its own spread, are nearest in the mean
    square. Time is moved and not stretched.

    Args:
        counterpart: The motion.
        n_q: Number of coordinates.
        execution: The model's motion from its release on, a period at least.
        period: Of the model [s].
        n_periods: How many to keep at most.

    Raises:
        InputError: If the motion is shorter than two periods.
    """
    times = counterpart.times
    if times[-1] - times[0] < 2 * period:
        message = f"must last two periods, {2 * period:.4g} s, at least"
        raise InputError(f"Argument `data` {message}, but it lasts {times[-1] - times[0]:.4g} s.")
    late = times >= times[-1] - (n_periods + 1) * period
    known = late & np.all(np.isfinite(counterpart.states[:, :n_q]), axis=1)
    rows = np.flatnonzero(known)
    if len(rows) < 2:
        raise InputError("Argument `data` must have numbers at its end, but it has holes only.")
    rows = rows[:: max(1, len(rows) // _MOST)]
    model_times, model_states = execution.sampled()
    shifts = np.linspace(0.0, period, _PHASES, endpoint=False)
    miss = np.zeros(len(shifts))
    for k in range(n_q):
        seen = counterpart.states[rows, k]
        spread = float(np.ptp(model_states[:, k])) or 1.0
        for at, shift in enumerate(shifts):
            phases: Vector = np.mod(times[rows] + shift, period)
            there = np.interp(phases, model_times, model_states[:, k])
            miss[at] += float(np.sum(((seen - there) / spread) ** 2))
    shift = _lowest(shifts, miss, period)
    begin = times[-1] - (n_periods + 1) * period
    first = max(begin, times[0])
    zero = (math.ceil((first + shift) / period)) * period - shift
    kept = (times >= zero) & (times <= zero + n_periods * period)
    return Counterpart(
        label=counterpart.label, times=times[kept] - zero, states=counterpart.states[kept]
    )


def _lowest(shifts: Vector, miss: Vector, period: float) -> float:
    """Return where a periodic curve is lowest, by a parabola through its lowest three points."""
    k = int(np.argmin(miss))
    before, here, after = miss[k - 1], miss[k], miss[(k + 1) % len(miss)]
    bend = before - 2 * here + after
    part = 0.0 if bend <= 0.0 else 0.5 * (before - after) / bend
    return float(np.mod(shifts[k] + part * period / len(shifts), period))
