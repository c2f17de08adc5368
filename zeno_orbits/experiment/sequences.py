"""Sequences of impacts in the period of an orbit, stop by stop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.orbits import Orbit


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitSequence:
    """A sequence of impacts of an orbit. Times count from the start of the period.

    Attributes:
        impacts: Times of the impacts, increasing [s].
        zeno: Zeno point, or ``None``.
        release: Release after the Zeno point, or ``None``.
    """

    impacts: tuple[float, ...]
    zeno: float | None
    release: float | None

    @property
    def flights(self) -> Vector:
        """Durations of the resolved flights between its impacts [s]."""
        return np.diff(self.impacts)

    @property
    def end(self) -> float:
        """Its last time [s]."""
        known = (self.impacts[-1], self.zeno, self.release)
        return max(one for one in known if one is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedSequence:
    """A sequence of impacts as indices of events, each with the periods to add to its time.

    Attributes:
        impacts: The impacts, in order.
        zeno: Zeno point, or ``None``.
        release: Release after the Zeno point, or ``None``.
    """

    impacts: tuple[tuple[int, int], ...]
    zeno: tuple[int, int] | None
    release: tuple[int, int] | None


def placed_sequences(
    events: Sequence[tuple[str, float]], period: float, stop: str
) -> tuple[PlacedSequence, ...]:
    """Return the sequences of a stop in a period, in order of their first impacts.

    An impact that follows no impact on the same stop, or no slower motion towards a Zeno point,
    begins a sequence.

    Args:
        events: Name and time of every event of the period, in order.
        period: The period [s].
        stop: Name of the stop.
    """
    own = [
        (place, name.partition(" ")[0], time)
        for place, (name, time) in enumerate(events)
        if name.partition(" ")[2] == stop and not name.startswith("switch ")
    ]
    accumulates = any(kind == "zeno" for _, kind, _ in own)
    n = len(own)
    found: list[PlacedSequence] = []
    for first, (start, kind, begin) in enumerate(own):
        if kind != "impact" or (accumulates and own[first - 1][1] == "impact" and n > 1):
            continue
        impacts, zeno, release = [(start, 0)], None, None
        for k in range(1, n):
            place, what, time = own[(first + k) % n]
            turns = math.ceil((begin - time) / period) if time < begin else 0
            if what == "impact":
                if not accumulates or zeno is not None:
                    break
                impacts.append((place, turns))
            elif what == "zeno":
                zeno = (place, turns)
            else:
                release = (place, turns)
                break
        found.append(PlacedSequence(impacts=tuple(impacts), zeno=zeno, release=release))
    return tuple(found)


def orbit_sequences(orbit: Orbit, stop: str) -> tuple[OrbitSequence, ...]:
    """Return the sequences of a stop in a period, in order of their first impacts.

    Args:
        orbit: The orbit.
        stop: Name of the stop.
    """
    events = [(event.name, event.time) for event in orbit.events]

    def time(at: tuple[int, int]) -> float:
        return events[at[0]][1] + at[1] * orbit.period

    return tuple(
        OrbitSequence(
            impacts=tuple(map(time, one.impacts)),
            zeno=None if one.zeno is None else time(one.zeno),
            release=None if one.release is None else time(one.release),
        )
        for one in placed_sequences(events, orbit.period, stop)
    )


def longest_flight(sequences: Sequence[OrbitSequence], period: float) -> float:
    """Return the duration between the bounces of a stop and its other flights, their mean in size.

    Args:
        sequences: The sequences of the stop, at least one.
        period: The period [s].
    """
    longest, least = bounce_and_flight(sequences, period)
    return math.sqrt(longest * least) if longest > 0.0 else least / 2


def bounce_and_flight(sequences: Sequence[OrbitSequence], period: float) -> tuple[float, float]:
    """Return the longest flight within a sequence and the shortest one between two of them [s].

    Args:
        sequences: The sequences of the stop, at least one.
        period: The period [s].
    """
    begins = sorted(one.impacts[0] for one in sequences)
    free = [
        min((b - one.end) % period or period for b in begins)
        for one in sequences
        if one.zeno is None or one.release is not None
    ]
    bounces = [float(flight) for one in sequences for flight in one.flights]
    return max(bounces, default=0.0), min(free, default=period)
