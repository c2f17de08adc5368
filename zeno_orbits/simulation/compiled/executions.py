"""Executions by the compiled loop, whose reference is the plain simulator in Python.

The loop carries out a whole execution, with all its mode logic. It asks for the formulas of a mode
when a motion first needs them. `programs` names the machines that it cannot carry out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.integrators import RungeKutta, Step, Tolerance
from zeno_orbits.loop import GraphProgram, LoopRun, UnknownOperationError, binding
from zeno_orbits.model import GraphMode, HybridDynamics, require_start
from zeno_orbits.simulation.compiled.interrupted import interruption
from zeno_orbits.simulation.compiled.programs import add_asked, program_of_graph
from zeno_orbits.simulation.compiled.task_settings import (
    are_known,
    filled_settings,
    tolerance_of,
)
from zeno_orbits.simulation.events import Event
from zeno_orbits.simulation.execution import Execution
from zeno_orbits.simulation.pieces import Piece
from zeno_orbits.simulation.recorded import RecordedExecution, RecordedRun, events_of
from zeno_orbits.simulation.reference_run import ReferenceRun
from zeno_orbits.simulation.settings import SimulationTask
from zeno_orbits.simulation.zeno.completion import FINEST, ZenoPassage
from zeno_orbits.simulation.zeno.rescaled_flight import Flight, rescaled_flights
from zeno_orbits.simulation.zeno.zeno_limit import ZenoLimit
from zeno_orbits.simulation.zeno.zeno_passage import pass_through
from zeno_orbits.work import silent

_STEPS, _EVENTS = 256, 12
"""Rows of the records of a piece: about a sequence of impacts to its release."""


def serves(task: SimulationTask) -> bool:
    """Return True if the loop can carry out a task: formulas, steps and completion are its own."""
    return are_known(task.settings) and not isinstance(program_of_graph(task.graph), str)


def by_loop(task: SimulationTask) -> Execution | None:
    """Return the completed execution, or ``None`` if the loop cannot carry it out.

    Args:
        task: The simulation task.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued.
    """
    if not serves(task):
        return None
    run = _Run(task)
    # With few rows of arcs it comes back often.
    rows = {} if task.on_progress is silent else {"arcs": 3}
    try:
        task.on_progress("simulating", 0.0)
        while not run.is_over:
            run.go_on(**rows)
            reached = task.until if run.is_over else run.loop.now()[0]
            task.report(reached)
        return run.execution()
    except UnknownOperationError:
        # Of a mode that the motion has come to.
        return None
    except SimulationError as error:
        error.execution = run.execution() if len(run.loop.record().arcs) else None
        raise
    finally:
        run.loop.close()


def pieces_by_loop(task: SimulationTask) -> Iterator[Piece]:
    """Yield the completed execution in pieces, carried out by the loop.

    Args:
        task: Simulation task for which `serves` is true.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued, after the piece before that.
    """
    run = _Run(task)
    n_x = len(task.graph.state_names)
    # A run that ends at a release is not left before that.
    events = _EVENTS if task.most_releases == math.inf else _STEPS
    events = max(events, run.loop.least_events)
    interrupted: SimulationError | None = None
    try:
        while not run.is_over and interrupted is None:
            try:
                run.go_on(steps=_STEPS, polynomials=64, arcs=32, events=events)
            except SimulationError as error:
                interrupted = error
            record = run.loop.taken()
            time, mode, state = run.mode_now()
            if run.is_over and len(record.arcs):
                # The run itself stores only the start of its last arc.
                last = record.arcs[-1]
                mode, time = run.starts(record.arcs[-1:])[0][1], float(last[2])
                state = last[binding.ARC_WIDTH + n_x :][:n_x]
            yield Piece(
                events=run.events_of(record.events),
                states=record.steps[:, 2 : 2 + n_x],
                time=time,
                state=state,
                mode=mode,
                starts=partial(run.starts, record.arcs),
            )
        if interrupted is not None:
            raise interrupted
    finally:
        run.loop.close()


class PairByLoop:
    """Two motions that the loop follows side by side, turn by turn."""

    def __init__(
        self,
        task: SimulationTask,
        *,
        direction: Vector,
        scale: Vector,
        distance: float,
        vanished: float,
    ) -> None:
        """Begin at a state.

        Args:
            task: One turn of the first motion, for which `serves` is true.
            direction: Direction from it to the other motion, zero for the clock, ``(n_x,)``.
            scale: Size of each state, ``(n_x,)``.
            distance: Distance of both at the start of a turn, in these sizes.
            vanished: Part of it below which a distance is rounding.
        """
        self._run, n = _Run(task, records=False), task.state.size
        self._pair = pair = binding.PairType(
            turn=task.until,
            distance=distance,
            vanished=vanished,
            sides=(1 << len(task.graph.open_mode[1])) - 1,
        )
        for name, values in (("first", task.state), ("direction", direction), ("scale", scale)):
            getattr(pair, name)[:n] = values.tolist()
        for k in task.graph.first.clock:
            pair.in_clock[k] = 1

    def rates(self, count: int) -> list[float]:
        """Return ``ln(d / d_0) / T`` of the next turns, for those that began apart [1/s].

        Args:
            count: Number of turns.

        Raises:
            SimulationError: If a motion cannot be continued.
            UnknownOperationError: If a formula holds an operation that tapes do not have.
        """
        pair, found = self._pair, np.empty(count)
        pair.n_turns, pair.n_rates, pair.rates = 0, 0, found.ctypes.data
        self._run.carry(lambda: self._run.loop.turns(pair, count))
        return found[: pair.n_rates].tolist()

    def close(self) -> None:
        """Free the memory. Further turns are impossible afterwards."""
        self._run.loop.close()


class _Run:
    """A run of the loop in progress, with what it asks of Python."""

    def __init__(self, task: SimulationTask, *, records: bool = True) -> None:
        """Begin the run of a task.

        Args:
            task: The simulation task.
            records: Whether steps and arcs are recorded.

        Raises:
            InputError: If the state is not admissible.
        """
        graph, program = task.graph, program_of_graph(task.graph)
        if isinstance(program, str):
            reason = f"Argument `task` must be one of the compiled loop, but {program}."
            raise ValueError(reason)  # noqa: TRY004
        if not task.goes_on:
            require_start(graph, task.state, task.settings.contact)
        self._task, self._program = task, program
        self._paths: dict[float, tuple[Step, ...]] = {}
        self._rules: ReferenceRun | None = None
        self._modes: dict[tuple[int, int], GraphMode] = {}
        settings = filled_settings(task)
        for place in settings:
            place.records = records
        self.loop = LoopRun(program, settings, graph.p, task.state)
        self.is_over = False

    def events_of(self, rows: Vector) -> list[Event]:
        """Return the events of rows of the record."""
        graph = self._task.graph
        return events_of(rows, len(graph.state_names), graph.stop_names, graph.switch_names)

    def starts(self, rows: Vector) -> list[tuple[float, GraphMode]]:
        """Return start time and mode of arcs by their rows of the record."""
        found = list[tuple[float, GraphMode]]()
        views = tuple(self._program.views)
        for row in rows:
            view = views[int(row[binding.ARC_WIDTH - 1])]
            held = (view.stop,) if row[0] == binding.LOCKED else ()
            found.append((float(row[1]), (tuple(sorted((*view.closed, *held))), view.sides)))
        return found

    def mode_now(self) -> tuple[float, GraphMode, Vector]:
        """Return time, mode and state that the run has reached."""
        time, mode, state = self.loop.now()
        seen, graph = self.loop.outlook(), self._task.graph
        stops = seen.rest | (1 << seen.focus if mode == binding.LOCKED else 0)
        key = stops, seen.sides
        if key not in self._modes:
            closed = tuple(k for k in range(graph.n_watched) if stops >> k & 1)
            n_kinks = len(graph.switch_names) - graph.n_declared
            self._modes[key] = closed, tuple(bool(seen.sides >> k & 1) for k in range(n_kinks))
        return time, self._modes[key], state

    def go_on(self, **rows: int) -> None:
        """Continue until the run ends, or a record of these numbers of rows is full.

        Raises:
            SimulationError: If the execution cannot be continued.
            UnknownOperationError: If a formula holds an operation that tapes do not have.
        """
        self.carry(lambda: self.loop.resume(**rows))

    def carry(self, on: Callable[[], int]) -> None:
        """Call a function that carries the loop on until it has ended or its records are full.

        Args:
            on: The function. It returns a status, to which the loop is answered.

        Raises:
            SimulationError: If the execution cannot be continued.
            UnknownOperationError: If a formula holds an operation that tapes do not have.
        """
        while True:
            status = on()
            if status == binding.MODE and isinstance(self._program, GraphProgram):
                asked = self._program.asked_for(self.loop.detail().about)
                add_asked(self._task.graph.compiled, self._program, asked)
            elif status == binding.CURVE:
                limit = self._curve_limit()
                if limit is not None:
                    self._paths[limit.time] = limit.path
                self.loop.answer(None if limit is None else (limit.time, limit.error, limit.state))
            elif status in (binding.FULL, binding.DONE):
                self.is_over = status == binding.DONE
                return
            else:
                raise interruption(self._task, status, self.loop.detail())

    def execution(self) -> RecordedExecution:
        """Return the execution so far."""
        return RecordedExecution.of(
            RecordedRun(
                graph=self._task.graph,
                views=tuple(self._program.views),
                tolerance=tolerance_of(self._task),
                record=self.loop.record(),
                paths=self._paths,
            )
        )

    def _curve_limit(self) -> ZenoLimit | None:
        """Return the Zeno point at the end of the curve of the impacts, if nothing else is near."""
        rule = self._task.settings.completion
        if not isinstance(rule, ZenoPassage):
            return None
        rules, asked = self._looking(), self.loop.detail()
        limit = pass_through(
            rules.dynamics,
            _flights(rules.dynamics, rule, self.loop),
            asked.time,
            asked.state,
            asked.number,
            rule.tolerance,
            most_flights=int(asked.steps),
        )
        if limit is None or limit.time >= self._task.until or not rules.is_clear(limit):
            return None
        return limit

    def _looking(self) -> ReferenceRun:
        """Return a run of the reference, whose rules apply along the curve of many impacts."""
        if self._rules is None:
            self._rules = ReferenceRun.of(self._task)
        rules, seen, graph = self._rules, self.loop.outlook(), self._task.graph
        n_stops, n_switches, n = graph.n_watched, len(graph.switch_names), graph.n_declared
        rules.above = tuple(bool(seen.above >> k & 1) for k in range(n))
        rules.sides = tuple(bool(seen.sides >> k & 1) for k in range(n_switches - n))
        split = frozenset(k for k in range(n_switches) if seen.splits >> k & 1)
        rules.split_by = split, frozenset()
        rules.look(tuple(k for k in range(n_stops) if seen.rest >> k & 1), seen.focus)
        return rules


def _flights(dynamics: HybridDynamics, rule: ZenoPassage, run: LoopRun) -> Flight:
    """Return single flights, carried out by the loop if their steps are its own."""
    finest: Tolerance = FINEST.times(dynamics.own.least)
    if type(rule.engine) is not RungeKutta or rule.engine.largest_step < math.inf:
        return rescaled_flights(dynamics, rule.engine, finest)

    def flight(state_plus: Vector, speed: float) -> tuple[float, Vector, float] | None:
        return run.flight(state_plus, speed, finest.relative, finest.absolute)

    return flight
