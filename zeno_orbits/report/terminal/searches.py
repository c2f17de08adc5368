"""Tables of searches: their outcome, the orbits found, and objective and bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from zeno_orbits.errors import counted
from zeno_orbits.report.table import BOUNDS, TableColumn, number_column, text_column
from zeno_orbits.report.terminal.console import print_lines, print_table

if TYPE_CHECKING:
    from zeno_orbits.search import (
        Candidate,
        SearchResult,
        StartAttempt,
    )


def print_search(result: SearchResult) -> None:
    """Print how a search went."""
    print_lines([f"{result.status.value} {result.detail}".strip()])
    if result.scan:
        print_lines([result.scan])
    if len(result.attempts) > 1:
        columns: list[TableColumn[StartAttempt]] = [
            text_column("start", lambda one: _listed({**one.gains, **one.parameters}, 4)),
            text_column("ended", lambda one: one.status.name.lower().replace("_", " ")),
            text_column("reason", lambda one: one.detail),
        ]
        print_table(columns, result.attempts)


def print_solver(result: SearchResult) -> None:
    """Print the nonlinear program of a search with its agreement, or its orbits, and the time."""
    time = f"Search: {result.wall_time:.1f} s."
    if not result.n_unknowns:
        closed = counted(result.n_orbits, "orbit")
        print_lines([f"Solver: {result.method.value}, which closed {closed}. {time}"])
        return
    print_lines(
        [
            f"Solver: {counted(result.n_unknowns, 'unknown')}, "
            f"{counted(result.iterations, 'iteration')}, {result.solve_time:.3f} s. "
            f"It agrees with a simulation to {result.agreement:.0e}, its Zeno limit to "
            f"{result.closure_error:.0e}. {time}"
        ]
    )


def print_candidates(result: SearchResult) -> None:
    """Print the verified orbits, the best first."""
    freed = result.attempts[0].parameters

    def numbers(one: Candidate) -> str:
        parameters = {name: one.orbit.parameters[name] for name in freed}
        return _listed({**one.orbit.gains, **parameters}, 5)

    columns: list[TableColumn[tuple[int, Candidate]]] = [
        number_column("rank", lambda row: str(row[0])),
        number_column("score", lambda row: f"{row[1].score:.6g}"),
        number_column("period [s]", lambda row: f"{row[1].orbit.period:.8g}"),
        number_column("spectral radius", lambda row: f"{_radius(row[1]):.4g}"),
        text_column("numbers", lambda row: numbers(row[1])),
    ]
    print_table(columns, enumerate(result.candidates, start=1))


def _radius(one: Candidate) -> float:
    return math.nan if one.certificate is None else one.certificate.spectral_radius


def _listed(values: Mapping[str, float], digits: int) -> str:
    return ", ".join(f"{name} = {value:.{digits}g}" for name, value in values.items())


def print_reached(result: SearchResult, wish: str) -> None:
    """Print an objective, its value at the best orbit, and the free values there.

    Args:
        result: The result of the search.
        wish: The objective in words.
    """
    value = result.value if result.mean is None else result.worst
    # No push that was tried loses the orbit: the push has no value.
    reached = f": {value:.8g}" if result.is_measured and math.isfinite(value) else ""
    print_lines([f"Asked for {wish}{reached}.", f"  {_listed(result.free, 10)}"])
    if result.mean is not None:
        where = _listed(result.worst_at, 6) or "the search's own values"
        mean = f"Mean over the corners: {result.mean:.8g}."
        print_lines([f"Worst case: {result.worst:.8g} at {where}. {mean}"])


def print_bounds(asked: Sequence[Mapping[str, Any]]) -> None:
    """Print the requested bounds and the values that a simulation reaches."""
    if not asked:
        return
    print_table(BOUNDS, asked)
