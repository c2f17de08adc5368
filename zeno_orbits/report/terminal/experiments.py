"""Tables of machines, simulated or measured: rigs, recordings and fitted parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from zeno_orbits.errors import counted
from zeno_orbits.model import unit_quotient
from zeno_orbits.report.recordings import comparison_columns, comparison_lines, known, seven
from zeno_orbits.report.table import (
    TableColumn,
    name_column,
    number_column,
    prefixed,
    shown_number,
    text_column,
)
from zeno_orbits.report.terminal.console import print_lines, print_table

if TYPE_CHECKING:
    from zeno_orbits.experiment import Column as FileColumn
    from zeno_orbits.experiment import (
        Comparison,
        Estimate,
        FittedParameter,
        FittedTrial,
        FlightDeviation,
        Identification,
        ImpactDeviation,
        LawComparison,
        LawFit,
        RecordingDescription,
        RigComparison,
        TransientComparison,
        TransientFit,
    )

_RIG_ROWS = {
    "impact_time": "first impact",
    "impact_rate": "gap rate at the first impact",
    "lock_time": "Zeno point, or end of chatter",
    "lock_angle": "{amplitude} at that time",
    "period": "period",
}
"""Description of each quantity by name, with times since the release."""


def print_rig(comparison: RigComparison, amplitude: str) -> None:
    """Print the cycles of a simulated machine next to an orbit.

    Args:
        comparison: The machine's cycles and the orbit.
        amplitude: Name of the coordinate whose amplitude the problem measures.
    """
    rows = {name: words.format(amplitude=amplitude) for name, words in _RIG_ROWS.items()}

    def orbit(name: str) -> float:
        return getattr(comparison.orbit, name)

    def mean(name: str) -> float:
        return getattr(comparison.mean, name)

    def scale(name: str) -> tuple[str, float]:
        return prefixed(comparison.units[name], orbit(name), mean(name))

    def spread(name: str) -> float:
        return getattr(comparison.spread, name)

    def difference(name: str) -> str:
        apart = (mean(name) - orbit(name)) / scale(name)[1]
        return f"{apart:+.2g}" if abs(apart) > _ROUNDING else "0"

    columns: list[TableColumn[str]] = [
        text_column("quantity", lambda name: rows[name]),
        text_column("unit", lambda name: scale(name)[0]),
        number_column("orbit", lambda name: seven(orbit(name) / scale(name)[1])),
        number_column("machine, mean", lambda name: seven(mean(name) / scale(name)[1])),
        number_column("standard deviation", lambda name: _two(spread(name) / scale(name)[1])),
        number_column("difference", difference),
    ]
    print_table(columns, rows)
    lines = [
        f"Simulated, not measured: {_settled(comparison, rows)}. In the space of states the "
        f"machine is at most {100 * comparison.portrait:.2g} % of the orbit's size away from "
        f"it, at {100 * comparison.portrait_at:.0f} % of the cycle.",
        *(f"Warning: {warning}." for warning in comparison.warnings),
    ]
    print_lines(lines)


_ROUNDING = 1e-15
"""Coordinates of this size at the stop are rounding."""


def _two(value: float) -> str:
    return shown_number(value, 2) if abs(value) > _ROUNDING else "0"


def _settled(comparison: RigComparison, rows: Mapping[str, str]) -> str:
    cycles = counted(comparison.cycles, "cycle")
    if comparison.unlike:
        return f"{cycles}, none of the orbit's kind: {', '.join(comparison.unlike)}"
    if comparison.drifting is None:
        return f"{cycles}, too few to decide whether it has settled"
    if comparison.drifting:
        moving = ", ".join(rows[name] for name in comparison.drifting)
        return f"{cycles}, and the machine has not settled: {moving} still changes in one direction"
    return f"{comparison.cycles} settled cycles"


def print_contacts(
    name: str,
    contacts: Sequence[Mapping[str, float]],
    gap_unit: str,
    stops: Sequence[str] = (),
    *,
    every: bool = True,
) -> None:
    """Print the contacts of a simulated machine.

    Args:
        name: Name of the problem.
        contacts: Start, end [s] and approach rate of each.
        gap_unit: Unit of the gap.
        stops: Stop of each contact, for a machine with several stops.
        every: Whether a list that is longer than a terminal is printed whole. Else it has one row
            per stop.
    """
    if not every and len(contacts) > _MOST_ROWS:
        _print_contact_summary(contacts, gap_unit, stops or ["stop"] * len(contacts))
        print_lines(
            [
                "--events prints every contact.",
                f"Simulated, not measured: {counted(len(contacts), 'contact')} of {name}.",
            ]
        )
        return
    unit, size = prefixed("s", *(one["end"] for one in contacts))
    rate, speed = prefixed(
        unit_quotient(gap_unit, "s"), *(one["approach_rate"] for one in contacts)
    )
    named: TableColumn[tuple[str, Mapping[str, float]]] = TableColumn(
        heading="stop", cell=lambda one: one[0], is_whole=True
    )
    columns: list[TableColumn[tuple[str, Mapping[str, float]]]] = [
        *([named] if stops else []),
        number_column(f"contact begins [{unit}]", lambda one: seven(one[1]["start"] / size)),
        number_column(f"ends [{unit}]", lambda one: seven(one[1]["end"] / size)),
        number_column(
            f"gap rate at its beginning [{rate}]",
            lambda one: seven(one[1]["approach_rate"] / speed),
        ),
    ]
    names = stops or [""] * len(contacts)
    print_table(columns, list(zip(names, contacts, strict=True)))
    print_lines([f"Simulated, not measured: {counted(len(contacts), 'contact')} of {name}."])


_MOST_ROWS = 16
"""Rows of a table that fits a terminal."""


def _print_contact_summary(
    contacts: Sequence[Mapping[str, float]], gap_unit: str, stops: Sequence[str]
) -> None:
    """Print the number of contacts, their first and last time, and their speeds, by stop."""
    by_stop: dict[str, list[Mapping[str, float]]] = {}
    for stop, one in zip(stops, contacts, strict=True):
        by_stop.setdefault(stop, []).append(one)
    unit, size = prefixed("s", *(one["end"] for one in contacts))
    rates = [one["approach_rate"] for one in contacts]
    rate, speed = prefixed(unit_quotient(gap_unit, "s"), *rates)
    short, scale = prefixed("s", *(one["end"] - one["start"] for one in contacts))

    def fastest(rows: Sequence[Mapping[str, float]]) -> float:
        return min(one["approach_rate"] for one in rows)

    def longest(rows: Sequence[Mapping[str, float]]) -> float:
        return max(one["end"] - one["start"] for one in rows)

    columns: list[TableColumn[tuple[str, list[Mapping[str, float]]]]] = [
        name_column("stop", lambda row: row[0]),
        number_column("contacts", lambda row: str(len(row[1]))),
        number_column(f"first begins [{unit}]", lambda row: seven(row[1][0]["start"] / size)),
        number_column(f"last ends [{unit}]", lambda row: seven(row[1][-1]["end"] / size)),
        number_column(f"fastest gap rate [{rate}]", lambda row: seven(fastest(row[1]) / speed)),
        number_column(f"longest [{short}]", lambda row: seven(longest(row[1]) / scale)),
    ]
    print_table(columns, list(by_stop.items()))


def print_description(found: RecordingDescription) -> None:
    """Print what a file was understood to be: its extent, and a row for every column."""
    recording = found.recording
    if recording is None:
        print_lines([f"Not a recording: {found.trouble}."])
    else:
        rows = counted(len(recording.time), "row")
        span = f"from {recording.time[0]:.7g} to {recording.time[-1]:.7g} s"
        print_lines([f"A recording of {rows} {span}, {found.rate:.4g} rows a second."])

    def bound(one: FileColumn, k: int) -> str:
        extent = found.extent(one)
        return "" if extent is None else seven(extent[k])

    def missing(one: FileColumn) -> str:
        extent = found.extent(one)
        return str(extent[2]) if extent is not None and extent[2] else ""

    def role(one: FileColumn) -> str:
        return found.role(one) if one.holds_text or not one.trouble else "cannot be used"

    columns: list[TableColumn[FileColumn]] = [
        name_column("title", lambda one: one.title or "(empty)"),
        name_column("name", lambda one: one.name),
        text_column("unit", lambda one: one.unit),
        number_column("least", lambda one: bound(one, 0)),
        number_column("greatest", lambda one: bound(one, 1)),
        number_column("missing", missing),
        text_column("counts as", role),
    ]
    print_table(columns, found.columns)
    troubles = [one.trouble for one in found.columns if one.trouble and not one.holds_text]
    remarks = () if recording is None else recording.remarks
    print_lines(f"Note: {remark}." for remark in dict.fromkeys((*troubles, *remarks)))


def print_comparison(found: Comparison) -> None:
    """Print the verdict on a recording, and its quantities next to the orbit's quantities."""
    print_lines(comparison_lines(found))
    if found.metrics:
        print_table(comparison_columns(found), found.metrics)
    if found.second_file is not None and found.second_file.metrics:
        print_lines(["", "Second file:"])
        print_table(comparison_columns(found.second_file), found.second_file.metrics)
    notes = (*found.recording.remarks, *_read_as(found.instruments), *found.remarks)
    print_lines(f"Note: {remark}." for remark in notes)


