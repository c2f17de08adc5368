"""Taylor coefficients over many boxes at once, in hardware numbers: midpoints and radii.

The numbers are the longest of the processor (`numpy.longdouble`), with their unit of rounding
``u``: ``2^-64`` on most processors, ``2^-113`` on some, and ``2^-53`` on others, on which fewer
certificates are proved. Pairs of doubles do not round by one unit and are rejected.

Rounding. The error of a computed sum of ``n`` products is at most ``(n + 2) u`` times the sum of
the products' absolute values, for any order of summation, plus ``2^-1074`` for each product that
underflows. So for factors within ``r`` of ``c`` and ``s`` of ``d``

    |sum x y - sum c d| <= sum |c| (s + (n + 4) u |d|) + sum r (|d| + s)

includes the rounding of the midpoint. The right-hand side is a sum of nonnegative numbers, of which
each operation loses at most a part ``u``. So ``1 + 2^-40`` times the computed sum, plus ``2^-1000``
for underflow, is an upper bound if fewer than ``2^-41 / u`` numbers are added (4096 for the unit
``2^-53``). Longer sums are rejected. All other rounding is bounded in the same way. Sums of terms
over a step have fewer than ``2^7`` terms. Overflow results in infinity or NaN, for which every
inequality is false.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.proof.checker.balls import Array, Ball, NotProved, require
from zeno_orbits.proof.checker.formulas import Graph, Row
from zeno_orbits.proof.checker.series import function_at

HIGHEST = 100
"""Highest order."""
REAL = np.longdouble
UNIT, UP, TINY = float(np.finfo(REAL).eps) / 2, 1 + 2.0**-40, 2.0**-1000
_SUM = 2.0**7 * UNIT
MOST_TERMS = int(2.0**-41 / UNIT)
"""Largest number of summands for which the computed sum bounds the exact sum."""
_BITS = 100
"""Number of bits after the binary point in the computation of functions."""


def orders_of(record: Mapping[str, Any]) -> tuple[int, int]:
    """Return the orders of a record, for a point and for the derivative.

    Raises:
        InputError: If an order is not allowed.
    """
    high, low = record["orders"]
    sound = type(high) is type(low) is int
    if not (sound and 0 < min(high, low) <= max(high, low) < HIGHEST):
        raise InputError(f"The certificate's orders must be from 1 to {HIGHEST - 1}.")
    return high, low


def require_rounding(info: Any = np.finfo(REAL)) -> None:  # noqa: B008
    """Raise an error for hardware numbers that do not round by half a unit in the last place.

    Args:
        info: Properties of the numbers, from `numpy.finfo`.

    Raises:
        InputError: If the numbers do not have 53, 64 or 113 bits.
    """
    if info.nmant not in (52, 63, 112) or info.eps != 2.0**-info.nmant:
        wanted = "A check needs a `numpy.longdouble` of 53, 64 or 113 bits"
        raise InputError(f"{wanted}, but this one has {info.nmant + 1}. Check on another machine.")


@dataclass(frozen=True, slots=True)
class Lanes:
    """Intervals in an array: midpoints and radii."""

    c: Any
    r: Any

    def __getitem__(self, key: Any) -> Lanes:
        return Lanes(self.c[key], self.r[key])

    def __add__(self, other: Any) -> Lanes:
        c = self.c + other.c
        return Lanes(c, (self.r + other.r + 2 * UNIT * abs(c)) * UP)

    def __sub__(self, other: Any) -> Lanes:
        return self + Lanes(-other.c, other.r)

    def __mul__(self, other: Any) -> Lanes:
        return _products(np.multiply, 1, self, other)

    def __truediv__(self, other: Any) -> Lanes:
        c, least = self.c / other.c, abs(other.c) - other.r
        r = (self.r + abs(c) * other.r + TINY) / least * UP + 4 * UNIT * abs(c) + TINY
        return Lanes(c, np.where(least > 0, r, np.inf))

    def hull(self) -> Lanes:
        """Return sums over axis 0 of the first terms and any part of all other terms."""
        low = np.minimum(0, self.c[1:] - self.r[1:]).sum(axis=0) + self.c[0]
        high = np.maximum(0, self.c[1:] + self.r[1:]).sum(axis=0) + self.c[0]
        size = (abs(self.c) + self.r).sum(axis=0)
        c = (low + high) / 2
        moved = (self.c[1:] != 0) | (self.r[1:] != 0)
        r = ((high - low) / 2 + self.r[0]) * UP + _SUM * size + TINY
        return Lanes(c, np.where(moved.any(axis=0), r, self.r[0]))

    def total(self) -> Lanes:
        """Return the sums along axis 0."""
        size = abs(self.c).sum(axis=0)
        share = (len(self.c) + 4) * UNIT
        return Lanes(self.c.sum(axis=0), (self.r.sum(axis=0) + share * size) * UP + TINY)

    def wider(self) -> Lanes:
        """Return intervals that are wider by a fixed factor."""
        return Lanes(self.c, self.r * 1.125 + TINY)

    def then(self, last: Lanes) -> Lanes:
        """Return terms with one term appended along axis 0."""
        return Lanes(np.concatenate([self.c, last.c[None]]), np.concatenate([self.r, last.r[None]]))

    def inside(self, other: Lanes) -> Any:
        """Return True for each interval that lies in the interior of the other interval."""
        return (abs(self.c - other.c) + self.r) * UP < other.r

    def balls(self, bits: int) -> Array:
        """Return the intervals as balls."""
        pairs = zip(self.c.ravel(), self.r.ravel(), strict=True)
        found: Any = np.empty(self.c.size, dtype=object)
        found[:] = [_ball(c, r, bits) for c, r in pairs]
        return found.reshape(self.c.shape)


def where(which: Any, these: Lanes, others: Lanes) -> Lanes:
    """Return intervals selected by a boolean array from two arrays.

    Args:
        which: True where an entry comes from the first array. Shapes broadcast.
        these: The first array.
        others: The second array.
    """
    return Lanes(np.where(which, these.c, others.c), np.where(which, these.r, others.r))


def _products(apply: Callable[..., Any], n: int, x: Lanes, y: Lanes) -> Lanes:
    """Return sums of products with n terms."""
    require(n + 16 < MOST_TERMS, f"the rounding of {n} products is not bounded on this processor")
    a = abs(y.c)
    r = apply(abs(x.c), y.r + (n + 4) * UNIT * a) + apply(x.r, a + y.r)
    return Lanes(apply(x.c, y.c), r * UP + TINY)


def matmul(x: Lanes, y: Lanes) -> Lanes:
    """Return products of matrices."""
    return _products(np.matmul, x.c.shape[-1], x, y)


def _convolved(x: Lanes, y: Lanes) -> Lanes:
    """Return ``sum_j x_j y_(n - j)``."""
    return _products(_dot, len(x.c), x, y[::-1])


def _dot(a: Any, b: Any) -> Any:
    return np.einsum("k...,k...->...", a, b)


def _ball(c: Any, r: Any, bits: int) -> Ball:
    if not (abs(c) < np.inf and r < np.inf):
        raise NotProved("a bound exceeds the largest number")
    (n, d), (k, e) = c.as_integer_ratio(), r.as_integer_ratio()
    m, rest = divmod(n << bits, d)
    return Ball(m, -(-(k << bits) // e) + (rest != 0), bits)


def _interval(ball: Ball) -> tuple[Any, Any]:
    """Return midpoint and radius of an interval of hardware numbers that contains a ball."""
    unit = 1 << ball.bits
    first = ball.m / unit
    n, d = first.as_integer_ratio()
    c = REAL(first) + REAL((ball.m * d - (n << ball.bits)) / (d << ball.bits))
    n, d = c.as_integer_ratio()
    # Rounding error of the midpoint, rounded up.
    off = abs(ball.m * d - (n << ball.bits))
    r = ball.r + -(-off // d)
    return c, REAL(np.nextafter(r / unit, np.inf) if r else 0.0)


def lanes_of(balls: Any) -> Lanes:
    """Return arrays of balls as intervals."""
    balls = np.asarray(balls, dtype=object)
    pairs = np.array([_interval(ball) for ball in balls.ravel()], dtype=REAL)
    return Lanes(*np.moveaxis(pairs.reshape(*balls.shape, 2), -1, 0))


class LaneFlow(NamedTuple):
    """A flow and its derivative as nodes."""

    graph: Graph
    z: Sequence[int]
    rates: Row
    slopes: Sequence[Row]


def coefficients(
    flow: LaneFlow, inputs: Mapping[int, Lanes], h: Lanes, order: int, longer: int
) -> tuple[Lanes, Lanes]:
    """Return Taylor coefficients times ``h^k`` of the flow and its derivative over many boxes.

    Args:
        flow: The flow.
        inputs: All inputs over the boxes, ``(L,)`` each.
        h: The steps, ``(L,)``.
        order: Order of the last coefficient of the derivative.
        longer: Order of the last coefficient of the states, at least `order`.

    Returns:
        Coefficients of the states, ``(longer + 1, L, N)``, and of the derivative,
        ``(order + 1, L, N, N)``.
    """
    graph, n, L = flow.graph, len(flow.z), len(h.c)
    flat = [part for row in flow.slopes for part in row]
    plan, known = graph.needed([*flow.rates, *flat]), dict[int, Lanes]()
    in_flow = set(graph.needed(flow.rates))
    shape = longer + 1, L
    moving = {place for place, node in zip(flow.z, flow.rates, strict=True) if node is not None}
    for place in {*plan, *inputs}:
        known[place] = Lanes(np.zeros(shape, REAL), np.zeros(shape, REAL))
    for place, one in inputs.items():
        known[place].c[0], known[place].r[0] = one.c, one.r
    for place in plan:
        if any(a in moving for a in graph.nodes[place][1:] if isinstance(a, int)):
            moving.add(place)
    for k in range(longer):
        for place in plan:
            if (
                place in inputs
                or (k and place not in moving)
                or (k >= order and place not in in_flow)
            ):
                continue
            found = _next(graph.nodes[place], known, known[place], k, moving)
            known[place].c[k], known[place].r[k] = found.c, found.r
        part = h / _number(k + 1)
        for place, node in zip(flow.z, flow.rates, strict=True):
            if node is not None:
                rate = known[node][k] * part
                known[place].c[k + 1], known[place].r[k + 1] = rate.c, rate.r
    states = _stacked([known[place] for place in flow.z])
    zero = np.zeros(shape, REAL)
    known[-1] = Lanes(zero, zero)
    rows = [known[-1 if place is None else place][:order] for place in flat]
    entries, whole = _stacked(rows), (order, L, n, n)
    J = Lanes(entries.c.reshape(whole), entries.r.reshape(whole))
    return states, _derivative(J, h, order)


def _stacked(lanes: Sequence[Lanes]) -> Lanes:
    """Return intervals along a new last axis."""
    return Lanes(np.stack([one.c for one in lanes], -1), np.stack([one.r for one in lanes], -1))


def _derivative(J: Lanes, h: Lanes, order: int) -> Lanes:
    """Return coefficients of the solution of ``V' = J V`` that starts at the identity."""
    V = Lanes(*(np.zeros((order + 1, *J.c.shape[1:]), REAL) for _ in range(2)))
    V.c[0] = np.eye(J.c.shape[-1])
    for k in range(order):
        wide = [np.concatenate(list(part[: k + 1]), axis=-1) for part in (J.c, J.r)]
        tall = [np.concatenate(list(part[k::-1]), axis=-2) for part in (V.c, V.r)]
        part = h / _number(k + 1)
        found = matmul(Lanes(*wide), Lanes(*tall)) * part[:, None, None]
        V.c[k + 1], V.r[k + 1] = found.c, found.r
    return V


