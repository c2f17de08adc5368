"""The command `search`."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.cli.options import (
    add_accuracy,
    add_command,
    add_place,
    add_problem,
    place_of,
    require_engine,
    run_resumable,
    verification_of,
)
from zeno_orbits.cli.parsing import (
    Named,
    Once,
    read_bound,
    read_count,
    read_named_number,
    read_number,
    read_range,
    read_seed,
    read_shape,
    read_wish,
)
from zeno_orbits.cli.search_output import SearchNotes, answer
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report
from zeno_orbits.work import require_writable

if TYPE_CHECKING:
    from zeno_orbits.model import ParameterValues, Problem
    from zeno_orbits.orbits import ZenoOrbit
    from zeno_orbits.search import SearchResult


def add_search(commands: Any) -> None:
    """Add the command `search`."""
    from zeno_orbits.search import objective_help

    parser = add_command(
        commands,
        "search",
        _run_search,
        "find gains and initial states of a periodic orbit, and verify it",
        [
            "zeno-orbits search motor_pendulum -o orbit.json",
            "zeno-orbits search motor_pendulum --fix Kp=4 --fix Kd=-1",
            "zeno-orbits search motor_pendulum --gain Kp=1:5 --fix Kd=-1 --objective period=1.83",
            "zeno-orbits search motor_pendulum --fix Kp=2.5 --objective energy --keep theta2=:1.9",
            "zeno-orbits search motor_pendulum --fix Kp=2.5 --fix Kd=-1 --free R=2:4 "
            "--objective peak=current",
            "zeno-orbits search motor_pendulum --from orbit.json --set restitution=0.3",
            "zeno-orbits search motor_pendulum --fix Kp=4.3 --fix Kd=-1.53 --shape 'zeno*2'",
            "zeno-orbits search motor_pendulum --objective margin --candidates 3 -o orbit.json",
            "zeno-orbits search motor_pendulum --objective energy --scheduler tcp://host:8786",
        ],
    )
    add_problem(parser)
    parser.add_argument(
        "--gain",
        action=Named,
        type=read_range,
        metavar="NAME=LOW:HIGH",
        help="search a gain in this range; by default every gain in the problem's range",
    )
    parser.add_argument(
        "--free",
        action=Named,
        type=read_range,
        metavar="NAME=LOW:HIGH",
        help="also search a physical parameter (or a gain) in this range; parameters derived from "
        "it keep their values",
    )
    parser.add_argument(
        "--fix",
        action=Named,
        type=read_named_number,
        metavar="NAME=VALUE",
        help="fix a gain; may be repeated",
    )
    parser.add_argument(
        "--objective",
        action=Once,
        type=read_wish,
        metavar="WISH",
        help=objective_help(),
    )
    parser.add_argument(
        "--keep",
        action=Named,
        type=read_bound,
        metavar="NAME=LOWER:UPPER",
        help="bounds that the orbit must keep, an open end left empty (NAME=:1.2): a state, "
        "current or voltage at all times; period, energy, spectral_radius, or a margin of the "
        "certificate; may be repeated",
    )
    parser.add_argument(
        "--start",
        action=Named,
        type=read_named_number,
        metavar="STATE=VALUE",
        help="simulate from this state, others zero, to find orbits; by default from each start of "
        "the problem",
    )
    parser.add_argument(
        "--from",
        dest="near",
        type=Path,
        metavar="ORBIT.json",
        help="start from this orbit and its values, except those that --set or --fix change",
    )
    parser.add_argument(
        "--shape",
        type=read_shape,
        metavar="SHAPE",
        help="phases of a period: zeno (impacts accumulate, the stop holds, and lets go), impact "
        "(one impact, off the stop again), plastic (the stop holds at once, e = 0); *N for N of "
        "them, joined by commas (zeno*2, impact*3); by default what a simulation settles to",
    )
    parser.add_argument(
        "--candidates",
        type=read_count,
        default=1,
        metavar="N",
        help="continue until this many different orbits are verified, and rank them",
    )
    parser.add_argument(
        "--allow-unstable", action="store_true", help="also accept an unstable orbit"
    )
    add_accuracy(parser)
    add_place(parser)
    parser.add_argument(
        "--until",
        type=read_number,
        metavar="T",
        help="longest time for a motion to repeat [s]; by default some hundred periods of "
        "the problem's clock, or of its slowest oscillation",
    )
    parser.add_argument(
        "--starts",
        type=read_count,
        default=12,
        metavar="N",
        help="most starts after the first, of places all over the box the most promising ones",
    )
    parser.add_argument(
        "--seed", type=read_seed, default=0, help="seed of these places; 0 by default"
    )
    parser.add_argument("-o", "--output", type=Path, help="write the verified orbit here")


def _run_search(options: argparse.Namespace) -> int:
    from zeno_orbits.api import Verified
    from zeno_orbits.model import locate_problem
    from zeno_orbits.search import (
        SearchSettings,
        SettlingSettings,
        StartWorkers,
        far_from_own,
        search_gains,
    )
    from zeno_orbits.work import Plan

    problem_file = locate_problem(options.problem)
    problem = problem_file.load()
    near = _known_orbit(options, problem)
    values, free = _numbers(options, problem, near)
    wish = options.objective or read_wish("nearest")
    objective = wish.objective(problem, free)
    bounds = tuple(options.keep.values())
    if near is not None:
        near.shape.agreed(options.shape)
    if options.output is not None:
        require_writable(options.output)
    settings = SearchSettings(
        settling=SettlingSettings(horizon=options.until),
        n_starts=options.starts,
        seed=options.seed,
        candidates=options.candidates,
    )
    if options.accuracy is not None:
        settings = settings.for_accuracy(options.accuracy)
    judge = Verified(
        problem=problem_file,
        settings=verification_of(options, 1e-9),
        allow_unstable=options.allow_unstable,
        accuracy=options.accuracy,
    )
    require_engine(options, problem.dynamics(values))
    place = place_of(options)

    def work(checkpoint: Path | None, progress: report.ProgressLine) -> SearchResult:
        plan = Plan(place=place, checkpoint=checkpoint)
        return search_gains(
            problem,
            values,
            free=free,
            objective=objective,
            bounds=bounds,
            near=near,
            settings=settings,
            accept=judge,
            on_progress=progress,
            spread=StartWorkers(problem_file=problem_file, plan=plan, tell=progress),
            shape=options.shape,
            initial_states=(options.start,) if options.start else (),
        )

    def finish(result: SearchResult) -> int:
        notes = SearchNotes(
            free=free,
            objective=objective,
            bounds=bounds,
            held=problem.derived_from(free, values.parameters),
            far=far_from_own(problem, values),
        )
        return answer(options, problem, result, notes)

    # With nothing free there is one start, which is done or not.
    return run_resumable(options, work, finish, keep=bool(free))


def _known_orbit(options: argparse.Namespace, problem: Problem) -> ZenoOrbit | None:
    from zeno_orbits.orbits import read_orbit

    if options.near is None:
        return None
    orbit = read_orbit(options.near)
    if orbit.problem != problem.name:
        message = f"must be an orbit of `{problem.name}`, but it is of `{orbit.problem}`"
        raise InputError(f"Argument `from` {message}.")
    return orbit


def _numbers(
    options: argparse.Namespace, problem: Problem, near: ZenoOrbit | None
) -> tuple[ParameterValues, dict[str, tuple[float, float]]]:
    """Return the numbers to start from and what is free."""
    from zeno_orbits.model import unknown
    from zeno_orbits.search import free_gains

    fixed, given, boxes, named = options.fix, options.set, options.gain, options.free
    gains = free_gains(problem)
    for name in boxes:
        if name not in gains:
            raise InputError(unknown("gain", name, tuple(gains)))
    for option, names in (("gain", {*boxes}), ("free", {*named})):
        for held, taken in (("fix", {*fixed}), ("set", {*given})):
            both = sorted(names & taken)
            if both and (option, held) != ("free", "set"):
                what = "a fixed gain" if held == "fix" else "what is set"
                message = f"must not name {what}, but it names {', '.join(both)}"
                raise InputError(f"Argument `{option}` {message}.")
    twice = sorted({*boxes} & {*named})
    if twice:
        message = f"must not name a gain that `gain` names, but it names {', '.join(twice)}"
        raise InputError(f"Argument `free` {message}.")
    free = {name: box for name, box in {**gains, **boxes, **named}.items() if name not in fixed}
    if near is not None:
        fixed, known = {**near.gains, **fixed}, {**near.parameters, **given}
    else:
        known = given
    values = problem.values(gains=fixed, parameters=known)
    for name in given:
        low, high = free.get(name, (-math.inf, math.inf))
        if not low <= given[name] <= high:
            message = (
                f"must start in its range [{low:g}, {high:g}], but it is set to {given[name]:g}"
            )
            raise InputError(f"Argument `{name}` {message}.")
    return values, free
