"""The commands about problems, before any orbit: `problems`, `new`, `conditions`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    add_gains,
    add_problem,
    print_json,
    say_written,
    values_of,
)
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report
from zeno_orbits.work import require_picture, write_whole

if TYPE_CHECKING:
    from zeno_orbits.model import ParameterValues, Problem


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
    from zeno_orbits.model import bundled_problems, load_problem

    problems = [one for name in bundled_problems() for one in load_problem(name).ladder()]
    if options.json:
        print_json([_problem_json(problem) for problem in problems])
    else:
        report.print_problems(problems)
    return YES


def _problem_json(problem: Problem) -> dict[str, Any]:
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
        "write a working problem file, to change into your own",
        [
            "zeno-orbits new my_problem",
            "zeno-orbits new my_problem --with-motor",
            "zeno-orbits search ./my_problem.py",
        ],
    )
    parser.add_argument("name", metavar="NAME", help="name of the new problem; its file is NAME.py")
    parser.add_argument(
        "--with-motor",
        action="store_true",
        help="let a DC motor under feedback drive it, in place of a periodic force",
    )


def template(*, with_motor: bool) -> str:
    """Return a problem file that works, whose problem is called NAME."""
    name = "motor" if with_motor else "periodic_force"
    path = Path(__file__).parent / "templates" / f"{name}.py.txt"
    return path.read_text(encoding="utf-8")


def _run_new(options: argparse.Namespace) -> int:
    from zeno_orbits.model import bundled_problems

    if not options.name.isidentifier():
        wanted = "must be a word of letters, digits and underscores"
        raise InputError(f"Argument `name` {wanted}, but it is `{options.name}`.")
    if options.name in bundled_problems():
        wanted = "must not be the name of a bundled problem"
        raise InputError(f"Argument `name` {wanted}, but `{options.name}` is one.")
    path = Path(f"{options.name}.py")
    if path.exists():
        raise InputError(f"Argument `name` must name a new file, but `{path}` exists.")
    content = template(with_motor=options.with_motor)
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
        "conditions",
        _run_conditions,
        "Theorem 1: d2h/dt2 at the Zeno equilibria, in symbols and numbers",
        [
            "zeno-orbits conditions motor_pendulum",
            "zeno-orbits conditions motor_pendulum --set m2=0.12 -o region.png",
        ],
    )
    add_problem(parser)
    add_gains(parser)
    parser.add_argument("-o", "--output", type=Path, help="draw the region d2h/dt2 < 0 here")


def _run_conditions(options: argparse.Namespace) -> int:
    from zeno_orbits.model import (
        acceleration_formula,
        load_problem,
        six_digits,
        with_numbers,
    )

    problem = load_problem(options.problem)
    values = values_of(problem, options)
    # What cannot be drawn is refused before anything is printed.
    if options.output is not None:
        _draw_region(problem, values, options.output)
    formula = acceleration_formula(problem)
    numbers = with_numbers(formula, values)
    always = bool(numbers < 0) if numbers.is_number else None
    if options.json:
        print_json(
            {
                "problem": problem.name,
                "restitution": values.parameters["restitution"],
                "formula": str(formula),
                "numbers": six_digits(numbers),
                "coefficients": {
                    str(term): float(factor)
                    for term, factor in numbers.as_coefficients_dict().items()
                },
                "parameters": dict(values.parameters),
            }
        )
    else:
        report.print_conditions(problem, values, str(formula), six_digits(numbers), always=always)
    if options.output is not None:
        say_written(options, [options.output])
    return NO if always is False else YES


def _draw_region(problem: Problem, values: ParameterValues, path: Path) -> None:
    from zeno_orbits.report import plots

    require_picture(path)
    dynamics = problem.dynamics(values)
    plots.save_figure(plots.plot_zeno_region(problem, dynamics), path)
