"""A problem as functions of many rows: steps of its modes, resets, and the rest on the stop.

A CasADi function for many rows at once: what each row gets does not depend on the others.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import fall_source, overflow, rosenbrock_step
from zeno_orbits.kernels import Kernels, KernelSource, Recipe, address_of
from zeno_orbits.model import (
    USUAL,
    CompiledSystem,
    ModeFunctions,
    OwnScale,
    Problem,
    dense_function,
    renamed,
)


class BatchFlow:
    """A mode for many rows ``(y, p)``."""

    def __init__(self, mode: ModeFunctions, absolute: float, kernels: Kernels) -> None:
        """Take the functions of a mode.

        Args:
            mode: The mode.
            absolute: Absolute over relative local error.
            kernels: Of the whole model.
        """
        self.n_y = mode.n_y
        name = mode.rate.name()
        self._rate = Columns(mode.rate, kernels, f"zk_{name}")
        self._guard = Columns(mode.guard, kernels, f"zk_{mode.guard.name()}")
        self._step = Columns(_step_function(mode, absolute), kernels, f"zk_{name}_step")
        self._kernels, self._kernel = kernels, f"zk_{name}_step"

    def rate(self, y: Vector, p: Vector) -> Vector:
        """Return ``dy/dt``, ``(n, n_y)``."""
        return self._rate(y, p)[0]

    def guard(self, y: Vector, p: Vector) -> Vector:
        """Return the guard and its time derivative, ``(n, 2)``."""
        return self._guard(y, p)[0]

    def attempt(
        self, y: Vector, p: Vector, size: Vector, tolerance: Vector
    ) -> tuple[Vector, Vector, Vector]:
        """Return the states after a step, ``(n, n_y)``, errors, ``(n,)``, and guards, ``(n, 2)``.

        Args:
            y: States before it, ``(n, n_y)``.
            p: Parameters, ``(n, n_p)``.
            size: Step sizes, ``(n,)``.
            tolerance: Local errors allowed relative to ``absolute + |y|``, ``(n,)``.
        """
        numbers = np.empty((len(y), 2))
        numbers[:, 0], numbers[:, 1] = size, tolerance
        after, error, guard = self._step(y, p, numbers)
        return after, error[:, 0], guard

    def falls(self, y: Vector, p: Vector, numbers: Vector) -> Vector | None:
        """Return what `first_falls` does, ``(n,)``, from compiled code, if there is any by now.

        Args:
            y: States before the steps, ``(n, n_y)``.
            p: Parameters, ``(n, n_p)``.
            numbers: Size, tolerance, 1 on the guard, then guard and rate at the start and at the
                end, ``(n, 7)``.
        """
        library = self._kernels.library()
        if library is None:
            return None
        falls = np.empty(len(y))
        # Kept by name until the call is over.
        kept = (*map(np.ascontiguousarray, (y, p, numbers)), np.empty(self.n_y), falls)
        sizes = [ctypes.c_longlong(size) for size in (len(y), self.n_y, p.shape[1])]
        places = [ctypes.c_void_p(address_of(array)) for array in kept]
        library.function("zk_falls")(library.address(self._kernel), *sizes, *places)
        return falls


def _step_function(mode: ModeFunctions, absolute: float) -> ca.Function:
    y = ca.SX.sym("y", mode.rate.size1_in(0))
    p = ca.SX.sym("p", mode.rate.size1_in(1))
    numbers = ca.SX.sym("numbers", 2)
    size, tolerance = ca.vertsplit(numbers)
    after, miss = rosenbrock_step(lambda state: mode.rate(state, p), mode.jacobian(y, p), y, size)
    scale = tolerance * (mode.weighed(absolute) + ca.fmax(ca.fabs(y), ca.fabs(after)))
    error = ca.sqrt(ca.sumsqr(miss / scale) / y.numel()) + overflow(ca.sum1(after), ca)
    name = f"{mode.rate.name()}_rosenbrock"
    return dense_function(name, [y, p, numbers], [after, error, mode.guard(after, p)])


ABSOLUTE = 0.1
"""Absolute over relative local error, as `Tolerance` has it by default."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchModel:
    """A problem for many rows.

    Attributes:
        state_names: Name of each state.
        n_q: Number of coordinates.
        clock: Places of the clock in the state; empty where nothing is forced.
        n_p: Number of gains and parameters.
        free: The mode off the stop.
        locked: The mode on the stop.
        flight: The rescaled flight; its last parameter is the speed (theory (14)).
        contact: ``(x, p) -> (gap, gap_rate, gap_acceleration, multiplier, multiplier_rate)``.
        restitution: ``(x, p) -> restitution``.
        rebound: ``(p, approach rate) -> gap rate after the impact``.
        reset: ``(x, p, approach rate) -> x`` after the impact.
        resting: ``(x, p) -> (x on the stop, its gap_acceleration, its locked flow)``.
        own: Sizes of the problem's numbers.
    """

    state_names: tuple[str, ...]
    n_q: int
    clock: tuple[int, ...]
    n_p: int
    free: BatchFlow
    locked: BatchFlow
    flight: BatchFlow
    contact: Columns
    restitution: Columns
    rebound: Columns
    reset: Columns
    resting: Columns
    own: OwnScale

    @property
    def absolute(self) -> float:
        """Absolute over relative local error."""
        return ABSOLUTE * self.own.least

    @property
    def n_x(self) -> int:
        """Number of states."""
        return len(self.state_names)

    @property
    def moving(self) -> list[int]:
        """Places of all states but the clock: of those that stand still where a motion rests."""
        return [k for k in range(self.n_x) if k not in self.clock]


