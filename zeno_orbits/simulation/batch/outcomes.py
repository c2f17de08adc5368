"""Events that a batch reports of its lanes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from zeno_orbits.arrays import Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Released:
    """A lane was released from the stop.

    Attributes:
        lane: Which.
        time: When [s].
        state: Where, ``(n_x,)``.
        impacts: Impacts since the release before, or the start.
        struck: Gap rate before the first of them; negative.
        zeno_time: When the impacts ended [s]; NaN if none did.
        zeno_acceleration: Gap acceleration there.
    """

    lane: int
    time: float
    state: Vector
    impacts: int
    struck: float
    zeno_time: float
    zeno_acceleration: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Struck:
    """A sequence of impacts began: the impact is the first, or hardly slower than the one before.

    Attributes:
        lane: Which.
        time: When [s].
        state: State just after the impact, ``(n_x,)``.
        rate: Gap rate before it; negative.
    """

    lane: int
    time: float
    state: Vector
    rate: float


class Reason(Enum):
    """Why a lane ended."""

    HORIZON = "the end of the time was reached"
    ESCAPE = "a coordinate left its bounds"
    REST = "it came to rest"
    HELD = "it stays on its stop"
    FAILURE = "it cannot be continued"


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """A lane ended.

    Attributes:
        lane: Which.
        time: When [s].
        state: Where, ``(n_x,)``.
        reason: Why.
        detail: Name of the coordinate that escaped, or a sentence on the failure.
    """

    lane: int
    time: float
    state: Vector
    reason: Reason
    detail: str = ""


LaneEvent = Released | Struck | Ended
