r"""Quantities of the events of a period, named after their stop or switch, with exact derivatives.

A sequence of impacts on a stop begins with an impact that no faster impact on it precedes. It ends
at a Zeno point, a release, an impact on another stop or a reset.

`STOP.impact_speed`
    Speed of the first impact of a sequence.
`STOP.impacts`, `STOP.impacts@SPEED`
    Number of impacts in the period that are faster than 1 % of the first of their sequence, or than
    a stated speed. The number of resolved impacts would depend on the settings.
`STOP.bounce_time`
    Time from the first impact of a sequence to its Zeno point.
`STOP.impact_time`, `STOP.zeno_time`, `STOP.release_time`, `SWITCH.time`
    Time of the first impact, Zeno point, release or switch since the last zero phase of the clock,
    or since the start of the period without a steady clock.
`STOP.energy_lost`
    Kinetic energy lost in the impacts of a period. With the Delassus matrix
    :math:`G = J W J^\top` and the set `S` of stops that stay closed, an impact on `k` takes

    .. math:: \frac{1 - e^2}{2}\,\frac{\dot h_k^2}{s},\qquad
        s = G_{kk} - G_{kS}\,G_{SS}^{-1}\,G_{Sk}

    The impacts after the last resolved impact take the rest :math:`e^2 \dot h_k^2 / (2 s)`, the sum
    of a geometric series.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import GraphDynamics, unknown
from zeno_orbits.orbits.events.section import EventReturn
from zeno_orbits.simulation import (
    Event,
    Extent,
    Impact,
    Release,
    SaltationDerivative,
    SwitchEvent,
    ZenoPoint,
    state_before,
    steady_turn,
)

_COUNTED = 1e-2
"""Part of the speed of the first impact of a sequence above which an impact counts."""
_CLOSED = 1e-9
"""Gap and gap rate of a closed stop, relative to their scales."""
_AT_ZERO = 1e-9
"""Part of a turn before the zero phase of the clock that counts as zero."""

_OF_STOP = (
    "impact_speed",
    "impacts",
    "bounce_time",
    "impact_time",
    "zeno_time",
    "release_time",
    "energy_lost",
)
"""Words of the quantities of a stop."""
_OF_SWITCH = ("time",)
"""Words of the quantities of a switch."""
PERIOD = "period"
"""Name of the period among the quantities of an orbit of events."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A value of a quantity, and its derivative.

    Attributes:
        value: The value.
        by: Its derivative with respect to the start and the parameters, ``(m,)``. Empty without
            derivatives.
    """

    value: float
    by: Vector

    def __add__(self, other: Reading) -> Reading:
        """Return the sum."""
        return Reading(value=self.value + other.value, by=self.by + other.by)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Moment:
    """An event of a period with the derivatives of its time and of the state before it."""

    event: Event
    shift: SaltationDerivative


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sequence:
    """Impacts on a stop, and the Zeno point to which they accumulate, if they do."""

    impacts: tuple[_Moment, ...]
    zeno: _Moment | None


@dataclass(frozen=True, kw_only=True)
class EventQuantities:
    """The quantities of one period.

    Attributes:
        graph: The graph of modes.
        start: State at the start of the period, ``(n_x,)``.
        period: The period [s].
        events: Events of the period. The period ends at the last event.
        shifts: Derivatives of the events, with the state before each. Empty without derivatives.
        parameters: Indices in ``p`` of the parameters of the derivatives.
    """

    graph: GraphDynamics
    start: Vector
    period: float
    events: tuple[Event, ...]
    shifts: tuple[SaltationDerivative, ...] = ()
    parameters: tuple[int, ...] = ()

    @classmethod
    def of(
        cls, graph: GraphDynamics, found: EventReturn, parameters: Sequence[int] = ()
    ) -> EventQuantities:
        """Return the quantities of a return, with derivatives.

        Args:
            graph: The graph of modes.
            found: The return.
            parameters: Indices in ``p`` of the parameters of its derivatives.
        """
        return cls(
            graph=graph,
            start=found.start,
            period=found.period,
            events=(*found.events, *found.opened),
            shifts=(*found.shifts, *found.shifts[-1:] * len(found.opened)),
            parameters=tuple(parameters),
        )

    def extent(self, name: str) -> Extent | None:
        """Return the range of a quantity over the period, ``None`` if its event does not occur.

        Args:
            name: Name of the quantity.

        Raises:
            InputError: If the name is unknown.
        """
        values = [reading.value for reading in self.readings(name)]
        return Extent(lowest=min(values), highest=max(values)) if values else None

    def table(self) -> dict[str, Extent]:
        """Return the quantities whose events occur, name to range."""
        found = {name: self.extent(name) for name in event_quantity_names(self.graph)}
        return {name: extent for name, extent in found.items() if extent is not None}

    def readings(self, name: str) -> list[Reading]:
        """Return the values of a quantity in the period, in order of time.

        Args:
            name: Name of the quantity.

        Raises:
            InputError: If the name is unknown.
        """
        if name == PERIOD:
            return [self._period]
        owner, word, speed = _parts_of(name, self.graph, "name")
        if word == "time":
            return [self._time(one) for one in self._moments if _is_switch(one, owner)]
        if word == "release_time":
            return [
                self._time(one)
                for one in self._moments
                if isinstance(one.event, Release) and one.event.stop == owner
            ]
        if word == "impacts":
            return [self._count(owner, speed)]
        if word == "energy_lost":
            return [self.energy_lost(owner)]
        by_word: Mapping[str, Callable[[_Sequence], Reading | None]] = {
            "impact_speed": lambda one: _speed(one.impacts[0]),
            "impact_time": lambda one: self._time(one.impacts[0]),
            "bounce_time": self._bounce_time,
            "zeno_time": lambda one: None if one.zeno is None else self._time(one.zeno),
        }
        found = [by_word[word](one) for one in self._sequences(owner)]
        return [reading for reading in found if reading is not None]

    def energy_lost(self, stop: str) -> Reading:
        """Return the kinetic energy lost in the impacts on a stop in a period.

        Args:
            stop: Name of the stop.
        """
        total = Reading(value=0.0, by=np.zeros(self._width))
        for sequence in self._sequences(stop):
            for one in sequence.impacts:
                total += self._loss(one, rest=False)
            if sequence.zeno is not None:
                total += self._loss(sequence.impacts[-1], rest=True)
        return total

    # Events and sequences.

    @property
    def _width(self) -> int:
        """Number of columns of the derivatives."""
        return len(self.start) + len(self.parameters) if self.shifts else 0

    @cached_property
    def _moments(self) -> tuple[_Moment, ...]:
        none = SaltationDerivative(
            time=np.zeros(0), state=np.zeros((len(self.start), 0)), rate=np.zeros(0)
        )
        shifts = self.shifts or (none,) * len(self.events)
        return tuple(
            _Moment(event=event, shift=shift)
            for event, shift in zip(self.events, shifts, strict=True)
        )

    def _sequences(self, stop: str) -> Iterator[_Sequence]:
        """Yield the sequences of impacts on a stop. One may go on over the end of the period."""
        kinks = self.graph.switch_names[self.graph.n_declared :]
        round_trip = [
            one
            for one in self._moments
            if not (isinstance(one.event, SwitchEvent) and one.event.name in kinks)
        ]
        n = len(round_trip)
        for first, begin in enumerate(round_trip):
            if not _strikes(begin, stop) or _goes_on(round_trip[first - 1], begin):
                continue
            impacts = [begin]
            zeno: _Moment | None = None
            for k in range(first + 1, first + n):
                here = round_trip[k % n]
                if not _goes_on(impacts[-1], here):
                    if isinstance(here.event, ZenoPoint) and here.event.stop == stop:
                        zeno = here
                    break
                impacts.append(here)
            yield _Sequence(impacts=tuple(impacts), zeno=zeno)

    # Values.

    @property
    def _period(self) -> Reading:
        return Reading(value=self.period, by=self._moments[-1].shift.time)

    def _count(self, stop: str, speed: float | None) -> Reading:
        """Return the number of impacts that are faster than a speed."""
        number = 0
        for sequence in self._sequences(stop):
            least = _COUNTED * _speed(sequence.impacts[0]).value if speed is None else speed
            number += sum(_speed(one).value > least for one in sequence.impacts)
        return Reading(value=float(number), by=np.zeros(self._width))

    def _bounce_time(self, sequence: _Sequence) -> Reading | None:
        if sequence.zeno is None:
            return None
        first, last = sequence.impacts[0], sequence.zeno
        time = last.event.time - first.event.time
        by = last.shift.time - first.shift.time
        if time < 0.0:
            return Reading(value=time + self.period, by=by + self._period.by)
        return Reading(value=time, by=by)

    def _time(self, one: _Moment) -> Reading:
        """Return the time of an event since the zero phase of the clock, or since the start."""
        turn = self._turn
        if turn is None:
            return Reading(value=one.event.time, by=one.shift.time)
        n_turns = max(round(self.period / turn), 1)
        place = list(self.graph.first.clock)
        cosine, sine = np.asarray(state_before(one.event))[place]
        phase = math.atan2(sine, cosine) / (2 * math.pi) % 1.0
        if phase > 1.0 - _AT_ZERO:
            phase -= 1.0
        by_cosine, by_sine = one.shift.state[place]
        by_phase = (cosine * by_sine - sine * by_cosine) / (2 * math.pi)
        # A turn lasts as long as a part of the period, whose derivative is known.
        by = turn * by_phase + phase * self._period.by / n_turns
        return Reading(value=turn * phase, by=by)

    @cached_property
    def _turn(self) -> float | None:
        return steady_turn(self.graph.first, self.start)

    def _loss(self, one: _Moment, *, rest: bool) -> Reading:
        """Return the energy lost in an impact, or in all impacts that would follow it."""
        impact = one.event
        if not isinstance(impact, Impact):
            raise TypeError(f"Argument `one` must be an impact, but it is {impact}.")
        graph, k = self.graph, self.graph.stop_names.index(impact.stop)
        x, speed = np.asarray(impact.state_minus), -impact.approach_rate
        matrix = graph.delassus(x)
        along, kept = _direction(graph, impact, matrix)
        view = graph.view((kept, graph.open_mode[1]), k)
        yields, after = float(along @ matrix @ along), view.speed_after(-speed)
        value = (after**2 if rest else speed**2 - after**2) / 2 / yields
        if not self.shifts:
            return Reading(value=value, by=np.zeros(0))
        if view.differentiation is None:
            raise AssertionError("A compiled system has formulas.")
        n_x = len(self.start)
        by_matrix = graph.delassus_derivative(x, self.parameters)
        gradient = np.einsum("i,ijm,j->m", along, by_matrix, along)
        by_yields = gradient[:n_x] @ one.shift.state
        by_yields[n_x:] += gradient[n_x:]
        by_rate, *by_parameters = view.differentiation.by(self.parameters).speed_after(-speed)
        faster = by_rate * one.shift.rate
        faster[n_x:] += np.array(by_parameters)
        by = (after if rest else -after) * faster - (0.0 if rest else speed) * one.shift.rate
        return Reading(value=value, by=by / yields - value / yields * by_yields)


def event_quantity_names(graph: GraphDynamics) -> tuple[str, ...]:
    """Return the names of all quantities: of every stop, then of every switch.

    Args:
        graph: The graph of modes.
    """
    stops = [f"{stop}.{word}" for stop in graph.stop_names for word in _OF_STOP]
    switches = [f"{name}.{word}" for name in graph.switch_names for word in _OF_SWITCH]
    return (*stops, *switches)


def require_event_quantity(name: str, graph: GraphDynamics, argument: str) -> None:
    """Refuse a name that is neither the period nor a quantity of an event.

    Args:
        name: The name.
        graph: The graph of modes.
        argument: Argument with the name, for the message.

    Raises:
        InputError: If the name is unknown. The message lists the names.
    """
    if name != PERIOD:
        _parts_of(name, graph, argument)


def _parts_of(name: str, graph: GraphDynamics, argument: str) -> tuple[str, str, float | None]:
    """Return the stop or switch, the word, and the stated speed of a quantity.

    Raises:
        InputError: If the name is unknown.
    """
    bare, sign, speed = name.partition("@")
    owner, _, word = bare.rpartition(".")
    names = event_quantity_names(graph)
    stated = _number(speed) if sign else None
    if bare not in names or (sign and (word != "impacts" or stated is None)):
        raise InputError(unknown(argument, name, (PERIOD, *names)))
    return owner, word, stated


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if 0.0 <= number < math.inf else None


def _is_switch(one: _Moment, name: str) -> bool:
    return isinstance(one.event, SwitchEvent) and one.event.name == name


def _strikes(one: _Moment, stop: str) -> bool:
    return isinstance(one.event, Impact) and one.event.stop == stop


def _goes_on(before: _Moment, one: _Moment) -> bool:
    """Return True if an impact belongs to the sequence of the event before it."""
    if not (isinstance(before.event, Impact) and isinstance(one.event, Impact)):
        return False
    slower = -one.event.approach_rate < -before.event.approach_rate
    return before.event.stop == one.event.stop and slower


def _speed(one: _Moment) -> Reading:
    rate = one.event.approach_rate if isinstance(one.event, Impact) else 0.0
    return Reading(value=-rate, by=-one.shift.rate)


def _direction(
    graph: GraphDynamics, impact: Impact, matrix: Vector
) -> tuple[Vector, tuple[int, ...]]:
    r"""Return the vector `w` with :math:`s = w^\top G\,w` of an impact, and the stops it keeps."""
    k = graph.stop_names.index(impact.stop)
    along = np.zeros(len(graph.stop_names))
    along[k] = 1.0
    kept = [j for j in range(len(along)) if j != k and _stays_closed(graph, j, impact)]
    if kept:
        along[kept] = -np.linalg.solve(matrix[np.ix_(kept, kept)], matrix[kept, k])
    return along, tuple(kept)


def _stays_closed(graph: GraphDynamics, stop: int, impact: Impact) -> bool:
    """Return True if a stop is closed at rest before and after an impact on another stop."""
    view = graph.view(graph.open_mode, stop)
    rates = [view.gap_rate(x) for x in (impact.state_minus, impact.state_plus)]
    still = max(map(abs, rates)) <= _CLOSED * view.own.gap_rate
    return still and abs(view.gap(impact.state_minus)) <= _CLOSED * view.own.gap
