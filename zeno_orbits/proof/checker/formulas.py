"""A problem's CasADi instructions as a graph of few operations, with its tangents and a digest.

A node is ``(operation, *arguments)``, its arguments other nodes. A function is the integral of its
derivative: ``("function", name, u, integrand)`` with ``integrand = f'(u) u'``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

import casadi as ca

from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem
from zeno_orbits.proof.checker.balls import NotProved


class Graph:
    """Operations in the order in which a coefficient of each can be computed."""

    def __init__(self) -> None:
        self.nodes: list[tuple[Any, ...]] = []
        self.order: list[int] = []
        self._functions: dict[tuple[str, int], int] = {}
        self._places: dict[tuple[Any, ...], int] = {}

    def put(self, *node: Any) -> int:
        """Return the place of a node, which is appended if it is a new one."""
        if node == ("input",) or node not in self._places:
            self._places[node] = self._place(*node)
            self.order.append(self._places[node])
        return self._places[node]

    def _place(self, *node: Any) -> int:
        self.nodes.append(node)
        return len(self.nodes) - 1

    def function(self, name: str, u: int) -> int:
        """Return the node of an analytic function of a node."""
        if (name, u) not in self._functions:
            place, at = self._place(), len(self.order)
            self._functions[name, u] = place
            self.order.append(place)
            slope = self._place("slope", u)
            integrand = self._place("mul", self.derivative(name, u), slope)
            self.nodes[place] = ("function", name, u, integrand)
            # One order behind, it is asked for by the function, and needs what comes after that.
            self.order[at:at] = [slope, integrand]
        return self._functions[name, u]

    def derivative(self, name: str, u: int) -> int:
        """Return a node of the derivative of a function."""
        f, one = self._functions[name, u], self.put("constant", 1.0)
        if name in ("sin", "cos"):
            other = self.function("cos" if name == "sin" else "sin", u)
            return other if name == "sin" else self.put("neg", other)
        if name == "exp":
            return f
        if name == "sqrt":
            return self.put("div", self.put("constant", 0.5), f)
        if name == "log":
            return self.put("div", one, u)
        if name == "tanh":
            return self.put("sub", one, self.put("mul", f, f))
        return self.put("div", one, self.put("add", one, self.put("mul", u, u)))

    def needed(self, outputs: Iterable[int | None]) -> list[int]:
        """Return the nodes that outputs need, in order."""
        found, waiting = set[int](), [place for place in outputs if place is not None]
        while waiting:
            place = waiting.pop()
            if place not in found:
                found.add(place)
                waiting += [a for a in self.nodes[place][1:] if isinstance(a, int)]
        return [place for place in self.order if place in found]

    def tangents(
        self, outputs: Sequence[int], seeds: Mapping[int, Sequence[int]]
    ) -> list[list[int | None]]:
        """Return the tangents of outputs, a row each, from those of the inputs; zeros are None."""
        known: dict[int, list[int | None]] = {}
        size = len(next(iter(seeds.values())))
        for place in self.needed(outputs):
            node = self.nodes[place]
            if node[0] == "input":
                known[place] = list(seeds.get(place, [None] * size))
            elif node[0] in ("constant", "slope"):
                known[place] = [None] * size
            elif node[0] == "function":
                outer = self.derivative(node[1], node[2])
                known[place] = [self._mul(outer, inner) for inner in known[node[2]]]
            else:
                inner = [known.get(a, [None] * size) for a in node[1:]]
                known[place] = [self._tangent(place, *parts) for parts in zip(*inner, strict=True)]
        return [known[place] for place in outputs]

    def _tangent(self, place: int, x: int | None, y: int | None = None) -> int | None:
        """Return the tangent of an arithmetic node from those of its arguments."""
        name, a, *b = self.nodes[place]
        if name == "mul":
            return self._add(self._mul(b[0], x), self._mul(a, y))
        if name == "div":
            whole = self._add(x, self._neg(self._mul(place, y)))
            return None if whole is None else self.put("div", whole, b[0])
        return self._neg(x) if name == "neg" else self._add(x, self._neg(y) if name == "sub" else y)

    def _mul(self, a: int, b: int | None) -> int | None:
        return None if b is None else self.put("mul", a, b)

    def _neg(self, a: int | None) -> int | None:
        return None if a is None else self.put("neg", a)

    def _add(self, a: int | None, b: int | None) -> int | None:
        return (a if b is None else b) if a is None or b is None else self.put("add", a, b)


class Formulas(NamedTuple):
    """All formulas that a certificate rests on as one function, its digest, and ``n_q``."""

    function: ca.Function
    digest: str
    n_q: int


def formulas_of(problem: Problem) -> Formulas:
    """Return the formulas of a problem; the digest is of CasADi's instructions.

    Raises:
        InputError: If its impacts obey another law than that of one constant.
    """
    symbols = problem.symbols()
    system = problem.model(symbols)
    if system.law_numbers.numel() != 1 or ca.depends_on(system.law_numbers, system.state):
        raise InputError("A certificate must be about impacts with a constant restitution.")
    parts: tuple[Any, ...] = (
        system.free_flow,
        system.locked_flow,
        cast("Any", ca).vertcat(*system.contact),
        system.impulse_direction,
        system.law_numbers,
        system.holonomic,
    )
    inputs = [system.state, ca.vertcat(*symbols.values())]
    outputs = [ca.densify(ca.SX(part)) for part in parts]
    function = ca.Function("system", inputs, outputs)
    lines = [f"{function.numel_in(0)} {function.numel_in(1)} {system.n_q}"]
    for name, takes, gives, number in _instructions(function):
        words = [name, ",".join(map(str, takes)), ",".join(map(str, gives))]
        lines.append(" ".join(words if number is None else [*words, number.hex()]))
    text = "".join(line + "\n" for line in lines)
    return Formulas(function, hashlib.sha256(text.encode()).hexdigest(), system.n_q)


def _instructions(function: ca.Function) -> Iterator[tuple[str, list[int], list[int], Any]]:
    """Give name, arguments and results of each instruction, and the number of a constant."""
    names = {getattr(ca, name): name for name in sorted(dir(ca), reverse=True) if name[:3] == "OP_"}
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        number = float(function.instruction_constant(k)) if code == ca.OP_CONST else None
        yield names[code][3:], function.instruction_input(k), function.instruction_output(k), number


def walked(function: ca.Function, graph: Graph, inputs: Sequence[Sequence[int]]) -> list[list[int]]:
    """Return the nodes of a function's outputs, instruction by instruction.

    Args:
        function: The function.
        graph: The nodes are put there.
        inputs: Nodes of each of its inputs.
    """
    outputs = [[-1] * function.numel_out(k) for k in range(function.n_out())]
    work: dict[int, int] = {}
    table = _operations(graph)
    for name, takes, gives, number in _instructions(function):
        if name == "INPUT":
            work[gives[0]] = inputs[takes[0]][takes[1]]
        elif name == "OUTPUT":
            outputs[gives[0]][gives[1]] = work[takes[0]]
        elif name == "CONST":
            work[gives[0]] = graph.put("constant", number)
        elif name in table:
            work[gives[0]] = table[name](*(work[place] for place in takes))
        else:
            raise NotProved(f"the formulas hold the operation {name.lower()}")
    return outputs


def _operations(graph: Graph) -> dict[str, Callable[..., int]]:
    """Return what makes a node of an operation of CasADi, by its name."""
    put, function = graph.put, graph.function

    def power(a: int, b: int) -> int:
        exponent = graph.nodes[b][1] if graph.nodes[b][0] == "constant" else None
        if exponent in (2.0, 3.0, 4.0):
            square = put("mul", a, a)
            return square if exponent == 2.0 else put("mul", square, square if exponent > 3 else a)
        log = function("log", a)
        return function("sqrt", a) if exponent == 0.5 else function("exp", put("mul", b, log))

    def twice(a: int) -> int:
        return put("add", a, a)

    def square(a: int) -> int:
        return put("mul", a, a)

    def inverse(a: int) -> int:
        return put("div", put("constant", 1.0), a)

    def tangent(a: int) -> int:
        return put("div", function("sin", a), function("cos", a))

    own = {"TWICE": twice, "SQ": square, "INV": inverse, "TAN": tangent, "POW": power}
    plain = {name.upper(): partial(put, name) for name in ("add", "sub", "mul", "div", "neg")}
    others = {name.upper(): partial(function, name) for name in _FUNCTIONS}
    return {**own, **plain, **others, "CONSTPOW": power}


_FUNCTIONS = ("sin", "cos", "exp", "log", "sqrt", "atan", "tanh")
