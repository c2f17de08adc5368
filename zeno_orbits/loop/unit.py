"""A problem as a co-simulation unit of FMI 3.0: a zip with description, C code and library.

The unit integrates, and passes impacts, Zeno points and releases by itself. Source: the standard
"Functional Mock-up Interface 3.0", https://fmi-standard.org/docs/3.0/.
"""

from __future__ import annotations

import hashlib
import io
import math
import platform
import sys
import zipfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from zeno_orbits.errors import InputError, KernelError, not_known
from zeno_orbits.loop.compiler import find_compiler
from zeno_orbits.loop.export import (
    ExportedRun,
    c_array,
    c_number,
    c_text,
    exported_files,
    stem_of,
)
from zeno_orbits.loop.graph_program import GraphProgram
from zeno_orbits.loop.source import FLAGS, LIBRARIES, whole_source
from zeno_orbits.work import scratch_folder

_OWN = ("mode", "impacts", "zeno_points", "zeno_time")
"""Further outputs, in the order of `fmi3_unit.c`. With several stops the last three of each stop
follow."""

_MEANINGS = {
    "mode": "1 on the stop, 0 off it",
    "impacts": "number of impacts so far",
    "zeno_points": "number of Zeno points so far",
    "zeno_time": "time of the last Zeno point, NaN before the first",
}
TOKEN = "{token}"
TOKEN_LINE = f'#define INSTANTIATION_TOKEN "{TOKEN}"\n'
_DATE = (1980, 1, 1, 0, 0, 0)
"""Of the files in the zip: the same problem gives the same bytes."""


class ParameterRange(NamedTuple):
    """Values that a parameter may take.

    Attributes:
        lowest: Smallest value, or minus infinity.
        highest: Largest value, or infinity.
        words: The requirement, as in a message: ``lie in [0, 1)``.
    """

    lowest: float
    highest: float
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedUnit:
    """Contents of a co-simulation unit in addition to the code.

    Attributes:
        run: Names, values, start and settings.
        units: Unit of every state, gain and parameter, by name.
        meanings: One-line description of a gain or parameter, by name.
        tunable: Names that may change between steps.
        inputs: Names of gains or parameters that are inputs.
        ranges: Range of a parameter, by name. Other values are refused.
        derived: Names of the derived parameters that depend on a parameter, by its name. A
            change of the parameter must change them as well.
        clock: Indices of the cosine and sine of the clock in the state, or nothing.
        generator: Program and version that created the unit.
    """

    run: ExportedRun
    units: Mapping[str, str]
    meanings: Mapping[str, str]
    tunable: Collection[str]
    inputs: Collection[str]
    ranges: Mapping[str, ParameterRange]
    derived: Mapping[str, Sequence[str]]
    clock: Sequence[int]
    generator: str

    def require_inputs(self) -> None:
        """Reject an input that is not a gain or a parameter.

        Raises:
            InputError: If an input is unknown. The message lists the known names.
        """
        known = self.run.parameter_names
        for name in self.inputs:
            if name not in known:
                raise InputError(f"Argument `input`: {not_known(name, known)}")


def exported_unit(program: GraphProgram, unit: ExportedUnit) -> tuple[bytes, str]:
    """Return the unit as the bytes of a file `.fmu`, and the reason if it lacks a library.

    Args:
        program: The formulas of all modes.
        unit: Names, values and kinds of the variables.

    Raises:
        InputError: If an input is not a gain or a parameter.
    """
    unit.require_inputs()
    files = exported_files(program, unit.run)
    del files["main.c"]
    files["fmi3.c"] = _interface(unit)
    return packed(stem_of(unit.run.name), files, lambda token: _description(unit, token))


def packed(
    stem: str, sources: Mapping[str, str], description: Callable[[str], str]
) -> tuple[bytes, str]:
    """Return a unit as the bytes of a file `.fmu`, and the reason if it lacks a library.

    Args:
        stem: Identifier of the model.
        sources: C code by file name. ``fmi3.c`` includes all of it, and has `TOKEN` for the token.
        description: Function of the token that returns ``modelDescription.xml``.
    """
    token = _token(sources)
    files = {**sources, "fmi3.c": sources["fmi3.c"].replace(TOKEN, token)}
    library, reason = _library(files)
    content = {
        "modelDescription.xml": description(token).encode(),
        "sources/buildDescription.xml": _BUILD.format(stem=stem).encode(),
        **{f"sources/{name}": text.encode() for name, text in files.items()},
    }
    if library:
        content[f"binaries/{_platform()}/{stem}{_SUFFIXES.get(sys.platform, '.so')}"] = library
    return _zipped(content), reason


