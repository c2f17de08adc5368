"""The data of a periodic orbit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.model import (
    GraphDynamics,
    HybridDynamics,
    ParameterValues,
    Problem,
    RecordedFile,
)
from zeno_orbits.orbits.digest import digest_of
from zeno_orbits.orbits.sequences import kind_of_events, sequence_of
from zeno_orbits.orbits.shape import EventSequence, PhaseKind
from zeno_orbits.work import Columns, TableRepr, by_name, checked, versions

FORMAT = 3
"""Version of the file format. It is the newest version that this code can read."""

_STOP = "stop"
"""Name of a stop that is not named."""
_ENDS = {True: [f"zeno {_STOP}", f"release {_STOP}"], False: list[str]()}
"""Events after the impacts of a phase, by whether contact follows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitEvent:
    """An event of an orbit.

    Attributes:
        name: Kind of the event, and its stop or switch, such as ``impact knee``.
        time: Time since the start of the period [s].
        state: State name to value just before the event.
        after: State name to value just after it, where a phase begins at an impact. Else None.
    """

    name: str
    time: float
    state: Mapping[str, float]
    after: Mapping[str, float] | None = None

    @property
    def word(self) -> str:
        """Kind of the event: ``impact``, ``zeno``, ``release`` or ``switch``."""
        return self.name.partition(" ")[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitImpact:
    """One resolved impact of an orbit.

    Attributes:
        time: Time since the start of the period [s].
        state_minus: State name to value just before the impact.
    """

    time: float
    state_minus: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitPhase:
    """A flight of an orbit of a machine with one stop, and the events that end it.

    Attributes:
        kind: Kind of its end.
        start_time: Time of its start since the start of the period [s].
        start_state: State name to value at its start: at a release, or just after an impact.
        impacts: The impacts that were resolved one by one.
        zeno_time: If contact follows, the accumulation time since the start of the period [s].
        zeno_state: If contact follows, state name to value at the accumulation.
    """

    kind: PhaseKind
    start_time: float
    start_state: Mapping[str, float]
    impacts: tuple[OrbitImpact, ...]
    zeno_time: float | None = None
    zeno_state: Mapping[str, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Orbit(TableRepr):
    """The data with which a periodic orbit can be rebuilt and verified. Times count from its start.

    Attributes:
        problem: Name of the problem.
        parameters: Name to value, for all parameters of the problem.
        gains: Name to value, for all gains of the problem.
        period: Period [s].
        start_state: State name to value just after the last event of the period.
        events: All events of the period in order. The last event ends the period.
        phases_as: Kinds of the phases, for an orbit of a machine with one stop and no switch that
            starts at a release, or at an impact without contact. Else None.
        floquet_multipliers: Multipliers of the return map at the start of the period. Empty while
            unknown.
        certificate: Result of a verification, as plain data. Empty while unverified.
        versions: Name to version of the packages that computed it.
        problem_digest: Digest of the equations of its problem (`digest.digest_of`). Empty in files
            of older versions.
        problem_file: File of its problem, or None if the problem is bundled. Not compared.
    """

    problem: str
    parameters: Mapping[str, float]
    gains: Mapping[str, float]
    period: float
    start_state: Mapping[str, float]
    events: tuple[OrbitEvent, ...]
    phases_as: EventSequence | None = None
    floquet_multipliers: tuple[complex, ...] = ()
    certificate: Mapping[str, Any] = field(default_factory=dict[str, Any])
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    problem_digest: tuple[float, ...] = ()
    problem_file: RecordedFile | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        """Return one line with the gains, the period, the events and the verification status."""
        gains = "".join(f"{name}={value:.7g}, " for name, value in self.gains.items())
        known = ", ".join(f"{abs(value):.3g}" for value in self.floquet_multipliers)
        moduli = f"multipliers of modulus {known}, " if known else ""
        verified = bool(self.certificate.get("passed"))
        return (
            f"<Orbit of {self.problem}: {gains}period={self.period:.10g} s, "
            f"sequence={', '.join(self.sequence)}, {moduli}verified={verified}>"
        )

    def _columns(self) -> Columns:
        """Return the events with the states before them."""
        return {
            "event": [event.name for event in self.events],
            "time": [event.time for event in self.events],
            **by_name([event.state for event in self.events]),
        }

    @property
    def sequence(self) -> tuple[str, ...]:
        """The event sequence: one entry per phase, named after its end.

        Impacts that accumulate, and kinks in their flights, belong to the entry of their Zeno
        point.
        """
        return sequence_of([event.name for event in self.events])

    @property
    def kind(self) -> str:
        """Name of the orbit: Zeno periodic, simple (plastic impacts), or without a Zeno point."""
        if self.phases_as is not None:
            return self.phases_as.kind
        return kind_of_events([(event.name, event.time) for event in self.events])

    @property
    def past_switch(self) -> str:
        """Name of the switch just after which the period starts, or empty."""
        kind, _, name = self.events[-1].name.partition(" ") if self.events else ("", "", "")
        return name if kind == "switch" else ""

    @property
    def section(self) -> str:
        """Name of the event at which the period starts and ends.

        Raises:
            InputError: If events are missing.
        """
        if not self.events:
            raise InputError("Argument `orbit` must have an event, but its list is empty.")
        return self.events[-1].name

    @property
    def n_returns(self) -> int:
        """Number of events of the section in a period."""
        return sum(event.name == self.section for event in self.events)

    @property
    def has_phases(self) -> bool:
        """True if the period is a sequence of phases of one stop."""
        return self.phases_as is not None

    @property
    def shape(self) -> EventSequence:
        """Kinds of its phases.

        Raises:
            InputError: If the period is not a sequence of phases of one stop.
        """
        if self.phases_as is None:
            wanted = "must be of a machine with one stop, no switch and no kink"
            sequence = ", ".join(self.sequence)
            raise InputError(f"Argument `orbit` {wanted}, but its events are `{sequence}`.")
        return self.phases_as

    @property
    def phases(self) -> tuple[OrbitPhase, ...]:
        """The phases of an orbit of a machine with one stop. The first starts at time 0.

        Raises:
            InputError: If the period is not a sequence of phases of one stop.
        """
        return _phases(self.shape, self.events, self.start_state)

    @property
    def impacts(self) -> tuple[OrbitImpact, ...]:
        """The resolved impacts."""
        return tuple(_impact(event) for event in self.events if event.word == "impact")

    @property
    def release_state(self) -> Mapping[str, float]:
        """State name to value at the release of an orbit with one release per period.

        Raises:
            InputError: If the orbit has a different shape.
        """
        self.shape.require_one_release()
        return self.start_state

    @property
    def zeno_time(self) -> float:
        """Zeno time of an orbit with one Zeno point per period [s].

        Raises:
            InputError: If the orbit has a different shape.
        """
        return self._zeno_point().time

    @property
    def zeno_state(self) -> Mapping[str, float]:
        """State name to value at the Zeno point of an orbit with one Zeno point per period.

        Raises:
            InputError: If the orbit has a different shape.
        """
        return self._zeno_point().state

    def _zeno_point(self) -> OrbitEvent:
        if self.phases_as is not None:
            self.phases_as.require_one_release()
        points = [event for event in self.events if event.word == "zeno"]
        if len(points) != 1:
            wanted = f"must have one Zeno point per period, but it has {len(points)}"
            raise InputError(f"Argument `orbit` {wanted}.")
        return points[0]

    @checked
    def with_phases(self, phases: Sequence[OrbitPhase]) -> Orbit:
        """Return the orbit with other phases of its one stop.

        Args:
            phases: The phases of a period, which ends where it did.

        Raises:
            InputError: If the phases are not possible together.
        """
        shape = EventSequence(phases=tuple(phase.kind for phase in phases))
        events, start = _events(phases, self.period), phases[0].start_state
        return replace(self, events=events, start_state=start, phases_as=shape)

    def as_json(self) -> dict[str, Any]:
        """Return the orbit as the plain data of its file, without `problem_file`."""
        digest = {"problem_digest": list(self.problem_digest)} if self.problem_digest else {}
        shape = {} if self.phases_as is None else {"shape": self.phases_as.text}
        return {
            "format": FORMAT,
            "problem": self.problem,
            "parameters": dict(self.parameters),
            "gains": dict(self.gains),
            "sequence": list(self.sequence),
            **shape,
            "period": self.period,
            "start_state": dict(self.start_state),
            "events": [_plain(event) for event in self.events],
            "floquet_multipliers": [[mu.real, mu.imag] for mu in self.floquet_multipliers],
            "certificate": dict(self.certificate),
            "versions": dict(self.versions),
            **digest,
        }

    @checked
    def values(self, problem: Problem) -> ParameterValues:
        """Return the orbit's parameter values for its problem.

        Raises:
            InputError: If the names or values do not fit the problem.
        """
        return problem.values(gains=self.gains, parameters=self.parameters)

    @checked
    def machine(self, problem: Problem) -> HybridDynamics | GraphDynamics:
        """Return the machine of the orbit at its gains and parameters.

        Raises:
            InputError: If the names or values do not fit the problem.
        """
        values = self.values(problem)
        return problem.dynamics(values) if self.has_phases else problem.graph_dynamics(values)


def orbit_of_events(
    problem: Problem,
    values: ParameterValues,
    *,
    period: float,
    start_state: Mapping[str, float],
    events: Sequence[OrbitEvent],
) -> Orbit:
    """Return an orbit without a certificate, computed by this version.

    Args:
        problem: Its problem.
        values: The problem's parameter values.
        period: Period [s].
        start_state: State name to value at its start.
        events: Its events.
    """
    return Orbit(
        problem=problem.name,
        parameters=dict(values.parameters),
        gains=dict(values.gains),
        period=period,
        start_state=start_state,
        events=tuple(events),
        versions=versions(),
        problem_digest=digest_of(problem),
        problem_file=RecordedFile.of(problem),
    )


def _impact(event: OrbitEvent) -> OrbitImpact:
    return OrbitImpact(time=event.time, state_minus=event.state)


def _phases(
    shape: EventSequence, events: Sequence[OrbitEvent], start_state: Mapping[str, float]
) -> tuple[OrbitPhase, ...]:
    """Return the phases that events of one stop form.

    Raises:
        InputError: If the events do not have the shape.
    """
    found: list[OrbitPhase] = []
    left, time, state = [*events], 0.0, start_state
    for kind in shape.phases:
        # An impact that the stop throws off is a phase. Other impacts belong to a Zeno point.
        most = len(left) if kind.holds else 1
        impacts = [*takewhile(lambda event: event.name == f"impact {_STOP}", left[:most])]
        ends = left[len(impacts) :][:2] if kind.holds else []
        if [event.name for event in ends] != _ENDS[kind.holds] or not (ends or impacts):
            break
        *others, last = impacts + ends
        begins = not kind.holds and len(found) + 1 < len(shape.phases)
        if (last.after is not None) != begins or any(one.after is not None for one in others):
            break
        zeno = ends[0] if ends else None
        found.append(
            OrbitPhase(
                kind=kind,
                start_time=time,
                start_state=state,
                impacts=tuple(map(_impact, impacts)),
                zeno_time=None if zeno is None else zeno.time,
                zeno_state=None if zeno is None else zeno.state,
            )
        )
        left = left[len(impacts) + len(ends) :]
        time, state = last.time, last.state if last.after is None else last.after
    if left or len(found) < len(shape.phases):
        listed = ", ".join(sequence_of([event.name for event in events]))
        raise InputError(f"Argument `orbit` says `{shape.text}`, but its events are `{listed}`.")
    return tuple(found)


def _events(phases: Sequence[OrbitPhase], period: float) -> tuple[OrbitEvent, ...]:
    """Return the events of phases of one stop, which is named `stop`."""
    found: list[OrbitEvent] = []
    ends = [(phase.start_time, phase.start_state) for phase in phases[1:]]
    ends.append((period, phases[0].start_state))
    for k, (phase, (time, state)) in enumerate(zip(phases, ends, strict=True), 1):
        after = None if phase.kind.holds or k == len(phases) else state
        found += [
            OrbitEvent(name=f"impact {_STOP}", time=one.time, state=one.state_minus, after=after)
            for one in phase.impacts
        ]
        if phase.zeno_time is not None and phase.zeno_state is not None:
            zeno = phase.zeno_time, phase.zeno_state
            found.append(OrbitEvent(name=f"zeno {_STOP}", time=zeno[0], state=zeno[1]))
        if phase.kind.holds:
            found.append(OrbitEvent(name=f"release {_STOP}", time=time, state=state))
    return tuple(found)


def _plain(event: OrbitEvent) -> dict[str, Any]:
    after = {} if event.after is None else {"after": dict(event.after)}
    return {"name": event.name, "time": event.time, "state": dict(event.state), **after}
