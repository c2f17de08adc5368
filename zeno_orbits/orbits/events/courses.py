r"""Integrals and peaks along a periodic return, with exact derivatives.

With the perturbation `V` at a fixed time since the start of an arc, the work of an arc from
:math:`t_0` to :math:`t_1` moves by

.. math:: \delta \int P\,dt = \int (P_x V + P_p)\,dt + P(t_1)\,(\delta t_1 - \delta t_0)

A rescaled flight has the unit of time `w`, and its work also moves with :math:`\delta w`. At a
peak inside an arc the signal is stationary, so a shift of its time has no effect:
:math:`\delta f = f_x V + f_p`. At an event `V` is the derivative of the state on either side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import CompiledGraph, GraphDynamics, GraphMode
from zeno_orbits.orbits.events.quantities import Reading
from zeno_orbits.orbits.events.section import EventReturn
from zeno_orbits.simulation import ArcPassage, Extent, ZenoPoint, signal, signal_names

ENERGY = "energy"
"""Name of the electrical work of a period."""

_POWER = ""
"""Stands for the electrical power among the names of signals."""
_PARTS = 6
_WEIGHTS = np.array([41, 216, 27, 272, 27, 216, 41]) / 840
"""Closed rule of Newton and Cotes for six parts of a step: its error falls with the ninth power."""
_SAMPLES = 65
"""Samples of an arc for peaks, in addition to the steps of the integrator."""
_POSITION = 1e-10
"""Error of the position of a peak, as a part of its arc. The value has the square of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeakReading:
    """A local extreme of a signal, or its value at an end of an arc.

    Attributes:
        time: Its time [s].
        reading: The value.
    """

    time: float
    reading: Reading


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """A sample that may be a peak.

    Attributes:
        passage: The arc.
        around: The flow's own times of the sample and of its neighbours.
        value: The signal there.
    """

    passage: ArcPassage
    around: tuple[float, float, float]
    value: float

    @property
    def is_inside(self) -> bool:
        """True if it is not an end of the arc."""
        return self.around[0] < self.around[1] < self.around[2]


