"""The command `report`."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from zeno_orbits import api
from zeno_orbits.cli.commands.prove import add_proof, proof_of
from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    add_orbit,
    add_shared,
    print_json,
    require_phases,
    say_written,
)
from zeno_orbits.cli.outputs import PAGE, require_outputs
from zeno_orbits.cli.parsing import read_count, read_number, read_share
from zeno_orbits.report import terminal as report
from zeno_orbits.work import utf8, write_whole


def add_report(commands: Any) -> None:
    """Add the command `report`."""
    parser = add_command(
        commands,
        "report",
        _run_report,
        "verify an orbit and write the results to one page for a browser; exit code 1, stated on "
        "the page, if the orbit fails",
        [
            "zeno-orbits report orbit.json -o report.html",
            "zeno-orbits report orbit.json -o report.html --trade trade.json",
            "zeno-orbits report orbit.json -o report.html --pushes pushes.json "
            "--recovery recovery.json",
            "zeno-orbits report orbit.json -o report.html --recording run.csv --t-start 12",
        ],
    )
    add_orbit(parser)
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="PAGE.html", help="write the page here"
    )
    parser.add_argument(
        "--trade",
        type=Path,
        metavar="TRADE.json",
        help="also show the figures of this file, written by `work-precision -o`",
    )
    parser.add_argument(
        "--pushes",
        type=Path,
        metavar="PUSHES.json",
        help="also show the largest pushes of this file, written by `push -o`",
    )
    parser.add_argument(
        "--recovery",
        type=Path,
        metavar="RECOVERY.json",
        help="also show the recovery of this file, written by `recovery -o`",
    )
    parser.add_argument(
        "--recording",
        type=Path,
        metavar="DATA.csv",
        help="also compare this recording with the orbit, as `compare` does",
    )
    add_shared(parser, "t_start", type=read_number)
    add_shared(parser, "t_end", type=read_number)
    add_proof(parser)
    parser.add_argument(
        "--tolerance",
        type=read_share,
        default=1e-9,
        metavar="TOL",
        help="largest relative residual that passes (default: 1e-9)",
    )
    parser.add_argument(
        "--periods", type=read_count, default=3, metavar="N", help="periods to follow"
    )


def _run_report(options: argparse.Namespace) -> int:
    from zeno_orbits.report import load_bundle, page_of

    beside = (options.trade, options.pushes, options.recovery, options.recording, options.proof)
    given = (options.orbit, *beside)
    reads = [path for path in given if path is not None]
    require_outputs(options, {"output": PAGE}, reads=reads)
    bundle = load_bundle()
    orbit = api.any_orbit(options.orbit)
    problem = api.problem_of(orbit, options.problem)
    if options.proof is not None:
        require_phases(orbit, "--proof")
    settings = api.verification_settings(tolerance=options.tolerance, n_periods=options.periods)
    with report.ProgressLine(options.interrupts.check) as progress:
        subject = api.report_subject(
            orbit,
            problem=problem,
            settings=settings,
            trade=options.trade,
            pushes=options.pushes,
            recovery=options.recovery,
            recording=options.recording,
            t_start=options.t_start,
            t_end=options.t_end,
            on_progress=progress,
        )
        proved = proof_of(options, orbit, problem)
        progress("writing the page")
        subject = replace(
            subject,
            file=options.orbit.name,
            problem_file=options.problem or "",
            content=options.orbit.read_text(encoding="utf-8"),
            command=_command(options),
            proof=(proved.verdict(), *proved.lines()) if proved is not None and proved.ok else (),
        )
        page = utf8(page_of(subject.followed(), bundle))
    write_whole(options.output, page)
    certificate = subject.certificate
    if options.json:
        print_json(certificate.as_json() | {"page": str(options.output), "bytes": len(page)})
    else:
        report.print_verdict(certificate)
        if proved is not None:
            report.print_lines([proved.verdict()])
    say_written(options, [options.output])
    return YES if certificate.passed and (proved is None or proved.ok) else NO


def _command(options: argparse.Namespace) -> tuple[str, ...]:
    """Return the words of this command, defaults left out."""
    words = ["zeno-orbits", "report", options.orbit.name, "-o", options.output.name]
    if options.problem is not None:
        words += ["--problem", options.problem]
    if options.trade is not None:
        words += ["--trade", options.trade.name]
    if options.pushes is not None:
        words += ["--pushes", options.pushes.name]
    if options.recovery is not None:
        words += ["--recovery", options.recovery.name]
    if options.recording is not None:
        words += ["--recording", options.recording.name]
    if options.t_start is not None:
        words += ["--t-start", f"{options.t_start:g}"]
    if options.t_end is not None:
        words += ["--t-end", f"{options.t_end:g}"]
    if options.proof is not None:
        words += ["--proof", options.proof.name]
    if options.tolerance != 1e-9:
        words += ["--tolerance", f"{options.tolerance:g}"]
    if options.periods != 3:
        words += ["--periods", str(options.periods)]
    return tuple(words)
