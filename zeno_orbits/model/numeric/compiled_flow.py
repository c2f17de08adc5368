"""A mode of a problem as functions, and as a flow at fixed numbers: what the engines ask of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import (
    FIRST_ITERATIONS,
    Collocation,
    CompilableFlow,
    Corrected,
    LegCode,
    NewtonPieces,
    StageGuess,
    Tolerance,
    error_norm,
    explicit_attempt,
    follow_source,
    implicit_expressions,
    n_factors,
    overflow,
    radau_scheme,
)
from zeno_orbits.kernels import KernelLibrary, Kernels, KernelSource, Recipe, caller
from zeno_orbits.model.numeric.calls import Call, Connect, StepCall


@dataclass(frozen=True, kw_only=True, eq=False)
class ModeFunctions:
    """A flow and its guard as functions of ``(y, p)``, and what is made of them when it is needed.

    Attributes:
        rate: ``(y, p) -> dy/dt``.
        guard: ``(y, p) -> (guard, its time derivative)``.
        interpreted: They stay interpreted, for comparisons.
        weights: Size of each state, of which an absolute local error is a part; none if all are 1.
    """

    rate: ca.Function
    guard: ca.Function
    interpreted: bool = False
    weights: tuple[float, ...] = ()

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
    def step(self) -> ca.Function:
        """A step of DOP853.

        ``(y, p, (size, relative, absolute)) -> (y after, error in units of the tolerance, guard
        after)``.
        """
        y, p = self._symbols()
        numbers = ca.SX.sym("numbers", 3)
        size, relative, absolute = ca.vertsplit(numbers)
        after, fifth, third = explicit_attempt(lambda state: self.rate(state, p), y, size)
        scale = self.weighed(absolute) + relative * ca.fmax(ca.fabs(y), ca.fabs(after))
        error = overflow(ca.sum1(after), ca) + error_norm(
            ca.sumsqr(fifth / scale), ca.sumsqr(third / scale), ca.fabs(size), y.numel(), ca
        )
        name = f"{self.rate.name()}_step"
        return dense_function(name, [y, p, numbers], [after, error, self.guard(after, p)])

    @cached_property
    def kernels(self) -> Kernels:
        """The same compiled, with the loop over the steps of a leg."""
        maker = f"{__name__}:{leg_kernels.__name__}"
        functions = (self.rate, self.guard)
        recipe = Recipe(maker=maker, functions=functions, numbers=(N_STAGES, *self.weights))
        return Kernels(None if self.interpreted else recipe)

    def weighed(self, absolute: ca.SX | float) -> ca.SX:
        """Return the absolute local error of each state, ``(n_y,)``, or one for all."""
        return absolute * ca.SX(list(self.weights)) if self.weights else ca.SX(absolute)

    def _symbols(self) -> tuple[ca.SX, ca.SX]:
        return ca.SX.sym("y", self.n_y), ca.SX.sym("p", self.n_p)


N_STAGES = 7
"""Stages of the implicit steps that are compiled, those of the implicit engine."""


def leg_kernels(functions: Sequence[ca.Function], numbers: Sequence[float]) -> KernelSource:
    """Return the source of the kernels of a mode and of the loop over its steps.

    Args:
        functions: Rate and guard of the mode.
        numbers: Stages of an implicit step, then the weights of the states, if there are any.
    """
    rate, guard = functions
    stages, *weights = numbers
    mode = ModeFunctions(rate=rate, guard=guard, weights=tuple(weights))
    scheme = radau_scheme(int(stages))
    newton = newton_functions(mode, scheme)
    kernels = {
        "rate": rate,
        "guard": guard,
        "jacobian": mode.jacobian,
        "step": mode.step,
        "begin": newton.begin,
        "correct": newton.correct,
        "error": newton.error,
    }
    named = [renamed(function, f"zk_{name}") for name, function in kernels.items()]
    code = follow_source(mode.n_y, n_factors(mode.n_y, scheme), scheme)
    return KernelSource(functions=named, code=code)


@lru_cache(maxsize=64)
def weighted(mode: ModeFunctions, weights: tuple[float, ...]) -> ModeFunctions:
    """Return a mode whose local errors are absolute in other sizes of its states, made once.

    Args:
        mode: The mode.
        weights: Size of each state, ``(n_y,)``.
    """
    return mode if set(weights) == {1.0} else replace(mode, weights=weights)


def renamed(function: ca.Function, name: str) -> ca.Function:
    """Return a function of scalar instructions under another name."""
    inputs = [ca.SX.sym(f"i{k}", function.sparsity_in(k)) for k in range(function.n_in())]
    return ca.Function(name, inputs, function.call(inputs))


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


def mode_functions(name: str, y: ca.SX, p: ca.SX, rate: ca.SX, guard: ca.SX) -> ModeFunctions:
    """Build the functions of a mode.

    Args:
        name: How its functions are called.
        y: Its state, ``(n_y,)``.
        p: Its parameters.
        rate: ``dy/dt``, ``(n_y,)``.
        guard: The guard and its time derivative.

    Raises:
        ValueError: If an expression holds another symbol.
    """
    return ModeFunctions(
        rate=dense_function(f"{name}_rate", [y, p], [rate]),
        guard=dense_function(f"{name}_guard", [y, p], [guard]),
    )


def dense_function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    """Return a function with dense outputs: a buffer receives the stored entries only.

    Args:
        name: How the function is called.
        inputs: Symbols.
        outputs: Expressions in them.

    Raises:
        ValueError: If an output depends on a symbol that is no input.
    """
    options = {"cse": True, "allow_free": True}
    function = ca.Function(name, inputs, [ca.densify(output) for output in outputs], options)
    if function.has_free():
        wanted = "must depend on its state and named parameters only"
        loose = ", ".join(function.get_free())
        raise ValueError(f"Argument `system` {wanted}, but `{name}` depends on {loose}.")
    return function


class FlowMemory:
    """The functions of a mode with their memory, which flows at different ``p`` take in turns.

    Memory is made at the first call: an engine that has its own code needs none of it. Nor are the
    weights of the states asked for before the first step.
    """

    def __init__(
        self, mode: ModeFunctions, weights: Callable[[], tuple[float, ...]] | None = None
    ) -> None:
        self.mode = mode
        self._weights = weights
        self.p: Vector = np.zeros(mode.n_p)
        self.owner: object = None
        self._newton: tuple[Collocation, NewtonCalls] | None = None
        self._leg_code: LegCode | None = None

    @cached_property
    def stepping(self) -> ModeFunctions:
        """The mode with the weights that its steps are taken with."""
        return self.mode if self._weights is None else weighted(self.mode, self._weights())

    @cached_property
    def rate(self) -> Call:
        """From a state to ``dy/dt``."""
        return Call(self.mode.rate, self.p)

    @cached_property
    def guard(self) -> Call:
        """From a state to the guard and its rate."""
        return Call(self.mode.guard, self.p)

    @cached_property
    def jacobian(self) -> Call:
        """From a state to the derivative of ``dy/dt``."""
        return Call(self.mode.jacobian, self.p)

    @cached_property
    def step(self) -> StepCall:
        """One step of DOP853."""
        library = self.stepping.kernels.library()
        if library is not None:
            return StepCall(self.mode.n_y, self.p, _kernel(library, "step"))
        with self.stepping.kernels.owing():
            step = self.stepping.step
        return StepCall(self.mode.n_y, self.p, partial(caller, step))

    def newton(self, scheme: Collocation) -> NewtonCalls:
        """Return one step of a collocation scheme, in pieces."""
        if self._newton is None or self._newton[0] is not scheme:
            mode = self.stepping
            library = mode.kernels.library() if scheme is radau_scheme(N_STAGES) else None
            if library is None:
                with mode.kernels.owing():
                    functions = newton_functions(mode, scheme)
                connect = _NewtonConnect(*(partial(caller, function) for function in functions))
            else:
                connect = _NewtonConnect(*(_kernel(library, n) for n in NewtonFunctions._fields))
            self._newton = (scheme, NewtonCalls(connect, self.p, self.mode.n_y, scheme))
        return self._newton[1]

    def leg_code(self) -> LegCode | None:
        """Return the compiled loop over the steps of a leg, if there is one by now."""
        if self._leg_code is None:
            library = self.stepping.kernels.library()
            if library is not None:
                self._leg_code = LegCode(library, self.p, self.mode.n_y, radau_scheme(N_STAGES))
        return self._leg_code


def _kernel(library: KernelLibrary, name: str) -> Connect:
    return partial(library.caller, f"zk_{name}")


class CompiledFlow(CompilableFlow):
    """A guarded flow whose step is one CasADi call through preallocated memory.

    Flows that differ in their numbers alone, as the flights of a problem, can share the memory.
    """

    def __init__(self, mode: ModeFunctions, p: Vector, memory: FlowMemory | None = None) -> None:
        self.mode = mode
        self.p = p
        self._memory = memory or FlowMemory(mode)
        # A step tells the guard at its end, so whoever asks for it there need not wait.
        self._end: Vector | None = None
        self._end_guard = (0.0, 0.0)

    def calls(self) -> FlowMemory:
        """Return the memory, with the numbers of this flow in it."""
        memory = self._memory
        if memory.owner is not self:
            memory.p[:] = self.p
            memory.owner = self
        return memory

    def rate(self, y: Vector) -> Vector:
        """Return ``dy/dt``."""
        return self.calls().rate(y).copy()

    def guard(self, y: Vector) -> tuple[float, float]:
        """Return the guard and its time derivative along the flow."""
        if y is self._end:
            return self._end_guard
        value, rate = self.calls().guard(y).tolist()
        return value, rate

    def attempt(self, y: Vector, size: float, tolerance: Tolerance) -> tuple[Vector, float]:
        """Return the state after one step of DOP853 and its error, in units of the tolerance."""
        after, error, guard = self.calls().step(y, size, tolerance)
        self.keep_end(after, guard)
        return after, error

    def keep_end(self, after: Vector, guard: tuple[float, float]) -> None:
        """Remember the guard at the end of a step; the state is known by the array it is in."""
        self._end, self._end_guard = after, guard

    def jacobian(self, y: Vector) -> Vector:
        """Return the derivative of the rate, ``(n_y, n_y)``."""
        return self.calls().jacobian(y).reshape(y.size, y.size, order="F").copy()

    def newton(self, scheme: Collocation) -> NewtonPieces:
        """Return the iteration for an implicit step of a collocation scheme."""
        return CompiledNewton(self, scheme)

    def leg_code(self) -> LegCode | None:
        """Return the compiled loop over the steps of a leg, with the numbers of this flow in it."""
        return self.calls().leg_code()

    def owe(self, seconds: float) -> None:
        """Hear of time that compiled code would have saved [s]; in the end that repays it."""
        self._memory.stepping.kernels.owe(seconds)


class CompiledNewton:
    """Newton's iteration for an implicit step of a flow."""

    def __init__(self, flow: CompiledFlow, scheme: Collocation) -> None:
        self._flow = flow
        self.scheme = scheme

    def begin(
        self, y: Vector, size: float, tolerance: Tolerance, guess: StageGuess | None
    ) -> Corrected:
        """Factorize for a step and return what its first iterations give."""
        calls = self._flow.calls().newton(self.scheme)
        corrected, guard = calls.begin(y, size, tolerance, guess)
        self._flow.keep_end(corrected.after, guard)
        return corrected

    def correct(self, stages: Vector) -> tuple[Vector, float]:
        """Return the stage increments after one more iteration and the size of its correction."""
        return self._flow.calls().newton(self.scheme).correct(stages)

    def error(self, stages: Vector) -> float:
        """Return the error of the step, in units of the tolerance."""
        return self._flow.calls().newton(self.scheme).error(stages)


