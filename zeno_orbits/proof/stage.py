"""Where a proof has come to: a set, its mode, the times of all its motions, and the next record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from zeno_orbits.proof.balls import ZERO, Ball, Matrix, product
from zeno_orbits.proof.sets import BallSet


class Departure(Enum):
    """How the motions of a set are about to move, which tells how the stop is near."""

    FLYING = "flying"
    RELEASED = "released"
    STRUCK = "struck"
    LOCKED = "locked"


@dataclass(frozen=True, slots=True, kw_only=True)
class BallTime:
    """Times of the motions of a set: of the one from the middle, and how they change.

    Attributes:
        middle: Time of the motion from the middle of the start box [s].
        slopes: Derivative with respect to the start coordinates, over the whole box, ``(d,)``.
    """

    middle: Ball
    slopes: tuple[Ball, ...]

    @classmethod
    def start(cls, d: int) -> BallTime:
        """Return time zero, with ``d`` start coordinates."""
        return cls(middle=ZERO, slopes=(ZERO,) * d)

    def later(self, duration: Ball, slopes: Sequence[Ball] = ()) -> BallTime:
        """Return the times after a duration, which may change with the start coordinates."""
        added = slopes or (ZERO,) * len(self.slopes)
        return BallTime(
            middle=self.middle + duration,
            slopes=tuple(a + b for a, b in zip(self.slopes, added, strict=True)),
        )

    def at(self, offset: Sequence[Ball]) -> Ball:
        """Return the time at start coordinates, given less those of the middle."""
        return sum((a * b for a, b in zip(self.slopes, offset, strict=True)), self.middle)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofRecord:
    """One inclusion: what leads from a set to the next.

    Attributes:
        kind: ``step``, ``cross``, ``impact`` or ``tail``.
        numbers: The numbers of the record, exact.
        orders: Of a Taylor step; empty otherwise.
        result: The set handed on.
    """

    kind: str
    numbers: dict[str, Any]
    orders: tuple[int, ...]
    result: BallSet


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofStage:
    """A set on its way.

    Attributes:
        at: The set.
        departure: How it moves on.
        time: Since the start.
    """

    at: BallSet
    departure: Departure
    time: BallTime

    def timed(self, duration: Ball, row: Matrix) -> BallTime:
        """Return the times after an event.

        Args:
            duration: From here to it, for ``m``.
            row: Its derivative with respect to the state, ``(1, n)``.
        """
        slopes: list[Ball] = (row * self.at.derivative).entries() if self.at.U else []
        (noise,) = product(row, self.at.noise)
        return self.time.later(duration + noise, slopes)

    def next(self, result: BallSet, departure: Departure, time: BallTime) -> ProofStage:
        """Return the stage after a record."""
        return replace(self, at=result, departure=departure, time=time)
