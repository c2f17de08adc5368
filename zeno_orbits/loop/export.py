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
from zeno_orbits.loop.graph_program import GraphProgram
from zeno_orbits.loop.program import TapedProblem, scheme
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
        settings: Accuracy and limits at every stop.
        stop_names: Name of each stop.
        switch_names: Name of each switch, the declared switches before the kinks.
    """

    name: str
    state_names: Sequence[str]
    parameter_names: Sequence[str]
    values: Vector
    state: Vector
    settings: Sequence[RunSettings]
    stop_names: Sequence[str]
    switch_names: Sequence[str] = ()


_ONLY_HERE = tuple(f"{name}.{end}" for name in ("tangent", "turns", "returns") for end in "hc")
"""Parts of the library that an exported run lacks."""


def exported_files(program: GraphProgram, run: ExportedRun) -> dict[str, str]:
    """Return the exported files, name to text: the code, its header and an example.

    Args:
        program: The formulas of all modes.
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
        **dict.fromkeys(_ONLY_HERE, ""),
    }
    if program.only_view is not None:
        view = program.only_view
        places[FORMULAS] = formulas_source(program.n_x, {view.problem.formulas: view.tapes})
    library = whole_source(skipped=places)
    code = "\n".join((library, *_data(program, run, stem)))
    main = (HERE / "example.c").read_text(encoding="utf-8").replace("PROBLEM", stem)
    return {f"{stem}.c": code, f"{stem}.h": header, "main.c": main}


def stem_of(name: str) -> str:
    """Return the name of files and identifiers for a problem."""
    return re.sub(r"\W", "_", name)


_DECLARATIONS = """/* The problem, the settings of a run at every stop, and names. */
extern const zl_problem PROBLEM_problem;
extern const zl_settings PROBLEM_settings[];
extern const double PROBLEM_parameters[];
extern const double PROBLEM_start[];
extern const char *const PROBLEM_state_names[];
extern const char *const PROBLEM_parameter_names[];
extern const char *const PROBLEM_stop_names[];
extern const char *const PROBLEM_switch_names[];
"""


