r"""Derivatives of the events of an execution, with respect to its start and parameters.

`EventDerivatives` chooses the parameters, and offers the derivatives at the ends of arcs, inside
them and at given times. `walk` follows an execution event by event.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import (
    GAP,
    GAP_RATE,
    GraphDynamics,
    GraphMode,
    HybridDynamics,
)
from zeno_orbits.simulation.derivatives.sensitivity import (
    SaltationDerivative,
    VariationalEquation,
    change_of,
)
from zeno_orbits.simulation.derivatives.state_transition import carried_within
from zeno_orbits.simulation.derivatives.tangent import course_of_arc
from zeno_orbits.simulation.derivatives.walk import ArcPassage, Walk
from zeno_orbits.simulation.execution import Arc, Ending, Execution, Mode


class EventDerivatives:
    """Derivatives along the executions of a machine."""

    def __init__(
        self,
        system: HybridDynamics | GraphDynamics,
        chosen: Sequence[int],
        tolerance: Tolerance,
        *,
        in_python: bool = False,
    ) -> None:
        """Choose the parameters.

        Args:
            system: The machine at fixed values.
            chosen: Indices in ``p`` of the parameters of the derivatives, ``(k,)``.
            tolerance: Local error of steps that have to be taken anew.
            in_python: Whether the loop is left out, as by the reference.

        Raises:
            InputError: If the machine does not have formulas.
        """
        self.graph, self.chosen, self.tolerance = system.as_graph(), tuple(chosen), tolerance
        self.in_python = in_python
        self._known: dict[tuple[GraphMode, int], VariationalEquation] = {}
        # A system of plain functions is refused here.
        self.at(*self.graph.some_stop(self.graph.open_mode))

    def at_start(self) -> SaltationDerivative:
        """Return the derivatives of a start whose state is independent."""
        n_x = len(self.graph.state_names)
        state = np.eye(n_x, n_x + len(self.chosen))
        zero = np.zeros(state.shape[1])
        return SaltationDerivative(time=zero, state=state, rate=zero)

    def passages(
        self, execution: Execution, start: SaltationDerivative | None = None, *, first: int = 0
    ) -> Iterator[ArcPassage]:
        """Yield every arc of an execution with derivatives.

        The columns of the derivatives are the states of the start, then the chosen parameters.
        Before an impact they include the gap rate. A Zeno point has one state.

        Args:
            execution: The execution. Its impacts must be resolved one by one.
            start: Derivatives of the start of the first arc. By default, its state is independent.
            first: Index of the arc that counts as the first.

        Raises:
            SimulationError: If an event lacks a derivative: a stop is touched without an impact.
        """
        walk = Walk(self, execution, first, start)
        while not walk.is_over:
            yield from walk.followed() or [walk.past()]

    def course(self, passage: ArcPassage, *, parts: int) -> tuple[Vector, Vector]:
        """Return the derivatives of the state along an arc, at equal parts of every step.

        Args:
            passage: The arc, which has a flow.
            parts: Number of outputs per step.

        Returns:
            The flow's own times since the start of the arc, ``(n,)``, and the derivatives of the
            states at these times, ``(n, n_x, m)``. The start is the first of them.
        """
        perturbations, mode, v, q = self.flow(passage.arc, passage.start)
        times, rows = course_of_arc(perturbations, passage.arc, mode, v, q, parts=parts)
        return times, rows[:, : passage.arc.start_state.size]

    def at_equal_times(
        self, passage: ArcPassage, *, parts: int
    ) -> tuple[Vector, Vector, Vector] | None:
        """Return the derivatives along an arc at times that do not move.

        Args:
            passage: The arc.
            parts: Number of evenly spaced points per step of the integrator.

        Returns:
            Times, ``(n,)`` [s], the derivatives of the state there with respect to the start and
            the chosen parameters, ``(n, n_x, m)``, and their rates in time. ``None`` for the tail
            of a Zeno point and for an arc that takes no time.
        """
        arc, n_x = passage.arc, passage.arc.start_state.size
        if arc.ending is Ending.ZENO or not arc.end_time > arc.start_time:
            return None
        offsets, shifts = self.course(passage, parts=parts)
        # Rounding may put the last time beyond the end of the arc.
        offsets = np.minimum(offsets, arc.duration)
        states = arc.flow_states_at(offsets)[:, :n_x]
        perturbations, mode, v, _ = self.flow(arc, passage.start)
        _, differential = perturbations.flow_of(arc, mode, n_x)
        own = perturbations.dynamics
        rates = (own.locked if mode is Mode.LOCKED else own.free).rates(states)
        longer = passage.start.rate if len(v) > n_x else 0.0
        later = passage.start.time + offsets[:, None] * longer
        moved = shifts - rates[:, :, None] * later[:, None]
        every = np.broadcast_to(
            perturbations.parameters, (len(states), *perturbations.parameters.shape)
        )
        slopes = differential.linear(states) @ np.concatenate([moved, every], axis=1)
        return arc.start_time + offsets * arc.time_unit, moved, slopes

    def within(self, passage: ArcPassage, offsets: Vector) -> Vector:
        """Return the derivatives of the states inside an arc, ``(n, n_x, m)``.

        Args:
            passage: The arc, which has a flow.
            offsets: The flow's own times since the start of the arc, ``(n,)``.
        """
        arc = passage.arc
        perturbations, mode, v, q = self.flow(arc, passage.start)
        _, before = course_of_arc(perturbations, arc, mode, v, q)
        flow, differential = perturbations.flow_of(arc, mode, len(v))
        rows = carried_within(flow, differential, arc, self.tolerance, before, q, offsets)
        return rows[:, : arc.start_state.size]

    def rested(self, passage: ArcPassage, stop: str) -> tuple[Vector, Vector]:
        """Return the start of an arc moved onto a stop at rest, and its derivatives.

        Args:
            passage: The arc.
            stop: Name of the stop, which is open along the arc.

        Returns:
            The state, ``(n_x,)``, and its derivatives, ``(n_x, m)``.
        """
        arc = passage.arc
        perturbations = self.of_stop(arc, self.index(stop))
        by_state = perturbations.differentials.resting(arc.start_state)[: arc.start_state.size]
        resting = perturbations.dynamics.resting(arc.start_state)
        return resting.state, change_of(by_state, passage.start.state)

    # Views.

    def index(self, stop: str) -> int:
        """Return the index of a stop."""
        return self.graph.stop_names.index(stop)

    def of_stop(self, arc: Arc, stop: int) -> VariationalEquation:
        """Return the derivatives of a stop in the mode of an arc, with that stop open."""
        closed, sides = arc.mode_in(self.graph)
        return self.at((tuple(k for k in closed if k != stop), sides), stop)

    def at(self, mode: GraphMode, stop: int) -> VariationalEquation:
        """Return the derivatives of a stop that is open in a mode."""
        key = (mode, stop)
        if key not in self._known:
            view = self.graph.view(mode, stop)
            if view.differentiation is None:
                wanted = "must have formulas, but it has plain functions"
                raise InputError(f"Argument `dynamics` {wanted}.")
            self._known[key] = VariationalEquation(
                dynamics=view,
                differentials=view.differentiation.by(self.chosen),
                n_parameters=len(self.chosen),
                tolerance=self.tolerance,
                in_python=self.in_python,
            )
        return self._known[key]

    def flow(
        self, arc: Arc, start: SaltationDerivative
    ) -> tuple[VariationalEquation, Mode, Vector, Vector]:
        """Return the flow of an arc, with the perturbations of its start and its parameters."""
        mode = arc.mode_in(self.graph)
        stop = self.stop_of_flight(arc)
        if stop is not None:
            perturbations = self.of_stop(arc, stop)
            v = np.concatenate([start.state, self._scaled(perturbations, arc, start)])
            q = np.concatenate([perturbations.parameters, start.rate[None, :]])
            return perturbations, Mode.FREE, v, q
        rest, some = self.graph.some_stop(mode)
        perturbations = self.at(rest, some)
        flow = Mode.FREE if rest == mode else Mode.LOCKED
        return perturbations, flow, start.state, perturbations.parameters

    def _scaled(
        self, perturbations: VariationalEquation, arc: Arc, start: SaltationDerivative
    ) -> Vector:
        """Return the perturbations of the scaled gap and its rate at a flight's start, ``(2, m)``.

        They do not move on the stop. Off the stop the speed that scales them does not move.
        """
        if arc.flow_states[0, -2] == 0.0:
            return np.zeros((2, start.state.shape[1]))
        contact = perturbations.differentials.contact(arc.start_state)
        gap, rate = (change_of(contact[k], start.state) for k in (GAP, GAP_RATE))
        return np.array([gap / arc.time_unit**2, rate / arc.time_unit])

    def stop_of_flight(self, arc: Arc) -> int | None:
        """Return the stop of a rescaled flight, or ``None`` for another arc."""
        if arc.stop:
            return self.index(arc.stop)
        is_flight = (
            arc.mode is Mode.FREE
            and arc.ending is not Ending.ZENO
            and arc.flow_state_at(arc.duration).size > arc.start_state.size
        )
        return 0 if is_flight else None
