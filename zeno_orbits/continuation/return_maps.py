r"""Return maps along a line of parameters, with exact derivatives and the margins of each return.

A return map takes a section to itself: the states just after an event of a kind. A return passes
one event sequence, for every machine. Returns are computed in the full state, so that they can be
composed:

.. math:: D(P_2 \circ P_1) = \partial_x P_2\; D P_1 + \partial_s P_2

A return can be truncated, so that it is smooth where a contact phase vanishes. The impact sequence
that ends exactly at the release is the stable set of the fixed point of theory (5.7). There the
Zeno point is not differentiable, but the first `n` impacts are. A return with a plastic reset at
impact `n` differs from the true return by :math:`O(\sigma^{4n})`, theory (2.3). The condition
:math:`r_n = r_*` has an error of :math:`O((\sigma / \kappa)^n)` in the parameter. Source: theory
(5.5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from threading import get_ident
from typing import Protocol

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.separatrix import separatrix
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import GAP_ACCELERATION, CompiledGraph, GraphDynamics, HybridDynamics
from zeno_orbits.orbits import (
    EventReturn,
    EventSection,
    Line,
    Margin,
    MarginKind,
    Saddle,
    Section,
    contact_view,
    contacts_of,
    differentials_of,
    event_return,
    extrapolated,
    kept_section,
    margins_of_return,
    on_section,
    relaxed_settings,
    saddle_of_return,
)
from zeno_orbits.simulation import Impact, PlasticAfter, SimulationSettings, steady_turn


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentiatedReturn:
    """A return and its derivatives in the full state.

    Attributes:
        time: Duration of the return [s].
        end: State at its end, ``(n_x,)``.
        by_state: Derivative of `end` with respect to the start, ``(n_x, n_x)``.
        by_parameter: Derivative of `end` with respect to the position on the line, ``(n_x,)``.
        margins: Distance from each kind of loss.
        volume: Product of the multipliers by Liouville's formula if the orbit closes, or ``None``
            if the formula does not apply (theory (5.9)).
        turns: Number of turns of the clock in that time. 0 without a steadily turning clock.
    """

    time: float
    end: Vector
    by_state: Vector
    by_parameter: Vector
    margins: Mapping[Margin, float]
    volume: float | None = None
    turns: float = 0.0


class LazyMargins(Mapping[Margin, float]):
    """Margins that are computed at their first use.

    Most returns are trials of Newton's method and do not need margins.

    Args:
        measure: Function that computes the margins.
    """

    def __init__(self, measure: Callable[[], Mapping[Margin, float]]) -> None:
        self._measure: Callable[[], Mapping[Margin, float]] | None = measure
        self._values: Mapping[Margin, float] = {}

    def _measured(self) -> Mapping[Margin, float]:
        if self._measure is not None:
            # The function keeps a whole execution alive. It is released here.
            self._values, self._measure = self._measure(), None
        return self._values

    def __reduce__(self) -> tuple[type[dict[Margin, float]], tuple[dict[Margin, float]]]:
        """Return the computed margins, because other processes do not have the execution."""
        return dict, (dict(self._measured()),)

    def __getitem__(self, key: Margin) -> float:
        return self._measured()[key]

    def __iter__(self) -> Iterator[Margin]:
        return iter(self._measured())

    def __len__(self) -> int:
        return len(self._measured())


class FamilyMap(Protocol):
    """A section and its return map, along a line of parameters."""

    @property
    def line(self) -> Line:
        """The line."""
        ...

    @property
    def n_places(self) -> int:
        """Number of places of its margins."""
        ...

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion from a state of the section to the next.

        Args:
            x: The state, ``(n_x,)``.
            s: Position on the line.
            horizon: Longest time to wait [s].

        Raises:
            ZenoOrbitsError: If the motion does not return within the horizon, or the return is not
                differentiable.
        """
        ...

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return the section around one of its states.

        Args:
            x: The state, ``(n_x,)``.
            s: Position on the line.
            scale: Size of each state, ``(n_x,)``.
        """
        ...

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        """Return the state of the section nearest to a state.

        Args:
            x: The state, ``(n_x,)``.
            s: Position on the line.
            scale: Size of each state, ``(n_x,)``.
        """
        ...

    def restitution(self, s: float, place: int = 0) -> float:
        """Return the coefficient of restitution of the stop of a margin.

        Args:
            s: Position on the line.
            place: Place of the margin.
        """
        ...

    def saddle(self, x: Vector, s: float, *, horizon: float) -> Saddle | None:
        """Return the saddle near the slowest state of the motion from a state, or ``None``.

        Args:
            x: The state, ``(n_x,)``.
            s: Position on the line.
            horizon: Longest time to wait [s].
        """
        ...

    def loosened(self) -> FamilyMap:
        """Return the same map at a looser tolerance. The change is an error estimate."""
        ...

    def moved_to(self, line: Line) -> FamilyMap:
        """Return the same map along another line."""
        ...

    def cut_after(self, n_impacts: int) -> FamilyMap:
        """Return the same map with truncated impact sequences.

        Args:
            n_impacts: Number of impacts before each plastic reset.
        """
        ...


LOOSER = 30.0
"""Factor on the tolerances for the second computation of a point."""
PATIENCE = 4.0
"""Longest time to wait for a return, in periods of the start."""


_Values = tuple[float, ...]
"""All parameter values, ``(n_p,)``."""


@lru_cache(maxsize=2)
def _graph_of(compiled: CompiledGraph, values: _Values, thread: int) -> GraphDynamics:
    """Return the machine at some values. Its memory belongs to one thread."""
    del thread
    return GraphDynamics(compiled, values)


@lru_cache(maxsize=8)
def _graph_at(
    compiled: CompiledGraph, start: _Values, values: _Values, thread: int
) -> GraphDynamics:
    """Return the machine at some values. A return and its section in one thread share it.

    It has the scales of the start of its family, on which all returns depend alike.

    Raises:
        SimulationError: If the values are invalid, such as a negative restitution.
    """
    try:
        graph = _graph_of(compiled, start, thread).at(values)
        _ = graph.open_views
    except InputError as error:
        raise SimulationError(str(error), time=0.0, state=()) from error
    return graph


@dataclass(frozen=True, kw_only=True)
class EventReturns:
    """Return map from an event to the end of its event sequence, along a line of parameters.

    Attributes:
        compiled: Functions of the problem.
        start: All parameter values at the start of the family.
        line: The line of parameters.
        settings: Accuracy.
        section: The section.
        cut: Number of impacts before a plastic reset at each Zeno point. 0 resolves all impacts.
            All Zeno points are truncated, since several contact phases of a symmetric orbit vanish
            at once. Far from its end, an impact sequence is changed less.
    """

    compiled: CompiledGraph
    start: _Values
    line: Line
    settings: SimulationSettings
    section: EventSection
    cut: int = 0

    @property
    def n_places(self) -> int:
        """Number of events in the event sequence."""
        return len(self.section.sequence)

    def dynamics(self, s: float) -> GraphDynamics:
        """Return the machine at a position on the line."""
        values = tuple(self.line.at(s).tolist())
        return _graph_at(self.compiled, self.start, values, get_ident())

    def restitution(self, s: float, place: int = 0) -> float:
        """Return the coefficient of restitution of the stop of an event.

        Args:
            s: Position on the line.
            place: Index of the event in the event sequence. If it has no stop, the first is meant.
        """
        graph = self.dynamics(s)
        _, _, name = self.section.sequence[place % self.n_places].partition(" ")
        stop = graph.stop_names.index(name) if name in graph.stop_names else 0
        return graph.open_views[stop].restitution

    def moved_to(self, line: Line) -> EventReturns:
        """Return the same map along another line."""
        return replace(self, line=line)

    def cut_after(self, n_impacts: int) -> EventReturns:
        """Return the same map with truncated impact sequences."""
        return replace(self, cut=n_impacts)

    def loosened(self) -> EventReturns:
        """Return the same map at a looser tolerance."""
        return replace(self, settings=relaxed_settings(self.settings, factor=LOOSER))

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return the section around one of its states."""
        line = self.line
        kept = kept_section(self.dynamics(s), x, self.section.mode, scale, line.moving)
        return replace(kept, drift=(kept.drift @ line.slopes)[:, None])

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        """Return the state projected onto its closed stops, and onto the stop that it leaves."""
        del scale
        return on_section(self.dynamics(s), x, self.section.mode)

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion from a state of the section to the end of the event sequence.

        Raises:
            SimulationError: If the event sequence is another, or the motion does not return.
        """
        graph = self.dynamics(s)
        found = self._returned(graph, x, horizon)
        turn = steady_turn(graph.first, found.start)
        return DifferentiatedReturn(
            time=found.period,
            end=found.end,
            by_state=found.by_state,
            by_parameter=found.by_parameters @ self.line.slopes,
            margins=LazyMargins(lambda: self._margins(graph, found)),
            volume=volume_of(graph, found),
            turns=found.period / turn if turn else 0.0,
        )

    def saddle(self, x: Vector, s: float, *, horizon: float) -> Saddle | None:
        """Return the saddle near the slowest state of the motion from a state, or ``None``."""
        graph = self.dynamics(s)
        start = on_section(graph, x, self.section.mode)
        return saddle_of_return(graph, self._returned(graph, start, horizon))

    def _returned(self, graph: GraphDynamics, x: Vector, horizon: float) -> EventReturn:
        whole = extrapolated(self.settings)
        return event_return(
            graph,
            x,
            section=self.section.name,
            n_returns=self.section.n_returns,
            guess=horizon / PATIENCE,
            settings=self.settings,
            parameters=self.line.moving,
            completion=PlasticAfter(n_impacts=self.cut) if self.cut else whole,
            sequence=self.section.sequence,
            openings=self.section.openings,
        )

    def _margins(self, graph: GraphDynamics, found: EventReturn) -> Mapping[Margin, float]:
        """Return the margins of a return, or those of its truncations alone."""
        if not self.cut:
            return margins_of_return(graph, found)
        return {
            Margin(loss=MarginKind.CUT, place=contact.place): _from_separatrix(
                contact_view(graph, found, contact), contact.last_impact
            )
            for contact in contacts_of(found)
        }


def _from_separatrix(dynamics: HybridDynamics, impact: Impact) -> float:
    r"""Return :math:`1 - r / r_*` after an impact.

    It is positive if the impacts accumulate before the release.
    """
    resting = dynamics.resting(impact.state_plus)
    gradient = differentials_of(dynamics, ()).contact(resting.state)[GAP_ACCELERATION]
    fall = float(gradient @ resting.rate)
    speed = dynamics.speed_after(impact.approach_rate)
    ratio = speed * fall / resting.gap_acceleration**2
    return 1 - ratio / separatrix(dynamics.restitution).ratio


@dataclass(frozen=True, kw_only=True)
class Composed:
    """Composition of several returns, under which an orbit of a higher period closes.

    Attributes:
        maps: The return maps, all with the same section and line.
    """

    maps: tuple[FamilyMap, ...]

    @property
    def line(self) -> Line:
        """The line of parameters."""
        return self.maps[0].line

    @property
    def n_places(self) -> int:
        """Number of places of its margins."""
        return len(self.maps) * self.maps[0].n_places

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return the section around one of its states."""
        return self.maps[0].frame(x, s, scale)

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        """Return the state of the section nearest to a state."""
        return self.maps[0].projected(x, s, scale)

    def saddle(self, x: Vector, s: float, *, horizon: float) -> Saddle | None:
        """Return the saddle near the slowest state of the motion from a state, or ``None``."""
        return self.maps[0].saddle(x, s, horizon=horizon)

    def restitution(self, s: float, place: int = 0) -> float:
        """Return the coefficient of restitution of the stop of a margin."""
        return self.maps[0].restitution(s, place)

    def moved_to(self, line: Line) -> Composed:
        """Return the same map along another line."""
        return Composed(maps=tuple(one.moved_to(line) for one in self.maps))

    def cut_after(self, n_impacts: int) -> Composed:
        """Return the same map with truncated impact sequences."""
        return Composed(maps=tuple(one.cut_after(n_impacts) for one in self.maps))

    def loosened(self) -> Composed:
        """Return the same map at a looser tolerance."""
        return Composed(maps=tuple(one.loosened() for one in self.maps))

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion up to the last return."""
        end, by_state, by_parameter = x, np.eye(x.size), np.zeros(x.size)
        time, turns, margins = 0.0, 0.0, list[Mapping[Margin, float]]()
        volumes = list[float | None]()
        for k, one in enumerate(self.maps):
            # A motion drifts off the constraints of its section.
            start = one.projected(end, s, np.ones(x.size)) if k else end
            found = one.follow(start, s, horizon=horizon)
            volumes.append(found.volume)
            by_state = found.by_state @ by_state
            by_parameter = found.by_state @ by_parameter + found.by_parameter
            end, time, turns = found.end, time + found.time, turns + found.turns
            margins.append(found.margins)
        return DifferentiatedReturn(
            time=time,
            end=end,
            by_state=by_state,
            by_parameter=by_parameter,
            margins=LazyMargins(lambda: _placed(margins, self.maps[0].n_places)),
            volume=_product(volumes),
            turns=turns,
        )


def _placed(margins: Sequence[Mapping[Margin, float]], n_places: int) -> Mapping[Margin, float]:
    """Return the margins of several returns, those of each return after those before it."""
    return {
        replace(key, place=turn * n_places + key.place): value
        for turn, one in enumerate(margins)
        for key, value in one.items()
    }


def _product(factors: Sequence[float | None]) -> float | None:
    known = [factor for factor in factors if factor is not None]
    return math.prod(known) if len(known) == len(factors) else None


def volume_of(graph: GraphDynamics, found: EventReturn) -> float | None:
    r"""Return the factor of phase volume over flights and their impacts.

    .. math:: \prod \frac{w}{v}\,\frac{dw}{dv}\,\exp\int \operatorname{div} f\,dt

    with the gap rates `v` before and `w` after each impact. Return ``None`` if the divergence is
    not constant (then damping is not linear), if holonomic rows couple the coordinates, or if
    another event than an impact occurs.

    Args:
        graph: The machine.
        found: A return.
    """
    arcs = [arc for arc in found.execution.arcs if arc.start_time < found.period]
    simple = all(isinstance(event, Impact) for event in found.events)
    if not simple or any(arc.closed or arc.trajectory is None for arc in arcs):
        return None
    if graph.first.holonomic(found.start).size > bool(graph.first.clock):
        return None
    volume, n_x = 1.0, found.start.size
    for arc in arcs:
        flow = graph.view(arc.mode_in(graph), 0).free
        places = np.linspace(0.0, arc.duration, _TRACES)
        traces = [np.trace(flow.jacobian(arc.flow_state_at(t)[:n_x])) for t in places]
        if np.ptp(traces) > _CONSTANT * max(np.max(np.abs(traces)), 1 / found.period):
            return None
        volume *= float(np.exp(traces[0] * (arc.end_time - arc.start_time)))
    for event in found.events:
        if isinstance(event, Impact):
            view = graph.open_views[graph.stop_names.index(event.stop)]
            by_rate = float(differentials_of(view, ()).speed_after(event.approach_rate)[0])
            volume *= view.speed_after(event.approach_rate) / event.approach_rate * by_rate
    return abs(volume)


_TRACES, _CONSTANT = 7, 1e-12
"""Number of points at which the divergence is computed, and the largest relative change at which it
counts as constant."""
