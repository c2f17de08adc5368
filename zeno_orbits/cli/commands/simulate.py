"""The command `simulate`."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import zeno_orbits as zo
from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    YES,
    add_accuracy,
    add_command,
    add_problem,
    add_shared,
    add_start,
    numbers_of,
    print_json,
    require_output_of,
    say_written,
)
from zeno_orbits.cli.outputs import PICTURE, SAMPLES, require_outputs
from zeno_orbits.cli.parsing import read_count, read_number, read_seed
from zeno_orbits.cli.typed import with_options
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.report import terminal as report


def add_simulate(commands: Any) -> None:
    """Add the command `simulate`."""
    parser = add_command(
        commands,
        "simulate",
        _run_simulate,
        "simulate a completed execution: impacts, Zeno points, contact phases and releases",
        [
            "zeno-orbits simulate motor_pendulum --until 10",
            "zeno-orbits simulate motor_pendulum --start theta1=1.2 --start dtheta2=0.5",
            "zeno-orbits simulate motor_pendulum --set L=1e-6 --accuracy 1e-6",
            "zeno-orbits simulate bouncing_ball --set restitution=0.8 --until 5 --json",
            "zeno-orbits simulate motor_pendulum --truncation 0.01",
            "zeno-orbits simulate vibrating_table --set A=0.03 --settle",
            "zeno-orbits simulate motor_pendulum --until 40 -o data.csv --noise 1e-3",
        ],
    )
    add_problem(parser)
    add_accuracy(parser)
    add_shared(parser, "until", " (default: 10)", type=read_number, default=10.0)
    add_start(parser)
    parser.add_argument(
        "--settle",
        action="store_true",
        help="also print the attractor of the motion, with the time limit of `map`",
    )
    parser.add_argument(
        "--truncation",
        type=read_number,
        metavar="DELTA",
        help="the paper's rule in place of the Zeno limit: the first impact with |dh/dt| below "
        "this is plastic; its error is of first order in Zeno points, of third order later",
    )
    parser.add_argument(
        "--max-steps",
        dest="most_steps",
        type=read_count,
        metavar="N",
        help="stop after this many steps of the integrator (default: 2000000)",
    )
    parser.add_argument(
        "--max-impacts",
        dest="most_impacts",
        type=read_count,
        metavar="N",
        help="stop after this many impacts in a sequence without a Zeno point (default: 100000)",
    )
    parser.add_argument(
        "--all-states", action="store_true", help="print every state, including constant states"
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="DATA.csv", help="write samples of the states here"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the states over time here")
    parser.add_argument("--events", action="store_true", help="print every impact")
    _add_samples(parser)


_RATE = 500.0
"""Samples per second of a recording, if no rate is given."""


def _add_samples(parser: argparse.ArgumentParser) -> None:
    """Add the options of the written samples."""
    parser.add_argument(
        "--rate",
        type=read_number,
        metavar="HZ",
        help=f"samples per second (default: {_RATE:g})",
    )
    parser.add_argument(
        "--noise",
        type=read_number,
        default=0.0,
        metavar="SHARE",
        help="noise on the samples, relative to the range of each state (default: 0)",
    )
    parser.add_argument(
        "--seed", type=read_seed, metavar="N", help="seed of the noise (default: 0)"
    )


_MOST_ANGLE = 4 * math.pi
"""Largest angle of a start without a note [rad]: a larger one is often in degrees."""


def _run_simulate(options: argparse.Namespace) -> int:
    problem = api.known_problem(options.problem)
    require_outputs(options, {"output": SAMPLES, "plot": PICTURE})
    require_output_of(options, "rate", "noise", "seed")
    rate = _RATE if options.rate is None else options.rate
    sampling: dict[str, Any] = {"rate": rate, "noise": options.noise, "seed": options.seed or 0}
    if options.output is not None:
        api.require_samples(options.until, **sampling)
    for name, value in options.start.items():
        unit = dict(zip(problem.state_names, problem.state_units, strict=True)).get(name)
        if unit == "rad" and abs(value) > _MOST_ANGLE:
            turns = abs(value) / (2 * math.pi)
            note = f"--start {name}={value:g}: in radians this is {turns:.3g} turns"
            report.print_note(f"{note} ({value:g} degrees are {math.radians(value):.4g}).")
    for note in api.energy_notes(problem, options.set, options.problem):
        report.print_note(note)
    stopped = None
    try:
        assured = _simulated(options, problem)
    except SimulationError as error:
        if options.debug or error.execution is None:
            raise
        stopped, assured = error, api.unfinished(error, options.engine)
    execution = assured.execution
    attractor = None
    if options.settle:
        attractor = api.attractor_of(
            problem, **numbers_of(problem, options), start=options.start or None
        )
    if options.json:
        entries = api.execution_json(problem, assured) | {"stopped": stopped and str(stopped)}
        print_json(entries if attractor is None else entries | {"attractor": attractor.as_json()})
    else:
        report.print_execution(
            problem, assured, all_states=options.all_states, all_events=options.events
        )
        if stopped is None:
            why = api.engine_choice(problem, execution, **numbers_of(problem, options))
            report.print_engine(options.engine, why, assured.error)
        if attractor is not None:
            report.print_attractor(attractor)
    if options.plot is not None:
        from zeno_orbits.report import plots

        plots.save_figure(plots.plot_time_series(problem, execution), options.plot)
        say_written(options, [options.plot])
    if options.output is not None:
        recording = api.sample_execution(
            problem, execution, **numbers_of(problem, options), **sampling
        )
        zo.write_recording(recording, options.output)
        say_written(options, [options.output])
    if stopped is not None:
        report.print_error(with_options(str(stopped)))
        return NO
    return YES


def _settings(options: argparse.Namespace) -> zo.SimulationSettings:
    """Return the settings of the simulator.

    Raises:
        InputError: If the options exclude each other, or the threshold is not a speed.
    """
    settings = api.simulation_settings(options.engine)
    if options.truncation is not None:
        if options.accuracy is not None:
            raise InputError(
                "Options `--truncation` and `--accuracy` exclude each other: leave out one."
            )
        if not options.truncation > 0.0:
            wanted = "must be a speed above 0"
            raise InputError(f"Argument `truncation` {wanted}, but it is {options.truncation:g}.")
        settings = replace(settings, completion=zo.Truncation(delta=options.truncation))
    if options.most_steps is not None:
        settings = replace(settings, most_steps=options.most_steps)
    if options.most_impacts is not None:
        settings = replace(settings, most_impacts=options.most_impacts)
    return settings


def _simulated(options: argparse.Namespace, problem: zo.Problem) -> zo.ExecutionWithError:
    """Return the execution with its estimated error, to the requested accuracy if there is one."""
    asked: dict[str, Any] = {
        **numbers_of(problem, options),
        "start": options.start or None,
        "until": options.until,
        "settings": _settings(options),
    }
    with report.ProgressLine(options.interrupts.check) as progress:
        if options.accuracy is None:
            return api.simulate_with_error(problem, **asked, on_progress=progress)
        return api.simulate_to_accuracy(
            problem, accuracy=options.accuracy, **asked, on_progress=progress
        )
