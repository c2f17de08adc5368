"""The tables and key values of a report, as data: contents of each column."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

from zeno_orbits.experiment import Comparison
from zeno_orbits.maps import Push, Pushes, Recovery
from zeno_orbits.model import Problem, Quantity, unit_quotient
from zeno_orbits.orbits import Orbit
from zeno_orbits.precision import WorkPrecision
from zeno_orbits.report.disturbances import PUSHES, extent_columns, extents_of, least_pushes
from zeno_orbits.report.page import words
from zeno_orbits.report.page.plotly_bundle import Bundle
from zeno_orbits.report.page.subject import Subject
from zeno_orbits.report.paths import stops_of
from zeno_orbits.report.recordings import comparison_columns
from zeno_orbits.report.table import (
    BELOW_ROUNDING,
    BOUNDS,
    Table,
    TableColumn,
    number_column,
    shown_multiplier,
    shown_number,
    shown_size,
    table_of,
    text_column,
)
from zeno_orbits.report.trade_lines import CHEAPEST, cheapest_of
from zeno_orbits.simulation import Event, Execution, Impact, Mode, ZenoPoint, event_name
from zeno_orbits.verification import CHECKS, OrbitCertificate
from zeno_orbits.work import versions

_MOST_EVENTS = 40
"""Rows of the table of events."""
_FORCES = {("J", "m"): "N", ("J", "rad"): "N m", ("J", "1"): "J"}
"""Unit of the force that closes the gap, by the units of energy and gap, if that unit has a
name."""
_ROUNDING = 1e-13
"""Part of the largest energy below which one is rounding, and is zero."""


def tiles_of(subject: Subject) -> tuple[tuple[str, str, str], ...]:
    """Return name, value and unit of the main quantities of one period."""
    orbit, execution = subject.orbit, subject.execution
    radius = subject.certificate.spectral_radius
    points = execution.zeno_points[:3] if execution else ()
    first = next((one.time for one in orbit.impacts), None)
    push = "unknown" if math.isnan(radius) else shown_number(radius, 4)
    return (
        ("period", f"{orbit.period:.10g}", "s"),
        *([("first impact after", f"{first:.10g}", "s")] if first is not None else []),
        *((f"Zeno point{_of(point.stop)} after", f"{point.time:.10g}", "s") for point in points),
        *(_rests(execution, orbit.period) if execution and points else ()),
        ("a small disturbance changes by the factor", push, "per period"),
    )


def _rests(execution: Execution, end: float) -> list[tuple[str, str, str]]:
    """Return the duration of contact with each stop up to a time, as name, value and unit.

    An execution is a little longer than its period, which may start in contact.
    """
    rests: list[tuple[str, str, str]] = []
    for stop in stops_of(execution) or ("",):
        resting = sum(
            max(min(arc.end_time, end) - arc.start_time, 0.0)
            for arc in execution.arcs
            if arc.mode is Mode.LOCKED and (not stop or stop in arc.closed)
        )
        rests.append((f"rests on the stop{' ' + stop if stop else ''} for", f"{resting:.6g}", "s"))
    return rests


def _of(stop: str) -> str:
    """Return the words that add the name of a stop, if it has one."""
    return f" of {stop}" if stop else ""


def tables_of(subject: Subject, bundle: Bundle) -> dict[str, Table[Any]]:
    """Return the tables of a report by name, without the tables that do not apply."""
    certificate, problem = subject.certificate, subject.problem
    tables: dict[str, Table[Any]] = {
        "gains": gains_table(subject.orbit, problem),
        "bounds": bounds_table(subject.orbit),
        "multipliers": multipliers_table(certificate),
        "checks": checks_table(certificate),
        "margins": margins_table(certificate, problem.gap_unit, problem.energy_unit),
        "energies": energies_table(certificate, problem.energy_unit),
        "parameters": parameters_table(subject.orbit, problem),
        "versions": versions_table(subject.orbit, bundle),
    }
    if subject.execution is not None:
        tables["events"] = events_table(subject.execution, problem.gap_unit)
    if subject.trade is not None:
        tables["trade"] = trade_table(subject.trade)
    if subject.pushes is not None:
        tables["least_pushes"] = least_pushes_table(subject.pushes)
        tables["pushes"] = table_of("Largest pushes", PUSHES, subject.pushes.pushes)
    if subject.recovery is not None:
        tables["extents"] = extents_table(subject.recovery)
    if subject.comparison is not None:
        tables["recording"] = recording_table(subject.comparison)
    return tables


def _titled(table: Table[Any]) -> Table[Any]:
    return replace(table, is_titled=True)


def _quantity_columns(values: Mapping[str, float]) -> list[TableColumn[Quantity]]:
    return [
        text_column("name", lambda quantity: quantity.name),
        number_column("value", lambda quantity: shown_number(values[quantity.name], 12)),
        text_column("unit", lambda quantity: quantity.unit),
        text_column("meaning", lambda quantity: quantity.meaning),
    ]


def gains_table(orbit: Orbit, problem: Problem) -> Table[Any]:
    """Return the gains with their units."""
    known = {gain.name: gain for gain in problem.gains}
    gains = [known[name] for name in orbit.gains]
    return table_of("Gains", _quantity_columns(orbit.gains), gains)


def parameters_table(orbit: Orbit, problem: Problem) -> Table[Any]:
    """Return the physical parameters with their units."""
    columns = _quantity_columns(orbit.parameters)
    return _titled(table_of("Parameters", columns, problem.parameters))


def bounds_table(orbit: Orbit) -> Table[Any]:
    """Return the bounds of the search, as far as the orbit's file contains them."""
    known: list[Any] = list(orbit.certificate.get("asked", ()))
    bounds = [cast("dict[str, Any]", one) for one in known if isinstance(one, dict)]
    return table_of("Bounds the search was asked to keep", BOUNDS, bounds)


