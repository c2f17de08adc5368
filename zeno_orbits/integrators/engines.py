"""The engines by name, one row each. Another engine is a module and a row here.

Importing this module loads none of them: a command line lists them before any is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from zeno_orbits.errors import InputError, not_known

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


def engine_named(name: str) -> Engine:
    """Return the engine of a row.

    Raises:
        InputError: If the table lacks such an engine.
    """
    if name not in ENGINES:
        raise InputError(f"Argument `engine`: {not_known(name, ENGINES, 'integrator')}")
    row = ENGINES[name]
    engine: Engine = getattr(
        import_module(f"zeno_orbits.integrators.{row.module}"), row.type_name
    )()
    return engine
