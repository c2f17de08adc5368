"""Tables of motions: executions, orbits and certificates."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from zeno_orbits.errors import counted
from zeno_orbits.report.table import (
    TableColumn,
    name_column,
    number_column,
    shown_complex,
    shown_multipliers,
    shown_size,
    text_column,
    with_unit,
)
from zeno_orbits.report.terminal.console import print_lines, print_table

if TYPE_CHECKING:
    from zeno_orbits.arrays import Vector
    from zeno_orbits.model import Problem
    from zeno_orbits.orbits import Orbit, OrbitEvent, OrbitPhase
    from zeno_orbits.precision import ExecutionWithError
    from zeno_orbits.simulation import Event, Execution
    from zeno_orbits.verification import DeltaCut, OrbitCertificate

_MOST_EVENTS = 40
"""Events of an execution that are printed."""
_MOST_STATES = 3
"""States of an event that are printed: as many as 80 columns hold."""
_ROUGH = 1e-3
"""Estimated relative error from which the order of events is in doubt."""
_STILL = 1e-9
"""A state that changes less from event to event stands still, relative."""
_ROUNDED = 1e-14
"""Part of the largest size of a state below which its value is rounding, and prints as 0."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Skipped:
    """Impacts of a sequence that are not printed.

    Attributes:
        count: Their number.
    """

    count: int


_Line = Any
"""An event, or `_Skipped` impacts."""


def print_execution(
    problem: Problem,
    assured: ExecutionWithError,
    *,
    all_states: bool = False,
    all_events: bool = False,
) -> None:
    """Print the events of an execution, the errors of its Zeno points and its end.

    Args:
        problem: The problem.
        assured: The execution with its estimated errors.
        all_states: True prints every state. False leaves out states that hardly change.
        all_events: True prints every impact. False prints the first impact of a sequence.
    """
    execution = assured.execution
    names = problem.state_names
    errors = dict(zip(map(id, execution.zeno_points), assured.zeno_errors, strict=False))
    events = execution.events
    moving = names if all_states else _moving(problem, events)[:_MOST_STATES]
    columns: list[TableColumn[_Line]] = [
        number_column("t [s]", lambda event: _unless_skipped(event, _time)),
        text_column("event", lambda event: _event_name(event, errors)),
        number_column("dh/dt", lambda event: _unless_skipped(event, _approach_rate)),
    ]
    sizes = _sizes_of(execution)
    lines = list(events) if all_events else _one_line_per_sequence(events)
    states = [
        _state_column(name, names.index(name), float(sizes[names.index(name)])) for name in moving
    ]
    print_table([*columns, *states], lines[:_MOST_EVENTS], repeated=len(columns))
    if len(lines) > _MOST_EVENTS:
        print_lines([f"... and {len(lines) - _MOST_EVENTS} more events. --json lists all events."])
    if len(lines) < len(events):
        print_lines(["--events prints every impact."])
    rest = [name for name in names if name not in moving]
    if events and rest:
        print_lines([f"Not shown: {', '.join(rest)} (--all-states prints them)."])
    counts = (
        counted(len(execution.impacts), "resolved impact"),
        counted(len(execution.zeno_points), "Zeno point"),
        counted(len(execution.releases), "release"),
        *(
            [f"{len(execution.switches)} switch{'es' if len(execution.switches) > 1 else ''}"]
            if execution.switches
            else []
        ),
    )
    closed = execution.arcs[-1].closed
    last = f"contact at {', '.join(closed)}" if closed else execution.arcs[-1].mode.value
    print_lines([f"{', '.join(counts)} in {execution.end_time:g} s. The last arc is {last}."])


