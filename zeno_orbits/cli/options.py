"""Exit codes, option groups, their values, and output that several commands share."""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar
from uuid import uuid4

from zeno_orbits.cli.parsing import Named, read_count, read_named_number, read_number
from zeno_orbits.errors import CheckpointError, InputError, WorkError, did_you_mean
from zeno_orbits.integrators import ENGINES, Selective, engine_named
from zeno_orbits.report import terminal as report
from zeno_orbits.work import require_picture, require_writable, write_whole

if TYPE_CHECKING:
    from zeno_orbits.model import HybridDynamics, ParameterValues, Problem
    from zeno_orbits.orbits import ZenoOrbit
    from zeno_orbits.simulation import SimulationSettings
    from zeno_orbits.verification import VerificationSettings
    from zeno_orbits.work import Place

YES, NO, MISUSE, INTERRUPTED = 0, 1, 2, 130

_HELP_WIDTH = 78

Result = TypeVar("Result")


class Parser(argparse.ArgumentParser):
    """A parser that refuses bad input in one line, and asks whether a near name is meant."""

    def parse_known_args(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, args: Any = None, namespace: Any = None
    ) -> Any:
        """Return the options; a word that belongs to none of them is an error of this command."""
        found, rest = super().parse_known_args(args, namespace)
        if rest:
            known = [word for action in self._actions for word in action.option_strings]
            near = did_you_mean(rest[0].partition("=")[0], known)
            self.error(f"unrecognized arguments: {' '.join(rest)}.{near}")
        return found, rest

    def error(self, message: str) -> NoReturn:
        """Exit with the code of misuse."""
        report.print_error(f"{_sentence(message)} (see `{self.prog} --help`)")
        sys.exit(MISUSE)


def _sentence(message: str) -> str:
    """Return a message of ``argparse`` in the form of the package's own messages."""
    missing = re.fullmatch(r"the following arguments are required: (.*)", message)
    if missing is not None:
        return f"Missing: {missing[1]}."
    found = re.fullmatch(r"argument (?:-\w/)?(?:--)?([^:]+): (.*)", message, flags=re.DOTALL)
    if found is None:
        return message[0].upper() + message[1:]
    option, clause = found.groups()
    if clause == "expected one argument":
        clause = "must have a value, but it has none"
    choice = re.fullmatch(r"invalid choice: '(.*)' \(choose from (.*)\)", clause, flags=re.DOTALL)
    if choice is not None:
        given, known = choice[1], re.findall(r"'([^']*)'", choice[2])
        clause = f"must be one of {', '.join(known)}, but it is `{given}`."
        clause += did_you_mean(given, known)
    if clause.startswith("Argument "):
        return clause
    return f"Argument `{option}` {clause}{'' if clause.endswith(('.', '?')) else '.'}"


