"""Output of the command `search`: the orbit and how it was reached, or why none was found."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.options import NO, YES, print_json, say_written
from zeno_orbits.errors import InputError, counted
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    import zeno_orbits as zo

_LOCAL = "One start led there, so the optimum may be local; --candidates 3 tries more starts."


def answer(
    options: argparse.Namespace,
    problem: zo.Problem,
    result: zo.SearchResult,
    notes: api.SearchNotes,
) -> int:
    """Print the result of a search, write its orbit, and return the exit code.

    Args:
        options: The command line.
        problem: The problem.
        result: The result of the search.
        notes: Requested objective and bounds.
    """
    import zeno_orbits as zo

    if result.orbit is None:
        _say_no(options, problem, result, notes)
        return NO
    options.interrupts.check()
    orbit, certificate = result.orbit, result.candidates[0].certificate
    if certificate is None:
        raise InputError("Argument `accept` must give a certificate.")
    if options.output is not None:
        zo.write_orbit(orbit, options.output)
    said = on_the_optimum(options, problem, result, notes)
    if options.json:
        told: dict[str, Any] = {}
        if notes.free or options.candidates > 1:
            told["notes"] = [*filter(None, [result.detail]), *said]
            told["search"] = result.as_json()
        print_json(orbit.as_json() | ranking(options, result) | told)
        return YES
    free = result.attempts[0].parameters
    report.print_summary(problem, orbit, certificate, free)
    report.print_verdict(certificate)
    say_written(options, [] if options.output is None else [options.output])
    if result.detail:
        report.print_lines([result.detail])
    if options.candidates > 1:
        report.print_candidates(result)
    if options.states:
        report.print_orbit(problem, orbit, certificate, free)
    objective = notes.objective
    if notes.free and (objective.is_measured or objective.prescribes or objective.goal):
        report.print_reached(result, objective.wish)
    report.print_lines(said)
    report.print_bounds(certificate.asked)
    if notes.held:
        report.print_lines([f"Derived, and held at their initial values: {', '.join(notes.held)}."])
    if options.accuracy is not None:
        report.print_error_estimate(certificate.orbit_error)
    if len(result.attempts) > 1 or result.scan:
        report.print_search(result)
    report.print_solver(result)
    return YES


def on_the_optimum(
    options: argparse.Namespace,
    problem: zo.Problem,
    result: zo.SearchResult,
    notes: api.SearchNotes,
) -> list[str]:
    """Return possible improvements of the objective, and missing orbits, as sentences.

    Args:
        options: Options of the command.
        problem: The problem.
        result: The result of the search.
        notes: Decision variables and objective.
    """
    if not notes.free:
        return lacking_orbits(options, result)
    best, objective = result.candidates[0], notes.objective
    said: list[str] = []
    if objective.quantities and best.score > objective.least:
        one = best.starts == 1
        said.append(_LOCAL if one else f"{best.starts} of {len(result.attempts)} starts led there.")
    if objective.quantities or objective.goal:
        said += notes.at_ends(problem, best.orbit)
    return said + lacking_orbits(options, result)


def lacking_orbits(options: argparse.Namespace, result: zo.SearchResult) -> list[str]:
    """Return the number of missing orbits and the starts that were used, as a sentence.

    Args:
        options: Options of the command.
        result: The result of the search.
    """
    lacking = options.candidates - len(result.candidates)
    if lacking <= 0:
        return []
    starts = counted(len(result.attempts), "start")
    states = f"{result.n_states} initial states at the values of the best orbit"
    found = counted(len(result.candidates), "orbit")
    return [f"{lacking} fewer than requested: {starts} and {states} led to {found}."]


def _say_no(
    options: argparse.Namespace,
    problem: zo.Problem,
    result: zo.SearchResult,
    notes: api.SearchNotes,
) -> None:
    """Print the reason of a failed search, possible remedies, and the state of an older output."""
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
                "search": result.as_json(),
            }
        )
        return
    report.print_search(result)
    report.print_bounds(result.asked)
    report.print_lines(notes.far)
    report.print_whole(f"Try: {hint}" for hint in hints)
    if older:
        report.print_lines([f"{options.output} was not written: it holds an older result."])


def _levers(
    options: argparse.Namespace,
    problem: zo.Problem,
    result: zo.SearchResult,
    notes: api.SearchNotes,
) -> list[str]:
    """Return the options and commands that may lead to an orbit after a failed search."""
    found: list[str] = []
    if result.status.name == "NO_EVENTS":
        found.append("--start STATE=VALUE, for a motion that reaches a stop or a switch.")
        found.append("--until T, to simulate for longer.")
    elif result.status.name == "NO_GUESS" and not notes.driven:
        found.append("a problem with a drive or a clock: without one, motion comes to rest.")
    elif result.status.name == "NO_GUESS":
        found.append("--start STATE=VALUE, to simulate from elsewhere.")
        if result.undecided:
            found.append("--until T, to wait longer for a motion to repeat.")
        found.append(f"{map_command(problem, options, notes)}, to see where orbits are.")
        if options.shape is not None:
            found.append("omit --shape, to accept any orbit that the simulation converges to.")
    found += [
        f'--bounds "{bound.name}={bound.text}", to keep a least speed.'
        for bound in result.least_speeds
    ]
    if result.repels:
        found.append("--allow-unstable, to accept an unstable orbit.")
    if notes.bounds:
        kept = ", ".join(f"{bound.name}={bound.text}" for bound in notes.bounds)
        found.append(f"a wider --bounds than {kept}.")
    if notes.free and not result.status.lacks_motion:
        ranges = ", ".join(f"{name}={low:g}:{high:g}" for name, (low, high) in notes.free.items())
        found.append(f"wider ranges than {ranges} (--vary).")
    if not notes.free and problem.gains:
        found.append("no --set for a gain, so that the search varies it.")
    return found


def map_command(problem: zo.Problem, options: argparse.Namespace, notes: api.SearchNotes) -> str:
    """Return the command that maps the first two parameters of a search.

    Args:
        problem: The problem.
        options: Options of the search, whose values the map keeps.
        notes: Decision variables.
    """
    around = {q.name: (q.default / 2, 2 * q.default) for q in problem.parameters if q.default}
    others = {**api.free_gains(problem), **around}
    if "restitution" in problem.names:
        others["restitution"] = (0.0, 0.9)
    axes = list({**notes.free, **others})[:2]
    ranges = {**others, **notes.free}
    words = [f"zeno-orbits map {options.problem}"]
    for side, name in zip("xy", axes, strict=False):
        low, high = ranges[name]
        words.append(f"--{side} {name}={low:g}:{high:g}")
    words += [f"--set {name}={x:g}" for name, x in options.set.items() if name not in axes]
    return " ".join(words)


def _attempts(result: zo.SearchResult) -> list[dict[str, Any]]:
    return [
        {
            "gains": dict(a.gains),
            "parameters": dict(a.parameters),
            "status": a.status.value,
            "detail": a.detail,
        }
        for a in result.attempts
    ]


def ranking(options: argparse.Namespace, result: zo.SearchResult) -> dict[str, Any]:
    """Return the ranked orbits and the failures as plain data, if several orbits were requested.

    Args:
        options: Options of the command.
        result: The result of the search.
    """
    if options.candidates == 1:
        return {}
    ranked = [{"score": one.score, "orbit": one.orbit.as_json()} for one in result.candidates]
    pairs = zip(result.attempts, _attempts(result), strict=True)
    failures = [data for attempt, data in pairs if attempt.status.name != "FOUND"]
    return {"candidates": ranked, "failures": failures}
