"""Orbit files: JSON that stores every number of an orbit to the last bit.

One format is written. Those of older versions are read: format 1 is a period from release to
release, and format 2 a list of phases, both of a machine with one stop.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import InputError, OrbitFileError, newer_format, shortened
from zeno_orbits.model import RecordedFile
from zeno_orbits.orbits.orbit import FORMAT, Orbit, OrbitEvent, OrbitImpact, OrbitPhase
from zeno_orbits.orbits.sequences import sequence_of
from zeno_orbits.orbits.shape import EventSequence, PhaseKind
from zeno_orbits.work import EntryError, checked, from_plain, read_json, write_whole

MOST_EVENTS = 10_000
"""Largest number of events of a period in a file. The verification takes about 0.1 ms for each."""
_MOST_BYTES = 1 << 26
"""Largest size of an orbit file [B]: an event of 10 states has about 400."""
_ONE_RELEASE, _PHASES = 1, 2
"""Older versions of the format."""


@checked
def write_orbit(orbit: Orbit, path: Path | str) -> None:
    """Write an orbit file completely or not at all.

    Args:
        orbit: The orbit.
        path: The file. An existing file is replaced.

    Raises:
        InputError: If the folder cannot be written.
    """
    path, file = Path(path), orbit.problem_file
    entry = {} if file is None else {"problem_file": file.relative_to(path.parent)}
    text = json.dumps({**orbit.as_json(), **entry}, indent=2, allow_nan=False) + "\n"
    write_whole(path, text, "path")


@checked
def read_orbit(path: Path | str) -> Orbit:
    """Read an orbit file, every number to the last bit.

    Args:
        path: The file.

    Raises:
        OrbitFileError: If the file is missing, truncated, of a wrong type or of a newer format, if
            a name occurs twice in it, or if its entries contradict each other.
    """
    path = Path(path)
    return orbit_from_json(_plain_data(path), path)


def _plain_data(path: Path) -> object:
    """Return the plain data of a JSON file in which every name occurs once.

    Raises:
        OrbitFileError: If the file is missing, truncated, no text, or repeats a name.
    """
    try:
        data = read_json(path, most=_MOST_BYTES, constants=True)
    except ValueError as error:
        raise OrbitFileError(path, str(error)) from error
    for name, entry in _lists(data):
        if len(entry) > MOST_EVENTS:
            reason = f"its `{name}` has {len(entry)} entries, and the most is {MOST_EVENTS}"
            raise OrbitFileError(path, reason)
    return data


def _lists(data: object) -> Iterator[tuple[str, list[Any]]]:
    """Yield the lists of an orbit and of its phases, with their names."""
    if isinstance(data, dict):
        for name, entry in cast("dict[str, Any]", data).items():
            if isinstance(entry, list):
                listed = cast("list[Any]", entry)
                yield name, listed
                for inner in listed[:MOST_EVENTS]:
                    yield from _lists(inner)


@checked
def orbit_from_json(data: object, path: Path) -> Orbit:
    """Return the orbit of the plain data from `Orbit.as_json`, or from a file of an older version.

    Args:
        data: Plain data.
        path: File of the data, for messages.

    Raises:
        OrbitFileError: If the data have a wrong type or a newer format.
    """
    try:
        return _orbit(data, path.parent)
    except EntryError as error:
        raise OrbitFileError(path, str(error)) from error
    except _ContradictionError as error:
        raise OrbitFileError(path, str(error)) from error


class _ContradictionError(ValueError):
    """Entries of a file do not fit each other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Entries:
    """Entries of all formats."""

    problem: str
    parameters: Mapping[str, float]
    gains: Mapping[str, float]
    period: float
    floquet_multipliers: tuple[complex, ...] = ()
    shape: str = ""
    certificate: Mapping[str, Any] = field(default_factory=dict[str, Any])
    versions: Mapping[str, Any] = field(default_factory=dict[str, Any])
    problem_digest: tuple[float, ...] = ()
    problem_file: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Listed:
    """The period as events."""

    start_state: Mapping[str, float]
    events: tuple[OrbitEvent, ...]
    sequence: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _OneRelease:
    """The period in format 1: from release to release."""

    release_state: Mapping[str, float]
    impacts: tuple[OrbitImpact, ...]
    zeno_time: float
    zeno_state: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Phase:
    """A phase in format 2."""

    kind: str
    start_time: float
    start_state: Mapping[str, float]
    impacts: tuple[OrbitImpact, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class _HeldPhase(_Phase):
    """A phase in format 2 whose impacts end in contact."""

    zeno_time: float
    zeno_state: Mapping[str, float]


def _orbit(data: object, folder: Path) -> Orbit:
    if not isinstance(data, dict):
        raise EntryError("the file", "an object with names", _shown(data))
    named = cast("dict[str, Any]", data)
    number = _format(named)
    entries = from_plain(_Entries, named, finite=True)
    _require_positive("period", entries.period)
    orbit = Orbit(
        problem=entries.problem,
        parameters=entries.parameters,
        gains=entries.gains,
        period=entries.period,
        start_state={},
        events=(),
        floquet_multipliers=entries.floquet_multipliers,
        certificate=entries.certificate,
        versions={name: str(value) for name, value in entries.versions.items()},
        problem_digest=entries.problem_digest,
        problem_file=RecordedFile.beside(folder, entries.problem_file),
    )
    if number == FORMAT:
        return _with_events(orbit, from_plain(_Listed, named, finite=True), entries.shape)
    phases = (_one_release(named, entries.shape),) if number == _ONE_RELEASE else _phases(named)
    try:
        orbit = orbit.with_phases(phases)
    except InputError as error:
        message = f"its phases are not a valid shape: {error}".removesuffix(".")
        raise _ContradictionError(message) from error
    _require_shape(named, orbit.shape, number)
    return orbit


def _shown(data: object) -> str:
    """Return data as in a JSON file, cut if they are long."""
    try:
        return json.dumps(data, default=str)[:40]
    except (TypeError, ValueError, RecursionError):
        return shortened(repr(data))


def _format(entries: Mapping[str, Any]) -> int:
    number = entries.get("format")
    if isinstance(number, bool) or not isinstance(number, int) or number < 1:
        found = json.dumps(number) if "format" in entries else "missing"
        raise EntryError("format", "a positive whole number", found)
    if number > FORMAT:
        raise _ContradictionError(newer_format(number, FORMAT))
    return number


# Events.


def _with_events(orbit: Orbit, listed: _Listed, shape: str) -> Orbit:
    """Return an orbit with the events of a file."""
    kinds = _shape_of(shape) if shape else None
    found = replace(orbit, start_state=listed.start_state, events=listed.events, phases_as=kinds)
    _require_order(listed)
    if kinds is None and listed.events[-1].time != orbit.period:
        raise _ContradictionError("its last event is not at the end of its `period`")
    if kinds is None and any(event.after is not None for event in listed.events):
        raise _ContradictionError("an event has `after`, which needs a `shape`")
    if kinds is not None:
        try:
            _ = found.phases
        except InputError as error:
            said = f"its `shape` is `{shape}`, but its events are `{', '.join(found.sequence)}`"
            raise _ContradictionError(said) from error
    return found


def _shape_of(text: str) -> EventSequence:
    try:
        return EventSequence.parsed(text)
    except InputError as error:
        wanted = "phases such as `zeno` or `impact*2`"
        raise EntryError("shape", wanted, json.dumps(text)) from error


def _require_order(listed: _Listed) -> None:
    """Reject events that contradict each other.

    Raises:
        _ContradictionError: If an event comes before the one before it, or the sequence belongs to
            other events.
    """
    times = [0.0, *(event.time for event in listed.events)]
    if not listed.events:
        raise _ContradictionError("it must have at least one event")
    if any(later < earlier for earlier, later in itertools.pairwise(times)):
        raise _ContradictionError("its `events` are not in order of time")
    found = sequence_of([event.name for event in listed.events])
    if listed.sequence not in (found, _joined(found)) and found != _without_kinks(listed.sequence):
        said, has = ", ".join(listed.sequence), ", ".join(found)
        raise _ContradictionError(f"its `sequence` is `{said}`, but its events are `{has}`")


def _without_kinks(sequence: Sequence[str]) -> tuple[str, ...]:
    """Return a sequence of a former file without the kinks in flights that accumulate."""
    zenos = {name: name.replace("zeno", "impact", 1) for name in sequence if name[:5] == "zeno "}
    return sequence_of(
        [one for name in sequence for one in ((zenos[name], name) if name in zenos else (name,))]
    )


def _joined(sequence: Sequence[str]) -> tuple[str, ...]:
    """Return a sequence as former files hold it.

    A plastic impact that lets go, and the kinks after it, are joined to the next Zeno point.
    """
    joined: list[str] = []
    for name in sequence:
        if name.startswith("zeno "):
            impact, place = name.replace("zeno", "impact", 1), len(joined)
            while place and (joined[place - 1] == impact or joined[place - 1][:7] == "switch "):
                place -= 1
            place += next((k for k, one in enumerate(joined[place:]) if one == impact), len(joined))
            del joined[place:]
        joined.append(name)
    return tuple(joined)


# Phases of older files.


def _one_release(entries: Mapping[str, Any], shape: str) -> OrbitPhase:
    """Return the only phase of format 1. Its first files do not name the kind of the phase."""
    one = from_plain(_OneRelease, entries, finite=True)
    _require_positive("zeno_time", one.zeno_time)
    at_once = len(one.impacts) == 1 and one.impacts[0].time == one.zeno_time
    seen = PhaseKind.PLASTIC if at_once else PhaseKind.ZENO
    return OrbitPhase(
        kind={kind.value: kind for kind in PhaseKind if kind.holds}.get(shape, seen),
        start_time=0.0,
        start_state=one.release_state,
        impacts=one.impacts,
        zeno_time=one.zeno_time,
        zeno_state=one.zeno_state,
    )


def _phases(entries: Mapping[str, Any]) -> tuple[OrbitPhase, ...]:
    listed = entries.get("phases")
    if not isinstance(listed, list) or not listed:
        found = json.dumps(listed)[:40] if "phases" in entries else "missing"
        raise EntryError("phases", "a list of one phase or more", found)
    return tuple(_phase(entry, k) for k, entry in enumerate(cast("list[Any]", listed)))


def _phase(data: object, place: int) -> OrbitPhase:
    where = f"phases[{place}]"
    kinds = {kind.value: kind for kind in PhaseKind}
    phase = from_plain(_Phase, data, where, finite=True)
    if phase.kind not in kinds:
        raise EntryError(f"{where}.kind", f"one of {', '.join(kinds)}", json.dumps(phase.kind))
    if (phase.start_time == 0.0) != (place == 0) or phase.start_time < 0.0:
        wanted = "0" if place == 0 else "later than 0"
        raise EntryError(f"{where}.start_time", wanted, f"{phase.start_time:g}")
    kind, zeno_time, zeno_state = kinds[phase.kind], None, None
    if kind.holds:
        held = from_plain(_HeldPhase, data, where, finite=True)
        _require_positive(f"{where}.zeno_time", held.zeno_time)
        zeno_time, zeno_state = held.zeno_time, held.zeno_state
    elif {"zeno_time", "zeno_state"} & set(cast("dict[str, Any]", data)):
        message = f"`{where}.kind` is `{phase.kind}`, and yet there is a Zeno point"
        raise _ContradictionError(message)
    return OrbitPhase(
        kind=kind,
        start_time=phase.start_time,
        start_state=phase.start_state,
        impacts=phase.impacts,
        zeno_time=zeno_time,
        zeno_state=zeno_state,
    )


def _require_positive(name: str, value: float) -> None:
    if not value > 0.0:
        raise EntryError(name, "positive", f"{value:g}")


def _require_shape(entries: Mapping[str, Any], shape: EventSequence, number: int) -> None:
    """Reject phases of a shape unlike the file's."""
    if number == _PHASES and "shape" not in entries:
        raise EntryError("shape", "there", "missing")
    said = entries.get("shape", shape.text)
    if said != shape.text:
        raise _ContradictionError(f"its `shape` is `{said}`, but its phases are `{shape.text}`")
