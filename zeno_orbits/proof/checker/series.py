"""Taylor coefficients of the nodes of a graph in balls, and nodes over complex discs."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from importlib import import_module
from operator import mul
from typing import Any, cast

import numpy as np

from zeno_orbits.proof.checker.balls import (
    Array,
    Ball,
    NotProved,
    between,
    quotient,
    require,
    rounded,
)
from zeno_orbits.proof.checker.formulas import Graph

_MPMATH: Any = import_module("mpmath")
iv: Any = import_module("mpmath.ctx_iv").MPIntervalContext()
"""Interval arithmetic of mpmath, real and complex. Other code cannot change its precision."""
iv.prec = 1024 + 128
_ROUNDED = iv.mpf(2) ** -1100
"""Relative error bound above the rounding of these intervals."""
"""Precision of the intervals [bits], above the precision of the finest unit."""
_SPARE = 20
"""Additional bits of elementary functions beyond the unit."""
_FINITE = 2048
"""Largest number of bits before the binary point for the conversion of an interval to a ball."""
_LARGEST = dict.fromkeys(("sin", "cos", "log", "sqrt", "atan"), 1 << 600) | {
    "exp": 700,
    "tanh": 300,
}
"""Largest arguments of functions. Beyond them, the value or the computing time is unbounded."""


class Series:
    """Coefficients of one node: midpoints, radii, and bounds of their absolute values."""

    __slots__ = ("a", "m", "r", "s", "still")

    def __init__(self) -> None:
        self.still = False
        self.m, self.a, self.r, self.s = (list[int]() for _ in range(4))

    def append(self, m: int, r: int) -> None:
        """Append a coefficient."""
        self.m.append(m)
        self.a.append(abs(m))
        self.r.append(r)
        self.s.append(abs(m) + r)

    def append_part(self, m: int, r: int, part: int) -> None:
        """Append a coefficient that is divided by an integer."""
        self.append(m // part, -(-r // part) + (m % part != 0))


def taylor(
    graph: Graph,
    z: Sequence[int],
    rates: Sequence[int | None],
    starts: Mapping[int, Ball],
    h: Ball,
    order: int,
) -> Array:
    """Return Taylor coefficients times ``h^k`` of states, up to an order, ``(N, order + 1)``.

    Args:
        graph: The formulas.
        z: Inputs of the states.
        rates: The nodes of their rates, ``None`` for a rate of zero.
        starts: Inputs and their values at the start, including constants of the motion.
        h: The step.
        order: Order of the last coefficient.
    """
    moving = {place for place, node in zip(z, rates, strict=True) if node is not None}
    every, plan = graph.needed(rates), list[int]()
    series = _started(graph, every, starts)
    for place in every:
        if any(a in moving for a in graph.nodes[place][1:] if isinstance(a, int)):
            moving.add(place)
            plan.append(place)
    for still in series.keys() - moving:
        series[still].still = True
        for _ in range(order):
            series[still].append(0, 0)
    for k in range(order):
        for place, node in zip(z, rates, strict=True):
            if node is not None:
                one = series[node]
                series[place].append_part(
                    *rounded(h.m * one.m[k], h.size * one.r[k], h.bits), k + 1
                )
        for place in plan:
            _grow(graph.nodes[place], series, series[place], h.bits)
    found = (zip(series[place].m, series[place].r, strict=True) for place in z)
    return np.array([[Ball(*pair, h.bits) for pair in one] for one in found], dtype=object)


def values(graph: Graph, inputs: Mapping[int, Ball], outputs: Sequence[int | None]) -> Array:
    """Return nodes over a box of the inputs.

    Args:
        graph: The formulas.
        inputs: Inputs and their values.
        outputs: The nodes, with ``None`` for zero.
    """
    bits = next(iter(inputs.values())).bits
    series = _started(graph, graph.needed(outputs, at_rest=True), inputs)
    found = [None if place is None else series[place] for place in outputs]
    pairs = [(0, 0) if one is None else (one.m[0], one.r[0]) for one in found]
    return np.array([Ball(*pair, bits) for pair in pairs], dtype=object)


def _started(graph: Graph, plan: Sequence[int], inputs: Mapping[int, Ball]) -> dict[int, Series]:
    """Return the first coefficients of nodes."""
    series = {place: Series() for place in [*inputs, *plan]}
    for place, ball in inputs.items():
        series[place].append(ball.m, ball.r)
    bits = next(iter(inputs.values())).bits
    for place in plan:
        if place not in inputs:
            _grow(graph.nodes[place], series, series[place], bits)
    return series


def _grow(node: tuple[Any, ...], series: Mapping[int, Series], own: Series, bits: int) -> None:
    """Append the next coefficient of a node, after the coefficients of its arguments."""
    name, n = node[0], len(own.m)
    if name == "constant":
        numerator, denominator = node[1].as_integer_ratio()
        own.append_part(numerator << bits, 0, denominator)
        return
    if name == "function":
        u = series[node[2]]
        if n == 0:
            start = function_at(node[1], Ball(u.m[0], u.r[0], bits))
            own.append(start.m, start.r)
            return
        # n f_n is the sum of j u_j f'(u)_(n - j).
        g, count = series[node[3]], range(1, n + 1)
        um, ua, ur = (list(map(mul, part[1:], count)) for part in (u.m, u.a, u.r))
        r = sum(map(mul, ua, g.r[n - 1 :: -1])) + sum(map(mul, ur, g.s[n - 1 :: -1]))
        own.append_part(*rounded(sum(map(mul, um, g.m[n - 1 :: -1])), r, bits), n)
        return
    x, y = series[node[1]], series[node[-1]]
    if name == "neg":
        own.append(-x.m[n], x.r[n])
    elif name == "mul" and (x.still or y.still):
        x, y = (x, y) if x.still else (y, x)
        own.append(*rounded(x.m[0] * y.m[n], x.a[0] * y.r[n] + x.r[0] * y.s[n], bits))
    elif name == "mul":
        m = sum(map(mul, x.m, y.m[n::-1]))
        r = sum(map(mul, x.a, y.r[n::-1])) + sum(map(mul, x.r, y.s[n::-1]))
        own.append(*rounded(m, r, bits))
    elif name == "div":
        m = (x.m[n] << bits) - sum(map(mul, own.m, y.m[n:0:-1]))
        r = sum(map(mul, own.a, y.r[n:0:-1])) + sum(map(mul, own.r, y.s[n:0:-1]))
        own.append(*quotient(m, (x.r[n] << bits) + r, Ball(y.m[0], y.r[0], bits)))
    else:
        sign = 1 if name == "add" else -1
        own.append(x.m[n] + sign * y.m[n], x.r[n] + y.r[n])


def function_at(name: str, u: Ball) -> Ball:
    """Return an elementary function of a ball, by mpmath's functions of intervals.

    mpmath rounds its ends in the wrong direction for about one argument in 10000. So each end is
    widened by 16 units in the last place of its precision. The precision increases with
    the size of an exponential.
    """
    if u.size >> u.bits >= _LARGEST[name] or (name in ("log", "sqrt") and u.low <= 0):
        raise NotProved(f"{name} of {u.shown()} is unbounded")
    if name == "tanh":
        power = function_at("exp", u + u)
        return (power - 1) / (power + 1)
    exact = _MPMATH.libmp.from_man_exp
    ends = exact(u.low, -u.bits), exact(u.high, -u.bits)
    grown = 2 * (u.size >> u.bits) if name == "exp" else 0
    prec = u.bits + _SPARE + u.size.bit_length() + grown
    found = getattr(_MPMATH.libmp.libmpi, f"mpi_{name}")(ends, prec)
    low, high = (_floor(end, u.bits) for end in found)
    spare = 2 + (max(abs(low), abs(high)) >> prec - 5)
    return between(low - spare, high + spare, u.bits)


def complex_values(
    graph: Graph, discs: Mapping[int, tuple[Ball, Ball]], outputs: Sequence[int | None]
) -> list[Any]:
    """Return nodes over a product of discs, as complex intervals of mpmath.

    Args:
        graph: The formulas.
        discs: Real centre and radius of the disc of every input.
        outputs: The nodes, with ``None`` for zero.
    """
    found: dict[int | None, Any] = {None: iv.mpc(0)}
    for place, (ball, radius) in discs.items():
        reach = radius.size
        real = between(ball.low - reach, ball.high + reach, ball.bits)
        found[place] = iv.mpc(interval(real), interval(Ball(0, reach, ball.bits)))
    for place in graph.needed(outputs, at_rest=True):
        name, *given = graph.nodes[place]
        if name == "constant":
            found[place] = iv.mpc(given[0])
        elif name == "function":
            found[place] = _complex_function(given[0], found[given[1]])
        elif name in _COMPLEX:
            found[place] = _COMPLEX[name](*(found[a] for a in given))
        finite = abs(found[place]) < iv.inf
        require(bool(finite), "a formula is unbounded over complex numbers")
    return [found[place] for place in outputs]


_COMPLEX: dict[str, Any] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": cast("Any", operator).truediv,
    "neg": operator.neg,
}


def _complex_function(name: str, z: Any) -> Any:
    """Return an analytic function over a complex rectangle."""
    if name in ("sin", "cos", "exp"):
        return _widened(getattr(iv, name)(z))
    if name in ("log", "sqrt") and z.real > 0:
        found = _widened(iv.log(z))
        return found if name == "log" else _widened(iv.exp(found / 2))
    if name == "tanh":
        return 1 - 2 / (_widened(iv.exp(2 * z)) + 1)
    if name == "atan" and abs(z.imag) < 1:
        # i z is within the strip in which both logarithms have their principal values.
        turned = iv.mpc(-z.imag, z.real)
        parts = (_complex_function("log", 1 + sign * turned) for sign in (1, -1))
        found = next(parts) - next(parts)
        return iv.mpc(found.imag, -found.real) / 2
    raise NotProved(f"{name} is not known to be analytic over complex numbers")


def _widened(z: Any) -> Any:
    """Return a rectangle around a function value of mpmath, whose ends may be off by some units."""
    off = iv.mpf([-1, 1]) * (abs(z.real) + abs(z.imag)) * _ROUNDED
    return z + iv.mpc(off, off)


def interval(ball: Ball) -> Any:
    """Return a ball as an interval of mpmath."""
    return iv.mpf([ball.low, ball.high]) * iv.mpf(2) ** -ball.bits


def upper(bound: Any, bits: int) -> Ball:
    """Return the upper end of an interval of bounds, rounded up to units.

    Args:
        bound: The interval of mpmath, with finite and nonnegative ends.
        bits: The unit is ``2^-bits``.

    Raises:
        NotProved: If an end is infinite, NaN or negative.
    """
    low, high = (_floor(end, bits) for end in bound._mpi_)
    require(0 <= low <= high, "a bound is negative")
    return Ball(high + 1, 0, bits)


def _floor(end: Any, bits: int) -> int:
    """Return a number of mpmath in units, rounded down.

    `mpmath.libmp.to_fixed` returns 0 for infinity and for NaN.
    """
    sign, man, exp, length = end
    finite = man != 0 or exp == 0
    require(finite and exp + length <= _FINITE, "a bound exceeds the largest number")
    shift, units = exp + bits, -int(man) if sign else int(man)
    return units << shift if shift >= 0 else units >> -shift
