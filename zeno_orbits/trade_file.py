"""Trade files: read back what `trade -o` wrote."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import InputError
from zeno_orbits.trade import Trade, Trial


def read_trade(path: Path) -> Trade:
    """Read a trade file.

    Raises:
        InputError: If it is missing, cut short or of a wrong type.
    """
    try:
        data: Any = json.loads(path.read_text(encoding="utf-8"))
        entries = cast("Mapping[str, Any]", data)
        return Trade(
            problem=str(entries["problem"]),
            work=str(entries["work"]),
            truth=str(entries["truth"]),
            truth_error=_number(entries["truth_error"]),
            trials=tuple(_trial(entry) for entry in entries["trials"]),
        )
    except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
        message = f"Trade file `{path}` must hold what `trade -o` wrote, but it does not"
        raise InputError(f"{message} ({type(error).__name__}).") from error


def _trial(entry: Mapping[str, Any]) -> Trial:
    return Trial(
        sweep=str(entry["sweep"]),
        name=str(entry["name"]),
        value=float(entry["value"]),
        seconds=_number(entry["seconds"]),
        error=_number(entry["error"]),
        n_impacts=int(entry["impacts"]),
        trouble=str(entry["trouble"]),
    )


def _number(value: float | None) -> float:
    """Return a number; what was not finite was written as null."""
    return math.inf if value is None else float(value)
