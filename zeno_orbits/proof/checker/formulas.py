"""A problem's CasADi instructions as a graph of few operations, with its tangents and a digest.

A node is ``(operation, *arguments)``, whose arguments are other nodes. A function is the integral
of its derivative: ``("function", name, u, f'(u))``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial, reduce
from itertools import chain
from typing import Any, NamedTuple, cast

import casadi as ca

from zeno_orbits.model import CompletedSystem, ModeGraph, Problem, system_of_stop, watched
from zeno_orbits.proof.checker.balls import NotProved

Row = list[int | None]


class Graph:
    """Operations in the order in which they can be evaluated."""

    def __init__(self) -> None:
        self.nodes: list[tuple[Any, ...]] = []
        self._places: dict[tuple[Any, ...], int] = {}
        self.one, self.zero = self.put("constant", 1.0), self.put("constant", 0.0)

    def put(self, *node: Any) -> int:
        """Return the index of a node, which is appended if it is new."""
        if node == ("input",) or node not in self._places:
            self._places[node] = len(self.nodes)
            self.nodes.append(node)
        return self._places[node]

    def factors(self, place: int) -> list[int]:
        """Return the factors of a node. Factors of a long product may be products themselves."""
        found, waiting = list[int](), [place]
        while waiting:
            name, *given = self.nodes[waiting[-1]]
            if name == "mul" and len(found) + len(waiting) < _HIGHEST:
                waiting[-1:] = reversed(given)
            else:
                found.append(waiting.pop())
        return found

    def function(self, name: str, u: int) -> int:
        """Return the node of an analytic function of a node."""
        if (name, u) not in self._places:
            place = self._places[name, u] = len(self.nodes)
            self.nodes.append(())
            self.nodes[place] = ("function", name, u, self._derivative(name, u))
        return self._places[name, u]

    def _derivative(self, name: str, u: int) -> int:
        f = self._places[name, u]
        if name in ("sin", "cos"):
            other = self.function("cos" if name == "sin" else "sin", u)
            return other if name == "sin" else self.put("neg", other)
        if name == "exp":
            return f
        if name == "sqrt":
            return self.put("div", self.put("constant", 0.5), f)
        if name == "tanh":
            return self.put("sub", self.one, self.put("mul", f, f))
        square = self.put("mul", u, u)
        return self.put("div", self.one, u if name == "log" else self.put("add", self.one, square))

    def needed(self, outputs: Iterable[int | None], *, at_rest: bool = False) -> list[int]:
        """Return the nodes that outputs depend on, in order, for values only or for series."""
        found, waiting = set[int](), [place for place in outputs if place is not None]
        while waiting:
            place = waiting.pop()
            if place not in found:
                found.add(place)
                node = self.nodes[place]
                given = node[2:3] if at_rest and node[0] == "function" else node[1:]
                waiting += [a for a in given if isinstance(a, int)]
        return sorted(found)

    def tangents(self, outputs: Sequence[int], seeds: Mapping[int, Row]) -> list[Row]:
        """Return the tangents of outputs, one row each, from the inputs' tangents. None is zero."""
        none: Row = [None] * len(next(iter(seeds.values())))
        known: dict[int, Row] = {}
        for place in self.needed(outputs, at_rest=True):
            name, *given = self.nodes[place]
            if name in ("input", "constant"):
                known[place] = list(seeds.get(place, none))
            elif name == "function":
                known[place] = [self.product(given[2], inner) for inner in known[given[1]]]
            else:
                inner = [known[a] for a in given]
                known[place] = [self._tangent(place, *parts) for parts in zip(*inner, strict=True)]
        return [known[place] for place in outputs]

    def composed(self, outputs: Sequence[int], inner: Mapping[int, int]) -> list[int]:
        """Return outputs with other nodes in place of inputs. Nodes minus themselves are zero."""
        known = dict(inner)
        for place in self.needed(outputs, at_rest=True):
            name, *given = self.nodes[place]
            if place in known:
                continue
            if name in ("input", "constant"):
                known[place] = place
            elif name == "function":
                known[place] = self.function(given[0], known[given[1]])
            else:
                known[place] = self._simple(name, *(known[a] for a in given))
        return [known[place] for place in outputs]

    def _simple(self, name: str, a: int, *b: int) -> int:
        opposite = name == "add" and ("neg", a) == self.nodes[b[0]]
        is_zero = opposite or (name == "sub" and a == b[0])
        return self.zero if is_zero else self.put(name, a, *b)

    def _tangent(self, place: int, x: int | None, y: int | None = None) -> int | None:
        """Return the tangent of an arithmetic node from the tangents of its arguments."""
        name, a, *b = self.nodes[place]
        if name == "mul":
            return self.total(self.product(b[0], x), self.product(a, y))
        if name == "div":
            whole = self.total(x, self._neg(self.product(place, y)))
            return None if whole is None else self.put("div", whole, b[0])
        return (
            self._neg(x) if name == "neg" else self.total(x, self._neg(y) if name == "sub" else y)
        )

    def product(self, a: int | None, b: int | None) -> int | None:
        """Return the node of a product."""
        if None in (a, b) or self.zero in (a, b):
            return None
        return b if a == self.one else a if b == self.one else self.put("mul", a, b)

    def _neg(self, a: int | None) -> int | None:
        return None if a is None else self.put("neg", a)

    def total(self, *parts: int | None) -> int | None:
        """Return the node of a sum."""
        found: int | None = None
        for part in parts:
            if part not in (None, self.zero):
                found = part if found is None else self.put("add", found, part)
        return found


