"""Exit codes, option groups, their values, and output that several commands share."""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import sys
import tempfile
import textwrap
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, redirect_stdout
from contextvars import ContextVar
from itertools import pairwise, takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO, TypedDict, TypeVar
from uuid import uuid4

from zeno_orbits import api
from zeno_orbits.aliases import FORMER
from zeno_orbits.cli.help import help_of
from zeno_orbits.cli.parsing import Named, read_count, read_named_number, read_number
from zeno_orbits.errors import CheckpointError, InputError, WorkError, did_you_mean, not_known
from zeno_orbits.report import terminal as report
from zeno_orbits.work import remove_abandoned, write_whole

if TYPE_CHECKING:
    import zeno_orbits as zo
    from zeno_orbits.work import Place

YES, NO, MISUSE, INTERRUPTED = 0, 1, 2, 130

_HELP_WIDTH = 78
_LONGEST_NAME = 200
"""Bytes of an output's name in the name of its checkpoint. File systems allow 255 bytes in all."""

Result = TypeVar("Result")


_NEGATIVE = re.compile(r"-(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?$|-(?:inf|nan)$")
"""Negative numbers, which are values. ``argparse`` takes those with an exponent for options."""


class Parser(argparse.ArgumentParser):
    """A parser that refuses bad input in one line, and asks whether a near name is meant."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, allow_abbrev=False, **kwargs)
        self._words: list[str] = []
        self._negative_number_matcher = _NEGATIVE

    def parse_known_args(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, args: Any = None, namespace: Any = None
    ) -> Any:
        """Return the options. An unknown word is an error of this command."""
        self._words = [*(sys.argv[1:] if args is None else args)]
        self._require_no_empty_word()
        self._require_known_options()
        found, rest = super().parse_known_args(args, namespace)
        if rest:
            near = did_you_mean(rest[0].partition("=")[0], self._option_strings())
            if "--set" in self._option_strings() and re.match(r"\w+=", rest[0]):
                near = f" Give every value with its own option: --set {rest[0]}."
            self.error(f"unrecognized arguments: {' '.join(rest)}.{near or ' Remove them.'}")
        return found, rest

    def _option_strings(self) -> list[str]:
        """Return the options of this command in all their forms."""
        return [word for action in self._actions for word in action.option_strings]

    def _require_known_options(self) -> None:
        """Refuse an unknown option: `argparse` would first ask for the option that is meant."""
        known = self._option_strings()
        for word in takewhile(lambda word: word != "--", self._words if " " in self.prog else ()):
            option = word.partition("=")[0]
            is_option = word.startswith("--") or (word.startswith("-") and option in FORMER)
            if is_option and option not in known:
                self.error(f"{option}: unknown option.{did_you_mean(option, known)}")

    def _require_no_empty_word(self) -> None:
        """Refuse an empty value, which would be the current folder as a path."""
        for before, word in pairwise(["", *self._words]):
            empty = re.fullmatch(r"(--[\w-]+)=", word)
            if (word and not empty) or " " not in self.prog:
                continue
            operands = [one.metavar or one.dest for one in self._actions if not one.option_strings]
            operand = str(operands[0]) if operands else "an argument"
            label = empty[1] if empty else before if before.startswith("-") else operand
            self.error(f"{label}: the value is empty. Give a value, or leave it out.")

    def format_help(self) -> str:
        """Return the help of common options, in groups."""
        return help_of(self, self._get_formatter)

    def format_help_all(self) -> str:
        """Return the help of all options, in groups."""
        return help_of(self, self._get_formatter, everything=True)

    def actions(self) -> list[argparse.Action]:
        """Return the arguments and options."""
        return self._actions

    def error(self, message: str) -> NoReturn:
        """Exit with the code of misuse."""
        report.print_error(f"{_sentence(message, self._words)} (see `{self.prog} --help`)")
        sys.exit(MISUSE)


def _sentence(message: str, words: Sequence[str]) -> str:
    """Return a message of ``argparse`` in the form of the package's own messages.

    Args:
        message: The message.
        words: The command line, whose form of an option is taken.
    """
    missing = re.fullmatch(r"the following arguments are required: (.*)", message)
    if missing is not None:
        return f"Missing: {missing[1]}."
    found = re.fullmatch(r"argument ([^:]+): (.*)", message, flags=re.DOTALL)
    if found is None:
        return message if message.startswith("-") else message[0].upper() + message[1:]
    forms, clause = found[1].split("/"), found[2]
    label = next((one for one in forms if _is_typed(one, words)), forms[-1])
    if clause == "expected one argument":
        clause = "a value is missing"
    choice = re.fullmatch(r"invalid choice: '(.*)' \(choose from (.*)\)", clause, flags=re.DOTALL)
    if choice is not None:
        given, known = choice[1], re.findall(r"'([^']*)'", choice[2])
        clause = not_known(given, known)
    named = re.fullmatch(r"Argument `([^`]+)` (.*)", clause, flags=re.DOTALL)
    if named is not None:
        same = label == f"--{named[1]}"
        label, clause = label if same else f"{label} {named[1]}", named[2]
    return f"{label}: {clause}{'' if clause.endswith(('.', '?')) else '.'}"


def _is_typed(option: str, words: Sequence[str]) -> bool:
    """Return True if an option is among the words, with or without its value in the same word."""
    glued = option if len(option) == 2 else f"{option}="
    return any(word == option or word.startswith(glued) for word in words)


class _HelpAll(argparse.Action):
    """Print the help of all options, and exit."""

    def __init__(self, option_strings: Sequence[str], dest: str, **kwargs: Any) -> None:
        super().__init__(option_strings, dest, nargs=0, default=argparse.SUPPRESS, **kwargs)

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,  # noqa: ARG002 (the form that `argparse` calls)
        values: Any,  # noqa: ARG002
        option_string: str | None = None,  # noqa: ARG002
    ) -> None:
        """Print the help and exit."""
        if isinstance(parser, Parser):
            sys.stdout.write(parser.format_help_all())
        parser.exit()


def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], int],
    summary: str,
    examples: Sequence[str],
) -> argparse.ArgumentParser:
    """Return the parser of a command, with the options that all commands share.

    Args:
        commands: The program's commands, of ``add_subparsers``.
        name: Name of the command.
        run: Function from the parsed options to the exit code.
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
    parser.set_defaults(run=run, parser=parser)
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    parser.add_argument("-v", "--verbose", action="store_true", help="print integrator diagnostics")
    parser.add_argument("--debug", action="store_true", help="print the traceback of an error")
    parser.add_argument("--help-all", action=_HelpAll, help="show all options and examples")
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


