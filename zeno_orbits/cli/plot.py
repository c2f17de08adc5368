"""The command `plot`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from zeno_orbits.cli.options import (
    YES,
    add_command,
    add_orbit,
    orbit_and_problem,
    print_json,
    say_written,
)
from zeno_orbits.cli.parsing import read_count
from zeno_orbits.errors import InputError
from zeno_orbits.work import require_folder, write_all

_PICTURES = ("portraits", "time", "outputs", "zeno", "region")


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
        "the Zeno point, region d2h/dt2 < 0; may be repeated; by default all that the problem has",
    )
    parser.add_argument("--format", choices=("png", "pdf", "svg"), default="png")
    parser.add_argument(
        "--periods", type=read_count, default=1, metavar="N", help="periods to draw"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path(), help="folder for the pictures")


def _run_plot(options: argparse.Namespace) -> int:
    from zeno_orbits.report import motion_of, plots
    from zeno_orbits.verification import problem_dynamics

    orbit, problem = orbit_and_problem(options)
    dynamics = problem_dynamics(orbit, problem)
    require_folder(options.output)
    execution = motion_of(orbit, problem, dynamics, periods=options.periods)
    draw = {
        "portraits": lambda: plots.plot_portraits(problem, execution),
        "time": lambda: plots.plot_time_series(problem, execution),
        "outputs": lambda: plots.plot_outputs(problem, orbit.values(problem), execution),
        "zeno": lambda: plots.plot_zeno_zoom(problem, execution, dynamics),
        "region": lambda: plots.plot_zeno_region(problem, dynamics, execution),
    }
    rests = orbit.shape.starts_at_release
    has = {
        "outputs": bool(problem.outputs),
        "zeno": rests,
        "region": rests and plots.has_zeno_region(dynamics),
    }
    kinds = options.kind or [kind for kind in _PICTURES if has.get(kind, True)]
    if "outputs" in kinds and not problem.outputs:
        raise InputError(
            f"Argument `kind` must be a picture that `{problem.name}` has, but it has no outputs."
        )
    if not rests and {"zeno", "region"} & {*kinds}:
        wanted = "must be a picture of an orbit without a Zeno point"
        raise InputError(f"Argument `kind` {wanted}, but it is `zeno` or `region`.")
    # One that cannot be drawn leaves none behind.
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
