"""What a person reads: tables on standard output, progress on standard error.

Rich is imported with the first table: progress, errors and JSON need none of it.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from zeno_orbits.attractors import Attractor
    from zeno_orbits.bounds import Extent
    from zeno_orbits.certificate import OrbitCertificate
    from zeno_orbits.comparison import Comparison
    from zeno_orbits.execution import Execution
    from zeno_orbits.families import Boundary, Continuation
    from zeno_orbits.fidelity import ReductionCost
    from zeno_orbits.identification import Identification
    from zeno_orbits.maps import ParameterMap
    from zeno_orbits.orbit import ZenoOrbit
    from zeno_orbits.problem import Problem, Setting
    from zeno_orbits.recordings import Recording
    from zeno_orbits.search import SearchResult
    from zeno_orbits.trade import Trade, Trial

_PATIENCE = 1.0
"""Work shorter than this says nothing [s]."""
_RARER = 0.1
"""A file gets no more lines than one in this part of the time so far."""


class Progress:
    """Says on standard error what long work is doing, how long it has taken, and what is left.

    A terminal gets one line that is rewritten; a file gets a line now and then.

    Args:
        check: Called at every word; it may raise.
    """

    def __init__(self, check: Callable[[], None]) -> None:
        self._check = check
        self._started = time.perf_counter()
        self._said = -_PATIENCE
        self._terminal = sys.stderr.isatty()
        self._width = 0

    def __enter__(self) -> Progress:
        """Begin."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave a clean line behind."""
        if self._width:
            sys.stderr.write("\r" + " " * self._width + "\r")
            sys.stderr.flush()

    def tell(self, what: str, part: float | None = None) -> None:
        """Say what is being done.

        Args:
            what: A few words.
            part: How much of it is done, in [0, 1], if that is known.
        """
        self._check()
        elapsed = time.perf_counter() - self._started
        pause = 0.1 if self._terminal else max(_PATIENCE, _RARER * elapsed)
        if elapsed < _PATIENCE or elapsed - self._said < pause:
            return
        self._said = elapsed
        line = f"{elapsed:6.1f} s  {what}"
        if part is not None and part > 0.0:
            line += f"  {100 * part:3.0f} %, {elapsed * (1 - part) / part:.0f} s left"
        if self._terminal:
            self._width = max(self._width, len(line))
            sys.stderr.write("\r" + line.ljust(self._width))
        else:
            sys.stderr.write(line + "\n")
        sys.stderr.flush()


def print_problems(problems: Sequence[Problem]) -> None:
    """Print the list of scenes."""
    table = _table("name", "states", "gains", "scene")
    for problem in problems:
        gains = ", ".join(gain.name for gain in problem.gains) or "-"
        table.add_row(problem.name, str(len(problem.state_names)), gains, problem.title)
    _print(table)


def print_comparison(found: Comparison) -> None:
    """Print a recording beside an orbit."""
    table = _table("", "orbit", "recording", "difference", "standard error", "unit")
    for metric in found.metrics:
        known = math.isfinite(metric.data)
        difference = f"{metric.data - metric.orbit:+.3g}" if known else "-"
        error = f"{metric.error:.2g}" if math.isfinite(metric.error) else "-"
        data = f"{metric.data:.7g}" if known else "not seen"
        table.add_row(metric.name, f"{metric.orbit:.7g}", data, difference, error, metric.unit)
    if found.metrics:
        _print(table)
    console = _console()
    for remark in (*found.recording.remarks, *found.remarks):
        console.print(f"Note: {remark}.", soft_wrap=True, markup=False, highlight=False)
    if found.agrees:
        console.print("The recording shows such an orbit.")
        return
    console.print("The recording shows no such orbit:")
    for reason in found.reasons:
        console.print(f"  {reason}.", soft_wrap=True, markup=False, highlight=False)


def print_identification(recording: Recording, found: Identification) -> None:
    """Print parameters that were found from a recording."""
    table = _table("", "start", "fitted", "standard error", "95 % interval")
    for one in found.fitted:
        known = math.isfinite(one.error)
        error = f"{one.error:.2g}" if known else "not told"
        interval = f"{one.low:.6g} to {one.high:.6g}" if known else "-"
        label = one.sought.label
        table.add_row(label, f"{one.start:.6g}", f"{one.value:.7g}", error, interval)
    _print(table)
    console = _console()
    console.print(
        f"Deviation of all signals, in parts of their ranges: {found.before:.2g} before, "
        f"{found.after:.2g} after the fit. Period {found.orbit.period:.7g} s.",
        soft_wrap=True,
    )
    for remark in (*recording.remarks, *found.remarks):
        console.print(f"Note: {remark}.", soft_wrap=True, markup=False, highlight=False)
    for one in found.unseen:
        console.print(f"Warning: {one.text}.", soft_wrap=True, markup=False, highlight=False)


