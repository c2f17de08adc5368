"""A mode of a problem as functions, and as a flow at fixed parameters for the integrators."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import (
    FIRST_ITERATIONS,
    JUMPS,
    Collocation,
    Corrected,
    NewtonPieces,
    StageGuess,
    Tolerance,
    error_norm,
    explicit_attempt,
    guard_bounds,
    has_bounds,
    implicit_expressions,
    longest_step,
    may_be_merged,
    n_factors,
    overflow,
)
from zeno_orbits.model.numeric.calls import Call, StepCall
from zeno_orbits.model.numeric.casadi_calls import caller
from zeno_orbits.model.numeric.columns import Columns


@dataclass(frozen=True, kw_only=True, eq=False)
class ModeFunctions:
    """A flow and its guard as functions of ``(y, p)``, with derived functions built on demand.

    Attributes:
        rate: ``(y, p) -> dy/dt``.
        guard: ``(y, p) -> (guard, its time derivative)``.
        interpreted: Whether the compiled loop must not evaluate the functions, for comparisons.
        weights: Size of each state for the absolute local error, empty if all are 1.
        watched: ``(y, p) -> (guard, its time derivatives)``, as formulas whose bounds are needed to
            detect every zero crossing, or ``None`` if the guard is affine in the state.
    """

    rate: ca.Function
    guard: ca.Function
    interpreted: bool = False
    weights: tuple[float, ...] = ()
    watched: ca.Function | None = None

    @cached_property
    def bounded(self) -> ca.Function | None:
        """The watched formulas, if their bounds over a box of states are available."""
        return self.watched if self.watched is not None and has_bounds(self.watched) else None

    @property
    def bounds(self) -> ca.Function | None:
        """Bounds of the guard over a box of states, if it needs any: see `guard_bounds`."""
        return None if self.bounded is None else _bounds(self.bounded)

    @cached_property
    def is_carried(self) -> bool:
        """True if the guard is a state, in addition to its watched formula."""
        y, p = self._symbols()
        return self.watched is not None and is_affine(self.guard(y, p)[0], y)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields, without the functions that are derived from them."""
        return {one.name: getattr(self, one.name) for one in fields(self)}

    @property
    def n_y(self) -> int:
        """Number of states."""
        return self.rate.size1_in(0)

    @property
    def n_p(self) -> int:
        """Number of parameters."""
        return self.rate.size1_in(1)

    @cached_property
    def jacobian(self) -> ca.Function:
        """``(y, p) -> d(dy/dt)/dy``."""
        y, p = self._symbols()
        name = f"{self.rate.name()}_jacobian"
        return dense_function(name, [y, p], [ca.jacobian(self.rate(y, p), y)])

    @cached_property
    def longest(self) -> ca.Function | None:
        """``(y, p) -> largest step``, or ``None`` without smooth tables: see `longest_step`."""
        y, p = self._symbols()
        found = longest_step(y, self.rate(y, p))
        return None if found is None else dense_function("longest", [y, p], [found])

    @cached_property
    def step(self) -> ca.Function:
        """A step of DOP853.

        ``(y, p, (size, relative, absolute)) -> (y after, error in units of the tolerance, guard
        after)``.
        """
        y, p = self._symbols()
        numbers = ca.SX.sym("numbers", 3)
        size, relative, absolute = ca.vertsplit(numbers)
        name = f"{self.rate.name()}_step"
        with as_written():
            after, fifth, third = explicit_attempt(lambda state: self.rate(state, p), y, size)
            scale = self.weighed(absolute) + relative * ca.fmax(ca.fabs(y), ca.fabs(after))
            error = overflow(ca.sum1(after), ca) + error_norm(
                ca.sumsqr(fifth / scale), ca.sumsqr(third / scale), ca.fabs(size), y.numel(), ca
            )
            return dense_function(name, [y, p, numbers], [after, error, self.guard(after, p)])

    def weighed(self, absolute: ca.SX | float) -> ca.SX:
        """Return the absolute local error of each state, ``(n_y,)``, or one for all."""
        return absolute * ca.SX(list(self.weights)) if self.weights else ca.SX(absolute)

    def _symbols(self) -> tuple[ca.SX, ca.SX]:
        return ca.SX.sym("y", self.n_y), ca.SX.sym("p", self.n_p)


