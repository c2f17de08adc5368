"""The commands about accuracy and its cost: `fidelity` and `trade`."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    YES,
    add_command,
    add_problem,
    add_shared,
    add_start,
    hand_out,
    numbers_of,
    print_json,
)
from zeno_orbits.cli.outputs import JSON, PICTURE, require_outputs
from zeno_orbits.cli.parsing import read_number
from zeno_orbits.report import terminal as report


def add_fidelity(commands: Any) -> None:
    """Add the command `fidelity`."""
    parser = add_command(
        commands,
        "reduced-models",
        _run_fidelity,
        "estimate the error of a problem's reduced models, before one is used",
        [
            "zeno-orbits reduced-models motor_pendulum",
            "zeno-orbits reduced-models motor_pendulum --set L=0.02 --measure --json",
        ],
    )
    add_problem(parser)
    parser.add_argument(
        "--measure", action="store_true", help="also find the full problem's orbit, and compare"
    )


def _run_fidelity(options: argparse.Namespace) -> int:
    problem = api.known_problem(options.problem)
    costs = api.reduced_model_errors(
        problem, **numbers_of(problem, options), measure=options.measure
    )
    if options.json:
        print_json([{**asdict(cost), "bound": cost.bound} for cost in costs])
    else:
        report.print_reduction_costs(costs)
    return YES


def add_trade(commands: Any) -> None:
    """Add the command `trade`."""
    parser = add_command(
        commands,
        "work-precision",
        _run_trade,
        "measure error and time of integrators, tolerances, Zeno limits, meshes and reduced models",
        [
            "zeno-orbits work-precision motor_pendulum",
            "zeno-orbits work-precision motor_pendulum --set L=1e-5 --quick",
            "zeno-orbits work-precision bouncing_ball --until 5 -o study.json --plot study.png",
        ],
    )
    add_problem(parser)
    add_start(parser)
    add_shared(parser, "until", type=read_number)
    parser.add_argument(
        "--quick", action="store_true", help="few settings and one run each, for a first look"
    )
    parser.add_argument(
        "--plot",
        dest="picture",
        type=Path,
        metavar="FILE",
        help="draw the work-precision diagram here",
    )
    parser.add_argument("-o", "--output", type=Path, help="write all results here, as JSON")


def _run_trade(options: argparse.Namespace) -> int:
    problem = api.known_problem(options.problem)
    require_outputs(options, {"output": JSON, "picture": PICTURE})
    with report.ProgressLine(options.interrupts.check) as progress:
        found = api.work_precision(
            problem,
            **numbers_of(problem, options),
            start=options.start or None,
            until=options.until,
            quick=options.quick,
            on_progress=progress,
        )
    hand_out(options, found, report.print_trade, lambda plots: plots.plot_trade(found))
    return YES
