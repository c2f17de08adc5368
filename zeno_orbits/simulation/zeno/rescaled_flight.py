"""One rescaled flight from an impact to the next, not recorded (theory (2.6))."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import StepSizeError
from zeno_orbits.integrators import Step, Stepper, Tolerance
from zeno_orbits.model import HybridDynamics

Flight = Callable[[Vector, float], tuple[float, Vector, float] | None]
"""Function from the state and gap rate after an impact to duration, state and gap rate at the next
impact.

``None`` means that the flight does not belong to a sequence that accumulates.
"""

_MOST_STEPS = 1000
"""Steps of a flight before it is given up."""

_MOST_CORRECTIONS = 10
_CLOSE = 1e-7
"""A correction of the landing after which one more reaches rounding, as part of the flight."""


def rescaled_flights(dynamics: HybridDynamics, engine: Stepper, tolerance: Tolerance) -> Flight:
    """Return the flights of a system, as a function.

    A flight is given up where the free flow no longer presses on the stop at the end of a step:
    its gap might have other roots, and impacts do not accumulate there.

    Args:
        dynamics: The system.
        engine: The integrator.
        tolerance: Its local error.
    """
    n_x = len(dynamics.state_names)

    def flight(state_plus: Vector, speed: float) -> tuple[float, Vector, float] | None:
        start = np.append(state_plus, (0.0, 1.0))
        steps = engine.steps(dynamics.flight(speed), start, tolerance)
        try:
            for _, step in zip(range(_MOST_STEPS), steps, strict=False):
                if not dynamics.gap_acceleration(step.after[:n_x]) < 0.0:
                    return None
                if step.after[-2] <= 0.0:
                    return _landing(step, speed, n_x)
        except StepSizeError:
            return None
        return None

    return flight


def _landing(step: Step, speed: float, n_x: int) -> tuple[float, Vector, float] | None:
    """Return the end of a flight inside its last step.

    The scaled gap is concave and has fallen below zero: Newton's method closes in from outside.
    """
    offset, y, close = step.size, step.after, False
    for _ in range(_MOST_CORRECTIONS):
        change = float(y[-2] / y[-1])
        offset -= change
        y = step.state_at(offset)
        if close:
            return speed * (step.start + offset), y[:n_x], speed * float(y[-1])
        close = abs(change) <= _CLOSE * (step.start + offset)
    return None