@lru_cache(maxsize=64)
def _bounds(watched: ca.Function) -> ca.Function:
    return guard_bounds(watched)


@contextmanager
def as_written() -> Generator[None]:
    """Disable the simplification of formulas.

    CasADi combines two products with constants, and replaces a product with an inverse by a
    quotient. The digits of a step would then differ from a sequence of its operations, as in the
    loop.
    """
    before = ca.GlobalOptions.getSimplificationOnTheFly()
    ca.GlobalOptions.setSimplificationOnTheFly(False)
    try:
        yield
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(before)


@lru_cache(maxsize=64)
def unguarded_mode(mode: ModeFunctions) -> ModeFunctions:
    """Return a mode whose guard is 1 and never falls, made once.

    Args:
        mode: The mode.
    """
    y, p = ca.SX.sym("y", mode.n_y), ca.SX.sym("p", mode.n_p)
    none = dense_function(f"{mode.guard.name()}_none", [y, p], [ca.SX([1.0, 0.0])])
    return replace(mode, guard=none, watched=None)


@lru_cache(maxsize=64)
def weighted(mode: ModeFunctions, weights: tuple[float, ...]) -> ModeFunctions:
    """Return a mode whose local errors are absolute in other sizes of its states, made once.

    Args:
        mode: The mode.
        weights: Size of each state, ``(n_y,)``.
    """
    return mode if set(weights) == {1.0} else replace(mode, weights=weights)


class NewtonFunctions(NamedTuple):
    """The pieces of an implicit step as functions.

    ``numbers`` are ``(size, relative, absolute, start, ratio)``, the last two of the continuation.

    Attributes:
        begin: ``(y, p, numbers, coefficients continued) -> (factors of Newton's matrices, stages
            and coefficients after the first iterations, y after, (sizes of the last two
            corrections, error in units of the tolerance, guard and its rate after))``.
        correct: ``(y, p, numbers, factors, stages) -> (stages, size of the correction)``.
        error: ``(y, p, numbers, factors, stages) -> error in units of the tolerance``.
    """

    begin: ca.Function
    correct: ca.Function
    error: ca.Function


def mode_functions(
    name: str, y: ca.SX, p: ca.SX, rate: ca.SX, guard: ca.SX, watched: ca.SX | None = None
) -> ModeFunctions:
    """Build the functions of a mode.

    Args:
        name: How its functions are called.
        y: Its state, ``(n_y,)``.
        p: Its parameters.
        rate: ``dy/dt``, ``(n_y,)``.
        guard: The guard and its time derivative.
        watched: The formula of the guard and of its time derivatives, `guard` by default, of which
            bounds are needed unless it is affine in the state: the error control of that is its own
            then.

    Raises:
        ValueError: If an expression holds another symbol.
    """
    formulas = guard if watched is None else watched
    affine = is_affine(formulas[0], y)
    return ModeFunctions(
        rate=dense_function(f"{name}_rate", [y, p], [rate]),
        guard=dense_function(f"{name}_guard", [y, p], [guard]),
        watched=None if affine else dense_function(f"{name}_watched", [y, p], [formulas]),
    )


def is_affine(expression: ca.SX, y: ca.SX) -> bool:
    """Return True if an expression is affine in symbols: constant derivative and no jumps."""
    if ca.depends_on(ca.jacobian(expression, y), y):
        return False
    f = ca.Function("f", ca.symvar(expression), [expression])
    return not any(f.instruction_id(k) in JUMPS for k in range(f.n_instructions()))


def dense_function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    """Return a function with dense outputs, because a buffer receives only the stored entries.

    Args:
        name: Name of the function.
        inputs: Symbols.
        outputs: Expressions in them.

    Raises:
        ValueError: If an output depends on a symbol that is not an input.
    """
    options = {"cse": may_be_merged(outputs), "allow_free": True}
    function = ca.Function(name, inputs, [ca.densify(output) for output in outputs], options)
    if function.has_free():
        wanted = "must depend on its state and named parameters only"
        loose = ", ".join(function.get_free())
        raise ValueError(f"Argument `system` {wanted}, but `{name}` depends on {loose}.")
    return function


