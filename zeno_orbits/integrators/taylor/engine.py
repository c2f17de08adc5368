"""The fast engine: Taylor series of heyoka, compiled from the formulas of a model.

A leg is one call into compiled code that ends at the fall of the guard. Whatever looks odd in what
comes back is followed again, step by step, as by every other engine: heyoka drops a fall without a
word where the guard is exactly zero at the start of a step. Needs the extra `taylor`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.engine import Leg, Outcome, Passage
from zeno_orbits.integrators.events import SteppedTrajectory, follow_steps
from zeno_orbits.integrators.flow import GuardedFlow, Tolerance
from zeno_orbits.integrators.steps import first_size
from zeno_orbits.integrators.taylor.modes import Carrier, SymbolicMode, carrier, stepper, symbols_of

_FIRST_BOUND, _BOUND_GROWTH = 1.0, 16.0
"""Bound of the steps in the first batch, and its growth from batch to batch: a polynomial flow
allows steps of any length, in which a root would drown."""

_FEWEST, _MOST = 256, 4096
"""Steps in the first and in later batches, between two looks from Python."""

_GROWTH = 8.0
"""Growth of single steps at most."""

_NET = 1e-9
"""Depth of the net under the guard, as part of guard and rate at the start."""

_SHALLOW = 1e-12
"""A rise from the guard lower than this is rounding where a leg does not say what is."""

_ON_ROOT = 1e-9
"""A root is one if the guard there is below this part of what it fell from."""

_MOST_FALSE_FALLS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Taylor:
    """Taylor's method of an order that fits the tolerance.

    heyoka measures the error of a step by the largest entry of the state and not entry by entry:
    it is below the smaller of the two tolerances, times that entry where that is above 1.
    """

    def require(self, flow: GuardedFlow, y: Vector) -> None:
        """Refuse a flow that has no formulas, or not analytic ones.

        Args:
            flow: The flow.
            y: Where a leg may start: what is zero there and stays so is left out of the series.

        Raises:
            InputError: It says why.
        """
        mode, _ = symbols_of(flow)
        carrier(mode, _single(Tolerance()), y)

    def follow(self, leg: Leg) -> Passage:
        """Follow a flow until its guard falls through zero or the time is over.

        Raises:
            InputError: If heyoka is missing, or the flow has no formulas or not analytic ones.
            StepSizeError: If the step size falls to rounding level.
        """
        mode, p = symbols_of(leg.flow)
        passage = _carried(leg, mode, p, carrier(mode, _single(leg.tolerance), leg.y))
        return passage or follow_steps(self.steps(leg.flow, leg.y, leg.tolerance), leg)

    def steps(self, flow: GuardedFlow, y: Vector, tolerance: Tolerance) -> Iterator[TaylorStep]:
        """Yield steps from ``y`` on, without end.

        Raises:
            InputError: If heyoka is missing, or the flow has no formulas or not analytic ones.
            StepSizeError: If the step size falls to rounding level.
        """
        mode, p = symbols_of(flow)
        return _steps(mode, p, y, _single(tolerance), first_size(flow, y, tolerance))


def _single(tolerance: Tolerance) -> float:
    return min(tolerance.relative, tolerance.absolute)


def _steps(
    mode: SymbolicMode, p: Vector, y: Vector, tolerance: float, largest: float
) -> Iterator[TaylorStep]:
    """Yield steps from ``y`` on, the first no longer than ``largest``."""
    kept = stepper(mode, tolerance)
    time = 0.0
    while True:
        size, after, series = kept.step(time, y, p, largest)
        yield TaylorStep(start=time, size=size, before=y, after=after, series=series)
        time, y, largest = time + size, after, _GROWTH * size


@dataclass(frozen=True, slots=True, kw_only=True)
class TaylorStep:
    """One step with its series, which is as accurate inside the step as at its end."""

    start: float
    size: float
    before: Vector
    after: Vector
    series: Vector

    def state_at(self, offset: float) -> Vector:
        """Return the state ``offset`` after the start of the step."""
        if offset == self.size:
            return self.after
        state = self.series[:, -1]
        for k in range(self.series.shape[1] - 2, -1, -1):
            state = self.series[:, k] + offset * state
        return state

    def end_at(self, offset: float) -> Vector:
        """Return the same: a shorter step has the same series."""
        return self.state_at(offset)


def _carried(leg: Leg, mode: SymbolicMode, p: Vector, kept: Carrier) -> Passage | None:
    """Return what came of a leg followed in compiled code, or nothing where that is in doubt."""
    before = kept.begin(leg.y, p)
    if not (leg.on_guard or before[0] > 0.0):
        return None
    shallow = leg.rounding or _SHALLOW
    kept.set_net(max(shallow, _NET * (abs(before[0]) + abs(before[1]))))
    bound, batch, last, false_falls = _FIRST_BOUND, _FEWEST, 0.0, 0
    while True:
        outcome, steps, time = kept.advance(leg.horizon, bound, batch)
        if outcome not in {kept.fall, kept.time_limit, kept.step_limit}:
            return None
        end = kept.state.copy()
        leg.watch(steps, time, end)
        if outcome == kept.step_limit:
            if not time - last > batch * np.spacing(time):
                return None
            bound, batch, last = _BOUND_GROWTH * bound, min(4 * batch, _MOST), time
            continue
        value, rate = kept.guard()
        if outcome == kept.time_limit:
            return _passage(leg, mode, p, Outcome.HORIZON, leg.horizon, end) if value > 0 else None
        height = -rate * time
        if not leg.on_guard or height > shallow:
            sound = rate < 0.0 and abs(value) <= _ON_ROOT * max(before[0], height)
            return _passage(leg, mode, p, Outcome.FALL, time, end) if sound else None
        # The start is a root to rounding only, and the guard fell from less than that.
        false_falls += 1
        if false_falls > _MOST_FALSE_FALLS:
            return None


def _passage(
    leg: Leg, mode: SymbolicMode, p: Vector, outcome: Outcome, duration: float, end: Vector
) -> Passage:
    way = TaylorTrajectory(
        mode=mode, p=p, tolerance=_single(leg.tolerance), start=leg.y, duration=duration, end=end
    )
    return Passage(outcome=outcome, duration=duration, state=end, trajectory=way)


@dataclass(frozen=True, kw_only=True)
class TaylorTrajectory:
    """The flow along a leg, integrated again, with its series, once somebody asks for it.

    Attributes:
        mode: The formulas.
        p: Numbers in them.
        tolerance: Of a step.
        start: State at the start, ``(n_y,)``.
        duration: Where the leg ends.
        end: State there, ``(n_y,)``.
    """

    mode: SymbolicMode
    p: Vector
    tolerance: float
    start: Vector
    duration: float
    end: Vector

    @cached_property
    def _way(self) -> SteppedTrajectory:
        steps: list[TaylorStep] = []
        for step in _steps(self.mode, self.p, self.start, self.tolerance, self.duration):
            steps.append(step)
            if step.start + step.size >= self.duration:
                break
        return SteppedTrajectory(steps=tuple(steps), duration=self.duration, end=self.end)

    @property
    def times(self) -> Vector:
        """Starts of the steps of the second integration, and the end, ``(m,)``."""
        return self._way.times

    @property
    def states(self) -> Vector:
        """State at each of these times, ``(m, n_y)``."""
        return self._way.states

    def state_at(self, offset: float) -> Vector:
        """Return the state at a time from the start; its ends cost nothing."""
        if offset <= 0.0:
            return self.start
        return self.end if offset >= self.duration else self._way.state_at(offset)
