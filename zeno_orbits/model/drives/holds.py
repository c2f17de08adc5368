"""States that are constant between events and set anew at a named event."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from zeno_orbits.errors import InputError, shown
from zeno_orbits.model.drives.circuits import Drive, Held
from zeno_orbits.model.expressions.operations import expand_calls
from zeno_orbits.model.lagrangian import HybridLagrangian, require_separate, require_symbols
from zeno_orbits.work import require_kinds

KINDS = ("impact", "zeno", "release", "switch")
"""Kinds of events at which states may be set."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold:
    r"""States that are constant between events and set anew at an event.

    .. math:: \dot u = 0,\qquad u^+ = f(q, v, u, \dots)

    Just after the event all other states keep their values. Then each stop that is touched stays
    closed or opens by the forces of the new values.

    Attributes:
        states: :math:`u`, symbols, ``(n_u,)``.
        at: The event, such as ``release stop``, ``zeno knee``, ``impact table`` or
            ``switch sample``.
        after: :math:`f`, a formula of all states just after the event, clock and parameters,
            ``(n_u,)``. It may hold limits such as ``fmin`` and ``fmax``.
    """

    states: ca.SX
    at: str
    after: ca.SX

    def __post_init__(self) -> None:
        """Reject states that are not symbols, another number of formulas, and unknown kinds."""
        require_kinds(self)
        expand_calls(self)
        require_symbols("states", self.states)
        n_u = self.states.numel()
        if n_u == 0:
            raise ValueError("Argument `states` must hold at least one symbol, but it is empty.")
        if self.after.numel() != n_u:
            wanted = f"must have {n_u} entries, one per state, but it has {self.after.numel()}"
            raise ValueError(f"Argument `after` {wanted}.")
        require_event(self.at)

    def drive(self, mechanism: HybridLagrangian) -> Drive:
        """Return the states as a drive of a mechanism, without force and without powers.

        Args:
            mechanism: The mechanism.

        Raises:
            ValueError: If a state is one of the mechanism or its clock.
        """
        n_q, zero = mechanism.q.numel(), ca.SX(0)
        require_separate(self.states, mechanism)
        states, after = ca.vec(self.states), ca.vec(self.after)
        return Drive(
            states=states,
            rates=ca.SX.zeros(states.numel()),
            force=ca.SX.zeros(n_q),
            input_power=zero,
            copper_loss=zero,
            other_loss=zero,
            stored_energy=zero,
            motor_current=ca.SX(0, 1),
            motor_voltage=ca.SX(0, 1),
            added_inertia=ca.SX(n_q, n_q),
            kinds=("",) * states.numel(),
            entries=(("after", after),),
            holds=(Held(states=states, at=self.at, after=after),),
        )


def require_event(at: str) -> None:
    """Refuse a text that names no event at which states may be set.

    Args:
        at: The text.

    Raises:
        InputError: If it names none.
    """
    kind, _, name = at.partition(" ")
    if kind not in KINDS or not name:
        known = ", ".join(f"`{one} NAME`" for one in KINDS)
        raise InputError(f"Argument `at` must be an event ({known}), but it is {shown(at)}.")
