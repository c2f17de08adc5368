"""What the commands share: exit codes, options, what the options stand for, and JSON."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from zeno_orbits.cli.parsing import read_count, read_numbers
from zeno_orbits.errors import InputError
from zeno_orbits.integrators.engines import ENGINES, Selective, engine_named
from zeno_orbits.report import terminal as report
from zeno_orbits.work.files import require_picture, require_writable

if TYPE_CHECKING:
    from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
    from zeno_orbits.model.problem import ParameterValues, Problem
    from zeno_orbits.orbits.orbit import ZenoOrbit
    from zeno_orbits.simulation.simulator import SimulationSettings
    from zeno_orbits.verification.verifier import VerificationSettings
    from zeno_orbits.work import Place

YES, NO, MISUSE, INTERRUPTED = 0, 1, 2, 130


class Parser(argparse.ArgumentParser):
    """A parser that complains in one line."""

    def error(self, message: str) -> NoReturn:
        """Exit with the code of misuse."""
        report.print_error(f"{message} (see `{self.prog} --help`)")
        sys.exit(MISUSE)


def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], int],
    summary: str,
    examples: Sequence[str],
) -> argparse.ArgumentParser:
    """Return the parser of a command, with what all commands share."""
    parser = commands.add_parser(
        name,
        help=summary,
        description=summary[0].upper() + summary[1:] + ".",
        epilog="examples:\n" + "\n".join(f"  {example}" for example in examples),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    parser.add_argument("--debug", action="store_true", help="show where an error comes from")
    return parser


def add_problem(parser: argparse.ArgumentParser) -> None:
    """Add the problem and its parameters."""
    parser.add_argument(
        "problem", metavar="PROBLEM", help="a problem's name or Python file, or problem@fidelity"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a parameter of the problem; may be repeated",
    )


def add_gain_values(parser: argparse.ArgumentParser) -> None:
    """Add the gains at which a problem is looked at."""
    parser.add_argument(
        "--gain",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a gain; may be repeated",
    )


def add_start(parser: argparse.ArgumentParser) -> None:
    """Add the initial state."""
    parser.add_argument(
        "--start",
        action="append",
        default=[],
        metavar="STATE=VALUE",
        help="initial state; what is not named is zero; by default the problem's first start",
    )


def add_accuracy(parser: argparse.ArgumentParser) -> None:
    """Add the accuracy and the engine."""
    parser.add_argument(
        "--accuracy",
        type=float,
        metavar="A",
        help="take the cheapest settings measured to reach this relative error, 1e-6 for instance, "
        "and report the error that was made; by default as accurate as is cheap",
    )
    parser.add_argument(
        "--engine",
        choices=tuple(ENGINES),
        default=next(iter(ENGINES)),
        help="the integrator; automatic steps explicitly, and implicitly where the problem is stiff; "
        "taylor needs the extra of that name",
    )


def add_place(parser: argparse.ArgumentParser) -> None:
    """Add where the work is done, and where what is finished is kept."""
    parser.add_argument(
        "--workers", type=read_count, metavar="N", help="processes; one a core by default"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="work on the Dask cluster of this scheduler instead, tcp://host:8786 for instance",
    )
    parser.add_argument(
        "--checkpoint",
        type=Path,
        metavar="FOLDER",
        help="keep what is finished here, and go on from what is kept here already; by default "
        "beside the output, until there is an answer",
    )


def place_of(options: argparse.Namespace) -> Place:
    """Return where the work is to be done."""
    from zeno_orbits.work import Cluster, Workers

    if options.scheduler is None:
        return Workers(count=options.workers)
    if options.workers is not None:
        message = "must not be given with a scheduler, which has its own workers"
        raise InputError(f"Argument `workers` {message}, but it is {options.workers}.")
    return Cluster(address=options.scheduler)


def checkpoint_of(options: argparse.Namespace) -> Path | None:
    """Return the folder that was named, else one beside the output."""
    if options.checkpoint is not None:
        return options.checkpoint
    output = options.output
    return None if output is None else output.with_name(f"{output.name}.checkpoint")


def interrupted(options: argparse.Namespace, checkpoint: Path | None) -> int:
    """Say what is kept of interrupted work, and return the exit code."""
    from zeno_orbits.work import keeps_nothing, remove_checkpoint

    if checkpoint is not None and options.checkpoint is None and keeps_nothing(checkpoint):
        # Nobody asked for it, and it would stand in the way of another work with that output.
        remove_checkpoint(checkpoint)
        checkpoint = None
    kept = "nothing was written" if checkpoint is None else f"`{checkpoint}` keeps what is finished"
    report.print_error(f"interrupted; {kept}")
    return INTERRUPTED


def add_orbit(parser: argparse.ArgumentParser) -> None:
    """Add the orbit file and its problem."""
    parser.add_argument("orbit", metavar="ORBIT.json", type=Path, help="an orbit file")
    parser.add_argument(
        "--problem", metavar="FILE.py", help="the problem, where it is not a bundled one"
    )


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Add the file of a recording, and which part of it counts."""
    parser.add_argument(
        "data",
        metavar="DATA.csv",
        type=Path,
        help="a table of signals over time; its titles are `name [unit]`, one of them `time`",
    )
    parser.add_argument(
        "--from", dest="since", type=float, metavar="T", help="leave out what is earlier [s]"
    )
    parser.add_argument("--to", type=float, metavar="T", help="leave out what is later [s]")


