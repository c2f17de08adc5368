"""The process around a command: reliable interrupts, and streams that may be closed.

CasADi loses an interrupt that arrives while it inspects a Python object. So the interrupt is also
stored and raised again at the next opportunity. If the reader of the output closes its pipe
(`| head`), the command still runs until its exit code is known. A closed stream accepts text
silently, and a full disk is an error of one line.
"""

from __future__ import annotations

import io
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any, TextIO, cast

from zeno_orbits.errors import InputError


@contextmanager
def patient_streams() -> Generator[None, None, None]:
    """Replace the standard streams by patient streams for as long as the context lasts."""
    out, err = cast("TextIO | None", sys.stdout), cast("TextIO | None", sys.stderr)
    sys.stdout, sys.stderr = _Patient(out, may_fail=True), _Patient(err, may_fail=False)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = cast("Any", out), cast("Any", err)


class _Patient(io.TextIOBase):
    """A stream that accepts text even if its reader has closed the pipe.

    Args:
        stream: The underlying stream, or ``None`` if it was closed before the start.
        may_fail: Whether a full disk is an error. It is False for the stream of error messages.
    """

    def __init__(self, stream: TextIO | None, *, may_fail: bool) -> None:
        self._stream = stream
        self._may_fail = may_fail

    @property
    def encoding(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Encoding of the underlying stream."""
        return getattr(self._stream, "encoding", None) or "utf-8"

    def isatty(self) -> bool:
        """Return True if it is a terminal."""
        return self._stream is not None and self._stream.isatty()

    def fileno(self) -> int:
        """Return the file descriptor of the underlying stream.

        Raises:
            OSError: If the underlying stream lacks a file descriptor.
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
                self._stream.write(self._encodable(text))
        except OSError as error:
            self._drop(error)
        return len(text)

    def _encodable(self, text: str) -> str:
        """Return text with escapes for characters that the stream cannot encode."""
        try:
            text.encode(self.encoding)
        except UnicodeEncodeError:
            return text.encode(self.encoding, "backslashreplace").decode(self.encoding)
        return text

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
        """Discard all further output, including the rest of the buffer at the end."""
        stream, self._stream = self._stream, None
        if stream is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        if self._may_fail and not isinstance(error, BrokenPipeError):
            message = "Standard output is not writable"
            raise InputError(f"{message} ({error.strerror}).") from error


class Interrupts:
    """Remember an interrupt, or a request to end, for as long as the context lasts.

    Both are raised as `KeyboardInterrupt`, so that temporary files are removed on the way out.

    Attributes:
        seen: True if there was one.
        signal: Its signal: SIGINT, SIGTERM, or SIGHUP when the terminal closes.
    """

    def __init__(self) -> None:
        self.seen = False
        self.signal: int = signal.SIGINT
        self._first = -math.inf
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interrupts:
        """Begin to watch for interrupts. This is possible only in the main thread."""
        if threading.current_thread() is threading.main_thread():
            for number in _SIGNALS:
                # An interrupt that is ignored, of a job in the background, stays ignored.
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._see)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Hand the signal back."""
        for number, before in self._before.items():
            signal.signal(number, before)

    def check(self) -> None:
        """Raise if an interrupt was seen.

        Raises:
            KeyboardInterrupt: Once more, should the first have been lost.
        """
        if self.seen:
            raise KeyboardInterrupt

    def _see(self, number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if now - self._first < _PATIENCE:
            return
        self._first = now
        self.seen, self.signal = True, number
        raise KeyboardInterrupt


_SIGNALS = [
    signal.Signals[name]
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if name in signal.Signals.__members__
]
"""Signals that ask a command to end. Windows lacks the last."""

_PATIENCE = 3.0
"""Time after an interrupt in which further ones are ignored, so that a command can clean up [s]."""
