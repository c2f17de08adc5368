"""Motion of an orbit, simulated at its own parameter values, and the lines of its mechanism."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import GraphDynamics, HybridDynamics, ParameterValues, Problem
from zeno_orbits.orbits import EventOrbit, ZenoOrbit, placed
from zeno_orbits.simulation import Execution, Mode, simulate

_LONGER = 1e-6
"""Part of the duration to follow a motion longer, so that rounding cuts off no release."""
STOP = "stop"
"""The line of a drawing that is the stop itself, and is drawn as such."""


def motion_of(
    orbit: ZenoOrbit | EventOrbit,
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
    start = np.array(problem.state_vector(orbit.start_state))
    if isinstance(orbit, ZenoOrbit) and isinstance(dynamics, HybridDynamics):
        shape = orbit.shape.at_restitution(dynamics.restitution)
        # The verifier rejects an initial state off the section, but the simulator must accept it.
        start = placed(dynamics, shape, start)
    return simulate(dynamics, start, until=periods * orbit.period * (1 + _LONGER))


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineMotion:
    """The lines of a machine at even times of a period.

    Attributes:
        times: Times since the start of the period [s], ``(n,)``.
        states: States there, ``(n, n_x)``.
        modes: Off the stop, or on it.
        lines: Name to corners, ``(n, n_corners, 2)`` [m].
    """

    times: Vector
    states: Vector
    modes: tuple[Mode, ...]
    lines: dict[str, Vector]


def machine_motion(
    problem: Problem, values: ParameterValues, execution: Execution, period: float, *, n: int
) -> MachineMotion:
    """Return a mechanism at evenly spaced times of one period.

    Args:
        problem: The problem, which must have a drawing.
        values: Parameter values of the problem.
        execution: One period of the motion.
        period: Period [s].
        n: Number of times.

    Raises:
        InputError: If the problem lacks a drawing.
    """
    if problem.drawing is None:
        raise InputError(f"Argument `problem` must have a drawing, but `{problem.name}` lacks one.")
    times = np.linspace(0.0, period, n, endpoint=False)
    states = np.array([execution.state_at(time) for time in times.tolist()])
    modes = [
        next((arc.mode for arc in execution.arcs if arc.end_time > time), Mode.FREE)
        for time in times.tolist()
    ]
    lines = problem.drawn_lines(values, states[:, : len(problem.state_names)])
    return MachineMotion(times=times, states=states, modes=tuple(modes), lines=lines)


def frame_of(motion: MachineMotion) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return a square that holds all lines: its range across, and upwards [m]."""
    corners = np.concatenate([points.reshape(-1, 2) for points in motion.lines.values()])
    low, high = corners.min(axis=0), corners.max(axis=0)
    reach = 0.56 * float(np.max(high - low)) or 1.0
    (x, y) = ((low + high) / 2).tolist()
    return (x - reach, x + reach), (y - reach, y + reach)