PROBLEM_HELP = "a problem's name (NAME@FIDELITY for a reduced model) or Python file"


def add_problem(parser: argparse.ArgumentParser, meaning: str = PROBLEM_HELP) -> None:
    """Add the problem, its gains and its parameters."""
    parser.add_argument("problem", metavar="PROBLEM", help=meaning)
    add_values(parser)


def _add_named(
    parser: argparse.ArgumentParser,
    option: str,
    form: str,
    meaning: str,
) -> None:
    """Add an option that gives numbers by name and may be repeated."""
    parser.add_argument(
        option,
        action=Named,
        type=read_named_number,
        metavar=form,
        help=f"{meaning} (repeatable)",
    )


def add_shared(parser: argparse.ArgumentParser, name: str, more: str = "", **details: Any) -> None:
    """Add an option that has the name of an argument of functions, by the table of names.

    Args:
        parser: The parser of a command.
        name: Name of the row.
        more: Help for this command alone.
        details: Further arguments of ``add_argument``.
    """
    row = api.NAMES[name]
    parser.add_argument(row.option, metavar=row.form, help=api.meaning_of(name, more), **details)


def add_values(parser: argparse.ArgumentParser) -> None:
    """Add the gains and parameters of a problem."""
    _add_named(parser, "--set", "NAME=VALUE", "set a gain or parameter")


