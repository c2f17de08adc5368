r"""Orbits at changing values, with exact derivatives of quantities along the orbits.

At values `p` the start of the orbit solves :math:`x = P(x, p)`. So it moves by

.. math:: \frac{dx}{dp} = (1 - P_x)^{-1} P_p,\qquad
    \frac{dQ}{dp} = Q_x \frac{dx}{dp} + Q_p

for every quantity `Q` of an event, the energy and every peak of a signal. A direction in which a
return has no effect does not count.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector, spectral_radius
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import GraphDynamics, ParameterValues, Problem
from zeno_orbits.orbits import (
    ENERGY,
    PERIOD,
    Bound,
    EventCourse,
    EventQuantities,
    EventReturn,
    EventSequence,
    Reading,
    StepError,
    closed_return,
    course_signal_names,
    multipliers_of_return,
    objection_to,
    orbit_event_name,
    sequence_of,
    start_by_parameters,
)
from zeno_orbits.search.closing.closing import indices_of, settled_return
from zeno_orbits.search.measures import Slope
from zeno_orbits.search.objectives import LEAST_RADIUS
from zeno_orbits.simulation import Extent, SimulationSettings
from zeno_orbits.verification import EVENT_MARGINS, SHARE, measured_margin

MOST_PEAKS = 6
"""Number of extremes of a signal that are rows of a program: those nearest to the bound."""
RADIUS = "spectral_radius"
"""Name of the spectral radius among the quantities of an orbit."""

MARGINS = (SHARE, *EVENT_MARGINS)
"""Names of the margins among the quantities of an orbit."""
DIFFERENCED = (RADIUS, *MARGINS)
"""Quantities whose derivatives are differences."""

_STEP = 1e-4
"""Difference of a free value for such a derivative, in units of its range."""


class NoEventError(StepError):
    """The event of an objective or of a bound does not occur in an orbit.

    Attributes:
        argument: Argument that asks for the event.
    """

    def __init__(self, argument: str, message: str) -> None:
        super().__init__(message)
        self.argument = argument


@dataclass(frozen=True, kw_only=True)
class OrbitAtValues:
    """An orbit of events at given values.

    Attributes:
        values: The values.
        graph: The graph of modes there.
        found: The periodic return.
        chosen: Places of the free values in the parameter vector.
    """

    values: ParameterValues
    graph: GraphDynamics
    found: EventReturn
    chosen: tuple[int, ...]

    @cached_property
    def quantities(self) -> EventQuantities:
        """The quantities of its events."""
        return EventQuantities.of(self.graph, self.found, self.chosen)

    @cached_property
    def moved(self) -> Vector:
        """Derivative of its start with respect to the free values, ``(n_x, k)``."""
        return start_by_parameters(self.graph, self.found)

    @property
    def radius(self) -> float:
        """Spectral radius of the return."""
        multipliers = multipliers_of_return(self.graph, self.found)
        return spectral_radius(multipliers)

    def slope(self, reading: Reading) -> Slope:
        """Return a value with its derivative along the orbits.

        Args:
            reading: The value with its derivatives with respect to start and values.
        """
        n_x = len(self.found.start)
        return Slope(value=reading.value, by=reading.by[:n_x] @ self.moved + reading.by[n_x:])

    @cached_property
    def course(self) -> EventCourse:
        """Work and signals along the orbit."""
        return EventCourse(graph=self.graph, found=self.found, parameters=self.chosen)

    def is_signal(self, name: str) -> bool:
        """Return True for a signal, False for a number of the whole orbit or of an event."""
        return name in course_signal_names(self.graph.compiled)

    def slopes(self, name: str) -> list[Slope]:
        """Return the values of a number of the orbit or of its events, in order of time.

        Args:
            name: The energy, the period or a quantity of an event.

        Raises:
            NoEventError: If the event of the quantity does not occur.
        """
        if name == ENERGY:
            return [self.slope(self.course.work)]
        slopes = [self.slope(one) for one in self.quantities.readings(name)]
        if not slopes:
            raise NoEventError("bounds", self._lacks(name))
        return slopes

    def extent(self, name: str) -> Extent:
        """Return the range of a quantity.

        Args:
            name: Name of a signal, of a number of the orbit or of a quantity of an event.

        Raises:
            NoEventError: If the event of the quantity does not occur.
        """
        if self.is_signal(name):
            return self.course.extent(name)
        if name == RADIUS:
            return Extent(lowest=self.radius, highest=self.radius)
        if name in MARGINS:
            return Extent(lowest=self.number(name), highest=self.number(name))
        values = [one.value for one in self.slopes(name)]
        return Extent(lowest=min(values), highest=max(values))

    def number(self, name: str) -> float:
        """Return the spectral radius or a margin, whose derivatives are differences.

        Args:
            name: Its name.

        Raises:
            NoEventError: If the event of the margin does not occur.
        """
        if name == RADIUS:
            return self.radius
        margin = measured_margin(name, self.graph, self.found)
        if margin is None:
            raise NoEventError("bounds", self._lacks(name))
        return margin

    def _lacks(self, name: str) -> str:
        events = sequence_of([orbit_event_name(event) for event in self.found.events])
        return f"`{name}` does not occur in the orbit with the events `{', '.join(events)}`"

    def peaks(self, signal: str, sign: float, most: int = MOST_PEAKS) -> list[Slope]:
        """Return the largest local extremes of a signal times a sign, in order of time.

        Args:
            signal: Name of the signal.
            sign: 1 or -1.
            most: Largest number of extremes.
        """
        found = self.course.peaks(signal, sign, most)
        return [self.slope(one.reading).scaled(sign) for one in found]

    def amplitude(self, state: str) -> Slope:
        """Return half the range of a state over the period."""
        (most,), (least,) = self.peaks(state, 1.0, 1), self.peaks(state, -1.0, 1)
        return (most + least).scaled(0.5)

    def objection(self, bounds: Sequence[Bound]) -> str:
        """Return a clause with the violated bounds, empty without any.

        Args:
            bounds: The bounds.

        Raises:
            NoEventError: If the event of a bound does not occur.
        """
        return objection_to(bounds, {bound.name: self.extent(bound.name) for bound in bounds})

    def peak_costs(self, signal: str) -> tuple[Slope, ...]:
        """Return the largest absolute extremes of a signal, `MOST_PEAKS` of them.

        Where there are fewer, the others are zero, which no absolute value is below.

        Args:
            signal: Name of the signal.
        """
        found = [*self.peaks(signal, 1.0), *self.peaks(signal, -1.0)]
        kept = largest_of(found)
        return (*kept, *self._padding(len(kept), 0.0))

    def rows(self, bound: Bound, size: float) -> list[Slope]:
        """Return the distances of a quantity from its bounds, positive inside, in units of a size.

        Every bound has `MOST_PEAKS` rows: of the values nearest to it, in order of time, and of
        constants that it keeps. The period and the energy have one row.

        Args:
            bound: The bound on anything but the spectral radius or a margin.
            size: The size.

        Raises:
            NoEventError: If the event of a quantity does not occur.
        """
        is_signal = self.is_signal(bound.name)
        slopes = [] if is_signal else self.slopes(bound.name)
        rows: list[Slope] = []
        for sign, end in ((-1.0, -bound.lower), (1.0, bound.upper)):
            if not np.isfinite(end):
                continue
            if is_signal:
                signed = self.peaks(bound.name, sign)
            else:
                signed = largest_of([one.scaled(sign) for one in slopes])
            rows += [one.scaled(-1 / size, end) for one in signed]
            if bound.name not in (PERIOD, ENERGY):
                rows += self._padding(len(signed), 1.0)
        return rows

    def _padding(self, n: int, value: float) -> list[Slope]:
        """Return constants that complete a list of a number of values."""
        return [Slope(value=value, by=np.zeros(len(self.chosen)))] * (MOST_PEAKS - n)

    def _stops(self, stop: str) -> tuple[str, ...]:
        return (stop,) if stop else self.graph.stop_names

    def impact_speed(self, stop: str) -> dict[str, float]:
        """Return the fastest first impact of every stop that is struck.

        Args:
            stop: Name of a stop, or an empty text for all stops.
        """
        found = {one: self.quantities.extent(f"{one}.impact_speed") for one in self._stops(stop)}
        return {one: extent.highest for one, extent in found.items() if extent is not None}

    def impact_cost(self, stop: str, quantity: str) -> Slope:
        """Return a quantity of impacts, summed over stops and sequences.

        Args:
            stop: Name of a stop, or an empty text for all stops.
            quantity: Word of the quantity, such as ``energy_lost``.

        Raises:
            NoEventError: If no such event occurs.
        """
        names = [f"{one}.{quantity}" for one in self._stops(stop)]
        readings = [one for name in names for one in self.quantities.readings(name)]
        if not self.impact_speed(stop) or not readings:
            where = f"on `{stop}`" if stop else "on any stop"
            raise NoEventError("objective", f"`{quantity}` does not occur {where}")
        total = self.slope(readings[0])
        for one in readings[1:]:
            total += self.slope(one)
        return total


def largest_of(slopes: Sequence[Slope]) -> list[Slope]:
    """Return the `MOST_PEAKS` largest values, in their order.

    Args:
        slopes: The values.
    """
    places = sorted(range(len(slopes)), key=lambda k: -slopes[k].value)[:MOST_PEAKS]
    # The order stays that of time, so that a value keeps its place.
    return [slopes[k] for k in sorted(places)]


@dataclass(kw_only=True)
class OrbitsOverValues:
    """Orbits at changing values, each found from the last one that belongs to the same corner.

    Attributes:
        problem: The problem.
        values: Values of everything that is neither free nor at a corner.
        names: Names of the free values.
        simulation: Accuracy.
        starts: Initial states of motions that settle, name to value, where an orbit is lost. The
            default is the problem's own.
        shape: Phases of the orbits of a machine with the stop `stop`, or ``None`` for any.
        n_orbits: Number of orbits so far.
    """

    problem: Problem
    values: ParameterValues
    names: tuple[str, ...]
    simulation: SimulationSettings
    starts: tuple[Mapping[str, float], ...] = ()
    shape: EventSequence | None = None
    n_orbits: int = 0
    _last: dict[tuple[tuple[str, float], ...], EventReturn] = field(
        default_factory=dict["tuple[tuple[str, float], ...]", EventReturn]
    )

    def begin(self, found: EventReturn, corner: Mapping[str, float] | None = None) -> None:
        """Take the first orbit, or the first orbit at a corner.

        Args:
            found: The orbit.
            corner: Values of the uncertain parameters, in their order.
        """
        self._last[tuple((corner or {}).items())] = found

    def at(
        self, numbers: Vector, corner: dict[str, float], *, settles: bool = True
    ) -> OrbitAtValues:
        """Return the orbit at free values and a corner of uncertain parameters.

        Args:
            numbers: The free values, ``(k,)``.
            corner: Values of the uncertain parameters.
            settles: Whether a motion is simulated until it settles if no orbit is near the last.
                This takes long where motions decay slowly.

        Raises:
            SimulationError: If no orbit is found near the last orbit.
        """
        free = dict(zip(self.names, map(float, numbers), strict=True))
        values = self.values.replaced({**corner, **free})
        key = tuple(corner.items())
        near = self._last.get(key, self._last[()])
        section = orbit_event_name(near.events[-1])
        graph, chosen = self.problem.graph_dynamics(values), indices_of(values, self.names)
        try:
            found = self._closed(graph, near, section, chosen)
        except SimulationError:
            if not settles:
                raise
            try:
                settled = settled_return(
                    self.problem,
                    values,
                    starts=self.starts,
                    section=section,
                    shape=self.shape,
                    simulation=self.simulation,
                )
            except InputError as error:
                raise StepError(str(error)) from error
            if _returns(settled, section) != _returns(near, section):
                # Another orbit would be followed from here on.
                raise SimulationError(
                    "The orbit is lost: the motion converges to another attractor",
                    time=settled.period,
                    state=tuple(settled.start.tolist()),
                ) from None
            found = self._closed(graph, settled, section, chosen)
        self.n_orbits += 1
        self._last[key] = found
        return OrbitAtValues(values=values, graph=graph, found=found, chosen=chosen)

    def _closed(
        self, graph: GraphDynamics, near: EventReturn, section: str, chosen: Sequence[int]
    ) -> EventReturn:
        return closed_return(
            graph,
            near.start,
            section=section,
            n_returns=_returns(near, section),
            guess=near.period,
            settings=self.simulation,
            parameters=chosen,
            # A stop that moves may otherwise pass the last start.
            mode=near.mode,
        )

    def differenced(
        self,
        name: str,
        point: OrbitAtValues,
        numbers: Vector,
        ranges: Vector,
        corner: dict[str, float],
    ) -> Slope:
        """Return the spectral radius or a margin, with its derivative by central differences.

        Args:
            name: Its name.
            point: The orbit at the free values.
            numbers: The free values, ``(k,)``.
            ranges: Their ranges, ``(k, 2)``.
            corner: Values of the uncertain parameters.

        Raises:
            NoEventError: If the event of the margin does not occur.
        """
        by = np.zeros(len(numbers))
        for k, (low, high) in enumerate(ranges):
            ends = [
                min(max(numbers[k] + sign * _STEP * (high - low), low), high) for sign in (-1, 1)
            ]
            found = [
                self.at(np.where(np.arange(len(numbers)) == k, end, numbers), corner).number(name)
                for end in ends
            ]
            by[k] = (found[1] - found[0]) / (ends[1] - ends[0])
        value = point.number(name)
        return Slope(value=max(value, LEAST_RADIUS) if name == RADIUS else value, by=by)


def _returns(found: EventReturn, section: str) -> int:
    """Return how often an orbit passes its section in a period."""
    return sum(orbit_event_name(event) == section for event in found.events)
