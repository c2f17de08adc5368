"""The command `prove`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    orbit_and_problem,
    print_json,
    require_outputs,
    say_written,
)
from zeno_orbits.cli.parsing import read_interval, read_share
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report


def add_prove(commands: Any) -> None:
    """Add the command `prove`."""
    parser = add_command(
        commands,
        "prove",
        _run_prove,
        "prove that the orbit of a file exists, as a theorem with a certificate",
        [
            "zeno-orbits prove orbit.json -o proof.json",
            "zeno-orbits prove orbit.json --radius 1e-6",
            "zeno-orbits prove orbit.json --over Kp=2.5:1e-8",
        ],
    )
    parser.add_argument("orbit", metavar="ORBIT.json", type=Path, help="an orbit file")
    parser.add_argument(
        "--problem", metavar="FILE.py", help="the problem's file, if it is not a bundled one"
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="PROOF.json", help="write the certificate here"
    )
    parser.add_argument(
        "--radius",
        type=read_share,
        metavar="R",
        help="radius of the box, per size of a coordinate; found by itself by default",
    )
    parser.add_argument(
        "--over",
        type=read_interval,
        action="append",
        default=[],
        metavar="NAME=VALUE:RADIUS",
        help="prove it for all values of a gain or parameter in an interval at once",
    )


def _run_prove(options: argparse.Namespace) -> int:
    from zeno_orbits.api import prove

    require_outputs(options, pictures=(), reads=(options.orbit,))
    orbit, problem = orbit_and_problem(options)
    known = {**orbit.gains, **orbit.parameters}
    over: dict[str, float] = {}
    for name, value, radius in options.over:
        problem.place(name, argument="over")
        if known[name] != value:
            wanted = f"must have the orbit's own `{name}`, {known[name]!r}, in the middle"
            raise InputError(f"Argument `over` {wanted}, but it has {value!r}.")
        over[name] = radius
    with report.ProgressLine(options.interrupts.check) as progress:
        proof = prove(
            orbit, problem=problem, over=over, radius=options.radius, on_progress=progress
        )
    if proof.proved and options.output is not None:
        from zeno_orbits.proof import write_proof

        write_proof(proof.certificate, options.output)
    if options.json:
        print_json(proof.as_json())
    else:
        report.print_lines(proof.lines())
        if proof.proved and options.output is not None:
            say_written(options, [options.output])
    return YES if proof.proved else NO
