"""Executions over a graph of modes by the compiled loop, whose reference is `GraphRun` in Python.

The loop carries out a whole execution, with all its mode logic. It asks for the formulas of a mode
when a motion first needs them. `graph_program` names the machines that it cannot carry out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, combinations, product
from typing import Any
from weakref import WeakKeyDictionary

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, StepSizeError
from zeno_orbits.integrators import Step, Tolerance
from zeno_orbits.loop import (
    Detail,
    GraphFormulas,
    GraphProgram,
    LoopRun,
    Program,
    Record,
    RunSettings,
    Side,
    UnknownOperationError,
    View,
    binding,
    loop_library,
    program_or_reason,
)
from zeno_orbits.model import (
    CharacteristicScales,
    CompiledGraph,
    GraphDynamics,
    ModeFunctions,
    inside_stop,
    require_admissible,
)
from zeno_orbits.simulation.compiled.executions import (
    COMPLETIONS,
    curve_limit,
    interruption,
    run_settings,
)
from zeno_orbits.simulation.compiled.steps import loop_steps
from zeno_orbits.simulation.execution import Arc, Event, Mode
from zeno_orbits.simulation.graph_run import GraphRun
from zeno_orbits.simulation.interruptions import (
    accumulate_together,
    armed_at_start,
    coincide,
    enters_by_switch,
    slides,
    switches_accumulate,
    undefined_guard,
    undetermined_contact,
)
from zeno_orbits.simulation.recorded import RecordedExecution, arc_of, events_of
from zeno_orbits.simulation.settings import SimulationTask
from zeno_orbits.simulation.zeno.zeno_limit import ZenoLimit

_KINDS = {binding.IMPACT: "impact", binding.RELEASE: "release", binding.SWITCH: "switch"}


@dataclass(kw_only=True, eq=False)
class GraphHistory:
    """An execution over a graph of modes, with the context of its record.

    Attributes:
        graph: The graph.
        views: The stops and modes of the arcs, in the order of their indices.
        tolerance: Local error of the steps.
        record: Record of the run.
        paths: Curves of the impacts by the times of Zeno points that were found along them.
    """

    graph: GraphDynamics
    views: Sequence[View]
    tolerance: Tolerance
    record: Record
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
        view = self.views[int(row[binding.ARC_WIDTH - 1])]
        dynamics = self.graph.view((view.closed, view.sides), view.stop)
        arc = arc_of(row, self.record, dynamics, self.tolerance, self.paths)
        closed = view.closed
        if arc.mode is Mode.LOCKED:
            closed = tuple(sorted((*closed, view.stop)))
        names = self.graph.stop_names
        return replace(
            arc,
            mode=Mode.LOCKED if closed else Mode.FREE,
            closed=tuple(names[k] for k in closed),
            stop=names[view.stop] if row[0] == binding.FLIGHT else "",
            sides=view.sides,
        )


@dataclass(slots=True, kw_only=True)
class _Followed:
    """A run of the loop in progress.

    Attributes:
        task: The simulation task.
        rules: A run of the reference, whose rules apply along the curve of many impacts.
        program: The formulas.
        run: The run.
        paths: Curves of the impacts so far.
    """

    task: SimulationTask
    rules: GraphRun
    program: GraphProgram
    run: LoopRun
    paths: dict[float, tuple[Step, ...]] = field(default_factory=dict[float, "tuple[Step, ...]"])

    def execution(self) -> RecordedExecution:
        """Return the execution so far."""
        return RecordedExecution.of(
            GraphHistory(
                graph=self.rules.graph,
                views=tuple(self.program.views),
                tolerance=self.rules.follower.tolerance,
                record=self.run.record(),
                paths=self.paths,
            )
        )

    def to_end(self) -> RecordedExecution:
        """Carry out the run to its end.

        Raises:
            InputError: If the first state is inside of a stop.
            SimulationError: If the execution cannot be continued.
            UnknownOperationError: If a formula holds an operation that tapes do not have.
        """
        task, run = self.task, self.run
        task.on_progress("simulating", 0.0)
        while True:
            status = run.resume()
            if status == binding.MODE:
                _add(
                    self.rules.graph.compiled,
                    self.program,
                    self.program.asked_for(run.detail().about),
                )
            elif status == binding.CURVE:
                limit = self._curve_limit()
                if limit is not None:
                    self.paths[limit.time] = limit.path
                run.answer(None if limit is None else (limit.time, limit.error, limit.state))
            elif status in (binding.FULL, binding.DONE):
                reached = task.until if status == binding.DONE else run.now()[0]
                task.on_progress("simulating", reached / task.until)
                if status == binding.DONE:
                    return self.execution()
            else:
                raise self._interruption(status, run.detail())

    def _curve_limit(self) -> ZenoLimit | None:
        """Return the Zeno point at the end of the curve of the impacts, if nothing else is near."""
        rules, seen = self.rules, self.run.outlook()
        n_stops, n_switches = len(rules.graph.stop_names), len(rules.graph.switch_names)
        n = rules.graph.n_declared
        rules.rest = tuple(k for k in range(n_stops) if seen.rest >> k & 1)
        rules.above = tuple(bool(seen.above >> k & 1) for k in range(n))
        rules.sides = tuple(bool(seen.sides >> k & 1) for k in range(n_switches - n))
        split = frozenset(k for k in range(n_switches) if seen.splits >> k & 1)
        rules.focus, rules.split_by = seen.focus, (split, frozenset())
        rules.stop_name = rules.graph.stop_names[rules.focus]
        view = rules.graph.view((rules.rest, rules.sides), rules.focus)
        limit = curve_limit(replace(self.task, dynamics=view), self.run)
        if limit is None or limit.time >= self.task.until or not rules.is_clear(limit):
            return None
        return limit

    def _interruption(self, status: int, told: Detail) -> SimulationError | InputError:
        """Return the error that a status stands for."""
        graph, about, time, state = self.rules.graph, told.about, told.time, told.state
        stops, switches = graph.stop_names, graph.switch_names

        def event(kind: int, index: int) -> str:
            return f"{_KINDS[kind]} {(switches if kind == binding.SWITCH else stops)[index]}"

        def chosen(bits: int) -> list[str]:
            return [name for k, name in enumerate(stops) if bits >> k & 1]

        def together(what: str) -> SimulationError:
            return accumulate_together(stops[about[0]], what, time, state)

        made: dict[int, Callable[[], SimulationError | InputError]] = {
            binding.INSIDE: lambda: inside_stop(told.number, stops[told.index]),
            binding.SLIDES: lambda: slides(switches[told.index], time, state),
            binding.COINCIDE: lambda: coincide(event(*about[:2]), event(*about[2:]), time, state),
            binding.SPLITS: lambda: together(f"the switch `{switches[about[1]]}` changes"),
            binding.TOGETHER: lambda: together(f"events of the switch `{switches[about[1]]}` come"),
            binding.IN_TURN: lambda: together(
                f"impacts on {', '.join(f'`{name}`' for name in sorted(chosen(about[1])))} come"
            ),
            binding.ACCUMULATE: lambda: switches_accumulate(switches[told.index], time, state),
            binding.UNDEFINED: lambda: undefined_guard(switches[told.index], time, state),
            binding.UNDETERMINED: lambda: undetermined_contact(
                ", ".join(f"`{name}`" for name in chosen(about[0])), time, state
            ),
            binding.BY_SWITCH: lambda: enters_by_switch(
                switches[about[0]], stops[about[1]], time, state
            ),
            binding.ARMED: lambda: armed_at_start(switches[told.index], time, state),
        }
        if status in made:
            return made[status]()
        error = interruption(replace(self.task, dynamics=graph.first), status, told)
        if isinstance(error, StepSizeError) and told.index >= 0:
            reason = f"{error.reason}; a formula is not differentiable at its own kink"
            text = f"{reason} `{switches[told.index]}`"
            return StepSizeError(text, time=error.time, state=error.state)
        return error


def looped(task: SimulationTask, rules: GraphRun) -> RecordedExecution | None:
    """Return the completed execution, or ``None`` if the loop cannot carry it out.

    Args:
        task: The simulation task, with the system of the graph's first stop.
        rules: A run of the reference at its start.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued.
    """
    graph = rules.graph
    program = graph_program(graph.compiled)
    if isinstance(program, str) or not _serves(task):
        return None
    require_admissible(graph.first, task.state)
    run = LoopRun(program, _settings(task, rules), graph.p, task.state)
    followed = _Followed(task=task, rules=rules, program=program, run=run)
    try:
        return followed.to_end()
    except UnknownOperationError:
        return None
    except SimulationError as error:
        error.execution = followed.execution() if len(run.record().arcs) else None
        raise
    finally:
        run.close()


def _serves(task: SimulationTask) -> bool:
    """Return True if steps and completion of a task are those of the loop."""
    return (
        loop_steps(task.settings.engine) is not None
        and type(task.settings.completion) in COMPLETIONS
    )


def _settings(task: SimulationTask, rules: GraphRun) -> Any:
    """Return accuracy and limits at every stop, in the loop's format."""
    settings = settings_of_stops(task, rules.graph)
    return (binding.SettingsType * len(settings))(*(one.filled() for one in settings))


