r"""The return map of an orbit in named coordinates, with its derivatives.

The coordinates `y` are states that determine a point of the section, :math:`x = s(y, p)`. With the
return :math:`x^+ = P(x, p)`, the map is :math:`y^+ = E P(s(y, p), p)`, where `E` picks the
coordinates. The conditions of the section are :math:`G(x, p) = 0`. With the other states `r`,

.. math:: \partial s_r / \partial y = -G_r^{-1} G_y, \qquad
    \partial s_r / \partial p = -G_r^{-1} G_p.

The states of a section are those just after its event, or just before it if it is a switch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector, finite_vector, spectral_radius
from zeno_orbits.errors import InputError, did_you_mean, finite_number, named_numbers, not_known
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits.events.return_map import (
    Surface,
    cause_at,
    multipliers_of_return,
    on_surface,
    shift_at,
    surface_of,
)
from zeno_orbits.orbits.events.section import (
    EventReturn,
    at_section,
    closed_return,
    event_return,
    largest_states,
    openings_of,
)
from zeno_orbits.orbits.looser_run import relaxed_settings
from zeno_orbits.orbits.orbit import Orbit
from zeno_orbits.orbits.section import Section, coordinates_of, section_of
from zeno_orbits.orbits.sequences import accumulating_events, orbit_event_name, sequence_of
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.work import Columns, TableRepr, checked, versions

_MOVES, _RANK = 1e-9, 1e-9
"""Relative change of a state above which a section moves, and relative singular value below which
conditions depend."""
_ROUNDED = 1e-12
"""Part of the largest value of a state that is rounding."""
_UNSURE = 0.1
"""Relative change of a derivative with the tolerance above which it is rounding."""
_CLOSED = 1e-6
"""Relative change over a period of an orbit that is closed."""

Numbers = Mapping[str, float] | Sequence[float] | Vector | None
"""Values by name, or in the declared order. ``None``: those of the orbit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReturnSlopes:
    """A return from a point of a section, with its derivatives.

    Attributes:
        point: Coordinates of the next return, ``(d,)``.
        time: Time until then [s].
        jacobian: Derivative of the point with respect to the coordinates, ``(d, d)``.
        gain_jacobian: The same with respect to the gains, ``(d, n_gains)``.
        parameter_jacobian: The same with respect to the parameters, ``(d, n_parameters)``.
        time_jacobian: Derivative of the time with respect to coordinates, gains and parameters, in
            this order, ``(d + n_gains + n_parameters,)``.
    """

    point: Vector
    time: float
    jacobian: Vector
    gain_jacobian: Vector
    parameter_jacobian: Vector
    time_jacobian: Vector