def add_start(parser: argparse.ArgumentParser) -> None:
    """Add the initial state."""
    add_shared(
        parser,
        "start",
        " (default: the problem's first start) (repeatable)",
        action=Named,
        type=read_named_number,
    )


def add_at(parser: argparse.ArgumentParser) -> None:
    """Add the state at which a theorem is looked at."""
    meaning = (
        "state Theorem 1 at this point, with a neighbourhood in which all impacts accumulate; "
        "other states are 0, a clock has the cosine 1"
    )
    _add_named(parser, "--at", "STATE=VALUE", meaning)


def add_spread(parser: argparse.ArgumentParser, usual: str) -> None:
    """Add what scatters.

    Args:
        parser: The parser of a command.
        usual: The default.
    """
    meaning = (
        "relative standard deviation of `restitution` or `STOP.restitution` at each impact, or "
        f"absolute one of a state in each period (default: {usual})"
    )
    _add_named(parser, "--spread", "NAME=VALUE", meaning)


def add_problem_file(parser: argparse.ArgumentParser, dest: str = "problem") -> None:
    """Add the file of an orbit's problem."""
    parser.add_argument(
        "--problem",
        dest=dest,
        metavar="FILE.py",
        help="the problem's file, if it is neither bundled nor found beside the orbit",
    )


def require_phases(orbit: zo.Orbit, option: str) -> None:
    """Refuse an option that an orbit lacks, because its period is no sequence of phases.

    Args:
        orbit: The orbit.
        option: The option as it was typed.

    Raises:
        InputError: If the machine has several stops, a switch or a kink.
    """
    if orbit.phases_as is None:
        raise InputError(
            f"Option `{option}` needs a machine with one stop, no switch and no kink, in this "
            "version: leave it out."
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
        choices=api.ENGINE_NAMES,
        default=api.ENGINE_NAMES[0],
        help="the integrator; automatic takes explicit steps, and implicit steps if the problem "
        "is stiff",
    )


def add_place(parser: argparse.ArgumentParser) -> None:
    """Add the options for workers and for the folder of finished work."""
    parser.add_argument(
        "-j",
        "--workers",
        type=read_count,
        metavar="N",
        help="number of processes (default: one per core)",
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
        help="keep finished work in this folder and resume from it (default: a folder next to the "
        "output, or a temporary one, removed when the work is done)",
    )


def place_of(options: argparse.Namespace) -> Place:
    """Return the executor of the work."""
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
    """Do work whose finished parts are kept at an interrupt, and return the exit code.

    The parts are kept in the named folder, else next to the first output, else in a temporary
    folder. A folder that was not named is removed when it is not needed any more.

    Args:
        options: The parsed options.
        work: Function from the folder and a progress callback to the result.
        finish: Function that prints and writes the result and returns the exit code.
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
        report.print_error(f"interrupted, {_kept(options, folder) or 'nothing was written'}")
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
    """Return a folder for finished work, determined by its purpose."""
    if _is_temporary(options):
        place = Path(tempfile.gettempdir())
        remove_abandoned(place, "zeno-orbits-????????", _ABANDONED)
        return place / f"zeno-orbits-{uuid4().hex[:8]}"
    output = options.output or options.picture
    name = os.fsencode(output.name)
    if len(name) > _LONGEST_NAME:
        name = name[:_LONGEST_NAME] + b"-" + hashlib.sha256(name).hexdigest()[:8].encode()
    return output.with_name(f"{os.fsdecode(name)}.checkpoint")


_ABANDONED = 7 * 86_400.0
"""Age at which the finished work in a temporary folder of an ended run is removed [s]."""


def _kept(options: argparse.Namespace, folder: Path | None) -> str:
    """Return a clause on the kept parts of unfinished work and how to resume, or nothing."""
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
    return f"`{folder}` keeps the finished work: {again} continues from there"


def read_orbit_path(word: str) -> Path:
    """Return the path of an orbit file.

    Raises:
        ArgumentTypeError: If the word is a problem.
    """
    path = Path(word)
    is_problem = word.partition("@")[0] in api.bundled_names() or path.suffix == ".py"
    if is_problem and not (path.is_file() and path.suffix != ".py"):
        command = f"zeno-orbits search {word} -o orbit.json"
        raise argparse.ArgumentTypeError(f"`{word}` is a problem: run `{command}` first")
    return path


def add_orbit(parser: argparse.ArgumentParser) -> None:
    """Add the orbit file and its problem."""
    parser.add_argument("orbit", metavar="ORBIT.json", type=read_orbit_path, help="an orbit file")
    add_problem_file(parser)


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Add the file of a recording, and which part of it counts."""
    parser.add_argument(
        "data",
        metavar="DATA.csv",
        type=Path,
        help="a table of signals over time with headings `name [unit]`, one of them `time`",
    )
    add_shared(parser, "t_start", type=read_number)
    add_shared(parser, "t_end", type=read_number)


