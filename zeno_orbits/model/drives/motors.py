"""The motors of a problem: the joints that they turn, their constants and their voltages."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from zeno_orbits.errors import counted
from zeno_orbits.model.expressions.operations import expand_calls
from zeno_orbits.work import require_kinds


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorBank:
    r"""The `n_M` motors of a problem: their joints, constants and voltages.

    Attributes:
        selection: :math:`S`, ``(n_q, n_M)``: motor `k` adds torque to the coordinates of column `k`
            and turns at :math:`(S^\top v)_k`. Gear ratios belong here.
        resistance: :math:`R`, ``(n_M, n_M)`` [ohm].
        inductance: :math:`L`, ``(n_M, n_M)`` [H].
        torque_constant: :math:`K_\varphi`, ``(n_M, n_M)`` [N m/A].
        emf_constant: :math:`K_\omega`, ``(n_M, n_M)`` [V s/rad].
        voltage: :math:`V(q, v)`, ``(n_M,)`` [V], gains symbolic. It may also depend on the
            currents, additional states and the clock.
        current: Symbols of the currents, ``(n_M,)`` [A], if the voltage depends on them. By default
            new symbols are created.
    """

    selection: ca.SX
    resistance: ca.SX
    inductance: ca.SX
    torque_constant: ca.SX
    emf_constant: ca.SX
    voltage: ca.SX
    current: ca.SX | None = None

    def __post_init__(self) -> None:
        """Expand the calls of functions, and refuse shapes that do not fit the number of motors."""
        require_kinds(self)
        expand_calls(self)
        n_motors = self.selection.shape[1]
        for name in ("resistance", "inductance", "torque_constant", "emf_constant"):
            shape = getattr(self, name).shape
            if shape != (n_motors, n_motors):
                wanted = f"must be of shape ({n_motors}, {n_motors})"
                motors = f"`selection` has {counted(n_motors, 'column')}, one per motor"
                raise ValueError(f"Argument `{name}` {wanted}, but it is {shape}: {motors}.")
        for k in range(n_motors):
            if self.selection[:, k].is_zero():
                turns = f"but motor {k + 1} turns none"
                raise ValueError(
                    f"Argument `selection` must let every motor turn a joint, {turns}."
                )
        if self.voltage.numel() != n_motors:
            message = (
                f"Argument `voltage` must have {n_motors} entries, one per motor, "
                f"but it has {self.voltage.numel()}."
            )
            raise ValueError(message)
        if self.current is not None and self.current.numel() != n_motors:
            raise ValueError(
                f"Argument `current` must have {n_motors} entries, one per motor, "
                f"but it has {self.current.numel()}."
            )

    @property
    def currents(self) -> ca.SX:
        """The symbols of the currents, by default newly created."""
        return ca.SX.sym("i", self.voltage.numel()) if self.current is None else self.current
