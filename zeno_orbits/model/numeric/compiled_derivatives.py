r"""The derivatives of a compiled model: variational equations and differentials at a point.

Along :math:`\dot y = f(y, q)` a perturbation obeys the variational equation

.. math:: \dot V = \frac{\partial f}{\partial y}\,V + \frac{\partial f}{\partial q}\,Q

(theory (24)). It is carried by the very steps that carry `y`: a step of DOP853 in symbols of both
together is the exact derivative of the step of `y`. Source: [HairerNorsettWanner1993]_, I.14.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import explicit_attempt
from zeno_orbits.kernels import Kernels, KernelSource, Recipe, caller
from zeno_orbits.model.numeric.calls import Call
from zeno_orbits.model.numeric.compiled_flow import N_STAGES, ModeFunctions, dense_function, renamed


class VariationFunctions:
    """The variational equation of a mode for some columns of perturbations, built when needed."""

    def __init__(self, mode: ModeFunctions, chosen: tuple[int, ...], n_columns: int) -> None:
        """Take a mode.

        Args:
            mode: The mode.
            chosen: Places of the parameters that are perturbed.
            n_columns: Number of perturbations.
        """
        self._mode, self._chosen, self._n_columns = mode, chosen, n_columns

    @cached_property
    def step(self) -> ca.Function:
        """``(y, p, size, V, Q) -> (V after the step, its error estimate of order 5)``."""
        n_columns, chosen = self._n_columns, self._chosen
        y, p, rate, jacobian, by_parameters = self._expressions
        n_y, name, size = y.numel(), self._mode.rate.name(), ca.SX.sym("size")
        v, q = ca.SX.sym("v", n_y, n_columns), ca.SX.sym("q", len(chosen), n_columns)
        varied = ca.mtimes(jacobian, v) + ca.mtimes(by_parameters, q)
        # Dense, as the stages of both are added up in one column.
        whole = ca.densify(ca.vertcat(rate, ca.vec(varied)))
        column = ca.vertcat(y, ca.vec(v))
        both = ca.Function(f"{name}_varied", [column, p, q], [whole], {"cse": True})
        after, fifth, _ = explicit_attempt(lambda state: both(state, p, q), column, size)
        varied_after, error = (
            ca.reshape(part[n_y:], n_y, n_columns) for part in (after, size * fifth)
        )
        return dense_function(f"{name}_varied_step", [y, p, size, v, q], [varied_after, error])

    @cached_property
    def linear(self) -> ca.Function:
        """``(y, p) -> (J, F)``, side by side."""
        y, p, _, jacobian, by_parameters = self._expressions
        both = ca.horzcat(jacobian, by_parameters)
        return dense_function(f"{self._mode.rate.name()}_linear", [y, p], [both])

    @cached_property
    def linear_stages(self) -> ca.Function:
        """The same for every stage of an implicit step."""
        return self.linear.map(f"{self.linear.name()}_stages", "serial", N_STAGES, [1], [])

    @cached_property
    def kernels(self) -> Kernels:
        """The same compiled."""
        maker = f"{__name__}:{variation_kernels.__name__}"
        numbers = (self._n_columns, *self._chosen)
        functions = (self._mode.rate, self._mode.guard)
        recipe = Recipe(maker=maker, functions=functions, numbers=numbers)
        return Kernels(None if self._mode.interpreted else recipe)

    @cached_property
    def _expressions(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
        """State, parameters, rate, and its derivatives by the state and the chosen parameters."""
        y, p = ca.SX.sym("y", self._mode.n_y), ca.SX.sym("p", self._mode.n_p)
        rate = self._mode.rate(y, p)
        return y, p, rate, ca.jacobian(rate, y), ca.jacobian(rate, _picked(p, self._chosen))


def variation_kernels(functions: Sequence[ca.Function], numbers: Sequence[float]) -> KernelSource:
    """Return the source of the kernels of a variational equation.

    Args:
        functions: Rate and guard of a mode.
        numbers: Number of perturbations, then places of the parameters that are perturbed.
    """
    mode = ModeFunctions(rate=functions[0], guard=functions[1])
    n_columns, *places = map(int, numbers)
    made = VariationFunctions(mode, tuple(places), n_columns)
    return KernelSource(
        functions=[renamed(made.step, "zk_step"), renamed(made.linear, "zk_linear")]
    )


@lru_cache(maxsize=256)
def _variation_functions(
    mode: ModeFunctions, chosen: tuple[int, ...], n_columns: int
) -> VariationFunctions:
    return VariationFunctions(mode, chosen, n_columns)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointFunctions:
    """Functions of a system that are differentiated at a point, in ``(x, p)``.

    Attributes:
        contact: ``(x, p) -> (gap, gap_rate, gap_acceleration, multiplier, multiplier_rate)``.
        holonomic: ``(x, p) -> (eta, eta_rate)``.
        impulse: Its third output are the numbers of the law of impact, the restitution first.
        rebound: ``(p, approach rate) -> gap rate after the impact``.
        reset: ``(x, p, approach rate) -> x after the impact``.
        resting: ``(x, p) -> (x on the stop, its gap_acceleration, its locked flow)``.
    """

    contact: ca.Function
    holonomic: ca.Function
    impulse: ca.Function
    rebound: ca.Function
    reset: ca.Function
    resting: ca.Function


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _PointJacobians:
    contact: ca.Function
    holonomic: ca.Function
    rebound: ca.Function
    reset: ca.Function
    resting: ca.Function
    restitution: ca.Function


@lru_cache(maxsize=64)
def _point_jacobians(functions: PointFunctions, chosen: tuple[int, ...]) -> _PointJacobians:
    n_x, n_p = functions.contact.size1_in(0), functions.contact.size1_in(1)
    x, p, rate = ca.SX.sym("x", n_x), ca.SX.sym("p", n_p), ca.SX.sym("rate")
    picked = _picked(p, chosen)
    by = ca.vertcat(x, picked)

    def jacobian(name: str, expression: ca.SX) -> ca.Function:
        return dense_function(f"{name}_jacobian", [x, p], [ca.jacobian(expression, by)])

    after = functions.reset(x, p, rate)
    return _PointJacobians(
        contact=jacobian("contact", functions.contact(x, p)),
        holonomic=jacobian("holonomic", functions.holonomic(x, p)),
        reset=dense_function(
            "reset_jacobian", [x, p, rate], [ca.jacobian(after, ca.vertcat(x, rate, picked))]
        ),
        rebound=dense_function(
            "rebound_jacobian",
            [p, rate],
            [ca.jacobian(functions.rebound(p, rate), ca.vertcat(rate, picked))],
        ),
        resting=jacobian("resting", ca.vertcat(*functions.resting.call([x, p]))),
        restitution=dense_function(
            "restitution_jacobian",
            [x, p],
            [ca.jacobian(functions.impulse.call([x, p])[2][0], picked)],
        ),
    )


def _picked(p: ca.SX, chosen: tuple[int, ...]) -> ca.SX:
    return ca.vertcat(*(p[k] for k in chosen)) if chosen else ca.SX(0, 1)


_SAVED = 1e-5
"""What compiling saves in a step of state and perturbations [s], measured."""


class CompiledVariation:
    """The variational equation of a flow at fixed numbers, called through preallocated memory."""

    def __init__(
        self, mode: ModeFunctions, p: Vector, chosen: tuple[int, ...], n_columns: int
    ) -> None:
        functions = _variation_functions(mode, chosen, n_columns)
        n_y = mode.n_y
        self.p = p
        self._states = np.zeros((N_STAGES, n_y))
        # CasADi's matrices are stored by columns: here they lie on their side.
        self._pieces = np.zeros((N_STAGES, n_y + len(chosen), n_y))
        self._y, self._size = np.zeros(n_y), np.zeros(1)
        self._v, self._q = np.zeros((n_columns, n_y)), np.zeros((n_columns, len(chosen)))
        self._after, self._error = np.zeros((n_columns, n_y)), np.zeros((n_columns, n_y))
        self._owe = functions.kernels.owe
        step = (self._y, p, self._size, self._v, self._q), (self._after, self._error)
        linear = (self._states, p), (self._pieces,)
        library = functions.kernels.library()
        if library is None:
            self._saved = _SAVED
            with functions.kernels.owing():
                self._step = caller(functions.step, *step)
                self._linear = caller(functions.linear_stages, *linear)
        else:
            self._saved = 0.0
            self._step = library.caller("zk_step", *step)
            rows = library.rows("zk_linear", (n_y, 0), (self._pieces[0].size,))
            self._linear = partial(rows, N_STAGES, linear[0], self._pieces)

    def step(self, y: Vector, size: float, v: Vector, q: Vector) -> tuple[Vector, float]:
        """Return the perturbations after a step, ``(n_y, m)``, and their error, relative."""
        self._y[:] = y
        self._size[0] = size
        self._v[:] = v.T
        self._q[:] = q.T
        self._step()
        self._owe(self._saved)
        # NaN where a column vanishes, which has no error.
        with np.errstate(invalid="ignore"):
            errors = np.abs(self._error).max(axis=1) / np.abs(self._after).max(axis=1)
        return self._after.T.copy(), float(np.fmax.reduce(errors, initial=0.0))

    def linear(self, states: Vector) -> Vector:
        """Return ``(J, F)`` side by side at every state, ``(N_STAGES, n_y, n_y + n_q)``."""
        self._states[:] = states
        self._linear()
        return self._pieces.transpose(0, 2, 1)


class CompiledDifferentials:
    """The derivatives of a compiled system at fixed numbers, by chosen parameters."""

    def __init__(
        self,
        modes: tuple[ModeFunctions, ModeFunctions, ModeFunctions],
        functions: PointFunctions,
        p: Vector,
        chosen: tuple[int, ...],
    ) -> None:
        self._modes, self._p, self._chosen = modes, p, chosen
        self._n_x = functions.contact.size1_in(0)
        jacobians = _point_jacobians(functions, chosen)
        self._contact = Call(jacobians.contact, p)
        self._holonomic = Call(jacobians.holonomic, p)
        self._resting = Call(jacobians.resting, p)
        self._restitution = Call(jacobians.restitution, p)
        self._x, self._rate = np.zeros(self._n_x), np.zeros(1)
        self._after = np.zeros(jacobians.reset.numel_out(0))
        self._reset = caller(jacobians.reset, (self._x, p, self._rate), (self._after,))

        self._speeds = np.zeros(1 + len(chosen))
        self._rebound = caller(jacobians.rebound, (p, self._rate), (self._speeds,))

    @property
    def _n_columns(self) -> int:
        return self._n_x + len(self._chosen)

    @property
    def free(self) -> CompiledVariation:
        """Of the flow off the stop."""
        return self._free

    @property
    def locked(self) -> CompiledVariation:
        """Of the flow on the stop."""
        return self._locked

    @cached_property
    def _free(self) -> CompiledVariation:
        return CompiledVariation(self._modes[0], self._p, self._chosen, self._n_columns)

    @cached_property
    def _locked(self) -> CompiledVariation:
        return CompiledVariation(self._modes[1], self._p, self._chosen, self._n_columns)

    @cached_property
    def _flight(self) -> CompiledVariation:
        chosen = (*self._chosen, self._p.size)
        return CompiledVariation(self._modes[2], np.append(self._p, 1.0), chosen, self._n_columns)

    def flight(self, speed: float) -> CompiledVariation:
        """Of a rescaled flight, valid until the next flight is asked for."""
        self._flight.p[-1] = speed
        return self._flight

    def contact(self, x: Vector) -> Vector:
        """Of gap, its rate and acceleration, multiplier and its rate, ``(5, n_x + k)``."""
        return _matrix(self._contact(x), (5, self._n_columns))

    def holonomic(self, x: Vector) -> Vector:
        """Of the holonomic rows, ``(2 n_eta, n_x + k)``."""
        return _matrix(self._holonomic(x), (-1, self._n_columns))

    def reset(self, x: Vector, approach_rate: float) -> Vector:
        """Of the reset map by state, approach rate and parameters, ``(n_x, n_x + 1 + k)``."""
        self._x[:] = x
        self._rate[0] = approach_rate
        self._reset()
        return _matrix(self._after, (self._n_x, self._n_columns + 1))

    def speed_after(self, approach_rate: float) -> Vector:
        """Of the gap rate after an impact by that before it, and by parameters, ``(1 + k,)``."""
        self._rate[0] = approach_rate
        self._rebound()
        return self._speeds.copy()

    def resting(self, x: Vector) -> Vector:
        """Of the state on the stop, its gap acceleration and locked flow, as rows."""
        return _matrix(self._resting(x), (2 * self._n_x + 1, self._n_columns))

    @property
    def restitution(self) -> Vector:
        """Of the restitution by the parameters alone, ``(k,)``."""
        return self._restitution(np.zeros(self._n_x)).copy()


def _matrix(flat: Vector, shape: tuple[int, int]) -> Vector:
    if shape[0] < 0:
        shape = (flat.size // shape[1], shape[1])
    return flat.reshape(shape, order="F").copy()
