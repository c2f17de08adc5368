"""The commands about what accuracy costs: `fidelity` and `trade`."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from zeno_orbits.cli.options import (
    YES,
    add_command,
    add_gains,
    add_problem,
    add_start,
    hand_out,
    print_json,
    require_outputs,
    start_of,
    values_of,
)
from zeno_orbits.cli.parsing import read_number
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report


def add_fidelity(commands: Any) -> None:
    """Add the command `fidelity`."""
    parser = add_command(
        commands,
        "fidelity",
        _run_fidelity,
        "estimate the error of a problem's reduced models, before one is used",
        [
            "zeno-orbits fidelity motor_pendulum",
            "zeno-orbits fidelity motor_pendulum --set L=0.02 --measure --json",
        ],
    )
    add_problem(parser)
    add_gains(parser)
    parser.add_argument(
        "--measure", action="store_true", help="also find the full problem's orbit, and compare"
    )


def _run_fidelity(options: argparse.Namespace) -> int:
    from zeno_orbits.model import load_problem
    from zeno_orbits.precision import reduction_costs

    problem = load_problem(options.problem)
    values = values_of(problem, options)
    if not problem.fidelities:
        message = f"must have reduced models, but `{problem.name}` has none"
        raise InputError(f"Argument `problem` {message}.")
    costs = list(reduction_costs(problem, values, measure=options.measure).values())
    if options.json:
        print_json([asdict(cost) for cost in costs])
    else:
        report.print_reduction_costs(costs)
    return YES


def add_trade(commands: Any) -> None:
    """Add the command `trade`."""
    parser = add_command(
        commands,
        "trade",
        _run_trade,
        "measure what accuracy costs: engines, tolerances, closures, meshes, reduced models",
        [
            "zeno-orbits trade motor_pendulum",
            "zeno-orbits trade motor_pendulum --set L=1e-5 --quick",
            "zeno-orbits trade bouncing_ball --until 5 -o trade.json --picture trade.png",
        ],
    )
    add_problem(parser)
    add_gains(parser)
    add_start(parser)
    parser.add_argument("--until", type=read_number, metavar="T", help="end of the simulations [s]")
    parser.add_argument(
        "--quick", action="store_true", help="few settings and one run each, for a first look"
    )
    parser.add_argument("--picture", type=Path, help="draw the work-precision diagram here")
    parser.add_argument("-o", "--output", type=Path, help="write all numbers here, as JSON")


def _run_trade(options: argparse.Namespace) -> int:
    from zeno_orbits.model import load_problem
    from zeno_orbits.precision import QUICK, WorkPrecisionSettings, trade

    problem = load_problem(options.problem)
    values = values_of(problem, options)
    state = start_of(problem, options)
    require_outputs(options)
    settings = QUICK if options.quick else WorkPrecisionSettings()
    if options.until is not None:
        settings = replace(settings, until=options.until)
    with report.ProgressLine(options.interrupts.check) as progress:
        found = trade(problem, values, state, settings=settings, on_progress=progress)
    hand_out(options, found, report.print_trade, lambda plots: plots.plot_trade(found))
    return YES
