"""The process around a command: an interrupt that cannot be lost, and streams that may be closed.

An interrupt that arrives while CasADi looks at a Python object is lost in it; so it is also
remembered, and raised again at the next occasion. A reader who has seen enough (`| head`) does not
stop a command before its exit code is known, a closed stream takes nothing, and a full disk is an
error of one line.
"""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any, TextIO, cast

from zeno_orbits.errors import InputError


@contextmanager
def patient_streams() -> Generator[None, None, None]:
    """Put patient streams in place of the standard ones for as long as the context lasts."""
    out, err = cast("TextIO | None", sys.stdout), cast("TextIO | None", sys.stderr)
    sys.stdout, sys.stderr = _Patient(out, may_fail=True), _Patient(err, may_fail=False)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = cast("Any", out), cast("Any", err)


class _Patient(io.TextIOBase):
    """A stream that accepts text even when its reader is gone.

    Args:
        stream: What it writes to; ``None`` if that was closed before the start.
        may_fail: Whether a full disk is an error; not on the stream of error messages.
    """

    def __init__(self, stream: TextIO | None, *, may_fail: bool) -> None:
        self._stream = stream
        self._may_fail = may_fail

    @property
    def encoding(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Encoding of what it writes to."""
        return getattr(self._stream, "encoding", None) or "utf-8"

    def isatty(self) -> bool:
        """Return True if it is a terminal."""
        return self._stream is not None and self._stream.isatty()

    def fileno(self) -> int:
        """Return the number of its file.

        Raises:
            OSError: If it has none.
        """
        if self._stream is None:
            raise io.UnsupportedOperation("fileno")
        return self._stream.fileno()

    def write(self, text: str, /) -> int:
        """Write, or discard text without a reader.

        Raises:
            InputError: If the disk is full, where that is an error.
        """
        try:
            if self._stream is not None:
                self._stream.write(text)
        except OSError as error:
            self._drop(error)
        return len(text)

    def flush(self) -> None:
        """Flush, likewise.

        Raises:
            InputError: If the disk is full, where that is an error.
        """
        try:
            if self._stream is not None:
                self._stream.flush()
        except OSError as error:
            self._drop(error)

    def _drop(self, error: OSError) -> None:
        """Write no more, not even what is left in the buffer at the end."""
        stream, self._stream = self._stream, None
        if stream is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        if self._may_fail and not isinstance(error, BrokenPipeError):
            message = "Standard output must be writable, but it is not"
            raise InputError(f"{message} ({error.strerror}).") from error


class Interrupts:
    """Remember an interrupt for as long as the context lasts.

    Attributes:
        seen: True if there was one.
    """

    def __init__(self) -> None:
        self.seen = False
        self._before: Any = None

    def __enter__(self) -> Interrupts:
        """Begin to watch; only the main thread may."""
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._see)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Hand the signal back."""
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def check(self) -> None:
        """Raise if an interrupt was seen.

        Raises:
            KeyboardInterrupt: Once more, should the first have been lost.
        """
        if self.seen:
            raise KeyboardInterrupt

    def _see(self, _number: int, _frame: FrameType | None) -> None:
        self.seen = True
        raise KeyboardInterrupt
