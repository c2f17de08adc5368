"""The reference engine: SciPy's integrators, slow and independent of ours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import StepSizeError
from zeno_orbits.integrators.engine import Segment, SegmentResult
from zeno_orbits.integrators.flow import FlowWithEvent, Tolerance
from zeno_orbits.integrators.following import follow_steps
from zeno_orbits.integrators.steps import hermite_box

if TYPE_CHECKING:
    from scipy.integrate import DOP853, LSODA, Radau

_FAR = 1e300
"""A time bound that no flow reaches, as SciPy's solvers require a bound."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SciPy:
    """A method of ``scipy.integrate``, stepped by hand.

    Attributes:
        method: ``DOP853``, ``Radau`` (stiff) or ``LSODA`` of ``scipy.integrate``, the class itself.
        largest_step: No step is longer than this, in the time of the flow.
    """

    method: type[DOP853] | type[Radau] | type[LSODA]
    largest_step: float = np.inf

    def follow(self, leg: Segment) -> SegmentResult:
        """Follow a flow until its guard falls through zero or the time is over.

        Raises:
            StepSizeError: If the integrator gives up.
        """
        return follow_steps(self.steps(leg.flow, leg.y, leg.tolerance), leg)

    def steps(self, flow: FlowWithEvent, y: Vector, tolerance: Tolerance) -> Iterator[SciPyStep]:
        """Yield steps from ``y`` on, without end.

        Raises:
            StepSizeError: If the integrator gives up.
        """
        from scipy.integrate import LSODA

        solver = self.method(
            lambda _, state: flow.rate(np.asarray(state, dtype=np.float64)),
            0.0,
            y,
            _FAR,
            max_step=self.largest_step,
            rtol=tolerance.relative,
            atol=tolerance.absolute,
        )
        before = y
        while True:
            if not isinstance(solver, LSODA):
                # LSODA keeps its first bound.
                solver.max_step = min(self.largest_step, flow.longest(before))
            start = float(solver.t)
            with np.errstate(all="ignore"):
                # The NaN of a step that overflows rejects the step, so a warning would be
                # superfluous.
                message = solver.step()
            if solver.status == "failed":
                raise StepSizeError(
                    f"SciPy's {self.method.__name__} stopped: {message}",
                    time=start,
                    state=tuple(before.tolist()),
                )
            after = np.array(solver.y, dtype=np.float64)
            yield SciPyStep(
                engine=self,
                flow=flow,
                tolerance=tolerance,
                start=start,
                size=float(solver.t) - start,
                before=before,
                after=after,
            )
            before = after


@dataclass(frozen=True, slots=True, kw_only=True)
class SciPyStep:
    """A step of SciPy's solver. States inside are integrated again for accuracy."""

    engine: SciPy
    flow: FlowWithEvent
    tolerance: Tolerance
    start: float
    size: float
    before: Vector
    after: Vector

    def state_at(self, offset: float) -> Vector:
        """Return the state ``offset`` after the start of the step."""
        if offset == 0.0:
            return self.before
        if offset == self.size:
            return self.after
        from scipy.integrate import solve_ivp

        solution = solve_ivp(
            lambda _, state: self.flow.rate(np.asarray(state, dtype=np.float64)),
            (0.0, offset),
            self.before,
            method=self.engine.method,
            t_eval=[offset],
            rtol=self.tolerance.relative,
            atol=self.tolerance.absolute,
        )
        return np.asarray(solution.y[:, -1], dtype=np.float64)

    def end_at(self, offset: float) -> Vector:
        """Return the same: nothing is interpolated."""
        return self.state_at(offset)

    def box(self, left: float, right: float, low: Vector, high: Vector) -> tuple[Vector, Vector]:
        """Return bounds of the states between two offsets, at which they are given."""
        return hermite_box(self.flow, right - left, low, high)
