"""Files of orbits that list events: JSON that stores every number to the last bit."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import OrbitFileError
from zeno_orbits.model import RecordedFile
from zeno_orbits.orbits.events.event_orbit import EventOrbit, OrbitEvent, sequence_of
from zeno_orbits.orbits.orbit import EVENT_FORMAT, ZenoOrbit
from zeno_orbits.orbits.orbit_file import orbit_from_json, plain_data, write_orbit_data
from zeno_orbits.work import EntryError, checked, from_plain


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
    problem_digest: tuple[float, ...] = ()
    problem_file: str = ""


@checked
def write_event_orbit(orbit: EventOrbit, path: Path | str) -> None:
    """Write an orbit file completely or not at all.

    Args:
        orbit: The orbit.
        path: The file. An existing file is replaced.

    Raises:
        InputError: If the folder cannot be written.
    """
    write_orbit_data(orbit.as_json(), orbit.problem_file, Path(path))


def _lists_events(data: object) -> bool:
    return isinstance(data, dict) and cast("dict[str, Any]", data).get("format") == EVENT_FORMAT


@checked
def read_event_orbit(path: Path | str) -> EventOrbit:
    """Read an orbit file that lists events.

    Args:
        path: The file.

    Raises:
        OrbitFileError: If the file is not such a file, or its entries contradict each other.
    """
    path = Path(path)
    return _event_orbit(path, plain_data(path))


@checked
def read_any_orbit(path: Path | str) -> ZenoOrbit | EventOrbit:
    """Read an orbit file of any format.

    Args:
        path: The file.

    Raises:
        OrbitFileError: If the file is not such a file, or its entries contradict each other.
    """
    path = Path(path)
    data = plain_data(path)
    return _event_orbit(path, data) if _lists_events(data) else orbit_from_json(data, path)


def _event_orbit(path: Path, data: object) -> EventOrbit:
    try:
        entries = from_plain(_Entries, data, finite=True)
    except EntryError as error:
        raise OrbitFileError(path, str(error)) from error
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
        problem_digest=entries.problem_digest,
        problem_file=RecordedFile.beside(path.parent, entries.problem_file),
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
    if found not in (entries.sequence, _without_kinks(entries.sequence)):
        said, has = ", ".join(entries.sequence), ", ".join(found)
        raise OrbitFileError(path, f"its `sequence` is `{said}`, but its events are `{has}`")


def _without_kinks(sequence: Sequence[str]) -> tuple[str, ...]:
    """Return a sequence of a former file without the kinks in flights that accumulate."""
    zenos = {name: name.replace("zeno", "impact", 1) for name in sequence if name[:5] == "zeno "}
    return sequence_of(
        [one for name in sequence for one in ((zenos[name], name) if name in zenos else (name,))]
    )
