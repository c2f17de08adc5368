"""One way to follow a leg, shared by all engines that step; compiled where it can be."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import cached_property

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.compiled_leg import CompilableFlow, StepLoop
from zeno_orbits.integrators.engine import FAR, Leg, Passage, Step
from zeno_orbits.integrators.events import follow_steps
from zeno_orbits.integrators.flow import GuardedFlow, Tolerance

STEP_COST = 1e-5
"""What an interpreted step costs more than a compiled one [s]: 5 to 15 us were measured."""


class SteppingEngine(ABC):
    """An engine that takes steps, here or in compiled code."""

    __slots__ = ()

    @cached_property
    @abstractmethod
    def loop(self) -> StepLoop:
        """The steps that it takes."""

    @abstractmethod
    def steps(
        self, flow: GuardedFlow, y: Vector, tolerance: Tolerance, horizon: float = FAR
    ) -> Iterator[Step]:
        """Yield steps from ``y`` on, without end.

        Args:
            flow: The flow.
            y: State at the start, ``(n_y,)``.
            tolerance: Local error of a step.
            horizon: No step is longer.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """

    def follow(self, leg: Leg) -> Passage:
        """Follow a flow until its guard falls through zero or the time is over.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        code = leg.flow.leg_code() if isinstance(leg.flow, CompilableFlow) else None
        if code is not None:
            loop = self.loop
            if code.serves(loop):
                return code.follow(leg, loop)
        return self.follow_interpreted(leg)

    def follow_interpreted(self, leg: Leg) -> Passage:
        """Follow a flow step by step in Python: the reference of the compiled loop.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        passage = follow_steps(self.steps(leg.flow, leg.y, leg.tolerance, leg.horizon), leg)
        if isinstance(leg.flow, CompilableFlow):
            leg.flow.owe(STEP_COST * len(passage.trajectory.times))
        return passage