class Formulas(NamedTuple):
    """All formulas of a problem as functions, their digest, and ``n_q``.

    Attributes:
        function: Flows, contact quantities, impulse direction, restitution and constraints.
        law: The impact law, a function of state, parameters, restitution and gap rate.
        coefficient: The restitution as a function of parameters and impact speed, or None if it
            does not depend on the speed.
        inertia: The mass matrix.
        digest: SHA-256 of the instructions of `function`.
        n_q: Number of coordinates.
    """

    function: ca.Function
    law: ca.Function
    coefficient: ca.Function | None
    inertia: ca.Function
    digest: str
    n_q: int


class CheckedView(NamedTuple):
    """A stop of a machine with several stops, switches or kinks, on sides of the kinks.

    Another stop may be held closed, or -1.
    """

    stop: int
    sides: tuple[bool, ...]
    held: int = -1


def _viewed(graph: ModeGraph, view: CheckedView) -> tuple[CompletedSystem, tuple[Any, ...]]:
    """Return the system of a view, and the formulas of the other stops and of the switches."""
    if graph.has_current_layers or graph.roots:
        raise NotProved("the problem has current layers or roots at events")
    if graph.n_frictions:
        raise NotProved("the problem has a part with dry friction, which sticks")
    # Such a switch has another cause: an event of a stop that sets states anew.
    if any(ca.SX(one.guard).is_constant() for one in graph.switches):
        raise NotProved(
            "the problem has a switch with a constant guard, which another event causes"
        )
    stack: Any = cast("Any", ca).vertcat
    every = range(len(graph.switches) + len(view.sides))
    further = (
        stack(*(one.gap for one in watched(graph.stops))),
        stack(ca.SX(0, 1), *(graph.guard(view.sides, k) for k in every)),
        stack(ca.SX(0, 1), *(ca.SX(one.armed) for one in graph.switches)),
        *graph.resets,
    )
    return system_of_stop(graph, ((), view.sides), view.stop), further


def checked_formulas(problem: Problem) -> Formulas:
    """Return the formulas of a problem with one stop, which is evaluated once.

    Args:
        problem: The problem.
    """
    symbols = problem.symbols()
    return _formulas(problem.one_stop_model(symbols), (), symbols)


def formulas_of_view(graph: ModeGraph, symbols: Mapping[str, ca.SX], view: CheckedView) -> Formulas:
    """Return the formulas of a stop of a machine on sides of its kinks.

    Args:
        graph: The modes of the machine.
        symbols: Gains and parameters by name.
        view: The stop and the sides.
    """
    system, further = _viewed(graph, view)
    return _formulas(system, further, symbols)


