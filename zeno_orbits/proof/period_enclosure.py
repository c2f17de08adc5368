"""Result of the enclosure of one period: its events, and the distance of the orbit file."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from zeno_orbits.proof.theorem import ProvedInterval
from zeno_orbits.work import decimal_above

_WORDS = {"impact": "resolved impact", "zeno_point": "Zeno point", "release": "release"}


@dataclass(frozen=True, slots=True, kw_only=True)
class EnclosedEvent:
    """An event of a period.

    Attributes:
        kind: ``impact``, ``zeno_point`` or ``release``.
        time: Time since the start of the period, for every execution of the box [s].
    """

    kind: str
    time: ProvedInterval


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PeriodEnclosure:
    """Result of an enclosure: whether one period has exactly the events of the orbit file.

    Attributes:
        problem: Name of the problem.
        claim: Name of the first claim that could not be shown, empty if all claims were shown.
        reason: Reason of the failure.
        events: Individually resolved impacts, Zeno points and releases, in order. Empty unless the
            period is enclosed.
        miss: Bound of the distance between the orbit file and any execution of the box. Times are
            relative to the period, states to their size. None unless the period is enclosed.
        radius: Radius of the box of initial states, relative to the size of each coordinate of the
            section, or 0 if the section is a single point. None unless the period is enclosed.
        n_inclusions: Number of inclusions that enclose the period.
        processor_time: Processor time [s].
    """

    problem: str
    claim: str = ""
    reason: str = ""
    events: tuple[EnclosedEvent, ...] = ()
    miss: float | None = None
    radius: float | None = None
    n_inclusions: int = 0
    processor_time: float = 0.0

    def __repr__(self) -> str:
        """Return the verdict as one line."""
        return f"<PeriodEnclosure of {self.problem}: {self.verdict()}>"

    @property
    def enclosed(self) -> bool:
        """True if the period is enclosed and has exactly the events of the file."""
        return not self.claim

    def verdict(self) -> str:
        """Return the verdict as one line."""
        if self.miss is None:
            return f"Rigorous: not enclosed: `{self.claim}`: {self.reason}."
        kinds = [event.kind for event in self.events]
        counts = [_counted(kinds.count(kind), word) for kind, word in _WORDS.items()]
        inclusions = _counted(self.n_inclusions, "inclusion")
        return (
            f"Rigorous: {inclusions} enclose one period with {', '.join(counts)}. No event is"
            " missed. The numbers of the orbit file are within"
            f" {decimal_above(Fraction(self.miss), 2)} of every enclosed execution."
        )

    def as_json(self) -> dict[str, Any]:
        """Return the result as plain data."""
        return {
            "enclosed": self.enclosed,
            "claim": self.claim,
            "reason": self.reason,
            "events": [{"kind": one.kind, "time": one.time.text} for one in self.events],
            "miss": self.miss,
            "radius": self.radius,
            "inclusions": self.n_inclusions,
            "processor_time": self.processor_time,
        }


def _counted(count: int, word: str) -> str:
    return f"{count} {word}{'' if count == 1 else 's'}"
