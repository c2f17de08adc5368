"""The command `rig`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.cli.options import (
    NO,
    YES,
    add_command,
    add_gains,
    add_parameters,
    add_problem_file,
    add_start,
    orbit_and_problem,
    print_json,
    require_outputs,
    say_written,
    start_of,
    values_of,
)
from zeno_orbits.cli.parsing import Named, read_count, read_named_number, read_number, read_seed
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    from zeno_orbits.experiment import RigRun, RigSettings
    from zeno_orbits.model import Problem, Rig

_PARTS = ("friction", "gears", "bridge", "controller", "sensors")

_CYCLES = 10
_UNTIL = 10.0


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
    add_gains(parser)
    add_parameters(parser)
    add_start(parser)
    parser.add_argument(
        "--part",
        action=Named,
        type=read_named_number,
        metavar="PART.NAME=VALUE",
        help="change a number of the machine, for example contact.stiffness=1e5, "
        "friction.COORDINATE.coulomb=0.01 or gears.MOTOR.play=0.01; may be repeated; "
        "docs/rig.md lists them",
    )
    parser.add_argument(
        "--only",
        action="append",
        choices=(*_PARTS, "contact"),
        metavar="PART",
        help=f"use this part only, beside the contact ({', '.join(_PARTS)}, or only contact); may "
        "be repeated; by default all parts",
    )
    parser.add_argument(
        "--without",
        action="append",
        default=[],
        choices=_PARTS,
        metavar="PART",
        help="leave out a part; may be repeated",
    )
    parser.add_argument(
        "--exact", action="store_true", help="follow the bridge's pulses edge by edge"
    )
    parser.add_argument("--seed", type=read_seed, default=0, metavar="N", help="seed of the noise")
    parser.add_argument(
        "--cycles",
        type=read_count,
        metavar="N",
        help=f"number of settled cycles, with an orbit; {_CYCLES} by default",
    )
    parser.add_argument(
        "--until",
        type=read_number,
        metavar="T",
        help=f"end of the simulation, with a problem [s]; {_UNTIL:g} by default",
    )
    parser.add_argument(
        "-o", "--output", type=Path, help="write the measured signals here, as a recording"
    )


def _run_rig(options: argparse.Namespace) -> int:
    near_orbit = options.target.endswith(".json")
    reads = [Path(options.target)] if near_orbit else []
    require_outputs(options, pictures=(), reads=reads)
    return _near_orbit(options) if near_orbit else _from_start(options)


def _near_orbit(options: argparse.Namespace) -> int:
    from zeno_orbits.experiment import compare_cycles, rig_cycles

    for name in ("gain", "set", "start", "until"):
        if getattr(options, name) not in (None, {}):
            has = "whose periods --cycles counts" if name == "until" else "which has its own"
            raise InputError(f"Argument `{name}` must not be given with an orbit, {has}.")
    options.orbit = Path(options.target)
    orbit, problem = orbit_and_problem(options)
    rig = _rig_of(options, problem)
    with report.ProgressLine(options.interrupts.check) as progress:
        settled = rig_cycles(
            orbit,
            problem,
            rig,
            cycles=options.cycles or _CYCLES,
            seed=options.seed,
            settings=_settings(rig),
            on_progress=progress,
        )
    comparison = compare_cycles(orbit, problem, settled)
    if options.json:
        print_json(comparison.as_json())
    else:
        report.print_rig(comparison, problem.amplitude_of)
    _write(options, settled.run, problem)
    return NO if comparison.drifting else YES


def _from_start(options: argparse.Namespace) -> int:
    from zeno_orbits.experiment import simulate_rig
    from zeno_orbits.model import load_problem

    for name in ("cycles", "problem"):
        if getattr(options, name) is not None:
            raise InputError(f"Argument `{name}` must come with an orbit, but there is none.")
    problem = load_problem(options.target)
    values = values_of(problem, options)
    own_time = problem.dynamics(values).own.time
    until = _UNTIL * own_time if options.until is None else options.until
    rig = _rig_of(options, problem)
    with report.ProgressLine(options.interrupts.check) as progress:
        run = simulate_rig(
            problem,
            values,
            rig,
            start_of(problem, options),
            until,
            seed=options.seed,
            settings=_settings(rig),
            on_progress=progress,
        )
    touches = [
        {"start": t.start, "end": min(t.end, until), "approach_rate": t.approach_rate}
        for t in run.touches
    ]
    if options.json:
        print_json({"problem": problem.name, "source": "simulated", "contacts": touches})
    else:
        report.print_contacts(problem.name, touches)
    _write(options, run, problem)
    return YES


def _rig_of(options: argparse.Namespace, problem: Problem) -> Rig:
    from dataclasses import replace

    from zeno_orbits.experiment import default_rig
    from zeno_orbits.model import PART_NAMES, Switching, rig_with_numbers, without_parts

    left_out = options.without
    if options.only is not None:
        if "sensors" in options.only and "controller" not in options.only:
            wanted = "must name the controller with the sensors, which it reads"
            raise InputError(f"Argument `only` {wanted}, but it does not.")
        left_out = [*left_out, *(name for name in PART_NAMES if name not in options.only)]
    rig = rig_with_numbers(without_parts(default_rig(problem), left_out), options.part)
    if not options.exact:
        return rig
    if rig.bridge is None:
        raise InputError("Argument `exact` must come with a bridge, but the machine has none.")
    return replace(rig, bridge=replace(rig.bridge, switching=Switching.EXACT))


def _settings(rig: Rig) -> RigSettings:
    """Return an accuracy that noise and rounding by sensors leave worth having."""
    from zeno_orbits.experiment import RigSettings
    from zeno_orbits.integrators import Tolerance

    if rig.controller is None:
        return RigSettings()
    return RigSettings(tolerance=Tolerance(relative=1e-8, absolute=1e-10))


def _write(options: argparse.Namespace, run: RigRun, problem: Problem) -> None:
    if options.output is not None:
        from zeno_orbits.experiment import recording_of, write_recording

        notes: Mapping[str, str] = {"seed": str(options.seed)}
        write_recording(recording_of(run, problem, notes), options.output)
        say_written(options, [options.output])
