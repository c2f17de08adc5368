"""Parts of a machine that its model leaves out, each with units and checked ranges.

Every part may be missing, so that the effect of each part can be examined separately. A problem may
declare the parts of its own machine (``Problem.rig``). Their behaviour is defined in the package
``rig``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, ClassVar

from zeno_orbits.errors import InputError, did_you_mean, not_known
from zeno_orbits.model.declared.quantities import Quantity, positive
from zeno_orbits.work import require_kinds


def _nonnegative(name: str, default: float | None, unit: str, meaning: str) -> Quantity:
    return Quantity(name=name, unit=unit, meaning=meaning, default=default, lower=0.0)


class Part:
    """A part of a machine, whose numbers have ranges."""

    __slots__ = ()
    QUANTITIES: ClassVar[tuple[Quantity, ...]] = ()

    def __post_init__(self) -> None:
        """Reject values out of range."""
        for quantity in self.QUANTITIES:
            quantity.checked(getattr(self, quantity.name))


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact(Part):
    r"""A compliant stop with damping (theory (6.1)).

    .. math:: F = k\,\delta^n\,\max(0, 1 + \alpha\dot\delta),\qquad \delta = -h

    The damping factor follows from the problem's restitution and the speed at which a contact
    begins (theory (6.2)). It is not a separate parameter.

    Attributes:
        stiffness: :math:`k`, force over penetration to the `n`.
        exponent: :math:`n`, which is 1 for a spring and 1.5 for two spheres [Hertz1882]_.
        slowest: Minimum impact speed. A slower contact is damped as if it had begun at this speed.
    """

    QUANTITIES: ClassVar[tuple[Quantity, ...]] = (
        positive("stiffness", 1e5, "1", "force over penetration to the exponent"),
        Quantity(
            name="exponent",
            unit="1",
            meaning="power of the penetration",
            default=1.0,
            lower=1.0,
            upper=3.0,
        ),
        positive("slowest", 1e-6, "1", "speed below which damping grows no further"),
    )

    stiffness: float = 1e5
    exponent: float = 1.0
    slowest: float = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Friction(Part):
    r"""Friction of one coordinate: dry friction, which slips or sticks, and :math:`-b v`.

    The dry friction is a `DryFriction` along the coordinate, with the torque `c` (theory (6.3)).

    Attributes:
        coulomb: :math:`c`, dry friction [N m].
        viscous: :math:`b` [N m s/rad].
    """

    QUANTITIES: ClassVar[tuple[Quantity, ...]] = (
        _nonnegative("coulomb", 0.0, "N m", "dry friction"),
        _nonnegative("viscous", 0.0, "N m s/rad", "viscous friction"),
    )

    coulomb: float = 0.0
    viscous: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Gear(Part):
    """A gear train with backlash between a rotor and the joint that it drives (theory (6.3)).

    Attributes:
        rotor_inertia: Inertia on the motor side, reflected to the joint. The problem includes it in
            its mass matrix [kg m^2].
        play: Backlash, the angle of free rotation of the rotor [rad].
        stiffness: Stiffness of the teeth in contact [N m/rad].
        loss: Damping factor of the teeth [s/rad].
    """

    QUANTITIES: ClassVar[tuple[Quantity, ...]] = (
        positive("rotor_inertia", None, "kg m^2", "inertia on the motor's side of the teeth"),
        _nonnegative("play", 0.0, "rad", "angle by which the rotor turns freely"),
        positive("stiffness", 1000.0, "N m/rad", "stiffness of the teeth"),
        _nonnegative("loss", 0.0, "s/rad", "damping factor of the teeth"),
    )

    rotor_inertia: float
    play: float = 0.0
    stiffness: float = 1000.0
    loss: float = 0.0


class PwmSettings(Enum):
    """Ways to follow the transistors of a bridge."""

    AVERAGED = "averaged over a period"
    EXACT = "edge by edge"


@dataclass(frozen=True, slots=True, kw_only=True)
class HBridge(Part):
    """The H-bridges that feed the motors, one per motor, all alike (theory (6.4)).

    Attributes:
        supply: Supply voltage, which limits all voltages [V].
        resistance: Resistance of the transistors in the current's path [ohm].
        frequency: Frequency of the pulses [Hz].
        dead_time: Dead time, in which both transistors of a leg are off at an edge [s].
        diode_drop: Voltage over a diode that carries the current in a dead time [V].
        switching: Whether the pulses are simulated edge by edge. Otherwise their mean is used.
    """

    QUANTITIES: ClassVar[tuple[Quantity, ...]] = (
        positive("supply", 12.0, "V", "supply voltage, which limits all voltages"),
        _nonnegative("resistance", 0.0, "ohm", "transistors in the path of the current"),
        positive("frequency", 20e3, "Hz", "pulses per second"),
        _nonnegative("dead_time", 0.0, "s", "time at every edge with both transistors off"),
        _nonnegative("diode_drop", 0.0, "V", "over a diode that carries the current"),
    )

    supply: float
    resistance: float = 0.0
    frequency: float = 20e3
    dead_time: float = 0.0
    diode_drop: float = 0.0
    switching: PwmSettings = PwmSettings.AVERAGED

    def __post_init__(self) -> None:
        """Reject values out of range, and dead times that leave no time to switch."""
        Part.__post_init__(self)
        if not 2 * self.dead_time * self.frequency < 1.0:
            longest = 0.5 / self.frequency
            wanted = f"must be less than half a period of the pulses, {longest:g} s"
            raise InputError(f"Argument `dead_time` {wanted}, but it is {self.dead_time:g}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller(Part):
    """A computer that samples, and sets and holds the voltages, at a fixed rate.

    Attributes:
        period: Between two readings [s].
        delay: Time from a reading to the voltages computed from it [s].
    """

    QUANTITIES: ClassVar[tuple[Quantity, ...]] = (
        positive("period", 1e-3, "s", "between two readings"),
        _nonnegative("delay", 0.0, "s", "from a reading to its voltage"),
    )

    period: float
    delay: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensors(Part):
    """Measurements of the state for a controller: rounded coordinates, and their differences.

    Attributes:
        resolution: Step of the encoders of all coordinates, or 0 for exact coordinates [rad].
        noise: Standard deviation of a coordinate before it is rounded [rad].
        filter_time: Time constant of the low pass after the difference of two readings [s].
        current_noise: Standard deviation of a current, as recorded and as the controller reads it
            [A].
        window: Time of readings through which a parabola is fitted for states that are set at an
            event, or 0 for the last reading [s].
    """

    QUANTITIES: ClassVar[tuple[Quantity, ...]] = (
        _nonnegative("resolution", 0.0, "rad", "step of the encoders"),
        _nonnegative("noise", 0.0, "rad", "standard deviation of a coordinate"),
        _nonnegative("filter_time", 0.0, "s", "low pass after the difference of two readings"),
        _nonnegative("current_noise", 0.0, "A", "standard deviation of a current that is read"),
        _nonnegative("window", 0.0, "s", "readings of which an event's state is the parabola"),
    )

    resolution: float = 0.0
    noise: float = 0.0
    filter_time: float = 0.0
    current_noise: float = 0.0
    window: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """A machine: a compliant stop, and optional parts.

    Attributes:
        contact: The compliant stop.
        friction: Friction by the name of the coordinate.
        gears: Gears by the index of the motor, from 1.
        bridge: H-bridge between controller and motors. Without a bridge the motors get any
            commanded voltage.
        controller: Sampled controller. Without a controller the feedback is the model's continuous
            feedback.
        sensors: Sensors of the controller. Without sensors it reads the exact states.
    """

    contact: Contact = field(default_factory=Contact)
    friction: Mapping[str, Friction] = field(default_factory=dict[str, Friction])
    gears: Mapping[int, Gear] = field(default_factory=dict[int, Gear])
    bridge: HBridge | None = None
    controller: Controller | None = None
    sensors: Sensors | None = None

    def __post_init__(self) -> None:
        """Refuse sensors that nothing reads, and windows of too few readings."""
        require_kinds(self)
        if self.sensors is not None and self.controller is None:
            wanted = "must be given for `sensors`, which it reads"
            raise InputError(f"Argument `controller` {wanted}, but it is missing.")
        if self.sensors is None or self.controller is None or not self.sensors.window:
            return
        least = _LEAST_READINGS * self.controller.period
        if self.sensors.window < least:
            wanted = f"must be 0, or at least {_LEAST_READINGS} readings of `controller.period`"
            told = f"{wanted}, {least:g} s, but it is {self.sensors.window:g}"
            raise InputError(f"Argument `sensors.window` {told}.")

    def __hash__(self) -> int:
        """Hash by value, so that cached functions of a rig can be found again."""
        parts = (self.contact, self.bridge, self.controller, self.sensors)
        named = frozenset((*self.friction.items(), *self.gears.items()))
        return hash((*parts, named))


_LEAST_READINGS = 4
"""Readings that a parabola needs, with one to spare."""
PART_NAMES = ("friction", "gears", "bridge", "controller", "sensors")
"""Parts of a rig in addition to its contact."""
_ONE = {"contact": Contact, "bridge": HBridge, "controller": Controller, "sensors": Sensors}
_MANY = {"friction": Friction, "gears": Gear}


def without_parts(rig: Rig, names: Sequence[str]) -> Rig:
    """Return a rig without some of its parts, and without sensors that nothing would read.

    Args:
        rig: The rig.
        names: Names from ``PART_NAMES``.
    """
    gone = {*names, *(["sensors"] if "controller" in names else [])}
    changes: dict[str, Any] = {name: {} if name in _MANY else None for name in gone}
    return replace(rig, **changes)


def rig_with_numbers(rig: Rig, numbers: Mapping[str, float]) -> Rig:
    """Return a rig with changed parameter values. A missing part is added.

    Args:
        rig: The rig.
        numbers: Values by names like ``contact.stiffness``, ``friction.COORDINATE.coulomb`` and
            ``gears.MOTOR.play``.

    Raises:
        InputError: If a name is unknown, a value is out of its range, or an added part needs
            another part.
    """
    given: dict[tuple[str, str], dict[str, float]] = {}
    for name, value in numbers.items():
        part, _, rest = name.partition(".")
        owner, dot, field_name = rest.rpartition(".")
        kind = _ONE.get(part) or _MANY.get(part)
        known = [quantity.name for quantity in kind.QUANTITIES] if kind is not None else []
        if kind is None or field_name not in known or bool(dot) is not (part in _MANY):
            raise InputError(_unknown_number(name, part, known))
        given.setdefault((part, owner), {})[field_name] = value
    for (part, owner), changes in given.items():
        try:
            rig = _with_part(rig, part, owner, changes)
        except InputError as error:
            # The user wrote the whole name of the value.
            whole = ".".join(filter(None, (part, owner)))
            text = re.sub(r"^Argument `(\w+)`", rf"Argument `{whole}.\1`", str(error))
            raise InputError(text) from error
    return rig


def _with_part(rig: Rig, part: str, owner: str, changes: Mapping[str, float]) -> Rig:
    values: dict[str, Any] = dict(changes)
    held: Any = getattr(rig, part)
    if part in _ONE:
        made = replace(held, **values) if held is not None else _made(_ONE[part], part, values)
        return replace(rig, **{part: made})
    if part == "gears" and not owner.isdigit():
        wanted = "must be a number in `gears.MOTOR.NAME`"
        raise InputError(f"Argument `motor` {wanted}, but it is `{owner}`.")
    key: Any = int(owner) if part == "gears" else owner
    one = held.get(key)
    made = replace(one, **values) if one is not None else _made(_MANY[part], part, values)
    return replace(rig, **{part: {**held, key: made}})


def _made(kind: Any, part: str, values: dict[str, Any]) -> Any:
    """Return a new part, its defaults filled in."""
    full = {q.name: q.default for q in kind.QUANTITIES if q.default is not None} | values
    for quantity in kind.QUANTITIES:
        if quantity.name not in full:
            wanted = f"must be given for a part that is added: `{part}` lacks it"
            raise InputError(f"Argument `{quantity.name}` {wanted}.")
    return kind(**full)


def _unknown_number(name: str, part: str, known: Sequence[str]) -> str:
    if not known:
        parts = (*_ONE, *_MANY)
        near = did_you_mean(name.partition(".")[0], parts)
        return f"Argument `part`: unknown part in `{name}`.{near} Known: {', '.join(parts)}."
    owner = {"friction": "COORDINATE.", "gears": "MOTOR."}.get(part, "")
    forms = [f"{part}.{owner}{field_name}" for field_name in known]
    return f"Argument `part`: {not_known(name, forms)}"