def _read_as(errors: Mapping[str, Estimate]) -> Iterator[str]:
    """Yield the fitted errors of instruments in words."""
    for name, one in errors.items():
        error = f" +- {one.error:.2g}" if math.isfinite(one.error) else ", not determined"
        yield f"{name} = {one.value:.6g}{error}"


def print_laws(found: LawComparison) -> None:
    """Print laws of impact and the law that the recordings support."""
    words = {True: "no structure left", False: "structure left"}
    columns: list[TableColumn[LawFit]] = [
        name_column("law", lambda one: one.law),
        number_column("deviation", lambda one: f"{100 * one.found.after:.3g} %"),
        text_column("residuals", lambda one: words[one.is_supported]),
        text_column("fitted", lambda one: ", ".join(map(_short, one.found.fitted))),
    ]
    print_lines([f"Laws of impact: {found.verdict}."])
    print_table(columns, found.fits)
    print_lines(["", f"Law `{found.best.law}`:"])


def _short(one: FittedParameter) -> str:
    return f"{one.unknown.label}={one.value:.5g}"


def print_identification(found: Identification, recording_remarks: Sequence[str] = ()) -> None:
    """Print parameters that were fitted to recordings.

    Args:
        found: The result.
        recording_remarks: Remarks of the reader of the files.
    """
    if found.transient is not None:
        print_lines([f"Model: {found.transient.verdict}."])
    columns: list[TableColumn[FittedParameter]] = [
        name_column("parameter", lambda one: one.unknown.label),
        number_column("start value", lambda one: f"{one.start:.6g}"),
        number_column("fitted", lambda one: f"{one.value:.7g}"),
        text_column("standard error", lambda one: known(one.error, ".2g", "not determined")),
        text_column("95 % interval", _interval),
    ]
    print_table(columns, found.fitted)
    print_lines(
        [
            f"{_deviation(found)}{_period(found)}".strip(),
            *_edges(found),
            *([] if found.transient is None else _transient_lines(found.transient)),
            "Intervals contain noise and its correlation, and no error of the model. They contain "
            "errors of instruments only if these are fitted: CHANNEL.gain, CHANNEL.offset, "
            "clock_rate.",
            *(f"Note: {remark}." for remark in (*recording_remarks, *found.remarks)),
            *(f"Warning: {one.text}." for one in found.unseen),
        ]
    )