def batch_model(compiled: CompiledSystem, own: OwnScale = USUAL) -> BatchModel:
    """Return the functions of a compiled problem for many rows.

    Args:
        compiled: The problem.
        own: Sizes of its numbers.
    """
    absolute = ABSOLUTE * own.least
    n_p = compiled.contact.size1_in(1)
    free, locked, flight = modes = compiled.weighted(own)
    weights = own.flight_weights(compiled.n_x)
    functions = (
        *(function for mode in modes for function in (mode.rate, mode.guard)),
        *(compiled.contact, _restitution(compiled), compiled.rebound),
        *(compiled.reset, compiled.resting),
    )
    maker = f"{__name__}:{batch_kernels.__name__}"
    interpreted = compiled.free.interpreted
    recipe = Recipe(maker=maker, functions=functions, numbers=(absolute, *weights))
    kernels = Kernels(None if interpreted else recipe)
    contact, restitution, rebound, reset, resting = (
        Columns(function, kernels, f"zk_{function.name()}") for function in functions[-5:]
    )
    return BatchModel(
        state_names=compiled.state_names,
        n_q=compiled.n_q,
        clock=compiled.clock,
        n_p=n_p,
        free=BatchFlow(free, absolute, kernels),
        locked=BatchFlow(locked, absolute, kernels),
        flight=BatchFlow(flight, absolute, kernels),
        contact=contact,
        restitution=restitution,
        rebound=rebound,
        reset=reset,
        resting=resting,
        own=own,
    )


def _restitution(compiled: CompiledSystem) -> ca.Function:
    x, p = ca.SX.sym("x", compiled.n_x), ca.SX.sym("p", compiled.contact.size1_in(1))
    return dense_function("restitution", [x, p], [compiled.impulse(x, p)[2][0]])


def batch_kernels(functions: Sequence[ca.Function], numbers: Sequence[float]) -> KernelSource:
    """Return the source of the kernels of a model for many rows.

    Args:
        functions: Rate and guard of every mode, then what holds at a point.
        numbers: Absolute over relative local error, and the weights of a rescaled flight.
    """
    absolute, *weights = numbers
    pairs = zip(functions[:6:2], functions[1:6:2], strict=True)
    modes = [
        ModeFunctions(rate=rate, guard=guard, weights=tuple(weights[: rate.size1_in(0)]))
        for rate, guard in pairs
    ]
    named = {function.name(): function for function in functions}
    named |= {f"{mode.rate.name()}_step": _step_function(mode, absolute) for mode in modes}
    code = Path(__file__).with_name("falls.c").read_text(encoding="utf-8")
    functions = [renamed(one, f"zk_{name}") for name, one in named.items()]
    return KernelSource(functions=functions, code=fall_source() + code)


