"""The commands that draw an orbit: `plot` and `figures`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    YES,
    add_command,
    add_orbit,
    add_problem_file,
    print_json,
    require_phases,
    say_written,
)
from zeno_orbits.cli.outputs import FOLDER, require_outputs
from zeno_orbits.cli.parsing import read_count
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.report import terminal as report
from zeno_orbits.work import write_all

if TYPE_CHECKING:
    import zeno_orbits as zo
    from zeno_orbits.report import plots

_PICTURES = ("portraits", "time", "outputs", "zeno", "region")
_FIGURES = ("graph", "mechanism", "region", "portraits", "beside", "animation")


def add_plot(commands: Any) -> None:
    """Add the command `plot`."""
    parser = add_command(
        commands,
        "plot",
        _run_plot,
        "draw an orbit",
        [
            "zeno-orbits plot orbit.json -o pictures",
            "zeno-orbits plot orbit.json --kind portraits --format pdf",
        ],
    )
    add_orbit(parser)
    parser.add_argument(
        "--kind",
        action="append",
        choices=_PICTURES,
        help="picture to draw: phase portraits, states over time, outputs over time, zoom into "
        "the Zeno point, region d2h/dt2 < 0 (repeatable, default: all of the problem)",
    )
    parser.add_argument("--format", choices=("png", "pdf", "svg"), default="png")
    parser.add_argument(
        "--periods", type=read_count, default=1, metavar="N", help="periods to draw"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path(), help="folder for the pictures")


def _run_plot(options: argparse.Namespace) -> int:
    from zeno_orbits.report import orbit_motion, plots

    require_outputs(options, {"output": FOLDER})
    orbit = api.any_orbit(options.orbit)
    problem = api.problem_of(orbit, options.problem)
    dynamics: Any = orbit.machine(problem)
    execution = orbit_motion(orbit, problem, dynamics, periods=options.periods)
    draw = {
        "portraits": lambda: plots.plot_portraits(problem, execution),
        "time": lambda: plots.plot_time_series(problem, execution),
        "outputs": lambda: plots.plot_outputs(problem, orbit.values(problem), execution),
        "zeno": lambda: plots.plot_zeno_neighbourhood(problem, execution, dynamics),
        "region": lambda: plots.plot_zeno_set(problem, dynamics, execution),
    }
    rests = any(name.startswith("zeno ") for name in orbit.sequence)
    if "region" in (options.kind or ()):
        require_phases(orbit, "--kind region")
    region = orbit.phases_as is not None and rests and plots.has_zeno_region(dynamics)
    has = {"outputs": bool(problem.outputs), "zeno": rests, "region": region}
    kinds = options.kind or [kind for kind in draw if has.get(kind, True)]
    if "outputs" in kinds and not problem.outputs:
        raise InputError(
            f"Argument `kind` must be a picture that `{problem.name}` has, but it lacks outputs."
        )
    if not rests and {"zeno", "region"} & {*kinds}:
        wanted = "must be a picture of an orbit without a Zeno point"
        raise InputError(f"Argument `kind` {wanted}, but it is `zeno` or `region`.")
    # All figures are drawn before any file is written, so a failure leaves no files.
    files = {
        f"{kind}.{options.format}": plots.rendered(draw[kind](), options.format) for kind in kinds
    }
    write_all(options.output, files)
    paths = [options.output / name for name in files]
    if options.json:
        print_json({"pictures": [str(path) for path in paths]})
    else:
        say_written(options, paths)
    return YES


def add_figures(commands: Any) -> None:
    """Add the command `figures`."""
    parser = add_command(
        commands,
        "figures",
        _run_figures,
        "draw the figures of the paper for an orbit, at the width of a column, as PDF and PNG",
        [
            "zeno-orbits figures orbit.json -o figures",
            "zeno-orbits figures motor_pendulum -o figures --kind graph --kind region",
            "zeno-orbits figures orbit.json -o figures --kind beside --recording recording.csv",
        ],
    )
    parser.add_argument(
        "orbit",
        metavar="ORBIT.json|PROBLEM",
        type=Path,
        help="an orbit file, or a problem, for which an orbit is searched first",
    )
    add_problem_file(parser)
    parser.add_argument(
        "--kind",
        action="append",
        choices=_FIGURES,
        metavar="KIND",
        help=f"figures to draw, one of {', '.join(_FIGURES)}: the system and its completion as "
        "graphs, the mechanism and its circuit, the region d2h/dt2 < 0, phase portraits, five "
        "figures that compare the model with the virtual rig, the machine in motion "
        "(repeatable, default: all of the problem)",
    )
    parser.add_argument(
        "--recording",
        dest="data",
        type=Path,
        metavar="FILE.csv",
        help="show the model with this recording instead of the virtual rig",
    )
    parser.add_argument(
        "--periods",
        type=read_count,
        default=3,
        metavar="N",
        help="number of periods to show with another motion, and of a walk",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the figures")


def _run_figures(options: argparse.Namespace) -> int:
    from zeno_orbits.report import plots

    require_outputs(options, {"output": FOLDER})
    if options.data is not None and options.kind and "beside" not in options.kind:
        raise InputError("Argument `data` needs the kind `beside`.")
    asked: list[str] = options.kind or []
    wanted = [*asked, "beside"] if options.data is not None else asked
    files: dict[str, bytes] = {}
    left_out: dict[str, str] = {}
    with report.ProgressLine(options.interrupts.check) as progress:
        material = _material(options, progress)
        for kind in dict.fromkeys(asked or _FIGURES):
            progress(f"drawing: {kind}")
            try:
                files |= plots.PAPER[kind](material)
            except (InputError, SimulationError) as error:
                # Figures requested by name must exist.
                if kind in wanted:
                    raise
                left_out[kind] = str(error).removesuffix(".")
    if "machine.gif" in files and "machine.mp4" not in files:
        left_out["machine.mp4"] = "ffmpeg is not installed"
    write_all(options.output, files)
    paths = [options.output / name for name in files]
    if options.json:
        print_json({"figures": [str(path) for path in paths], "left_out": left_out})
    else:
        report.print_lines(f"Left out, {kind}: {why}." for kind, why in left_out.items())
    say_written(options, paths)
    return YES


def _material(options: argparse.Namespace, progress: report.ProgressLine) -> plots.Material:
    from zeno_orbits.report import orbit_motion, plots

    orbit, problem = _orbit_and_problem(options, progress)
    dynamics = orbit.machine(problem)
    one = orbit_motion(orbit, problem, dynamics)
    if orbit.phases_as is not None and not one.zeno_points:
        message = "must reach a Zeno point, but its period contains only other impacts"
        raise InputError(f"Argument `orbit` {message}. See `verify`.")

    return plots.Material(
        problem=problem,
        values=orbit.values(problem),
        dynamics=dynamics,
        period=orbit.period,
        one=one,
        several=orbit_motion(orbit, problem, dynamics, periods=options.periods),
        periods=options.periods,
        other=lambda: _counterpart(options, orbit, problem, progress),
    )


def _counterpart(
    options: argparse.Namespace,
    orbit: zo.Orbit,
    problem: zo.Problem,
    progress: report.ProgressLine,
) -> Any:
    """Return the motion that `--kind beside` draws beside the orbit."""
    require_phases(orbit, "--kind beside")
    return api.counterpart_for(
        orbit, problem, recording=options.data, periods=options.periods, on_progress=progress
    )


def _orbit_and_problem(
    options: argparse.Namespace, progress: report.ProgressLine
) -> tuple[zo.Orbit, zo.Problem]:
    """Return the orbit of a file, or the orbit of a problem at its default parameters."""
    if options.orbit.suffix == ".json":
        orbit = api.any_orbit(options.orbit)
        return orbit, api.problem_of(orbit, options.problem)
    if options.problem is not None:
        message = "must come with an orbit file, but a problem is named already"
        raise InputError(f"Argument `problem` {message}.")
    problem = api.known_problem(str(options.orbit))
    progress("searching for the orbit")
    return api.find_orbit(problem, on_progress=progress).unwrap(), problem
