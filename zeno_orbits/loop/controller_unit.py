"""The controller of a machine as a co-simulation unit of FMI 3.0, around its C99 file.

Readings and contacts are inputs, held states and voltages are outputs. A step takes the readings of
its begin, and the voltages hold until its end, as those of a sampled controller do.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count

from zeno_orbits.arrays import Vector
from zeno_orbits.loop.controller import ExportedController, controller_files
from zeno_orbits.loop.export import c_array, c_number, stem_of
from zeno_orbits.loop.source import whole_source
from zeno_orbits.loop.unit import TOKEN_LINE, Variable, described, free_name, packed


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerUnit:
    """Contents of the unit of a controller in addition to its code.

    Attributes:
        controller: The controller.
        state: State of the machine whose readings are taken before any is set, ``(n_x,)``.
        units: Unit of every state, by name.
        generator: Program and version that created the unit.
    """

    controller: ExportedController
    state: Vector
    units: Mapping[str, str]
    generator: str


def exported_controller_unit(unit: ControllerUnit) -> tuple[bytes, str]:
    """Return the unit as the bytes of a file `.fmu`, and the reason if it lacks a library.

    Args:
        unit: The controller and the kinds of its variables.

    Raises:
        UnknownOperationError: If a formula holds an operation that the code lacks.
    """
    name = unit.controller.name
    stem = f"{stem_of(name)}_controller"
    sources = controller_files(unit.controller)
    first = [c_number(value) for _, value in _sensors(unit)] or ["0.0"]
    tables = c_array("static const double FIRST_SENSORS[]", first)
    code = f'#include "{stem}.c"\n\n{TOKEN_LINE}{tables}'
    sources["fmi3.c"] = (
        whole_source("fmi3_controller.c", {"CONTROLLER.c": code})
        .replace("NAME_", f"{stem_of(name)}_")
        .replace("CONTROLLER.so", f"{stem}.so")
    )
    variables = list(_variables(unit))
    return packed(
        stem, sources, lambda token: described(stem, stem, token, unit.generator, variables)
    )


def _sensors(unit: ControllerUnit) -> list[tuple[str, float]]:
    """Return the names and first readings of the states that are measured."""
    known = unit.controller
    rows = zip(known.state_names, unit.state.tolist(), strict=True)
    return [row for k, row in enumerate(rows) if k not in known.held]


def _variables(unit: ControllerUnit) -> Iterator[Variable]:
    """Yield the variables in the order of their references."""
    known, counter = unit.controller, count(1)
    taken = {"time", *known.state_names}
    independent = {"causality": "independent", "variability": "continuous"}
    yield Variable("Float64", {"name": "time", "valueReference": "0", **independent})
    for name, value in _sensors(unit):
        kind = {"causality": "input", "variability": "continuous"}
        yield _float(
            unit, name, next(counter), f"reading of {name}", {**kind, "start": repr(value)}
        )
    for stop in known.stop_names:
        name = free_name(
            f"contact_{stem_of(stop)}" if len(known.stop_names) > 1 else "contact", taken
        )
        words = {"name": name, "valueReference": str(next(counter))}
        words |= {"description": f"true in contact with {stop}"}
        yield Variable(
            "Boolean", {**words, "causality": "input", "variability": "discrete", "start": "false"}
        )
    discrete = {"causality": "output", "variability": "discrete", "initial": "calculated"}
    for k in known.held:
        name = known.state_names[k]
        yield _float(unit, name, next(counter), "held from event to event", discrete)
    n_voltages = known.voltage.numel_out(0)
    for k in range(n_voltages):
        name = free_name(f"voltage_{k + 1}" if n_voltages > 1 else "voltage", taken)
        words = {"name": name, "valueReference": str(next(counter))}
        words |= {"description": "voltage of a motor, held until the next step"}
        yield Variable("Float64", {**words, **discrete, "unit": "V"})


def _float(
    unit: ControllerUnit, name: str, reference: int, meaning: str, kind: Mapping[str, str]
) -> Variable:
    found = {"name": name, "valueReference": str(reference), "description": meaning, **kind}
    measured = unit.units.get(name, "1")
    return Variable("Float64", found if measured == "1" else {**found, "unit": measured})
