"""The command `simulate`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.cli.options import (
    NO,
    YES,
    add_accuracy,
    add_command,
    add_gains,
    add_problem,
    add_start,
    print_json,
    require_outputs,
    say_written,
    simulation_of,
    start_of,
    values_of,
)
from zeno_orbits.cli.parsing import read_count, read_number, read_seed
from zeno_orbits.errors import SimulationError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    from zeno_orbits.experiment import Sampling
    from zeno_orbits.model import HybridDynamics, Problem
    from zeno_orbits.precision import Assured
    from zeno_orbits.simulation import SimulationSettings


def add_simulate(commands: Any) -> None:
    """Add the command `simulate`."""
    parser = add_command(
        commands,
        "simulate",
        _run_simulate,
        "simulate a completed execution: impacts, Zeno points, locked arcs and releases",
        [
            "zeno-orbits simulate motor_pendulum --until 10",
            "zeno-orbits simulate motor_pendulum --start theta1=1.2 --start dtheta2=0.5",
            "zeno-orbits simulate motor_pendulum --set L=1e-6 --accuracy 1e-6",
            "zeno-orbits simulate bouncing_ball --set restitution=0.8 --until 5 --json",
            "zeno-orbits simulate motor_pendulum --until 40 --data data.csv --noise 1e-3",
        ],
    )
    add_problem(parser)
    add_gains(parser)
    add_accuracy(parser)
    parser.add_argument(
        "--until",
        type=read_number,
        default=10.0,
        metavar="T",
        help="end of the simulation [s]; 10 by default",
    )
    add_start(parser)
    parser.add_argument(
        "--most-steps",
        type=read_count,
        metavar="N",
        help="stop after this many steps of the integrator; 2000000 by default",
    )
    parser.add_argument(
        "--all-states", action="store_true", help="print every state, also those that stand still"
    )
    parser.add_argument("-o", "--output", type=Path, help="draw the states over time here")
    parser.add_argument(
        "--data", type=Path, metavar="DATA.csv", help="write samples of the states here"
    )
    parser.add_argument(
        "--rate",
        type=read_number,
        default=500.0,
        metavar="HZ",
        help="samples per second; 500 by default",
    )
    parser.add_argument(
        "--noise",
        type=read_number,
        default=0.0,
        metavar="SHARE",
        help="noise on the samples, relative to the range of each state; 0 by default",
    )
    parser.add_argument(
        "--seed", type=read_seed, default=0, metavar="N", help="seed of the noise; 0 by default"
    )


def _run_simulate(options: argparse.Namespace) -> int:
    from zeno_orbits.model import load_problem
    from zeno_orbits.precision import why_engine

    problem = load_problem(options.problem)
    values = values_of(problem, options)
    state = start_of(problem, options)
    require_outputs(options, files=("data",), pictures=("output",))
    sampling = None if options.data is None else _sampling_of(options)
    dynamics = problem.dynamics(values)
    stopped = None
    try:
        assured = _simulated(options, dynamics, state)
    except SimulationError as error:
        if options.debug or error.execution is None:
            raise
        stopped, assured = error, _until(error, simulation_of(options))
    execution = assured.execution
    if options.json:
        print_json(_execution_json(problem, assured) | {"stopped": stopped and str(stopped)})
    else:
        report.print_execution(problem, assured, all_states=options.all_states)
        if stopped is None:
            longest = max(arc.end_time - arc.start_time for arc in execution.arcs)
            why = why_engine(dynamics, state, longest)
            report.print_engine(options.engine, why, assured.error)
    if options.output is not None:
        from zeno_orbits.report import plots

        plots.save_figure(plots.plot_time_series(problem, execution), options.output)
        say_written(options, [options.output])
    if sampling is not None and options.data is not None:
        from zeno_orbits.experiment import sampled, write_recording

        write_recording(sampled(problem, dynamics, execution, sampling), options.data)
        say_written(options, [options.data])
    if stopped is not None:
        report.print_error(str(stopped))
        return NO
    return YES


def _until(error: SimulationError, settings: SimulationSettings) -> Assured:
    """Return what an execution that could not be continued has come to, its error unknown."""
    from zeno_orbits.precision import Assured

    n_points = len(error.execution.zeno_points)
    return Assured(
        execution=error.execution, settings=settings, error=inf, zeno_errors=(inf,) * n_points
    )


def _sampling_of(options: argparse.Namespace) -> Sampling:
    from zeno_orbits.experiment import Sampling

    sampling = Sampling(rate=options.rate, noise=options.noise, seed=options.seed)
    if options.until > 0.0:
        sampling.count(options.until)
    return sampling


def _simulated(
    options: argparse.Namespace, dynamics: HybridDynamics, state: Sequence[float]
) -> Assured:
    """Return the execution with its estimated error, to an accuracy if one was asked for."""
    from zeno_orbits.precision import simulate_to, simulate_with_error

    settings = simulation_of(options)
    if options.most_steps is not None:
        settings = replace(settings, most_steps=options.most_steps)
    with report.ProgressLine(options.interrupts.check) as progress:
        if options.accuracy is None:
            return simulate_with_error(
                dynamics, state, until=options.until, settings=settings, on_progress=progress
            )
        return simulate_to(
            dynamics,
            state,
            until=options.until,
            accuracy=options.accuracy,
            settings=settings,
            on_progress=progress,
        )


def _number(error: float) -> float | None:
    """Return an error for JSON, which has no infinity."""
    return error if isfinite(error) else None


def _execution_json(problem: Problem, assured: Assured) -> dict[str, Any]:
    from zeno_orbits.simulation import Impact, ZenoPoint

    execution, errors = assured.execution, iter(assured.zeno_errors)

    def named(state: Any) -> dict[str, float]:
        return dict(zip(problem.state_names, map(float, state), strict=True))

    events: list[dict[str, Any]] = []
    for event in execution.events:
        if isinstance(event, Impact):
            events.append(
                {
                    "event": "impact",
                    "time": event.time,
                    "approach_rate": event.approach_rate,
                    "state_minus": named(event.state_minus),
                    "state_plus": named(event.state_plus),
                }
            )
        else:
            kind = "zeno_point" if isinstance(event, ZenoPoint) else "release"
            entry: dict[str, Any] = {
                "event": kind,
                "time": event.time,
                "state": named(event.state),
            }
            if isinstance(event, ZenoPoint):
                entry["error"] = _number(next(errors))
                entry["limit_error"] = event.limit_error
            events.append(entry)
    return {
        "problem": problem.name,
        "end_time": execution.end_time,
        "end_mode": execution.arcs[-1].mode.value,
        "end_state": named(execution.end_state),
        "error": _number(assured.error),
        "events": events,
    }
