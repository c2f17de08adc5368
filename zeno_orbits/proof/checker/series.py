"""Taylor coefficients of the nodes of a graph in balls, and nodes at points and complex boxes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from operator import mul
from typing import Any

from zeno_orbits.proof.checker.balls import Ball, NotProved, between, quotient, rounded
from zeno_orbits.proof.checker.formulas import Graph

_LIBRARY: Any = import_module("mpmath.libmp.libmpi")
_EXACT: Any = import_module("mpmath.libmp")
"""Interval arithmetic of mpmath, below `mpmath.iv`: at a precision that is handed over."""
_REAL: dict[str, Callable[..., Any]] = {
    name: getattr(_LIBRARY, f"mpi_{name}") for name in ("sin", "cos", "exp", "log", "sqrt", "atan")
}
_COMPLEX: dict[str, Callable[..., Any]] = {
    name: getattr(_LIBRARY, f"mpci_{name}")
    for name in ("add", "sub", "mul", "div", "neg", "sin", "cos", "exp", "log")
}
_SPARE = 20
"""Bits that elementary functions carry beyond the unit."""


class Series:
    """Coefficients of one node: midpoints, radii, and bounds of their absolute values."""

    __slots__ = ("a", "m", "r", "s")

    def __init__(self) -> None:
        self.m: list[int] = []
        self.a: list[int] = []
        self.r: list[int] = []
        self.s: list[int] = []

    def append(self, m: int, r: int) -> None:
        """Append a coefficient."""
        self.m.append(m)
        self.a.append(abs(m))
        self.r.append(r)
        self.s.append(abs(m) + r)


def function_at(name: str, u: Ball) -> Ball:
    """Return an elementary function of a ball, by mpmath's interval arithmetic."""
    bits = u.bits
    prec = bits + _SPARE + u.size.bit_length()
    if name in ("log", "sqrt") and u.low <= 0:
        raise NotProved(f"the argument of {name} may be negative: {u.shown()}")
    if name == "tanh":
        power, one = function_at("exp", u + u), Ball(1 << bits, 0, bits)
        return (power - one) / (power + one)
    return _ball(_REAL[name](_interval(u.low, u.high, bits), prec), bits)


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
    series = {place: Series() for place in (*plan, *starts)}
    for place, ball in starts.items():
        series[place].append(ball.m, ball.r)
    for k in range(order + 1):
        for place in plan:
            _grow(graph.nodes[place], series, series[place], bits)
        for place in starts:
            node = rates.get(place)
            if node is None:
                series[place].append(0, 0)
            else:
                rate = Ball(series[node].m[k], series[node].r[k], bits)
                ball = (h * rate).fraction(k + 1)
                series[place].append(ball.m, ball.r)
    wanted = {*rates, *outputs}
    return {
        place: [Ball(m, r, bits) for m, r in zip(found.m, found.r, strict=True)][: order + 1]
        for place, found in series.items()
        if place in wanted
    }


def values(graph: Graph, inputs: Mapping[int, Ball], outputs: Sequence[int | None]) -> list[Ball]:
    """Return nodes at a box of the inputs; the others are zero."""
    bits = next(iter(inputs.values())).bits
    wanted = [place for place in outputs if place is not None]
    found = taylor(graph, {}, inputs, Ball(1 << bits, 0, bits), 0, wanted)
    zero = Ball(0, 0, bits)
    return [zero if place is None else found[place][0] for place in outputs]


