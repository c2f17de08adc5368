r"""Permanent-magnet DC drives: full, corrected, quasi-static, ideal torque, or without a drive.

A drive turns a feedback law into a generalized force. It adds current states only at the fidelity
that requires them, so a problem contains only the necessary states.

Source: [HaasGahleitner2000]_, theory (1.2)-(1.4), (1.12) and (1.10).
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from zeno_orbits.errors import counted
from zeno_orbits.model.drives.auxiliary import Auxiliary, joined_auxiliary
from zeno_orbits.model.drives.circuits import (
    Circuit,
    Drive,
    Field,
    Network,
    circuit_drive,
    network_drive,
)
from zeno_orbits.model.drives.motors import MotorBank
from zeno_orbits.model.expressions.identities import values_near_one
from zeno_orbits.model.lagrangian import HybridLagrangian
from zeno_orbits.work import checked

__all__ = [
    "Auxiliary",
    "Circuit",
    "Drive",
    "MotorBank",
    "circuit_drive",
    "corrected_drive",
    "full_drive",
    "ideal_torque_drive",
    "no_drive",
    "quasi_static_drive",
]


@checked
def full_drive(lagrangian: HybridLagrangian, motors: MotorBank) -> Drive:
    r"""Return the drive with its current dynamics (paper eq. 4, theory (1.2)).

    .. math:: L\,\dot\imath = V(q, v) - R\,\imath - K_\omega S^\top v,\qquad F = S K_\varphi\,\imath

    Args:
        lagrangian: The mechanism.
        motors: The motors on it.
    """
    return _bank_drive(lagrangian, motors, motors.currents)


@checked
def quasi_static_drive(lagrangian: HybridLagrangian, motors: MotorBank) -> Drive:
    r"""Return the drive in the limit :math:`L \to 0`: no current state (theory (1.3)).

    .. math:: \imath = R^{-1}\,(V(q, v) - K_\omega S^\top v),\qquad F = S K_\varphi\,\imath

    Args:
        lagrangian: The mechanism.
        motors: The motors on it.
    """
    current = _static_current(lagrangian, motors)

    def fed(source: ca.SX) -> Drive:
        return quasi_static_drive(lagrangian, replace(motors, voltage=source))

    return replace(_bank_drive(lagrangian, motors, current, is_algebraic=True), fed=fed)


@checked
def corrected_drive(lagrangian: HybridLagrangian, motors: MotorBank) -> Drive:
    r"""Return the quasi-static drive with its first correction in `L`, without current states.

    Let :math:`\bar\imath(q, v)` be the quasi-static current and `D` the derivative of the voltage
    with respect to :math:`S^\top v` (theory (1.12)). Then

    .. math:: F = S K_\varphi\,\bigl(\bar\imath - R^{-1} L\,\partial_q\bar\imath\;v\bigr),
        \qquad \Delta M = S K_\varphi R^{-1} L R^{-1} (D - K_\omega) S^\top

    Its error is :math:`O((L/R)^2)`, including the current layer of an impact. The electrical powers
    are computed from :math:`\bar\imath`, with an error of :math:`O(L/R)`. The energy balance is
    exact. Source: [KokotovicKhalilOReilly1999]_ for the slow manifold, theory (1.12).

    Args:
        lagrangian: The mechanism.
        motors: The motors on it.

    Raises:
        ValueError: If the added inertia is not constant or not symmetric, since each motor must
            feed back its own speed by a constant factor. If the voltage changes with time.
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
        other_loss=quasi_static.other_loss + ca.dot(lag, lagrangian.v),
        added_inertia=ca.sparsify((added + added.T) / 2),
    )


@checked
def ideal_torque_drive(lagrangian: HybridLagrangian, *, selection: ca.SX, torque: ca.SX) -> Drive:
    r"""Return a drive that delivers the commanded torque: :math:`F = S \tau(q, v)` (theory (1.4)).

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
    source = Auxiliary(
        states=ca.SX(0, 1),
        rate=ca.SX(0, 1),
        force=force,
        input_power=ca.dot(force, lagrangian.v),
    )
    return joined_auxiliary(lagrangian, source)


@checked
def no_drive(lagrangian: HybridLagrangian) -> Drive:
    """Return the drive of a mechanism that moves by itself: no force, no state."""
    return ideal_torque_drive(
        lagrangian, selection=ca.SX(lagrangian.q.numel(), 0), torque=ca.SX(0, 1)
    )


def _bank_drive(
    lagrangian: HybridLagrangian, motors: MotorBank, current: ca.SX, *, is_algebraic: bool = False
) -> Drive:
    r"""Return a bank of motors as the circuit that it is, its derivatives taken by hand.

    Its coenergy is :math:`i^\top L\,i / 2 + i^\top K_\omega S^\top q` (theory (1.10)).
    Torque constants other than the back-EMF constants are a converter that loses or gains power.
    """
    n_q = lagrangian.q.numel()
    if motors.selection.shape[0] != n_q:
        rows = counted(motors.selection.shape[0], "row")
        raise ValueError(
            f"Argument `selection` must have {counted(n_q, 'row')}, one per coordinate, but it has "
            f"{rows}."
        )
    speed = ca.mtimes(motors.selection.T, lagrangian.v)
    torque = ca.mtimes(motors.torque_constant, current)
    emf = ca.mtimes(motors.emf_constant, speed)
    n_motors = current.numel()
    fields = Field(
        currents=current,
        voltages=ca.SX(0, 1),
        inertia=motors.inductance,
        motion=emf,
        force=ca.mtimes(motors.selection, torque),
        stored_energy=ca.dot(current, ca.mtimes(motors.inductance, current)) / 2,
        conversion_loss=ca.dot(current, emf) - ca.dot(torque, speed),
    )
    network = Network(
        resistance=motors.resistance,
        conductance=ca.SX(0, 0),
        incidence=ca.SX(n_motors, 0),
        source=motors.voltage,
    )
    parts = ("inductance", "resistance", "torque_constant", "emf_constant", "voltage", "selection")
    entries = tuple((name, getattr(motors, name)) for name in parts)
    return network_drive(fields, network, is_algebraic=is_algebraic, motors=motors, entries=entries)


def _static_current(lagrangian: HybridLagrangian, motors: MotorBank) -> ca.SX:
    if motors.current is not None and ca.depends_on(motors.voltage, motors.current):
        wanted = "must not depend on currents in a drive without current states"
        raise ValueError(f"Argument `voltage` {wanted}, but it does: take `full_drive`.")
    emf = ca.mtimes(motors.emf_constant, ca.mtimes(motors.selection.T, lagrangian.v))
    return ca.solve(motors.resistance, motors.voltage - emf)


def _require_inertia(lagrangian: HybridLagrangian, added: ca.SX) -> None:
    """Reject an added inertia that depends on the state or is not symmetric.

    Symmetry is tested at random values of the symbols, at which it cannot hold by accident.
    """
    wanted = "must make each motor feed back its own speed by a constant factor, but"
    if ca.depends_on(added, ca.vertcat(lagrangian.q, lagrangian.v)):
        raise ValueError(f"Argument `motors` {wanted} the added inertia changes with the state.")
    for row in values_near_one(added):
        trial = row.reshape(added.shape)
        if np.max(np.abs(trial - trial.T)) > 1e-9 * np.max(np.abs(trial)):
            raise ValueError(f"Argument `motors` {wanted} the added inertia is not symmetric.")
