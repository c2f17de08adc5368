r"""The elements of a program: flow, events, Zeno tails and signals of a machine's modes.

All formulas are those of the machine's compiled systems. The column of an element ends with the
free values, and its constants are all values of the machine, so that other values need no further
element.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca

from zeno_orbits.model import CompiledGraph, CompiledSystem, GraphMode
from zeno_orbits.search.program.elements import LegElement
from zeno_orbits.search.program.legs import Leg, without
from zeno_orbits.simulation import Ending, limit_weights, signal, tail_time

GUARD, FALL = 0, 1
"""Places of a guard and of the rate at which it falls, among the outputs of an event."""


@dataclass(frozen=True, eq=False)
class MachineFormulas:
    """The elements of a machine with given free values.

    Attributes:
        compiled: The functions of its modes.
        free: Names of the free values.
    """

    compiled: CompiledGraph
    free: tuple[str, ...]

    @property
    def n_x(self) -> int:
        """Number of states."""
        return len(self.compiled.state_names)

    @cached_property
    def _elements(self) -> dict[tuple[object, ...], LegElement]:
        return {}

    @cached_property
    def _values(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Symbols of the free values and of all values, and the parameter vector with the first."""
        free = ca.SX.sym("free", len(self.free))
        names = tuple(self.compiled.symbols)
        values = ca.SX.sym("values", len(names))
        p = [
            free[self.free.index(name)] if name in self.free else values[k]
            for k, name in enumerate(names)
        ]
        return free, values, ca.vertcat(*p)

    def _element(self, key: tuple[object, ...], column: ca.SX, outputs: Any) -> LegElement:
        free, values, _ = self._values
        whole = ca.vertcat(column, free)
        self._elements[key] = LegElement.of(whole, values, outputs)
        return self._elements[key]

    def system(self, mode: GraphMode) -> tuple[CompiledSystem, bool]:
        """Return a system with the formulas of a mode, and if the mode is its constrained flow.

        Args:
            mode: The mode.
        """
        n_watched = max(1, len(self.compiled.graph.stops))
        opened = [k for k in range(n_watched) if k not in mode[0]]
        if opened:
            return self.compiled.system(mode, opened[0]), False
        first = mode[0][0]
        return self.compiled.system(without(mode, first), first), True

    def stage(self, leg: Leg, *, has_work: bool) -> LegElement:
        """Return the element of a flow: ``(y, T, w, free) -> T f(y)``, then the power times `T`.

        Args:
            leg: The leg. A plain flow has no `w`.
            has_work: Whether the electrical work is needed.
        """
        key = ("stage", leg.mode, leg.stop, has_work)
        if key in self._elements:
            return self._elements[key]
        p = self._values[2]
        if leg.stop is None:
            system, is_locked = self.system(leg.mode)
            functions = system.locked if is_locked else system.free
            w, unit = ca.SX.sym("w", 0), 1.0
        else:
            system = self.compiled.system(leg.mode, leg.stop)
            functions = system.flight
            w = unit = ca.SX.sym("w")
        y, T = ca.SX.sym("y", functions.rate.size1_in(0)), ca.SX.sym("T")
        outputs = T * functions.rate(y, ca.vertcat(p, w))
        if has_work:
            power = system.powers(y[: self.n_x], p)[0]
            outputs = ca.vertcat(outputs, T * unit * power)
        return self._element(key, ca.vertcat(y, T, w), outputs)

    def _end(self, leg: Leg) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return symbols of the end of a flow, of the unit of a rescaled one, and its state."""
        is_flight = leg.stop is not None
        y = ca.SX.sym("y", self.n_x + (2 if is_flight else 0))
        return y, ca.SX.sym("w", 1 if is_flight else 0), y[: self.n_x]

    def event(self, leg: Leg) -> LegElement:
        """Return the element of an event.

        ``(y, w, free) -> (guard, its fall, x after it, speed after it, energy lost)``. Of an impact
        that ends a sequence, the lost energy is that of all impacts that would follow, too.

        Args:
            leg: The leg that ends at the event.
        """
        closed = leg.after[0] if leg.after is not None else leg.mode[0]
        key = ("event", leg.ending, leg.mode, leg.stop, leg.index, closed)
        if key in self._elements:
            return self._elements[key]
        y, w, x = self._end(leg)
        if leg.strikes:
            outputs = self._impact(leg, y, w, closed)
        elif leg.ending is Ending.RELEASE:
            contact = self.compiled.system(without(leg.mode, leg.index), leg.index).contact_at(
                x, self._values[2]
            )
            outputs = [contact.multiplier, -contact.multiplier_rate, x, 0.0, 0.0]
        else:
            outputs = self._switch(leg, x)
        return self._element(key, ca.vertcat(y, w), ca.vertcat(*outputs))

    def _impact(self, leg: Leg, y: ca.SX, w: ca.SX, closed: tuple[int, ...]) -> list[Any]:
        x, p = y[: self.n_x], self._values[2]
        # A stop that the impact opens is no constraint of the impulse.
        kept = tuple(k for k in closed if k != leg.index and k in leg.mode[0])
        system = self.compiled.system((kept, leg.mode[1]), leg.index)
        contact, law = system.contact_at(x, p), system.law_at(p)
        guard, rate = contact.gap, contact.gap_rate
        if leg.stop == leg.index:
            guard, rate = y[self.n_x], w * y[self.n_x + 1]
        after = x - law.rate_drop(rate) * system.impulse(x, p)[0]
        part = 1 if leg.tail is not None else 1 - law.restitution**2
        lost = part * system.impulse(x, p)[1] * rate**2 / 2
        return [guard, -rate, after, law.speed_after(rate), lost]

    def _switch(self, leg: Leg, x: ca.SX) -> list[Any]:
        p, n_declared = self._values[2], len(self.compiled.graph.switches)
        is_declared = leg.index < n_declared
        above = True if is_declared else leg.mode[1][leg.index - n_declared]
        guard = self.compiled.guard(leg.mode, leg.index, above).guard(x, p)
        after = self.compiled.resets[leg.index](x, p) if is_declared else x
        return [guard[0], -guard[1], after, 0.0, 0.0]

    def armed(self, leg: Leg) -> LegElement | None:
        """Return ``(x, free) -> armed`` of a declared switch, ``None`` if it is always armed.

        Args:
            leg: The leg that ends at the switch.
        """
        if leg.ending is not Ending.SWITCH or leg.index >= len(self.compiled.graph.switches):
            return None
        x = ca.SX.sym("x", self.n_x)
        formula = self.compiled.arming(x, self._values[2])[1][leg.index]
        if formula.is_constant():
            return None
        key = ("armed", leg.index)
        return self._elements.get(key) or self._element(key, x, formula)

    def rested(self, leg: Leg, y: ca.SX, w: ca.SX) -> tuple[CompiledSystem, Any, Any]:
        """Return the system of an impact, the state with the mean gap rate, and the gap rate."""
        x, p = y[: self.n_x], self._values[2]
        system = self.compiled.system(without(leg.mode, leg.index), leg.index)
        rate = system.contact_at(x, p).gap_rate
        if leg.stop == leg.index:
            rate = w * y[self.n_x + 1]
        return system, x - rate * system.impulse(x, p)[0], rate

    def tail(self, leg: Leg) -> LegElement:
        """Return ``(y, w, free) -> (state at the end of a tail, its time)``, theory (2.7).

        Args:
            leg: The leg that ends at the impact.
        """
        key = ("tail", leg.mode, leg.stop, leg.index)
        if key in self._elements:
            return self._elements[key]
        y, w, _ = self._end(leg)
        p = self._values[2]
        system, rest, rate = self.rested(leg, y, w)
        law = system.law_at(p)
        bends = system.contact_at(rest, p).gap_acceleration
        time = tail_time(law.speed_after(rate), bends, law.restitution)
        outputs = [rest + time * system.locked.rate(rest, p), time]
        return self._element(key, ca.vertcat(y, w), ca.vertcat(*outputs))

    def tail_work(self, leg: Leg) -> LegElement:
        """Return ``(y, w, x after the tail, its time, free) -> electrical work in the tail``.

        Args:
            leg: The leg that ends at the last resolved impact.
        """
        key = ("tail work", leg.mode, leg.stop, leg.index)
        if key in self._elements:
            return self._elements[key]
        y, w, _ = self._end(leg)
        end, time = ca.SX.sym("end", self.n_x), ca.SX.sym("time")
        system, rest, _ = self.rested(leg, y, w)
        powers = [system.powers(x, self._values[2])[0] for x in (rest, end)]
        return self._element(key, ca.vertcat(y, w, end, time), time * (powers[0] + powers[1]) / 2)

    def limit(self, first: tuple[int, ...], n_hops: int) -> LegElement:
        """Return the element of a Zeno limit.

        ``(speeds, states and times of the tails, w and T of later hops, free) ->
        (Zeno state, its time since the last resolved impact)``.

        Args:
            first: For each node the number of hops before it.
            n_hops: Number of hops.
        """
        key = ("limit", first, n_hops)
        if key in self._elements:
            return self._elements[key]
        n, n_nodes = self.n_x, len(first)
        speeds, times = ca.SX.sym("speeds", n_nodes), ca.SX.sym("times", n_nodes)
        states = ca.SX.sym("states", n, n_nodes)
        w, T = ca.SX.sym("w", n_hops), ca.SX.sym("T", n_hops)
        weights = limit_weights([speeds[k] for k in range(n_nodes)])
        state, time = ca.SX.zeros(n), ca.SX(0)
        for k, weight in enumerate(weights):
            later = ca.dot(w[first[k] :], T[first[k] :]) if first[k] < n_hops else 0.0
            state += weight * states[:, k]
            time += weight * (times[k] - later)
        column = ca.vertcat(speeds, ca.vec(states), times, w, T)
        return self._element(key, column, ca.vertcat(state, time))

    def product(self) -> LegElement:
        """Return ``(w, T, free) -> w T``, the time of a rescaled flight."""
        column = ca.SX.sym("column", 2)
        return self._elements.get(("product",)) or self._element(
            ("product",), column, column[0] * column[1]
        )

    def holonomic(self, mode: GraphMode) -> LegElement:
        """Return ``(x, free) -> (eta, eta_rate)`` of the constraints and the clock's circle.

        Args:
            mode: The mode.
        """
        x = ca.SX.sym("x", self.n_x)
        key = ("holonomic", mode)
        if key in self._elements:
            return self._elements[key]
        return self._element(key, x, self.system(mode)[0].holonomic(x, self._values[2]))

    def contact(self, mode: GraphMode, stop: int) -> LegElement:
        """Return ``(x, free) -> gap`` of an open stop, or the multiplier of a closed one.

        Args:
            mode: The mode.
            stop: Index of the stop.
        """
        key = ("contact", mode, stop)
        if key in self._elements:
            return self._elements[key]
        x = ca.SX.sym("x", self.n_x)
        contact = self.compiled.system(without(mode, stop), stop).contact_at(x, self._values[2])
        return self._element(key, x, contact.multiplier if stop in mode[0] else contact.gap)

    def signal(self, mode: GraphMode, name: str) -> LegElement:
        """Return ``(x, free) -> value`` of a signal.

        Args:
            mode: The mode.
            name: Name of the signal.
        """
        key = ("signal", mode, name)
        if key in self._elements:
            return self._elements[key]
        x = ca.SX.sym("x", self.n_x)
        function = signal(self.system(mode)[0], name).function
        return self._element(key, x, function(x, self._values[2]))

    def times(self) -> LegElement | None:
        """Return ``(free,) -> distances of switching times``, ``None`` without a waveform."""
        if not self.compiled.graph.time_orders:
            return None
        _, upper, least = self.compiled.times(self._values[2])
        key = ("times",)
        return self._elements.get(key) or self._element(key, ca.SX(0, 1), upper - least)


@lru_cache(maxsize=16)
def formulas_of_machine(compiled: CompiledGraph, free: tuple[str, ...]) -> MachineFormulas:
    """Return the elements of a machine, shared by all programs of a process.

    Args:
        compiled: The functions of its modes.
        free: Names of the free values.
    """
    return MachineFormulas(compiled, free)
