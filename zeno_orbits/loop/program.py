"""A problem in the library's format: its formulas as tapes, made once for all parameter values."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import radau_scheme
from zeno_orbits.loop import binding as c
from zeno_orbits.loop.formulas import formulas_digest, machine_source, view_number
from zeno_orbits.loop.library import (
    compile_library,
    compiled_library,
    loop_library,
)
from zeno_orbits.loop.tape import Tape, UnknownOperationError, tape_of
from zeno_orbits.loop.views import View
from zeno_orbits.model import (
    GAP,
    GAP_ACCELERATION,
    GAP_RATE,
    MULTIPLIER_RATE,
    CompiledSystem,
    ModeFunctions,
)


class TapedProblem:
    """Formulas as tapes, and the memory for their evaluation."""

    def __init__(
        self, library: Any, tapes: Sequence[Tape], carried: Sequence[bool], *sizes: int
    ) -> None:
        """Write the tapes to memory.

        Args:
            library: The library.
            tapes: The formulas in the order of `loop.h`. The last formulas may be missing.
            carried: For each mode, whether the guard is a state in addition to its formula.
            sizes: Numbers of states, coordinates and parameters.
        """
        self.library = library
        self._code = c.CodeType()
        self._compiled: Any = None
        self.n_x, self.n_q, self.n_p = sizes
        self.tapes = tuple(tapes)
        self.problem = c.ProblemType(n_x=self.n_x, n_q=self.n_q, n_p=self.n_p)
        self.problem.carried[: len(carried)] = list(map(int, carried))
        for k, tape in enumerate(self.tapes):
            fill_tape(self.problem.tapes[k], tape)
        self._scheme = scheme()
        self.problem.scheme = ctypes.addressof(self._scheme)
        self.problem.code = ctypes.addressof(self._code)
        self.address = ctypes.addressof(self.problem)
        self._alone = _Alone(library, self.address)
        self.problem.graph = ctypes.addressof(self._alone.table)
        self._size: int = library.zl_size(self.address)
        self._spare: list[Any] = []
        self._rooms: list[_StepRoom] = []

    @property
    def is_compiled(self) -> bool:
        """True if the formulas are compiled. The digits are equal either way."""
        return self._compiled is not None

    def load(self, digest: str) -> None:
        """Use compiled formulas from now on, if they are in the cache.

        Args:
            digest: Digest of the formulas.
        """
        self.use(compiled_library(digest))

    def use(self, compiled: Any) -> None:
        """Use compiled formulas from now on, also in runs that have begun.

        Args:
            compiled: Their library, or ``None`` for the tapes.
        """
        self._compiled = compiled
        for name in ("one", "lanes"):
            code: Any = None if compiled is None else getattr(compiled, f"zl_{name}")
            setattr(self._code, name, code and ctypes.cast(code, ctypes.c_void_p).value)

    def compile_views(self, digest: str, views: Iterable[TapedProblem]) -> None:
        """Compile the formulas of views now and use them from now on.

        Args:
            digest: Digest of the formulas, by which they are found.
            views: The formulas.

        Raises:
            KernelError: If the compilation fails. The message contains the reason.
        """
        tapes = {view.problem.formulas: view.tapes for view in views}
        compile_library(digest, lambda: machine_source(self.n_x, tapes))
        self.load(digest)

    @property
    def n_stops(self) -> int:
        """Number of stops."""
        return 1

    @property
    def n_declared(self) -> int:
        """Number of declared switches."""
        return 0

    @property
    def size(self) -> int:
        """Size of a run in bytes."""
        return self._size

    def borrowed(self) -> Any:
        """Return memory for a run."""
        try:
            return self._spare.pop()
        except IndexError:
            return ctypes.create_string_buffer(self._size)

    def give_back(self, memory: Any) -> None:
        """Take back memory that a run no longer needs."""
        self._spare.append(memory)

    def states_after(
        self, p: Vector, mode: int, speed: float, before: Vector, sizes: Vector
    ) -> Vector:
        """Return the states after explicit steps, each from a state of its own, ``(n, n_y)``.

        Args:
            p: Parameters, ``(n_p,)``.
            mode: Mode of the flow.
            speed: Unit of time of a rescaled flight.
            before: States before the steps, ``(n, n_y)``.
            sizes: Sizes of the steps, in the flow's own time, ``(n,)``.
        """
        try:
            room = self._rooms.pop()
        except IndexError:
            room = _StepRoom(self)
        library = self.library
        if room.numbers is not p:
            room.p[:], room.numbers = p, p
            library.zl_begin(self.address, room.run, room.settings, room.p_place, room.x_place)
        before, sizes = np.ascontiguousarray(before), np.ascontiguousarray(sizes)
        states = np.empty(before.shape)
        library.zl_states_at(
            *(self.address, room.run, mode, speed, before.ctypes.data),
            *(sizes.ctypes.data, len(sizes), states.ctypes.data),
        )
        self._rooms.append(room)
        return states


class _Alone:
    """Tables of a graph with one stop, whose only view is a problem."""

    def __init__(self, library: Any, address: int) -> None:
        self._zero = ctypes.c_longlong(0)
        zero = ctypes.addressof(self._zero)
        self.table = c.GraphType(n_stops=1, n_views=1, n_numbers=library.zl_room(address))
        self.table.view_keys, self.table.view_places, self.table.views = zero, zero, address


class _StepRoom:
    """Memory for single steps, shared by flows. `numbers` are the parameters stored in it."""

    def __init__(self, program: TapedProblem) -> None:
        self._memory, self._settings = program.borrowed(), c.SettingsType()
        self.run, self.settings = ctypes.addressof(self._memory), ctypes.addressof(self._settings)
        self.numbers: Vector | None = None
        self.p, self._x = np.zeros(program.n_p), np.zeros(c.MOST)
        self.p_place, self.x_place = self.p.ctypes.data, self._x.ctypes.data


class Program(TapedProblem):
    """The formulas of a problem, and memory for its runs."""

    def __init__(self, library: Any, system: CompiledSystem) -> None:
        """Make the tapes.

        Args:
            library: The library.
            system: The formulas.

        Raises:
            UnknownOperationError: If one of them holds an operation that tapes do not have.
        """
        carried = [mode.is_carried for mode in (system.free, system.locked, system.flight)]
        sizes = (system.n_x, system.n_q, system.free.n_p)
        super().__init__(library, tuple(_tapes(system)), carried, *sizes)
        self.digest = formulas_digest(self.n_x, self.tapes)
        self.problem.formulas = view_number(self.digest)
        self.load(self.digest)

    @property
    def views(self) -> dict[View, Program]:
        """The only view, which is this problem."""
        return {View((), 0, ()): self}

    def compile(self) -> None:
        """Compile the formulas now and use them from now on.

        Raises:
            KernelError: If the compilation fails. The message contains the reason.
        """
        self.compile_views(self.digest, [self])
        for other in _programs.values():
            if isinstance(other, Program) and other.digest == self.digest:
                other.load(self.digest)


_programs: WeakKeyDictionary[ModeFunctions, Program | str] = WeakKeyDictionary()


def program_of(system: CompiledSystem) -> Program | None:
    """Return the program of a problem, or ``None`` if the library cannot execute it."""
    found = program_or_reason(system)
    return None if isinstance(found, str) else found


def program_or_reason(system: CompiledSystem) -> Program | str:
    """Return the program of a problem, or the reason why it does not exist, as a clause."""
    library = loop_library()
    if library is None:
        return "the library is missing"
    if system.free.interpreted:
        return "its formulas are to be interpreted"
    found = _programs.get(system.free)
    if found is None:
        found = _made(library, system)
        _programs[system.free] = found
    return found


def refusals() -> list[str]:
    """Return the reasons why the library does not support formulas of this process, as clauses."""
    found = [reason for reason in _programs.values() if isinstance(reason, str)]
    return [f"some executions run in Python: {reason}" for reason in dict.fromkeys(found)]


def _made(library: Any, system: CompiledSystem) -> Program | str:
    if system.n_x + 2 > c.MOST:
        return f"a problem has {system.n_x} states, and the loop takes {c.MOST - 2}"
    try:
        return Program(library, system)
    except UnknownOperationError as error:
        return f"a formula holds the operation `{error}`"


def _tapes(system: CompiledSystem) -> Iterator[Tape]:
    """Yield the tapes of a problem in the order of `loop.h`."""
    modes = (system.free, system.locked, system.flight)
    for mode in modes:
        yield tape_of(mode.rate)
    for mode in modes:
        yield tape_of(mode.guard)
    for mode in modes:
        yield tape_of(mode.jacobian)
    for mode in modes:
        yield Tape.empty() if mode.bounded is None else tape_of(mode.bounded)
    yield tape_of(system.contact, wanted=[(0, GAP), (0, GAP_RATE)])
    yield tape_of(system.contact, wanted=[(0, GAP_ACCELERATION)])
    yield tape_of(system.contact, wanted=[(0, MULTIPLIER_RATE)])
    yield tape_of(system.impulse, wanted=[(1, 0)])
    yield tape_of(system.rebound, parameters=0)
    yield tape_of(system.resting)
    yield tape_of(system.landing)
    for mode in modes:
        yield Tape.empty() if mode.longest is None else tape_of(mode.longest)


def fill_tape(place: Any, tape: Tape) -> None:
    """Write a tape to memory. The tape must outlive the memory."""
    place.n_varying, place.n_parameters = tape.n_varying, tape.n_parameters
    place.n_constants, place.n_registers = tape.constants.size, tape.n_registers
    place.n_once, place.n_first = tape.n_once, tape.n_first
    place.n_instructions, place.n_outputs = len(tape.code), tape.outputs.size
    place.code, place.constants = tape.code.ctypes.data, tape.constants.ctypes.data
    place.outputs = tape.outputs.ctypes.data
    place.tables = tape.table_places.ctypes.data


@cache
def scheme() -> c.SchemeType:
    """Return the implicit scheme as the library has it."""
    place, chosen = c.SchemeType(), radau_scheme(c.STAGES)
    gamma, embedded = chosen.embedded
    place.gamma = gamma
    values = [[mu.real, mu.imag] for mu in chosen.spectrum.values]
    columns = [[column.real, column.imag] for column in chosen.spectrum.columns]
    rows = [[row.real, row.imag] for row in chosen.spectrum.rows]
    for name, numbers in (
        ("nodes", chosen.nodes),
        ("inverse", chosen.inverse),
        ("monomials", chosen.monomials),
        ("embedded", embedded),
        ("values", values),
        ("columns", columns),
        ("rows", rows),
    ):
        field: Vector = np.frombuffer(getattr(place, name), dtype=np.float64)
        field[:] = np.ravel(np.array(numbers, dtype=np.float64))
    return place
