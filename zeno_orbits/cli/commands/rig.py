"""The command `rig`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits import api
from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    add_problem_file,
    add_shared,
    add_start,
    add_values,
    numbers_of,
    print_json,
    require_output_of,
    say_written,
)
from zeno_orbits.cli.outputs import SAMPLES, require_outputs
from zeno_orbits.cli.parsing import Named, read_count, read_named_number, read_number, read_seed
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    import zeno_orbits as zo

_PARTS = ("friction", "gears", "bridge", "controller", "sensors")

_CYCLES = 10


def add_rig(commands: Any) -> None:
    """Add the command `rig`."""
    parser = add_command(
        commands,
        "rig",
        _run_rig,
        "simulate a problem as a real machine with a compliant stop, and compare it with an orbit",
        [
            "zeno-orbits rig orbit.json -o run.csv",
            "zeno-orbits rig orbit.json --only friction --part contact.stiffness=1e5 --cycles 3",
            "zeno-orbits rig orbit.json --without gears --part controller.delay=0.003 --seed 1",
            "zeno-orbits rig motor_pendulum --until 5 -o run.csv",
        ],
    )
    parser.add_argument(
        "target",
        metavar="ORBIT.json|PROBLEM",
        help="an orbit file (the machine settles near its orbit) or a problem (see --start)",
    )
    add_problem_file(parser)
    add_values(parser)
    add_start(parser)
    _add_parts(parser)
    parser.add_argument(
        "--rate",
        type=read_number,
        metavar="HZ",
        help="samples per second of a machine without a controller (default: 1000 per "
        "characteristic time)",
    )
    parser.add_argument(
        "--noise",
        type=read_number,
        default=0.0,
        metavar="SHARE",
        help="noise on the samples of a machine without a controller, relative to the range of "
        "each signal; contact channels stay exact (default: 0)",
    )
    parser.add_argument("--seed", type=read_seed, default=0, metavar="N", help="seed of the noise")
    parser.add_argument(
        "--cycles",
        type=read_count,
        metavar="N",
        help=f"number of settled cycles, for an orbit (default: {_CYCLES})",
    )
    add_shared(
        parser, "until", ", for a problem in place of an orbit (default: 10)", type=read_number
    )
    parser.add_argument(
        "--events", action="store_true", help="print every contact, and no summary of them"
    )
    parser.add_argument(
        "-o", "--output", type=Path, help="write the measured signals here, as a recording"
    )


def _add_parts(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose and change parts of the machine."""
    parser.add_argument(
        "--part",
        action=Named,
        type=read_named_number,
        metavar="PART.NAME=VALUE",
        help="change a parameter of the machine, for example contact.stiffness=1e5, "
        "friction.COORDINATE.coulomb=0.01 or gears.MOTOR.play=0.01 (repeatable); "
        "docs/rig.md lists them",
    )
    parser.add_argument(
        "--only",
        action="append",
        choices=(*_PARTS, "contact"),
        metavar="PART",
        help=f"use this part only, in addition to the contact ({', '.join(_PARTS)}, or only "
        "contact; repeatable, default: all parts)",
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        choices=_PARTS,
        metavar="PART",
        help="leave out a part (repeatable)",
    )
    parser.add_argument(
        "--exact-pwm",
        dest="exact",
        action="store_true",
        help="follow the bridge's pulses edge by edge",
    )


def _run_rig(options: argparse.Namespace) -> int:
    near_orbit = options.target.endswith(".json")
    reads = [Path(options.target)] if near_orbit else []
    require_outputs(options, {"output": SAMPLES}, reads=reads)
    return _near_orbit(options) if near_orbit else _from_start(options)


