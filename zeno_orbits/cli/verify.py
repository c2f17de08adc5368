"""The command `verify`."""

from __future__ import annotations

import argparse
from dataclasses import replace
from math import isfinite
from typing import Any

from zeno_orbits.cli.options import (
    NO,
    YES,
    add_accuracy,
    add_command,
    add_orbit,
    orbit_and_problem,
    print_json,
    require_engine,
    verification_of,
)
from zeno_orbits.cli.parsing import read_count, read_share
from zeno_orbits.cli.prove import add_proof, proof_of
from zeno_orbits.report import terminal as report


def add_verify(commands: Any) -> None:
    """Add the command `verify`."""
    parser = add_command(
        commands,
        "verify",
        _run_verify,
        "verify an orbit file by independent forward integration",
        [
            "zeno-orbits verify orbit.json",
            "zeno-orbits verify orbit.json --model reference --tolerance 1e-8 --json",
        ],
    )
    add_orbit(parser)
    parser.add_argument(
        "--tolerance",
        type=read_share,
        metavar="TOL",
        help="largest relative residual that passes; by default the accuracy, if given, or 1e-9",
    )
    add_proof(parser)
    add_accuracy(parser)
    parser.add_argument(
        "--periods",
        type=read_count,
        default=3,
        metavar="N",
        help="number of periods to integrate; 3 by default",
    )
    parser.add_argument(
        "--model",
        choices=("derived", "reference"),
        default="derived",
        help="integrate the model derived from energies, or the problem's hand-written one",
    )


def _run_verify(options: argparse.Namespace) -> int:
    from zeno_orbits.verification import problem_dynamics, verify

    tolerance = options.tolerance
    orbit, problem = orbit_and_problem(options)
    settings = replace(
        verification_of(options, 1e-9 if tolerance is None else tolerance),
        n_periods=options.periods,
        use_reference=options.model == "reference",
    )
    if tolerance is not None:
        settings = replace(settings, tolerance=tolerance)
    proved = proof_of(options, orbit, problem)
    dynamics = problem_dynamics(orbit, problem, use_reference=settings.use_reference)
    require_engine(options, dynamics)
    with report.ProgressLine(options.interrupts.check) as progress:
        certificate = verify(
            orbit, problem, settings=settings, dynamics=dynamics, on_progress=progress
        )
    if options.json:
        error = certificate.orbit_error
        accuracy = {"error": error if isfinite(error) else None} if options.accuracy else {}
        claims = (
            {} if proved is None else {"proof": {"proved": proved.ok, "says": proved.verdict()}}
        )
        print_json(certificate.as_json() | accuracy | claims)
    else:
        report.print_certificate(certificate)
        report.print_verdict(certificate)
        if proved is not None:
            report.print_lines([proved.verdict()])
        if options.accuracy is not None:
            report.print_error_estimate(certificate.orbit_error)
    shown = proved is None or proved.ok
    certain = options.accuracy is None or certificate.orbit_error <= options.accuracy
    if certificate.passed and not certain and not options.json:
        report.print_lines([f"That exceeds the requested accuracy {options.accuracy:.0e}."])
    return YES if certificate.passed and certain and shown else NO
