r"""A period of an orbit as a table: signals at any of very many times, at once.

Between the nodes of an arc a signal is the cubic with the values and slopes at both (Hermite); at
an impact there are two nodes with one time. With nodes at most ``d`` apart a cubic errs by
:math:`d^4 \max|y^{(4)}| / 384`; nodes stand where the integrator stepped and several in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.model import CompiledSystem, HybridDynamics, Problem, dense_function
from zeno_orbits.orbits import Cycle, ZenoOrbit
from zeno_orbits.search import cycle_near
from zeno_orbits.simulation import (
    Arc,
    Columns,
    Ending,
    Mode,
    SimulationSettings,
    signal,
    signal_names,
)

GAP = "gap"
"""Name of the signal that every problem has beside its own."""

_BETWEEN = 6
"""CubicColumns between two steps of the integrator."""
_AT_ONCE = 1 << 16
"""States that are evaluated at a time, each beside its own copy of the parameters."""
_JUMP = 1e-6
"""A step of this part of a signal's range is a jump: a table is as exact as that."""
_LAYER = 0.005
"""How far a signal goes in a layer, in parts of its range, at least."""
ROUGHLY = 0.01
"""Part of a period beside a jump that does not count while phases are known roughly; at most."""
_BESIDE = 1e-4
"""The same at least, however well phases are known."""
_SURE = 4.0
"""Standard errors of a phase within which it may be off."""
_LEAST = 24
"""Intervals of an arc at least."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measurement:
    """Signals that instruments see of a state.

    Attributes:
        names: Of the signals.
        units: Their units; the gap has none of its own.
        function: ``(x, p) -> signals``, ``(n_s,)``.
        slopes: ``(x, p) -> derivative of the signals by the state, then by p``, by columns.
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
        """Return the derivatives by the state, then by `p`, ``(n, n_s, n_x + n_p)``."""
        flat = self.slopes(states, _rows(p, states))[0]
        return flat.reshape(len(states), -1, len(self.names)).transpose(0, 2, 1)


def _rows(p: Vector, states: Vector) -> Vector:
    return np.broadcast_to(p, (len(states), len(p)))


def measurement(problem: Problem, names: Sequence[str]) -> Measurement:
    """Return the signals of a problem with the given names, each one of `measurable`."""
    compiled = problem.compiled()
    x = ca.SX.sym("x", compiled.n_x)
    p = ca.SX.sym("p", compiled.contact.numel_in(1))
    known = measurable(problem)
    outputs = ca.vertcat(*(_formula(problem, compiled, name, x, p) for name in names))
    slopes = ca.jacobian(outputs, ca.vertcat(x, p))
    return Measurement(
        names=tuple(names),
        units=tuple(known.get(name, "") for name in names),
        function=Columns(dense_function("signals", [x, p], [outputs])),
        slopes=Columns(dense_function("signal_slopes", [x, p], [slopes])),
    )


def measurable(problem: Problem) -> dict[str, str]:
    """Return name to unit of what may be measured of a problem: states, motors, outputs."""
    compiled = problem.compiled()
    units = dict(zip(problem.state_names, problem.state_units, strict=True))
    for name in signal_names(compiled):
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


