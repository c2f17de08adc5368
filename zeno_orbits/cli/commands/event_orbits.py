"""The commands `search` and `verify` for orbits of events."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    YES,
    numbers_of,
    print_json,
    say_written,
)
from zeno_orbits.cli.outputs import JSON, require_outputs
from zeno_orbits.cli.parsing import over_ranges, read_wish, require_starts_inside
from zeno_orbits.cli.search_output import lacking_orbits, ranking
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    import zeno_orbits as zo

_SEARCH = {
    "shape": "--shape",
    "scheduler": "--scheduler",
    "checkpoint": "--checkpoint",
    "states": "--states",
}
"""Options of `search` that need a machine with one stop, by their names in the namespace."""

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

    A chosen method also needs it.

    Args:
        options: The command line.
    """
    words = (*_ABOUT_IMPACTS, *(_OVER_RANGES if options.uncertain else ()))
    about = options.objective is not None and options.objective.word in words
    about |= options.method is not None
    return about or any("." in name for name in options.bounds)


def search_events(options: argparse.Namespace, problem: zo.Problem) -> int:
    """Find, verify and print the orbit of a machine, and return the exit code.

    Without an objective, bounds and ranges it is the orbit to which the machine settles.

    Args:
        options: The command line.
        problem: A problem with several stops or switches, or one with a wish about events.

    Raises:
        InputError: If an option needs a machine with one stop.
        SimulationError: If no motion settles.
    """
    import zeno_orbits as zo

    _refuse(options, _SEARCH)
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
    report.print_event_orbit(orbit, certificate)
    _say_output(options, certificate, passes=passes)
    if options.accuracy is not None:
        report.print_error_estimate(certificate.orbit_error)
    return YES if passes else NO


def _search_gains(options: argparse.Namespace, problem: zo.Problem, *, varies: bool) -> int:
    """Find the best orbits in given ranges, verify and print them, and return the exit code."""
    import zeno_orbits as zo

    numbers = numbers_of(problem, options)
    free = {**api.free_gains(problem, numbers["gains"] or {}), **options.vary} if varies else {}
    require_starts_inside(options.set, free)
    wish = options.objective or read_wish("nearest")
    objective = wish.objective(problem, free)
    if options.uncertain or wish.word == "robustness":
        objective = over_ranges(wish, objective, options.uncertain)
    with report.ProgressLine(options.interrupts.check) as progress:
        result = api.search_event_gains(
            problem,
            vary=free,
            **numbers,
            near=options.near,
            start=options.start or None,
            objective=objective,
            bounds=tuple(options.bounds.values()),
            section=options.section,
            until=options.until,
            n_starts=options.starts,
            seed=options.seed,
            candidates=options.candidates,
            method=None if options.method is None else api.search_method(options.method),
            allow_unstable=options.allow_unstable,
            settings=api.simulation_settings(options.engine),
            on_progress=progress,
        )
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
    report.print_event_orbit(orbit, certificate)
    _say_output(options, certificate, passes=passes)
    if result.candidates:
        report.print_candidates(result)
    if free:
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
        f"Option `{option}` needs a machine with one stop, no switch and no kink, and no objective "
        "or bound about impacts, in this version: leave it out."
    )
