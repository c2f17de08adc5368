"""A problem in numbers of a given length: its flows, its contact and its reset map."""

from __future__ import annotations

from collections.abc import Sequence

from zeno_orbits.model import CompiledSystem, ContactQuantities, ImpactLaw
from zeno_orbits.precision.multiprecision import Arithmetic, Formula, Real, flow_of

State = list[Real]

_LOST = 3
"""Digits that the conditions on the stop lose against the numbers they are made of."""


class ExtendedSystem:
    """A problem at fixed numbers, in numbers of a length: flows, contact and reset map."""

    def __init__(
        self, arithmetic: Arithmetic, compiled: CompiledSystem, values: Sequence[float]
    ) -> None:
        """Compile the flows; takes about a second.

        Args:
            arithmetic: Length of the numbers.
            compiled: The problem.
            values: Gains, then parameters, exactly.
        """
        self.arithmetic = arithmetic
        self.n_x, self.n_q, self.n_values = compiled.n_x, compiled.n_q, len(values)
        self.flight = flow_of(arithmetic, compiled.flight.rate, (*values, 1.0))
        self.locked = flow_of(arithmetic, compiled.locked.rate, values, compiled.locked.guard)
        self._contact = Formula(arithmetic, compiled.contact, values)
        self.holonomic = Formula(arithmetic, compiled.holonomic, values)
        self._locked_rate = Formula(arithmetic, compiled.locked.rate, values)
        self._impulse = Formula(arithmetic, compiled.impulse, values)

    @property
    def smallest(self) -> float:
        """Size below which a condition on the stop counts as zero."""
        return 10.0 ** (_LOST - self.arithmetic.digits)

    def contact(self, x: State) -> ContactQuantities:
        """Return the contact quantities at a state."""
        return ContactQuantities(*self._contact(x)[0])

    def on_stop(self, x: State) -> State:
        """Return the state moved onto the stop along the impulse, gap and gap rate zero."""
        (direction,), n_q = self._impulse(x)[:1], self.n_q
        gap = self.contact(x).gap
        shifts = [gap * d for d in direction[n_q : 2 * n_q]]
        moved = [value - shift for value, shift in zip(x, shifts, strict=False)] + x[n_q:]
        rate = self.contact(moved).gap_rate
        return along(moved, -rate, self._impulse(moved)[0])

    def reset(self, x: State, approach_rate: Real) -> tuple[State, State, Real, Real]:
        """Return states after the impact and after a plastic one, speed and restitution."""
        direction, _, numbers = self._impulse(x)
        law = ImpactLaw(*numbers)
        after = along(x, -law.rate_drop(approach_rate), direction)
        resting = self.on_stop(along(x, -approach_rate, direction))
        return after, resting, law.speed_after(approach_rate), law.restitution

    def locked_on(self, x: State, duration: Real) -> State:
        """Return the state after a short time on the stop, to first order."""
        return along(x, duration, self._locked_rate(x)[0])


def along(x: State, length: Real, direction: State) -> State:
    """Return ``x + length direction``.

    Args:
        x: A state, ``(n_x,)``.
        length: How far.
        direction: Direction, ``(n_x,)``.
    """
    return [value + length * d for value, d in zip(x, direction, strict=True)]
