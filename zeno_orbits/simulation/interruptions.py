"""Errors that end an execution early, shared by the compiled loop and its reference."""

from __future__ import annotations

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import (
    ChatterError,
    PenetrationError,
    RunawayError,
    SimulationError,
    SimultaneousEventsError,
    SlidingError,
    StepLimitError,
    StepSizeError,
    counted,
)
from zeno_orbits.model import GraphDynamics


def flow_ends(error: StepSizeError, graph: GraphDynamics, time: float, kink: str) -> StepSizeError:
    """Return the error of a flow that cannot be continued, with its cause.

    Args:
        error: The error of the integrator.
        graph: The machine.
        time: Time at which the execution ends [s].
        kink: The kink whose condition is zero there, or an empty text.
    """
    reason = error.reason
    undefined = graph.undefined_ahead(np.array(error.state)[: len(graph.state_names)], time)
    if undefined:
        reason = f"{reason.partition(': ')[0]}: {undefined.rstrip('.')}"
    elif kink:
        reason = f"{reason}; a formula is not differentiable at its own kink `{kink}`"
    return StepSizeError(reason, time=time, state=error.state)


def too_many_steps(most: int, time: float, state: Vector) -> SimulationError:
    """Return the error of an execution that needs too many steps.

    Args:
        most: Steps that it may take.
        time: Time at which the execution ends [s].
        state: State at that time.
    """
    return StepLimitError(
        f"The execution needs more than {counted(most, 'step')}: "
        "raise `most_steps` (--max-steps), or simulate a shorter time",
        time=time,
        state=tuple(state.tolist()),
    )


def runs_away(name: str, time: float, state: Vector) -> RunawayError:
    """Return the error of a coordinate that is beyond its bound.

    Args:
        name: The coordinate.
        time: Time at which the execution ends [s].
        state: State at that time.
    """
    return RunawayError(f"{name} diverges", time=time, state=tuple(state.tolist()), coordinate=name)


def grows_without_end(
    name: str, steps: int, needed: float, time: float, state: Vector
) -> RunawayError:
    """Return the error of a velocity that grows so fast that the steps will not last.

    Args:
        name: The velocity.
        steps: Steps whose pace was taken.
        needed: Steps that the rest of the time would take.
        time: Time at which the execution ends [s].
        state: State at that time.
    """
    return RunawayError(
        f"{name} grows without bound: at the pace of its last {steps} steps, "
        f"{needed:.1g} more would be needed",
        time=time,
        state=tuple(state.tolist()),
    )


def leaves_set(time: float, state: Vector) -> PenetrationError:
    """Return the error of a state that leaves the admissible set.

    Args:
        time: Time at which the execution ends [s].
        state: State at that time, ``(n_x,)``.
    """
    return PenetrationError(
        "The state leaves the admissible set from its boundary",
        time=time,
        state=tuple(state.tolist()),
    )


def does_not_close(approach_rate: float, time: float, state: Vector) -> SimulationError:
    """Return the error of an impact that does not close the gap.

    Args:
        approach_rate: Gap rate before it.
        time: Time at which the execution ends [s].
        state: State before it, ``(n_x,)``.
    """
    return SimulationError(
        f"An impact must close the gap, but the gap rate is {approach_rate:.3g}",
        time=time,
        state=tuple(state.tolist()),
    )


def restitution_beyond(
    speed: float, approach_rate: float, stop: str, time: float, state: Vector
) -> SimulationError:
    """Return the error of a restitution outside [0, 1] at the speed of an impact.

    Args:
        speed: Gap rate after the impact.
        approach_rate: Gap rate before it.
        stop: Name of the stop.
        time: Time at which the execution ends [s].
        state: State before it, ``(n_x,)``.
    """
    at = f" of the stop `{stop}`" if stop else ""
    return SimulationError(
        f"Argument `restitution`{at} must lie in [0, 1], but at the impact speed "
        f"{-approach_rate:.6g} it is {speed / -approach_rate:.6g}",
        time=time,
        state=tuple(state.tolist()),
    )


def enters_by_reset(time: float, state: Vector) -> PenetrationError:
    """Return the error of a reset map that sends the state into the stop.

    Args:
        time: Time at which the execution ends [s].
        state: State before the impact, ``(n_x,)``.
    """
    return PenetrationError(
        "The reset map sends the state into the stop", time=time, state=tuple(state.tolist())
    )


