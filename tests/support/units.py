"""The same machine in other units: what a change of kilogram, metre and second does to numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from zeno_orbits import Problem, Quantity
from zeno_orbits.arrays import Vector
from zeno_orbits.model import powers_of
from zeno_orbits.simulation import Execution, Impact

Dimension = tuple[int, int, int]
"""Powers of mass, length and time."""

PENDULUM: Mapping[str, Dimension] = {
    "L1": (0, 1, 0),
    "lc1": (0, 1, 0),
    "L2": (0, 1, 0),
    "lc2": (0, 1, 0),
    "m1": (1, 0, 0),
    "m2": (1, 0, 0),
    "I1": (1, 2, 0),
    "I2": (1, 2, 0),
    "J_rotor": (1, 2, 0),
    "R": (1, 2, -3),
    "L": (1, 2, -2),
    "K_torque": (1, 2, -2),
    "K_emf": (1, 2, -2),
    "restitution": (0, 0, 0),
    "g": (0, 1, -2),
    "Kp": (1, 2, -3),
    "Kd": (1, 2, -2),
}
"""Of every gain and parameter of the motor pendulum; the ampere stays what it is."""
PENDULUM_STATE: Sequence[Dimension] = ((0, 0, 0), (0, 0, 0), (0, 0, -1), (0, 0, -1), (0, 0, 0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Units:
    """How many of the new units make one SI unit.

    Attributes:
        mass: 1e3 for the gram.
        length: 1e3 for the millimetre.
        time: 1e3 for the millisecond.
    """

    mass: float = 1.0
    length: float = 1.0
    time: float = 1.0

    def factor(self, dimension: Dimension) -> float:
        """Return what a number of this dimension is multiplied by."""
        return math.prod(
            unit**power
            for unit, power in zip((self.mass, self.length, self.time), dimension, strict=True)
        )

    def numbers(
        self, values: Mapping[str, float], dimensions: Mapping[str, Dimension]
    ) -> dict[str, float]:
        """Return named quantities in the new units."""
        return {name: value * self.factor(dimensions[name]) for name, value in values.items()}

    def state(self, dimensions: Sequence[Dimension]) -> Vector:
        """Return the factor of every entry of a state, ``(n_x,)``."""
        return np.array([self.factor(dimension) for dimension in dimensions])

    def in_si(
        self, execution: Execution, dimensions: Sequence[Dimension], gap: Dimension
    ) -> Execution:
        """Return events and end of an execution, turned back into SI units."""
        rates, rate = self.state(dimensions), self.factor(gap) / self.time
        events = []
        for event in execution.events:
            changes: dict[str, Any] = {"time": event.time / self.time}
            if isinstance(event, Impact):
                changes["approach_rate"] = event.approach_rate / rate
                changes["state_minus"] = event.state_minus / rates
            events.append(replace(event, **changes))
        last = replace(execution.arcs[-1], end_state=execution.end_state / rates)
        return replace(execution, arcs=(*execution.arcs[:-1], last), events=tuple(events))


def in_units(problem: Problem, units: Units) -> Problem:
    """Return the same machine with its numbers in other units, and the words for these as before.

    Its model must be made of its named numbers alone: laws hold in any units.

    Args:
        problem: The problem, in SI units.
        units: The other units.
    """
    dimensions = {one.name: dimension_of(one.unit) for one in problem.quantities}
    states = dict(zip(problem.state_names, map(dimension_of, problem.state_units), strict=True))
    derive = problem.derive

    def derived(given: Mapping[str, float]) -> Mapping[str, float]:
        back = Units(mass=1 / units.mass, length=1 / units.length, time=1 / units.time)
        found = cast("Any", derive)(back.numbers(given, dimensions))
        return units.numbers(found, dimensions)

    def scaled(quantity: Quantity) -> Quantity:
        factor = units.factor(dimensions[quantity.name])
        default = quantity.default
        return replace(
            quantity,
            default=None if default is None else factor * default,
            lower=factor * quantity.lower,
            upper=factor * quantity.upper,
            excluded=tuple(factor * value for value in quantity.excluded),
        )

    return replace(
        problem,
        parameters=tuple(map(scaled, problem.parameters)),
        gains=tuple(map(scaled, problem.gains)),
        starts=tuple(units.numbers(start, states) for start in problem.starts),
        derive=None if derive is None else derived,
        escapes={
            name: replace(escape, beyond=escape.beyond * units.factor(states[name]))
            for name, escape in problem.escapes.items()
        },
        fidelities={word: in_units(one, units) for word, one in problem.fidelities.items()},
    )


def dimension_of(unit: str) -> Dimension:
    """Return the powers of mass, length and time in a unit; others stay what they are."""
    powers = powers_of(unit)
    return powers.get("kg", 0), powers.get("m", 0), powers.get("s", 0)