class _Arrays:
    """Definitions of arrays, each of which is written once."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._names: dict[str, str] = {}
        self._tables: dict[int, str] = {}

    def name(self, kind: str, entries: Sequence[str]) -> str:
        """Return the name of an array of constants, or ``0`` if it is empty."""
        if not entries:
            return "0"
        text = _folded(entries, 4)
        key = f"{kind} {text}"
        if key not in self._names:
            self._names[key] = name = f"data_{len(self._names)}"
            self.texts.append(f"static const {kind} {name}[] = {{\n    {text}\n}};\n")
        return self._names[key]

    def table(self, table: Vector) -> str:
        """Return the name of a table, whose text is made once."""
        if id(table) not in self._tables:
            numbers = list(map(c_number, table.tolist()))
            self._tables[id(table)] = self.name("double", numbers)
        return self._tables[id(table)]

    def tape(self, tape: Tape) -> str:
        """Return a formula as an entry."""
        rows = ["{" + ", ".join(map(str, row)) + "}" for row in tape.code.tolist()]
        counts = (
            *(tape.n_varying, tape.n_parameters, tape.constants.size, tape.n_registers),
            *(tape.n_once, tape.n_first, len(tape.code), tape.outputs.size),
        )
        names = (
            self.name("zl_instruction", rows),
            self.name("double", list(map(c_number, tape.constants.tolist()))),
            self.name("int", list(map(str, tape.outputs.tolist()))),
            self.name("double *const", list(map(self.table, tape.tables))),
        )
        return "{" + ", ".join((*map(str, counts), *names)) + "}"

    def problem(self, program: TapedProblem, graph: str = "0") -> str:
        """Return a view, or a graph, as an entry."""
        problem, tapes = program.problem, list(map(self.tape, program.tapes)) or ["{0}"]
        carried = ", ".join(map(str, problem.carried))
        counts = f"{problem.n_x}, {problem.n_q}, {problem.n_p}, {{{carried}}}"
        inside = ",\n        ".join(tapes)
        return (
            f"{{\n    {counts},\n    {{\n        {inside}\n    }},\n    &scheme,\n    {graph},\n"
            f"    {problem.formulas},\n    0\n}}"
        )

    def graph(self, program: GraphProgram) -> str:
        """Return the tables of a graph as an entry."""
        views = [self.problem(view) for view in program.views.values()]
        sides = [
            f"{{{program.place_of(side)}, {self.tape(value)}, {self.tape(bounds)}}}"
            for side, (value, bounds) in program.sides.items()
        ]
        resets = list(map(self.tape, program.resets))
        shared = (program.switches, program.delassus, program.orders)
        formulas = program.formulas
        counts = (
            *(formulas.n_stops, formulas.n_declared, formulas.n_switches, len(views), len(sides)),
            formulas.n_frictional,
            program.n_numbers,
            *map(program.place_of, shared),
            *formulas.clock,
        )
        entries = (
            *map(str, counts),
            *map(self.tape, shared),
            self.name("zl_tape", resets),
            self.name("long long", [str(program.place_of(tape)) for tape in program.resets]),
            self.name("long long", list(map(str, program.cause_keys))),
            self.name("long long", [str(view.key) for view in program.views]),
            self.name("long long", [str(program.place_of(view)) for view in program.views]),
            self.name("zl_problem", views),
            self.name("long long", [str(side.key) for side in program.sides]),
            self.name("zl_side", sides),
        )
        return "{\n    " + ",\n    ".join(entries) + "\n}"


def _data(program: GraphProgram, run: ExportedRun, stem: str) -> Iterable[str]:
    """Yield the definitions of the variables that the header declares."""
    numbers = ",\n    ".join(_scheme(scheme()))
    yield f"static const zl_scheme scheme = {{\n    {numbers}\n}};\n"
    arrays = _Arrays()
    graph = arrays.graph(program)
    whole = arrays.problem(program, "&graph")
    yield from arrays.texts
    yield f"static const zl_graph graph = {graph};\n"
    yield f"const zl_problem {stem}_problem = {whole};\n"
    settings = ["{\n    " + _settings(one) + "\n}" for one in run.settings]
    yield f"const zl_settings {stem}_settings[] = {{{', '.join(settings)}}};\n"
    # C has no empty arrays.
    values = run.values.tolist() or [0.0]
    yield c_array(f"const double {stem}_parameters[]", map(c_number, values))
    yield c_array(f"const double {stem}_start[]", map(c_number, run.state.tolist()))
    for name, words in (
        ("state", run.state_names),
        ("parameter", run.parameter_names),
        ("stop", run.stop_names),
        ("switch", run.switch_names),
    ):
        yield c_array(f"const char *const {stem}_{name}_names[]", map(c_text, words or ("",)))


def _scheme(place: c.SchemeType) -> Iterable[str]:
    for name in (entry[0] for entry in c.SchemeType._fields_):
        value = getattr(place, name)
        numbers = [value] if isinstance(value, float) else list(value)
        shown = _folded(map(c_number, numbers), 8)
        yield shown if isinstance(value, float) else f"{{{shown}}}"


def _settings(settings: RunSettings) -> str:
    filled = settings.filled()
    entries: list[str] = []
    for name in (entry[0] for entry in c.SettingsType._fields_):
        value = getattr(filled, name)
        if isinstance(value, float):
            entries.append(c_number(value))
        elif isinstance(value, int):
            entries.append(str(value))
        else:
            entries.append("{" + _folded(map(c_number, list(value)), 4) + "}")
    return ",\n    ".join(entries)


def c_number(value: float) -> str:
    """Return a number as C has it, with every digit.

    Args:
        value: The number.
    """
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    return repr(value)


def c_text(word: str) -> str:
    """Return a text as C has it.

    Args:
        word: The text.
    """
    return '"' + word.replace("\\", "\\\\").replace('"', '\\"') + '"'


def c_array(head: str, entries: Iterable[str]) -> str:
    """Return the definition of an array as C has it.

    Args:
        head: Type and name.
        entries: Its entries.
    """
    return f"{head} = {{\n    {_folded(entries, 4)}\n}};\n"


def _folded(entries: Iterable[str], indent: int) -> str:
    space = " " * indent
    # A line must not end inside of a text.
    text = _QUOTED.sub(lambda found: found[0].replace(" ", "\0"), ", ".join(entries))
    lines = textwrap.wrap(
        text, 96, subsequent_indent=space, break_long_words=False, drop_whitespace=True
    )
    return "\n".join(lines).replace("\0", " ")


_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"')
