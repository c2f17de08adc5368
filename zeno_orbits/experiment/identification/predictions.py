"""Predictions of samples by an orbit, and exact derivatives with respect to the fit's unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.experiment.comparison.folding import Fold, Folded
from zeno_orbits.experiment.identification.event_period import (
    EventPeriod,
    OrbitSlope,
    event_period,
    orbit_slope,
)
from zeno_orbits.experiment.identification.unknowns import Unknowns
from zeno_orbits.experiment.orbit_table import Measurement, measurement
from zeno_orbits.model import Problem
from zeno_orbits.orbits import EventReturn, closed_return, orbit_event_name
from zeno_orbits.simulation import SimulationSettings

_KEPT = 64
"""Orbits that are remembered."""
_MORE, _EVENTS = 6, 120
"""An orbit of more events than so many times those at the start, and so many, is not followed."""
_STEPS = 4
"""Steps in which an orbit is followed to other unknowns, at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slopes:
    """Derivatives with respect to the unknowns.

    Attributes:
        signals: Derivatives of the recorded signals at the samples, ``(n, n_s, k + 1)``.
        period: Derivative of the recorded period, ``(k + 1,)`` [s].
    """

    signals: Vector
    period: Vector


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EventTimes:
    """Recorded times of the events of an orbit, since the start of its period.

    Attributes:
        names: Names of the events, such as ``impact closed``, in order of time.
        times: Their times, the last one at the end of the period, ``(n,)`` [s].
        period: The period [s].
    """

    names: tuple[str, ...]
    times: Vector
    period: float

    def stretched(self, factor: float) -> EventTimes:
        """Return them by a clock that is faster by a factor."""
        return replace(self, times=self.times * factor, period=self.period * factor)


