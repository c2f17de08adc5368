r"""The largest Lyapunov exponent of a motion, from two parallel runs.

A second motion starts a small distance :math:`d_0` from the first motion. After every period of the
clock (or every oscillation) the distance :math:`d_k` is recorded and the second motion is rescaled
to the distance :math:`d_0` in the same direction. The exponent is the mean of
:math:`\ln(d_k / d_0) / T` [Benettin1980]_. Differences of true executions are valid through
impacts, Zeno points and releases. A variational equation would need the saltation matrix of each
event.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics, GraphMode
from zeno_orbits.simulation.settings import SimulationSettings, SimulationTask
from zeno_orbits.simulation.simulator import pieces

_DISTANCE = 1e-7
"""Distance at which the second motion starts, relative to the size of the states."""
_VANISHED = 1e-7
"""Part of it below which it is rounding."""
_SETTLING = 10
"""Turns in which the second motion turns into the direction that grows fastest."""
_ROUNDS = (60, 180, 600)
"""Numbers of periods in the average: few if they suffice."""
_BLOCKS = 12
_DEVIATIONS = 3.0
"""Standard deviations of the mean that the error stands for."""
_CLEAR = 0.3
"""Error over the exponent with which a round is enough."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exponent:
    """An average exponent.

    Attributes:
        value: Largest Lyapunov exponent [1/s].
        error: Three standard deviations of the mean over blocks [1/s].
        turns: Turns that were averaged.
    """

    value: float
    error: float
    turns: int


def largest_exponent(
    graph: GraphDynamics,
    state: Vector,
    *,
    turn: float,
    scale: Vector,
    settings: SimulationSettings,
) -> Exponent:
    """Return the largest Lyapunov exponent of the motion from a state.

    Perturbations of the clock are excluded, because their exponent belongs to the clock.

    Args:
        graph: The graph of modes.
        state: A state on the attractor of the motion, ``(n_x,)``.
        turn: Period of the clock, or of an oscillation [s].
        scale: Size of each state, ``(n_x,)``.
        settings: Accuracy of the simulations.

    Raises:
        SimulationError: If a motion cannot be continued.
    """
    clock = graph.first.clock
    free = np.array([k for k in range(len(state)) if k not in clock])
    direction = np.zeros(len(state))
    direction[free] = scale[free] * np.cos(1.0 + np.arange(len(free)))
    first, rates = state, list[float]()
    other = _beside(graph, first, direction, scale, graph.open_mode)
    exponent = None
    for count in (_SETTLING + _ROUNDS[0], *_ROUNDS[1:]):
        for _ in range(count):
            started = float(np.max(np.abs((other - first)[free]) / scale[free]))
            first, mode = _after(graph, first, turn, settings)
            other, _ = _after(graph, other, turn, settings)
            away = np.zeros(len(state))
            away[free] = (other - first)[free]
            distance = float(np.max(np.abs(away[free]) / scale[free]))
            if started > 0.0:
                rates.append(math.log(max(distance / started, _VANISHED)) / turn)
            if distance > _VANISHED * _DISTANCE:
                direction = away
            other = _beside(graph, first, direction, scale, mode)
        exponent = _mean(np.array(rates[_SETTLING:]))
        if abs(exponent.value) * _CLEAR > exponent.error:
            break
    assert exponent is not None
    return exponent


def states_at_turns(
    graph: GraphDynamics, state: Vector, turn: float, count: int, settings: SimulationSettings
) -> list[Vector]:
    """Return the states of a motion at the ends of periods, with the first state in front.

    Args:
        graph: The graph of modes.
        state: The first state, ``(n_x,)``.
        turn: Length of a period [s].
        count: Number of periods.
        settings: Accuracy of the simulation.

    Raises:
        SimulationError: If the motion cannot be continued.
    """
    states = [state]
    for _ in range(count):
        states.append(_after(graph, states[-1], turn, settings)[0])
    return states


def _mean(rates: Vector) -> Exponent:
    blocks = np.array([np.mean(block) for block in np.array_split(rates, _BLOCKS)])
    spread = float(np.std(blocks, ddof=1)) / math.sqrt(_BLOCKS)
    return Exponent(value=float(np.mean(rates)), error=_DEVIATIONS * spread, turns=len(rates))


def _beside(
    graph: GraphDynamics, state: Vector, direction: Vector, scale: Vector, mode: GraphMode
) -> Vector:
    """Return an admissible state at the distance, on the closed stops of a mode."""
    closed, sides = mode
    size = float(np.max(np.abs(direction) / scale))
    for sign in (1.0, -1.0):
        other = state + sign * _DISTANCE / size * direction
        for stop in closed:
            other = graph.holding((closed, sides), stop).on_stop(other)
        inside = [
            view
            for stop, view in enumerate(graph.open_views)
            if stop not in closed and view.gap(other) < 0.0
        ]
        if not inside:
            return other
    for view in inside:
        other = view.on_stop(other)
    return other


def _after(
    graph: GraphDynamics, state: Vector, time: float, settings: SimulationSettings
) -> tuple[Vector, GraphMode]:
    """Return the state of a motion after a time, and its mode."""
    task = SimulationTask(dynamics=graph, state=state, until=time, settings=settings, goes_on=True)
    end, mode = state, graph.open_mode
    for piece in pieces(task):
        end, mode = piece.state, piece.mode
    return end, mode
