"""The command `problems`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from zeno_orbits.cli.options import YES, add_command, print_json
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    from zeno_orbits.model.problem import Problem


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
    from zeno_orbits.model.library import bundled_problems, load_problem

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
