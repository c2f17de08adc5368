"""Recordings: named signals over time, from a machine or from a simulation, and their files.

The file is a table, by commas or otherwise, with a line of titles ``name [unit]`` and above it, if
they are known, lines ``# key: value`` (docs/measured_data.md)::

    # zeno-orbits data 1
    # source: measured
    # problem: some_problem
    time [ms],angle [deg],current [mA]
    0.0,12.5,-310
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from textwrap import shorten

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import (
    DataFileError,
    InputError,
    counted,
    did_you_mean,
    newer_format,
    not_known,
)
from zeno_orbits.experiment.recordings.columns import TIMES, Column, ColumnNotes, columns_of
from zeno_orbits.experiment.recordings.heads import Head, read_head
from zeno_orbits.experiment.recordings.table import ColumnTable, read_table
from zeno_orbits.work import ByValue, checked, require_kinds, write_pieces

FORMAT = 1
"""Version of the file format that this code writes, and the newest that it reads."""

_MAGIC = re.compile(r"zeno-orbits data (\d+)")
_TIMELY = re.compile(r"\b(time|zeit)\b", flags=re.IGNORECASE)
"""A title that may be that of the times."""
_ROWS = 1 << 16
"""Rows that are written at a time."""
ONE_OF_TWO = "rename or delete one, or name it by its number, such as --column 2=NAME"
"""Remedy for two columns with one name."""
_FEW, _UNEVEN = 3, 1.5
"""Steps of a file of changes at least, and ratio of its longest to its shortest step."""
_GAP = 5.0
"""A pause of so many usual steps counts as a gap."""


class Source(Enum):
    """Origin of a recording. The value is the word in its file."""

    MEASURED = "measured"
    SIMULATED = "simulated"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class RecordedSignal(ByValue):
    """One quantity over time.

    Attributes:
        name: Its name.
        unit: An SI unit.
        values: ``(n_t,)``, NaN where it was not taken.
    """

    name: str
    unit: str
    values: Vector

    def __post_init__(self) -> None:
        """Refuse values of a wrong kind."""
        require_kinds(self)

    def __repr__(self) -> str:
        """Return one line: name, unit and number of values."""
        return f"<RecordedSignal {self.name} [{self.unit}]: values={len(self.values)}>"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Recording(ByValue):
    """Signals that were recorded together.

    Attributes:
        source: Origin of the signals, or ``None`` if unknown.
        problem: Name of the problem that the signals belong to, or an empty string if unknown.
        time: Increasing, ``(n_t,)`` [s].
        signals: The signals, with different names.
        notes: Further facts about the recording, as texts without line ends.
        remarks: Omissions and irregularities found by the reader, as sentences without full stops.
    """

    source: Source | None
    problem: str
    time: Vector
    signals: tuple[RecordedSignal, ...]
    notes: Mapping[str, str] = field(default_factory=dict[str, str])
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse wrong kinds, times that do not increase, and signals that do not fit together."""
        require_kinds(self)
        if self.time.ndim != 1 or len(self.time) < 2 or not np.all(np.diff(self.time) > 0.0):
            raise ValueError("Argument `time` must hold two or more times that increase.")
        names = [signal.name for signal in self.signals]
        if len(set(names)) != len(names):
            raise ValueError(f"Argument `signals` must have different names, but they are {names}.")
        for signal in self.signals:
            if signal.values.shape != self.time.shape:
                wanted = f"must have {len(self.time)} values each"
                has = f"`{signal.name}` has {len(signal.values)}"
                raise ValueError(f"Argument `signals` {wanted}, but {has}.")

    def __repr__(self) -> str:
        """Return one line: the span of time and the signals."""
        return (
            f"<Recording of {self.problem or 'an unknown problem'} from {self.time[0]:g} to "
            f"{self.time[-1]:.9g} s: times={len(self.time)}, signals={', '.join(self.names)}>"
        )

    @property
    def label(self) -> str:
        """Label in a comparison with an orbit, which states whether the recording was simulated."""
        return "recording" if self.source is None else f"recording, {self.source.value}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals."""
        return tuple(signal.name for signal in self.signals)

    @checked
    def signal(self, name: str) -> RecordedSignal:
        """Return a signal by its name.

        Raises:
            InputError: If no signal has this name.
        """
        for signal in self.signals:
            if signal.name == name:
                return signal
        raise InputError(f"Argument `signal`: {not_known(name, self.names)}")


