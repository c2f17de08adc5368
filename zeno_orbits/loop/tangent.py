"""Derivatives of recorded executions in the library: their formulas as tapes, and calls."""

from __future__ import annotations

import ctypes
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import radau_scheme
from zeno_orbits.loop import binding as c
from zeno_orbits.loop.program import Program, fill_tape
from zeno_orbits.loop.run import LoopRecord
from zeno_orbits.loop.tape import Tape, UnknownOperationError, tape_of
from zeno_orbits.model import DerivativeFormulas, LinearFormula


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Settings of the propagation of derivatives.

    Attributes:
        record: The record of a run.
        p: Gains and parameters, ``(n_p,)``.
        restitution: Restitution of the slowest impacts.
        by_parameters: Derivatives of the restitution with respect to the chosen parameters,
            ``(k,)``.
        trusted: Largest relative error of an explicit step that is reused for perturbations.
    """

    record: LoopRecord
    p: Vector
    restitution: float
    by_parameters: Vector
    trusted: float


class TangentProgram:
    """Derivatives of a problem with respect to its states and chosen parameters.

    Attributes:
        address: Address of the tapes.
        work: Numbers of the memory that the derivatives of an execution take.
    """

    def __init__(self, program: Program, formulas: DerivativeFormulas) -> None:
        """Make the tapes.

        Args:
            program: The problem.
            formulas: Its derivatives.

        Raises:
            UnknownOperationError: If one of them holds an operation that tapes do not have.
        """
        self._program = program
        self._n_x, self._n_chosen = formulas.n_x, len(formulas.chosen)
        self._tapes = tuple(_tapes(formulas))
        self._places = tuple(_places(one) for one in formulas.linear)
        self._place = place = c.TangentType()
        place.n_chosen = self._n_chosen
        for k, tape in enumerate(self._tapes):
            fill_tape(place.tapes[k], tape)
        for mode, arrays in enumerate(self._places):
            for name, array in zip(("rows", "columns", "states", "ends"), arrays, strict=True):
                getattr(place, name)[mode] = array.ctypes.data
            place.n_blocks[mode] = arrays[-1].size
        place.matrix[:] = np.ravel(radau_scheme(c.STAGES).matrix).tolist()
        self.address = ctypes.addressof(place)
        self.work: int = program.library.zl_tangent_work(program.address, self.address)

    @property
    def n_columns(self) -> int:
        """States and chosen parameters."""
        return self._n_x + self._n_chosen

    @property
    def width(self) -> int:
        """Number of columns, rounded up to whole lanes."""
        return -(-self.n_columns // c.LANES) * c.LANES

    def follow(self, track: Track, start: Vector, *, joins: bool) -> Vector:
        """Return the derivatives of the start, the end and the state after the end of every arc.

        Args:
            track: The arcs.
            start: Derivatives of the start: rows of time, gap rate and states, ``(2 + n_x, m)``.
            joins: Whether the first event is the impact before the first arc.

        Returns:
            ``(n, 3, 2 + n_x, m)``, for the arcs that have derivatives.
        """
        shifts = np.zeros((1 + len(track.record.arcs), 3, 2 + self._n_x, self.width))
        shifts[0, 2, :, : self.n_columns] = start
        with self._held(track) as (memory, place):
            n: int = self._program.library.zl_follow(
                *(self._program.address, self.address, memory, place, joins, shifts.ctypes.data)
            )
        return shifts[1 : n + 1, :, :, : self.n_columns]

    def course(self, track: Track, v: Vector, q: Vector, parts: int) -> tuple[Vector, Vector]:
        """Return times in an arc and the derivatives of its flow there.

        Args:
            track: The arc.
            v: Derivatives of its first state, ``(n_y, m)``.
            q: Derivatives of the flow's parameters, ``(k, m)``. The speed of a rescaled flight is
                also a parameter.
            parts: Number of outputs per step.

        Returns:
            Times in the flow's own time, ``(n,)``, and derivatives, ``(n, n_y, m)``.
        """
        n = int(track.record.arcs[0, _N_STEPS]) * parts
        times, rows = np.zeros(n), np.zeros((n, len(v), self.width))
        given = self._padded(v), self._padded(q)
        with self._held(track) as (memory, place):
            self._program.library.zl_course(
                *(self._program.address, self.address, memory, place, parts),
                *(array.ctypes.data for array in (*given, times, rows)),
            )
        return times, rows[:, :, : self.n_columns]

    def _padded(self, rows: Vector) -> Vector:
        padded = np.zeros((len(rows), self.width))
        padded[:, : self.n_columns] = rows
        return padded

    @contextmanager
    def _held(self, track: Track) -> Generator[tuple[int, int]]:
        """Hold memory for a call and yield the addresses of a run and of the tracked execution."""
        record, arrays = track.record, list[Vector]()

        def address(array: Vector) -> int:
            arrays.append(np.ascontiguousarray(array, dtype=np.float64))
            return int(arrays[-1].ctypes.data)

        place = c.TrackType()
        place.steps, place.polynomials = address(record.steps), address(record.polynomials)
        place.arcs, place.events = address(record.arcs), address(record.events)
        place.n_arcs, place.n_events = len(record.arcs), len(record.events)
        place.trusted, place.restitution = track.trusted, address(track.by_parameters)
        width = c.ESTIMATE_WIDTH + 2 * self._n_x
        place.estimates = address(np.empty((1 + len(record.arcs), width)))
        place.work = address(np.empty(self.work))
        settings = c.SettingsType()
        settings.restitution = track.restitution
        memory = self._program.borrowed()
        try:
            self._program.library.zl_begin(
                *(self._program.address, ctypes.addressof(memory), ctypes.addressof(settings)),
                *(address(track.p), address(np.zeros(c.MOST))),
            )
            yield ctypes.addressof(memory), ctypes.addressof(place)
        finally:
            self._program.give_back(memory)


_N_STEPS = 8
"""Column of an arc's row with its number of steps."""

_made: WeakKeyDictionary[DerivativeFormulas, dict[Program, TangentProgram | None]] = (
    WeakKeyDictionary()
)


def tangent_of(program: Program, formulas: DerivativeFormulas) -> TangentProgram | None:
    """Return the derivatives of a problem, or ``None`` if tapes do not have their operations.

    Args:
        program: The problem.
        formulas: Its derivatives.
    """
    known = _made.setdefault(formulas, {})
    if program not in known:
        try:
            known[program] = TangentProgram(program, formulas)
        except UnknownOperationError:
            known[program] = None
    return known[program]


def _tapes(formulas: DerivativeFormulas) -> Iterator[Tape]:
    """Yield the tapes of derivatives in the order of `tangent.h`."""
    for one in formulas.linear:
        yield tape_of(one.entries)
    yield tape_of(formulas.contact)
    yield tape_of(formulas.reset)
    yield tape_of(formulas.rebound, parameters=0)
    yield tape_of(formulas.resting)


def _places(formula: LinearFormula) -> tuple[NDArray[np.int32], ...]:
    """Return rows and columns of entries, the states block after block, and where blocks end."""
    states = [state for block in formula.blocks for state in block]
    ends = np.cumsum([len(block) for block in formula.blocks])
    lists: tuple[Sequence[int], ...] = (formula.rows, formula.columns, states, ends.tolist())
    return tuple(np.array(numbers, dtype=np.int32) for numbers in lists)
