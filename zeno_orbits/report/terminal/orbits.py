"""What a person reads in the terminal: tables of problems, executions, orbits and searches.

Tables of trades, maps and families, progress, plain lines and errors come from modules of their own
and are passed on.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from zeno_orbits.report.terminal.console import (
    plain_console,
    print_error,
    print_lines,
    print_table,
    table_of,
)
from zeno_orbits.report.terminal.experiments import (
    print_comparison,
    print_contacts,
    print_identification,
    print_rig,
)
from zeno_orbits.report.terminal.progress import ProgressLine
from zeno_orbits.report.terminal.studies import print_families, print_map, print_trade

if TYPE_CHECKING:
    from rich.table import Table

    from zeno_orbits.model.problem import ParameterValues, Problem
    from zeno_orbits.orbits.orbit import ZenoOrbit
    from zeno_orbits.precision.accuracy import Assured
    from zeno_orbits.precision.reduced_models import ReductionCost
    from zeno_orbits.search import SearchResult
    from zeno_orbits.simulation.signals import Extent
    from zeno_orbits.verification.certificate import OrbitCertificate

__all__ = [
    "ProgressLine",
    "print_asked",
    "print_candidates",
    "print_certificate",
    "print_comparison",
    "print_conditions",
    "print_contacts",
    "print_costs",
    "print_engine",
    "print_error",
    "print_error_made",
    "print_execution",
    "print_families",
    "print_goal",
    "print_identification",
    "print_lines",
    "print_map",
    "print_orbit",
    "print_problems",
    "print_rig",
    "print_search",
    "print_trade",
    "print_verdict",
]


def print_problems(problems: Sequence[Problem]) -> None:
    """Print the list of problems."""
    table = table_of("name", "states", "gains", "problem")
    for problem in problems:
        gains = ", ".join(gain.name for gain in problem.gains) or "-"
        table.add_row(problem.name, str(len(problem.state_names)), gains, problem.title)
    print_table(table)


def print_conditions(
    problem: Problem, values: ParameterValues, formula: str, numbers: str, *, always: bool | None
) -> None:
    """Print Theorem 1 for a problem."""
    e = values.parameters["restitution"]
    console = plain_console()
    console.print("Theorem 1: Zeno executions exist near a Zeno equilibrium if")
    console.print("  0 <= e < 1   and   d2h/dt2 < 0   there, where\n")
    console.print(f"  d2h/dt2 = {formula}\n", soft_wrap=True)
    console.print(f"At the numbers of {problem.name}, e = {e:g}:\n")
    console.print(f"  d2h/dt2 = {numbers}\n", soft_wrap=True)
    if always is not None:
        console.print(
            "It is negative everywhere."
            if always
            else "It is nowhere negative: there is no Zeno point."
        )


def print_costs(costs: Sequence[ReductionCost]) -> None:
    """Print what the reduced models of a problem cost in accuracy, relative errors of an orbit."""
    measured = any(cost.measured for cost in costs)
    columns = ("estimate", "measured") if measured else ("estimate",)
    table = table_of("reduced model", "states", "error of", *columns)
    for cost in costs:
        for k, (name, estimate) in enumerate(cost.estimate.items()):
            heads = (
                (cost.problem, f"{cost.n_states} of {cost.n_full_states}") if k == 0 else ("", "")
            )
            known = (f"{cost.measured[name]:.1e}",) if cost.measured else ()
            table.add_row(*heads, name.replace("_", " "), f"{estimate:.1e}", *known)
    print_table(table)
    cost = costs[0]
    plain_console().print(
        f"Relative errors. The currents settle in {cost.layer:.3g} s; the motion changes at "
        f"{cost.rate:.3g} 1/s.",
        soft_wrap=True,
    )


def print_execution(problem: Problem, assured: Assured, most: int = 40) -> None:
    """Print the events of an execution, the errors of its Zeno points and where it ends."""
    from zeno_orbits.simulation.execution import Impact, ZenoPoint

    execution, errors = assured.execution, iter(assured.zeno_errors)
    console = plain_console()
    pair = problem.portraits[0] if problem.portraits else problem.state_names[:2]
    states = list(dict.fromkeys((*pair, problem.state_names[-1])))
    table = table_of("t [s]", "event", "dh/dt", *(f"{name}" for name in states))
    events = execution.events
    for event in events[:most]:
        rate, word = "", "release"
        state = event.state_minus if isinstance(event, Impact) else event.state
        if isinstance(event, Impact):
            word, rate = "impact", f"{event.approach_rate:.6g}"
        elif isinstance(event, ZenoPoint):
            error = next(errors)
            word = f"Zeno point (+- {error:.0e})" if math.isfinite(error) else "Zeno point (+- ?)"
        values = [f"{state[problem.state_names.index(name)]:.6g}" for name in states]
        table.add_row(f"{event.time:.10g}", word, rate, *values)
    print_table(table)
    if len(events) > most:
        console.print(f"... and {len(events) - most} more events; --json lists them all.")
    console.print(
        f"{len(execution.impacts)} impacts resolved, {len(execution.zeno_points)} Zeno points, "
        f"{len(execution.releases)} releases in {execution.end_time:g} s; "
        f"the last arc is {execution.arcs[-1].mode.value}."
    )


def print_engine(engine: str, why: str, error: float) -> None:
    """Print which engine ran and why, and the error that was made."""
    chosen = f"automatic, {why}" if engine == "automatic" else f"{engine}, as asked for."
    print_lines([f"Engine: {chosen}"])
    if math.isfinite(error):
        print_error_made(error)
    else:
        print_lines(["Estimated relative error: unknown, a looser run goes another way."])


def print_error_made(error: float) -> None:
    """Print an estimated error."""
    print_lines([f"Estimated relative error: {error:.1e}."])


def print_orbit(
    problem: Problem,
    orbit: ZenoOrbit,
    certificate: OrbitCertificate,
    free: Iterable[str] = (),
) -> None:
    """Print an orbit and the gist of its certificate.

    Args:
        problem: Its problem.
        orbit: The orbit.
        certificate: What a verification said of it.
        free: Parameters that were searched, to be shown among the gains.
    """
    table = table_of("quantity", "value", "unit")
    units = {gain.name: gain.unit for gain in problem.gains}
    for name, value in orbit.gains.items():
        table.add_row(name, f"{value:.12g}", units[name])
    for quantity in problem.parameters:
        if quantity.name in free:
            value = orbit.parameters[quantity.name]
            table.add_row(quantity.name, f"{value:.12g}", quantity.unit)
    table.add_row("period", f"{orbit.period:.12g}", "s")
    one = orbit.shape.n_phases == 1
    if not orbit.shape.has_one_release:
        table.add_row("shape", orbit.shape.text, "")
    for k, phase in enumerate(orbit.phases):
        if not one:
            table.add_row(f"phase {k + 1} starts", f"{phase.start_time:.12g}", "s")
        after = "release" if orbit.phases[k - 1].kind.holds else "start"
        _add_state(table, problem, f"at {after}", phase.start_state)
        table.add_row("first impact", f"{phase.impacts[0].time:.12g}", "s")
        if phase.zeno_time is not None and phase.zeno_state is not None:
            table.add_row("Zeno point", f"{phase.zeno_time:.12g}", "s")
            _add_state(table, problem, "at Zeno point", phase.zeno_state)
    for k, multiplier in enumerate(certificate.multipliers):
        table.add_row(f"multiplier {k + 1}", _complex(multiplier), "1")
    work = certificate.energies.get("input_work")
    if work is not None:
        table.add_row("work put in a period", f"{work:.9g}", "J")
    print_table(table)


def _add_state(table: Table, problem: Problem, where: str, state: Mapping[str, float]) -> None:
    for name, unit in zip(problem.state_names, problem.state_units, strict=True):
        table.add_row(f"{name} {where}", f"{state[name]:.12g}", unit)


def print_certificate(certificate: OrbitCertificate) -> None:
    """Print residuals, margins and the verdict."""
    from rich.text import Text

    from zeno_orbits.verification.certificate import RESIDUALS

    table = table_of("residual", "size", "", "true if zero")
    for name, meaning in RESIDUALS.items():
        if name in certificate.residuals:
            size = certificate.residuals[name]
            good = size <= certificate.tolerance
            mark = Text("ok", "green") if good else Text("no", "red")
            table.add_row(name, f"{size:.1e}", mark, meaning)
    print_table(table)
    margins = table_of("margin", "value", "")
    for name, value in certificate.margins.items():
        margins.add_row(name, f"{value:.6g}", "" if value > 0 else Text("lost", "red"))
    print_table(margins)
    if certificate.delta_sweep:
        sweep = table_of("cut below |dh/dt|", "speed of the cut", "error at a later time")
        for cut in certificate.delta_sweep:
            sweep.add_row(f"{cut.delta:.3g}", f"{cut.speed:.3g}", f"{cut.error:.1e}")
        print_table(sweep)
        order = certificate.delta_order
        none = "none, no cut errs more than the integration"
        seen = f"{order:.2f}" if math.isfinite(order) else none
        plain_console().print(f"Observed order of the cut: {seen} (theory: 3)")
    console = plain_console()
    none = "none, the section is a point" if certificate.stable else "unknown"
    multipliers = ", ".join(_complex(value) for value in certificate.multipliers) or none
    console.print(f"Floquet multipliers: {multipliers} (+- {certificate.multiplier_error:.0e})")
    console.print(
        f"Estimated error of the integration: {certificate.integration_error:.0e}, "
        f"of the Zeno limit on top of it: {certificate.zeno_error:.0e}"
    )


def print_verdict(certificate: OrbitCertificate) -> None:
    """Print yes or no."""
    colour = "green" if certificate.passed else "red"
    plain_console().print(certificate.verdict(), style=colour, soft_wrap=True)


def print_search(result: SearchResult) -> None:
    """Print how a search went."""
    from rich.text import Text

    console = plain_console()
    console.print(f"{result.status.value} {result.detail}".strip(), soft_wrap=True)
    if len(result.attempts) > 1:
        table = table_of("start", "ended", "why")
        for attempt in result.attempts:
            numbers = {**attempt.gains, **attempt.parameters}
            gains = ", ".join(f"{name} = {value:.4g}" for name, value in numbers.items())
            ended = attempt.status.name.lower().replace("_", " ")
            table.add_row(gains, ended, Text(attempt.detail))
        print_table(table)
    if result.orbit is not None:
        console.print(
            f"Program: {result.n_unknowns} unknowns, {result.iterations} iterations, "
            f"{result.solve_time:.3f} s; it agrees with a simulation to {result.agreement:.0e}, "
            f"its Zeno closure to {result.closure_error:.0e}. "
            f"Search: {result.wall_time:.1f} s."
        )


def print_candidates(result: SearchResult) -> None:
    """Print the verified orbits, the best first."""
    table = table_of("rank", "score", "period [s]", "radius", "numbers")
    for rank, one in enumerate(result.candidates, start=1):
        radius = math.nan if one.certificate is None else one.certificate.spectral_radius
        free = {**one.orbit.gains, **_freed(result, one.orbit)}
        numbers = ", ".join(f"{name} = {value:.5g}" for name, value in free.items())
        figures = (f"{one.score:.6g}", f"{one.orbit.period:.8g}", f"{radius:.4g}")
        table.add_row(str(rank), *figures, numbers)
    print_table(table)


def _freed(result: SearchResult, orbit: ZenoOrbit) -> dict[str, float]:
    return {name: orbit.parameters[name] for name in result.attempts[0].parameters}


def print_goal(wish: str, extents: Mapping[str, Extent], quantities: Sequence[str]) -> None:
    """Print what was asked for and what a simulation of the orbit measures of it."""
    for name in quantities:
        extent = extents[name]
        reached = f"{extent.lowest:.8g}"
        if extent.highest > extent.lowest:
            reached = f"{extent.lowest:.8g} to {extent.highest:.8g}"
        print_lines([f"Asked for {wish}; measured on a simulation, {name}: {reached}."])


def print_asked(asked: Sequence[Mapping[str, Any]]) -> None:
    """Print the bounds that were asked for and what a simulation reaches."""
    if not asked:
        return
    table = table_of("kept", "from", "to", "reached from", "reached to")
    for one in asked:
        ends = ("-" if one[end] is None else f"{one[end]:g}" for end in ("lower", "upper"))
        table.add_row(one["quantity"], *ends, f"{one['lowest']:.8g}", f"{one['highest']:.8g}")
    print_table(table)


def _complex(value: complex) -> str:
    return f"{value.real:.7g}" if value.imag == 0.0 else f"{value.real:.7g} {value.imag:+.7g} i"
