r"""Edges of a sampled contact channel, and the errors that the sampling leaves.

An edge between two samples that are :math:`\Delta` apart is known to be between them. The error of
its midpoint is uniform, with the standard deviation :math:`\Delta / \sqrt{12}`. If the sampling is
synchronous with the motion, the error is the same in every cycle, and cycles do not reduce it.
Otherwise the midpoints scatter over the cycles. The variance of an error is the variance within the
cycles plus the variance of the mean over the cycles, so the scatter tells what the mean still has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.estimate import UNKNOWN, Estimate

_FEWEST = 2
"""Samples of a contact or flight from which a shorter one would still be seen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """An edge of a contact channel.

    Attributes:
        low: Time of the last sample before it [s].
        high: Time of the first sample after it [s].
    """

    low: float
    high: float

    @property
    def middle(self) -> float:
        """Middle of both samples [s]."""
        return (self.low + self.high) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenContact:
    """A contact in a recording.

    Attributes:
        begin: Edge at which it begins, or ``None`` if it had begun before the recording.
        end: Edge at which it ends, or ``None`` if it lasts beyond the recording.
        samples: Number of its samples.
    """

    begin: Edge | None
    end: Edge | None
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenSequence:
    """Contacts of a stop that no long flight divides: bounces, and the lasting contact.

    Attributes:
        begins: Edges at which the contacts begin, up to the lasting contact.
        release: Edge at which the last contact ends.
        fewest: Smallest number of samples of a contact or flight of the sequence.
        n_sure: Number of beginnings before which every contact and flight is resolved.
        contacts: Durations of the contacts before the lasting contact [s].
    """

    begins: tuple[Edge, ...]
    release: Edge
    fewest: int
    n_sure: int
    contacts: tuple[float, ...]

    @property
    def is_resolved(self) -> bool:
        """True if every contact and flight has so many samples that none is missed."""
        return self.fewest >= _FEWEST

    @property
    def begins_surely(self) -> bool:
        """True if the first contact and the flight after it are resolved, so none is before it."""
        return self.n_sure > 1


def seen_contacts(time: Vector, channel: Vector) -> list[SeenContact]:
    """Return the contacts of a channel in order of time.

    Args:
        time: Times of the samples, ``(n_t,)`` [s].
        channel: 1 in contact and 0 off the stop, NaN where a sample is missing, ``(n_t,)``.
    """
    seen = np.isfinite(channel)
    t, on = time[seen], channel[seen] == 1.0
    turns = np.flatnonzero(on[1:] != on[:-1])
    starts = [0, *(turns + 1).tolist()]
    ends = [*(turns + 1).tolist(), len(t)]
    return [
        SeenContact(
            begin=Edge(low=float(t[a - 1]), high=float(t[a])) if a > 0 else None,
            end=Edge(low=float(t[b - 1]), high=float(t[b])) if b < len(t) else None,
            samples=b - a,
        )
        for a, b in zip(starts, ends, strict=True)
        if len(t) and on[a]
    ]


def is_coarse(contacts: Sequence[SeenContact], step: float) -> bool:
    """Return True if samples may miss contacts: none is seen, or one or a gap has one sample.

    Args:
        contacts: The contacts in order of time.
        step: Time between two samples [s].
    """
    whole = [one.samples for one in contacts if one.begin is not None and one.end is not None]
    apart = [
        round((after.begin.low - before.end.high) / step) + 1
        for before, after in pairwise(contacts)
        if before.end is not None and after.begin is not None
    ]
    return not contacts or min([*whole, *apart], default=_FEWEST) < _FEWEST


def seen_sequences(
    contacts: Sequence[SeenContact], time: Vector, longest_flight: float, step: float
) -> list[SeenSequence]:
    """Return the whole sequences of contacts in a recording.

    Args:
        contacts: The contacts in order of time.
        time: Times of the samples, ``(n_t,)`` [s].
        longest_flight: Flights from this duration on divide two sequences [s].
        step: Time between two samples [s].
    """
    groups: list[list[SeenContact]] = []
    start, end = float(time[0]), float(time[-1])
    for one in contacts:
        before = groups[-1][-1].end if groups else None
        if (
            before is not None
            and one.begin is not None
            and one.begin.middle - before.middle < longest_flight
        ):
            groups[-1].append(one)
        else:
            groups.append([one])
    return [
        _sequence(group, step)
        for group in groups
        if group[0].begin is not None
        and group[0].begin.low - start >= longest_flight
        and group[-1].end is not None
        and end - group[-1].end.high >= longest_flight
    ]


