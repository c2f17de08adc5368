r"""Orbits of machines with several stops or switches at the fit's unknowns, and exact derivatives.

The orbit is the fixed point of the return to an event. With the derivatives :math:`P_x`,
:math:`P_p` of the return, its start moves by

.. math:: \frac{dx_0}{dp} = (1 - P_x)^{-1} P_p

and every event and every state of the period follows from the derivatives with respect to the start
and `p` (theory (4.3)).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.experiment.identification.orbit_sensitivity import OrbitSlope
from zeno_orbits.experiment.identification.predictions import EventTimes, OrbitPredictions
from zeno_orbits.experiment.identification.unknowns import Unknowns
from zeno_orbits.experiment.orbit_table import (
    CubicColumns,
    Measurement,
    PeriodTable,
    closed_nodes,
    signal_nodes,
)
from zeno_orbits.model import GraphDynamics, Problem
from zeno_orbits.orbits import (
    EventReturn,
    closed_return,
    orbit_event_name,
    start_by_parameters,
)
from zeno_orbits.simulation import SimulationSettings

_MORE, _EVENTS = 6, 120
"""An orbit of more events than so many times those at the start, and so many, is not followed."""
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


class EventPredictions(OrbitPredictions[EventPeriod]):
    """Orbits of a machine with several stops or switches at unknowns."""

    def __init__(
        self, problem: Problem, unknowns: Unknowns, measured: Measurement, near: EventReturn
    ) -> None:
        super().__init__(unknowns, measured)
        self._problem, self._near = problem, near
        self._graph = problem.graph_dynamics(unknowns.base)
        self._settings = SimulationSettings()
        self._most = _MORE * len(near.events) + _EVENTS

    def accept(self, x: Vector) -> None:
        """Start the next searches from the orbit at these unknowns."""
        self._near = self.table(x).found

    def _events(self, x: Vector) -> EventTimes:
        found = self.table(x).found
        return EventTimes(
            names=tuple(orbit_event_name(event) for event in found.events),
            times=np.array([event.time for event in found.events]),
            period=found.period,
        )

    def _event_slopes(self, x: Vector) -> Vector:
        table = self.table(x)
        times = np.array([shift.time for shift in table.found.shifts])
        return times @ table.moved @ self.unknowns.ties

    def _copy(self) -> Self:
        return type(self)(self._problem, self.unknowns, self._measured, self._near)

    def _tabulated(self, key: bytes) -> EventPeriod:
        near, graph = self._near, self._graph.at(np.frombuffer(key))
        section = orbit_event_name(near.events[-1])
        found = closed_return(
            graph,
            near.start,
            section=section,
            n_returns=sum(orbit_event_name(event) == section for event in near.events),
            guess=near.period,
            settings=self._settings,
            parameters=self.unknowns.places,
            mode=near.mode,
        )
        if len(found.events) > self._most:
            raise SimulationError("Too many events per period", time=0.0, state=())
        return event_period(graph, found, self._measured)

    def _differentiated(self, key: bytes) -> OrbitSlope:
        table = self._tables(key)
        found, n_x = table.found, len(table.found.start)
        along = [found.differentiation.at_equal_times(p, parts=_PARTS) for p in found.passages]
        pieces = [
            (times, (moved @ table.moved).reshape(len(times), -1), rates @ table.moved)
            for times, moved, rates in filter(None, along)
        ]
        return OrbitSlope(
            period=found.shifts[-1].time @ table.moved,
            release=table.moved[:n_x],
            states=CubicColumns(
                times=np.concatenate([times for times, _, _ in pieces]),
                values=np.concatenate([moved for _, moved, _ in pieces]),
                slopes=np.concatenate([rates.reshape(len(rates), -1) for _, _, rates in pieces]),
            ),
        )


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
