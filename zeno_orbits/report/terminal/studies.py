"""Tables of what looks at many motions or orbits: trades, maps and families."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from zeno_orbits.report.terminal.console import print_lines, print_table, table_of

if TYPE_CHECKING:
    from zeno_orbits.continuation.families import Boundary, Continuation
    from zeno_orbits.maps.attractors import Attractor
    from zeno_orbits.maps.mapping import ParameterMap
    from zeno_orbits.precision.work_precision import Trial, WorkPrecision


def print_trade(trade: WorkPrecision) -> None:
    """Print the trials of a trade, those that no other beats marked, and the cheapest for each."""
    front = set(map(id, trade.front))
    table = table_of("", "sweep", "setting", "value", "time [ms]", "error", "impacts")
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
    print_table(table)
    table = table_of("accuracy", "cheapest setting", "value", "time [ms]", "error")
    for accuracy in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12):
        best = trade.cheapest(accuracy)
        name = "none" if best is None else f"{best.sweep}: {best.name}"
        row = ("", "", "") if best is None else _figures(best)
        table.add_row(f"{accuracy:.0e}", name, *row)
    print_table(table)
    print_lines(
        [
            f"Work: {trade.work}. Truth: {trade.truth}, certain to {trade.truth_error:.0e}.",
            "* no other setting is both faster and more accurate. Times are of this machine.",
        ]
    )


def print_map(found: ParameterMap) -> None:
    """Print how many points of a map settle to what."""
    table = table_of("the motion settles to", "points", "share", "period [s]", "spectral radius")
    groups: dict[str, list[Attractor]] = {}
    for attractor in found.attractors:
        groups.setdefault(attractor.phrase, []).append(attractor)
    for phrase, group in sorted(groups.items(), key=lambda item: -len(item[1])):
        share = f"{100 * len(group) / len(found.attractors):.1f} %"
        periods = _range([one.period for one in group])
        radii = _range([one.spectral_radius for one in group])
        table.add_row(phrase, str(len(group)), share, periods, radii)
    print_table(table)
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
        table = table_of("point", name, "error", "period [s]", "multipliers")
        for special in family.named:
            values = special.at.multipliers[:2]
            table.add_row(
                special.kind.value,
                f"{special.at.value:.12g}",
                f"{special.error:.0e}" if special.kind.located else "",
                f"{special.at.period:.10g}",
                ", ".join(_short(value) for value in values),
            )
        print_table(table)
        print_lines(
            f"{special.kind.value}: {special.detail}" for special in family.named if special.detail
        )
    if found.boundaries:
        table = table_of("boundary", "points", "in", "largest error", "ends")
        for boundary in found.boundaries:
            table.add_row(
                boundary.kind.value,
                str(len(boundary.x)),
                ", ".join(boundary.names),
                f"{max(boundary.errors):.0e}",
                "; ".join(boundary.ends),
            )
        print_table(table)
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
