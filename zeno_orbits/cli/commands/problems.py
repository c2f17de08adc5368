"""The commands about problems, before any orbit: `problems`, `new`, `conditions`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    YES,
    add_at,
    add_command,
    add_problem,
    numbers_of,
    print_json,
    say_written,
)
from zeno_orbits.cli.outputs import PICTURE, require_outputs
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report
from zeno_orbits.work import write_whole

if TYPE_CHECKING:
    import zeno_orbits as zo


def add_problems(commands: Any) -> None:
    """Add the command `problems`."""
    add_command(
        commands,
        "problems",
        _run_problems,
        "list the problems",
        ["zeno-orbits problems", "zeno-orbits problems --json"],
    )


def _run_problems(options: argparse.Namespace) -> int:
    problems = api.all_problems()
    if options.json:
        print_json([_problem_json(problem) for problem in problems])
    else:
        report.print_problems(problems)
    return YES


def _problem_json(problem: zo.Problem) -> dict[str, Any]:
    return {
        "name": problem.name,
        "title": problem.title,
        "source": problem.source,
        "states": dict(zip(problem.state_names, problem.state_units, strict=True)),
        "gains": {
            gain.name: {"default": gain.default, "lower": gain.lower, "upper": gain.upper}
            for gain in problem.gains
        },
        "parameters": dict(problem.values().parameters),
    }


def add_new(commands: Any) -> None:
    """Add the command `new`."""
    parser = add_command(
        commands,
        "new",
        _run_new,
        "write a working problem file as a template",
        [
            "zeno-orbits new my_problem",
            "zeno-orbits new my_problem --with-motor",
            "zeno-orbits new my_problem --with-circuit",
            "zeno-orbits search ./my_problem.py",
        ],
    )
    parser.add_argument("name", metavar="NAME", help="name of the new problem; its file is NAME.py")
    drive = parser.add_mutually_exclusive_group()
    drive.add_argument(
        "--with-motor",
        action="store_true",
        help="let a DC motor under feedback drive it, in place of a periodic force",
    )
    drive.add_argument(
        "--with-circuit",
        action="store_true",
        help="let a motor with a current loop drive it: a circuit and a further state",
    )


def template(*, with_motor: bool, with_circuit: bool = False) -> str:
    """Return a problem file that works, whose problem is called NAME."""
    name = "motor" if with_motor else "circuit" if with_circuit else "periodic_force"
    path = Path(__file__).parents[1] / "templates" / f"{name}.py.txt"
    return path.read_text(encoding="utf-8")


def _run_new(options: argparse.Namespace) -> int:
    if not options.name.isidentifier():
        wanted = "must begin with a letter and hold letters, digits and underscores only"
        raise InputError(f"Argument `name` {wanted}, but it is `{options.name}`.")
    if options.name in api.bundled_names():
        wanted = "must not be the name of a bundled problem"
        raise InputError(f"Argument `name` {wanted}, but `{options.name}` is one.")
    path = Path(f"{options.name}.py")
    if path.exists():
        raise InputError(f"Argument `name` must name a new file, but `{path}` exists.")
    content = template(with_motor=options.with_motor, with_circuit=options.with_circuit)
    write_whole(path, content.replace("NAME", options.name))
    if options.json:
        print_json({"problem": str(path)})
    else:
        say_written(options, [path])
    return YES


def add_conditions(commands: Any) -> None:
    """Add the command `conditions`."""
    parser = add_command(
        commands,
        "zeno-condition",
        _run_conditions,
        "Theorem 1: d2h/dt2 at the Zeno equilibria, in symbols and numbers",
        [
            "zeno-orbits zeno-condition motor_pendulum",
            "zeno-orbits zeno-condition motor_pendulum --set m2=0.12 --plot region.png",
            "zeno-orbits zeno-condition motor_pendulum --at theta1=1.2 --at current=-0.4",
        ],
    )
    add_problem(parser)
    add_at(parser)
    parser.add_argument(
        "--plot", type=Path, metavar="FILE", help="picture of the region d2h/dt2 < 0"
    )


def _run_conditions(options: argparse.Namespace) -> int:
    require_outputs(options, {"plot": PICTURE})
    problem = api.known_problem(options.problem)
    numbers = numbers_of(problem, options)
    # A problem that cannot be drawn is rejected before anything is printed.
    if options.plot is not None:
        _draw_region(problem, problem.values(**numbers), options.plot)
    for note in api.energy_notes(problem, options.set):
        report.print_note(note)
    found = api.zeno_condition(problem, **numbers, at=options.at)
    point = found.equilibrium
    if options.json:
        print_json(found.as_json())
    else:
        report.print_conditions(
            problem, found.values, str(found.formula), found.text, always=found.always
        )
        if point is not None:
            report.print_equilibrium(problem, point)
    if options.plot is not None:
        say_written(options, [options.plot])
    if point is not None:
        return YES if point.has_zeno_executions else NO
    return NO if found.always is False else YES


def _draw_region(problem: zo.Problem, values: zo.ParameterValues, path: Path) -> None:
    from zeno_orbits.report import plots

    dynamics = problem.dynamics(values)
    plots.save_figure(plots.plot_zeno_set(problem, dynamics), path)