def _grow(node: tuple[Any, ...], series: Mapping[int, Series], own: Series, bits: int) -> None:
    """Append the next coefficient of a node, if those that it needs are known."""
    name, n = node[0], len(own.m)
    if name == "constant":
        numerator, denominator = node[1].as_integer_ratio() if n == 0 else (0, 1)
        scaled = numerator << bits
        own.append(scaled // denominator, int(scaled % denominator != 0))
        return
    if name == "function":
        if n == 0:
            start = function_at(node[1], Ball(series[node[2]].m[0], series[node[2]].r[0], bits))
            own.append(start.m, start.r)
        else:
            integrand = series[node[3]]
            step = Ball(integrand.m[n - 1], integrand.r[n - 1], bits).fraction(n)
            own.append(step.m, step.r)
        return
    x = series[node[1]]
    if name == "slope":
        if len(x.m) > n + 1:
            own.append((n + 1) * x.m[n + 1], (n + 1) * x.r[n + 1])
        return
    y = series[node[-1]]
    if min(len(x.m), len(y.m)) <= n:
        return
    if name == "neg":
        own.append(-x.m[n], x.r[n])
    elif name == "mul":
        m = sum(map(mul, x.m, y.m[n::-1]))
        r = sum(map(mul, x.a, y.r[n::-1])) + sum(map(mul, x.r, y.s[n::-1]))
        own.append(*rounded(m, r, bits))
    elif name == "div":
        m = (x.m[n] << bits) - sum(map(mul, own.m, y.m[n:0:-1]))
        r = sum(map(mul, own.a, y.r[n:0:-1])) + sum(map(mul, own.r, y.s[n:0:-1]))
        by = Ball(y.m[0], y.r[0], bits)
        own.append(*quotient(m, (x.r[n] << bits) + r, by))
    else:
        sign = 1 if name == "add" else -1
        own.append(x.m[n] + sign * y.m[n], x.r[n] + y.r[n])


def complex_values(
    graph: Graph, inputs: Mapping[int, tuple[Ball, int]], outputs: Sequence[int]
) -> list[tuple[Ball, Ball]]:
    """Return real and imaginary parts of nodes over a product of discs.

    Args:
        graph: The formulas.
        inputs: For every input its real centre and the radius of its disc, in units.
        outputs: The nodes.
    """
    bits = next(iter(inputs.values()))[0].bits
    found: dict[int, Any] = {}
    for place, (ball, radius) in inputs.items():
        real = _interval(ball.low - radius, ball.high + radius, bits)
        found[place] = real, _interval(-radius, radius, bits)
    prec = bits + _SPARE
    for place in graph.needed(outputs):
        name, *given = graph.nodes[place]
        if name == "constant":
            numerator, denominator = given[0].as_integer_ratio()
            places = denominator.bit_length() - 1
            found[place] = _interval(numerator, numerator, places), _interval(0, 0, 0)
        elif name == "function":
            found[place] = _complex_function(given[0], found[given[1]], prec)
        elif name not in ("input", "slope") and all(a in found for a in given):
            extra = () if name == "neg" else (found[given[1]],)
            found[place] = _COMPLEX[name](found[given[0]], *extra, prec)
        if place in found:
            _require_finite(found[place])
    return [(_ball(found[place][0], bits), _ball(found[place][1], bits)) for place in outputs]


def _complex_function(name: str, z: Any, prec: int) -> Any:
    """Return an analytic function over a complex rectangle."""
    if name in ("log", "sqrt") and not _LIBRARY.mpi_gt(z[0], _interval(0, 0, 0)):
        raise NotProved(f"the argument of {name} leaves the right half-plane")
    if name in _COMPLEX:
        return _COMPLEX[name](z, prec)
    if name == "sqrt":
        real, imaginary = (_LIBRARY.mpi_shift(part, -1) for part in _COMPLEX["log"](z, prec))
        return _COMPLEX["exp"]((real, imaginary), prec)
    raise NotProved(f"{name} is not bounded over complex numbers")


def _interval(low: int, high: int, bits: int) -> tuple[Any, Any]:
    return _EXACT.from_man_exp(low, -bits), _EXACT.from_man_exp(high, -bits)


def _ball(interval: Any, bits: int) -> Ball:
    low, high = (_EXACT.to_fixed(end, bits) for end in interval)
    return between(low - 1, high + 1, bits)


def _require_finite(parts: Any) -> None:
    """Refuse infinities and what is no number, which mpmath writes without a mantissa."""
    for _, mantissa, exponent, _ in (end for part in parts for end in part):
        if not mantissa and exponent:
            raise NotProved("a bound over complex numbers is not finite")
