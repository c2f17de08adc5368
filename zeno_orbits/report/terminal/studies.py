"""Tables of many motions or orbits: reduced models, work-precision measurements, maps, families."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from textwrap import wrap
from typing import TYPE_CHECKING

from zeno_orbits.errors import counted
from zeno_orbits.report.disturbances import (
    PUSHES,
    extent_columns,
    extents_of,
    least_push_line,
    recovery_lines,
    scan_line,
    summary_line,
)
from zeno_orbits.report.table import (
    TableColumn,
    name_column,
    number_column,
    shown_complex,
    shown_multiplier,
    shown_multipliers,
    shown_size,
    text_column,
    with_unit,
)
from zeno_orbits.report.terminal.console import line_width, print_lines, print_table
from zeno_orbits.work import decimal_below

if TYPE_CHECKING:
    from zeno_orbits.continuation import (
        Continuation,
        Family,
        HeldFamilies,
        HeldPoint,
        SpecialCurve,
        SpecialPoint,
    )
    from zeno_orbits.maps import (
        Attractor,
        Feedback,
        LoopCorner,
        ParameterMap,
        Pushes,
        Recovery,
        Scatter,
        ScatterRow,
    )
    from zeno_orbits.orbits import Stability
    from zeno_orbits.precision import ReductionCost, TimedSetting, WorkPrecision
    from zeno_orbits.proof import Proof

_MOST_HELD = 12
"""Rows of repelling orbits that are printed at least, if there are as many."""
_ROUNDING = 1e-12
"""A multiplier of a branch below this value is rounding error."""


def print_reduction_costs(costs: Sequence[ReductionCost]) -> None:
    """Print the relative errors that the reduced models of a problem make in an orbit."""
    columns: list[TableColumn[tuple[ReductionCost, str]]] = [
        name_column("reduced model", lambda row: _if_first(row, row[0].problem)),
        text_column(
            "states", lambda row: _if_first(row, f"{row[0].n_states} of {row[0].n_full_states}")
        ),
        text_column("error of", lambda row: row[1].replace("_", " ")),
        number_column("estimate", lambda row: f"{row[0].estimate[row[1]]:.1e}"),
        number_column("up to", lambda row: f"{row[0].bound[row[1]]:.1e}"),
    ]
    if any(cost.measured for cost in costs):
        columns.append(number_column("measured", _measured))
    print_table(columns, _landmarks(costs))
    cost = costs[0]
    print_lines(
        [
            f"Relative errors. The currents settle in {cost.layer:.3g} s; the motion changes at "
            f"{cost.rate:.3g} 1/s.",
            "The estimate of the corrected model is an order of magnitude.",
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


def print_trade(trade: WorkPrecision) -> None:
    """Print the trials of a work-precision study, its Pareto front and the cheapest trials."""
    from zeno_orbits.report.trade_lines import CHEAPEST, cheapest_of, shown_value

    front = set(map(id, trade.front))
    columns: list[TableColumn[TimedSetting]] = [
        text_column("", lambda trial: "*" if id(trial) in front else ""),
        text_column("sweep", lambda trial: trial.sweep),
        text_column("setting", lambda trial: trial.name),
        number_column("value", shown_value),
        number_column("time [ms]", _milliseconds),
        text_column("error", _error_of),
        text_column("impacts", lambda one: one.trouble or str(one.n_impacts or "")),
    ]
    print_table(columns, trade.trials)
    print_table(CHEAPEST, cheapest_of(trade))
    print_lines(
        [
            f"Work: {trade.work}. Reference: {trade.truth}, with an error of "
            f"{trade.truth_error:.0e}.",
            "* no other setting is both faster and more accurate. Times are of this machine.",
        ]
    )
    if math.isfinite(trade.cut_order):
        order = f"{trade.cut_order:.2f} (theory: {trade.expected_cut_order}, of the "
        order += f"{trade.compared}s)"
        print_lines([f"Observed order of the error of plastic cuts in their speed: {order}."])


def _milliseconds(trial: TimedSetting) -> str:
    return f"{1e3 * trial.seconds:.2f}" if trial.seconds < math.inf else "-"


def _error_of(trial: TimedSetting) -> str:
    if trial.trouble:
        return "-"
    return shown_size(trial.error) if trial.error < math.inf else "another motion"


def print_map(found: ParameterMap) -> None:
    """Print the number of points of a map for each attractor."""
    groups: dict[str, list[Attractor]] = {}
    for attractor in found.attractors:
        groups.setdefault(attractor.phrase, []).append(attractor)
    total = len(found.attractors)
    columns: list[TableColumn[tuple[str, list[Attractor]]]] = [
        text_column("attractor", lambda row: row[0]),
        number_column("points", lambda row: str(len(row[1]))),
        number_column("share", lambda row: f"{100 * len(row[1]) / total:.1f} %"),
        number_column("period [s]", lambda row: _range([one.period for one in row[1]])),
        number_column(
            "spectral radius", lambda row: _range([one.spectral_radius for one in row[1]])
        ),
    ]
    print_table(columns, sorted(groups.items(), key=lambda item: -len(item[1])))
    axes = (f"{a.name} = {a.lower:g} to {a.upper:g} ({a.count})" for a in (found.x, found.y))
    print_lines([f"{' by '.join(axes)}. Each motion was simulated for {found.until:g} s at most."])
    if found.refine:
        finest_x, finest_y, _ = found.finest()
        grid = f"{finest_x.count} x {finest_y.count}"
        print_lines([f"Boundaries: {len(found.between)} more points of a grid of {grid}."])


def print_attractor(found: Attractor) -> None:
    """Print the attractor of a motion."""
    parts = [found.phrase]
    if math.isfinite(found.period):
        parts.append(f"period {found.period:.8g} s")
    if math.isfinite(found.spectral_radius):
        parts.append(f"spectral radius {found.spectral_radius:.4g}")
    if math.isfinite(found.exponent):
        error = f"{found.exponent:.3g} +- {found.exponent_error:.1g} 1/s"
        parts.append(f"largest Lyapunov exponent {error}")
    if found.detail and found.detail != found.phrase:
        parts.append(found.detail)
    print_lines([f"Attractor: {'; '.join(parts)}."])


def print_pushes(found: Pushes) -> None:
    """Print the largest pushes of an orbit, the least one first."""
    print_lines([least_push_line(found)])
    print_table(PUSHES, found.pushes)
    print_lines([scan_line(found), summary_line(found)])


def print_recovery(found: Recovery) -> None:
    """Print the recovery of an orbit, its time first."""
    print_lines(recovery_lines(found))
    extents = extents_of(found)
    if extents:
        print_lines([""])
        print_table(extent_columns(found), extents)


def print_scatter(found: Scatter) -> None:
    """Print the scatter of an orbit: what scatters, how long it lasts, and a table."""
    told = ", ".join(f"{name} {value:g}" for name, value in found.spread.items())
    print_lines([f"Scatter of {found.problem}, standard deviations: {told}.", _lasts(found)])
    for reason, count in found.reasons.items():
        print_lines([f"{count} of {found.lost}: {reason}."])
    columns: list[TableColumn[ScatterRow]] = [
        name_column("quantity", lambda row: with_unit(row.name, f"[{row.unit}]")),
        number_column("orbit", lambda row: f"{row.orbit:.6g}"),
        number_column("linear", lambda row: f"{row.linear:.3g}"),
        number_column("simulated", lambda row: f"{row.deviation:.3g}"),
        number_column("+-", lambda row: f"{row.error:.1g}"),
        number_column("5 %", lambda row: f"{row.low:.6g}"),
        number_column("95 %", lambda row: f"{row.high:.6g}"),
    ]
    print_lines([""])
    print_table(columns, found.rows)


def _lasts(found: Scatter) -> str:
    """Return how many periods a motion stays on its orbit."""
    low, high = found.periods_until_lost_interval
    many = counted(found.simulated, "period")
    if not found.lost:
        return f"{many} simulated, none lost: more than {low:.3g} until a loss (95 %)."
    mean = f"{found.periods_until_lost:.3g}"
    return (
        f"{many} simulated, {found.lost} lost: {mean} until a loss (95 %: {low:.3g} to {high:.3g})."
    )


def print_stability(found: Stability) -> None:
    """Print the stability of an orbit: verdict, multipliers, return map and time to recover."""
    error = f" +- {found.error:.0e}" if found.spectral_radius else ""
    size = f"{found.spectral_radius:.6g}{error}" if math.isfinite(found.error) else "unknown"
    radius = f"spectral radius {size}"
    print_lines([f"Orbit of {found.problem}: {found.verdict}, {radius}"])
    if not found.values:
        print_lines(["No multipliers: every period passes a section that is a point."])
    else:
        rows = list(zip(found.values, found.errors, strict=True))
        columns: list[TableColumn[tuple[complex, float]]] = [
            text_column("multiplier", lambda row: shown_multipliers(row[:1], row[1], 7)),
            number_column("modulus", lambda row: shown_multiplier(abs(row[0]), row[1], 7)),
            number_column("error", lambda row: f"{row[1]:.0e}"),
        ]
        print_table(columns, rows)
        _print_return_map(found)
    print_lines(recovery_words(found))


def _print_return_map(found: Stability) -> None:
    """Print the derivative of the return map in the coordinates of its section."""
    side = "before" if found.event.startswith("switch") else "after"
    print_lines([f"Derivative DP of the return map, states just {side} `{found.event}`:"])

    def heading(k: int) -> str:
        name = found.coordinates[k]
        return with_unit(name, f"[{found.units[name]}]")

    def number(k: int) -> TableColumn[int]:
        return number_column(f"per {heading(k)}", lambda row: f"{found.jacobian[row, k]:.6g}")

    rows = range(len(found.coordinates))
    print_table([name_column("", heading), *map(number, rows)], rows)
    print_lines([f"Norm of DP (largest row sum, in scaled coordinates): {found.norm:.4g}"])


def print_feedback(found: Feedback, extents: Mapping[str, tuple[float, float]]) -> None:
    """Print a feedback: its matrix, its multipliers, and the disturbances that decay.

    Args:
        found: The feedback.
        extents: Coordinate to its largest disturbances, relative to its largest value.
    """
    known = found.returns
    keeps = "keeps" if found.stable else "does not keep"
    when = ", one return after the measurement" if found.delay else ""
    print_lines(
        [
            f"Feedback of {known.problem.name} by {', '.join(found.inputs)} at `{known.event}`"
            f"{when}: {keeps} the orbit",
            "Each input is its value in the orbit, minus the sum of coefficient times deviation:",
        ]
    )

    def coefficient(k: int) -> TableColumn[int]:
        name = found.measured[k]
        heading = with_unit(name, f"[{known.units[name]}]") if name in known.units else name
        return number_column(f"per {heading}", lambda row: f"{found.gain[row, k]:.6g}")

    print_table(
        [
            name_column("input", lambda row: found.inputs[row]),
            number_column("in the orbit", lambda row: f"{found.centre[row]:.7g}"),
            text_column("range", lambda row: _range_text(*found.limits[row])),
            *map(coefficient, range(len(found.measured))),
        ],
        range(len(found.inputs)),
    )
    before, after = (
        shown_multipliers(values, 0.0, 6) or "none"
        for values in (known.multipliers, found.multipliers)
    )
    print_lines([f"Multipliers without it: {before}", f"Multipliers with it:    {after}"])
    print_lines(_ends_of_ranges(found))
    if found.corners:
        _print_corners(found)
    if extents:
        columns: list[TableColumn[str]] = [
            name_column("coordinate", lambda name: name),
            number_column("in the orbit", lambda name: _in_orbit(found, name)),
            number_column("returns from", lambda name: _disturbed(found, name, extents[name][0])),
            number_column("to", lambda name: _disturbed(found, name, extents[name][1])),
            text_column("unit", lambda name: known.units[name]),
        ]
        print_table(columns, list(extents))


def _print_corners(found: Feedback) -> None:
    """Print a loop at the corners of its uncertain parameters, with the worst one."""
    parameters = list(found.corners[0].parameters)
    columns: list[TableColumn[LoopCorner]] = [
        *(
            number_column(name, lambda one, name=name: f"{one.parameters[name]:g}")
            for name in parameters
        ),
        text_column("multipliers with it", _corner_multipliers),
        *(
            number_column(
                f"{name} there", lambda one, k=k: "" if one.lost else f"{one.inputs[k]:.7g}"
            )
            for k, name in enumerate(found.inputs)
        ),
    ]
    print_table(columns, found.corners)
    lost = [one for one in found.corners if one.lost]
    print_lines([f"No orbit at {_listed(one.parameters)}: {one.lost}" for one in lost])
    where = _listed(found.worst_at) or "the values of the orbit"
    size = f"modulus {found.worst:.6g}" if not lost else "no orbit"
    keeps = "keeps an orbit at every corner" if found.robust else "does not keep an orbit there"
    print_lines([f"Worst case: {size} at {where}. The loop {keeps}."])


def _corner_multipliers(one: LoopCorner) -> str:
    if one.lost:
        return "no orbit"
    return shown_multipliers(one.multipliers, 0.0, 6) or "none"


def _listed(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in values.items())


def print_reading_errors(
    found: Feedback,
    errors: Mapping[str, float],
    offset: Mapping[str, float],
    scatter: Mapping[str, float],
) -> None:
    """Print how errors of the readings act on an orbit and its inputs.

    Args:
        found: The feedback.
        errors: Coordinate to the error of its reading.
        offset: Quantity to its shift, if the errors are constant.
        scatter: Quantity to its standard deviation, if they are random.
    """
    known = found.returns
    units = {**known.units, **known.problem.units}
    given = ", ".join(f"{name} {value:g} {known.units[name]}" for name, value in errors.items())
    print_lines([f"Errors of readings: {given}"])
    columns: list[TableColumn[str]] = [
        name_column("quantity", lambda name: name),
        number_column("shifted, if constant", lambda name: f"{offset[name]:.4g}"),
        number_column("scatter, if random", lambda name: f"{scatter[name]:.4g}"),
        text_column("unit", lambda name: units[name]),
    ]
    print_table(columns, list(offset))


def _range_text(low: float, high: float) -> str:
    smallest = sys.float_info.min
    if high == math.inf:
        if low == -math.inf:
            return "any"
        return "> 0" if 0.0 < low <= smallest else f">= {low:.7g}"
    if low == -math.inf:
        return f"<= {high:.7g}"
    return f"{low:.7g} to {high:.7g}"


def _ends_of_ranges(found: Feedback) -> list[str]:
    """Return a sentence on each input whose orbit is at an end of its range."""
    return [
        f"`{name}` is at an end of its range in the orbit and can change to one side only: give a "
        f"range with `--input {name}=LOW:HIGH`."
        for name, value, ends in zip(found.inputs, found.centre, found.limits, strict=True)
        if value in ends
    ]


def _in_orbit(found: Feedback, name: str) -> str:
    known = found.returns
    return f"{known.fixed_point[known.coordinates.index(name)]:.6g}"


def _disturbed(found: Feedback, name: str, part: float) -> str:
    known = found.returns
    place = known.coordinates.index(name)
    return f"{known.fixed_point[place] + part * known.sizes[place]:.4g}"


def recovery_words(found: Stability) -> list[str]:
    """Return the slowest direction of an orbit and its times as sentences."""
    slow, lines = found.slowest, list[str]()
    if slow is None and found.stable:
        wait = counted(round(found.periods_to(0.5)), "period")
        return [f"Every small disturbance vanishes within {wait}, to rounding."]
    if slow is not None:
        which = "Fastest growth" if found.unstable else "Slowest direction"
        lines += wrap(f"{which}: {slow.words}", line_width(), subsequent_indent="  ")
        if math.isfinite(slow.periods_per_turn):
            turn = f"{slow.periods_per_turn:.4g}"
            lines.append(f"The disturbance turns once in {turn} periods.")
    for name, periods in found.milestones.items():
        time = f"{periods:.4g} periods ({periods * found.period:.4g} s)"
        change = f"decays to {name}" if found.stable else f"grows to {name} its size"
        lines.append(f"A small disturbance {change} in {time}.")
    if not (found.stable or found.unstable):
        lines.append("The errors of the multipliers leave open whether a disturbance decays.")
    if not found.closes:
        lines.append(
            "The motion does not return to its start (`verify` measures by how much), a kink at "
            "which the flow jumps is crossed at the time of another event, or a root has an "
            "infinite derivative at an event."
        )
    return lines


def print_basin(proof: Proof, sampled: Recovery | None) -> None:
    """Print the proved set of initial states beside the ball of the same orbit that was sampled.

    Args:
        proof: The proof.
        sampled: The ball, or ``None`` if the section is a single point.
    """
    box = proof.initial_box
    if sampled is None or box is None:
        return
    name = "The set of initial states" if proof.basin_box else "Box 1"
    print_lines(["", f"{name} beside the sampled ball, whose half-widths are estimates:"])
    contained, halves = box.contained(), proof.initial_states
    columns: list[TableColumn[str]] = [
        text_column("state", lambda row: row),
        text_column("contained in the set", lambda row: contained[row]),
        number_column("ball", lambda row: f"+- {sampled.extents[row]:.3g}"),
        number_column("ratio", lambda row: _below(halves[row] / sampled.extents[row])),
        text_column("unit", lambda row: sampled.units[row]),
    ]
    print_table(columns, list(box.coordinates))


def _below(x: float) -> str:
    """Return a number rounded down to two digits."""
    return decimal_below(Fraction(x))


def _range(values: Sequence[float]) -> str:
    finite = [value for value in values if math.isfinite(value)]
    return f"{min(finite):.4g} to {max(finite):.4g}" if finite else ""


def print_families(found: Continuation) -> None:
    """Print the special points and ends of families, and the boundaries in two parameters."""
    for family in found.families:
        _print_family(family)
    if found.boundaries:
        columns: list[TableColumn[SpecialCurve]] = [
            text_column("boundary", lambda one: one.kind.value),
            number_column("points", lambda one: str(len(one.x))),
            text_column("in", lambda one: ", ".join(one.names)),
            number_column("largest error", lambda one: f"{max(one.errors):.0e}"),
            text_column("ends", lambda one: "; ".join(one.ends)),
        ]
        print_table(columns, found.boundaries)
        print_lines(_cusp(boundary, k) for boundary in found.boundaries for k in boundary.cusps)


def print_held_families(held: HeldFamilies) -> None:
    """Print the repelling orbits of families, each with the least feedback that keeps it.

    Args:
        held: The families with feedbacks.
    """
    name = held.found.families[0].parameter
    every = [point for points in held.points for point in points]
    kept = [point for point in every if not point.reason]
    orbits = counted(len(every), "repelling orbit")
    print_lines([f"Feedback by {', '.join(held.inputs)} keeps {len(kept)} of {orbits}."])
    if not every:
        return
    columns: list[TableColumn[HeldPoint]] = [
        number_column(name, lambda one: f"{one.value:.9g}"),
        number_column("period [s]", lambda one: f"{one.period:.9g}"),
        number_column("radius without", lambda one: f"{one.spectral_radius:.6g}"),
        number_column("with", lambda one: "" if one.reason else f"{one.held_radius:.6g}"),
        number_column("effort", lambda one: "" if one.reason else f"{one.effort:.5g}"),
    ]
    step = max(1, len(every) // _MOST_HELD)
    shown = every[::step]
    print_table(columns, shown)
    if step > 1:
        print_lines([f"One of {step} orbits is shown; --json has all."])
    print_lines(
        [
            "Effort: change of the inputs, relative to their own values, per disturbance of the "
            "coordinates' largest values."
        ]
    )
    for reason in dict.fromkeys(point.reason for point in every if point.reason):
        print_lines([f"Not kept: {reason}"])


def _print_family(family: Family) -> None:
    name = family.parameter
    returns = "" if family.n_returns == 1 else f", {family.n_returns} returns per period"
    stable = sum(point.stable for point in family.points)
    orbits = counted(len(family.points), "orbit")
    print_lines([f"Family in {name}{returns}: {orbits}, {stable} stable."])
    columns: list[TableColumn[SpecialPoint]] = [
        text_column("point", lambda one: one.kind.value),
        number_column(name, lambda one: f"{one.at.value:.12g}"),
        number_column("error", lambda one: f"{one.error:.0e}" if one.kind.located else ""),
        number_column("period [s]", lambda one: f"{one.at.period:.10g}"),
        text_column("multipliers", lambda one: ", ".join(map(_short, one.at.multipliers[:2]))),
        number_column("their error", _multiplier_error),
    ]
    print_table(columns, family.named)
    if math.isfinite(family.resolution):
        nearest = f"{family.resolution:.1e}"
        print_lines(
            [f"Two special points of one kind closer than {nearest} in {name} may be missed."]
        )
    print_lines(f"{one.kind.value}: {one.detail}" for one in family.named if one.detail)


_LEAST_ERROR = 1e-16
"""Error of a multiplier below which rounding hides it."""


def _multiplier_error(one: SpecialPoint) -> str:
    """Return the error of the multipliers at a point as text, empty without multipliers."""
    error = one.at.multiplier_error
    if not len(one.at.multipliers) or not math.isfinite(error):
        return "" if not len(one.at.multipliers) else "-"
    return f"{error:.0e}" if error >= _LEAST_ERROR else f"< {_LEAST_ERROR:.0e}"


def _cusp(boundary: SpecialCurve, place: int) -> str:
    values = zip(boundary.names, (boundary.x[place], boundary.y[place]), strict=True)
    return "Two folds meet in a cusp at " + ", ".join(f"{n} = {v:.10g}" for n, v in values) + "."


def _short(value: complex) -> str:
    return shown_complex(value, _ROUNDING, 5)