def _formula(problem: Problem, compiled: CompiledSystem, name: str, x: ca.SX, p: ca.SX) -> ca.SX:
    if name in signal_names(compiled):
        return signal(compiled, name).function(x, p)
    if name == GAP:
        return compiled.contact_at(x, p).gap
    outputs = [output.name for output in problem.outputs]
    if name not in outputs:
        raise ValueError(f"Argument `name` must be a signal of the problem, but it is `{name}`.")
    symbols = problem.symbols()
    system = problem.model(symbols)
    formula = problem.output_formulas(system, symbols)[outputs.index(name)]
    return ca.substitute([formula], [system.state, ca.vertcat(*symbols.values())], [x, p])[0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CubicColumns:
    """Columns over time, cubic between the nodes.

    Attributes:
        times: Not decreasing; twice the same where the columns jump, ``(n,)`` [s].
        values: ``(n, m)``.
        slopes: Their time derivatives, ``(n, m)``.
    """

    times: Vector
    values: Vector
    slopes: Vector

    def at(self, times: Vector) -> Vector:
        """Return the columns at times, the later one where they jump, ``(n, m)``."""
        return self.with_slopes(times)[0]

    def with_slopes(self, times: Vector) -> tuple[Vector, Vector]:
        """Return the columns and their time derivatives at times, each ``(n, m)``."""
        last = len(self.times) - 2
        k = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, last)
        size = self.times[k + 1] - self.times[k]
        size = np.where(size > 0.0, size, 1.0)
        s = ((times - self.times[k]) / size)[:, None]
        y0, y1 = self.values[k], self.values[k + 1]
        d = size[:, None]
        f0, f1 = self.slopes[k] * d, self.slopes[k + 1] * d
        rise = y1 - y0
        # y0 + s f0 + s^2 (3 rise - 2 f0 - f1) + s^3 (f0 + f1 - 2 rise)
        second, third = 3 * rise - 2 * f0 - f1, f0 + f1 - 2 * rise
        value = y0 + s * (f0 + s * (second + s * third))
        slope = (f0 + s * (2 * second + 3 * s * third)) / d
        return value, slope


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrbitTable:
    """A period of an orbit, from release to release; times count from the first.

    Attributes:
        cycle: The period.
        measured: The signals.
        nodes: Their values.
        states: The states.
        p: Gains, then parameters.
    """

    cycle: Cycle
    measured: Measurement
    nodes: CubicColumns
    states: CubicColumns
    p: Vector

    @property
    def period(self) -> float:
        """[s]."""
        return self.cycle.period

    @property
    def first_impact(self) -> float:
        """Time of the first impact [s]."""
        return self.cycle.impacts[0].time - self.cycle.start.time

    @property
    def zeno_time(self) -> float:
        """[s]."""
        return self.cycle.zeno.time - self.cycle.start.time

    def at(self, phases: Vector) -> Vector:
        """Return the signals at phases, ``(n, n_s)``.

        Args:
            phases: In periods from the release, any number of them, ``(n,)``.
        """
        return self.nodes.at(np.mod(phases, 1.0) * self.period)


def jump_width(error: float) -> float:
    """Return how near to a jump a sample may lie on either side of it, in periods.

    Args:
        error: Standard error of the phases of samples [periods].
    """
    return min(max(_SURE * error, _BESIDE), ROUGHLY)


def beside_jumps(table: OrbitTable, phases: Vector, width: float) -> NDArray[np.bool_]:
    """Return which samples lie beside a jump of their signal, ``(n, n_s)``.

    Such a sample shows on which side of the jump it was taken, and nothing else. It does not count
    in a fit, in a test or in a printed figure.

    Args:
        table: The orbit.
        phases: Of the samples since the release, ``(n,)`` [periods].
        width: How near to the jump, by `jump_width`, or `ROUGHLY` [periods].
    """
    nodes = table.nodes
    before = np.flatnonzero(np.diff(nodes.times) <= 0.0)
    steps = np.abs(nodes.values[before + 1] - nodes.values[before])
    jumps = steps > _JUMP * np.ptp(nodes.values, axis=0)
    return _beside(phases, nodes.times[before] / table.period, jumps, width)