class Predictions:
    """Orbits at unknowns. The search for the next orbit starts from the last accepted orbit."""

    def __init__(
        self, problem: Problem, unknowns: Unknowns, measured: Measurement, near: EventReturn
    ) -> None:
        """Start at an orbit.

        Args:
            problem: The problem.
            unknowns: The unknowns.
            measured: The recorded signals.
            near: The return of the orbit.
        """
        self.unknowns = unknowns
        self._problem, self._near, self._measured = problem, near, measured
        self._graph = problem.graph_dynamics(unknowns.base)
        self._settings = SimulationSettings()
        self._most = _MORE * len(near.events) + _EVENTS
        self._instruments = unknowns.instruments(measured.names)
        self._tables: Callable[[bytes], EventPeriod] = lru_cache(_KEPT)(self._tabulated)
        self._slopes: Callable[[bytes], OrbitSlope] = lru_cache(_KEPT)(self._differentiated)

    def table(self, x: Vector) -> EventPeriod:
        """Return the orbit at unknowns.

        Raises:
            SimulationError: If no orbit is found near the last accepted orbit.
        """
        try:
            return self._tables(self.unknowns.p_at(x).tobytes())
        except InputError as error:
            # The search for an orbit may leave the states that a simulation accepts.
            raise SimulationError("No orbit is found there", time=0.0, state=()) from error

    def of_both(self, other: Predictions) -> Predictions:
        """Return predictions of the channels of two files, with the unknowns of the second one."""
        names = [*self._measured.names, *other._measured.names]
        unknowns = replace(other.unknowns, elsewhere=())
        return Predictions(self._problem, unknowns, measurement(self._problem, names), self._near)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the recorded signals."""
        return self._measured.names

    def shift(self, x: Vector, data: Folded) -> float | Vector:
        """Return the delay of the orbit at the rows of samples, in periods."""
        return float(x[-1]) + data.late(float(self._instruments.delay @ self.unknowns.numbers(x)))

    def accept(self, x: Vector) -> None:
        """Start the next searches from the orbit at these unknowns."""
        self._near = self.table(x).found

    def events(self, x: Vector) -> EventTimes:
        """Return the times of the events of the orbit at unknowns.

        Raises:
            SimulationError: If no orbit is found near the last accepted orbit.
        """
        stretch = self._instruments.stretch(self.unknowns.numbers(x))
        return self._events(x).stretched(stretch)

    def event_slopes(self, x: Vector) -> Vector:
        """Return the exact derivatives of the times of the events, ``(n, k + 1)`` [s]."""
        return self._recorded_times(x, self._events(x).times, self._event_slopes(x))

    def starting_at(self, x: Vector) -> Self:
        """Return predictions that search for orbits near the orbit at these unknowns.

        Raises:
            SimulationError: If the orbit is lost on the way there.
        """
        found = self._copy()
        begin, done, step = self.unknowns.first, 0.0, 1.0
        while done < 1.0:
            try:
                found.accept(begin + min(done + step, 1.0) * (x - begin))
                done += step
            except SimulationError as error:
                step /= 2.0
                if step * _STEPS < 1.0:
                    raise SimulationError("No orbit is found there", time=0.0, state=()) from error
        return found

    def fold(self, x: Vector, data: Folded) -> Fold:
        """Return the orbit at the phases of samples, as the channels read it."""
        fold = data.predicted(self.table(x), self.shift(x, data))
        return self._instruments.fold(fold, self.unknowns.numbers(x))

    def bends(self, x: Vector, data: Folded) -> Vector:
        """Return the uncertainty of predicted means of a signal that is curved within a bin."""
        gain = self._instruments.gain(self.unknowns.numbers(x))
        return data.bends(self.table(x), self.shift(x, data)) * gain

    def slopes(self, x: Vector, data: Folded) -> Slopes:
        """Return the exact derivatives of the predicted samples (theory (6.11))."""
        unknowns, table, instruments = self.unknowns, self.table(x), self._instruments
        fold = data.predicted(table, self.shift(x, data))
        slope = self._slopes(table.p.tobytes())
        states = slope.at(fold.times)
        n_x = states.shape[1]
        by = self._measured.derivatives(table.states.at(fold.times), table.p)
        moved = by[:, :, :n_x] @ states + by[:, :, n_x:][:, :, list(unknowns.places)]
        # At a fixed phase a longer period means a later time.
        share = fold.times / table.period
        moved += fold.slopes[:, :, None] * share[:, None, None] * slope.period
        late = -fold.slopes[:, :, None] * table.period
        gain = instruments.gain(unknowns.numbers(x))[:, None]
        read = gain * (moved @ unknowns.ties) + instruments.by_numbers(fold.values)
        if data.clocks is not None:
            read += gain * late * data.clocks[:, None, None] * instruments.delay
        return Slopes(
            signals=np.concatenate([read * unknowns.scale, gain * late], axis=2),
            period=self._recorded_times(
                x, np.array([table.period]), slope.period[None] @ unknowns.ties
            )[0],
        )

    def _recorded_times(self, x: Vector, times: Vector, by: Vector) -> Vector:
        """Return the derivatives of recorded times from those of times, ``(n, k + 1)`` [s].

        Args:
            x: The unknowns.
            times: The times by the machine's clock, ``(n,)`` [s].
            by: Their derivatives with respect to the values of the unknowns, ``(n, k)``.
        """
        unknowns, instruments = self.unknowns, self._instruments
        recorded = instruments.stretch(unknowns.numbers(x)) * by + np.outer(times, instruments.rate)
        return np.concatenate([recorded * unknowns.scale, np.zeros((len(times), 1))], axis=1)

    def _events(self, x: Vector) -> EventTimes:
        """Return the times of the events at unknowns by the machine's clock."""
        found = self.table(x).found
        return EventTimes(
            names=tuple(orbit_event_name(event) for event in found.events),
            times=np.array([event.time for event in found.events]),
            period=found.period,
        )

    def _event_slopes(self, x: Vector) -> Vector:
        """Return the derivatives of these times by the values of the unknowns, ``(n, k)``."""
        table = self.table(x)
        times = np.array([shift.time for shift in table.found.shifts])
        return times @ table.moved @ self.unknowns.ties

    def _copy(self) -> Self:
        """Return the same predictions without remembered orbits."""
        return type(self)(self._problem, self.unknowns, self._measured, self._near)

    def _tabulated(self, key: bytes) -> EventPeriod:
        """Return the orbit at gains and parameters, given as bytes."""
        near, graph = self._near, self._graph.at(np.frombuffer(key))
        section = orbit_event_name(near.events[-1])
        found = closed_return(
            graph,
            near.start,
            section=section,
            n_returns=sum(orbit_event_name(event) == section for event in near.events),
            guess=near.period,
            settings=self._settings,
            parameters=self.unknowns.places,
            mode=near.mode,
            by_returns=True,
        )
        if len(found.events) > self._most:
            raise SimulationError("Too many events per period", time=0.0, state=())
        return event_period(graph, found, self._measured)

    def _differentiated(self, key: bytes) -> OrbitSlope:
        """Return the derivatives of this orbit with respect to the parameters that vary."""
        return orbit_slope(self._tables(key))
