"""The events at which a motion crosses a section: releases, and first impacts of a sequence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation import Event, Impact, MotionEnd, Release, watched, watched_releases

_NO_IMPACT = 1e-12
"""Largest gap rate of a state near a release, in units of the problem's characteristic gap rate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReleaseRecord:
    """A release from the stop.

    Attributes:
        time: Time of the release [s].
        state: State at the release, ``(n_x,)``.
        struck: Gap rate before the first impact since the previous release. NaN without an impact.
        zeno_time: Time of the Zeno point [s]. NaN without a Zeno point.
        zeno_state: State at the Zeno point, ``(n_x,)``.
    """

    time: float
    state: Vector
    struck: float = math.nan
    zeno_time: float = math.nan
    zeno_state: Vector | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactRecord:
    """An impact that begins a sequence: a first impact, or an impact at almost the previous speed.

    Attributes:
        time: Time of the impact [s].
        state: State just after the impact, ``(n_x,)``.
        rate: Gap rate before the impact, negative.
    """

    time: float
    state: Vector
    rate: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Follower:
    """Simulator for motions of one system.

    Attributes:
        dynamics: The system.
        bounds: Largest modulus of each state, ``(n_x,)``.
    """

    dynamics: HybridDynamics
    bounds: Vector | None = None

    def crossings(
        self,
        state: Vector,
        *,
        until: float,
        error: float,
        goes_on: bool = True,
        seen: Callable[[Event], None] | None = None,
    ) -> Iterator[ReleaseRecord | ImpactRecord | MotionEnd]:
        """Yield the crossings of a motion, and then its end.

        Args:
            state: Initial state, ``(n_x,)``.
            until: Longest simulated time [s].
            error: Relative local error of a step.
            goes_on: True if the state continues an earlier motion, exactly or slightly displaced.
            seen: Called with every event.
        """
        events = watched(
            self.dynamics,
            state,
            until=until,
            error=error,
            bounds=self.bounds,
            goes_on=goes_on,
        )
        start = state if goes_on else None
        return _crossings(self.dynamics, events, start, seen=seen)

    def releases(
        self, states: Vector, *, until: float, error: float, count: int
    ) -> Iterator[list[ReleaseRecord]]:
        """Yield the first releases of the motion from each state.

        Args:
            states: States of an earlier motion, exactly or slightly displaced, ``(n, n_x)``.
            until: Longest simulated time [s].
            error: Relative local error of a step.
            count: Largest number of releases.
        """
        limits = {"until": until, "error": error, "releases": count}
        runs = watched_releases(self.dynamics, states, bounds=self.bounds, **limits)
        for state, events in zip(states, runs, strict=True):
            found = _crossings(self.dynamics, iter(events), state, strikes=False)
            yield [one for one in found if isinstance(one, ReleaseRecord)]


def _crossings(
    dynamics: HybridDynamics,
    events: Iterator[Event | MotionEnd],
    start: Vector | None,
    *,
    strikes: bool = True,
    seen: Callable[[Event], None] | None = None,
) -> Iterator[ReleaseRecord | ImpactRecord | MotionEnd]:
    """Yield the crossings of a motion.

    Args:
        dynamics: The system.
        events: Events of the motion.
        start: Initial state if the motion continues from a release, or inside a sequence of
            impacts.
        strikes: True if impacts are crossings.
        seen: Called with every event.
    """
    first = zeno_time = math.nan
    last = zeno_state = None
    speed = 0.0 if start is None else dynamics.gap_rate(start)
    if start is not None and speed > dynamics.own.gap_rate * _NO_IMPACT:
        last = start
    for event in events:
        if seen is not None and not isinstance(event, MotionEnd):
            seen(event)
        if isinstance(event, Impact):
            if math.isnan(first):
                first = event.approach_rate
            if not strikes:
                continue
            before, speed = speed, dynamics.speed_after(event.approach_rate)
            if last is None or _begins(dynamics, last, before, speed):
                yield ImpactRecord(
                    time=event.time, state=event.state_plus, rate=event.approach_rate
                )
            last = event.state_plus
        elif isinstance(event, MotionEnd):
            yield event
        elif isinstance(event, Release):
            yield ReleaseRecord(
                time=event.time,
                state=event.state,
                struck=first,
                zeno_time=zeno_time,
                zeno_state=zeno_state,
            )
            first = zeno_time = math.nan
            last = zeno_state = None
        else:
            zeno_time, zeno_state = event.time, event.state


def _begins(dynamics: HybridDynamics, last: Vector, before: float, speed: float) -> bool:
    """Return True if an impact does not belong to the sequence of its predecessor.

    The speed of successive impacts in a sequence decreases by about the factor `e`, if the gap
    acceleration is negative.

    Args:
        dynamics: The system.
        last: State after the previous impact, ``(n_x,)``.
        before: Gap rate after the previous impact.
        speed: Gap rate after the impact.
    """
    if speed >= (1 + dynamics.restitution) / 2 * before:
        return True
    return not dynamics.gap_acceleration(last) < 0.0