def events_table(execution: Execution, unit: str) -> Table[Any]:
    """Return the events of a period. A long sequence is shortened in its middle.

    Args:
        execution: The period.
        unit: Unit of the gap.
    """
    columns: list[TableColumn[Event]] = [
        number_column("time [s]", lambda event: shown_number(event.time, 12)),
        text_column("event", _event_name),
        number_column(f"speed of the impact [{unit_quotient(unit, 's')}]", _hit_speed),
    ]
    table = table_of("Events of one period, times since its start", columns, execution.events)
    if len(table.rows) <= _MOST_EVENTS:
        return table
    half = _MOST_EVENTS // 2
    between = ("...", f"and {len(table.rows) - 2 * half} more", "")
    return replace(table, rows=(*table.rows[:half], between, *table.rows[-half:]))


def _event_name(event: Event) -> str:
    if isinstance(event, ZenoPoint):
        return f"{event_name(event)}, {event.tail:.2g} s after the last impact followed"
    return event_name(event)


def _hit_speed(event: Event) -> str:
    return f"{-event.approach_rate:.6g}" if isinstance(event, Impact) else ""


def multipliers_table(certificate: OrbitCertificate) -> Table[Any]:
    """Return the Floquet multipliers."""
    error = certificate.multiplier_error

    def cell(value: float) -> str:
        return shown_multiplier(value, error, 8)

    def size(value: float) -> str:
        return cell(value) if cell(value) != "0" else BELOW_ROUNDING

    columns: list[TableColumn[tuple[int, complex]]] = [
        text_column("number", lambda one: f"{one[0]}"),
        number_column("real part [1]", lambda one: cell(one[1].real)),
        number_column("imaginary part [1]", lambda one: cell(one[1].imag)),
        number_column("modulus [1]", lambda one: size(abs(one[1]))),
    ]
    caption = f"Floquet multipliers (error of the largest: {shown_size(error)})"
    return table_of(caption, columns, enumerate(certificate.multipliers, start=1))


def checks_table(certificate: OrbitCertificate) -> Table[Any]:
    """Return every residual in plain words, as a number and by its name."""
    sizes, tolerance = certificate.residuals, certificate.tolerance
    columns: list[TableColumn[str]] = [
        text_column("in plain words", lambda name: CHECKS[name].plainly),
        text_column("passed", lambda name: sizes[name] <= tolerance),
        number_column("residual [1]", lambda name: _residual(sizes[name])),
        text_column("for the expert", lambda name: f"{name}: {CHECKS[name].law}"),
    ]
    caption = f"Relative residuals (up to {tolerance:.0e} pass)"
    return table_of(caption, columns, [name for name in CHECKS if name in sizes])