def _interface(unit: ExportedUnit) -> str:
    """Return the C code of the standard's functions. The token is inserted later."""
    stem = stem_of(unit.run.name)
    # The tables of the unit follow those of the problem.
    tables = f'#include "{stem}.c"\n\n{_tables(unit)}'
    return whole_source("fmi3.c", {"PROBLEM.c": tables}).replace("PROBLEM", stem)


def _tables(unit: ExportedUnit) -> str:
    """Return what the code has to know of the variables, as C."""
    names, changes = unit.run.parameter_names, {*unit.tunable, *unit.inputs}
    ranges = [unit.ranges.get(name, _UNBOUNDED) for name in names] or [_UNBOUNDED]
    pairs = [
        f"{{{names.index(name)}, {names.index(other)}}}"
        for name, others in unit.derived.items()
        for other in others
    ]
    tables = {
        "/* Parameters that may change between steps. */\nstatic const int MAY_CHANGE[]": [
            str(int(name in changes)) for name in names
        ]
        or ["0"],
        "/* Values that parameters may take. */\nstatic const double LOWEST[]": [
            c_number(one.lowest) for one in ranges
        ],
        "static const double HIGHEST[]": [c_number(one.highest) for one in ranges],
        "static const char *const RANGES[]": [c_text(one.words) for one in ranges],
        "/* Pairs of parameters, the second of which is derived from the first. */\n"
        "static const int DERIVED[][2]": [*pairs, "{-1, -1}"],
        "/* Cosine and sine of the clock in the state, or -1. */\nstatic const int CLOCK[2]": [
            *map(str, unit.clock or (-1, -1))
        ],
    }
    lines = (c_array(head, entries) for head, entries in tables.items())
    return "".join((TOKEN_LINE, *lines))


_UNBOUNDED = ParameterRange(-math.inf, math.inf, "")


def _token(files: Mapping[str, str]) -> str:
    digest = hashlib.sha256("\n".join(files.values()).encode()).hexdigest()
    return "-".join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32]))


def _library(files: Mapping[str, str]) -> tuple[bytes, str]:
    """Return the library of the unit for this machine, or the reason why it is missing."""
    try:
        compiler = find_compiler()
    except KernelError as error:
        return b"", str(error)
    if compiler is None:
        return b"", "a C compiler is missing"
    with scratch_folder() as folder:
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        target = folder / "unit.so"
        try:
            source = folder / "fmi3.c"
            compiler.compile(
                source, target, flags=FLAGS, libraries=LIBRARIES, on_wait=lambda _seconds: None
            )
        except KernelError as error:
            return b"", str(error)
        return target.read_bytes(), ""


_SUFFIXES = {"win32": ".dll", "darwin": ".dylib"}


def _platform() -> str:
    """Return the folder of this machine's library, as the standard names it."""
    machine = platform.machine().lower()
    known = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
    system = {"win32": "windows", "darwin": "darwin"}.get(sys.platform, "linux")
    return f"{known.get(machine, machine)}-{system}"


def _zipped(files: Mapping[str, bytes]) -> bytes:
    place = io.BytesIO()
    with zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as whole:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            whole.writestr(entry, content)
    return place.getvalue()


_BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="{stem}">
    <SourceFileSet language="C99" compilerOptions="-ffp-contract=off">
      <SourceFile name="fmi3.c"/>
    </SourceFileSet>
    <Library name="m"/>
  </BuildConfiguration>
</fmiBuildDescription>
"""


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of the description: its type, and its attributes in order."""

    kind: str
    attributes: dict[str, str]

    def text(self) -> str:
        """Return the element of XML."""
        words = " ".join(f"{name}={quoteattr(value)}" for name, value in self.attributes.items())
        return f"    <{self.kind} {words}/>\n"


def _description(unit: ExportedUnit, token: str) -> str:
    """Return `modelDescription.xml`."""
    run = unit.run
    variables = list(_variables(unit))
    stop, relative = run.settings[0].until, run.settings[0].relative
    experiment = (
        f'  <DefaultExperiment startTime="0" stopTime="{stop!r}" tolerance="{relative!r}" '
        f'stepSize="{stop / 1000!r}"/>\n'
    )
    return described(run.name, stem_of(run.name), token, unit.generator, variables, experiment)


