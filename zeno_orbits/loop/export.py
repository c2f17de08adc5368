"""A problem as one C99 file with its header and an example program: no Python, no allocation.

The file contains the library, the formulas of the problem, and the settings of one run. Its results
are equal to the loop's results to the last digit, with the same C library.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from zeno_orbits.arrays import Vector
from zeno_orbits.loop import binding as c
from zeno_orbits.loop.formulas import FILE as FORMULAS
from zeno_orbits.loop.formulas import formulas_source
from zeno_orbits.loop.program import Program, scheme
from zeno_orbits.loop.run import RunSettings
from zeno_orbits.loop.source import HERE, whole_source
from zeno_orbits.loop.tape import Tape


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedRun:
    """Contents of an exported file in addition to the formulas.

    Attributes:
        name: Name of the problem, of files and identifiers.
        state_names: Name of each state.
        parameter_names: Name of each gain and parameter.
        values: Their values, ``(n_p,)``.
        state: Initial state of the example, ``(n_x,)``.
        settings: Accuracy and limits.
    """

    name: str
    state_names: Sequence[str]
    parameter_names: Sequence[str]
    values: Vector
    state: Vector
    settings: RunSettings


def exported_files(program: Program, run: ExportedRun) -> dict[str, str]:
    """Return the exported files, name to text: the code, its header and an example.

    Args:
        program: The formulas.
        run: Values and names.
    """
    stem = stem_of(run.name)
    header = (HERE / "loop.h").read_text(encoding="utf-8")
    header = header.replace("ZENO_LOOP_H", f"{stem.upper()}_H").rstrip()
    own = _DECLARATIONS.replace("PROBLEM", stem)
    header = header.removesuffix("#endif").rstrip() + f"\n\n{own}\n#endif\n"
    # The library includes its own header, which the exported header replaces.
    places = {
        "loop.h": f'#include "{stem}.h"\n',
        FORMULAS: formulas_source(program.n_x, program.tapes),
        **dict.fromkeys(("tangent.h", "tangent.c"), ""),
    }
    library = whole_source(skipped=places)
    code = "\n".join((library, *_data(program, run, stem)))
    main = (HERE / "example.c").read_text(encoding="utf-8").replace("PROBLEM", stem)
    return {f"{stem}.c": code, f"{stem}.h": header, "main.c": main}


def stem_of(name: str) -> str:
    """Return the name of files and identifiers for a problem."""
    return re.sub(r"\W", "_", name)


_DECLARATIONS = """/* The problem, the numbers of a run, and the names that belong to them. */
extern const zl_problem PROBLEM_problem;
extern const zl_settings PROBLEM_settings;
extern const double PROBLEM_parameters[];
extern const double PROBLEM_start[];
extern const char *const PROBLEM_state_names[];
extern const char *const PROBLEM_parameter_names[];
"""


def _data(program: Program, run: ExportedRun, stem: str) -> Iterable[str]:
    """Yield the definitions of the variables that the header declares."""
    for k, tape in enumerate(program.tapes):
        yield from _tape_arrays(k, tape)
    tapes = ",\n        ".join(_tape(k, tape) for k, tape in enumerate(program.tapes))
    problem = program.problem
    carried = ", ".join(map(str, problem.carried))
    counts = f"{problem.n_x}, {problem.n_q}, {problem.n_p}, {{{carried}}}"
    whole = f"{counts},\n    {{\n        {tapes}\n    }},\n    &scheme,\n    0"
    numbers = ",\n    ".join(_scheme(scheme()))
    yield f"static const zl_scheme scheme = {{\n    {numbers}\n}};\n"
    yield f"const zl_problem {stem}_problem = {{\n    {whole}\n}};\n"
    yield f"const zl_settings {stem}_settings = {{\n    {_settings(run.settings)}\n}};\n"
    yield _array(f"const double {stem}_parameters[]", map(_number, run.values.tolist()))
    yield _array(f"const double {stem}_start[]", map(_number, run.state.tolist()))
    yield _array(f"const char *const {stem}_state_names[]", map(_text, run.state_names))
    yield _array(f"const char *const {stem}_parameter_names[]", map(_text, run.parameter_names))


def _tape_arrays(k: int, tape: Tape) -> Iterable[str]:
    if len(tape.code):
        rows = ("{" + ", ".join(map(str, row)) + "}" for row in tape.code.tolist())
        yield _array(f"static const zl_instruction code_{k}[]", rows)
    if tape.constants.size:
        yield _array(f"static const double constants_{k}[]", map(_number, tape.constants.tolist()))
    if tape.outputs.size:
        yield _array(f"static const int outputs_{k}[]", map(str, tape.outputs.tolist()))


def _tape(k: int, tape: Tape) -> str:
    counts = (
        *(tape.n_varying, tape.n_parameters, tape.constants.size, tape.n_registers, tape.n_once),
        *(tape.n_first, len(tape.code), tape.outputs.size),
    )
    code = f"code_{k}" if len(tape.code) else "0"
    constants = f"constants_{k}" if tape.constants.size else "0"
    outputs = f"outputs_{k}" if tape.outputs.size else "0"
    return "{" + ", ".join((*map(str, counts), code, constants, outputs)) + "}"


def _scheme(place: c.SchemeType) -> Iterable[str]:
    for name in (entry[0] for entry in c.SchemeType._fields_):
        value = getattr(place, name)
        numbers = [value] if isinstance(value, float) else list(value)
        shown = _folded(map(_number, numbers), 8)
        yield shown if isinstance(value, float) else f"{{{shown}}}"


def _settings(settings: RunSettings) -> str:
    filled = settings.filled()
    entries: list[str] = []
    for name in (entry[0] for entry in c.SettingsType._fields_):
        value = getattr(filled, name)
        if isinstance(value, float):
            entries.append(_number(value))
        elif isinstance(value, int):
            entries.append(str(value))
        else:
            entries.append("{" + _folded(map(_number, list(value)), 4) + "}")
    return ",\n    ".join(entries)


def _number(value: float) -> str:
    """Return a number of C that has every digit."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    return repr(value)


def _text(word: str) -> str:
    return '"' + word.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _array(head: str, entries: Iterable[str]) -> str:
    return f"{head} = {{\n    {_folded(entries, 4)}\n}};\n"


def _folded(entries: Iterable[str], indent: int) -> str:
    space = " " * indent
    text = ", ".join(entries)
    return "\n".join(
        textwrap.wrap(
            text, 96, subsequent_indent=space, break_long_words=False, drop_whitespace=True
        )
    )
