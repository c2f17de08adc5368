"""The sections of a report: words and tables, and the places where plots will stand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

from zeno_orbits.certificate import RESIDUALS
from zeno_orbits.execution import Arc, Execution, Mode
from zeno_orbits.page import words
from zeno_orbits.page.markup import Html, table, tag
from zeno_orbits.page.places import plot_place, section
from zeno_orbits.page.subject import Subject
from zeno_orbits.trade import Trade

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
            f" (scene {orbit.problem}, from: {problem.source}) at the gains below. The file "
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
