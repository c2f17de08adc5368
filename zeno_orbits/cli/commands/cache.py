"""The command `cache`."""

from __future__ import annotations

import argparse
from typing import Any

from zeno_orbits.cli.options import NO, YES, add_command, print_json
from zeno_orbits.errors import InputError, KernelError
from zeno_orbits.report import terminal as report


def add_cache(commands: Any) -> None:
    """Add the command `cache`."""
    parser = add_command(
        commands,
        "cache",
        _run_cache,
        "show, fill or clear the cache of compiled code",
        [
            "zeno-orbits cache",
            "zeno-orbits cache --compile motor_pendulum",
            "zeno-orbits cache --clear",
        ],
    )
    parser.add_argument(
        "--compile",
        metavar="PROBLEM",
        help="compile the formulas of a problem now: runs are faster, with the same results",
    )
    parser.add_argument("--clear", action="store_true", help="remove all compiled code")


def _run_cache(options: argparse.Namespace) -> int:
    from zeno_orbits.loop import find_compiler, library_folder, may_compile

    when, folder = may_compile(), library_folder()
    removed = folder.clear() if options.clear else None
    faults = list[str]()
    if options.compile is not None:
        faults += _compiled(options.compile)
    try:
        compiler = find_compiler()
    except KernelError as error:
        compiler = None
        faults.append(str(error))
    facts = {
        "folder": str(folder.path),
        "libraries": len(folder.libraries()),
        "bytes": folder.size(),
        "compiler": None if compiler is None else " ".join(compiler.command[:2]),
        "compile": when.value,
        "failures": list(dict.fromkeys(faults)),
    }
    if removed is not None:
        facts["removed"] = removed
    if options.json:
        print_json(facts)
    else:
        report.print_kernels(facts)
    return NO if faults and options.compile is not None else YES


def _compiled(name: str) -> list[str]:
    """Compile the formulas of a problem, and return the reasons of a failure."""
    from zeno_orbits import api
    from zeno_orbits.model import load_problem

    problem = load_problem(name)
    try:
        api.compile_problem(problem)
    except InputError as error:
        text = str(error)
        return [text[0].lower() + text[1:].removesuffix(".")]
    return []
