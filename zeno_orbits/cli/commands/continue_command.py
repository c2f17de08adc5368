"""The command `continue`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    PROBLEM_HELP,
    YES,
    add_command,
    add_place,
    add_problem,
    add_problem_file,
    add_shared,
    hand_out,
    numbers_of,
    place_of,
    run_resumable,
    write_json,
)
from zeno_orbits.cli.outputs import JSON, PICTURE, require_outputs
from zeno_orbits.cli.parsing import (
    Named,
    read_count,
    read_named_number,
    read_point_kind,
    read_range,
)
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report
from zeno_orbits.work import ExecutionPlan

if TYPE_CHECKING:
    import zeno_orbits as zo


def add_continue(commands: Any) -> None:
    """Add the command `continue`."""
    parser = add_command(
        commands,
        "continue",
        _run_continue,
        "continue an orbit in a gain or a parameter, stable or not, to the ends of its branch",
        [
            "zeno-orbits continue motor_pendulum --parameter restitution=0:0.5 --plot family.png",
            "zeno-orbits continue orbit.json --parameter Kd=-2.5:0 -o family.json",
            "zeno-orbits continue motor_pendulum --parameter Kd=-2.5:0 "
            "--parameter2 Kp=1:6 --kind fold",
            "zeno-orbits continue orbit.json --parameter Kd=-2:-1 --stabilize Kp --plot held.png",
            "zeno-orbits continue forced_oscillator --parameter A=0.05:1.5 --section impact "
            "--set c=0.1 --set stop=1 --set restitution=0.8 --start speed=1 --start cosine=1",
        ],
    )
    add_problem(parser, f"{PROBLEM_HELP}, or an orbit file to start from")
    add_problem_file(parser, "problem_file")
    add_shared(parser, "parameter", dest="range", type=read_range, required=True)
    add_shared(
        parser,
        "near",
        " (default: an orbit that a simulation converges to)",
        dest="start_orbit",
        type=Path,
    )
    add_shared(
        parser,
        "section",
        ": release, or impact for orbits without a Zeno point",
        choices=("release", "impact"),
        default="release",
    )
    add_shared(
        parser,
        "start",
        ", of a simulation that converges to the orbit, with --section impact (repeatable)",
        action=Named,
        type=read_named_number,
    )
    parser.add_argument(
        "--max-points",
        dest="steps",
        type=read_count,
        default=300,
        metavar="N",
        help="largest number of points in each direction",
    )
    parser.add_argument(
        "--stabilize",
        dest="inputs",
        action="append",
        default=[],
        metavar="INPUT",
        help="gain or parameter set once per period: the least effort that keeps each repelling "
        "orbit (repeatable)",
    )
    _add_second(parser)
    add_place(parser)
    parser.add_argument("-o", "--output", type=Path, help="write the families here, as JSON")
    parser.add_argument(
        "--plot", dest="picture", type=Path, metavar="FILE", help="draw the families here"
    )


def _add_second(parser: argparse.ArgumentParser) -> None:
    """Add the options of a second parameter."""
    add_shared(parser, "parameter2", dest="second", type=read_range)
    parser.add_argument(
        "--kind",
        dest="point",
        action="append",
        type=read_point_kind,
        default=[],
        metavar="KIND",
        help="with --parameter2: only points of this kind, for example fold (repeatable)",
    )


def _run_continue(options: argparse.Namespace) -> int:
    import zeno_orbits as zo

    problem = _problem(options)
    require_outputs(options, {"output": JSON, "picture": PICTURE})
    problem.require_range(*options.range, argument="parameter")
    if options.second is not None:
        problem.require_range(*options.second, argument="second")
    for name in options.inputs:
        problem.quantity(name, argument="inputs")
        if name == options.range.name:
            raise InputError(f"Argument `inputs`: `{name}` is the parameter of the families.")

    def work(checkpoint: Path | None, progress: report.ProgressLine) -> zo.Continuation:
        return _continued(options, problem, checkpoint, progress)

    def finish(found: zo.Continuation) -> int:
        if options.inputs:
            _hand_out_held(options, problem, found)
        else:
            hand_out(
                options,
                found,
                report.print_families,
                lambda plots: plots.plot_families(found, problem),
            )
        if not options.json:
            _print_held(options, problem, found)
        ends = [end for family in found.families for end in (family.first, family.last)]
        return NO if any(end.kind is zo.SpecialPointKind.GAVE_UP for end in ends) else YES

    return run_resumable(options, work, finish)


def _hand_out_held(
    options: argparse.Namespace, problem: zo.Problem, found: zo.Continuation
) -> None:
    """Design the feedbacks of all repelling orbits, and hand out the families with them."""
    with report.ProgressLine(options.interrupts.check) as progress:
        held = api.stabilize(found, options.inputs, problem=problem, on_progress=progress)

    def show(_: Any) -> None:
        report.print_families(found)
        report.print_held_families(held)

    hand_out(
        options,
        held,
        show,
        lambda plots: plots.plot_held_families(held, problem),
        lambda _, path: write_json(_WithFile(held), path),
    )


class _WithFile:
    """Families with feedbacks, and the problem file that they record."""

    def __init__(self, held: zo.HeldFamilies) -> None:
        self._held, self.problem_file = held, held.found.problem_file

    def as_json(self) -> dict[str, Any]:
        return self._held.as_json()


def _problem(options: argparse.Namespace) -> zo.Problem:
    """Return the problem, which an orbit file in its place names and starts."""
    if Path(options.problem).suffix != ".json":
        if options.problem_file is not None:
            raise InputError("Argument `--problem` needs an orbit file in place of PROBLEM.")
        return api.repeating_problem(options.problem)
    if options.start_orbit is not None:
        raise InputError(f"Argument `--near` is not needed: the start is `{options.problem}`.")
    options.start_orbit = Path(options.problem)
    return api.problem_of(api.any_orbit(options.start_orbit), options.problem_file)


def _print_held(options: argparse.Namespace, problem: zo.Problem, found: zo.Continuation) -> None:
    """Say which parameters keep the values that the problem would derive anew: a map does so."""
    changes = [one for one in (options.range, options.second) if one is not None]
    names = [one.name for one in changes]
    held = problem.derived_from(names, found.families[0].parameters)
    if held:
        report.print_lines([f"Derived, and held at their initial values: {', '.join(held)}."])


def _continued(
    options: argparse.Namespace,
    problem: zo.Problem,
    checkpoint: Path | None,
    progress: report.ProgressLine,
) -> zo.Continuation:
    """Return the solution branches, computed by the requested workers."""
    place = place_of(options)
    _require_agreement(options)
    name, box = options.range
    common: dict[str, Any] = {
        "settings": api.continuation_settings(options.steps),
        "plan": ExecutionPlan(place=place, checkpoint=checkpoint),
        "on_progress": progress,
    }
    if options.section == "impact":
        return api.continue_impacts(
            problem,
            (name, *box),
            start=options.start,
            **numbers_of(problem, options),
            **common,
        )
    second = None
    if options.second is not None:
        second = api.second_parameter(options.second.name, options.second.box, options.point)
    orbit = _orbit(options, problem, progress)
    return api.continue_orbit(orbit, (name, *box), problem=problem, parameter2=second, **common)


def _require_agreement(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other."""
    if options.point and options.second is None:
        raise InputError("Argument `point` needs --parameter2.")
    if options.section == "impact":
        if options.start_orbit is not None or options.second is not None or not options.start:
            message = "needs --start, and excludes --near and --parameter2"
            raise InputError(f"Argument `section` {message}.")
    elif options.start:
        raise InputError("Argument `start` needs --section impact.")


def _orbit(
    options: argparse.Namespace, problem: zo.Problem, progress: report.ProgressLine
) -> zo.Orbit:
    """Return the orbit to start from."""
    if options.start_orbit is None:
        ranges = [one for one in (options.range, options.second) if one is not None]
        return api.orbit_inside(problem, dict(ranges), numbers=options.set, on_progress=progress)
    if options.set:
        message = "cannot be combined with --set: the orbit file defines all values"
        raise InputError(f"Argument `--near {options.start_orbit}` {message}.")
    return api.any_orbit(options.start_orbit)
