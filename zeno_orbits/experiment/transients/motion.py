r"""A simulated motion with exact derivatives at given times, for fits of transients.

With the state :math:`x(t; x_0, p)`, the sensitivity is
:math:`S = \partial x / \partial (x_0, p)` at a fixed time. It jumps at every event by the rules of
theory (4.3). Inside an arc it is the cubic that matches the values and slopes at the nodes of the
integrator and points between them.

A deviation :math:`\epsilon` of the restitution at a single impact changes the state after it by

.. math:: \delta x^+ = \frac{x^+ - x^-}{1 + e}\,\epsilon

because the impulse is proportional to :math:`1 + e`, and then follows the same sensitivities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import GraphDynamics
from zeno_orbits.simulation import (
    ArcPassage,
    EventDerivatives,
    EventKind,
    Execution,
    Impact,
    SaltationDerivative,
    SimulationSettings,
    ZenoExtrapolation,
    simulate,
)

_PARTS = 2
"""Nodes of the sensitivities per step of the integrator."""
_ROUGH = 1e-10
"""Relative error of a step of a trial simulation, far below the noise of recordings."""

SETTINGS = SimulationSettings(
    tolerance=Tolerance(relative=_ROUGH),
    completion=ZenoExtrapolation(),
    most_impacts=4000,
    most_steps=60_000,
)
"""Accuracy and limits of the simulations of a fit. A trial that chatters for ever is abandoned."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StatesAt:
    """States of a motion at given times.

    Attributes:
        motion: The motion.
        times: Increasing times, ``(n,)`` [s].
    """

    motion: TransientMotion
    times: Vector

    @cached_property
    def states(self) -> Vector:
        """The states, ``(n, n_x)``. Before time 0 the machine waits at its start."""
        arcs = self.motion.execution.arcs
        found = np.tile(arcs[0].start_state, (len(self.times), 1))
        for k, rows in self.motion.samples(self.times):
            found[rows] = arcs[k].states_at(self.times[rows])
        return found

    @cached_property
    def rates(self) -> Vector:
        """Time derivatives of the states, ``(n, n_x)``."""
        found, graph = np.zeros_like(self.states), self.motion.graph
        for k, rows in self.motion.samples(self.times):
            flow = graph.flow(self.motion.execution.arcs[k].mode_in(graph))
            found[rows] = flow.rates(self.states[rows])
        return found

    @cached_property
    def by(self) -> Vector:
        """Derivatives by the initial state, then the chosen parameters, ``(n, n_x, m)``.

        Raises:
            SimulationError: If an event lacks a derivative.
        """
        found = np.tile(
            np.eye(self.states.shape[1], self.motion.n_columns), (len(self.times), 1, 1)
        )
        for k, rows in self.motion.samples(self.times):
            found[rows] = self.motion.sensitivities(k, self.times[rows])
        return found


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionTimes:
    """Times of the events of one kind at one stop.

    Attributes:
        times: ``(n,)`` [s].
        by: Derivatives of the times, ``(n, m)``.
    """

    times: Vector
    by: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class TransientMotion:
    """A simulated motion with derivatives.

    Attributes:
        graph: The machine.
        execution: The motion.
        chosen: Indices of the parameters of the derivatives.
    """

    graph: GraphDynamics
    execution: Execution
    chosen: tuple[int, ...]

    @cached_property
    def _derivatives(self) -> EventDerivatives:
        return EventDerivatives(self.graph, self.chosen, SETTINGS.tolerance)

    @cached_property
    def _passages(self) -> tuple[ArcPassage, ...]:
        return tuple(self._derivatives.passages(self.execution))

    def at(self, times: Vector) -> StatesAt:
        """Return states and derivatives at times, which are computed when they are asked for.

        Args:
            times: Increasing times, ``(n,)`` [s].
        """
        return StatesAt(motion=self, times=times)

    def sensitivities(self, k: int, times: Vector) -> Vector:
        """Return the derivatives of the states at times inside an arc, ``(n, n_x, m)``.

        Args:
            k: Index of the arc.
            times: Increasing times, ``(n,)`` [s].

        Raises:
            SimulationError: If an event lacks a derivative.
        """
        return _between(self._derivatives, self._passages[k], times)

    def events(self, kind: EventKind, stop: str) -> MotionTimes:
        """Return the events of a kind at a stop, impacts up to the resolved ones.

        Args:
            kind: Impact or release.
            stop: Name of the stop.
        """
        found = [
            (event.time, before.time)
            for passage in self._passages
            for event, before, _ in passage.crossings
            if event.kind is kind and event.what == stop
        ]
        return MotionTimes(
            times=np.array([time for time, _ in found]),
            by=np.array([row for _, row in found]).reshape(len(found), self.n_columns),
        )

    def zeno_times(self, stop: str) -> Vector:
        """Return the Zeno times at a stop, ``(n,)`` [s]."""
        return np.array([one.time for one in self.execution.zeno_points if one.stop == stop])

    def after_deviation(self, impact: Impact, times: Vector) -> Vector:
        """Return the derivatives of the states with respect to the restitution at one impact.

        Args:
            impact: An impact of the motion.
            times: Increasing times, ``(n,)`` [s].

        Returns:
            The derivatives, ``(n, n_x)``. They are zero up to the impact.
        """
        passages, first = self._deviated(impact)
        found = np.zeros((len(times), len(impact.state_plus)))
        for k, rows in self.samples(times):
            if k >= first:
                own = _between(self._of_states, passages[k - first], times[rows])
                found[rows] = own[:, :, 0]
        return found

    def events_after_deviation(self, impact: Impact, kind: EventKind, stop: str) -> Vector:
        """Return the derivatives of event times with respect to the restitution at one impact.

        Args:
            impact: An impact of the motion.
            kind: Impact or release.
            stop: Name of the stop.

        Returns:
            The derivatives for all events of `events`, ``(n,)`` [s], zero up to the impact.
        """
        passages, _ = self._deviated(impact)
        later = {
            event.time: float(before.time[0])
            for passage in passages
            for event, before, _ in passage.crossings
            if event.kind is kind and event.what == stop
        }
        return np.array([later.get(time, 0.0) for time in self.events(kind, stop).times])

    @cached_property
    def _of_states(self) -> EventDerivatives:
        return EventDerivatives(self.graph, (), SETTINGS.tolerance)

    def _deviated(self, impact: Impact) -> tuple[list[ArcPassage], int]:
        """Return the arcs after an impact with the derivatives, and the index of the first one."""
        arcs = self.execution.arcs
        first = next(
            (k for k, arc in enumerate(arcs) if arc.start_time >= impact.time), len(arcs) - 1
        )
        view = self.graph.open_views[self.graph.stop_names.index(impact.stop)]
        # The restitution of this impact, which may depend on its speed.
        ratio = float(view.speed_after(impact.approach_rate)) / abs(impact.approach_rate)
        kick = (impact.state_plus - impact.state_minus) / (1.0 + ratio)
        state = np.zeros((len(kick), len(kick)))
        state[:, 0] = kick
        rate = np.zeros(len(kick))
        rate[0] = abs(impact.approach_rate)
        start = SaltationDerivative(time=np.zeros(len(kick)), state=state, rate=rate)
        passages = self._of_states.passages(self.execution, start, first=first)
        return list(passages), first

    @property
    def n_columns(self) -> int:
        """Number of columns of the derivatives."""
        return len(self.graph.state_names) + len(self.chosen)

    def samples(self, times: Vector) -> list[tuple[int, slice]]:
        """Return the arcs that hold some of the times, each with the range of these times."""
        arcs = self.execution.arcs
        starts = np.array([arc.start_time for arc in arcs])
        place = np.searchsorted(starts, times, side="right") - 1
        found: list[tuple[int, slice]] = []
        for k in np.unique(place[place >= 0]).tolist():
            rows = np.searchsorted(place, [k, k + 1])
            found.append((k, slice(int(rows[0]), int(rows[1]))))
        return found


