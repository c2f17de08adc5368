"""Differences of two executions of one motion: landmark by landmark, relative."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import USUAL, OwnScale
from zeno_orbits.simulation import Event, Execution, Impact, ZenoPoint

ROUNDING = 4e-15
"""Differences below this, times the number of events, are rounding: two runs may share it."""

_NOTHING = 1e-12
"""A state that is never larger, in its own size, is zero to rounding and no unit of its error."""


class Kind(Enum):
    """Kinds of landmarks."""

    IMPACT = "impact"
    ZENO = "Zeno point"
    RELEASE = "release"
    END = "end"


@dataclass(frozen=True, slots=True, kw_only=True)
class Landmark:
    """A point of an execution that another one has, too.

    Attributes:
        kind: What it is.
        time: When [s].
        state: Where, ``(n_x,)``; before the impact, where it is one.
    """

    kind: Kind
    time: float
    state: Vector


def difference(first: Execution, second: Execution, own: OwnScale = USUAL) -> float:
    """Return the largest relative difference of two executions, over every event and the end.

    Times are relative to the last event's, states to their largest
    value. Near a Zeno point one may resolve more impacts than the other. An event so late that the
    other one lacks it is held against the end of that: an end so near an impact is before it or
    after it, and no accuracy says which.

    Args:
        first: One execution.
        second: Another one to the same time.
        own: Sizes of the problem's numbers.

    Returns:
        Infinity if they go different ways.
    """
    pairs = list(_pairs(_sections_of(first), _sections_of(second)))
    last = max((event.time for event in second.events), default=0.0)
    return _largest(pairs, sizes(second, own), last or second.end_time)


def landmarks(execution: Execution) -> tuple[Landmark, ...]:
    """Return the landmarks by which executions of different completions are compared.

    These are the releases, if there are any.

    Without a release, Zeno points; without these, impacts; without these, the end. So the paper's
    rule, whose Zeno instants mean little, is judged by what comes later.
    """
    for events in (execution.releases, execution.zeno_points, execution.impacts):
        if events:
            return tuple(_landmark(event) for event in events)
    return (_end(execution),)


def apart(first: Sequence[Landmark], second: Sequence[Landmark], scale: Vector) -> float:
    """Return the largest relative difference of two executions' landmarks.

    Args:
        first: Of one execution.
        second: Of the other; the time of the last one is the unit of the times.
        scale: Size of each state, ``(n_x,)`` (see ``sizes``).

    Returns:
        Infinity if one has a landmark that the other lacks.
    """
    if [mark.kind for mark in first] != [mark.kind for mark in second]:
        return math.inf
    return _largest(list(zip(first, second, strict=True)), scale, second[-1].time or 1.0)


def sizes(execution: Execution, own: OwnScale = USUAL) -> Vector:
    """Return the largest value of each state at the ends of arcs, ``(n_x,)``; its size for zero."""
    return sizes_of([x for arc in execution.arcs for x in (arc.start_state, arc.end_state)], own)


def sizes_of(states: Sequence[Sequence[float] | Vector], own: OwnScale = USUAL) -> Vector:
    """Return the largest value of each state among some, ``(n_x,)``; its own size for zero."""
    largest = np.max(np.abs(np.array(states, dtype=np.float64)), axis=0)
    usual = own.states(len(largest))
    return np.where(largest > _NOTHING * usual, largest, usual)


def _landmark(event: Event) -> Landmark:
    if isinstance(event, Impact):
        return Landmark(kind=Kind.IMPACT, time=event.time, state=event.state_minus)
    kind = Kind.ZENO if isinstance(event, ZenoPoint) else Kind.RELEASE
    return Landmark(kind=kind, time=event.time, state=event.state)


def _end(execution: Execution) -> Landmark:
    return Landmark(kind=Kind.END, time=execution.end_time, state=execution.end_state)


def _sections_of(execution: Execution) -> list[list[Landmark]]:
    """Return the landmarks in groups: some impacts, then a Zeno point, a release or the end."""
    marks = [*map(_landmark, execution.events), _end(execution)]
    cuts = [k for k, mark in enumerate(marks, start=1) if mark.kind is not Kind.IMPACT]
    return [marks[start:stop] for start, stop in pairwise([0, *cuts])]


def _pairs(
    first: Sequence[Sequence[Landmark]], second: Sequence[Sequence[Landmark]]
) -> Iterator[tuple[Landmark, Landmark]]:
    """Yield what corresponds to each other."""
    for (*some, mark), (*others, other) in zip(first, second, strict=False):
        yield from zip(some, others, strict=False)
        if mark.kind is other.kind is Kind.END and len(some) != len(others):
            # One more impact before the end of one than before the end of the other.
            n = min(len(some), len(others))
            yield [*some, mark][n], [*others, other][n]
        else:
            yield mark, other


def _largest(pairs: Sequence[tuple[Landmark, Landmark]], scale: Vector, unit: float) -> float:
    """Return the largest relative difference within pairs; infinity if a pair is none."""
    if any(a.kind is not b.kind and Kind.END not in (a.kind, b.kind) for a, b in pairs):
        return math.inf
    times = [abs(a.time - b.time) / unit for a, b in pairs]
    states = [float(np.max(np.abs(a.state - b.state) / scale)) for a, b in pairs]
    # NumPy's maximum keeps NaN, which Python's may lose.
    return float(np.max([*times, *states]))