def print_conditions(
    problem: Problem, setting: Setting, formula: str, numbers: str, *, always: bool | None
) -> None:
    """Print Theorem 1 for a scene."""
    e = setting.parameters["restitution"]
    console = _console()
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
    """Print what the reduced models of a scene cost in accuracy, relative errors of an orbit."""
    measured = any(cost.measured for cost in costs)
    columns = ("estimate", "measured") if measured else ("estimate",)
    table = _table("reduced model", "states", "error of", *columns)
    for cost in costs:
        for k, (name, estimate) in enumerate(cost.estimate.items()):
            heads = (
                (cost.problem, f"{cost.n_states} of {cost.n_full_states}") if k == 0 else ("", "")
            )
            known = (f"{cost.measured[name]:.1e}",) if cost.measured else ()
            table.add_row(*heads, name.replace("_", " "), f"{estimate:.1e}", *known)
    _print(table)
    cost = costs[0]
    _console().print(
        f"Relative errors. The currents settle in {cost.layer:.3g} s; the motion changes at "
        f"{cost.rate:.3g} 1/s.",
        soft_wrap=True,
    )


def print_setting(problem: Problem, setting: Setting) -> None:
    """Print the numbers of a scene."""
    table = _table("parameter", "value", "unit", "meaning")
    for quantity in (*problem.gains, *problem.parameters):
        values = {**setting.gains, **setting.parameters}
        number = f"{values[quantity.name]:.10g}"
        table.add_row(quantity.name, number, quantity.unit, quantity.meaning)
    _print(table)


def print_execution(problem: Problem, execution: Execution, most: int = 40) -> None:
    """Print the events of an execution and where it ends."""
    from zeno_orbits.execution import Impact, ZenoPoint

    console = _console()
    pair = problem.portraits[0] if problem.portraits else problem.state_names[:2]
    states = list(dict.fromkeys((*pair, problem.state_names[-1])))
    table = _table("t [s]", "event", "dh/dt", *(f"{name}" for name in states))
    events = execution.events
    for event in events[:most]:
        rate, word = "", "release"
        state = event.state_minus if isinstance(event, Impact) else event.state
        if isinstance(event, Impact):
            word, rate = "impact", f"{event.approach_rate:.6g}"
        elif isinstance(event, ZenoPoint):
            word = f"Zeno point (+- {event.error:.0e})"
        values = [f"{state[problem.state_names.index(name)]:.6g}" for name in states]
        table.add_row(f"{event.time:.10g}", word, rate, *values)
    _print(table)
    if len(events) > most:
        console.print(f"... and {len(events) - most} more events; --json lists them all.")
    console.print(
        f"{len(execution.impacts)} impacts resolved, {len(execution.zeno_points)} Zeno points, "
        f"{len(execution.releases)} releases in {execution.end_time:g} s; "
        f"the last arc is {execution.arcs[-1].mode.value}."
    )