class FlowMemory:
    """The functions of a mode with their memory, shared by flows at different ``p``.

    The memory is allocated at the first call, because the compiled loop does not need it. The
    weights of the states are also computed at the first step.
    """

    def __init__(
        self, mode: ModeFunctions, weights: Callable[[], tuple[float, ...]] | None = None
    ) -> None:
        self.mode = mode
        self._weights = weights
        self.p: Vector = np.zeros(mode.n_p)
        self.owner: object = None
        self._newton: tuple[Collocation, NewtonCalls] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a recipe for pickle, with the same weights and without parameter values."""
        return _memory, (self.mode, self.stepping.weights)

    @cached_property
    def stepping(self) -> ModeFunctions:
        """The mode with the weights that its steps are taken with."""
        return self.mode if self._weights is None else weighted(self.mode, self._weights())

    @cached_property
    def rate(self) -> Call:
        """From a state to ``dy/dt``."""
        return Call(self.mode.rate, self.p)

    @cached_property
    def rates(self) -> Columns:
        """From states, and parameters in the same rows, to ``dy/dt``."""
        return Columns(self.mode.rate)

    @cached_property
    def guard(self) -> Call:
        """From a state to the guard and its rate."""
        return Call(self.mode.guard, self.p)

    @cached_property
    def guards(self) -> Columns:
        """From states, and parameters in the same rows, to the guard and its rate."""
        return Columns(self.mode.guard)

    @cached_property
    def bounds(self) -> Call | None:
        """From lower and upper ends of a box of states to bounds of the guard in it."""
        bounds = self.mode.bounds
        return None if bounds is None else Call(bounds, self.p)

    @cached_property
    def longest(self) -> Call | None:
        """From a state to the largest step, or ``None`` without a bound."""
        longest = self.mode.longest
        return None if longest is None else Call(longest, self.p)

    @cached_property
    def jacobian(self) -> Call:
        """From a state to the derivative of ``dy/dt``."""
        return Call(self.mode.jacobian, self.p)

    @cached_property
    def step(self) -> StepCall:
        """One step of DOP853."""
        return StepCall(self.stepping.step, self.mode.n_y, self.p)

    def newton(self, scheme: Collocation) -> NewtonCalls:
        """Return one step of a collocation scheme, in pieces."""
        if self._newton is None or self._newton[0] is not scheme:
            functions = newton_functions(self.stepping, scheme)
            self._newton = (scheme, NewtonCalls(functions, self.p, self.mode.n_y, scheme))
        return self._newton[1]


def _memory(mode: ModeFunctions, weights: tuple[float, ...]) -> FlowMemory:
    return FlowMemory(mode, (lambda: weights) if weights else None)


class CompiledFlow:
    """A guarded flow whose step is a single CasADi call through preallocated memory.

    Flows that differ only in their parameter values, as the flights of a problem, can share the
    memory.
    """

    def __init__(self, mode: ModeFunctions, p: Vector, memory: FlowMemory | None = None) -> None:
        self.mode = mode
        self.p = p
        self._memory = memory or FlowMemory(mode)
        # A step returns the guard at its end, so a later evaluation there is free.
        self._end: Vector | None = None
        self._end_guard = (0.0, 0.0)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a recipe for pickle that preserves shared memory."""
        return CompiledFlow, (self.mode, self.p, self._memory)

    def calls(self) -> FlowMemory:
        """Return the memory, with the parameter values of this flow in it."""
        memory = self._memory
        if memory.owner is not self:
            memory.p[:] = self.p
            memory.owner = self
        return memory

    def rate(self, y: Vector) -> Vector:
        """Return ``dy/dt``."""
        return self.calls().rate(y).copy()

    def rates(self, states: Vector) -> Vector:
        """Return ``dy/dt`` at states ``(n, n_y)``, one row each."""
        return self._memory.rates(states, np.broadcast_to(self.p, (len(states), self.p.size)))[0]

    def guard(self, y: Vector) -> tuple[float, float]:
        """Return the guard and its time derivative along the flow."""
        if y is self._end:
            return self._end_guard
        value, rate = self.calls().guard(y).tolist()
        return value, rate

    def guards(self, states: Vector) -> Vector:
        """Return the guard at states ``(n, n_y)``, ``(n,)``."""
        return self._guards_and_rates(states)[:, 0]

    def guard_rates(self, states: Vector) -> Vector:
        """Return the time derivative of the guard at states ``(n, n_y)``, ``(n,)``."""
        return self._guards_and_rates(states)[:, 1]

    def _guards_and_rates(self, states: Vector) -> Vector:
        p = np.broadcast_to(self.p, (len(states), self.p.size))
        return self._memory.guards(states, p)[0]

    @property
    def weights(self) -> tuple[float, ...]:
        """Size of each state for the absolute local error, empty if all are 1."""
        return self._memory.stepping.weights

    @property
    def is_bounded(self) -> bool:
        """True if the guard varies otherwise than the state, and its bounds in a box are known."""
        return self._memory.bounds is not None

    @property
    def is_carried(self) -> bool:
        """True if the guard is a state, in addition to its formula."""
        return self.mode.is_carried

    def guard_bounds(self, lower: Vector, upper: Vector) -> Sequence[float]:
        """Return bounds of the guard, its rate and its second derivative over a box of states."""
        bounds = self.calls().bounds
        if bounds is None:
            return (-math.inf, math.inf) * 3
        found: list[float] = bounds(np.concatenate((lower, upper))).tolist()
        return found

    def attempt(self, y: Vector, size: float, tolerance: Tolerance) -> tuple[Vector, float]:
        """Return the state and the error of a DOP853 step, in units of the tolerance."""
        after, error, guard = self.calls().step(y, size, tolerance)
        self.keep_end(after, guard)
        return after, error

    def keep_end(self, after: Vector, guard: tuple[float, float]) -> None:
        """Cache the guard at the end of a step. The state is identified by its array."""
        self._end, self._end_guard = after, guard

    def longest(self, y: Vector) -> float:
        """Return the largest step from a state that cannot pass a pulse of a table unseen."""
        longest = self.calls().longest
        return math.inf if longest is None else float(longest(y)[0])

    def jacobian(self, y: Vector) -> Vector:
        """Return the derivative of the rate, ``(n_y, n_y)``."""
        return self.calls().jacobian(y).reshape(y.size, y.size, order="F").copy()

    def newton(self, scheme: Collocation) -> NewtonPieces:
        """Return the iteration for an implicit step of a collocation scheme."""
        return CompiledNewton(self, scheme)


