"""The default engine: explicit steps in general, implicit steps if a fast decay limits the step.

Every leg begins explicitly, which a layer after an impact needs anyway. Once the decay of the
fastest component, and no longer the accuracy, sets the step, and enough of the leg is left, the
implicit engine takes over with a step for the slow rest (theory (4.1)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.dop853 import RungeKutta
from zeno_orbits.integrators.engine import FAR, BoxedStep, Step
from zeno_orbits.integrators.flow import FlowWithEvent, Tolerance, flow_eigenvalues
from zeno_orbits.integrators.radau import Radau
from zeno_orbits.integrators.stepping import SteppingEngine
from zeno_orbits.work import Checked

Values = NDArray[np.complex128]

FIRST_LOOK = 5
"""Number of explicit steps before the decay rates of a flow are computed."""

PATIENCE = 24
"""Number of explicit steps between two computations of the rates."""

HELD, STUCK = 3.0, 1.0
"""Step times fastest decay from which stability sets the explicit step, near its 6: of any step,
and of one that no longer grows, as it does to the end of a layer."""

PAYS = 25.0
"""Fastest decay over the rates that stay from which an implicit step pays."""

LONG = 60.0
"""Ratio of the rest of a leg to a decay time, above which the component counts as decayed and
implicit steps pay."""

FIRST_STEP = 2.5
"""Factor of the first implicit step: times the next decay time and the eighth root of the
tolerance. It matches the usual error estimate of order 8."""


@dataclass(frozen=True, kw_only=True)
class Automatic(SteppingEngine, Checked):
    """Explicit steps, and implicit steps once stiffness limits the explicit steps.

    Attributes:
        explicit: The integrator at the start.
        implicit: The integrator for stiff parts.
    """

    explicit: RungeKutta = field(default_factory=RungeKutta)
    implicit: Radau = field(default_factory=Radau)

    def steps(
        self, flow: FlowWithEvent, y: Vector, tolerance: Tolerance, horizon: float = FAR
    ) -> Iterator[BoxedStep]:
        """Yield explicit steps without end, and implicit steps if the flow becomes stiff."""
        limits, size = _NONE, 0.0
        for count, step in enumerate(self.explicit.steps(flow, y, tolerance, horizon), start=1):
            yield step
            if count == FIRST_LOOK or count % PATIENCE == 0:
                limits = _limits(flow, step.after, tolerance)
            stuck, size = step.size <= size, step.size
            may_grow = size < self.implicit.largest_step
            if may_grow and size * limits.fastest > (STUCK if stuck else HELD):
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
        fastest: The decay rate that limits explicit steps [1/time]. It is zero if no other
            component is slower by far, for any length of the leg.
        first: First implicit step [time].
        values: Eigenvalues of the Jacobian.
    """

    fastest: float
    first: float
    values: Values

    def pay(self, left: float) -> bool:
        """Return True if implicit steps pay for the rest of a leg."""
        return self.fastest > PAYS * staying_rate(self.values, left)


_NONE = _Limits(fastest=0.0, first=0.0, values=np.zeros(0, dtype=np.complex128))


def _limits(flow: FlowWithEvent, y: Vector, tolerance: Tolerance) -> _Limits:
    """Return the decay that holds explicit steps back and an implicit step to begin with."""
    values = flow_eigenvalues(flow, y)
    fastest, next_rate = rates_of(values)
    if not fastest > PAYS * staying_rate(values, math.inf):
        return _NONE
    first = FIRST_STEP * tolerance.relative ** (1 / 8)
    first = _without_last_bits(first / next_rate) if next_rate > 0.0 else 0.0
    return _Limits(fastest=fastest, first=first, values=values)


def _without_last_bits(x: float) -> float:
    """Return a guess rounded to eight bits, because the last bits of eigenvalues differ from C."""
    part, power = math.frexp(x)
    return math.ldexp(math.floor(256.0 * part) / 256.0, power)


def _time_left(flow: FlowWithEvent, step: Step) -> float:
    """Return the time from the end of a step to the zero of the guard, from a parabola."""
    (_, rate_before), (value, rate) = flow.guard(step.before), flow.guard(step.after)
    bend = (rate - rate_before) / step.size
    if value < 0.0:
        return 0.0
    if bend < 0.0:
        return (rate + math.sqrt(rate * rate - 2.0 * bend * value)) / -bend
    return -value / rate if rate < 0.0 else math.inf


def rates_of(values: Values) -> tuple[float, float]:
    """Return the fastest decay of a flow and the largest rate of anything slower [1/time].

    Rates are moduli of eigenvalues of the Jacobian. Decays within a factor of ten of the fastest,
    of several motors for instance, count with it.

    Args:
        values: The eigenvalues, ``(n_y,)``.
    """
    fastest = max(float(-np.min(values.real)), 0.0)
    slower = [abs(value) for value in values if -value.real < fastest / 10]
    return fastest, float(max(slower, default=0.0))


def staying_rate(values: Values, left: float) -> float:
    """Return the largest rate of the components that persist until a leg ends [1/time].

    Several boundary layers, for instance of motors with very different ``L / R``, all decay soon. A
    component that oscillates faster than it decays counts as persistent.

    Args:
        values: Eigenvalues of the Jacobian, ``(n_y,)``.
        left: Length of the rest of the leg.
    """
    staying = [
        abs(value)
        for value in values
        if not (value.real < -abs(value.imag) and -float(value.real) * left > LONG)
    ]
    return float(max(staying, default=0.0))
