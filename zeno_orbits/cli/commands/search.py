"""The command `search`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    add_accuracy,
    add_command,
    add_place,
    add_problem,
    add_shared,
    place_of,
    run_resumable,
)
from zeno_orbits.cli.outputs import JSON, require_outputs
from zeno_orbits.cli.parsing import (
    Named,
    Once,
    over_ranges,
    read_bound,
    read_count,
    read_named_number,
    read_number,
    read_range,
    read_seed,
    read_shape,
    read_wish,
    require_starts_inside,
)
from zeno_orbits.cli.search_output import answer
from zeno_orbits.report import terminal as report
from zeno_orbits.work import ExecutionPlan

if TYPE_CHECKING:
    import zeno_orbits as zo


def add_search(commands: Any) -> None:
    """Add the command `search`."""
    parser = add_command(
        commands,
        "search",
        _run_search,
        "find gains and initial states of a periodic orbit, and verify it",
        [
            "zeno-orbits search motor_pendulum -o orbit.json",
            "zeno-orbits search motor_pendulum --set Kp=4 --set Kd=-1",
            "zeno-orbits search motor_pendulum --vary Kp=1:5 --set Kd=-1 --objective period=1.83",
            "zeno-orbits search motor_pendulum --set Kp=2.5 --objective energy "
            "--bounds theta2=:1.9",
            "zeno-orbits search motor_pendulum --set Kp=2.5 --set Kd=-1 --vary R=2:4 "
            "--objective peak=current",
            "zeno-orbits search motor_pendulum --near orbit.json --set restitution=0.3",
            "zeno-orbits search motor_pendulum --set Kp=4.3 --set Kd=-1.53 --shape 'zeno*2'",
            "zeno-orbits search motor_pendulum --objective energy --candidates 3 -o orbit.json",
            "zeno-orbits search motor_pendulum --objective energy --scheduler tcp://host:8786",
            "zeno-orbits search motor_pendulum --set Kp=2.5 --vary Kd=-1.05:-0.95 "
            "--objective push --n-starts 1",
            "zeno-orbits search relay --vary U=20:24 --objective impacts=closed",
            "zeno-orbits search clapper --vary omega=0.2:0.4 --objective period=24 "
            "--method program",
        ],
    )
    add_problem(parser)
    add_shared(
        parser,
        "vary",
        " (default: every gain that --set does not fix, in the problem's range); derived "
        "parameters keep their values (repeatable)",
        action=Named,
        type=read_range,
    )
    _add_choice(parser)
    _add_method(parser)
    _add_motion(parser)
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
    _add_effort(parser)
    parser.add_argument("--states", action="store_true", help="print every state at every event")
    parser.add_argument("-o", "--output", type=Path, help="write the verified orbit here")


def _add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose among orbits."""
    more = f"; {api.objective_help()}"
    add_shared(parser, "objective", more, action=Once, type=read_wish)
    parser.add_argument(
        "--uncertain",
        action=Named,
        type=read_range,
        metavar="NAME=LOW:HIGH",
        help="range of an uncertain parameter: --objective robustness, energy, peak, impacts and "
        "bounce take the worst corner of these ranges (repeatable)",
    )
    add_shared(
        parser,
        "bounds",
        ", with an open end left empty (NAME=:1.2): a state, current or voltage at all times; "
        "period, energy, spectral_radius, or a margin of the certificate; with several stops also "
        "a quantity of an event, such as STOP.impact_speed (repeatable)",
        action=Named,
        type=read_bound,
    )


def _add_method(parser: argparse.ArgumentParser) -> None:
    """Add the option that chooses between the program and shooting."""
    add_shared(
        parser,
        "method",
        f": {', '.join(api.METHODS)}: a nonlinear program with all events, orbits that a "
        "simulation closes at every choice of the values, or the program with shooting as its "
        "check and substitute (default: auto)",
        choices=api.METHODS,
    )


def _add_motion(parser: argparse.ArgumentParser) -> None:
    """Add the options about the start, the phases and the section of an orbit."""
    add_shared(
        parser,
        "start",
        " (default: each start of the problem) (repeatable)",
        action=Named,
        type=read_named_number,
    )
    add_shared(parser, "near", ", except those that --set changes", type=Path)
    add_shared(
        parser,
        "shape",
        ": zeno (impacts accumulate, contact, release), impact (one impact, off the stop again), "
        "plastic (contact after one impact, e = 0); *N for N of them, joined by commas (zeno*2, "
        "impact*3; default: the attractor of a simulation)",
        type=read_shape,
    )
    add_shared(
        parser,
        "section",
        ", such as 'zeno NAME' or 'switch NAME'; a stop without a name is `stop` (default: chosen)",
    )


def _add_effort(parser: argparse.ArgumentParser) -> None:
    """Add the options that limit the work."""
    add_shared(
        parser,
        "until",
        " (default: about 100 periods of the problem's clock, or of its slowest oscillation; "
        "longer while it converges)",
        type=read_number,
    )
    parser.add_argument(
        "--n-starts",
        dest="starts",
        type=read_count,
        default=12,
        metavar="N",
        help="maximum number of further starts, taken from a scan of the search box",
    )
    parser.add_argument(
        "--seed", type=read_seed, default=0, help="seed of these points (default: 0)"
    )


def _run_search(options: argparse.Namespace) -> int:
    problem = api.known_problem(options.problem)
    gains, parameters = api.split_numbers(problem, options.set)
    numbers = {**gains, **parameters}
    sources = api.energy_notes(problem, numbers, options.problem)
    for note in (*sources, *api.unit_notes(problem, numbers)):
        report.print_note(note)
    free = {**api.free_gains(problem), **options.vary}
    free = {name: box for name, box in free.items() if name in options.vary or name not in gains}
    require_starts_inside(options.set, free)
    near = None if options.near is None else api.any_orbit(options.near)
    wish = options.objective or read_wish("nearest")
    objective = wish.objective(problem, free)
    if options.uncertain or wish.word == "robustness":
        objective = over_ranges(wish, objective, options.uncertain)
    bounds = tuple(options.bounds.values())
    require_outputs(options, {"output": JSON})
    settings = api.search_settings(
        horizon=options.until,
        n_starts=options.starts,
        seed=options.seed,
        candidates=options.candidates,
    )
    place = place_of(options)

    def work(checkpoint: Path | None, progress: report.ProgressLine) -> zo.SearchResult:
        return api.search_gains(
            options.problem,
            vary=free,
            gains=gains,
            parameters=parameters,
            start=options.start or None,
            objective=objective,
            bounds=bounds,
            near=near,
            section=options.section,
            shape=options.shape,
            method=None if options.method is None else api.search_method(options.method),
            settings=settings,
            allow_unstable=options.allow_unstable,
            accuracy=options.accuracy,
            engine=options.engine,
            plan=ExecutionPlan(place=place, checkpoint=checkpoint),
            on_progress=progress,
        )

    def finish(result: zo.SearchResult) -> int:
        values = api.start_values(problem, near=near, gains=gains, parameters=parameters)
        notes = api.search_notes(problem, values, free=free, objective=objective, bounds=bounds)
        return answer(options, problem, result, notes)

    # With nothing free there is one start, which is done or not.
    return run_resumable(options, work, finish, keep=bool(free))
