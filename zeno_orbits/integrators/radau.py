"""The stiff engine: Radau IIA of order 13, whose step size is independent of fast layers' decay.

Source: [HairerWanner1996]_, IV.8 for the iteration and the step control, theory (4.1).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.collocation import Collocation, radau_scheme
from zeno_orbits.integrators.engine import FAR
from zeno_orbits.integrators.flow import FlowWithEvent, StageGuess, Tolerance
from zeno_orbits.integrators.stepping import SteppingEngine
from zeno_orbits.integrators.steps import RadauStep, cut, first_size, solved, too_small
from zeno_orbits.work import Checked

SAFETY = 0.9
SHRINK, GROW = 0.1, 6.0
N_STAGES = 7
"""Stages of a step, for order 13."""

UNSOLVED = 0.3
"""Factor of the step size after an iteration that did not converge."""


@dataclass(frozen=True, kw_only=True)
class Radau(SteppingEngine, Checked):
    """Radau IIA with simplified Newton iterations.

    Attributes:
        scheme: The collocation scheme, of an odd number of stages.
        largest_step: No step is longer than this, in the time of the flow.
    """

    scheme: Collocation = field(default_factory=lambda: radau_scheme(N_STAGES))
    largest_step: float = math.inf

    def steps(
        self,
        flow: FlowWithEvent,
        y: Vector,
        tolerance: Tolerance,
        horizon: float = FAR,
        *,
        time: float = 0.0,
        size: float | None = None,
    ) -> Iterator[RadauStep]:
        """Yield steps from ``y``, without end.

        Args:
            flow: The flow.
            y: State at the start, ``(n_y,)``.
            tolerance: Local error of a step.
            horizon: Largest step size.
            time: Time at the start.
            size: First trial step size, by default estimated.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        pieces = flow.newton(self.scheme)
        largest = min(self.largest_step, horizon)
        size = min(size or first_size(flow, y, tolerance), largest)
        exponent = -1.0 / (self.scheme.n_stages + 1)
        last: RadauStep | None = None
        refused = False
        wanted, size = cut(flow, y, size)
        while True:
            guess = None if last is None else StageGuess(last.coefficients, 1.0, size / last.size)
            found = solved(pieces, y, size, tolerance, guess)
            error = math.inf if found is None else found.error
            factor = SAFETY * max(error, 1e-300) ** exponent if error < math.inf else UNSOLVED
            if found is None or not error <= 1.0:
                part = max(SHRINK, min(factor, 0.5 if last is None else 1.0))
                size = min(size, sys.float_info.max) * part
                refused = True
                if not size > 4 * math.ulp(time) or size < 1e-300:
                    raise too_small("the flow is singular", time, y)
                continue
            last = RadauStep(
                flow=flow,
                scheme=self.scheme,
                tolerance=tolerance,
                start=time,
                size=size,
                before=y,
                after=found.after,
                coefficients=found.coefficients,
            )
            yield last
            time += size
            y = last.after
            size *= min(1.0 if refused else GROW, factor)
            size = min(size if refused else max(size, wanted), largest)
            wanted, size = cut(flow, y, size)
            refused = False
