r"""Edges of contact channels as observations of a fit.

A contact that begins is an impact, and the end of the last contact of a sequence is the release. An
edge at the phase :math:`\varphi` of the recording, with its standard error :math:`\sigma`, is
compared with the event of the orbit at the time `t` of a period `T`, which is shifted by `s`
periods:

.. math:: r = \frac{T_\text{rec}}{\sigma} \bigl(\varphi - t / T - s\bigr)

The difference of phases is between -1/2 and 1/2. Bounces are counted from the first impact, up to
the first bounce that is too short for the sampling. The recording decides how many there are, so
the number of residuals does not change. Bounces that the orbit lacks are at its Zeno point,
their limit. A further bounce of the orbit that is longer than contacts would hide costs the excess.
A sequence of contacts without one of the orbit, and a sequence of the orbit without contacts, cost
as much as no orbit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.contact_edges import Edge, SeenSequence, mean_of
from zeno_orbits.experiment.comparison.event_contacts import SeenEvents
from zeno_orbits.experiment.identification.predictions import EventTimes
from zeno_orbits.experiment.sequences import (
    OrbitSequence,
    PlacedSequence,
    placed_sequences,
)

UNMATCHED = 1e3
"""Residual of an edge or a sequence without its counterpart."""
_HIDDEN = 2.0
"""A bounce of so many samples more than a contact is not hidden."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenEdge:
    """An edge of a contact channel in all cycles.

    Attributes:
        label: Its name, such as ``closed.impact 2`` or ``closed.release``.
        number: Index of the impact in its sequence, or ``None`` for the release.
        phase: Phase in periods, its mean over the cycles.
        turn: Mean index of the cycles, counted from the middle of the recording.
        error: Standard error [s].
    """

    label: str
    number: int | None
    phase: float
    turn: float
    error: float

    def stretched(self, factor: float) -> SeenEdge:
        """Return it by the phases of a period that is longer by a factor."""
        return replace(self, phase=(self.turn + self.phase) / factor - self.turn)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenRows:
    """The edges of a sequence of contacts.

    Attributes:
        stop: Name of the stop.
        edges: The edges: impacts in order from the first one on, then the release.
        hidden: Longest further bounce that the contacts hide [s], infinite if bounces are not
            counted.
        error: Standard error of the length of a bounce [s].
    """

    stop: str
    edges: tuple[SeenEdge, ...]
    hidden: float
    error: float

    @property
    def n_rows(self) -> int:
        """Number of residuals: the edges, and the further bounce."""
        return len(self.edges) + 1

    @property
    def n_impacts(self) -> int:
        """Number of impacts."""
        return sum(one.number is not None for one in self.edges)


class _Event(NamedTuple):
    """The event of an orbit that belongs to an edge: its index, and the periods until it."""

    place: int
    turns: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContactRows:
    """The edges of all contact channels of a recording.

    Attributes:
        sequences: The sequences of contacts.
        stops: Names of the stops that have a channel.
        period: Period of the recording [s].
    """

    sequences: tuple[SeenRows, ...] = ()
    stops: tuple[str, ...] = ()
    period: float = math.nan

    @property
    def n_rows(self) -> int:
        """Number of residuals: of every sequence, and one for every stop."""
        return sum(one.n_rows for one in self.sequences) + len(self.stops)

    @property
    def n_edges(self) -> int:
        """Number of edges."""
        return sum(len(one.edges) for one in self.sequences)

    def stretched(self, factor: float) -> ContactRows:
        """Return the edges by the phases of a period that is longer by a factor."""
        sequences = tuple(
            replace(one, edges=tuple(edge.stretched(factor) for edge in one.edges))
            for one in self.sequences
        )
        return replace(self, sequences=sequences, period=self.period * factor)

    def residuals(self, orbit: EventTimes, shift: float) -> Vector:
        """Return the residuals, ``(n_rows,)``.

        Args:
            orbit: The events of an orbit.
            shift: Delay of the orbit, in periods.
        """
        return self._rows(orbit, shift, None)[0]

    def jacobian(self, orbit: EventTimes, shift: float, by: Vector, by_period: Vector) -> Vector:
        """Return the exact derivatives of the residuals, ``(n_rows, k + 1)``.

        Args:
            orbit: The events of an orbit.
            shift: Delay of the orbit, in periods.
            by: Derivatives of the times of its events, ``(n, k + 1)`` [s].
            by_period: Derivatives of its period, ``(k + 1,)`` [s].
        """
        return self._rows(orbit, shift, (by, by_period))[1]

    def _rows(
        self, orbit: EventTimes, shift: float, by: tuple[Vector, Vector] | None
    ) -> tuple[Vector, Vector]:
        n = 0 if by is None else len(by[1])
        values, slopes = np.zeros(self.n_rows), np.zeros((self.n_rows, n))
        at = 0
        matched, extra = self._matched(orbit, shift)
        for one, sequence in zip(self.sequences, matched, strict=True):
            rows = slice(at, at + one.n_rows)
            at += one.n_rows
            if sequence is None:
                values[rows][:-1] = UNMATCHED
                continue
            self._fill(values[rows], slopes[rows], one, sequence, orbit, shift, by)
        values[at:] = [UNMATCHED * extra[stop] for stop in self.stops]
        return values, slopes

    def _fill(
        self,
        values: Vector,
        slopes: Vector,
        one: SeenRows,
        sequence: PlacedSequence,
        orbit: EventTimes,
        shift: float,
        by: tuple[Vector, Vector] | None,
    ) -> None:
        """Write the residuals of a sequence and their derivatives."""
        for k, edge in enumerate(one.edges):
            event = _event_of(edge, sequence)
            if event is None:
                values[k] = UNMATCHED
                continue
            phase = orbit.times[event.place] / orbit.period
            off = (edge.phase - phase - shift + 0.5) % 1.0 - 0.5
            weight = self.period / edge.error
            values[k] = off * weight
            if by is not None:
                slopes[k] = -weight * (by[0][event.place] - phase * by[1]) / orbit.period
                slopes[k, -1] -= weight
        n, impacts = one.n_impacts, sequence.impacts
        if math.isfinite(one.hidden) and 0 < n < len(impacts):
            (last, before), (next_, after) = impacts[n - 1], impacts[n]
            length = orbit.times[next_] - orbit.times[last] + (after - before) * orbit.period
            excess = (length - one.hidden) / one.error
            if excess > 0.0:
                values[-1] = excess
                if by is not None:
                    longer = by[0][next_] - by[0][last] + (after - before) * by[1]
                    slopes[-1] = longer / one.error

    def _matched(
        self, orbit: EventTimes, shift: float
    ) -> tuple[list[PlacedSequence | None], dict[str, int]]:
        """Return the sequence of the orbit for each one of the recording, and what is left over."""
        found: list[PlacedSequence | None] = [None] * len(self.sequences)
        extra: dict[str, int] = {}
        events = list(zip(orbit.names, orbit.times.tolist(), strict=True))
        for stop in self.stops:
            own = placed_sequences(events, orbit.period, stop)
            seen = [k for k, one in enumerate(self.sequences) if one.stop == stop]
            apart = [
                (abs((edge.phase - first - shift + 0.5) % 1.0 - 0.5), k, j)
                for k in seen
                for edge in self.sequences[k].edges[:1]
                for j, one in enumerate(own)
                for first in [orbit.times[one.impacts[0][0]] / orbit.period]
            ]
            left = set(range(len(own)))
            for _, k, j in sorted(apart):
                if found[k] is None and j in left:
                    found[k] = own[j]
                    left.discard(j)
            extra[stop] = len(left)
        return found, extra


