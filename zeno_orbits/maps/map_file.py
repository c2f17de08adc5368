"""Map files, in JSON with one line per point and written atomically, and boundary curves."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from zeno_orbits.errors import BoundaryFileError, MapFileError, newer_format
from zeno_orbits.maps.attractors import attractor_from_json, attractor_json
from zeno_orbits.maps.mapping import FORMAT, BetweenPoint, Boundary, ParameterMap
from zeno_orbits.maps.plane import MOST_HALVINGS
from zeno_orbits.maps.refinement import fine_count
from zeno_orbits.model import RecordedFile
from zeno_orbits.work import (
    EntryError,
    from_plain,
    read_json,
    read_object,
    without_collection,
    write_whole,
)


def write_map(found: ParameterMap, path: Path) -> None:
    """Write a map file atomically, with one line per point.

    Raises:
        InputError: If the folder cannot be written.
    """
    file = found.problem_file
    entry = {} if file is None else {"problem_file": file.relative_to(path.parent)}
    text = json.dumps({**found.header(), **entry}, indent=2, allow_nan=False).removesuffix("\n}")
    if found.refine:
        text += _listed("between", found.between_json())
    text += _listed("points", [attractor_json(one) for one in found.attractors])
    write_whole(path, f"{text}\n}}\n")


def _listed(name: str, entries: Sequence[Mapping[str, Any]]) -> str:
    """Format a list of a file, with one line per entry."""
    if not entries:
        return f',\n  "{name}": []'
    lines = (json.dumps(one, allow_nan=False) for one in entries)
    return f',\n  "{name}": [\n    ' + ",\n    ".join(lines) + "\n  ]"


@without_collection()
def read_map(path: Path) -> ParameterMap:
    """Read a map file.

    Raises:
        MapFileError: If the file is missing, is truncated, contains a wrong type or has a newer
            format.
    """
    try:
        entries = read_object(path)
    except ValueError as error:
        raise MapFileError(path, str(error)) from error
    number = entries.get("format")
    if not isinstance(number, int) or number < 1:
        raise MapFileError(path, f"its format is {number}, not 1 to {FORMAT}")
    if number > FORMAT:
        raise MapFileError(path, newer_format(number, FORMAT))
    try:
        found = _map_of(entries, path.parent)
    except (KeyError, TypeError, ValueError) as error:
        reason = (
            str(error) if isinstance(error, EntryError) else f"an entry does not fit ({error!r})"
        )
        raise MapFileError(path, reason) from error
    if len(found.attractors) != found.x.count * found.y.count:
        raise MapFileError(path, "it does not have one entry per point")
    return found


def read_boundaries(path: Path, x: str, y: str) -> tuple[Boundary, ...]:
    """Read the boundary curves in a plane, from a family file or a list of curves.

    Args:
        path: The file.
        x: Gain or parameter of the horizontal axis.
        y: Gain or parameter of the vertical axis.

    Raises:
        BoundaryFileError: If the file is missing, or does not contain a curve in this plane.
    """
    try:
        data = read_json(path)
    except ValueError as error:
        raise BoundaryFileError(path, str(error)) from error
    try:
        if isinstance(data, dict):
            data = cast("dict[str, Any]", data)["boundaries"]
        curves = cast("list[Mapping[str, Any]]", data)
        found = [boundary for curve in curves if (boundary := _boundary_of(curve, x, y))]
    except (ValueError, KeyError, TypeError) as error:
        raise BoundaryFileError(path, "curves are missing") from error
    if not found:
        raise BoundaryFileError(path, f"curves over {x} and {y} are missing")
    return tuple(found)


def _boundary_of(curve: Mapping[str, Any], x: str, y: str) -> Boundary | None:
    """Return a curve in a plane, or ``None`` if the curve lies in another plane."""
    names = list(curve["parameters"])
    if sorted(names) != sorted((x, y)):
        return None
    across, upwards = ("x", "y") if names == [x, y] else ("y", "x")
    points = zip(map(float, curve[across]), map(float, curve[upwards]), strict=True)
    return Boundary(name=str(curve["name"]), points=tuple(points))


def _map_of(entries: Mapping[str, Any], folder: Path) -> ParameterMap:
    """Return the map of plain data in a folder.

    Raises:
        EntryError: If an entry is missing, has a wrong type, or an invalid value.
    """
    apart: dict[str, tuple[Any, ...]] = {"attractors": (), "orbits": (), "between": ()}
    plain = {**entries, **{name: list(nothing) for name, nothing in apart.items()}}
    file = from_plain(str, plain.pop("problem_file", ""), "problem_file")
    found = from_plain(ParameterMap, plain, finite=True)
    for side, axis in (("x", found.x), ("y", found.y)):
        if axis.count < 2 or not axis.lower < axis.upper:
            wanted = "an axis with lower < upper and at least two points"
            raise EntryError(side, wanted, f"{axis.lower:g}:{axis.upper:g} with {axis.count}")
    if found.until <= 0.0:
        raise EntryError("until", "a positive number of seconds", f"{found.until:g}")
    points = cast("list[Mapping[str, Any]]", entries["points"])
    attractors = [attractor_from_json(one, f"points[{k}]") for k, one in enumerate(points)]
    orbits = cast("list[Mapping[str, Any]]", entries.get("orbits", []))
    between = cast("list[Mapping[str, Any]]", entries.get("between", []))
    if not 0 <= found.refine <= MOST_HALVINGS:
        raise EntryError("refine", f"0 to {MOST_HALVINGS}", str(found.refine))
    return replace(
        found,
        problem_file=RecordedFile.beside(folder, file),
        attractors=tuple(attractors),
        orbits=tuple(attractor_from_json(one, f"orbits[{k}]") for k, one in enumerate(orbits)),
        between=tuple(_between(found, one, f"between[{k}]") for k, one in enumerate(between)),
    )


def _between(found: ParameterMap, entries: Mapping[str, Any], name: str) -> BetweenPoint:
    """Return a point of a refinement.

    Raises:
        EntryError: If the point lies outside of the finest grid.
    """
    one = BetweenPoint(
        row=from_plain(int, entries["row"], f"{name}.row"),
        column=from_plain(int, entries["column"], f"{name}.column"),
        attractor=attractor_from_json(entries, name),
    )
    for side, place, axis in (("row", one.row, found.y), ("column", one.column, found.x)):
        count = fine_count(axis.count, found.refine)
        if not 0 <= place < count:
            raise EntryError(f"{name}.{side}", f"0 to {count - 1}", str(place))
    return one
