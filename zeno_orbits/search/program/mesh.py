r"""Meshes of collocation schemes, graded by the guess.

After every impact the current has a boundary layer of width `L/R`. A uniform mesh does not resolve
the layer, and the program diverges. Every interval whose polynomial deviates from the guess is
halved, which grades the mesh from the impact outwards. The method does not depend on motors.

Source: [HairerWanner1996]_, theory (3.2).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zeno_orbits.arrays import Array
from zeno_orbits.integrators import Collocation, lagrange_basis

_COARSER = 10.0
"""Factor of the tolerance if the number of intervals is not sufficient."""
_ROUNDING, _SIZE = 1e-16, 1.0
"""Smallest tolerance above zero, and a deviation as large as the trajectory."""


def graded_mesh(
    trajectory: Callable[[Array], Array],
    scheme: Collocation,
    *,
    scale: Array,
    tolerance: float,
    fewest: int = 1,
    most: int = 2**20,
    deepest: int = 14,
) -> Array:
    """Return the ends of the intervals on which polynomials approximate a trajectory.

    Intervals are halved until the polynomials satisfy the tolerance. If this needs more than
    ``most`` intervals, the trajectory is rounding noise at this tolerance. The tolerance is then
    multiplied by ten until ``most`` intervals are sufficient.

    Args:
        trajectory: States at fractions of the arc in [0, 1], ``(n,)`` to ``(n, n_y)``.
        scheme: Collocation scheme. The polynomial interpolates its stages and the interval's start.
        scale: Size of each state, ``(n_y,)``.
        tolerance: Largest deviation of the polynomial between its points, in units of ``scale``.
        fewest: Number of uniform intervals at the beginning.
        most: Largest number of intervals.
        deepest: Largest number of halvings of an interval.

    Returns:
        Fractions from 0 to 1, ``(n_intervals + 1,)``.
    """
    points = np.concatenate([[0.0], scheme.nodes])
    between = (points[1:] + points[:-1]) / 2
    predict = np.array([lagrange_basis(points.tolist(), float(at)) for at in between])
    places = np.concatenate([points, between])

    def deviations(left: Array, right: Array) -> Array:
        fractions = left[:, None] + (right - left)[:, None] * places
        states = trajectory(fractions.ravel()).reshape(*fractions.shape, -1)
        at, seen = states[:, : len(points)], states[:, len(points) :]
        return np.max(np.abs(predict @ at - seen) / scale, axis=(1, 2))

    even = np.linspace(0.0, 1.0, fewest + 1)
    room = max(most, fewest)
    while tolerance < _SIZE:
        left, right, ends = even[:-1], even[1:], [even[:1]]
        for depth in range(deepest + 1):
            coarse = ~(deviations(left, right) <= tolerance) & (depth < deepest)
            ends.append(right[~coarse])
            left, right = left[coarse], right[coarse]
            middle = (left + right) / 2
            left, right = np.concatenate([left, middle]), np.concatenate([middle, right])
            if sum(map(len, ends)) + len(left) > room + 1 or not left.size:
                break
        if not left.size:
            return np.sort(np.concatenate(ends))
        tolerance = max(_COARSER * tolerance, _ROUNDING)
    return even


def stage_fractions(mesh: Array, scheme: Collocation) -> Array:
    """Return the position of every stage in the arc, ``(n_intervals * n_stages,)``."""
    sizes = np.diff(mesh)
    return (mesh[:-1, None] + sizes[:, None] * scheme.nodes).ravel()