def values_of(problem: Problem, options: argparse.Namespace) -> ParameterValues:
    """Return the numbers that were asked for."""
    return problem.values(
        gains=read_numbers(options.gain, "gain"), parameters=read_numbers(options.set, "set")
    )


def start_of(problem: Problem, options: argparse.Namespace) -> tuple[float, ...]:
    """Return the initial state that was asked for, ``(n_x,)``."""
    named = read_numbers(options.start, "start") if options.start else problem.starts[0]
    return problem.state_vector(named)


def simulation_of(options: argparse.Namespace) -> SimulationSettings:
    """Return the simulator's settings for the engine that was asked for."""
    from zeno_orbits.simulation.simulator import SimulationSettings

    return SimulationSettings(engine=engine_named(options.engine))


def verification_of(options: argparse.Namespace, tolerance: float) -> VerificationSettings:
    """Return how to check at the accuracy that was asked for, if one was."""
    from zeno_orbits.orbits.looser_run import LOOSER
    from zeno_orbits.precision.accuracy import FINEST, settings_for
    from zeno_orbits.verification.verifier import VerificationSettings

    simulation = simulation_of(options)
    if options.accuracy is None:
        return VerificationSettings(tolerance=tolerance, simulation=simulation)
    settings_for(options.accuracy)
    # The looser of the two integrations has to reach the accuracy, too.
    fine = settings_for(max(options.accuracy / LOOSER, FINEST), simulation)
    return VerificationSettings(tolerance=options.accuracy, simulation=fine)


def require_engine(options: argparse.Namespace, dynamics: HybridDynamics) -> None:
    """Refuse an engine that cannot follow a system, before any work is done with it."""
    engine = engine_named(options.engine)
    if not isinstance(engine, Selective):
        return
    import numpy as np

    # Some state off the stop and on it: what rests there is no part of the series.
    off = np.ones(len(dynamics.state_names))
    starts = (off, dynamics.on_stop(off), np.append(off, (1.0, 1.0)))
    flows = (dynamics.free, dynamics.locked, dynamics.flight(1.0))
    for flow, start in zip(flows, starts, strict=True):
        engine.require(flow, start)


def orbit_and_problem(options: argparse.Namespace) -> tuple[ZenoOrbit, Problem]:
    """Return the orbit of a file and its problem."""
    from zeno_orbits.api import problem_of
    from zeno_orbits.orbits.orbit_file import read_orbit

    orbit = read_orbit(options.orbit)
    return orbit, problem_of(orbit, options.problem)


def require_outputs(
    options: argparse.Namespace,
    files: Sequence[str] = ("output",),
    pictures: Sequence[str] = ("picture",),
    reads: Sequence[Path] = (),
) -> None:
    """Refuse outputs that cannot all be written, before any work is done for them.

    Args:
        options: What was asked for.
        files: Options that name files to write.
        pictures: Options that name pictures to draw.
        reads: Files that are read, and must stay.

    Raises:
        InputError: If one cannot become a file, or would lie on another or on what is read.
    """
    taken = {path.resolve(): "what is read" for path in reads}
    for name in (*files, *pictures):
        path = getattr(options, name)
        if path is None:
            continue
        require = require_writable if name in files else require_picture
        require(path, name)
        other = taken.setdefault(path.resolve(), f"`{name}`")
        if other != f"`{name}`":
            wanted = f"must be another file than {other}, but both are `{path}`"
            raise InputError(f"Argument `{name}` {wanted}.")


def print_json(data: Any) -> None:
    """Print data as JSON."""
    print(json_text(data))


def json_text(data: Any) -> str:
    """Return data as JSON; what is not finite is an error."""
    import json

    return json.dumps(data, indent=2, allow_nan=False)


def say_written(options: argparse.Namespace, paths: Sequence[Path]) -> None:
    """Name the files that were written, unless JSON is printed."""
    if not options.json:
        report.print_lines(f"Written: {path}" for path in paths)
