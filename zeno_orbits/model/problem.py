"""A problem: a completed system with named parameters, gain ranges and initial states.

A problem is found by its name among the bundled problems, or by the path of a Python file (or of a
folder with a ``model.py``) that defines ``PROBLEM``. ``problem@fidelity`` is a reduced model of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector, finite_vector
from zeno_orbits.errors import (
    InputError,
    did_you_mean,
    finite_number,
    named_numbers,
    number_range,
)
from zeno_orbits.model.contact import require_zeno_points
from zeno_orbits.model.declared.drawing import DrawingFunction, lines_of
from zeno_orbits.model.declared.origin import Declared, Origin
from zeno_orbits.model.declared.quantities import (
    Output,
    ParameterValues,
    Quantity,
    StateLimit,
    positive,
    require_names,
    require_ranges,
    require_restitution,
    restitution,
    unknown,
)
from zeno_orbits.model.declared.rig_parts import Rig
from zeno_orbits.model.declared.starts import Start, require_starts, state_of
from zeno_orbits.model.expressions.formula_units import unit_of
from zeno_orbits.model.expressions.units import energy_unit, require_coherent
from zeno_orbits.model.hybrid import CompletedSystem
from zeno_orbits.model.lagrangian import accelerate
from zeno_orbits.model.mistakes import place_in_file
from zeno_orbits.model.modes import ModeGraph
from zeno_orbits.model.validation import (
    built,
    require_known_symbols,
    require_sound_numbers,
    require_states,
    unused_symbols,
)
from zeno_orbits.work import checked as of_kinds
from zeno_orbits.work import require_kinds

if TYPE_CHECKING:
    from zeno_orbits.model.numeric.compiled import CompiledSystem
    from zeno_orbits.model.numeric.graph_dynamics import CompiledGraph, GraphDynamics
    from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics


_IMPULSES = {"m": "N s", "rad": "N m s"}
"""Unit of a coordinate to the unit of an impulse along it."""
_MOVED, _FROM_ZERO = 1.01, 1e-6
"""Factor by which a value is changed to test its effect, and the change of a zero value."""

__all__ = [
    "Output",
    "ParameterValues",
    "Problem",
    "Quantity",
    "StateLimit",
    "positive",
    "restitution",
]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Problem(Declared):
    """A problem. Two problems are equal if their file and their changes are the same.

    Functions cannot be compared, so a problem without a file equals only itself. A problem with a
    file is pickled as its name or path, the digest of the file, and the changes.

    Attributes:
        name: Name of the problem.
        title: One line for the user.
        source: Reference of the problem.
        state_names: Name of each state, ``(n_x,)``, configuration, velocity, currents.
        state_units: Unit of each state.
        parameters: Physical constants. The restitution of a stop may be one of them, a number or a
            formula.
        gains: Feedback gains, whose ranges are the default search box. May be empty.
        model: Function from named symbols (gains and parameters) to the completed system.
        starts: Initial states from which the problem may settle to an orbit, as values by name. A
            missing state is zero. A value may be a formula of the gains and parameters, as in
            ``{"z": lambda p: p["d"]}``.
        portraits: Pairs of state names to draw against each other.
        amplitude_of: State whose amplitude a search may prescribe.
        derive: Function from the given and default values to the parameters without a default.
        reference: Path of a hand-written numeric model of the same problem, if there is one: its
            ``dynamics`` takes a ``ParameterValues`` and returns a ``HybridDynamics``.
        fidelities: Reduced models of the same problem, by the word after the ``@``. A parameter
            that a reduced model lacks does not affect it.
        escapes: Limits of coordinates that may diverge, by name. Other coordinates are unlimited.
        outputs: Further quantities to draw over time.
        drawing: Drawing of the mechanism, if it is to be shown: its links as lines.
        rig: The parts of a plausible machine, for the virtual rig, or ``None`` for a stop alone.
        origin: The file that declares it, set by `load_problem`.
    """

    name: str
    title: str
    source: str
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    parameters: tuple[Quantity, ...]
    gains: tuple[Quantity, ...]
    model: Callable[[Mapping[str, ca.SX]], CompletedSystem]
    starts: tuple[Start, ...]
    portraits: tuple[tuple[str, str], ...]
    amplitude_of: str
    derive: Callable[[Mapping[str, float]], Mapping[str, float]] | None = None
    reference: Path | None = None
    fidelities: Mapping[str, Problem] = field(default_factory=dict["str", "Problem"])
    escapes: Mapping[str, StateLimit] = field(default_factory=dict[str, StateLimit])
    outputs: tuple[Output, ...] = ()
    drawing: DrawingFunction | None = None
    rig: Rig | None = None
    origin: Origin | None = None

    def __repr__(self) -> str:
        """Return one line: name, title, and the names of states and gains."""
        states, gains = ", ".join(self.state_names), ", ".join(one.name for one in self.gains)
        return f"<Problem {self.name}: {self.title}; states {states}; gains {gains or 'none'}>"

    def __post_init__(self) -> None:
        """Reject invalid names, units and ranges. The model itself is checked by `checked`."""
        require_kinds(self)
        require_names(self.state_names, self.state_units, (*self.gains, *self.parameters))
        require_coherent(self.units)
        require_ranges(self.gains, self.parameters, derives=self.derive is not None)
        if "restitution" in self.names:
            require_restitution(self.parameters)
        _require_states(self)
        for name in self.escapes:
            if name not in self.state_names:
                raise InputError(unknown("escapes", name, self.state_names))

    def compiled(self) -> CompiledSystem:
        """Return the model as functions of the state and the parameter vector, built once."""
        return _compiled(self)

    @of_kinds
    def dynamics(self, values: ParameterValues | Sequence[float] | Vector) -> HybridDynamics:
        """Return the flows, guards and resets of the model at given parameter values.

        Args:
            values: Values of every gain and parameter, or the parameter vector, ``(n_p,)``.
        """
        from zeno_orbits.model.numeric.binding import bind

        vector = self._vector_of(values)
        return bind(_compiled(self), vector)

    def _vector_of(self, values: ParameterValues | Sequence[float] | Vector) -> Sequence[float]:
        """Return the parameter vector of values."""
        if isinstance(values, ParameterValues):
            return values.vector
        return finite_vector("values", values, of=self.names).tolist()

    @of_kinds
    def require_zeno_points(self, values: ParameterValues) -> None:
        """Refuse elastic impacts on the first stop, for what needs a Zeno point.

        Values without a system are reported where the system is used.

        Args:
            values: Values of every gain and parameter.

        Raises:
            InputError: If the restitution is 1.
        """
        try:
            first = self.first_system(values)
        except InputError:
            return
        require_zeno_points(first.restitution)

    def one_stop_model(self, symbols: Mapping[str, ca.SX]) -> CompletedSystem:
        """Return the completed system of a machine with one stop and no declared switch.

        Its formulas are as written, with their kinks.

        Args:
            symbols: Gains and parameters by name.

        Raises:
            InputError: If the machine lacks a stop, or has several stops or a declared switch.
        """
        system = self.model(symbols)
        graph = system.graph
        if len(graph.stops) != 1 or graph.switches:
            raise _needs_one_stop(self, graph)
        return system

    @property
    def has_graph(self) -> bool:
        """True for a machine with several stops, with switches or with kinks of the state."""
        return bool(_built(self)[0].graph.reason)

    def compiled_graph(self) -> CompiledGraph:
        """Return the functions of a machine over its modes.

        A machine with one stop and no switch has its stop under the name `stop`, and every kink of
        its formulas is a switch.
        """
        return _compiled_graph(self)

    @of_kinds
    def graph_dynamics(self, values: ParameterValues | Sequence[float] | Vector) -> GraphDynamics:
        """Return the graph of modes of a machine, as `compiled_graph` has it.

        Args:
            values: Values of every gain and parameter, or the parameter vector, ``(n_p,)``.
        """
        from zeno_orbits.model.numeric.graph_dynamics import GraphDynamics

        vector = self._vector_of(values)
        return GraphDynamics(_compiled_graph(self), vector)

    @of_kinds
    def system(
        self, values: ParameterValues | Sequence[float] | Vector
    ) -> HybridDynamics | GraphDynamics:
        """Return the machine at fixed values, as `simulate` takes it.

        Args:
            values: Values of every gain and parameter, or the parameter vector, ``(n_p,)``.
        """
        return self.graph_dynamics(values) if self.has_graph else self.dynamics(values)

    @of_kinds
    def first_system(self, values: ParameterValues | Sequence[float] | Vector) -> HybridDynamics:
        """Return the system of the first stop, with the other stops open.

        Args:
            values: Values of every gain and parameter, or the parameter vector, ``(n_p,)``.
        """
        return self.system(values).as_graph().first

    @property
    def modes_reason(self) -> str:
        """The property that gives the machine several modes, for messages, or an empty text."""
        return _built(self)[0].graph.reason

    @property
    def has_time(self) -> bool:
        """True if the clock is a `Time`, under which no motion repeats."""
        return _built(self)[0].has_time

    @property
    def clock(self) -> tuple[int, ...]:
        """Indices of the clock in the state, empty for an unforced problem."""
        return _built(self)[0].clock

    @of_kinds
    def output_values(self, values: ParameterValues, states: Vector) -> Vector:
        """Return the outputs at states, one column per output, ``(n, n_outputs)``.

        Args:
            values: Values of every gain and parameter.
            states: ``(n, n_x)``.
        """
        from zeno_orbits.model.numeric.compiled import tabulate

        symbols = self.symbols()
        system = self.model(symbols)
        formulas = ca.vertcat(*self.output_formulas(system, symbols))
        return tabulate(formulas, system, symbols, values.vector, states)

    @of_kinds
    def drawn_lines(self, values: ParameterValues, states: Vector) -> dict[str, Vector]:
        """Return the lines of the drawing at states, name to corners ``(n, n_corners, 2)`` [m].

        Args:
            values: Values of every gain and parameter.
            states: ``(n, n_x)``.
        """
        from zeno_orbits.model.numeric.compiled import tabulate

        symbols = self.symbols()
        system = self.model(symbols)
        lines = self.lines(system, symbols)
        flat = ca.vertcat(*(ca.vec(corners.T) for corners in lines.values()))
        entries = tabulate(flat, system, symbols, values.vector, states)
        found: dict[str, Vector] = {}
        first = 0
        for name, corners in lines.items():
            last = first + corners.numel()
            found[name] = entries[:, first:last].reshape(len(states), -1, 2)
            first = last
        return found

    @of_kinds
    def inverse_masses(self, values: ParameterValues, states: Vector) -> tuple[Vector, Vector]:
        """Return the inverse mass on the constraints and the kinetic energy at states.

        Args:
            values: Values of every gain and parameter.
            states: ``(n, n_x)``.

        Returns:
            ``(n, n_q, n_q)`` and ``(n,)`` [J].
        """
        from zeno_orbits.model.numeric.compiled import tabulate

        symbols = self.symbols()
        system = self.model(symbols)
        mechanism = system.mechanism
        n_q = mechanism.q.numel()
        inverse, _ = accelerate(mechanism, ca.SX.zeros(n_q))
        formula = ca.vertcat(ca.vec(inverse), mechanism.kinetic)
        entries = tabulate(formula, system, symbols, values.vector, states)
        return entries[:, :-1].reshape(-1, n_q, n_q), entries[:, -1]

    @of_kinds
    def impulse_unit(self, unit: str) -> str:
        """Return the unit of an impulse along a coordinate: its energy over its velocity.

        Args:
            unit: Unit of the coordinate.
        """
        if self.energy_unit == "J" and unit in _IMPULSES:
            return _IMPULSES[unit]
        return f"{self.energy_unit} s/{unit}" if unit != "1" else f"{self.energy_unit} s"

    def escaped(self, state: Sequence[float]) -> str:
        """Return the name of a coordinate that diverges, or an empty text.

        Args:
            state: A state, ``(n_x,)``.
        """
        for name, escape in self.escapes.items():
            if abs(state[self.state_names.index(name)]) > escape.beyond:
                return name
        return ""

    def checked(self) -> Problem:
        """Return the problem itself, if its model is consistent at the default parameters.

        Raises:
            InputError: If the model is inconsistent. The message names the invalid part.
        """
        symbols = self.symbols()
        system = built(self.model, symbols)
        require_states(system, self.state_names, self.state_units)
        require_known_symbols(system, symbols)
        values = self.values()
        looks = [*self.output_formulas(system, symbols), *self.lines(system, symbols).values()]
        looks += system.graph.formulas
        unused = unused_symbols(system, symbols, looks)
        for name in unused:
            if not self.derived_from([name], values.parameters):
                kind = "gains" if name in values.gains else "parameters"
                wanted = "must appear in the model or an output"
                raise InputError(
                    f"Argument `{kind}` {wanted}, but `{name}` appears nowhere. Use it, or delete "
                    "it."
                )
        require_coherent(self.units | {f"gap of {name}": u for name, u in self.gap_units.items()})
        starts = [self._checked_start(k, values) for k in range(len(self.starts))]
        units = self.state_units
        self._require_named_stops(system.graph.named_stops, values, starts)
        dynamics = self.first_system(values)
        require_sound_numbers(system, symbols, values.vector, dynamics, units, starts)
        for word in self.fidelities:
            self.at_fidelity(word).checked()
        return self

    def _checked_start(self, k: int, values: ParameterValues) -> tuple[float, ...]:
        """Return a declared start as a state, ``(n_x,)``.

        Raises:
            InputError: If it is not one. The message names the argument of the file.
        """
        try:
            return self.state_vector(self.starts[k], values)
        except InputError as error:
            reason = str(error).replace("Argument ", "the value of ", 1)
            if "`starts`" in reason:
                raise
            raise InputError(f"Argument `starts`: {reason}") from error

    def _require_named_stops(
        self, names: Sequence[str], values: ParameterValues, starts: Sequence[Sequence[float]]
    ) -> None:
        """Refuse two stops that are one, and starts inside of a stop.

        Raises:
            InputError: If two stops are one at a start, or a start is inside of a stop.
        """
        from zeno_orbits.model.numeric.admission import require_outside

        for (number, start), (k, name) in product(enumerate(starts, start=1), enumerate(names)):
            graph, x = self.graph_dynamics(values), np.array(start)
            view = graph.view(graph.open_mode, k)
            require_outside(view, x, 0.0, name, subject=f"Start {number}")
            equal = graph.equal_stops(x)
            if equal is not None:
                raise InputError(
                    f"Argument `stops` must hold different stops, but `{equal[0]}` and "
                    f"`{equal[1]}` have the same gap."
                )

    def output_formulas(
        self, system: CompletedSystem, symbols: Mapping[str, ca.SX]
    ) -> tuple[ca.SX, ...]:
        """Return the expressions of the outputs in the states of a system and named symbols."""
        states = {name: system.state[k] for k, name in enumerate(self.state_names)}
        return tuple(ca.SX(output.formula(states, symbols)) for output in self.outputs)

    def lines(self, system: CompletedSystem, symbols: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
        """Return the lines of the drawing, corners as rows ``(n, 2)`` [m], or an empty dict."""
        if self.drawing is None:
            return {}
        states = {name: system.state[k] for k, name in enumerate(self.state_names)}
        return lines_of(self.drawing, states, symbols)

    def derived_from(self, names: Collection[str], parameters: Mapping[str, float]) -> list[str]:
        """Return the parameters that the problem derives from some of the others.

        Args:
            names: Names of the other parameters. No parameter is derived from a gain.
            parameters: Parameter values by name, at which the dependence is tested.
        """
        derived = [q.name for q in self.parameters if q.default is None and q.name not in names]
        if self.derive is None:
            return []
        given = {q.name: parameters[q.name] for q in self.parameters if q.default is not None}
        moved = {name: _MOVED * given[name] or _FROM_ZERO for name in names if name in given}
        try:
            before, after = self._derived(given), self._derived({**given, **moved})
        except ValueError:
            return derived
        return [name for name in derived if before[name] != after[name]]

    @of_kinds
    def at_fidelity(self, word: str) -> Problem:
        """Return the reduced model of that name, whose own name is ``problem@word``.

        Raises:
            InputError: If the problem declares no such model. The message lists the declared
                models.
        """
        if word not in self.fidelities:
            asked = f"{self.name}@{word}"
            if not self.fidelities:
                message = f"must have reduced models for `{asked}`, but `{self.name}` lacks them"
                raise InputError(f"Argument `problem` {message}.")
            known = (self.name, *(f"{self.name}@{one}" for one in self.fidelities))
            raise InputError(unknown("problem", asked, known))
        model = replace(self.fidelities[word], name=f"{self.name}@{word}", fidelities={})
        return model if self.origin is None else self.origin.reduced_model(word, model)

    def ladder(self) -> tuple[Problem, ...]:
        """Return the problem and its reduced models, as they are declared."""
        return (self, *(self.at_fidelity(word) for word in self.fidelities))

    @of_kinds
    def shared(self, values: ParameterValues) -> ParameterValues:
        """Return another fidelity's values for the names that this fidelity has."""
        known = {quantity.name for quantity in self.parameters}
        parameters = {name: value for name, value in values.parameters.items() if name in known}
        return self.values(gains=values.gains, parameters=parameters)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Gains, then parameters, in the order of the parameter vector."""
        return (*self.gains, *self.parameters)

    @property
    def units(self) -> dict[str, str]:
        """Name to unit of every state, gain, parameter and output."""
        others = {one.name: one.unit for one in (*self.quantities, *self.outputs)}
        return dict(zip(self.state_names, self.state_units, strict=True)) | others

    @property
    def is_balanced(self) -> bool:
        """True if all powers are given, so that the energy balance can be checked."""
        return self.compiled().is_balanced

    @property
    def energy_unit(self) -> str:
        """Unit of the problem's energies: J, or the unit that follows from its own units."""
        return energy_unit(self.units)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of gains, then of parameters, in the order of the parameter vector."""
        return tuple(quantity.name for quantity in self.quantities)

    @of_kinds
    def quantity(self, name: str, *, argument: str = "name") -> Quantity:
        """Return the gain or parameter of that name.

        Args:
            name: The name.
            argument: Name of the argument in an error message.

        Raises:
            InputError: If the name is unknown. The message lists the known names.
        """
        return self.quantities[self.place(name, argument=argument)]

    @of_kinds
    def place(self, name: str, *, argument: str = "name") -> int:
        """Return the index of a gain or parameter in the parameter vector.

        Args:
            name: The name.
            argument: Name of the argument in an error message.

        Raises:
            InputError: If the name is unknown. The message lists the known names.
        """
        if name not in self.names:
            raise InputError(unknown(argument, str(name), self.names))
        return self.names.index(name)

    @of_kinds
    def require_range(
        self, name: str, box: tuple[float, float], *, argument: str = "name"
    ) -> Quantity:
        """Return the gain or parameter of that name, if it may lie anywhere in a range.

        The problem's range of a gain is the default search box and not a limit.

        Args:
            name: The name.
            box: Lower and upper end.
            argument: Name of the argument in an error message.

        Raises:
            InputError: If the name is unknown, the range is empty or not finite, or an end of the
                range is an invalid value of a parameter.
        """
        quantity = self.quantity(name, argument=argument)
        low, high = number_range(argument, box, name)
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            wanted = f"must have finite bounds LOWER < UPPER for `{name}`"
            raise InputError(f"Argument `{argument}` {wanted}, but they are {low:g}:{high:g}.")
        if quantity in self.parameters:
            quantity.checked(low)
            quantity.checked(high)
        return quantity

    def values(
        self,
        *,
        gains: Mapping[str, float] | None = None,
        parameters: Mapping[str, float] | None = None,
        numbers: Mapping[str, float] | None = None,
    ) -> ParameterValues:
        """Return validated values for every name, including defaults and derived values.

        Args:
            gains: Gains that differ from their defaults.
            parameters: Parameters that differ from their defaults.
            numbers: Gains or parameters by name. They override the other arguments.

        Raises:
            InputError: If a name is unknown or a value is out of its range.
        """
        given_gains, given = named_numbers("gains", gains), named_numbers("parameters", parameters)
        for name, value in named_numbers("numbers", numbers).items():
            (given_gains if self.quantity(name) in self.gains else given)[name] = value
        chosen_gains = _chosen("gain", self.gains, given_gains, bounded=False)
        chosen = _chosen("parameter", self.parameters, given, bounded=True)
        if self.derive is not None:
            derived = self._derived(chosen)
            chosen = {
                quantity.name: quantity.checked(
                    chosen[quantity.name] if quantity.name in chosen else derived[quantity.name]
                )
                for quantity in self.parameters
            }
        return ParameterValues(gains=chosen_gains, parameters=chosen)

    def _derived(self, chosen: Mapping[str, float]) -> Mapping[str, float]:
        """Return the derived parameters.

        Raises:
            InputError: If the derivation raises an error, such as a division by zero.
        """
        if self.derive is None:
            return {}
        wanted = f"must be values from which `{self.name}` can derive the others"
        try:
            return self.derive(chosen)
        except ArithmeticError as error:
            raise InputError(f"Argument `parameters` {wanted} ({error}).") from error
        except InputError:
            raise
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(".")
            told = f"`derive` raises {reason}{place_in_file(error, self.derive)}"
            raise InputError(f"Argument `parameters` {wanted} ({told}).") from error

    def symbols(self) -> dict[str, ca.SX]:
        """Return one symbol for every gain and parameter, in order."""
        return {name: ca.SX.sym(name) for name in self.names}

    @property
    def gap_unit(self) -> str:
        """Unit of the gap of the first stop, by `gap_units`, or 1 without a stop."""
        return next(iter(self.gap_units.values()), "1")

    @property
    def gap_units(self) -> dict[str, str]:
        """Unit of the gap of each stop, declared by the stop or inferred from its formula."""
        system, symbols = _built(self)
        states = zip(ca.vertsplit(system.state), self.state_units, strict=True)
        units = [*states, *((symbols[name], self.units[name]) for name in self.names)]
        return {stop.name: stop.unit or unit_of(stop.gap, units) for stop in system.graph.stops}

    @of_kinds
    def state_vector(
        self, named: Start, values: ParameterValues | None = None
    ) -> tuple[float, ...]:
        """Return the state with the named entries, the others zero, ``(n_x,)``.

        A clock of which no state is named has the phase of the first declared start.

        Args:
            named: State name to value, as in ``starts`` or an orbit's ``release_state``.
            values: Values at which formulas among the entries are evaluated, by default the
                defaults of the problem.

        Raises:
            InputError: If a name is not a state of the problem or a value is not a finite number.
        """
        given, first = named_numbers("start", named), self.starts[0]
        clock = [self.state_names[k] for k in self.clock]
        if not any(name in given for name in clock):
            given |= {name: first[name] for name in clock if name in first}
        return state_of(given, self.state_names, lambda: (values or self.values()).numbers)

    @of_kinds
    def initial_state(
        self, start: Start | None = None, values: ParameterValues | None = None
    ) -> tuple[float, ...]:
        """Return the state with the named entries, or the first start of the problem, ``(n_x,)``.

        Args:
            start: Values by state name, or ``None`` for the first initial state.
            values: Values at which the problem's start must be admissible. By default it is
                evaluated at the defaults, where a problem is checked when it is loaded.

        Raises:
            InputError: If a name is not a state of the problem, a value is not a finite number, or
                the problem's start is not admissible.
        """
        if start is not None:
            return self.state_vector(start, values)
        if values is None:
            return self.state_vector(self.starts[0])
        return self._declared(self.starts[0], values)

    @of_kinds
    def admissible_starts(self, values: ParameterValues) -> tuple[tuple[float, ...], ...]:
        """Return the problem's initial states that are admissible, each ``(n_x,)``.

        Args:
            values: Values of every gain and parameter.

        Raises:
            InputError: If every start is refused. The message is about the first start.
        """
        found: list[tuple[float, ...]] = []
        refusal: InputError | None = None
        for start in self.starts:
            try:
                found.append(self._declared(start, values))
            except InputError as error:
                refusal = refusal or error
        if refusal is not None and not found:
            raise refusal
        return tuple(found)

    def _declared(self, start: Start, values: ParameterValues) -> tuple[float, ...]:
        """Return a start of the problem at values, if it is admissible there.

        Raises:
            InputError: If it is not admissible. The message holds both remedies.
        """
        from zeno_orbits.model.numeric.admission import require_start

        system = self.system(values)
        try:
            x = self.state_vector(start, values)
        except InputError as error:
            raise InputError(f"{error} Pass a start (`start`).") from error
        try:
            require_start(system, np.array(x), 0.0)
        except InputError as error:
            entries = zip(self.state_names, x, strict=True)
            told = ", ".join(f"{name}={value:g}" for name, value in entries if name in start)
            reason = str(error).removeprefix("Argument `state` ").rstrip(".")
            raise InputError(
                f"The declared start ({told or 'all states zero'}) {reason}, at these parameter "
                "values. Pass a start (`start`), or declare it as a formula of "
                'parameters, such as {"q": lambda p: p["d"]}.'
            ) from error
        return x


_MOST = 16
"""Number of cached compiled problems, limited for a session that creates thousands."""


def _needs_one_stop(problem: Problem, graph: ModeGraph) -> InputError:
    """Return the refusal of a machine with several stops, a switch or a kink."""
    return InputError(
        "Argument `problem`: one flow off the stop and one on it are needed here, but "
        f"`{problem.name}` has {graph.reason}."
    )


@lru_cache(maxsize=_MOST)
def _built(problem: Problem) -> tuple[CompletedSystem, dict[str, ca.SX]]:
    """Return the completed system of a problem, and the symbols of its parameters."""
    symbols = problem.symbols()
    return built(problem.model, symbols), symbols


def system_in_symbols(problem: Problem) -> tuple[CompletedSystem, Mapping[str, ca.SX]]:
    """Return the completed system of a problem, and the symbols of its gains and parameters.

    Args:
        problem: The problem.
    """
    return _built(problem)


@lru_cache(maxsize=_MOST)
def _compiled_graph(problem: Problem) -> CompiledGraph:
    """Return the functions of a machine over its modes."""
    from zeno_orbits.model.numeric.graph_dynamics import CompiledGraph

    system, symbols = _built(problem)
    if not system.is_built:
        raise InputError(
            "Argument `model` must return the system of `hybrid_system` as it is, but formulas of "
            "it are replaced. Change the mechanism, its stops or its drive instead."
        )
    return CompiledGraph(
        graph=system.graph,
        symbols=symbols,
        state_names=problem.state_names,
        starts=partial(_starts_at, problem),
        state_units=problem.state_units,
    )


@lru_cache(maxsize=_MOST)
def _compiled(problem: Problem) -> CompiledSystem:
    """Return the functions of a problem, shared by all parameter values.

    Building them takes as long as the simulation of a period. A problem is immutable, and its
    functions have symbols for all parameters. Each binding to parameter values has its own memory.
    """
    from zeno_orbits.model.numeric.compiled import compile_system

    system, symbols = _built(problem)
    if system.graph.reason:
        raise _needs_one_stop(problem, system.graph)
    compiled = compile_system(system, symbols, problem.state_names)
    starts = partial(_starts_at, problem)
    return replace(compiled, starts=starts, state_units=problem.state_units)


def _starts_at(problem: Problem, p: Sequence[float] | Vector) -> tuple[tuple[float, ...], ...]:
    """Return the initial states at a parameter vector, each ``(n_x,)``.

    Where a formula fails, no motion starts. Then the scales are those at the defaults.
    """
    if not any(callable(entry) for start in problem.starts for entry in start.values()):
        return _usual_starts(problem)
    n_gains, numbers = len(problem.gains), [float(one) for one in p]
    values = ParameterValues(
        gains=dict(zip(problem.names[:n_gains], numbers, strict=False)),
        parameters=dict(zip(problem.names[n_gains:], numbers[n_gains:], strict=True)),
    )
    try:
        states = [problem.state_vector(start, values) for start in problem.starts]
    except InputError:
        return _usual_starts(problem)
    return tuple(map(tuple, states))


@lru_cache(maxsize=_MOST)
def _usual_starts(problem: Problem) -> tuple[tuple[float, ...], ...]:
    """Return the initial states at the defaults, each ``(n_x,)``."""
    return tuple(map(tuple, map(problem.state_vector, problem.starts)))


def _require_states(problem: Problem) -> None:
    """Refuse starts, portraits and an amplitude that name no state."""
    states = problem.state_names
    require_starts(problem.starts, states)
    for argument, named in (
        *(("portraits", name) for pair in problem.portraits for name in pair),
        ("amplitude_of", problem.amplitude_of),
    ):
        if named not in states:
            known = ", ".join(states)
            message = f"must name states ({known}), but it names `{named}`"
            raise InputError(f"Argument `{argument}` {message}.{did_you_mean(str(named), states)}")


def _chosen(
    kind: str, quantities: tuple[Quantity, ...], given: Mapping[str, float], *, bounded: bool
) -> dict[str, float]:
    known = tuple(quantity.name for quantity in quantities)
    for name in given:
        if name not in known:
            raise InputError(unknown(kind, name, known))
    chosen: dict[str, float] = {}
    for quantity in quantities:
        value = given.get(quantity.name, quantity.default)
        if value is None and quantity.name not in given:
            continue
        number = finite_number(quantity.name, value)
        chosen[quantity.name] = quantity.checked(number) if bounded else number
    return chosen
