"""Work of one worker: one chunk at a time, with results or errors returned as JSON."""

from __future__ import annotations

import json
import threading
import time
import traceback
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from zeno_orbits.errors import InputError, WorkError
from zeno_orbits.work.software import code_digest

Task = Callable[[Sequence[Any]], Sequence[Any]]
"""Function from a chunk of points to their results, all plain data. It can be pickled."""

_ONE_AT_A_TIME = threading.Lock()
"""Lock for tasks: models of a process share memory, and a Dask worker may have several threads."""
_NOTED = 0.1
"""Shortest time between two progress notes of a worker [s]."""

_listener: ContextVar[Callable[[float], object] | None] = ContextVar("listener", default=None)


def report_part(part: float) -> None:
    """Report the finished part of this chunk to its listener, if a listener is set.

    Args:
        part: The part of the points of the chunk that are done, in [0, 1].
    """
    listener = _listener.get()
    if listener is not None:
        listener(part)


@contextmanager
def parts_told_to(listener: Callable[[float], object]) -> Generator[None]:
    """Pass the reports of `report_part` to a function within a context."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


class _Note:
    """A file with the finished part of a chunk, which its reader polls."""

    def __init__(self, path: str) -> None:
        self._path, self._written = Path(path), 0.0

    def __call__(self, part: float) -> None:
        """Write the finished part, unless the last note is too recent."""
        now = time.monotonic()
        if now - self._written >= _NOTED:
            self._written = now
            # The file is replaced atomically, so a reader never finds it empty.
            new = self._path.with_suffix(".new")
            new.write_text(f"{part:.6f}", encoding="ascii")
            new.replace(self._path)


def read_note(path: Path) -> float:
    """Return the finished part of a chunk in its worker's note, or 0 before the first note."""
    try:
        return float(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 0.0


def run_chunk(task: Task, points: Sequence[Any], code: str, note: str = "") -> str:
    """Return the results of a chunk, or its error, as JSON.

    An exception is returned as text, since an exception that the parent cannot unpickle would look
    like a crash of the worker.

    Args:
        task: The task.
        points: The chunk.
        code: Digest of the parent's code.
        note: File for the finished part, or an empty text if no reader has access.
    """
    try:
        with _ONE_AT_A_TIME, parts_told_to(_Note(note) if note else _unheard):
            return json.dumps({"results": _results(task, points, code)}, allow_nan=False)
    except Exception as error:  # noqa: BLE001, it is told at home
        told = {"misuse": isinstance(error, InputError), "text": _told(error)}
        return json.dumps({"error": told | {"trace": traceback.format_exc()}})


def _unheard(_part: float) -> None:
    """Ignore a part."""


def _results(task: Task, points: Sequence[Any], code: str) -> list[Any]:
    if code_digest() != code:
        raise InputError(
            "Workers must have the code of this program, but one has another version of "
            "zeno_orbits. Install one version for all, and change no file while the work runs."
        )
    results = list(task(points))
    if len(results) != len(points):
        lengths = f"must return one result per point, but for {len(points)} points it returns"
        raise InputError(f"Argument `task` {lengths} {len(results)}.")
    return results


def results_of(answer: str) -> list[Any]:
    """Return the results in the answer of a worker.

    Raises:
        InputError: If the task was misused.
        WorkError: If the task failed in another way.
    """
    told = json.loads(answer)
    if "error" not in told:
        return told["results"]
    error = told["error"]
    if error["misuse"]:
        raise InputError(error["text"])
    raise WorkError(f"A chunk of the work fails: {error['text']}", trace=error["trace"])


def _told(error: Exception) -> str:
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