def _between(derivatives: EventDerivatives, passage: ArcPassage, times: Vector) -> Vector:
    """Return the sensitivities at times inside an arc, ``(n, n_x, m)``."""
    nodes = derivatives.at_equal_times(passage, parts=_PARTS)
    if nodes is None:
        # The tail of the impacts is shorter than any sampling interval.
        return np.tile(passage.end.state, (len(times), 1, 1))
    at, values, slopes = nodes
    k = np.clip(np.searchsorted(at, times, side="right") - 1, 0, len(at) - 2)
    size = at[k + 1] - at[k]
    part = np.clip((times - at[k]) / np.where(size > 0.0, size, 1.0), 0.0, 1.0)[:, None, None]
    size = size[:, None, None]
    up = part**2 * (3.0 - 2.0 * part)
    return np.asarray(
        values[k] * (1.0 - up)
        + values[k + 1] * up
        + size * part * (1.0 - part) * ((1.0 - part) * slopes[k] - part * slopes[k + 1])
    )


def moved(
    graph: GraphDynamics, start: Vector, until: float, chosen: Sequence[int]
) -> TransientMotion | None:
    """Return the motion from a start, or ``None`` if it cannot be followed to the end.

    Args:
        graph: The machine at fixed values.
        start: Initial state, ``(n_x,)``.
        until: End time [s].
        chosen: Indices of the parameters of the derivatives.
    """
    try:
        execution = simulate(graph, start, until=until, settings=SETTINGS)
    except (ZenoOrbitsError, ValueError, FloatingPointError):
        # Trial values may be inadmissible: the start inside a stop, or a motion that diverges.
        return None
    return TransientMotion(graph=graph, execution=execution, chosen=tuple(chosen))
