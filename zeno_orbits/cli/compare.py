"""The command `compare`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    add_orbit,
    add_recording,
    orbit_and_problem,
    print_json,
    require_outputs,
    say_written,
)
from zeno_orbits.report import terminal as report


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
    from zeno_orbits.experiment import compare, cut, measurable, read_recording

    require_outputs(options, files=(), reads=[options.orbit, options.data])
    orbit, problem = orbit_and_problem(options)
    with report.ProgressLine(options.interrupts.check) as progress:
        progress("reading the recording")
        recording = read_recording(options.data, only=tuple(measurable(problem)))
        recording = cut(recording, options.since, options.to)
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
