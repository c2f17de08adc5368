"""The command `cache`."""

from __future__ import annotations

import argparse
from typing import Any

from zeno_orbits.cli.options import NO, YES, add_command, print_json
from zeno_orbits.report import terminal as report


def add_cache(commands: Any) -> None:
    """Add the command `cache`."""
    parser = add_command(
        commands,
        "cache",
        _run_cache,
        "tell where compiled steps are kept, and how large they are; fill and clear the folder",
        [
            "zeno-orbits cache",
            "zeno-orbits cache --compile motor_pendulum",
            "zeno-orbits cache --clear",
        ],
    )
    parser.add_argument(
        "--compile", metavar="PROBLEM", help="compile the steps of a problem now, and wait for it"
    )
    parser.add_argument("--clear", action="store_true", help="remove everything that is kept")


def _run_cache(options: argparse.Namespace) -> int:
    from zeno_orbits.kernels import complaints, kernel_folder, usable_compiler, when_to_compile

    when, folder = when_to_compile(), kernel_folder()
    removed = folder.clear() if options.clear else None
    done = options.compile is None or _compiled(options.compile)
    compiler = usable_compiler()
    facts = {
        "folder": str(folder.path),
        "libraries": len(folder.libraries()),
        "bytes": folder.size(),
        "compiler": None if compiler is None else " ".join(compiler.command[:2]),
        "compile": when.value,
        "failures": list(dict.fromkeys((*folder.failures(), *complaints()))),
    }
    if removed is not None:
        facts["removed"] = removed
    if options.json:
        print_json(facts)
    else:
        report.print_kernels(facts)
    return YES if done else NO


def _compiled(name: str) -> bool:
    """Compile the steps of a problem and return True if all of them are compiled."""
    from zeno_orbits.model import load_problem

    problem = load_problem(name)
    return problem.compiled().build(problem.values().vector)
