"""The record of a compiled run as arcs and events, which become values once somebody asks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import (
    ExplicitStep,
    FlowWithEvent,
    RadauStep,
    Step,
    SteppedTrajectory,
    Tolerance,
    Trajectory,
    radau_scheme,
)
from zeno_orbits.loop import LoopRecord, TapedProblem, View, binding, program_of
from zeno_orbits.model import (
    CharacteristicScales,
    CompiledFlow,
    GraphDynamics,
    HybridDynamics,
)
from zeno_orbits.simulation.events import Event, EventKind, Impact, Release, SwitchEvent, ZenoPoint
from zeno_orbits.simulation.execution import Arc, Ending, Execution, Mode, closed_names

_ENDINGS = {kind.number: Ending(kind.label) for kind in EventKind}
_ENDINGS[binding.HORIZON] = Ending.HORIZON


def events_of(
    rows: Vector, n_x: int, stops: Sequence[str] = ("",), switches: Sequence[str] = ()
) -> list[Event]:
    """Return the events of rows of the record.

    Args:
        rows: In each row kind, time, three numbers, stop or switch, the state before and after.
        n_x: Number of states.
        stops: Names of the stops.
        switches: Names of the switches.
    """
    numbers = rows[:, : binding.EVENT_WIDTH].tolist()
    before = rows[:, binding.EVENT_WIDTH : binding.EVENT_WIDTH + n_x]
    after = rows[:, binding.EVENT_WIDTH + n_x :]
    return [
        _event_of(row, x, y, (switches if row[0] == binding.SWITCH else stops)[int(row[5])])
        for row, x, y in zip(numbers, before, after, strict=True)
    ]


def _event_of(numbers: list[float], before: Vector, after: Vector, stop: str) -> Event:
    kind, time, first, tail, speed, _ = numbers
    if kind == binding.SWITCH:
        return SwitchEvent(time=time, name=stop, state_minus=before, state_plus=after)
    if kind == binding.IMPACT:
        return Impact(
            time=time, state_minus=before, state_plus=after, approach_rate=first, stop=stop
        )
    if kind == binding.RELEASE:
        return Release(time=time, state=before, stop=stop)
    return ZenoPoint(
        time=time, state=before, limit_error=first, tail=tail, last_speed=speed, stop=stop
    )


@dataclass(kw_only=True, eq=False)
class RecordedRun:
    """A run with the context of its record. Its arcs and events are made at the first question.

    Attributes:
        graph: The graph of modes.
        views: The stops and modes of the arcs, in the order of their indices.
        tolerance: Local error of the steps.
        record: Record of the run.
        paths: Curves of the impacts by the times of Zeno points that were found along them.
    """

    graph: GraphDynamics
    views: Sequence[View]
    tolerance: Tolerance
    record: LoopRecord
    paths: Mapping[float, tuple[Step, ...]]

    @property
    def state_names(self) -> tuple[str, ...]:
        """Name of each state."""
        return self.graph.state_names

    @property
    def own(self) -> CharacteristicScales:
        """Characteristic scales of the problem."""
        return self.graph.own

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """The events in order of time."""
        names = self.graph.stop_names, self.graph.switch_names
        return tuple(events_of(self.record.events, len(self.state_names), *names))

    @cached_property
    def arcs(self) -> tuple[Arc, ...]:
        """The arcs in order of time."""
        return tuple(map(self._arc, self.record.arcs))

    @property
    def end_time(self) -> float:
        """Time of the end [s]."""
        return float(self.record.arcs[-1, 2])

    @property
    def end_state(self) -> Vector:
        """State at the end, ``(n_x,)``."""
        n_x = len(self.state_names)
        return self.record.arcs[-1, binding.ARC_WIDTH + n_x :][:n_x]

    def _arc(self, row: Vector) -> Arc:
        view, names = self.views[int(row[binding.ARC_WIDTH - 1])], self.graph.stop_names
        dynamics = self.graph.view((view.closed, view.sides), view.stop)
        n_x = len(self.state_names)
        mode, start, end, unit, duration, ending, *counts = row[: binding.ARC_WIDTH].tolist()
        n_y = n_x + 2 if mode == binding.FLIGHT else n_x
        first = row[binding.ARC_WIDTH : binding.ARC_WIDTH + n_x]
        last = row[binding.ARC_WIDTH + n_x : binding.ARC_WIDTH + n_x + n_y]
        ended = _ENDINGS[int(ending)]
        *counts, launch, height, _ = counts
        index, first_step, n_steps, first_polynomial, n_polynomials = map(int, counts)
        way: Trajectory | None
        if ended is Ending.ZENO:
            path = self.paths.get(end, ())
            way = SteppedTrajectory(steps=path, duration=duration, end=last) if path else None
        else:
            begin = np.concatenate([first, (height, launch)]) if mode == binding.FLIGHT else first
            polynomials = self.record.polynomials[first_polynomial:][:n_polynomials]
            way = LoopTrajectory(
                flow=_Flow(dynamics, int(mode), unit),
                tolerance=self.tolerance,
                begin=begin,
                rows=self.record.steps[first_step : first_step + n_steps, : 2 + n_y],
                polynomials=polynomials[:, : binding.STAGES * n_y].reshape(
                    n_polynomials, binding.STAGES, n_y
                ),
                duration=duration,
                end=last,
            )
        held = (view.stop,) if mode == binding.LOCKED else ()
        closed = tuple(sorted((*view.closed, *held)))
        return Arc(
            mode=Mode.LOCKED if closed else Mode.FREE,
            start_time=start,
            end_time=end,
            start_state=first,
            end_state=last[:n_x],
            ending=ended,
            impact_index=index,
            time_unit=unit,
            trajectory=way,
            closed=closed_names(names, closed),
            stop=names[view.stop] if mode == binding.FLIGHT else "",
            sides=view.sides,
        )


_ARCS: Any = Execution.__dict__["arcs"]
"""Descriptor of an execution's arcs."""


