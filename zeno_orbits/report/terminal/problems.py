"""Tables of problems: their list, and Theorem 1."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from zeno_orbits.report.table import Column, name_column, number_column, text_column
from zeno_orbits.report.terminal.console import print_lines, print_table, print_whole

if TYPE_CHECKING:
    from zeno_orbits.model import ParameterValues, Problem


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
