"""Dry friction of a joint, a gear or a sliding part: it slips, or it sticks."""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca

from zeno_orbits.errors import shortened
from zeno_orbits.model.drives.circuits import Drive
from zeno_orbits.model.expressions.operations import expand_calls
from zeno_orbits.model.lagrangian import HybridLagrangian, require_scalar, require_separate
from zeno_orbits.work import require_kinds

SIDE = "side_"
"""Begin of the names of the states that tell whether a part slips or sticks."""
STICKS_BELOW = 0.25
"""Square of a side below which a part sticks: a side is -1, 0 or 1."""


@dataclass(frozen=True, slots=True)
class DryFriction:
    r"""Coulomb friction along a relative rate :math:`r`, with a state that tells how it acts.

    .. math:: f = -T\,s \text{ while } s\,r > 0,\qquad
        \dot r = 0,\ |f| \le T_0 \text{ while } s = 0

    The side :math:`s` is 1 or -1 while the part slips, and 0 while it sticks. It is the state
    ``side_NAME`` of the machine and changes at the switches ``stick NAME``, ``turn NAME up``,
    ``turn NAME down``, ``slip NAME up`` and ``slip NAME down``. Where the rate is zero, the part
    sticks if the force that it needs for that is at most :math:`T_0`. Friction is bounded, so it
    gives no impulse in an impact. Just after an impact that changes the rate, the part slips by the
    sign of its rate.

    Attributes:
        name: Name of the part in switches, tables and messages.
        rate: :math:`r`, a formula that is affine in the velocities. It may hold the speed of a
            belt.
        torque: :math:`T \ge 0`, a smooth formula of states, clock and parameters.
        static: :math:`T_0 \ge T`, by default :math:`T`.
        side: Symbol of the state :math:`s`.

    Source: [LeineNijmeijer2004]_.
    """

    name: str
    rate: ca.SX = field(kw_only=True)
    torque: ca.SX | float = field(kw_only=True)
    static: ca.SX | float | None = field(default=None, kw_only=True)
    side: ca.SX = field(init=False, compare=False, default_factory=lambda: ca.SX(0, 1))

    def __post_init__(self) -> None:
        """Refuse wrong kinds, an empty name, a negative torque and a static one below it."""
        require_kinds(self)
        expand_calls(self)
        if not self.name.strip():
            raise ValueError("Argument `name` must name the part with friction, but it is empty.")
        if not (SIDE + self.name).isidentifier():
            wanted = (
                f"must hold letters, digits and underscores only, as the state `{SIDE}NAME` does"
            )
            raise ValueError(f"Argument `name` {wanted}, but it is `{shortened(self.name)}`.")
        object.__setattr__(self, "side", ca.SX.sym(SIDE + self.name))
        require_scalar("rate", self.rate)
        torque, static = ca.SX(self.torque), self._static
        for name, formula in (("torque", torque), ("static", static)):
            require_scalar(name, formula)
            if formula.is_constant() and not float(formula) >= 0.0:
                wanted = f"must be a number >= 0 or a formula, but it is {float(formula):g}"
                raise ValueError(f"Argument `{name}` {wanted}.")
        if (static - torque).is_constant() and not float(static - torque) >= 0.0:
            wanted = f"must be at least the torque {float(torque):g}"
            raise ValueError(f"Argument `static` {wanted}, but it is {float(static):g}.")

    @property
    def _static(self) -> ca.SX:
        """Largest force while it sticks."""
        return ca.SX(self.torque if self.static is None else self.static)

    def drive(self, mechanism: HybridLagrangian) -> Drive:
        """Return the friction as a drive of a mechanism, with its side as a state.

        Args:
            mechanism: The mechanism.

        Raises:
            ValueError: If the rate is not affine in the velocities, or does not depend on them.
        """
        require_separate(self.side, mechanism)
        v, n_q = mechanism.v, mechanism.q.numel()
        row = ca.jacobian(self.rate, v)
        if not row.nnz() or ca.depends_on(row, v):
            raise ValueError(
                f"Argument `rate` of the friction `{self.name}` must be affine in the velocities, "
                "as `v` and `v - belt` are."
            )
        force = -ca.SX(self.torque) * self.side
        # The part of the rate that is no velocity of the mechanism does work on it.
        belt = ca.simplify(ca.substitute(self.rate, v, ca.SX.zeros(n_q)))
        zero = ca.SX(0)
        return Drive(
            states=self.side,
            rates=ca.SX.zeros(1),
            force=row.T * force,
            input_power=-force * belt,
            copper_loss=zero,
            other_loss=-force * self.rate,
            stored_energy=zero,
            motor_current=ca.SX(0, 1),
            motor_voltage=ca.SX(0, 1),
            added_inertia=ca.SX(n_q, n_q),
            kinds=("",),
            entries=(
                ("rate", self.rate),
                ("torque", ca.SX(self.torque)),
                ("static", self._static),
            ),
            frictions=(self.name,),
            sides=self.side,
            sliding=self.rate,
            torques=ca.SX(self.torque),
            static=self._static,
            sticks=ca.if_else(self.side**2 > STICKS_BELOW, 0, 1),
        )
