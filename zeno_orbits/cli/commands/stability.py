"""The command `stability`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zeno_orbits import api
from zeno_orbits.cli.options import NO, YES, add_command, add_orbit, hand_out
from zeno_orbits.cli.outputs import JSON, PICTURE, require_outputs
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.report import terminal as report


def add_stability(commands: Any) -> None:
    """Add the command `stability`."""
    parser = add_command(
        commands,
        "stability",
        _run_stability,
        "compute Floquet multipliers with errors, the return map and the time to recover",
        [
            "zeno-orbits stability orbit.json",
            "zeno-orbits stability orbit.json --json -o stability.json",
        ],
    )
    add_orbit(parser)
    parser.add_argument("-o", "--output", type=Path, help="write the result here, as JSON")
    parser.set_defaults(picture=None)


def _run_stability(options: argparse.Namespace) -> int:
    require_outputs(options, {"output": JSON, "picture": PICTURE}, reads=[options.orbit])
    with report.ProgressLine(options.interrupts.check):
        found = api.floquet_multipliers(options.orbit, problem=options.problem)
        hand_out(options, _Data(options, found), lambda _: report.print_stability(found))
    return YES if found.stable else NO


@dataclass(frozen=True)
class _Data:
    """The data of an orbit's stability, with its return map, which is computed for them alone."""

    options: argparse.Namespace
    found: Any

    def as_json(self) -> dict[str, Any]:
        try:
            known = api.return_map(self.options.orbit, problem=self.options.problem).as_json()
        except (InputError, SimulationError):
            # An orbit that is not closed, or lacks a derivative, is undecided and has no map.
            known = None
        return {**self.found.as_json(), "map": known}
