"""Progress where a person watches: in a notebook, or in a terminal."""

from __future__ import annotations

import sys
from typing import Any

from zeno_orbits.report.terminal.progress import ProgressLine


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
    """Return where to show progress unasked: a notebook or a terminal; None if nobody watches."""
    ipython: Any = sys.modules.get("IPython")
    if ipython is not None and getattr(ipython.get_ipython(), "kernel", None) is not None:
        return NotebookLine(ipython.display.display)
    return ProgressLine(lambda: None) if sys.stderr.isatty() else None
