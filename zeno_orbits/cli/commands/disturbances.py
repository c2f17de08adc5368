"""The commands about disturbances of an orbit: `recovery` and `scatter`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from zeno_orbits import api
from zeno_orbits.cli.options import YES, add_command, add_orbit, add_spread, hand_out
from zeno_orbits.cli.outputs import JSON, PICTURE, require_outputs
from zeno_orbits.cli.parsing import read_count, read_seed, read_share
from zeno_orbits.report import terminal as report


def add_recovery(commands: Any) -> None:
    """Add the command `recovery`."""
    parser = add_command(
        commands,
        "recovery",
        _run_recovery,
        "compute how fast a disturbance decays, and a ball whose samples return into it",
        [
            "zeno-orbits recovery orbit.json",
            "zeno-orbits recovery orbit.json --decay 1e-3 --samples 3000 -o recovery.json",
        ],
    )
    add_orbit(parser)
    parser.add_argument(
        "--decay",
        dest="part",
        type=read_share,
        default=0.01,
        metavar="SHARE",
        help="fraction to which a disturbance must decay (default: 0.01)",
    )
    parser.add_argument(
        "--samples",
        type=read_count,
        default=300,
        metavar="N",
        help="number of points that test the ball (default: 300)",
    )
    parser.add_argument(
        "--confidence",
        type=read_share,
        default=0.95,
        metavar="C",
        help="confidence of the statement about the ball (default: 0.95)",
    )
    parser.add_argument(
        "--error",
        type=read_share,
        default=0.02,
        metavar="REL",
        help="relative step of the radius (default: 0.02)",
    )
    parser.add_argument(
        "--seed", type=read_seed, default=0, metavar="N", help="seed of the points (default: 0)"
    )
    parser.add_argument("-o", "--output", type=Path, help="write the result here, as JSON")
    parser.set_defaults(picture=None)


def _run_recovery(options: argparse.Namespace) -> int:
    require_outputs(options, {"output": JSON, "picture": PICTURE}, reads=[options.orbit])
    settings = api.recovery_settings(
        part=options.part,
        samples=options.samples,
        confidence=options.confidence,
        error=options.error,
        seed=options.seed,
    )
    with report.ProgressLine(options.interrupts.check) as progress:
        found = api.recovery(
            options.orbit, problem=options.problem, settings=settings, on_progress=progress
        )
    hand_out(options, found, report.print_recovery)
    return YES


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