def _sequence(group: Sequence[SeenContact], step: float) -> SeenSequence:
    lasting = max(range(len(group)), key=lambda k: group[k].samples)
    begins = [one.begin for one in group[: lasting + 1] if one.begin is not None]
    release = group[-1].end
    if release is None:
        raise ValueError("Argument `group` must end in the recording.")
    # The fewest samples of each contact before the lasting one and of the flight after it.
    bounces = [
        min(before.samples, round((after.begin.low - before.end.high) / step) + 1)
        for before, after in pairwise(group[: lasting + 1])
        if before.end is not None and after.begin is not None
    ]
    unsure = (k for k, count in enumerate(bounces) if count < _FEWEST)
    return SeenSequence(
        begins=tuple(begins),
        release=release,
        fewest=min([*bounces, group[lasting].samples]),
        n_sure=next(unsure, len(bounces)) + 1,
        contacts=tuple(
            one.end.middle - one.begin.middle
            for one in group[:lasting]
            if one.begin is not None and one.end is not None
        ),
    )


def period_of_edges(series: Sequence[Sequence[Edge]], cycles: Sequence[Sequence[int]]) -> Estimate:
    """Return the period for which all edges of every series lie between their samples.

    Two edges of a series bound the period. The bounds of all pairs are combined. If scatter of the
    cycles makes them contradict each other, the period is the slope of the least-squares lines.

    Args:
        series: Series of edges that recur in every cycle.
        cycles: Number of the cycle of each edge.
    """
    low, high = -math.inf, math.inf
    for edges, numbers in zip(series, cycles, strict=True):
        n = np.array(numbers, dtype=np.float64)
        # Lines through all intervals are bounded by their hulls alone.
        least = _upper_hull(n, np.array([one.low for one in edges]))
        most = _upper_hull(n, -np.array([one.high for one in edges])) * (1.0, -1.0)
        apart = least[None, :, 0] - most[:, None, 0]
        rise = least[None, :, 1] - most[:, None, 1]
        later, earlier = apart > 0.0, apart < 0.0
        low = max(low, float(np.max(rise[later] / apart[later], initial=-math.inf)))
        high = min(high, float(np.min(rise[earlier] / apart[earlier], initial=math.inf)))
    if math.isfinite(low) and math.isfinite(high) and low < high:
        return Estimate(value=(low + high) / 2, error=(high - low) / math.sqrt(12))
    return _slope(series, cycles)


def _upper_hull(x: Vector, y: Vector) -> Vector:
    """Return the corners of the upper hull of points, ``(m, 2)``.

    Args:
        x: Abscissas in any order, ``(n,)``.
        y: Ordinates, ``(n,)``.
    """
    hull: list[tuple[float, float]] = []
    for k in np.lexsort((y, x)):
        at, height = float(x[k]), float(y[k])
        while hull and (
            hull[-1][0] == at
            or (
                len(hull) > 1
                and (hull[-1][1] - hull[-2][1]) * (at - hull[-2][0])
                <= (height - hull[-2][1]) * (hull[-1][0] - hull[-2][0])
            )
        ):
            hull.pop()
        hull.append((at, height))
    return np.array(hull).reshape(-1, 2)


def _slope(series: Sequence[Sequence[Edge]], cycles: Sequence[Sequence[int]]) -> Estimate:
    """Return the common slope of the middles of edges over their cycles."""
    above, below, left, freedom = 0.0, 0.0, 0.0, -1
    rows: list[tuple[Vector, Vector]] = []
    for edges, numbers in zip(series, cycles, strict=True):
        if len(edges) < 2:
            continue
        middle = np.array([one.middle for one in edges])
        n = np.array(numbers, dtype=np.float64)
        rows.append((n - n.mean(), middle - middle.mean()))
        above += float(rows[-1][0] @ rows[-1][1])
        below += float(rows[-1][0] @ rows[-1][0])
        freedom += len(n) - 1
    if not below > 0.0 or freedom < 1:
        return UNKNOWN
    slope = above / below
    left = sum(float(np.sum((y - slope * n) ** 2)) for n, y in rows)
    return Estimate(value=slope, error=math.sqrt(left / freedom / below))


def mean_of(values: Vector, n_edges: int, step: float) -> Estimate:
    r"""Return the mean over cycles of a sum or difference of edges.

    With the variance :math:`v = m \Delta^2 / 12` of `m` edges and the variance :math:`s^2` over the
    `n` cycles, the mean has the variance :math:`\max(v - s^2, v / n)`. Scatter beyond the sampling
    adds :math:`\max(0, s^2 - v) / n`.

    Args:
        values: The value in every cycle, ``(n,)``.
        n_edges: Number of edges that it consists of.
        step: Time between two samples [s].
    """
    n = len(values)
    if n == 0:
        return UNKNOWN
    each = n_edges * step**2 / 12
    scatter = float(np.var(values))
    variance = max(each - scatter, each / n) + max(0.0, scatter - each) / n
    return Estimate(value=float(np.mean(values)), error=math.sqrt(variance))
