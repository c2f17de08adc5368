"""A whole leg in one call of compiled code: `follow.c`, the loop of the stepping engines in C.

The loop in Python is the reference, and the fall-back where there is no compiled code. Both take
the same steps, and so leave the same record of them, to rounding.
"""

from __future__ import annotations

import ctypes
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.collocation import Collocation
from zeno_orbits.integrators.engine import Leg, Outcome, Passage, Step
from zeno_orbits.integrators.events import SteppedTrajectory
from zeno_orbits.integrators.flow import flow_eigenvalues
from zeno_orbits.integrators.steps import ExplicitStep, RadauStep, not_finite, too_small
from zeno_orbits.kernels import KernelLibrary

_CAPACITY = 256
"""Steps that one call records; longer legs take several."""

ENDINGS = (Outcome.FALL, Outcome.HORIZON, Outcome.LEFT)
"""What a call returns at the end of a leg, in the order of `follow.c`."""

_FULL, _FAR, _EXPLICIT_SINGULAR, _IMPLICIT_SINGULAR, _NOT_FINITE, _RATES = range(3, 9)
"""What else it returns."""


class StepLoop(NamedTuple):
    """The loop of an engine.

    Attributes:
        explicit: It begins with explicit steps.
        implicit: It takes implicit ones, from the beginning or once they pay.
        largest_explicit: No explicit step is longer, in the time of the flow.
        largest_implicit: No implicit step is longer.
        scheme: Of the implicit steps.
    """

    explicit: bool
    implicit: bool
    largest_explicit: float
    largest_implicit: float
    scheme: Collocation | None


@cache
def _leg_type(n_y: int, n_stages: int) -> type[ctypes.Structure]:
    """Return the type `Leg` of `follow.c`."""
    number, count, address = ctypes.c_double, ctypes.c_longlong, ctypes.c_void_p
    numbers = "horizon relative absolute rounding largest_explicit largest_implicit time size "
    numbers += "last_size earlier_size fastest first largest_change offset"
    arrays = {"guard": 2, "y": n_y, "end": n_y, "reach": n_y, "eigenvalues": 2 * n_y}
    arrays["coefficients"] = n_stages * n_y
    counts = "switches implicit on_guard started refused has_last has_rates n_steps n_explicit "
    counts += "n_recorded n_polynomials capacity"
    fields = [
        *((name, number) for name in numbers.split()),
        *((name, number * length) for name, length in arrays.items()),
        *((name, count) for name in counts.split()),
        *((name, address) for name in ("p", "rows", "polynomials")),
    ]
    return type("_Leg", (ctypes.Structure,), {"_fields_": fields})


