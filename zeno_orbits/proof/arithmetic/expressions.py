r"""The equations of a problem for the prover: one state vector, without folded constants.

CasADi folds constants in double arithmetic when it differentiates: :math:`1/3` of :math:`x/3`, and
1 of :math:`x + 2^{-54} x`. So every constant except powers of two first becomes a symbol, which
receives its exact value when a program is bound. Each state and parameter is multiplied by a symbol
for 1, so that derivatives are not sums of numbers. The gap and its rate are also states. If the
gap equals a coordinate up to its sign and a constant, they replace existing states. Otherwise they
are two additional states.
"""

from __future__ import annotations

import hashlib
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, cast

import casadi as ca

from zeno_orbits.errors import TableProofError, TranslationError
from zeno_orbits.integrators import called_table
from zeno_orbits.model import (
    CharacteristicScales,
    CompletedSystem,
    Problem,
    impact_speed,
    system_of_stop,
    watched,
)

_DEEP = 30
"""Depth to which two formulas of a gap are compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GapCoordinate:
    """A configuration coordinate that the gap is affine in: ``gap = sign * q + offset``.

    Attributes:
        place: Index of the coordinate in the state.
        sign: 1 or -1.
        offset: Gap at the zero of the coordinate, a function of the parameters.
    """

    place: int
    sign: int
    offset: ca.SX


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineView:
    """A stop of a machine with several stops, switches or kinks, on given sides of the kinks.

    Attributes:
        stop: Index of the stop.
        sides: Side of every kink, True where its condition is positive.
        held: Index of another stop that is held closed, or -1.
    """

    stop: int
    sides: tuple[bool, ...]
    held: int = -1


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofExpressions:
    r"""The equations in the prover's states ``y`` and numbers ``(p, constants)``.

    Attributes:
        digest: SHA-256 of the instructions of the formulas from which the other entries are
            derived.
        states: ``y``, ``(N,)``: the problem's states, of which two may be the gap and its rate,
            otherwise followed by gap and rate, then the parameters that are carried as states.
            Each state has its own unit.
        numbers: Symbols of gains and parameters, then of the constants.
        constants: Values of the constants.
        gap_place: Index of the gap in ``y``.
        rate_place: Index of the gap rate in ``y``.
        coordinate: Coordinate that determines the gap, or None if the gap is an additional state.
        free: Free flow `f`, ``(N,)``.
        locked: Constrained flow :math:`f - \ddot h\, D`, with zero rows for gap and rate, ``(N,)``.
        pressure: Minus the gap acceleration of the free flow at states on the stop. Contact ends
            when it vanishes.
        direction: Impulse direction `D`, scaled to unit gap rate, ``(N,)``.
        restitution: Coefficient of restitution.
        inertia: Mass matrix by columns, in the units of the problem, ``(n_q * n_q,)``.
        constraints: Expressions that vanish on the release section in addition to gap and rate, the
            pressure first.
        struck_constraints: Expressions that vanish on the section of the states just after an
            impact, in addition to the gap.
        defined: The gap and the holonomic constraints as the problem states them. The proof needs
            that they are analytic along the motion.
        holonomic: The holonomic constraints of the problem, and gap and gap rate of a held stop.
        n_stops: Number of stops, whose gaps and gap rates are states if `coordinate` is None.
        gaps: Gap and gap rate of every stop as functions of the problem's states.
        guards: Guards of the declared switches, then the conditions of the kinks on their sides.
        armed: The formulas `armed` of the declared switches.
        resets: State after each declared switch, ``(N,)`` each.
        room: Determinant of the responses of the own and the held stop, each in units of its own.
            It is positive if they are independent. Empty without a held stop.
        pushed: Change of the gap rate of the held stop per unit of the own one if it were not held.
            It is negative if an impact presses the held stop. Empty if it is zero.
    """

    digest: str
    states: ca.SX
    numbers: ca.SX
    constants: tuple[float, ...]
    gap_place: int
    rate_place: int
    coordinate: GapCoordinate | None
    free: ca.SX
    locked: ca.SX
    pressure: ca.SX
    direction: ca.SX
    restitution: ca.SX
    inertia: ca.SX
    constraints: ca.SX
    struck_constraints: ca.SX
    defined: ca.SX
    holonomic: ca.SX
    n_stops: int
    gaps: ca.SX
    guards: ca.SX
    armed: ca.SX
    resets: tuple[ca.SX, ...]
    room: ca.SX
    pushed: ca.SX


@dataclass(frozen=True, slots=True, kw_only=True)
class _Seen:
    """A view of a machine: its system with one stop, and what else the machine has.

    Attributes:
        held: The stop that is held, or -1.
        beside: Impulse direction of the stop that is held, or empty.
        moves: True if a reset changes a state on which a gap or a gap rate depends.
    """

    system: CompletedSystem
    gaps: tuple[ca.SX, ...]
    stop: int
    guards: ca.SX
    armed: ca.SX
    resets: tuple[ca.SX, ...]
    held: int = -1
    beside: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    moves: bool = False


def _seen(problem: Problem, symbols: Mapping[str, ca.SX], view: MachineView | None) -> _Seen:
    none = ca.SX(0, 1)
    if view is None:
        one = problem.one_stop_model(symbols)
        return _Seen(system=one, gaps=(one.gap,), stop=0, guards=none, armed=none, resets=())
    graph = problem.model(symbols).graph
    n, sides = len(graph.switches), view.sides
    every = [graph.guard(sides, k) for k in range(n + len(sides))]
    gaps = tuple(stop.gap for stop in watched(graph.stops))
    system, beside = system_of_stop(graph, ((), sides), view.stop), none
    if view.held >= 0:
        beside = system_of_stop(graph, ((), sides), view.held).impulse_direction
    return _Seen(
        system=system,
        held=view.held,
        beside=beside,
        gaps=gaps,
        moves=any(_moves(system, gaps, one) for one in graph.resets),
        stop=view.stop,
        guards=ca.densify(ca.vertcat(none, *every)),
        armed=ca.densify(ca.vertcat(none, *(ca.SX(one.armed) for one in graph.switches))),
        resets=tuple(ca.densify(one) for one in graph.resets),
    )


def _moves(system: CompletedSystem, gaps: Sequence[ca.SX], reset: ca.SX) -> bool:
    """Return True if a reset changes a state on which a gap or a gap rate depends."""
    x = system.state
    stacked = ca.vertcat(*gaps)
    ends = ca.vertcat(stacked, ca.jtimes(stacked, x, system.free_flow))
    columns = set(ca.jacobian(ends, x).sparsity().get_triplet()[1])
    return any(not ca.is_equal(reset[k], x[k]) for k in columns)


def _given(seen: _Seen, x: ca.SX, p: ca.SX) -> ca.Function:
    """Return the formulas of a problem by state, parameters and impact speed, resets last."""
    system = seen.system
    # The direction of an absent stop is 0 / 0. It has no impact.
    struck = ca.depends_on(ca.SX(system.gap), x)
    given = [
        system.free_flow,
        system.gap,
        system.impulse_direction if struck else ca.SX.zeros(x.numel()),
        system.law.at(impact_speed),
        system.holonomic,
        ca.vec(ca.densify(ca.SX(system.mechanism.mass_matrix))),
        ca.vertcat(*seen.gaps),
        seen.guards,
        seen.armed,
        seen.beside,
        *seen.resets,
    ]
    outputs = [ca.densify(ca.SX(one)) for one in given]
    return ca.Function("given", [x, p, impact_speed], outputs, {"cse": True})


def proof_expressions(
    problem: Problem,
    carried: Sequence[str] = (),
    sizes: Sequence[float] = (),
    view: MachineView | None = None,
) -> ProofExpressions:
    """Return a problem's equations for the prover.

    Args:
        problem: The problem.
        carried: Gains or parameters that become states of rate zero.
        sizes: Units of the prover's states, powers of two: for the problem's states, gap and rate,
            and the carried parameters. The default is 1 for all units.
        view: The stop and the sides of a machine with several stops, switches or kinks.

    Raises:
        TranslationError: If an operation is not analytic.
    """
    symbols = problem.symbols()
    seen = _seen(problem, symbols, view)
    system = seen.system
    x, p = system.state, ca.vertcat(*symbols.values())
    function = _given(seen, x, p)
    one = ca.SX.sym("one")
    outputs, names, values = _without_constants(function, one * x, one * p, one * impact_speed)
    over = [symbols[name] for name in carried]
    resets = [_bare(*pair, x) for pair in zip(outputs[10:], seen.resets, strict=True)]
    formulas, coordinate = _Formulas._make([*outputs[:10], resets]).at_impacts(x), None
    if len(seen.gaps) == 1 and not seen.moves:
        coordinate = _coordinate(system.n_q, x, one, formulas.gap, formulas.free, over)
    if coordinate is None:
        moving = [_moves(system, seen.gaps, one) for one in seen.resets]
        form = _with_gap_states(formulas, x, over, (seen.stop, seen.held), moving)
    else:
        form = _with_gap_coordinate(formulas, x, over, coordinate, system.n_q)
    # A symbol is used because CasADi would round the value of a function at the number 0.
    zero, places = ca.SX.sym("zero"), list(form.places)
    form = form.on_stop(zero)
    if sizes:
        n_x = x.numel()
        kept = sizes if coordinate is None else [*sizes[:n_x], *sizes[n_x + 2 :]]
        form = form.scaled(ca.SX(list(kept)))
    left = [symbols[name] for name in problem.names if name not in carried]
    return ProofExpressions(
        digest=_digest(seen, p),
        states=form.states,
        numbers=ca.vertcat(*left, *names, zero, one),
        constants=(*values, 0.0, 1.0),
        gap_place=places[0],
        rate_place=places[1],
        coordinate=coordinate,
        n_stops=len(seen.gaps),
        **form.parts,
        resets=tuple(form.resets),
    )


class _Formulas(NamedTuple):
    """The formulas of a problem, without constants."""

    free: ca.SX
    gap: ca.SX
    direction: ca.SX
    restitution: ca.SX
    holonomic: ca.SX
    inertia: ca.SX
    gaps: ca.SX
    guards: ca.SX
    armed: ca.SX
    beside: ca.SX
    resets: Sequence[ca.SX]

    def holding(self, x: ca.SX, stop: int, held: int) -> tuple[_Formulas, ca.SX, ca.SX]:
        """Return the formulas while a stop is held closed, and `room` and `pushed` of a view.

        The direction is normalised.
        """
        none, rates = ca.SX(0, 1), ca.jtimes(self.gaps, x, self.free)
        if not ca.depends_on(self.gaps[stop], x):
            return self._replace(direction=ca.SX.zeros(x.numel())), none, none
        along = self.direction / ca.jtimes(rates[stop], x, self.direction)
        if held < 0:
            return self._replace(direction=along), none, none
        beside = self.beside / ca.jtimes(rates[held], x, self.beside)
        free = self.free - ca.jtimes(rates[held], x, self.free) * beside
        pushed = ca.jtimes(rates[held], x, along)
        if pushed.is_zero():
            return self._replace(free=free, direction=along), none, none
        along = along - pushed * beside
        room = ca.jtimes(rates[stop], x, along)
        return self._replace(free=free, direction=along / room), room, pushed

    def at_impacts(self, x: ca.SX) -> _Formulas:
        """Return formulas whose impact speed is minus the gap rate of the state."""
        rate = ca.jtimes(self.gap, x, self.free)
        return self._replace(restitution=ca.substitute(self.restitution, impact_speed, -rate))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Form:
    """Formulas in the prover's states.

    Attributes:
        states: The states.
        places: Indices of the own gap and gap rate.
        ends: Indices of gap and gap rate of every stop.
        acceleration: The own gap acceleration.
        parts: Formulas by their names in `ProofExpressions`.
        resets: State after each declared switch.
    """

    states: ca.SX
    places: tuple[int, int]
    ends: Sequence[int]
    acceleration: ca.SX
    parts: dict[str, ca.SX]
    resets: Sequence[ca.SX]

    def on_stop(self, zero: ca.SX) -> _Form:
        """Return the formulas with constrained flow and pressure, at zero gap and gap rate."""
        parts, places = self.parts, list(self.places)
        locked = parts["free"] - self.acceleration * parts["direction"]
        locked[places] = 0
        stopped = ca.SX(self.states)
        stopped[places] = zero
        found = ca.substitute(
            [locked, -self.acceleration, parts["constraints"]], [self.states], [stopped]
        )
        names = ("locked", "pressure", "constraints")
        return replace(self, parts=parts | dict(zip(names, found, strict=True)))

    def scaled(self, unit: ca.SX) -> _Form:
        """Return the formulas of states in units."""
        every = ca.substitute(
            [*self.parts.values(), *self.resets], [self.states], [unit * self.states]
        )
        parts = dict(zip(self.parts, every, strict=False))
        for name in ("free", "locked"):
            parts[name] = parts[name] / unit
        parts["direction"] = parts["direction"] * unit[self.places[1]] / unit
        parts["gaps"] = parts["gaps"] / unit[list(self.ends)]
        resets = [one / unit for one in every[len(parts) :]]
        return replace(self, parts=parts, resets=resets)


def _with_gap_states(
    f: _Formulas, x: ca.SX, over: Sequence[ca.SX], stops: tuple[int, int], moving: Sequence[bool]
) -> _Form:
    """Return formulas with gap and gap rate of every stop as additional states.

    Resets that move a gap set these states anew. A stop whose gap is constant is never struck. Gap
    and gap rate of a held stop, the second of the stops, are zero.
    """
    stop, held = stops
    n, n_x, still = f.gaps.numel(), x.numel(), ca.SX.zeros(len(over))
    ends = ca.SX.sym("gap", 2 * n)
    rates = ca.jtimes(f.gaps, x, f.free)
    f, room, pressed = f.holding(x, stop, held)
    accelerations, speeds = ca.jtimes(rates, x, f.free), ca.SX(ends[1::2])
    pushed = ca.jtimes(rates, x, f.direction)
    pushed[stop] = 1
    kept = ca.SX(f.holonomic)
    if held >= 0:
        accelerations[held], speeds[held], pushed[held] = 0, 0, 0
        kept = ca.vertcat(f.gaps[held], rates[held], kept)

    def paired(first: ca.SX, second: ca.SX) -> ca.SX:
        return ca.vec(ca.horzcat(first, second).T)

    constraints = ca.vertcat(-accelerations[stop], f.gap, rates[stop], kept)
    own_ends = paired(f.gaps, rates)
    resets = [
        ca.vertcat(reset, _ends_after(own_ends, x, reset, ends) if moves else ends, *over)
        for reset, moves in zip(f.resets, moving, strict=True)
    ]
    return _Form(
        states=ca.vertcat(x, ends, *over),
        places=(n_x + 2 * stop, n_x + 2 * stop + 1),
        ends=range(n_x, n_x + 2 * n),
        acceleration=accelerations[stop],
        parts={
            "free": ca.vertcat(f.free, paired(speeds, accelerations), still),
            "direction": ca.vertcat(f.direction, paired(ca.SX.zeros(n), pushed), still),
            "restitution": f.restitution,
            "inertia": f.inertia,
            "constraints": constraints,
            "struck_constraints": ca.vertcat(f.gap, kept),
            "defined": ca.vertcat(f.gap, f.holonomic),
            "holonomic": kept,
            "gaps": own_ends,
            "guards": f.guards,
            "armed": f.armed,
            "room": room,
            "pushed": pressed,
        },
        resets=resets,
    )


def _bare(reset: ca.SX, given: ca.SX, x: ca.SX) -> ca.SX:
    """Return a reset without the factors 1 of the states that it leaves unchanged."""
    rows = [x[k] if ca.is_equal(given[k], x[k]) else reset[k] for k in range(x.numel())]
    return ca.vertcat(*rows)


def _ends_after(own: ca.SX, x: ca.SX, reset: ca.SX, ends: ca.SX) -> ca.SX:
    """Return gaps and gap rates after a reset. Unchanged states are the states before it."""
    after = ca.substitute(own, x, reset)
    rows = [
        ends[k] if ca.is_equal(after[k], own[k], _DEEP) else after[k] for k in range(own.numel())
    ]
    return ca.vertcat(*rows)


def _with_gap_coordinate(
    f: _Formulas, x: ca.SX, over: Sequence[ca.SX], coordinate: GapCoordinate, n_q: int
) -> _Form:
    """Return formulas with the gap and its rate in place of the coordinate and its rate."""
    g, sign, still = coordinate.place, coordinate.sign, ca.SX.zeros(len(over))
    rate = n_q + g
    moved = ca.SX(x)
    moved[g] = sign * (x[g] - coordinate.offset)
    moved[rate] = sign * x[rate]
    resets = [ca.vertcat(reset, *over) for reset in f.resets]
    found = ca.substitute([*f[:-1], *resets], [x], [moved])
    free, gap, direction, restitution, holonomic, inertia, _, guards, armed, _, *resets = found
    # No reset of a machine in this form changes the coordinate or its rate.
    for reset in resets:
        reset[g], reset[rate] = x[g], x[rate]
    for expression in (free, direction):
        expression[rate] *= sign
    free[g], acceleration = x[rate], free[rate]
    direction = direction / direction[rate]
    direction[g], direction[rate] = 0, 1
    return _Form(
        states=ca.vertcat(x, *over),
        places=(g, rate),
        ends=(g, rate),
        acceleration=acceleration,
        parts={
            "free": ca.vertcat(free, still),
            "direction": ca.vertcat(direction, still),
            "restitution": restitution,
            "inertia": inertia,
            "constraints": ca.vertcat(-acceleration, holonomic),
            "struck_constraints": ca.SX(holonomic),
            "defined": ca.vertcat(gap, holonomic),
            "holonomic": ca.SX(holonomic),
            "gaps": ca.vertcat(x[g], x[rate]),
            "guards": guards,
            "armed": armed,
            "room": ca.SX(0, 1),
            "pushed": ca.SX(0, 1),
        },
        resets=resets,
    )


def _digest(seen: _Seen, numbers: ca.SX) -> str:
    """Return the SHA-256 of the instructions of a system's formulas, as in the checker."""
    system = seen.system
    given: list[Any] = [
        system.free_flow,
        system.locked_flow,
        ca.vertcat(*system.contact),
        system.impulse_direction,
        system.law_numbers,
        system.holonomic,
    ]
    if seen.guards.numel() or len(seen.gaps) > 1:
        given += [ca.vertcat(*seen.gaps), seen.guards, seen.armed, *seen.resets]
    outputs = [ca.densify(ca.SX(one)) for one in given]
    f = ca.Function("system", [system.state, numbers], outputs)
    heading = f"{system.state.numel()} {numbers.numel()} {system.n_q}"
    lines = [heading, *_instructions(f)]
    if system.law.of_speed is not None:
        law = [ca.densify(ca.SX(system.law.at(impact_speed)))]
        lines += _instructions(ca.Function("coefficient", [numbers, impact_speed], law))
    return hashlib.sha256("".join(line + "\n" for line in lines).encode()).hexdigest()