def unguarded(flow: CompiledFlow) -> CompiledFlow:
    """Return a flow whose guard never falls: the same rate, numbers and weights.

    Args:
        flow: The flow.
    """
    weights = flow.weights
    mode = unguarded_mode(flow.mode)
    return CompiledFlow(mode, flow.p, _memory(mode, weights))


class CompiledNewton:
    """Newton's iteration for an implicit step of a flow."""

    def __init__(self, flow: CompiledFlow, scheme: Collocation) -> None:
        self._flow = flow
        self.scheme = scheme

    def begin(
        self, y: Vector, size: float, tolerance: Tolerance, guess: StageGuess | None
    ) -> Corrected:
        """Factorize the matrices of a step and return the result of its first iterations."""
        calls = self._flow.calls().newton(self.scheme)
        corrected, guard = calls.begin(y, size, tolerance, guess)
        self._flow.keep_end(corrected.after, guard)
        return corrected

    def correct(self, stages: Vector) -> tuple[Vector, float]:
        """Return the stage increments after another iteration and the size of its correction."""
        return self._flow.calls().newton(self.scheme).correct(stages)

    def error(self, stages: Vector) -> float:
        """Return the error of the step, in units of the tolerance."""
        return self._flow.calls().newton(self.scheme).error(stages)


