"""Further states of a problem, a pressure or the integral of an error, and drives in one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from zeno_orbits.model.drives.circuits import Circuit, Drive
from zeno_orbits.model.drives.friction import DryFriction
from zeno_orbits.model.drives.holds import Hold
from zeno_orbits.model.drives.motors import MotorBank
from zeno_orbits.model.expressions.operations import expand_calls
from zeno_orbits.model.lagrangian import HybridLagrangian, require_separate, require_symbols
from zeno_orbits.work import require_kinds


@dataclass(frozen=True, slots=True, kw_only=True)
class Auxiliary:
    r"""Additional states with their own rates: a pressure, the integral of an error, a filter.

    .. math:: \dot z = f(q, v, z, \dots),\qquad
        \dot E = P - D - F^\top v

    The second law holds if all energies are given. With a force and without `input_power`, `loss`
    and `stored_energy` the energy balance of the problem is incomplete. Without a force the states
    exchange no energy with the mechanism, and the balance does not need any of the three.

    Attributes:
        states: :math:`z`, symbols, ``(n_z,)``.
        rate: :math:`f`, a formula of all states, clock and gains, ``(n_z,)``.
        force: :math:`F`, generalized force on the mechanism, ``(n_q,)``, by default absent.
        input_power: :math:`P` [W], by default zero.
        loss: :math:`D` [W], by default zero.
        stored_energy: :math:`E` [J], by default zero.
        after_impact: The states just after an impact as a formula of the states before it,
            ``(n_z,)``, by default unchanged. Changes may be proportional to the gap rate, so that
            an impact with zero speed changes nothing and impacts can accumulate. A contact force is
            the limit of many such impacts, so the same law describes its effect on the states. If
            there is a `stored_energy`, its increase in an impact is a negative loss of the impact.
    """

    states: ca.SX
    rate: ca.SX
    force: ca.SX | None = None
    input_power: ca.SX | None = None
    loss: ca.SX | None = None
    stored_energy: ca.SX | None = None
    after_impact: ca.SX | None = None

    def __post_init__(self) -> None:
        """Reject states that are not symbols, and formulas with another number of entries."""
        require_kinds(self)
        expand_calls(self)
        require_symbols("states", self.states)
        n_z = self.states.numel()
        for name in ("rate", "after_impact"):
            given = getattr(self, name)
            if given is not None and given.numel() != n_z:
                wanted = f"must have {n_z} entries, one per state, but it has {given.numel()}"
                raise ValueError(f"Argument `{name}` {wanted}.")
        for name in ("input_power", "loss", "stored_energy"):
            given = getattr(self, name)
            if given is not None and not given.is_scalar():
                wanted = f"must be one number, but its shape is {given.shape}"
                raise ValueError(f"Argument `{name}` {wanted}.")

    def drive(self, mechanism: HybridLagrangian) -> Drive:
        """Return the states as a drive of a mechanism.

        Args:
            mechanism: The mechanism.

        Raises:
            ValueError: If a state is one of the mechanism or its clock, or if the force has another
                number of entries than the coordinates.
        """
        n_q = mechanism.q.numel()
        require_separate(self.states, mechanism)
        force = ca.SX.zeros(n_q) if self.force is None else ca.vec(ca.SX(self.force))
        if force.numel() != n_q:
            raise ValueError(
                f"Argument `force` must have {n_q} entries, one per coordinate, "
                f"but it has {force.numel()}."
            )
        powers = {
            name: getattr(self, name)
            for name in ("input_power", "loss", "stored_energy")
            if getattr(self, name) is not None
        }
        entries = {"rate": ca.vec(self.rate), "force": force, **powers}
        if self.after_impact is not None:
            entries["after_impact"] = self.after_impact
        return Drive(
            states=ca.vec(self.states),
            rates=ca.vec(self.rate),
            force=force,
            input_power=ca.SX(powers.get("input_power", 0)),
            copper_loss=ca.SX(0),
            other_loss=ca.SX(powers.get("loss", 0)),
            stored_energy=ca.SX(powers.get("stored_energy", 0)),
            motor_current=ca.SX(0, 1),
            motor_voltage=ca.SX(0, 1),
            added_inertia=ca.SX(n_q, n_q),
            after_impact=None if self.after_impact is None else ca.vec(self.after_impact),
            kinds=("",) * self.states.numel(),
            entries=tuple(entries.items()),
            is_balanced=force.is_zero() or bool(powers),
        )


Part = Drive | Auxiliary | Hold | DryFriction
"""A part of a drive."""


def joined_auxiliary(
    mechanism: HybridLagrangian,
    drives: Part | Sequence[Part],
) -> Drive:
    """Return several drives as one, their states one after the other.

    Args:
        mechanism: The mechanism.
        drives: A drive, further states, or several of them.

    Raises:
        ValueError: If something else is among them, or two share a state.
    """
    given = list(drives) if isinstance(drives, Sequence) else [drives]
    parts = [
        one.drive(mechanism) if isinstance(one, Auxiliary | Hold | DryFriction) else _known(one)
        for one in given
    ]
    if len(parts) == 1:
        return parts[0]
    states = ca.vertcat(ca.SX(0, 1), *(part.states for part in parts))
    require_symbols("drive", states)
    banks = [part.motors for part in parts if part.motors is not None]
    if len(banks) > 1:
        wanted = "must hold the motors of a mechanism in one bank"
        raise ValueError(f"Argument `drive` {wanted}, but it holds {len(banks)} banks.")
    n_q, zero = mechanism.q.numel(), ca.SX(0)

    def fed(source: ca.SX) -> Drive:
        return joined_auxiliary(mechanism, _fed(parts, source))

    resets = [part.states if part.after_impact is None else part.after_impact for part in parts]
    has_reset = any(part.after_impact is not None for part in parts)
    return Drive(
        states=states,
        rates=ca.vertcat(ca.SX(0, 1), *(part.rates for part in parts)),
        force=sum((part.force for part in parts), ca.SX.zeros(n_q)),
        input_power=sum((part.input_power for part in parts), zero),
        copper_loss=sum((part.copper_loss for part in parts), zero),
        other_loss=sum((part.other_loss for part in parts), zero),
        stored_energy=sum((part.stored_energy for part in parts), zero),
        motor_current=ca.vertcat(ca.SX(0, 1), *(part.motor_current for part in parts)),
        motor_voltage=ca.vertcat(ca.SX(0, 1), *(part.motor_voltage for part in parts)),
        added_inertia=sum((part.added_inertia for part in parts), ca.SX(n_q, n_q)),
        after_impact=ca.vertcat(*resets) if has_reset else None,
        motors=banks[0] if banks else None,
        kinds=sum((part.kinds for part in parts), ()),
        inertia=ca.diagcat(*(part.inertia for part in parts)),
        entries=sum((part.entries for part in parts), ()),
        is_balanced=all(part.is_balanced for part in parts),
        fed=fed,
        joins=tuple(parts),
        holds=sum((part.holds for part in parts), ()),
        frictions=sum((part.frictions for part in parts), ()),
        sides=ca.vertcat(ca.SX(0, 1), *(part.sides for part in parts)),
        sliding=ca.vertcat(ca.SX(0, 1), *(part.sliding for part in parts)),
        torques=ca.vertcat(ca.SX(0, 1), *(part.torques for part in parts)),
        static=ca.vertcat(ca.SX(0, 1), *(part.static for part in parts)),
        sticks=ca.vertcat(ca.SX(0, 1), *(part.sticks for part in parts)),
    )


def _fed(parts: Sequence[Drive], source: ca.SX) -> list[Drive]:
    """Return drives fed by the voltages of one column, each by as many as it has sources."""
    found: list[Drive] = []
    first = 0
    for part in parts:
        n = part.motor_voltage.numel()
        found.append(part if part.fed is None else part.fed(source[first : first + n]))
        first += n
    return found


def _known(drive: object) -> Drive:
    if isinstance(drive, Drive):
        return drive
    wanted = "must hold drives and further states"
    hint = "; see `circuit_drive`" if isinstance(drive, Circuit) else ""
    hint = "; see `full_drive`" if isinstance(drive, MotorBank) else hint
    kind = "None" if drive is None else f"a `{type(drive).__name__}`"
    hint = hint or ". Without a drive, write `zo.no_drive(mechanism)`"
    raise ValueError(f"Argument `drive` {wanted}, but it holds {kind}{hint}.")