def _instructions(f: ca.Function) -> list[str]:
    """Return the instructions of a function as lines."""
    lines = list[str]()
    for k in range(f.n_instructions()):
        code = f.instruction_id(k)
        takes, gives = f.instruction_input(k), f.instruction_output(k)
        words = [
            proof_operation(code).upper(),
            ",".join(map(str, takes)),
            ",".join(map(str, gives)),
        ]
        if code == ca.OP_CONST:
            words.append(float(f.instruction_constant(k)).hex())
        lines.append(" ".join(words))
    return lines


def stop_identities(
    problem: Problem, own: CharacteristicScales
) -> tuple[ca.Function, dict[str, float]]:
    """Return expressions that vanish if the other formulas agree with the formulas of the proof.

    The proof uses free flow, gap, impulse direction, restitution and constraints. Simulations use
    further formulas of the problem. If these differ, an orbit file describes another system.

    Args:
        problem: The problem.
        own: Characteristic sizes of the problem's quantities.

    Returns:
        A function of state and parameters with a column of terms for each identity, whose sum is
        zero, and the description of each identity, mapped to the size of its terms.
    """
    symbols = problem.symbols()
    s = problem.one_stop_model(symbols)
    gap, rate = (ca.jacobian(one, s.state).T for one in (s.gap, s.gap_rate))
    columns: list[Any] = [
        (gap * s.free_flow, -s.gap_rate),
        (rate * s.free_flow, -s.gap_acceleration),
        (rate * s.impulse_direction, -1),
        (s.multiplier, s.gap_acceleration * s.normal_inertia),
    ]
    sizes = {
        "gap_rate is the rate of gap": own.gap_rate,
        "gap_acceleration is the rate of gap_rate": own.gap_acceleration,
        "an impact turns the gap rate round": 1.0,
        "multiplier is minus gap_acceleration times normal_inertia": own.multiplier,
    }
    per_time = own.gap_rate / own.gap
    for k, size in enumerate(own.states(s.state.numel())):
        pushed = s.gap_acceleration * s.impulse_direction[k]
        columns.append((s.locked_flow[k], -s.free_flow[k], pushed))
        name = problem.state_names[k] if k < len(problem.state_names) else str(k)
        what = "locked_flow is free_flow minus gap_acceleration times impulse_direction"
        sizes[f"{what} in the row of {name}"] = size * per_time
    outputs: list[ca.SX] = [ca.densify(cast("ca.SX", ca.vertcat(*column))) for column in columns]
    return ca.Function("identities", [s.state, ca.vertcat(*symbols.values())], outputs), sizes