def crop_recording(recording: Recording, since: float | None, until: float | None) -> Recording:
    """Return the part of a recording between two times.

    Args:
        recording: The whole.
        since: Earliest time to keep, by default the beginning [s].
        until: Latest time to keep, by default the end [s].

    Raises:
        InputError: If fewer than two rows are left.
    """
    if since is None and until is None:
        return recording
    low = -np.inf if since is None else since
    high = np.inf if until is None else until
    first = int(np.searchsorted(recording.time, low, side="left"))
    last = int(np.searchsorted(recording.time, high, side="right"))
    if last - first < 2:
        whole = f"[{recording.time[0]:.6g}, {recording.time[-1]:.6g}] s"
        wanted = f"must leave two rows of the recording, which covers {whole}"
        argument = "t_end" if since is None else "t_start"
        raise InputError(f"Argument `{argument}` {wanted}, but [{low:g}, {high:g}] s leaves fewer.")
    part = slice(first, last)
    signals = tuple(replace(one, values=one.values[part]) for one in recording.signals)
    return replace(recording, time=recording.time[part], signals=signals)


@checked
def write_recording(recording: Recording, path: Path | str) -> None:
    """Write a recording, whole or not at all, in digits that give back every bit.

    Raises:
        InputError: If the folder cannot be written.
    """
    write_pieces(Path(path), _written(recording), "path")


def _written(recording: Recording) -> Iterator[bytes]:
    lines = [f"# zeno-orbits data {FORMAT}"]
    if recording.source is not None:
        lines.append(f"# source: {recording.source.value}")
    if recording.problem:
        lines.append(f"# problem: {recording.problem}")
    lines += [f"# {key}: {value}" for key, value in recording.notes.items()]
    titles = (f"{signal.name} [{signal.unit}]" for signal in recording.signals)
    lines.append(",".join(("time [s]", *titles)))
    yield ("\n".join(lines) + "\n").encode()
    columns = (recording.time, *(signal.values for signal in recording.signals))
    for at in range(0, len(recording.time), _ROWS):
        rows = np.stack([column[at : at + _ROWS] for column in columns], axis=1).tolist()
        yield "".join(",".join(map(repr, row)) + "\n" for row in rows).encode()


@checked
def read_recording(
    path: Path | str,
    *,
    only: Collection[str] = (),
    families: Collection[str] = (),
    units: Mapping[str, str] | None = None,
    columns: ColumnNotes | None = None,
) -> Recording:
    """Read a recording in SI units.

    Lines above the titles, a line of units below them and columns of text do not matter.

    Rows without a time or with the same time as the previous row are omitted. Infinite values are
    treated as missing. ``remarks`` lists both.

    Args:
        path: The file.
        only: Names of the signals to read, if the file has them. All signals are read if `only` is
            empty. The contents of other columns do not matter then.
        families: Beginnings of further names to read. ``contact`` stands for ``contact`` and
            ``contact.STOP``, and ``impact`` for ``impact`` and ``impact STOP``.
        units: Units of the signals that a problem has, by name. The recorded units must measure the
            same, and the file must hold one of the signals, or a name of ``families``.
        columns: What is known of the columns in addition to their titles.

    Raises:
        DataFileError: If the file cannot be read or parsed, or does not fit ``units``. The message
            names the line.
    """
    known, told = units or {}, columns or ColumnNotes()
    path = Path(path)
    head = read_head(path, untitled=bool(told.names))
    notes = _notes(path, head)
    found = columns_of(head, known, told)
    names = [one.name for one in found]
    time = _time_column(path, head, found, told)
    wanted = only or [one.name for one in found if not one.holds_text]
    chosen = [
        k
        for k, name in enumerate(names)
        if k != time and name and (name in wanted or _family(name) in families)
    ]
    for k in chosen:
        if names.count(names[k]) > 1:
            twice = f"line {head.line}: two of its columns are named `{names[k]}`"
            raise DataFileError(path, f"{twice}: {ONE_OF_TWO}")
    if units is not None and not chosen:
        raise DataFileError(path, _no_signal(head, names, known, notes))
    for k in (*(() if time is None else (time,)), *chosen):
        if found[k].trouble:
            raise DataFileError(path, found[k].trouble)
    return _of_columns(path, head, notes, found, time, chosen, known, told)