def does_not_accumulate(most: int, time: float, state: Vector) -> ChatterError:
    """Return the error of a sequence of impacts without a Zeno point.

    Args:
        most: Impacts that a sequence may have.
        time: Time at which the execution ends [s].
        state: State at that time, ``(n_x,)``.
    """
    return ChatterError(
        f"More than {most} impacts came without a Zeno point (elastic impacts lack one): "
        "raise `most_impacts` (--max-impacts), or simulate a shorter time",
        time=time,
        state=tuple(state.tolist()),
    )


def switches_too_often(switch: str, most: int, time: float, state: Vector) -> ChatterError:
    """Return the error of an execution with too many declared switches.

    Args:
        switch: Name of the last one.
        most: Switches that an execution may have.
        time: Time at which the execution ends [s].
        state: State at that time, ``(n_x,)``.
    """
    return ChatterError(
        f"More than {most} switches occurred, the last one is `{switch}`: raise `most_impacts` "
        "(--max-impacts), or simulate a shorter time",
        time=time,
        state=tuple(state.tolist()),
    )


def coincide(first: str, second: str, time: float, state: Vector) -> SimultaneousEventsError:
    """Return the error of two events at one time.

    Args:
        first: Name of one event.
        second: Name of the other event.
        time: Time at which the execution ends [s].
        state: State at that time, ``(n_x,)``.
    """
    return SimultaneousEventsError(
        f"Two events coincide to rounding: {first} and {second}",
        time=time,
        state=tuple(state.tolist()),
    )


def accumulate_together(stop: str, other: str, time: float, state: Vector) -> SimulationError:
    """Return the error of impacts that accumulate while another event occurs in every flight.

    Args:
        stop: Name of the stop.
        other: The other event, as a clause.
        time: Time at which the execution ends [s].
        state: State at that time, ``(n_x,)``.
    """
    return SimultaneousEventsError(
        f"Impacts accumulate on the stop `{stop}`, and {other} in between",
        time=time,
        state=tuple(state.tolist()),
    )


def switches_accumulate(switch: str, time: float, state: Vector) -> ChatterError:
    """Return the error of a switch whose events accumulate.

    Args:
        switch: Name of the switch.
        time: Time at which the execution ends [s].
        state: State at that time, ``(n_x,)``.
    """
    return ChatterError(
        f"Events of the switch `{switch}` accumulate, and the execution ends at their limit",
        time=time,
        state=tuple(state.tolist()),
    )


def undefined_guard(switch: str, time: float, state: Vector) -> SimulationError:
    """Return the error of a switch whose guard is not a number.

    Args:
        switch: Name of the switch.
        time: Time at which the execution ends [s].
        state: State at that time, ``(n_x,)``.
    """
    return SimulationError(
        f"The guard of the switch `{switch}` must be a number, but it is NaN",
        time=time,
        state=tuple(state.tolist()),
    )


def undetermined_contact(names: str, time: float, state: Vector) -> SimultaneousEventsError:
    """Return the error of stops whose contact the laws do not determine.

    Args:
        names: Names of the stops.
        time: Time at which the execution ends [s].
        state: State at that time, ``(n_x,)``.
    """
    return SimultaneousEventsError(
        f"The laws of contact determine no set, or several sets of closed stops among {names}",
        time=time,
        state=tuple(state.tolist()),
    )


def slides(graph: GraphDynamics, switch: int, time: float, state: Vector) -> SlidingError:
    """Return the error of a motion that slides along a switch, with what to write instead.

    Args:
        graph: The modes.
        switch: Index of the switch.
        time: Time at which the execution ends [s].
        state: State at that time, ``(n_x,)``.
    """
    name = graph.switch_names[switch]
    return SlidingError(
        f"The motion slides along the switch `{name}`: the flows on both sides point to it",
        time=time,
        state=tuple(state.tolist()),
        remedy=graph.instead_of_sliding(switch),
    )


def enters_by_switch(switch: str, stop: str, time: float, state: Vector) -> PenetrationError:
    """Return the error of a switch whose reset sends the state into a stop.

    Args:
        switch: Name of the switch.
        stop: Name of the stop.
        time: Time at which the execution ends [s].
        state: State after the reset, ``(n_x,)``.
    """
    return PenetrationError(
        f"The reset of the switch `{switch}` sends the state into the stop `{stop}`",
        time=time,
        state=tuple(state.tolist()),
    )


def armed_at_start(switch: str, time: float, state: Vector) -> SimulationError:
    """Return the error of a switch that is armed where its guard is zero at a start.

    Args:
        switch: Name of the switch.
        time: Time at which the execution ends [s].
        state: State at that time, ``(n_x,)``.
    """
    return SimulationError(
        f"The switch `{switch}` is armed at its start: its guard is zero there and falls. Start a "
        "little before or beyond it",
        time=time,
        state=tuple(state.tolist()),
    )