@dataclass(frozen=True, kw_only=True, repr=False)
class ReturnMap(TableRepr):
    """The return map of an orbit on the section of one of its events.

    Points are arrays of the values of `coordinates`. Gains and parameters are given by name, or as
    arrays in the order of `gain_names` and `parameter_names`. Those left out are the orbit's. Two
    maps are equal if they are of one orbit, section and accuracy, from which the rest is computed.

    Attributes:
        problem: The problem.
        orbit: The orbit.
        event: Event of the section, such as ``release stop``.
        coordinates: States that determine a point of the section, ``d`` names.
        fixed_point: The orbit, ``(d,)``.
        period: Period of the orbit [s].
        simulation: Accuracy.
    """

    problem: Problem
    orbit: Orbit
    event: str
    coordinates: tuple[str, ...] = field(compare=False)
    fixed_point: Vector = field(compare=False)
    period: float = field(compare=False)
    simulation: SimulationSettings
    _return: EventReturn = field(repr=False, compare=False)
    _surface: Surface = field(repr=False, compare=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the orbit, from which the map is computed again: functions are not data."""
        return _made_again, (self.problem, self.orbit, self.event, self.simulation)

    def __repr__(self) -> str:
        """Return one line: problem, section, coordinates and spectral radius."""
        radius = spectral_radius(self.multipliers)
        names = ", ".join(self.coordinates) or "none"
        return (
            f"<ReturnMap of {self.problem.name} at `{self.event}`: coordinates {names}, "
            f"spectral_radius={radius:.6g}>"
        )

    def _columns(self) -> Columns:
        """Return the fixed point, with the derivative of the map in its rows."""
        return {
            "coordinate": list(self.coordinates),
            "unit": [self.units[name] for name in self.coordinates],
            "fixed_point": self.fixed_point.tolist(),
            **{
                f"by_{name}": self.jacobian[:, k].tolist()
                for k, name in enumerate(self.coordinates)
            },
        }

    @property
    def values(self) -> ParameterValues:
        """Gains and parameters of the orbit."""
        return self.orbit.values(self.problem)

    @property
    def gain_names(self) -> tuple[str, ...]:
        """Names of the gains, in the order of `gain_jacobian`."""
        return tuple(one.name for one in self.problem.gains)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of `parameter_jacobian`."""
        return tuple(one.name for one in self.problem.parameters)

    @property
    def units(self) -> dict[str, str]:
        """State to its unit."""
        return dict(zip(self.problem.state_names, self.problem.state_units, strict=True))

    @property
    def sizes(self) -> Vector:
        """Largest value of each coordinate over the period, or its own scale, ``(d,)``."""
        return largest_states(self._return.execution.arcs, self._surface.graph)[self._chosen]

    @property
    def n_events(self) -> int:
        """Number of events of the section in a period of the orbit."""
        names = [orbit_event_name(event) for event in self._return.events]
        return names.count(self.event)

    @property
    def is_kink(self) -> bool:
        """True if the event of the section is a kink of a formula, which no switch declares."""
        switch = self._surface.switch
        return switch is not None and switch >= self._surface.graph.n_declared

    @property
    def start(self) -> dict[str, float]:
        """State of the orbit from which a motion can begin, by name. Rounding is zero.

        It is the one just after the event of the section. If the event is a switch that would occur
        there again, it is the middle of the longest flight.
        """
        arcs, after = self._return.execution.arcs, self._surface.reset(self._centre)
        if self._surface.switch is not None and self._surface.occurs(after):
            off = self._chart.normal @ self._surface.values(after)
            if np.max(np.abs(off), initial=0.0) <= _MOVES:
                flights = [arc for arc in arcs if not arc.closed] or arcs
                longest = max(flights, key=lambda arc: arc.end_time - arc.start_time)
                middle = (longest.start_time + longest.end_time) / 2
                after = longest.states_at(np.array([middle]))[0]
        after = np.where(
            np.abs(after) <= _ROUNDED * largest_states(arcs, self._surface.graph), 0.0, after
        )
        return dict(zip(self.problem.state_names, after.tolist(), strict=True))

    @checked
    def moves_section(self, name: str) -> bool:
        """Return True if a gain or parameter moves the section at the orbit.

        A motion on the section is then off it as soon as the value changes.

        Args:
            name: Name of the gain or parameter.
        """
        lift = self._lift(self._surface, self._centre, (self._place_of(name),))
        scale = largest_states(self._return.execution.arcs, self._surface.graph)
        return bool(np.max(np.abs(lift[:-1, -1]) * self.size_of(name) / scale) > _MOVES)

    @checked
    def size_of(self, name: str) -> float:
        """Return the size of a gain or parameter: its value.

        If this is zero, it is the change that moves the next return by the size of a coordinate.

        Args:
            name: Name of the gain or parameter.
        """
        place = self._place_of(name)
        if name not in self._known_sizes:
            self._known_sizes[name] = self._size_at(place, name)
        return self._known_sizes[name]

    @cached_property
    def _known_sizes(self) -> dict[str, float]:
        """Sizes computed so far: that of a zero input takes a simulation."""
        return {}

    def _size_at(self, place: int, name: str) -> float:
        effects = np.concatenate([self.gain_jacobian, self.parameter_jacobian], axis=1)[:, place]
        effect = float(np.max(np.abs(effects) / self.sizes, initial=0.0))
        value = abs(self.values.number(name))
        if value * effect > _ROUNDED or effect == 0.0:
            return value or 1.0
        # An effect that changes with the tolerance is rounding.
        looser = self._slopes(
            self.fixed_point, self.values, relaxed_settings(self.simulation), (place,)
        )
        other = np.concatenate([looser.gain_jacobian, looser.parameter_jacobian], axis=1)[:, 0]
        changed = float(np.max(np.abs(effects - other) / self.sizes))
        return 1.0 / effect if changed < _UNSURE * effect else value or 1.0

    def _place_of(self, name: str) -> int:
        """Return the index in ``p`` of a gain or parameter.

        Raises:
            InputError: If the name is unknown.
        """
        names = (*self.gain_names, *self.parameter_names)
        if name not in names:
            raise InputError(f"Argument `name`: {not_known(name, names)}")
        return names.index(name)

    @property
    def jacobian(self) -> Vector:
        """Derivative of the map at the orbit, ``(d, d)``."""
        return self._by_state.jacobian

    @property
    def gain_jacobian(self) -> Vector:
        """Derivative of the map at the orbit with respect to the gains, ``(d, n_gains)``."""
        return self._at_orbit.gain_jacobian

    @property
    def parameter_jacobian(self) -> Vector:
        """The same with respect to the parameters, ``(d, n_parameters)``."""
        return self._at_orbit.parameter_jacobian

    @property
    def time_jacobian(self) -> Vector:
        """Derivative of the return time at the orbit, ``(d + n_gains + n_parameters,)``.

        It is with respect to coordinates, gains and parameters, in this order.
        """
        return self._at_orbit.time_jacobian

    @cached_property
    def multipliers(self) -> tuple[complex, ...]:
        """Eigenvalues of the derivative at the orbit, ``d`` numbers, the largest first."""
        known = multipliers_of_return(self._surface.graph, self._return)
        return (*known, *(0j,) * (len(self.coordinates) - len(known)))

    @cached_property
    def errors(self) -> Vector:
        """Estimated errors of the derivative at the orbit, ``(d, d)``.

        They are the difference from the derivative at hundred times the errors of integration.
        """
        looser = relaxed_settings(self.simulation)
        found = self._slopes(self.fixed_point, self.values, looser, ())
        return np.abs(found.jacobian - self.jacobian)

    @cached_property
    def _by_state(self) -> ReturnSlopes:
        return self._slopes(self.fixed_point, self.values, self.simulation, ())

    @cached_property
    def _at_orbit(self) -> ReturnSlopes:
        return self._slopes(self.fixed_point, self.values, self.simulation, self._moving)

    def map(self, x: Any, gains: Numbers = None, parameters: Numbers = None) -> Vector:
        """Return the coordinates of the next return, ``(d,)``.

        Args:
            x: Coordinates of a point, ``(d,)``.
            gains: Gains until the return.
            parameters: Parameters until the return.

        Raises:
            InputError: If the point or a value is invalid.
            SimulationError: If the motion does not return with the event sequence of the orbit.
        """
        return self.returned(x, gains, parameters)[0]

    def returned(
        self, x: Any, gains: Numbers = None, parameters: Numbers = None
    ) -> tuple[Vector, float]:
        """Return the coordinates of the next return, ``(d,)``, and the time until then [s].

        Args:
            x: As for `map`.
            gains: As for `map`.
            parameters: As for `map`.

        Raises:
            InputError: As for `map`.
            SimulationError: As for `map`.
        """
        values = self._values(gains, parameters)
        found = self._returned(self._point(x), values, self.simulation, ())[0]
        return on_surface(cause_at(found, found.period))[self._chosen], found.period

    def slopes(self, x: Any, gains: Numbers = None, parameters: Numbers = None) -> ReturnSlopes:
        """Return the next return with its derivatives.

        Args:
            x: As for `map`.
            gains: As for `map`.
            parameters: As for `map`.

        Raises:
            InputError: If the point or a value is invalid.
            SimulationError: As for `map`, or if an event has no derivative.
        """
        values = self._values(gains, parameters)
        return self._slopes(self._point(x), values, self.simulation, self._moving)

    def jvp(
        self,
        x: Any,
        change: Any,
        gain_change: Numbers = None,
        parameter_change: Numbers = None,
        *,
        gains: Numbers = None,
        parameters: Numbers = None,
    ) -> Vector:
        """Return the change of the next return due to changes of its arguments, ``(d,)``.

        Args:
            x: As for `map`.
            change: Change of the point, ``(d,)``.
            gain_change: Changes of gains. Those left out are zero.
            parameter_change: Changes of parameters. Those left out are zero.
            gains: As for `map`.
            parameters: As for `map`.
        """
        found = self.slopes(x, gains, parameters)
        along = self._vector("gain_change", gain_change, self.gain_names)
        further = self._vector("parameter_change", parameter_change, self.parameter_names)
        moved = found.jacobian @ self._point(change, "change")
        return moved + found.gain_jacobian @ along + found.parameter_jacobian @ further

    def vjp(
        self, x: Any, weights: Any, gains: Numbers = None, parameters: Numbers = None
    ) -> tuple[Vector, Vector, Vector]:
        """Return the gradients of a weighted sum of the next return.

        Args:
            x: As for `map`.
            weights: Weight of each coordinate, ``(d,)``.
            gains: As for `map`.
            parameters: As for `map`.

        Returns:
            Gradients with respect to point, gains and parameters.
        """
        found = self.slopes(x, gains, parameters)
        w = self._point(weights, "weights")
        return w @ found.jacobian, w @ found.gain_jacobian, w @ found.parameter_jacobian

    def state(self, x: Any, gains: Numbers = None, parameters: Numbers = None) -> dict[str, float]:
        """Return the full state of a point of the section, by name.

        Args:
            x: As for `map`.
            gains: Gains of the section.
            parameters: Parameters of the section.

        Raises:
            SimulationError: If the section lacks a point there.
        """
        surface = self._surface_at(self._values(gains, parameters))
        full = self._on(surface, self._point(x))
        return dict(zip(self.problem.state_names, full.tolist(), strict=True))

    @checked
    def point(self, state: Mapping[str, float]) -> Vector:
        """Return the coordinates of a full state, ``(d,)``.

        Args:
            state: State name to value.

        Raises:
            InputError: If the state lacks a coordinate.
        """
        for name in self.coordinates:
            if name not in state:
                raise InputError(f"Argument `state` must have `{name}`.")
        return np.array([finite_number(name, state[name]) for name in self.coordinates])

    def as_json(self) -> dict[str, Any]:
        """Return the map at the orbit as plain data."""
        return {
            "problem": self.problem.name,
            "section": self.event,
            "period": self.period,
            "coordinates": {name: self.units[name] for name in self.coordinates},
            "fixed_point": self.fixed_point.tolist(),
            "jacobian": self.jacobian.tolist(),
            "errors": self.errors.tolist(),
            "gains": list(self.gain_names),
            "gain_jacobian": self.gain_jacobian.tolist(),
            "parameters": list(self.parameter_names),
            "parameter_jacobian": self.parameter_jacobian.tolist(),
            "time_jacobian": self.time_jacobian.tolist(),
            "versions": dict(versions()),
        }

    @property
    def _chosen(self) -> list[int]:
        return [self.problem.state_names.index(name) for name in self.coordinates]

    @property
    def _others(self) -> list[int]:
        chosen = set(self._chosen)
        return [k for k in range(len(self.problem.state_names)) if k not in chosen]

    @property
    def _centre(self) -> Vector:
        """The state of the orbit on the section, ``(n_x,)``."""
        return on_surface(cause_at(self._return, self._return.period))

    def _point(self, x: Any, name: str = "x") -> Vector:
        return finite_vector(name, x, of=self.coordinates)

    def _values(self, gains: Numbers, parameters: Numbers) -> ParameterValues:
        """Return the orbit's values, some of them replaced by numbers that the problem allows."""
        known = self.values
        if gains is None and parameters is None:
            return known
        groups = (
            ("gains", gains, self.gain_names),
            ("parameters", parameters, self.parameter_names),
        )
        numbers = {
            argument: self._vector(argument, given, names, np.array([*map(known.number, names)]))
            for argument, given, names in groups
        }
        return self.problem.values(
            gains=dict(zip(self.gain_names, numbers["gains"].tolist(), strict=True)),
            parameters=dict(zip(self.parameter_names, numbers["parameters"].tolist(), strict=True)),
        )

    def _vector(
        self, argument: str, given: Numbers, names: tuple[str, ...], rest: Vector | None = None
    ) -> Vector:
        """Return numbers in the order of their names, those left out from the rest, or zero."""
        full = np.zeros(len(names)) if rest is None else rest.copy()
        if given is None:
            return full
        if not isinstance(given, Mapping):
            return finite_vector(argument, given, of=names)
        for name, value in named_numbers(argument, given).items():
            if name not in names:
                known = f"Known: {', '.join(names) or 'none'}"
                hint = did_you_mean(name, names)
                raise InputError(f"Argument `{argument}` has no `{name}`.{hint} {known}.")
            full[names.index(name)] = finite_number(name, value)
        return full

    def _surface_at(self, values: ParameterValues) -> Surface:
        return replace(self._surface, graph=self.problem.graph_dynamics(values))

    @cached_property
    def _chart(self) -> Section:
        """The chart of the section in the coordinates: corrections move the other states alone."""
        centre, others = self._centre, self._others
        scale = largest_states(self._return.execution.arcs, self._surface.graph)
        gradient = self._surface.gradient(centre) * scale
        normal = np.zeros(gradient.T.shape)
        normal[others] = _inverse(gradient[:, others])
        tangent = self._lift(self._surface, centre, ()) * scale[self._chosen] / scale[:, None]
        return replace(section_of(gradient, centre, scale), tangent=tangent, normal=normal)

    def _on(self, surface: Surface, point: Vector) -> Vector:
        """Return the state of a section with given coordinates, ``(n_x,)``."""
        away = (point - self.fixed_point) / self._chart.scale[self._chosen]
        return surface.state(self._chart, away, self.event)

    def _returned(
        self,
        point: Vector,
        values: ParameterValues,
        settings: SimulationSettings,
        chosen: Sequence[int],
    ) -> tuple[EventReturn, Surface, Vector]:
        """Return the next return from a point, the section and the point's state."""
        surface = self._surface_at(values)
        x = self._on(surface, point)
        names = [orbit_event_name(event) for event in self._return.events]
        found = event_return(
            surface.graph,
            surface.reset(x),
            section=names[-1],
            n_returns=names.count(names[-1]),
            guess=self.period,
            settings=settings,
            parameters=chosen,
            mode=self._return.mode,
            sequence=sequence_of(names),
            openings=openings_of(self._return.events),
        )
        return found, surface, x

    @property
    def _moving(self) -> tuple[int, ...]:
        """Indices in ``p`` of all gains and parameters."""
        return tuple(range(len(self.gain_names) + len(self.parameter_names)))

    def _slopes(
        self,
        point: Vector,
        values: ParameterValues,
        settings: SimulationSettings,
        moving: tuple[int, ...],
    ) -> ReturnSlopes:
        """Return a return with its derivatives by the point and some gains and parameters."""
        n_x, chosen = len(self.problem.state_names), self._chosen
        found, surface, x = self._returned(point, values, settings, moving)
        cause = cause_at(found, found.period)
        ends = shift_at(found, cause)
        lift = self._lift(surface, x, moving)
        start = np.concatenate([surface.reset_derivative(x, moving) @ lift, lift[n_x:]])
        by, time = ends.state @ start, ends.time @ start
        d, n_gains = len(chosen), len(self.gain_names)
        return ReturnSlopes(
            point=on_surface(cause)[chosen],
            time=found.period,
            jacobian=by[chosen, :d],
            gain_jacobian=by[chosen, d : d + n_gains],
            parameter_jacobian=by[chosen, d + n_gains :],
            time_jacobian=time,
        )

    def _lift(self, surface: Surface, x: Vector, moving: Sequence[int]) -> Vector:
        """Return the derivative of state and parameters by point and parameters."""
        n_x, d, others = x.size, len(self.coordinates), self._others
        scale = largest_states(self._return.execution.arcs, surface.graph)
        gradient = surface.gradient(x, moving)
        inverse = _inverse(gradient[:, others] * scale[others])
        kept = np.concatenate([gradient[:, self._chosen], gradient[:, n_x:]], axis=1)
        lift = np.zeros((n_x + len(moving), d + len(moving)))
        lift[self._chosen, :d] = np.eye(d)
        lift[n_x:, d:] = np.eye(len(moving))
        lift[others] = -scale[others, None] * (inverse @ kept)
        return lift


def return_map_of(
    problem: Problem,
    orbit: Orbit,
    *,
    section: str | None = None,
    simulation: SimulationSettings | None = None,
) -> ReturnMap:
    """Return the return map of an orbit in named coordinates of a section.

    Args:
        problem: The problem of the orbit.
        orbit: The orbit.
        section: Event of the section. The default is the event at which the orbit starts.
        simulation: Accuracy.

    Raises:
        InputError: If the orbit lacks the event or is not closed, or if the impacts accumulate.
        SimulationError: If the motion from its start does not return.
    """
    settings = simulation or SimulationSettings()
    values = orbit.values(problem)
    graph = problem.graph_dynamics(values)
    start = np.array(problem.state_vector(orbit.start_state))
    found = closed_return(
        graph,
        start,
        section=orbit.section,
        n_returns=orbit.n_returns,
        guess=orbit.period,
        settings=settings,
    )
    scale = largest_states(found.execution.arcs, graph)
    missed = float(np.max(np.abs(found.start - start) / scale))
    if not missed < _CLOSED:
        wanted = f"must be closed, but the orbit near its start is {missed:.1g} away"
        raise InputError(f"Argument `orbit` {wanted}.")
    if section is not None:
        _require_section(section, [orbit_event_name(event) for event in found.events])
        found = at_section(graph, found, section, settings)
    cause = cause_at(found, found.period)
    surface, centre = surface_of(graph, found, cause), on_surface(cause)
    scale = largest_states(found.execution.arcs, graph)
    tangent = section_of(surface.gradient(centre) * scale, centre, scale).tangent
    chosen = coordinates_of(tangent)
    return ReturnMap(
        problem=problem,
        orbit=orbit,
        event=orbit_event_name(cause),
        coordinates=tuple(problem.state_names[k] for k in chosen),
        fixed_point=centre[chosen],
        period=found.period,
        simulation=settings,
        _return=found,
        _surface=surface,
    )


def _inverse(matrix: Vector) -> Vector:
    """Return the pseudo-inverse of rows that have different units."""
    sizes = np.linalg.norm(matrix, axis=1)
    sizes[sizes == 0.0] = 1.0
    inverse = np.asarray(np.linalg.pinv(matrix / sizes[:, None], rcond=_RANK), dtype=np.float64)
    return inverse / sizes


def _require_section(section: str, names: Sequence[str]) -> None:
    """Refuse a section that is not an event of an orbit, or an event of impacts that accumulate.

    Raises:
        InputError: If it is.
    """
    limit = accumulating_events(names).get(section)
    if limit is not None:
        wanted = f"must not be `{section}`, whose events accumulate: take `{limit}`"
        raise InputError(f"Argument `section` {wanted}.")
    if section not in names:
        known = ", ".join(dict.fromkeys(names))
        raise InputError(
            f"Argument `section` must be an event of the orbit ({known}), but it is `{section}`."
        )


def _made_again(
    problem: Problem, orbit: Orbit, section: str, simulation: SimulationSettings
) -> ReturnMap:
    return return_map_of(problem, orbit, section=section, simulation=simulation)
