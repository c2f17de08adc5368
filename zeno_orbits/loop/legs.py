"""Legs by themselves: one flow from a state until its guard falls, with no event after it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import fast_dataclass
from zeno_orbits.loop import binding as c
from zeno_orbits.loop.library import loop_library
from zeno_orbits.loop.program import TapedProblem
from zeno_orbits.loop.run import Detail, detail_of
from zeno_orbits.loop.tape import Tape, UnknownOperationError, tape_of
from zeno_orbits.model import ModeFunctions

_STEPS, _POLYNOMIALS, _ROWS = 1024, 256, 8
"""Rows of the records that one call writes."""

_NO_POLYNOMIALS = np.zeros((0, c.STAGES, 0))
_NO_ROWS = np.zeros((0, c.STEP_WIDTH))


class LegSettings(NamedTuple):
    """Start, end and steps of a leg.

    Attributes:
        horizon: Longest time, in the time of the flow.
        relative: Local error of a step, as a part of an entry.
        absolute: The same in the weights of the entries.
        weights: Size of each state for the absolute error, or all 1 if it is empty.
        on_guard: Whether the start is a root of the guard that does not count.
        rounding: Rounding level of the guard.
        late: Time before the horizon in which a zero of the guard does not count.
        begins_explicit: Whether the first steps are explicit.
        goes_implicit: Whether implicit steps are used when they pay.
        largest_explicit: Largest explicit step.
        largest_implicit: Largest implicit step.
    """

    horizon: float
    relative: float
    absolute: float
    weights: tuple[float, ...]
    on_guard: bool
    rounding: float
    late: float
    begins_explicit: bool
    goes_implicit: bool
    largest_explicit: float
    largest_implicit: float


@fast_dataclass
class LegRecord:
    """The steps of a leg.

    Attributes:
        status: Status at the end: ``DONE``, or an error of `binding`.
        fell: Whether the leg ended at a zero crossing of the guard.
        duration: Duration of the leg.
        end: State at its end, ``(n_y,)``.
        rows: Start, size and state after of every step, ``(n, 2 + n_y)``.
        polynomials: Polynomials of the last steps, which are implicit, ``(m, n_stages, n_y)``.
        detail: Details of an error, if the leg ended in an error.
    """

    status: int
    fell: bool
    duration: float
    end: Vector
    rows: Vector
    polynomials: Vector
    detail: Detail | None


class LegProgram(TapedProblem):
    """A flow and its guard as tapes, in the place of the mode off the stop."""

    def __init__(self, library: Any, mode: ModeFunctions) -> None:
        """Make the tapes.

        Args:
            library: The library.
            mode: The flow and its guard.

        Raises:
            UnknownOperationError: If one of them holds an operation that tapes do not have.
        """
        tapes = [Tape.empty()] * c.TAPES
        tapes[c.RATE], tapes[c.GUARD] = tape_of(mode.rate), tape_of(mode.guard)
        tapes[c.JACOBIAN] = tape_of(mode.jacobian)
        if mode.bounded is not None:
            tapes[c.WATCHED] = tape_of(mode.bounded)
        if mode.longest is not None:
            tapes[c.LONGEST] = tape_of(mode.longest)
        super().__init__(library, tapes, (mode.is_carried,), mode.n_y, 0, mode.n_p)
        self._leg_rooms: list[_Room] = []

    def follow(
        self,
        settings: LegSettings,
        p: Vector,
        y: Vector,
        watch: Callable[[int, float, Vector], None],
    ) -> LegRecord:
        """Return a leg from a state.

        Args:
            settings: Start, end and steps.
            p: Parameters of the flow, ``(n_p,)``.
            y: State at the start, ``(n_y,)``.
            watch: Called with every record of steps: how many, when, and the state there. It may
                raise.
        """
        try:
            room = self._leg_rooms.pop()
        except IndexError:
            room = _Room(self)
        record = self._followed(room, settings, p, y, watch)
        self._leg_rooms.append(room)
        return record

    def _followed(
        self,
        room: _Room,
        settings: LegSettings,
        p: Vector,
        y: Vector,
        watch: Callable[[int, float, Vector], None],
    ) -> LegRecord:
        n_y, records = self.n_x, room.records
        room.fill(settings, p, y)
        begun: int = self.library.zl_begin_leg(
            *(self.address, room.run, room.settings_place, room.p_place, room.y_place),
            *(settings.on_guard, settings.rounding, settings.late),
        )
        rows, polynomials = list[Vector](), list[Vector]()
        status = begun or c.FULL
        while status == c.FULL:
            status = self.library.zl_resume_leg(self.address, room.run, room.records_place)
            n, m = records.n_steps, records.n_polynomials
            if n:
                part = room.rows[:n].copy()
                rows.append(part)
                watch(n, float(part[-1, 0]), part[-1, 2:])
            if m:
                stages = room.polynomials[:m].copy()
                polynomials.append(stages.reshape(m, c.STAGES, n_y))
        failed = status != c.DONE
        return LegRecord(
            status=status,
            fell=room.arc[5] == c.IMPACT,
            duration=float(room.arc[4]),
            end=room.arc[c.ARC_WIDTH + n_y : c.ARC_WIDTH + 2 * n_y].copy(),
            rows=_joined(rows, _NO_ROWS),
            polynomials=_joined(polynomials, _NO_POLYNOMIALS),
            detail=detail_of(self.library, room.run) if failed else None,
        )


class _Room:
    """Memory of a leg and its records, which successive legs reuse."""

    def __init__(self, program: LegProgram) -> None:
        n_y = program.n_x
        self._run = program.borrowed()
        self.run = ctypes.addressof(self._run)
        self._n_y, self._p, self._y = n_y, np.zeros(program.n_p), np.zeros(n_y)
        self.p_place, self.y_place = self._p.ctypes.data, self._y.ctypes.data
        self._weights: tuple[float, ...] | None = None
        self._settings = c.SettingsType(most_steps=2**62, records=1)
        self.settings_place = ctypes.addressof(self._settings)
        self.records = c.RecordsType()
        self.records_place = ctypes.addressof(self.records)
        steps = self._array("steps", _STEPS, c.STEP_WIDTH + n_y + 2)
        stages = self._array("polynomials", _POLYNOMIALS, c.STAGES * (n_y + 2))
        arcs = self._array("arcs", _ROWS, c.ARC_WIDTH + 2 * n_y + 2)
        self._events = self._array("events", _ROWS, c.EVENT_WIDTH + 2 * n_y)
        self.rows, self.polynomials = steps[:, : 2 + n_y], stages[:, : c.STAGES * n_y]
        self.arc: Vector = arcs[0]

    def _array(self, name: str, rows: int, width: int) -> Vector:
        array = np.zeros((rows, width))
        setattr(self.records, name, array.ctypes.data)
        setattr(self.records, f"most_{name}", rows)
        return array

    def fill(self, settings: LegSettings, p: Vector, y: Vector) -> None:
        """Write the initial data of a leg to memory."""
        place = self._settings
        place.until, place.relative = settings.horizon, settings.relative
        place.absolute = settings.absolute
        place.begins_explicit = settings.begins_explicit
        place.goes_implicit = settings.goes_implicit
        place.largest_explicit = settings.largest_explicit
        place.largest_implicit = settings.largest_implicit
        if settings.weights is not self._weights:
            self._weights = settings.weights
            place.weights[: self._n_y] = settings.weights or (1.0,) * self._n_y
        self._p[:], self._y[:] = p, y


def _joined(parts: list[Vector], none: Vector) -> Vector:
    """Return parts as one array, or that for none of them."""
    if not parts:
        return none
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


_programs: WeakKeyDictionary[ModeFunctions, LegProgram | None] = WeakKeyDictionary()


def leg_program(mode: ModeFunctions) -> LegProgram | None:
    """Return the program of one flow, or ``None`` if the library cannot execute it."""
    library = loop_library()
    if library is None or mode.interpreted or mode.n_y + 2 > c.MOST:
        return None
    if mode not in _programs:
        try:
            _programs[mode] = LegProgram(library, mode)
        except UnknownOperationError:
            _programs[mode] = None
    return _programs[mode]
