"""The explicit engine: DOP853 steps taken by the flow itself.

Source: [HairerNorsettWanner1993]_.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.engine import FAR
from zeno_orbits.integrators.flow import FlowWithEvent, Tolerance
from zeno_orbits.integrators.stepping import SteppingEngine
from zeno_orbits.integrators.steps import ExplicitStep, cut, first_size, too_small
from zeno_orbits.work import Checked

SAFETY = 0.9
SHRINK, GROW = 0.2, 8.0
EXPONENT = -1 / 8


@dataclass(frozen=True, kw_only=True)
class RungeKutta(SteppingEngine, Checked):
    """DOP853 with the usual step control.

    Attributes:
        largest_step: No step is longer than this, in the time of the flow.
    """

    largest_step: float = math.inf

    def steps(
        self, flow: FlowWithEvent, y: Vector, tolerance: Tolerance, horizon: float = FAR
    ) -> Iterator[ExplicitStep]:
        """Yield explicit steps from ``y`` on, without end."""
        time = 0.0
        largest = min(self.largest_step, horizon)
        size = min(first_size(flow, y, tolerance), largest)
        refused = False
        wanted, size = cut(flow, y, size)
        while True:
            after, error = flow.attempt(y, size, tolerance)
            if not error <= 1.0:
                # A flow that diverges returns NaN, but a shorter step may still be finite.
                factor = SAFETY * error**EXPONENT if math.isfinite(error) else SHRINK
                # No part of an infinite step is finite.
                size = min(size, sys.float_info.max) * max(SHRINK, factor)
                refused = True
                if size <= 4 * math.ulp(time) or size < 1e-300:
                    raise too_small("the flow is too stiff or singular", time, y)
                continue
            yield ExplicitStep(flow, tolerance, time, size, y, after)
            time += size
            y = after
            growth = GROW if error == 0.0 else SAFETY * error**EXPONENT
            size *= min(1.0 if refused else GROW, max(SHRINK, growth))
            # A step that the end of a span cut short tells nothing against the size before it.
            size = min(size if refused else max(size, wanted), largest)
            wanted, size = cut(flow, y, size)
            refused = False
