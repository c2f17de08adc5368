"""The bundled problems with one stop and no switch, for tests of commands that need one."""

from __future__ import annotations

from pathlib import Path

from zeno_orbits.model import bundled_problems, load_problem


def one_stop_problems() -> dict[str, Path]:
    """Return name to path of the bundled problems with one stop and no switch."""
    return {
        name: path for name, path in bundled_problems().items() if not load_problem(name).has_graph
    }
