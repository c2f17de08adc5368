"""Stops and switches: the events of a machine, as a model declares them."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from zeno_orbits.model.operations import expand_calls
from zeno_orbits.model.quantities import require_unit
from zeno_orbits.work import Checked


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop(Checked):
    r"""A unilateral constraint :math:`h(q) \ge 0` with Newton's law of impact.

    Attributes:
        name: Name of the stop in events, tables and messages.
        gap: :math:`h(q)`, scalar.
        restitution: Coefficient of restitution :math:`e` in [0, 1], a symbol or a number.
        unit: Unit of the gap. By default it follows from the units of the formula's symbols.
    """

    name: str
    gap: ca.SX
    restitution: ca.SX | float
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse wrong kinds and a text that is not a unit, and expand the calls of functions."""
        Checked.__post_init__(self)
        if self.unit:
            require_unit(self.name, self.unit)
        expand_calls(self)


ABSENT = Stop(name="", gap=ca.SX(1), restitution=0.0, unit="1")
"""The stop of the views of a machine without stops. Its gap is constant, so it never closes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Switch(Checked):
    r"""An event without a stop: a guard that falls through zero while the switch is armed.

    A formula after the event that is not given leaves its states unchanged.

    Attributes:
        name: Name of the switch in events, tables and messages.
        guard: :math:`g`, a formula of the state and the clock.
        armed: The guard's zero is an event only where this formula is positive, by default always.
        q_after: Coordinates just after the event, ``(n_q,)``.
        v_after: Velocities just after it, ``(n_q,)``.
        others_after: States of the drive just after it, without the clock.
    """

    name: str
    guard: ca.SX
    armed: ca.SX | float = 1.0
    q_after: ca.SX | None = None
    v_after: ca.SX | None = None
    others_after: ca.SX | None = None

    def __post_init__(self) -> None:
        """Refuse wrong kinds, and expand the calls of functions."""
        Checked.__post_init__(self)
        expand_calls(self)


def require_event_names(names: list[str]) -> None:
    """Refuse an empty name, and two events of one name.

    Args:
        names: Names of all stops and switches.

    Raises:
        ValueError: If a name is empty or occurs twice.
    """
    for k, name in enumerate(names):
        if not name.strip():
            raise ValueError("Argument `name` must name the stop or switch, but it is empty.")
        if name in names[:k]:
            raise ValueError(
                f"Argument `name` must differ for all stops and switches, but two are `{name}`."
            )


def watched(stops: tuple[Stop, ...]) -> tuple[Stop, ...]:
    """Return the stops that the views of a machine have: its own, or the absent one.

    Args:
        stops: Its stops.
    """
    return stops or (ABSENT,)