NO_CONTACTS = ContactRows()
"""No contact channels."""


def _event_of(edge: SeenEdge, sequence: PlacedSequence) -> _Event | None:
    """Return the event of an orbit that belongs to an edge, or ``None``."""
    if edge.number is None:
        return None if sequence.release is None else _Event(*sequence.release)
    if edge.number < len(sequence.impacts):
        return _Event(*sequence.impacts[edge.number])
    return None if sequence.zeno is None else _Event(*sequence.zeno)


def contact_rows(seen: SeenEvents, start: float, period: float, period_error: float) -> ContactRows:
    """Return the edges of the contact channels of a recording.

    Args:
        seen: The contacts.
        start: A time at which the orbit's period starts, near the middle of the recording [s].
        period: Period of the recording [s].
        period_error: Its standard error [s].
    """
    clock = _Clock(start=start, period=period, period_error=period_error, step=seen.step)
    return ContactRows(
        sequences=tuple(
            _rows_of(stop.name, label, orbit, found, clock)
            for stop in seen.stops
            for label, orbit, found in zip(stop.labels(), stop.orbit, stop.seen, strict=True)
            if found
        ),
        stops=tuple(stop.name for stop in seen.stops),
        period=period,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Clock:
    """The phases of a recording: start of a period, period and its error, and sampling [s]."""

    start: float
    period: float
    period_error: float
    step: float

    def edge(self, label: str, number: int | None, edges: Sequence[Edge]) -> SeenEdge:
        """Return an edge from its times in all cycles."""
        late: Vector = (np.array([one.middle for one in edges]) - self.start) / self.period
        first = float(late[0])
        turns: Vector = np.asarray(np.round(late - first), dtype=np.float64) + math.floor(first)
        phases: Vector = late - turns
        estimate = mean_of(phases * self.period, 1, self.step)
        turn = float(np.mean(turns))
        return SeenEdge(
            label=label,
            number=number,
            phase=float(np.mean(phases)),
            turn=turn,
            error=math.hypot(estimate.error, turn * self.period_error),
        )


def _rows_of(
    stop: str, label: str, orbit: OrbitSequence, found: Sequence[SeenSequence], clock: _Clock
) -> SeenRows:
    """Return the edges of a sequence that is in several cycles.

    Without a Zeno point the first impact alone counts: contacts end after an impact at a time that
    the model with hard stops does not have. A contact that a reset ends lacks a release.
    """
    accumulates = orbit.zeno is not None
    n = min(one.n_sure for one in found) if accumulates else 1
    edges = [
        clock.edge(f"{label}.impact {k + 1}", k, [one.begins[k] for one in found]) for k in range(n)
    ]
    if accumulates and orbit.release is not None:
        edges.append(clock.edge(f"{label}.release", None, [one.release for one in found]))
    lasting = [length for one in found for length in one.contacts]
    contact = float(np.median(lasting)) if lasting else 0.0
    counted = accumulates and max(len(one.begins) for one in found) == n
    return SeenRows(
        stop=stop,
        edges=tuple(edges),
        hidden=contact + _HIDDEN * clock.step if counted else math.inf,
        error=clock.step / math.sqrt(6.0),
    )
