"""A mode as Taylor integrators of heyoka, compiled once and kept for whatever gains come.

One integrator stops at the fall of the guard by itself, in C++; the other has no events and gives
single steps with their series.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Protocol

import casadi as ca
import numpy as np

from zeno_orbits.dynamics import GuardedFlow, Vector
from zeno_orbits.errors import InputError, StepSizeError
from zeno_orbits.translate import load_heyoka, translate

NUDGE = 1e-30
"""Added to the guard: a constant term of exactly 0.0 makes heyoka find the start, and no fall."""

_KEPT = 32
"""Integrators kept of each kind; a scene at one tolerance needs three."""

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

    def __init__(self, mode: SymbolicMode, tolerance: float) -> None:
        heyoka, names, rates, guard = _formulas(mode)
        depth = heyoka.par[mode.rate.size1_in(1)]
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
        # Both arrays are the integrator's own memory, here and in CasADi's call.
        self.state: Vector = self._taylor.state
        self._numbers: Vector = self._taylor.pars
        self._pair = np.zeros(2)
        self._guard = _caller(mode.guard, (self.state, self._numbers[:-1]), self._pair)
        limits = heyoka.taylor_outcome
        self.time_limit, self.step_limit = int(limits.time_limit), int(limits.step_limit)
        self.fall = -1

    def begin(self, y: Vector, p: Vector) -> tuple[float, float]:
        """Put the state at time zero and return guard and rate there."""
        taylor = self._taylor
        taylor.time = 0.0
        taylor.reset_cooldowns()
        self.state[:] = y
        self._numbers[:-1] = p
        return self.guard()

    def guard(self) -> tuple[float, float]:
        """Return the guard and its rate where the state is."""
        self._guard()
        value, rate = self._pair.tolist()
        return value, rate

    def set_net(self, depth: float) -> None:
        """Hang the net this far below zero."""
        self._numbers[-1] = depth

    def advance(self, until: float, largest: float, steps: int) -> tuple[int, int, float]:
        """Take steps until an event, the time or their number ends it.

        Returns:
            The outcome as heyoka numbers it, the steps taken and the time reached.
        """
        taylor = self._taylor
        outcome = taylor.propagate_until(until, max_delta_t=largest, max_steps=steps)
        return int(outcome[0]), int(outcome[3]), float(taylor.time)


class Stepper:
    """Takes single steps of a mode."""

    def __init__(self, mode: SymbolicMode, tolerance: float) -> None:
        heyoka, names, rates, _ = _formulas(mode)
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


def carrier(mode: SymbolicMode, tolerance: float) -> Carrier:
    """Return the integrator of a mode that stops at its guard, kept from an earlier call."""
    return _carrier(mode, max(tolerance, _FINEST), threading.get_ident())


def stepper(mode: SymbolicMode, tolerance: float) -> Stepper:
    """Return the integrator of a mode for single steps, kept from an earlier call."""
    return _stepper(mode, max(tolerance, _FINEST), threading.get_ident())


@lru_cache(maxsize=_KEPT)
def _carrier(mode: SymbolicMode, tolerance: float, _thread: int) -> Carrier:
    # An integrator holds one state, so each thread has its own.
    return Carrier(mode, tolerance)


@lru_cache(maxsize=_KEPT)
def _stepper(mode: SymbolicMode, tolerance: float, _thread: int) -> Stepper:
    return Stepper(mode, tolerance)


def _formulas(mode: SymbolicMode) -> tuple[Any, list[Any], list[Any], Any]:
    """Return heyoka, the names of the states, their rates and the guard."""
    heyoka = load_heyoka()
    # heyoka prints its warnings on the standard output; what they warn of is checked here.
    heyoka.set_logger_level_critical()
    n_y, n_p = mode.rate.size1_in(0), mode.rate.size1_in(1)
    names = [heyoka.expression(f"y{k}") for k in range(n_y)]
    arguments = [names, [heyoka.par[k] for k in range(n_p)]]
    return heyoka, names, translate(mode.rate, arguments), translate(mode.guard, arguments)[0]


def _is_large(mode: SymbolicMode) -> bool:
    return bool(mode.rate.n_instructions() > _LARGE)


def _caller(function: ca.Function, arguments: Sequence[Vector], result: Vector) -> Any:
    """Return a call without arguments that reads and writes the given arrays in place."""
    # CasADi's stubs ask for a size that the call takes from the memory itself.
    buffer: Any
    buffer, evaluate = function.buffer()
    for k, argument in enumerate(arguments):
        buffer.set_arg(k, memoryview(argument.data))
    buffer.set_res(0, memoryview(result.data))

    def call(_kept: Any = (buffer, *arguments, result)) -> None:
        # The default keeps buffer and arrays alive: the trigger knows their bare addresses only.
        evaluate()

    return call