class LegCode:
    """The compiled loop of a mode at numbers that are read anew for every leg."""

    def __init__(self, library: KernelLibrary, p: Vector, n_y: int, scheme: Collocation) -> None:
        """Make room for a leg.

        Args:
            library: Of the kernels of the mode, with the loop.
            p: Parameters of the flow, read in place.
            n_y: Number of states.
            scheme: Of the implicit steps that were compiled.
        """
        self._follow = library.function("zk_follow")
        self._scheme = scheme
        self._kept = p
        self._rows = np.zeros((_CAPACITY, 2 + n_y))
        self._polynomials = np.zeros((_CAPACITY, scheme.n_stages, n_y))
        self._leg: Any = _leg_type(n_y, scheme.n_stages)()
        self._given = ctypes.byref(self._leg)
        self._leg.capacity = _CAPACITY
        self._leg.p, self._leg.rows, self._leg.polynomials = (
            array.ctypes.data for array in (p, self._rows, self._polynomials)
        )
        self._y = np.frombuffer(self._leg.y, dtype=np.float64)
        self._end = np.frombuffer(self._leg.end, dtype=np.float64)
        self._reach = np.frombuffer(self._leg.reach, dtype=np.float64)
        self._reach[:] = math.inf
        self._bound: Vector | None = None
        self._rates = np.frombuffer(self._leg.eigenvalues, dtype=np.float64).reshape(2, n_y)

    def serves(self, loop: StepLoop) -> bool:
        """Return True if this loop was compiled."""
        return not loop.implicit or loop.scheme is self._scheme

    def follow(self, leg: Leg, loop: StepLoop) -> Passage:
        """Follow a flow until its guard falls through zero or the time is over.

        Args:
            leg: The leg; its flow is the one whose numbers are in place.
            loop: What steps to take.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        self._begin(leg, loop)
        own = self._leg
        chunks: list[_Chunk] = []
        while True:
            ending: int = self._follow(self._given)
            n = own.n_recorded
            if n:
                rows, n_implicit = self._rows[:n].copy(), own.n_polynomials
                polynomials = self._polynomials[:n_implicit].copy() if n_implicit else _NO_STEPS
                chunks.append((rows, polynomials))
                leg.watch(n, rows[-1, 0], rows[-1, 2:])
            if ending < len(ENDINGS):
                break
            self._go_on(leg, ending)
        outcome = ENDINGS[ending]
        duration: float = own.time
        state = self._end.copy()
        if outcome is Outcome.FALL:
            duration += own.offset
        elif outcome is Outcome.HORIZON:
            duration = leg.horizon
        trajectory = RecordedTrajectory(leg, chunks, self._scheme, duration, state)
        return Passage(outcome=outcome, duration=duration, state=state, trajectory=trajectory)

    def _begin(self, leg: Leg, loop: StepLoop) -> None:
        own, tolerance = self._leg, leg.tolerance
        own.started = False
        own.horizon, own.rounding = leg.horizon, leg.rounding
        own.relative, own.absolute = tolerance.relative, tolerance.absolute
        own.largest_explicit, own.largest_implicit = loop.largest_explicit, loop.largest_implicit
        own.switches = loop.explicit and loop.implicit
        own.implicit = not loop.explicit
        own.on_guard = leg.on_guard
        self._y[:] = leg.y
        if leg.reach is not self._bound:
            self._bound = leg.reach
            self._reach[:] = math.inf
            if leg.reach is not None:
                self._reach[: leg.reach.size] = leg.reach

    def _go_on(self, leg: Leg, ending: int) -> None:
        """Do what the loop cannot do by itself, or raise what it met."""
        own = self._leg
        if ending == _RATES:
            values = flow_eigenvalues(leg.flow, self._rows[own.n_recorded, 2:])
            self._rates[:] = values.real, values.imag
            own.has_rates = 1
        elif ending == _NOT_FINITE:
            raise not_finite(leg.y)
        elif ending == _EXPLICIT_SINGULAR:
            raise too_small("the flow is too stiff or singular", own.time, self._y)
        elif ending == _IMPLICIT_SINGULAR:
            raise too_small("the flow is singular", own.time, self._y)


class CompilableFlow(ABC):
    """A guarded flow whose legs compiled code may follow."""

    @abstractmethod
    def leg_code(self) -> LegCode | None:
        """Return the compiled loop over the steps of a leg, if there is one by now."""

    @abstractmethod
    def owe(self, seconds: float) -> None:
        """Hear of time that compiled code would have saved [s]; in the end that repays it."""


_Chunk = tuple[Vector, Vector]
"""Start, size and state after of each step, ``(n, 2 + n_y)``, and polynomials of the last of them,
which are the implicit ones."""

_NO_STEPS = np.zeros((0, 0, 0))


class RecordedTrajectory:
    """The flow along a leg, its steps made of their record once somebody asks for one."""

    __slots__ = ("_chunks", "_leg", "_scheme", "_way", "duration", "end")

    def __init__(
        self,
        leg: Leg,
        chunks: Sequence[_Chunk],
        scheme: Collocation,
        duration: float,
        end: Vector,
    ) -> None:
        """Keep the record.

        Args:
            leg: The leg.
            chunks: Its steps in order.
            scheme: Of the implicit ones.
            duration: Where the leg ends.
            end: State there, ``(n_y,)``.
        """
        self._leg, self._chunks, self._scheme = leg, chunks, scheme
        self.duration, self.end = duration, end
        self._way: SteppedTrajectory | None = None

    @property
    def steps(self) -> Sequence[Step]:
        """The steps, at least one."""
        return self.stepped().steps

    @property
    def times(self) -> Vector:
        """Starts of the steps, and the end, ``(m,)``."""
        return self.stepped().times

    @property
    def states(self) -> Vector:
        """State at each of these times, ``(m, n_y)``."""
        return self.stepped().states

    def state_at(self, offset: float) -> Vector:
        """Return the state at a time from the start."""
        return self.stepped().state_at(offset)

    def stepped(self) -> SteppedTrajectory:
        """Return the same in steps."""
        if self._way is None:
            steps = tuple(self._made())
            self._way = SteppedTrajectory(steps=steps, duration=self.duration, end=self.end)
        return self._way

    def _made(self) -> Iterator[Step]:
        before = self._leg.y
        for rows, polynomials in self._chunks:
            first = len(rows) - len(polynomials)
            for k, (start, size) in enumerate(rows[:, :2].tolist()):
                after = rows[k, 2:]
                coefficients = polynomials[k - first] if k >= first else None
                yield self._step(start, size, before, after, coefficients)
                before = after

    def _step(
        self, start: float, size: float, before: Vector, after: Vector, coefficients: Vector | None
    ) -> Step:
        flow, tolerance = self._leg.flow, self._leg.tolerance
        if coefficients is None:
            return ExplicitStep(flow, tolerance, start, size, before, after)
        return RadauStep(
            flow=flow,
            scheme=self._scheme,
            tolerance=tolerance,
            start=start,
            size=size,
            before=before,
            after=after,
            coefficients=coefficients,
        )
