"""Relative differences of two executions of one motion, landmark by landmark."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import UNIT_SCALES, CharacteristicScales
from zeno_orbits.simulation import Event, EventKind, Execution
from zeno_orbits.work import checked

ROUNDING = 4e-15
"""Relative rounding error per event. Two runs may share it, so it is not visible in a difference.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Landmark:
    """A point of an execution that has a counterpart in another execution.

    Attributes:
        kind: Kind of its event, or ``None`` at the end.
        time: Time [s].
        state: State, ``(n_x,)``. At an impact, it is the state before the impact.
    """

    kind: EventKind | None
    time: float
    state: Vector

    @property
    def label(self) -> str:
        """The kind as a reader sees it."""
        return "end" if self.kind is None else self.kind.label


@checked
def execution_distance(
    first: Execution, second: Execution, own: CharacteristicScales = UNIT_SCALES
) -> float:
    """Return the largest relative difference of two executions, over every event and the end.

    Times are relative to the time of the last event, states to their largest value. Near a Zeno
    point one execution may resolve more impacts than the other. An event that only one execution
    reaches is compared with the end of the other, since rounding decides whether an event at the
    end is included.

    Args:
        first: First execution.
        second: Second execution, to the same time.
        own: Characteristic scales of the problem.

    Returns:
        The difference. Infinite if the executions have different events.
    """
    pairs = list(_pairs(_sections_of(first), _sections_of(second)))
    last = max((event.time for event in second.events), default=0.0)
    return _largest(pairs, sizes(second, own), last or second.end_time)


def landmarks(execution: Execution) -> tuple[Landmark, ...]:
    """Return the landmarks by which executions of different completions are compared.

    The landmarks are the first nonempty group of: releases, Zeno points, impacts, the end. So the
    paper's rule is judged by later events, because its Zeno instants have little meaning.
    """
    for events in (execution.releases, execution.zeno_points, execution.impacts):
        if events:
            return tuple(_landmark(event) for event in events)
    return (_end(execution),)


def apart(first: Sequence[Landmark], second: Sequence[Landmark], scale: Vector) -> float:
    """Return the largest relative difference of two executions' landmarks.

    Args:
        first: Landmarks of one execution.
        second: Landmarks of the other execution. The last time is the unit of the times.
        scale: Size of each state, ``(n_x,)`` (see ``sizes``).

    Returns:
        The difference. Infinite if a landmark does not have a counterpart.
    """
    if [mark.kind for mark in first] != [mark.kind for mark in second]:
        return math.inf
    return _largest(list(zip(first, second, strict=True)), scale, second[-1].time or 1.0)


def sizes(execution: Execution, own: CharacteristicScales = UNIT_SCALES) -> Vector:
    """Return the largest value of each state at the ends of arcs, ``(n_x,)``.

    The value zero is replaced by the state's characteristic scale.
    """
    return sizes_of([x for arc in execution.arcs for x in (arc.start_state, arc.end_state)], own)


def sizes_of(
    states: Sequence[Sequence[float] | Vector], own: CharacteristicScales = UNIT_SCALES
) -> Vector:
    """Return the largest value of each state over a number of states, ``(n_x,)``.

    The value zero is replaced by the state's characteristic scale.
    """
    largest = np.max(np.abs(np.array(states, dtype=np.float64)), axis=0)
    return own.not_zero(largest)


def _landmark(event: Event) -> Landmark:
    # A reset may bring many states to one.
    state = event.after if event.kind is EventKind.SWITCH else event.before
    return Landmark(kind=event.kind, time=event.time, state=state)


def _end(execution: Execution) -> Landmark:
    return Landmark(kind=None, time=execution.end_time, state=execution.end_state)


def _sections_of(execution: Execution) -> list[list[Landmark]]:
    """Return the landmarks in groups. Each is impacts, then a Zeno point, a release or the end."""
    marks = [*map(_landmark, execution.events), _end(execution)]
    cuts = [k for k, mark in enumerate(marks, start=1) if mark.kind is not EventKind.IMPACT]
    return [marks[start:stop] for start, stop in pairwise([0, *cuts])]


def _pairs(
    first: Sequence[Sequence[Landmark]], second: Sequence[Sequence[Landmark]]
) -> Iterator[tuple[Landmark, Landmark]]:
    """Yield pairs of corresponding landmarks."""
    for (*some, mark), (*others, other) in zip(first, second, strict=False):
        yield from zip(some, others, strict=False)
        if mark.kind is other.kind is None and len(some) != len(others):
            # One execution has more impacts before its end than the other.
            n = min(len(some), len(others))
            yield [*some, mark][n], [*others, other][n]
        else:
            yield mark, other


def _largest(pairs: Sequence[tuple[Landmark, Landmark]], scale: Vector, unit: float) -> float:
    """Return the largest relative difference within pairs, infinite for a pair of two kinds."""
    if any(a.kind is not b.kind and None not in (a.kind, b.kind) for a, b in pairs):
        return math.inf
    times = [abs(a.time - b.time) / unit for a, b in pairs]
    states = [float(np.max(np.abs(a.state - b.state) / scale)) for a, b in pairs]
    # NumPy's maximum keeps NaN. Python's maximum may lose it.
    return float(np.max([*times, *states]))
