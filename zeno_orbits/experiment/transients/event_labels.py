r"""Which recorded event is which impact: missed and false events, by dynamic programming.

The flights of a sequence of impacts shrink by the restitution `e`. The state is (event `i`, next
true event `j`, number `s` of impacts skipped between). With `s` skipped impacts, an interval
:math:`\Delta` begins with the flight :math:`T = \Delta (1 - e) / (1 - e^{s+1})` and ends with
:math:`e^s T`. A transition costs

.. math:: \bigl(\ln (T' / e T) / \sigma\bigr)^2 + 12\,s + 25\,(j - i - 1), \qquad
    \sigma^2 = \sigma_e^2 + 2 (\sigma_t / T)^2 + 2 (\sigma_t / T')^2

and a dropped event at either end costs 25. The weights were chosen on simulated sequences: a
smaller cost of a false event explains a missed second impact as a false first one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from zeno_orbits.arrays import Vector

_MISSED, _FALSE = 12.0, 25.0
_SCATTER = 0.04
"""Scatter of the ratio of two flights that does not show an error."""
_JITTER = 1.5e-3
"""Error of a recorded time, relative to the longest interval or 0.5 s, whichever is smaller."""
_MOST_SKIPPED, _MOST_FALSE = 2, 2
_CANDIDATES = 12
_FEWEST = 3
"""Events of a later sequence, at least."""
_GROWS, _WHOLE = 3.2, 0.5
"""An interval begins another sequence if it is longer by the first factor than those just before
it, which two missed impacts do not explain, and than this part of the longest one before it."""


class _Step(NamedTuple):
    """Two neighbouring true events, and the number of impacts skipped between them."""

    first: int
    last: int
    skipped: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Labels:
    """Labels of the events of one sequence.

    Attributes:
        numbers: Index of the impact that each event is, ``None`` for a false one, ``(n,)``.
        missed: Indices of impacts between the first and the last event that were not recorded.
        ratio: Ratio of neighbouring flights.
        cost: Cost of the labels.
    """

    numbers: tuple[int | None, ...]
    missed: tuple[int, ...]
    ratio: float
    cost: float

    @property
    def n_false(self) -> int:
        """Number of false events."""
        return sum(one is None for one in self.numbers)


def sequences_of(times: Vector) -> list[slice]:
    """Return the ranges of the sequences of impacts in sorted times: intervals shrink in each.

    Args:
        times: Increasing times, ``(n,)`` [s].
    """
    gaps, edges = np.diff(times), [0]
    for k in range(1, len(gaps)):
        # A false event near the beginning also makes a short interval before a long one.
        near, whole = gaps[max(k - 3, 0) : k], gaps[edges[-1] : k]
        is_long = gaps[k] > _GROWS * np.max(near) and gaps[k] > _WHOLE * np.max(whole)
        # A lone late event is a false one.
        is_long = is_long and len(times) - (k + 1) >= _FEWEST
        if is_long and k + 1 - edges[-1] > _MOST_FALSE + 2:
            edges.append(k + 1)
    edges.append(len(times))
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def labelled(times: Vector, scatter: float = _SCATTER) -> Labels:
    """Return the labels of the events of one sequence of impacts.

    Args:
        times: Increasing times, ``(n,)`` [s]. Fewer than four are all taken as true.
        scatter: Scatter of the ratio of two flights that does not show an error.
    """
    n = len(times)
    if n < 4:
        return Labels(numbers=tuple(range(n)), missed=(), ratio=math.nan, cost=0.0)
    intervals = np.diff(times)
    jitter = _JITTER * min(1.0, float(np.max(intervals)) / 0.5)
    best: tuple[float, list[_Step], float] | None = None
    for ratio in _candidates(intervals):
        cost, path = _cheapest(times, ratio, jitter, scatter)
        if best is None or cost < best[0]:
            best = cost, path, ratio
    if best is None:
        return Labels(numbers=tuple(range(n)), missed=(), ratio=math.nan, cost=0.0)
    for _ in range(2):
        ratio = _median_ratio(times, best[1], best[2])
        cost, path = _cheapest(times, ratio, jitter, scatter)
        if cost >= best[0] - 1e-9:
            break
        best = cost, path, ratio
    return _named(n, best[1], _median_ratio(times, best[1], best[2]), best[0])


def _candidates(intervals: Vector) -> list[float]:
    ratios = intervals[1:] / intervals[:-1]
    inside = ratios[(ratios > 0.1) & (ratios < 0.985)]
    if not len(inside):
        return []
    known = np.unique(np.round(np.append(inside, np.median(inside)), 3))
    if len(known) > _CANDIDATES:
        known = np.quantile(known, np.linspace(0.02, 0.98, _CANDIDATES))
    return known.tolist()


def _cheapest(
    times: Vector, ratio: float, jitter: float, scatter: float
) -> tuple[float, list[_Step]]:
    """Return the cost and the path of the best labels at a ratio of flights."""
    n, stamps = len(times), times.tolist()
    whole = [(1 - ratio ** (s + 1)) / (1 - ratio) for s in range(_MOST_SKIPPED + 1)]
    best: dict[_Step, tuple[float, _Step | None]] = {}
    ending: list[list[tuple[_Step, float]]] = [[] for _ in range(n)]
    for j in range(1, n):
        for i in range(max(0, j - _MOST_FALSE - 1), j):
            for s in range(_MOST_SKIPPED + 1):
                step, flight = _Step(i, j, s), (stamps[j] - stamps[i]) / whole[s]
                extra = _FALSE * (j - i - 1) + _MISSED * s
                cheapest: tuple[float, _Step | None] = (_FALSE * i + extra, None)
                for before, last in ending[i]:
                    spread = scatter**2 + 2 * (jitter / last) ** 2 + 2 * (jitter / flight) ** 2
                    off = math.log(flight / (last * ratio)) ** 2 / spread
                    cost = best[before][0] + off + extra
                    if cost < cheapest[0]:
                        cheapest = cost, before
                best[step] = cheapest
                ending[j].append((step, flight * ratio**s))
    end = min(best, key=lambda one: best[one][0] + _FALSE * (n - 1 - one.last))
    path: list[_Step] = []
    at: _Step | None = end
    while at is not None:
        path.append(at)
        at = best[at][1]
    return best[end][0] + _FALSE * (n - 1 - end.last), path[::-1]


def _median_ratio(times: Vector, path: Sequence[_Step], otherwise: float) -> float:
    """Return the median ratio of neighbouring flights without a skipped impact."""
    flights = [(one, times[one.last] - times[one.first]) for one in path]
    ratios = [
        after / before
        for (one, before), (then, after) in itertools.pairwise(flights)
        if one.skipped == then.skipped == 0
    ]
    return float(np.clip(np.median(ratios), 0.02, 0.985)) if ratios else otherwise


def _named(n: int, path: Sequence[_Step], ratio: float, cost: float) -> Labels:
    numbers: list[int | None] = [None] * n
    at, missed = 0, list[int]()
    numbers[path[0].first] = 0
    for one in path:
        missed += range(at + 1, at + 1 + one.skipped)
        at += one.skipped + 1
        numbers[one.last] = at
    return Labels(numbers=tuple(numbers), missed=tuple(missed), ratio=ratio, cost=cost)