def _near_orbit(options: argparse.Namespace) -> int:

    for name in ("set", "start", "until"):
        if getattr(options, name) not in (None, {}):
            has = "whose periods --cycles counts" if name == "until" else "which has its own"
            raise InputError(f"Argument `{name}` must not be given with an orbit, {has}.")
    orbit = api.any_orbit(options.target)
    problem = api.problem_of(orbit, options.problem)
    rig = _rig_of(options, problem, orbit=orbit)
    cycles = options.cycles or _CYCLES
    settings = api.rig_sampling(rig, options.rate, cycles * orbit.period, noise=options.noise)
    require_output_of(options, "noise")
    if orbit.phases_as is None:
        return _near_event_orbit(options, orbit, problem, rig, settings)
    with report.ProgressLine(options.interrupts.check) as progress:
        settled = api.simulate_experiment(
            orbit,
            problem=problem,
            rig=rig,
            cycles=cycles,
            seed=options.seed,
            settings=settings,
            on_progress=progress,
        )
    comparison = api.compare_rig(orbit, problem, settled)
    if options.json:
        print_json(comparison.as_json())
    else:
        report.print_rig(comparison, problem.amplitude_of)
        if options.events:
            touches, stops = _contacts(settled.run)
            report.print_contacts(problem.name, touches, problem.gap_unit, stops)
    _write(options, settled.run, problem)
    return NO if comparison.drifting or comparison.unlike else YES


def _near_event_orbit(
    options: argparse.Namespace,
    orbit: zo.Orbit,
    problem: zo.Problem,
    rig: zo.Rig,
    settings: zo.RigSettings,
) -> int:
    with report.ProgressLine(options.interrupts.check) as progress:
        run = api.simulate_periods(
            orbit,
            problem=problem,
            rig=rig,
            periods=options.cycles or _CYCLES,
            seed=options.seed,
            settings=settings,
            on_progress=progress,
        )
    _show_contacts(options, run, problem)
    return YES


def _from_start(options: argparse.Namespace) -> int:
    for name in ("cycles", "problem"):
        if getattr(options, name) is not None:
            raise InputError(f"Argument `{name}` must come with an orbit file.")
    problem = api.known_problem(options.target)
    values = problem.values(**numbers_of(problem, options))
    rig = _rig_of(options, problem, values=values)
    until = api.rig_duration(problem, values) if options.until is None else options.until
    settings = api.rig_sampling(rig, options.rate, until, noise=options.noise)
    require_output_of(options, "noise")
    with report.ProgressLine(options.interrupts.check) as progress:
        run = api.simulate_rig(
            problem,
            rig,
            until=until,
            **numbers_of(problem, options),
            start=options.start or None,
            seed=options.seed,
            settings=settings,
            on_progress=progress,
        )
    _show_contacts(options, run, problem)
    return YES


def _contacts(run: zo.RigRun) -> tuple[list[dict[str, float]], list[str]]:
    """Return the contacts of a run, and the stop of each for a machine with several stops."""
    end = float(run.times[-1])
    touches = [
        {"start": t.start, "end": min(t.end, end), "approach_rate": t.approach_rate}
        for t in run.touches
    ]
    return touches, [t.stop for t in run.touches] if len(run.stop_names) > 1 else []


def _show_contacts(options: argparse.Namespace, run: zo.RigRun, problem: zo.Problem) -> None:
    """Print the contacts of a run, and write its recording."""
    touches, stops = _contacts(run)
    several = len(run.stop_names) > 1
    if options.json:
        contacts = (
            [one | {"stop": stop} for one, stop in zip(touches, stops, strict=True)]
            if several
            else touches
        )
        print_json({"problem": problem.name, "source": "simulated", "contacts": contacts})
    else:
        report.print_contacts(problem.name, touches, problem.gap_unit, stops, every=options.events)
        report.print_lines(f"Warning: {one}." for one in api.rig_warnings(run, problem))
    _write(options, run, problem)


def _rig_of(
    options: argparse.Namespace,
    problem: zo.Problem,
    *,
    orbit: zo.Orbit | None = None,
    values: zo.ParameterValues | None = None,
) -> zo.Rig:
    return api.machine_of(
        problem,
        orbit=orbit,
        values=values,
        numbers=options.part,
        only=options.only,
        without=options.without,
        exact=options.exact,
    )


def _write(options: argparse.Namespace, run: zo.RigRun, problem: zo.Problem) -> None:
    if options.output is not None:
        import zeno_orbits as zo

        recording = api.rig_recording(run, problem, noise=options.noise, seed=options.seed)
        zo.write_recording(recording, options.output)
        say_written(options, [options.output])
