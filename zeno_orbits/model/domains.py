"""The formulas of a machine in the words of its file, and the operations that leave their domain.

A formula that is not finite is traced to the first operation whose operands are finite, such as
the root of a negative number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import Lookup, called
from zeno_orbits.model.drives.circuits import Drive
from zeno_orbits.model.expressions.operations import operation_name, symbols_in
from zeno_orbits.model.hybrid import CompletedSystem
from zeno_orbits.model.lagrangian import HybridLagrangian
from zeno_orbits.model.mistakes import FormulaError

_LONGEST = 60
"""Characters of a formula up to which a message prints it."""

_REMEDIES: Mapping[int, str] = {
    ca.OP_SQRT: "keep the argument of the root at 0 or above",
    ca.OP_LOG: "keep the argument of the logarithm above 0",
    ca.OP_LOG1P: "keep the argument of `log1p` above -1",
    ca.OP_DIV: "keep the denominator away from 0",
    ca.OP_INV: "keep the denominator away from 0",
    ca.OP_POW: "keep the base of the power above 0",
    ca.OP_CONSTPOW: "keep the base of the power above 0",
    ca.OP_ASIN: "keep the argument of `asin` in [-1, 1]",
    ca.OP_ACOS: "keep the argument of `acos` in [-1, 1]",
    ca.OP_ACOSH: "keep the argument of `acosh` at 1 or above",
    ca.OP_ATANH: "keep the argument of `atanh` in (-1, 1)",
    ca.OP_TAN: "keep the argument of `tan` within one period",
}
"""Operation to the remedy if its result is not finite."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedFormula:
    """A formula of a machine.

    Attributes:
        words: Noun phrase for messages, such as ``the passive force``.
        keywords: Arguments of a problem file that may give the formula.
        formula: The formula.
        owner: Name of the stop or switch that the formula belongs to, or an empty text.
    """

    words: str
    keywords: tuple[str, ...]
    formula: ca.SX
    owner: str = ""

    def error(self, text: str, operation: str = "") -> FormulaError:
        """Return an error about the formula, with what is needed to find its line."""
        return FormulaError(text, keywords=self.keywords, owner=self.owner, operation=operation)


def named_formulas(system: CompletedSystem) -> tuple[NamedFormula, ...]:
    """Return the formulas that a model declares, by the words of a user."""
    mechanism = system.mechanism
    found = [*_of_mechanism(mechanism)]
    if not mechanism.stops:
        found.append(NamedFormula(words="the gap", keywords=("gap",), formula=system.gap))
        restitution = ca.SX(system.restitution)
        found.append(
            NamedFormula(words="the restitution", keywords=("restitution",), formula=restitution)
        )
    for switch in system.graph.switches:
        for word, formula in (("guard", switch.guard), ("armed", switch.armed)):
            words = f"`{word}` of the switch `{switch.name}`"
            one = NamedFormula(
                words=words, keywords=(word,), formula=ca.SX(formula), owner=switch.name
            )
            found.append(one)
    return (*found, *_of_drive(system.drive))


def _of_mechanism(mechanism: HybridLagrangian) -> list[NamedFormula]:
    """Return the formulas of a mechanism and its stops."""
    rows = [
        ("the mass matrix", ("mass_matrix", "kinetic"), mechanism.mass_matrix),
        ("the potential", ("potential",), mechanism.potential),
        ("the passive force", ("passive_force", "gravity"), mechanism.passive_force),
        ("the applied force", ("applied_force",), mechanism.applied_force),
        ("the constraint", ("holonomic",), mechanism.holonomic),
    ]
    found = [NamedFormula(words=a, keywords=b, formula=c) for a, b, c in rows]
    for stop in mechanism.stops:
        for word, formula in (("gap", stop.gap), ("restitution", stop.law.restitution)):
            words, keywords = f"the {word} of the stop `{stop.name}`", (word,)
            one = NamedFormula(
                words=words, keywords=keywords, formula=ca.SX(formula), owner=stop.name
            )
            found.append(one)
    return found


def _of_drive(drive: Drive) -> list[NamedFormula]:
    """Return the formulas of a drive."""
    return [
        NamedFormula(words=f"`{name}`", keywords=(name,), formula=entry)
        for name, entry in drive.entries
    ]