def _coordinate(
    n_q: int, x: ca.SX, one: ca.SX, gap: ca.SX, free: ca.SX, carried: Sequence[ca.SX]
) -> GapCoordinate | None:
    """Return the coordinate with gap = plus or minus coordinate + constant, or None if none exists.

    Args:
        n_q: Number of coordinates.
        x: The problem's state.
        one: Symbols that multiply each state in the formulas.
        gap: The gap of the problem.
        free: The free flow of the problem. The rate of the coordinate must be a velocity state.
        carried: Parameters that vary. The position of the stop must not depend on them.
    """
    if any(ca.depends_on(gap, parameter) for parameter in carried):
        return None
    slopes = ca.jacobian(gap, x)
    places = [k for k in range(x.numel()) if not slopes[k].is_zero()]
    if len(places) != 1 or places[0] >= n_q:
        return None
    (place,) = places
    signs = [sign for sign in (1, -1) if ca.is_equal(slopes[place], sign * one, 1)]
    if not signs or not ca.is_equal(free[place], one * x[n_q + place], 1):
        return None
    offset = ca.substitute(gap, x[place], ca.SX(0))
    return GapCoordinate(place=place, sign=signs[0], offset=offset)


def _without_constants(
    function: ca.Function, *inputs: ca.SX
) -> tuple[list[ca.SX], list[ca.SX], list[float]]:
    """Return the outputs with symbols in place of constants, the symbols, and their values."""
    outputs = [ca.SX.zeros(*function.size_out(k)) for k in range(function.n_out())]
    symbols: dict[float, ca.SX] = {}
    work: dict[int, ca.SX] = {}
    fixed: dict[int, float] = {}
    table = _operations()
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        takes, gives = function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_OUTPUT:
            outputs[gives[0]][gives[1]] = work[takes[0]]
            continue
        place = gives[0]
        if code == ca.OP_INPUT:
            work[place] = inputs[takes[0]][takes[1]]
        elif code == ca.OP_CONST:
            value = float(function.instruction_constant(k))
            fixed[place] = value
            work[place] = _constant(value, symbols)
            continue
        elif code in (ca.OP_POW, ca.OP_CONSTPOW):
            base = work[takes[0]]
            if takes[0] in fixed:
                # CasADi would compute the logarithm of a number in double arithmetic.
                base = symbols.setdefault(fixed[takes[0]], ca.SX.sym(f"constant{len(symbols)}"))
            work[place] = _power(base, work[takes[1]], fixed.get(takes[1]))
        elif code in table:
            work[place] = table[code](*(work[one] for one in takes))
        elif code == ca.OP_CALL:
            raise TableProofError(called_table(function, k))
        else:
            raise TranslationError(proof_operation(code))
        # The index may have held an operand.
        fixed.pop(place, None)
    return outputs, list(symbols.values()), list(symbols)