def _period(found: Identification) -> str:
    """Return the period of the orbit in words, empty for transients."""
    return "" if found.closed_orbit is None else f"Period {found.closed_orbit.period:.7g} s."


_LISTED = 6
"""Trials that have their own line."""


def _transient_lines(found: TransientFit) -> list[str]:
    """Return the impacts, the events and the starts of a fit of transients in words."""
    lines = [
        f"{one.label}: {counted(len(one.impacts), 'impact')} of the fitted motion, "
        f"{one.seen_impacts} in the recording, {counted(len(one.missed), 'event')} missed, "
        f"{len(one.false)} false."
        for one in found.trials[:_LISTED]
    ]
    others = found.trials[_LISTED:]
    if others:
        missed, false = (sum(map(len, rows)) for rows in _errors_of(others))
        more = counted(len(others), "further trial")
        lines.append(f"{more}: {counted(missed, 'event')} missed, {false} false.")
    if math.isfinite(found.scatter) and not math.isfinite(found.jitter):
        lines.append(f"Scatter of the restitution per impact: {100 * found.scatter:.2g} %.")
    elif math.isfinite(found.scatter):
        lines.append(
            f"Event times: jitter {1e3 * found.jitter:.2g} ms, scatter of the restitution per "
            f"impact {100 * found.scatter:.2g} %."
        )
    lines.append(f"Starts: {found.agreed} of {found.starts} led to this optimum.")
    return lines


