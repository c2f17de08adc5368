"""Legs of single flows by the steps of the loop, for those who follow a machine of their own."""

from __future__ import annotations

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import (
    Engine,
    FlowWithEvent,
    Segment,
    SegmentResult,
    SteppingEngine,
    Termination,
    Tolerance,
    not_finite,
    too_small,
)
from zeno_orbits.loop import LegProgram, LegRecord, LegSettings, binding, leg_program
from zeno_orbits.model import CompiledFlow, ModeFunctions, unguarded
from zeno_orbits.simulation.compiled.steps import loop_steps
from zeno_orbits.simulation.recorded import FlowOfLeg, LoopTrajectory


class LegFollower:
    """Integrator of legs of flows: in compiled code if available, else by an engine."""

    def __init__(self, engine: Engine) -> None:
        """Take an engine.

        Args:
            engine: Its steps are taken.
        """
        self._engine, self._steps = engine, loop_steps(engine)
        self._programs: dict[ModeFunctions, LegProgram | None] = {}

    def follow(self, leg: Segment) -> SegmentResult:
        """Follow a flow until its guard falls through zero or the time is over.

        Args:
            leg: The leg.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        flow = leg.flow
        program = self.program(flow) if leg.reach is None else None
        if program is None or not isinstance(flow, CompiledFlow):
            return self._engine.follow(leg)
        found = self.recorded(program, flow, leg)
        if found.status == binding.LEFT and found.detail is not None:
            duration, state, outcome = found.detail.time, found.detail.state, Termination.LEFT
        else:
            _require_done(found, leg.y)
            duration, state = found.duration, found.end
            outcome = Termination.FALL if found.fell else Termination.HORIZON
        trajectory = LoopTrajectory(
            flow=FlowOfLeg(flow, program),
            tolerance=leg.tolerance,
            begin=leg.y,
            rows=found.rows,
            polynomials=found.polynomials,
            duration=duration,
            end=state,
        )
        return SegmentResult(outcome=outcome, duration=duration, state=state, trajectory=trajectory)

    def program(self, flow: FlowWithEvent) -> LegProgram | None:
        """Return a flow as the library has it, or ``None`` if its legs are the engine's."""
        if self._steps is None or not isinstance(flow, CompiledFlow):
            return None
        try:
            return self._programs[flow.mode]
        except KeyError:
            program = self._programs[flow.mode] = leg_program(flow.mode)
            return program

    def recorded(self, program: LegProgram, flow: CompiledFlow, leg: Segment) -> LegRecord:
        """Return the record of a leg.

        Args:
            program: The flow as the library has it.
            flow: The flow.
            leg: The leg.
        """
        tolerance, steps = leg.tolerance, self._steps
        if steps is None:
            raise ValueError("Argument `program` must come from this follower.")
        settings = LegSettings(
            leg.horizon,
            tolerance.relative,
            tolerance.absolute,
            flow.weights,
            leg.on_guard,
            leg.rounding,
            leg.late,
            steps.begins_explicit,
            steps.goes_implicit,
            steps.largest_explicit,
            steps.largest_implicit,
        )
        return program.follow(settings, flow.p, leg.y, leg.watch)


def states_after_steps(
    flow: FlowWithEvent, engine: SteppingEngine, y: Vector, tolerance: Tolerance, duration: float
) -> Vector:
    """Return the states after the steps of a flow, for any guard, ``(n, n_y)``.

    Args:
        flow: The flow.
        engine: Integrator of the flow.
        y: State at the start, ``(n_y,)``.
        tolerance: Local error of a step.
        duration: All steps end before this time.

    Raises:
        StepSizeError: If the step size falls to rounding level.
    """
    if isinstance(flow, CompiledFlow):
        free, follower = unguarded(flow), LegFollower(engine)
        program = follower.program(free)
        if program is not None:
            leg = Segment(flow=free, y=y, horizon=duration, tolerance=tolerance, on_guard=False)
            found = follower.recorded(program, free, leg)
            _require_done(found, y)
            inside = found.rows[:, 0] + found.rows[:, 1] < duration
            return found.rows[inside, 2:]
    states: list[Vector] = []
    for step in engine.steps(flow, y, tolerance, duration):
        if not step.start + step.size < duration:
            break
        states.append(step.after)
    return np.reshape(states, (len(states), len(y)))


def _require_done(found: LegRecord, start: Vector) -> None:
    """Reject a leg that ended in an error, with the messages of the engines.

    Raises:
        StepSizeError: If the step size falls to rounding level. The message contains the cause.
    """
    if found.status == binding.NOT_FINITE:
        raise not_finite(start)
    if found.detail is not None:
        stiff = found.status == binding.TOO_STIFF
        reason = "the flow is too stiff or singular" if stiff else "the flow is singular"
        raise too_small(reason, found.detail.time, found.detail.state)
