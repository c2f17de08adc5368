"""From expressions to numbers: the only place that makes ``ca.Function`` of a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.collocation import Collocation
from zeno_orbits.dynamics import (
    FusedResting,
    GuardedFlow,
    HybridDynamics,
    NewtonPieces,
    Resting,
    Tolerance,
    Vector,
)
from zeno_orbits.hybrid import CompletedSystem
from zeno_orbits.implicit import implicit_expressions
from zeno_orbits.problem import Problem
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


@dataclass(frozen=True, slots=True, kw_only=True)
class CompiledSystem:
    """The functions of a completed system in ``(x, p)``; ``p`` holds gains, then parameters.

    Attributes:
        state_names: Name of each state.
        n_q: Number of coordinates.
        free: The mode off the stop, in ``(x, p)``.
        locked: The mode on the stop, in ``(x, p)``.
        flight: The rescaled flight, in ``((x, h / w^2, (dh/dt) / w), (p, w))`` (theory (14)).
        contact: ``(x, p) -> (gap, gap_rate, gap_acceleration, multiplier, multiplier_rate)``.
        impulse: ``(x, p) -> (impulse_direction, normal_inertia, restitution)``.
        reset: ``(x, p, approach rate) -> x after the impact``.
        resting: ``(x, p) -> (x on the stop, its gap_acceleration, its locked flow)``.
        powers: ``(x, p) -> (input_power, copper_loss, other_loss)`` [W].
        energy: ``(x, p) -> energy`` [J].
        holonomic: ``(x, p) -> (eta, eta_rate)``.
    """

    state_names: tuple[str, ...]
    n_q: int
    free: ModeFunctions
    locked: ModeFunctions
    flight: ModeFunctions
    contact: ca.Function
    impulse: ca.Function
    reset: ca.Function
    resting: ca.Function
    powers: ca.Function
    energy: ca.Function
    holonomic: ca.Function

    @property
    def n_x(self) -> int:
        """Number of states."""
        return len(self.state_names)


def compile_problem(
    problem: Problem, transform: Callable[[CompletedSystem], CompletedSystem] | None = None
) -> CompiledSystem:
    """Build the functions of a scene.

    Args:
        problem: The scene.
        transform: A change of the completed system first, ``hybrid.audited`` for instance, which
            may append states.
    """
    symbols = problem.symbols()
    system = problem.model(symbols)
    names = problem.state_names
    if transform is not None:
        system = transform(system)
        extra = system.state.numel() - len(names)
        names = (*names, *(f"ledger{k}" for k in range(extra)))
    return compile_system(system, symbols, names)


def compile_system(
    system: CompletedSystem, symbols: Mapping[str, ca.SX], state_names: Sequence[str]
) -> CompiledSystem:
    """Build the functions of a completed system.

    Args:
        system: The completed system.
        symbols: Its named parameters, in the order of ``p``.
        state_names: One name a state.

    Raises:
        ValueError: If the names do not fit the states, or an expression holds another symbol.
    """
    if system.state.numel() != len(state_names):
        message = (
            f"Argument `state_names` must name {system.state.numel()} states, "
            f"but it names {len(state_names)}."
        )
        raise ValueError(message)
    parameters = ca.vertcat(*symbols.values())
    contact = ca.vertcat(
        system.gap,
        system.gap_rate,
        system.gap_acceleration,
        system.multiplier,
        system.multiplier_rate,
    )
    powers = ca.vertcat(system.input_power, system.copper_loss, system.other_loss)

    def function(name: str, *outputs: ca.SX) -> ca.Function:
        return _function(name, [system.state, parameters], list(outputs))

    scaled_gap, speed = ca.SX.sym("eta", 2), ca.SX.sym("w")
    flight_rate = ca.vertcat(speed * system.free_flow, scaled_gap[1], system.gap_acceleration)
    return CompiledSystem(
        state_names=tuple(state_names),
        n_q=system.n_q,
        free=_mode("free", system.state, parameters, system.free_flow, contact[0:2]),
        locked=_mode("locked", system.state, parameters, system.locked_flow, contact[3:5]),
        flight=_mode(
            "flight",
            ca.vertcat(system.state, scaled_gap),
            ca.vertcat(parameters, speed),
            flight_rate,
            scaled_gap,
        ),
        contact=function("contact", contact),
        impulse=function(
            "impulse", system.impulse_direction, system.normal_inertia, system.restitution
        ),
        reset=_function("reset", [system.state, parameters, speed], [_reset(system, speed)]),
        resting=function("resting", *_resting(system)),
        powers=function("powers", powers),
        energy=function("energy", system.energy),
        holonomic=function("holonomic", system.holonomic),
    )


def _reset(system: CompletedSystem, approach_rate: ca.SX) -> ca.SX:
    """Return the state after an impact: Newton's law along the impulse, theory (7).

    The rate is given, and exact where the state holds only rounding.
    """
    change = (1 + system.restitution) * approach_rate * system.impulse_direction
    return system.state - change


def _resting(system: CompletedSystem) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the state moved onto the stop as by ``HybridDynamics.on_stop``, and its rates."""
    x, n_q, direction = system.state, system.n_q, system.impulse_direction
    moved = ca.vertcat(x[:n_q] - system.gap * direction[n_q : 2 * n_q], x[n_q:])
    rate, direction = ca.substitute([system.gap_rate, direction], [x], [moved])
    resting = moved - rate * direction
    flows = [system.gap_acceleration, system.locked_flow]
    acceleration, locked = ca.substitute(flows, [x], [resting])
    return resting, acceleration, locked


