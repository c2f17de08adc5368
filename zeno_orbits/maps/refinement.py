"""Refinement of a grid along boundaries: only cells with different corners are halved."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Rows

Place = tuple[int, int]
"""Row and column of a point of a grid."""


def fine_count(count: int, levels: int) -> int:
    """Return the number of points along an axis after some halvings of its cells."""
    return (count - 1) * 2**levels + 1


def refined(
    coarse: Sequence[str],
    shape: tuple[int, int],
    levels: int,
    classes_at: Callable[[int, Sequence[Place]], Sequence[str]],
) -> None:
    """Halve the cells along boundaries, level by level.

    A cell is halved if its corners differ in class, or the midpoints of its sides that a neighbour
    needed. A point inside of other cells has the class of their corners.

    Args:
        coarse: Class of each point, row by row, ``(n_y * n_x,)``.
        shape: Rows and columns, ``(n_y, n_x)``.
        levels: Number of halvings.
        classes_at: Function of a level and points of its grid. It returns the classes of the points
            and stores them.
    """
    codes: dict[str, int] = {}

    def coded(classes: Sequence[str]) -> list[int]:
        return [codes.setdefault(one, len(codes)) for one in classes]

    known: Rows = np.reshape(np.array(coded(coarse), dtype=np.intp), shape)
    for level in range(1, levels + 1):
        grid = inherited(known)
        new = np.zeros(grid.shape, dtype=bool)
        wanted = _midpoints(grid) & ~new
        while wanted.any():
            rows, columns = np.nonzero(wanted)
            places = list(zip(rows.tolist(), columns.tolist(), strict=True))
            grid[rows, columns] = coded(classes_at(level, places))
            new |= wanted
            wanted = _midpoints(grid) & ~new
        known = grid


def inherited(known: Rows) -> Rows:
    """Return a grid with twice as many cells per side. New points have the class of a neighbour.

    Args:
        known: Class of each point, ``(n_y, n_x)``.

    Returns:
        Class of each point, ``(2 n_y - 1, 2 n_x - 1)``.
    """
    twice = np.repeat(np.repeat(known, 2, axis=0), 2, axis=1)
    return twice[:-1, :-1]


def _midpoints(grid: Rows) -> NDArray[np.bool_]:
    """Return flags of the new points of all cells with different classes on their border.

    Args:
        grid: Class of each point after a halving, ``(2 n_y - 1, 2 n_x - 1)``.
    """
    low, high = slice(None, -2, 2), slice(2, None, 2)
    middle = slice(1, None, 2)
    border = [(low, low), (low, middle), (low, high), (middle, low)]
    border += [(middle, high), (high, low), (high, middle), (high, high)]
    around = np.stack([grid[place] for place in border])
    changes = np.any(around != around[:1], axis=0)
    flags = np.zeros(grid.shape, dtype=bool)
    for rows, columns in ((middle, middle), *border[1:2], *border[3:5], *border[6:7]):
        flags[rows, columns] |= changes
    return flags
