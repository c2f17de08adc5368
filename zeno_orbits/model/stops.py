"""Stops and switches: the events of a machine, as a model declares them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from zeno_orbits.errors import shortened
from zeno_orbits.model.contact import ImpactLaw
from zeno_orbits.model.declared.quantities import require_unit
from zeno_orbits.model.expressions.operations import expand_calls
from zeno_orbits.work import Checked


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop(Checked):
    r"""A unilateral constraint :math:`h(q) \ge 0` with Newton's law of impact.

    Attributes:
        name: Name of the stop in events, tables and messages.
        gap: :math:`h(q)`, scalar.
        restitution: Coefficient of restitution :math:`e` in [0, 1]: a number, or a formula of
            parameters and ``zo.impact_speed``. A formula of the speed must have a limit between 0
            and 1 at speed zero.
        unit: Unit of the gap. By default it follows from the units of the formula's symbols.
    """

    name: str
    gap: ca.SX
    restitution: ca.SX | float
    unit: str = ""

    @property
    def law(self) -> ImpactLaw:
        """The law of its impacts."""
        return ImpactLaw.of_formula(self.restitution)

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


_SETTING = "hold at "


def setting_name(event: str) -> str:
    """Return the name of the switch that sets states at an event.

    Args:
        event: Name of the event, such as ``release stop``.
    """
    return _SETTING + event


def event_of_setting(name: str) -> str:
    """Return the event at which a switch sets states, or no text for another switch.

    Args:
        name: Name of the switch.
    """
    return name.removeprefix(_SETTING) if name.startswith(_SETTING) else ""


def continuous_arming(formula: Any) -> ca.SX:
    """Return a continuous formula that is positive where a formula of comparisons is true.

    At a border of the comparisons it is zero, on both sides of ``<`` and ``<=``. A formula without
    comparisons stays as it is.

    Args:
        formula: The formula `armed` of a switch.
    """
    node = ca.SX(formula)
    parts: list[Any] = [] if node.is_leaf() else [node.dep(k) for k in range(node.n_dep())]
    operation = node.op()
    if operation in (ca.OP_LT, ca.OP_LE):
        return ca.SX(parts[1] - parts[0])
    if operation == ca.OP_SIGN:
        return continuous_arming(parts[0])
    if operation == ca.OP_NOT:
        return -continuous_arming(parts[0])
    if operation == ca.OP_AND or (operation == ca.OP_MUL and all(map(_is_true_or_false, parts))):
        return ca.fmin(*map(continuous_arming, parts))
    if operation == ca.OP_OR:
        return ca.fmax(*map(continuous_arming, parts))
    chosen = [one.op() == ca.OP_IF_ELSE_ZERO for one in parts]
    if operation == ca.OP_ADD and all(chosen):
        # A choice between two values: one of both terms is zero.
        return ca.fmax(*map(continuous_arming, parts))
    if operation == ca.OP_IF_ELSE_ZERO:
        return ca.fmin(*map(continuous_arming, parts))
    return node


def _is_true_or_false(formula: Any) -> bool:
    return formula.op() in (ca.OP_LT, ca.OP_LE, ca.OP_NOT, ca.OP_AND, ca.OP_OR)


_MARKS = frozenset(",;:=`'\"")
"""Marks that separate names, or end them, on the command line and in messages."""


def require_event_names(names: list[str]) -> None:
    """Refuse an empty name, two events of one name, and names that cannot be typed in a list.

    Args:
        names: Names of all stops and switches.

    Raises:
        ValueError: If a name is empty or occurs twice, or is not words with single blanks between
            them.
    """
    for k, name in enumerate(names):
        if not name.strip():
            raise ValueError("Argument `name` must name the stop or switch, but it is empty.")
        if name != " ".join(name.split()) or not name.isprintable() or _MARKS & set(name):
            wanted = "must be words with single blanks between them, without , ; : = ` or quotes"
            raise ValueError(f"Argument `name` {wanted}, but it is {shortened(repr(name))}.")
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
