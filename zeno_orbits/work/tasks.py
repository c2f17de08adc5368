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
"""From a chunk of points to their results, all plain data; it can be pickled."""

_ONE_AT_A_TIME = threading.Lock()
"""Models of a process share memory, and a Dask worker may have several threads."""
_NOTED = 0.1
"""Shortest time between two notes of a worker [s]."""

_listener: ContextVar[Callable[[float], object] | None] = ContextVar("listener", default=None)


def tell_part(part: float) -> None:
    """Tell whoever waits for this chunk how much of it is done; nobody has to be waiting.

    Args:
        part: The part of the points of the chunk that are done, in [0, 1].
    """
    listener = _listener.get()
    if listener is not None:
        listener(part)


@contextmanager
def parts_told_to(listener: Callable[[float], object]) -> Generator[None]:
    """Pass to a function what `tell_part` tells, for as long as the context lasts."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


class _Note:
    """A file that holds the part of a chunk that is done; its reader polls it."""

    def __init__(self, path: str) -> None:
        self._path, self._written = Path(path), 0.0

    def __call__(self, part: float) -> None:
        """Write the part, unless the last note is too recent."""
        now = time.monotonic()
        if now - self._written >= _NOTED:
            self._written = now
            # Replaced as a whole: a reader never finds it empty.
            new = self._path.with_suffix(".new")
            new.write_text(f"{part:.6f}", encoding="ascii")
            new.replace(self._path)


def read_note(path: Path) -> float:
    """Return the part of a chunk that its worker noted; 0 before it has noted any."""
    try:
        return float(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return 0.0


def run_chunk(task: Task, points: Sequence[Any], code: str, note: str = "") -> str:
    """Return the results of a chunk as JSON, or what went wrong.

    An exception goes home as text: one that cannot be unpickled there would pass for the death of
    the worker.

    Args:
        task: The task.
        points: The chunk.
        code: Digest of the code that asks.
        note: File in which to note how much is done; empty where nobody can read it.
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
            "Argument `scheduler` must lead to workers with the code of this program, but one has "
            "another version of zeno_orbits."
        )
    results = list(task(points))
    if len(results) != len(points):
        lengths = f"must return one result a point, but of {len(points)} points it returns"
        raise InputError(f"Argument `task` {lengths} {len(results)}.")
    return results


def results_of(answer: str) -> list[Any]:
    """Return the results in an answer.

    Raises:
        InputError: If the task was misused.
        WorkError: If it failed otherwise.
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
