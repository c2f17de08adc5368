r"""Table of one orbit period, which evaluates the signals at very many times at once.

Between the nodes of an arc a signal is the cubic that matches the values and slopes at both nodes
(Hermite). An impact has two nodes at the same time. With nodes at most ``d`` apart the error of a
cubic is :math:`d^4 \max|y^{(4)}| / 384`. The nodes are the steps of the integrator and several
points between them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.sequences import OrbitSequence, orbit_sequences
from zeno_orbits.integrators import FlowWithEvent
from zeno_orbits.model import Columns, GraphDynamics, Problem, dense_function
from zeno_orbits.orbits import Orbit, event_return
from zeno_orbits.simulation import (
    Arc,
    Ending,
    Impact,
    SimulationSettings,
    ZenoPoint,
    signal,
    signal_names,
    simulate,
    steady_turn,
)

STOP = "stop"
"""Name of the only stop of a machine whose stops have no names."""
GAP = "gap"
"""Name of the gap signal, which every problem has in addition to its own signals."""

_BETWEEN = 6
"""Nodes between two steps of the integrator."""
_AT_ONCE = 1 << 16
"""Number of states per evaluation. Each state needs its own copy of the parameters."""
_JUMP = 1e-6
"""A step of this part of a signal's range is a jump: a table is as exact as that."""
_LAYER = 0.005
"""Smallest change of a signal in a layer, relative to its range."""
ROUGHLY = 0.01
"""Largest part of a period next to a jump that is ignored while the phases are roughly known."""
_BESIDE = 1e-4
"""The same at least, however well phases are known."""
_SURE = 4.0
"""Standard errors of a phase within which it may be off."""
_PAST = 1e-7
"""Part of the period of an orbit given as events to simulate further."""
_LEAST = 24
"""Intervals of an arc at least."""
_INSIDE = 1e-9
"""Part of an arc by which a state is inside it, so that every condition of a formula is decided."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measurement:
    """Signals measured in a state.

    Attributes:
        names: Names of the signals.
        units: Units of the signals, an empty string for the gap.
        function: ``(x, p) -> signals``, ``(n_s,)``.
        slopes: ``(x, p) -> derivative of the signals with respect to the state, then to p``, by
            columns.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    function: Columns
    slopes: Columns

    def values(self, states: Vector, p: Vector) -> Vector:
        """Return the signals at states ``(n, n_x)`` and gains, then parameters, ``(n, n_s)``."""
        found = np.empty((len(states), len(self.names)))
        for at in range(0, len(states), _AT_ONCE):
            piece = slice(at, at + _AT_ONCE)
            found[piece] = self.function(states[piece], _rows(p, states[piece]))[0]
        return found

    def derivatives(self, states: Vector, p: Vector) -> Vector:
        """Return the derivatives with respect to the state and to `p`, ``(n, n_s, n_x + n_p)``."""
        flat = self.slopes(states, _rows(p, states))[0]
        columns = (len(states), states.shape[1] + len(p), len(self.names))
        return flat.reshape(columns).transpose(0, 2, 1)


def _rows(p: Vector, states: Vector) -> Vector:
    return np.broadcast_to(p, (len(states), len(p)))


def measurement(problem: Problem, names: Sequence[str]) -> Measurement:
    """Return the signals of a problem with the given names, each one of `measurable`."""
    known = measurable(problem)
    x = ca.SX.sym("x", len(problem.state_names))
    p = ca.SX.sym("p", len(problem.names))
    outputs = ca.vertcat(*(_formula(problem, name, x, p) for name in names))
    slopes = ca.jacobian(outputs, ca.vertcat(x, p))
    return Measurement(
        names=tuple(names),
        units=tuple(known.get(name, "") for name in names),
        function=Columns(dense_function("signals", [x, p], [outputs])),
        slopes=Columns(dense_function("signal_slopes", [x, p], [slopes])),
    )