def _residual(size: float) -> str:
    return shown_size(size) if math.isfinite(size) else "never reached"


def margins_table(certificate: OrbitCertificate, unit: str, energy: str) -> Table[Any]:
    """Return the distances of the orbit to loss of existence.

    Args:
        certificate: The certificate.
        unit: Unit of the gap.
        energy: Unit of energies.
    """
    speed = unit_quotient(unit, "s")
    units = {
        "speed": speed,
        "acceleration": unit_quotient(speed, "s"),
        "force_rate": unit_quotient(
            _FORCES.get((energy, unit)) or unit_quotient(energy, unit), "s"
        ),
    }
    columns: list[TableColumn[str]] = [
        text_column("name", lambda name: name),
        number_column("value", lambda name: shown_number(certificate.margins[name], 6)),
        text_column(
            "unit",
            lambda name: words.MARGINS[name][1].format(**units),
        ),
        text_column("meaning", lambda name: words.MARGINS[name][0]),
    ]
    return _titled(table_of("Margins", columns, certificate.margins))


def energies_table(certificate: OrbitCertificate, unit: str) -> Table[Any]:
    """Return the energy balance of a period.

    Args:
        certificate: The certificate.
        unit: Unit of energies in the problem.
    """
    energies = certificate.energies
    least = _ROUNDING * max((abs(value) for value in energies.values()), default=0.0)
    columns: list[TableColumn[str]] = [
        text_column("part", lambda name: words.ENERGIES.get(name, name)),
        number_column(
            f"energy [{unit}]",
            lambda name: shown_number(energies[name] if abs(energies[name]) > least else 0.0, 6),
        ),
    ]
    return table_of("Energy over one period", columns, energies)


def trade_table(trade: WorkPrecision) -> Table[Any]:
    """Return the cheapest setting for each accuracy."""
    return table_of("Cheapest setting that reaches an accuracy", CHEAPEST, cheapest_of(trade))


def least_pushes_table(found: Pushes) -> Table[Any]:
    """Return the least push per direction and sense over all phases."""
    columns: list[TableColumn[Push]] = [
        text_column("direction", lambda push: push.name),
        number_column("least push", _least),
        number_column("error", lambda push: f"{push.error:.1g}" if _is_lost(push) else ""),
        text_column("unit", lambda push: push.unit),
        number_column("phase [1]", lambda push: f"{push.phase:.4g}" if _is_lost(push) else "all"),
        text_column("the part is", lambda push: words.MODES[push.mode] if _is_lost(push) else ""),
        text_column("after a larger push", lambda push: push.beyond if _is_lost(push) else "-"),
    ]
    return table_of("Least push per direction over all phases", columns, least_pushes(found))


def _least(push: Push) -> str:
    if _is_lost(push):
        return f"{push.largest:.6g}"
    return f"none lost up to {push.searched:.4g}"


def _is_lost(push: Push) -> bool:
    return math.isfinite(push.largest)


def extents_table(found: Recovery) -> Table[Any]:
    """Return the states that vary inside the ball."""
    caption = "Largest difference from the orbit inside the ball, to first order"
    return table_of(caption, extent_columns(found), extents_of(found))


def recording_table(found: Comparison) -> Table[Any]:
    """Return the quantities of a recording next to the orbit's."""
    return table_of("The recording beside the orbit", comparison_columns(found), found.metrics)


def versions_table(orbit: Orbit, bundle: Bundle) -> Table[Any]:
    """Return the versions that found the orbit and the versions that wrote the page."""
    here = {**versions(), "plotly": bundle.version}
    columns: list[TableColumn[str]] = [
        text_column("package", lambda name: name),
        text_column("that found the orbit", lambda name: orbit.versions.get(name, "-")),
        text_column("that wrote this page", lambda name: here.get(name, "-")),
    ]
    return table_of("Versions", columns, dict.fromkeys([*orbit.versions, *here]))
