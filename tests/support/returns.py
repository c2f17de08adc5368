"""Returns of machines with one stop to the release, as tests compare them with other methods."""

from __future__ import annotations

from collections.abc import Sequence

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics, HybridDynamics
from zeno_orbits.orbits import (
    RELEASE_ROWS,
    EventReturn,
    Section,
    event_return,
    multipliers_of_return,
    section_around,
)
from zeno_orbits.simulation import SimulationSettings

RELEASE_OF_STOP = "release stop"


def release_section(dynamics: HybridDynamics, centre: Vector, scale: Vector) -> Section:
    """Return a chart of the release states around one of them."""
    return section_around(dynamics, RELEASE_ROWS, centre, scale)


def release_return(
    machine: HybridDynamics | GraphDynamics,
    x: Vector,
    *,
    guess: float,
    settings: SimulationSettings | None = None,
    parameters: Sequence[int] = (),
) -> EventReturn:
    """Return the motion from a release state to the next release, with derivatives."""
    graph = machine.as_graph("stop")
    return event_return(
        graph,
        graph.first.on_stop(x),
        section=RELEASE_OF_STOP,
        n_returns=1,
        guess=guess,
        settings=settings or SimulationSettings(),
        parameters=parameters,
    )


def next_release(machine: HybridDynamics, x: Vector, *, guess: float) -> tuple[float, Vector]:
    """Return time and state of the next release after a release state."""
    found = release_return(machine, x, guess=guess)
    return found.period, found.end


def multipliers_at(machine: HybridDynamics, x: Vector, period: float) -> tuple[complex, ...]:
    """Return the multipliers of the orbit through a release state, the largest first."""
    found = release_return(machine, x, guess=period)
    return multipliers_of_return(machine.as_graph("stop"), found)