def _family(name: str) -> str:
    """Return the beginning of a name, up to a point or a space."""
    return name.partition(".")[0].partition(" ")[0]


def _of_columns(
    path: Path,
    head: Head,
    notes: dict[str, str],
    columns: Sequence[Column],
    time: int | None,
    chosen: Sequence[int],
    known: Mapping[str, str],
    told: ColumnNotes,
) -> Recording:
    """Return the recording of chosen columns, whose units are known."""
    names = [one.name for one in columns]
    table = read_table(path, head, (*(() if time is None else (time,)), *chosen))
    if time is None and told.frame_rate is not None:
        frames: Vector = np.arange(table.values.shape[1], dtype=np.float64) / told.frame_rate
        table = replace(table, values=np.concatenate([frames[None], table.values]))
    kept, remarks = _sound_rows(path, table)
    places = (*(() if time is None else (time,)), *chosen)
    rows = table.values[table.values.shape[0] - len(places) :]
    # Whole columns are scaled without a copy: a second copy of a long recording may not fit.
    for row, k in zip(rows, places, strict=True):
        if columns[k].zero:
            row -= columns[k].zero
        if columns[k].size != 1.0:
            row *= columns[k].size
            # A zero has no sign.
            row += 0.0
    values = table.values if kept is None else table.values[:, kept]
    remarks += _missing(values[1:], [names[k] for k in chosen]) + _gaps(values[0])
    remarks += _changes(values)
    return Recording(
        source=_source(path, notes),
        problem=_problem(notes),
        time=values[0],
        signals=tuple(
            RecordedSignal(name=names[k], unit=columns[k].unit, values=row)
            for k, row in zip(chosen, values[1:], strict=True)
        ),
        notes=notes,
        remarks=(
            *table.remarks,
            *_texts(columns, known),
            *_ignored(head, names, chosen, known),
            *remarks,
        ),
    )


def _no_signal(
    head: Head, names: Sequence[str], known: Mapping[str, str], notes: Mapping[str, str]
) -> str:
    """Return the message about a file whose titles name no signal of a problem."""
    titled = shorten(", ".join(names), 400, placeholder=" ...")
    near = next(filter(None, (did_you_mean(name, known) for name in names)), "")
    word = _problem(dict(notes))
    belongs = f" The file is a recording of the problem `{word}`." if word else ""
    listed = ", ".join(known)
    return (
        f"line {head.line} names no signal of the problem (its columns: {titled}).{near}{belongs} "
        f"Known: {listed}"
    )


def _texts(columns: Sequence[Column], known: Mapping[str, str]) -> Iterator[str]:
    """Yield a remark about columns of text, if all columns count."""
    texts = [f"`{one.name}`" for one in columns if one.holds_text and not known]
    if texts:
        yield f"{counted(len(texts), 'column')} of text left out: {', '.join(texts)}"


def _ignored(
    head: Head, names: Sequence[str], chosen: Sequence[int], known: Mapping[str, str]
) -> Iterator[str]:
    """Yield remarks about columns whose title is near the name of a signal that is missing."""
    missing = [name for name in known if name not in names]
    for k, name in enumerate(names):
        near = did_you_mean(name, missing) if name and k not in chosen else ""
        if near and name.lower() not in TIMES:
            meant = near.removeprefix(" Did you mean ").removesuffix("?")
            told = (
                f"line {head.line}: column `{name}` is not a signal of the problem and was left out"
            )
            yield f"{told}: rename it if it is {meant}"


def _notes(path: Path, head: Head) -> dict[str, str]:
    notes: dict[str, str] = {}
    for comment in head.comments:
        magic = _MAGIC.fullmatch(comment)
        if magic is not None and int(magic[1]) > FORMAT:
            raise DataFileError(path, newer_format(int(magic[1]), FORMAT))
        key, colon, value = comment.partition(":")
        if magic is None and colon:
            notes[key.strip()] = value.strip()
    return notes


def _source(path: Path, notes: dict[str, str]) -> Source | None:
    word = notes.pop("source", None)
    known = {source.value: source for source in Source}
    if word is None:
        return None
    if word not in known:
        told = f"its line `# source:` must name one of {', '.join(known)}, not `{word}`"
        raise DataFileError(path, f"{told}.{did_you_mean(word, known)}")
    return known[word]


def _problem(notes: dict[str, str]) -> str:
    """Return the name of the problem. Files of version 0.1 store it under the key `scene`."""
    older = notes.pop("scene", "")
    return notes.pop("problem", older)


