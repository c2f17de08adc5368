r"""Special points followed in two parameters: folds, flips and ends of families as curves.

The plane of both parameters is scaled by their ranges. Folds and flips are followed by
pseudo-arclength (`fold_flip_curve`), other special points by secants (`end_curve`). For a secant
step, the line through the predicted point normal to the secant is taken. The special point of the
family along that line is the next point. So a curve may run in any direction, and each of its
points has its own error estimate. Theory (5.8).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zeno_orbits.continuation.corrector import BranchPoint
from zeno_orbits.continuation.families import HalfCurve
from zeno_orbits.continuation.two_parameters.end_curve import (
    ApproachPoint,
    SecantCurve,
    SpecialCurvePoint,
    left_of,
)
from zeno_orbits.continuation.two_parameters.fold_flip_curve import MULTIPLIERS, half_fold_flip
from zeno_orbits.continuation.two_parameters.plane import CurveSetup, CurveStart


def half_boundary(setup: CurveSetup, start: CurveStart, *, upwards: bool) -> HalfCurve:
    """Return the curve of a special point in one direction.

    Args:
        setup: The setup of the curve.
        start: The special point.
        upwards: True if the second parameter rises at first, False if it falls.

    Raises:
        ZenoOrbitsError: If the point is not on a curve, or its neighbours do not return.
    """
    unit, found = setup.metric.unit, start.found
    setup = replace(setup, metric=replace(setup.metric, unit=1.0))
    plane, metric = setup.plane, setup.metric
    if found.kind in MULTIPLIERS:
        return half_fold_flip(setup, start, upwards=upwards)

    def relative(point: BranchPoint) -> ApproachPoint:
        state = (point.x - found.z[:-1] * metric.scale) / metric.scale
        away = (point.z[-1] - found.z[-1]) / (plane.units[0] / unit)
        left = left_of(point, found.cause)
        return ApproachPoint(state=state, away=np.array([away, 0.0]), left=left)

    first = SpecialCurvePoint(
        at=np.array(start.value) / plane.units,
        located=replace(found, z=np.append(found.z[:-1], 0.0), error=found.error / plane.units[0]),
        before=tuple(relative(point) for point in start.leading),
    )
    spots, end = SecantCurve(setup, found.kind, found.cause).run(first, upwards=upwards)
    values = np.array([spot.at * plane.units for spot in spots])
    return HalfCurve(
        x=tuple(values[:, 0].tolist()),
        y=tuple(values[:, 1].tolist()),
        errors=tuple(spot.located.error for spot in spots),
        end=end,
    )
