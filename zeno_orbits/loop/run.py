"""A run of the loop, which can be started, resumed and queried, and its record."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.loop import binding as c
from zeno_orbits.loop.program import TapedProblem

_STEPS, _POLYNOMIALS, _ARCS, _EVENTS = 1024, 256, 128, 128
"""Rows of the records that one call writes."""
_ESTIMATES = 64
"""Impacts of a sequence for which there is memory at first."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """Accuracy and limits of a run.

    Attributes:
        until: End time [s].
        relative: Local error of a step, as a part of an entry.
        absolute: The same in the weights of the entries.
        contact: Relative threshold, in the problem's scales, below which a guard counts as zero.
        restitution: Restitution of the slowest impacts.
        time: Scale of times. The next four entries are also scales.
        gap: Scale of the gap.
        gap_rate: Scale of its rate.
        gap_acceleration: Scale of its second derivative.
        multiplier: Scale of the multiplier.
        sizes: Size of each state, ``(n_x,)``.
        weights: Size of each state in which a local error is absolute, ``(n_x,)``.
        flight_weights: The same of a rescaled flight, ``(n_x + 2,)``.
        reach: Bound of each coordinate, ``(n_q,)``, by default infinite.
        begins_explicit: Whether the first steps of a leg are explicit.
        goes_implicit: Whether implicit steps are used when they pay.
        largest_explicit: Largest explicit step, in the time of the flow.
        largest_implicit: Largest implicit step.
        completion: How a sequence of impacts ends: a constant of `binding`.
        limit_tolerance: Largest estimated error of a Zeno point.
        resolved: Part of the first speed down to which impacts are resolved.
        delta: Speed at which a sequence is cut, for that rule.
        n_fixed: Impacts of a sequence, for that rule.
        most_releases: Number of releases after which the run ends.
        most_landings: Number of impacts that end a flight, after which the run ends.
        most_steps: Largest number of steps of a run.
        most_impacts: Largest number of impacts of a sequence.
        records: Whether steps and arcs are recorded.
        past: One more than the index of the switch that has just occurred at the start, 0 for none,
            -1 for any.
        varies: Whether the restitution depends on the speed of an impact.
    """

    until: float
    relative: float
    absolute: float
    contact: float
    restitution: float
    time: float
    gap: float
    gap_rate: float
    gap_acceleration: float
    multiplier: float
    sizes: Sequence[float]
    weights: Sequence[float]
    flight_weights: Sequence[float]
    reach: Sequence[float]
    begins_explicit: bool
    goes_implicit: bool
    largest_explicit: float
    largest_implicit: float
    completion: int
    limit_tolerance: float
    resolved: float
    delta: float
    n_fixed: float
    most_releases: float
    most_landings: float
    most_steps: int
    most_impacts: int
    records: bool = True
    past: int = 0
    varies: bool = False

    def filled(self) -> c.SettingsType:
        """Return the same as the library has it."""
        place = c.SettingsType()
        for name in self.__slots__:
            value = getattr(self, name)
            if name in ("sizes", "weights", "flight_weights", "reach"):
                getattr(place, name)[: len(value)] = value
            else:
                setattr(place, name, value)
        return place


def filled(settings: Sequence[RunSettings]) -> Any:
    """Return accuracy and limits at every stop as the library has them.

    Args:
        settings: The settings, one for each stop.
    """
    return (c.SettingsType * len(settings))(*(one.filled() for one in settings))


@dataclass(slots=True, kw_only=True)
class LoopRecord:
    """Record of a run, with the columns defined in `loop.h`.

    Attributes:
        steps: One row per step: start, size, state after, ``(n, 2 + n_x + 2)``.
        polynomials: Polynomials of implicit steps, ``(n, n_stages * (n_x + 2))``.
        arcs: One row per arc.
        events: One row per event.
    """

    steps: Vector
    polynomials: Vector
    arcs: Vector
    events: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Detail:
    """Details of a status.

    Attributes:
        time: Time of the event, or the flow's time of a failed step.
        state: State at that time.
        number: A value for the message.
        steps: A number of steps for the message.
        index: Index of a state, stop or switch.
        about: Further stops, switches and events.
    """

    time: float
    state: Vector
    number: float
    steps: float
    index: int
    about: tuple[int, ...]


def detail_of(library: Any, place: int) -> Detail:
    """Return the details of the last status of a run.

    Args:
        library: The library.
        place: Address of the run.
    """
    told = c.DetailType()
    library.zl_tell(place, ctypes.addressof(told))
    return Detail(
        time=told.time,
        state=np.array(told.state[: told.n_state]),
        number=told.number,
        steps=told.steps,
        index=told.index,
        about=tuple(told.about),
    )


_KINDS = ("steps", "polynomials", "arcs", "events")


class _Buffers:
    """Memory into which one call writes its records."""

    def __init__(self, most: tuple[int, ...], widths: tuple[int, ...]) -> None:
        self.arrays = [np.empty(shape) for shape in zip(most, widths, strict=True)]
        self.places = c.RecordsType()
        for name, rows, array in zip(_KINDS, most, self.arrays, strict=True):
            setattr(self.places, name, array.ctypes.data)
            setattr(self.places, f"most_{name}", rows)

    def written(self) -> tuple[Vector, ...]:
        """Return the rows that the call has written, one array a kind."""
        places = self.places
        counts = (places.n_steps, places.n_polynomials, places.n_arcs, places.n_events)
        return tuple(array[:n].copy() for array, n in zip(self.arrays, counts, strict=True))


def _least_rows(program: TapedProblem, settings: Any) -> tuple[int, ...]:
    """Return the rows of records that one event needs. `has_room` in C has the same numbers."""
    events = 2 + 4 * program.n_stops + program.n_declared
    return (*((1, 1, 3) if settings[0].records else (0, 0, 0)), events)


class LoopRun:
    """One execution in the library. It can be resumed after every status but an error."""

    def __init__(self, program: TapedProblem, settings: Any, p: Vector, x: Vector) -> None:
        """Begin a run.

        Args:
            program: The problem.
            settings: Accuracy and limits at every stop, as `filled` returns them.
            p: Gains and parameters, ``(n_p,)``.
            x: Admissible state, ``(n_x,)``.
        """
        n = program.n_x
        self._program = program
        self._memory = program.borrowed()
        self._place = ctypes.addressof(self._memory)
        self._widths = (
            c.STEP_WIDTH + n + 2,
            c.STAGES * (n + 2),
            c.ARC_WIDTH + 2 * n + 2,
            c.EVENT_WIDTH + 2 * n,
        )
        self._estimates = np.empty((_ESTIMATES, c.ESTIMATE_WIDTH + 2 * n))
        self._parts = list[tuple[Vector, ...]]()
        self._spare = _spare.setdefault(program, {})
        self._settings, self._p = settings, np.ascontiguousarray(p, dtype=np.float64)
        self._least = _least_rows(program, settings)
        self.restart(x)

    @property
    def least_events(self) -> int:
        """Rows of the record of events that one event may need."""
        return self._least[-1]

    @property
    def _library(self) -> Any:
        return self._program.library

    def restart(self, x: Vector) -> None:
        """Begin again at another state.

        Args:
            x: Admissible state, ``(n_x,)``.
        """
        state = np.ascontiguousarray(x, dtype=np.float64)
        self._parts.clear()
        self._library.zl_begin(
            self._program.address,
            self._place,
            ctypes.addressof(self._settings),
            self._p.ctypes.data,
            state.ctypes.data,
        )

    def close(self) -> None:
        """Free the memory. Afterwards the run cannot be resumed."""
        if self._memory is not None:
            self._program.give_back(self._memory)
            self._memory = None

    def resume(
        self,
        *,
        steps: int = _STEPS,
        polynomials: int = _POLYNOMIALS,
        arcs: int = _ARCS,
        events: int = _EVENTS,
    ) -> int:
        """Continue until the run ends, a record is full or the caller has to act.

        Args:
            steps: Rows of the record of steps.
            polynomials: Rows of the record of polynomials.
            arcs: Rows of the record of arcs, at least 3.
            events: Rows of the record of events, at least 2, 4 for each stop and 1 for each
                declared switch: one event may strike and open every stop.

        Returns:
            A status of `loop.h`. A request of memory for estimates is already handled.

        Raises:
            ValueError: If a record has too few rows: the run could not continue.
        """
        most = (steps, polynomials, arcs, events)
        for kind, given, fewest in zip(_KINDS, most, self._least, strict=True):
            if given < fewest:
                raise ValueError(f"Argument `{kind}` must be at least {fewest}, but it is {given}.")
        return self._carried(most, lambda places: (places,), "zl_resume")

    def turns(self, pair: c.PairType, count: int) -> int:
        """Follow two motions side by side up to a number of turns, without records.

        Args:
            pair: The motions. The run is at the start of the first one, or was left by a status.
            count: Number of turns in all.

        Returns:
            A status as of `resume`.
        """
        place = ctypes.addressof(pair)
        most = (0, 0, 0, _EVENTS)
        status = self._carried(most, lambda places: (places, place, count), "zl_turns")
        self._parts.clear()
        return status

    def _carried(
        self, most: tuple[int, ...], arguments: Callable[[int], tuple[int, ...]], function: str
    ) -> int:
        """Return the status of a function that carries the run on, with memory for its records."""
        # The tables may grow while this run goes on: it takes them first, then memory for them.
        address = self._program.address
        self._grow()
        spare = self._spare.setdefault(most, [])
        try:
            buffers = spare.pop()
        except IndexError:
            buffers = _Buffers(most, self._widths)
        places, call = buffers.places, getattr(self._library, function)
        status = c.ESTIMATES
        while status == c.ESTIMATES:
            places.estimates = self._estimates.ctypes.data
            places.most_estimates = len(self._estimates)
            status = call(address, self._place, *arguments(ctypes.addressof(places)))
            self._parts.append(buffers.written())
            if status == c.ESTIMATES:
                more = np.empty((4 * len(self._estimates), self._estimates.shape[1]))
                more[: len(self._estimates)] = self._estimates
                self._estimates = more
        spare.append(buffers)
        return int(status)

    def _grow(self) -> None:
        """Take more memory if the tables of the problem have grown."""
        if self._memory is None or len(self._memory) >= self._program.size:
            return
        more, size = self._program.borrowed(), len(self._memory)
        self._place = ctypes.addressof(more)
        ctypes.memmove(more, self._memory, size)
        # Of another run the new views hold formulas at other parameters.
        ctypes.memset(self._place + size, 0, len(more) - size)
        self._memory = more

    def answer(self, found: tuple[float, float, Vector] | None) -> None:
        """Answer the status ``CURVE``.

        Args:
            found: Time, error and state of the Zeno point, if the curve was followed to it.
        """
        time, error, state = found if found is not None else (0.0, 0.0, np.zeros(0))
        padded = np.zeros(c.MOST)
        padded[: state.size] = state
        self._library.zl_answer(
            self._place, int(found is not None), time, error, padded.ctypes.data
        )

    def outlook(self) -> c.OutlookType:
        """Return what the run looks at."""
        outlook = c.OutlookType()
        self._library.zl_outlook_of(self._place, ctypes.addressof(outlook))
        return outlook

    def detail(self) -> Detail:
        """Return the details of the last status."""
        return detail_of(self._library, self._place)

    def now(self) -> tuple[float, int, Vector]:
        """Return time, mode and state that the run has reached."""
        mode, state = ctypes.c_int(0), np.empty(self._program.n_x)
        time = self._library.zl_now(
            self._program.address, self._place, ctypes.addressof(mode), state.ctypes.data
        )
        return time, mode.value, state

    def flight(
        self, state_plus: Vector, speed: float, relative: float, absolute: float
    ) -> tuple[float, Vector, float] | None:
        """Return one rescaled flight: its duration, the state and the gap rate at its end.

        Args:
            state_plus: State after an impact, ``(n_x,)``.
            speed: Gap rate there.
            relative: Local error of a step.
            absolute: The same in the weights of the states.
        """
        given = np.ascontiguousarray(state_plus, dtype=np.float64)
        landing = np.empty(2 + given.size)
        found = self._library.zl_flight(
            *(self._program.address, self._place, given.ctypes.data, speed, relative, absolute),
            landing.ctypes.data,
        )
        return (float(landing[0]), landing[2:], float(landing[1])) if found else None

    def evaluate(self, tape: int, varying: Vector, n_outputs: int) -> Vector:
        """Return a formula of the problem, ``(n_outputs,)``.

        Args:
            tape: Index of the formula in `loop.h`.
            varying: Varying inputs of the formula, the state first.
            n_outputs: Entries of the result.
        """
        given, outputs = np.ascontiguousarray(varying, dtype=np.float64), np.empty(n_outputs)
        self._library.zl_evaluate(
            *(self._program.address, self._place, tape, given.ctypes.data, outputs.ctypes.data)
        )
        return outputs

    def copy(self) -> LoopRun:
        """Return an independent copy of the run in its present state."""
        other: LoopRun = object.__new__(LoopRun)
        other._program = self._program
        other._memory = self._program.borrowed()
        other._place = ctypes.addressof(other._memory)
        other._widths = self._widths
        other._estimates = self._estimates.copy()
        other._parts = list(self._parts)
        other._spare = self._spare
        other._settings, other._p = self._settings, self._p
        other._least = self._least
        self._library.zl_copy(self._program.address, self._place, other._place)
        return other

    def taken(self) -> LoopRecord:
        """Return the record since the last call, and clear it."""
        record = self.record()
        self._parts.clear()
        return record

    def record(self) -> LoopRecord:
        """Return everything that was recorded so far and not taken."""
        if len(self._parts) != 1:
            nothing = tuple(np.empty((0, width)) for width in self._widths)
            kinds = zip(nothing, *self._parts, strict=True)
            self._parts = [tuple(np.concatenate(parts) for parts in kinds)]
        steps, polynomials, arcs, events = self._parts[0]
        return LoopRecord(steps=steps, polynomials=polynomials, arcs=arcs, events=events)


_spare: WeakKeyDictionary[TapedProblem, dict[tuple[int, ...], list[_Buffers]]] = WeakKeyDictionary()
"""Memory of earlier calls, by the numbers of its rows."""