@dataclass(frozen=True, kw_only=True)
class EventCourse:
    """Work and signals along a return.

    Attributes:
        graph: The graph of modes.
        found: The return.
        parameters: Indices in ``p`` of the parameters of its derivatives.
    """

    graph: GraphDynamics
    found: EventReturn
    parameters: tuple[int, ...]

    @cached_property
    def work(self) -> Reading:
        """The electrical work of the period [J]."""
        total = Reading(value=0.0, by=np.zeros(len(self.found.start) + len(self.parameters)))
        for passage in self.found.passages:
            total += self._work(passage)
        return total

    def extent(self, name: str) -> Extent:
        """Return the range of a signal over the period.

        Args:
            name: Name of the signal.
        """
        (lowest,), (highest,) = self.peaks(name, -1.0, 1), self.peaks(name, 1.0, 1)
        return Extent(lowest=lowest.reading.value, highest=highest.reading.value)

    def peaks(self, name: str, sign: float, most: int) -> list[PeakReading]:
        """Return the largest local extremes of a signal, in order of time.

        An end of an arc also counts, with the state on its side of an event.

        Args:
            name: Name of the signal.
            sign: 1 for the largest values, -1 for the smallest.
            most: Largest number of extremes. There is at least one.
        """
        places = sorted(self._places(name, sign), key=lambda one: -sign * one.value)
        # A refinement can change the order of two samples.
        found = [self._refined(name, sign, one) for one in places[: 2 * most]]
        found.sort(key=lambda one: -sign * one.reading.value)
        return sorted(found[:most], key=lambda one: one.time)

    # Work.

    def _work(self, passage: ArcPassage) -> Reading:
        arc = passage.arc
        if arc.trajectory is None:
            return self._work_of_tail(passage)
        unit = arc.time_unit
        times, moved = self.found.differentiation.course(passage, parts=_PARTS)
        values, by = self._along(_POWER, passage, arc.flow_states_at(times), moved)
        n_steps = (len(times) - 1) // _PARTS
        weights = np.zeros(len(times))
        for step in range(n_steps):
            first = step * _PARTS
            size = times[first + _PARTS] - times[first]
            weights[first : first + _PARTS + 1] += size * _WEIGHTS
        total = float(weights @ values)
        longer = passage.end.time - passage.start.time
        slope = unit * weights @ by + values[-1] * longer
        if arc.stop:
            slope += (total - arc.duration * values[-1]) * passage.start.rate
        return Reading(value=unit * total, by=slope)

    def _work_of_tail(self, passage: ArcPassage) -> Reading:
        """Return the work in the tail of an impact sequence, in which the mean gap rate is zero."""
        arc = passage.arc
        zeno = next(event for event, _, _ in passage.crossings if isinstance(event, ZenoPoint))
        rested, moved = self.found.differentiation.rested(passage, zeno.stop)
        states = np.array([rested, arc.end_state])
        values, by = self._along(_POWER, passage, states, np.array([moved, passage.end.state]))
        time = arc.end_time - arc.start_time
        longer = passage.end.time - passage.start.time
        return Reading(
            value=time * float(np.mean(values)),
            by=time * np.mean(by, axis=0) + longer * np.mean(values),
        )

    # Peaks.

    def _places(self, name: str, sign: float) -> Iterator[_Place]:
        """Yield the samples that are not below a neighbour in their arc."""
        for passage in self.found.passages:
            arc = passage.arc
            times = np.linspace(0.0, arc.duration, _SAMPLES)
            times = np.union1d(times, arc.flow_times) if arc.duration > 0.0 else times[:1]
            signed = sign * self._values(name, passage, self._states(passage, times))
            last = len(times) - 1
            for k in range(len(times)):
                low, high = max(k - 1, 0), min(k + 1, last)
                if signed[k] < signed[low] or signed[k] < signed[high]:
                    continue
                if 0 < k < last and signed[k] == signed[low] == signed[high]:
                    # A constant signal has its ends.
                    continue
                around = (float(times[low]), float(times[k]), float(times[high]))
                yield _Place(passage=passage, around=around, value=sign * float(signed[k]))

    def _refined(self, name: str, sign: float, place: _Place) -> PeakReading:
        # SciPy's optimizers take a while to import.
        from scipy.optimize import minimize_scalar

        passage, (low, offset, high) = place.passage, place.around
        arc, value = passage.arc, place.value
        if place.is_inside:

            def below(at: float) -> float:
                states = self._states(passage, np.array([at]))
                return -sign * float(self._values(name, passage, states)[0])

            inside: Any = minimize_scalar(
                below,
                bounds=(low, high),
                method="bounded",
                options={"xatol": _POSITION * arc.duration},
            )
            if -float(inside.fun) > sign * value:
                offset, value = float(inside.x), -sign * float(inside.fun)
        state, moved = self._moved(passage, offset)
        _, by = self._along(name, passage, state[None], moved[None])
        unit = arc.time_unit
        reading = Reading(value=value, by=by[0])
        return PeakReading(time=arc.start_time + unit * offset, reading=reading)

    def _moved(self, passage: ArcPassage, offset: float) -> tuple[Vector, Vector]:
        """Return a state of an arc with its derivatives, ``(n_x, m)``."""
        arc = passage.arc
        if offset <= 0.0:
            return arc.start_state, passage.start.state
        if offset >= arc.duration:
            return arc.end_state, passage.end.state
        offsets = np.array([offset])
        state = self._states(passage, offsets)[0]
        if arc.trajectory is None:
            part = offset / arc.duration
            return state, (1 - part) * passage.start.state + part * passage.end.state
        return state, self.found.differentiation.within(passage, offsets)[0]

    # States and formulas.

    def _states(self, passage: ArcPassage, offsets: Vector) -> Vector:
        """Return the states of an arc at the flow's own times, ``(n, n_x)``. Its ends are exact."""
        arc = passage.arc
        if arc.trajectory is None:
            part = (offsets / (arc.duration or 1.0))[:, None]
            states = (1 - part) * arc.start_state + part * arc.end_state
        else:
            states = arc.flow_states_at(offsets)[:, : arc.start_state.size]
        states[offsets <= 0.0] = arc.start_state
        if arc.duration > 0.0:
            states[offsets >= arc.duration] = arc.end_state
        return states

    def _values(self, name: str, passage: ArcPassage, states: Vector) -> Vector:
        """Return a signal at states of an arc, ``(n,)``."""
        value: Any = self._formulas(name, passage)[0](states.T, self.graph.p)
        return np.asarray(value.full(), dtype=np.float64).ravel()

    def _along(
        self, name: str, passage: ArcPassage, states: Vector, moved: Vector
    ) -> tuple[Vector, Vector]:
        """Return a signal and its derivatives at states with derivatives, ``(n,)`` and ``(n, m)``.

        Args:
            name: Name of the signal.
            passage: The arc.
            states: The states, ``(n, n_x)`` or with further columns.
            moved: Their derivatives, ``(n, n_x, m)``.
        """
        n_x, n = len(self.found.start), len(states)
        called: Any = self._formulas(name, passage)[1](states[:, :n_x].T, self.graph.p)
        value, by_x, by_p = (np.asarray(one.full(), dtype=np.float64) for one in called)
        by = np.einsum("ni,nim->nm", by_x.reshape(n, n_x), moved)
        by[:, n_x:] += by_p.reshape(n, -1)[:, list(self.parameters)]
        return np.ravel(value), by

    def _formulas(self, name: str, passage: ArcPassage) -> tuple[ca.Function, ca.Function]:
        arc = passage.arc
        mode, stop = self.graph.some_stop(arc.mode_in(self.graph))
        return _formulas_of(self.graph.compiled, mode, stop, name)


@lru_cache(maxsize=256)
def _formulas_of(
    compiled: CompiledGraph, mode: GraphMode, stop: int, name: str
) -> tuple[ca.Function, ca.Function]:
    """Return ``(x, p) -> value``, and the same with its derivatives with respect to x and p."""
    system = compiled.system(mode, stop)
    x, p = ca.SX.sym("x", system.n_x), ca.SX.sym("p", system.powers.numel_in(1))
    value = system.powers(x, p)[0] if name == _POWER else signal(system, name).function(x, p)
    by = [ca.densify(ca.jacobian(value, one)) for one in (x, p)]
    return ca.Function("value", [x, p], [value]), ca.Function("slope", [x, p], [value, *by])


def course_signal_names(compiled: CompiledGraph) -> tuple[str, ...]:
    """Return the names of the signals of a machine: states, then motors' currents and voltages.

    Args:
        compiled: Its functions.
    """
    sides = (True,) * len(compiled.graph.conditions)
    return signal_names(compiled.system(((), sides), 0))


def has_source(compiled: CompiledGraph) -> bool:
    """Return True if a source or an external force can deliver energy to a machine.

    Args:
        compiled: Its functions.
    """
    system = compiled.system(((), (True,) * len(compiled.graph.conditions)), 0)
    x, p = ca.SX.sym("x", system.n_x), ca.SX.sym("p", system.powers.numel_in(1))
    return not system.powers(x, p)[0].is_zero()