class NewtonCalls:
    """Newton's iteration for an implicit step, each piece one call."""

    def __init__(
        self, functions: NewtonFunctions, p: Vector, n_y: int, scheme: Collocation
    ) -> None:
        shape = (scheme.n_stages, n_y)
        self._y, self._numbers = np.zeros(n_y), np.zeros(5)
        self._continued, self._nothing = np.zeros(shape), np.zeros(shape)
        self._factors = np.zeros(n_factors(n_y, scheme))
        self._begun, self._coefficients = np.zeros(shape), np.zeros(shape)
        self._after, self._told = np.zeros(n_y), np.zeros(5)
        self._stages, self._corrected = np.zeros(shape), np.zeros(shape)
        self._size, self._error = np.zeros(1), np.zeros(1)
        step = (self._y, p, self._numbers)
        begun = (self._factors, self._begun, self._coefficients, self._after, self._told)
        iterate = (*step, self._factors, self._stages)
        self._begin = caller(functions.begin, (*step, self._continued), begun)
        self._correct = caller(functions.correct, iterate, (self._corrected, self._size))
        self._estimate = caller(functions.error, iterate, (self._error,))

    def begin(
        self, y: Vector, size: float, tolerance: Tolerance, guess: StageGuess | None
    ) -> tuple[Corrected, tuple[float, float]]:
        """Factorize and return the result of the first iterations, and the guard at the end."""
        start, ratio = (0.0, 0.0) if guess is None else (guess.start, guess.ratio)
        self._y[:] = y
        self._continued[:] = self._nothing if guess is None else guess.coefficients
        self._numbers[:] = (size, tolerance.relative, tolerance.absolute, start, ratio)
        self._begin()
        before, last, error, value, rate = self._told.tolist()
        corrected = Corrected(
            self._begun.copy(), self._coefficients.copy(), self._after.copy(), before, last, error
        )
        return corrected, (value, rate)

    def correct(self, stages: Vector) -> tuple[Vector, float]:
        """Return the stage increments after another iteration and the size of its correction."""
        self._stages[:] = stages
        self._correct()
        return self._corrected.copy(), self._size.item()

    def error(self, stages: Vector) -> float:
        """Return the error of the step, in units of the tolerance."""
        self._stages[:] = stages
        self._estimate()
        return self._error.item()


@lru_cache(maxsize=64)
def newton_functions(mode: ModeFunctions, scheme: Collocation) -> NewtonFunctions:
    """Build the functions of an implicit step, which only stiff problems need."""
    p = ca.SX.sym("p", mode.rate.size1_in(1))
    pieces = implicit_expressions(mode.rate, p, scheme)
    y, stages, factors = pieces.y, pieces.stages, pieces.factors
    numbers = ca.SX.sym("numbers", 5)
    size, relative, absolute, start, ratio = ca.vertsplit(numbers)
    scale = mode.weighed(absolute) + relative * ca.fabs(y)

    def norm(change: ca.SX) -> ca.SX:
        columns = ca.repmat(scale, 1, change.shape[1])
        return ca.sqrt(ca.sumsqr(change / columns) / change.numel())

    def function(name: str, inputs: list[ca.SX], *outputs: ca.SX) -> ca.Function:
        sized = ca.substitute([*outputs], [pieces.size], [size])
        return dense_function(f"{mode.rate.name()}_{name}", [y, p, numbers, *inputs], sized)

    iterate = [factors, stages]
    correct = function("correct", iterate, stages + pieces.correction, norm(pieces.correction))
    error = function(
        "error", iterate, norm(pieces.error) + overflow(ca.sum1(y + stages[:, -1]), ca)
    )
    continued = ca.SX.sym("continued", y.numel(), scheme.n_stages)
    factorized = ca.substitute(pieces.factorized, pieces.size, size)
    corrected, norms = _continued(continued, scheme, start, ratio), list[ca.SX]()
    for _ in range(FIRST_ITERATIONS):
        corrected, last = correct(y, p, numbers, factorized, corrected)
        norms.append(last)
    after = y + corrected[:, -1]
    estimate = error(y, p, numbers, factorized, corrected)
    told = ca.vertcat(*norms[-2:], estimate, mode.guard(after, p))
    coefficients = ca.mtimes(corrected, ca.DM(scheme.monomials).T)
    return NewtonFunctions(
        begin=function("begin", [continued], factorized, corrected, coefficients, after, told),
        correct=correct,
        error=error,
    )


def _continued(coefficients: ca.SX, scheme: Collocation, start: ca.SX, ratio: ca.SX) -> ca.SX:
    """Return the result of ``Collocation.continued`` in symbols."""
    at = [start + ratio * node for node in scheme.nodes.tolist()]
    values = [_polynomial(coefficients, position) for position in at]
    return ca.horzcat(*values) - _polynomial(coefficients, start)


def _polynomial(coefficients: ca.SX, position: ca.SX) -> ca.SX:
    """Return a polynomial without constant term, ``(n_y,)``, by Horner's rule."""
    value = ca.SX.zeros(coefficients.shape[0])
    for column in reversed(ca.horzsplit(coefficients)):
        value = (value + column) * position
    return value
