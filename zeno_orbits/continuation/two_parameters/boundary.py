r"""Special points followed in two parameters: folds, flips and ends of families as curves.

In the plane of both parameters, in units of their ranges, a curve is followed by secants. On a line
at right angles to the secant, through the predicted place, the special point is located anew as one
of a family along that line; so every point of the curve is located as well as a point of a family,
with its own error estimate, and a curve may run in any direction. Theory (40).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zeno_orbits.continuation.corrector import BranchPoint, Metric
from zeno_orbits.continuation.families import Boundary, HalfCurve, whole_curve
from zeno_orbits.continuation.special_points import Located
from zeno_orbits.continuation.two_parameters.end_curve import Before, SecantCurve, Spot, left_of
from zeno_orbits.continuation.two_parameters.fold_flip_curve import CRITICAL, half_critical
from zeno_orbits.continuation.two_parameters.plane import CurveSteps, OnLine, Plane, Tell


def follow_boundary(
    plane: Plane,
    on_line: OnLine,
    metric: Metric,
    found: Located,
    value: tuple[float, float],
    *,
    leading: tuple[BranchPoint, ...],
    steps: CurveSteps,
    tell: Tell,
) -> Boundary:
    """Return the curve of a special point of a family.

    Args:
        plane: The two parameters; the family is followed in the first.
        on_line: From a line to the return map along it.
        metric: Units of the family.
        found: The special point.
        value: Both parameters there.
        leading: The last points of the family before an end.
        steps: How to step.
        tell: Called with what happens.

    Raises:
        ZenoOrbitsError: If the point is none of the curve, or its neighbours do not return.
    """

    def half(*, upwards: bool) -> HalfCurve:
        return half_boundary(
            plane,
            on_line,
            metric,
            found,
            value,
            leading=leading,
            upwards=upwards,
            steps=steps,
            tell=tell,
        )

    first = half(upwards=True)
    second = None if first.closes else half(upwards=False)
    return whole_curve(found.kind, plane.names, first, second)


def half_boundary(
    plane: Plane,
    on_line: OnLine,
    metric: Metric,
    found: Located,
    value: tuple[float, float],
    *,
    leading: tuple[BranchPoint, ...],
    upwards: bool,
    steps: CurveSteps,
    tell: Tell,
) -> HalfCurve:
    """Return the curve of a special point in one direction, whatever the other one is.

    Args:
        plane: As in `follow_boundary`.
        on_line: As there.
        metric: As there.
        found: As there.
        value: As there.
        leading: As there.
        upwards: Whether the second parameter rises at first, or falls.
        steps: As there.
        tell: As there.

    Raises:
        ZenoOrbitsError: If the point is none of the curve, or its neighbours do not return.
    """
    if found.kind in CRITICAL:
        return half_critical(
            plane, on_line, metric, found, value, upwards=upwards, steps=steps, tell=tell
        )
    scale = plane.units[0] / metric.unit

    def relative(point: BranchPoint) -> Before:
        state = (point.x - found.z[:-1] * metric.scale) / metric.scale
        away = (point.z[-1] - found.z[-1]) / scale
        left = left_of(point, found.kind, found.place)
        return Before(state=state, away=np.array([away, 0.0]), left=left)

    first = Spot(
        at=np.array(value) / plane.units,
        located=replace(found, z=np.append(found.z[:-1], 0.0), error=found.error / plane.units[0]),
        before=tuple(relative(point) for point in leading),
    )
    curve = SecantCurve(
        plane, on_line, replace(metric, unit=1.0), found.kind, found.place, steps, tell
    )
    spots, end = curve.run(first, upwards=upwards)
    values = np.array([spot.at * plane.units for spot in spots])
    return HalfCurve(
        x=tuple(values[:, 0].tolist()),
        y=tuple(values[:, 1].tolist()),
        errors=tuple(spot.located.error for spot in spots),
        end=end,
    )
