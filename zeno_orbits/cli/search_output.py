"""Output of the command `search`: the orbit and how it was reached, or why none was found."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from zeno_orbits.cli.options import NO, YES, print_json, say_written
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    from zeno_orbits.model import Problem
    from zeno_orbits.orbits import Bound
    from zeno_orbits.search import Objective, SearchResult

_LOCAL = "One start led there, so the optimum may be local; --candidates 3 tries more starts."


def answer(
    options: argparse.Namespace,
    problem: Problem,
    result: SearchResult,
    objective: Objective | None,
    bounds: Sequence[Bound],
    held: Sequence[str],
    far: Sequence[str] = (),
) -> int:
    """Print what a search found, write its orbit, and return the exit code.

    Args:
        options: The command line.
        problem: The problem.
        result: The result of the search.
        objective: The objective, if anything was free.
        bounds: The bounds that the orbit had to keep.
        held: Parameters that are derived from free ones but were held.
        far: Sentences that may explain a failure, one for each number far from the problem's own.
    """
    from zeno_orbits.orbits import asked_and_reached, write_orbit
    from zeno_orbits.verification import certified

    if result.orbit is None:
        if options.json:
            print_json(
                {
                    "found": False,
                    "status": result.status.value,
                    "detail": result.detail,
                    "attempts": _attempts(result),
                    "far": list(far),
                }
            )
        else:
            report.print_search(result)
            report.print_lines(far)
        return NO
    options.interrupts.check()
    best = result.candidates[0]
    certificate = best.certificate
    if certificate is None:
        raise InputError("Argument `accept` must give a certificate, but it gave none.")
    certificate = replace(certificate, asked=tuple(asked_and_reached(bounds, best.extents)))
    orbit = certified(result.orbit, certificate)
    if options.output is not None:
        write_orbit(orbit, options.output)
    if options.json:
        print_json(orbit.as_json() | _ranking(options, result))
    else:
        report.print_search(result)
        if options.candidates > 1:
            report.print_candidates(result)
        report.print_orbit(problem, orbit, certificate, result.attempts[0].parameters)
        if objective is not None:
            report.print_objective(objective.wish, best.extents, objective.quantities)
            if objective.quantities and best.starts == 1:
                report.print_lines([_LOCAL])
        report.print_bounds(certificate.asked)
        if held:
            report.print_lines([f"Derived, and held at their initial values: {', '.join(held)}."])
        if options.accuracy is not None:
            report.print_error_estimate(certificate.orbit_error)
        report.print_verdict(certificate)
        say_written(options, [] if options.output is None else [options.output])
    return YES


def _attempts(result: SearchResult) -> list[dict[str, Any]]:
    return [
        {
            "gains": dict(a.gains),
            "parameters": dict(a.parameters),
            "status": a.status.value,
            "detail": a.detail,
        }
        for a in result.attempts
    ]


def _ranking(options: argparse.Namespace, result: SearchResult) -> dict[str, Any]:
    """Return the ranked orbits and the failures, if more than one was asked for."""
    if options.candidates == 1:
        return {}
    from zeno_orbits.search import SearchStatus
    from zeno_orbits.verification import certified

    ranked = [
        {
            "score": one.score,
            "orbit": (
                one.orbit if one.certificate is None else certified(one.orbit, one.certificate)
            ).as_json(),
        }
        for one in result.candidates
    ]
    pairs = zip(result.attempts, _attempts(result), strict=True)
    failures = [data for attempt, data in pairs if attempt.status is not SearchStatus.FOUND]
    return {"candidates": ranked, "failures": failures}