def bind(compiled: CompiledSystem, values: Sequence[float]) -> HybridDynamics:
    """Return the system at fixed numbers for gains and parameters.

    Args:
        compiled: The functions.
        values: ``p``, gains then parameters.
    """
    p = np.asarray(values, dtype=np.float64)
    contact = _Call(compiled.contact, p)
    impulse = _Call(compiled.impulse, p)
    energy = _Call(compiled.energy, p)
    holonomic = _Call(compiled.holonomic, p)

    def flight(speed: float) -> GuardedFlow:
        numbers = np.empty(p.size + 1)
        numbers[:-1], numbers[-1] = p, speed
        return CompiledFlow(compiled.flight, numbers)

    plain = HybridDynamics(
        state_names=compiled.state_names,
        n_q=compiled.n_q,
        restitution=float(impulse(np.zeros(compiled.n_x), 2)[0]),
        free=CompiledFlow(compiled.free, p),
        locked=CompiledFlow(compiled.locked, p),
        flight=flight,
        gap=lambda x: float(contact(x)[0]),
        gap_rate=lambda x: float(contact(x)[1]),
        gap_acceleration=lambda x: float(contact(x)[2]),
        multiplier=lambda x: float(contact(x)[3]),
        multiplier_rate=lambda x: float(contact(x)[4]),
        reset_map=_ResetCall(compiled.reset, p),
        impulse_direction=lambda x: impulse(x, 0).copy(),
        normal_inertia=lambda x: float(impulse(x, 1)[0]),
        energy=lambda x: float(energy(x)[0]),
        holonomic=lambda x: holonomic(x).copy(),
    )
    at_rest = FusedResting(evaluate=_RestingCall(compiled.resting, p), parts=plain.resting_parts)
    return replace(plain, fused_resting=at_rest)


class CompiledFlow:
    """A guarded flow whose step is one CasADi call through preallocated memory.

    Memory is made at the first call: an engine that has its own code needs none of it.
    """

    def __init__(self, mode: ModeFunctions, p: Vector) -> None:
        self.mode = mode
        self.p = p
        self._newton: tuple[Collocation, CompiledNewton] | None = None

    @cached_property
    def _rate(self) -> _Call:
        return _Call(self.mode.rate, self.p)

    @cached_property
    def _guard(self) -> _Call:
        return _Call(self.mode.guard, self.p)

    @cached_property
    def _step(self) -> _StepCall:
        return _StepCall(self.mode.step, self.p)

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
        return _Call(self.mode.jacobian, self.p)(y).reshape(y.size, y.size, order="F")

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
        self._factorize = _caller(functions.factorize, step, (self._factors,))
        self._correct = _caller(functions.correct, iterate, (self._corrected, self._size))
        self._estimate = _caller(functions.error, iterate, (self._error,))

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
        return _function(f"{mode.rate.name()}_{name}", [pieces.y, p, numbers, *inputs], sized)

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


