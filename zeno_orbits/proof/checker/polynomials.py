"""Polynomials of the start coordinates over many boxes at once, with their remainders.

A quantity ``q(s)`` with ``s`` in ``[-1, 1]^D`` is given by coefficients ``c``, one for each
monomial up to a degree, and by a bound ``r`` of ``|q(s) - sum c_a s^a|``. The numbers are those of
`lanes`, and so are the bounds of rounding: the computed coefficients of a product differ from the
exact coefficients by at most ``(T + 2) u`` times the product of the sums of the factors' absolute
values in total, for ``T`` products per coefficient. The monomials of a product above the degree are
at most 1, so the sum of the absolute values of their coefficients is added to ``r``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations_with_replacement as choices
from typing import Any, NamedTuple

import numpy as np

from zeno_orbits.proof.checker.balls import Array, Ball, NotProved, require
from zeno_orbits.proof.checker.formulas import Graph
from zeno_orbits.proof.checker.lanes import (
    MOST_TERMS,
    REAL,
    TINY,
    UNIT,
    UP,
    LaneFlow,
    Lanes,
    lanes_of,
)
from zeno_orbits.proof.checker.series import function_at, taylor

_BITS = 100
"""Number of bits after the binary point in the computation of functions."""

_ONE = Lanes(REAL(1), REAL(0))


class Monomials(NamedTuple):
    """Monomials of some variables up to a degree, in order of their degrees.

    Attributes:
        degree: Largest degree.
        exponents: One tuple per monomial, the constant first.
        targets: For each monomial, the monomials whose products with it have at most the degree,
            and the places of these products.
        above: 1 for each pair of monomials whose product is above the degree, ``(M, M)``.
    """

    degree: int
    exponents: tuple[tuple[int, ...], ...]
    targets: tuple[tuple[Any, Any], ...]
    above: Any

    @property
    def n(self) -> int:
        """Number of monomials."""
        return len(self.exponents)


@cache
def monomials(n_variables: int, degree: int) -> Monomials:
    """Return the monomials of some variables up to a degree."""
    variables = range(n_variables)
    factors = (one for k in range(degree + 1) for one in choices(variables, k))
    every = (tuple(map(one.count, variables)) for one in factors)
    found = sorted(every, key=lambda one: (sum(one), one))
    places, targets = {one: k for k, one in enumerate(found)}, list[tuple[Any, Any]]()
    above = np.ones((len(found), len(found)), REAL)
    for i, a in enumerate(found):
        sums = [tuple(x + y for x, y in zip(a, b, strict=True)) for b in found]
        with_it = [j for j, one in enumerate(sums) if one in places]
        above[i, with_it] = 0
        targets.append((np.array(with_it), np.array([places[sums[j]] for j in with_it])))
    return Monomials(degree, tuple(found), tuple(targets), above)


@dataclass(frozen=True, slots=True)
class Polys:
    """Polynomials in an array: coefficients ``(..., M)`` and remainders ``(...)``."""

    of: Monomials
    c: Any
    r: Any

    def __getitem__(self, key: Any) -> Polys:
        return Polys(self.of, self.c[key], self.r[key])

    @classmethod
    def constant(cls, of: Monomials, x: Lanes) -> Polys:
        """Return constants."""
        c = np.zeros((*np.shape(x.c), of.n), REAL)
        c[..., 0] = x.c
        return cls(of, c, np.asarray(x.r, REAL))

    @classmethod
    def from_balls(cls, of: Monomials, coefficients: Array) -> Polys:
        """Return polynomials with balls as coefficients, ``(..., M)``."""
        lanes = lanes_of(coefficients)
        return cls(of, lanes.c, lanes.r.sum(axis=-1) * UP)

    @property
    def size(self) -> Any:
        """Bound of the polynomials without their remainders."""
        return abs(self.c).sum(axis=-1) * UP

    @property
    def spread(self) -> Any:
        """Bound of the difference from the constant coefficients."""
        return (abs(self.c[..., 1:]).sum(axis=-1) + self.r) * UP

    @property
    def range(self) -> Lanes:
        """All values."""
        return Lanes(self.c[..., 0], self.spread)

    def to(self, of: Monomials) -> Polys:
        """Return them with the monomials of a lower degree only."""
        rest = abs(self.c[..., of.n :]).sum(axis=-1)
        return Polys(of, self.c[..., : of.n], (self.r + rest) * UP)

    def wider(self, r: Any) -> Polys:
        """Return them with larger remainders."""
        return Polys(self.of, self.c, (self.r + r) * UP)

    def balls(self, bits: int) -> Array:
        """Return the coefficients as balls. Those of the constants include the remainders."""
        r = np.zeros(self.c.shape, REAL)
        r[..., 0] = self.r
        return Lanes(self.c, r).balls(bits)

    def __neg__(self) -> Polys:
        return Polys(self.of, -self.c, self.r)

    def __add__(self, other: Polys) -> Polys:
        c = self.c + other.c
        rounding = 2 * UNIT * abs(c).sum(axis=-1)
        return Polys(self.of, c, (self.r + other.r + rounding) * UP)

    def __sub__(self, other: Polys) -> Polys:
        return self + -other

    def __mul__(self, other: Polys) -> Polys:
        return _product("...p,...q->...pq", "...,...->...", 1, self, other)

    def scaled(self, by: Lanes) -> Polys:
        """Return products with numbers, ``(...)``."""
        c: Any = np.asarray(by.c)
        size: Any = abs(c)
        r = self.size * (by.r + 5 * UNIT * size) + self.r * (size + by.r)
        return Polys(self.of, self.c * c[..., None], r * UP + TINY)


def _product(pairs: str, sums: str, n: int, x: Polys, y: Polys) -> Polys:
    """Return sums of products.

    Args:
        pairs: Subscripts of the sums of products of all pairs of coefficients.
        sums: The same without the axes of coefficients.
        n: Number of products of polynomials in a sum.
        x: The first factors.
        y: The second factors.
    """
    of = x.of
    terms = n * of.n**2
    require(
        terms + 16 < MOST_TERMS,
        f"the rounding of {terms} products is not bounded on this processor",
    )
    every = np.einsum(pairs, x.c, y.c)
    c = np.zeros(every.shape[:-1], REAL)
    for i, (with_it, places) in enumerate(of.targets):
        c[..., places] += every[..., i, with_it]
    a, b = x.size, y.size
    r = np.einsum(sums, a, y.r + (terms + 4) * UNIT * b) + np.einsum(sums, x.r, b + y.r)
    r += (abs(every) * of.above).sum(axis=(-1, -2))
    return Polys(of, c, r * UP + TINY)


def dot(x: Polys, y: Polys) -> Polys:
    """Return ``sum_j x_j y_(n - j)`` over axis 0."""
    return _product("k...p,k...q->...pq", "k...,k...->...", len(x.c), x, y[::-1])


def polynomial_value(series: Polys, rest: Polys, part: Polys) -> Polys:
    """Return the sums of series at parts of their steps.

    Args:
        series: Terms over the whole steps, along axis 0.
        rest: The last terms.
        part: Parts of the steps. Axes are broadcast.
    """
    value = rest
    for k in range(len(series.c) - 1, -1, -1):
        value = value * part + series[k]
    return value


def poly_series(
    flow: LaneFlow, inputs: Mapping[int, Polys], h: Lanes, order: int, *, slopes: bool
) -> tuple[Polys, Polys | None]:
    """Return Taylor coefficients times ``h^k`` of the flow over many sets.

    Args:
        flow: The flow.
        inputs: All inputs over the sets, ``(L,)`` each.
        h: The steps, ``(L,)``.
        order: Order of the last coefficient.
        slopes: True for the derivative too.

    Returns:
        Coefficients of the states, ``(order + 1, L, N)``, and of the derivative,
        ``(order + 1, L, N, N)``, or None.
    """
    graph, n, L = flow.graph, len(flow.z), len(h.c)
    of = next(iter(inputs.values())).of
    flat = [part for row in flow.slopes for part in row] if slopes else []
    nodes = _Nodes(graph, of, [*flow.rates, *flat], inputs, (order + 1, L))
    moving = {place for place, node in zip(flow.z, flow.rates, strict=True) if node is not None}
    nodes.follow(moving)
    for k in range(order):
        nodes.grow(k)
        part = h / Lanes(float(k + 1), 0.0)
        for place, node in zip(flow.z, flow.rates, strict=True):
            if node is not None:
                nodes.put(place, k + 1, nodes.known[node][k].scaled(part))
    states = _stacked([nodes.known[place] for place in flow.z])
    if not slopes:
        return states, None
    zero = Polys(of, np.zeros((order + 1, L, of.n), REAL), np.zeros((order + 1, L), REAL))
    flat_J = _stacked([zero if place is None else nodes.known[place] for place in flat])
    shape = order + 1, L, n, n
    J = Polys(of, flat_J.c.reshape(*shape, of.n), flat_J.r.reshape(shape))
    V = Polys(of, np.zeros_like(J.c), np.zeros_like(J.r))
    V.c[0, ..., 0] = np.eye(n)
    for k in range(order):
        found = _product(
            "klnap,klamq->lnmpq", "klna,klam->lnm", (k + 1) * n, J[: k + 1], V[: k + 1][::-1]
        )
        part = h / Lanes(float(k + 1), 0.0)
        found = found.scaled(part[:, None, None])
        V.c[k + 1], V.r[k + 1] = found.c, found.r
    return states, V


def poly_values(
    graph: Graph, inputs: Mapping[int, Polys], outputs: Sequence[int | None]
) -> list[Polys]:
    """Return nodes over one set, ``(1,)`` each.

    Args:
        graph: The formulas.
        inputs: All inputs, ``(1,)`` each.
        outputs: The nodes, with ``None`` for zero.
    """
    of = next(iter(inputs.values())).of
    nodes = _Nodes(graph, of, outputs, inputs, (1, 1))
    nodes.grow(0)
    zero = Polys.constant(of, Lanes(np.zeros(1, REAL), np.zeros(1, REAL)))
    return [zero if place is None else nodes.known[place][0] for place in outputs]


def _stacked(polys: Sequence[Polys]) -> Polys:
    """Return polynomials along a new axis 2."""
    c, r = np.stack([one.c for one in polys], 2), np.stack([one.r for one in polys], 2)
    return Polys(polys[0].of, c, r)


class _Nodes:
    """Coefficients of nodes, order by order."""

    def __init__(
        self,
        graph: Graph,
        of: Monomials,
        outputs: Sequence[int | None],
        inputs: Mapping[int, Polys],
        shape: tuple[int, int],
    ) -> None:
        self._graph, self._of, self._inputs = graph, of, inputs
        self._plan = graph.needed(outputs, at_rest=shape[0] == 1)
        self._inverses: dict[int, Polys] = {}
        self._moving = set[int]()
        self.known: dict[int, Polys] = {}
        for place in {*self._plan, *inputs}:
            self.known[place] = Polys(of, np.zeros((*shape, of.n), REAL), np.zeros(shape, REAL))
        for place, one in inputs.items():
            self.put(place, 0, one)

    def put(self, place: int, k: int, one: Polys) -> None:
        """Store a coefficient."""
        self.known[place].c[k], self.known[place].r[k] = one.c, one.r

    def follow(self, moving: set[int]) -> None:
        """Set the inputs that move. Other nodes have one coefficient only."""
        self._moving = set(moving)
        for place in self._plan:
            if any(a in self._moving for a in self._graph.nodes[place][1:] if isinstance(a, int)):
                self._moving.add(place)

    def grow(self, k: int) -> None:
        """Compute coefficient ``k`` of all nodes except the inputs."""
        for place in self._plan:
            if place not in self._inputs and (k == 0 or place in self._moving):
                self.put(place, k, self._next(place, k))

    def _next(self, place: int, n: int) -> Polys:
        node, known = self._graph.nodes[place], self.known
        name, own = node[0], known[place]
        if name == "constant":
            L = own.r.shape[1]
            return Polys.constant(self._of, Lanes(np.full(L, node[1], REAL), np.zeros(L, REAL)))
        if name == "function":
            if n == 0:
                return composed(node[1], known[node[2]][0])
            u, g = known[node[2]], known[node[3]]
            weights = Lanes(np.arange(1, n + 1, dtype=REAL).reshape(-1, 1), 0.0)
            total = dot(u[1 : n + 1].scaled(weights), g[:n])
            return total.scaled(_ONE / Lanes(float(n), 0.0))
        x, y = known[node[1]], known[node[-1]]
        if name == "neg":
            return -x[n]
        if name == "mul":
            if n and node[1] not in self._moving:
                return x[0] * y[n]
            if n and node[2] not in self._moving:
                return x[n] * y[0]
            return dot(x[: n + 1], y[: n + 1])
        if name == "div":
            if node[2] not in self._inverses:
                self._inverses[node[2]] = composed("", y[0])
            rest = x[n]
            if n and node[2] in self._moving:
                rest = rest - dot(own[:n], y[1 : n + 1])
            return rest * self._inverses[node[2]]
        if name not in ("add", "sub"):
            raise NotProved(f"the operation `{name}` lacks polynomials")
        return x[n] + y[n] if name == "add" else x[n] - y[n]


@cache
def _small(name: str) -> tuple[Graph, list[int], list[int]]:
    """Return a graph with ``u' = 1, y' = f'(u)``, whose solution is ``y = f(u)``."""
    graph = Graph()
    u, y = graph.put("input"), graph.put("input")
    if name:
        slope = graph.nodes[graph.function(name, u)][3]
    else:
        slope = graph.put("neg", graph.put("div", graph.one, graph.put("mul", u, u)))
    return graph, [u, y], [graph.one, slope]


