r"""Permanent-magnet DC drives: full, corrected, quasi-static, ideal torque.

A drive turns a feedback law into a generalized force. It brings current states only where the
fidelity asks for them, so a problem models what it requires and no more.

Source: [HaasGahleitner2000]_, theory (2)-(4) and (20).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from zeno_orbits.model.lagrangian import HybridLagrangian


@dataclass(frozen=True, slots=True, kw_only=True)
class MotorBank:
    r"""The `n_M` motors of a problem: which joints they turn, their constants and their voltages.

    Attributes:
        selection: :math:`S`, ``(n_q, n_M)``: motor `k` adds torque to the coordinates of column `k`
            and turns at :math:`(S^\top v)_k`. Gear ratios belong here.
        resistance: :math:`R`, ``(n_M, n_M)`` [ohm].
        inductance: :math:`L`, ``(n_M, n_M)`` [H].
        torque_constant: :math:`K_\varphi`, ``(n_M, n_M)`` [N m/A].
        emf_constant: :math:`K_\omega`, ``(n_M, n_M)`` [V s/rad].
        voltage: :math:`V(q, v)`, ``(n_M,)`` [V], gains symbolic.
    """

    selection: ca.SX
    resistance: ca.SX
    inductance: ca.SX
    torque_constant: ca.SX
    emf_constant: ca.SX
    voltage: ca.SX

    def __post_init__(self) -> None:
        """Refuse matrices whose shapes do not fit the number of motors."""
        n_motors = self.selection.shape[1]
        for name in ("resistance", "inductance", "torque_constant", "emf_constant"):
            shape = getattr(self, name).shape
            if shape != (n_motors, n_motors):
                wanted = f"must be of shape ({n_motors}, {n_motors})"
                raise ValueError(f"Argument `{name}` {wanted}, but it is {shape}.")
        for k in range(n_motors):
            if self.selection[:, k].is_zero():
                turns = f"but motor {k + 1} turns none"
                raise ValueError(
                    f"Argument `selection` must let every motor turn a joint, {turns}."
                )
        if self.voltage.numel() != n_motors:
            message = (
                f"Argument `voltage` must have {n_motors} entries, one a motor, "
                f"but it has {self.voltage.numel()}."
            )
            raise ValueError(message)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """The effect of motors on a mechanism, and their powers.

    Attributes:
        current: Current states, ``(n_i,)`` [A]; empty below full fidelity.
        current_rate: Their time derivative, ``(n_i,)`` [A/s].
        force: Generalized force on the mechanism, ``(n_q,)``.
        input_power: Power that the source delivers [W].
        copper_loss: Power lost in the windings [W].
        conversion_loss: Electrical less mechanical power of the air gap [W]; zero when the torque
            and the back-EMF constants are equal.
        magnetic_energy: Energy stored in the inductances [J].
        motor_current: Current of every motor, a state or not, ``(n_M,)`` [A].
        motor_voltage: Voltage of every motor, ``(n_M,)`` [V].
        added_inertia: What the drive adds to the mass matrix, constant and symmetric,
            ``(n_q, n_q)``; empty but for a corrected drive. The mechanism then strikes its stop
            with that inertia too, and `complete` corrects the restitution for it.
        motors: What the drive is made of; ``None`` for an ideal torque.
    """

    current: ca.SX
    current_rate: ca.SX
    force: ca.SX
    input_power: ca.SX
    copper_loss: ca.SX
    conversion_loss: ca.SX
    magnetic_energy: ca.SX
    motor_current: ca.SX
    motor_voltage: ca.SX
    added_inertia: ca.SX
    motors: MotorBank | None = None


def full_drive(lagrangian: HybridLagrangian, motors: MotorBank) -> Drive:
    r"""Return the drive with its current dynamics (paper eq. 4, theory (2)).

    .. math:: L\,\dot\imath = V(q, v) - R\,\imath - K_\omega S^\top v,\qquad F = S K_\varphi\,\imath

    Args:
        lagrangian: The mechanism.
        motors: The motors on it.
    """
    current = ca.SX.sym("i", motors.voltage.numel())
    emf = ca.mtimes(motors.emf_constant, ca.mtimes(motors.selection.T, lagrangian.v))
    rate = ca.solve(motors.inductance, motors.voltage - ca.mtimes(motors.resistance, current) - emf)
    stored = ca.dot(current, ca.mtimes(motors.inductance, current)) / 2
    return _drive(lagrangian, motors, current=current, states=current, rate=rate, stored=stored)


def quasi_static_drive(lagrangian: HybridLagrangian, motors: MotorBank) -> Drive:
    r"""Return the drive in the limit :math:`L \to 0`: no current state (theory (3)).

    .. math:: \imath = R^{-1}\,(V(q, v) - K_\omega S^\top v),\qquad F = S K_\varphi\,\imath

    Args:
        lagrangian: The mechanism.
        motors: The motors on it.
    """
    current = _static_current(lagrangian, motors)
    none = ca.SX(0, 1)
    return _drive(lagrangian, motors, current=current, states=none, rate=none, stored=ca.SX(0))


def corrected_drive(lagrangian: HybridLagrangian, motors: MotorBank) -> Drive:
    r"""Return the quasi-static drive with its first correction in `L`: no current state.

    With :math:`\bar\imath(q, v)` the quasi-static current and `D` the derivative of the voltage by
    :math:`S^\top v` (theory (20)),

    .. math:: F = S K_\varphi\,\bigl(\bar\imath - R^{-1} L\,\partial_q\bar\imath\;v\bigr),
        \qquad \Delta M = S K_\varphi R^{-1} L R^{-1} (D - K_\omega) S^\top

    It is wrong by :math:`O((L/R)^2)`, an impact's current layer included. The electrical powers
    are those of :math:`\bar\imath`, off by :math:`O(L/R)`; the energy balance is exact.
    Source: [KokotovicKhalilOReilly1999]_ for the slow manifold, theory (20).

    Args:
        lagrangian: The mechanism.
        motors: The motors on it.

    Raises:
        ValueError: If the added inertia is not constant, or not symmetric: each motor must feed
            back the speed that it turns at, by a constant factor. If the voltage changes with time.
    """
    quasi_static = quasi_static_drive(lagrangian, motors)
    current = _static_current(lagrangian, motors)
    if lagrangian.clock is not None and ca.depends_on(current, lagrangian.clock.state):
        raise ValueError(
            "Argument `motors` must have a voltage of the state alone for a corrected drive, "
            "but it changes with the clock."
        )
    torque_per_rate = ca.mtimes(
        ca.mtimes(motors.selection, motors.torque_constant),
        ca.solve(motors.resistance, motors.inductance),
    )
    lag = ca.mtimes(torque_per_rate, ca.jtimes(current, lagrangian.q, lagrangian.v))
    added = ca.mtimes(torque_per_rate, ca.jacobian(current, lagrangian.v))
    _require_inertia(lagrangian, added)
    return replace(
        quasi_static,
        force=quasi_static.force - lag,
        conversion_loss=quasi_static.conversion_loss + ca.dot(lag, lagrangian.v),
        added_inertia=ca.sparsify((added + added.T) / 2),
    )


def ideal_torque_drive(lagrangian: HybridLagrangian, *, selection: ca.SX, torque: ca.SX) -> Drive:
    r"""Return a drive that delivers the commanded torque: :math:`F = S \tau(q, v)` (theory (4)).

    Args:
        lagrangian: The mechanism.
        selection: :math:`S`, ``(n_q, n_M)``.
        torque: :math:`\tau(q, v)`, ``(n_M,)`` [N m], gains symbolic.
    """
    if selection.shape != (lagrangian.q.numel(), torque.numel()):
        message = (
            f"Argument `selection` must be of shape ({lagrangian.q.numel()}, {torque.numel()}), "
            f"but it is {selection.shape}."
        )
        raise ValueError(message)
    force = ca.mtimes(selection, torque)
    none, zero = ca.SX(0, 1), ca.SX(0)
    return Drive(
        current=none,
        current_rate=none,
        force=force,
        input_power=ca.dot(force, lagrangian.v),
        copper_loss=zero,
        conversion_loss=zero,
        magnetic_energy=zero,
        motor_current=none,
        motor_voltage=none,
        added_inertia=ca.SX(lagrangian.q.numel(), lagrangian.q.numel()),
    )


def no_drive(lagrangian: HybridLagrangian) -> Drive:
    """Return the drive of a mechanism that moves by itself: no force, no state."""
    return ideal_torque_drive(
        lagrangian, selection=ca.SX(lagrangian.q.numel(), 0), torque=ca.SX(0, 1)
    )


def _drive(
    lagrangian: HybridLagrangian,
    motors: MotorBank,
    *,
    current: ca.SX,
    states: ca.SX,
    rate: ca.SX,
    stored: ca.SX,
) -> Drive:
    speed = ca.mtimes(motors.selection.T, lagrangian.v)
    torque = ca.mtimes(motors.torque_constant, current)
    emf = ca.mtimes(motors.emf_constant, speed)
    return Drive(
        current=states,
        current_rate=rate,
        force=ca.mtimes(motors.selection, torque),
        input_power=ca.dot(motors.voltage, current),
        copper_loss=ca.dot(current, ca.mtimes(motors.resistance, current)),
        conversion_loss=ca.dot(current, emf) - ca.dot(torque, speed),
        magnetic_energy=stored,
        motor_current=current,
        motor_voltage=motors.voltage,
        added_inertia=ca.SX(lagrangian.q.numel(), lagrangian.q.numel()),
        motors=motors,
    )


def _static_current(lagrangian: HybridLagrangian, motors: MotorBank) -> ca.SX:
    emf = ca.mtimes(motors.emf_constant, ca.mtimes(motors.selection.T, lagrangian.v))
    return ca.solve(motors.resistance, motors.voltage - emf)


def _require_inertia(lagrangian: HybridLagrangian, added: ca.SX) -> None:
    """Refuse an added inertia that is none: one that changes with the state, or is not symmetric.

    Symmetry is tried at a few random numbers for the symbols, where it cannot hold by accident.
    """
    wanted = "must make each motor feed back its own speed by a constant factor, but"
    if ca.depends_on(added, ca.vertcat(lagrangian.q, lagrangian.v)):
        raise ValueError(f"Argument `motors` {wanted} the added inertia changes with the state.")
    symbols = ca.veccat(*ca.symvar(added))
    values = ca.Function("added_inertia", [symbols], [ca.densify(added)])
    random = np.random.default_rng(0)
    for _ in range(4):
        trial = np.array(values(random.uniform(0.5, 1.5, symbols.numel())).full())
        if np.max(np.abs(trial - trial.T)) > 1e-9 * np.max(np.abs(trial)):
            raise ValueError(f"Argument `motors` {wanted} the added inertia is not symmetric.")
