"""The modes of a machine with several stops, switches or kinks, in symbols."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

import casadi as ca

from zeno_orbits.integrators import lookups_in
from zeno_orbits.model.drives.circuits import Drive
from zeno_orbits.model.drives.waveforms import TimeOrder
from zeno_orbits.model.expressions.kinks import branched, is_smooth, sided
from zeno_orbits.model.friction import PER_PART, friction_formulas, friction_guards
from zeno_orbits.model.lagrangian import HybridLagrangian
from zeno_orbits.model.stops import Stop, Switch, watched

GraphMode = tuple[tuple[int, ...], tuple[bool, ...]]
"""A mode: the indices of its closed stops in increasing order, and the side of every kink."""

_Branch = tuple[HybridLagrangian, Drive, tuple[ca.SX, ...]]
"""Mechanism, drive and conditions on a branch of the kinks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeGraph:
    r"""The modes and events of a machine, in symbols.

    Attributes:
        mechanism: The mechanism.
        drive: Its drive.
        stops: Its stops.
        switches: The declared switches.
        conditions: The conditions of the kinks of its formulas, whose zeros are switches.
        roots: Bases of powers that events keep from falling below zero, with the exponents.
        time_orders: Orders of the switching times of its piecewise inputs.
        delassus: Delassus matrix :math:`J W J^\top` of all stops.
        coupling: The same without the inertia that a corrected drive adds, which acts only in the
            current layer after an impact. An impact opens other stops by this matrix.
        resets: State after every declared switch, ``(n_x,)``.
        state: ``(q, v, states of the drive, clock)``.
        causes: The event of a stop that causes each declared switch, or no text for a switch with
            a guard of its own. The latter come first.
        is_named: Whether the machine names its stops. The one ``gap`` of a mechanism is unnamed.
    """

    mechanism: HybridLagrangian
    drive: Drive
    stops: tuple[Stop, ...]
    switches: tuple[Switch, ...]
    conditions: tuple[ca.SX, ...]
    roots: tuple[tuple[ca.SX, ca.SX], ...]
    time_orders: tuple[TimeOrder, ...]
    delassus: ca.SX
    coupling: ca.SX
    resets: tuple[ca.SX, ...]
    state: ca.SX
    causes: tuple[str, ...] = ()
    is_named: bool = True
    _branches: dict[tuple[tuple[bool, ...], tuple[int, ...]], _Branch] = field(
        default_factory=dict["tuple[tuple[bool, ...], tuple[int, ...]]", "_Branch"],
        compare=False,
        repr=False,
    )
    _frictions: dict[GraphMode, tuple[ca.SX, ...]] = field(
        default_factory=dict["GraphMode", "tuple[ca.SX, ...]"], compare=False, repr=False
    )

    @property
    def held(self) -> tuple[int, ...]:
        """Indices of the states of the drive that are constant between events."""
        first, rates = 2 * self.mechanism.q.numel(), ca.vertsplit(ca.SX(self.drive.rates))
        return tuple(first + k for k, rate in enumerate(rates) if ca.SX(rate).is_zero())

    @property
    def has_current_layers(self) -> bool:
        """True if a corrected drive adds the current layer to every impact."""
        return self.drive.added_inertia.nnz() > 0

    @property
    def reason(self) -> str:
        """The property that gives the machine another form than one stop, or an empty text."""
        if len(self.stops) > 1:
            return "several stops"
        if not self.stops:
            return "no stop"
        if self.switches:
            return "switches"
        if self.roots and not self.conditions:
            return "a root that is zero at its stop"
        if any(one.table.is_kinked for one in lookups_in(self._kinked)):
            return "a linear or monotone table"
        if self.conditions:
            return "a kink of the state (`fmin`, `fmax`, `fabs`, `sign`, `if_else`, `atan2`)"
        name = "a stop with a name, of `stops` (a `gap` of its mechanism is unnamed)"
        return name if self.is_named else ""

    @property
    def named_stops(self) -> tuple[str, ...]:
        """Names of the stops that the machine names."""
        return tuple(stop.name for stop in self.stops if self.is_named)

    @property
    def n_watched(self) -> int:
        """Number of stops of its views: of a machine without stops it is 1."""
        return len(watched(self.stops))

    @property
    def switch_names(self) -> tuple[str, ...]:
        """Names of the declared switches, then of the kinks."""
        kinks = (f"kink {k}" for k in range(1, len(self.conditions) + 1))
        return (*(switch.name for switch in self.switches), *kinks)

    @property
    def formulas(self) -> list[ca.SX]:
        """Formulas of the stops and switches."""
        stops = [ca.SX(part) for one in self.stops for part in (one.gap, one.law.numbers)]
        switches = [ca.SX(part) for one in self.switches for part in (one.guard, one.armed)]
        return [*stops, *switches, *self.resets]

    @property
    def n_frictions(self) -> int:
        """Number of parts with dry friction."""
        return len(self.drive.frictions)

    @property
    def frictional(self) -> range:
        """Indices of the switches of its parts with dry friction, the last declared switches."""
        n = len(self.switches)
        return range(n - PER_PART * self.n_frictions, n)

    def declared(self, contact: ca.SX, sizes: ca.SX) -> tuple[tuple[Switch, ...], ca.SX]:
        """Return the declared switches with some stops closed, and what occurs without a zero.

        Args:
            contact: 1 for each stop that is closed, and else 0, ``(n_stops,)``.
            sizes: Sizes of the states, ``(n_x,)``.
        """
        own = self.frictional.start
        if not self.n_frictions:
            return self.switches, ca.SX.zeros(own)
        parts = self.mechanism, self.drive, self._every_gap, contact
        found = friction_formulas(*parts, self.state, sizes)
        return (*self.switches[:own], *found.switches), ca.vertcat(ca.SX.zeros(own), found.due)

    def _guards_of_friction(self, mode: GraphMode) -> tuple[ca.SX, ...]:
        """Return the guards of the switches of dry friction in a mode."""
        if mode not in self._frictions:
            closed, sides = mode
            mechanism, drive, _ = self.on_branch(sides)
            contact = ca.SX([float(k in closed) for k in range(len(self.stops))])
            found = friction_guards(mechanism, drive, self._every_gap, contact)
            self._frictions[mode] = found
        return self._frictions[mode]

    @property
    def _every_gap(self) -> ca.SX:
        return ca.vertcat(ca.SX(0, 1), *(one.gap for one in self.stops))

    def guard(self, sides: tuple[bool, ...], switch: int, closed: tuple[int, ...] = ()) -> ca.SX:
        """Return the guard of a switch.

        Args:
            sides: The side of every kink.
            switch: Index of a declared switch, or of a kink after these.
            closed: Indices of the closed stops, on which the guards of dry friction depend.
        """
        declared = len(self.switches)
        if switch in self.frictional:
            return self._guards_of_friction((closed, sides))[switch - self.frictional.start]
        if switch < declared:
            return ca.SX(self.switches[switch].guard)
        return self.on_branch(sides)[2][switch - declared]

    def on_branch(self, sides: tuple[bool, ...], beyond: tuple[int, ...] = ()) -> _Branch:
        """Return mechanism, drive and conditions on a branch of the kinks.

        Args:
            sides: The side of every kink.
            beyond: Indices of compliant stops whose gap is negative.
        """
        key = (sides, beyond)
        if key not in self._branches:
            parts = formulas_of(self.mechanism), formulas_of(self.drive)
            found = branched(self._kinked, self.state, sides, self._gaps(beyond))
            n = len(parts[0])
            drive = replace(self.drive, **dict(zip(parts[1], found.formulas[n:], strict=True)))
            self._branches[key] = (
                replace(self.mechanism, **dict(zip(parts[0], found.formulas[:n], strict=True))),
                replace(drive, fed=self._fed_on_branch(sides, beyond)),
                found.smooth,
            )
        return self._branches[key]

    def _fed_on_branch(
        self, sides: tuple[bool, ...], beyond: tuple[int, ...]
    ) -> Callable[[ca.SX], Drive] | None:
        """Return the function from source voltages to the drive on a branch of the kinks."""
        fed = self.drive.fed
        if fed is None or not self.conditions:
            return fed

        def on_branch(source: ca.SX) -> Drive:
            asked = ca.SX.sym("source", source.numel())
            parts = formulas_of(fed(asked))
            kinked = [*self._kinked, *parts.values()]
            found = branched(kinked, self.state, sides, self._gaps(beyond))
            if len(found.conditions) > len(self.conditions):
                # A kink of the source itself has no side: the formulas stay as they are written.
                return fed(source)
            smooth = found.formulas[len(self._kinked) :]
            whole = ca.substitute(list(smooth), [asked], [source])
            return replace(fed(source), **dict(zip(parts, whole, strict=True)))

        return on_branch

    def on_sides(self, sides: ca.SX) -> tuple[tuple[ca.SX, ...], tuple[ca.SX, ...]]:
        """Return the conditions of the kinks on given sides, and their derivatives: `sided`."""
        return sided(self._kinked, self.state, sides, self._gaps())

    @property
    def _kinked(self) -> list[ca.SX]:
        """The formulas whose kinks are the kinks of the machine."""
        return [*formulas_of(self.mechanism).values(), *formulas_of(self.drive).values()]

    def _gaps(self, beyond: tuple[int, ...] = ()) -> list[ca.SX]:
        """Return the gap of every stop with the sign that it has."""
        return [-one.gap if k in beyond else one.gap for k, one in enumerate(self.stops)]


def kinks_of(
    mechanism: HybridLagrangian, drive: Drive, state: ca.SX
) -> tuple[tuple[ca.SX, ...], tuple[tuple[ca.SX, ca.SX], ...]]:
    """Return the conditions of the kinks of a machine, and its roots at events, as written.

    Args:
        mechanism: The mechanism.
        drive: Its drive.
        state: The states, ``(n_x,)``.

    Raises:
        ValueError: If a formula jumps without a condition, or holds an unknown operation.
    """
    formulas = [*formulas_of(mechanism).values(), *formulas_of(drive).values()]
    if is_smooth(formulas):
        return (), ()
    gaps = [stop.gap for stop in mechanism.stops] or [mechanism.gap]
    found = branched(formulas, state, gaps=gaps)
    return found.conditions, found.roots


def formulas_of(part: HybridLagrangian | Drive) -> dict[str, ca.SX]:
    """Return the formulas of a mechanism or drive by name, without its symbols."""
    symbols = ("q", "v", "states")
    formulas = {one.name: getattr(part, one.name) for one in fields(part)}
    return {
        name: formula
        for name, formula in formulas.items()
        if isinstance(formula, ca.SX) and name not in symbols
    }
