"""A mode of a scene as functions, and as a flow at fixed numbers: what the engines ask of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from zeno_orbits.calls import Call, StepCall, caller
from zeno_orbits.collocation import Collocation
from zeno_orbits.dynamics import NewtonPieces, Tolerance, Vector
from zeno_orbits.implicit import implicit_expressions
from zeno_orbits.runge_kutta import error_norm, explicit_attempt, overflow


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModeFunctions:
    """A flow and its guard as functions of ``(y, p)``, and a whole DOP853 step of the flow.

    Attributes:
        rate: ``(y, p) -> dy/dt``.
        jacobian: ``(y, p) -> d(dy/dt)/dy``.
        guard: ``(y, p) -> (guard, its time derivative)``.
        step: ``(y, p, (size, relative, absolute)) -> (y after, error in units of the tolerance)``.
    """

    rate: ca.Function
    jacobian: ca.Function
    guard: ca.Function
    step: ca.Function


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NewtonFunctions:
    """The pieces of an implicit step as functions; ``numbers`` are ``(size, relative, absolute)``.

    Attributes:
        factorize: ``(y, p, numbers) -> factors`` of Newton's matrices.
        correct: ``(y, p, numbers, factors, stages) -> (stages, size of the correction)``.
        error: ``(y, p, numbers, factors, stages) -> error in units of the tolerance``.
    """

    factorize: ca.Function
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
    field = dense_function(f"{name}_rate", [y, p], [rate])
    numbers = ca.SX.sym("numbers", 3)
    size, relative, absolute = ca.vertsplit(numbers)
    after, fifth, third = explicit_attempt(lambda state: field(state, p), y, size)
    scale = absolute + relative * ca.fmax(ca.fabs(y), ca.fabs(after))
    error = overflow(ca.sum1(after), ca) + error_norm(
        ca.sumsqr(fifth / scale), ca.sumsqr(third / scale), ca.fabs(size), y.numel(), ca
    )
    return ModeFunctions(
        rate=field,
        jacobian=dense_function(f"{name}_jacobian", [y, p], [ca.jacobian(rate, y)]),
        guard=dense_function(f"{name}_guard", [y, p], [guard]),
        step=dense_function(f"{name}_step", [y, p, numbers], [after, error]),
    )


def dense_function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    """Return a function with dense outputs: a buffer receives the stored entries only.

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


class CompiledFlow:
    """A guarded flow whose step is one CasADi call through preallocated memory.

    Memory is made at the first call: an engine that has its own code needs none of it.
    """

    def __init__(self, mode: ModeFunctions, p: Vector) -> None:
        self.mode = mode
        self.p = p
        self._newton: tuple[Collocation, CompiledNewton] | None = None

    @cached_property
    def _rate(self) -> Call:
        return Call(self.mode.rate, self.p)

    @cached_property
    def _guard(self) -> Call:
        return Call(self.mode.guard, self.p)

    @cached_property
    def _step(self) -> StepCall:
        return StepCall(self.mode.step, self.p)

    def rate(self, y: Vector) -> Vector:
        """Return ``dy/dt``."""
        return self._rate(y).copy()

    def guard(self, y: Vector) -> tuple[float, float]:
        """Return the guard and its time derivative along the flow."""
        value, rate = self._guard(y).tolist()
        return value, rate

    def attempt(self, y: Vector, size: float, tolerance: Tolerance) -> tuple[Vector, float]:
        """Return the state after one step of DOP853 and its error, in units of the tolerance."""
        return self._step(y, size, tolerance)

    def jacobian(self, y: Vector) -> Vector:
        """Return the derivative of the rate, ``(n_y, n_y)``."""
        return Call(self.mode.jacobian, self.p)(y).reshape(y.size, y.size, order="F")

    def newton(self, scheme: Collocation) -> NewtonPieces:
        """Return the iteration for an implicit step of a collocation scheme."""
        if self._newton is None or self._newton[0] is not scheme:
            functions = _newton_functions(self.mode, scheme)
            self._newton = (scheme, CompiledNewton(functions, self.p, scheme.n_stages))
        return self._newton[1]


class CompiledNewton:
    """Newton's iteration for an implicit step, each piece one CasADi call."""

    def __init__(self, functions: NewtonFunctions, p: Vector, n_stages: int) -> None:
        n_y = functions.factorize.size1_in(0)
        self._shape = (n_stages, n_y)
        self._y = np.zeros(n_y)
        self._numbers = np.zeros(3)
        self._factors = np.zeros(functions.factorize.numel_out(0))
        self._stages = np.zeros(self._shape)
        self._corrected = np.zeros(self._shape)
        self._size = np.zeros(1)
        self._error = np.zeros(1)
        step = (self._y, p, self._numbers)
        iterate = (*step, self._factors, self._stages)
        self._factorize = caller(functions.factorize, step, (self._factors,))
        self._correct = caller(functions.correct, iterate, (self._corrected, self._size))
        self._estimate = caller(functions.error, iterate, (self._error,))

    def begin(self, y: Vector, size: float, guess: Vector | None) -> Vector:
        """Factorize for a step and return the stage increments to start from."""
        self._y[:] = y
        self._numbers[0] = size
        self._factorize()
        return np.zeros(self._shape) if guess is None else guess

    def correct(self, stages: Vector, tolerance: Tolerance) -> tuple[Vector, float]:
        """Return the stage increments after one iteration and the size of its correction."""
        self._stages[:] = stages
        self._numbers[1:] = (tolerance.relative, tolerance.absolute)
        self._correct()
        return self._corrected.copy(), self._size.item()

    def error(self, stages: Vector, tolerance: Tolerance) -> float:
        """Return the error of the step, in units of the tolerance."""
        self._stages[:] = stages
        self._numbers[1:] = (tolerance.relative, tolerance.absolute)
        self._estimate()
        return self._error.item()


@lru_cache(maxsize=64)
def _newton_functions(mode: ModeFunctions, scheme: Collocation) -> NewtonFunctions:
    """Build the pieces of an implicit step; only a scene that turns out stiff needs them."""
    p = ca.SX.sym("p", mode.rate.size1_in(1))
    pieces = implicit_expressions(mode.rate, p, scheme)
    numbers = ca.SX.sym("numbers", 3)
    size, relative, absolute = ca.vertsplit(numbers)
    scale = absolute + relative * ca.fabs(pieces.y)

    def norm(change: ca.SX) -> ca.SX:
        columns = ca.repmat(scale, 1, change.shape[1])
        return ca.sqrt(ca.sumsqr(change / columns) / change.numel())

    def function(name: str, inputs: list[ca.SX], *outputs: ca.SX) -> ca.Function:
        sized = ca.substitute([*outputs], [pieces.size], [size])
        return dense_function(f"{mode.rate.name()}_{name}", [pieces.y, p, numbers, *inputs], sized)

    iterate = [pieces.factors, pieces.stages]
    return NewtonFunctions(
        factorize=function("factorize", [], pieces.factorized),
        correct=function(
            "correct", iterate, pieces.stages + pieces.correction, norm(pieces.correction)
        ),
        error=function(
            "error",
            iterate,
            norm(pieces.error) + overflow(ca.sum1(pieces.y + pieces.stages[:, -1]), ca),
        ),
    )
