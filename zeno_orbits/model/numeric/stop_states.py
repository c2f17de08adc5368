"""States on the stop: a projected state, and the result of an impact."""

from __future__ import annotations

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import fast_dataclass


@fast_dataclass
class ContactProjection:
    r"""A state projected onto the stop, with its accelerations.

    Attributes:
        state: State with zero gap and gap rate, ``(n_x,)``.
        gap_acceleration: :math:`\ddot h` of the free flow at that state.
        rate: :math:`\dot x` of the constrained flow at that state, ``(n_x,)``.
    """

    state: Vector
    gap_acceleration: float
    rate: Vector


@fast_dataclass
class Landed(ContactProjection):
    """Result of an impact: the state after it, and the same state projected onto the stop.

    Attributes:
        state_plus: State just after the impact, ``(n_x,)``.
        gap_rate: Gap rate of that state.
    """

    state_plus: Vector
    gap_rate: float
