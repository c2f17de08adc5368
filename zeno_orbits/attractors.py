"""What a motion settles to, as numbers: the answer for one point of a map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum


class Fate(Enum):
    """Where a motion ends. The value is the phrase shown to the user."""

    ZENO = "Zeno periodic orbit"
    SIMPLE = "simple periodic orbit"
    NO_ZENO = "periodic orbit without a Zeno point"
    REST = "rest"
    ESCAPE = "a coordinate runs away"
    UNSETTLED = "not settled in the time given"
    FAILED = "the simulation stops"


@dataclass(frozen=True, slots=True, kw_only=True)
class Attractor:
    """What a motion settles to.

    Attributes:
        fate: Its kind. ``SIMPLE`` is an orbit that locks with the first impact: a plastic stop.
        returns: Releases a period, 1 for a period-1 orbit, 2 after a flip; 0 where there is none.
        period: Time after which the motion repeats [s]; NaN where it does not.
        multipliers: Floquet multipliers over the period, the largest first.
        margins: Name to distance from where the orbit would lose its shape, as in a certificate.
        state: State at the release (or impact) at which the period starts, by name.
        escaped: Name of the coordinate that runs away.
        trend: Factor by which the motion grows a period, if it neither repeats nor has died out;
            NaN where nothing can be said.
        detail: The reason in words, where the fate alone does not tell.
    """

    fate: Fate
    returns: int = 0
    period: float = float("nan")
    multipliers: tuple[complex, ...] = ()
    margins: Mapping[str, float] = field(default_factory=dict[str, float])
    state: Mapping[str, float] = field(default_factory=dict[str, float])
    escaped: str = ""
    trend: float = float("nan")
    detail: str = ""

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of the multipliers; NaN without any."""
        return max((abs(value) for value in self.multipliers), default=float("nan"))
