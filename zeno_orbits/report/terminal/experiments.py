"""Tables of machines, simulated or measured: rigs, recordings and fitted parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from zeno_orbits.errors import counted
from zeno_orbits.report.table import Column, name_column, number_column, text_column
from zeno_orbits.report.terminal.console import print_lines, print_table

if TYPE_CHECKING:
    from zeno_orbits.experiment import (
        Comparison,
        Fitted,
        Identification,
        Metric,
        Recording,
        RigComparison,
    )

_RIG_ROWS = {
    "impact_time": "first impact",
    "impact_rate": "gap rate at the first impact",
    "lock_time": "Zeno point, or end of chatter",
    "lock_angle": "{amplitude} at that time",
    "period": "period",
}
"""Name of a number to its words; times count from release."""


def print_rig(comparison: RigComparison, amplitude: str) -> None:
    """Print the cycles of a simulated machine beside an orbit.

    Args:
        comparison: Both.
        amplitude: Name of the coordinate whose amplitude the problem measures.
    """
    rows = {name: words.format(amplitude=amplitude) for name, words in _RIG_ROWS.items()}

    def orbit(name: str) -> float:
        return getattr(comparison.orbit, name)

    def mean(name: str) -> float:
        return getattr(comparison.mean, name)

    columns: list[Column[str]] = [
        text_column("quantity", lambda name: rows[name]),
        text_column("unit", lambda name: comparison.units[name]),
        number_column("orbit", lambda name: f"{orbit(name):.6f}"),
        number_column("machine, mean", lambda name: f"{mean(name):.6f}"),
        number_column("standard deviation", lambda name: f"{getattr(comparison.spread, name):.1e}"),
        number_column("difference", lambda name: f"{mean(name) - orbit(name):+.1e}"),
    ]
    print_table(columns, rows)
    print_lines(
        [
            f"Simulated, not measured: {_settled(comparison, rows)}. In the space of states the "
            f"machine is at most {100 * comparison.portrait:.2g} % of the orbit's size away from "
            f"it, at {100 * comparison.portrait_at:.0f} % of the cycle."
        ]
    )


def _settled(comparison: RigComparison, rows: Mapping[str, str]) -> str:
    cycles = counted(comparison.cycles, "cycle")
    if comparison.drifting is None:
        return f"{cycles}, too few to tell whether it has settled"
    if comparison.drifting:
        moving = ", ".join(rows[name] for name in comparison.drifting)
        return f"{cycles}, and the machine has not settled: {moving} still changes in one direction"
    return f"{comparison.cycles} settled cycles"


def print_contacts(name: str, contacts: Sequence[Mapping[str, float]]) -> None:
    """Print the contacts of a simulated machine.

    Args:
        name: Name of the problem.
        contacts: Start, end [s] and approach rate of each.
    """
    columns: list[Column[Mapping[str, float]]] = [
        number_column("contact begins [s]", lambda contact: f"{contact['start']:.6f}"),
        number_column("ends [s]", lambda contact: f"{contact['end']:.6f}"),
        number_column(
            "gap rate at its beginning", lambda contact: f"{contact['approach_rate']:.6f}"
        ),
    ]
    print_table(columns, contacts)
    print_lines([f"Simulated, not measured: {counted(len(contacts), 'contact')} of {name}."])


def print_comparison(found: Comparison) -> None:
    """Print a recording beside an orbit."""
    columns: list[Column[Metric]] = [
        text_column("quantity", lambda metric: metric.name),
        number_column("orbit", lambda metric: f"{metric.orbit:.7g}"),
        number_column(
            found.recording.label, lambda metric: _known(metric.data, ".7g", "not observed")
        ),
        number_column("difference", lambda metric: _known(metric.data - metric.orbit, "+.3g")),
        number_column("standard error", lambda metric: _known(metric.error, ".2g")),
        text_column("unit", lambda metric: metric.unit),
    ]
    if found.metrics:
        print_table(columns, found.metrics)
    print_lines(f"Note: {remark}." for remark in (*found.recording.remarks, *found.remarks))
    if found.agrees:
        print_lines(["The recording shows such an orbit."])
        return
    print_lines(["The recording shows no such orbit:", *(f"  {one}." for one in found.reasons)])


def _known(value: float, form: str, otherwise: str = "-") -> str:
    return f"{value:{form}}" if math.isfinite(value) else otherwise


def print_identification(recording: Recording, found: Identification) -> None:
    """Print parameters that were fitted to a recording."""
    columns: list[Column[Fitted]] = [
        name_column("parameter", lambda one: one.unknown.label),
        number_column("start value", lambda one: f"{one.start:.6g}"),
        number_column("fitted", lambda one: f"{one.value:.7g}"),
        text_column("standard error", lambda one: _known(one.error, ".2g", "not determined")),
        text_column("95 % interval", _interval),
    ]
    print_table(columns, found.fitted)
    print_lines(
        [
            f"Deviation of all signals relative to their ranges: {found.before:.2g} before, "
            f"{found.after:.2g} after the fit. Period {found.orbit.period:.7g} s.",
            *(f"Note: {remark}." for remark in (*recording.remarks, *found.remarks)),
            *(f"Warning: {one.text}." for one in found.unseen),
        ]
    )


def _interval(one: Fitted) -> str:
    return f"{one.low:.6g} to {one.high:.6g}" if math.isfinite(one.error) else "-"
