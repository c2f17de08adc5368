"""States that an execution may start from."""

from __future__ import annotations

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model.numeric.graph_dynamics import GraphDynamics
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.numeric.own_scale import START_OFF, constraint_sizes


def require_admissible(dynamics: HybridDynamics, x: Vector) -> None:
    """Reject a state of a wrong shape, that is not finite, or that is off its constraints.

    Args:
        dynamics: The system.
        x: The state.

    Raises:
        InputError: If the state is not admissible. The message contains the reason.
    """
    names = dynamics.state_names
    if x.shape != (len(names),):
        message = f"Argument `state` must have {len(names)} entries, but its shape is {x.shape}."
        raise InputError(message)
    if not np.all(np.isfinite(x)):
        raise InputError("Argument `state` must be finite, but it holds NaN or infinity.")
    _require_constraints(dynamics, x)


def require_outside(
    dynamics: HybridDynamics,
    x: Vector,
    contact: float,
    stop: str = "",
    *,
    subject: str = "Argument `state`",
) -> None:
    """Reject a state inside of a stop, beyond the error of another run.

    Args:
        dynamics: The system.
        x: The state.
        contact: Relative threshold below which a gap counts as zero.
        stop: Name of the stop, empty for a machine with one stop.
        subject: Subject of the message.

    Raises:
        InputError: If the gap is below zero.
    """
    gap = dynamics.gap(x)
    if gap < -max(START_OFF, contact) * dynamics.own.gap:
        raise inside_stop(gap, stop, subject)


def require_start(
    system: HybridDynamics | GraphDynamics,
    x: Vector,
    contact: float,
    *,
    subject: str = "Argument `state`",
) -> None:
    """Reject a first state that is not admissible.

    Args:
        system: The system, or its graph of modes.
        x: The state.
        contact: Relative threshold below which a gap counts as zero.
        subject: Subject of the message.

    Raises:
        InputError: If the state is not admissible. The message contains the reason.
    """
    graph = system.as_graph()
    require_admissible(graph.first, x)
    _require_sides(graph, x, subject)
    for k, name in enumerate(graph.stop_names):
        view = graph.view(graph.open_mode, k)
        require_outside(view, x, contact, name, subject=subject)


def _require_sides(graph: GraphDynamics, x: Vector, subject: str) -> None:
    """Reject a side of a part with dry friction other than -1, 0 and 1.

    Raises:
        InputError: If there is one. The message names its state.
    """
    for k in graph.sides_of_friction:
        if not min(abs(x[k] - side) for side in (-1.0, 0.0, 1.0)) <= START_OFF:
            name = graph.state_names[k]
            raise InputError(
                f"{subject} must have `{name}` = 1 or -1 where the part slips, or 0 where it "
                f"sticks or its rate decides, but it is {x[k]:g}."
            )


def inside_stop(gap: float, stop: str = "", subject: str = "Argument `state`") -> InputError:
    """Return the error of a first state inside of a stop.

    Args:
        gap: The gap.
        stop: Name of the stop, empty for a machine with one stop.
        subject: Subject of the message.
    """
    where = f" at the stop `{stop}`" if stop else ""
    return InputError(f"{subject} must have a gap >= 0{where}, but it is {gap:.6g}.")


def _require_constraints(dynamics: HybridDynamics, x: Vector) -> None:
    """Reject a state off its constraints, relative to the effect of the problem's scales on them.

    Raises:
        InputError: If the state violates its constraints. The message contains the deviation.
    """
    off = np.abs(dynamics.holonomic(x))
    if dynamics.own.least == 1.0 and not np.any(off > START_OFF):
        return
    if not np.any(off > START_OFF * constraint_sizes(dynamics, x)):
        return
    if dynamics.clock and off[-1] > START_OFF:
        names = " and ".join(f"`{dynamics.state_names[k]}`" for k in dynamics.clock)
        seen = " and ".join(f"{x[k]:g}" for k in dynamics.clock)
        message = f"must have {names} on the unit circle, as a clock, but they are {seen}"
        first = dynamics.state_names[dynamics.clock[0]]
        remedy = f"A start names the clock, too: add {first}=1 for the start of a turn"
        raise InputError(f"Argument `state` {message}. {remedy}.")
    message = "Argument `state` must keep the holonomic constraints, but it is off by"
    raise InputError(f"{message} {float(np.max(off)):.3g}.")
