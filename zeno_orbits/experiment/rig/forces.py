"""The forces and voltages of a rig's parts, in symbols (theory (6.1), (6.3), (6.4))."""

from __future__ import annotations

import casadi as ca

from zeno_orbits.model import Contact, Gear, HBridge

_SMALL_VOLTAGE = 1e-3
"""Part of the supply over which an averaged bridge changes its direction."""
_SMALL_CURRENT = 1e-3
"""Part of the stalled motor's current over which diodes of an averaged dead time change theirs."""


def contact_force(contact: Contact, damping: ca.SX, depth: ca.SX, rate: ca.SX) -> ca.SX:
    r"""Return the force of a stop: :math:`k\,\delta^n \max(0, 1 + \alpha\dot\delta)`.

    Args:
        contact: Stiffness and exponent.
        damping: :math:`\alpha`.
        depth: :math:`\delta`. Below zero the force is continued as an odd function, for trial steps
            that end a little outside.
        rate: Its time derivative.

    Source: [HuntCrossley1975]_, theory (6.1).
    """
    spring = depth if contact.exponent == 1.0 else depth * ca.fabs(depth) ** (contact.exponent - 1)
    return contact.stiffness * spring * ca.fmax(0, 1 + damping * rate)


def teeth_torque(gear: Gear, twist: ca.SX, rate: ca.SX) -> ca.SX:
    """Return the torque from a rotor to its joint: zero within the backlash, else a damped spring.

    Args:
        gear: Backlash, stiffness and damping.
        twist: Angle of the rotor minus the angle of the joint.
        rate: Its time derivative.
    """

    def flank(depth: ca.SX, closing: ca.SX) -> ca.SX:
        return gear.stiffness * ca.fmax(0, depth) * ca.fmax(0, 1 + gear.loss * closing)

    half = gear.play / 2
    return flank(twist - half, rate) - flank(-twist - half, -rate)


def averaged_voltage(
    bridge: HBridge, asked: ca.SX, current: ca.SX, inductance: ca.SX, stall: ca.SX
) -> ca.SX:
    r"""Return the mean voltage of bridges over a period of their pulses.

    .. math:: \bar V = s \max(0, |V| - \sigma s V_d),\qquad V_d = (V_s + 2 V_f)\, t_d f

    `s` is the sign of the commanded voltage, which is limited to the supply. :math:`\sigma` is the
    sign of the current. It is zero while the ripple makes the current cross zero in every period.

    Args:
        bridge: Parameters of the bridge.
        asked: Commanded voltages, ``(n_M,)`` [V].
        current: Current of every motor [A].
        inductance: Inductance of every motor, which determines the ripple [H].
        stall: Current of every motor at rest under the supply [A].
    """
    voltage = ca.fmax(-bridge.supply, ca.fmin(bridge.supply, asked))
    if bridge.dead_time == 0.0:
        return voltage
    lost = (bridge.supply + 2 * bridge.diode_drop) * bridge.dead_time * bridge.frequency
    size = ca.fabs(voltage)
    ripple = size * (1 - size / bridge.supply) / (2 * bridge.frequency * inductance)
    above = ca.tanh((current - ripple) / (_SMALL_CURRENT * stall))
    below = ca.tanh((current + ripple) / (_SMALL_CURRENT * stall))
    sign = ca.tanh(voltage / (_SMALL_VOLTAGE * bridge.supply))
    return sign * ca.fmax(0, size - (above + below) / 2 * sign * lost)


_RIPPLES = 100.0
"""Largest ripples of a loop's current that stand for the current of a stalled motor."""


def inductive_current(bridge: HBridge, inductance: ca.SX) -> ca.SX:
    r"""Return the current scale of loops that drive no motor, :math:`100\,V_s / (8 f L)` [A].

    :math:`V_s / (8 f L)` is the largest ripple of the current. A loop of an ideal coil has zero
    resistance, so it does not have a current at rest.
    """
    return _RIPPLES * bridge.supply / (8 * bridge.frequency * inductance)
