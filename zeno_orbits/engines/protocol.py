"""The small protocol behind which every integrator stands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from zeno_orbits.dynamics import GuardedFlow, Tolerance, Vector


class Step(Protocol):
    """One accepted step; the state inside it is as accurate as at its end."""

    @property
    def start(self) -> float:
        """Time at its start, from the start of the flow."""
        ...

    @property
    def size(self) -> float:
        """Its length in time."""
        ...

    @property
    def before(self) -> Vector:
        """State at its start."""
        ...

    @property
    def after(self) -> Vector:
        """State at its end."""
        ...

    def state_at(self, offset: float) -> Vector:
        """Return the state ``offset`` after the start of the step, ``0 <= offset <= size``."""
        ...


class Engine(Protocol):
    """An integrator."""

    def steps(self, flow: GuardedFlow, y: Vector, tolerance: Tolerance) -> Iterator[Step]:
        """Yield steps from ``y`` on, without end.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """A step that knows its flow: the state inside is another, shorter step from the start."""

    flow: GuardedFlow
    tolerance: Tolerance
    start: float
    size: float
    before: Vector
    after: Vector

    def state_at(self, offset: float) -> Vector:
        """Return the state ``offset`` after the start of the step."""
        if offset == self.size:
            return self.after
        return self.flow.attempt(self.before, offset, self.tolerance)[0]
