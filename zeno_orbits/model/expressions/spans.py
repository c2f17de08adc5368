r"""Spans of a table: stretches of its argument that a step may pass without missing a pulse.

A step samples a table at a few points. On a span the table is a polynomial through a dozen points,
to a small part of its range there, so the points of a step show all of it. A step ends where a span
ends. If knots are events, a step may pass one, but not beyond the formula of its cell.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector

_NODES = 12
"""Points through which the polynomial of a span goes: as many as the stages of an explicit step."""
_SHARE, _LEAST, _ROUNDING = 1e-7, 1e-12, 1e-14
"""Difference from the polynomial that is small: shares of the range of the table on the span, of
its range on all knots, and of its largest value."""
_SPLIT = 8
"""Number of cells up to which a span is split into all of its cells."""
_POINTS = 48
"""Points at which spans are compared first."""
_CHUNK = 4096
"""Number of spans, or of points, that are compared at once."""
_PAST = 1e-6
"""Part of a cell by which a step passes the end of a span, so that the next one begins past it."""
_NEAR = 0.49
"""Part of the next cell in which the formula of a cell holds."""
_BEYOND = 1e3
"""Length of the outer spans in lengths of the table: an outer cell goes on beyond the knots."""

_known: dict[bytes, Vector] = {}


def reach(knots: Vector, coefficients: Vector, *, turns: bool = False) -> Vector:
    """Return the lengths from every knot back to the start and on to the end of its span.

    Args:
        knots: The knots, ``(n + 1,)``.
        coefficients: Coefficients of the cells in powers of the way from their knot, ``(k, n, m)``.
        turns: Whether the knots are phases of a turn, so that no outer cell goes on.

    Returns:
        Lengths from the knot of every cell, ``(2, n)``.
    """
    digest = hashlib.sha256(np.ascontiguousarray(knots).tobytes())
    digest.update(np.ascontiguousarray(coefficients).tobytes())
    key = digest.digest() + bytes([turns])
    if key not in _known:
        _known[key] = _reach(knots, coefficients, turns=turns)
    return _known[key]


def reach_of_cells(knots: Vector, *, turns: bool = False) -> Vector:
    """Return the lengths from every knot back and on that a step may pass if knots are events.

    The formula of a cell holds up to the middles of its neighbours.

    Args:
        knots: The knots, ``(n + 1,)``.
        turns: Whether the knots are phases of a turn, so that no outer cell goes on.

    Returns:
        Lengths from the knot of every cell, ``(2, n)``.
    """
    width = np.diff(knots)
    lengths = np.stack([_NEAR * np.roll(width, 1), width + _NEAR * np.roll(width, -1)])
    return lengths if turns else _beyond(knots, lengths, [0], [-1])


def _beyond(knots: Vector, lengths: Vector, first: Any, last: Any) -> Vector:
    """Let the steps of outer cells go on beyond the knots."""
    far = _BEYOND * (knots[-1] - knots[0])
    lengths[0, first] = lengths[1, last] = far
    return lengths


def _reach(knots: Vector, coefficients: Vector, *, turns: bool) -> Vector:
    borders = _borders(knots, coefficients)
    width, first = np.diff(knots), knots[:-1]
    span = np.searchsorted(borders, np.arange(len(width)), side="right")
    start, end = borders[span - 1], borders[span]
    # An index beyond the last cell is that of the first one, after a turn.
    behind = first - knots[start] + _PAST * width[start - 1]
    ahead = knots[end] - first + _PAST * width[end % len(width)]
    lengths = np.stack([behind, ahead])
    return lengths if turns else _beyond(knots, lengths, start == 0, end == len(width))


def _borders(knots: Vector, coefficients: Vector) -> np.ndarray:
    """Return the indices of the knots between spans, with both ends."""
    n = len(knots) - 1
    tabled = _tabled(knots, coefficients)
    at_knots = tabled(knots)
    largest = np.max(np.abs(at_knots), axis=0)
    least = np.maximum(_LEAST * np.ptp(at_knots, axis=0), _ROUNDING * largest)
    found, spans = [np.array([0, n])], np.array([[0, n]])
    while len(spans):
        split = np.concatenate(
            [
                ~_are_shown(knots, tabled, spans[k : k + _CHUNK], least)
                for k in range(0, len(spans), _CHUNK)
            ]
        )
        spans = spans[split]
        short = spans[:, 1] - spans[:, 0] <= _SPLIT
        found += [one[0] + np.arange(one[1] - one[0]) for one in spans[short]]
        spans = spans[~short]
        middles = (spans[:, 0] + spans[:, 1]) // 2
        found.append(middles)
        spans = np.concatenate(
            [np.stack([spans[:, 0], middles], 1), np.stack([middles, spans[:, 1]], 1)]
        )
    return np.unique(np.concatenate(found))


def _tabled(knots: Vector, coefficients: Vector) -> Callable[[Vector], Vector]:
    """Return a table as a function of arguments ``(...)`` with values ``(..., m)``."""

    def values(x: Vector) -> Vector:
        k = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
        u = (x - knots[k])[..., None]
        total = coefficients[-1][k]
        for one in coefficients[-2::-1]:
            total = one[k] + u * total
        return total

    return values


_ANGLES = (np.arange(_NODES) + 0.5) * np.pi / _NODES
_CHEBYSHEV = (1.0 - np.cos(_ANGLES)) / 2
_WEIGHTS = (-1.0) ** np.arange(_NODES) * np.sin(_ANGLES)


def _are_shown(
    knots: Vector, tabled: Callable[[Vector], Vector], spans: np.ndarray, least: Vector
) -> np.ndarray:
    """Return whether the table on each span is the polynomial through its points, ``(s,)``."""
    first, last = knots[spans[:, 0]], knots[spans[:, 1]]
    nodes = first[:, None] + (last - first)[:, None] * _CHEBYSHEV
    samples = tabled(nodes)
    share = (np.arange(_POINTS) + 0.5) / _POINTS
    # Equal steps of the index reach every cell of a short span, however narrow it is.
    places = spans[:, :1] + (spans[:, 1:] - spans[:, :1]) * share
    cells = places.astype(int)
    points = knots[cells] + (places - cells) * (knots[cells + 1] - knots[cells])
    shown = _are_near(nodes, samples, points, tabled, least)
    for k in np.flatnonzero(shown & (spans[:, 1] - spans[:, 0] > _POINTS // 4)).tolist():
        inner = knots[spans[k, 0] : spans[k, 1] + 1]
        every = np.concatenate([inner[1:-1], (inner[1:] + inner[:-1]) / 2])
        shown[k] = all(
            _are_near(nodes[k : k + 1], samples[k : k + 1], one[None], tabled, least)[0]
            for one in np.array_split(every, 1 + len(every) // _CHUNK)
        )
    return shown


def _are_near(
    nodes: Vector,
    samples: Vector,
    points: Vector,
    tabled: Callable[[Vector], Vector],
    least: Vector,
) -> np.ndarray:
    """Return whether polynomials through nodes meet the table at points, ``(s,)``.

    Args:
        nodes: Nodes of every span, ``(s, 12)``.
        samples: The table there, ``(s, 12, m)``.
        points: Points of every span, ``(s, l)``.
        tabled: The table.
        least: Difference that counts as rounding, ``(m,)``.
    """
    way = points[:, :, None] - nodes[:, None, :]
    is_node = way == 0.0
    parts = _WEIGHTS / np.where(is_node, 1.0, way)
    # At a node the polynomial is the table itself.
    met = np.any(is_node, axis=2)
    values = np.einsum("slk,skm->slm", parts, samples) / np.sum(parts, axis=2)[:, :, None]
    found = tabled(points)
    away = np.where(met[:, :, None], 0.0, np.abs(found - values))
    both = np.concatenate([samples, found], axis=1)
    return np.all(away <= (_SHARE * np.ptp(both, axis=1) + least)[:, None, :], axis=(1, 2))
