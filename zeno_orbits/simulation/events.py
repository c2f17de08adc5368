"""The table of events: a row per kind, and the values of the events."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import fast_dataclass
from zeno_orbits.loop import binding
from zeno_orbits.work import ByValue


class EventKind(Enum):
    """A row of the table of events.

    Attributes:
        word: The kind in event sequences and orbit files.
        label: The kind as a reader sees it.
        number: The kind in records of the loop.
    """

    IMPACT = "impact", "impact", binding.IMPACT
    ZENO = "zeno", "Zeno point", binding.ZENO
    RELEASE = "release", "release", binding.RELEASE
    SWITCH = "switch", "switch", binding.SWITCH

    def __init__(self, word: str, label: str, number: int) -> None:
        """Keep the columns."""
        self.word, self.label, self.number = word, label, number


class _OfStop:
    """An event of a stop."""

    __slots__ = ()
    stop: str

    @property
    def what(self) -> str:
        """Name of its stop."""
        return self.stop


class _Jump:
    """An event with a reset."""

    __slots__ = ()
    state_minus: Vector
    state_plus: Vector

    @property
    def before(self) -> Vector:
        """State just before it, ``(n_x,)``."""
        return self.state_minus

    @property
    def after(self) -> Vector:
        """State just after it, ``(n_x,)``."""
        return self.state_plus


class _NoJump:
    """An event at which the state goes on."""

    __slots__ = ()
    state: Vector

    @property
    def before(self) -> Vector:
        """State just before it, ``(n_x,)``."""
        return self.state

    @property
    def after(self) -> Vector:
        """State just after it, ``(n_x,)``."""
        return self.state


@fast_dataclass
class Impact(_OfStop, _Jump, ByValue):
    """A resolved impact.

    Attributes:
        time: Time of the impact [s].
        state_minus: State before it, ``(n_x,)``.
        state_plus: State after it, ``(n_x,)``.
        approach_rate: Gap rate before the impact, negative. It is exact even if the state
            determines it only to rounding.
        stop: Name of the stop, empty for a machine with one stop.
    """

    time: float
    state_minus: Vector
    state_plus: Vector
    approach_rate: float
    stop: str = ""
    kind: ClassVar[EventKind] = EventKind.IMPACT


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenoPoint(_OfStop, _NoJump, ByValue):
    """The limit of an impact sequence.

    Attributes:
        time: Zeno time [s].
        state: Zeno state, ``(n_x,)``.
        limit_error: Estimated extrapolation error of time and state, relative to ``1 + |t|`` and
            ``1 + |x|``, as if the resolved impacts were exact. The integration error of the
            previous flights is additional and may be far larger. ``accuracy.simulate_with_error``
            estimates both errors.
        tail: Time between the last resolved impact and the limit [s].
        last_speed: Gap rate after the last resolved impact.
        stop: Name of the stop, empty for a machine with one stop.
    """

    time: float
    state: Vector
    limit_error: float
    tail: float
    last_speed: float
    stop: str = ""
    kind: ClassVar[EventKind] = EventKind.ZENO


@dataclass(frozen=True, slots=True, kw_only=True)
class Release(_OfStop, _NoJump, ByValue):
    """The end of contact, at which the contact force reaches zero.

    Attributes:
        time: Time of the release [s].
        state: State at the release, ``(n_x,)``.
        stop: Name of the stop, empty for a machine with one stop.
    """

    time: float
    state: Vector
    stop: str = ""
    kind: ClassVar[EventKind] = EventKind.RELEASE


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchEvent(_Jump, ByValue):
    """A switch: a guard that fell through zero where it is armed, or a kink of a formula.

    Attributes:
        time: Time of the switch [s].
        name: Name of the switch.
        state_minus: State before it, ``(n_x,)``.
        state_plus: State after it, ``(n_x,)``. At a kink it is the same state.
    """

    time: float
    name: str
    state_minus: Vector
    state_plus: Vector
    kind: ClassVar[EventKind] = EventKind.SWITCH

    @property
    def what(self) -> str:
        """Name of its switch."""
        return self.name

    @property
    def state(self) -> Vector:
        """The state after the switch."""
        return self.state_plus


Event = Impact | ZenoPoint | Release | SwitchEvent


def event_name(event: Event) -> str:
    """Return the name of an event, with the name of its stop or switch if it has one.

    Args:
        event: The event.
    """
    return f"{event.kind.label} {event.what}".rstrip()


def state_before(event: Event) -> Vector:
    """Return the state just before an event, ``(n_x,)``.

    Args:
        event: The event.
    """
    return event.before


def state_after(event: Event) -> Vector:
    """Return the state just after an event, ``(n_x,)``.

    Args:
        event: The event.
    """
    return event.after
