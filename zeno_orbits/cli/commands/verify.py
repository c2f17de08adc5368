"""The command `verify`."""

from __future__ import annotations

import argparse
from math import isfinite
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.commands.prove import add_proof, proof_of
from zeno_orbits.cli.options import (
    NO,
    YES,
    add_accuracy,
    add_command,
    add_orbit,
    print_json,
    require_phases,
)
from zeno_orbits.cli.parsing import read_count, read_share
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    import zeno_orbits as zo


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
            "zeno-orbits verify orbit.json --rigorous",
        ],
    )
    add_orbit(parser)
    parser.add_argument(
        "--tolerance",
        type=read_share,
        metavar="TOL",
        help="largest relative residual that passes (default: the accuracy, if given, or 1e-9)",
    )
    add_proof(parser)
    parser.add_argument(
        "--rigorous",
        action="store_true",
        help="also enclose one period by inclusions, which exclude missed events; may take minutes",
    )
    add_accuracy(parser)
    parser.add_argument(
        "--periods",
        type=read_count,
        default=3,
        metavar="N",
        help="number of periods to integrate (default: 3)",
    )
    parser.add_argument(
        "--margins", action="store_true", help="print the distances to loss of existence"
    )
    parser.add_argument("--truncation", action="store_true", help="print the truncation-order test")
    parser.add_argument("--all", action="store_true", help="print margins and truncation test")
    parser.add_argument(
        "--model",
        choices=("derived", "reference"),
        default="derived",
        help="integrate the model derived from energies, or the problem's hand-written one",
    )


def _run_verify(options: argparse.Namespace) -> int:
    orbit = api.any_orbit(options.orbit)
    _require_few_periods(options, len(orbit.events))
    is_reference = options.model == "reference"
    for option, is_asked in (
        ("--proof", options.proof),
        ("--rigorous", options.rigorous),
        ("--model reference", is_reference),
    ):
        if is_asked:
            require_phases(orbit, option)
    problem = api.problem_to_check(orbit, options.problem)
    settings = api.verification_settings(
        accuracy=options.accuracy,
        tolerance=options.tolerance,
        engine=options.engine,
        n_periods=options.periods,
        use_reference=is_reference,
    )
    proved = proof_of(options, orbit, problem)
    with report.ProgressLine(options.interrupts.check) as progress:
        certificate = api.verify(orbit, problem=problem, settings=settings, on_progress=progress)
    _require_whole_run(certificate, options)
    enclosure = _enclosure(options, orbit, problem, settings.tolerance)
    if options.json:
        error = certificate.orbit_error
        accuracy = {"error": error if isfinite(error) else None} if options.accuracy else {}
        claims = (
            {} if proved is None else {"proof": {"proved": proved.ok, "says": proved.verdict()}}
        )
        rigorous = {} if enclosure is None else {"rigorous": enclosure.as_json()}
        print_json(certificate.as_json() | accuracy | claims | rigorous)
    else:
        report.print_certificate(
            certificate,
            margins=options.margins or options.all,
            truncation=options.truncation or options.all,
        )
        if proved is not None:
            report.print_lines([proved.verdict()])
        if enclosure is not None:
            report.print_lines([enclosure.verdict()])
        if options.accuracy is not None:
            report.print_error_estimate(certificate.orbit_error)
    shown = (proved is None or proved.ok) and (enclosure is None or enclosure.enclosed)
    certain = options.accuracy is None or certificate.orbit_error <= options.accuracy
    if certificate.passed and not certain and not options.json:
        report.print_lines([f"That exceeds the requested accuracy {options.accuracy:.0e}."])
    return YES if certificate.passed and certain and shown else NO


def _require_few_periods(options: argparse.Namespace, events: int) -> None:
    """Refuse more periods than a simulation of one step per event could follow.

    Raises:
        InputError: If there are more.
    """
    import zeno_orbits as zo

    if options.periods * events > zo.SimulationSettings().most_steps:
        message = "needs more steps than a simulation may take: verify fewer periods"
        raise InputError(f"Argument `--periods {options.periods}` {message}.")


def _require_whole_run(certificate: zo.OrbitCertificate, options: argparse.Namespace) -> None:
    """Refuse more periods than the steps of a simulation allow: they say nothing of the orbit.

    Raises:
        InputError: If the simulation ended for this reason.
    """
    if "--max-steps" in certificate.trouble:
        message = "needs more steps than a simulation may take: verify fewer periods"
        raise InputError(f"Argument `--periods {options.periods}` {message}.")


def _enclosure(
    options: argparse.Namespace, orbit: zo.Orbit, problem: zo.Problem, tolerance: float
) -> zo.PeriodEnclosure | None:
    """Return the enclosure of one period, or None if it was not requested."""
    if not options.rigorous:
        return None
    with report.ProgressLine(options.interrupts.check) as progress:
        return api.enclose_period(orbit, problem=problem, tolerance=tolerance, on_progress=progress)
