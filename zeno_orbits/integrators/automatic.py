"""The default engine: explicit where a flow is smooth, implicit where a fast decay holds it back.

Every leg begins explicitly, which a layer after an impact needs anyway. Once the decay of the
fastest component, and no longer the accuracy, sets the step, and enough of the leg is left, the
implicit engine takes over with a step for the slow rest (theory (23)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.compiled_leg import StepLoop
from zeno_orbits.integrators.dop853 import RungeKutta
from zeno_orbits.integrators.engine import FAR, Step
from zeno_orbits.integrators.flow import GuardedFlow, Tolerance, flow_eigenvalues
from zeno_orbits.integrators.radau import Radau
from zeno_orbits.integrators.stepping import SteppingEngine

Values = NDArray[np.complex128]

FIRST_LOOK = 5
"""Explicit steps before the decay rates of a flow are asked for."""

PATIENCE = 24
"""Explicit steps between two looks at the rates."""

HELD, STUCK = 3.0, 1.0
"""Step times fastest decay from which stability sets the explicit step, near its 6: of any step,
and of one that no longer grows, as it does to the end of a layer."""

PAYS = 25.0
"""Fastest decay over the rates that stay from which an implicit step pays."""

LONG = 60.0
"""Decay times what is left of the leg from which it is gone for most of that, and so from which
going over pays."""

FIRST_STEP = 2.5
"""First implicit step times the next rate, over the eighth root of the tolerance: what the error
estimate of order 8 mostly takes."""


@dataclass(frozen=True, kw_only=True)
class Automatic(SteppingEngine):
    """Explicit steps, and implicit ones once stiffness holds the explicit ones back.

    Attributes:
        explicit: The engine that begins.
        implicit: The engine that takes over.
    """

    explicit: RungeKutta = field(default_factory=RungeKutta)
    implicit: Radau = field(default_factory=Radau)

    @cached_property
    def loop(self) -> StepLoop:
        """Explicit steps, then implicit ones."""
        explicit, implicit = self.explicit.largest_step, self.implicit.largest_step
        return StepLoop(True, True, explicit, implicit, self.implicit.scheme)

    def steps(
        self, flow: GuardedFlow, y: Vector, tolerance: Tolerance, horizon: float = FAR
    ) -> Iterator[Step]:
        """Yield explicit steps, then perhaps implicit ones, without end."""
        limits, size = _NONE, 0.0
        for count, step in enumerate(self.explicit.steps(flow, y, tolerance, horizon), start=1):
            yield step
            if count == FIRST_LOOK or count % PATIENCE == 0:
                limits = _limits(flow, step.after, tolerance)
            stuck, size = step.size <= size, step.size
            if size * limits.fastest > (STUCK if stuck else HELD):
                end = step.start + size
                left = min(_time_left(flow, step), horizon - end)
                if left * limits.fastest > LONG and limits.pay(left):
                    size = max(2 * size, min(limits.first, 1.1 * left))
                    yield from self.implicit.steps(
                        flow, step.after, tolerance, horizon, time=end, size=size
                    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Limits:
    """The limits of the steps of a flow.

    Attributes:
        fastest: The decay that holds explicit steps back [1/time]; zero if nothing else is slower
            by far, however long the leg.
        first: Implicit step to begin with [time].
        values: Eigenvalues of the Jacobian.
    """

    fastest: float
    first: float
    values: Values

    def pay(self, left: float) -> bool:
        """Return True if implicit steps pay for what is left of a leg."""
        return self.fastest > PAYS * staying_rate(self.values, left)


_NONE = _Limits(fastest=0.0, first=0.0, values=np.zeros(0, dtype=np.complex128))


def _limits(flow: GuardedFlow, y: Vector, tolerance: Tolerance) -> _Limits:
    """Return the decay that holds explicit steps back and an implicit step to begin with."""
    values = flow_eigenvalues(flow, y)
    fastest, next_rate = rates_of(values)
    if not fastest > PAYS * staying_rate(values, math.inf):
        return _NONE
    first = FIRST_STEP * tolerance.relative ** (1 / 8)
    return _Limits(
        fastest=fastest, first=first / next_rate if next_rate > 0.0 else 0.0, values=values
    )


def _time_left(flow: GuardedFlow, step: Step) -> float:
    """Return how long the guard takes to fall from the end of a step, as a parabola tells it."""
    (_, rate_before), (value, rate) = flow.guard(step.before), flow.guard(step.after)
    bend = (rate - rate_before) / step.size
    if value < 0.0:
        return 0.0
    if bend < 0.0:
        return (rate + math.sqrt(rate * rate - 2.0 * bend * value)) / -bend
    return -value / rate if rate < 0.0 else math.inf


def decay_rates(flow: GuardedFlow, y: Vector) -> tuple[float, float]:
    """Return the fastest decay of a flow and the largest rate of anything slower [1/time].

    Rates are moduli of eigenvalues of the Jacobian. Decays within a factor of ten of the fastest,
    of several motors for instance, count with it.
    """
    return rates_of(flow_eigenvalues(flow, y))


def rates_of(values: Values) -> tuple[float, float]:
    """Return the same of eigenvalues, ``(n_y,)``."""
    fastest = max(float(-np.min(values.real)), 0.0)
    slower = [abs(value) for value in values if -value.real < fastest / 10]
    return fastest, float(max(slower, default=0.0))


def staying_rate(values: Values, left: float) -> float:
    """Return the largest rate of what does not decay long before a leg ends [1/time].

    Several layers, of motors with far different ``L / R`` for instance, are all passed soon. What
    swings faster than it decays is not counted on to be gone.

    Args:
        values: Eigenvalues of the Jacobian, ``(n_y,)``.
        left: What is left of the leg.
    """
    staying = [
        abs(value)
        for value in values
        if not (value.real < -abs(value.imag) and -float(value.real) * left > LONG)
    ]
    return float(max(staying, default=0.0))
