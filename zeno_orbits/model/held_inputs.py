r"""A problem some of whose gains or parameters are held states, set anew at an event by a law.

.. math:: u^+ = \mathrm{clip}\bigl(u^* - K\,(y - y^*)\bigr)

The centre :math:`u^*` is the gain or parameter itself. `K` and :math:`y^*` are parameters.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import casadi as ca

from zeno_orbits.errors import InputError, did_you_mean, finite_number
from zeno_orbits.model.declared.quantities import Quantity, unknown
from zeno_orbits.model.declared.starts import Start
from zeno_orbits.model.drives.auxiliary import Auxiliary
from zeno_orbits.model.drives.circuits import Drive
from zeno_orbits.model.drives.holds import Hold, require_event
from zeno_orbits.model.expressions.units import unit_quotient
from zeno_orbits.model.graph import hybrid_system
from zeno_orbits.model.hybrid import CompletedSystem
from zeno_orbits.model.library import bundled_problems, split_fidelity
from zeno_orbits.model.problem import Problem
from zeno_orbits.model.stops import Switch

HELD, NEXT, CENTRE = "held", "next", "centre"
"""First parts of the names of held inputs, of inputs that wait, and of measured centres."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldLaw:
    """A linear law of inputs that are held between events.

    Attributes:
        inputs: Name of each gain or parameter that is held, to its least and largest value.
        at: The event at which they are set.
        gain: Name of each input to the coefficients of the measured states, and with a delay of
            the inputs in use, by name.
        centre: Value of every measured state at which the inputs have their own values.
        delay: Whether a value acts one event after its measurement.
    """

    inputs: Mapping[str, tuple[float, float]]
    at: str
    gain: Mapping[str, Mapping[str, float]]
    centre: Mapping[str, float]
    delay: bool = False

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measured states, and with a delay of the inputs in use."""
        return (*self.centre, *(self.inputs if self.delay else ()))

    def value(
        self,
        name: str,
        states: Mapping[str, ca.SX],
        used: Mapping[str, ca.SX],
        p: Mapping[str, ca.SX],
    ) -> ca.SX:
        """Return the next value of an input as a formula.

        Args:
            name: Name of the input.
            states: States by name.
            used: Inputs in use, by name.
            p: Gains and parameters by name, those of the law among them.
        """
        away = {one: states[one] - p[centre_name(name, one)] for one in self.centre}
        away |= {one: used[one] - p[one] for one in self.measured if one not in away}
        wished = p[name] - sum(p[coefficient_name(name, one)] * x for one, x in away.items())
        low, high = self.inputs[name]
        wished = wished if low == -math.inf else ca.fmax(low, wished)
        return ca.SX(wished if high == math.inf else ca.fmin(high, wished))


def held_file(
    word: str, folder: Path, law: HeldLaw, values: Mapping[str, float], start: Mapping[str, float]
) -> str:
    """Return the text of a problem file that calls `zo.hold_inputs`.

    Args:
        word: Name of the problem if it is bundled, or the path of its file.
        folder: Folder of the new file, from which the path is relative.
        law: The law of the inputs.
        values: Gains and parameters that become defaults, by name.
        start: State from which the machine starts.
    """
    is_bundled = split_fidelity(word)[0] in bundled_problems()
    given = repr(word)
    if not is_bundled:
        path = os.path.relpath(word, os.path.realpath(folder))
        given = f"str(Path(__file__).parent / {Path(path).as_posix()!r})"
    rows = {
        "inputs": {one: tuple(map(float, ends)) for one, ends in law.inputs.items()},
        "at": law.at,
        "gain": {one: {k: float(x) for k, x in row.items()} for one, row in law.gain.items()},
        "centre": {one: float(x) for one, x in law.centre.items()},
        "delay": law.delay,
        "values": {one: float(x) for one, x in values.items()},
        "start": {one: float(x) for one, x in start.items()},
    }
    lines = [f"    {name}={_python(value)},\n" for name, value in rows.items()]
    names = " and ".join(law.inputs)
    imports = "" if is_bundled else "from pathlib import Path\n\n"
    return (
        f'"""A machine with {names} set at each `{law.at}` by a feedback."""\n\n{imports}'
        f"import zeno_orbits as zo\n\nPROBLEM = zo.hold_inputs(\n    {given},\n"
        f"{''.join(lines)})\n"
    )


def _python(value: Any) -> str:
    """Return a value as Python has it. Python lacks literals of infinite numbers."""
    if isinstance(value, dict):
        rows = cast("dict[str, Any]", value)
        return "{" + ", ".join(f'"{one}": {_python(x)}' for one, x in rows.items()) + "}"
    if isinstance(value, tuple):
        return "(" + ", ".join(map(_python, cast("tuple[Any, ...]", value))) + ")"
    if isinstance(value, float) and not math.isfinite(value):
        return f'float("{value}")'
    return f'"{value}"' if isinstance(value, str) else repr(value)


def centre_name(name: str, measured: str) -> str:
    """Return the name of the value of a measured state at which an input has its own value."""
    return f"{CENTRE}_{name}_{measured}"


def coefficient_name(name: str, measured: str) -> str:
    """Return the name of a coefficient of a law as a parameter."""
    return f"K_{name}_{measured}"


def with_held_inputs(
    problem: Problem,
    law: HeldLaw,
    *,
    name: str | None = None,
    values: Mapping[str, float] | None = None,
    start: Start | None = None,
) -> Problem:
    """Return a problem some of whose gains or parameters are held states.

    The state ``held_NAME`` takes the place of the input, and ``next_NAME`` waits with a delay. The
    coefficients and centres of the law are parameters: ``K_NAME_STATE`` and ``centre_NAME_STATE``.

    Args:
        problem: The problem.
        law: The law of the inputs.
        name: Name of the new problem. The default is ``PROBLEM_held``.
        values: Gains and parameters that become defaults, by name.
        start: Values of states from which the machine starts. Inputs that it lacks have their own
            values.

    Raises:
        InputError: If a name is unknown or taken, a range is empty, or the law lacks a coefficient.
    """
    _require_law(problem, law)
    _require_no_time(problem, law)
    values = dict(values or {})
    added = tuple(_law_quantities(problem, law))
    parts = (HELD, *((NEXT,) if law.delay else ()))
    states = {f"{part}_{one}": one for one in law.inputs for part in parts}
    for one in (*states, *(quantity.name for quantity in added)):
        if one in (*problem.names, *problem.state_names):
            raise InputError(f"Argument `problem` must not have the name `{one}`, which is needed.")
    n_drive = len(problem.state_names) - len(problem.clock)
    names = (*problem.state_names[:n_drive], *states, *problem.state_names[n_drive:])
    own = dict(zip(problem.state_names, problem.state_units, strict=True))
    units = own | {state: problem.units[one] for state, one in states.items()}
    own_values = {state: _value_of(one) for state, one in states.items()}
    given = [dict(start)] if start is not None else []
    return replace(
        problem,
        name=name or f"{problem.name}_held",
        title=f"{problem.title}, {' and '.join(law.inputs)} set at each {law.at}",
        state_names=names,
        state_units=tuple(units[one] for one in names),
        gains=tuple(_with_default(one, values) for one in problem.gains),
        parameters=(*(_with_default(one, values) for one in problem.parameters), *added),
        model=_Model(problem=problem, law=law),
        starts=tuple({**own_values, **one} for one in (*given, *problem.starts)),
        derive=None if problem.derive is None else _Derived(problem=problem),
        reference=None,
        fidelities={},
        origin=None,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Derived:
    """The derivation of a problem's parameters, without those of a law."""

    problem: Problem

    def __call__(self, given: Mapping[str, float]) -> Mapping[str, float]:
        known = {one.name for one in self.problem.parameters}
        derive = self.problem.derive
        own = {name: value for name, value in given.items() if name in known}
        return {} if derive is None else derive(own)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Model:
    """The model of a problem with held inputs."""

    problem: Problem
    law: HeldLaw

    def __call__(self, p: Mapping[str, ca.SX]) -> CompletedSystem:
        law, inputs = self.law, tuple(self.law.inputs)
        used = {one: ca.SX.sym(f"{HELD}_{one}") for one in inputs}
        waiting = {one: ca.SX.sym(f"{NEXT}_{one}") for one in inputs if law.delay}
        base = self.problem.model({**p, **used})
        n_drive = 2 * base.n_q + base.drive.states.numel()
        places = [*range(n_drive), *base.clock]
        known = zip(self.problem.state_names, places, strict=True)
        states = {name: base.state[k] for name, k in known}
        every: list[ca.SX] = []
        after: list[ca.SX] = []
        for one in inputs:
            in_use = waiting if law.delay else used
            value = law.value(one, states, in_use, p)
            every += [used[one], *([waiting[one]] if law.delay else [])]
            after += [waiting[one], value] if law.delay else [value]
        return _held(base, law.at, ca.vertcat(*every), ca.vertcat(*after))


