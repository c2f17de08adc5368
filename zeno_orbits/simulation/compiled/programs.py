"""Graphs of modes in the library's format, with the formulas that runs have asked for, or all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, combinations, product
from weakref import WeakKeyDictionary

from zeno_orbits.errors import KernelError
from zeno_orbits.loop import (
    VARIABLE,
    GraphFormulas,
    GraphProgram,
    Program,
    SwitchSide,
    UnknownOperationError,
    View,
    binding,
    loop_library,
    may_have_formulas,
    program_or_reason,
)
from zeno_orbits.model import CompiledGraph, GraphDynamics, ModeFunctions, OneStop


def program_of_graph(graph: GraphDynamics) -> Program | GraphProgram | str:
    """Return a graph at fixed values in the library's format, or the reason why it does not exist.

    Args:
        graph: The graph.
    """
    if not isinstance(graph, OneStop):
        return graph_program(graph.compiled)
    formulas = graph.first.formulas
    return "it lacks formulas" if formulas is None else program_or_reason(formulas.system)


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
    n_stops, n_switches = graph.n_watched, len(graph.switch_names)
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
        n_frictional=len(graph.frictional),
        switches=compiled.switches,
        delassus=compiled.coupling,
        resets=compiled.resets,
        causes=[_cause(one, [stop.name for stop in graph.stops]) for one in graph.causes],
        orders=compiled.times,
        clock=(clock[0], clock[-1] + 1) if clock else (0, 0),
    )
    try:
        made = GraphProgram(library, formulas)
    except UnknownOperationError as error:
        return f"a formula holds the operation `{error}`"
    made.add({first: program}, {})
    return made


def _cause(event: str, stops: Sequence[str]) -> tuple[int, int] | None:
    """Return the kind and the stop of an event that causes a switch, or ``None`` for no text."""
    kind, _, stop = event.partition(" ")
    return (_KINDS[kind], stops.index(stop)) if event else None


_KINDS = {"impact": binding.IMPACT, "zeno": binding.ZENO, "release": binding.RELEASE}


def whole_program(compiled: CompiledGraph) -> GraphProgram | str:
    """Return a graph with all its modes, or the reason why it does not exist, as a clause.

    Args:
        compiled: The graph.
    """
    begun = graph_program(compiled)
    if isinstance(begun, str):
        return begun
    graph, program = compiled.graph, GraphProgram(begun.library, begun.formulas)
    n_stops, n_kinks = graph.n_watched, len(graph.conditions)
    n_modes = 2 ** (n_stops + n_kinks)
    if n_modes > _MOST_MODES:
        return f"it has {n_modes} modes, and at most {_MOST_MODES} are exported"
    views, sides = dict[View, Program](), dict[SwitchSide, ModeFunctions]()
    try:
        for branches in product((True, False), repeat=n_kinks):
            for closed in _subsets(n_stops):
                for stop in set(range(n_stops)).difference(closed):
                    view = View(closed, stop, branches)
                    views[view] = _view(compiled, view)
                for switch, positive in product(range(len(graph.switch_names)), (True, False)):
                    mode = compiled.guard((closed, branches), switch, positive)
                    sides[SwitchSide(closed, branches, switch, positive)] = mode
        program.add(views, sides)
    except UnknownOperationError as error:
        return f"of a formula: {error}"
    return program


def compile_formulas(compiled: CompiledGraph) -> str:
    """Compile the formulas of all modes, and return the reason of a failure as a clause.

    Args:
        compiled: The graph.
    """
    program, whole = graph_program(compiled), whole_program(compiled)
    if isinstance(program, str) or isinstance(whole, str):
        return str(whole)
    if not may_have_formulas():
        return f"{VARIABLE} excludes them"
    try:
        program.compile(whole.views.values())
    except KernelError as error:
        return str(error)
    return "" if program.is_compiled else "they cannot be loaded"


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


def add_asked(compiled: CompiledGraph, program: GraphProgram, asked: View | SwitchSide) -> None:
    """Add what a run asks for to the tables of a program, unless they have it.

    Args:
        compiled: The graph.
        program: Its program.
        asked: The view or side.

    Raises:
        UnknownOperationError: If a formula holds an operation that tapes do not have.
    """
    if isinstance(asked, View):
        if asked not in program.views:
            program.add({asked: _view(compiled, asked)}, {})
    elif asked not in program.sides:
        mode = asked.closed, asked.sides
        program.add({}, {asked: compiled.guard(mode, asked.switch, asked.positive)})
