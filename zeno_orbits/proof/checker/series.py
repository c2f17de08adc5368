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
iv: Any = _MPMATH.iv
"""Interval arithmetic of mpmath, real and complex."""
_SPARE = 20
"""Bits that elementary functions carry beyond the unit."""


class Series:
    """Coefficients of one node: midpoints, radii, and bounds of their absolute values.

    Those of a node that does not move are zero but for the first.
    """

    __slots__ = ("a", "m", "r", "s", "still")

    def __init__(self, *, still: bool) -> None:
        self.still = still
        self.m, self.a, self.r, self.s = (list[int]() for _ in range(4))

    def append(self, m: int, r: int) -> None:
        """Append a coefficient."""
        self.m.append(m)
        self.a.append(abs(m))
        self.r.append(r)
        self.s.append(abs(m) + r)

    def rest(self, count: int) -> None:
        """Append zeros if the node does not move."""
        for known in (self.m, self.a, self.r, self.s) if self.still else ():
            known.extend([0] * count)

    def append_part(self, m: int, r: int, part: int) -> None:
        """Append a coefficient that is divided by a whole number."""
        self.append(m // part, -(-r // part) + (m % part != 0))


def taylor(
    graph: Graph,
    rates: Mapping[int, int | None],
    starts: Mapping[int, Ball],
    h: Ball,
    order: int,
    outputs: Sequence[int] = (),
) -> dict[int, list[Ball]]:
    """Return Taylor coefficients times ``h^k`` of states and outputs, up to an order.

    Args:
        graph: The formulas.
        rates: Inputs that move, and the nodes of their rates; ``None`` where a rate is zero.
        starts: Inputs and their values at the start, constants of the motion among them.
        h: The step.
        order: Order of the last coefficient.
        outputs: Other nodes that are wanted.
    """
    bits = h.bits
    plan = [p for p in graph.needed([*rates.values(), *outputs]) if graph.nodes[p][0] != "input"]
    series: dict[int, Series] = {}
    for place, ball in starts.items():
        series[place] = Series(still=rates.get(place) is None)
        series[place].append(ball.m, ball.r)
    for place in plan:
        given = (a for a in graph.nodes[place][1:] if isinstance(a, int) and a in series)
        series[place] = Series(still=all(series[a].still for a in given))
    for k in range(order + 1):
        for place in plan:
            _grow(graph.nodes[place], series, series[place], bits)
        if k == 0:
            for one in series.values():
                one.rest(order + 1)
            plan = [place for place in plan if not series[place].still]
        for place, node in rates.items():
            if node is not None:
                ball = h * Ball(series[node].m[k], series[node].r[k], bits)
                series[place].append_part(ball.m, ball.r, k + 1)
    return {
        place: [Ball(*pair, bits) for pair in zip(series[place].m, series[place].r, strict=True)][
            : order + 1
        ]
        for place in (*rates, *outputs)
    }


def values(graph: Graph, inputs: Mapping[int, Ball], outputs: Sequence[int | None]) -> Array:
    """Return nodes over a box of the inputs.

    Args:
        graph: The formulas.
        inputs: Inputs and their values.
        outputs: The nodes; those that are ``None`` are zero.
    """
    bits = next(iter(inputs.values())).bits
    wanted = [place for place in outputs if place is not None]
    found = taylor(graph, {}, inputs, Ball(1 << bits, 0, bits), 0, wanted)
    zero = [Ball(0, 0, bits)]
    return np.array(
        [(zero if place is None else found[place])[0] for place in outputs], dtype=object
    )


def _grow(node: tuple[Any, ...], series: Mapping[int, Series], own: Series, bits: int) -> None:
    """Append the next coefficient of a node, if those that it needs are known."""
    name, n = node[0], len(own.m)
    if name == "constant":
        numerator, denominator = node[1].as_integer_ratio()
        own.append_part(numerator << bits, 0, denominator)
        return
    if name == "function":
        if n == 0:
            u = series[node[2]]
            start = function_at(node[1], Ball(u.m[0], u.r[0], bits))
            own.append(start.m, start.r)
        else:
            own.append_part(series[node[3]].m[n - 1], series[node[3]].r[n - 1], n)
        return
    x, y = series[node[1]], series[node[-1]]
    if min(len(x.m), len(y.m)) <= n + (name == "slope"):
        return
    if name == "slope":
        own.append((n + 1) * x.m[n + 1], (n + 1) * x.r[n + 1])
    elif name == "neg":
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
    """Return an elementary function of a ball, by mpmath's interval arithmetic."""
    require(name not in ("log", "sqrt") or u.low > 0, f"{name} of {u.shown()} is not analytic")
    if name == "tanh":
        power = function_at("exp", u + u)
        return (power - 1) / (power + 1)
    exact, fixed = _MPMATH.libmp.from_man_exp, _MPMATH.libmp.to_fixed
    ends = exact(u.low, -u.bits), exact(u.high, -u.bits)
    prec = u.bits + _SPARE + u.size.bit_length()
    low, high = getattr(_MPMATH.libmp.libmpi, f"mpi_{name}")(ends, prec)
    return between(fixed(low, u.bits) - 1, fixed(high, u.bits) + 1, u.bits)


def complex_values(
    graph: Graph, discs: Mapping[int, tuple[Ball, Ball]], outputs: Sequence[int]
) -> list[Any]:
    """Return nodes over a product of discs, as complex intervals of mpmath.

    Args:
        graph: The formulas.
        discs: For every input its real centre and the radius of its disc.
        outputs: The nodes.
    """
    found: dict[int, Any] = {}
    for place, (ball, radius) in discs.items():
        reach = radius.size
        real = between(ball.low - reach, ball.high + reach, ball.bits)
        found[place] = iv.mpc(interval(real), interval(Ball(0, reach, ball.bits)))
    for place in graph.needed(outputs):
        name, *given = graph.nodes[place]
        if name == "constant":
            found[place] = iv.mpc(given[0])
        elif name == "function":
            found[place] = _complex_function(given[0], found[given[1]])
        elif name in _COMPLEX and all(a in found for a in given):
            found[place] = _COMPLEX[name](*(found[a] for a in given))
        finite = place not in found or abs(found[place]) < iv.inf
        require(bool(finite), "a formula has no bound over complex numbers")
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
        return getattr(iv, name)(z)
    if name in ("log", "sqrt") and z.real > 0:
        return iv.log(z) if name == "log" else iv.exp(iv.log(z) / 2)
    raise NotProved(f"{name} is not known to be analytic over complex numbers")


def interval(ball: Ball) -> Any:
    """Return a ball as an interval of mpmath."""
    return iv.mpf([ball.low, ball.high]) * iv.mpf(2) ** -ball.bits


def upper(bound: Any, bits: int) -> Ball:
    """Return the upper end of a real interval of mpmath, rounded up to units."""
    return Ball(_MPMATH.libmp.to_fixed(bound._mpi_[1], bits) + 1, 0, bits)
