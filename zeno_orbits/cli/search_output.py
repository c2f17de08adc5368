"""Output of the command `search`: the orbit and how it was reached, or why none was found."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from zeno_orbits.cli.options import NO, YES, print_json, say_written
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    from zeno_orbits.model import Problem
    from zeno_orbits.orbits import Bound
    from zeno_orbits.search import Objective, SearchResult

_LOCAL = "One start led there, so the optimum may be local; --candidates 3 tries more starts."


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchNotes:
    """The question of a search, and what is known of its numbers.

    Attributes:
        free: Name to range of what was free.
        objective: The objective, of what is free.
        bounds: The bounds that the orbit had to keep.
        held: Parameters that are derived from free ones but were held.
        far: Sentences that may explain a failure, one for each number far from the problem's own.
    """

    free: Mapping[str, tuple[float, float]]
    objective: Objective
    bounds: Sequence[Bound]
    held: Sequence[str]
    far: Sequence[str]


def answer(
    options: argparse.Namespace, problem: Problem, result: SearchResult, notes: SearchNotes
) -> int:
    """Print what a search found, write its orbit, and return the exit code.

    Args:
        options: The command line.
        problem: The problem.
        result: The result of the search.
        notes: What was asked.
    """
    from zeno_orbits.orbits import asked_and_reached, write_orbit
    from zeno_orbits.verification import certified

    if result.orbit is None:
        _say_no(options, problem, result, notes)
        return NO
    options.interrupts.check()
    best = result.candidates[0]
    certificate = best.certificate
    if certificate is None:
        raise InputError("Argument `accept` must give a certificate, but it gave none.")
    asked = asked_and_reached(notes.bounds, best.extents)
    certificate = replace(certificate, asked=tuple(asked))
    orbit = certified(result.orbit, certificate)
    if options.output is not None:
        write_orbit(orbit, options.output)
    said = on_the_optimum(options, problem, result, notes)
    if options.json:
        told = {"notes": [*filter(None, [result.detail]), *said]} if notes.free else {}
        print_json(orbit.as_json() | _ranking(options, result) | told)
        return YES
    report.print_search(result)
    if options.candidates > 1:
        report.print_candidates(result)
    report.print_orbit(problem, orbit, certificate, result.attempts[0].parameters)
    report.print_lines(said)
    report.print_bounds(certificate.asked)
    if notes.held:
        report.print_lines([f"Derived, and held at their initial values: {', '.join(notes.held)}."])
    if options.accuracy is not None:
        report.print_error_estimate(certificate.orbit_error)
    report.print_verdict(certificate)
    say_written(options, [] if options.output is None else [options.output])
    return YES


def on_the_optimum(
    options: argparse.Namespace, problem: Problem, result: SearchResult, notes: SearchNotes
) -> list[str]:
    """Return what was asked and reached, and what more there may be, as sentences.

    Args:
        options: Options of the command.
        problem: The problem.
        result: The search's answer.
        notes: What is free and what is wished.
    """
    from zeno_orbits.search import at_ends

    if not notes.free:
        return []
    best, objective = result.candidates[0], notes.objective
    said = report.objective_reached(objective.wish, best.extents, objective.quantities)
    if objective.quantities and best.score > objective.least:
        one = best.starts == 1
        said.append(_LOCAL if one else f"{best.starts} of {len(result.attempts)} starts led there.")
    if objective.quantities or objective.goal:
        values = best.orbit.values(problem)
        said += at_ends(problem, values, notes.free, objective.goal)
    lacking = options.candidates - len(result.candidates)
    if lacking > 0:
        led = f"{sum(one.starts for one in result.candidates)} of {len(result.attempts)} starts"
        said.append(f"{lacking} fewer than asked: {led} led to an orbit, no other one among them.")
    return said


def _say_no(
    options: argparse.Namespace, problem: Problem, result: SearchResult, notes: SearchNotes
) -> None:
    """Print why nothing was found, what may help, and what an older output still holds."""
    older = options.output is not None and options.output.exists()
    hints = _levers(options, problem, result, notes)
    if options.json:
        print_json(
            {
                "found": False,
                "status": result.status.value,
                "detail": result.detail,
                "scan": result.scan,
                "attempts": _attempts(result),
                "far": list(notes.far),
                "try": hints,
                "older_output": older,
            }
        )
        return
    report.print_search(result)
    report.print_lines(notes.far)
    report.print_whole(f"Try: {hint}" for hint in hints)
    if older:
        report.print_lines([f"{options.output} was not written: what it holds is older."])


def _levers(
    options: argparse.Namespace, problem: Problem, result: SearchResult, notes: SearchNotes
) -> list[str]:
    """Return the options and commands that may lead to an orbit where there was none."""
    from zeno_orbits.search import SearchStatus

    found: list[str] = []
    if result.status is SearchStatus.NO_GUESS:
        found.append("--start STATE=VALUE, to simulate from elsewhere.")
        if result.undecided:
            found.append("--until T, to wait longer for a motion to repeat.")
        found.append(f"{map_command(problem, options, notes)}, to see where orbits are.")
        if options.shape is not None:
            found.append("no --shape, to take the orbits that motions settle to.")
    if result.repels:
        found.append("--allow-unstable, to take an orbit that does not attract.")
    if notes.bounds:
        kept = ", ".join(f"{bound.name}={bound.text}" for bound in notes.bounds)
        found.append(f"a wider --keep than {kept}.")
    if notes.free and result.status is not SearchStatus.NO_GUESS:
        ranges = ", ".join(f"{name}={low:g}:{high:g}" for name, (low, high) in notes.free.items())
        found.append(f"wider ranges than {ranges} (--gain, --free).")
    if not notes.free and problem.gains:
        found.append("fewer --fix, so that gains are searched.")
    return found


def map_command(problem: Problem, options: argparse.Namespace, notes: SearchNotes) -> str:
    """Return the command that maps the first two numbers that a search is about.

    Args:
        problem: The problem.
        options: Options of the search, whose numbers the map keeps.
        notes: What is free.
    """
    from zeno_orbits.search import free_gains

    around = {q.name: (q.default / 2, 2 * q.default) for q in problem.parameters if q.default}
    others = {**free_gains(problem), **around, "restitution": (0.0, 0.9)}
    axes = list({**notes.free, **others})[:2]
    ranges = {**others, **notes.free}
    words = [f"zeno-orbits map {options.problem}"]
    for side, name in zip("xy", axes, strict=False):
        low, high = ranges[name]
        words.append(f"--{side} {name}={low:g}:{high:g}")
    for option, given in (("gain", options.fix), ("set", options.set)):
        words += [f"--{option} {name}={x:g}" for name, x in given.items() if name not in axes]
    return " ".join(words)


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
