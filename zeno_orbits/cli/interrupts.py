"""Ctrl-C that cannot be lost.

An interrupt that arrives while CasADi looks at a Python object is swallowed by it; so it is also
remembered, and looked for at the next occasion.
"""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any


class Interrupts:
    """Remembers an interrupt for as long as the context lasts."""

    def __init__(self) -> None:
        self._seen = False
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
            KeyboardInterrupt: Once more, whoever swallowed the first.
        """
        if self._seen:
            raise KeyboardInterrupt

    def _see(self, _number: int, _frame: FrameType | None) -> None:
        self._seen = True
        raise KeyboardInterrupt
