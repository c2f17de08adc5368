"""The whole page: its template, filled with an orbit's texts, tables and data of its plots."""

from __future__ import annotations

import base64
import gzip
import hashlib
import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING

from zeno_orbits.errors import printable
from zeno_orbits.model import Problem
from zeno_orbits.report.disturbances import (
    least_push_line,
    recovery_lines,
    scan_line,
    summary_line,
)
from zeno_orbits.report.page import words
from zeno_orbits.report.page.plot_data import curves_of
from zeno_orbits.report.page.plotly_bundle import Bundle
from zeno_orbits.report.page.subject import Subject
from zeno_orbits.report.page.tables import tables_of, tiles_of
from zeno_orbits.report.push_panels import push_panels
from zeno_orbits.report.recordings import comparison_lines
from zeno_orbits.report.symbols import direction_symbol, html_symbol
from zeno_orbits.report.zeno_neighbourhood import close_ups

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

_MARKS = {"refused": "✗", "passed": "✓", "unsure": "!"}
"""Kind of an answer to the sign in front of it."""


def page_of(subject: Subject, bundle: Bundle) -> str:
    """Return the page as text, which is reproducible for the same subject.

    Its content security policy forbids all requests, and all scripts except the two scripts of the
    page. So the page stays offline and harmless even if a text of a problem contained HTML.

    Raises:
        InputError: If jinja2 is not installed.
    """
    from markupsafe import Markup

    script, style = _text("page.js"), _text("page.css")
    library = gzip.decompress(base64.b64decode(bundle.packed)).decode()
    certificate, execution = subject.certificate, subject.execution
    kind = "refused" if not certificate.passed else "passed" if certificate.stable else "unsure"
    zooms = close_ups(execution, subject.dynamics) if execution else ()
    error, curves = certificate.orbit_error, curves_of(subject)
    heading = subject.problem.title[:1].upper() + subject.problem.title[1:]
    what = subject.orbit.kind[:1].upper() + subject.orbit.kind[1:]
    return (
        template_environment()
        .get_template("page.html")
        .render(
            title=f"{heading}: {what}",
            heading=heading,
            kind=what,
            contents=_contents(subject),
            cautions=words.cautions(subject.problem, execution),
            policy=Markup(
                f"default-src 'none'; script-src {_hashed(script)} {_hashed(library)}; "
                "style-src 'unsafe-inline'; img-src data: blob:; "
                "base-uri 'none'; form-action 'none'"
            ),
            style=Markup(style),
            script=Markup(script),
            bundle=bundle,
            words=words,
            subject=subject,
            orbit=subject.orbit,
            problem=subject.problem,
            certificate=certificate,
            execution=execution,
            trade=subject.trade,
            recovered=recovery_lines(subject.recovery) if subject.recovery else (),
            pushed=[line(subject.pushes) for line in (least_push_line, summary_line, scan_line)]
            if subject.pushes
            else (),
            directions=[panel.direction for panel in push_panels(subject.pushes)]
            if subject.pushes
            else (),
            recorded=comparison_lines(subject.comparison) if subject.comparison else (),
            overlay=_picture(subject),
            symbol=_marked_symbols(subject.problem),
            answer={"kind": kind, "mark": _MARKS[kind]},
            tiles=tiles_of(subject),
            tables=tables_of(subject, bundle),
            zooms=[(zoom.zeno.stop, len(zoom.flights)) for zoom in zooms],
            orbit_error=f"{error:.0e}" if math.isfinite(error) else "",
            commands=Markup("\n").join(map(_unbroken, commands_of(subject))),
            file=base64.b64encode(subject.content.encode()).decode(),
            curves=curves,
        )
    )


def _marked_symbols(problem: Problem) -> Callable[[str | Mapping[str, float]], Markup]:
    """Return the function that writes the name of a state, or a direction, as HTML."""
    from markupsafe import Markup

    def symbol(name: str) -> str:
        return html_symbol(name, problem.state_names)

    return lambda one: Markup(
        symbol(one) if isinstance(one, str) else direction_symbol(one, symbol)
    )


def _picture(subject: Subject) -> str:
    """Return the recording over the orbit as a picture inside the page, or nothing."""
    found = subject.comparison
    if found is None or found.deviations is None:
        return ""
    from zeno_orbits.report.plots import plot_comparison, rendered

    figure = plot_comparison(subject.problem, found)
    picture = base64.b64encode(rendered(figure, "svg")).decode()
    return f"data:image/svg+xml;base64,{picture}"


def _contents(subject: Subject) -> dict[str, str]:
    """Return the names and titles of the sections that the subject has, in order."""
    disturbed = subject.pushes is not None or subject.recovery is not None
    titles = {
        "happens": "What happens",
        "asked": "What was asked",
        "motion": "The motion",
        "stability": "Stability",
        "disturbances": "Disturbances" if disturbed else "",
        "recording": "Recording" if subject.comparison is not None else "",
        "checks": "Can it be trusted?",
        "margins": "Margins" if subject.certificate.margins else "",
        "trade": "What accuracy costs" if subject.trade is not None else "",
        "parameters": "Parameters",
        "theory": "The theory in short",
        "reproduce": "How to reproduce it",
    }
    return {name: title for name, title in titles.items() if title}


def commands_of(subject: Subject) -> tuple[tuple[str, ...], ...]:
    """Return the words of the commands that find, check and report the orbit."""
    orbit, problem = subject.orbit, subject.problem
    name = subject.problem_file or orbit.problem
    given = {
        quantity.name: orbit.parameters[quantity.name]
        for quantity in problem.parameters
        if quantity.default is not None and orbit.parameters[quantity.name] != quantity.default
    }
    # Derived parameters are listed only if they differ from the derived values.
    derived = problem.values(parameters=given).parameters
    given |= {name: value for name, value in orbit.parameters.items() if derived[name] != value}
    search = ["zeno-orbits", "search", name]
    search += [word for name, v in orbit.gains.items() for word in ("--set", f"{name}={v!r}")]
    search += [word for name, v in given.items() for word in ("--set", f"{name}={v!r}")]
    if not orbit.has_phases:
        search += ["--section", orbit.section]
    where = ("--problem", subject.problem_file) if subject.problem_file else ()
    check = ("zeno-orbits", "verify", subject.file, *where)
    tolerance = ("--tolerance", f"{subject.certificate.tolerance:g}")
    report = (subject.command,) if subject.command else ()
    return ((*search, "-o", subject.file), (*check, *tolerance), *report)


def _unbroken(command: Sequence[str]) -> Markup:
    """Return a command as HTML whose lines break between words, not inside an option."""
    from markupsafe import Markup

    option = Markup('<span class="option">%s</span>')
    words = [option % word if word.startswith("-") else shlex.quote(word) for word in command]
    return Markup(" ").join(words)


def _printable(value: object) -> object:
    """Return a value for the page. Characters that command a terminal are replaced."""
    return printable(value) if type(value) is str else value


def template_environment() -> Environment:
    """Return the environment that renders the template and escapes every value."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        loader=FunctionLoader(_text),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_printable,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    # A number that is not finite must not slip into the data of the plots.
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment


def _text(name: str) -> str:
    return files("zeno_orbits.report.page").joinpath(name).read_text(encoding="utf-8")


def _hashed(script: str) -> str:
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return f"'sha256-{digest}'"
