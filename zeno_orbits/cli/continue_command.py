"""The command `continue`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    add_gains,
    add_place,
    add_problem,
    hand_out,
    place_of,
    require_outputs,
    run_resumable,
    start_of,
    values_of,
)
from zeno_orbits.cli.parsing import (
    Named,
    point_kinds,
    read_count,
    read_named_number,
    read_point_kind,
    read_range,
)
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    from zeno_orbits.continuation import Continuation, ContinuationSettings, Crew
    from zeno_orbits.model import Problem, ProblemFile
    from zeno_orbits.orbits import ZenoOrbit


def add_continue(commands: Any) -> None:
    """Add the command `continue`."""
    parser = add_command(
        commands,
        "continue",
        _run_continue,
        "follow the family of an orbit in a gain or a parameter, stable or not, to its ends",
        [
            "zeno-orbits continue motor_pendulum --in restitution=0:0.5 --picture family.png",
            "zeno-orbits continue motor_pendulum --in Kd=-2.5:0 --from orbit.json -o family.json",
            "zeno-orbits continue motor_pendulum --in Kd=-2.5:0 --second Kp=1:6 --point fold",
            "zeno-orbits continue forced_oscillator --in A=0.05:1.5 --section impact "
            "--set c=0.1 --set stop=1 --set restitution=0.8 --start speed=1 --start cosine=1",
        ],
    )
    add_problem(parser)
    add_gains(parser)
    parser.add_argument(
        "--in",
        dest="range",
        type=read_range,
        required=True,
        metavar="NAME=LOW:HIGH",
        help="the gain or parameter to vary, and its range, which must contain the start",
    )
    parser.add_argument(
        "--from",
        dest="start_orbit",
        type=Path,
        metavar="ORBIT.json",
        help="start from this orbit and its values; by default from one that a motion settles to",
    )
    parser.add_argument(
        "--section",
        choices=("release", "impact"),
        default="release",
        help="the event at which a period begins: impact, for orbits without a Zeno point",
    )
    parser.add_argument(
        "--start",
        action=Named,
        type=read_named_number,
        metavar="STATE=VALUE",
        help="with --section impact: initial state of a motion that settles to the orbit",
    )
    parser.add_argument(
        "--steps", type=read_count, default=300, metavar="N", help="most steps in each direction"
    )
    parser.add_argument(
        "--second",
        type=read_range,
        metavar="NAME=LOW:HIGH",
        help="also follow the special points in this second parameter",
    )
    parser.add_argument(
        "--point",
        action="append",
        type=read_point_kind,
        default=[],
        metavar="KIND",
        help="with --second: only points of this kind, for example fold; may be repeated",
    )
    add_place(parser)
    parser.add_argument("-o", "--output", type=Path, help="write the families here, as JSON")
    parser.add_argument("--picture", type=Path, help="draw the families here")


def _run_continue(options: argparse.Namespace) -> int:
    from zeno_orbits.continuation import SpecialPointKind
    from zeno_orbits.model import locate_problem

    problem_file = locate_problem(options.problem)
    problem = problem_file.load()
    require_outputs(options)
    problem.require_range(*options.range, argument="in")
    if options.second is not None:
        problem.require_range(*options.second, argument="second")

    def work(checkpoint: Path | None, progress: report.ProgressLine) -> Continuation:
        return _continued(options, problem_file, checkpoint, progress)

    def finish(found: Continuation) -> int:
        hand_out(
            options, found, report.print_families, lambda plots: plots.plot_families(found, problem)
        )
        if not options.json:
            _print_held(options, problem, found)
        ends = [end for family in found.families for end in (family.first, family.last)]
        return NO if any(end.kind is SpecialPointKind.GAVE_UP for end in ends) else YES

    return run_resumable(options, work, finish)


def _print_held(options: argparse.Namespace, problem: Problem, found: Continuation) -> None:
    """Say which parameters keep the values that the problem would derive anew: a map does so."""
    changes = [one for one in (options.range, options.second) if one is not None]
    names = [one.name for one in changes]
    held = problem.derived_from(names, found.families[0].parameters)
    if held:
        report.print_lines([f"Derived, and held at their initial values: {', '.join(held)}."])


def _continued(
    options: argparse.Namespace,
    problem_file: ProblemFile,
    checkpoint: Path | None,
    progress: report.ProgressLine,
) -> Continuation:
    """Return what was asked for, by the workers that were asked for."""
    from zeno_orbits.continuation import ContinuationSettings, Crew, FamilySteps
    from zeno_orbits.work import Plan, open_pool

    settings = ContinuationSettings(steps=FamilySteps(most=options.steps))
    plan = Plan(place=place_of(options), checkpoint=checkpoint)
    _require_agreement(options)
    with open_pool(plan.place) as pool:
        crew = Crew(problem_file=problem_file, plan=plan, pool=pool, on_progress=progress)
        return _asked(options, problem_file.load(), settings, crew)


def _require_agreement(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other."""
    if options.point and options.second is None:
        raise InputError("Argument `point` must come with --second, but it does not.")
    if options.section == "impact":
        if options.start_orbit is not None or options.second is not None or not options.start:
            message = "must come with --start, and without --from and --second"
            raise InputError(f"Argument `section` {message}, but it does not.")
    elif options.start:
        raise InputError("Argument `start` must come with --section impact, but it does not.")


def _asked(
    options: argparse.Namespace,
    problem: Problem,
    settings: ContinuationSettings,
    crew: Crew,
) -> Continuation:
    from zeno_orbits.continuation import SecondParameter, continue_impacts, continue_orbit

    name, box = options.range
    if options.section == "impact":
        return continue_impacts(
            problem,
            values_of(problem, options),
            start_of(problem, options),
            name,
            box,
            settings=settings,
            on_progress=crew.on_progress,
            crew=crew,
        )
    second = None
    if options.second is not None:
        kinds = tuple(options.point) or tuple(point_kinds().values())
        second = SecondParameter(name=options.second.name, box=options.second.box, kinds=kinds)
    return continue_orbit(
        problem,
        _orbit(options, problem, crew),
        name,
        box,
        second=second,
        settings=settings,
        on_progress=crew.on_progress,
        crew=crew,
    )


def _orbit(options: argparse.Namespace, problem: Problem, crew: Crew) -> ZenoOrbit:
    """Return the orbit to start from."""
    from zeno_orbits.continuation import start_orbit, values_inside
    from zeno_orbits.orbits import read_orbit

    if options.start_orbit is None:
        asked = [one for one in (options.range, options.second) if one is not None]
        given = options.gain | options.set
        values = values_inside(problem, values_of(problem, options), dict(asked), given)
        return start_orbit(problem, values, on_progress=crew.on_progress)
    if options.gain or options.set:
        message = "cannot be combined with --gain or --set: the orbit file defines all values"
        raise InputError(f"Argument `from` {message}.")
    return read_orbit(options.start_orbit)
