"""Errors that the statuses of the loop stand for."""

from __future__ import annotations

from collections.abc import Callable

from zeno_orbits.errors import InputError, SimulationError, StepSizeError
from zeno_orbits.integrators import not_finite, too_small
from zeno_orbits.loop import Detail, binding
from zeno_orbits.model import inside_stop
from zeno_orbits.simulation.events import EventKind
from zeno_orbits.simulation.interruptions import (
    accumulate_together,
    armed_at_start,
    coincide,
    does_not_accumulate,
    does_not_close,
    enters_by_reset,
    enters_by_switch,
    flow_ends,
    grows_without_end,
    leaves_set,
    restitution_beyond,
    runs_away,
    slides,
    switches_accumulate,
    switches_too_often,
    too_many_steps,
    undefined_guard,
    undetermined_contact,
)
from zeno_orbits.simulation.settings import SimulationTask

_LABELS = {kind.number: kind.label for kind in EventKind}
_Made = dict[int, Callable[[], SimulationError | InputError]]


def interruption(task: SimulationTask, status: int, told: Detail) -> SimulationError | InputError:
    """Return the error that a status stands for.

    Args:
        task: The simulation task.
        status: The status.
        told: Its details.
    """
    error = {**_of_flows(task, told), **_of_events(task, told)}[status]()
    if isinstance(error, StepSizeError):
        kink = task.graph.switch_names[told.index] if told.index >= 0 else ""
        return flow_ends(error, task.graph, told.time, kink)
    return error


def _of_flows(task: SimulationTask, told: Detail) -> _Made:
    """Return the errors of flows, steps and impacts by status."""
    settings, names, time, state = task.settings, task.graph.state_names, told.time, told.state
    return {
        binding.TOO_STIFF: lambda: too_small("the flow is too stiff or singular", time, state),
        binding.SINGULAR: lambda: too_small("the flow is singular", time, state),
        binding.NOT_FINITE: lambda: not_finite(state),
        binding.LEFT: lambda: leaves_set(time, state),
        binding.MANY_STEPS: lambda: too_many_steps(settings.most_steps, time, state),
        binding.MANY_IMPACTS: lambda: does_not_accumulate(settings.most_impacts, time, state),
        binding.BEYOND: lambda: runs_away(names[told.index], time, state),
        binding.GROWS: lambda: grows_without_end(
            names[told.index], int(told.steps), told.number, time, state
        ),
        binding.NOT_CLOSING: lambda: does_not_close(told.number, time, state),
        binding.INTO_STOP: lambda: enters_by_reset(time, state),
        binding.BEYOND_LAW: lambda: restitution_beyond(
            told.steps, told.number, task.graph.stop_names[told.index], time, state
        ),
    }


def _of_events(task: SimulationTask, told: Detail) -> _Made:
    """Return the errors of stops and switches by status."""
    about, time, state = told.about, told.time, told.state
    stops, switches = task.graph.stop_names, task.graph.switch_names

    def event(kind: int, index: int) -> str:
        names = switches if kind == binding.SWITCH else stops
        return f"{_LABELS[kind]} {names[index]}"

    def chosen(bits: int) -> list[str]:
        return [name for k, name in enumerate(stops) if bits >> k & 1]

    def together(what: str) -> SimulationError:
        return accumulate_together(stops[about[0]], what, time, state)

    return {
        binding.INSIDE: lambda: inside_stop(told.number, stops[told.index]),
        binding.SLIDES: lambda: slides(task.graph, told.index, time, state),
        binding.COINCIDE: lambda: coincide(event(*about[:2]), event(*about[2:]), time, state),
        binding.SPLITS: lambda: together(f"the switch `{switches[about[1]]}` changes"),
        binding.TOGETHER: lambda: together(f"events of the switch `{switches[about[1]]}` come"),
        binding.IN_TURN: lambda: together(
            f"impacts on {', '.join(f'`{name}`' for name in sorted(chosen(about[1])))} come"
        ),
        binding.MANY_SWITCHES: lambda: switches_too_often(
            switches[told.index], task.settings.most_impacts, time, state
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
