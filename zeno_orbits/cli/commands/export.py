"""The command `export`."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.cli.options import (
    YES,
    add_command,
    add_problem,
    add_shared,
    add_start,
    print_json,
    say_written,
    start_of,
    values_of,
)
from zeno_orbits.cli.outputs import FOLDER, require_outputs
from zeno_orbits.cli.parsing import read_number
from zeno_orbits.errors import InputError
from zeno_orbits.report import terminal as report

if TYPE_CHECKING:
    from zeno_orbits.loop import ExportedController, ExportedRun, GraphProgram
    from zeno_orbits.model import ParameterValues, Problem

_MOST_READINGS = 10_000
"""Largest number of readings in the window of a controller."""


def add_export(commands: Any) -> None:
    """Add the command `export`."""
    parser = add_command(
        commands,
        "export",
        _run_export,
        "write a problem as one C99 file that follows its executions without Python",
        [
            "zeno-orbits export motor_pendulum -o exported",
            "zeno-orbits export bouncing_ball --set restitution=0.7 --until 5 -o exported",
            "zeno-orbits export motor_pendulum --fmu -o exported",
            "zeno-orbits export sampled_pendulum --controller -o exported",
            "zeno-orbits export sampled_pendulum --controller --fmu -o exported",
        ],
    )
    add_problem(parser)
    add_start(parser)
    more = ", of the example's execution (default: 10)"
    add_shared(parser, "until", more, type=read_number)
    parser.add_argument(
        "--fmu",
        action="store_true",
        help="write a co-simulation unit of FMI 3.0 instead, its library for this machine; with "
        "--controller the unit of the controller",
    )
    parser.add_argument(
        "--controller",
        action="store_true",
        help="write the controller alone instead: law, held states and events, from readings",
    )
    parser.add_argument(
        "--persists",
        type=read_number,
        metavar="SECONDS",
        help="with --controller: duration from which a contact persists (default: 0.01)",
    )
    parser.add_argument(
        "--window",
        type=read_number,
        metavar="SECONDS",
        help="with --controller: take states at events from a parabola through the readings of "
        "this time, as `sensors.window` of the rig does (default: the reading itself)",
    )
    parser.add_argument(
        "--period",
        type=read_number,
        metavar="SECONDS",
        help="with --window: time between two readings",
    )
    parser.add_argument(
        "--input",
        action="append",
        default=[],
        metavar="NAME",
        help="with --fmu: a gain or parameter that is an input of the unit (repeatable)",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="FOLDER",
        help="write the code, its header and an example program here",
    )


def _run_export(options: argparse.Namespace) -> int:
    from zeno_orbits.loop import exported_files
    from zeno_orbits.model import load_problem

    require_outputs(options, {"output": FOLDER})
    if options.input and not options.fmu:
        raise InputError("Argument `--input` belongs to `--fmu`, which is missing.")
    if options.input and options.controller:
        raise InputError("Argument `--input` must be left out with `--controller`.")
    if options.persists is not None and not options.controller:
        raise InputError("Argument `--persists` belongs to `--controller`, which is missing.")
    if options.until is not None and options.controller:
        raise InputError("Argument `--until` must be left out with `--controller`.")
    if options.window is not None and not options.controller:
        raise InputError("Argument `--window` belongs to `--controller`, which is missing.")
    _require_readings(options.window, options.period)
    problem = load_problem(options.problem)
    values = values_of(problem, options)
    if options.controller:
        return _write_controller(problem, values, options)
    until = 10.0 if options.until is None else options.until
    if not until > 0.0:
        message = f"must be a finite, positive number of seconds, but it is {until}"
        raise InputError(f"Argument `until` {message}.")
    program, run = _exported(problem, values, options, until)
    warning = ""
    if options.fmu:
        files, warning = _unit(problem, program, run, options)
    else:
        files = {name: text.encode() for name, text in exported_files(program, run).items()}
    _hand_out(options, files, warning)
    return YES


def _require_readings(window: float | None, period: float | None) -> None:
    """Refuse a window without a period or a period without a window, and a window too large."""
    if (window is None) != (period is None):
        given, other = ("window", "period") if period is None else ("period", "window")
        raise InputError(f"Argument `--{given}` needs `--{other}`, which is missing.")
    if window is None or period is None:
        return
    for name, value in (("window", window), ("period", period)):
        if not 0.0 < value < math.inf:
            message = f"must be a positive number of seconds, but it is {value:g}"
            raise InputError(f"Argument `--{name}` {message}.")
    if window / period > _MOST_READINGS:
        message = f"holds {window / period:.3g} readings that are `--period` {period:g} s apart"
        most = f"and a controller stores at most {_MOST_READINGS}: give a shorter window"
        raise InputError(f"Argument `--window` {message}, {most}.")


def _hand_out(options: argparse.Namespace, files: Mapping[str, bytes], warning: str) -> None:
    """Write files into the folder, and print their names and a warning."""
    from zeno_orbits.work import write_all

    write_all(options.output, files)
    paths = [options.output / name for name in files]
    if options.json:
        print_json({"written": [str(path) for path in paths], "warning": warning or None})
    elif warning:
        report.print_lines([f"Warning: {warning}."])
    say_written(options, paths)


def _write_controller(
    problem: Problem, values: ParameterValues, options: argparse.Namespace
) -> int:
    """Write the C code of the controller of a machine.

    Raises:
        InputError: If the machine lacks held states, or the duration is not positive.
    """
    import numpy as np

    from zeno_orbits.loop import controller_files, controller_of

    persists = 0.01 if options.persists is None else options.persists
    if not 0.0 < persists < math.inf:
        raise InputError(f"Argument `--persists` must be positive, but it is {persists:g}.")
    state = np.array(start_of(problem, options))
    controller = controller_of(
        problem,
        values,
        state,
        persists=persists,
        window=options.window or 0.0,
        period=options.period or 0.0,
    )
    warning = ""
    if options.fmu:
        files, warning = _controller_unit(problem, controller, state)
    else:
        files = {name: text.encode() for name, text in controller_files(controller).items()}
    _hand_out(options, files, warning)
    return YES


def _controller_unit(
    problem: Problem, controller: ExportedController, state: Any
) -> tuple[dict[str, bytes], str]:
    """Return the unit of a controller as file name to bytes, and the reason without a library."""
    from zeno_orbits import __version__
    from zeno_orbits.loop import ControllerUnit, exported_controller_unit

    unit = ControllerUnit(
        controller=controller,
        state=state,
        units=dict(zip(problem.state_names, problem.state_units, strict=True)),
        generator=f"zeno_orbits {__version__}",
    )
    content, reason = exported_controller_unit(unit)
    return {f"{problem.name}_controller.fmu": content}, _without_library(reason)


def _without_library(reason: str) -> str:
    return f"the unit holds its C code only, because {reason}" if reason else ""


def _exported(
    problem: Problem, values: ParameterValues, options: argparse.Namespace, until: float
) -> tuple[GraphProgram, ExportedRun]:
    """Return the formulas of a problem, and the values and names of its exported run.

    Raises:
        InputError: If the compiled loop cannot carry out the problem.
    """
    import numpy as np

    from zeno_orbits.loop import ExportedRun, loop_trouble
    from zeno_orbits.simulation import SimulationTask, run_settings, whole_program

    graph = problem.graph_dynamics(values)
    task = SimulationTask(dynamics=graph, state=np.array(start_of(problem, options)), until=until)
    program = whole_program(graph.compiled)
    if isinstance(program, str):
        reason = loop_trouble() or program
        raise InputError(f"Argument `problem` cannot be exported: {reason}.")
    run = ExportedRun(
        name=problem.name,
        state_names=problem.state_names,
        parameter_names=tuple(problem.symbols()),
        values=np.array(values.vector),
        state=task.state,
        settings=run_settings(task),
        stop_names=graph.stop_names,
        switch_names=graph.switch_names,
    )
    return program, run


def _derived(problem: Problem, numbers: Mapping[str, float]) -> dict[str, list[str]]:
    """Return for each parameter the derived parameters that would change with it in `simulate`.

    Args:
        problem: The problem.
        numbers: Values that were given, which are not derived.
    """
    derived = [
        one.name for one in problem.parameters if one.default is None and one.name not in numbers
    ]
    found: dict[str, list[str]] = {}
    usual = problem.values(numbers=numbers).parameters
    for name, value in usual.items() if derived else ():
        shifted = value * (1.0 + _SHIFT) + (_SHIFT if value == 0.0 else 0.0)
        try:
            others = problem.values(numbers={**numbers, name: shifted}).parameters
        except InputError:
            # No derived value belongs to it: all of them depend on it.
            found[name] = [other for other in derived if other != name]
            continue
        found[name] = [one for one in derived if one != name and others[one] != usual[one]]
    return found


_SHIFT = 2.0**-20
"""Relative change of a parameter that shows which parameters are derived from it."""


def _unit(
    problem: Problem,
    program: GraphProgram,
    run: ExportedRun,
    options: argparse.Namespace,
) -> tuple[dict[str, bytes], str]:
    """Return the co-simulation unit as file name to bytes, and the reason if it lacks a library."""
    from zeno_orbits import __version__
    from zeno_orbits.loop import ExportedUnit, ParameterRange, exported_unit

    quantities = (*problem.gains, *problem.parameters)
    states = zip(problem.state_names, problem.state_units, strict=True)
    unit = ExportedUnit(
        run=run,
        units={**dict(states), **{one.name: one.unit for one in quantities}},
        meanings={one.name: one.meaning for one in quantities},
        tunable=tuple(gain.name for gain in problem.gains),
        inputs=tuple(options.input),
        # The range of a gain is the box of a search, and other values are valid.
        ranges={
            one.name: ParameterRange(*one.closed_range(), one.range_words())
            for one in problem.parameters
            if one.closed_range() != (-math.inf, math.inf)
        },
        derived=_derived(problem, options.set),
        clock=problem.model(problem.symbols()).clock,
        generator=f"zeno_orbits {__version__}",
    )
    content, reason = exported_unit(program, unit)
    return {f"{problem.name}.fmu": content}, _without_library(reason)
