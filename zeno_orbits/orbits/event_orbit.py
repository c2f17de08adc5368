"""A periodic orbit as a sequence of events, for machines with several stops or switches."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import OrbitFileError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.simulation import Event, ZenoPoint, event_name
from zeno_orbits.work import Columns, Displayed, EntryError, by_name, restored, write_whole

EVENT_FORMAT = 3
"""Version of the format of orbit files that list events."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitEvent:
    """An event of an orbit.

    Attributes:
        name: Kind of the event, and its stop or switch, such as ``impact knee``.
        time: Time since the start of the period [s].
        state: State name to value just before the event.
    """

    name: str
    time: float
    state: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class EventOrbit(Displayed):
    """A periodic orbit of a machine with several stops or switches. Times count from its start.

    Attributes:
        problem: Name of the problem.
        parameters: Name to value, for all parameters.
        gains: Name to value, for all gains.
        period: Period [s].
        start_state: State name to value just after the last event of the period.
        events: All events of the period in order. The last event ends the period.
        floquet_multipliers: Multipliers of the return map. Empty while unknown.
        certificate: Result of a verification, as plain data. Empty while unverified.
        versions: Name to version of the packages that computed it.
    """

    problem: str
    parameters: Mapping[str, float]
    gains: Mapping[str, float]
    period: float
    start_state: Mapping[str, float]
    events: tuple[OrbitEvent, ...]
    floquet_multipliers: tuple[complex, ...] = ()
    certificate: Mapping[str, Any] = field(default_factory=dict[str, Any])
    versions: Mapping[str, str] = field(default_factory=dict[str, str])

    def __repr__(self) -> str:
        """Return one line with the period, the event sequence and the verification status."""
        known = ", ".join(f"{abs(value):.3g}" for value in self.floquet_multipliers)
        moduli = f"multipliers of modulus {known}, " if known else ""
        verified = bool(self.certificate.get("passed"))
        return (
            f"<EventOrbit of {self.problem}: period={self.period:.10g} s, "
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

        Impacts that accumulate belong to the entry of their Zeno point.
        """
        return sequence_of([event.name for event in self.events])

    @property
    def section(self) -> str:
        """Name of the event at which the period starts and ends."""
        return self.events[-1].name

    @property
    def n_returns(self) -> int:
        """Number of such events in a period."""
        return sum(event.name == self.section for event in self.events)

    def values(self, problem: Problem) -> ParameterValues:
        """Return the orbit's parameter values for its problem.

        Raises:
            InputError: If the names or values do not fit the problem.
        """
        return problem.values(gains=self.gains, parameters=self.parameters)

    def as_json(self) -> dict[str, Any]:
        """Return the orbit as the plain data of its file."""
        return {
            "format": EVENT_FORMAT,
            "problem": self.problem,
            "parameters": dict(self.parameters),
            "gains": dict(self.gains),
            "sequence": list(self.sequence),
            "period": self.period,
            "start_state": dict(self.start_state),
            "events": [
                {"name": event.name, "time": event.time, "state": dict(event.state)}
                for event in self.events
            ],
            "floquet_multipliers": [[mu.real, mu.imag] for mu in self.floquet_multipliers],
            "certificate": dict(self.certificate),
            "versions": dict(self.versions),
        }


def sequence_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the event sequence of all events, without the impacts before their Zeno point.

    Args:
        names: Names of the events in order.
    """
    return tuple(names[phase[-1]] for phase in phases_of_events(names))


def phases_of_events(names: Sequence[str]) -> list[list[int]]:
    """Return the indices of the events of each phase: impacts belong to their Zeno point.

    Args:
        names: Names of the events in order.
    """
    phases: list[list[int]] = []
    for k, name in enumerate(names):
        kind, _, what = name.partition(" ")
        phase = [k]
        while kind == "zeno" and phases and names[phases[-1][-1]] == f"impact {what}":
            phase = phases.pop() + phase
        phases.append(phase)
    return phases


def orbit_event_name(event: Event) -> str:
    """Return the name of an event in orbit files, such as ``zeno knee``.

    Args:
        event: The event.
    """
    return f"zeno {event.stop}" if isinstance(event, ZenoPoint) else event_name(event)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Entries:
    """Entries of the file."""

    problem: str
    parameters: Mapping[str, float]
    gains: Mapping[str, float]
    period: float
    start_state: Mapping[str, float]
    events: tuple[OrbitEvent, ...]
    sequence: tuple[str, ...]
    floquet_multipliers: tuple[complex, ...] = ()
    certificate: Mapping[str, Any] = field(default_factory=dict[str, Any])
    versions: Mapping[str, Any] = field(default_factory=dict[str, Any])


def write_event_orbit(orbit: EventOrbit, path: Path | str) -> None:
    """Write an orbit file completely or not at all.

    Args:
        orbit: The orbit.
        path: The file. An existing file is replaced.

    Raises:
        InputError: If the folder cannot be written.
    """
    write_whole(Path(path), json.dumps(orbit.as_json(), indent=2, allow_nan=False) + "\n")


def holds_events(path: Path | str) -> bool:
    """Return True if a file is an orbit file that lists events."""
    try:
        data: object = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(data, dict) and cast("dict[str, Any]", data).get("format") == EVENT_FORMAT


def read_event_orbit(path: Path | str) -> EventOrbit:
    """Read an orbit file that lists events.

    Args:
        path: The file.

    Raises:
        OrbitFileError: If the file is not such a file, or its entries contradict each other.
    """
    path = Path(path)
    try:
        data: object = json.loads(path.read_text(encoding="utf-8"))
        entries = restored(_Entries, data, finite=True)
    except OSError as error:
        raise OrbitFileError(path, f"it cannot be read ({error.strerror})") from error
    except UnicodeDecodeError as error:
        raise OrbitFileError(path, "it is not UTF-8 text") from error
    except EntryError as error:
        raise OrbitFileError(path, str(error)) from error
    except (ValueError, RecursionError) as error:
        raise OrbitFileError(path, f"it is not complete JSON ({error})") from error
    _require_order(path, entries)
    return EventOrbit(
        problem=entries.problem,
        parameters=entries.parameters,
        gains=entries.gains,
        period=entries.period,
        start_state=entries.start_state,
        events=entries.events,
        floquet_multipliers=entries.floquet_multipliers,
        certificate=entries.certificate,
        versions={name: str(value) for name, value in entries.versions.items()},
    )


def _require_order(path: Path, entries: _Entries) -> None:
    """Reject events that contradict each other.

    Raises:
        OrbitFileError: If a period is not positive, an event comes before the one before it or
            after the period, or the sequence belongs to other events.
    """
    times = [0.0, *(event.time for event in entries.events)]
    if not entries.events or not entries.period > 0.0:
        raise OrbitFileError(path, "it must have a positive `period` and at least one event")
    if any(later < earlier for earlier, later in itertools.pairwise(times)):
        raise OrbitFileError(path, "its `events` are not in order of time")
    if times[-1] != entries.period:
        raise OrbitFileError(path, "its last event is not at the end of its `period`")
    found = sequence_of([event.name for event in entries.events])
    if found != entries.sequence:
        said, has = ", ".join(entries.sequence), ", ".join(found)
        raise OrbitFileError(path, f"its `sequence` is `{said}`, but its events are `{has}`")
