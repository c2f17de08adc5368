"""Distance of points from a line of straight sides, in space of any dimension."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector

SIDE = 3e-4
"""Length between the posts of a line whose size is about one."""
_POSTS = 8
"""Places on the line whose sides are tried for a point."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Polyline:
    """A line of straight sides.

    Attributes:
        corners: ``(n, m)``, in units in which its size is about one; see `telling_corners`.
    """

    corners: Vector

    def distances(self, points: Vector) -> Vector:
        """Return the distance of points from the line, ``(k,)``.

        Args:
            points: ``(k, m)``.
        """
        sides = np.diff(self.corners, axis=0)
        owner, posts = self._posts
        _, nearest = posts.query(points, k=min(_POSTS, posts.n))
        squared = np.full(len(points), np.inf)
        for column in owner[nearest].reshape(len(points), -1).T:
            start, side = self.corners[column], sides[column]
            length = np.maximum(np.sum(side**2, axis=1), 1e-300)
            part = np.clip(np.sum((points - start) * side, axis=1) / length, 0.0, 1.0)
            rest = points - start - part[:, None] * side
            squared = np.minimum(squared, np.sum(rest**2, axis=1))
        return np.sqrt(squared)

    @cached_property
    def _posts(self) -> tuple[NDArray[np.intp], Any]:
        """Number of the side of each post, and the posts as a tree.

        Posts stand as closely on long sides, the resets, as on short ones, so that the nearest
        posts stand on the nearest side, up to a part of the square of their spacing.
        """
        # SciPy's trees take longer to import than most of the package, and few ask for a distance.
        from scipy.spatial import cKDTree

        sides = np.diff(self.corners, axis=0)
        counts = np.ceil(np.sqrt(np.sum(sides**2, axis=1)) / SIDE).astype(np.intp).clip(1)
        owner = np.repeat(np.arange(len(sides)), counts)
        step = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
        places = self.corners[owner] + sides[owner] * ((step + 0.5) / counts[owner])[:, None]
        return owner, cKDTree(places)


def telling_corners(corners: Vector) -> NDArray[np.intp]:
    """Return which corners tell a line: ends of long sides, and others at even lengths.

    Where many stand in one place, as of a motion at rest, their posts would hide all others.
    """
    sides = np.sqrt(np.sum(np.diff(corners, axis=0) ** 2, axis=1))
    lengths = np.concatenate([[0.0], np.cumsum(sides)])
    _, even = np.unique(np.floor(lengths / SIDE), return_index=True)
    long = np.flatnonzero(sides > SIDE)
    return np.unique(np.concatenate([even, long, long + 1, [len(corners) - 1]]))