def undefined_ahead(
    mechanism: HybridLagrangian,
    drive: Drive,
    inputs: tuple[ca.SX, ca.SX],
    states: Sequence[Vector],
    values: Vector,
) -> str:
    """Return what ends a flow: a formula of a mode that is infinite or undefined ahead of a state.

    Args:
        mechanism: The mechanism in the mode.
        drive: The drive in the mode.
        inputs: Symbols of the state ``(n_x,)``, and of the gains and parameters ``(n_p,)``.
        states: The state, and states on its tangent in the order of time, each ``(n_x,)``.
        values: Values of the gains and parameters.

    Returns:
        A clause that names the formula and the state, or an empty text.
    """
    declared = [*_of_mechanism(mechanism), *_of_drive(drive)]
    declared += _derivatives(mechanism, drive, declared)
    known = ca.vertcat(*inputs)
    for x in states[1:]:
        for one in declared:
            place = _first_infinite(one.formula, list(inputs), x, values, before=states[0])
            if place is None:
                continue
            node, operands = place
            where = _values_of(node, known, (*states[0], *values))
            return f"{one.words} is not finite ahead{where}: {_account(node, operands)}"
    return ""


def require_finite(
    system: CompletedSystem,
    symbols: Mapping[str, ca.SX],
    x: Vector,
    p: Vector,
    number: int,
    *,
    with_derivatives: bool,
) -> None:
    """Refuse a formula, or a derivative that the motion needs, that is not finite at a start.

    Args:
        system: The completed system.
        symbols: Gains and parameters by name.
        x: The start, ``(n_x,)``.
        p: Values of the symbols, in the same order.
        number: Number of the start, from 1.
        with_derivatives: Whether derivatives are checked.

    Raises:
        FormulaError: If a formula is not finite. The message names the operation and its operands.
    """
    inputs = [system.state, ca.vertcat(*symbols.values())]
    known = ca.vertcat(*inputs)
    declared = named_formulas(system)
    mechanism, drive = system.mechanism, system.drive
    derived = _derivatives(mechanism, drive, declared) if with_derivatives else ()
    for one in (*declared, *derived):
        place = _first_infinite(one.formula, inputs, x, p)
        if place is None:
            continue
        node, operands = place
        where = _values_of(node, known, (*x, *p))
        raise one.error(
            f"{one.words} is not finite at start {number}{where}: {_account(node, operands)}",
            operation_name(node.op()),
        )


def _values_of(formula: Any, known: ca.SX, values: Sequence[float]) -> str:
    """Return the values of the symbols of a formula in brackets, or an empty text.

    The formula holds the symbols of the file, which may differ from the names of the states.
    """
    numbers = {known[k].element_hash(): value for k, value in enumerate(values)}
    told = ", ".join(
        f"{one.name()} = {numbers[one.element_hash()]:g}" for one in symbols_in(formula)
    )
    return f" ({told})" if told else ""


def _account(node: Any, operands: Sequence[float]) -> str:
    """Return what an operation is given, and the remedy."""
    lookup = _lookup_behind(node)
    if lookup is not None:
        first, last = lookup.table.knots[0], lookup.table.knots[-1]
        name = lookup.table.name
        told = name if name.startswith("argument ") else f"the argument of {name}"
        return (
            f"{told} is beyond its knots from {first:g} to {last:g}. "
            "Add knots, change a value or the start, or give the table `outside='hold'` or "
            "`outside='extend'`."
        )
    operation, text = node.op(), str(node)
    told = f"`{text}`" if len(text) <= _LONGEST and "@" not in text else "an operation"
    given = [f"{value:.6g}" for value in operands]
    if operation in (ca.OP_DIV, ca.OP_INV):
        above, below = ("1", *given)[-2:]
        what = f"divides {above} by {below}"
    else:
        what = f"is `{operation_name(operation)}` of {' and '.join(given)}"
    remedy = _REMEDIES.get(operation, "keep the result within the range of a double")
    return f"{told} {what}. Change the formula, a value or the start: {remedy}."


def _lookup_behind(node: Any) -> Lookup | None:
    """Return the look-up of a cell whose result an operation takes."""
    parts = [node.dep(k) for k in range(node.n_dep())]
    if len(parts) != 1 or not parts[0].is_output():
        return None
    return called(parts[0].dep(0))[1]