@lru_cache(maxsize=4)
def model_in_rows(problem: Problem, own: OwnScale = USUAL) -> BatchModel:
    """Return the functions of a problem for many rows, built once for each scale."""
    return batch_model(problem.compiled(), own)


_LARGEST = 8
"""Rows of the widest mapped function, as a power of two; more take several calls."""
_FEW = 16
"""Rows of a block that costs hardly more than its call."""


_SAVED = 1.2e-9
"""What compiling an instruction saves each time that it is carried out [s], measured."""


class Columns:
    """A function called for `n` rows: compiled, or through blocks of 256, 128, ... 1 rows.

    Each row goes through the same instructions, so its result is the same to the last bit in
    whatever company.
    """

    def __init__(
        self, function: ca.Function, kernels: Kernels | None = None, kernel: str = ""
    ) -> None:
        """Take a function.

        Args:
            function: The function.
            kernels: Where it is compiled, perhaps.
            kernel: Its name there.
        """
        self._function = function
        self._widths_in = [function.numel_in(k) for k in range(function.n_in())]
        self._widths_out = [function.numel_out(k) for k in range(function.n_out())]
        self._ends = [0, *accumulate(self._widths_out)]
        self._blocks: dict[int, Any] = {}
        self._kernels, self._kernel = kernels, kernel
        self._compiled: Callable[[int, Sequence[Vector], Vector], None] | None = None
        self._saved = _SAVED * function.n_instructions()

    def __call__(self, *inputs: Vector) -> tuple[Vector, ...]:
        """Return one array ``(n, n_out)`` an output.

        Args:
            inputs: One array ``(n, n_in)`` an input.
        """
        if self._kernels is not None and self._compiled is None:
            library = self._kernels.library()
            if library is None:
                self._kernels.owe(len(inputs[0]) * self._saved)
            else:
                self._compiled = library.rows(self._kernel, self._widths_in, self._widths_out)
        if self._compiled is None:
            return self._interpreted(*inputs)
        n = len(inputs[0])
        given = [np.ascontiguousarray(array, dtype=np.float64) for array in inputs]
        results = np.empty((n, self._ends[-1]))
        self._compiled(n, given, results)
        return tuple([results[:, start:end] for start, end in pairwise(self._ends)])

    def _interpreted(self, *inputs: Vector) -> tuple[Vector, ...]:
        n = len(inputs[0])
        padded = _padded(n)
        given = [_filled(array, padded) for array in inputs]
        results = [np.empty((padded, width)) for width in self._widths_out]
        start, power = 0, _LARGEST
        while start < padded:
            while (1 << power) > padded - start:
                power -= 1
            stop = start + (1 << power)
            buffer, evaluate = self._block(power)
            for k, array in enumerate(given):
                buffer.set_arg(k, memoryview(array[start:stop].reshape(-1).data))
            for k, array in enumerate(results):
                buffer.set_res(k, memoryview(array[start:stop].reshape(-1).data))
            evaluate()
            start = stop
        return tuple(result[:n] for result in results)

    def _block(self, power: int) -> tuple[Any, Any]:
        if power not in self._blocks:
            mapped = self._function if power == 0 else self._function.map(1 << power, "serial")
            self._blocks[power] = mapped.buffer()
        return self._blocks[power]


def _padded(n: int) -> int:
    """Return a number of rows not below `n` that takes few blocks: a block costs some rows."""
    if n <= _FEW:
        return 1 << max(n - 1, 0).bit_length() if n else 0
    return -(-n // _FEW) * _FEW


def _filled(array: Vector, n: int) -> Vector:
    """Return the rows in one piece, the last one repeated up to `n`."""
    if len(array) == n:
        return np.ascontiguousarray(array)
    filled = np.empty((n, *array.shape[1:]))
    filled[: len(array)], filled[len(array) :] = array, array[-1]
    return filled