def _number(k: int) -> Lanes:
    return Lanes(float(k), 0.0)


def _next(
    node: tuple[Any, ...], known: Mapping[int, Lanes], own: Lanes, n: int, moving: set[int]
) -> Lanes:
    """Return coefficient ``n`` of a node from the coefficients of its arguments."""
    name = node[0]
    if name == "constant":
        return Lanes(node[1], 0.0)
    if name == "function":
        u, g = known[node[2]], known[node[3]]
        if n == 0:
            found = (function_at(node[1], ball) for ball in u[0].balls(_BITS))
            return lanes_of([*found])
        weights = Lanes(np.arange(1, n + 1, dtype=REAL).reshape(-1, 1), 0.0)
        return _convolved(u[1 : n + 1] * weights, g[:n]) / _number(n)
    x, y = known[node[1]], known[node[-1]]
    if name == "neg":
        return Lanes(-x.c[n], x.r[n])
    if name == "mul":
        if node[1] not in moving:
            return x[0] * y[n]
        return x[n] * y[0] if node[2] not in moving else _convolved(x[: n + 1], y[: n + 1])
    if name == "div":
        rest = x[n] - _convolved(own[:n], y[1 : n + 1]) if n and node[2] in moving else x[n]
        return rest / y[0]
    return x[n] + y[n] if name == "add" else x[n] - y[n]
