"""A stop of a machine with several stops or switches in the library's format.

The stop is a machine with one stop. The other guards of the machine are beside it: while they are
clearly not involved, the loop carries out the execution. Otherwise the caller follows an arc.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from zeno_orbits.loop import binding as c
from zeno_orbits.loop.program import Program, TapedProblem, fill_tape
from zeno_orbits.loop.tape import Tape, tape_of
from zeno_orbits.model import ModeFunctions


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherGuard:
    """A guard beside the guard of a stop.

    Attributes:
        kind: A constant of `binding`.
        stop: Index of the stop, or -1 for a switch.
        sign: Side of a switch: its guard is the formula times this number.
        off: The guard along the flow off the stop.
        on: The guard along the flow on the stop, or ``None`` until a motion enters that mode.
    """

    kind: int
    stop: int
    sign: float
    off: ModeFunctions
    on: ModeFunctions | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Beside:
    """What a machine has beside a stop.

    Attributes:
        stop: Index of the stop.
        n_stops: Number of stops.
        guards: The other guards, the switches last, in their order.
        n_switches: Number of switches.
        switches: ``(x, p, sizes) -> (formulas of all switches, their sizes, ...)``.
        delassus: ``(x, p) -> J W J^T`` of all stops.
    """

    stop: int
    n_stops: int
    guards: Sequence[OtherGuard]
    n_switches: int
    switches: ca.Function
    delassus: ca.Function


class GraphProgram(TapedProblem):
    """The formulas of a stop and of the guards beside it."""

    def __init__(self, library: Any, program: Program, beside: Beside) -> None:
        """Make the tapes.

        Args:
            library: The library.
            program: The stop as a machine with one stop.
            beside: The other guards.

        Raises:
            UnknownOperationError: If a formula holds an operation that tapes do not have.
        """
        carried = list(program.problem.carried)
        super().__init__(library, program.tapes, carried, program.n_x, program.n_q, program.n_p)
        self.beside = beside
        self._room, self._others = 0, list[Tape]()
        rows = (c.GuardType * max(len(beside.guards), 1))()
        for row, guard in zip(rows, beside.guards, strict=False):
            row.kind, row.stop, row.sign = guard.kind, guard.stop, guard.sign
            for side, mode in enumerate((guard.off, guard.on)):
                if mode is None:
                    continue
                row.place[side] = self._added(row.value[side], tape_of(mode.guard), 1)
                if mode.bounded is not None:
                    row.bounds_place[side] = self._added(row.bounds[side], tape_of(mode.bounded), 3)
        self._rows, self._table = rows, c.BesideType(n_guards=len(beside.guards))
        table = self._table
        table.n_switches, table.n_stops, table.stop = beside.n_switches, beside.n_stops, beside.stop
        table.guards = ctypes.addressof(rows)
        if beside.n_switches:
            table.switches_place = self._added(table.switches, tape_of(beside.switches), 1)
        table.delassus_place = self._added(table.delassus, tape_of(beside.delassus), 1)
        table.n_registers = self._room
        self.problem.beside = ctypes.addressof(table)
        self._size = library.zl_size(self.address)

    def _added(self, place: Any, tape: Tape, width: int) -> int:
        """Write a tape to memory and return the place of its registers.

        Args:
            place: The memory.
            tape: The tape.
            width: Numbers for each register: three, with its interval.
        """
        fill_tape(place, tape)
        self._others.append(tape)
        first = self._room
        self._room += width * tape.n_registers
        return first
