"""The commands about recordings of a machine: `read`, `compare` and `identify`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
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

if TYPE_CHECKING:
    import zeno_orbits as zo


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
            "zeno-orbits read video.csv --second-file logger.csv",
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
    parser.add_argument(
        "--second-file",
        type=Path,
        metavar="FILE",
        help="show a second file of the same motion too, and by signals that both files have what "
        "its clock shows at the beginning of the first",
    )
    parser.add_argument("-o", "--output", type=Path, help="write the recording here, in SI units")


def _run_read(options: argparse.Namespace) -> int:
    import zeno_orbits as zo

    reads = [options.data] if options.second_file is None else [options.data, options.second_file]
    require_outputs(options, {"output": SAMPLES}, reads=reads)
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
    second = options.second_file and api.describe_recording(
        options.second_file, problem=options.problem
    )
    if options.output is not None:
        if found.recording is None:
            reason = f"needs a recording, and the file is none: {found.trouble}"
            raise InputError(f"Argument `output` {reason}.")
        part = api.crop(found.recording, options.t_start, options.t_end)
        zo.write_recording(part, options.output)
    words = second and api.clock_words(found, second)
    if options.json:
        more = {"second_file": {**second.as_json(), "clock": words}} if second else {}
        print_json(found.as_json() | more)
    else:
        report.print_description(found)
        if second:
            report.print_lines([f"Second file {options.second_file}:"])
            report.print_description(second)
            report.print_lines([f"Note: {words}."] if words else [])
        say_written(options, [options.output] if options.output is not None else [])
    return YES if found.is_complete and (not second or second.is_complete) else NO


def add_compare(commands: Any) -> None:
    """Add the command `compare`."""
    parser = add_command(
        commands,
        "compare",
        _run_compare,
        "compare a recording of signals over time with an orbit; exit code 0 if the recording "
        "shows it or one of the machine with other values, 1 if it does not or cannot decide; with "
        "a problem, compare transients impact by impact, exit code 1 if structure is left",
        [
            "zeno-orbits compare orbit.json data.csv --t-start 12 --plot compared.png",
            "zeno-orbits compare orbit.json data.csv --t-start 12 --json",
            "zeno-orbits compare orbit.json data.csv --t-start 12 --second-file video.csv",
            "zeno-orbits compare bouncing_ball drop.csv --set restitution=0.8 --plot drop.png",
            "zeno-orbits compare bouncing_ball track.csv --fit height.gain,height.offset",
        ],
    )
    add_problem(parser, "an orbit file, or for transients a problem's name or Python file")
    add_problem_file(parser, "problem_file")
    add_recording(parser)
    parser.add_argument(
        "--fit",
        type=_read_names,
        default=(),
        metavar="NAME,...",
        help="errors of instruments to determine first: CHANNEL.gain and CHANNEL.offset of a "
        "channel without a known scale or zero, such as a track in pixels; for transients also "
        "clock_rate",
    )
    _add_trials(parser)
    parser.add_argument(
        "--plot",
        dest="picture",
        type=Path,
        metavar="FILE",
        help="draw the recording over the orbit here",
    )


def _add_trials(parser: argparse.ArgumentParser) -> None:
    """Add further trials of transients, and their initial values."""
    parser.add_argument(
        "--trial",
        dest="trials",
        nargs="+",
        action="extend",
        default=[],
        type=Path,
        metavar="FILE",
        help="recordings of further trials of a transient, with the same parameters",
    )
    parser.add_argument(
        "--second-file",
        type=Path,
        metavar="FILE",
        help="a second file of the same motion on another clock; the offset and the rate of "
        "its clock are determined",
    )
    add_shared(
        parser,
        "start",
        " that are not recorded (repeatable); it is known, and the initial values of other "
        "recorded states and their rates are determined",
        action=Named,
        type=read_named_number,
    )
    add_shared(parser, "initial", type=_read_names, default=())


def _read_names(text: str) -> tuple[str, ...]:
    """Return names with commas between.

    Raises:
        ArgumentTypeError: If one is empty.
    """
    names = tuple(part.strip() for part in text.split(","))
    if not all(names):
        raise argparse.ArgumentTypeError(f"must be NAME,NAME, but it is `{text}`")
    return names


def _files(options: argparse.Namespace) -> list[Path]:
    """Return the files of recordings that a command reads."""
    second = [] if options.second_file is None else [options.second_file]
    return [options.data, *options.trials, *second]


def _run_compare(options: argparse.Namespace) -> int:
    files = _files(options)
    if Path(options.problem).suffix != ".json":
        require_outputs(options, {"picture": PICTURE}, reads=files)
        return _run_compare_transient(options)
    orbit_path = Path(options.problem)
    require_outputs(options, {"picture": PICTURE}, reads=[orbit_path, *files])
    for name in ("set", "start", "trials", "initial"):
        if getattr(options, name):
            asked = f"--{name.removesuffix('s')}"
            raise InputError(f"Argument `{asked}` needs a problem in place of `{orbit_path}`.")
    orbit = api.any_orbit(orbit_path)
    problem = api.problem_of(orbit, options.problem_file)
    with report.ProgressLine(options.interrupts.check) as progress:
        found = api.compare(
            orbit,
            options.data,
            problem=problem,
            fit=options.fit,
            second_file=options.second_file,
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


def _run_compare_transient(options: argparse.Namespace) -> int:
    _require_one_problem(options)
    problem, gains, parameters = api.problem_or_orbit(options.problem, options.set)
    with report.ProgressLine(options.interrupts.check) as progress:
        found = api.compare_transient(
            problem,
            [options.data, *options.trials],
            second_file=options.second_file,
            fit=options.fit,
            gains=gains,
            parameters=parameters,
            start=options.start,
            initial=options.initial,
            t_start=options.t_start,
            t_end=options.t_end,
            on_progress=progress,
        )
    if options.picture is not None:
        from zeno_orbits.report import plots

        plots.save_figure(plots.plot_transient(found.fit), options.picture)
    if options.json:
        print_json(found.as_json())
    else:
        report.print_transient_comparison(found)
        say_written(options, [options.picture] if options.picture is not None else [])
    return YES if found.agrees else NO


def _require_one_problem(options: argparse.Namespace) -> None:
    """Refuse the file of an orbit's problem beside a problem.

    Raises:
        InputError: If both are given.
    """
    if options.problem_file is not None and not options.problem.endswith(".json"):
        wanted = "must come with an orbit file, but a problem is named already"
        raise InputError(f"Argument `--problem {options.problem_file}` {wanted}.")


def add_identify(commands: Any) -> None:
    """Add the command `identify`."""
    parser = add_command(
        commands,
        "identify",
        _run_identify,
        "estimate parameters of a machine from recordings of it, settled or transient; exit code 1 "
        "if a recording does not show a motion of the problem",
        [
            "zeno-orbits identify motor_pendulum data.csv --t-start 12 --fit R,restitution",
            "zeno-orbits identify orbit.json data.csv --t-start 12 --fit R,restitution",
            "zeno-orbits identify motor_pendulum data.csv --t-start 12 --set R=3.2 --fit R=2:4 "
            "-o fitted.json --orbit fitted_orbit.json",
            "zeno-orbits identify motor_pendulum data.csv --t-start 12 "
            "--fit K_torque+K_emf=0.02:0.05 --json",
            "zeno-orbits identify motor_pendulum data.csv --t-start 12 "
            "--fit R,restitution,current.gain,theta1.offset,clock_rate",
            "zeno-orbits identify bouncing_ball drop.csv --fit restitution --plot drop.png",
            "zeno-orbits identify bouncing_ball drop.csv --trial drop2.csv --fit restitution",
            "zeno-orbits identify bouncing_ball drop.csv --fit restitution --law constant,linear",
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
    _add_trials(parser)
    parser.add_argument(
        "--transient",
        action="store_true",
        help="fit a transient; by default the recording decides: several trials, event times and "
        "motions that come to rest are transients",
    )
    parser.add_argument(
        "--law",
        type=_read_names,
        metavar="LAW,...",
        help="fit transients under each of these laws of impact (constant, linear, power), and "
        "tell which one they support",
    )
    parser.add_argument(
        "--plot",
        dest="picture",
        type=Path,
        metavar="FILE",
        help="draw fitted transients and their deviations here",
    )
    parser.add_argument("-o", "--output", type=Path, help="write the results here, as JSON")
    parser.add_argument(
        "--orbit",
        type=Path,
        help="fit a settled orbit, and write the orbit at the fitted values here",
    )


def _run_identify(options: argparse.Namespace) -> int:
    import zeno_orbits as zo

    _require_one_problem(options)
    problem, gains, parameters = api.problem_or_orbit(
        options.problem, options.set, options.problem_file
    )
    if options.transient and options.orbit is not None:
        raise InputError("Argument `--orbit` must go without --transient, which shows no orbit.")
    if options.law and options.orbit is not None:
        raise InputError("Argument `--orbit` must go without --law, which fits transients.")
    if options.law and options.second_file is not None:
        raise InputError("Argument `--second-file` must go without --law, which compares trials.")
    outputs = {"output": JSON, "orbit": JSON, "picture": PICTURE}
    require_outputs(options, outputs, reads=_files(options))
    with report.ProgressLine(options.interrupts.check) as progress:
        files = [options.data, *options.trials]
        trials = api.labelled_recordings(problem, files, options.t_start, options.t_end, progress)
        fit = {"+".join(names): box for names, box in options.fit}
        laws = options.law and api.compare_laws_of(
            problem,
            trials,
            fit,
            options.law,
            values=problem.values(gains=gains, parameters=parameters),
            start=options.start,
            initial=options.initial,
            on_progress=progress,
        )
        found = (
            laws.best.found
            if laws
            else api.identify_trials(
                problem,
                trials,
                fit,
                values=problem.values(gains=gains, parameters=parameters),
                start=options.start,
                initial=options.initial,
                second=api.read_second_file(problem, options.second_file, progress),
                # An orbit to write is one to fit.
                transient=True if options.transient else None if options.orbit is None else False,
                on_progress=progress,
            )
        )
    if options.picture is not None:
        _draw_transient(found, options.picture)
    data = laws or found
    if options.output is not None:
        write_json(data, options.output)
    if options.orbit is not None:
        zo.write_orbit(found.orbit, options.orbit)
    if options.json:
        print_json(data.as_json())
    else:
        if laws:
            report.print_laws(laws)
        remarks = dict.fromkeys(word for _, one in trials for word in one.remarks)
        report.print_identification(found, tuple(remarks))
        paths = (options.output, options.orbit, options.picture)
        say_written(options, [path for path in paths if path is not None])
    return YES


def _draw_transient(found: zo.Identification, picture: Path) -> None:
    """Draw the fitted transients.

    Raises:
        InputError: If a settled orbit was fitted.
    """
    from zeno_orbits.report import plots

    if found.transient is None:
        raise InputError("Argument `--plot` needs transients: compare the orbit by `compare`.")
    plots.save_figure(plots.plot_transient(found.transient), picture)
