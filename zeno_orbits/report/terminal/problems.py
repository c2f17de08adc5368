"""Tables of problems: their list, Theorem 1, and the errors of reduced models."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from zeno_orbits.report.table import Column, name_column, number_column, text_column
from zeno_orbits.report.terminal.console import print_lines, print_table, print_whole

if TYPE_CHECKING:
    from zeno_orbits.model import ParameterValues, Problem
    from zeno_orbits.precision import ReductionCost


def print_problems(problems: Sequence[Problem]) -> None:
    """Print the list of problems."""
    columns: list[Column[Problem]] = [
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
        values: Its numbers.
        formula: d2h/dt2 in symbols.
        numbers: The same at the numbers.
        always: Whether it is negative everywhere (true) or nowhere (false); ``None`` if neither.
    """
    e = values.parameters["restitution"]
    print_whole(
        [
            "Theorem 1: Zeno executions exist near a Zeno equilibrium if",
            "  0 <= e < 1   and   d2h/dt2 < 0   there, where\n",
            f"  d2h/dt2 = {formula}\n",
            f"At the numbers of {problem.name}, e = {e:g}:\n",
            f"  d2h/dt2 = {numbers}\n",
        ]
    )
    if always is not None:
        nowhere = "It is nowhere negative: there is no Zeno point."
        print_lines(["It is negative everywhere." if always else nowhere])


def print_reduction_costs(costs: Sequence[ReductionCost]) -> None:
    """Print the relative errors that the reduced models of a problem make in an orbit."""
    columns: list[Column[tuple[ReductionCost, str]]] = [
        name_column("reduced model", lambda row: _if_first(row, row[0].problem)),
        text_column(
            "states", lambda row: _if_first(row, f"{row[0].n_states} of {row[0].n_full_states}")
        ),
        text_column("error of", lambda row: row[1].replace("_", " ")),
        number_column("estimate", lambda row: f"{row[0].estimate[row[1]]:.1e}"),
    ]
    if any(cost.measured for cost in costs):
        columns.append(number_column("measured", _measured))
    print_table(columns, _landmarks(costs))
    cost = costs[0]
    print_lines(
        [
            f"Relative errors. The currents settle in {cost.layer:.3g} s; the motion changes at "
            f"{cost.rate:.3g} 1/s."
        ]
    )


def _landmarks(costs: Sequence[ReductionCost]) -> Iterator[tuple[ReductionCost, str]]:
    return ((cost, name) for cost in costs for name in cost.estimate)


def _if_first(row: tuple[ReductionCost, str], text: str) -> str:
    """Return a text in the first row of a model only."""
    cost, name = row
    return text if name == next(iter(cost.estimate)) else ""


def _measured(row: tuple[ReductionCost, str]) -> str:
    cost, name = row
    return f"{cost.measured[name]:.1e}" if cost.measured else ""
