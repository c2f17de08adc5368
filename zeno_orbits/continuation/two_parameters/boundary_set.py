"""The curves on which the special points of families lie in two parameters, each once."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.continuation.assembly import Grown
from zeno_orbits.continuation.corrector import BranchPoint
from zeno_orbits.continuation.families import Boundary, Kind, whole_curve
from zeno_orbits.continuation.parallel import Dispatch, Half
from zeno_orbits.continuation.special_points import Located
from zeno_orbits.continuation.two_parameters.plane import Plane


@dataclass(frozen=True, kw_only=True)
class _Candidate:
    """A special point that may be on a curve of its own.

    Attributes:
        grown: Its family.
        located: The point.
        leading: The last points of the family before an end.
    """

    grown: Grown
    located: Located
    leading: tuple[BranchPoint, ...]


def curves_through(
    dispatch: Dispatch, plane: Plane, grown: Sequence[Grown], kinds: Collection[Kind]
) -> tuple[Boundary, ...]:
    """Return the curves through special points of families, each once.

    A curve may come back through another point of its kind. So points of a kind take turns, and
    what is on a curve already is left out, whoever follows it.

    Args:
        dispatch: Who follows them.
        plane: The two parameters.
        grown: The families.
        kinds: Which kinds of points.
    """
    found = [
        _Candidate(grown=one, located=located, leading=leading)
        for one in grown
        for located, leading in (*((s, ()) for s in one.special), *one.ends)
        if located.kind in kinds
    ]
    curves: dict[int, Boundary] = {}
    waiting, turn = dict(enumerate(found)), 0
    while waiting:
        turn += 1
        chosen: dict[int, tuple[Half, Half]] = {}
        for k, one in list(waiting.items()):
            metric, kind = one.grown.track.metric, one.located.kind
            value = (one.located.z[-1] * metric.unit, float(plane.p[plane.places[1]]))
            if _known(tuple(curves.values()), plane, kind, value):
                del waiting[k]
            elif kind not in [found[other].located.kind for other in chosen]:
                up = Half(
                    course=one.grown.track.course,
                    plane=plane,
                    found=one.located,
                    value=value,
                    leading=one.leading,
                    upwards=True,
                )
                chosen[k] = (up, replace(up, upwards=False))
        results = dispatch.done(f"curves-{turn}", "half curves", list(chosen.values()))
        for k, halves in zip(chosen, results, strict=True):
            second = halves[1] if len(halves) > 1 else None
            curves[k] = whole_curve(found[k].located.kind, plane.names, halves[0], second)
            del waiting[k]
    return tuple(curves[k] for k in sorted(curves))


_SAME = 1e-6
"""Part of a range by which two points on one boundary may differ."""


def _known(
    boundaries: Sequence[Boundary], plane: Plane, kind: Kind, value: tuple[float, float]
) -> bool:
    """Tell whether a boundary runs through a point already: a curve may come back to its line."""
    for boundary in boundaries:
        if boundary.kind is not kind:
            continue
        x, y = np.array(boundary.x), np.array(boundary.y)
        for k in np.flatnonzero((y[:-1] - value[1]) * (y[1:] - value[1]) <= 0.0):
            part = (value[1] - y[k]) / (y[k + 1] - y[k]) if y[k + 1] != y[k] else 0.0
            near = abs(x[k] + part * (x[k + 1] - x[k]) - value[0])
            bend = 0.1 * abs(x[k + 1] - x[k]) + _SAME * plane.units[0]
            if near <= bend:
                return True
    return False