def _derivatives(
    mechanism: HybridLagrangian, drive: Drive, declared: Sequence[NamedFormula]
) -> tuple[NamedFormula, ...]:
    """Return the derivatives of declared formulas that the equations of motion hold."""
    q, fields = mechanism.q, drive.states
    found: list[NamedFormula] = []
    for one in declared:
        by = ca.vertcat(q, fields) if "coenergy" in one.keywords else q
        if one.keywords[0] not in ("mass_matrix", "potential", "gap", "holonomic", "coenergy"):
            continue
        slope = ca.jacobian(one.formula, by)
        for order, formula in (("", slope), ("second ", ca.jacobian(slope, by))):
            found.append(
                NamedFormula(
                    words=f"the {order}derivative of {one.words}",
                    keywords=one.keywords,
                    formula=formula,
                    owner=one.owner,
                )
            )
            if one.keywords[0] in ("mass_matrix", "potential"):
                break
    return tuple(found)


def _first_infinite(
    formula: ca.SX, inputs: list[ca.SX], x: Vector, p: Vector, before: Vector | None = None
) -> tuple[Any, list[float]] | None:
    """Return the first operation that is not finite with its operands, or None if all are finite.

    Args:
        formula: The formula.
        inputs: Symbols of the state and of the parameters.
        x: The state.
        p: Values of the parameters.
        before: An earlier state. A denominator between zero and its value there counts as zero.
    """
    function: Any = ca.Function("formula", inputs, [ca.densify(formula)])
    made = function.instructions_sx()
    nodes: list[Any] = [
        made[k]
        for k in range(function.n_instructions())
        if function.instruction_id(k) not in (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)
    ]
    if before is None and np.all(np.isfinite(function(x, p).full())):
        return None
    symbols = function.sx_in()
    for node in nodes:
        parts = [ca.SX(node.dep(k)) for k in range(node.n_dep())]
        values: Any = ca.Function("node", symbols, [ca.SX(node), ca.vertcat(*parts)])
        result, operands = values(x, p)
        told = [float(one) for one in operands.full().ravel()]
        if not np.all(np.isfinite(result.full())):
            return node, told
        if before is not None and _has_pole_between(node, symbols, (before, x), p):
            return node, values(before, p)[1].full().ravel().tolist()
    return None


_EVEN = (ca.OP_SQ, ca.OP_FABS, ca.OP_SQRT, ca.OP_POW, ca.OP_CONSTPOW, ca.OP_NEG, ca.OP_MUL)
"""Operations that are zero where their first operand is, such as a square without a sign change."""


def _has_pole_between(
    node: Any, symbols: Sequence[ca.SX], ends: tuple[Vector, Vector], p: Vector
) -> bool:
    """Return True if a quotient or a tangent has a pole between two states."""
    operation = node.op()
    if operation == ca.OP_TAN:
        found: Any = ca.Function("turns", symbols, [ca.floor(ca.SX(node.dep(0)) / ca.pi + 0.5)])
        return float(found(ends[0], p)) != float(found(ends[1], p))
    if operation not in (ca.OP_DIV, ca.OP_INV):
        return False
    vanishing, seen = [ca.SX(node.dep(node.n_dep() - 1))], list[ca.SX]()
    while vanishing:
        one: Any = vanishing.pop()
        seen.append(one)
        if one.op() in _EVEN:
            count = 2 if one.op() == ca.OP_MUL else 1
            vanishing += [ca.SX(one.dep(k)) for k in range(count)]
    signs: Any = ca.Function("signs", symbols, [ca.vertcat(*seen)])
    before, after = (np.sign(signs(x, p).full().ravel()) for x in ends)
    return bool(np.any(before * after < 0.0))


def require_rising_gap(
    system: CompletedSystem, symbols: Mapping[str, ca.SX], x: Vector, p: Vector, number: int
) -> None:
    """Refuse a gap whose derivative with respect to the configuration is zero at a start.

    Args:
        system: The completed system.
        symbols: Named parameters.
        x: The start, ``(n_x,)``.
        p: Values of the parameters, ``(n_p,)``.
        number: Number of the start, from 1.

    Raises:
        FormulaError: If a derivative is zero. The message names the gap.
    """
    inputs = [system.state, ca.vertcat(*symbols.values())]
    for one in named_formulas(system):
        if one.keywords[0] != "gap":
            continue
        slope: Any = ca.Function(
            "slope", inputs, [ca.densify(ca.jacobian(one.formula, system.mechanism.q))]
        )
        if not np.any(slope(x, p).full()):
            raise one.error(
                f"{one.words} must change with the configuration at start {number}, but its "
                "derivative is 0 there. Write a gap with a slope, such as `q` for `q**2`, or "
                "change the start."
            )
