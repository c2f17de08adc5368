"""The command `new`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from zeno_orbits.cli.options import YES, add_command, print_json, say_written
from zeno_orbits.errors import InputError
from zeno_orbits.work.files import write_whole


def add_new(commands: Any) -> None:
    """Add the command `new`."""
    parser = add_command(
        commands,
        "new",
        _run_new,
        "write a problem that works, to change into your own",
        [
            "zeno-orbits new my_problem",
            "zeno-orbits new my_problem --with-motor",
            "zeno-orbits search ./my_problem.py",
        ],
    )
    parser.add_argument("name", metavar="NAME", help="of the problem; the file is NAME.py")
    parser.add_argument(
        "--with-motor",
        action="store_true",
        help="a DC motor under feedback drives it; else a periodic force does",
    )


def template(*, with_motor: bool) -> str:
    """Return a problem file that works, whose problem is called NAME."""
    name = "motor" if with_motor else "periodic_force"
    path = Path(__file__).parent / "templates" / f"{name}.py.txt"
    return path.read_text(encoding="utf-8")


def _run_new(options: argparse.Namespace) -> int:
    from zeno_orbits.model.library import bundled_problems

    if not options.name.isidentifier():
        wanted = "must be a word of letters, digits and underscores"
        raise InputError(f"Argument `name` {wanted}, but it is `{options.name}`.")
    if options.name in bundled_problems():
        wanted = "must not be that of a problem which comes with the package"
        raise InputError(f"Argument `name` {wanted}, but `{options.name}` is one.")
    path = Path(f"{options.name}.py")
    if path.exists():
        raise InputError(f"Argument `name` must be of a new file, but `{path}` exists.")
    content = template(with_motor=options.with_motor)
    write_whole(path, content.replace("NAME", options.name))
    if options.json:
        print_json({"problem": str(path)})
    else:
        say_written(options, [path])
    return YES