def _formulas(
    system: CompletedSystem, further: tuple[Any, ...], symbols: Mapping[str, ca.SX]
) -> Formulas:
    """Return the formulas of a system with one stop, and those of the machine.

    The digest belongs to CasADi's instructions. The impact law is evaluated for one impact: from
    the gap rate before it and the restitution, it gives the drop of the gap rate and the gap rate
    after the impact. A restitution that does not depend on the speed is a symbol, since CasADi
    would fold ``1 + 0.3`` in doubles.
    """
    is_wide = further and (further[1].numel() or further[0].numel() > 1)
    parts: tuple[Any, ...] = (
        system.free_flow,
        system.locked_flow,
        cast("Any", ca).vertcat(*system.contact),
        system.impulse_direction,
        system.law_numbers,
        system.holonomic,
        *(further if is_wide else ()),
    )
    inputs = [system.state, ca.vertcat(*symbols.values())]
    function = ca.Function("system", inputs, [ca.densify(ca.SX(part)) for part in parts])
    speed, restitution, coefficient = ca.SX.sym("speed"), ca.SX.sym("restitution"), None
    named = system.law._replace(restitution=restitution)
    if system.law.of_speed is not None:
        # The law itself is evaluated, at the speed that it is given.
        named, own = system.law, [ca.densify(ca.SX(system.law.at(speed)))]
        coefficient = ca.Function("coefficient", [inputs[1], speed], own)
    lines = [f"{function.numel_in(0)} {function.numel_in(1)} {system.n_q}"]
    every = [function] if coefficient is None else [function, coefficient]
    for name, takes, gives, number in chain.from_iterable(map(_instructions, every)):
        words = [name, ",".join(map(str, takes)), ",".join(map(str, gives))]
        lines.append(" ".join(words if number is None else [*words, number.hex()]))
    text = "".join(line + "\n" for line in lines)
    law = [ca.densify(ca.SX(part)) for part in (named.rate_drop(speed), named.speed_after(speed))]
    struck = ca.Function("law", [*inputs, restitution, speed], law)
    mass = ca.vec(ca.densify(ca.SX(system.mechanism.mass_matrix)))
    inertia = ca.Function("inertia", inputs, [mass])
    digest = hashlib.sha256(text.encode()).hexdigest()
    return Formulas(function, struck, coefficient, inertia, digest, system.n_q)


def joined_digest(digests: Iterable[str]) -> str:
    """Return the digest of a machine from those of its systems, by sides and stop."""
    return hashlib.sha256("".join(digests).encode()).hexdigest()


def _instructions(function: ca.Function) -> Iterator[tuple[str, list[int], list[int], Any]]:
    """Yield name, arguments and results of each instruction, and the value of a constant."""
    names = {getattr(ca, name): name for name in sorted(dir(ca), reverse=True) if name[:3] == "OP_"}
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        number = float(function.instruction_constant(k)) if code == ca.OP_CONST else None
        yield names[code][3:], function.instruction_input(k), function.instruction_output(k), number


