"""The curves on which the special points of families lie in two parameters, each once."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.continuation.assembly import FollowedFamily
from zeno_orbits.continuation.families import SpecialCurve, SpecialPointKind, whole_curve
from zeno_orbits.continuation.jobs import FollowHalfCurve
from zeno_orbits.continuation.parallel import Dispatch
from zeno_orbits.continuation.setup import Setup
from zeno_orbits.continuation.two_parameters.plane import CurveStart, ParameterPlane


@dataclass(frozen=True, kw_only=True)
class _Candidate:
    """A special point that may be on a curve of its own.

    Attributes:
        setup: The setup of its family.
        start: The point.
    """

    setup: Setup
    start: CurveStart


def curves_through(
    dispatch: Dispatch,
    plane: ParameterPlane,
    families: Sequence[FollowedFamily],
    kinds: Collection[SpecialPointKind],
) -> tuple[SpecialCurve, ...]:
    """Return the curves through special points of families, each once.

    A curve may pass through another point of its kind. So the points of a kind are followed one by
    one, and a point on a curve already found is skipped. The result does not depend on the process
    that follows a curve.

    Args:
        dispatch: Dispatch that runs the jobs.
        plane: The two parameters.
        families: The families.
        kinds: Kinds of special points to follow.
    """
    waiting = dict(enumerate(_candidates(plane, families, kinds)))
    curves: dict[int, SpecialCurve] = {}
    turn = 0
    while waiting:
        turn += 1
        chosen: dict[int, _Candidate] = {}
        for k, one in list(waiting.items()):
            if _known(tuple(curves.values()), plane, one.start):
                del waiting[k]
            elif all(
                one.start.found.kind is not other.start.found.kind for other in chosen.values()
            ):
                chosen[k] = one
        halves = [
            tuple(
                FollowHalfCurve(setup=one.setup, plane=plane, start=one.start, upwards=upwards)
                for upwards in (True, False)
            )
            for one in chosen.values()
        ]
        results = dispatch.results(f"curves-{turn}", "half curves", halves)
        for (k, one), (first, *second) in zip(chosen.items(), results, strict=True):
            curves[k] = whole_curve(one.start.found.kind, plane.names, first, *second)
            del waiting[k]
    return tuple(curves[k] for k in sorted(curves))


def _candidates(
    plane: ParameterPlane, families: Sequence[FollowedFamily], kinds: Collection[SpecialPointKind]
) -> list[_Candidate]:
    second = float(plane.p[plane.places[1]])
    return [
        _Candidate(
            setup=one.setup,
            start=CurveStart(
                found=found,
                value=(found.z[-1] * one.setup.metric.unit, second),
                leading=leading,
            ),
        )
        for one in families
        for found, leading in (*((special, ()) for special in one.special), *one.ends)
        if found.kind in kinds
    ]


_SAME = 1e-6
"""Largest difference of two points on one curve, relative to a range."""


def _known(boundaries: Sequence[SpecialCurve], plane: ParameterPlane, start: CurveStart) -> bool:
    """Return True if one of the curves passes through a point.

    A curve may cross the line of its family more than once.
    """
    first, second = start.value
    for boundary in boundaries:
        if boundary.kind is not start.found.kind:
            continue
        x, y = np.array(boundary.x), np.array(boundary.y)
        for k in np.flatnonzero((y[:-1] - second) * (y[1:] - second) <= 0.0):
            part = (second - y[k]) / (y[k + 1] - y[k]) if y[k + 1] != y[k] else 0.0
            near = abs(x[k] + part * (x[k + 1] - x[k]) - first)
            bend = 0.1 * abs(x[k + 1] - x[k]) + _SAME * plane.units[0]
            if near <= bend:
                return True
    return False