def composed(name: str, u: Polys) -> Polys:
    """Return a function of polynomials, by Taylor's formula at their constant coefficients.

    Args:
        name: The function, or an empty text for the reciprocal.
        u: The polynomials, ``(L,)``.
    """
    degree, away = u.of.degree, u.spread
    here, last = list[Any](), list[Ball]()
    for middle, all_of_it in zip(
        Lanes(u.c[:, 0], np.zeros(len(away), REAL)).balls(_BITS), u.range.balls(_BITS), strict=True
    ):
        here.append(_terms(name, middle, degree))
        last.append(_terms(name, all_of_it, degree + 1)[degree + 1])
    terms, bound = lanes_of(np.array(here, dtype=object).T), lanes_of(last)
    c = u.c.copy()
    c[:, 0] = 0
    step = Polys(u.of, c, u.r)
    found = Polys.constant(u.of, terms[degree])
    for k in range(degree - 1, -1, -1):
        found = found * step + Polys.constant(u.of, terms[k])
    rest = abs(bound.c) + bound.r
    for _ in range(degree + 1):
        rest = rest * away * UP
    return found.wider(rest + TINY)


def _terms(name: str, u: Ball, order: int) -> Array:
    """Return Taylor coefficients of a function over a ball, up to an order."""
    graph, z, rates = _small(name)
    start = function_at(name, u) if name else 1 / u
    one = Ball(1 << u.bits, 0, u.bits)
    return taylor(graph, z, rates, dict(zip(z, (u, start), strict=True)), one, order)[1]
