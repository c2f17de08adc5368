"""Tables of problems: their list, and Theorem 1."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from zeno_orbits.report.table import TableColumn, name_column, number_column, text_column
from zeno_orbits.report.terminal.console import print_lines, print_table, print_whole

if TYPE_CHECKING:
    from zeno_orbits.model import ParameterValues, Problem
    from zeno_orbits.proof import EquilibriumReport


_DOWN, _UP = 1 - 1e-5, 1 + 1e-5
"""Factors after which six digits are a bound."""


def print_problems(problems: Sequence[Problem]) -> None:
    """Print the list of problems."""
    columns: list[TableColumn[Problem]] = [
        name_column("name", lambda problem: problem.name),
        number_column("states", lambda problem: str(len(problem.state_names))),
        text_column("gains", lambda problem: ", ".join(g.name for g in problem.gains) or "-"),
        text_column("problem", lambda problem: problem.title),
    ]
    print_table(columns, problems)


def print_conditions(
    problem: Problem, values: ParameterValues, formula: str, numbers: str, *, always: bool | None
) -> None:
    """Print Theorem 1 for a problem.

    Args:
        problem: The problem.
        values: Parameter values of the problem.
        formula: d2h/dt2 in symbols.
        numbers: d2h/dt2 at the parameter values.
        always: Whether d2h/dt2 is negative everywhere (true) or nowhere (false), or ``None`` for
            neither.
    """
    first = problem.first_system(values)
    e, at = first.restitution, " at speed 0" if first.restitution_at is not None else ""
    print_whole(
        [
            "Theorem 1: Zeno executions exist near a Zeno equilibrium if",
            "  0 <= e < 1   and   d2h/dt2 < 0   there, where\n",
            f"  d2h/dt2 = {formula}\n",
            f"At the parameters of {problem.name}, e = {e:g}{at}:\n",
            f"  d2h/dt2 = {numbers}\n",
        ]
    )
    if always is not None:
        nowhere = "It is nowhere negative: Zeno points do not exist."
        print_lines(["It is negative everywhere." if always else nowhere])


def print_equilibrium(problem: Problem, point: EquilibriumReport) -> None:
    """Print Theorem 1 at a state: its conditions, and the neighbourhood of the executions.

    Args:
        problem: The problem.
        point: Properties of the state.
    """
    named = zip(problem.state_names, point.state, strict=True)
    print_whole(
        [
            f"At {', '.join(f'{name} = {value:.9g}' for name, value in named)}:\n",
            f"  h = {point.gap:.9g}, dh/dt = {point.gap_rate:.9g}, "
            f"d2h/dt2 = {point.gap_acceleration:.9g}\n",
        ]
    )
    print_lines([_verdict(point)])
    for value in point.eigenvalues:
        print_lines([f"  eigenvalue of the free flow {value.real:.15g} {value.imag:+.15g} i"])
    found = point.neighbourhood
    if found is None:
        if point.has_zeno_executions:
            print_lines(["No neighbourhood was found: no bounds hold on any box around the state."])
        return
    print_lines(["Impacts accumulate from every admissible state of the neighbourhood W:"])
    units = dict(zip(problem.state_names, problem.state_units, strict=True))
    columns: list[TableColumn[tuple[str, float, float]]] = [
        name_column("state", lambda row: row[0]),
        number_column("centre", lambda row: f"{row[1]:.17g}"),
        number_column("radius", lambda row: f"{row[2]:.17g}"),
        text_column("unit", lambda row: units[row[0]]),
    ]
    print_table(columns, list(zip(problem.state_names, found.centre, found.radii, strict=True)))
    print_lines(
        [
            f"with 0 <= h <= {_DOWN * found.gap:.6g} and |dh/dt| <= {_DOWN * found.gap_rate:.6g}, "
            f"within {_UP * found.duration:.6g} s.",
            f"All of them have d2h/dt2 from {-_UP * found.pull[1]:.6g} to "
            f"{-_DOWN * found.pull[0]:.6g}.",
        ]
    )


def _verdict(point: EquilibriumReport) -> str:
    if not point.is_on_stop:
        still = " The free flow stands still there." if point.is_still else ""
        return f"No Zeno equilibrium: the state does not rest on the stop.{still}"
    if point.is_still:
        return "No Zeno equilibrium: the free flow stands still there, f = 0."
    if point.gap_acceleration < 0.0:
        return "A Zeno equilibrium with d2h/dt2 < 0: Theorem 1 holds."
    return "A Zeno equilibrium, but d2h/dt2 is not negative: Theorem 1 does not apply."
