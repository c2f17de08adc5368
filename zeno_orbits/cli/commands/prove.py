"""The command `prove`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    add_place,
    add_problem_file,
    add_shared,
    place_of,
    print_json,
    read_orbit_path,
    run_resumable,
    say_written,
)
from zeno_orbits.cli.outputs import JSON, require_outputs
from zeno_orbits.cli.parsing import read_interval, read_range, read_share
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    import zeno_orbits as zo


def add_prove(commands: Any) -> None:
    """Add the command `prove`."""
    parser = add_command(
        commands,
        "prove",
        _run_prove,
        "prove that the orbit of a file exists, or check such a proof",
        [
            "zeno-orbits prove orbit.json -o proof.json",
            "zeno-orbits prove --check proof.json",
            "zeno-orbits prove orbit.json --basin",
            "zeno-orbits prove orbit.json --radius 1e-7",
            "zeno-orbits prove orbit.json --interval Kp=2.5:1e-8",
            "zeno-orbits prove orbit.json --branch Kp=6:20 -o branch.json",
        ],
    )
    parser.add_argument(
        "orbit", metavar="ORBIT.json", type=read_orbit_path, nargs="?", help="an orbit file"
    )
    add_problem_file(parser)
    parser.add_argument(
        "-o", "--output", type=Path, metavar="PROOF.json", help="write the certificate here"
    )
    parser.add_argument(
        "--check",
        type=Path,
        metavar="PROOF.json",
        help="check a certificate instead, without the prover and in another arithmetic",
    )
    parser.add_argument(
        "--radius",
        type=read_share,
        metavar="R",
        help="relative radius of the box (chosen automatically by default)",
    )
    parser.add_argument(
        "--basin",
        action="store_true",
        help="prove a set of initial states that the return map maps into itself, as large as the "
        "enclosures allow",
    )
    add_shared(parser, "interval", type=read_interval, action="append", default=[])
    add_shared(parser, "branch", type=read_range)
    add_place(parser)


def _run_prove(options: argparse.Namespace) -> int:
    if (options.orbit is None) == (options.check is None):
        given = "both are there" if options.orbit else "both are missing"
        raise InputError(f"One of `ORBIT.json` and `--check` must be given, but {given}.")
    if options.basin and options.radius is not None:
        raise InputError("Option `--radius` sets the box, but `--basin` chooses it. Remove one.")
    if options.check is not None:
        return _check(options)
    if options.branch is not None:
        return _branch(options)
    _require_no_workers(options)
    require_outputs(options, {"output": JSON}, reads=(options.orbit,))
    orbit = api.any_orbit(options.orbit)
    problem = api.problem_to_check(orbit, options.problem)
    with report.ProgressLine(options.interrupts.check) as progress:
        proof = api.prove(
            orbit,
            problem=problem,
            interval=_over(options, problem, {**orbit.gains, **orbit.parameters}),
            radius=options.radius,
            basin=options.basin,
            on_progress=progress,
        )
    sampled = api.recovery(orbit, problem=problem) if options.basin and proof.box else None
    written = options.output if proof.proved else None
    if written is not None:
        api.write_proof(proof.certificate, written)
    if options.json:
        data = proof.as_json()
        if sampled is not None:
            data["sampled_extents"] = {name: sampled.extents[name] for name in proof.box}
        print_json(data)
    else:
        report.print_lines(proof.lines())
        if options.basin and proof.proved:
            report.print_basin(proof, sampled)
        if written is not None:
            say_written(options, [written])
    return YES if proof.proved else NO


def _require_no_workers(options: argparse.Namespace) -> None:
    """Refuse options of parallel work for the proof of a single orbit."""
    for name in ("workers", "scheduler", "checkpoint"):
        if getattr(options, name) is not None:
            raise InputError(f"Option `--{name}` needs --branch: one orbit is proved at once.")


def _branch(options: argparse.Namespace) -> int:
    """Prove a branch, part by part, and print its theorem."""
    from zeno_orbits.work import ExecutionPlan, Workers

    for name, given in (
        ("interval", options.interval),
        ("radius", options.radius is not None),
        ("basin", options.basin),
    ):
        if given:
            raise InputError(f"Option `--{name}` is for a single orbit, without --branch.")
    require_outputs(options, {"output": JSON}, reads=(options.orbit,))
    orbit = api.any_orbit(options.orbit)
    problem = api.problem_to_check(orbit, options.problem)
    place, (name, box) = place_of(options), options.branch
    count = place.count if isinstance(place, Workers) else None

    def work(checkpoint: Path | None, progress: report.ProgressLine) -> zo.BranchProof:
        return api.prove_branch(
            orbit,
            (name, *box),
            problem=problem,
            plan=ExecutionPlan(place=place, checkpoint=checkpoint),
            on_progress=progress,
            on_estimate=lambda one: report.print_note(one.sentence(count or os.cpu_count() or 1)),
        )

    def finish(proof: zo.BranchProof) -> int:
        written = options.output if proof.proved else None
        if written is not None:
            api.write_proof(proof.certificate, written)
        if options.json:
            print_json(proof.as_json())
        else:
            report.print_lines(proof.lines())
            if written is not None:
                say_written(options, [written])
        return YES if proof.complete else NO

    return run_resumable(options, work, finish)


def _over(
    options: argparse.Namespace, problem: zo.Problem, known: dict[str, float]
) -> dict[str, float]:
    """Return the radii by name. The middle of each interval must be the orbit's own value."""
    over: dict[str, float] = {}
    for name, value, radius in options.interval:
        problem.place(name, argument="interval")
        if known[name] != value:
            wanted = f"must have the orbit's own `{name}`, {known[name]!r}, in the middle"
            raise InputError(f"Argument `interval` {wanted}, but it has {value!r}.")
        over[name] = radius
    return over


