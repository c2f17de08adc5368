"""A graph of modes at fixed parameter values: a system with one stop for every mode and open stop.

The functions of a mode are built when a motion enters it. They are shared by all parameter values.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import combinations, pairwise

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import FlowWithEvent
from zeno_orbits.model.contact import MULTIPLIER_RATE
from zeno_orbits.model.declared.starts import Starts
from zeno_orbits.model.domains import undefined_ahead
from zeno_orbits.model.drives.waveforms import LEAST_PART
from zeno_orbits.model.friction import FORCED, PER_PART
from zeno_orbits.model.graph import guard_and_flow, system_of_stop
from zeno_orbits.model.kink_friction import instead_of_kink
from zeno_orbits.model.modes import GraphMode, ModeGraph
from zeno_orbits.model.numeric.binding import bind
from zeno_orbits.model.numeric.calls import Call
from zeno_orbits.model.numeric.casadi_calls import caller
from zeno_orbits.model.numeric.columns import Columns
from zeno_orbits.model.numeric.compiled import CompiledSystem, compile_system
from zeno_orbits.model.numeric.compiled_flow import (
    CompiledFlow,
    FlowMemory,
    ModeFunctions,
    dense_function,
    mode_functions,
)
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.numeric.known_scales import KnownScales
from zeno_orbits.model.numeric.own_scale import own_scale
from zeno_orbits.model.scale import CharacteristicScales
from zeno_orbits.model.stops import continuous_arming

_ZERO = 1e-12
"""Part of a switch's size below which its guard counts as zero."""
_EQUAL = 1e-9
"""Relative difference below which two stops are one."""
_NEARER = (1e-6, 1e-8, 1e-10)
"""Distances from a state, in its sizes, at which derivatives with a limit come nearer to it."""
_AHEAD, _ROUNDING, _ROUNDINGS = 1e-9, 1e-8, 100.0
"""Part of its own time, and roundings of time, within which a flow that cannot be continued ends.

The second one is the shortest part of this at which its formulas are evaluated.
"""