class RecordedExecution(Execution):
    """An execution whose arcs and events are made of a record at the first question."""

    __slots__ = ("_run",)
    _run: RecordedRun

    @classmethod
    def of(cls, run: RecordedRun) -> RecordedExecution:
        """Return the execution of a run."""
        made = object.__new__(cls)
        for name, value in (
            ("state_names", run.state_names),
            ("own", run.own),
            ("_run", run),
        ):
            object.__setattr__(made, name, value)
        return made

    @property
    def end_time(self) -> float:
        """Time of its end [s], without a look at any arc if none was made."""
        return super().end_time if self._has_arcs else self._run.end_time

    @property
    def end_state(self) -> Vector:
        """State at its end, ``(n_x,)``, likewise."""
        return super().end_state if self._has_arcs else self._run.end_state

    @property
    def _has_arcs(self) -> bool:
        try:
            _ARCS.__get__(self, type(self))
        except AttributeError:
            return False
        return True

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a recipe for pickle, with arcs and events as values."""
        return _execution, tuple(getattr(self, one.name) for one in fields(Execution))

    def __getattr__(self, name: str) -> object:
        """Make arcs or events, which are then kept."""
        if name not in ("arcs", "events"):
            raise AttributeError(name)
        made = getattr(self._run, name)
        object.__setattr__(self, name, made)
        return made


def recorded_run(execution: Execution) -> RecordedRun | None:
    """Return the run of an execution with its record, if the loop made it in this process."""
    run = getattr(execution, "_run", None)
    return run if isinstance(run, RecordedRun) else None


def _execution(*values: Any) -> RecordedExecution:
    made = object.__new__(RecordedExecution)
    for one, value in zip(fields(Execution), values, strict=True):
        object.__setattr__(made, one.name, value)
    return made


class Carrier(NamedTuple):
    """The flow of an arc as the library has it.

    Attributes:
        program: Its formulas.
        p: Their parameters.
        mode: Its mode.
        speed: Unit of time of a rescaled flight.
    """

    program: TapedProblem
    p: Vector
    mode: int
    speed: float


@dataclass(frozen=True, slots=True)
class Made:
    """The flow of an arc that another process made."""

    flow: FlowWithEvent

    def made(self) -> FlowWithEvent:
        """Return the flow."""
        return self.flow

    def carrier(self) -> Carrier | None:
        """Return ``None``: the flow takes its steps by itself."""
        return None


class FlowOfLeg(NamedTuple):
    """The flow of a leg by itself.

    Attributes:
        flow: The flow.
        program: Its formulas as the library has them.
    """

    flow: CompiledFlow
    program: TapedProblem

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a recipe for pickle."""
        return Made, (self.flow,)

    def made(self) -> FlowWithEvent:
        """Return the flow."""
        return self.flow

    def carrier(self) -> Carrier | None:
        """Return the compiled code of its steps."""
        return Carrier(self.program, self.flow.p, binding.FREE, 1.0)


@dataclass(frozen=True, slots=True)
class _Flow:
    """The flow of an arc, made at the first question."""

    dynamics: HybridDynamics
    mode: int
    speed: float

    def __reduce__(self) -> tuple[Any, ...]:
        """Return a recipe for pickle, without the system that the flow belongs to."""
        return Made, (self.made(),)

    def made(self) -> FlowWithEvent:
        """Return the flow."""
        if self.mode == binding.FLIGHT:
            return self.dynamics.flight(self.speed)
        return self.dynamics.locked if self.mode == binding.LOCKED else self.dynamics.free

    def carrier(self) -> Carrier | None:
        """Return the compiled code of its steps, or ``None`` without compiled code."""
        formulas = self.dynamics.formulas
        program = None if formulas is None else program_of(formulas.system)
        if formulas is None or program is None:
            return None
        return Carrier(program, formulas.values, self.mode, self.speed)


