"""States of a long motion by which it is told whether it repeats, rests, grows or dies out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.simulation import Execution, Impact, Release

_LOOK_BACK = 3
"""Periods that have to repeat before a motion counts as settled."""
_OVERDUE = 1.5
"""Periods without a passage after which a motion does not repeat any more."""
_ROUNDING = 1e-3
"""A change of this part of what is close may be an error of integration, and need not shrink."""
_LEAST_TREND = 3
"""Marks that tell a trend."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Passage:
    """A state of the motion that comes back if the motion does."""

    time: float
    state: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A piece of the run: an execution and the time at which it starts."""

    start: float
    execution: Execution

    @property
    def end(self) -> float:
        """When it ends [s]."""
        return self.start + self.execution.end_time

    def passages(self, kind: type[Release] | type[Impact]) -> list[Passage]:
        """Return the states at its releases, or before its impacts."""
        found: list[Passage] = []
        for event in self.execution.events:
            if isinstance(event, kind):
                state = event.state_minus if isinstance(event, Impact) else event.state
                found.append(Passage(time=self.start + event.time, state=state))
        return found

    def turns(self, coordinate: int, n_q: int) -> list[Passage]:
        """Return where a coordinate is largest, to the root of its velocity."""
        times, states = self.execution.sampled(20)
        rates = states[:, n_q + coordinate]
        falls = np.flatnonzero((rates[:-1] > 0.0) & (rates[1:] <= 0.0) & (np.diff(times) > 0.0))
        return [self._turn(times[k], times[k + 1], n_q + coordinate) for k in falls]

    def _turn(self, low: float, high: float, velocity: int) -> Passage:
        for _ in range(80):
            middle = (low + high) / 2
            if self.execution.state_at(middle)[velocity] > 0.0:
                low = middle
            else:
                high = middle
        return Passage(time=self.start + high, state=self.execution.state_at(high))


def rests(pieces: Sequence[Piece], close: float) -> bool:
    """Return True if what is left of the motion in the last quarter is none."""
    everything = np.concatenate([s.execution.sampled(10)[1] for s in pieces])
    times, states = pieces[-1].execution.sampled(10)
    late = states[times >= 0.75 * times[-1]]
    size = np.ptp(everything, axis=0)
    return bool(np.all(np.ptp(late, axis=0) <= close * np.where(size > 0.0, size, 1.0)))


def passages_of(pieces: Sequence[Piece], n_q: int) -> list[Passage]:
    """Return releases if the motion still has them, else impacts, else turning points."""
    releases = passages_at(pieces, Release)
    return releases or passages_at(pieces, Impact) or _turns(pieces, n_q)


def passages_at(pieces: Sequence[Piece], kind: type[Release] | type[Impact]) -> list[Passage]:
    """Return the events of a kind, none if the second half of the motion has fewer than two."""
    found = [passage for piece in pieces for passage in piece.passages(kind)]
    late = sum(passage.time > pieces[-1].end / 2 for passage in found)
    return found if late > 1 else []


def _turns(pieces: Sequence[Piece], n_q: int) -> list[Passage]:
    """Return where the coordinate that moves most is largest."""
    states = pieces[-1].execution.sampled(10)[1]
    moving = int(np.argmax(np.ptp(states[:, :n_q], axis=0)))
    return [passage for piece in pieces for passage in piece.turns(moving, n_q)]


def scale_of(passages: Sequence[Passage]) -> Vector:
    """Return the size of each state, ``(n_x,)``, the largest where one vanishes."""
    sizes = np.max(np.abs([passage.state for passage in passages]), axis=0)
    largest = float(np.max(sizes))
    return np.where(sizes > 1e-9 * largest, sizes, largest or 1.0)


def repeats(passages: Sequence[Passage], n: int, close: float, *, now: float) -> bool:
    """Return True if the motion is close to one that repeats after `n` passages.

    The distance left is that of the last two periods, summed as the geometric series they begin.

    Args:
        passages: Of the motion, in order.
        n: Marks a period.
        close: What is close, relative to the size of the states.
        now: The time reached [s]; a motion that has made no passage for too long does other things.
    """
    if len(passages) < _LOOK_BACK * n + 1:
        return False
    if now - passages[-1].time > _OVERDUE * (passages[-1].time - passages[-n - 1].time):
        return False
    scale = scale_of(passages[-_LOOK_BACK * n - 1 :])

    def change(k: int) -> float:
        return float(np.max(np.abs(passages[-k].state - passages[-k - n].state) / scale))

    last = max(change(k) for k in range(1, n + 1))
    before = max(change(k) for k in range(n + 1, 2 * n + 1))
    if last <= _ROUNDING * close:
        return True
    ratio = last / before if before > 0.0 else math.inf
    return ratio < 1.0 and last * max(ratio / (1.0 - ratio), 1.0) <= close


def trend_of(pieces: Sequence[Piece], n_q: int) -> float:
    """Return the factor by which the motion grows a period, over its second half.

    A period lasts from release to release, or else from one turning point to the next; NaN where
    there are too few of them.
    """
    passages = passages_at(pieces, Release) or _turns(pieces, n_q)
    late = passages[-max(len(passages) // 2, _LEAST_TREND) :]
    if len(late) < _LEAST_TREND:
        return math.nan
    scale = scale_of(passages)
    sizes = [float(np.max(np.abs(passage.state) / scale)) for passage in late]
    if min(sizes) <= 0.0:
        return math.nan
    slope = np.polyfit(np.arange(len(sizes)), np.log(sizes), 1)[0]
    return float(np.exp(slope))