def _held(base: CompletedSystem, at: str, states: ca.SX, after: ca.SX) -> CompletedSystem:
    """Return a machine with further states that are set at one of its events."""
    graph = base.graph
    switches = [
        one
        for k, (one, cause) in enumerate(zip(graph.switches, graph.causes, strict=True))
        if not (cause or k in graph.frictional)
    ]
    kind, _, name = at.partition(" ")
    part: Hold | Auxiliary = Hold(states=states, at=at, after=after)
    if kind == "switch":
        if name not in [switch.name for switch in switches]:
            raise InputError(f"Argument `at`: `{at}` is a kink, which sets no states.")
        # The law holds for the state before the switch, the section's own.
        part = Auxiliary(states=states, rate=ca.SX.zeros(states.numel()))
        own = base.drive.states
        switches = [
            _with_reset(one, own, states, after if one.name == name else states) for one in switches
        ]
    elif switches:
        switches = [_with_reset(one, base.drive.states, states, states) for one in switches]
    stop_restitution = base.stop_restitution if base.bare.has_gap else None
    parts: Sequence[Drive | Hold | Auxiliary] = (*base.drive.parts, part)
    return hybrid_system(base.bare, parts, stop_restitution, switches=switches or None)


def _with_reset(switch: Switch, own: ca.SX, states: ca.SX, after: ca.SX) -> Switch:
    """Return a switch that also sets further states. It keeps them if they are their own values."""
    if switch.others_after is None and after is states:
        return switch
    others = own if switch.others_after is None else ca.vec(ca.SX(switch.others_after))
    return replace(switch, others_after=ca.vertcat(others, after))


