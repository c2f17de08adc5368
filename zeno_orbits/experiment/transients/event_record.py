"""Event times of a recording: columns of times, or edges of contact channels.

A column `impact STOP [s]` holds the times of impacts, and `release STOP [s]` those of releases. For
a machine with one stop the titles are `impact [s]` and `release [s]`. A recording without a column
of times consists of such columns alone, which may have different lengths.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import DataFileError, InputError, not_known
from zeno_orbits.experiment.recordings.columns import TIMES, ColumnNotes, columns_of
from zeno_orbits.experiment.recordings.contacts import contact_channels
from zeno_orbits.experiment.recordings.heads import number_of, read_head, short
from zeno_orbits.experiment.recordings.recording import RecordedSignal, Recording
from zeno_orbits.experiment.recordings.table import read_table
from zeno_orbits.experiment.recordings.text_files import opened, pieces_of
from zeno_orbits.experiment.transients.event_labels import Labels, labelled, sequences_of
from zeno_orbits.model import in_si
from zeno_orbits.simulation import EventKind

_KINDS = {"impact": EventKind.IMPACT, "release": EventKind.RELEASE}
EVENT_FAMILIES = tuple(_KINDS)
"""First words of the titles of columns of event times."""
_TITLES = 4096
"""Characters in which a file of several columns has a separator."""
_CLOSED = 3
"""Samples of a flight at least that a contact channel resolves."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EventSeries:
    """The labelled times of the events of one kind at one stop.

    Attributes:
        kind: Impact or release.
        stop: Name of the stop.
        times: Times of the events that are true, ``(n,)`` [s].
        groups: Sequence of each event, from 0, ``(n,)``.
        numbers: Index of each event in its sequence, from 0, ``(n,)``.
        error: Standard error of the times that is known beforehand [s], or zero.
        missed: Sentences about events that were not recorded.
        false: Sentences about events that the machine did not make.
        ratio: Ratio of neighbouring flights in the first sequence of impacts, or NaN.
    """

    kind: EventKind
    stop: str
    times: Vector
    groups: tuple[int, ...]
    numbers: tuple[int, ...]
    error: float = 0.0
    missed: tuple[str, ...] = ()
    false: tuple[str, ...] = ()
    ratio: float = math.nan


def read_event_file(path: Path | str) -> Recording | None:
    """Return a file of event times alone as a recording, or ``None`` if it has a column of times.

    A single column holds one time per line.

    Args:
        path: The file.

    Raises:
        DataFileError: If the file cannot be parsed.
    """
    path = Path(path)
    lone = _lone_column(path)
    if lone is not None:
        return lone
    head = read_head(path)
    titles = [title.partition("[")[0].partition("(")[0].strip() for title in head.columns]
    chosen = [k for k, title in enumerate(titles) if event_kind_of(title) is not None]
    if not chosen or any(title.lower() in TIMES for title in titles):
        return None
    columns = columns_of(head, {}, ColumnNotes())
    for k in chosen:
        if columns[k].trouble or columns[k].unit != "s":
            told = columns[k].trouble or f"column `{titles[k]}` is not in units of time"
            raise DataFileError(path, f"{told}: write `{titles[k]} [s]`")
    table = read_table(path, head, chosen)
    rows = [row * columns[k].size for k, row in zip(chosen, table.values, strict=True)]
    return _of_times(path, {titles[k]: row for k, row in zip(chosen, rows, strict=True)})


