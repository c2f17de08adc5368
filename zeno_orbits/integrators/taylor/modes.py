"""A mode as Taylor integrators of heyoka, compiled once and kept for whatever gains come.

One integrator stops at the fall of the guard by itself, in C++; the other has no events and gives
single steps with their series.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, StepSizeError
from zeno_orbits.integrators.flow import GuardedFlow
from zeno_orbits.integrators.taylor.casadi_to_heyoka import load_heyoka, translate
from zeno_orbits.kernels import caller

NUDGE = 1e-30
"""Added to the guard: a constant term of exactly 0.0 makes heyoka find the start, and no fall."""

_KEPT = 32
"""Integrators kept of each kind; a problem at one tolerance needs three."""

_LARGE = 1000
"""Operations from which the code is compiled as calls, or compiling would take too long."""

_FINEST = float(np.finfo(np.float64).eps)


class SymbolicMode(Protocol):
    """A flow and its guard as CasADi functions."""

    @property
    def rate(self) -> ca.Function:
        """``(y, p) -> dy/dt``."""
        ...

    @property
    def guard(self) -> ca.Function:
        """``(y, p) -> (guard, its time derivative)``."""
        ...


def symbols_of(flow: GuardedFlow) -> tuple[SymbolicMode, Vector]:
    """Return the formulas of a flow and the numbers ``p`` in them.

    Raises:
        InputError: If it has none, as a model written by hand.
    """
    mode, p = getattr(flow, "mode", None), getattr(flow, "p", None)
    if mode is None or p is None:
        message = "Argument `flow` must come from formulas for Taylor's method"
        raise InputError(f"{message}, but it is a {type(flow).__name__}.")
    return mode, p


class Carrier:
    """Carries a state until the guard of its mode falls, without a return to Python on the way.

    Terminal events are the fall itself and, as a net under it, the fall through a depth.
    """

    def __init__(self, mode: SymbolicMode, tolerance: float, resting: tuple[int, ...]) -> None:
        heyoka = _heyoka()
        lean = lean_mode(mode, resting)
        n_p, n_factors = lean.formulas.size1_in(1), lean.formulas.size1_in(2)
        names = [heyoka.expression(f"y{k}") for k in range(len(lean.moving))]
        numbers = [heyoka.par[k] for k in range(n_p + n_factors)]
        *rates, guard = translate(lean.formulas, [names, numbers[:n_p], numbers[n_p:]])
        depth = heyoka.par[n_p + n_factors]
        falls = heyoka.event_direction.negative
        self._taylor: Any = heyoka.taylor_adaptive(
            list(zip(names, rates, strict=True)),
            np.zeros(len(names)),
            tol=tolerance,
            t_events=[
                heyoka.t_event(guard + NUDGE, direction=falls),
                heyoka.t_event(guard + depth, direction=falls),
            ],
            compact_mode=_is_large(mode),
            # Sums in any order, a sixth faster. What is not finite is seen by comparisons outside
            # this code, and whatever is in doubt is followed again by the stepper, which is strict.
            fast_math=True,
        )
        # These arrays are the integrator's own memory, here and in CasADi's calls.
        self._moved: Vector = self._taylor.state
        self._numbers: Vector = self._taylor.pars
        self._moving = list(lean.moving)
        self._p = self._numbers[:n_p]
        self._full = self._moved if not resting else np.zeros(lean.n_y)
        self._pair = np.zeros(2)
        self._guard = caller(mode.guard, (self._full, self._p), (self._pair,))
        self._fold = caller(lean.factors, (self._p,), (self._numbers[n_p : n_p + n_factors],))
        limits = heyoka.taylor_outcome
        self.time_limit, self.step_limit = int(limits.time_limit), int(limits.step_limit)
        self.fall = -1

    def begin(self, y: Vector, p: Vector) -> tuple[float, float]:
        """Put the state at time zero and return guard and rate there."""
        taylor = self._taylor
        taylor.time = 0.0
        taylor.reset_cooldowns()
        self._p[:] = p
        self._fold()
        self._moved[:] = y if self._full is self._moved else y[self._moving]
        return self.guard()

    @property
    def state(self) -> Vector:
        """The state of the flow where it is, ``(n_y,)``, in memory that changes with it."""
        if self._full is not self._moved:
            self._full[self._moving] = self._moved
        return self._full

    def guard(self) -> tuple[float, float]:
        """Return the guard and its rate where the state is."""
        _ = self.state
        self._guard()
        value, rate = self._pair.tolist()
        return value, rate

    def set_net(self, depth: float) -> None:
        """Hang the net this far below zero."""
        self._numbers[-1] = depth

    def advance(self, until: float, largest: float, steps: int) -> tuple[int, int, float]:
        """Take steps until an event, the time or their number ends it.

        Args:
            until: Time to stop at.
            largest: No step is longer.
            steps: Number of steps at most.

        Returns:
            The outcome as heyoka numbers it, the steps taken and the time reached.
        """
        taylor = self._taylor
        outcome = taylor.propagate_until(until, max_delta_t=largest, max_steps=steps)
        return int(outcome[0]), int(outcome[3]), float(taylor.time)


class TaylorStepper:
    """Takes single steps of a mode."""

    def __init__(self, mode: SymbolicMode, tolerance: float) -> None:
        heyoka = _heyoka()
        names, rates = _formulas(heyoka, mode)
        self._taylor: Any = heyoka.taylor_adaptive(
            list(zip(names, rates, strict=True)),
            np.zeros(len(names)),
            tol=tolerance,
            compact_mode=_is_large(mode),
        )
        self._failed = heyoka.taylor_outcome.err_nf_state
        self._state: Vector = self._taylor.state
        # heyoka counts parameters up to the last that occurs.
        self._numbers: Vector = self._taylor.pars

    def step(
        self, time: float, y: Vector, p: Vector, largest: float
    ) -> tuple[float, Vector, Vector]:
        """Return the size of one step from ``y``, the state after it, and its Taylor coefficients.

        Args:
            time: Time at its start, for the error alone.
            y: State there, ``(n_y,)``.
            p: Numbers in the formulas.
            largest: No longer than this.

        Returns:
            Size, state ``(n_y,)``, coefficients of rising powers of the time ``(n_y, order + 1)``.

        Raises:
            StepSizeError: If the flow is not finite or the step falls to rounding level.
        """
        taylor = self._taylor
        # Others may have used the integrator since the last step.
        taylor.time = 0.0
        self._state[:] = y
        self._numbers[:] = p[: self._numbers.size]
        outcome, size = taylor.step(max_delta_t=largest, write_tc=True)
        after = self._state.copy()
        if outcome == self._failed or not np.isfinite(after).all() or not time + size > time:
            raise StepSizeError(
                "The step size fell to rounding level: the flow is singular",
                time=time,
                state=tuple(y.tolist()),
            )
        return float(size), after, np.array(taylor.tc)


def carrier(mode: SymbolicMode, tolerance: float, y: Vector) -> Carrier:
    """Return the integrator of a mode that stops at its guard, kept from an earlier call.

    Args:
        mode: The formulas.
        tolerance: Of a step.
        y: Where a leg starts: what is zero there and stays so is left out.
    """
    zeros = tuple(k for k, value in enumerate(y.tolist()) if value == 0.0)
    resting = _resting(mode, zeros) if zeros else ()
    return _carrier(mode, max(tolerance, _FINEST), resting, threading.get_ident())


def stepper(mode: SymbolicMode, tolerance: float) -> TaylorStepper:
    """Return the integrator of a mode for single steps, kept from an earlier call."""
    return _stepper(mode, max(tolerance, _FINEST), threading.get_ident())


@lru_cache(maxsize=_KEPT)
def _carrier(
    mode: SymbolicMode, tolerance: float, resting: tuple[int, ...], _thread: int
) -> Carrier:
    # An integrator holds one state, so each thread has its own.
    return Carrier(mode, tolerance, resting)


@lru_cache(maxsize=_KEPT)
def _stepper(mode: SymbolicMode, tolerance: float, _thread: int) -> TaylorStepper:
    return TaylorStepper(mode, tolerance)


@dataclass(frozen=True, slots=True, kw_only=True)
class LeanMode:
    """A mode without what need not be a series: states at rest, and factors of numbers alone.

    Attributes:
        moving: Indices of the states that are left.
        formulas: ``(moving states, p, factors) -> (their rates, guard)``.
        factors: ``p -> factors``.
        n_y: Number of states of the mode.
    """

    moving: tuple[int, ...]
    formulas: ca.Function
    factors: ca.Function
    n_y: int


def lean_mode(mode: SymbolicMode, resting: tuple[int, ...] = ()) -> LeanMode:
    """Return a mode at states that rest at zero, parts that depend on numbers alone taken out.

    On the stop a gap and its rate rest; a mass matrix is made of factors of masses and lengths.
    """
    y, p = ca.SX.sym("y", mode.rate.size1_in(0)), ca.SX.sym("p", mode.rate.size1_in(1))
    moving = tuple(k for k in range(y.numel()) if k not in resting)
    rates, guard = _at_rest(mode, y, p, resting)
    kept = ca.vertcat(*(rates[k] for k in moving), guard)
    formulas, symbols, factors = ca.extract_parametric(kept, p)
    inputs = [y[list(moving)], p, ca.vertcat(*symbols)]
    return LeanMode(
        moving=moving,
        formulas=ca.Function("lean", inputs, [formulas], {"cse": True}),
        factors=ca.Function("factors", [p], [ca.densify(ca.vertcat(*factors))], {"cse": True}),
        n_y=y.numel(),
    )


def _at_rest(
    mode: SymbolicMode, y: ca.SX, p: ca.SX, resting: tuple[int, ...]
) -> tuple[ca.SX, ca.SX]:
    """Return the rates and the guard at states of which some are zero."""
    at = ca.vertcat(*(0 if k in resting else y[k] for k in range(y.numel())))
    return ca.densify(mode.rate(at, p)), mode.guard(at, p)[0]


@lru_cache(maxsize=4 * _KEPT)
def _resting(mode: SymbolicMode, zeros: tuple[int, ...]) -> tuple[int, ...]:
    """Return which of some states that are zero stay so: their rates vanish while they do."""
    y, p = ca.SX.sym("y", mode.rate.size1_in(0)), ca.SX.sym("p", mode.rate.size1_in(1))
    while True:
        rates, _ = _at_rest(mode, y, p, zeros)
        left = tuple(k for k in zeros if rates[k].is_zero())
        if left == zeros:
            # An equilibrium rests altogether, and something has to be left to follow.
            return left if len(left) < y.numel() else ()
        zeros = left


def _heyoka() -> Any:
    """Return heyoka, which prints its warnings on the standard output; they are checked here."""
    heyoka = load_heyoka()
    heyoka.set_logger_level_critical()
    return heyoka


def _formulas(heyoka: Any, mode: SymbolicMode) -> tuple[list[Any], list[Any]]:
    """Return the names of the states and their rates."""
    n_y, n_p = mode.rate.size1_in(0), mode.rate.size1_in(1)
    names = [heyoka.expression(f"y{k}") for k in range(n_y)]
    return names, translate(mode.rate, [names, [heyoka.par[k] for k in range(n_p)]])


def _is_large(mode: SymbolicMode) -> bool:
    return bool(mode.rate.n_instructions() > _LARGE)