class _NewtonConnect(NamedTuple):
    """What makes calls of the pieces of an implicit step, as `NewtonFunctions` lists them."""

    begin: Connect
    correct: Connect
    error: Connect


class NewtonCalls:
    """Newton's iteration for an implicit step, each piece one call."""

    def __init__(self, connect: _NewtonConnect, p: Vector, n_y: int, scheme: Collocation) -> None:
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
        self._begin = connect.begin((*step, self._continued), begun)
        self._correct = connect.correct(iterate, (self._corrected, self._size))
        self._estimate = connect.error(iterate, (self._error,))

    def begin(
        self, y: Vector, size: float, tolerance: Tolerance, guess: StageGuess | None
    ) -> tuple[Corrected, tuple[float, float]]:
        """Factorize and return what the first iterations give, and the guard at the end."""
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
        """Return the stage increments after one more iteration and the size of its correction."""
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
    """Build the pieces of an implicit step; only a problem that turns out stiff needs them."""
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
    """Return what ``Collocation.continued`` does, in symbols."""
    at = [start + ratio * node for node in scheme.nodes.tolist()]
    values = [_polynomial(coefficients, position) for position in at]
    return ca.horzcat(*values) - _polynomial(coefficients, start)


def _polynomial(coefficients: ca.SX, position: ca.SX) -> ca.SX:
    """Return a polynomial without constant term, ``(n_y,)``, by Horner's rule."""
    value = ca.SX.zeros(coefficients.shape[0])
    for column in reversed(ca.horzsplit(coefficients)):
        value = (value + column) * position
    return value
