"""The default engine: explicit where a flow is smooth, implicit where a fast decay holds it back.

Every leg begins explicitly, which a layer after an impact needs anyway. Once the decay of the
fastest component, and no longer the accuracy, sets the step, the implicit engine takes over
(theory (23)).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from zeno_orbits.dynamics import GuardedFlow, Tolerance, Vector
from zeno_orbits.engines.protocol import FAR, Leg, Passage, Step
from zeno_orbits.engines.radau import Radau
from zeno_orbits.engines.runge_kutta import RungeKutta
from zeno_orbits.engines.stepping import follow_steps

_PATIENCE = 24
"""Explicit steps between two looks at what holds the step back."""

_HELD = 1.0
"""Step times fastest decay at which stability begins to set the explicit step, near its 6."""

PAYS = 25.0
"""Fastest decay over the next rate from which an implicit step pays."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Automatic:
    """Explicit steps, and implicit ones once stiffness holds the explicit ones back.

    Attributes:
        explicit: The engine that begins.
        implicit: The engine that takes over.
    """

    explicit: RungeKutta = field(default_factory=RungeKutta)
    implicit: Radau = field(default_factory=Radau)

    def follow(self, leg: Leg) -> Passage:
        """Follow a flow until its guard falls through zero or the time is over.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        return follow_steps(self.steps(leg.flow, leg.y, leg.tolerance, leg.horizon), leg)

    def steps(
        self, flow: GuardedFlow, y: Vector, tolerance: Tolerance, horizon: float = FAR
    ) -> Iterator[Step]:
        """Yield steps from ``y`` on, without end, none longer than the horizon.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        for count, step in enumerate(self.explicit.steps(flow, y, tolerance, horizon), start=1):
            yield step
            if count % _PATIENCE == 0 and is_held_back(flow, step.after, step.size):
                end = step.start + step.size
                yield from self.implicit.steps(
                    flow, step.after, tolerance, horizon, time=end, size=2 * step.size
                )


def is_held_back(flow: GuardedFlow, y: Vector, size: float) -> bool:
    """Tell whether a fast decay, far faster than all else, sets an explicit step of this size."""
    fastest, next_rate = decay_rates(flow, y)
    return size * fastest > _HELD and fastest > PAYS * next_rate


def decay_rates(flow: GuardedFlow, y: Vector) -> tuple[float, float]:
    """Return the fastest decay of a flow and the largest rate of anything slower [1/time].

    Rates are moduli of eigenvalues of the Jacobian. Decays within a factor of ten of the fastest,
    of several motors for instance, count with it.
    """
    values = np.linalg.eigvals(flow.jacobian(y))
    fastest = max(float(-np.min(values.real)), 0.0)
    slower = [abs(value) for value in values if -value.real < fastest / 10]
    return fastest, float(max(slower, default=0.0))
