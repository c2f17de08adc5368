"""Functions of a system at fixed parameter values, called through preallocated memory."""

from __future__ import annotations

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model.numeric.casadi_calls import caller
from zeno_orbits.model.numeric.stop_states import ContactProjection, Landed


class Call:
    """A function of ``(x, p)`` at fixed ``p``, called through preallocated memory."""

    def __init__(self, function: ca.Function, p: Vector) -> None:
        self._function, self._p = function, p
        self._results: list[Vector] = []

    def _allocate(self) -> None:
        """Allocate the memory. A system at other values has a dozen calls, few of them used."""
        function = self._function
        self._x = np.zeros(function.size1_in(0))
        self._results = [np.zeros(function.numel_out(k)) for k in range(function.n_out())]
        self._evaluate = caller(function, (self._x, self._p), self._results)

    def __call__(self, x: Vector, output: int = 0) -> Vector:
        """Return one output at a state, valid until the next call."""
        if not self._results:
            self._allocate()
        self._x[:] = x
        self._evaluate()
        return self._results[output]


class StepCall:
    """A step of a flow at fixed ``p``, called through preallocated memory."""

    def __init__(self, function: ca.Function, n_y: int, p: Vector) -> None:
        self._y = np.zeros(n_y)
        self._numbers = np.zeros(3)
        self._after = np.zeros_like(self._y)
        self._told = np.zeros(3)
        results = (self._after, self._told[:1], self._told[1:])
        self._evaluate = caller(function, (self._y, p, self._numbers), results)
        self._tolerance: Tolerance | None = None

    def __call__(
        self, y: Vector, size: float, tolerance: Tolerance
    ) -> tuple[Vector, float, tuple[float, float]]:
        """Return the state after a step of a size, its error, and guard and guard rate there.

        The error is in units of the tolerance.
        """
        if tolerance is not self._tolerance:
            self._numbers[1:] = (tolerance.relative, tolerance.absolute)
            self._tolerance = tolerance
        self._y[:] = y
        self._numbers[0] = size
        self._evaluate()
        error, value, rate = self._told.tolist()
        return self._after.copy(), error, (value, rate)


class ResetCall:
    """The reset map at fixed ``p``, called through preallocated memory."""

    def __init__(self, function: ca.Function, p: Vector) -> None:
        self._x = np.zeros(function.size1_in(0))
        self._rate = np.zeros(1)
        self._after = np.zeros_like(self._x)
        self._evaluate = caller(function, (self._x, p, self._rate), (self._after,))

    def __call__(self, x: Vector, approach_rate: float) -> Vector:
        """Return the state after an impact, from the state before it and its gap rate."""
        self._x[:] = x
        self._rate[0] = approach_rate
        self._evaluate()
        return self._after.copy()


class RestingCall:
    """The rest of a state on the stop at fixed ``p``, called through preallocated memory."""

    def __init__(self, function: ca.Function, p: Vector) -> None:
        self._x = np.zeros(function.size1_in(0))
        self._state = np.zeros_like(self._x)
        self._acceleration = np.zeros(1)
        self._rate = np.zeros_like(self._x)
        results = (self._state, self._acceleration, self._rate)
        self._evaluate = caller(function, (self._x, p), results)

    def __call__(self, x: Vector) -> ContactProjection:
        """Return the state moved onto the stop, and its rates there."""
        self._x[:] = x
        self._evaluate()
        return ContactProjection(
            state=self._state.copy(),
            gap_acceleration=self._acceleration.item(),
            rate=self._rate.copy(),
        )


class LandingCall:
    """Reset and projection of an impact at fixed ``p``, called through preallocated memory."""

    def __init__(self, function: ca.Function, p: Vector) -> None:
        self._x, self._rate = np.zeros(function.size1_in(0)), np.zeros(1)
        self._after, self._state, self._flow = (np.zeros_like(self._x) for _ in range(3))
        self._told = np.zeros(2)
        results = (self._after, self._told[:1], self._state, self._told[1:], self._flow)
        self._evaluate = caller(function, (self._x, p, self._rate), results)

    def __call__(self, x: Vector, approach_rate: float) -> Landed:
        """Return the landing of an impact from the state and the gap rate before it."""
        self._x[:] = x
        self._rate[0] = approach_rate
        self._evaluate()
        gap_rate, acceleration = self._told.tolist()
        return Landed(
            state=self._state.copy(),
            gap_acceleration=acceleration,
            rate=self._flow.copy(),
            state_plus=self._after.copy(),
            gap_rate=gap_rate,
        )
