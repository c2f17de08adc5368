"""The phases of an execution: consecutive flights with the events that end them (theory (3.5))."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from zeno_orbits.arrays import Vector
from zeno_orbits.orbits.shape import PhaseKind
from zeno_orbits.simulation import Arc, Ending, Execution, Impact, Mode, ZenoPoint

_AT_ONCE = 1e-6
"""Fraction of an execution. An earlier release belongs to its start."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """Start or end of a phase.

    Attributes:
        time: Time [s].
        state: A release state, or the state just after an impact, ``(n_x,)``.
    """

    time: float
    state: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Phase:
    """A flight and the events that end it.

    Attributes:
        kind: Kind of its end.
        start: Start of the phase.
        flight: The free arc to the first impact.
        rescaled_flights: The flights from impact to impact. Empty outside an accumulation.
        impacts: The resolved impacts, one more than rescaled flights.
        zeno: The Zeno point, if contact follows.
        locked: The contact phase, if contact follows.
        end: End of the phase.
    """

    kind: PhaseKind
    start: Moment
    flight: Arc
    rescaled_flights: tuple[Arc, ...]
    impacts: tuple[Impact, ...]
    zeno: ZenoPoint | None
    locked: Arc | None
    end: Moment

    @property
    def flights(self) -> tuple[Arc, ...]:
        """All flights."""
        return (self.flight, *self.rescaled_flights)

    @property
    def arcs(self) -> tuple[Arc, ...]:
        """All arcs that have a flow. The tail of an accumulation is not included."""
        return self.flights if self.locked is None else (*self.flights, self.locked)


def phases_of(
    execution: Execution, start: Vector | None = None, *, held: bool = True
) -> tuple[Phase, ...]:
    """Return the phases of an execution, beginning with the first complete phase.

    A phase in which the stop is touched without an impact is omitted. The next phase then does not
    start at the end of the previous phase.

    Args:
        execution: The execution.
        start: Its initial state, if a phase starts there: at a release or after an impact.
        held: True if phases end at releases and include all impacts before the release. Otherwise
            every impact ends a phase, up to the first contact phase.
    """
    begin = None if start is None else Moment(time=0.0, state=start)
    if held:
        return tuple(_held(execution, begin))
    return tuple(_struck(execution, begin))


def follow_each_other(phases: Sequence[Phase]) -> bool:
    """Return True if every phase starts at the end of the previous phase."""
    return all(one.end.time == two.start.time for one, two in pairwise(phases))


def _struck(execution: Execution, begin: Moment | None) -> list[Phase]:
    """Return one phase per impact, up to the first contact phase."""
    impacts = {impact.time: impact for impact in execution.impacts}
    phases: list[Phase] = []
    here, flown = begin, False
    for arc in execution.arcs:
        if arc.mode is Mode.LOCKED and not flown:
            # A start in contact because of a rounding error is released at once.
            continue
        if arc.mode is Mode.LOCKED or arc.ending is not Ending.IMPACT:
            break
        flown, impact = True, impacts.get(arc.end_time)
        if impact is not None and here is not None:
            phases.append(_of_impact(here, arc, impact))
        here = None if impact is None else _after(impact)
    return phases


def _held(execution: Execution, begin: Moment | None) -> list[Phase]:
    """Return the phases up to each release. At a plastic stop a release may have several phases."""
    impacts = {impact.time: impact for impact in execution.impacts}
    releases = {release.time: release for release in execution.releases}
    phases: list[Phase] = []
    flights: list[tuple[Arc, Impact | None]] = []
    here = begin
    for arc in execution.arcs:
        if arc.mode is Mode.FREE and arc.ending is Ending.IMPACT:
            flights.append((arc, impacts.get(arc.end_time)))
        if arc.mode is Mode.FREE:
            continue
        if arc.ending is not Ending.RELEASE:
            break
        release = releases[arc.end_time]
        if not flights and begin is here and release.time <= _AT_ONCE * execution.end_time:
            # A start in contact because of a rounding error is released at once.
            continue
        end = Moment(time=release.time, state=release.state)
        whole = [(flight, impact) for flight, impact in flights if impact is not None]
        if here is not None and whole and len(whole) == len(flights):
            zenos = [z for z in execution.zeno_points if here.time < z.time <= arc.start_time]
            if len(zenos) == 1:
                phases += _to_release(here, whole, zenos[0], arc, end)
        here, flights = end, []
    return phases


def _to_release(
    here: Moment, flights: Sequence[tuple[Arc, Impact]], zeno: ZenoPoint, locked: Arc, end: Moment
) -> list[Phase]:
    """Return the phases from one release to the next."""
    before: list[Phase] = []
    kind = PhaseKind.ZENO
    if zeno.tail == 0.0 and zeno.last_speed == 0.0:
        # At a plastic stop a flight ends in contact or with an immediate release.
        kind = PhaseKind.PLASTIC
        for arc, impact in flights[:-1]:
            before.append(_of_impact(here, arc, impact))
            here = _after(impact)
        flights = flights[-1:]
    arcs = [arc for arc, _ in flights]
    whole = Phase(
        kind=kind,
        start=here,
        flight=arcs[0],
        rescaled_flights=tuple(arcs[1:]),
        impacts=tuple(impact for _, impact in flights),
        zeno=zeno,
        locked=locked,
        end=end,
    )
    return [*before, whole]


def _of_impact(start: Moment, arc: Arc, impact: Impact) -> Phase:
    return Phase(
        kind=PhaseKind.IMPACT,
        start=start,
        flight=arc,
        rescaled_flights=(),
        impacts=(impact,),
        zeno=None,
        locked=None,
        end=_after(impact),
    )


def _after(impact: Impact) -> Moment:
    return Moment(time=impact.time, state=impact.state_plus)


def kinds_of(phases: Sequence[Phase]) -> tuple[PhaseKind, ...]:
    """Return the kinds of phases, in the format of a shape."""
    return tuple(phase.kind for phase in phases)
