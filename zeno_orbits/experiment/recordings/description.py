"""A file of time series as it was understood: its columns, and what keeps any from counting."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from zeno_orbits.errors import DataFileError
from zeno_orbits.experiment.recordings.columns import Column, ColumnNotes, columns_of
from zeno_orbits.experiment.recordings.heads import read_head
from zeno_orbits.experiment.recordings.recording import (
    ONE_OF_TWO,
    Recording,
    read_recording,
)
from zeno_orbits.experiment.transients.event_record import event_kind_of, read_event_file
from zeno_orbits.work import checked


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingDescription:
    """What a file was understood to be.

    Attributes:
        path: The file.
        columns: Its columns.
        recording: The recording of the columns that count, or ``None`` if it cannot be read.
        trouble: Reason why it cannot be read, or empty.
        sought: Names of the signals of the problem, if one was given.
    """

    path: Path
    columns: tuple[Column, ...]
    recording: Recording | None
    trouble: str = ""
    sought: tuple[str, ...] = ()

    @property
    def is_complete(self) -> bool:
        """True if there is a recording, and every column of numbers counts."""
        numbers = [one for one in self.columns if not one.holds_text]
        return self.recording is not None and not any(one.trouble for one in numbers)

    @property
    def rate(self) -> float:
        """Rows per second, by the usual step. Not a number without a recording."""
        if self.recording is None:
            return math.nan
        return 1.0 / float(np.median(np.diff(self.recording.time)))

    def extent(self, column: Column) -> tuple[float, float, int] | None:
        """Return the least and the largest value of a column, and how many values are missing.

        ``None`` if it does not count.
        """
        if self.recording is None or column.trouble:
            return None
        if column.is_time:
            return float(self.recording.time[0]), float(self.recording.time[-1]), 0
        values = self.recording.signal(column.name).values
        known = values[np.isfinite(values)]
        if not len(known):
            return math.nan, math.nan, len(values)
        return float(known.min()), float(known.max()), len(values) - len(known)

    def role(self, column: Column) -> str:
        """Return what a column counts as, or why it does not."""
        if column.trouble:
            return "text, left out" if column.holds_text else column.trouble
        if column.is_time:
            return "time"
        if event_kind_of(column.name) is not None:
            return "times of events"
        if self.sought and column.name not in self.sought:
            return "not a signal of the problem"
        return "signal"

    def as_json(self) -> dict[str, Any]:
        """Return the description as plain data."""
        return {
            "file": str(self.path),
            "rows": 0 if self.recording is None else len(self.recording.time),
            "rows_per_second": self.rate,
            "trouble": self.trouble,
            "remarks": [] if self.recording is None else list(self.recording.remarks),
            "columns": [
                {
                    "title": one.title,
                    "name": one.name,
                    "unit": one.unit,
                    "size": one.size,
                    "zero": one.zero,
                    "role": self.role(one),
                    "extent": self.extent(one),
                }
                for one in self.columns
            ],
        }


@checked
def description_of(
    path: Path | str,
    *,
    columns: ColumnNotes | None = None,
    units: Mapping[str, str] | None = None,
) -> RecordingDescription:
    """Return what a file of time series is understood to be.

    Args:
        path: The file.
        columns: What is known of the columns in addition to their titles.
        units: Units of the signals of a problem, by name.

    Raises:
        DataFileError: If the file is not a table of values.
        InputError: If the notes name a column that the file does not have.
    """
    path, told, known = Path(path), columns or ColumnNotes(), units or {}
    events = None if columns is not None and columns.names else read_event_file(path)
    if events is not None:
        return _of_events(path, events, tuple(known))
    head = read_head(path, untitled=bool(told.names))
    found = _once(columns_of(head, known, told), head.line)
    usable = [one.name for one in found if not (one.trouble or one.is_time)]
    recording, trouble = None, ""
    if not usable:
        trouble = "no column is a signal with a unit"
    else:
        try:
            recording = read_recording(path, only=usable, columns=told)
        except DataFileError as error:
            trouble = error.reason
    return RecordingDescription(
        path=path, columns=found, recording=recording, trouble=trouble, sought=tuple(known)
    )


def _of_events(path: Path, events: Recording, sought: tuple[str, ...]) -> RecordingDescription:
    """Return the description of a file of event times."""
    columns = tuple(
        Column(title=f"{one.name} [s]", name=one.name, unit=one.unit) for one in events.signals
    )
    return RecordingDescription(
        path=path, columns=columns, recording=events, trouble="", sought=sought
    )


def _once(columns: Collection[Column], line: int) -> tuple[Column, ...]:
    """Return columns of which those that share a name do not count."""
    count = Counter(one.name for one in columns)
    return tuple(
        replace(
            one, trouble=f"line {line}: two of its columns are named `{one.name}`: {ONE_OF_TWO}"
        )
        if count[one.name] > 1 and one.name
        else one
        for one in columns
    )