def _one_line_per_sequence(events: Sequence[Event]) -> list[_Line]:
    """Return the events, with one entry for the later impacts before a Zeno point."""
    from zeno_orbits.simulation import Impact, ZenoPoint

    def key(event: Event) -> str | None:
        return event.stop if isinstance(event, Impact) else None

    groups = [list(group) for _, group in groupby(events, key)]
    lines: list[_Line] = []
    for group, after in zip(groups, [*groups, None][1:], strict=True):
        ends = after is not None and isinstance(after[0], ZenoPoint)
        if ends and isinstance(group[0], Impact) and len(group) > 2:
            lines += [group[0], _Skipped(count=len(group) - 1)]
        else:
            lines += group
    return lines


def _unless_skipped(line: _Line, cell: Callable[[Event], str]) -> str:
    return "..." if isinstance(line, _Skipped) else cell(line)


def _time(event: Event) -> str:
    return f"{event.time:.10g}"


def _moving(problem: Problem, events: Sequence[Event]) -> list[str]:
    """Return the informative states at events, without the clock, constant states and dh/dt."""
    from zeno_orbits.simulation import Impact, state_before

    if not events:
        return []
    states = np.array([state_before(event) for event in events])
    rates = np.array([one.approach_rate if isinstance(one, Impact) else 0.0 for one in events])
    n_timeless = len(problem.state_names) - (2 if problem.clock else 0)
    found: list[str] = []
    for k, name in enumerate(problem.state_names[:n_timeless]):
        size = _STILL * (1.0 + float(np.max(np.abs(states[:, k]))))
        same = float(np.max(np.abs(np.abs(states[:, k]) - np.abs(rates)))) < size
        if not same and (len(events) == 1 or float(np.ptp(states[:, k])) > size):
            found.append(name)
    return found


def _event_name(line: _Line, errors: Mapping[int, float]) -> str:
    """Return the name of an event, with the error of a Zeno point."""
    from zeno_orbits.simulation import ZenoPoint, event_name

    if isinstance(line, _Skipped):
        return f"{line.count} more impacts"
    if not isinstance(line, ZenoPoint):
        return event_name(line)
    error = errors.get(id(line), math.inf)
    return f"{event_name(line)} +- {f'{error:.0e}' if math.isfinite(error) else '?'}"


def _approach_rate(event: Event) -> str:
    from zeno_orbits.simulation import Impact

    return f"{event.approach_rate:.6g}" if isinstance(event, Impact) else ""


def _state_column(name: str, index: int, size: float) -> TableColumn[_Line]:
    """Return the column of a state, at an impact or switch just before it."""
    from zeno_orbits.simulation import state_before

    def cell(event: Event) -> str:
        return f"{_without_rounding(float(state_before(event)[index]), size):.5g}"

    return number_column(name, lambda line: _unless_skipped(line, cell))


def _sizes_of(execution: Execution) -> Vector:
    """Return the largest size of each state along an execution, ``(n_x,)``."""
    n_x = len(execution.end_state)
    return np.max([np.abs(arc.flow_states[:, :n_x]).max(axis=0) for arc in execution.arcs], axis=0)


def _sizes_along(orbit: Orbit) -> dict[str, float]:
    """Return the largest size of each state at the events of an orbit."""
    states = [orbit.start_state, *(event.state for event in orbit.events)]
    return {name: max(abs(one[name]) for one in states) for name in orbit.start_state}


def _without_rounding(value: float, size: float) -> float:
    """Return a value, or zero if it is rounding of a state of some size."""
    return value if abs(value) > _ROUNDED * size else 0.0


def print_engine(engine: str, why: str, error: float) -> None:
    """Print the engine that ran, the reason for its choice, and the estimated error.

    Args:
        engine: Name of the requested engine.
        why: The choice of the automatic engine, as a sentence.
        error: Estimated relative error, infinite if it is unknown.
    """
    chosen = f"automatic, {why}" if engine == "automatic" else f"{engine}, as requested."
    print_lines([f"Engine: {chosen}"])
    if math.isfinite(error):
        print_error_estimate(error)
    else:
        message = "a run with a looser tolerance takes another course"
        print_lines([f"Estimated relative error: unknown, {message}."])


