"""A machine in the library's format.

A view is an open stop in a mode. A side is the guard of a switch on one
side of it, along the flow of a mode. The tables of views and sides grow when a run asks for one.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from zeno_orbits.loop import binding as c
from zeno_orbits.loop.formulas import formulas_digest
from zeno_orbits.loop.program import Program, TapedProblem, fill_tape, scheme
from zeno_orbits.loop.tape import Tape, tape_of
from zeno_orbits.loop.views import SwitchSide, View
from zeno_orbits.model import ModeFunctions


@dataclass(frozen=True, slots=True, kw_only=True)
class GraphFormulas:
    """The formulas that all modes of a machine share.

    Attributes:
        n_x: Number of states.
        n_q: Number of coordinates.
        n_p: Number of parameters.
        n_stops: Number of stops.
        n_declared: Number of declared switches.
        n_switches: Number of declared switches and kinks.
        n_frictional: Number of the last declared switches, which belong to dry friction.
        switches: ``(x, p, sizes, sides) -> (formulas of all switches, their sizes, formulas
            `armed`)``, with dry friction as `CompiledGraph.switches`.
        delassus: ``(x, p) -> J W J^T`` of all stops, by which an impact opens stops.
        resets: ``(x, p) -> x`` after each declared switch.
        causes: For each declared switch the event of a stop that causes it, as kind and index of
            the stop, or ``None`` for a switch with a guard of its own.
        orders: ``p -> (lower times, upper times, least upper times)`` of waveforms.
        clock: Index of the first state of the clock, and of the first state after the clock.
    """

    n_x: int
    n_q: int
    n_p: int
    n_stops: int
    n_declared: int
    n_switches: int
    n_frictional: int
    switches: ca.Function
    delassus: ca.Function
    resets: Sequence[ca.Function]
    causes: Sequence[tuple[int, int] | None]
    orders: ca.Function
    clock: tuple[int, int]


class GraphProgram(TapedProblem):
    """The formulas of a graph of modes, as far as runs have asked for them."""

    def __init__(self, library: Any, formulas: GraphFormulas) -> None:
        """Make the tapes that all modes share.

        Args:
            library: The library.
            formulas: The formulas.

        Raises:
            UnknownOperationError: If a formula holds an operation that tapes do not have.
        """
        super().__init__(library, (), (), formulas.n_x, formulas.n_q, formulas.n_p)
        self.formulas = formulas
        self.switches = tape_of(formulas.switches) if formulas.n_switches else Tape.empty()
        self.delassus = tape_of(formulas.delassus)
        self.resets = tuple(map(tape_of, formulas.resets))
        times = formulas.orders.numel_out(0)
        self.orders = tape_of(formulas.orders, parameters=0) if times else Tape.empty()
        self.views: dict[View, Program] = {}
        self.sides: dict[SwitchSide, tuple[Tape, Tape]] = {}
        self._places: dict[object, int] = {}
        self._n_numbers = 0
        self._kept: list[object] = []
        for tape in (self.switches, self.delassus, self.orders, *self.resets):
            self._place(id(tape), tape.n_registers)
        self._tabulate()

    def add(self, views: Mapping[View, Program], sides: Mapping[SwitchSide, ModeFunctions]) -> None:
        """Add views, and guards of switches, to the tables.

        Raises:
            UnknownOperationError: If a formula holds an operation that tapes do not have.
        """
        for view, program in views.items():
            self.views[view] = program
            self._place(view, self.library.zl_room(program.address))
        for side, mode in sides.items():
            bounds = Tape.empty() if mode.bounded is None else tape_of(mode.bounded)
            value = tape_of(mode.guard)
            self.sides[side] = value, bounds
            self._place(side, 1 + value.n_registers + 3 * bounds.n_registers)
        if self.only_view is None and len(self.views) == len(views) == 1:
            # The first view, by which the machine is found in the cache.
            self.load(self._digest)
        elif self._compiled is not None:
            self.use(self._compiled)
        self._tabulate()

    def use(self, compiled: Any) -> None:
        """Use compiled formulas for all views.

        Args:
            compiled: Their library, or ``None`` to leave each view as it is.
        """
        self._compiled = compiled
        for program in self.views.values() if compiled is not None else ():
            program.use(compiled)

    def give_back(self, memory: Any) -> None:
        """Take back memory of a run, unless the tables have grown since."""
        if len(memory) >= self.size:
            super().give_back(memory)

    def asked_for(self, about: Sequence[int]) -> View | SwitchSide:
        """Return the view or side that a run asks for.

        Args:
            about: What the status ``MODE`` is about.
        """
        is_side, mode, index, positive = about
        n_kinks = self.formulas.n_switches - self.formulas.n_declared
        closed = tuple(k for k in range(self.formulas.n_stops) if mode >> k & 1)
        sides = tuple(bool(mode >> (c.STOPS + k) & 1) for k in range(n_kinks))
        return (
            SwitchSide(closed, sides, index, bool(positive))
            if is_side
            else View(closed, index, sides)
        )

    @property
    def is_compiled(self) -> bool:
        """True if the formulas are compiled. The digits are equal either way."""
        only = self.only_view
        return super().is_compiled if only is None else only.is_compiled

    def compile(self, views: Iterable[Program]) -> None:
        """Compile formulas of views now and use them from now on.

        Args:
            views: The formulas, usually of all modes.

        Raises:
            KernelError: If the compilation fails. The message contains the reason.
        """
        if self.only_view is not None:
            self.only_view.compile()
        else:
            self.compile_views(self._digest, views)

    @property
    def _digest(self) -> str:
        """Digest of the first view and the shared formulas, by which a machine is found.

        Machines that differ in other views only find the same library, which lacks those views.
        """
        first = next(iter(self.views.values()))
        shared = (self.switches, self.delassus, self.orders, *self.resets)
        return formulas_digest(self.n_x, [*first.tapes, *shared])

    @property
    def only_view(self) -> Program | None:
        """The formulas of the only view of a machine with one stop and no switch, else ``None``."""
        formulas = self.formulas
        if formulas.n_stops + formulas.n_switches > 1 or not self.views:
            return None
        return next(iter(self.views.values()))

    @property
    def n_stops(self) -> int:
        """Number of stops."""
        return self.formulas.n_stops

    @property
    def n_declared(self) -> int:
        """Number of declared switches."""
        return self.formulas.n_declared

    @property
    def cause_keys(self) -> list[int]:
        """The cause of each declared switch: ``ZL_CAUSE``, or -1."""
        return [-1 if one is None else one[0] << 5 | one[1] for one in self.formulas.causes]

    @property
    def n_numbers(self) -> int:
        """Numbers of a run, apart from its settings and parameters."""
        return self._n_numbers

    def place_of(self, one: View | SwitchSide | Tape) -> int:
        """Return the place of numbers in those of a run.

        Args:
            one: A view, a side, or a tape that all modes share.
        """
        return self._places[id(one) if isinstance(one, Tape) else one]

    def _place(self, name: object, n_numbers: int) -> None:
        self._places[name] = self._n_numbers
        self._n_numbers += n_numbers

    def _tabulate(self) -> None:
        """Write the tables anew. Runs in other threads go on with those that they have."""
        views = (c.ProblemType * max(len(self.views), 1))()
        for place, program in zip(views, self.views.values(), strict=False):
            ctypes.pointer(place)[0] = program.problem
        sides = (c.SideType * max(len(self.sides), 1))()
        for place, (side, (value, bounds)) in zip(sides, self.sides.items(), strict=False):
            place.place = self._places[side]
            fill_tape(place.value, value)
            fill_tape(place.bounds, bounds)
        resets = (c.TapeType * max(len(self.resets), 1))()
        for place, tape in zip(resets, self.resets, strict=False):
            fill_tape(place, tape)
        tables = {
            "resets": resets,
            "reset_places": _whole([self._places[id(tape)] for tape in self.resets]),
            "causes": _whole(self.cause_keys),
            "view_keys": _whole([view.key for view in self.views]),
            "view_places": _whole([self._places[view] for view in self.views]),
            "views": views,
            "side_keys": _whole([side.key for side in self.sides]),
            "sides": sides,
        }
        table = c.GraphType(
            n_stops=self.formulas.n_stops,
            n_declared=self.formulas.n_declared,
            n_switches=self.formulas.n_switches,
            n_views=len(self.views),
            n_sides=len(self.sides),
            n_frictional=self.formulas.n_frictional,
            n_numbers=self._n_numbers,
            switches_place=self._places[id(self.switches)],
            delassus_place=self._places[id(self.delassus)],
            orders_place=self._places[id(self.orders)],
            first_clock=self.formulas.clock[0],
            end_clock=self.formulas.clock[1],
            **{name: ctypes.addressof(array) for name, array in tables.items()},
        )
        fill_tape(table.switches, self.switches)
        fill_tape(table.delassus, self.delassus)
        fill_tape(table.orders, self.orders)
        problem = c.ProblemType(n_x=self.n_x, n_q=self.n_q, n_p=self.n_p)
        problem.scheme = ctypes.addressof(scheme())
        problem.graph = ctypes.addressof(table)
        self._kept.append((problem, table, tables))
        self.problem, self.address = problem, ctypes.addressof(problem)
        self._size, self._spare = self.library.zl_size(self.address), []


def _whole(numbers: Sequence[int]) -> Any:
    return (ctypes.c_longlong * max(len(numbers), 1))(*numbers)