def _mode(name: str, y: ca.SX, p: ca.SX, rate: ca.SX, guard: ca.SX) -> ModeFunctions:
    field = _function(f"{name}_rate", [y, p], [rate])
    numbers = ca.SX.sym("numbers", 3)
    size, relative, absolute = ca.vertsplit(numbers)
    after, fifth, third = explicit_attempt(lambda state: field(state, p), y, size)
    scale = absolute + relative * ca.fmax(ca.fabs(y), ca.fabs(after))
    error = overflow(ca.sum1(after), ca) + error_norm(
        ca.sumsqr(fifth / scale), ca.sumsqr(third / scale), ca.fabs(size), y.numel(), ca
    )
    return ModeFunctions(
        rate=field,
        jacobian=_function(f"{name}_jacobian", [y, p], [ca.jacobian(rate, y)]),
        guard=_function(f"{name}_guard", [y, p], [guard]),
        step=_function(f"{name}_step", [y, p, numbers], [after, error]),
    )


def _function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
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


class _Call:
    """A function of ``(x, p)`` at fixed ``p``, called through preallocated memory."""

    def __init__(self, function: ca.Function, p: Vector) -> None:
        self._x = np.zeros(function.size1_in(0))
        self._results = [np.zeros(function.numel_out(k)) for k in range(function.n_out())]
        self._evaluate = _caller(function, (self._x, p), self._results)

    def __call__(self, x: Vector, output: int = 0) -> Vector:
        self._x[:] = x
        self._evaluate()
        return self._results[output]


class _StepCall:
    """A step of a flow at fixed ``p``, called through preallocated memory."""

    def __init__(self, function: ca.Function, p: Vector) -> None:
        self._y = np.zeros(function.size1_in(0))
        self._numbers = np.zeros(3)
        self._after = np.zeros_like(self._y)
        self._error = np.zeros(1)
        results = (self._after, self._error)
        self._evaluate = _caller(function, (self._y, p, self._numbers), results)

    def __call__(self, y: Vector, size: float, tolerance: Tolerance) -> tuple[Vector, float]:
        self._y[:] = y
        self._numbers[:] = (size, tolerance.relative, tolerance.absolute)
        self._evaluate()
        return self._after.copy(), self._error.item()


class _ResetCall:
    """The reset map at fixed ``p``, called through preallocated memory."""

    def __init__(self, function: ca.Function, p: Vector) -> None:
        self._x = np.zeros(function.size1_in(0))
        self._rate = np.zeros(1)
        self._after = np.zeros_like(self._x)
        self._evaluate = _caller(function, (self._x, p, self._rate), (self._after,))

    def __call__(self, x: Vector, approach_rate: float) -> Vector:
        self._x[:] = x
        self._rate[0] = approach_rate
        self._evaluate()
        return self._after.copy()


class _RestingCall:
    """The rest of a state on the stop at fixed ``p``, called through preallocated memory."""

    def __init__(self, function: ca.Function, p: Vector) -> None:
        self._x = np.zeros(function.size1_in(0))
        self._state = np.zeros_like(self._x)
        self._acceleration = np.zeros(1)
        self._rate = np.zeros_like(self._x)
        results = (self._state, self._acceleration, self._rate)
        self._evaluate = _caller(function, (self._x, p), results)

    def __call__(self, x: Vector) -> Resting:
        self._x[:] = x
        self._evaluate()
        return Resting(
            state=self._state.copy(),
            gap_acceleration=self._acceleration.item(),
            rate=self._rate.copy(),
        )


def _caller(
    function: ca.Function, arguments: Sequence[Vector], results: Sequence[Vector]
) -> Callable[[], None]:
    """Return a call without arguments that reads and writes the given arrays in place."""
    # CasADi's stubs ask for a size that the call takes from the memory itself.
    buffer: Any
    buffer, evaluate = function.buffer()
    for k, argument in enumerate(arguments):
        buffer.set_arg(k, memoryview(argument.data))
    for k, result in enumerate(results):
        buffer.set_res(k, memoryview(result.data))

    def call(_kept: Any = (buffer, *arguments, *results)) -> None:
        # The default keeps buffer and arrays alive: the trigger knows their bare addresses only.
        evaluate()

    return call
