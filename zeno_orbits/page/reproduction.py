"""How to get a report's orbit again: commands, the orbit's file, versions."""

from __future__ import annotations

import base64
import shlex

from zeno_orbits.orbit import versions
from zeno_orbits.page.bundle import Bundle
from zeno_orbits.page.markup import Html, table, tag
from zeno_orbits.page.places import section
from zeno_orbits.page.subject import Subject


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
    scene = subject.scene_file or orbit.problem
    given = {
        quantity.name: orbit.parameters[quantity.name]
        for quantity in problem.parameters
        if quantity.default is not None and orbit.parameters[quantity.name] != quantity.default
    }
    # What the scene derives has to be said only where it is not what it would derive.
    derived = problem.setting(parameters=given).parameters
    given |= {name: value for name, value in orbit.parameters.items() if derived[name] != value}
    search = ["zeno-orbits", "search", scene]
    search += [word for name, v in orbit.gains.items() for word in ("--fix", f"{name}={v!r}")]
    search += [word for name, v in given.items() for word in ("--set", f"{name}={v!r}")]
    where = ("--problem", subject.scene_file) if subject.scene_file else ()
    check = ("zeno-orbits", "verify", subject.file, *where)
    tolerance = ("--tolerance", f"{subject.certificate.tolerance:g}")
    return ((*search, "-o", subject.file), (*check, *tolerance), subject.command)