def _constant(value: float, symbols: dict[float, ca.SX]) -> ca.SX:
    """Return a power of two or zero unchanged, and a symbol for any other constant."""
    if value == 0.0 or math.frexp(abs(value))[0] == 0.5:
        return ca.SX(value)
    return symbols.setdefault(value, ca.SX.sym(f"constant{len(symbols)}"))


def _power(base: ca.SX, exponent: ca.SX, value: float | None) -> ca.SX:
    """Return a power: unchanged for integer exponents, otherwise by exponential and logarithm."""
    if value is not None and value == round(value) and abs(value) < 64:
        return base ** int(value)
    if value is not None and 2 * value == round(2 * value) and abs(value) < 32:
        return ca.sqrt(base) ** int(2 * value)
    return ca.exp(exponent * ca.log(base))


def _operations() -> Mapping[int, Callable[..., Any]]:
    """Return CasADi's operations as functions of their arguments, keyed by code."""

    def quotient(a: ca.SX, b: ca.SX) -> ca.SX:
        return a / b

    def inverse(a: ca.SX) -> ca.SX:
        return 1 / a

    def square(a: ca.SX) -> ca.SX:
        return a * a

    def hypotenuse(a: ca.SX, b: ca.SX) -> ca.SX:
        return ca.sqrt(a * a + b * b)

    def angle(y: ca.SX, x: ca.SX) -> ca.SX:
        return 2 * ca.atan(y / (x + hypotenuse(x, y)))

    table: dict[int, Callable[..., Any]] = {
        ca.OP_ASSIGN: operator.pos,
        ca.OP_ADD: operator.add,
        ca.OP_SUB: operator.sub,
        ca.OP_MUL: operator.mul,
        ca.OP_DIV: quotient,
        ca.OP_NEG: operator.neg,
        ca.OP_TWICE: partial(operator.mul, 2),
        ca.OP_SQ: square,
        ca.OP_INV: inverse,
        ca.OP_HYPOT: hypotenuse,
        ca.OP_ATAN2: angle,
        **{
            getattr(ca, f"OP_{name.upper()}"): getattr(ca, name)
            for name in (
                *("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos"),
                *("atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
            )
        },
    }
    return table


def proof_operation(code: int) -> str:
    """Return CasADi's name of an operation."""
    names = (name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == code)
    return next(names, f"OP_{code}").removeprefix("OP_").lower()