def _time_column(
    path: Path, head: Head, columns: Sequence[Column], told: ColumnNotes
) -> int | None:
    """Return the index of the column of times, or ``None`` if the rows are frames.

    Raises:
        DataFileError: If the file lacks one, or has more than one.
    """
    found = [k for k, one in enumerate(columns) if one.is_time]
    if len(found) == 1:
        return found[0]
    if not found and told.frame_rate is not None:
        return None
    names = [one.name for one in columns]
    titled = shorten(", ".join(names), 400, placeholder=" ...")
    count = "no" if not found else "more than one"
    near = next((one for one in names if did_you_mean(one, ("time",)) or _TIMELY.search(one)), "")
    remedy = f"rename `{near}` to `time`" if near and not found else "name one column `time`"
    said = f"line {head.line} has {count} column named `time` (its columns: {titled})"
    raise DataFileError(path, f"{said}: {remedy}")


def _sound_rows(path: Path, table: ColumnTable) -> tuple[NDArray[np.int64] | None, tuple[str, ...]]:
    """Return the indices of the rows to keep, ``None`` for all rows, and the irregularities."""
    time, lines = table.values[0], table.lines
    remarks: list[str] = []
    timed = np.isfinite(time)
    if not timed.all():
        at = int(lines[np.argmin(timed)])
        remarks.append(
            f"{counted(int((~timed).sum()), 'row')} without a time left out, first line {at}"
        )
    rows = np.flatnonzero(timed)
    steps = np.diff(time[rows])
    if np.any(steps < 0.0):
        k = int(np.argmax(steps < 0.0))
        earlier, later = time[rows[k]], time[rows[k + 1]]
        back = f"the time decreases from {earlier:.9g} to {later:.9g} in line {lines[rows[k + 1]]}"
        raise DataFileError(path, f"{back}: sort the lines, or split the file there")
    repeated = np.concatenate([[False], steps == 0.0]) if len(rows) else np.zeros(0, dtype=bool)
    if 2 * int(repeated.sum()) > len(rows):
        at = int(lines[rows[np.argmax(repeated)]])
        reason = f"most of its times repeat the one before, first in line {at}"
        raise DataFileError(path, f"{reason}: write the time with more digits")
    if repeated.any():
        at = int(lines[rows[np.argmax(repeated)]])
        what = f"{counted(int(repeated.sum()), 'row')} with the time of the row before left out"
        remarks.append(f"{what}, first line {at}")
        rows = rows[~repeated]
    if len(rows) < 2:
        raise DataFileError(
            path, f"it has {counted(len(rows), 'row')} of values, and two are needed: record more"
        )
    return (None if len(rows) == len(time) else rows), tuple(remarks)


def _missing(values: Vector, names: list[str]) -> tuple[str, ...]:
    remarks: list[str] = []
    for name, row in zip(names, values, strict=True):
        infinite = int(np.isinf(row).sum())
        if infinite:
            row[np.isinf(row)] = np.nan
        missing = int(np.isnan(row).sum())
        if missing:
            told = f"`{name}` is missing in {missing} of {counted(len(row), 'row')}"
            remarks.append(f"{told}, infinite in {infinite} of them" if infinite else told)
    return tuple(remarks)


def _changes(values: Vector) -> tuple[str, ...]:
    """Return a remark if every row is a change of a channel of zeros and ones."""
    rows = values[1:]
    known = np.isfinite(rows)
    steps = np.diff(values[0])
    if len(steps) < _FEW or not known.any() or not np.isin(rows[known], (0.0, 1.0)).all():
        return ()
    both = known[:, 1:] & known[:, :-1]
    changed = np.any(both & (rows[:, 1:] != rows[:, :-1]), axis=0)
    if not changed.all() or np.max(steps) < _UNEVEN * np.min(steps):
        return ()
    told = "its rows are changes of its channels, which are not sampled between"
    return (f"{told}: record at a fixed rate, or give the times as a column `impact [s]`",)


def _gaps(time: Vector) -> tuple[str, ...]:
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps))
    if not len(gaps):
        return ()
    longest = gaps[np.argmax(steps[gaps])]
    what = f"{counted(len(gaps), 'gap')} in time, the longest"
    return (f"{what} {steps[longest]:.4g} s after t = {time[longest]:.9g} s",)