def _errors_of(
    trials: Sequence[FittedTrial],
) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Return the missed and the false events of trials."""
    return [one.missed for one in trials], [one.false for one in trials]


def print_transient_comparison(found: TransientComparison) -> None:
    """Print transients compared with the motion of a problem, impact by impact."""
    print_lines([f"Model: {found.fit.verdict}."])
    impacts: list[TableColumn[ImpactDeviation]] = [
        name_column("trial", lambda one: one.trial),
        number_column("impact", lambda one: str(one.number)),
        number_column("recorded [s]", lambda one: known(one.recorded, ".6g", "not seen")),
        number_column("fitted [s]", lambda one: f"{one.fitted:.6g}"),
        number_column("difference [ms]", lambda one: known(1e3 * one.deviation, "+.3g")),
    ]
    if found.impacts:
        print_table(impacts, found.impacts)
    flights: list[TableColumn[FlightDeviation]] = [
        name_column("trial", lambda one: one.trial),
        text_column("signal", lambda one: one.signal),
        number_column("flight", lambda one: str(one.flight)),
        number_column("begin [s]", lambda one: f"{one.begin:.5g}"),
        number_column("mean deviation", lambda one: f"{one.mean:+.3g}"),
        number_column("rms deviation", lambda one: f"{one.rms:.3g}"),
        text_column("unit", lambda one: one.unit),
    ]
    if found.flights:
        print_table(flights, found.flights)
    print_lines(
        [
            f"Deviation of all signals relative to their ranges: {found.rms:.2g}. Only initial "
            f"values{' and errors of instruments' if found.instruments else ''} were fitted.",
            *(f"Note: {remark}." for remark in (*_read_as(found.instruments), *found.remarks)),
        ]
    )


def _deviation(found: Identification) -> str:
    """Return the deviation of the signals in words, empty without signals."""
    if not found.before > 0.0:
        return ""
    return (
        f"Deviation of all signals relative to their ranges: {found.before:.2g} before, "
        f"{found.after:.2g} after the fit. "
    )


def _edges(found: Identification) -> list[str]:
    """Return the deviation of the contacts in words, nothing without contact channels."""
    if not found.edges:
        return []
    return [f"Deviation of {found.edges} edges of contacts: {found.edge_misfit:.2g} errors."]


def _interval(one: FittedParameter) -> str:
    return f"{one.low:.6g} to {one.high:.6g}" if math.isfinite(one.error) else "-"
