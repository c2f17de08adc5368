"""The command `push`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    YES,
    add_command,
    add_orbit,
    add_place,
    add_shared,
    hand_out,
    place_of,
    run_resumable,
)
from zeno_orbits.cli.outputs import JSON, PICTURE, require_outputs
from zeno_orbits.cli.parsing import read_count, read_direction, read_number, read_share
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    import zeno_orbits as zo


def add_push(commands: Any) -> None:
    """Add the command `push`."""
    parser = add_command(
        commands,
        "push",
        _run_push,
        "find the largest impulses from which the motion returns to an orbit",
        [
            "zeno-orbits push orbit.json -o pushes.json --plot pushes.png",
            "zeno-orbits push orbit.json --directions theta1=1,theta2=1 --phases 4 --error 1e-4",
        ],
    )
    add_orbit(parser)
    add_shared(
        parser,
        "directions",
        " (default: each coordinate alone) (repeatable)",
        action="append",
        type=read_direction,
    )
    parser.add_argument(
        "--phases",
        type=read_count,
        default=12,
        metavar="N",
        help="number of equidistant phases of the period (default: 12)",
    )
    parser.add_argument(
        "--steps",
        type=read_count,
        default=96,
        metavar="N",
        help="number of impulses in the scan of each direction (default: 96)",
    )
    parser.add_argument(
        "--reach",
        type=read_number,
        default=2.0,
        metavar="X",
        help="end of the scan, in units of the impulse that gives a resting mechanism the largest "
        "kinetic energy of the orbit (default: 2)",
    )
    parser.add_argument(
        "--error",
        type=read_share,
        default=1e-3,
        metavar="REL",
        help="largest relative error of a located impulse (default: 1e-3)",
    )
    add_shared(parser, "until", " (default: as in `map`)", type=read_number)
    add_place(parser)
    parser.add_argument(
        "--plot",
        dest="picture",
        type=Path,
        metavar="FILE",
        help="draw the largest impulses over the phase here",
    )
    parser.add_argument("-o", "--output", type=Path, help="write the pushes here, as JSON")


def _run_push(options: argparse.Namespace) -> int:
    from zeno_orbits.work import ExecutionPlan

    settings = api.push_settings(
        phases=options.phases,
        steps=options.steps,
        reach=options.reach,
        error=options.error,
        until=options.until,
    )
    require_outputs(options, {"output": JSON, "picture": PICTURE}, reads=[options.orbit])
    place = place_of(options)

    def work(checkpoint: Path | None, progress: report.ProgressLine) -> zo.Pushes:
        return api.largest_push(
            options.orbit,
            problem=options.problem,
            directions=options.directions or (),
            settings=settings,
            plan=ExecutionPlan(place=place, checkpoint=checkpoint),
            on_progress=progress,
        )

    def finish(found: zo.Pushes) -> int:
        hand_out(options, found, report.print_pushes, lambda plots: plots.plot_pushes(found))
        return YES

    return run_resumable(options, work, finish)
