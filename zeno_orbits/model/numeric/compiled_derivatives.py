r"""The derivatives of a compiled model: variational equations and differentials at a point.

Along :math:`\dot y = f(y, q)` a perturbation obeys the variational equation

.. math:: \dot V = \frac{\partial f}{\partial y}\,V + \frac{\partial f}{\partial q}\,Q

(theory (24)). It is carried by the very steps that carry `y`: a step of DOP853 in symbols of both
together is the exact derivative of the step of `y`. Source: [HairerNorsettWanner1993]_, I.14.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import caller, explicit_attempt
from zeno_orbits.model.numeric.calls import Call
from zeno_orbits.model.numeric.compiled_flow import ModeFunctions, dense_function

N_STAGES = 7
"""Stages of the implicit steps, those of the implicit engine."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VariationFunctions:
    """The variational equation of a mode for some columns of perturbations.

    Attributes:
        step: ``(y, p, size, V, Q) -> (V after the step, its error estimate of order 5)``.
        linear: ``(states, p) -> (J, F)``, side by side, for every stage of an implicit step.
    """

    step: ca.Function
    linear: ca.Function


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


@lru_cache(maxsize=256)
def _variation_functions(
    mode: ModeFunctions, chosen: tuple[int, ...], n_columns: int
) -> VariationFunctions:
    n_y, n_p = mode.rate.size1_in(0), mode.rate.size1_in(1)
    y, p = ca.SX.sym("y", n_y), ca.SX.sym("p", n_p)
    v, q = ca.SX.sym("v", n_y, n_columns), ca.SX.sym("q", len(chosen), n_columns)
    size = ca.SX.sym("size")
    rate = mode.rate(y, p)
    jacobian = ca.jacobian(rate, y)
    by_parameters = ca.jacobian(rate, _picked(p, chosen))
    name = mode.rate.name()
    varied = ca.mtimes(jacobian, v) + ca.mtimes(by_parameters, q)
    # Dense, as the stages of both are added up in one column.
    whole = ca.densify(ca.vertcat(rate, ca.vec(varied)))
    both = ca.Function(f"{name}_varied", [ca.vertcat(y, ca.vec(v)), p, q], [whole], {"cse": True})
    after, fifth, _ = explicit_attempt(
        lambda state: both(state, p, q), ca.vertcat(y, ca.vec(v)), size
    )
    varied_after, error = (
        ca.reshape(column[n_y:], n_y, n_columns) for column in (after, size * fifth)
    )
    linear = dense_function(f"{name}_linear", [y, p], [ca.horzcat(jacobian, by_parameters)])
    return VariationFunctions(
        step=dense_function(f"{name}_varied_step", [y, p, size, v, q], [varied_after, error]),
        linear=linear.map(f"{name}_linear_stages", "serial", N_STAGES, [1], []),
    )


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


class CompiledVariation:
    """The variational equation of a flow at fixed numbers, called through preallocated memory."""

    def __init__(
        self, mode: ModeFunctions, p: Vector, chosen: tuple[int, ...], n_columns: int
    ) -> None:
        functions = _variation_functions(mode, chosen, n_columns)
        n_y = mode.rate.size1_in(0)
        self.p = p
        self._states = np.zeros((N_STAGES, n_y))
        self._pieces = np.zeros((N_STAGES, n_y + len(chosen), n_y))
        self._linear = caller(functions.linear, (self._states, p), (self._pieces,))
        # CasADi's matrices are stored by columns: here they lie on their side.
        self._y, self._size = np.zeros(n_y), np.zeros(1)
        self._v, self._q = np.zeros((n_columns, n_y)), np.zeros((n_columns, len(chosen)))
        self._after, self._error = np.zeros((n_columns, n_y)), np.zeros((n_columns, n_y))
        arguments = (self._y, p, self._size, self._v, self._q)
        self._step = caller(functions.step, arguments, (self._after, self._error))

    def step(self, y: Vector, size: float, v: Vector, q: Vector) -> tuple[Vector, float]:
        """Return the perturbations after a step, ``(n_y, m)``, and their error, relative."""
        self._y[:] = y
        self._size[0] = size
        self._v[:] = v.T
        self._q[:] = q.T
        self._step()
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
