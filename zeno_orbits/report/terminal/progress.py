"""What long work says on standard error while it goes on."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import TracebackType

_PATIENCE = 1.0
"""Work shorter than this says nothing [s]."""
_RARER = 0.1
"""A file gets no more lines than one in this part of the time so far."""


class Progress:
    """Says on standard error what long work is doing, how long it has taken, and what is left.

    A terminal gets one line that is rewritten; a file gets a line now and then.

    Args:
        check: Called at every word; it may raise.
    """

    def __init__(self, check: Callable[[], None]) -> None:
        self._check = check
        self._started = time.perf_counter()
        self._said = -_PATIENCE
        self._terminal = sys.stderr.isatty()
        self._width = 0

    def __enter__(self) -> Progress:
        """Begin."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave a clean line behind."""
        if self._width:
            sys.stderr.write("\r" + " " * self._width + "\r")
            sys.stderr.flush()

    def tell(self, what: str, part: float | None = None) -> None:
        """Say what is being done.

        Args:
            what: A few words.
            part: How much of it is done, in [0, 1], if that is known.
        """
        self._check()
        elapsed = time.perf_counter() - self._started
        pause = 0.1 if self._terminal else max(_PATIENCE, _RARER * elapsed)
        if elapsed < _PATIENCE or elapsed - self._said < pause:
            return
        self._said = elapsed
        line = f"{elapsed:6.1f} s  {what}"
        if part is not None and part > 0.0:
            line += f"  {100 * part:3.0f} %, {elapsed * (1 - part) / part:.0f} s left"
        if self._terminal:
            self._width = max(self._width, len(line))
            sys.stderr.write("\r" + line.ljust(self._width))
        else:
            sys.stderr.write(line + "\n")
        sys.stderr.flush()
