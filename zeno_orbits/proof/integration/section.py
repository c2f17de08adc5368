"""The section in balls: its points as functions of some of the states.

On the section of releases, gap, gap rate and contact force are zero. On the section of the states
just after an impact, only the gap is zero. The constraints of the problem hold on both, including
the circle of the clock. The remaining free states are the section's coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import arb
from scipy.linalg import qr

from zeno_orbits.errors import ProofError
from zeno_orbits.proof.arithmetic.balls import ZERO, Ball, Matrix, column, matrix, on_grid, product
from zeno_orbits.proof.integration.ball_system import BallSystem
from zeno_orbits.proof.integration.sets import MACHINE_WIDER, NEW_WIDER, BallSet, start_set

_NEWTON_STEPS = 8
_REACHES = (1e9, 1e8, 1e7, 1e6, 1e5, 1e4, 1e3, 100.0, 10.0, 2.0)
"""Trial radii for the other states, as multiples of their change with the coordinates."""
_LEAST_REACH = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionStart:
    """The start of a proof on the section.

    Attributes:
        places: Indices of the section's coordinates in the state.
        others: Indices of the states that the section determines.
        centre: Coordinates of the middle, exact, ``(d,)``.
        around: Box around the other states, as balls. For each value of the coordinates, the
            section has one point with its other states in this box.
        reached: Boxes inside `around` that contain the other states of these points, as balls.
        at: Set of the section's points over the box of coordinates and carried parameters.
    """

    places: list[int]
    others: list[int]
    centre: list[Ball]
    around: list[Ball]
    reached: list[Ball]
    at: BallSet


def section_places(system: BallSystem, y: Sequence[float]) -> tuple[list[int], list[int]]:
    """Return the indices of the section's coordinates, and of the states that follow from them.

    Args:
        system: The problem.
        y: A state near the section, ``(n,)``.
    """
    free = _free_places(system)
    slopes = _slopes(system, [arb(v) for v in y])
    if not slopes:
        return free, []
    n_constraints = len(slopes)
    floats = np.array([[float(row[k].mid()) for k in free] for row in slopes])
    scale = np.array([1e-3 + abs(y[k]) for k in free])
    order: list[int] = qr(floats * scale, pivoting=True, mode="economic")[2].tolist()
    others = sorted(free[k] for k in order[:n_constraints])
    return [k for k in free if k not in others], others


def start_on_section(
    system: BallSystem,
    y: Sequence[Ball],
    places: list[int],
    others: list[int],
    radii: Sequence[float],
    within: Sequence[Ball] | None = None,
) -> SectionStart:
    """Return the set of the section's points over a box of coordinates.

    Args:
        system: The problem.
        y: A state near the middle, ``(n,)``. The middle is the nearest point of the grid.
        places: Indices of the coordinates.
        others: Indices of the states that the section determines.
        radii: Radii of the coordinates, then of the carried parameters.
        within: Box that must contain the box around the other states. None allows any box.

    Raises:
        ProofError: If the section is not proved to have one point over each value of the
            coordinates.
    """
    carried = list(range(system.n - len(system.carried), system.n))
    inputs = [*places, *carried]
    middle = _middle_on(system, y, others)
    box = list(middle)
    deviations = [arb(0, radius) for radius in radii]
    for k, change in zip(inputs, deviations, strict=True):
        box[k] = middle[k] + change
    moved = [ZERO] * len(others)
    if inputs and others:
        moved = product(_section_derivative(system, middle, others, inputs), deviations)
    for reach in _REACHES:
        for k, change in zip(others, moved, strict=True):
            radius = reach * (change.abs_upper() + _LEAST_REACH * (1 + middle[k].abs_upper()))
            box[k] = middle[k] + arb(0, arb(float(radius)))
        inside = within is None or all(
            bool(outer.contains(box[k])) for k, outer in zip(others, within, strict=True)
        )
        found = _newton_box(system, box, middle, others) if inside else None
        if found is not None:
            break
    else:
        raise ProofError("start", "the section is not proved to be smooth there")
    around = [box[k] for k in others]
    thin, exact = list(middle), _newton_box(system, _around(box, middle, others), middle, others)
    for k, value in zip(others, exact or found, strict=True):
        thin[k] = value
    for k, value in zip(others, found, strict=True):
        box[k] = value
    derivative = _derivative_on(system, box, others, inputs)
    computed = [k for k in system.carried_stops if k not in system.stopped]
    if computed:
        values, slopes = system.stops(thin)[0], system.stops(box)[1]
        at = matrix(derivative, len(inputs))
        for k in computed:
            row = k - system.carried_stops[0]
            thin[k] = values[row]
            derivative[k] = (matrix([slopes[row]], system.n) * at).entries()
    wider = MACHINE_WIDER if system.view else NEW_WIDER
    whole = matrix(derivative, len(inputs))
    return SectionStart(
        places=places,
        others=others,
        centre=[middle[k] for k in places],
        around=around,
        reached=found,
        at=start_set(thin, whole, deviations, [*others, *computed], wider),
    )


def _middle_on(system: BallSystem, y: Sequence[Ball], others: list[int]) -> list[Ball]:
    """Return the point of the grid that is nearest to the section, by Newton's method."""
    middle = [ZERO if k in system.stopped else on_grid(value) for k, value in enumerate(y)]
    for _ in range(_NEWTON_STEPS):
        step = _newton(system, middle, middle, others)
        for k, change in zip(others, step, strict=True):
            middle[k] = on_grid(middle[k] - change)
    return middle


