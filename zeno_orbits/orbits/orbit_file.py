"""Orbit files: JSON that stores every number of an orbit to the last bit."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import InputError, OrbitFileError, newer_format, shortened
from zeno_orbits.model import RecordedFile
from zeno_orbits.orbits.orbit import (
    EVENT_FORMAT,
    FORMAT,
    ONE_RELEASE,
    OrbitImpact,
    OrbitPhase,
    ZenoOrbit,
    one_release_phase,
)
from zeno_orbits.orbits.shape import PhaseKind
from zeno_orbits.work import EntryError, checked, from_plain, read_json, write_whole

MOST_EVENTS = 10_000
"""Largest number of events of a period in a file. The verification takes about 0.1 ms for each."""
_MOST_BYTES = 1 << 26
"""Largest size of an orbit file [B]: an event of 10 states has about 400."""


@checked
def write_orbit(orbit: ZenoOrbit, path: Path | str) -> None:
    """Write an orbit file completely or not at all.

    Args:
        orbit: The orbit.
        path: The file. An existing file is replaced.

    Raises:
        InputError: If the folder cannot be written.
    """
    write_orbit_data(orbit.as_json(), orbit.problem_file, Path(path))


def write_orbit_data(data: Mapping[str, Any], file: RecordedFile | None, path: Path) -> None:
    """Write the plain data of an orbit and the path of its problem file, relative to its folder.

    Args:
        data: The plain data.
        file: File of the problem, or None.
        path: The file. An existing file is replaced.

    Raises:
        InputError: If the folder cannot be written.
    """
    entry = {} if file is None else {"problem_file": file.relative_to(path.parent)}
    text = json.dumps({**data, **entry}, indent=2, allow_nan=False) + "\n"
    write_whole(path, text, "path")


@checked
def read_orbit(path: Path | str) -> ZenoOrbit:
    """Read an orbit file, every number to the last bit.

    Args:
        path: The file.

    Raises:
        OrbitFileError: If the file is missing, truncated, of a wrong type or of a newer format, if
            a name occurs twice in it, or if its entries contradict each other.
    """
    path = Path(path)
    return orbit_from_json(plain_data(path), path)


def plain_data(path: Path) -> object:
    """Return the plain data of a JSON file in which every name occurs once.

    Args:
        path: The file.

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
def orbit_from_json(data: object, path: Path) -> ZenoOrbit:
    """Return the orbit of the plain data from `ZenoOrbit.as_json`.

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
    """Entries of both formats."""

    problem: str
    parameters: Mapping[str, float]
    gains: Mapping[str, float]
    period: float
    floquet_multipliers: tuple[complex, ...]
    shape: str = ""
    certificate: Mapping[str, Any] = field(default_factory=dict[str, Any])
    versions: Mapping[str, Any] = field(default_factory=dict[str, Any])
    problem_digest: tuple[float, ...] = ()
    problem_file: str = ""


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


def _orbit(data: object, folder: Path) -> ZenoOrbit:
    if not isinstance(data, dict):
        raise EntryError("the file", "an object with names", _shown(data))
    named = cast("dict[str, Any]", data)
    number = _format(named)
    entries = from_plain(_Entries, named, finite=True)
    _require_positive("period", entries.period)
    phases = (_one_release(named, entries.shape),) if number == ONE_RELEASE else _phases(named)
    orbit = ZenoOrbit(
        problem=entries.problem,
        parameters=entries.parameters,
        gains=entries.gains,
        period=entries.period,
        phases=phases,
        floquet_multipliers=entries.floquet_multipliers,
        certificate=entries.certificate,
        versions={name: str(value) for name, value in entries.versions.items()},
        problem_digest=entries.problem_digest,
        problem_file=RecordedFile.beside(folder, entries.problem_file),
    )
    _require_shape(named, orbit, number)
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
    if number == EVENT_FORMAT:
        machine = "a machine with several stops or switches"
        raise _ContradictionError(f"its format {number} is of {machine} (`read_event_orbit`)")
    if number > FORMAT:
        raise _ContradictionError(newer_format(number, EVENT_FORMAT))
    return number


def _one_release(entries: Mapping[str, Any], shape: str) -> OrbitPhase:
    period = from_plain(_OneRelease, entries, finite=True)
    _require_positive("zeno_time", period.zeno_time)
    phase = one_release_phase(
        release_state=period.release_state,
        impacts=period.impacts,
        zeno_time=period.zeno_time,
        zeno_state=period.zeno_state,
    )
    said = {kind.value: kind for kind in PhaseKind if kind.holds}.get(shape)
    return phase if said is None else replace(phase, kind=said)


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


def _require_shape(entries: Mapping[str, Any], orbit: ZenoOrbit, number: int) -> None:
    """Reject phases of an invalid shape, of a shape unlike the file's, or of the other format."""
    try:
        shape = orbit.shape
    except InputError as error:
        message = f"its phases are not a valid shape: {error}".removesuffix(".")
        raise _ContradictionError(message) from error
    if number == FORMAT and "shape" not in entries:
        raise EntryError("shape", "there", "missing")
    said = entries.get("shape", shape.text)
    if said != shape.text:
        raise _ContradictionError(f"its `shape` is `{said}`, but its phases are `{shape.text}`")
    if shape.has_one_release and number != ONE_RELEASE:
        message = f"a shape `{said}` has format {ONE_RELEASE}, but it has {number}"
        raise _ContradictionError(message)
