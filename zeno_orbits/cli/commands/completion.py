"""The command `completion`: the words of the command line, for a shell to complete."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

from zeno_orbits import api
from zeno_orbits.cli.options import YES, add_command, print_json
from zeno_orbits.report import terminal as report

_BASH = r"""
_zeno_orbits_files() { compgen -f -X "!*$2" -- "$1"; compgen -d -S / -- "$1"; }
_zeno_orbits_problem() { compgen -W "NAMES" -- "$1"; _zeno_orbits_files "$1" .py; }
_zeno_orbits_target() { compgen -W "NAMES" -- "$1"; _zeno_orbits_files "$1" .json; }
_zeno_orbits_py() { _zeno_orbits_files "$1" .py; }
_zeno_orbits_json() { _zeno_orbits_files "$1" .json; }
_zeno_orbits_csv() { _zeno_orbits_files "$1" .csv; }
"""
_ZSH = r"""
_zeno_orbits_problem() { _alternative 'names:problem:(NAMES)' 'files:file:_files -g "*.py"' }
_zeno_orbits_target() { _alternative 'names:problem:(NAMES)' 'files:file:_files -g "*.json"' }
_zeno_orbits_py() { _files -g "*.py" }
_zeno_orbits_json() { _files -g "*.json" }
_zeno_orbits_csv() { _files -g "*.csv" }
"""
_SHELLS = {"bash": _BASH, "zsh": _ZSH}
"""Name of a shell to its functions for problems and for files of one kind."""


def add_completion(commands: Any) -> None:
    """Add the command `completion`."""
    parser = add_command(
        commands,
        "completion",
        _run_completion,
        "print a script that lets a shell complete commands, options, problems and files",
        [
            "zeno-orbits completion bash > ~/.local/share/bash-completion/completions/zeno-orbits",
            "zeno-orbits completion zsh > ~/.zfunc/_zeno-orbits",
            'eval "$(zeno-orbits completion bash)"',
        ],
    )
    parser.add_argument("shell", choices=tuple(_SHELLS), help="shell that reads the script")


def _run_completion(options: argparse.Namespace) -> int:
    import shtab

    names = [one.name for one in api.all_problems()]
    parser: argparse.ArgumentParser = options.program
    for action in _actions(parser):
        kind = _kind(action)
        if kind in ("file", "directory"):
            complete = shtab.CHOICE_FUNCTIONS[kind]
        else:
            complete = dict.fromkeys(_SHELLS, f"_zeno_orbits_{kind}")
        if kind:
            # The attribute that shtab reads.
            vars(action)["complete"] = complete
    functions = _SHELLS[options.shell].replace("NAMES", " ".join(names))
    # The stub of shtab has the type `str`, but the function needs the name of a shell.
    preamble: Any = {options.shell: functions}
    script = shtab.complete(parser, options.shell, preamble=preamble)
    if options.json:
        print_json({"shell": options.shell, "script": script})
    else:
        report.print_whole([script])
    return YES


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the arguments of a parser and of its commands."""
    for action in parser._actions:  # noqa: SLF001 (argparse tells them nowhere else)
        yield action
        choices: object = cast("Any", action).choices
        if isinstance(choices, dict):
            for command in cast("dict[str, argparse.ArgumentParser]", choices).values():
                yield from _actions(command)


def _kind(action: argparse.Action) -> str:
    """Return the kind of completion of an argument, empty for arguments without completion."""
    metavar = action.metavar if isinstance(action.metavar, str) else ""
    if metavar == "PROBLEM":
        return "problem"
    if metavar == "ORBIT.json|PROBLEM":
        return "target"
    if metavar == "FOLDER":
        return "directory"
    _, dot, suffix = metavar.rpartition(".")
    if dot and suffix in ("py", "json", "csv"):
        return suffix
    return "file" if action.type is Path else ""
