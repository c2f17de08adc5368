"""Find, verify and follow Zeno periodic orbits of electromechanical hybrid systems.

``import zeno_orbits as zo`` offers ``zo.simulate``, ``zo.find_orbit``, ``zo.verify``,
``zo.Problem`` and the other names of ``__init__.pyi``. Each is imported at its first use. The
package alone imports neither NumPy nor CasADi.

The rooms, top first. Each imports from the rooms below it:
``cli``, ``api`` (the functions of this module), ``report``, ``experiment`` and ``precision``,
``continuation`` and ``maps``, ``search``, ``verification``, ``orbits``, ``simulation``, ``model``,
``integrators`` and ``work``. At the bottom are the modules ``arrays``, ``errors`` and
``aliases``.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

__version__ = "0.4.0.dev0"


def _places() -> dict[str, tuple[str, str]]:
    """Return public name to module and name of its object, as the stub file declares them."""
    stub = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    return {
        alias.asname or alias.name: (node.module, alias.name)
        for node in stub.body
        if isinstance(node, ast.ImportFrom) and node.module is not None
        for alias in node.names
    }


_PLACES = _places()


__all__ = ["__version__", *_PLACES]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a name at its first use. A former name gives a `DeprecationWarning`.

    Raises:
        AttributeError: If the name is unknown.
    """
    if name in _PLACES:
        module, original = _PLACES[name]
        found = getattr(import_module(f"{__name__}.{module}"), original)
        globals()[name] = found
        return found
    return _of_former_name(name)


def _of_former_name(name: str) -> Any:
    """Return the object of a former name, with a warning.

    Raises:
        AttributeError: If the name is unknown. The message names the successor of a removed name.
    """
    from zeno_orbits.aliases import ALIASES, FORMER

    if name not in ALIASES:
        successors = FORMER.get(name, ())
        near = f". Did you mean {__name__}.{successors[0]}?" if successors else ""
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{near}")
    import warnings

    new, place = ALIASES[name]
    message = f"zeno_orbits.{name} is now zeno_orbits.{new}, and will be removed."
    warnings.warn(message, DeprecationWarning, stacklevel=3)
    module, _, original = place.partition(":")
    return getattr(import_module(f"{__name__}.{module}"), original)


def __dir__() -> list[str]:
    """Return the public names."""
    return list(__all__)