def print_error_estimate(error: float) -> None:
    """Print an estimated error."""
    print_lines([f"Estimated relative error: {error:.1e}."])
    if error > _ROUGH:
        print_lines(["So few digits are left that later events may be false or missing."])


def print_summary(
    problem: Problem,
    orbit: Orbit,
    certificate: OrbitCertificate,
    free: Iterable[str] = (),
) -> None:
    """Print an orbit in a few lines: values, period, events and the state at its start.

    Args:
        problem: Its problem.
        orbit: The orbit.
        certificate: Its certificate.
        free: Parameters that were searched.
    """
    searched = set(free)
    given = [
        with_unit(f"{name} = {value}", unit)
        for name, value, unit in _value_rows(problem, orbit, searched)
        if name != "period"
    ]
    kind, unknown = _stability(certificate)
    at = f" at {', '.join(given)}" if given else ""
    shape = orbit.phases_as
    text = ", ".join(orbit.sequence) if shape is None else shape.text
    named = orbit.kind if text in ("zeno", "plastic") else f"orbit `{text}`"
    print_lines([f"Found: {kind}{named} of {problem.name}{at}{unknown}"])
    facts = [f"period {orbit.period:.12g} s"]
    if certificate.multipliers:
        facts.append(f"spectral radius {certificate.spectral_radius:.4g}")
    work = certificate.energies.get("input_work")
    if work is not None:
        facts.append(f"input work {work:.4g} {problem.energy_unit} per period")
    print_lines([f"  {', '.join(facts)}"])
    if shape is None:
        _print_events(orbit, certificate)
        return
    for k, phase in enumerate(orbit.phases):
        print_lines(_phase_lines(problem, orbit, k, phase))


def _stability(certificate: OrbitCertificate) -> tuple[str, str]:
    """Return an adjective for an orbit, or words after it if its stability is unknown."""
    if not certificate.passed:
        return "unverified ", ""
    if certificate.stable or certificate.unstable:
        return ("stable " if certificate.stable else "unstable "), ""
    return "", ", of unknown stability"


def _print_events(orbit: Orbit, certificate: OrbitCertificate) -> None:
    """Print the events of an orbit, the quantities of every stop and the state at its start."""
    print_lines([""])
    print_table(
        [
            number_column("t [s]", lambda event: f"{event.time:.10g}"),
            text_column("event", lambda event: event.name),
        ],
        orbit.events,
    )
    print_event_quantities(certificate)
    sizes = _sizes_along(orbit)
    state = ", ".join(
        f"{name}={_without_rounding(value, sizes[name]):.10g}"
        for name, value in orbit.start_state.items()
    )
    print_lines([f"Start, just after `{orbit.section}`:", f"  {state}", ""])


def _print_states(orbit: Orbit) -> None:
    """Print every state just before every event of an orbit."""
    columns: list[TableColumn[OrbitEvent]] = [
        text_column("before", lambda event: event.name),
        *(_before_column(name, size) for name, size in _sizes_along(orbit).items()),
    ]
    print_table(columns, orbit.events)


def _before_column(name: str, size: float) -> TableColumn[OrbitEvent]:
    return number_column(name, lambda event: f"{_without_rounding(event.state[name], size):.10g}")


_SHOWN = {
    "impact_speed": "impact speed",
    "impacts": "impacts",
    "bounce_time": "bounce time [s]",
    "zeno_time": "Zeno time [s]",
    "energy_lost": "energy lost",
}
"""Printed quantities of a stop, with the heads of their columns."""


def print_event_quantities(certificate: OrbitCertificate) -> None:
    """Print the quantities of every stop that is struck.

    Args:
        certificate: The certificate.
    """
    ranges = certificate.quantities
    names = (name.rpartition(".") for name in ranges)
    stops = [stop for stop, _, word in names if word == "impact_speed"]
    if not stops:
        return

    def cell(word: str) -> Callable[[str], str]:
        return lambda stop: _range_text(ranges.get(f"{stop}.{word}"))

    columns: list[TableColumn[str]] = [
        name_column("stop", lambda stop: stop),
        *(number_column(head, cell(word)) for word, head in _SHOWN.items()),
    ]
    print_table(columns, stops)


