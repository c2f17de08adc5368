"""The command `search`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits import report
from zeno_orbits.arguments import read_boxes, read_count, read_numbers, read_objective, read_seed
from zeno_orbits.cli.shared import (
    NO,
    YES,
    add_accuracy,
    add_command,
    add_scene,
    print_json,
    require_engine,
    say_written,
    verification_of,
)
from zeno_orbits.errors import InputError
from zeno_orbits.files import require_writable

if TYPE_CHECKING:
    from zeno_orbits.orbit import ZenoOrbit
    from zeno_orbits.problem import Problem
    from zeno_orbits.search import SearchResult


def add_search(commands: Any) -> None:
    """Add the command `search`."""
    parser = add_command(
        commands,
        "search",
        _run_search,
        "find gains and initial states of a Zeno periodic orbit, and verify it",
        [
            "zeno-orbits search motor_pendulum -o orbit.json",
            "zeno-orbits search motor_pendulum --fix Kp=4 --fix Kd=-1",
            "zeno-orbits search motor_pendulum --gain Kp=1:5 --fix Kd=-1 --objective period=1.83",
            "zeno-orbits search motor_pendulum --set R=2 --objective energy",
        ],
    )
    add_scene(parser)
    parser.add_argument(
        "--gain",
        action="append",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="search a gain in this range; one that is not named is searched in the scene's range",
    )
    parser.add_argument(
        "--fix",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="hold a gain; may be repeated",
    )
    parser.add_argument(
        "--objective",
        default="nearest",
        metavar="WISH",
        help=(
            "nearest (to the scene's gains), nearest:NAME=VALUE,..., period=SECONDS, "
            "amplitude=VALUE, or energy"
        ),
    )
    parser.add_argument(
        "--allow-unstable", action="store_true", help="take an orbit that does not attract, too"
    )
    add_accuracy(parser)
    parser.add_argument("--starts", type=read_count, default=12, metavar="N", help="random starts")
    parser.add_argument("--seed", type=read_seed, default=0, help="of the random starts")
    parser.add_argument("-o", "--output", type=Path, help="write the verified orbit here")


def _run_search(options: argparse.Namespace) -> int:
    from zeno_orbits.compiled import bind
    from zeno_orbits.models import compiled_model
    from zeno_orbits.problem import load_problem
    from zeno_orbits.search import SearchSettings, search_gains
    from zeno_orbits.verify import verify

    problem = load_problem(options.problem)
    fixed = read_numbers(options.fix, "fix")
    boxes = read_boxes(options.gain)
    both = sorted(set(fixed) & set(boxes))
    if both:
        message = f"Argument `gain` must not name a fixed gain, but it names {', '.join(both)}."
        raise InputError(message)
    setting = problem.setting(gains=fixed, parameters=read_numbers(options.set, "set"))
    scene_boxes = {gain.name: (gain.lower, gain.upper) for gain in problem.gains}
    free = {name: box for name, box in {**scene_boxes, **boxes}.items() if name not in fixed}
    objective = read_objective(options.objective, problem, free)
    if options.output is not None:
        require_writable(options.output)
    settings = SearchSettings(n_starts=options.starts, seed=options.seed)
    if options.accuracy is not None:
        settings = settings.for_accuracy(options.accuracy)
    verification = verification_of(options, 1e-9)
    require_engine(options, bind(compiled_model(problem), setting.values()))
    found: dict[str, Any] = {}

    def accept(orbit: ZenoOrbit) -> str:
        certificate = verify(orbit, problem, settings=verification)
        if not certificate.passed or not (certificate.stable or options.allow_unstable):
            radius = certificate.spectral_radius
            unstable = f"The orbit does not attract: its spectral radius is {radius:.4g}."
            return unstable if certificate.passed else certificate.verdict()
        error = certificate.orbit_error
        if options.accuracy is not None and not error <= options.accuracy:
            return f"Its numbers are certain to {error:.1e} only."
        found["certificate"] = certificate
        return ""

    with report.Progress(options.interrupts.check) as progress:
        result = search_gains(
            problem,
            setting,
            free_gains=free,
            objective=objective,
            settings=settings,
            accept=accept,
            on_progress=progress.tell,
        )
    return _finish_search(options, problem, result, found)


def _finish_search(
    options: argparse.Namespace, problem: Problem, result: SearchResult, found: dict[str, Any]
) -> int:
    from zeno_orbits.orbit import write_orbit
    from zeno_orbits.verify import certified

    if result.orbit is None:
        if options.json:
            print_json(
                {
                    "found": False,
                    "status": result.status.value,
                    "detail": result.detail,
                    "attempts": [
                        {"gains": dict(a.gains), "status": a.status.value, "detail": a.detail}
                        for a in result.attempts
                    ],
                }
            )
        else:
            report.print_search(result)
        return NO
    options.interrupts.check()
    certificate = found["certificate"]
    orbit = certified(result.orbit, certificate)
    if options.output is not None:
        write_orbit(orbit, options.output)
    if options.json:
        print_json(orbit.as_json())
    else:
        report.print_search(result)
        report.print_orbit(problem, orbit, certificate)
        if options.accuracy is not None:
            report.print_error_made(certificate.orbit_error)
        report.print_verdict(certificate)
        say_written(options, [] if options.output is None else [options.output])
    return YES
