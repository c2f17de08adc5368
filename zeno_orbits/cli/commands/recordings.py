"""The commands about recordings of a machine: `read`, `compare` and `identify`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    add_orbit,
    add_problem,
    add_problem_file,
    add_recording,
    add_shared,
    print_json,
    say_written,
    write_json,
)
from zeno_orbits.cli.outputs import JSON, PICTURE, SAMPLES, require_outputs
from zeno_orbits.cli.parsing import (
    Named,
    read_fit,
    read_named_number,
    read_named_text,
    read_number,
)
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report


def add_read(commands: Any) -> None:
    """Add the command `read`."""
    parser = add_command(
        commands,
        "read",
        _run_read,
        "show what a file of time series is understood to be, and write it as a recording in SI "
        "units; exit code 1 if a column of numbers cannot be used",
        [
            "zeno-orbits read data.csv",
            "zeno-orbits read track.csv --frame-rate 200 --column y=height "
            '--unit "height=-0.78 mm" --zero height=512 -o drop.csv',
            "zeno-orbits read data.csv --problem motor_pendulum --json",
        ],
    )
    parser.add_argument(
        "data", metavar="DATA.csv", type=Path, help="a table of values, as an instrument wrote it"
    )
    parser.add_argument(
        "--column",
        dest="names",
        type=read_named_text,
        action=Named,
        metavar="TITLE=NAME",
        help="the column with this title, or of this number from 1, is the quantity NAME; may be "
        "repeated",
    )
    parser.add_argument(
        "--unit",
        dest="units",
        type=read_named_text,
        action=Named,
        metavar="NAME=UNIT",
        help='what one recorded unit is, such as "deg" or "-0.78 mm"; may be repeated',
    )
    parser.add_argument(
        "--zero",
        dest="zeros",
        type=read_named_number,
        action=Named,
        metavar="NAME=NUMBER",
        help="the recorded value that stands for zero; may be repeated",
    )
    parser.add_argument(
        "--frame-rate",
        type=read_number,
        metavar="HZ",
        help="frames per second; times are then those of the frames, or of the rows",
    )
    add_problem_file(parser, "problem")
    add_shared(parser, "t_start", type=read_number)
    add_shared(parser, "t_end", type=read_number)
    parser.add_argument("-o", "--output", type=Path, help="write the recording here, in SI units")


def _run_read(options: argparse.Namespace) -> int:
    import zeno_orbits as zo

    require_outputs(options, {"output": SAMPLES}, reads=[options.data])
    found = api.describe_recording(
        options.data,
        columns=zo.ColumnNotes(
            names=options.names,
            units=options.units,
            zeros=options.zeros,
            frame_rate=options.frame_rate,
        ),
        problem=options.problem,
    )
    if options.output is not None:
        if found.recording is None:
            raise InputError(f"Argument `output`: there is nothing to write: {found.trouble}.")
        part = api.crop(found.recording, options.t_start, options.t_end)
        zo.write_recording(part, options.output)
    if options.json:
        print_json(found.as_json())
    else:
        report.print_description(found)
        say_written(options, [options.output] if options.output is not None else [])
    return YES if found.is_complete else NO


def add_compare(commands: Any) -> None:
    """Add the command `compare`."""
    parser = add_command(
        commands,
        "compare",
        _run_compare,
        "compare a recording of signals over time with an orbit; exit code 0 if the recording "
        "shows it or one of the machine with other values, 1 if it does not or cannot decide",
        [
            "zeno-orbits compare orbit.json data.csv --t-start 5 --plot compared.png",
            "zeno-orbits compare orbit.json data.csv --t-start 5 --json",
        ],
    )
    add_orbit(parser)
    add_recording(parser)
    parser.add_argument(
        "--plot",
        dest="picture",
        type=Path,
        metavar="FILE",
        help="draw the recording over the orbit here",
    )


def _run_compare(options: argparse.Namespace) -> int:
    require_outputs(options, {"picture": PICTURE}, reads=[options.orbit, options.data])
    orbit = api.any_orbit(options.orbit)
    problem = api.problem_of(orbit, options.problem)
    with report.ProgressLine(options.interrupts.check) as progress:
        found = api.compare(
            orbit,
            options.data,
            problem=problem,
            t_start=options.t_start,
            t_end=options.t_end,
            on_progress=progress,
        )
    picture: Path | None = options.picture
    drawn: list[Path] = []
    if picture is not None and found.deviations is not None:
        from zeno_orbits.report import plots

        drawn = [picture]
        plots.save_figure(plots.plot_comparison(problem, found), picture)
    if options.json:
        print_json(found.as_json())
    else:
        report.print_comparison(found)
        say_written(options, drawn)
        if picture is not None and not drawn:
            report.print_lines(["Nothing was drawn: the recording cannot be laid over the orbit."])
    return YES if found.agrees else NO


def add_identify(commands: Any) -> None:
    """Add the command `identify`."""
    parser = add_command(
        commands,
        "identify",
        _run_identify,
        "estimate parameters of a machine from a recording of it; exit code 1 if the recording "
        "does not show an orbit of the problem",
        [
            "zeno-orbits identify motor_pendulum data.csv --t-start 12 --fit R,restitution",
            "zeno-orbits identify orbit.json data.csv --t-start 12 --fit R,restitution",
            "zeno-orbits identify motor_pendulum data.csv --t-start 12 --set R=3.2 --fit R=2:4 "
            "-o fitted.json --orbit fitted_orbit.json",
            "zeno-orbits identify motor_pendulum data.csv --t-start 12 "
            "--fit K_torque+K_emf=0.02:0.05 --json",
            "zeno-orbits identify motor_pendulum data.csv --t-start 12 "
            "--fit R,restitution,current.gain,theta1.offset,clock_rate",
        ],
    )
    add_problem(parser, "a problem's name or Python file, or the file of an orbit near the data")
    add_problem_file(parser, "problem_file")
    add_recording(parser)
    parser.add_argument(
        "--fit",
        type=read_fit,
        required=True,
        metavar="NAME[=LOW:HIGH],...",
        help="parameters to estimate, each within this range; A+B share one value; the default "
        "range is a tenth to ten times the value; CHANNEL.gain, CHANNEL.offset and clock_rate are "
        "errors of instruments",
    )
    parser.add_argument("-o", "--output", type=Path, help="write the results here, as JSON")
    parser.add_argument("--orbit", type=Path, help="write the orbit at the fitted values here")


def _run_identify(options: argparse.Namespace) -> int:
    import zeno_orbits as zo

    if options.problem_file is not None and not options.problem.endswith(".json"):
        wanted = "must come with an orbit file, but a problem is named already"
        raise InputError(f"Argument `--problem {options.problem_file}` {wanted}.")
    problem, gains, parameters = api.problem_or_orbit(
        options.problem, options.set, options.problem_file
    )
    problem.values(gains=gains, parameters=parameters)
    require_outputs(options, {"output": JSON, "orbit": JSON}, reads=[options.data])
    with report.ProgressLine(options.interrupts.check) as progress:
        recording = api.recording_for(
            problem, options.data, options.t_start, options.t_end, progress
        )
        fit = {"+".join(names): box for names, box in options.fit}
        found = api.identify(
            problem,
            recording,
            fit,
            gains=gains,
            parameters=parameters,
            on_progress=progress,
        )
    if options.output is not None:
        write_json(found, options.output)
    if options.orbit is not None:
        zo.write_orbit(found.orbit, options.orbit)
    if options.json:
        print_json(found.as_json())
    else:
        report.print_identification(recording, found)
        written = [path for path in (options.output, options.orbit) if path is not None]
        say_written(options, written)
    return YES
