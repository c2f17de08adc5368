"""The command line as a whole: its parser, and how a command runs and ends."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress

import zeno_orbits
from zeno_orbits.cli.cache import add_cache
from zeno_orbits.cli.completion import add_completion
from zeno_orbits.cli.continue_command import add_continue
from zeno_orbits.cli.costs import add_fidelity, add_trade
from zeno_orbits.cli.map import add_map
from zeno_orbits.cli.options import INTERRUPTED, MISUSE, NO, Parser, print_json
from zeno_orbits.cli.pictures import add_figures, add_plot
from zeno_orbits.cli.problems import add_conditions, add_new, add_problems
from zeno_orbits.cli.process import Interrupts, patient_streams
from zeno_orbits.cli.prove import add_prove
from zeno_orbits.cli.recordings import add_compare, add_identify
from zeno_orbits.cli.report_command import add_report
from zeno_orbits.cli.rig import add_rig
from zeno_orbits.cli.search import add_search
from zeno_orbits.cli.simulate import add_simulate
from zeno_orbits.cli.verify import add_verify
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.report import terminal as report

_COMMANDS = (
    *(add_problems, add_new, add_conditions, add_simulate, add_fidelity),
    *(add_search, add_verify, add_prove, add_map, add_continue, add_trade, add_rig),
    *(add_plot, add_report, add_figures, add_compare, add_identify, add_cache, add_completion),
)
"""In the order of the help."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Args:
        arguments: Its words; by default those of the process.
    """
    with patient_streams():
        try:
            parser = build_parser()
            options = parser.parse_args(arguments)
            if options.run is None:
                parser.print_help()
                return MISUSE
        except InputError as error:
            # There is no room for what `--help` says.
            report.print_error(str(error))
            return MISUSE
        except KeyboardInterrupt:
            return _interrupted()
        return _answer(options)


def _answer(options: argparse.Namespace) -> int:
    """Run one command; an error is one line on standard error, and an exit code."""
    try:
        with Interrupts() as interrupts:
            options.interrupts = interrupts
            code: int = options.run(options)
            # A disk may turn out to be full as late as here.
            sys.stdout.flush()
            return code
    except InputError as error:
        return _end(error, MISUSE, options)
    except ZenoOrbitsError as error:
        return _end(error, NO, options)
    except KeyboardInterrupt:
        return _interrupted()
    except Exception as error:
        # What an interrupt leaves half done, an import for instance, fails afterwards.
        if options.interrupts.seen:
            return _interrupted()
        # The last line of defence against a raw traceback.
        if options.debug:
            raise
        text = f"internal error, please report it ({type(error).__name__}: {error}); see --debug"
        return _end(error, MISUSE, options, text)
    finally:
        _tell_of_kernels(options)


def _tell_of_kernels(options: argparse.Namespace) -> None:
    """Say why steps were not compiled if something is wrong, or anyway if `--verbose` asks."""
    if "zeno_orbits.kernels.requests" not in sys.modules:
        return
    from zeno_orbits.kernels import account, complaints

    # A variable that says nothing known has been refused already.
    with suppress(InputError):
        if options.verbose and account():
            report.print_note(f"{account()}.")
        elif complaints():
            report.print_note(f"{complaints()[0]}: steps are interpreted, as accurate and slower.")


def _interrupted() -> int:
    report.print_error("interrupted; nothing was written")
    return INTERRUPTED


def _end(error: Exception, code: int, options: argparse.Namespace, text: str = "") -> int:
    """Tell an error, by its own words or others, to people and to programs."""
    if options.debug:
        raise error
    said = text or str(error)
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
