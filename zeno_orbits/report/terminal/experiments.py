"""What a person reads of a machine, simulated or measured: tables of rigs, recordings and fits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from zeno_orbits.report.terminal.console import plain_console, print_table, table_of

if TYPE_CHECKING:
    from zeno_orbits.experiment import Comparison, Identification, Recording
    from zeno_orbits.experiment.rig.cycle_comparison import RigComparison

_RIG_ROWS = {
    "impact_time": "first impact",
    "impact_rate": "gap rate there",
    "lock_time": "Zeno time; end of chatter",
    "lock_angle": "amplitude's coordinate there",
    "period": "period",
}


def print_rig(comparison: RigComparison) -> None:
    """Print the cycles of a simulated machine beside an orbit."""
    table = table_of("", "unit", "orbit", "machine, simulated", "spread", "difference")
    for name, label in _RIG_ROWS.items():
        orbit = getattr(comparison.orbit, name)
        mean, spread = getattr(comparison.mean, name), getattr(comparison.spread, name)
        table.add_row(
            *(label, comparison.units[name], f"{orbit:.6f}", f"{mean:.6f}"),
            *(f"{spread:.1e}", f"{mean - orbit:+.1e}"),
        )
    print_table(table)
    plain_console().print(
        f"Simulated, not measured: {_settled(comparison)}. In the space of states the "
        f"machine is farthest from the orbit, {100 * comparison.portrait:.2g} % of its size, at "
        f"{100 * comparison.portrait_at:.0f} % of the cycle.",
        soft_wrap=True,
    )


def _settled(comparison: RigComparison) -> str:
    cycles = f"{comparison.cycles} cycle{'s' if comparison.cycles != 1 else ''}"
    if comparison.drifting is None:
        return f"{cycles}, too few to tell whether it has settled"
    if comparison.drifting:
        moving = ", ".join(_RIG_ROWS[name] for name in comparison.drifting)
        return f"{cycles}, and the machine has not settled: {moving} still move one way"
    return f"{comparison.cycles} settled cycles"


def print_contacts(name: str, contacts: Sequence[Mapping[str, float]]) -> None:
    """Print the contacts of a simulated machine."""
    table = table_of("contact from [s]", "to [s]", "gap rate before")
    for contact in contacts:
        numbers = (contact["start"], contact["end"], contact["approach_rate"])
        table.add_row(*(f"{number:.6f}" for number in numbers))
    print_table(table)
    plain_console().print(f"Simulated, not measured: {len(contacts)} contacts of {name}.")


def print_comparison(found: Comparison) -> None:
    """Print a recording beside an orbit."""
    table = table_of("", "orbit", found.recording.label, "difference", "standard error", "unit")
    for metric in found.metrics:
        known = math.isfinite(metric.data)
        difference = f"{metric.data - metric.orbit:+.3g}" if known else "-"
        error = f"{metric.error:.2g}" if math.isfinite(metric.error) else "-"
        data = f"{metric.data:.7g}" if known else "not seen"
        table.add_row(metric.name, f"{metric.orbit:.7g}", data, difference, error, metric.unit)
    if found.metrics:
        print_table(table)
    console = plain_console()
    for remark in (*found.recording.remarks, *found.remarks):
        console.print(f"Note: {remark}.", soft_wrap=True)
    if found.agrees:
        console.print("The recording shows such an orbit.")
        return
    console.print("The recording shows no such orbit:")
    for reason in found.reasons:
        console.print(f"  {reason}.", soft_wrap=True)


def print_identification(recording: Recording, found: Identification) -> None:
    """Print parameters that were found from a recording."""
    table = table_of("", "start", "fitted", "standard error", "95 % interval")
    for one in found.fitted:
        known = math.isfinite(one.error)
        error = f"{one.error:.2g}" if known else "not told"
        interval = f"{one.low:.6g} to {one.high:.6g}" if known else "-"
        label = one.unknown.label
        table.add_row(label, f"{one.start:.6g}", f"{one.value:.7g}", error, interval)
    print_table(table)
    console = plain_console()
    console.print(
        f"Deviation of all signals, in parts of their ranges: {found.before:.2g} before, "
        f"{found.after:.2g} after the fit. Period {found.orbit.period:.7g} s.",
        soft_wrap=True,
    )
    for remark in (*recording.remarks, *found.remarks):
        console.print(f"Note: {remark}.", soft_wrap=True)
    for one in found.unseen:
        console.print(f"Warning: {one.text}.", soft_wrap=True)
