"""The engines by name, one row each. Another engine is a module and a row here.

Importing this module loads none of them: a command line lists them before any is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from zeno_orbits.errors import InputError

if TYPE_CHECKING:
    from zeno_orbits.integrators.engine import Engine


@dataclass(frozen=True, slots=True)
class EngineRow:
    """Entry of an engine in the table of engines.

    Attributes:
        module: Module of the engine in this room.
        type_name: Class of the engine. Without arguments it has its highest accuracy.
    """

    module: str
    type_name: str


ENGINES = {
    "automatic": EngineRow("automatic", "Automatic"),
    "explicit": EngineRow("dop853", "RungeKutta"),
    "implicit": EngineRow("radau", "Radau"),
}
"""The first is the default."""

REMOVED = {
    "taylor": "was removed: take `automatic`, the default",
}
"""Engines of earlier releases, with the engine to take instead."""


def engine_refusal(name: str) -> str:
    """Return the reason why a name is not an engine, as a clause, or an empty string if it is.

    Args:
        name: The name.
    """
    if name in ENGINES:
        return ""
    why = f", which {REMOVED[name]}" if name in REMOVED else ""
    return f"must be one of {', '.join(ENGINES)}, but it is `{name}`{why}"


def engine_named(name: str) -> Engine:
    """Return the engine of a row.

    Raises:
        InputError: If the table lacks such an engine.
    """
    refusal = engine_refusal(name)
    if refusal:
        raise InputError(f"Argument `engine` {refusal}.")
    row = ENGINES[name]
    engine: Engine = getattr(
        import_module(f"zeno_orbits.integrators.{row.module}"), row.type_name
    )()
    return engine
