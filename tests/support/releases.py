"""Orbits of a machine with the one stop `stop`, closed near a release."""

from __future__ import annotations

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import (
    ONE_ZENO,
    EventReturn,
    SectionMode,
    closed_return,
    events_of_shape,
    orbit_event_name,
    sequence_of,
)
from zeno_orbits.simulation import SimulationSettings


def closed_at_release(
    graph: GraphDynamics, x: Vector, *, period: float, settings: SimulationSettings
) -> EventReturn:
    """Return the orbit with one contact phase near a release.

    Args:
        graph: The graph of modes.
        x: A state near the release.
        period: Approximate period [s].
        settings: Accuracy.

    Raises:
        SimulationError: If there is none.
    """
    found = closed_return(
        graph,
        x,
        section="release stop",
        n_returns=1,
        guess=period,
        settings=settings,
        by_returns=True,
        mode=SectionMode(closed=(), sides=(), stop="", released="stop"),
    )
    if sequence_of([orbit_event_name(one) for one in found.events]) != events_of_shape(ONE_ZENO):
        raise SimulationError("The orbit has other events", time=found.period, state=tuple(x))
    return found
