"""The formulas of a machine as C, in the order of their tapes, so that all digits are equal.

They are compiled alone, in a fraction of a second. The library of the loop calls them.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

from zeno_orbits.loop import binding as c
from zeno_orbits.loop.source import HERE, whole_source
from zeno_orbits.loop.tape import Tape

FILE, CODE = "formulas.c", "code.c"

_OPERATION = re.compile(r"^ +ONE\((?P<name>OP_\w+), (?P<formula>.+)\) *\\?$", re.MULTILINE)
_WORD = re.compile(r"\b[xyw]\b")
_CALL = re.compile(r"[a-z]\w*\(")
_LOOKUP = re.compile(r"\b(cell_of|cell_of_turn|number_of_cell)\(")


def machine_source(n_x: int, views: Mapping[int, Sequence[Tape]]) -> str:
    """Return the C code of the formulas of one machine, without the loop.

    Args:
        n_x: Number of states.
        views: The formulas of each view in the order of `loop.h`, by its `view_number`.
    """
    text = formulas_source(n_x, views)
    places = {FILE: text} if _LOOKUP.search(text) else {FILE: text, "lookup.c": ""}
    return whole_source(CODE, places)


def formulas_source(n_x: int, views: Mapping[int, Sequence[Tape]]) -> str:
    """Return the C code that stands in the place of `formulas.c`.

    Args:
        n_x: Number of states.
        views: The formulas of each view in the order of `loop.h`, by its `view_number`.
    """
    watched = range(c.WATCHED, c.GAP)
    formulas, lanes = dict[int, list[int]](), dict[int, list[int]]()
    parts = ["/* The formulas of a machine. */\n", f"enum {{ KNOWN_STATES = {n_x} }};\n"]
    for number, tapes in views.items():
        compiled = [k for k, tape in enumerate(tapes) if tape.outputs.size and k not in watched]
        rates = [k for k in compiled if c.RATE <= k < c.GUARD]
        parts += [_function(f"formula_{number}_{k}", tapes[k]) for k in compiled]
        parts += [_lanes_function(f"lanes_{number}_{k}", tapes[k]) for k in rates]
        formulas[number], lanes[number] = compiled, rates
    parts += [_choice("compiled_formula", "formula", formulas)]
    parts += [_choice("compiled_lanes", "lanes", lanes)]
    return "\n".join(parts)


def view_number(digest: str) -> int:
    """Return the number by which a library knows the formulas of a view.

    Args:
        digest: Digest of the formulas.
    """
    return int(digest[:15], 16)


def formulas_digest(n_x: int, tapes: Sequence[Tape]) -> str:
    """Return a digest of formulas, and of the program that writes them as C.

    Args:
        n_x: Number of states.
        tapes: The formulas.
    """
    digest = hashlib.sha256(Path(__file__).read_bytes() + (HERE / CODE).read_bytes())
    for tape in tapes:
        counts = (n_x, tape.n_varying, tape.n_parameters, tape.n_registers, tape.n_once)
        digest.update(repr((counts, tape.code.shape, tape.outputs.shape)).encode())
        for numbers in (tape.code, tape.constants, tape.outputs):
            digest.update(numbers.tobytes())
    return digest.hexdigest()[:32]


@cache
def _formulas() -> tuple[str, ...]:
    """Return the C expression of every operation in `x`, `y` and `w`, from `tape.c` itself."""
    text = (HERE / "tape.c").read_text(encoding="utf-8")
    return tuple(found["formula"].strip() for found in _OPERATION.finditer(text))


_ARGUMENTS = "const double *const *tables, const double *r, const double *v, double *z"
_UNUSED = "    (void)tables, (void)r, (void)v;\n"


def _choice(name: str, stem: str, views: Mapping[int, Iterable[int]]) -> str:
    """Return the function that selects one of several functions by view and index."""
    arguments = "const zl_problem *problem, int tape, const double *r, const double *v, double *z"
    text = [f"static int {name}({arguments}) {{\n"]
    text.append("    const double *const *tables = problem->tapes[tape].tables;\n")
    text.append("    switch (problem->formulas) {\n")
    for number, places in views.items():
        text.append(f"    case {number}LL:\n        switch (tape) {{\n")
        text += [
            f"        case {k}: {stem}_{number}_{k}(tables, r, v, z); break;\n" for k in places
        ]
        text.append("        }\n        return 1;\n")
    return "".join((*text, "    }\n    return 0;\n}\n"))


@dataclass(frozen=True, slots=True)
class _Line:
    """An instruction with each result named once.

    Attributes:
        name: Name of its result.
        formula: A C expression in other names.
        operands: Results that it takes.
        calls: Whether it calls a function, which is evaluated for one lane after the other.
    """

    name: str
    formula: str
    operands: tuple[str, ...]
    calls: bool


@dataclass(frozen=True, slots=True)
class _Body:
    """The instructions of a tape that vary, and its outputs as names and numbers."""

    lines: tuple[_Line, ...]
    outputs: tuple[str, ...]


def _body(tape: Tape) -> _Body:
    """Return a tape with a name in the place of every register that is used again."""
    names = [f"v[{k}]" for k in range(tape.n_varying)]
    # Constants too: of a power with a number compilers make products, which round otherwise.
    names += [f"r[{k}]" for k in range(len(names), tape.n_registers)]
    lines: list[_Line] = []
    results: set[str] = set()
    rows: list[list[int]] = tape.code[tape.n_once :].tolist()
    for k, (operation, to, *places) in enumerate(rows):
        pattern = _formulas()[operation]
        used = dict(zip("xyw", (names[place] for place in places), strict=True))
        words = sorted(set(_WORD.findall(pattern)))
        formula = _WORD.sub(partial(_replaced, used), pattern)
        operands = tuple(used[word] for word in words if used[word] in results)
        calls = _CALL.search(pattern) is not None and not pattern.startswith(_INLINE)
        names[to] = f"t{k}"
        lines.append(_Line(names[to], formula, operands, calls))
        results.add(names[to])
    outputs: list[int] = tape.outputs.tolist()
    return _Body(tuple(lines), tuple(names[place] for place in outputs))


def straight_line(name: str, tape: Tape) -> str:
    """Return a formula as a function of states alone, whose parameters are the array `p`.

    Args:
        name: Name of the function.
        tape: The formula.
    """
    first = tape.n_varying + tape.n_parameters
    names = [f"x[{k}]" for k in range(tape.n_varying)]
    names += [f"p[{k}]" for k in range(tape.n_parameters)]
    names += [f"({value!r})" for value in tape.constants.tolist()]
    names += [""] * (tape.n_registers - first - tape.constants.size)
    lines: list[str] = []
    rows: list[list[int]] = tape.code.tolist()
    for k, (operation, to, *places) in enumerate(rows):
        used = dict(zip("xyw", (names[place] for place in places), strict=True))
        formula = _WORD.sub(partial(_replaced, used), _formulas()[operation])
        names[to] = f"t{k}"
        lines.append(f"    const double t{k} = {formula};\n")
    outputs: list[int] = tape.outputs.tolist()
    ends = "".join(f"    z[{i}] = {names[place]};\n" for i, place in enumerate(outputs))
    body = f"{''.join(lines)}    (void)x, (void)z;\n{ends}"
    text = f"static void {name}(const double *x, double *z) {{\n{body}}}\n\n"
    return text.replace("(inf)", "INFINITY").replace("(-inf)", "(-INFINITY)")


def _replaced(names: Mapping[str, str], word: re.Match[str]) -> str:
    return names[word[0]]


_INLINE = ("sqrt(", "fabs(")
"""Functions that compilers carry out as one instruction."""


def _function(name: str, tape: Tape) -> str:
    """Return a formula as a function of its varying entries."""
    body = _body(tape)
    lines = "".join(f"    const double {one.name} = {one.formula};\n" for one in body.lines)
    ends = "".join(f"    z[{i}] = {name};\n" for i, name in enumerate(body.outputs))
    return f"static void {name}({_ARGUMENTS}) {{\n{lines}{_UNUSED}{ends}}}\n"


def _lanes_function(name: str, tape: Tape) -> str:
    """Return a formula as a function of rows, with one entry per lane.

    Operations that call functions are in separate loops, so that compilers vectorise the others.
    """
    body = _body(tape)
    groups = list(_groups(body.lines))
    home = {line.name: at for at, group in enumerate(groups) for line in group}
    shared = {
        name
        for at, group in enumerate(groups)
        for line in group
        for name in line.operands
        if home[name] != at
    }
    shared.update(name for name in body.outputs if home.get(name, len(groups)) != len(groups) - 1)
    shared &= home.keys()
    rows = ", ".join(f"{name}_[{c.LANES}]" for name in sorted(shared, key=lambda t: int(t[1:])))
    text = [f"static void {name}({_ARGUMENTS}) {{\n"]
    text += [f"    double {rows};\n"] if rows else []
    text += ["    int i;\n", _UNUSED]
    for at, group in enumerate(groups):
        inside = {line.name for line in group}
        most = c.STAGES if group[0].calls else c.LANES
        text.append(f"    for (i = 0; i < {most}; i++) {{\n")
        for line in group:
            formula = _in_lanes(line.formula, shared - inside)
            text.append(f"        const double {line.name} = {formula};\n")
        text += [
            f"        {line.name}_[i] = {line.name};\n" for line in group if line.name in shared
        ]
        if at == len(groups) - 1:
            text += _lane_outputs(body, shared - inside)
        text.append("    }\n")
        if most < c.LANES:
            kept = [line.name for line in group if line.name in shared]
            last = c.LANES - 1
            text += [f"    {name}_[{last}] = {name}_[0];\n" for name in kept]
    if not groups:
        text.append(f"    for (i = 0; i < {c.LANES}; i++) {{\n")
        text += [*_lane_outputs(body, set()), "    }\n"]
    return "".join((*text, "}\n"))


def _lane_outputs(body: _Body, rows: set[str]) -> list[str]:
    return [
        f"        z[{i * c.LANES} + i] = {_in_lanes(name, rows)};\n"
        for i, name in enumerate(body.outputs)
    ]


_NAME = re.compile(r"\bt\d+\b")
_VARYING = re.compile(r"\bv\[(\d+)\]")


def _in_lanes(formula: str, rows: set[str]) -> str:
    """Return a formula with rows in the place of names, at lane `i`."""
    named = _NAME.sub(lambda found: f"{found[0]}_[i]" if found[0] in rows else found[0], formula)
    return _VARYING.sub(lambda found: f"v[{int(found[1]) * c.LANES} + i]", named)


def _groups(lines: Sequence[_Line]) -> Iterator[list[_Line]]:
    """Yield instructions in groups with or without function calls, each after its dependencies."""
    waiting, done, calls = list(lines), set[str](), False
    while waiting:
        group: list[_Line] = []
        for line in waiting:
            if line.calls == calls and done.issuperset(line.operands):
                group.append(line)
                done.add(line.name)
        if group:
            yield group
        taken = {line.name for line in group}
        waiting = [line for line in waiting if line.name not in taken]
        calls = not calls
