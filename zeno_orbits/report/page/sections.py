"""The sections of a report: words and tables, and the places where plots will stand.

The motion in a report: the places of its plots, and its events as numbers.

How to get a report's orbit again: commands, the orbit's file, versions.
"""

from __future__ import annotations

import base64
import math
import shlex
from collections.abc import Sequence
from typing import Any, cast

from zeno_orbits.precision.work_precision import Trade
from zeno_orbits.report.page import words
from zeno_orbits.report.page.markup import Html, table, tag
from zeno_orbits.report.page.places import plot_place, section
from zeno_orbits.report.page.plotly_bundle import Bundle
from zeno_orbits.report.page.subject import Subject
from zeno_orbits.report.zeno_neighbourhood import close_up
from zeno_orbits.simulation.execution import Arc, Execution, Impact, Mode, ZenoPoint
from zeno_orbits.verification.certificate import RESIDUALS
from zeno_orbits.work.versions import versions

_ACCURACIES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


def banner(subject: Subject) -> Html:
    """Return the answer: first in words, then as the certificate has it."""
    certificate = subject.certificate
    kind = "refused" if not certificate.passed else "passed" if certificate.stable else "unsure"
    mark = {"refused": "✗", "passed": "✓", "unsure": "!"}[kind]
    return tag(
        "div",
        tag("p", Html(f'<span aria-hidden="true">{mark}</span> '), words.headline(certificate)),
        tag("p", certificate.verdict(), class_="small"),
        class_=f"banner {kind}",
        role="status",
    )


def asked(subject: Subject) -> Html:
    """Return what was asked for, as far as the orbit's file has it."""
    orbit, problem = subject.orbit, subject.problem
    known: list[Any] = list(orbit.certificate.get("asked", ()))
    bounds = [cast("dict[str, Any]", one) for one in known if isinstance(one, dict)]
    parts = [
        tag(
            "p",
            "A Zeno periodic orbit of ",
            tag("b", problem.title),
            f" (problem {orbit.problem}, from: {problem.source}) at the gains below. The file "
            f"{subject.file} claims one; this page holds it against a simulation of "
            f"{subject.certificate.n_periods} periods that knows nothing else of it. Residuals of "
            f"at most {subject.certificate.tolerance:.0e} pass.",
        )
    ]
    if problem.gains:
        units = {gain.name: gain for gain in problem.gains}
        rows = [
            (name, f"{value:.12g}", units[name].unit, units[name].meaning)
            for name, value in orbit.gains.items()
        ]
        parts.append(table("Gains", ("gain", "value", "unit", "meaning"), rows, (1,)))
    if bounds:
        keys = ("lower", "upper", "lowest", "highest")
        rows = [
            (str(one.get("quantity", "")), *(_maybe(one.get(key)) for key in keys))
            for one in bounds
        ]
        heads = ("to be kept", "from", "to", "reached from", "reached to")
        parts.append(table("Bounds the search was asked to keep", heads, rows, (1, 2, 3, 4)))
    return section("asked", "What was asked", *parts)


def happens(subject: Subject) -> Html:
    """Return one period in words and in its main numbers."""
    orbit, certificate = subject.orbit, subject.certificate
    radius = certificate.spectral_radius
    execution = subject.execution
    points = execution.zeno_points if execution else ()
    resting = sum(arc.end_time - arc.start_time for arc in _locked_arcs(execution))
    tiles = [
        ("period", f"{orbit.period:.10g}", "s"),
        ("first hit after", f"{orbit.impacts[0].time:.10g}", "s"),
        *(("Zeno point after", f"{point.time:.10g}", "s") for point in points[:3]),
        *([("rests on the stop for", f"{resting:.6g}", "s")] if points else []),
        ("of a push is left", "unknown" if math.isnan(radius) else f"{radius:.4g}", "a period"),
    ]
    shown = [
        tag("div", tag("dt", name), tag("dd", number, " ", tag("span", unit, class_="unit")))
        for name, number, unit in tiles
    ]
    return section(
        "happens",
        "What happens",
        tag("p", words.story(orbit, certificate, execution)),
        tag("dl", *shown, class_="tiles"),
    )


def _locked_arcs(execution: Execution | None) -> list[Arc]:
    return [arc for arc in execution.arcs if arc.mode is Mode.LOCKED] if execution else []


def stability(subject: Subject) -> Html:
    """Return the multipliers in words, in a table and in the unit circle."""
    certificate = subject.certificate
    parts = [tag("p", words.stability(certificate))]
    if certificate.multipliers:
        rows = [
            (f"{k + 1}", f"{value.real:.8g}", f"{value.imag:.8g}", f"{abs(value):.8g}")
            for k, value in enumerate(certificate.multipliers)
        ]
        caption = f"Floquet multipliers (error of the largest: {certificate.multiplier_error:.0e})"
        heads = ("multiplier", "real part [1]", "imaginary part [1]", "modulus [1]")
        parts += [
            table(caption, heads, rows, (1, 2, 3)),
            plot_place(
                "stability", "Floquet multipliers in the complex plane, with the unit circle."
            ),
        ]
    return section("stability", "Stability", *parts)