def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], int],
    summary: str,
    examples: Sequence[str],
) -> argparse.ArgumentParser:
    """Return the parser of a command, with what all commands share.

    Args:
        commands: The program's commands, of ``add_subparsers``.
        name: Its name.
        run: From the parsed options to the exit code.
        summary: One line for the list of commands.
        examples: Command lines to show in its help.
    """
    parser = commands.add_parser(
        name,
        help=summary,
        description=textwrap.fill(f"{summary[0].upper()}{summary[1:]}.", _HELP_WIDTH),
        epilog="\n".join(["examples:", *map(_folded_example, examples)]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    parser.add_argument(
        "--verbose", action="store_true", help="say how steps were computed, and why"
    )
    parser.add_argument("--debug", action="store_true", help="print the traceback of an error")
    return parser


def _folded_example(command: str) -> str:
    """Return a command line as a shell reads it, its lines broken before options."""
    lines = [""]
    for part in re.split(r" (?=-|> )", f"  {command}"):
        if lines[-1] and len(lines[-1]) + len(part) >= _HELP_WIDTH:
            lines.append(f"      {part}")
        else:
            lines[-1] = f"{lines[-1]} {part}" if lines[-1] else part
    return " \\\n".join(lines)


def add_problem(parser: argparse.ArgumentParser) -> None:
    """Add the problem and its parameters."""
    parser.add_argument(
        "problem",
        metavar="PROBLEM",
        help="a problem's name (NAME@FIDELITY for a reduced model) or Python file",
    )
    add_parameters(parser)


def _add_named(parser: argparse.ArgumentParser, option: str, form: str, meaning: str) -> None:
    """Add an option that gives numbers by name and may be repeated."""
    parser.add_argument(
        option,
        action=Named,
        type=read_named_number,
        metavar=form,
        help=f"{meaning}; may be repeated",
    )


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """Add the parameters of a problem."""
    _add_named(parser, "--set", "NAME=VALUE", "change a parameter of the problem")


def add_gains(parser: argparse.ArgumentParser) -> None:
    """Add the gains of a problem."""
    _add_named(parser, "--gain", "NAME=VALUE", "change a gain")


def add_start(parser: argparse.ArgumentParser) -> None:
    """Add the initial state."""
    meaning = "initial value of a state, 0 for the others; by default the problem's first start"
    _add_named(parser, "--start", "STATE=VALUE", meaning)


def add_problem_file(parser: argparse.ArgumentParser) -> None:
    """Add the file of an orbit's problem."""
    parser.add_argument(
        "--problem", metavar="FILE.py", help="the problem's file, if it is not a bundled one"
    )


def add_accuracy(parser: argparse.ArgumentParser) -> None:
    """Add the accuracy and the engine."""
    parser.add_argument(
        "--accuracy",
        type=read_number,
        metavar="A",
        help="relative error to reach, for example 1e-6, with the cheapest settings that do; the "
        "estimated error is reported",
    )
    parser.add_argument(
        "--engine",
        choices=tuple(ENGINES),
        default=next(iter(ENGINES)),
        help="the integrator; automatic takes explicit steps, and implicit ones where the problem "
        "is stiff; taylor needs the extra `taylor`",
    )


def add_place(parser: argparse.ArgumentParser) -> None:
    """Add where the work is done, and where what is finished is kept."""
    parser.add_argument(
        "--workers",
        type=read_count,
        metavar="N",
        help="number of processes; by default one per core",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="use the Dask cluster of this scheduler, for example tcp://host:8786",
    )
    parser.add_argument(
        "--checkpoint",
        type=Path,
        metavar="FOLDER",
        help="keep finished work in this folder and resume from it; by default a folder beside the "
        "output, or a temporary one, removed when the work is done",
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


def run_resumable(
    options: argparse.Namespace,
    work: Callable[[Path | None, report.ProgressLine], Result],
    finish: Callable[[Result], int],
    *,
    keep: bool = True,
) -> int:
    """Do work whose finished parts outlive an interrupt, and return the exit code.

    The parts are kept in the folder that was named, else beside the first output, else in a
    temporary folder. A folder that nobody named is removed when it is of no more use.

    Args:
        options: The parsed options.
        work: From the folder, and a function to report progress to, to the result.
        finish: From the result to the exit code: prints and writes it.
        keep: Whether there are parts to keep, if no folder was named.
    """
    from zeno_orbits.work import keeps_nothing, remove_checkpoint

    own = None if options.checkpoint is not None or not keep else _own_folder(options)
    folder = options.checkpoint or own
    try:
        with report.ProgressLine(options.interrupts.check) as progress:
            found = work(folder, progress)
        code = finish(found)
    except KeyboardInterrupt:
        report.print_error(f"interrupted; {_kept(options, folder) or 'nothing was written'}")
        return INTERRUPTED
    except WorkError as error:
        kept = _kept(options, folder)
        raise WorkError(f"{error}; {kept}" if kept else str(error), trace=error.trace) from error
    except CheckpointError:
        # It belongs to something else.
        raise
    except BaseException:
        if own is not None and (_is_temporary(options) or keeps_nothing(own)):
            remove_checkpoint(own)
        raise
    if own is not None:
        remove_checkpoint(own)
    return code


def _is_temporary(options: argparse.Namespace) -> bool:
    """Return True if the folder of finished work belongs to no folder and no output of the user."""
    return not (options.checkpoint or options.output or getattr(options, "picture", None))


def _own_folder(options: argparse.Namespace) -> Path:
    """Return a folder for finished work, by what the work is for."""
    if _is_temporary(options):
        return Path(tempfile.gettempdir(), f"zeno-orbits-{uuid4().hex[:8]}")
    output = options.output or options.picture
    return output.with_name(f"{output.name}.checkpoint")


def _kept(options: argparse.Namespace, folder: Path | None) -> str:
    """Return a clause on what is kept of unfinished work and how to go on, if anything is."""
    from zeno_orbits.work import keeps_nothing, remove_checkpoint

    if folder is None:
        return ""
    if keeps_nothing(folder):
        if options.checkpoint is None:
            # It would stand in the way of other work with the same output.
            remove_checkpoint(folder)
        return ""
    again = "the same command"
    if _is_temporary(options):
        again += f" with --checkpoint {folder}"
    return f"`{folder}` keeps what is finished: {again} goes on from there"


def add_orbit(parser: argparse.ArgumentParser) -> None:
    """Add the orbit file and its problem."""
    parser.add_argument("orbit", metavar="ORBIT.json", type=Path, help="an orbit file")
    add_problem_file(parser)


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Add the file of a recording, and which part of it counts."""
    parser.add_argument(
        "data",
        metavar="DATA.csv",
        type=Path,
        help="a table of signals over time with headings `name [unit]`, one of them `time`",
    )
    parser.add_argument(
        "--from", dest="since", type=read_number, metavar="T", help="ignore earlier data [s]"
    )
    parser.add_argument("--to", type=read_number, metavar="T", help="ignore later data [s]")


def values_of(problem: Problem, options: argparse.Namespace) -> ParameterValues:
    """Return the numbers that were asked for."""
    return problem.values(gains=options.gain, parameters=options.set)


def start_of(problem: Problem, options: argparse.Namespace) -> tuple[float, ...]:
    """Return the initial state that was asked for, ``(n_x,)``."""
    return problem.state_vector(options.start or problem.starts[0])


def simulation_of(options: argparse.Namespace) -> SimulationSettings:
    """Return the simulator's settings for the engine that was asked for."""
    from zeno_orbits.simulation import SimulationSettings

    return SimulationSettings(engine=engine_named(options.engine))


def verification_of(options: argparse.Namespace, tolerance: float) -> VerificationSettings:
    """Return how to check at the accuracy that was asked for, if one was."""
    from zeno_orbits.orbits import LOOSER
    from zeno_orbits.precision import FINEST, settings_for
    from zeno_orbits.verification import VerificationSettings

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
    from zeno_orbits.orbits import read_orbit

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
        options: The parsed options.
        files: Options that name files to write.
        pictures: Options that name pictures to draw.
        reads: Files that are read, and must stay.

    Raises:
        InputError: If one cannot become a file, or would lie on another or on what is read.
    """
    taken = {path.resolve(): "the one that is read" for path in reads}
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


def hand_out(
    options: argparse.Namespace,
    found: Any,
    show: Callable[[Any], None],
    draw: Callable[[Any], Any],
    write: Callable[[Any, Path], None] | None = None,
) -> None:
    """Draw, write and print a result, as far as ``--picture``, ``-o`` and ``--json`` ask for it.

    The file comes after the picture: drawing takes long enough to be interrupted.

    Args:
        options: The parsed options.
        found: The result, with ``as_json``.
        show: Prints it for people.
        draw: Returns its picture; takes `report.plots`, which is loaded only for it.
        write: Writes its file; by default all of ``as_json``.
    """
    if options.picture is not None:
        from zeno_orbits.report import plots

        plots.save_figure(draw(plots), options.picture)
    if options.output is not None:
        (write or write_json)(found, options.output)
    if options.json:
        print_json(found.as_json())
    else:
        show(found)
    say_written(options, [path for path in (options.output, options.picture) if path is not None])


def write_json(found: Any, path: Path) -> None:
    """Write the JSON of a result."""
    write_whole(path, json_text(found.as_json()) + "\n")


def say_written(options: argparse.Namespace, paths: Sequence[Path]) -> None:
    """Name the files that were written, unless JSON is printed."""
    if not options.json:
        report.print_whole(f"Written: {path}" for path in paths)