def _range_text(ends: tuple[float, float] | None) -> str:
    if ends is None:
        return ""
    low, high = (f"{end:.8g}" for end in ends)
    return low if low == high else f"{low} to {high}"


def _phase_lines(problem: Problem, orbit: Orbit, k: int, phase: OrbitPhase) -> list[str]:
    """Return the events of a phase and the state at its start, as lines."""
    events = [f"first impact {phase.impacts[0].time:.8g} s"]
    if phase.zeno_time is not None:
        events.append(f"Zeno point {phase.zeno_time:.8g} s")
        if orbit.shape.n_phases == 1:
            events.append(f"then {orbit.period - phase.zeno_time:.5g} s in contact")
    number = f"phase {k + 1}: " if orbit.shape.n_phases > 1 else ""
    start = "release" if orbit.phases[k - 1].kind.holds else "start"
    units = zip(problem.state_names, problem.state_units, strict=True)
    sizes = _sizes_along(orbit)
    values = {
        name: _without_rounding(value, sizes[name]) for name, value in phase.start_state.items()
    }
    states = [
        with_unit(f"{name} = {values[name]:.7g}", unit) for name, unit in units if values[name]
    ]
    return [f"  {number}{', '.join(events)}", f"  {start}: {', '.join(states) or 'all states 0'}"]


_Row = tuple[str, str, str]
"""Name, value and unit of a number."""


def print_orbit(
    problem: Problem,
    orbit: Orbit,
    certificate: OrbitCertificate,
    free: Iterable[str] = (),
) -> None:
    """Print an orbit with every state at every event, and the main values of its certificate.

    Args:
        problem: Its problem.
        orbit: The orbit.
        certificate: Its certificate.
        free: Parameters that were searched, printed as gains are.
    """
    columns: list[TableColumn[_Row]] = [
        name_column("quantity", lambda row: row[0]),
        number_column("value", lambda row: row[1]),
        text_column("unit", lambda row: row[2]),
    ]
    rows = [
        *_value_rows(problem, orbit, set(free)),
        *_phase_rows(problem, orbit),
        *_certificate_rows(certificate, problem.energy_unit),
    ]
    print_table(columns, rows)
    if orbit.phases_as is None:
        _print_states(orbit)


def _value_rows(problem: Problem, orbit: Orbit, free: set[str]) -> Iterator[_Row]:
    units = {gain.name: gain.unit for gain in problem.gains}
    for name, value in orbit.gains.items():
        yield name, f"{value:.12g}", units[name]
    for quantity in problem.parameters:
        if quantity.name in free:
            yield quantity.name, f"{orbit.parameters[quantity.name]:.12g}", quantity.unit
    yield "period", f"{orbit.period:.12g}", "s"


def _phase_rows(problem: Problem, orbit: Orbit) -> Iterator[_Row]:
    if orbit.phases_as is None:
        return
    if orbit.shape.n_phases > 1 or not orbit.shape.n_releases:
        yield "shape", orbit.shape.text, ""
    for k, phase in enumerate(orbit.phases):
        if orbit.shape.n_phases > 1:
            yield f"phase {k + 1} starts", f"{phase.start_time:.12g}", "s"
        after = "release" if orbit.phases[k - 1].kind.holds else "start"
        yield from _state_rows(problem, f"at {after}", phase.start_state)
        yield "first impact", f"{phase.impacts[0].time:.12g}", "s"
        if phase.zeno_time is not None and phase.zeno_state is not None:
            yield "Zeno point", f"{phase.zeno_time:.12g}", "s"
            yield from _state_rows(problem, "at Zeno point", phase.zeno_state)