def settings_of_stops(task: SimulationTask, graph: GraphDynamics) -> list[RunSettings]:
    """Return accuracy and limits at every stop. All steps have the tolerance of the machine.

    Args:
        task: The simulation task, with the system of the graph's first stop.
        graph: The graph.
    """
    tolerance = task.settings.tolerance.times(graph.own.least)
    return [
        run_settings(
            replace(task, dynamics=graph.view(graph.open_mode, k)),
            relative=tolerance.relative,
            absolute=tolerance.absolute,
        )
        for k in range(len(graph.stop_names))
    ]


_MOST_MODES = 256
"""Modes of a machine whose formulas are exported: about 50 kB of code each."""

_programs: WeakKeyDictionary[CompiledGraph, GraphProgram | str] = WeakKeyDictionary()


def graph_program(compiled: CompiledGraph) -> GraphProgram | str:
    """Return a graph in the library's format, or the reason why it does not exist, as a clause.

    The reference carries out a machine with too many stops, switches or states, with an operation
    that tapes do not have, or with formulas that are to be interpreted.

    Args:
        compiled: The graph.
    """
    if compiled not in _programs:
        _programs[compiled] = _made(compiled)
    return _programs[compiled]


def _made(compiled: CompiledGraph) -> GraphProgram | str:
    library, graph = loop_library(), compiled.graph
    n_stops, n_switches = len(graph.stops), len(graph.switch_names)
    if library is None:
        return "the library is missing"
    if n_stops > binding.STOPS:
        return f"it has {n_stops} stops, and the loop takes {binding.STOPS}"
    if n_stops - 1 + n_switches > binding.GUARDS:
        return f"it has {n_switches} switches and kinks, and the loop takes fewer"
    if len(graph.time_orders) > binding.ORDERS:
        return f"it has {len(graph.time_orders)} pairs of switching times, and the loop takes fewer"
    first = View((), 0, (True,) * len(graph.conditions))
    system = compiled.system((first.closed, first.sides), 0)
    program, clock = program_or_reason(system), system.clock
    if isinstance(program, str):
        return program
    formulas = GraphFormulas(
        n_x=program.n_x,
        n_q=program.n_q,
        n_p=program.n_p,
        n_stops=n_stops,
        n_declared=len(graph.switches),
        n_switches=n_switches,
        switches=compiled.switches,
        delassus=compiled.delassus,
        resets=compiled.resets,
        orders=compiled.times,
        clock=(clock[0], clock[-1] + 1) if clock else (0, 0),
    )
    try:
        made = GraphProgram(library, formulas)
    except UnknownOperationError as error:
        return f"a formula holds the operation `{error}`"
    made.add({first: program}, {})
    return made


