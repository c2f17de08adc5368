"""A scene as functions of many rows: steps of its modes, resets, and the rest on the stop."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from zeno_orbits.compiled import CompiledSystem
from zeno_orbits.dynamics import Vector
from zeno_orbits.flows import ModeFunctions, dense_function
from zeno_orbits.lockstep.columns import Columns
from zeno_orbits.models import compiled_model
from zeno_orbits.problem import Problem
from zeno_orbits.rosenbrock import rosenbrock_step
from zeno_orbits.runge_kutta import overflow


class BatchFlow:
    """A mode for many rows ``(y, p)``."""

    def __init__(self, mode: ModeFunctions) -> None:
        self.n_y = mode.rate.size1_in(0)
        self._rate = Columns(mode.rate)
        self._guard = Columns(mode.guard)
        self._step = Columns(_step_function(mode))

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
            tolerance: Local errors allowed relative to ``|y| + 0.1``, ``(n,)``.
        """
        after, error, guard = self._step(y, p, np.stack([size, tolerance], axis=1))
        return after, error[:, 0], guard


def _step_function(mode: ModeFunctions) -> ca.Function:
    y = ca.SX.sym("y", mode.rate.size1_in(0))
    p = ca.SX.sym("p", mode.rate.size1_in(1))
    numbers = ca.SX.sym("numbers", 2)
    size, tolerance = ca.vertsplit(numbers)
    after, miss = rosenbrock_step(lambda state: mode.rate(state, p), mode.jacobian(y, p), y, size)
    scale = tolerance * (ABSOLUTE + ca.fmax(ca.fabs(y), ca.fabs(after)))
    error = ca.sqrt(ca.sumsqr(miss / scale) / y.numel()) + overflow(ca.sum1(after), ca)
    name = f"{mode.rate.name()}_rosenbrock"
    return dense_function(name, [y, p, numbers], [after, error, mode.guard(after, p)])


ABSOLUTE = 0.1
"""Absolute over relative local error, as `Tolerance` has it by default."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchModel:
    """A scene for many rows.

    Attributes:
        state_names: Name of each state.
        n_q: Number of coordinates.
        n_p: Number of gains and parameters.
        free: The mode off the stop.
        locked: The mode on the stop.
        flight: The rescaled flight; its last parameter is the speed (theory (14)).
        contact: ``(x, p) -> (gap, gap_rate, gap_acceleration, multiplier, multiplier_rate)``.
        restitution: ``(x, p) -> restitution``.
        reset: ``(x, p, approach rate) -> x`` after the impact.
        resting: ``(x, p) -> (x on the stop, its gap_acceleration, its locked flow)``.
    """

    state_names: tuple[str, ...]
    n_q: int
    n_p: int
    free: BatchFlow
    locked: BatchFlow
    flight: BatchFlow
    contact: Columns
    restitution: Columns
    reset: Columns
    resting: Columns

    @property
    def n_x(self) -> int:
        """Number of states."""
        return len(self.state_names)


def batch_model(compiled: CompiledSystem) -> BatchModel:
    """Return the functions of a compiled scene for many rows."""
    n_p = compiled.contact.size1_in(1)
    x, p = ca.SX.sym("x", compiled.n_x), ca.SX.sym("p", n_p)
    restitution = compiled.impulse(x, p)[2]
    return BatchModel(
        state_names=compiled.state_names,
        n_q=compiled.n_q,
        n_p=n_p,
        free=BatchFlow(compiled.free),
        locked=BatchFlow(compiled.locked),
        flight=BatchFlow(compiled.flight),
        contact=Columns(compiled.contact),
        restitution=Columns(dense_function("restitution", [x, p], [restitution])),
        reset=Columns(compiled.reset),
        resting=Columns(compiled.resting),
    )


@lru_cache(maxsize=4)
def model_in_rows(problem: Problem) -> BatchModel:
    """Return the functions of a scene for many rows, built once."""
    return batch_model(compiled_model(problem))
