"""The command `scatter`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from zeno_orbits import api
from zeno_orbits.cli.options import YES, add_command, add_orbit, add_spread, hand_out
from zeno_orbits.cli.outputs import JSON, PICTURE, require_outputs
from zeno_orbits.cli.parsing import read_count, read_seed
from zeno_orbits.report import terminal as report

_USUAL = {"restitution": 0.07}
"""Scatter of the restitution that drops of marbles show."""


def add_scatter(commands: Any) -> None:
    """Add the command `scatter`."""
    parser = add_command(
        commands,
        "scatter",
        _run_scatter,
        "compute how an orbit scatters if its restitution differs from impact to impact",
        [
            "zeno-orbits scatter orbit.json",
            "zeno-orbits scatter orbit.json --spread restitution=0.03 --plot scatter.png",
        ],
    )
    add_orbit(parser)
    add_spread(parser, "restitution=0.07")
    parser.add_argument(
        "--periods",
        type=read_count,
        default=1000,
        metavar="N",
        help="number of simulated periods (default: 1000)",
    )
    parser.add_argument(
        "--seed", type=read_seed, default=0, metavar="N", help="seed of the scatter (default: 0)"
    )
    parser.add_argument(
        "--plot",
        dest="picture",
        type=Path,
        metavar="FILE",
        help="draw the distributions here",
    )
    parser.add_argument("-o", "--output", type=Path, help="write the result here, as JSON")


def _run_scatter(options: argparse.Namespace) -> int:
    require_outputs(options, {"output": JSON, "picture": PICTURE}, reads=[options.orbit])
    settings = api.scatter_settings(periods=options.periods, seed=options.seed)
    with report.ProgressLine(options.interrupts.check) as progress:
        found = api.scatter(
            options.orbit,
            options.spread or _USUAL,
            problem=options.problem,
            settings=settings,
            on_progress=progress,
        )
    hand_out(options, found, report.print_scatter, lambda plots: plots.plot_scatter(found))
    return YES
