"""Motion of an orbit, simulated at its own parameter values, and the lines of its mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import GraphDynamics, HybridDynamics, ParameterValues, Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.simulation import Execution, Mode, simulate, state_after, state_before
from zeno_orbits.verification import claimed_start

_LONGER = 1e-6
"""Part of the duration to follow a motion longer, so that rounding cuts off no release."""
STOP = "stop"
"""The line of a drawing that is the stop itself, and is drawn as such."""
GROUND = "ground"
"""The line of a drawing that is the ground. It is drawn as the stop, and cut at the frame."""
_SAME = 1e-6
"""Distance below which two corners are the same, in parts of the size of a drawing."""


def orbit_motion(
    orbit: Orbit,
    problem: Problem,
    dynamics: HybridDynamics | GraphDynamics,
    *,
    periods: int = 1,
) -> Execution:
    """Simulate periods of an orbit from its start.

    Args:
        orbit: The orbit.
        problem: Its problem.
        dynamics: The problem at the parameter values of the orbit, for an orbit of events the graph
            of modes.
        periods: Number of periods.

    Raises:
        SimulationError: If the execution cannot be continued: a false orbit may run anywhere.
    """
    # The verifier rejects an initial state off the section, but the simulator must accept it.
    start = claimed_start(orbit, problem, dynamics)
    until = periods * orbit.period * (1 + _LONGER)
    return simulate(dynamics, start, until=until, past=orbit.past_switch)


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineMotion:
    """The lines of a machine at even times of a motion.

    Attributes:
        times: Times since the start of the motion [s], ``(n,)``.
        states: States there, ``(n, n_x)``.
        modes: Off all stops, or on a stop.
        closed: Names of the closed stops, empty for a machine with one unnamed stop.
        lines: Name to corners, ``(n, n_corners, 2)`` [m]. A line is the same part of the machine at
            all times, with its name at the start.
        renamed: Names of the lines that exchange their names in resets.
    """

    times: Vector
    states: Vector
    modes: tuple[Mode, ...]
    closed: tuple[tuple[str, ...], ...]
    lines: dict[str, Vector]
    renamed: tuple[str, ...] = ()


def machine_motion(
    problem: Problem, values: ParameterValues, execution: Execution, duration: float, *, n: int
) -> MachineMotion:
    """Return a mechanism at evenly spaced times of a motion.

    A reset that renames coordinates, such as the heel strike of a walker, leaves the machine in its
    place. If a reset only translates the corners, the drawing is moved by this translation, and
    each line continues the line with the same corners.

    Args:
        problem: The problem, which must have a drawing.
        values: Parameter values of the problem.
        execution: The motion.
        duration: Duration to draw [s].
        n: Number of times.

    Raises:
        InputError: If the problem lacks a drawing.
    """
    if problem.drawing is None:
        raise InputError(f"Argument `problem` must have a drawing, but `{problem.name}` lacks one.")
    times = np.linspace(0.0, duration, n, endpoint=False)
    states = execution.states_at(times)
    last = execution.arcs[-1]
    arcs = [
        next((arc for arc in execution.arcs if arc.end_time > time), last)
        for time in times.tolist()
    ]
    drawn = _drawn(problem, values, states)
    lines = {name: np.empty_like(corners) for name, corners in drawn.items()}
    parts, offset, renamed = {name: name for name in drawn}, np.zeros(2), set[str]()
    resets = _resets(problem, values, execution)
    for k, time in enumerate(times.tolist()):
        while resets and resets[0][0] <= time:
            _, shift, before = resets.pop(0)
            parts = {name: parts[before[name]] for name in drawn}
            offset = offset + shift
            renamed |= {name for name, part in parts.items() if name != part}
        for name, part in parts.items():
            lines[part][k] = drawn[name][k] + offset
    return MachineMotion(
        times=times,
        states=states,
        modes=tuple(arc.mode for arc in arcs),
        closed=tuple(arc.closed for arc in arcs),
        lines=lines,
        renamed=tuple(name for name in drawn if name in renamed),
    )


def _drawn(problem: Problem, values: ParameterValues, states: Vector) -> dict[str, Vector]:
    return problem.drawn_lines(values, states[:, : len(problem.state_names)])


def _resets(
    problem: Problem, values: ParameterValues, execution: Execution
) -> list[tuple[float, Vector, dict[str, str]]]:
    """Return the resets that rename lines: time, translation, and name after to name before."""
    found: list[tuple[float, Vector, dict[str, str]]] = []
    for event in execution.switches:
        pair = np.array([state_before(event), state_after(event)])
        lines = _drawn(problem, values, pair)
        before, after = ({name: one[k] for name, one in lines.items()} for k in (0, 1))
        known = _renaming(before, after)
        if known is not None:
            found.append((event.time, *known))
    return found


def _renaming(
    before: Mapping[str, Vector], after: Mapping[str, Vector]
) -> tuple[Vector, dict[str, str]] | None:
    """Return the translation and the names of a reset that only renames, or None for others.

    Args:
        before: Lines just before the reset, name to corners ``(n_corners, 2)``.
        after: Lines just after it.
    """
    names = [name for name in before if name != GROUND]
    old, new = (np.concatenate([lines[name] for name in names]) for lines in (before, after))
    shift = np.mean(old, axis=0) - np.mean(new, axis=0)
    near = _SAME * float(np.max(np.ptp(old, axis=0)))
    found: dict[str, str] = {}
    for name in names:
        moved = after[name] + shift
        same = [
            other
            for other in names
            if other not in found.values() and _is_same(before[other], moved, near)
        ]
        if not same:
            return None
        # Lines that coincide keep their names.
        found[name] = name if name in same else same[0]
    return shift, found | {name: name for name in before if name == GROUND}


def _is_same(line: Vector, other: Vector, near: float) -> bool:
    """Return True if two lines have the same corners, in the same or the opposite order."""
    if line.shape != other.shape:
        return False
    return any(bool(np.max(np.abs(line - one)) <= near) for one in (other, other[::-1]))


def frame_of(
    motion: MachineMotion, *, square: bool = True
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return a frame that holds all lines but the ground: its range across, and upwards [m].

    Args:
        motion: The motion.
        square: Whether the frame is a square. By default it is.
    """
    lines = [points for name, points in motion.lines.items() if name != GROUND]
    corners = np.concatenate([points.reshape(-1, 2) for points in lines])
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float(np.max(high - low)) or 1.0
    (x, y), (wide, tall) = ((low + high) / 2).tolist(), (high - low).tolist()
    reach = [0.56 * size] * 2 if square else [side / 2 + 0.06 * size for side in (wide, tall)]
    return (x - reach[0], x + reach[0]), (y - reach[1], y + reach[1])
