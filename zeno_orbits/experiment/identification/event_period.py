r"""One period of an orbit, and its exact derivatives with respect to parameters.

The orbit is the fixed point of the return to an event. With the derivatives :math:`P_x`,
:math:`P_p` of the return, its start moves by

.. math:: \frac{dx_0}{dp} = (1 - P_x)^{-1} P_p

and every event and every state of the period follows from the derivatives with respect to the start
and `p` (theory (4.3), (6.11)). At an event that moves by :math:`\delta t` an equal time means
:math:`\delta x - f\,\delta t`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.orbit_table import (
    CubicColumns,
    Measurement,
    PeriodTable,
    closed_nodes,
    signal_nodes,
)
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import EventReturn, start_by_parameters

_PARTS = 3
"""Points in a step of the integrator: between them the derivatives are cubic."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EventPeriod(PeriodTable):
    """One period of an orbit of events.

    Attributes:
        graph: The graph of modes at its parameters.
        found: The periodic return.
    """

    graph: GraphDynamics
    found: EventReturn

    @cached_property
    def moved(self) -> Vector:
        """Derivatives of the start, then of the parameters, with respect to these, ``(m, k)``."""
        start = start_by_parameters(self.graph, self.found)
        return np.concatenate([start, np.eye(start.shape[1])])


def event_period(graph: GraphDynamics, found: EventReturn, measured: Measurement) -> EventPeriod:
    """Return the signals of a periodic return.

    Args:
        graph: The graph of modes.
        found: The return.
        measured: The signals.
    """
    arcs = [arc for arc in found.execution.arcs if arc.end_time <= found.period]
    states = closed_nodes(graph, arcs)
    return EventPeriod(
        period=found.period,
        measured=measured,
        nodes=signal_nodes(states, measured, graph.p),
        states=states,
        p=graph.p,
        graph=graph,
        found=found,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrbitSlope:
    """Derivatives of a periodic orbit with respect to chosen parameters.

    Attributes:
        period: Derivative of the period, ``(k,)``.
        start: Derivative of the state at its start, ``(n_x, k)``.
        states: Derivatives of the states over time from the start, column by column, ``n_x k``.
    """

    period: Vector
    start: Vector
    states: CubicColumns

    def at(self, times: Vector) -> Vector:
        """Return the derivatives of the states at times since the start, ``(n, n_x, k)``."""
        return self.states.at(times).reshape(len(times), *self.start.shape)


def orbit_slope(table: EventPeriod) -> OrbitSlope:
    """Return the derivatives of a periodic orbit with respect to the parameters of its return.

    Args:
        table: Its period.

    Raises:
        SimulationError: If the orbit is not differentiable.
    """
    found = table.found
    along = [found.differentiation.at_equal_times(p, parts=_PARTS) for p in found.passages]
    pieces = [
        (times, (moved @ table.moved).reshape(len(times), -1), rates @ table.moved)
        for times, moved, rates in filter(None, along)
    ]
    return OrbitSlope(
        period=found.shifts[-1].time @ table.moved,
        start=table.moved[: len(found.start)],
        states=CubicColumns(
            times=np.concatenate([times for times, _, _ in pieces]),
            values=np.concatenate([moved for _, moved, _ in pieces]),
            slopes=np.concatenate([rates.reshape(len(rates), -1) for _, _, rates in pieces]),
        ),
    )