def _derivative_on(
    system: BallSystem, box: list[Ball], others: list[int], inputs: list[int]
) -> list[list[Ball]]:
    """Return the derivative of the section's states with respect to its coordinates, by rows."""
    derivative = [[ZERO] * len(inputs) for _ in range(system.n)]
    for j, k in enumerate(inputs):
        derivative[k][j] = arb(1)
    if inputs and others:
        rows = _section_derivative(system, box, others, inputs).table()
        for k, row in zip(others, rows, strict=True):
            derivative[k] = row
    return derivative


def _around(box: list[Ball], middle: list[Ball], others: list[int]) -> list[Ball]:
    """Return the box with only the other states wide."""
    return [box[k] if k in others else value for k, value in enumerate(middle)]


def _free_places(system: BallSystem) -> list[int]:
    last = system.n - len(system.carried)
    still = {*system.stopped, *system.carried_stops}
    return [k for k in range(last) if k not in still]


def _slopes(system: BallSystem, y: Sequence[Ball]) -> list[list[Ball]]:
    values, slopes = system.constraints(y)
    rows = [[ZERO] * system.n for _ in values]
    for (row, col), one in zip(system.constraint_places, slopes, strict=True):
        rows[row][col] = one
    return rows


def _part(rows: list[list[Ball]], places: Sequence[int]) -> Matrix:
    return matrix([[row[k] for k in places] for row in rows], len(places))


def _section_derivative(
    system: BallSystem, y: Sequence[Ball], others: list[int], inputs: list[int]
) -> Matrix:
    """Return the derivative of the other states with respect to the inputs."""
    rows = _slopes(system, y)
    return _inverse(_part(rows, others)) * _part(rows, inputs) * -1


def _inverse(m: Matrix) -> Matrix:
    try:
        return m.inv()
    except ZeroDivisionError as error:
        raise ProofError("start", "the section is not proved to be smooth there") from error


def _newton(
    system: BallSystem, at: Sequence[Ball], slopes_at: Sequence[Ball], others: list[int]
) -> list[Ball]:
    values = system.constraints(at)[0]
    if not values:
        return []
    inverse = _inverse(_part(_slopes(system, slopes_at), others))
    return (inverse * column(values)).entries()


def _newton_box(
    system: BallSystem, box: Sequence[Ball], middle: Sequence[Ball], others: list[int]
) -> list[Ball] | None:
    """Enclose the other states over a box with the interval Newton method, or return None."""
    at = [middle[k] if k in others else value for k, value in enumerate(box)]
    try:
        steps = _newton(system, at, box, others)
    except ProofError:
        return None
    found = [middle[k] - step for k, step in zip(others, steps, strict=True)]
    inside = all(
        x.is_finite() and box[k].contains_interior(x) for k, x in zip(others, found, strict=True)
    )
    return found if inside else None
