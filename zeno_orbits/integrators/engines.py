"""The engines by name, one row each. Another engine is a module and a row here.

Importing this module loads none of them: a command line lists them before any is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from zeno_orbits.errors import InputError

if TYPE_CHECKING:
    from zeno_orbits.arrays import Vector
    from zeno_orbits.integrators.engine import Engine
    from zeno_orbits.integrators.flow import GuardedFlow


@dataclass(frozen=True, slots=True)
class EngineRow:
    """The place of an engine.

    Attributes:
        module: Its module in this room.
        type_name: Its class; without arguments it is as accurate as it gets.
        needs: A package that it cannot do without; the extra of the engine's name installs it.
    """

    module: str
    type_name: str
    needs: str = ""


ENGINES = {
    "automatic": EngineRow("automatic", "Automatic"),
    "explicit": EngineRow("dop853", "RungeKutta"),
    "implicit": EngineRow("radau", "Radau"),
    "taylor": EngineRow("taylor.engine", "Taylor", needs="heyoka"),
}
"""The first is the default."""


@runtime_checkable
class Selective(Protocol):
    """An engine that cannot follow every flow."""

    def require(self, flow: GuardedFlow, y: Vector) -> None:
        """Refuse a flow from a state that it cannot follow.

        Raises:
            InputError: It says why.
        """
        ...


def engine_named(name: str) -> Engine:
    """Return the engine of a row.

    Raises:
        InputError: If a package that it needs is missing.
    """
    row = ENGINES[name]
    if row.needs:
        try:
            import_module(row.needs)
        except ImportError as error:
            install = f"run `pip install 'zeno_orbits[{name}]'`"
            raise InputError(f"Engine `{name}` needs {row.needs}: {install} ({error}).") from error
    engine: Engine = getattr(
        import_module(f"zeno_orbits.integrators.{row.module}"), row.type_name
    )()
    return engine


def installed_engines() -> tuple[str, ...]:
    """Return the names of the engines that can be had here."""
    return tuple(name for name, row in ENGINES.items() if not row.needs or find_spec(row.needs))