def whole_program(compiled: CompiledGraph) -> GraphProgram | str:
    """Return a graph with all its modes, or the reason why it does not exist, as a clause.

    Args:
        compiled: The graph.
    """
    begun = graph_program(compiled)
    if isinstance(begun, str):
        return begun
    graph, program = compiled.graph, GraphProgram(begun.library, begun.formulas)
    n_stops, n_kinks = len(graph.stops), len(graph.conditions)
    n_modes = 2 ** (n_stops + n_kinks)
    if n_modes > _MOST_MODES:
        return f"it has {n_modes} modes, and at most {_MOST_MODES} are exported"
    views, sides = dict[View, Program](), dict[Side, ModeFunctions]()
    try:
        for branches in product((True, False), repeat=n_kinks):
            for closed in _subsets(n_stops):
                for stop in set(range(n_stops)).difference(closed):
                    view = View(closed, stop, branches)
                    views[view] = _view(compiled, view)
                for switch, positive in product(range(len(graph.switch_names)), (True, False)):
                    mode = compiled.guard((closed, branches), switch, positive)
                    sides[Side(closed, branches, switch, positive)] = mode
        program.add(views, sides)
    except UnknownOperationError as error:
        return f"of a formula: {error}"
    return program


def _subsets(n: int) -> Iterator[tuple[int, ...]]:
    return chain.from_iterable(combinations(range(n), k) for k in range(n + 1))


def _view(compiled: CompiledGraph, view: View) -> Program:
    """Return the formulas of a view.

    Raises:
        UnknownOperationError: If one of them holds an operation that tapes do not have.
    """
    program = program_or_reason(compiled.system((view.closed, view.sides), view.stop))
    if isinstance(program, str):
        raise UnknownOperationError(program)
    return program


def _add(compiled: CompiledGraph, program: GraphProgram, asked: View | Side) -> None:
    """Add what a run asks for to the tables of a program, unless they have it.

    Raises:
        UnknownOperationError: If a formula holds an operation that tapes do not have.
    """
    if isinstance(asked, View):
        if asked not in program.views:
            program.add({asked: _view(compiled, asked)}, {})
    elif asked not in program.sides:
        mode = asked.closed, asked.sides
        program.add({}, {asked: compiled.guard(mode, asked.switch, asked.positive)})
