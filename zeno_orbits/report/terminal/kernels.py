"""Terminal messages about compiled libraries."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from zeno_orbits.errors import counted, printable
from zeno_orbits.report.terminal.console import print_lines


def print_kernels(facts: Mapping[str, Any]) -> None:
    """Print the location and size of compiled libraries, and their compiler.

    Args:
        facts: The output of ``zeno-orbits cache --json``.
    """
    size = facts["bytes"] / 1e6
    lines = [
        f"Folder: {facts['folder']}",
        f"Kept: {counted(facts['libraries'], 'compiled file')}, {size:.1f} MB",
        f"Compiler: {facts['compiler'] or 'none'}",
        f"Compiling: {facts['compile']}",
    ]
    if "removed" in facts:
        lines.insert(0, f"Removed: {counted(facts['removed'], 'compiled file')}")
    print_lines([*lines, *(f"Failed: {reason}." for reason in facts["failures"])])


def print_note(message: str) -> None:
    """Print one line on standard error that is not an error."""
    sys.stderr.write(f"zeno-orbits: note: {printable(' '.join(message.split()))}\n")