def _require_law(problem: Problem, law: HeldLaw) -> None:
    """Refuse unknown names, empty ranges and missing coefficients.

    Raises:
        InputError: If there is one.
    """
    if not law.inputs:
        raise InputError("Argument `inputs` must name at least one gain or parameter.")
    require_event(law.at)
    for one, (low, high) in law.inputs.items():
        if one not in problem.names:
            raise InputError(unknown("inputs", one, problem.names))
        if not low <= high:
            raise InputError(
                f"Argument `inputs` must have a range LOWER <= UPPER for `{one}`, but it is "
                f"{low:g}:{high:g}."
            )
        for measured in law.measured:
            if measured not in law.gain.get(one, {}):
                raise InputError(
                    f"Argument `gain` lacks the coefficient of `{measured}` in `{one}`."
                )
            finite_number(f"gain of {measured}", law.gain[one][measured])
    for one, value in law.centre.items():
        if one not in problem.state_names:
            hint = did_you_mean(one, problem.state_names)
            raise InputError(f"Argument `centre` names the unknown state `{one}`.{hint}")
        finite_number(f"centre of {one}", value)


def _require_no_time(problem: Problem, law: HeldLaw) -> None:
    """Refuse a switching time of a waveform: it must not change with the state.

    Raises:
        InputError: If an input is one.
    """
    compiled = problem.compiled_graph()
    orders = compiled.graph.time_orders
    times = ca.vertcat(ca.SX(0, 1), *(ca.vertcat(one.lower, one.upper) for one in orders))
    for one in law.inputs:
        if times.numel() and ca.depends_on(times, compiled.symbols[one]):
            raise InputError(
                f"Argument `inputs`: `{one}` determines a switching time of a waveform, which "
                "cannot be a state. Take an amplitude."
            )


def _law_quantities(problem: Problem, law: HeldLaw) -> list[Quantity]:
    """Return the coefficients and centres of a law as parameters."""
    found: list[Quantity] = []
    for name in law.inputs:
        for one in law.measured:
            unit = unit_quotient(problem.units[name], problem.units[one])
            found.append(
                Quantity(
                    name=coefficient_name(name, one),
                    unit=unit,
                    meaning=f"decrease of {name} per {one}",
                    default=float(law.gain[name][one]),
                )
            )
        for one, value in law.centre.items():
            found.append(
                Quantity(
                    name=centre_name(name, one),
                    unit=problem.units[one],
                    meaning=f"{one} at which {name} has its own value",
                    default=float(value),
                )
            )
    return found


def _with_default(quantity: Quantity, values: Mapping[str, float]) -> Quantity:
    """Return a quantity with another default in its range, unless the problem derives it."""
    if quantity.name not in values or quantity.default is None:
        return quantity
    value = float(values[quantity.name])
    low, high = min(quantity.lower, value), max(quantity.upper, value)
    return replace(quantity, default=value, lower=low, upper=high)


def _value_of(name: str) -> Any:
    def value(p: Mapping[str, float]) -> float:
        return float(p[name])

    return value
