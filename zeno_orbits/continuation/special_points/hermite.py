r"""Zeros of a function between two points at which its value and derivative are given.

Between the points the function is the Hermite cubic plus an error,

.. math:: f = H + f[\ldots]\,x^2 (\ell - x)^2,

whose divided difference is estimated from a third point. The zeros are counted only if this error
cannot change their number. Theory (5.6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """A point of a function.

    Attributes:
        place: Argument of the function.
        value: Value of the function.
        slope: Derivative of the function.
        error: Estimated error of the value.
    """

    place: float
    value: float
    slope: float
    error: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """Number of zeros between two nodes, or the position of the next node.

    Attributes:
        crosses: True for one zero, False for no zero.
        split: Relative position in the interval at which another node is needed. It is ``None`` if
            the count is certain.
    """

    crosses: bool
    split: float | None = None


_SAMPLES = 65
"""Number of points at which the cubic and its error are compared."""
_SAFETY = 2.0
"""Factor of the estimated interpolation error."""
_ACCURATE = 0.1
"""Largest interpolation error, relative to the size of the function. If it is larger, the nodes are
too far apart."""
_LEAST, _MOST = 0.15, 0.85
"""Least and largest relative position at which an interval may be split."""


def zeros_between(left: Node, right: Node, third: Node | None) -> Count:
    """Return the number of zeros of a function between two nodes.

    Args:
        left: The first node.
        right: The second node.
        third: Another node nearby, before the first or after the second. Without a third node the
            error cannot be estimated, and the interval is split.
    """
    differs = left.value * right.value < 0.0
    if third is None:
        return Count(crosses=differs, split=0.5)
    length = right.place - left.place
    x = np.linspace(0.0, length, _SAMPLES)
    value, slope = _cubic(left, right, x)
    bound = _SAFETY * _quartic_bound(left, right, third)
    noise = max(left.error, right.error)
    error = bound * (x * (length - x)) ** 2
    if np.max(error) > _ACCURATE * max(abs(left.value), abs(right.value), noise):
        return Count(crosses=differs, split=0.5)
    error = error + noise
    if differs:
        rise = slope * np.sign(right.value)
        least = bound * np.abs(2 * x * (length - x) * (length - 2 * x)) + noise / length
        doubtful = (np.abs(value) <= error) & (rise <= least)
    else:
        doubtful = value * np.sign(left.value) <= error
    if not np.any(doubtful):
        return Count(crosses=differs)
    where = np.flatnonzero(doubtful)
    worst = where[int(np.argmin(np.abs(slope[where])))]
    return Count(crosses=differs, split=float(np.clip(x[worst] / length, _LEAST, _MOST)))


def _cubic(left: Node, right: Node, x: Vector) -> tuple[Vector, Vector]:
    """Return the cubic through two nodes with their slopes, and its derivative."""
    length = right.place - left.place
    mean = (right.value - left.value) / length
    second = (mean - left.slope) / length
    third = (right.slope - 2 * mean + left.slope) / length**2
    rest = x - length
    value = left.value + x * (left.slope + x * (second + third * rest))
    return value, left.slope + x * (2 * second + third * (2 * rest + x))


def _quartic_bound(left: Node, right: Node, third: Node) -> float:
    """Return the size of the divided difference that multiplies the error of the cubic.

    It is the sum of the difference over five arguments and the difference over six arguments. The
    second is multiplied by the distance over which the first may change.
    """
    nodes = sorted((left, right, third), key=lambda node: node.place)
    fourth, _ = _differences(nodes, once=third)
    fifth, span = _differences(nodes, once=None)
    return abs(fourth) + abs(fifth) * span


def _differences(nodes: Sequence[Node], once: Node | None) -> tuple[float, float]:
    """Return the divided difference of nodes, and their span. All nodes but one count twice."""
    places, table = list[float](), list[float]()
    first = list[float]()
    for node in nodes:
        for _ in range(1 if node is once else 2):
            places.append(node.place)
            table.append(node.value)
    slopes = {node.place: node.slope for node in nodes}
    for k in range(len(table) - 1):
        gap = places[k + 1] - places[k]
        first.append(slopes[places[k]] if gap == 0.0 else (table[k + 1] - table[k]) / gap)
    table = first
    for order in range(2, len(places)):
        table = [
            (table[k + 1] - table[k]) / (places[k + order] - places[k])
            for k in range(len(table) - 1)
        ]
    return table[0], places[-1] - places[0]