def _lone_column(path: Path) -> Recording | None:
    """Return a file of one column as a recording, or ``None`` if it has several columns.

    Raises:
        DataFileError: If its title is not that of events, or a line is not a number.
    """
    with opened(path) as file:
        pieces = pieces_of(file)
        first = next(pieces, "")
        if any(sign in first[:_TITLES] for sign in ",;\t"):
            return None
        lines = "".join([first, *pieces]).split("\n")
    rows = [
        (number, line.strip().strip('"'))
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not rows:
        return None
    title = rows[0][1]
    name = title.partition("[")[0].partition("(")[0].strip()
    if event_kind_of(name) is None:
        return None
    unit = title[len(name) :].strip(" []()")
    try:
        si, size = in_si(unit)
    except ValueError:
        si, size = "", 1.0
    if si != "s":
        raise DataFileError(path, f"line {rows[0][0]}: write the title as `{name} [s]`")
    values: list[float] = []
    for number, text in rows[1:]:
        value = number_of(text)
        if value is None:
            told = f"line {number} has `{short(text)}` where a time is expected"
            raise DataFileError(path, f"{told}: correct or delete the line")
        values.append(value * size)
    return _of_times(path, {name: np.array(values)})


def _of_times(path: Path, columns: Mapping[str, Vector]) -> Recording:
    """Return columns of event times as a recording, whose times are all of them.

    Raises:
        DataFileError: If there are fewer than two, or those of a column decrease.
    """
    for name, row in columns.items():
        known = row[np.isfinite(row)]
        back = np.flatnonzero(np.diff(known) < 0.0)
        if len(back):
            earlier, later = known[back[0]], known[back[0] + 1]
            told = f"the times of `{name}` decrease from {earlier:.9g} to {later:.9g} s"
            raise DataFileError(path, f"{told}: correct them, or write them in order")
    every = np.unique(np.concatenate(list(columns.values())))
    every = every[np.isfinite(every)]
    if len(every) < 2:
        raise DataFileError(path, "it holds fewer than two event times")
    return Recording(
        source=None,
        problem="",
        time=every,
        signals=tuple(
            RecordedSignal(name=name, unit="s", values=np.where(np.isin(every, row), every, np.nan))
            for name, row in columns.items()
        ),
    )


def has_event_times(recording: Recording) -> bool:
    """Return True if a recording has a column of event times."""
    return any(event_kind_of(name) is not None for name in recording.names)


def event_kind_of(name: str) -> EventKind | None:
    """Return the kind of events whose times a column holds, `None` for another column."""
    return _KINDS.get(name.split(" ")[0].lower()) if name else None


def event_series(recording: Recording, stops: Sequence[str]) -> tuple[EventSeries, ...]:
    """Return the event times of a recording, labelled.

    Args:
        recording: The recording.
        stops: Names of the machine's stops.

    Raises:
        InputError: If a column names no stop, or has another unit.
    """
    found: list[EventSeries] = []
    for signal in recording.signals:
        kind = event_kind_of(signal.name)
        if kind is None:
            continue
        stop = _stop_of(signal.name, stops)
        if signal.unit != "s":
            wanted = f"must have the column `{signal.name}` in s"
            raise InputError(f"Argument `recording` {wanted}, not in {signal.unit}.")
        times = np.unique(signal.values[np.isfinite(signal.values)])
        if len(times):
            found.append(labelled_series(kind, stop, times))
    known = {(one.kind, one.stop) for one in found}
    channels = contact_channels(recording, stops)
    for stop, row in channels.items():
        if (EventKind.IMPACT, stop) not in known:
            edges = _edges(recording.time, row)
            if len(edges):
                step = float(np.median(np.diff(recording.time)))
                found.append(_of_channel(stop, edges, step))
    return tuple(found)


def _stop_of(name: str, stops: Sequence[str]) -> str:
    """Return the stop that a title names.

    Raises:
        InputError: If it names none of the machine.
    """
    kind, _, stop = name.partition(" ")
    stop = stop.strip()
    if len(stops) == 1 and stop in ("", stops[0]):
        return stops[0]
    if stop not in stops:
        known = [f"{kind} {one}".strip() for one in stops]
        raise InputError(f"Argument `recording`: event column: {not_known(name, known)}")
    return stop


def labelled_series(
    kind: EventKind, stop: str, times: Vector, scatter: float = 0.04
) -> EventSeries:
    """Return event times with their labels. Releases do not accumulate, so all of them are true.

    Args:
        kind: Impact or release.
        stop: Name of the stop.
        times: Increasing times, ``(n,)`` [s].
        scatter: Scatter of the ratio of two flights that does not show an error.
    """
    if kind is not EventKind.IMPACT:
        n = len(times)
        return EventSeries(
            kind=kind, stop=stop, times=times, groups=tuple(range(n)), numbers=(0,) * n
        )
    kept, groups, numbers = list[float](), list[int](), list[int]()
    missed, false = list[str](), list[str]()
    ratios: list[float] = []
    for group, part in enumerate(sequences_of(times)):
        own = times[part]
        labels = labelled(own, scatter)
        ratios.append(labels.ratio)
        missed += _missed_words(own, labels, stop)
        for time, number in zip(own.tolist(), labels.numbers, strict=True):
            if number is None:
                false.append(f"the event at {time:.6g} s{_at(stop)} is not a bounce")
                continue
            kept.append(time)
            groups.append(group)
            numbers.append(number)
    return EventSeries(
        kind=kind,
        stop=stop,
        times=np.array(kept),
        groups=tuple(groups),
        numbers=tuple(numbers),
        missed=tuple(missed),
        false=tuple(false),
        ratio=ratios[0],
    )


def _missed_words(times: Vector, labels: Labels, stop: str) -> list[str]:
    """Return a sentence for every impact that was not recorded. Bounces count from 1."""
    words: list[str] = []
    known = [(n, t) for n, t in zip(labels.numbers, times.tolist(), strict=True) if n is not None]
    for number in labels.missed:
        before = max(t for n, t in known if n < number)
        after = min(t for n, t in known if n > number)
        between = f"between {before:.6g} and {after:.6g} s"
        words.append(f"bounce {number + 1}{_at(stop)} was not heard, {between}")
    return words


def _at(stop: str) -> str:
    return f" at `{stop}`" if stop else ""


def _edges(time: Vector, row: Vector) -> Vector:
    """Return the times at which a contact channel closes [s]."""
    known = np.isfinite(row)
    time, row = time[known], row[known]
    closes = np.flatnonzero((row[1:] == 1.0) & (row[:-1] == 0.0))
    return (time[closes] + time[closes + 1]) / 2


def _of_channel(stop: str, edges: Vector, step: float) -> EventSeries:
    """Return the edges of a contact channel as impacts, up to the flights that it resolves."""
    kept, groups, numbers = list[float](), list[int](), list[int]()
    for group, part in enumerate(sequences_of(edges)):
        own = edges[part]
        short = np.flatnonzero(np.diff(own) < _CLOSED * step)
        n = int(short[0]) + 1 if len(short) else len(own)
        kept += own[:n].tolist()
        groups += [group] * n
        numbers += range(n)
    return EventSeries(
        kind=EventKind.IMPACT,
        stop=stop,
        times=np.array(kept),
        groups=tuple(groups),
        numbers=tuple(numbers),
        error=step / np.sqrt(12.0),
    )
