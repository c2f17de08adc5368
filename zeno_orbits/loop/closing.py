"""Newton's method of a return in the library, for a machine with one stop."""

from __future__ import annotations

import ctypes
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.loop import binding as c
from zeno_orbits.loop.program import Program, TapedProblem
from zeno_orbits.loop.tangent import TangentProgram

_STEPS, _POLYNOMIALS, _ARCS, _EVENTS = 8192, 2048, 1024, 1024
"""Rows of the records of a return. A longer return is left to the reference."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closing:
    """A return that is to be closed.

    Attributes:
        x: State just after the event of the section, ``(n_x,)``.
        p: Gains and parameters, ``(n_p,)``.
        settings: Accuracy and limits, as `filled` returns them.
        sizes: Characteristic size of each state, ``(n_x,)``.
        section: Kind of the event: a constant of `binding`.
        n_returns: Number of such events in a period.
        guess: Approximate period [s].
        exact: Largest relative correction of an orbit.
        trusted: Largest relative error of an explicit step that is reused for derivatives.
    """

    x: Vector
    p: Vector
    settings: Any
    sizes: Vector
    section: int
    n_returns: int
    guess: float
    exact: float
    trusted: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosedRecord:
    """A return that repeats, with its derivatives.

    Attributes:
        start: The start, ``(n_x,)``.
        end: State after the last event, ``(n_x,)``.
        period: Time of the return [s].
        scale: Largest modulus of each state at the ends of arcs, ``(n_x,)``.
        by_state: Derivative of the end with respect to the start, ``(n_x, n_x)``.
        events: One row per event of the return.
        arcs: One row per arc. After a return to a Zeno point, the last one is the contact.
        shifts: Derivatives of every arc with respect to the start: of its start, of its end, after
            the event there. Rows of time, gap rate and states, ``(n, 3, 2 + n_x, n_x)``.
    """

    start: Vector
    end: Vector
    period: float
    scale: Vector
    by_state: Vector
    events: Vector
    arcs: Vector
    shifts: Vector


class _Room:
    """Memory for records and derivatives of a return."""

    def __init__(self, n_x: int, width: int) -> None:
        n = n_x
        self.steps = np.empty((_STEPS, c.STEP_WIDTH + n + 2))
        self.polynomials = np.empty((_POLYNOMIALS, c.STAGES * (n + 2)))
        self.arcs = np.empty((_ARCS, c.ARC_WIDTH + 2 * n + 2))
        self.events = np.empty((_EVENTS, c.EVENT_WIDTH + 2 * n))
        self.estimates = np.empty((_EVENTS, c.ESTIMATE_WIDTH + 2 * n))
        self.shifts = np.empty((1 + _ARCS, 3, 2 + n, width))
        self.records = c.RecordsType()
        for name in ("steps", "polynomials", "arcs", "events", "estimates"):
            array = getattr(self, name)
            setattr(self.records, name, array.ctypes.data)
            setattr(self.records, f"most_{name}", len(array))


_rooms: WeakKeyDictionary[TapedProblem, list[_Room]] = WeakKeyDictionary()


def closed_record(
    program: TapedProblem, view: Program, tangent: TangentProgram, closing: Closing
) -> ClosedRecord | None:
    """Return the periodic orbit near a start, or ``None`` if the reference has to look for it.

    Args:
        program: The machine.
        view: The formulas of its only view.
        tangent: Their derivatives with respect to the state.
        closing: The return.

    Raises:
        SimulationError: If no orbit is found: the motion does not return, or is interrupted, or a
            correction of Newton's method is not smaller than the one before.
    """
    n = program.n_x
    place = c.ClosingType(
        guess=closing.guess,
        exact=closing.exact,
        trusted=closing.trusted,
        section=closing.section,
        n_returns=closing.n_returns,
    )
    place.start[:n], place.sizes[:n] = closing.x.tolist(), closing.sizes.tolist()
    p, work = np.ascontiguousarray(closing.p), np.empty(tangent.work)
    place.settings, place.p = ctypes.addressof(closing.settings), p.ctypes.data
    place.work = work.ctypes.data
    rooms = _rooms.setdefault(program, [])
    room = rooms.pop() if rooms else _Room(n, tangent.width)
    place.shifts = room.shifts.ctypes.data
    with _memory(program) as run, _memory(view) as other:
        status = program.library.zl_close(
            *(program.address, run, view.address, tangent.address, other),
            *(ctypes.addressof(room.records), ctypes.addressof(place)),
        )
    found = _record(place, room, n) if status == c.CLOSED else None
    rooms.append(room)
    if status == c.OPEN:
        raise SimulationError(
            "Newton's method does not converge to a periodic orbit",
            time=place.guess,
            state=tuple(closing.x.tolist()),
        )
    return found


def _record(place: c.ClosingType, room: _Room, n: int) -> ClosedRecord:
    """Return what the library has left in memory that is used again."""
    return ClosedRecord(
        start=np.array(place.start[:n]),
        end=np.array(place.end[:n]),
        period=place.period,
        scale=np.array(place.scale[:n]),
        by_state=np.array(place.by_state[: n * n]).reshape(n, n),
        events=room.events[: place.n_events].copy(),
        arcs=room.arcs[: place.n_arcs].copy(),
        shifts=room.shifts[1 : 1 + place.n_arcs, :, :, :n].copy(),
    )


@contextmanager
def _memory(program: TapedProblem) -> Generator[int]:
    """Hold memory for a run, and yield its address."""
    memory = program.borrowed()
    try:
        yield ctypes.addressof(memory)
    finally:
        program.give_back(memory)
