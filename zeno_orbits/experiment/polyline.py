"""Distance of points from a line of straight sides, in space of any dimension."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector

SIDE = 3e-4
"""Longest side of a line whose size is about one."""
_NEAREST = 8
"""Corners whose sides are tried for a point."""


def line_distances(corners: Vector, points: Vector) -> Vector:
    """Return the distance of points from a line, ``(k,)``.

    Sides are cut into pieces, and corners nearer to each other than ``SIDE`` are left out. So the
    nearest corners lie on the nearest side.

    Args:
        corners: ``(n, m)``, in units in which the size of the line is about one.
        points: ``(k, m)``.
    """
    # SciPy's trees take longer to import than most of the package, and few callers need a distance.
    from scipy.spatial import cKDTree

    sides = np.sqrt(np.sum(np.diff(corners, axis=0) ** 2, axis=1))
    lengths: Vector = np.concatenate([[0.0], np.cumsum(sides)])
    long = np.flatnonzero(sides > SIDE)
    ends = np.unique(np.concatenate([long, long + 1, [0, len(corners) - 1]]))
    even: Vector = SIDE * np.arange(math.ceil(float(lengths[-1]) / SIDE)).astype(np.float64)
    # An evenly spaced point next to an end of a long side would cut the corner off.
    places = np.unique(np.concatenate([even, lengths[ends]]))
    line: Vector = np.empty((len(places), corners.shape[1]), dtype=np.float64)
    for k in range(corners.shape[1]):
        line[:, k] = np.interp(places, lengths, corners[:, k])
    found: Any = cKDTree(line).query(points, k=min(_NEAREST, len(line)))[1]
    nearest: NDArray[np.int64] = np.asarray(found, dtype=np.int64)
    squared = np.full(len(points), np.inf)
    for column in nearest.reshape(len(points), -1).T:
        for first in (column - 1, column):
            start = line[np.clip(first, 0, len(line) - 1)]
            side = line[np.clip(first + 1, 0, len(line) - 1)] - start
            length = np.maximum(np.sum(side**2, axis=1), 1e-300)
            part = np.clip(np.sum((points - start) * side, axis=1) / length, 0.0, 1.0)
            squared = np.minimum(squared, np.sum((points - start - part[:, None] * side) ** 2, 1))
    return np.sqrt(squared)
