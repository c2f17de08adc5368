"""The command line as a whole: its parser, and how a command runs and ends."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Generator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from typing import Any

import zeno_orbits
from zeno_orbits.cli.commands.cache import add_cache
from zeno_orbits.cli.commands.completion import add_completion
from zeno_orbits.cli.commands.continue_command import add_continue
from zeno_orbits.cli.commands.costs import add_fidelity, add_trade
from zeno_orbits.cli.commands.disturbances import add_recovery, add_scatter
from zeno_orbits.cli.commands.export import add_export
from zeno_orbits.cli.commands.feedback import add_feedback
from zeno_orbits.cli.commands.map import add_map
from zeno_orbits.cli.commands.pictures import add_figures, add_plot
from zeno_orbits.cli.commands.problems import add_conditions, add_new, add_problems
from zeno_orbits.cli.commands.prove import add_prove
from zeno_orbits.cli.commands.push import add_push
from zeno_orbits.cli.commands.recordings import add_compare, add_identify, add_read
from zeno_orbits.cli.commands.report_command import add_report
from zeno_orbits.cli.commands.rig import add_rig
from zeno_orbits.cli.commands.search import add_search
from zeno_orbits.cli.commands.simulate import add_simulate
from zeno_orbits.cli.commands.stability import add_stability
from zeno_orbits.cli.commands.verify import add_verify
from zeno_orbits.cli.options import (
    INTERRUPTED,
    MISUSE,
    NO,
    Parser,
    only_json,
    print_json,
)
from zeno_orbits.cli.process import Interrupts, patient_streams
from zeno_orbits.cli.typed import as_typed
from zeno_orbits.errors import EquationsWarning, InputError, ZenoOrbitsError
from zeno_orbits.report import terminal as report
from zeno_orbits.work import BUILD_WATCH

_COMMANDS = (
    *(add_problems, add_new, add_conditions, add_simulate, add_fidelity),
    *(add_search, add_verify, add_prove, add_map, add_continue, add_push),
    *(add_stability, add_recovery, add_scatter, add_feedback, add_trade, add_rig),
    *(
        add_export,
        add_plot,
        add_report,
        add_figures,
        add_read,
        add_compare,
        add_identify,
        add_cache,
        add_completion,
    ),
)
"""In the order of the help."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Args:
        arguments: Words of the command line, by default the words of the process.
    """
    with patient_streams():
        try:
            parser = build_parser()
            words = [*(sys.argv[1:] if arguments is None else arguments)]
            options = parser.parse_args(words)
            options.words, options.program = words, parser
            if options.run is None:
                parser.print_help()
                return MISUSE
        except InputError as error:
            # The output of `--help` cannot be written.
            report.print_error(str(error))
            return MISUSE
        except KeyboardInterrupt:
            return _interrupted()
        return _answer(options)


def _answer(options: argparse.Namespace) -> int:
    """Run one command. An error is one line on standard error, and an exit code."""
    # A second interrupt must not end the report of the first.
    with Interrupts() as interrupts, _warnings_as_notes():
        options.interrupts = interrupts
        options.refused = False
        BUILD_WATCH.set(lambda: report.ProgressLine(interrupts.check))
        try:
            with only_json() if options.json else nullcontext():
                code: int = options.run(options)
            # A disk may turn out to be full as late as here.
            sys.stdout.flush()
            return _of_signal(options) if code == INTERRUPTED else code
        except InputError as error:
            return _end(error, MISUSE, options)
        except ZenoOrbitsError as error:
            return _end(error, NO, options)
        except KeyboardInterrupt:
            _interrupted()
            return _of_signal(options)
        except Exception as error:
            # Code that an interrupt left unfinished, for instance an import, fails afterwards.
            if options.interrupts.seen:
                _interrupted()
                return _of_signal(options)
            # The last line of defence against a raw traceback.
            if options.debug:
                raise
            return _end(error, MISUSE, options, _about_unexpected(error))
        finally:
            _tell_of_loop(options)


@contextmanager
def _warnings_as_notes() -> Generator[None]:
    """Print each warning about other equations as one note."""
    seen: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *rest: Any) -> None:
        if not issubclass(category, EquationsWarning):
            shown(message, category, *rest)
        elif str(message) not in seen:
            seen.add(str(message))
            report.print_note(str(message))

    with warnings.catch_warnings():
        shown = warnings.showwarning
        warnings.simplefilter("always", EquationsWarning)
        warnings.showwarning = show
        yield


def _about_unexpected(error: Exception) -> str:
    """Return the message about an exception that no part of the package raises on purpose."""
    if isinstance(error, FileNotFoundError) and error.filename is None:
        # The system cannot name the folder to which paths are relative.
        return "The current folder was deleted. Change to an existing folder."
    return f"internal error, please report it ({type(error).__name__}: {error}). See --debug"


def _tell_of_loop(options: argparse.Namespace) -> None:
    """Print why executions run in Python if they do, and with `--verbose` how they run."""
    if options.refused and not options.verbose:
        # An error is one line.
        return
    if "zeno_orbits.loop.library" not in sys.modules:
        return
    from zeno_orbits.loop import loop_account, loop_trouble, refusals

    if options.verbose:
        if "zeno_orbits.loop.program" in sys.modules:
            for clause in (loop_account(), *refusals()):
                report.print_note(f"{clause}.")
    elif loop_trouble():
        report.print_note(f"executions run in Python, as accurate and slower: {loop_trouble()}.")


def _of_signal(options: argparse.Namespace) -> int:
    """Return the exit code that a shell gives to a command that a signal ended."""
    return 128 + int(options.interrupts.signal)


def _interrupted() -> int:
    report.print_error("interrupted, nothing was written")
    return INTERRUPTED


def _end(error: Exception, code: int, options: argparse.Namespace, text: str = "") -> int:
    """Print an error, by its message or another text, for users and for programs."""
    if options.debug:
        raise error
    options.refused = code == MISUSE
    said = text or as_typed(str(error), options.words, options)
    report.print_error(said)
    if options.json:
        # A disk that is full does not hide the error.
        with suppress(InputError):
            print_json({"error": type(error).__name__, "message": said})
            sys.stdout.flush()
    return code


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    parser = Parser(
        prog="zeno-orbits",
        description="Find, verify and follow Zeno periodic orbits.",
        epilog=(
            "exit codes: 0 yes; 1 no orbit found, or a check failed; 2 wrong usage or "
            "input\n\n"
            "example:\n"
            "  zeno-orbits search motor_pendulum -o orbit.json\n"
            "  zeno-orbits verify orbit.json\n"
            "  zeno-orbits plot orbit.json -o pictures"
        ),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    version = f"%(prog)s {zeno_orbits.__version__}"
    parser.add_argument("--version", action="version", version=version)
    parser.set_defaults(run=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for add in _COMMANDS:
        add(commands)
    return parser