_Stop = tuple[GraphMode, int]
_Side = tuple[GraphMode, int, bool]
"""An open stop, or a switch, of a mode, and a side of a switch in a mode."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CompiledGraph:
    """The functions of a graph of modes in ``(x, p)``.

    Attributes:
        graph: The graph in symbols.
        symbols: Named parameters, in the order of ``p``.
        state_names: Name of each state.
        starts: From ``p`` to the initial states of the problem.
        state_units: Units of the states.
    """

    graph: ModeGraph
    symbols: Mapping[str, ca.SX]
    state_names: tuple[str, ...]
    starts: Starts
    state_units: tuple[str, ...]
    _systems: dict[_Stop, CompiledSystem] = field(
        default_factory=dict["_Stop", CompiledSystem], repr=False
    )
    _guards: dict[_Side, ModeFunctions] = field(
        default_factory=dict["_Side", ModeFunctions], repr=False
    )
    _gradients: dict[_Stop, ca.Function] = field(
        default_factory=dict["_Stop", ca.Function], repr=False
    )
    _powers: dict[GraphMode, Columns] = field(
        default_factory=dict["GraphMode", Columns], repr=False
    )

    @cached_property
    def n_q(self) -> int:
        """Number of coordinates."""
        return self.graph.mechanism.q.numel()

    @cached_property
    def known_scales(self) -> KnownScales:
        """Scales that were computed with these functions."""
        return KnownScales()

    def system(self, mode: GraphMode, stop: int) -> CompiledSystem:
        """Return the functions of a stop that is open in a mode."""
        key = (mode, stop)
        if key not in self._systems:
            one = system_of_stop(self.graph, mode, stop)
            made = compile_system(one, self.symbols, self.state_names)
            self._systems[key] = replace(made, starts=self.starts, state_units=self.state_units)
        return self._systems[key]

    def powers(self, mode: GraphMode, rest: GraphMode, stop: int) -> Columns:
        """Return ``(x, p) -> (input power, copper loss, other losses)`` [W] of a mode, for states.

        Contact adds to the energy of the further states that it changes: a negative loss.

        Args:
            mode: The mode.
            rest: The mode in which a stop is open.
            stop: Index of the stop. Its constrained flow is the flow of the mode if modes differ.
        """
        if mode not in self._powers:
            graph, one = self.graph, system_of_stop(self.graph, rest, stop)
            flow = one.free_flow if rest == mode else one.locked_flow
            opened = system_of_stop(graph, ((), mode[1]), 0).free_flow
            further = slice(2 * one.n_q, None)
            added = (flow - opened)[further]
            stored = ca.SX(0)
            if added.numel():
                stored = ca.jtimes(one.energy, graph.state[further], added)
            given = one.input_power + one.belt_power[0 if rest == mode else 1]
            powers = ca.vertcat(given, one.copper_loss, one.other_loss - stored)
            inputs = [graph.state, self.parameters]
            self._powers[mode] = Columns(dense_function("powers", inputs, [powers]))
        return self._powers[mode]

    def guard(self, mode: GraphMode, switch: int, above: bool) -> ModeFunctions:
        """Return the flow of a mode with a switch's guard, or its negative, as the guard.

        Args:
            mode: The mode.
            switch: Index of the switch.
            above: True for the guard, False for its negative.
        """
        key = (mode, switch, above)
        if key not in self._guards:
            value, flow = guard_and_flow(self.graph, mode, switch)
            state = self.graph.state
            value = value if above else -value
            rate = ca.jtimes(value, state, flow)
            watched = ca.vertcat(value, rate, ca.jtimes(rate, state, flow))
            self._guards[key] = mode_functions(
                f"switch{switch}", state, self.parameters, flow, watched[:2], watched=watched
            )
        return self._guards[key]

    @cached_property
    def switches(self) -> ca.Function:
        """Guards at a state, on given sides of the kinks.

        ``(x, p, sizes, sides) -> (guards of all switches, sizes of the guards, formulas `armed`)``.
        With dry friction the flags of the closed stops follow the sides, and further outputs are
        positive where a declared switch occurs at the start of an arc without a zero.
        """
        graph = self.graph
        size = ca.SX.sym("size", graph.state.numel())
        sides = ca.SX.sym("side", len(graph.conditions))
        contact = ca.SX.sym("contact", len(graph.stops) if graph.n_frictions else 0)
        conditions, slopes = graph.on_sides(sides)
        switches, due = graph.declared(contact, size)
        declared = ca.vertcat(*(ca.SX(one.guard) for one in switches))
        armed = ca.vertcat(*(ca.SX(one.armed) for one in switches))
        guards = ca.vertcat(declared, *conditions)
        every = ca.vertcat(ca.jacobian(declared, graph.state), *slopes)
        if graph.n_frictions:
            sides = ca.vertcat(sides, contact)
        inputs = [graph.state, self.parameters, size, sides]
        outputs = [guards, ca.mtimes(ca.fabs(every), size), armed]
        outputs += [due] if graph.n_frictions else []
        return dense_function("switches", inputs, outputs)

    def gradient(self, mode: GraphMode, switch: int) -> ca.Function:
        """Return ``(x, p) -> (guard, its derivatives with respect to x and p)``.

        Args:
            mode: The mode.
            switch: Index of a declared switch, or of a kink after these.
        """
        closed, sides = mode
        key = (mode if switch in self.graph.frictional else ((), sides), switch)
        if key not in self._gradients:
            guard = self.graph.guard(sides, switch, closed)
            self._gradients[key] = self._derivative("guard", guard, self.parameters)
        return self._gradients[key]

    @cached_property
    def reset_derivatives(self) -> tuple[ca.Function, ...]:
        """``(x, p) -> (x after it, its derivatives with respect to x and p)``, one per switch."""
        return tuple(self._derivative("reset", one, self.parameters) for one in self.graph.resets)

    def _derivative(self, name: str, formula: ca.SX, p: ca.SX) -> ca.Function:
        x = self.graph.state
        outputs = [formula, ca.jacobian(formula, x), ca.jacobian(formula, p)]
        return dense_function(name, [x, p], outputs)

    @cached_property
    def times(self) -> ca.Function:
        """``p -> (lower times, upper times, least upper times)`` of all orders of waveforms."""
        orders = self.graph.time_orders
        lower = ca.vertcat(*(one.lower for one in orders))
        upper = ca.vertcat(*(one.upper for one in orders))
        # The largest time is the period of the clock.
        apart = LEAST_PART * ca.mmax(upper)
        least = ca.vertcat(*(one.lower + apart for one in orders))
        return dense_function("times", [self.parameters], [lower, upper, least])

    @cached_property
    def sides_of_friction(self) -> tuple[int, ...]:
        """Indices of the states that are sides of parts with dry friction."""
        state, sides = ca.vertsplit(self.graph.state), self.graph.drive.sides
        return tuple(k for k, one in enumerate(state) if ca.depends_on(sides, one))

    @cached_property
    def frictions(self) -> ca.Function:
        """``p -> (friction that slips, static one less that)``, 0 where a state changes them."""
        graph, drive = self.graph, self.graph.drive
        both = [
            [ca.SX(0) if ca.depends_on(one, graph.state) else one for one in ca.vertsplit(formulas)]
            for formulas in (drive.torques, drive.static - drive.torques)
        ]
        found = [ca.vertcat(ca.SX(0, 1), *formulas) for formulas in both]
        return dense_function("frictions", [self.parameters], found)

    @cached_property
    def switches_along(self) -> Columns:
        """The functions of `switches`, for many states."""
        return Columns(self.switches)

    @cached_property
    def arming(self) -> ca.Function:
        """``(x, p) -> (armed, continuous formulas of their signs)`` of the declared switches."""
        armed = [ca.SX(one.armed) for one in self.graph.switches]
        outputs = [ca.vertcat(*armed), ca.vertcat(*map(continuous_arming, armed))]
        return dense_function("arming", [self.graph.state, self.parameters], outputs)

    @cached_property
    def roots(self) -> ca.Function:
        """``(x, p, sizes) -> (bases, their sizes, exponents)`` of the roots that events keep."""
        x, size = self.graph.state, ca.SX.sym("size", self.graph.state.numel())
        bases = ca.vertcat(*(base for base, _ in self.graph.roots))
        exponents = ca.vertcat(*(exponent for _, exponent in self.graph.roots))
        sizes = ca.mtimes(ca.fabs(ca.jacobian(bases, x)), size)
        return dense_function("roots", [x, self.parameters, size], [bases, sizes, exponents])

    @cached_property
    def delassus(self) -> ca.Function:
        """``(x, p) -> J W J^T`` of all stops."""
        return dense_function(
            "delassus", [self.graph.state, self.parameters], [self.graph.delassus]
        )

    @cached_property
    def coupling(self) -> ca.Function:
        """``(x, p) -> J W J^T`` of all stops, without the inertia of a corrected drive."""
        graph = self.graph
        if not graph.has_current_layers:
            return self.delassus
        return dense_function("coupling", [graph.state, self.parameters], [graph.coupling])

    @cached_property
    def delassus_derivative(self) -> ca.Function:
        """``(x, p) -> (J W J^T, its derivatives with respect to x and p)``, by its columns."""
        return self._derivative("delassus", ca.vec(self.graph.delassus), self.parameters)

    @cached_property
    def resets(self) -> tuple[ca.Function, ...]:
        """``(x, p) -> x`` after every declared switch."""
        inputs = [self.graph.state, self.parameters]
        return tuple(dense_function("reset", inputs, [one]) for one in self.graph.resets)

    @property
    def parameters(self) -> ca.SX:
        """Symbols of gains and parameters, ``(n_p,)``."""
        return ca.vertcat(*self.symbols.values())


class _SwitchesCall:
    """The formulas of all switches at fixed ``p``, called through preallocated memory."""

    def __init__(self, function: ca.Function, p: Vector) -> None:
        self._x, self._size = np.zeros(function.size1_in(0)), np.zeros(function.size1_in(0))
        self._sides = np.zeros(function.size1_in(3))
        self._found = [np.zeros(function.numel_out(k)) for k in range(function.n_out())]
        self._evaluate = caller(function, (self._x, p, self._size, self._sides), self._found)

    def __call__(
        self, x: Vector, size: Vector, sides: Sequence[bool], closed: Sequence[int] = ()
    ) -> tuple[Vector, Vector, Vector]:
        """Return guards, their rounding levels and the formulas `armed`, from sizes of states."""
        self._x[:], self._size[:] = x, size
        self._sides[:] = with_contact(sides, closed, self._sides.size)
        self._evaluate()
        guards, sizes, armed = self._found[:3]
        return guards.copy(), _ZERO * sizes, armed.copy()

    @property
    def due(self) -> Vector:
        """The formulas that are positive where a switch occurs without a zero, as last found."""
        return self._found[3].copy()


def with_contact(sides: Sequence[bool], closed: Sequence[int], size: int) -> Vector:
    """Return the sides of kinks, and the flags of closed stops if formulas take them, ``(size,)``.

    Args:
        sides: The side of every kink.
        closed: Indices of the closed stops.
        size: Number of entries.
    """
    found = np.zeros(size)
    found[: len(sides)] = sides
    if size > len(sides):
        found[[len(sides) + k for k in closed]] = 1.0
    return found


class GraphDynamics:
    """A graph of modes as numeric functions of the state ``x``, ``(n_x,)``."""

    def __init__(self, compiled: CompiledGraph, values: Sequence[float] | Vector) -> None:
        """Bind the functions to parameter values.

        Args:
            compiled: The functions.
            values: Parameter vector, gains then parameters.

        Raises:
            SwitchingTimesError: If the switching times of a piecewise input do not increase.
        """
        self.compiled = compiled
        self.p = np.array(values, dtype=np.float64)
        if compiled.graph.time_orders:
            lower, upper, least = (one.full().ravel() for one in compiled.times(self.p))
            for k, order in enumerate(compiled.graph.time_orders):
                order.require(float(lower[k]), float(upper[k]), float(least[k]))
        if compiled.graph.n_frictions:
            self._require_frictions()
        self.state_names = compiled.state_names
        graph = compiled.graph
        self.stop_names = tuple(stop.name for stop in graph.stops)
        self.switch_names = graph.switch_names
        self.n_declared = len(graph.switches)
        self.causes = graph.causes
        self.held: tuple[int, ...] = tuple(graph.held)
        self.sides_of_friction = compiled.sides_of_friction
        self.frictional = graph.frictional
        self._views: dict[tuple[GraphMode, int], HybridDynamics] = {}
        self._flows: dict[tuple[GraphMode, int, bool], CompiledFlow] = {}
        self._scales: dict[int, CharacteristicScales] = {}
        self._delassus = Call(compiled.delassus, self.p)
        self._coupling = Call(compiled.coupling, self.p)
        self._resets = [Call(one, self.p) for one in compiled.resets]
        self.open_mode: GraphMode = ((), (True,) * len(graph.conditions))

    def _require_frictions(self) -> None:
        """Refuse a friction that pushes, and a static one below that of slipping.

        Raises:
            InputError: If there is one. The message names the part.
        """
        torques, left = (one.full().ravel() for one in self.compiled.frictions(self.p))
        for name, torque, reserve in zip(
            self.compiled.graph.drive.frictions, torques, left, strict=True
        ):
            if torque < 0.0:
                raise InputError(
                    f"Argument `torque` of the friction `{name}` must be at least 0, but at these "
                    f"values it is {torque:g}: the part would push. Check its sign."
                )
            if reserve < 0.0:
                wanted = "must be at least its friction while it slips"
                raise InputError(
                    f"Argument `static` of the friction `{name}` {wanted}, but at these values it "
                    f"is {-reserve:g} less."
                )

    def at(self, values: Sequence[float] | Vector) -> GraphDynamics:
        """Return the graph at other parameter values nearby, with the scales of this graph.

        Scales take a third of the time of a periodic return.

        Args:
            values: Parameter vector, gains then parameters.

        Raises:
            SwitchingTimesError: If the switching times of a piecewise input do not increase.
        """
        other = GraphDynamics(self.compiled, values)
        other._scales.update((k, self._scale(k)) for k in range(self.n_watched))
        return other

    @property
    def n_q(self) -> int:
        """Number of coordinates."""
        return self.compiled.n_q

    @property
    def exchanges_coordinates(self) -> bool:
        """True if a switch mixes coordinates, as legs that change names at a step do."""
        graph, q = self.compiled.graph, slice(0, self.n_q)
        coordinates = graph.state[q]
        return any(
            row != column
            for one in graph.resets
            for row, column in zip(
                *ca.jacobian(one[q], coordinates).sparsity().get_triplet(), strict=True
            )
        )

    @property
    def has_one_guard(self) -> bool:
        """True if a motion has one guard at a time: no switch or kink, and at most one stop."""
        return self.n_watched + len(self.switch_names) == 1

    @property
    def has_current_layers(self) -> bool:
        """True if a corrected drive adds the current layer to every impact."""
        return self.compiled.graph.has_current_layers

    @property
    def n_watched(self) -> int:
        """Number of stops of its views: of a machine without stops it is 1."""
        return max(1, len(self.stop_names))

    @property
    def first(self) -> HybridDynamics:
        """The system of the first stop, or of the absent one, with the other stops open."""
        return self.view(self.open_mode, 0)

    @property
    def own(self) -> CharacteristicScales:
        """Characteristic scales, with the gap of the first stop."""
        return self.first.own

    def view(self, mode: GraphMode, stop: int) -> HybridDynamics:
        """Return the system of a stop that is open in a mode, as a system with one stop.

        Args:
            mode: The mode.
            stop: Index of the stop.
        """
        key = (mode, stop)
        if key not in self._views:
            system = self.compiled.system(mode, stop)
            self._views[key] = bind(system, self.p, partial(self._scale, stop))
        return self._views[key]

    @property
    def open_views(self) -> tuple[HybridDynamics, ...]:
        """The system of each stop, or of the absent one, with the other stops open."""
        return tuple(self.view(self.open_mode, k) for k in range(self.n_watched))

    def some_stop(self, mode: GraphMode) -> tuple[GraphMode, int]:
        """Return the mode of a view with the formulas of a mode, and the stop of the view.

        An open stop leaves the mode as it is. If all stops are closed, it is the first one, which
        is open in the mode that is returned. The constrained flow of its view is the mode's flow.

        Args:
            mode: The mode.
        """
        closed, sides = mode
        opened = [k for k in range(self.n_watched) if k not in closed]
        return (mode, opened[0]) if opened else ((closed[1:], sides), closed[0])

    def flow(self, mode: GraphMode) -> FlowWithEvent:
        """Return the flow of a mode, with its closed stops as constraints.

        Args:
            mode: The mode.
        """
        rest, stop = self.some_stop(mode)
        view = self.view(rest, stop)
        return view.free if rest == mode else view.locked

    def holding(self, mode: GraphMode, stop: int) -> HybridDynamics:
        """Return the system of a closed stop, whose constrained flow is the flow of the mode.

        Args:
            mode: The mode.
            stop: Index of the closed stop.
        """
        closed, sides = mode
        return self.view((tuple(k for k in closed if k != stop), sides), stop)

    @cached_property
    def _switches(self) -> _SwitchesCall:
        return _SwitchesCall(self.compiled.switches, self.p)

    def _scale(self, stop: int) -> CharacteristicScales:
        """Return the scales of a stop, those of other values if this graph has them."""
        if stop not in self._scales:
            known = self.compiled.known_scales
            self._scales[stop] = known.at(self.p, stop, partial(self._own_scale, stop))
        return self._scales[stop]

    def _own_scale(self, stop: int) -> CharacteristicScales:
        """Return the scales of a stop, from the branches of the kinks at the initial states."""
        view, compiled = self.view(self.open_mode, stop), self.compiled
        system = compiled.system(self.open_mode, stop)
        return own_scale(
            view,
            compiled.starts(self.p),
            compiled.state_units,
            system.clock,
            system.further,
            partial(self._on_branch, stop) if compiled.graph.conditions else None,
            self.open_views,
            self._after_resets,
        )

    def _after_resets(self, x: Vector) -> list[tuple[Vector, Vector]]:
        """Return the state after each declared reset, and its derivative by the state."""
        found = [one(x, self.p) for one in self.compiled.reset_derivatives]
        return [(after.full().ravel(), by_x.full()) for after, by_x, _ in found]

    def _on_branch(self, stop: int, x: Vector) -> HybridDynamics:
        """Return the system of a stop on the branch of the kinks at a state, all stops open."""
        # The rounding levels need the scales, which are determined here.
        sides = self._sides_at(x, np.zeros(x.size), self.open_mode[1], ())
        return self.view(((), sides), stop)

    def as_graph(self, stop: str = "") -> GraphDynamics:
        """Return the graph itself, whose stops have names."""
        del stop
        return self

    def guard_flow(self, mode: GraphMode, switch: int, above: bool) -> CompiledFlow:
        """Return the flow of a mode, with the guard of a switch on one side of it."""
        key = (mode, switch, above)
        if key not in self._flows:
            functions = self.compiled.guard(mode, switch, above)
            memory = FlowMemory(functions, lambda: self.own.weights(len(self.state_names)))
            self._flows[key] = CompiledFlow(functions, self.p, memory)
        return self._flows[key]

    def guards(self, mode: GraphMode, x: Vector) -> tuple[Vector, Vector, Vector]:
        """Return the guards of all switches, their rounding levels, and the formulas `armed`.

        Args:
            mode: The mode. The side of a kink determines the branch of later conditions. The
                switches of dry friction depend on the closed stops.
            x: The state, ``(n_x,)``.
        """
        if not self.switch_names:
            return np.zeros(0), np.zeros(0), np.zeros(0)
        closed, sides = mode
        return self._switches(x, self.own.states(x.size) + np.abs(x), sides, closed)

    def due(self, mode: GraphMode, x: Vector, *, forced: bool = False) -> int | None:
        """Return a declared switch that occurs at the start of an arc without a zero, or ``None``.

        Args:
            mode: The mode.
            x: The state, ``(n_x,)``.
            forced: Whether only switches count that occur before the stops open or close.
        """
        if not self.sides_of_friction:
            return None
        self.guards(mode, x)
        due = self._switches.due
        first = int(np.argmax(due))
        return first if due[first] >= (FORCED if forced else 1) else None

    def sticking(self, switches: Iterable[int]) -> list[int]:
        """Return those of some switches of dry friction at which a part sticks."""
        first = self.frictional.start
        return [s for s in sorted(switches) if (s - first) % PER_PART == 0]

    def guards_along(self, mode: GraphMode, states: Vector) -> tuple[Vector, Vector, Vector]:
        """Return the same as `guards` at many states, ``(n, n_switches)`` each.

        Args:
            mode: The mode.
            states: The states, ``(n, n_x)``.
        """
        closed, sides = mode
        size = self.compiled.switches.numel_in(3)
        n, given = len(states), [self.p, with_contact(sides, closed, size)]
        p, side = (np.broadcast_to(one, (n, one.size)) for one in given)
        sizes = self.own.states(states.shape[1]) + np.abs(states)
        guards, sizes, armed = self.compiled.switches_along(states, p, sizes, side)[:3]
        return guards, _ZERO * sizes, armed

    def powers(self, mode: GraphMode, states: Vector) -> Vector:
        """Return input power, copper loss and other losses at states of a mode, ``(n, 3)`` [W].

        Args:
            mode: The mode.
            states: The states, ``(n, n_x)``.
        """
        p = np.broadcast_to(self.p, (len(states), self.p.size))
        return self.compiled.powers(mode, *self.some_stop(mode))(states, p)[0]

    def slopes(self, x: Vector, sides: tuple[bool, ...]) -> Vector:
        """Return sizes of the derivatives of all guards with respect to the states.

        Those with respect to the clock are zero: it has one direction, which the rates contain.

        Args:
            x: The state, ``(n_x,)``.
            sides: The side of every kink.

        Returns:
            The changes of the guards over the size of each state, ``(n_switches, n_x)``.
        """
        every = self.own.states(x.size) + np.abs(x)
        every[list(self.compiled.system(self.open_mode, 0).clock)] = 0.0
        sizes = np.diag(every)
        return np.transpose([self._switches(x, size, sides)[1] for size in sizes]) / _ZERO

    def sides_at(
        self, x: Vector, before: tuple[bool, ...], crossed: Sequence[int] = ()
    ) -> tuple[bool, ...]:
        """Return the side of every kink at a state, on the sides of the kinks before it.

        Args:
            x: The state, ``(n_x,)``.
            before: The sides that kinks with a zero condition keep.
            crossed: The kinks that have just been crossed, and keep their side as well.
        """
        return self._sides_at(x, self.own.states(x.size) + np.abs(x), before, crossed)

    def _sides_at(
        self, x: Vector, size: Vector, before: tuple[bool, ...], crossed: Sequence[int]
    ) -> tuple[bool, ...]:
        sides, n, taken = list(before), self.n_declared, {*crossed}
        while len(taken) < len(sides):
            guards, rounding, _ = self._switches(x, size, sides)
            clear = np.abs(guards[n:]) > rounding[n:]
            moved = clear & ((guards[n:] > 0.0) != sides)
            changed = [k for k in np.flatnonzero(moved) if k not in taken]
            if not changed:
                break
            # Later conditions may depend on this one, and so may the use of earlier ones.
            sides[changed[0]] = not sides[changed[0]]
            taken.add(int(changed[0]))
        return tuple(sides)

    def guard_gradient(
        self, switch: int, x: Vector, chosen: Sequence[int], mode: GraphMode
    ) -> Vector:
        """Return the derivative of a guard with respect to state and parameters, ``(n_x + k,)``.

        Args:
            switch: Index of the switch.
            x: The state, ``(n_x,)``.
            chosen: Indices of the parameters, ``(k,)``.
            mode: The mode.
        """
        _, by_x, by_p = self.compiled.gradient(mode, switch)(x, self.p)
        return np.append(by_x.full().ravel(), by_p.full().ravel()[list(chosen)])

    def reset_derivative(self, switch: int, x: Vector, chosen: Sequence[int]) -> Vector:
        """Return the derivative of a declared reset, ``(n_x, n_x + k)``."""
        _, by_x, by_p = self.compiled.reset_derivatives[switch](x, self.p)
        return np.concatenate([by_x.full(), by_p.full()[:, list(chosen)]], axis=1)

    def mode_of(self, closed: Sequence[str], sides: tuple[bool, ...]) -> GraphMode:
        """Return a mode from the names of its closed stops and the sides of the kinks."""
        return tuple(sorted(self.stop_names.index(name) for name in closed)), sides

    def setter_at(self, event: str) -> int | None:
        """Return the index of the switch that sets states at an event of a stop, or ``None``.

        Args:
            event: Name of the event, such as ``release stop``.
        """
        return self.causes.index(event) if event in self.causes else None

    def instead_of_sliding(self, switch: int) -> str:
        """Return what to write in place of a kink along which a motion slides.

        It is no text for a declared switch.
        """
        kink = switch - self.n_declared
        return instead_of_kink(self.compiled.graph, kink) if kink >= 0 else ""

    def after_switch(self, switch: int, x: Vector) -> Vector:
        """Return the state after a declared switch, ``(n_x,)``."""
        return self._resets[switch](x).copy()

    def delassus(self, x: Vector) -> Vector:
        r"""Return :math:`J W J^\top` of all stops, ``(n_stops, n_stops)``."""
        n = self.n_watched
        return self._delassus(x).copy().reshape(n, n)

    def coupling(self, x: Vector) -> Vector:
        """Return the same without the inertia of a corrected drive, by which stops open."""
        n = self.n_watched
        return self._coupling(x).copy().reshape(n, n)

    def delassus_derivative(self, x: Vector, chosen: Sequence[int]) -> Vector:
        r"""Return the derivative of :math:`J W J^\top`, ``(n_stops, n_stops, n_x + k)``.

        Args:
            x: The state, ``(n_x,)``.
            chosen: Indices of the parameters, ``(k,)``.
        """
        n = self.n_watched
        _, by_x, by_p = self.compiled.delassus_derivative(x, self.p)
        by = np.concatenate([by_x.full(), by_p.full()[:, list(chosen)]], axis=1)
        return by.reshape(n, n, -1)

    def arming(self, x: Vector) -> Vector:
        """Return how far declared switches are armed: above zero where they are, ``(n_declared,)``.

        Formulas of comparisons become continuous, except where that would change their answer.

        Args:
            x: The state, ``(n_x,)``.
        """
        if not self.n_declared:
            return np.zeros(0)
        found = self.compiled.arming(x, self.p)
        armed, smooth = (np.asarray(one.full(), dtype=np.float64).ravel() for one in found)
        return np.asarray(np.where((armed > 0.0) == (smooth > 0.0), smooth, armed))

    def has_infinite_slope(self, x: Vector) -> bool:
        """Return True if a root makes a derivative of the motion infinite at a state, to rounding.

        A factor that is zero there may keep it finite, as in ``x * sqrt(x)``.

        Args:
            x: The state, ``(n_x,)``.
        """
        if not self.compiled.graph.roots:
            return False
        found = self.compiled.roots(x, self.p, self.own.states(x.size) + np.abs(x))
        bases, sizes, exponents = (one.full().ravel() for one in found)
        if not np.any((np.abs(bases) <= _EQUAL * sizes) & (exponents < 1.0)):
            return False
        steps = np.diag(self.own.states(x.size))
        return any(self._diverges(x, side * step) for step in steps for side in (1.0, -1.0))

    def _diverges(self, x: Vector, step: Vector) -> bool:
        """Return True if derivatives grow without limit towards a state.

        Their differences grow in steps that become shorter by the same factor. Those of derivatives
        with a limit become smaller.

        Args:
            x: The state, ``(n_x,)``.
            step: Direction, from the nearest states to the state, ``(n_x,)``.
        """
        found: list[Vector] = []
        for part in _NEARER:
            near = x + part * step
            sides = self.sides_at(near, (True,) * len(self.open_mode[1]))
            known = self.view(((), sides), 0).differentiation
            if known is None:
                return True
            at = known.by(())
            flow = at.free.linear(near[None, :])[0]
            # The rate of the contact force is not differentiated.
            found.append(np.concatenate([flow, at.contact(near)[:MULTIPLIER_RATE]]))
        first, last = (np.abs(b - a) for a, b in pairwise(found))
        rounding = _EQUAL * np.max(np.abs(found), axis=0)
        return bool(np.any(~(last <= np.maximum(first, rounding))))

    def undefined_ahead(self, x: Vector, time: float) -> str:
        """Return what ends a flow at a state: a formula that is infinite or undefined ahead.

        Args:
            x: The state, ``(n_x,)``.
            time: Time there, whose rounding the flow cannot resolve [s].

        Returns:
            A clause that names the formula and the state, or an empty text.
        """
        closed = [k for k, view in enumerate(self.open_views) if self._rests(view, x)]
        own = self.own.time
        for before in (True, False):
            sides = self.sides_at(x, (before,) * len(self.open_mode[1]))
            mode = tuple(closed) if self.stop_names else (), sides
            rate = self.flow(mode).rate(x)[: x.size]
            ahead = states_ahead(x, rate, own, time)
            graph = self.compiled.graph
            mechanism, drive, _ = graph.on_branch(sides)
            inputs = graph.state, self.compiled.parameters
            told = undefined_ahead(mechanism, drive, inputs, [x, *ahead], self.p)
            if told:
                return told
        return ""

    def _rests(self, view: HybridDynamics, x: Vector) -> bool:
        """Return True if a stop is closed at a state, to rounding."""
        own = view.own
        is_slow = abs(view.gap_rate(x)) <= _EQUAL * own.gap / own.time
        return is_slow and abs(view.gap(x)) <= _EQUAL * own.gap

    def equal_stops(self, x: Vector) -> tuple[str, str] | None:
        """Return two stops that are one at a state: equal gaps that the same motion closes."""
        matrix = self.delassus(x)
        for j, k in combinations(range(len(self.stop_names)), 2):
            first, second = self.view(self.open_mode, j), self.view(self.open_mode, k)
            same_gap = abs(first.gap(x) - second.gap(x)) <= _EQUAL * first.own.gap
            product = float(matrix[j, j] * matrix[k, k])
            if same_gap and float(matrix[j, k]) > (1 - _EQUAL) * np.sqrt(product):
                return self.stop_names[j], self.stop_names[k]
        return None


def states_ahead(x: Vector, rate: Vector, own: float, time: float) -> list[Vector]:
    """Return states on the tangent of a motion, up to a time that a flow cannot resolve.

    Args:
        x: The state, ``(n_x,)``.
        rate: Its rate. If it is not finite, the state itself is returned.
        own: Characteristic time of the machine [s].
        time: Time at the state, which determines the rounding of times [s].
    """
    reach = own * _AHEAD + _ROUNDINGS * float(np.spacing(abs(time)))
    steps = np.geomspace(reach * _ROUNDING, reach, 9)
    if not np.all(np.isfinite(rate)):
        return [x]
    with np.errstate(over="ignore"):
        return [x + step * rate for step in steps]
