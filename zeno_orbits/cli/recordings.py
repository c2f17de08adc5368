"""The commands about recordings of a machine: `compare` and `identify`."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    add_gains,
    add_orbit,
    add_problem,
    add_recording,
    orbit_and_problem,
    print_json,
    require_outputs,
    say_written,
    values_of,
    write_json,
)
from zeno_orbits.cli.parsing import Fit, read_fit
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    from zeno_orbits.experiment import Recording, Unknown
    from zeno_orbits.model import ParameterValues, Problem


def add_compare(commands: Any) -> None:
    """Add the command `compare`."""
    parser = add_command(
        commands,
        "compare",
        _run_compare,
        "compare a recording of signals over time with an orbit; exit code 1 if the recording "
        "does not show the orbit",
        [
            "zeno-orbits compare orbit.json data.csv --from 5 --picture compared.png",
            "zeno-orbits compare orbit.json data.csv --from 5 --json",
        ],
    )
    add_orbit(parser)
    add_recording(parser)
    parser.add_argument("--picture", type=Path, help="draw the recording over the orbit here")


def _run_compare(options: argparse.Namespace) -> int:
    from zeno_orbits.experiment import compare

    require_outputs(options, files=(), reads=[options.orbit, options.data])
    orbit, problem = orbit_and_problem(options)
    with report.ProgressLine(options.interrupts.check) as progress:
        recording = _recording(options, problem, progress)
        progress("comparing")
        found = compare(orbit, problem, recording)
    picture: Path | None = options.picture
    drawn = [] if picture is None or found.deviations is None else [picture]
    for path in drawn:
        from zeno_orbits.report import plots

        plots.save_figure(plots.plot_comparison(problem, found), path)
    if options.json:
        print_json(found.as_json())
    else:
        report.print_comparison(found)
        say_written(options, drawn)
        if picture is not None and not drawn:
            report.print_lines(["Nothing was drawn: the recording cannot be laid over the orbit."])
    return YES if found.agrees else NO


def _recording(
    options: argparse.Namespace, problem: Problem, progress: report.ProgressLine
) -> Recording:
    """Return the part of the recording that counts."""
    from zeno_orbits.experiment import cut, measurable, read_recording

    progress("reading the recording")
    recording = read_recording(options.data, only=tuple(measurable(problem)))
    return cut(recording, options.since, options.to)


def add_identify(commands: Any) -> None:
    """Add the command `identify`."""
    parser = add_command(
        commands,
        "identify",
        _run_identify,
        "estimate parameters of a machine from a recording of it; exit code 1 if the recording "
        "does not show an orbit of the problem",
        [
            "zeno-orbits identify motor_pendulum data.csv --from 12 --fit R,restitution",
            "zeno-orbits identify motor_pendulum data.csv --from 12 --set R=3.2 --fit R=2:4 "
            "-o fitted.json --orbit fitted_orbit.json",
            "zeno-orbits identify motor_pendulum data.csv --from 12 "
            "--fit K_torque+K_emf=0.02:0.05 --json",
        ],
    )
    add_problem(parser)
    add_recording(parser)
    add_gains(parser)
    parser.add_argument(
        "--fit",
        type=read_fit,
        required=True,
        metavar="NAME[=LOW:HIGH],...",
        help="parameters to estimate, each within this range; A+B share one value; the default "
        "range is a tenth to ten times the value",
    )
    parser.add_argument("-o", "--output", type=Path, help="write the numbers here, as JSON")
    parser.add_argument("--orbit", type=Path, help="write the orbit at the fitted numbers here")


def _run_identify(options: argparse.Namespace) -> int:
    from zeno_orbits.experiment import identify
    from zeno_orbits.model import load_problem
    from zeno_orbits.orbits import write_orbit

    problem = load_problem(options.problem)
    values = values_of(problem, options)
    unknowns = _unknowns(problem, values, options.fit)
    require_outputs(options, files=("output", "orbit"), pictures=(), reads=[options.data])
    with report.ProgressLine(options.interrupts.check) as progress:
        recording = _recording(options, problem, progress)
        found = identify(problem, values, recording, unknowns, on_progress=progress)
    if options.output is not None:
        write_json(found, options.output)
    if options.orbit is not None:
        write_orbit(found.orbit, options.orbit)
    if options.json:
        print_json(found.as_json())
    else:
        report.print_identification(recording, found)
        written = [path for path in (options.output, options.orbit) if path is not None]
        say_written(options, written)
    return YES


_DECADE = 10.0


def _unknowns(problem: Problem, values: ParameterValues, fit: Fit) -> tuple[Unknown, ...]:
    """Return what is to be found, in ranges that the problem allows."""
    from zeno_orbits.experiment import Unknown

    known = {quantity.name: quantity for quantity in problem.parameters}
    found: list[Unknown] = []
    for names, box in fit:
        lower, upper = -math.inf, math.inf
        for name in names:
            if name in known:
                lower, upper = max(lower, known[name].lower), min(upper, known[name].upper)
        value = values.parameters.get(names[0], 0.0)
        around = sorted((value / _DECADE, value * _DECADE)) if value else (-1.0, 1.0)
        low, high = box if box is not None else (max(lower, around[0]), min(upper, around[1]))
        found.append(Unknown(names=names, lower=max(low, lower), upper=min(high, upper)))
    return tuple(found)
