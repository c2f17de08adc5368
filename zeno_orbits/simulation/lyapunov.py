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
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.loop import UnknownOperationError
from zeno_orbits.model import GraphDynamics, GraphMode
from zeno_orbits.simulation.compiled.executions import PairByLoop, serves
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
    free = _free(graph, len(state))
    direction = np.zeros(len(state))
    direction[free] = scale[free] * np.cos(1.0 + np.arange(len(free)))
    task = SimulationTask(dynamics=graph, state=state, until=turn, settings=settings, goes_on=True)
    if serves(task):
        with closing(pair_by_loop(task, direction, scale)) as pair:
            try:
                return _averaged(pair.rates, turn)
            except UnknownOperationError:
                # Of a mode that a motion has come to.
                pass
    rates = rates_turn_by_turn(task, direction, scale)
    return _averaged(lambda count: [one for one in islice(rates, count) if one is not None], turn)


def pair_by_loop(task: SimulationTask, direction: Vector, scale: Vector) -> PairByLoop:
    """Return a motion and another one beside it, both followed by the compiled loop.

    Args:
        task: One turn of the motion, which the loop can carry out.
        direction: First direction from it to the other motion, zero for the clock, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
    """
    return PairByLoop(
        task, direction=direction, scale=scale, distance=_DISTANCE, vanished=_VANISHED
    )


def rates_turn_by_turn(
    task: SimulationTask, direction: Vector, scale: Vector
) -> Iterator[float | None]:
    r"""Yield :math:`\ln(d / d_0) / T` of every turn [1/s], each followed by itself: the reference.

    It is ``None`` where both motions are the same at the start of a turn.

    Args:
        task: One turn of the motion.
        direction: As for `pair_by_loop`.
        scale: Size of each state, ``(n_x,)``.

    Raises:
        SimulationError: If a motion cannot be continued.
    """
    graph, first, turn, mode = task.graph, task.state, task.until, task.graph.open_mode
    free = _free(graph, len(first))
    while True:
        other = _beside(graph, first, direction, scale, mode)
        started = float(np.max(np.abs((other - first)[free]) / scale[free]))
        first, mode = _after(graph, first, turn, task.settings)
        other, _ = _after(graph, other, turn, task.settings)
        away = np.zeros(len(first))
        away[free] = (other - first)[free]
        distance = float(np.max(np.abs(away[free]) / scale[free]))
        if distance > _VANISHED * _DISTANCE:
            direction = away
        yield math.log(max(distance / started, _VANISHED)) / turn if started > 0.0 else None


def _free(graph: GraphDynamics, n_x: int) -> list[int]:
    """Return the indices of the states that do not belong to the clock."""
    return [k for k in range(n_x) if k not in graph.first.clock]


def _averaged(rates_of: Callable[[int], Sequence[float]], turn: float) -> Exponent:
    """Return the mean of as many rates as its error asks for.

    Args:
        rates_of: Function from a number of turns to the rates of the next turns.
        turn: Length of a turn [s].
    """
    rates = list(rates_of(_SETTLING + _ROUNDS[0]))
    exponent = _mean(rates, turn)
    for count in _ROUNDS[1:]:
        if abs(exponent.value) * _CLEAR > exponent.error:
            break
        rates += rates_of(count)
        exponent = _mean(rates, turn)
    return exponent


def _mean(rates: Sequence[float], turn: float) -> Exponent:
    """Return the mean of the rates after the settling.

    A motion that forgets every disturbance within a few turns has few rates, or none.
    """
    settled = np.array(rates[_SETTLING:] or rates or [math.log(_VANISHED) / turn])
    count = min(_BLOCKS, len(settled))
    blocks = np.array([np.mean(block) for block in np.array_split(settled, count)])
    spread = float(np.std(blocks, ddof=1)) / math.sqrt(count) if count > 1 else 0.0
    return Exponent(value=float(np.mean(settled)), error=_DEVIATIONS * spread, turns=len(settled))


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
    task = SimulationTask(dynamics=graph, state=state, until=time, settings=settings, goes_on=True)
    end, mode = state, graph.open_mode
    for piece in pieces(task):
        end, mode = piece.state, piece.mode
    return end, mode