def described(
    name: str,
    stem: str,
    token: str,
    generator: str,
    variables: Sequence[Variable],
    experiment: str = "",
) -> str:
    """Return ``modelDescription.xml`` of a unit for co-simulation.

    Args:
        name: Name of the model.
        stem: Its identifier.
        token: The token of the unit.
        generator: Program and version that created the unit.
        variables: Its variables, in the order of their references.
        experiment: Line of the default experiment, or empty.
    """
    outputs = [one for one in variables if one.attributes["causality"] == "output"]
    known = [one for one in outputs if one.attributes.get("initial") == "calculated"]
    units = sorted({one.attributes["unit"] for one in variables if "unit" in one.attributes})
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="3.0" ',
        f"modelName={quoteattr(name)} instantiationToken={quoteattr(token)} ",
        f"generationTool={quoteattr(generator)} variableNamingConvention=",
        f'"flat">\n  <CoSimulation modelIdentifier={quoteattr(stem)} ',
        'canHandleVariableCommunicationStepSize="true" canGetAndSetFMUState="true"/>\n',
        "  <UnitDefinitions>\n" if units else "",
        *(f"    <Unit name={quoteattr(one)}/>\n" for one in units),
        "  </UnitDefinitions>\n" if units else "",
        '  <LogCategories>\n    <Category name="logStatusError"/>\n  </LogCategories>\n',
        f"{experiment}  <ModelVariables>\n",
        *(one.text() for one in variables),
        "  </ModelVariables>\n  <ModelStructure>\n",
        *(f"    <Output valueReference={_reference(one)}/>\n" for one in outputs),
        *(f"    <InitialUnknown valueReference={_reference(one)}/>\n" for one in known),
        "  </ModelStructure>\n</fmiModelDescription>\n",
    ]
    return "".join(lines)


def _reference(variable: Variable) -> str:
    return quoteattr(variable.attributes["valueReference"])


def _variables(unit: ExportedUnit) -> Iterator[Variable]:
    """Yield the variables in the order of their references."""
    run, taken = unit.run, {"time", *unit.run.state_names, *unit.run.parameter_names}
    independent = {"causality": "independent", "variability": "continuous"}
    yield Variable("Float64", {"name": "time", "valueReference": "0", **independent})
    counter = count(1)
    for name, value in zip(run.state_names, run.state.tolist(), strict=True):
        kind = {"causality": "output", "variability": "continuous", "initial": "exact"}
        yield Variable("Float64", _attributes(unit, name, next(counter), value, kind))
    for name, value in zip(run.parameter_names, run.values.tolist(), strict=True):
        kind = {"causality": "parameter", "variability": "fixed", "initial": "exact"}
        if name in unit.inputs:
            kind = {"causality": "input", "variability": "discrete"}
        elif name in unit.tunable:
            kind["variability"] = "tunable"
        yield Variable("Float64", _attributes(unit, name, next(counter), value, kind))
    discrete = {"causality": "output", "variability": "discrete", "initial": "calculated"}
    several = len(run.stop_names) > 1
    for own, stop in [
        *((own, "") for own in _OWN),
        *((own, stop) for stop in run.stop_names if several for own in _OWN[1:]),
    ]:
        name = free_name(f"{own}_{stem_of(stop)}" if stop else own, taken)
        meaning = _MEANINGS[own] + (f", on the stop {stop}" if stop else "")
        if several and own == "mode":
            powers = (f"{2**k} for {stop}" for k, stop in enumerate(run.stop_names))
            meaning = f"sum over the closed stops: {', '.join(powers)}"
        words = {"name": name, "valueReference": str(next(counter)), "description": meaning}
        yield Variable("Float64" if own == "zeno_time" else "Int32", {**words, **discrete})


def _attributes(
    unit: ExportedUnit, name: str, reference: int, value: float, kind: Mapping[str, str]
) -> dict[str, str]:
    found = {"name": name, "valueReference": str(reference)}
    words = [unit.meanings[name]] if unit.meanings.get(name) else []
    if unit.derived.get(name):
        words.append(f"a change of it must also set {', '.join(unit.derived[name])}")
    if words:
        found["description"] = "; ".join(words)
    found.update(kind)
    measured = unit.units.get(name, "1")
    if measured != "1":
        found["unit"] = measured
    lowest, highest, _ = unit.ranges.get(name, _UNBOUNDED)
    ends = {"min": lowest, "max": highest, "start": value}
    return {**found, **{key: repr(end) for key, end in ends.items() if math.isfinite(end)}}


def free_name(name: str, taken: set[str]) -> str:
    """Return a name that no other variable has, and take it.

    Args:
        name: The name, to which underscores are added if it is taken.
        taken: Names of the other variables, to which the result is added.
    """
    while name in taken:
        name += "_"
    taken.add(name)
    return name