def checks(subject: Subject) -> Html:
    """Return every residual, in plain words and as a number."""
    certificate = subject.certificate
    rows: list[Sequence[str]] = []
    for name, meaning in RESIDUALS.items():
        if name not in certificate.residuals:
            continue
        size = certificate.residuals[name]
        good = size <= certificate.tolerance
        mark = tag("span", "✓ yes" if good else "✗ no", class_="yes" if good else "no")
        number = f"{size:.1e}" if math.isfinite(size) else "never came so far"
        rows.append((words.CHECKS[name], mark, number, f"{name}: {meaning}"))
    heads = ("in plain words", "so?", "residual [1]", "for the expert")
    caption = f"Relative residuals; up to {certificate.tolerance:.0e} pass"
    parts = [
        tag(
            "p",
            "Whoever found the orbit had no part in this check: the motion is integrated afresh "
            "from the numbers of the file, and each line compares two things that must agree.",
        ),
        table(caption, heads, rows, (2,)),
    ]
    if certificate.trouble:
        parts.append(tag("p", f"The check ended early: {certificate.trouble}.", class_="warning"))
    if math.isfinite(certificate.orbit_error):
        error = f"The numbers of the orbit are right to about {certificate.orbit_error:.0e}"
        parts.append(tag("p", error, " (relative, estimated)."))
    return section("checks", "Can it be trusted?", *parts)


def margins(subject: Subject) -> Html:
    """Return how far the orbit is from being lost, and where its energy goes."""
    certificate, problem = subject.certificate, subject.problem
    if not certificate.margins:
        return Html("")
    unit = problem.gap_unit
    rows = [
        (name, f"{value:.6g}", words.MARGINS[name][1].format(gap=unit), words.MARGINS[name][0])
        for name, value in certificate.margins.items()
    ]
    parts = [
        tag("p", "Each number is positive. Where one of them reaches zero, the orbit ends."),
        table("Margins", ("margin", "value", "unit", "meaning"), rows, (1,)),
    ]
    if certificate.lost:
        parts[0] = tag("p", f"Lost: {', '.join(certificate.lost)}.", class_="warning")
    if certificate.energies:
        known = [(words.ENERGIES.get(n, n), f"{v:.6g}") for n, v in certificate.energies.items()]
        parts.append(table("Energy over one period [J]", ("where", "energy [J]"), known, (1,)))
    return section("margins", "Margins", *parts)


def trade(found: Trade | None) -> Html:
    """Return what accuracy costs, if it was measured."""
    if found is None:
        return Html("")
    rows: list[Sequence[str]] = []
    for accuracy in _ACCURACIES:
        best = found.cheapest(accuracy)
        if best is None:
            rows.append((f"{accuracy:.0e}", "none", "", ""))
            continue
        number = f"{best.value:g}" if best.sweep == "impacts" else f"{best.value:.0e}"
        how = f"{best.label}, {number}"
        rows.append((f"{accuracy:.0e}", how, f"{1e3 * best.seconds:.2f}", f"{best.error:.1e}"))
    heads = ("accuracy [1]", "cheapest setting", "time [ms]", "error [1]")
    return section(
        "trade",
        "What accuracy costs",
        tag(
            "p",
            f"Work: {found.work}. Held against: {found.truth}, certain to {found.truth_error:.0e}. "
            "Processor times are of the machine that measured them.",
        ),
        plot_place("trade", "Time over error, a line a method, logarithmic axes."),
        table("Cheapest setting that reaches an accuracy", heads, rows, (2, 3)),
    )


def parameters(subject: Subject) -> Html:
    """Return the physical parameters with their units."""
    rows = [
        (one.name, f"{subject.orbit.parameters[one.name]:.12g}", one.unit, one.meaning)
        for one in subject.problem.parameters
    ]
    heads = ("parameter", "value", "unit", "meaning")
    return section("parameters", "Parameters", table("Parameters", heads, rows, (1,)))


def _maybe(value: object) -> str:
    return f"{value:.8g}" if isinstance(value, int | float) else "-"


_MOST_EVENTS = 40
"""Rows of the table of events."""


def _events(subject: Subject, execution: Execution) -> Html:
    """Return a table of what happens when."""
    rows: list[Sequence[str]] = []
    for event in execution.events:
        speed, word = "", "release"
        if isinstance(event, Impact):
            speed, word = f"{-event.approach_rate:.6g}", "hit"
        elif isinstance(event, ZenoPoint):
            word = f"Zeno point, {event.tail:.2g} s after the last hit followed"
        rows.append((f"{event.time:.12g}", word, speed))
    if len(rows) > _MOST_EVENTS:
        half = _MOST_EVENTS // 2
        between = ("...", f"and {len(rows) - 2 * half} more", "")
        rows = [*rows[:half], between, *rows[-half:]]
    unit = subject.problem.gap_unit
    heads = ("time [s]", "event", f"speed of the hit [{unit}/s]")
    inside = table("Events of one period, times since its start", heads, rows, (0, 2))
    return tag("details", tag("summary", "All events as numbers"), inside)


