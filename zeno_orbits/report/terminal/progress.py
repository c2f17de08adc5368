"""Progress of long work where a person watches: on standard error, or below a notebook's cell."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from zeno_orbits.errors import printable

_PATIENCE = 1.0
"""Work shorter than this prints nothing [s]."""
_TELLING = 2.0
"""Time in a stage before its mean pace gives an estimate of the time left [s]."""
_ANEW = 0.5
"""If the progress falls below this fraction of its last value, a new stage has begun."""
_TOLD, _LATE = 0.01, 60.0
"""Below the first value the estimate waits for the second, because workers start slowly [s]."""
_RARER = 0.1
"""A file gets no more lines than one in this part of the time so far."""
_SILENCE = 2.0
"""A line without news waits in a file until the elapsed time has grown by this factor."""


class _TimeLeft:
    """The time left of a stage, which never rises before the next stage begins."""

    def __init__(self) -> None:
        self._began = self._part = 0.0
        self._end = math.inf

    def at(self, now: float, part: float) -> float:
        """Return the time left by the mean pace so far [s], or infinity without an estimate.

        The time left falls with the clock. If it is over before the stage is, no estimate is left.

        Args:
            now: Time since the start [s].
            part: The completed part of the stage, in [0, 1]. The next stage begins with a smaller
                part.
        """
        if part < _ANEW * self._part:
            self._began, self._end, self._part = now, math.inf, part
        # An increase of the total work is not a new stage.
        self._part = part = max(part, self._part)
        passed = now - self._began
        if part > 0.0 and passed >= (_TELLING if part >= _TOLD else _LATE):
            self._end = min(self._end, now + passed * (1.0 - part) / part)
        if part >= 1.0:
            return 0.0
        return self._end - now if self._end > now else math.inf


def _duration(seconds: float) -> str:
    """Return a duration in the unit in which a reader thinks of it."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


class ProgressLine:
    """Print progress reports on standard error: the stage, the elapsed time and the time left.

    In a terminal a single line is rewritten. In a file a new line is added now and then.

    Args:
        check: Called at every report. It may raise an exception to end the work.
    """

    def __init__(self, check: Callable[[], None]) -> None:
        self._check = check
        self._started = time.perf_counter()
        self._said = -_PATIENCE
        self._left = _TimeLeft()
        self._done: tuple[str, str] = ("", "")
        self._terminal = sys.stderr.isatty()
        self._width = 0

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the line, so that later output starts on an empty line."""
        self._clear()

    def __call__(self, stage: str, part: float | None = None, /) -> None:
        """Print one report, unless the last report is too recent.

        Args:
            stage: The present stage in a few words.
            part: The completed part of the work, in [0, 1], if it is known.
        """
        self._check()
        elapsed = time.perf_counter() - self._started
        left = math.inf if part is None else self._left.at(elapsed, part)
        pause = 0.1 if self._terminal else max(_PATIENCE, _RARER * elapsed)
        if elapsed < _PATIENCE or elapsed - self._said < pause:
            return
        done = (printable(stage), f"  {100 * part:3.0f} %" if part else "")
        if not self._terminal and done == self._done and elapsed < _SILENCE * self._said:
            return
        self._said, self._done = elapsed, done
        line = f"{elapsed:6.1f} s  {''.join(done)}"
        if left < math.inf:
            line += f", about {_duration(left)} left"
        self._show(line)

    def _show(self, line: str) -> None:
        if self._terminal:
            self._width = max(self._width, len(line))
            sys.stderr.write("\r" + line.ljust(self._width))
        else:
            sys.stderr.write(line + "\n")
        sys.stderr.flush()

    def _clear(self) -> None:
        if self._width:
            sys.stderr.write("\r" + " " * self._width + "\r")
            sys.stderr.flush()


class NotebookLine(ProgressLine):
    """Show progress reports below the cell of a notebook, as one line that disappears at the end.

    Args:
        display: IPython's function of this name.
    """

    def __init__(self, display: Any) -> None:
        super().__init__(lambda: None)
        self._terminal = True
        self._display = display
        self._handle: Any = None

    def _show(self, line: str) -> None:
        if self._handle is None:
            self._handle = self._display({"text/plain": line}, raw=True, display_id=True)
        else:
            self._handle.update({"text/plain": line}, raw=True)

    def _clear(self) -> None:
        if self._handle is not None:
            self._handle.update({"text/plain": ""}, raw=True)


def line_for_watcher() -> ProgressLine | None:
    """Return a progress display for a notebook or terminal, or ``None`` if there is neither."""
    ipython: Any = sys.modules.get("IPython")
    if ipython is not None and getattr(ipython.get_ipython(), "kernel", None) is not None:
        return NotebookLine(ipython.display.display)
    return ProgressLine(lambda: None) if sys.stderr.isatty() else None
