"""The commands `search` and `verify` for orbits of events."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    YES,
    numbers_of,
    place_of,
    print_json,
    run_resumable,
    say_written,
)
from zeno_orbits.cli.outputs import JSON, require_outputs
from zeno_orbits.cli.parsing import over_ranges, read_wish, require_starts_inside
from zeno_orbits.cli.search_output import lacking_orbits, ranking
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report
from zeno_orbits.work import ExecutionPlan

if TYPE_CHECKING:
    import zeno_orbits as zo

_ABOUT_IMPACTS = ("impacts", "bounce")
"""Words of the objectives of orbits of events alone."""
_OVER_RANGES = ("energy", "peak")
"""Words of the objectives that orbits of events alone have over uncertain ranges."""

_VERIFY = {
    "proof": "--proof",
    "rigorous": "--rigorous",
}
"""Options of `verify` that need an orbit of a machine with one stop."""


def asks_for_events(options: argparse.Namespace) -> bool:
    """Return True if a wish needs an orbit of events: a bound such as ``stop.impact_speed``.

    A chosen method or section also needs it.

    Args:
        options: The command line.
    """
    words = (*_ABOUT_IMPACTS, *(_OVER_RANGES if options.uncertain else ()))
    about = options.objective is not None and options.objective.word in words
    about |= options.method is not None or options.section is not None
    return about or any("." in name for name in options.bounds)


def search_events(options: argparse.Namespace, problem: zo.Problem) -> int:
    """Find, verify and print the orbit of a machine, and return the exit code.

    Without an objective, bounds and ranges it is the orbit to which the machine settles.

    Args:
        options: The command line.
        problem: A problem with several stops or switches, or one with a wish about events.

    Raises:
        SimulationError: If no motion settles.
    """
    import zeno_orbits as zo

    require_outputs(options, {"output": JSON})
    varies = options.vary or options.objective or options.bounds or options.uncertain
    varies = varies or options.method
    if varies or options.candidates > 1:
        return _search_gains(options, problem, varies=bool(varies))
    with report.ProgressLine(options.interrupts.check) as progress:
        orbit = api.find_event_orbit(
            problem,
            **numbers_of(problem, options),
            near=options.near,
            start=options.start or None,
            section=options.section,
            shape=options.shape,
            until=options.until,
            settings=api.simulation_settings(options.engine),
            on_progress=progress,
        )
        certificate = api.verify(orbit, problem=problem, on_progress=progress)
    passes = certificate.passed and (certificate.stable or options.allow_unstable)
    if options.output is not None and passes:
        zo.write_orbit(orbit, options.output)
    if options.json:
        print_json(orbit.as_json())
        return YES if passes else NO
    _print_orbit(options, orbit, certificate, passes=passes)
    if options.accuracy is not None:
        report.print_error_estimate(certificate.orbit_error)
    return YES if passes else NO


def _print_orbit(
    options: argparse.Namespace, orbit: zo.Orbit, certificate: zo.OrbitCertificate, *, passes: bool
) -> None:
    """Print an orbit with its verdict, where it was written, and its states if they are asked."""
    report.print_event_orbit(orbit, certificate)
    _say_output(options, certificate, passes=passes)
    if options.states:
        report.print_event_states(orbit)


def _search_gains(options: argparse.Namespace, problem: zo.Problem, *, varies: bool) -> int:
    """Find the best orbits in given ranges, verify and print them, and return the exit code."""
    numbers = numbers_of(problem, options)
    free = {**api.free_gains(problem, numbers["gains"] or {}), **options.vary} if varies else {}
    require_starts_inside(options.set, free)
    wish = options.objective or read_wish("nearest")
    objective = wish.objective(problem, free)
    if options.uncertain or wish.word == "robustness":
        objective = over_ranges(wish, objective, options.uncertain)
    place = place_of(options)

    def work(checkpoint: Path | None, progress: report.ProgressLine) -> zo.SearchResult:
        return api.search_event_gains(
            options.problem,
            vary=free,
            **numbers,
            near=options.near,
            start=options.start or None,
            objective=objective,
            bounds=tuple(options.bounds.values()),
            section=options.section,
            shape=options.shape,
            until=options.until,
            n_starts=options.starts,
            seed=options.seed,
            candidates=options.candidates,
            method=None if options.method is None else api.search_method(options.method),
            allow_unstable=options.allow_unstable,
            settings=api.simulation_settings(options.engine),
            plan=ExecutionPlan(place=place, checkpoint=checkpoint),
            on_progress=progress,
        )

    def finish(result: zo.SearchResult) -> int:
        return _answer(options, result, varies=bool(free))

    # With nothing free there is one start, which is done or not.
    return run_resumable(options, work, finish, keep=bool(free))


def _answer(options: argparse.Namespace, result: zo.SearchResult, *, varies: bool) -> int:
    """Print the result of a search, write its orbit, and return the exit code."""
    import zeno_orbits as zo

    orbit, certificate = result.orbit, result.certificate
    if orbit is None or certificate is None:
        if options.json:
            print_json({"found": False, "search": result.as_json()})
        else:
            report.print_event_search(result)
        return NO
    passes = certificate.passed and (certificate.stable or options.allow_unstable)
    if options.output is not None and passes:
        zo.write_orbit(orbit, options.output)
    lacking = lacking_orbits(options, result) if options.candidates > 1 else []
    if options.json:
        told = {"notes": lacking} if lacking else {}
        print_json(orbit.as_json() | {"search": result.as_json()} | ranking(options, result) | told)
        return YES if passes else NO
    _print_orbit(options, orbit, certificate, passes=passes)
    if options.candidates > 1:
        report.print_candidates(result)
    if varies:
        report.print_event_search(result)
    report.print_lines(lacking)
    if options.accuracy is not None:
        report.print_error_estimate(certificate.orbit_error)
    return YES if passes else NO


def _say_output(
    options: argparse.Namespace, certificate: zo.OrbitCertificate, *, passes: bool
) -> None:
    """Print that the orbit was written, or why it was not."""
    outputs = [] if options.output is None else [options.output]
    if passes:
        say_written(options, outputs)
    elif certificate.passed:
        left = f", and {options.output} was not written" if outputs else ""
        report.print_lines([f"The orbit is not stable{left}: --allow-unstable accepts the orbit."])


def require_verifiable(options: argparse.Namespace) -> None:
    """Refuse options of `verify` that need an orbit of a machine with one stop.

    Args:
        options: The command line.

    Raises:
        InputError: If one is given.
    """
    _refuse(options, _VERIFY)
    if options.model == "reference":
        raise InputError(needs_one_stop("--model reference"))


def _refuse(options: argparse.Namespace, names: dict[str, str]) -> None:
    for name, option in names.items():
        if getattr(options, name, None):
            raise InputError(needs_one_stop(option))


def needs_one_stop(option: str) -> str:
    """Return the message that refuses an option for orbits of events."""
    return (
        f"Option `{option}` needs a machine with one stop, no switch and no kink, in this version: "
        "leave it out."
    )