def walked(function: ca.Function, graph: Graph, inputs: Sequence[Sequence[int]]) -> list[list[int]]:
    """Return the nodes of a function's outputs, instruction by instruction.

    Args:
        function: The function.
        graph: Graph that receives the nodes. A non-analytic operation becomes a node that fails.
        inputs: Nodes of each input of the function.
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
            # A table is a call with several results.
            known = (work[place] for place in takes if place in work)
            work |= dict.fromkeys(gives, graph.put("unknown", name.lower(), *known))
    return outputs


def require_analytic(graph: Graph, outputs: Iterable[int]) -> None:
    """Raise an error for formulas with a non-analytic operation, or with an invalid constant.

    Raises:
        NotProved: If such an operation or constant exists. The reason names it.
    """
    for place in graph.needed(outputs):
        name, *given = graph.nodes[place]
        if name == "unknown":
            raise NotProved(f"the operation `{given[0]}` is not known to be analytic")
        if name == "constant" and not abs(given[0]) < float("inf"):
            raise NotProved(f"the number {given[0]} stands in a formula that must be analytic")


def _power(graph: Graph, a: int, b: int) -> int:
    """Return the node of a power: products if twice the exponent is an integer, else an exp."""
    exponent = graph.nodes[b][1] if graph.nodes[b][0] == "constant" else 0.25
    if exponent % 0.5 == 0.0 and exponent % 1 and abs(exponent) <= _HIGHEST / 2:
        a, exponent = graph.function("sqrt", a), 2 * exponent
    if exponent % 1 or not abs(exponent) <= _HIGHEST:
        return graph.function("exp", graph.put("mul", b, graph.function("log", a)))
    found = graph.one
    for _ in range(int(abs(exponent))):
        found = a if found == graph.one else graph.put("mul", found, a)
    return graph.put("div", graph.one, found) if exponent < 0 else found


def _quotient(graph: Graph, a: int, b: int) -> int:
    """Return the node of a quotient without the factors that both numbers share."""
    kind, *number = graph.nodes[b]
    if kind == "constant" and abs(number[0]) == float("inf"):
        # A finite number divided by infinity is zero. The product checks that it is finite.
        return graph.put("mul", a, graph.zero)
    left, divisors, common = graph.factors(a), graph.factors(b), list[int]()
    for factor in graph.factors(a):
        if factor in divisors:
            common.append(factor)
            left.remove(factor)
            divisors.remove(factor)
    if not common:
        return graph.put("div", a, b)
    # Cancelled factors do not widen intervals. The sum checks that they are nonzero.
    add, mul, div = (partial(graph.put, name) for name in ("add", "mul", "div"))
    whole = div(reduce(mul, left, graph.one), reduce(mul, divisors, graph.one))
    inverses = (div(graph.one, factor) for factor in common)
    return add(whole, mul(reduce(add, inverses), graph.zero))


def _operations(graph: Graph) -> dict[str, Callable[..., int]]:
    """Return the functions that make a node from an operation of CasADi, keyed by name."""
    put, function, one, two = graph.put, graph.function, graph.one, graph.put("constant", 2.0)
    add, sub, mul, div = (partial(put, name) for name in ("add", "sub", "mul", "div"))
    exp, log, sqrt, atan = (partial(function, name) for name in ("exp", "log", "sqrt", "atan"))
    quotient, power = partial(_quotient, graph), partial(_power, graph)

    def inverse(a: int) -> int:
        return div(one, a)

    def twice(a: int) -> int:
        return add(a, a)

    def square(a: int) -> int:
        return mul(a, a)

    def hypotenuse(a: int, b: int) -> int:
        return sqrt(add(square(a), square(b)))

    def arcsine(a: int) -> int:
        return atan(div(a, sqrt(sub(one, square(a)))))

    unary: dict[str, Callable[[int], int]] = {
        "TWICE": twice,
        "SQ": square,
        "INV": inverse,
        "TAN": lambda a: div(function("sin", a), function("cos", a)),
        "SINH": lambda a: div(sub(exp(a), inverse(exp(a))), two),
        "COSH": lambda a: div(add(exp(a), inverse(exp(a))), two),
        "EXPM1": lambda a: sub(exp(a), one),
        "LOG1P": lambda a: log(add(one, a)),
        "ASIN": arcsine,
        "ACOS": lambda a: sub(twice(atan(one)), arcsine(a)),
        "ASINH": lambda a: log(add(a, sqrt(add(square(a), one)))),
        "ACOSH": lambda a: log(add(a, sqrt(sub(square(a), one)))),
        "ATANH": lambda a: div(log(div(add(one, a), sub(one, a))), two),
    }
    binary: dict[str, Callable[[int, int], int]] = {
        "DIV": quotient,
        "POW": power,
        "CONSTPOW": power,
        "HYPOT": hypotenuse,
        # Off the negative x axis, half the angle is the angle of (x + |(x, y)|, y).
        "ATAN2": lambda y, x: twice(atan(div(y, add(x, hypotenuse(x, y))))),
    }
    plain = {name.upper(): partial(put, name) for name in ("add", "sub", "mul", "neg")}
    others = {name.upper(): partial(function, name) for name in _FUNCTIONS}
    return {**plain, **others, **unary, **binary}


_FUNCTIONS = ("sin", "cos", "exp", "log", "sqrt", "atan", "tanh")
_HIGHEST = 64
"""Highest integer power that is expanded into products."""
