"""The commands that find, check and report an orbit again."""

from __future__ import annotations

from zeno_orbits.report.page.subject import Subject


def commands_of(subject: Subject) -> tuple[tuple[str, ...], ...]:
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