def _check(options: argparse.Namespace) -> int:
    """Check a certificate on both levels, and print the proved statements."""
    from dataclasses import asdict

    if api.is_branch_file(options.check):
        return _check_branch(options)
    _require_no_workers(options)
    verdict, replay = api.check_certificate(options.check, problem=options.problem)
    holds = verdict.ok and (replay is None or replay.ok)
    if options.json:
        levels = {"A": replay and {**asdict(replay), "ok": replay.ok}, "B": {"ok": verdict.ok}}
        print_json({"proved": holds, **verdict.as_json(), "levels": levels})
        return YES if holds else NO
    for claim in verdict.claims:
        report.print_lines([f"{'holds' if claim.ok else 'FAILS'}  {claim.name}: {claim.evidence}"])
    evidence = "the problem lacks a hand-written model." if replay is None else replay.verdict()
    level_b, *others = verdict.conclusions() or [verdict.verdict()]
    told = [*verdict.theorem.hypotheses(), f"Level A, replay: {evidence}"]
    report.print_lines([*told, f"Level B, inclusions: {level_b}", *others])
    what = "every claim holds" if holds else "a claim does not hold"
    report.print_lines([f"Certificate of `{verdict.problem}`: {what}."])
    return YES if holds else NO


def _check_branch(options: argparse.Namespace) -> int:
    """Check the certificate of a branch, and print the proved statements."""
    from zeno_orbits.work import ExecutionPlan

    if options.checkpoint is not None:
        raise InputError("Option `--checkpoint` is for a proof: a check keeps no finished work.")
    with report.ProgressLine(options.interrupts.check) as progress:
        verdict = api.check_branch(
            options.check,
            problem=options.problem,
            plan=ExecutionPlan(place=place_of(options)),
            on_progress=progress,
        )
    if options.json:
        print_json({"proved": verdict.ok, **verdict.as_json()})
    else:
        what = "every claim holds" if verdict.ok else "a claim does not hold"
        told = f"Certificate of a branch of `{verdict.problem}`: {what}."
        report.print_lines([*verdict.lines(), told])
    return YES if verdict.ok else NO


def add_proof(parser: argparse.ArgumentParser) -> None:
    """Add the certificate that an orbit exists."""
    parser.add_argument(
        "--proof",
        type=Path,
        metavar="PROOF.json",
        help="also check this certificate of the orbit, written by `prove -o`; takes minutes",
    )


def proof_of(
    options: argparse.Namespace, orbit: zo.Orbit, problem: zo.Problem
) -> zo.ProofVerdict | None:
    """Return the verdict on the orbit's certificate, or ``None`` without a certificate.

    Args:
        options: Options of the command, with the file of the certificate.
        orbit: The orbit that the certificate must refer to.
        problem: Its problem.
    """
    if options.proof is None:
        return None
    return api.check_certificate_of(orbit, options.proof, problem=problem)
