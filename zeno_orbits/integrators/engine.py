"""The common protocol of all integrators: integrate a flow until its guard crosses zero."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, TypeVar, dataclass_transform

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.flow import FlowWithEvent, Tolerance

FAR = 1e300
"""A horizon that no flow reaches. Steps that grow without bound end in NaN."""

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False)
def fast_dataclass(of: type[T]) -> type[T]:
    """Make a class a value of which an execution makes thousands: not frozen but to type checkers.

    To make a frozen dataclass takes three times as long, which was a sixth of a simulation.
    """
    return dataclass(slots=True, kw_only=True, eq=False)(of)


Watch = Callable[[int, float, Vector], None]
"""Told of every few steps: how many, the time at their end, the state there. It may raise."""


def unwatched(_steps: int, _time: float, _state: Vector) -> None:
    """Let the integration continue. This is the default watch function of a leg.

    Args:
        _steps: Steps since the last call.
        _time: Time reached, in the flow's unit.
        _state: State at that time, ``(n_y,)``.
    """


@fast_dataclass
class Segment:
    """A task of an engine: a flow, its initial state and its end.

    Attributes:
        flow: The flow, autonomous.
        y: State at its start, ``(n_y,)``.
        horizon: Longest duration, in the flow's own time.
        tolerance: Local error of a step.
        on_guard: Whether the start is a root of the guard that does not count.
        rounding: Rounding level of the guard. A guard that has not risen above this value cannot
            cross zero, and a guard below minus this value has crossed zero.
        late: Time before the horizon in which a zero of the guard does not count.
        watch: Callback for progress. It may end a leg that takes too long or leaves its bounds.
        reach: Bounds of the moduli of the first state entries, ``(n,)``. Beyond a bound the watch
            function is called immediately. Otherwise many steps may pass between two calls.
        is_low: Whether the formula of the guard is rounding, so that only its state counts.
        returns: Whether the guard may rise from its root and fall more than once in a step, as that
            of a table with short cells.
    """

    flow: FlowWithEvent
    y: Vector
    horizon: float
    tolerance: Tolerance
    on_guard: bool
    rounding: float = 0.0
    late: float = 0.0
    watch: Watch = unwatched
    reach: Vector | None = None
    is_low: bool = False
    returns: bool = False


class Termination(Enum):
    """The end of a leg. The value is the phrase shown to the user."""

    FALL = "the guard fell through zero"
    HORIZON = "the end of the time was reached"
    LEFT = "the flow left the guard on the wrong side"


class Trajectory(Protocol):
    """The flow along a leg."""

    @property
    def duration(self) -> float:
        """The end of the leg, in the flow's own time from the start."""
        ...

    @property
    def times(self) -> Vector:
        """Starts of the steps, and the end, in the flow's own time from the start, ``(m,)``."""
        ...

    @property
    def states(self) -> Vector:
        """State at each of these times, ``(m, n_y)``."""
        ...

    def state_at(self, offset: float) -> Vector:
        """Return the state at a time from the start, ``(n_y,)``, as accurate as the steps."""
        ...

    def states_at(self, offsets: Vector) -> Vector:
        """Return the states at times from the start, ``(n, n_y)``, as accurate as the steps."""
        ...


@fast_dataclass
class SegmentResult:
    """The result of a leg.

    Attributes:
        outcome: How it ended.
        duration: Time that it took, in the flow's own.
        state: State at its end, ``(n_y,)``.
        trajectory: The flow on the way.
    """

    outcome: Termination
    duration: float
    state: Vector
    trajectory: Trajectory


class Engine(Protocol):
    """An integrator."""

    def follow(self, leg: Segment) -> SegmentResult:
        """Follow a flow until its guard falls through zero or the time is over.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        ...


class Step(Protocol):
    """One accepted step of an engine that steps."""

    @property
    def start(self) -> float:
        """Start time of the step, counted from the start of the flow."""
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
        """Return the state ``offset`` after the start of the step, as dense output gives it."""
        ...

    def end_at(self, offset: float) -> Vector:
        """Return the state after a step that ends ``offset`` after the start: a true end."""
        ...


class BoxedStep(Step, Protocol):
    """A step that bounds its states."""

    def box(self, left: float, right: float, low: Vector, high: Vector, /) -> tuple[Vector, Vector]:
        """Return lower and upper bounds of the states between two offsets, each ``(n_y,)``.

        Args:
            left: One offset.
            right: The other.
            low: State at the left one, ``(n_y,)``.
            high: State at the right one.
        """
        ...


class Stepper(Protocol):
    """An engine that steps, and lets others watch."""

    def steps(self, flow: FlowWithEvent, y: Vector, tolerance: Tolerance) -> Iterator[Step]:
        """Yield steps from ``y`` on, without end.

        Args:
            flow: The flow.
            y: State at the start, ``(n_y,)``.
            tolerance: Local error of a step.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        ...