def in_layers(table: OrbitTable, phases: Vector, width: float) -> NDArray[np.bool_]:
    """Return which samples lie in a layer behind an impact, where their signal is steep.

    A current follows a jump of the velocity through a layer of width `L/R`. It is a layer if, at
    the impact, the signal is not yet on the line that it follows a little later.

    Args:
        table: The orbit.
        phases: Of the samples since the release, ``(n,)`` [periods].
        width: More than that of a layer [periods].
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
    """Return which phases are near a chosen place, signal by signal, ``(n, n_s)``.

    Args:
        phases: ``(n,)`` [periods].
        places: Increasing, in [0, 1], ``(m,)`` [periods].
        chosen: Which places count for which signal, ``(m, n_s)``.
        width: How near [periods].
    """
    inside = np.mod(phases, 1.0)
    near = np.zeros((len(phases), chosen.shape[1]), dtype=np.bool_)
    for k in np.flatnonzero(chosen.any(axis=0)):
        own = places[chosen[:, k]]
        # A place near the release is near the end of the cycle before it, too.
        around = np.concatenate([own - 1.0, own, own + 1.0])
        after = np.clip(np.searchsorted(around, inside), 1, len(around) - 1)
        near[:, k] = np.minimum(inside - around[after - 1], around[after] - inside) < width
    return near


def tabulate_orbit(orbit: ZenoOrbit, problem: Problem, names: Sequence[str]) -> OrbitTable:
    """Return the period of an orbit, simulated from its release.

    Args:
        orbit: The orbit.
        problem: Its problem.
        names: Of the signals to tabulate.

    Raises:
        SimulationError: If its release does not return.
    """
    p = np.asarray(orbit.values(problem).vector, dtype=np.float64)
    dynamics = problem.dynamics(p)
    release = dynamics.on_stop(np.array(problem.state_vector(orbit.release_state)))
    settings = SimulationSettings()
    cycle = cycle_near(dynamics, release, period=orbit.period, settings=settings)
    return tabulated(dynamics, cycle, measurement(problem, names), p)


def tabulated(
    dynamics: HybridDynamics, cycle: Cycle, measured: Measurement, p: Vector
) -> OrbitTable:
    """Return the signals of a period.

    Args:
        dynamics: The system.
        cycle: The period.
        measured: The signals.
        p: Gains, then parameters.
    """
    whole = state_nodes(dynamics, cycle.execution.arcs)
    whole = replace(whole, times=whole.times - cycle.start.time)
    slopes = measured.derivatives(whole.values, p)[:, :, : whole.values.shape[1]]
    signals = CubicColumns(
        times=whole.times,
        values=measured.values(whole.values, p),
        slopes=np.einsum("nsx,nx->ns", slopes, whole.slopes),
    )
    return OrbitTable(cycle=cycle, measured=measured, nodes=signals, states=whole, p=p)


def state_nodes(dynamics: HybridDynamics, arcs: Sequence[Arc]) -> CubicColumns:
    """Return the states along arcs in order, those that take no time left out."""
    pieces = [_arc_nodes(dynamics, arc) for arc in arcs if arc.end_time > arc.start_time]
    times, states, slopes = zip(*pieces, strict=True)
    return CubicColumns(
        times=np.concatenate(times), values=np.concatenate(states), slopes=np.concatenate(slopes)
    )


def _arc_nodes(dynamics: HybridDynamics, arc: Arc) -> tuple[Vector, Vector, Vector]:
    """Return times, states and their slopes along an arc."""
    times = _node_times(arc)
    states = np.array([arc.state_at(time) for time in times])
    if arc.ending is Ending.ZENO:
        # The tail of the impacts is no solution of the flow: it jumps without end.
        return times, states, np.gradient(states, times, axis=0)
    flow = dynamics.locked if arc.mode is Mode.LOCKED else dynamics.free
    return times, states, np.array([flow.rate(x).copy() for x in states])


def _node_times(arc: Arc) -> Vector:
    if arc.trajectory is None:
        return np.array([arc.start_time, arc.end_time])
    steps = arc.flow_times * arc.time_unit
    parts = [steps[:-1] + part / _BETWEEN * np.diff(steps) for part in range(_BETWEEN)]
    even = np.linspace(0.0, arc.end_time - arc.start_time, _LEAST + 1)
    times = np.unique(arc.start_time + np.concatenate([*parts, even]))
    return np.append(times[times < arc.end_time], arc.end_time)
