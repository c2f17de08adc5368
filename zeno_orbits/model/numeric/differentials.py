"""Derivatives of a compiled model: its differentiated functions, and their values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model.numeric.calls import Call
from zeno_orbits.model.numeric.casadi_calls import caller
from zeno_orbits.model.numeric.columns import Columns
from zeno_orbits.model.numeric.compiled_flow import dense_function
from zeno_orbits.model.numeric.derivatives import DerivativeFormulas, LinearFormula


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DifferentiableFunctions:
    """Functions of a system that are differentiated, in ``(x, p)``.

    Attributes:
        rates: ``dy/dt`` of the free and the constrained mode and of a rescaled flight.
        contact: ``(x, p) -> (gap, gap_rate, gap_acceleration, multiplier, multiplier_rate)``.
        holonomic: ``(x, p) -> (eta, eta_rate)``.
        impulse: Function whose third output holds the restitution of the slowest impacts first.
        rebound: ``(p, approach rate) -> gap rate after the impact``.
        reset: ``(x, p, approach rate) -> x after the impact``.
        resting: ``(x, p) -> (x on the stop, its gap_acceleration, its constrained flow)``.
    """

    rates: tuple[ca.Function, ca.Function, ca.Function]
    contact: ca.Function
    holonomic: ca.Function
    impulse: ca.Function
    rebound: ca.Function
    reset: ca.Function
    resting: ca.Function


@lru_cache(maxsize=64)
def derivative_formulas(
    functions: DifferentiableFunctions, chosen: tuple[int, ...]
) -> DerivativeFormulas:
    """Return the derivatives of functions by their states and chosen parameters.

    Args:
        functions: The functions.
        chosen: Indices of the parameters in ``p``.
    """
    n_x, n_p = functions.contact.size1_in(0), functions.contact.size1_in(1)
    x, p, rate = ca.SX.sym("x", n_x), ca.SX.sym("p", n_p), ca.SX.sym("rate")
    picked = _picked(p, chosen)
    by = ca.vertcat(x, picked)

    def jacobian(name: str, expression: ca.SX) -> ca.Function:
        return dense_function(f"{name}_jacobian", [x, p], [ca.jacobian(expression, by)])

    free, locked, flight = functions.rates
    after = functions.reset(x, p, rate)
    return DerivativeFormulas(
        chosen=chosen,
        n_x=n_x,
        linear=(
            _linear_formula(free, chosen),
            _linear_formula(locked, chosen),
            _linear_formula(flight, (*chosen, n_p)),
        ),
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


def _linear_formula(rate: ca.Function, chosen: tuple[int, ...]) -> LinearFormula:
    """Return the variational equation of a flow by some of its parameters."""
    y, p = ca.SX.sym("y", rate.size1_in(0)), ca.SX.sym("p", rate.size1_in(1))
    derivative = ca.sparsify(ca.jacobian(rate(y, p), ca.vertcat(y, _picked(p, chosen))))
    rows, columns = derivative.sparsity().get_triplet()
    order = sorted(range(len(rows)), key=lambda k: (rows[k], columns[k]))
    entries = derivative.nz[order] if order else ca.SX(0, 1)
    return LinearFormula(
        entries=dense_function(f"{rate.name()}_linear", [y, p], [entries]),
        rows=tuple(rows[k] for k in order),
        columns=tuple(columns[k] for k in order),
        blocks=_blocks(derivative[:, : y.numel()].sparsity()),
    )


def _blocks(depends: ca.Sparsity) -> tuple[tuple[int, ...], ...]:
    """Return the sets of mutually dependent states, each after the sets it depends on.

    In a set the states with the fewest dependencies come first, which minimises fill-in of a linear
    system.

    Args:
        depends: Dependency of states (rows) on states (columns).
    """
    _, order, ends = depends.T.scc()
    counts = Counter(depends.row())
    return tuple(
        tuple(sorted(order[begin:end], key=lambda state: (counts[state], state)))
        for begin, end in pairwise(ends)
    )


def _picked(p: ca.SX, chosen: Sequence[int]) -> ca.SX:
    return ca.vertcat(*(p[k] for k in chosen)) if chosen else ca.SX(0, 1)


class Variation:
    """The variational equation of a flow at fixed parameter values."""

    def __init__(self, formula: LinearFormula, p: Vector, n_columns: int) -> None:
        """Take a formula.

        Args:
            formula: The variational equation.
            p: Its parameters, read at every call.
            n_columns: States and parameters that it is by.
        """
        self.p, self._shape = p, (formula.entries.size1_in(0), n_columns)
        self._entries = Columns(formula.entries)
        self._places = (list(formula.rows), list(formula.columns))

    def linear(self, states: Vector) -> Vector:
        """Return ``(J, F)`` side by side at every state, ``(s, n_y, n_y + n_q)``."""
        found = np.zeros((len(states), *self._shape))
        rows, columns = self._places
        p = np.broadcast_to(self.p, (len(states), self.p.size))
        found[:, rows, columns] = self._entries(states, p)[0]
        return found


class BoundDifferentials:
    """Derivatives of a compiled system at fixed values, with respect to chosen parameters."""

    def __init__(self, formulas: DerivativeFormulas, p: Vector) -> None:
        """Take formulas.

        Args:
            formulas: The derivatives.
            p: Gains and parameters, ``(n_p,)``.
        """
        self.formulas = formulas
        self._n_columns = formulas.n_x + len(formulas.chosen)
        self._contact = Call(formulas.contact, p)
        self._holonomic = Call(formulas.holonomic, p)
        self._resting = Call(formulas.resting, p)
        self._restitution = Call(formulas.restitution, p)
        self._x, self._rate = np.zeros(formulas.n_x), np.zeros(1)
        self._after = np.zeros(formulas.reset.numel_out(0))
        self._reset = caller(formulas.reset, (self._x, p, self._rate), (self._after,))
        self._speeds = np.zeros(1 + len(formulas.chosen))
        self._rebound = caller(formulas.rebound, (p, self._rate), (self._speeds,))
        free, locked, flight = formulas.linear
        self._free = Variation(free, p, self._n_columns)
        self._locked = Variation(locked, p, self._n_columns)
        self._flight = Variation(flight, np.append(p, 1.0), self._n_columns + 3)

    @property
    def free(self) -> Variation:
        """Of the flow off the stop."""
        return self._free

    @property
    def locked(self) -> Variation:
        """Of the flow on the stop."""
        return self._locked

    def flight(self, speed: float) -> Variation:
        """Return the variational equation of a rescaled flight, valid until the next call."""
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
        return _matrix(self._after, (self.formulas.n_x, self._n_columns + 1))

    def speed_after(self, approach_rate: float) -> Vector:
        """Of the gap rate after an impact by that before it, and by parameters, ``(1 + k,)``."""
        self._rate[0] = approach_rate
        self._rebound()
        return self._speeds.copy()

    def resting(self, x: Vector) -> Vector:
        """Of the state on the stop, its gap acceleration and constrained flow, as rows."""
        return _matrix(self._resting(x), (2 * self.formulas.n_x + 1, self._n_columns))

    @property
    def restitution(self) -> Vector:
        """Of the restitution by the parameters alone, ``(k,)``."""
        return self._restitution(np.zeros(self.formulas.n_x)).copy()


def _matrix(flat: Vector, shape: tuple[int, int]) -> Vector:
    if shape[0] < 0:
        shape = (flat.size // shape[1], shape[1])
    return flat.reshape(shape, order="F").copy()