class LoopTrajectory:
    """The flow along an arc, whose steps are built from their record at the first access."""

    __slots__ = (
        "_begin",
        "_flow",
        "_polynomials",
        "_rows",
        "_steps",
        "_tolerance",
        "duration",
        "end",
    )

    def __init__(
        self,
        *,
        flow: _Flow | FlowOfLeg | Made,
        tolerance: Tolerance,
        begin: Vector,
        rows: Vector,
        polynomials: Vector,
        duration: float,
        end: Vector,
    ) -> None:
        """Keep the record.

        Args:
            flow: The flow.
            tolerance: Local error of the steps.
            begin: State at the start, ``(n_y,)``.
            rows: Start, size and state after of every step, ``(n, 2 + n_y)``.
            polynomials: Polynomials of the last steps, which are implicit, ``(m, n_stages, n_y)``.
            duration: End of the arc, in the flow's own time.
            end: State at the end, ``(n_y,)``.
        """
        self._flow, self._tolerance, self._begin = flow, tolerance, begin
        self._rows, self._polynomials = rows, polynomials
        self.duration, self.end = duration, end
        self._steps: tuple[Step, ...] | None = None

    @property
    def steps(self) -> Sequence[Step]:
        """The steps, at least one."""
        if self._steps is None:
            self._steps = tuple(self._step(k) for k in range(len(self._rows)))
        return self._steps

    @property
    def times(self) -> Vector:
        """Starts of the steps, and the end, ``(m,)``."""
        return np.append(self._rows[:, 0], self.duration)

    @property
    def states(self) -> Vector:
        """State at each of these times, ``(m, n_y)``."""
        return np.concatenate([[self._begin], self._rows[:-1, 2:], [self.end]])

    def record(self, mode: int, unit: float, n_x: int) -> LoopRecord:
        """Return the record of an arc with these steps.

        Args:
            mode: Mode of the flow, a constant of `binding`.
            unit: Unit of its time [s].
            n_x: Number of states of the system.
        """
        n_y, n, m = self._begin.size, len(self._rows), len(self._polynomials)
        steps = np.zeros((n, binding.STEP_WIDTH + n_x + 2))
        steps[:, : binding.STEP_WIDTH + n_y] = self._rows
        polynomials = np.zeros((m, binding.STAGES * (n_x + 2)))
        polynomials[:, : binding.STAGES * n_y] = self._polynomials.reshape(m, binding.STAGES * n_y)
        arc = np.zeros((1, binding.ARC_WIDTH + 2 * n_x + 2))
        height, launch = self._begin[n_x:] if n_y > n_x else (0.0, 0.0)
        numbers = mode, 0, 0, unit, self.duration, 0, 0, 0, n, 0, m, launch, height, 0
        arc[0, : binding.ARC_WIDTH] = numbers
        arc[0, binding.ARC_WIDTH :][:n_x] = self._begin[:n_x]
        events = np.zeros((0, binding.EVENT_WIDTH + 2 * n_x))
        return LoopRecord(steps=steps, polynomials=polynomials, arcs=arc, events=events)

    def state_at(self, offset: float) -> Vector:
        """Return the state at a time from the start."""
        return self.end if offset >= self.duration else self.states_at(np.array([offset]))[0]

    def states_at(self, offsets: Vector) -> Vector:
        """Return the states at times from the start, ``(n, n_y)``."""
        rows, first = self._rows, len(self._rows) - len(self._polynomials)
        at = np.maximum(np.searchsorted(rows[:, 0], offsets, side="right") - 1, 0)
        starts, sizes = rows[at, 0], rows[at, 1]
        inside = np.minimum(np.maximum(offsets - starts, 0.0), sizes)
        before = np.concatenate([self._begin[None], rows[:-1, 2:]])[at]
        states = rows[at, 2:]
        within = inside < sizes
        explicit, implicit = within & (at < first), within & (at >= first)
        if np.any(explicit):
            states[explicit] = self._stepped(at[explicit], before[explicit], inside[explicit])
        if np.any(implicit):
            coefficients = self._polynomials[at[implicit] - first]
            part = inside[implicit] / sizes[implicit]
            moved = radau_scheme(binding.STAGES).increments(coefficients, part)
            states[implicit] = before[implicit] + moved
        states[offsets >= self.duration] = self.end
        return states

    def _stepped(self, at: NDArray[np.intp], before: Vector, sizes: Vector) -> Vector:
        """Return the states after parts of explicit steps, ``(n, n_y)``."""
        carrier = self._flow.carrier()
        if carrier is None:
            pairs = zip(at.tolist(), sizes.tolist(), strict=True)
            return np.array([self._step(k).state_at(size) for k, size in pairs])
        program, p, mode, speed = carrier
        return program.states_after(p, mode, speed, before, sizes)

    def _step(self, k: int) -> Step:
        start, size = self._rows[k, :2].tolist()
        before, after = self._rows[k - 1, 2:] if k else self._begin, self._rows[k, 2:]
        first = len(self._rows) - len(self._polynomials)
        flow = self._flow.made()
        if k < first:
            return ExplicitStep(flow, self._tolerance, start, size, before, after)
        return RadauStep(
            flow=flow,
            scheme=radau_scheme(binding.STAGES),
            tolerance=self._tolerance,
            start=start,
            size=size,
            before=before,
            after=after,
            coefficients=self._polynomials[k - first],
        )
