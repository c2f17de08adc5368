"""Families as plain data, every bit kept, so that they can cross processes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.branch import Branch
from zeno_orbits.continuation.corrector import BranchPoint
from zeno_orbits.continuation.families import HalfCurve, Kind
from zeno_orbits.continuation.return_maps import Loss, Margin, Return
from zeno_orbits.continuation.special_points import Located
from zeno_orbits.work.serialization import plain


def branch_to_json(branch: Branch) -> dict[str, Any]:
    """Return a family in one direction as plain data."""
    return {
        "points": [_point_to_json(point) for point in branch.points],
        "special": [[index, _located_to_json(located)] for index, located in branch.special],
        "ending": branch.ending.name,
        "end": None if branch.end is None else _located_to_json(branch.end),
        "detail": branch.detail,
    }


def branch_from_json(data: Mapping[str, Any]) -> Branch:
    """Return a family in one direction from what `branch_to_json` gave."""
    return Branch(
        points=tuple(_point(point) for point in data["points"]),
        special=tuple((index, _located(located)) for index, located in data["special"]),
        ending=Kind[data["ending"]],
        end=None if data["end"] is None else _located(data["end"]),
        detail=data["detail"],
    )


def half_to_json(half: HalfCurve) -> dict[str, Any]:
    """Return half a curve as plain data."""
    return {
        "x": plain(half.x),
        "y": plain(half.y),
        "errors": plain(half.errors),
        "end": half.end,
        "cusps": list(half.cusps),
    }


def half_from_json(data: Mapping[str, Any]) -> HalfCurve:
    """Return half a curve from what `half_to_json` gave."""
    return HalfCurve(
        x=tuple(map(float, data["x"])),
        y=tuple(map(float, data["y"])),
        errors=tuple(map(float, data["errors"])),
        end=data["end"],
        cusps=tuple(data["cusps"]),
    )


def _point_to_json(point: BranchPoint) -> dict[str, Any]:
    found = point.found
    return {
        "x": plain(point.x),
        "s": plain(point.s),
        "z": plain(point.z),
        "tangent": plain(point.tangent),
        "jacobian": _matrix_to_json(point.jacobian),
        "miss": plain(point.miss),
        "found": {
            "time": plain(found.time),
            "end": plain(found.end),
            "by_state": _matrix_to_json(found.by_state),
            "by_parameter": plain(found.by_parameter),
            "margins": _margins_to_json(found.margins),
        },
    }


def _point(data: Mapping[str, Any]) -> BranchPoint:
    found = data["found"]
    return BranchPoint(
        x=_vector(data["x"]),
        s=float(data["s"]),
        z=_vector(data["z"]),
        tangent=_vector(data["tangent"]),
        jacobian=_matrix(data["jacobian"]),
        miss=float(data["miss"]),
        found=Return(
            time=float(found["time"]),
            end=_vector(found["end"]),
            by_state=_matrix(found["by_state"]),
            by_parameter=_vector(found["by_parameter"]),
            margins=_margins(found["margins"]),
        ),
    )


def _located_to_json(located: Located) -> dict[str, Any]:
    return {
        "kind": located.kind.name,
        "point": _point_to_json(located.point),
        "z": plain(located.z),
        "period": plain(located.period),
        "error": plain(located.error),
        "margins": _margins_to_json(located.margins),
        "place": located.place,
        "path": [_point_to_json(point) for point in located.path],
        "also": [kind.name for kind in located.also],
    }


def _located(data: Mapping[str, Any]) -> Located:
    return Located(
        kind=Kind[data["kind"]],
        point=_point(data["point"]),
        z=_vector(data["z"]),
        period=float(data["period"]),
        error=float(data["error"]),
        margins=_margins(data["margins"]),
        place=data["place"],
        path=tuple(_point(point) for point in data["path"]),
        also=tuple(Kind[name] for name in data["also"]),
    )


def _margins_to_json(margins: Mapping[Margin, float]) -> list[Any]:
    return [[margin.loss.name, margin.place, plain(value)] for margin, value in margins.items()]


def _margins(data: list[Any]) -> dict[Margin, float]:
    return {Margin(loss=Loss[loss], place=place): float(value) for loss, place, value in data}


def _matrix_to_json(matrix: Vector) -> dict[str, Any]:
    # A matrix without rows has no list that tells how many columns it has.
    return {"shape": list(matrix.shape), "entries": plain(matrix.ravel())}


def _matrix(data: Mapping[str, Any]) -> Vector:
    return _vector(data["entries"]).reshape(data["shape"])


def _vector(data: list[Any]) -> Vector:
    return np.array([float(value) for value in data], dtype=np.float64)