def _state_rows(problem: Problem, where: str, state: Mapping[str, float]) -> Iterator[_Row]:
    for name, unit in zip(problem.state_names, problem.state_units, strict=True):
        yield f"{name} {where}", f"{state[name]:.12g}", unit


def _certificate_rows(certificate: OrbitCertificate, energy_unit: str) -> Iterator[_Row]:
    for k, multiplier in enumerate(certificate.multipliers):
        yield f"multiplier {k + 1}", shown_complex(multiplier, certificate.multiplier_error, 7), "1"
    work = certificate.energies.get("input_work")
    if work is not None:
        yield "input work per period", f"{work:.9g}", energy_unit


def print_certificate(
    certificate: OrbitCertificate, *, margins: bool = False, truncation: bool = False
) -> None:
    """Print the verdict, then the residuals, multipliers and estimated errors.

    Args:
        certificate: The certificate.
        margins: True also prints the distances to loss of existence.
        truncation: True also prints the truncation-order test.
    """
    from zeno_orbits.verification import RESIDUALS

    sizes = certificate.residuals
    print_verdict(certificate)
    names = [name for name in RESIDUALS if name in sizes]
    passed = sum(sizes[name] <= certificate.tolerance for name in names)
    largest = max(names, key=lambda name: sizes[name], default="")
    worst = f"Largest residual: {shown_size(sizes[largest])} ({largest}), " if largest else ""
    count = f"{passed} of {counted(len(names), 'check')} passed."
    print_lines([f"{count} {worst}tolerance {certificate.tolerance:.0e}.", ""])
    residual_columns: list[TableColumn[str]] = [
        name_column("check", lambda name: name),
        number_column("residual", lambda name: shown_size(sizes[name])),
        text_column("passed", lambda name: sizes[name] <= certificate.tolerance),
        text_column("zero if", lambda name: RESIDUALS[name]),
    ]
    print_table(residual_columns, names)
    print_event_quantities(certificate)
    if certificate.unlisted:
        lacks = f"lacks {counted(certificate.unlisted, 'resolved impact')} before Zeno points"
        print_lines([f"Note: the orbit {lacks}, which follow from the motion.", ""])
    if margins:
        _print_margins(certificate)
    if truncation:
        _print_truncation(certificate)
    point = "none: the section is a point" if certificate.stable else "unknown"
    error = certificate.multiplier_error
    multipliers = shown_multipliers(certificate.multipliers, error, 7) or point
    spread = f" (+- {error:.0e})" if certificate.multipliers else ""
    print_lines(
        [
            f"Floquet multipliers: {multipliers}{spread}",
            f"Estimated error of the integration: {certificate.integration_error:.0e}, "
            f"of the Zeno limit in addition: {certificate.zeno_error:.0e}",
        ]
    )


def _print_margins(certificate: OrbitCertificate) -> None:
    margins = certificate.margins
    columns: list[TableColumn[str]] = [
        name_column("margin", lambda name: name),
        number_column("value", lambda name: f"{margins[name]:.6g}"),
        text_column("positive", lambda name: margins[name] > 0),
    ]
    print_table(columns, margins)


def _print_truncation(certificate: OrbitCertificate) -> None:
    if not certificate.delta_sweep:
        return
    columns: list[TableColumn[DeltaCut]] = [
        number_column("threshold |dh/dt|", lambda cut: f"{cut.delta:.3g}"),
        number_column("|dh/dt| at the cut", lambda cut: f"{cut.speed:.3g}"),
        number_column("relative error", lambda cut: f"{cut.error:.1e}"),
    ]
    print_table(columns, certificate.delta_sweep)
    order = certificate.delta_order
    none = "none, no truncation has a larger error than the integration"
    seen = f"{order:.2f}" if math.isfinite(order) else none
    print_lines([f"Observed order of the truncation error: {seen} (theory: 3)"])


def print_verdict(certificate: OrbitCertificate) -> None:
    """Print yes or no."""
    colour = "green" if certificate.passed else "red"
    print_lines([certificate.verdict()], style=colour)