def measurable(problem: Problem) -> dict[str, str]:
    """Return the units of all measurable signals by name: states, motors, outputs."""
    units = dict(zip(problem.state_names, problem.state_units, strict=True))
    for name in _motor_signals(problem):
        units.setdefault(name, "A" if name.startswith("current") else "V")
    for output in problem.outputs:
        units.setdefault(output.name, output.unit)
    return units


def gap_coordinates(problem: Problem) -> tuple[str, ...]:
    """Return the names of the states that the gap depends on."""
    system = problem.model(problem.symbols())
    return tuple(
        name
        for k, name in enumerate(problem.state_names)
        if any(ca.which_depends(system.gap, system.state[k], 1))
    )


def _motor_signals(problem: Problem) -> tuple[str, ...]:
    """Return the names of the states and of the signals of motors, with one stop alone."""
    return () if problem.has_graph else tuple(signal_names(problem.compiled()))


def _formula(problem: Problem, name: str, x: ca.SX, p: ca.SX) -> ca.SX:
    if name in problem.state_names:
        return x[problem.state_names.index(name)]
    if name in _motor_signals(problem):
        return signal(problem.compiled(), name).function(x, p)
    if name == GAP:
        return problem.compiled().contact_at(x, p).gap
    outputs = [output.name for output in problem.outputs]
    if name not in outputs:
        raise ValueError(f"Argument `name` must be a signal of the problem, but it is `{name}`.")
    symbols = problem.symbols()
    system = problem.model(symbols)
    formula = problem.output_formulas(system, symbols)[outputs.index(name)]
    return ca.substitute([formula], [system.state, ca.vertcat(*symbols.values())], [x, p])[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class CubicColumns:
    """Columns over time, cubic between the nodes.

    Attributes:
        times: Nondecreasing times, repeated at a jump of the columns, ``(n,)`` [s].
        values: Values of the columns, ``(n, m)``.
        slopes: Time derivatives of the columns, ``(n, m)``.
    """

    times: Vector
    values: Vector
    slopes: Vector

    @cached_property
    def _pieces(self) -> Any:
        """The cubics of the intervals that have a length."""
        from scipy.interpolate import PPoly

        own = np.flatnonzero(np.diff(self.times) > 0.0)
        size = (self.times[own + 1] - self.times[own])[:, None]
        mean = (self.values[own + 1] - self.values[own]) / size
        first, last = self.slopes[own], self.slopes[own + 1]
        third, second = (first + last - 2 * mean) / size**2, (3 * mean - 2 * first - last) / size
        times = np.append(self.times[own], self.times[-1])
        return PPoly(np.stack([third, second, first, self.values[own]]), times)

    def at(self, times: Vector) -> Vector:
        """Return the columns at times, or after a jump at its time, ``(n, m)``."""
        return np.asarray(self._pieces(times), dtype=np.float64)

    def with_slopes(self, times: Vector) -> tuple[Vector, Vector]:
        """Return the columns and their time derivatives at times, each ``(n, m)``."""
        return self.at(times), np.asarray(self._pieces(times, nu=1), dtype=np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class PeriodTable:
    """One period of an orbit, with times since its start.

    Attributes:
        period: [s].
        measured: The signals.
        nodes: Values of the signals.
        states: The states.
        p: Gains, then parameters.
        sequences: Sequences of impacts in the period by stop, for the stops that are struck.
        held: Stops that are closed during the whole period.
        turn: Time of a turn of the clock [s], or ``None`` without a steady clock.
        zero: Time of the clock's zero phase since the start of the period [s], or zero.
    """

    period: float
    measured: Measurement
    nodes: CubicColumns
    states: CubicColumns
    p: Vector
    sequences: Mapping[str, tuple[OrbitSequence, ...]] = field(
        default_factory=dict[str, tuple[OrbitSequence, ...]]
    )
    held: frozenset[str] = frozenset()
    turn: float | None = None
    zero: float = 0.0

    @property
    def accumulates(self) -> bool:
        """True if impacts accumulate in the period: the orbit is a Zeno orbit."""
        return any(one.zeno is not None for own in self.sequences.values() for one in own)

    def since_zero(self, time: float) -> float:
        """Return a time since the last zero phase of the clock, or since the start."""
        return (time - self.zero) % (self.turn or self.period)

    def parts(self, phases: Vector) -> dict[str, NDArray[np.bool_]]:
        """Return the parts of the period, as masks of phases. The whole period lacks a name.

        Args:
            phases: Phases in periods from the start, ``(n,)``.
        """
        if not self.accumulates:
            return {"": np.ones(len(phases), dtype=np.bool_)}
        times = phases * self.period

        def within(first: float | None, last: float | None) -> NDArray[np.bool_]:
            if first is None or last is None:
                return np.zeros(len(phases), dtype=np.bool_)
            return (times - first) % self.period < last - first

        sequences = [one for own in self.sequences.values() for one in own]
        chatter, locked = (
            np.asarray(np.any(parts, axis=0), dtype=np.bool_)
            for parts in (
                [within(one.impacts[0], one.zeno) for one in sequences],
                [within(one.zeno, one.release) for one in sequences],
            )
        )
        return {
            "in flight": ~(locked | chatter),
            "in chatter": chatter & ~locked,
            "in contact": locked,
        }

    def at(self, phases: Vector) -> Vector:
        """Return the signals at phases, ``(n, n_s)``.

        Args:
            phases: Phases in periods from the start, ``(n,)``.
        """
        return self.nodes.at(np.mod(phases, 1.0) * self.period)


@dataclass(frozen=True, kw_only=True, eq=False)
class OrbitTable(PeriodTable):
    """One period of an orbit, from release to release, with times since the first release.

    Attributes:
        impacts: The impacts that were resolved.
        zeno_time: Time at which they accumulate [s].
        rebound_speed: Speed with which the first impact is left. It is 0 at a plastic stop.
    """

    impacts: tuple[Impact, ...]
    zeno_time: float
    rebound_speed: float

    @property
    def first_impact(self) -> float:
        """Time of the first impact [s]."""
        return self.impacts[0].time


def jump_width(error: float) -> float:
    """Return the distance from a jump within which samples are ignored, in periods.

    Args:
        error: Standard error of the phases of samples [periods].
    """
    return min(max(_SURE * error, _BESIDE), ROUGHLY)


def beside_jumps(table: PeriodTable, phases: Vector, width: float) -> NDArray[np.bool_]:
    """Return the mask of samples near a jump of their signal, ``(n, n_s)``.

    Such a sample shows on which side of the jump it was taken, and nothing else. It does not count
    in a fit, in a test or in a printed figure.

    Args:
        table: The orbit.
        phases: Phases of the samples since the release, ``(n,)`` [periods].
        width: Distance from the jump, from `jump_width` or `ROUGHLY` [periods].
    """
    return _beside(phases, *_jumps(table), width)


def jump_bins(table: PeriodTable, n: int) -> NDArray[np.bool_]:
    """Return the bins of the phase in which a signal of an orbit jumps, ``(n, n_s)``."""
    places, jumps = _jumps(table)
    found = np.zeros((n, jumps.shape[1]), dtype=np.bool_)
    np.logical_or.at(found, np.minimum((places * n).astype(np.int64), n - 1), jumps)
    return found


def _jumps(table: PeriodTable) -> tuple[Vector, NDArray[np.bool_]]:
    """Return the phases of impacts and the release, and which signals jump there."""
    nodes = table.nodes
    before = np.flatnonzero(np.diff(nodes.times) <= 0.0)
    steps = np.abs(nodes.values[before + 1] - nodes.values[before])
    return nodes.times[before] / table.period, steps > _JUMP * np.ptp(nodes.values, axis=0)


def in_layers(table: PeriodTable, phases: Vector, width: float) -> NDArray[np.bool_]:
    """Return the mask of samples in a boundary layer after an impact, where their signal is steep.

    A current follows a jump of the velocity through a layer of width `L/R`. It is a layer if, at
    the impact, the signal is not yet on the line that it follows a little later.

    Args:
        table: The orbit.
        phases: Phases of the samples since the release, ``(n,)`` [periods].
        width: A distance larger than the width of a layer [periods].
    """
    nodes, span = table.nodes, width * table.period
    after = np.flatnonzero(np.diff(nodes.times) <= 0.0) + 1
    begin = nodes.times[after]
    later, slopes = nodes.with_slopes(np.mod(begin + span, table.period))
    off = np.abs(later - span * slopes - nodes.values[after])
    layers = off > _LAYER * np.ptp(nodes.values, axis=0)
    return _beside(phases, begin / table.period, layers, width)


def _beside(
    phases: Vector, places: Vector, chosen: NDArray[np.bool_], width: float
) -> NDArray[np.bool_]:
    """Return the mask of phases near a chosen point for each signal, ``(n, n_s)``.

    Args:
        phases: Phases, ``(n,)`` [periods].
        places: Points in increasing order, in [0, 1], ``(m,)`` [periods].
        chosen: Mask of the points that count for each signal, ``(m, n_s)``.
        width: Largest distance [periods].
    """
    inside = np.mod(phases, 1.0)
    near = np.zeros((len(phases), chosen.shape[1]), dtype=np.bool_)
    for k in np.flatnonzero(chosen.any(axis=0)):
        own = places[chosen[:, k]]
        # A point near the release is also near the end of the previous cycle.
        around = np.concatenate([own - 1.0, own, own + 1.0])
        after = np.clip(np.searchsorted(around, inside), 1, len(around) - 1)
        near[:, k] = np.minimum(inside - around[after - 1], around[after] - inside) < width
    return near


def tabulate_orbit(orbit: Orbit, problem: Problem, names: Sequence[str]) -> OrbitTable:
    """Return the period of an orbit, simulated from its release.

    Args:
        orbit: The orbit.
        problem: Its problem.
        names: Names of the signals to tabulate.

    Raises:
        InputError: If the period differs from one flight, its impacts and one contact phase.
        SimulationError: If the motion from its release has another event sequence.
    """
    values = orbit.values(problem)
    graph, p = problem.graph_dynamics(values), np.asarray(values.vector, dtype=np.float64)
    found = event_return(
        graph,
        graph.first.on_stop(np.array(problem.state_vector(orbit.release_state))),
        section=orbit.section,
        n_returns=1,
        guess=orbit.period,
        settings=SimulationSettings(),
        sequence=orbit.sequence,
    )
    impacts = tuple(event for event in found.events if isinstance(event, Impact))
    zeno = next(event.time for event in found.events if isinstance(event, ZenoPoint))
    # The unit of time of a rescaled flight is the speed that it starts with.
    rebound = next(arc for arc in found.arcs if arc.start_time == impacts[0].time)
    measured, states = measurement(problem, names), graph_nodes(graph, found.arcs)
    times = tuple(impact.time for impact in impacts)
    return OrbitTable(
        sequences={STOP: (OrbitSequence(impacts=times, zeno=zeno, release=found.period),)},
        impacts=impacts,
        zeno_time=zeno,
        rebound_speed=rebound.time_unit if len(impacts) > 1 else 0.0,
        period=found.period,
        measured=measured,
        nodes=signal_nodes(states, measured, p),
        states=states,
        p=p,
    )


def tabulate_events(orbit: Orbit, problem: Problem, names: Sequence[str]) -> PeriodTable:
    """Return the period of an orbit given as events, simulated from its start.

    Args:
        orbit: The orbit.
        problem: Its problem.
        names: Names of the states and outputs to tabulate.

    Raises:
        SimulationError: If the orbit cannot be simulated.
    """
    values = orbit.values(problem)
    graph = problem.graph_dynamics(values)
    start = np.array(problem.state_vector(orbit.start_state))
    # Rounding may delay the event that ends the period.
    run = simulate(graph, start, until=orbit.period * (1 + _PAST), past=orbit.past_switch)
    arcs = [arc for arc in run.arcs if arc.start_time < orbit.period * (1 - _PAST)]
    states, p = closed_nodes(graph, arcs), np.asarray(values.vector, dtype=np.float64)
    turn, zero = steady_turn(graph.first, start), 0.0
    if turn is not None:
        cosine, sine = start[list(graph.first.clock)]
        zero = -turn * (math.atan2(sine, cosine) / (2 * math.pi))
    measured = measurement(problem, names)
    struck = {stop: own for stop in graph.stop_names if (own := orbit_sequences(orbit, stop))}
    return PeriodTable(
        period=orbit.period,
        measured=measured,
        nodes=signal_nodes(states, measured, p),
        states=states,
        p=p,
        sequences=struck,
        held=frozenset(stop for stop in graph.stop_names if all(stop in a.closed for a in arcs)),
        turn=turn,
        zero=zero,
    )


def closed_nodes(graph: GraphDynamics, arcs: Sequence[Arc]) -> CubicColumns:
    """Return the states along the arcs of a period, and after the event that ends the period.

    Args:
        graph: The graph of modes.
        arcs: The arcs of the period, in order.
    """
    inside = graph_nodes(graph, arcs)
    # Signals may jump at the event that ends the period.
    return CubicColumns(
        times=np.append(inside.times, inside.times[-1]),
        values=np.concatenate([inside.values, inside.values[:1]]),
        slopes=np.concatenate([inside.slopes, inside.slopes[:1]]),
    )


def signal_nodes(states: CubicColumns, measured: Measurement, p: Vector) -> CubicColumns:
    """Return signals over time from the states.

    Args:
        states: The states over time.
        measured: The signals.
        p: Gains, then parameters.
    """
    slopes = measured.derivatives(states.values, p)[:, :, : states.values.shape[1]]
    return CubicColumns(
        times=states.times,
        values=measured.values(states.values, p),
        slopes=np.einsum("nsx,nx->ns", slopes, states.slopes),
    )


def graph_nodes(graph: GraphDynamics, arcs: Sequence[Arc]) -> CubicColumns:
    """Return the states along arcs over a graph of modes, those that take no time left out.

    The states at both ends of an arc are those just inside it, where a formula with a condition
    has the value of the arc.

    Args:
        graph: The graph of modes.
        arcs: The arcs, in order.
    """
    return _joined(
        [
            _arc_nodes(graph.flow(arc.mode_in(graph)), arc, inside=_INSIDE)
            for arc in arcs
            if arc.end_time > arc.start_time
        ]
    )


_Nodes = tuple[Vector, Vector, Vector]
"""Times, states and their slopes."""


def _joined(pieces: Sequence[_Nodes]) -> CubicColumns:
    times, states, slopes = zip(*pieces, strict=True)
    return CubicColumns(
        times=np.concatenate(times), values=np.concatenate(states), slopes=np.concatenate(slopes)
    )


def _arc_nodes(flow: FlowWithEvent, arc: Arc, inside: float = 0.0) -> _Nodes:
    """Return times, states and their slopes along an arc.

    Args:
        flow: The flow of its mode.
        arc: The arc.
        inside: Part of the arc by which the states at its ends are inside it.
    """
    times = _node_times(arc)
    margin = inside * (arc.end_time - arc.start_time)
    states = arc.states_at(np.clip(times, arc.start_time + margin, arc.end_time - margin))
    if arc.ending is Ending.ZENO:
        # The tail of the impacts is not a solution of the flow because it has infinitely many
        # jumps.
        return times, states, np.gradient(states, times, axis=0)
    return times, states, flow.rates(states)


def _node_times(arc: Arc) -> Vector:
    if arc.trajectory is None:
        return np.array([arc.start_time, arc.end_time])
    steps = arc.flow_times * arc.time_unit
    parts = [steps[:-1] + part / _BETWEEN * np.diff(steps) for part in range(_BETWEEN)]
    even = np.linspace(0.0, arc.end_time - arc.start_time, _LEAST + 1)
    times = np.unique(arc.start_time + np.concatenate([*parts, even]))
    return np.append(times[times < arc.end_time], arc.end_time)
