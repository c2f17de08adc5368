r"""The equations of a problem as the prover takes them: one state vector, no folded constants.

CasADi folds constants in double arithmetic when it differentiates: :math:`1/3` of :math:`x/3`. So
every constant but the powers of two becomes a symbol first, and gets its number back, exactly, when
a program is bound. The gap and its rate are states of their own: two coordinates where the gap is
plus or minus one of them, else two more.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca

from zeno_orbits.errors import TranslationError
from zeno_orbits.model import CompletedSystem, OwnScale, Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class GapCoordinate:
    """A configuration coordinate that the gap is affine in: ``gap = sign * q + offset``.

    Attributes:
        place: Its place in the state.
        sign: 1 or -1.
        offset: Gap where the coordinate is zero, of the parameters.
    """

    place: int
    sign: int
    offset: ca.SX


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofExpressions:
    """The equations in the prover's states ``y`` and numbers ``(p, constants)``.

    Attributes:
        states: ``y``, ``(N,)``: the problem's states, of which two may be the gap and its rate;
            gap and rate if they are none of them; parameters that are carried as states; each in
            its own unit.
        numbers: Gains and parameters, then the constants, symbols.
        constants: Values of the constants.
        gap_place: Place of the gap in ``y``.
        rate_place: Place of its rate.
        coordinate: What the gap is a coordinate of; None if it is not.
        free: Free flow, ``(N,)``.
        locked: Locked flow, its rows of gap and rate zero, ``(N,)``.
        multiplier: On the stop.
        direction: Change of ``y`` at an impact by unit gap rate, ``(N,)``.
        restitution: Coefficient of restitution.
        constraints: What is zero on the release section besides gap and rate, the multiplier first.
    """

    states: ca.SX
    numbers: ca.SX
    constants: tuple[float, ...]
    gap_place: int
    rate_place: int
    coordinate: GapCoordinate | None
    free: ca.SX
    locked: ca.SX
    multiplier: ca.SX
    direction: ca.SX
    restitution: ca.SX
    constraints: ca.SX


def proof_expressions(
    problem: Problem, carried: Sequence[str] = (), sizes: Sequence[float] = ()
) -> ProofExpressions:
    """Return a problem's equations for the prover.

    Args:
        problem: The problem.
        carried: Gains or parameters that become states of rate zero.
        sizes: Units of the prover's states, powers of two: those of the problem's states, of gap
            and rate, and of the carried parameters; by default all are 1.

    Raises:
        TranslationError: If an operation is not analytic.
    """
    symbols = problem.symbols()
    system = problem.model(symbols)
    x, p = system.state, ca.vertcat(*symbols.values())
    given = [
        system.free_flow,
        system.locked_flow,
        system.gap,
        system.gap_rate,
        system.gap_acceleration,
        system.multiplier,
        system.impulse_direction,
        system.restitution,
        system.holonomic,
    ]
    function = ca.Function(
        "given", [x, p], [ca.densify(ca.SX(one)) for one in given], {"cse": True}
    )
    outputs, names, values = _without_constants(function, x, p)
    free, locked, gap, rate, acceleration, multiplier, direction, restitution, holonomic = outputs
    over = [symbols[name] for name in carried]
    coordinate = _coordinate(system, gap, over)
    still = ca.SX.zeros(len(over))
    if coordinate is None:
        ends = ca.SX.sym("gap", 2)
        states = ca.vertcat(x, ends, *over)
        places = (x.numel(), x.numel() + 1)
        free = ca.vertcat(free, ends[1], acceleration, still)
        locked = ca.vertcat(locked, 0, 0, still)
        direction = ca.vertcat(direction, 0, 1, still)
        constraints = ca.vertcat(multiplier, gap, rate, holonomic)
    else:
        g, sign = coordinate.place, coordinate.sign
        places = (g, system.n_q + g)
        states = ca.vertcat(x, *over)
        moved = ca.SX(x)
        moved[g] = sign * (x[g] - coordinate.offset)
        moved[places[1]] = sign * x[places[1]]
        for expression in (free, locked, direction):
            expression[g] *= sign
            expression[places[1]] *= sign
        locked[g], locked[places[1]] = 0, 0
        direction[g], direction[places[1]] = 0, 1
        free, locked, direction, multiplier, holonomic = ca.substitute(
            [free, locked, direction, multiplier, holonomic], [x], [moved]
        )
        free[g] = x[places[1]]
        free, locked, direction = (ca.vertcat(e, still) for e in (free, locked, direction))
        constraints = ca.vertcat(multiplier, holonomic)
    on_stop = ca.SX(states)
    on_stop[list(places)] = 0
    locked, multiplier, constraints = ca.substitute(
        [locked, multiplier, constraints], [states], [on_stop]
    )
    if sizes:
        n_x = x.numel()
        kept = sizes if coordinate is None else [*sizes[:n_x], *sizes[n_x + 2 :]]
        unit = ca.SX(list(kept))
        parts = [free, locked, direction, multiplier, restitution, constraints]
        free, locked, direction, multiplier, restitution, constraints = ca.substitute(
            parts, [states], [unit * states]
        )
        free, locked = free / unit, locked / unit
        direction = direction * unit[places[1]] / unit
    left = [symbols[name] for name in problem.names if name not in carried]
    return ProofExpressions(
        states=states,
        numbers=ca.vertcat(*left, *names),
        constants=tuple(values),
        gap_place=places[0],
        rate_place=places[1],
        coordinate=coordinate,
        free=free,
        locked=locked,
        multiplier=multiplier,
        direction=direction,
        restitution=restitution,
        constraints=constraints,
    )


def stop_identities(problem: Problem, own: OwnScale) -> tuple[ca.Function, dict[str, float]]:
    """Return what vanishes identically in a problem whose stop obeys the laws.

    The prover takes these identities for granted: in balls they would only hold to their width.

    Args:
        problem: The problem.
        own: Sizes of its numbers.

    Returns:
        A function of state and numbers with a column of terms for each identity, their sum zero;
        and what each says, to the size of its numbers.
    """
    symbols = problem.symbols()
    s = problem.model(symbols)
    gap, rate = (ca.jacobian(one, s.state).T for one in (s.gap, s.gap_rate))
    columns = [
        (gap * s.free_flow, -s.gap_rate),
        (rate * s.free_flow, -s.gap_acceleration),
        (gap * s.impulse_direction, 0),
        (rate * s.impulse_direction, -1),
        (rate * s.locked_flow, 0),
        (s.multiplier, s.gap_acceleration * s.normal_inertia),
    ]
    sizes = {
        "gap_rate is the rate of gap": own.gap_rate,
        "gap_acceleration is the rate of gap_rate": own.gap_acceleration,
        "an impact leaves the gap": own.gap / own.gap_rate,
        "an impact turns the gap rate round": 1.0,
        "a stop that holds keeps the gap rate": own.gap_acceleration,
        "multiplier is what keeps the gap rate": own.multiplier,
    }
    outputs = [ca.densify(ca.vertcat(*column)) for column in columns]
    return ca.Function("identities", [s.state, ca.vertcat(*symbols.values())], outputs), sizes


def _coordinate(
    system: CompletedSystem, gap: ca.SX, carried: Sequence[ca.SX]
) -> GapCoordinate | None:
    """Return the coordinate that the gap is plus or minus, and a number; None if there is none.

    Args:
        system: The problem.
        gap: Its gap.
        carried: Parameters that vary; the place of the stop must be none of theirs.
    """
    if any(ca.depends_on(gap, one) for one in carried):
        return None
    slopes = ca.jacobian(gap, system.state)
    places = [k for k in range(system.state.numel()) if not slopes[k].is_zero()]
    if len(places) != 1 or places[0] >= system.n_q or not slopes[places[0]].is_constant():
        return None
    slope = float(ca.DM(slopes[places[0]]))
    if abs(slope) != 1.0:
        return None
    offset = ca.substitute(gap, system.state[places[0]], ca.SX(0))
    return GapCoordinate(place=places[0], sign=int(slope), offset=offset)


def _without_constants(
    function: ca.Function, x: ca.SX, p: ca.SX
) -> tuple[list[ca.SX], list[ca.SX], list[float]]:
    """Return the outputs with symbols for constants, the symbols, and their values."""
    inputs = (x, p)
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
        fixed.pop(place, None)
        if code == ca.OP_INPUT:
            work[place] = inputs[takes[0]][takes[1]]
        elif code == ca.OP_CONST:
            value = float(function.instruction_constant(k))
            fixed[place] = value
            work[place] = _constant(value, symbols)
        elif code in (ca.OP_POW, ca.OP_CONSTPOW):
            work[place] = _power(work[takes[0]], work[takes[1]], fixed.get(takes[1]))
        elif code in table:
            work[place] = table[code](*(work[one] for one in takes))
        else:
            raise TranslationError(operation_name(code), "which the prover does not know")
    return outputs, list(symbols.values()), list(symbols)


def _constant(value: float, symbols: dict[float, ca.SX]) -> ca.SX:
    """Return a power of two, or zero, as it is, and a symbol for any other constant."""
    if value == 0.0 or math.frexp(abs(value))[0] == 0.5:
        return ca.SX(value)
    return symbols.setdefault(value, ca.SX.sym(f"constant{len(symbols)}"))


def _power(base: ca.SX, exponent: ca.SX, value: float | None) -> ca.SX:
    """Return a power: of whole exponents as it is, of others by exponential and logarithm."""
    if value is not None and value == round(value) and abs(value) < 64:
        return base ** int(value)
    if value is not None and 2 * value == round(2 * value) and abs(value) < 32:
        return ca.sqrt(base) ** int(2 * value)
    return ca.exp(exponent * ca.log(base))


def _operations() -> Mapping[int, Callable[..., Any]]:
    """Return CasADi's operations by their code, each as a function of its arguments."""

    def quotient(a: ca.SX, b: ca.SX) -> ca.SX:
        return a / b

    def inverse(a: ca.SX) -> ca.SX:
        return 1 / a

    def square(a: ca.SX) -> ca.SX:
        return a * a

    def hypotenuse(a: ca.SX, b: ca.SX) -> ca.SX:
        return ca.sqrt(a * a + b * b)

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
        **{
            getattr(ca, f"OP_{name.upper()}"): getattr(ca, name)
            for name in (
                *("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos"),
                *("atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf"),
            )
        },
    }
    return table


def operation_name(code: int) -> str:
    """Return CasADi's name of an operation."""
    names = (name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == code)
    return next(names, f"OP_{code}").removeprefix("OP_").lower()
