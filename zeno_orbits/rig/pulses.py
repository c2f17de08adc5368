"""The pulses of a bridge, edge by edge (theory (51))."""

from __future__ import annotations

from enum import Enum

from zeno_orbits.imperfections import Bridge


class Leg(Enum):
    """Which transistors of the switching leg are on."""

    HIGH = "high"
    LOW = "low"
    NONE = "none"


def pulse(bridge: Bridge, share: float) -> tuple[tuple[float, Leg], ...]:
    """Return when in a period the switching leg changes, and to what, from the start of the period.

    Every edge that turns a transistor on waits for the dead time.

    Args:
        bridge: Its numbers.
        share: Part of the period for which the voltage is asked for, in [0, 1].
    """
    period, dead = 1.0 / bridge.frequency, bridge.dead_time
    on = share * period
    if share <= 0.0:
        return ((0.0, Leg.LOW),)
    if share >= 1.0:
        return ((0.0, Leg.HIGH),)
    edges: list[tuple[float, Leg]] = []
    if dead > 0.0:
        edges.append((0.0, Leg.NONE))
    if on > dead:
        edges.append((dead, Leg.HIGH))
    if dead > 0.0 and on > dead:
        edges.append((on, Leg.NONE))
    if on + dead < period:
        edges.append((on + dead, Leg.LOW))
    return tuple(edges)


def level(bridge: Bridge, leg: Leg, sign: float, current: float) -> float:
    """Return the voltage over a motor and its transistors while a leg is in a state [V].

    Args:
        bridge: Its numbers.
        leg: The state of the switching leg; the other leg stays low.
        sign: Sign of the voltage that is asked for.
        current: Of the motor, which a diode carries while no transistor does [A].
    """
    if leg is Leg.HIGH:
        return sign * bridge.supply
    if leg is Leg.LOW:
        return 0.0
    along = sign * current
    if along > 0.0:
        return -sign * bridge.diode_drop
    if along < 0.0:
        return sign * (bridge.supply + bridge.diode_drop)
    return 0.0
