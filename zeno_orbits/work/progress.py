"""Progress reports: a stage in a few words, and the part of it that is done."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from contextvars import ContextVar
from typing import Protocol


class Progress(Protocol):
    """Receive progress reports of long work: any function of two arguments, such as ``print``.

    It is called often and must return quickly. An exception that it raises ends the work.
    """

    def __call__(self, stage: str, part: float | None, /) -> object:
        """Receive one report.

        Args:
            stage: The present stage in a few words.
            part: The part of the work that is done, in [0, 1], or ``None`` if unknown.
        """
        ...


def portion(on_progress: Progress, low: float, high: float) -> Progress:
    """Return the progress function of one step of several, which rescales the parts of the step.

    Args:
        on_progress: Progress function of the whole work.
        low: Part of the whole work that is done before the step.
        high: Part of the whole work that is done after the step.
    """

    def tell(stage: str, part: float | None, /) -> None:
        on_progress(stage, None if part is None else low + (high - low) * part)

    return tell


class _Silent:
    """Ignores reports. It shows in signatures by its name."""

    def __call__(self, _stage: str, _part: float | None, /) -> None:
        """Ignore a report."""

    def __repr__(self) -> str:
        """Return the name."""
        return "silent"

    def __reduce__(self) -> str:
        """Return the name, by which other processes find it."""
        return "silent"


silent: Progress = _Silent()
"""Ignores every report: the default of every ``on_progress``."""


def _logged(stage: str, part: float | None, /) -> None:
    """Log the beginning of a stage, as one line on standard error unless a program handles it."""
    if not part:
        import logging

        logging.getLogger("zeno_orbits").warning("zeno_orbits: %s", stage)


BUILD_WATCH: ContextVar[Callable[[], AbstractContextManager[Progress]]] = ContextVar(
    "BUILD_WATCH", default=lambda: nullcontext(_logged)
)
"""Opens the progress of a compilation, which any call that simulates may begin."""
