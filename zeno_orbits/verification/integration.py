"""Forward integration from the claimed start of an orbit over several periods."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import (
    LOOSER,
    EventQuantities,
    caused_releases,
    extrapolated,
    orbit_event_name,
    relaxed_tolerance,
)
from zeno_orbits.simulation import (
    Arc,
    Event,
    Execution,
    Impact,
    Release,
    SimulationSettings,
    ZenoPoint,
    simulate,
    state_after,
)
from zeno_orbits.verification.claim import Claim


@dataclass(frozen=True, slots=True, kw_only=True)
class Period:
    """One integrated period.

    Attributes:
        events: Its events.
        opened: Releases that its last event causes, at the start of the next period.
        arcs: Its arcs.
        start: Time of its start [s].
        end: Time of its end [s].
        begin: State at its start, ``(n_x,)``.
        state: State just after its last event, ``(n_x,)``.
    """

    events: tuple[Event, ...]
    opened: tuple[Release, ...]
    arcs: tuple[Arc, ...]
    start: float
    end: float
    begin: Vector
    state: Vector

    @property
    def duration(self) -> float:
        """Its length [s]."""
        return self.end - self.start

    @property
    def impacts(self) -> list[Impact]:
        """Its resolved impacts."""
        return [event for event in self.events if isinstance(event, Impact)]

    @property
    def zeno_points(self) -> list[ZenoPoint]:
        """Its Zeno points."""
        return [event for event in self.events if isinstance(event, ZenoPoint)]

    def quantities(self, graph: GraphDynamics) -> EventQuantities:
        """Return the quantities of its events.

        Args:
            graph: The graph of modes.
        """
        events = (*self.events, *self.opened)
        return EventQuantities(graph=graph, start=self.begin, period=self.duration, events=events)

    def arc_before(self, event: Event) -> Arc:
        """Return the arc that ends at an event."""
        return next((arc for arc in self.arcs if arc.end_time >= event.time), self.arcs[-1])


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A motion over several periods.

    Attributes:
        start: Its start, ``(n_x,)``.
        execution: The execution, or ``None`` if the motion cannot start.
        periods: The finished periods.
        trouble: Reason for an early end, else empty.
    """

    start: Vector
    execution: Execution | None
    periods: tuple[Period, ...]
    trouble: str


_LONGEST = 1e200
"""Longest time to wait [s]. Beyond it the time of a rescaled flight overflows."""
_BEYOND, _LATE = 1e-3, 0.5
"""Parts of a period by which an integration goes on, usually and if the period is not over: the
mode after the last event must be seen, and the claimed period may be too short."""
_MORE = 4
"""Factor on the numbers of events, then: files of older versions lack releases."""
_AT_ONCE = 1e-6
"""Part of a period in which a release belongs to the start, which rests on its stop by rounding."""

_REPETITIONS = ((LOOSER, 1.0), (LOOSER / 10.0, 3.0))
"""Factors on the tolerances of a second integration, and the largest observed ratio of the error
to the difference. A state inside a long step may differ by more than the looser tolerance."""


_GROWN = 1e3
"""Residual, in units of the tolerance, up to which it may be an error of the integration."""
_FINER = 1e-2
"""Tolerances of the decisive integration, in units of the usual tolerances."""

Seen = TypeVar("Seen")


def decisive(
    observed: Callable[[SimulationSettings], Seen],
    worst: Callable[[Seen], float],
    settings: SimulationSettings,
    enough: float,
) -> tuple[Seen, SimulationSettings]:
    """Return an observation and its settings, at finer tolerances if it is near to sufficient.

    Over many impacts the errors of the integration may have grown to the size of a residual.

    Args:
        observed: Function of settings. It returns the observation with them.
        worst: Function of an observation. It returns the largest residual.
        settings: Settings of the first observation.
        enough: Largest residual that passes.
    """
    seen = observed(settings)
    if not 1.0 < worst(seen) / enough < _GROWN:
        return seen, settings
    finer = relaxed_tolerance(settings, factor=_FINER)
    return observed(finer), finer


def error_by_repetition(
    difference: Callable[[SimulationSettings], float], settings: SimulationSettings, enough: float
) -> float:
    """Return the error of an integration, from its differences to looser integrations.

    Args:
        difference: Function of settings. It returns the difference to an integration with them,
            infinite if that integration does not return.
        settings: Settings of the integration.
        enough: A larger error is estimated again by a less loose integration.
    """
    error = math.inf
    for factor, share in _REPETITIONS:
        error = min(error, share * difference(relaxed_tolerance(settings, factor=factor)))
        if error <= enough:
            break
    return error


def followed(
    graph: GraphDynamics, claim: Claim, x: Vector, settings: SimulationSettings, n_periods: int
) -> Run:
    """Return the motion from the start of a period, over a number of periods.

    Args:
        graph: The graph of modes.
        claim: The orbit as claimed. Its period is only used to limit the waiting time.
        x: The start, ``(n_x,)``.
        settings: Accuracy. The impacts are resolved one by one.
        n_periods: Number of periods.
    """
    exact = replace(settings, completion=extrapolated(settings))
    # A period that is claimed too long ends with its events.
    releases = claim.count("release")
    impacts = 0 if claim.count("zeno") else claim.count("impact")

    def simulated(until: float, more: int) -> Execution:
        return simulate(
            graph,
            x,
            until=until,
            releases=more * (n_periods * releases + 2) if releases else None,
            impacts=more * (n_periods * impacts + 2) if impacts else None,
            settings=exact,
            past=claim.section.removeprefix("switch "),
        )

    for beyond, more in ((_BEYOND * n_periods, 1), (_LATE, _MORE)):
        until = min((n_periods + beyond) * claim.period, _LONGEST)
        try:
            execution, trouble = simulated(until, more), ""
        except SimulationError as error:
            execution, trouble = error.execution, str(error).removesuffix(".")
        except InputError as error:
            return Run(start=x, execution=None, periods=(), trouble=str(error).removesuffix("."))
        periods = [] if execution is None else list(_periods(execution, claim, x))
        if trouble or len(periods) >= n_periods:
            break
        trouble = (
            f"The event `{claim.section}` does not follow {n_periods * claim.n_returns} times "
            f"within {until:.4g} s"
        )
    return Run(start=x, execution=execution, periods=tuple(periods[:n_periods]), trouble=trouble)


def _periods(execution: Execution, claim: Claim, x: Vector) -> Iterator[Period]:
    """Yield the periods of an execution, each ended by its n-th event of the section."""
    begin, count, first, events = 0.0, 0, 0, execution.events
    while first < len(events) and isinstance(events[first], Release):
        if (
            events[first].time > _AT_ONCE * claim.period
            or orbit_event_name(events[first]) != claim.section
        ):
            break
        first += 1
    for place, event in enumerate(events[first:], first):
        if orbit_event_name(event) != claim.section or event.time <= begin:
            continue
        count += 1
        if count % claim.n_returns == 0:
            yield Period(
                events=events[first : place + 1],
                opened=(opened := caused_releases(events, place)),
                arcs=tuple(a for a in execution.arcs if begin <= a.start_time < event.time),
                start=begin,
                end=event.time,
                begin=x,
                state=state_after(event),
            )
            x = state_after(event)
            begin, first = event.time, place + 1 + len(opened)


def distance(a: Vector, b: Vector, scale: Vector) -> float:
    """Return the largest difference of two states, each entry in units of its scale.

    Args:
        a: First state, ``(n_x,)``.
        b: Second state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
    """
    return float(np.max(np.abs(a - b) / scale))
