"""Modes of a machine, the guards that end them, and the damping of its stops."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.experiment.rig.contact_damping import damping_number
from zeno_orbits.model import GraphDynamics


@dataclass(frozen=True, slots=True)
class RigMode:
    """A mode of a machine.

    Attributes:
        touched: Indices of the touched stops, in increasing order.
        sides: Side of every kink, True where its condition is positive.
        above: For each declared switch, whether its guard is positive.
    """

    touched: tuple[int, ...] = ()
    sides: tuple[bool, ...] = ()
    above: tuple[bool, ...] = ()

    def turned(self, stop: int) -> RigMode:
        """Return the mode in which a contact has begun or ended.

        Args:
            stop: Index of the stop.
        """
        return replace(self, touched=tuple(sorted({*self.touched} ^ {stop})))

    def flipped(self, graph: GraphDynamics, switch: int, x: Vector) -> RigMode:
        """Return the mode on the other side of a switch.

        Args:
            graph: The modes of the machine without compliance.
            switch: Index of the switch. The declared switches come first.
            x: The state there, ``(n_x,)``, at which later conditions take their sides anew.
        """
        kink = switch - len(self.above)
        if kink < 0:
            above = tuple(one ^ (k == switch) for k, one in enumerate(self.above))
            return replace(self, above=above)
        sides = tuple(one ^ (k == kink) for k, one in enumerate(self.sides))
        return replace(self, sides=graph.sides_at(x, sides, (kink,)))


@dataclass(frozen=True, slots=True)
class RigGuard:
    """A guard of a mode.

    Attributes:
        index: Index of its stop, or of its switch after all stops.
        on_guard: Whether the start is a root that does not count.
        rounding: Rounding level of the guard.
        above: False for the negative of a switch's guard.
    """

    index: int
    on_guard: bool
    rounding: float = 0.0
    above: bool = True


def damping_numbers(restitutions: Mapping[str, float]) -> tuple[float, ...]:
    """Return the damping number of every stop.

    Args:
        restitutions: Name of each stop to its restitution.

    Raises:
        InputError: If a restitution is 0.
    """
    numbers = tuple(map(damping_number, restitutions.values()))
    for name, number in zip(restitutions, numbers, strict=True):
        if math.isinf(number):
            at = f" of the stop `{name}`" if len(numbers) > 1 else ""
            wanted = "must be greater than 0 for a compliant contact"
            raise InputError(f"Argument `restitution`{at} {wanted}, but it is 0.")
    return numbers