class Numbers(TypedDict):
    """Gains and parameters, by the names of the arguments of `api`."""

    gains: dict[str, float]
    parameters: dict[str, float]


def numbers_of(problem: zo.Problem, options: argparse.Namespace) -> Numbers:
    """Return the gains and parameters that were given, by the names of the arguments of `api`."""
    gains, parameters = api.split_numbers(problem, options.set)
    return {"gains": gains, "parameters": parameters}


def values_of(problem: zo.Problem, options: argparse.Namespace) -> zo.ParameterValues:
    """Return the values that were given, defaults filled in."""
    return problem.values(numbers=options.set)


def start_of(problem: zo.Problem, options: argparse.Namespace) -> tuple[float, ...]:
    """Return the initial state that was given, ``(n_x,)``."""
    return problem.initial_state(options.start or None, values_of(problem, options))


def require_output_of(options: argparse.Namespace, *names: str) -> None:
    """Refuse options of a recording that is not written.

    Args:
        options: The parsed options.
        names: Options that change the file of ``-o`` and nothing else.

    Raises:
        InputError: If one is given without ``-o``.
    """
    for name in names:
        if options.output is None and getattr(options, name):
            raise InputError(f"Argument `{name}` needs -o DATA.csv: it changes the file alone.")


JSON_OUTPUT: ContextVar[TextIO | None] = ContextVar("JSON_OUTPUT", default=None)
"""Where JSON is printed, while the standard output of a problem's code goes elsewhere."""


@contextmanager
def only_json() -> Generator[None]:
    """Send everything but JSON to standard error."""
    token = JSON_OUTPUT.set(sys.stdout)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        JSON_OUTPUT.reset(token)


def print_json(data: Any) -> None:
    """Print data as JSON."""
    print(json_text(data), file=JSON_OUTPUT.get())


def json_text(data: Any) -> str:
    """Return data as JSON. A nonfinite value is an error."""
    import json

    return json.dumps(data, indent=2, allow_nan=False)


def hand_out(
    options: argparse.Namespace,
    found: Any,
    show: Callable[[Any], None],
    draw: Callable[[Any], Any] | None = None,
    write: Callable[[Any, Path], None] | None = None,
) -> None:
    """Draw, write and print a result, depending on ``--plot``, ``-o`` and ``--json``.

    The picture is drawn first, since an interrupt while drawing must leave no file.

    Args:
        options: The parsed options.
        found: The result, with ``as_json``.
        show: Prints it for people.
        draw: Returns the figure of the result, if the command has ``--plot``. Its argument is
            `report.plots`, which is loaded only for it.
        write: Writes the file of the result, by default all of ``as_json``.
    """
    if draw is not None and options.picture is not None:
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
    """Write the JSON of a result, with the path of its problem file if it records one."""
    file = getattr(found, "problem_file", None)
    entry = {} if file is None else {"problem_file": file.relative_to(path.parent)}
    write_whole(path, json_text({**found.as_json(), **entry}) + "\n")


def say_written(options: argparse.Namespace, paths: Sequence[Path]) -> None:
    """Name the files that were written, unless JSON is printed."""
    if not options.json:
        report.print_whole(f"Written: {path}" for path in paths)
