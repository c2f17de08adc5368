"""One name per concept: options of the command line, and arguments of functions.

Both helps are printed from this table: `meaning_of` is the help of an option, and `options_line`
closes the docstring of a function.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Name:
    """The name of a concept.

    Attributes:
        name: Argument of functions. The option is the same with ``--`` and hyphens.
        form: Value of the option.
        meaning: What it is, in a clause.
    """

    name: str
    form: str
    meaning: str

    @property
    def option(self) -> str:
        """The option of the command line."""
        return f"--{self.name.replace('_', '-')}"


NAMES = {
    one.name: one
    for one in (
        Name(
            name="until",
            form="T",
            meaning="end of a simulation, or longest time until a motion settles [s]",
        ),
        Name(
            name="start",
            form="STATE=VALUE",
            meaning="initial value of a state, 0 for the others",
        ),
        Name(
            name="near",
            form="ORBIT.json",
            meaning="known orbit to start from, with its values",
        ),
        Name(
            name="vary",
            form="NAME=LOW:HIGH",
            meaning="range in which a gain or parameter is searched",
        ),
        Name(
            name="bounds",
            form="NAME=LOWER:UPPER",
            meaning="bounds that the orbit satisfies",
        ),
        Name(
            name="parameter",
            form="NAME=LOW:HIGH",
            meaning="gain or parameter of a family, and its range, which contains the start",
        ),
        Name(
            name="parameter2",
            form="NAME=LOW:HIGH",
            meaning="second parameter, in which special points are followed",
        ),
        Name(
            name="interval",
            form="NAME=VALUE:RADIUS",
            meaning="interval of a gain or parameter, which the proof covers as a whole",
        ),
        Name(
            name="branch",
            form="NAME=LOW:HIGH",
            meaning="interval of a gain or parameter over which a curve of orbits is proved",
        ),
        Name(name="x", form="NAME=LOW:HIGH[:COUNT]", meaning="axis of a map across"),
        Name(name="y", form="NAME=LOW:HIGH[:COUNT]", meaning="axis of a map upwards"),
        Name(
            name="directions",
            form="NAME=VALUE,...",
            meaning="generalized force along which an impulse acts",
        ),
        Name(name="t_start", form="T", meaning="earlier data of a recording are ignored [s]"),
        Name(name="t_end", form="T", meaning="later data of a recording are ignored [s]"),
        Name(
            name="initial",
            form="NAME,...",
            meaning="further initial values of a transient to determine: states, `clock`, `offset`",
        ),
        Name(name="section", form="EVENT", meaning="event at which a period starts and ends"),
        Name(name="shape", form="SHAPE", meaning="mode sequence of an orbit"),
        Name(name="objective", form="WISH", meaning="choice among the orbits"),
        Name(name="method", form="METHOD", meaning="method of the computation"),
    )
}
"""Name to its row, in the order of the documentation."""


def meaning_of(name: str, more: str = "") -> str:
    """Return the help of an option.

    Args:
        name: Name of a row.
        more: What holds for one command alone.
    """
    return f"{NAMES[name].meaning}{more}"


def options_line(arguments: Iterable[str]) -> str:
    """Return the options of the command line with the names of given arguments, or no text.

    Args:
        arguments: Names of arguments, in order.
    """
    known = [NAMES[name] for name in arguments if name in NAMES]
    return ", ".join(f"`{one.option} {one.form}`" for one in known)


def names_table() -> str:
    """Return the names as a table in Markdown."""
    rows = [
        f"| `{one.name}` | `{one.option} {one.form}` | {one.meaning} |" for one in NAMES.values()
    ]
    return "\n".join(["| Argument | Option | Meaning |", "|---|---|---|", *rows])
