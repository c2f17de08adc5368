"""Periodic orbits by Newton's method in the compiled loop, for machines with one stop."""

from __future__ import annotations

from zeno_orbits.loop import ClosedRecord, Closing, binding, closed_record, program_of, tangent_of
from zeno_orbits.simulation.compiled.programs import program_of_graph
from zeno_orbits.simulation.compiled.task_settings import are_known, filled_settings
from zeno_orbits.simulation.derivatives.state_transition import trusted
from zeno_orbits.simulation.events import Event
from zeno_orbits.simulation.recorded import events_of
from zeno_orbits.simulation.settings import SimulationTask

_KINDS = {"impact": binding.IMPACT, "zeno": binding.ZENO, "release": binding.RELEASE}


def closed_by_loop(
    task: SimulationTask, *, section: str, n_returns: int, guess: float, exact: float
) -> tuple[ClosedRecord, list[Event]] | None:
    """Return the periodic orbit near a start, and its events.

    The loop closes returns of machines with one stop, without switches, a clock or constraints. It
    leaves to the reference whatever is unusual: events at one time, conditions or directions that
    are not clearly independent, a step of Newton's method that does not come nearer.

    Args:
        task: Graph, start and accuracy. Its completion must resolve the impacts.
        section: Name of the event just before the start.
        n_returns: Number of such events in a period.
        guess: Approximate period [s].
        exact: Largest relative correction of an orbit.

    Returns:
        Its record and events, or ``None`` if the reference has to look for it.

    Raises:
        SimulationError: If no orbit is found nearby.
    """
    graph, first = task.graph, task.graph.first
    kind, is_plain = section.partition(" ")[0], graph.has_one_guard and bool(graph.stop_names)
    formulas, slopes = first.formulas, first.differentiation
    if kind not in _KINDS or not is_plain or formulas is None or slopes is None:
        return None
    if first.clock or first.holonomic(task.state).size or not are_known(task.settings):
        return None
    program, view = program_of_graph(graph), program_of(formulas.system)
    if isinstance(program, str) or view is None:
        return None
    tangent = tangent_of(view, slopes.by(()).formulas)
    if tangent is None:
        return None
    closing = Closing(
        x=task.state,
        p=graph.p,
        settings=filled_settings(task),
        sizes=graph.own.states(task.state.size),
        section=_KINDS[kind],
        n_returns=n_returns,
        guess=guess,
        exact=exact,
        trusted=trusted(task.settings.tolerance),
    )
    found = closed_record(program, view, tangent, closing)
    return (
        None
        if found is None
        else (found, events_of(found.events, len(task.state), graph.stop_names))
    )
