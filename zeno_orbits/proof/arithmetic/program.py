r"""A CasADi function as a program of operations on balls, and on Taylor series of balls.

Operations of a flow are computed coefficient by coefficient, with the rules of `recurrences`.
Operations that only depend on a flow, such as its derivatives, use products of whole series.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
from flint import arb, arb_series, ctx

from zeno_orbits.errors import TableProofError, TranslationError
from zeno_orbits.integrators import called_table
from zeno_orbits.proof.arithmetic.balls import ONE, ZERO, Ball
from zeno_orbits.proof.arithmetic.expressions import proof_operation
from zeno_orbits.proof.arithmetic.recurrences import (
    OPERATIONS,
    SLOPES,
    Series,
    recurrence,
    sine_and_cosine,
)


class BallProgram:
    """A CasADi function as operations on balls, with its second input fixed."""

    def __init__(self, function: ca.Function, numbers: Sequence[Ball], *, n_flow: int = 0) -> None:
        """Translate a function.

        Args:
            function: Function of states and parameters, of type SX, with any outputs.
            numbers: The second input.
            n_flow: Number of entries of the first output that are rates of the states.
                `flow_series` computes their series. The other entries are evaluated on known
                series.

        Raises:
            TranslationError: If an operation cannot be translated.
        """
        self.n = function.numel_in(0)
        self.fixed: list[Ball | None] = [None] * self.n
        self.operations: list[tuple[str, int, int]] = [("input", k, k) for k in range(self.n)]
        self._known: dict[tuple[str, int, int], int] = {}
        outputs = [[self._constant(ZERO)] * function.nnz_out(k) for k in range(function.n_out())]
        work: dict[int, int] = {}
        exponent: dict[int, float] = {}
        for k in range(function.n_instructions()):
            code = function.instruction_id(k)
            takes, gives = function.instruction_input(k), function.instruction_output(k)
            if code == ca.OP_OUTPUT:
                outputs[gives[0]][gives[1]] = work[takes[0]]
            elif code == ca.OP_INPUT:
                place = takes[1]
                work[gives[0]] = place if takes[0] == 0 else self._constant(numbers[place])
            elif code == ca.OP_CONST:
                value = function.instruction_constant(k)
                work[gives[0]] = self._constant(arb(value))
                exponent[work[gives[0]]] = value
            elif code in (ca.OP_POW, ca.OP_CONSTPOW):
                work[gives[0]] = self._power(work[takes[0]], work[takes[1]], exponent)
            elif code == ca.OP_CALL:
                raise TableProofError(called_table(function, k))
            else:
                work[gives[0]] = self._translated(code, [work[one] for one in takes])
        self.outputs = outputs
        self._online = self._needed(outputs[0][:n_flow]) if n_flow else []
        self._flow = outputs[0][:n_flow]
        online = set(self._online)
        every = [place for output in outputs for place in output]
        self._offline = [k for k in self._needed(every) if k not in online]

    def __call__(self, x: Sequence[Ball]) -> list[list[Ball]]:
        """Return the nonzero entries of every output at a state of real or complex balls."""
        values = list(x)
        for k in range(self.n, len(self.operations)):
            fixed = self.fixed[k]
            name, a, b = self.operations[k]
            values.append(_VALUES[name](values[a], values[b]) if fixed is None else fixed)
        return [[values[place] for place in output] for output in self.outputs]

    def flow_series(
        self, x: Sequence[Any], order: int, empty: Callable[[], Any] = list
    ) -> list[Series]:
        """Return the series of the flow from a state, and of all operations in the flow.

        Args:
            x: State, ``(n,)``.
            order: Order of the last coefficient of the states.
            empty: Maker of an empty series.

        Returns:
            One series for each operation, empty for operations outside the flow: first the states
            to ``order``, then the other operations to ``order - 1``.
        """
        series: list[Any] = [empty() for _ in self.operations]
        for k in range(self.n):
            series[k].append(x[k])
        steps = [self._stepper(k, series) for k in self._online]
        rates = [
            (series[k], series[place], self.fixed[place]) for k, place in enumerate(self._flow)
        ]
        for k in range(order):
            for step in steps:
                step(k)
            for state, rate, fixed in rates:
                if fixed is None:
                    state.append(rate[k] / (k + 1))
                else:
                    state.append(fixed if k == 0 else ZERO)
        return series

    def follow(self, series: list[Series], order: int) -> list[list[Series]]:
        """Return the series of all outputs along a flow, to an order.

        Args:
            series: Result of `flow_series`. Missing series are filled in.
            order: Order of the last coefficient, at most the order of the flow's rates.
        """
        n = order + 1
        ctx.cap = n
        known: dict[int, Any] = {}

        def polynomial(place: int) -> Any:
            found = known.get(place)
            if found is None:
                found = known[place] = arb_series(series[place][:n], n)
            return found

        for k in self._offline:
            name, a, b = self.operations[k]
            if name in _POLYNOMIAL:
                fixed_a, fixed_b = self.fixed[a], self.fixed[b]
                left = polynomial(a) if fixed_a is None else fixed_a
                right = polynomial(b) if fixed_b is None else fixed_b
                known[k] = _POLYNOMIAL[name](left, right)
                continue
            for place in (a, b):
                if self.fixed[place] is None and not series[place]:
                    series[place].extend(_coefficients(known[place], n))
            step = self._stepper(k, series)
            for j in range(n):
                step(j)
        for output in self.outputs:
            for place in output:
                if not series[place] and self.fixed[place] is None:
                    series[place].extend(_coefficients(known[place], n))
        zeros = [ZERO] * order
        return [
            [series[p][:n] if self.fixed[p] is None else [self.fixed[p], *zeros] for p in output]
            for output in self.outputs
        ]

    def _needed(self, places: Sequence[int]) -> list[int]:
        """Return the operations in given outputs, in order, without the inputs."""
        needed: set[int] = set()
        left = list(places)
        while left:
            place = left.pop()
            if place in needed or place < self.n or self.fixed[place] is not None:
                continue
            needed.add(place)
            left += self.operations[place][1:]
        return sorted(needed)

    def _constant(self, value: Ball) -> int:
        self.fixed.append(value)
        self.operations.append(("constant", 0, 0))
        return len(self.fixed) - 1

    def _add(self, name: str, a: int, b: int | None = None) -> int:
        """Return the index of an operation, which is folded if all arguments are constants."""
        b = a if b is None else b
        left, right = self.fixed[a], self.fixed[b]
        if left is not None and right is not None:
            return self._constant(_VALUES[name](left, right))
        if name == "mul" and ONE in (left, right):
            return b if left == ONE else a
        key = (name, a, b)
        if key not in self._known:
            if name in ("sin", "cos"):
                # Sine and cosine are computed together, since each recurrence needs the other
                # function.
                sine = self._append("sin", a, a)
                self._known["sin", a, b] = sine
                self._known["cos", a, b] = self._append("cos", a, sine)
            else:
                self._known[key] = self._append(name, a, b)
        return self._known[key]

    def _append(self, name: str, a: int, b: int) -> int:
        self.fixed.append(None)
        self.operations.append((name, a, b))
        return len(self.fixed) - 1

    def _power(self, base: int, exponent: int, values: dict[int, float]) -> int:
        """Return a power: products for integer exponents, otherwise exponential and logarithm."""
        value = values.get(exponent)
        if value is None or value != round(value) or abs(value) > 64:
            return self._add("exp", self._add("mul", exponent, self._add("log", base)))
        result = self._constant(ONE) if value == 0 else base
        for _ in range(abs(int(value)) - 1):
            result = self._add("mul", result, base)
        return result if value >= 0 else self._add("div", self._constant(ONE), result)

    def _translated(self, code: int, takes: list[int]) -> int:
        """Return the index of a CasADi operation, composed of operations with a recurrence."""
        name = proof_operation(code)
        if name in OPERATIONS:
            return self._add(name, *takes)
        a, b = takes[0], takes[-1]
        one, add = self._constant(ONE), self._add
        if name in ("assign", "lift"):
            return a
        if name == "twice":
            return add("mul", self._constant(arb(2)), a)
        if name == "inv":
            return add("div", one, a)
        if name == "tan":
            return add("div", add("sin", a), add("cos", a))
        if name == "expm1":
            return add("sub", add("exp", a), one)
        if name == "log1p":
            return add("log", add("add", one, a))
        if name == "hypot":
            return add("sqrt", add("add", add("sq", a), add("sq", b)))
        if name == "atan2":
            # Off the negative axis, half the angle of (x, y) is the angle of (x + |(x, y)|, y).
            length = add("sqrt", add("add", add("sq", a), add("sq", b)))
            half = self._translated(ca.OP_ATAN, [add("div", a, add("add", b, length))])
            return add("mul", self._constant(arb(2)), half)
        if name in ("sinh", "cosh", "tanh"):
            return self._hyperbolic(name, a)
        if name in ("asinh", "acosh"):
            beside = add("add" if name == "asinh" else "sub", add("sq", a), one)
            return add("log", add("add", a, add("sqrt", beside)))
        if name == "atanh":
            ratio = add("div", add("add", one, a), add("sub", one, a))
            return add("div", add("log", ratio), self._constant(arb(2)))
        if name in SLOPES:
            square, scale = add("sq", a), self._constant(arb(SLOPES[name][0]))
            root = add("add", self._constant(arb(SLOPES[name][1])), add("mul", scale, square))
            if name != "atan":
                root = add("sqrt", root)
            sign = self._constant(arb(-1 if name == "acos" else 1))
            return add(name, a, add("div", sign, root))
        raise TranslationError(name)

    def _hyperbolic(self, name: str, a: int) -> int:
        add = self._add
        up = add("exp", a)
        down = add("div", self._constant(ONE), up)
        high, low = add("add", up, down), add("sub", up, down)
        if name == "tanh":
            return add("div", low, high)
        return add("div", low if name == "sinh" else high, self._constant(arb(2)))

    def _stepper(self, k: int, series: list[Series]) -> Callable[[int], None]:
        """Return the function that appends the next coefficient of an operation."""
        name, a, b = self.operations[k]
        if name == "sin":
            return sine_and_cosine(series[a], series[k], series[k + 1])
        constants = self.fixed[a], self.fixed[b]
        return recurrence(name, series[a], series[b], constants, series[k])


def _coefficients(polynomial: Any, n: int) -> Series:
    found = list(polynomial)
    return found[:n] + [ZERO] * (n - len(found))


def _method(name: str) -> Callable[[Ball, Ball], Ball]:
    return lambda a, _: getattr(a, name)()


_VALUES: dict[str, Callable[[Ball, Ball], Ball]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a, _: -a,
    "sq": lambda a, _: a * a,
    **{name: _method(name) for name in ("exp", "log", "sqrt", "sin", "cos", *SLOPES)},
}
_POLYNOMIAL = {name: _VALUES[name] for name in ("add", "sub", "mul", "neg", "sq")}
