"""Map files: JSON with one line a point, written whole or not at all; curves to lay over them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import MapFileError
from zeno_orbits.maps.attractors import attractor_from_json, attractor_json
from zeno_orbits.maps.mapping import FORMAT, Boundary, ParameterMap
from zeno_orbits.maps.plane import Axis
from zeno_orbits.work import read_object, write_whole


def write_map(found: ParameterMap, path: Path) -> None:
    """Write a map file, whole or not at all, one line a point.

    Raises:
        InputError: If the folder cannot be written.
    """
    head = json.dumps(found.header(), indent=2, allow_nan=False).removesuffix("\n}")
    lines = (json.dumps(attractor_json(one), allow_nan=False) for one in found.attractors)
    write_whole(path, head + ',\n  "points": [\n    ' + ",\n    ".join(lines) + "\n  ]\n}\n")


def read_map(path: Path) -> ParameterMap:
    """Read a map file.

    Raises:
        MapFileError: If it is missing, cut short, of a wrong type or of a newer format.
    """
    try:
        entries = read_object(path)
    except ValueError as error:
        raise MapFileError(path, str(error)) from error
    if not isinstance(entries.get("format"), int) or not 1 <= entries["format"] <= FORMAT:
        raise MapFileError(path, f"its format is {entries.get('format')}, not one up to {FORMAT}")
    try:
        found = _map_of(entries)
    except (KeyError, TypeError, ValueError) as error:
        raise MapFileError(path, f"an entry does not fit ({error!r})") from error
    if len(found.attractors) != found.x.count * found.y.count:
        raise MapFileError(path, "it does not have one entry per point")
    return found


def read_boundaries(path: Path, x: str, y: str) -> tuple[Boundary, ...]:
    """Read the curves of a family file, or a list of such curves, that lie in a plane.

    Args:
        path: The file.
        x: Gain or parameter across.
        y: Upwards.

    Raises:
        MapFileError: If it is missing, holds no curves, or none in this plane.
    """
    try:
        data: Any = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(data, dict):
            data = cast("dict[str, Any]", data)["boundaries"]
        curves = cast("list[Mapping[str, Any]]", data)
        found = [boundary for curve in curves if (boundary := _boundary_of(curve, x, y))]
    except (OSError, ValueError, RecursionError, KeyError, TypeError) as error:
        raise MapFileError(path, f"it holds no boundaries ({type(error).__name__})") from error
    if not found:
        raise MapFileError(path, f"it holds no boundary over {x} and {y}")
    return tuple(found)


def _boundary_of(curve: Mapping[str, Any], x: str, y: str) -> Boundary | None:
    """Return a curve in a plane, or ``None`` if it lies in another."""
    names = list(curve["parameters"])
    if sorted(names) != sorted((x, y)):
        return None
    across, upwards = ("x", "y") if names == [x, y] else ("y", "x")
    points = zip(map(float, curve[across]), map(float, curve[upwards]), strict=True)
    return Boundary(name=str(curve["name"]), points=tuple(points))


def _map_of(entries: Mapping[str, Any]) -> ParameterMap:
    return ParameterMap(
        problem=str(entries["problem"]),
        x=Axis(**entries["x"]),
        y=Axis(**entries["y"]),
        gains=dict(entries["gains"]),
        parameters=dict(entries["parameters"]),
        start=dict(entries["start"]),
        until=float(entries["until"]),
        attractors=tuple(attractor_from_json(point) for point in entries["points"]),
        versions=dict(entries["versions"]),
    )
