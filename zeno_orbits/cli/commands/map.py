"""The command `map`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    add_place,
    add_problem,
    add_shared,
    add_start,
    hand_out,
    numbers_of,
    place_of,
    run_resumable,
)
from zeno_orbits.cli.outputs import JSON, PICTURE, require_outputs
from zeno_orbits.cli.parsing import AxisRange, Once, read_axis, read_grid, read_number, read_seed
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    from zeno_orbits.maps import Axis, Boundary, ParameterMap, Plane


def add_map(commands: Any) -> None:
    """Add the command `map`."""
    parser = add_command(
        commands,
        "map",
        _run_map,
        "classify the attractor on a grid of two gains, parameters or initial states; exit code 1 "
        "if no point of the map has a Zeno periodic orbit",
        [
            "zeno-orbits map motor_pendulum --x Kp=1:5 --y Kd=-2:0 -o map.json --plot map.png",
            "zeno-orbits map motor_pendulum --x restitution=0:0.5 --y Kd=-1.6:-0.4 --grid 20x30",
            "zeno-orbits map motor_pendulum --orbit orbit.json --x theta1=-1:1 --y dtheta1=-12:12 "
            "--grid 26x26 --refine 3 --plot basin.png",
            "zeno-orbits map motor_pendulum --x Kp=1:5 --y R=2:4 --scheduler tcp://host:8786",
        ],
    )
    add_problem(parser)
    add_start(parser)
    for side in ("x", "y"):
        more = ": a gain, a parameter or an initial state"
        add_shared(parser, side, more, action=Once, type=read_axis, required=True)
    parser.add_argument(
        "--grid",
        dest="points",
        type=read_grid,
        default=(50, 50),
        metavar="NxM",
        help="number of points along x and y, if the axes give none (default: 50x50)",
    )
    parser.add_argument(
        "--orbit",
        type=Path,
        metavar="ORBIT.json",
        help="start at the first state of this orbit, at its gains and parameters, except for "
        "the axes, --set and --start",
    )
    parser.add_argument(
        "--refine",
        type=read_seed,
        default=0,
        metavar="N",
        help="halve the cells along boundaries N times, and compute no other points (default: 0)",
    )
    add_shared(
        parser,
        "until",
        " (default: 300 periods of the problem's clock, or 115 of its slowest oscillation, more "
        "above a restitution of 0.5)",
        type=read_number,
    )
    add_place(parser)
    parser.add_argument(
        "--plot", dest="picture", type=Path, metavar="FILE", help="draw the map here"
    )
    parser.add_argument(
        "--boundaries",
        type=Path,
        metavar="FAMILY.json",
        help="draw the curves of this file of `continue --parameter2` on top",
    )
    parser.add_argument("-o", "--output", type=Path, help="write the map here, as JSON")


def _run_map(options: argparse.Namespace) -> int:
    from zeno_orbits.maps import (
        chunk_of,
        map_of_plane,
        read_boundaries,
        require_plane,
        require_refinement,
        write_map,
    )
    from zeno_orbits.work import ExecutionPlan

    plane = require_plane(_plane(options))
    require_refinement(plane, options.refine)
    reads = [path for path in (options.orbit, options.boundaries) if path is not None]
    require_outputs(options, {"output": JSON, "picture": PICTURE}, reads=reads)
    boundaries: tuple[Boundary, ...] = ()
    if options.boundaries is not None:
        if options.picture is None:
            raise InputError("Argument `boundaries` needs --plot.")
        boundaries = read_boundaries(options.boundaries, plane.x.name, plane.y.name)
    place, chunk = place_of(options), chunk_of(plane)

    def work(checkpoint: Path | None, progress: report.ProgressLine) -> ParameterMap:
        plan = ExecutionPlan(place=place, chunk=chunk, checkpoint=checkpoint)
        return map_of_plane(plane, plan, refine=options.refine, on_progress=progress)

    def finish(found: ParameterMap) -> int:
        hand_out(
            options,
            found,
            report.print_map,
            lambda plots: plots.plot_map(found, boundaries=boundaries),
            write_map,
        )
        return YES if found.has_zeno else NO

    return run_resumable(options, work, finish)


def _plane(options: argparse.Namespace) -> Plane:
    from zeno_orbits.model import locate_problem

    return api.map_plane(
        options.problem,
        x=_axis(options.x, options.points[0]),
        y=_axis(options.y, options.points[1]),
        **numbers_of(locate_problem(options.problem).load(), options),
        start=options.start or None,
        orbit=options.orbit,
        until=options.until,
    )


def _axis(asked: AxisRange, count: int) -> Axis:
    from zeno_orbits.maps import Axis

    lower, upper = asked.range.box
    return Axis(name=asked.range.name, lower=lower, upper=upper, count=asked.points or count)
