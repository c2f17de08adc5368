r"""Collocation schemes and the meshes they stand on, graded by the guess itself.

After every impact the current runs through a layer of width `L/R`; an even mesh cannot see it and
the program diverges. Halving every interval whose polynomial misses the guess grades the mesh
from the impact outwards, and knows nothing of motors. Source: [HairerWanner1996]_, theory (17).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Array
from zeno_orbits.integrators import Collocation, lagrange_basis


def graded_mesh(
    trajectory: Callable[[float], Array],
    scheme: Collocation,
    *,
    scale: Array,
    tolerance: float,
    fewest: int = 1,
    deepest: int = 14,
) -> Array:
    """Return the ends of the intervals on which polynomials follow a trajectory.

    Args:
        trajectory: State at a fraction of the arc in [0, 1], ``(n_y,)``.
        scheme: Its stages and the start of the interval are the points of the polynomial.
        scale: Size of each state, ``(n_y,)``.
        tolerance: Largest deviation of the polynomial between its points, in units of ``scale``.
        fewest: Even intervals to begin with.
        deepest: Most halvings of one of them.

    Returns:
        Fractions from 0 to 1, ``(n_intervals + 1,)``.
    """
    points = np.concatenate([[0.0], scheme.nodes])
    between = (points[1:] + points[:-1]) / 2
    predict = np.array([lagrange_basis(points.tolist(), float(at)) for at in between])

    def fits(left: float, right: float) -> bool:
        at = np.array([trajectory(left + (right - left) * float(c)) for c in points])
        seen = np.array([trajectory(left + (right - left) * float(c)) for c in between])
        return bool(np.max(np.abs(predict @ at - seen) / scale) <= tolerance)

    def split(left: float, right: float, depth: int) -> list[float]:
        if depth == 0 or fits(left, right):
            return [right]
        middle = (left + right) / 2
        return [*split(left, middle, depth - 1), *split(middle, right, depth - 1)]

    even = np.linspace(0.0, 1.0, fewest + 1)
    ends = [0.0]
    for left, right in pairwise(even):
        ends += split(float(left), float(right), deepest)
    return np.array(ends)


def stage_fractions(mesh: Array, scheme: Collocation) -> Array:
    """Return the position of every stage in the arc, ``(n_intervals * n_stages,)``."""
    sizes = np.diff(mesh)
    return (mesh[:-1, None] + sizes[:, None] * scheme.nodes).ravel()