def print_engine(engine: str, why: str, error: float | None) -> None:
    """Print which engine ran and why, and the error if it was asked for."""
    chosen = f"automatic, {why}" if engine == "automatic" else f"{engine}, as asked for."
    print_lines([f"Engine: {chosen}"])
    if error is not None:
        print_error_made(error)


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
        problem: Its scene.
        orbit: The orbit.
        certificate: What a verification said of it.
        free: Parameters that were searched, to be shown among the gains.
    """
    table = _table("quantity", "value", "unit")
    units = {gain.name: gain.unit for gain in problem.gains}
    for name, value in orbit.gains.items():
        table.add_row(name, f"{value:.12g}", units[name])
    for quantity in problem.parameters:
        if quantity.name in free:
            value = orbit.parameters[quantity.name]
            table.add_row(quantity.name, f"{value:.12g}", quantity.unit)
    table.add_row("period", f"{orbit.period:.12g}", "s")
    for name, unit in zip(problem.state_names, problem.state_units, strict=True):
        table.add_row(f"{name} at release", f"{orbit.release_state[name]:.12g}", unit)
    table.add_row("first impact", f"{orbit.impacts[0].time:.12g}", "s")
    table.add_row("Zeno point", f"{orbit.zeno_time:.12g}", "s")
    for name, unit in zip(problem.state_names, problem.state_units, strict=True):
        table.add_row(f"{name} at Zeno point", f"{orbit.zeno_state[name]:.12g}", unit)
    for k, multiplier in enumerate(certificate.multipliers):
        table.add_row(f"multiplier {k + 1}", _complex(multiplier), "1")
    work = certificate.energies.get("input_work")
    if work is not None:
        table.add_row("work put in a period", f"{work:.9g}", "J")
    _print(table)


def print_certificate(certificate: OrbitCertificate) -> None:
    """Print residuals, margins and the verdict."""
    from rich.text import Text

    from zeno_orbits.certificate import RESIDUALS

    table = _table("residual", "size", "", "true if zero")
    for name, meaning in RESIDUALS.items():
        if name in certificate.residuals:
            size = certificate.residuals[name]
            good = size <= certificate.tolerance
            mark = Text("ok", "green") if good else Text("no", "red")
            table.add_row(name, f"{size:.1e}", mark, meaning)
    _print(table)
    margins = _table("margin", "value", "")
    for name, value in certificate.margins.items():
        margins.add_row(name, f"{value:.6g}", "" if value > 0 else Text("lost", "red"))
    _print(margins)
    if certificate.delta_sweep:
        sweep = _table("cut below |dh/dt|", "speed of the cut", "error at a later time")
        for cut in certificate.delta_sweep:
            sweep.add_row(f"{cut.delta:.3g}", f"{cut.speed:.3g}", f"{cut.error:.1e}")
        _print(sweep)
        order = certificate.delta_order
        seen = f"{order:.2f}" if math.isfinite(order) else "none, all cuts are at rounding"
        _console().print(f"Observed order of the cut: {seen} (theory: 3)")
    console = _console()
    none = "none, the section is a point" if certificate.stable else "unknown"
    multipliers = ", ".join(_complex(value) for value in certificate.multipliers) or none
    console.print(f"Floquet multipliers: {multipliers} (+- {certificate.multiplier_error:.0e})")
    console.print(
        f"Estimated error of the integration: {certificate.integration_error:.0e}, "
        f"of the Zeno point: {certificate.zeno_error:.0e}"
    )


def print_verdict(certificate: OrbitCertificate) -> None:
    """Print yes or no."""
    colour = "green" if certificate.passed else "red"
    _console().print(certificate.verdict(), style=colour, soft_wrap=True)


def print_search(result: SearchResult) -> None:
    """Print how a search went."""
    from rich.text import Text

    console = _console()
    console.print(f"{result.status.value} {result.detail}".strip(), soft_wrap=True)
    if len(result.attempts) > 1:
        table = _table("start", "ended", "why")
        for attempt in result.attempts:
            numbers = {**attempt.gains, **attempt.parameters}
            gains = ", ".join(f"{name} = {value:.4g}" for name, value in numbers.items())
            ended = attempt.status.name.lower().replace("_", " ")
            table.add_row(gains, ended, Text(attempt.detail))
        _print(table)
    if result.orbit is not None:
        console.print(
            f"Program: {result.n_unknowns} unknowns, {result.iterations} iterations, "
            f"{result.solve_time:.3f} s; it agrees with a simulation to {result.agreement:.0e}, "
            f"its Zeno closure to {result.closure_error:.0e}. "
            f"Search: {result.wall_time:.1f} s."
        )


def print_candidates(result: SearchResult) -> None:
    """Print the verified orbits, the best first."""
    table = _table("rank", "score", "period [s]", "radius", "numbers")
    for rank, one in enumerate(result.candidates, start=1):
        radius = math.nan if one.certificate is None else one.certificate.spectral_radius
        free = {**one.orbit.gains, **_freed(result, one.orbit)}
        numbers = ", ".join(f"{name} = {value:.5g}" for name, value in free.items())
        figures = (f"{one.score:.6g}", f"{one.orbit.period:.8g}", f"{radius:.4g}")
        table.add_row(str(rank), *figures, numbers)
    _print(table)


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
    table = _table("kept", "from", "to", "reached from", "reached to")
    for one in asked:
        ends = ("-" if one[end] is None else f"{one[end]:g}" for end in ("lower", "upper"))
        table.add_row(one["quantity"], *ends, f"{one['lowest']:.8g}", f"{one['highest']:.8g}")
    _print(table)


def print_trade(trade: Trade) -> None:
    """Print the trials of a trade, those that no other beats marked, and the cheapest for each."""
    front = set(map(id, trade.front))
    table = _table("", "sweep", "setting", "value", "time [ms]", "error", "impacts")
    for trial in trade.trials:
        table.add_row(
            "*" if id(trial) in front else "",
            trial.sweep,
            trial.name,
            f"{trial.value:g}" if trial.sweep == "impacts" else f"{trial.value:.0e}",
            f"{1e3 * trial.seconds:.2f}" if trial.seconds < math.inf else "-",
            _error_of(trial),
            trial.trouble or (str(trial.n_impacts) if trial.n_impacts else ""),
        )
    _print(table)
    table = _table("accuracy", "cheapest setting", "value", "time [ms]", "error")
    for accuracy in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12):
        best = trade.cheapest(accuracy)
        name = "none" if best is None else f"{best.sweep}: {best.name}"
        row = ("", "", "") if best is None else _figures(best)
        table.add_row(f"{accuracy:.0e}", name, *row)
    _print(table)
    print_lines(
        [
            f"Work: {trade.work}. Truth: {trade.truth}, certain to {trade.truth_error:.0e}.",
            "* no other setting is both faster and more accurate. Times are of this machine.",
        ]
    )


def print_map(found: ParameterMap) -> None:
    """Print how many points of a map settle to what."""
    table = _table("the motion settles to", "points", "share", "period [s]", "spectral radius")
    groups: dict[str, list[Attractor]] = {}
    for attractor in found.attractors:
        groups.setdefault(attractor.phrase, []).append(attractor)
    for phrase, group in sorted(groups.items(), key=lambda item: -len(item[1])):
        share = f"{100 * len(group) / len(found.attractors):.1f} %"
        periods = _range([one.period for one in group])
        radii = _range([one.spectral_radius for one in group])
        table.add_row(phrase, str(len(group)), share, periods, radii)
    _print(table)
    axes = (f"{a.name} = {a.lower:g} ... {a.upper:g} ({a.count})" for a in (found.x, found.y))
    print_lines([f"{' by '.join(axes)}; each motion was followed for {found.until:g} s at most."])


def _range(values: Sequence[float]) -> str:
    finite = [value for value in values if math.isfinite(value)]
    return f"{min(finite):.4g} ... {max(finite):.4g}" if finite else ""


def print_families(found: Continuation) -> None:
    """Print the special points and ends of families, and how long boundaries are."""
    for family in found.families:
        name = family.parameter
        returns = "" if family.n_returns == 1 else f", {family.n_returns} returns a period"
        stable = sum(point.stable for point in family.points)
        print_lines([f"Family in {name}{returns}: {len(family.points)} orbits, {stable} stable."])
        table = _table("point", name, "error", "period [s]", "multipliers")
        for special in family.named:
            values = special.at.multipliers[:2]
            table.add_row(
                special.kind.value,
                f"{special.at.value:.12g}",
                f"{special.error:.0e}" if special.kind.located else "",
                f"{special.at.period:.10g}",
                ", ".join(_short(value) for value in values),
            )
        _print(table)
        print_lines(
            f"{special.kind.value}: {special.detail}" for special in family.named if special.detail
        )
    if found.boundaries:
        table = _table("boundary", "points", "in", "largest error", "ends")
        for boundary in found.boundaries:
            table.add_row(
                boundary.kind.value,
                str(len(boundary.x)),
                ", ".join(boundary.names),
                f"{max(boundary.errors):.0e}",
                "; ".join(boundary.ends),
            )
        _print(table)
        print_lines(_cusp(boundary, k) for boundary in found.boundaries for k in boundary.cusps)


def _cusp(boundary: Boundary, place: int) -> str:
    values = zip(boundary.names, (boundary.x[place], boundary.y[place]), strict=True)
    return "Two folds meet in a cusp at " + ", ".join(f"{n} = {v:.10g}" for n, v in values) + "."


def _short(value: complex) -> str:
    return f"{value.real:.5g}" if value.imag == 0.0 else f"{value.real:.5g} {value.imag:+.5g} i"


def _error_of(trial: Trial) -> str:
    if trial.trouble:
        return "-"
    return f"{trial.error:.1e}" if trial.error < math.inf else "another motion"


def _figures(trial: Trial) -> tuple[str, str, str]:
    return f"{trial.value:.0e}", f"{1e3 * trial.seconds:.2f}", f"{trial.error:.1e}"


def print_lines(lines: Iterable[str]) -> None:
    """Print plain lines."""
    for line in lines:
        _console().print(line, soft_wrap=True)


def print_error(message: str) -> None:
    """Print one line on standard error."""
    sys.stderr.write(f"zeno-orbits: {' '.join(message.split())}\n")


def _complex(value: complex) -> str:
    return f"{value.real:.7g}" if value.imag == 0.0 else f"{value.real:.7g} {value.imag:+.7g} i"


def _table(*columns: str) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        table.add_column(column)
    return table


def _console() -> Console:
    """Return a console that prints text as it is and leaves a broken pipe to the caller."""
    from rich.console import Console

    class Plain(Console):
        def on_broken_pipe(self) -> None:
            """Say so; rich would exit."""
            raise BrokenPipeError

    # A file has no width of its own; a hundred columns split no cell of ours.
    width = None if sys.stdout.isatty() else 100
    return Plain(highlight=False, markup=False, width=width)


def _print(table: Table) -> None:
    console = _console()
    console.print(table)
    console.print()
