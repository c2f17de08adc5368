"""One way to follow a leg, shared by all engines that step: the reference of the compiled loop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.engine import FAR, BoxedStep, Segment, SegmentResult
from zeno_orbits.integrators.flow import FlowWithEvent, Tolerance
from zeno_orbits.integrators.following import follow_steps


class SteppingEngine(ABC):
    """An engine that takes steps."""

    __slots__ = ()

    @abstractmethod
    def steps(
        self, flow: FlowWithEvent, y: Vector, tolerance: Tolerance, horizon: float = FAR
    ) -> Iterator[BoxedStep]:
        """Yield steps from ``y`` on, without end.

        Args:
            flow: The flow.
            y: State at the start, ``(n_y,)``.
            tolerance: Local error of a step.
            horizon: No step is longer.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """

    def follow(self, leg: Segment) -> SegmentResult:
        """Follow a flow until its guard falls through zero or the time is over.

        Args:
            leg: The leg.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        return follow_steps(self.steps(leg.flow, leg.y, leg.tolerance, leg.horizon), leg)