def motion(subject: Subject) -> Html:
    """Return the places of the phase portraits, the states over time and the zoom."""
    if subject.execution is None:
        sentence = f"The motion could not be followed, so there are no pictures: {subject.trouble}."
        return section("motion", "The motion", tag("p", sentence, class_="warning"))
    portraits = [
        plot_place(f"portrait-{k}", f"Phase portrait, {y} over {x}, over one period.")
        for k, (x, y) in enumerate(subject.problem.portraits)
    ]
    parts = [
        tag(
            "p",
            "Blue: off the stop. Orange and thick: resting on it. Rings: before a hit, dots: "
            "after it; a dashed line joins them. Star: the Zeno point. Square: the release.",
        ),
        tag("div", *portraits, class_="pair"),
        plot_place(
            "series", "All states over one period; shaded while on the stop, hits as lines.", 5
        ),
        _events(subject, subject.execution),
    ]
    if subject.execution.zeno_points:
        several = bool(close_up(subject.execution, subject.dynamics).flights)
        parts += _zoom(several=several)
    return section("motion", "The motion", *parts)


def _zoom(*, several: bool) -> list[Html]:
    """Return the places of the zoom; with several hits, on logarithmic axes as well."""
    head = tag("h3", "Zoom into the Zeno point")
    gap = plot_place("zeno", "Gap over time near the Zeno point.", 12)
    if not several:
        said = "A single hit leads to the Zeno point: nothing piles up, and nothing repeats itself."
        return [head, tag("p", f"{said} Time is counted from the Zeno point."), gap]
    return [
        head,
        tag(
            "p",
            "Each step is ten times closer. Where the hits pile up, the picture repeats itself "
            "at every scale. Time is counted from the Zeno point. Dashed: flights too short to "
            "be simulated one by one, by the law they tend to.",
        ),
        gap,
        tag(
            "p",
            "The same on logarithmic axes, on which equal distances are equal ratios: time "
            "runs to the right and never arrives. First the gap, then the speed of the hits.",
        ),
        tag(
            "div",
            plot_place("gaps", "Gap over the time left to the Zeno point, logarithmic axes."),
            plot_place("speeds", "Speed of the hits over the time left, logarithmic axes."),
            class_="pair",
        ),
    ]


def reproduction(subject: Subject, bundle: Bundle) -> Html:
    """Return the commands, the orbit's file and the versions."""
    shown = "\n".join(shlex.join(command) for command in commands(subject))
    parts = [
        tag(
            "p",
            "The first command seeks an orbit at these numbers; the second checks the file; the "
            "third wrote this page.",
        ),
        tag("pre", tag("code", shown), tabindex="0"),
    ]
    if subject.content:
        packed = base64.b64encode(subject.content.encode()).decode()
        link = tag(
            "a",
            "Save the orbit's file",
            href=f"data:application/json;base64,{packed}",
            download=subject.file,
        )
        parts.append(tag("p", link, " (it is inside this page)."))
    here = {**versions(), "plotly": bundle.version}
    names = list(dict.fromkeys([*subject.orbit.versions, *here]))
    rows = [(n, subject.orbit.versions.get(n, "-"), here.get(n, "-")) for n in names]
    parts.append(table("Versions", ("of", "that found the orbit", "that wrote this page"), rows))
    return section("reproduce", "How to reproduce it", *parts)


def commands(subject: Subject) -> tuple[tuple[str, ...], ...]:
    """Return the words of the commands that find, check and report the orbit."""
    orbit, problem = subject.orbit, subject.problem
    name = subject.problem_file or orbit.problem
    given = {
        quantity.name: orbit.parameters[quantity.name]
        for quantity in problem.parameters
        if quantity.default is not None and orbit.parameters[quantity.name] != quantity.default
    }
    # What the problem derives has to be said only where it is not what it would derive.
    derived = problem.values(parameters=given).parameters
    given |= {name: value for name, value in orbit.parameters.items() if derived[name] != value}
    search = ["zeno-orbits", "search", name]
    search += [word for name, v in orbit.gains.items() for word in ("--fix", f"{name}={v!r}")]
    search += [word for name, v in given.items() for word in ("--set", f"{name}={v!r}")]
    where = ("--problem", subject.problem_file) if subject.problem_file else ()
    check = ("zeno-orbits", "verify", subject.file, *where)
    tolerance = ("--tolerance", f"{subject.certificate.tolerance:g}")
    return ((*search, "-o", subject.file), (*check, *tolerance), subject.command)
