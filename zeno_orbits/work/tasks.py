"""Work of one worker: one chunk at a time, with results or errors returned as JSON."""

from __future__ import annotations

import json
import threading
import traceback
from collections.abc import Callable, Sequence
from typing import Any

from zeno_orbits.errors import InputError, WorkError
from zeno_orbits.work.software import code_digest

Task = Callable[[Sequence[Any]], Sequence[Any]]
"""From a chunk of points to their results, all plain data; it can be pickled."""

_ONE_AT_A_TIME = threading.Lock()
"""Models of a process share memory, and a Dask worker may have several threads."""


def run_chunk(task: Task, points: Sequence[Any], code: str) -> str:
    """Return the results of a chunk as JSON, or what went wrong.

    An exception goes home as text: one that cannot be unpickled there would pass for the death of
    the worker.

    Args:
        task: The task.
        points: The chunk.
        code: Digest of the code that asks.
    """
    try:
        with _ONE_AT_A_TIME:
            return json.dumps({"results": _results(task, points, code)}, allow_nan=False)
    except Exception as error:  # noqa: BLE001, it is told at home
        told = {"misuse": isinstance(error, InputError), "text": _told(error)}
        return json.dumps({"error": told | {"trace": traceback.format_exc()}})


def _results(task: Task, points: Sequence[Any], code: str) -> list[Any]:
    if code_digest() != code:
        raise InputError(
            "Argument `scheduler` must lead to workers with the same code as the program that "
            "asks them, but one has another version of zeno_orbits."
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
