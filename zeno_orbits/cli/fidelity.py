"""The command `fidelity`."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from zeno_orbits.cli.options import (
    YES,
    add_command,
    add_gain_values,
    add_problem,
    print_json,
    values_of,
)
from zeno_orbits.report import terminal as report


def add_fidelity(commands: Any) -> None:
    """Add the command `fidelity`."""
    parser = add_command(
        commands,
        "fidelity",
        _run_fidelity,
        "what a problem's reduced models cost in accuracy, before one is taken",
        [
            "zeno-orbits fidelity motor_pendulum",
            "zeno-orbits fidelity motor_pendulum --set L=0.02 --measure --json",
        ],
    )
    add_problem(parser)
    add_gain_values(parser)
    parser.add_argument(
        "--measure", action="store_true", help="find the full problem's orbit, too, and compare"
    )


def _run_fidelity(options: argparse.Namespace) -> int:
    from zeno_orbits.model.library import load_problem
    from zeno_orbits.precision.reduced_models import reduction_costs

    problem = load_problem(options.problem)
    values = values_of(problem, options)
    costs = list(reduction_costs(problem, values, measure=options.measure).values())
    if options.json:
        print_json([asdict(cost) for cost in costs])
    else:
        report.print_reduction_costs(costs)
    return YES
