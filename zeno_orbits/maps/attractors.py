"""Attractors with their properties: the result at one point of a map, and its plain data."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from zeno_orbits.orbits import NO_ZENO_ORBIT, SIMPLE_ORBIT, ZENO_ORBIT
from zeno_orbits.simulation import STEADY, AttractorKind
from zeno_orbits.work import EntryError, from_plain


class AttractorClass(Enum):
    """Kinds of attractors. The value is the phrase shown to the user."""

    ZENO = ZENO_ORBIT
    SIMPLE = SIMPLE_ORBIT
    NO_ZENO = NO_ZENO_ORBIT
    REST = "rest"
    HELD = "permanent contact"
    ESCAPE = "a coordinate diverges"
    UNSETTLED = "not settled yet"
    FAILED = "simulation failed"


_KINDS = {
    AttractorClass.ZENO: AttractorKind.REPEATS,
    AttractorClass.SIMPLE: AttractorKind.REPEATS,
    AttractorClass.NO_ZENO: AttractorKind.REPEATS,
    AttractorClass.REST: AttractorKind.RESTS,
    AttractorClass.HELD: AttractorKind.HELD,
    AttractorClass.ESCAPE: AttractorKind.GONE,
}
_IRREGULAR = {
    AttractorKind.QUASI_PERIODIC: "quasi-periodic motion",
    AttractorKind.CHAOTIC: "chaotic motion",
    AttractorKind.GROWS: "growing motion",
}
ORBITS = (AttractorClass.ZENO, AttractorClass.SIMPLE, AttractorClass.NO_ZENO)
"""Attractors that are periodic orbits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attractor:
    """The attractor of a motion.

    Attributes:
        fate: Kind of the attractor. ``SIMPLE`` is an orbit whose contact begins with the first
            impact, at a plastic stop.
        returns: Number of releases per period: 1 for a period-1 orbit, 2 after a period doubling, 0
            without releases.
        period: Time after which the motion repeats [s], also in permanent contact. NaN if it does
            not repeat.
        multipliers: Floquet multipliers over the period, the largest first.
        margins: Name to distance to a loss of the orbit's shape, as in a certificate.
        state: State at the release (or impact) at which the period starts, by name.
        escaped: Name of the diverging coordinate.
        trend: Growth factor of the motion per period, if it neither repeats nor has decayed. NaN if
            it is unknown.
        detail: Further explanation of the fate, as text, such as the stops of permanent contact.
        kind: Kind of the motion. For a motion that has not converged, it is quasi-periodic, chaotic
            or growing.
        turns: Number of turns of the clock per period. 0 without a clock or a period.
        exponent: Largest Lyapunov exponent of a motion that does not repeat [1/s], else NaN.
        exponent_error: Three standard deviations of the exponent [1/s].
        number: Index of the orbit if a map over states has several orbits of one kind, else 0.
        sequence: Event sequence of an orbit of a machine with several stops or switches, from the
            event after `state` to the event of its section.
    """

    fate: AttractorClass
    returns: int = 0
    period: float = float("nan")
    multipliers: tuple[complex, ...] = ()
    margins: Mapping[str, float] = field(default_factory=dict[str, float])
    state: Mapping[str, float] = field(default_factory=dict[str, float])
    escaped: str = ""
    trend: float = float("nan")
    detail: str = ""
    kind: AttractorKind = AttractorKind.UNDECIDED
    turns: int = 0
    exponent: float = float("nan")
    exponent_error: float = float("nan")
    number: int = 0
    sequence: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Fill in the kind that follows from the fate alone."""
        if self.kind is AttractorKind.UNDECIDED:
            object.__setattr__(self, "kind", _KINDS.get(self.fate, self.kind))

    @property
    def phrase(self) -> str:
        """The kind of the attractor, as text for a legend."""
        if self.fate in ORBITS:
            several = self.fate is AttractorClass.ZENO or self.returns > 1
            period = f", period {self.returns}" if several and self.returns else ""
            if self.sequence:
                period = f", {_counted(self.sequence)}"
            turns = f", {self.turns} turns" if self.turns > 1 else ""
            number = f", number {self.number}" if self.number else ""
            return f"{self.fate.value}{period}{turns}{number}"
        if self.fate is AttractorClass.HELD:
            return f"{self.fate.value}, {self.turns} turns" if self.turns > 1 else self.fate.value
        if self.fate is AttractorClass.ESCAPE:
            return self.detail or f"{self.escaped} diverges"
        if self.fate is AttractorClass.UNSETTLED and self.kind in _IRREGULAR:
            return _IRREGULAR[self.kind]
        if self.fate is AttractorClass.UNSETTLED and not self.detail:
            # The motion was not analysed further.
            if self.trend > 1.0 + STEADY:
                return f"{self.fate.value}, growing"
            if self.trend < 1.0 - STEADY:
                return f"{self.fate.value}, decaying"
        return self.fate.value

    def as_json(self) -> dict[str, Any]:
        """Return the attractor as plain data, as in a point of a map file."""
        return attractor_json(self)

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of the multipliers: 0 without multipliers, NaN if it is unknown."""
        # A state just after an impact always has a multiplier, but a release may not have any.
        known = self.sequence or self.fate in (AttractorClass.ZENO, AttractorClass.SIMPLE)
        nothing = 0.0 if known else math.nan
        return max((abs(value) for value in self.multipliers), default=nothing)


def _counted(sequence: Sequence[str]) -> str:
    """Return the number of events of a sequence, and of the Zeno points among them."""
    zenos = sum(name.startswith("zeno ") for name in sequence)
    counts = [(len(sequence), "event"), *([(zenos, "Zeno point")] if zenos else [])]
    return ", ".join(f"{n} {word}{'s' if n > 1 else ''}" for n, word in counts)


def attractor_json(attractor: Attractor) -> dict[str, Any]:
    """Return an attractor as plain data, bit for bit. Unknown entries are omitted."""
    entries = {
        "fate": attractor.fate.name.lower(),
        "returns": attractor.returns,
        "period": attractor.period,
        "multipliers": [[value.real, value.imag] for value in attractor.multipliers],
        "margins": dict(attractor.margins),
        "state": dict(attractor.state),
        "escaped": attractor.escaped,
        "trend": attractor.trend,
        "detail": attractor.detail,
        "kind": attractor.kind.name.lower(),
        "turns": attractor.turns,
        "exponent": attractor.exponent,
        "exponent_error": attractor.exponent_error,
        "number": attractor.number,
        "sequence": list(attractor.sequence),
    }
    empty: tuple[object, ...] = ("", [], {})
    return {
        name: value
        for name, value in entries.items()
        if value not in empty
        and (name, value) not in (("turns", 0), ("number", 0))
        and not (isinstance(value, float) and math.isnan(value))
    }


def attractor_from_json(entries: Mapping[str, Any], name: str = "data") -> Attractor:
    """Return the attractor of plain data.

    Args:
        entries: The plain data.
        name: Name of the data in an error message.

    Raises:
        EntryError: If an entry is missing, has a wrong type, or an invalid value.
        KeyError, TypeError, ValueError: If the data do not describe an attractor.
    """
    words = {**entries, "fate": str(entries["fate"]).upper()}
    words["kind"] = str(entries.get("kind", AttractorKind.UNDECIDED.name)).upper()
    found = from_plain(Attractor, words, name, finite=True)
    if found.returns < 0:
        raise EntryError(f"{name}.returns", "at least 0", str(found.returns))
    if found.turns < 0:
        raise EntryError(f"{name}.turns", "at least 0", str(found.turns))
    if found.number < 0:
        raise EntryError(f"{name}.number", "at least 0", str(found.number))
    if found.period <= 0.0:
        raise EntryError(f"{name}.period", "positive", f"{found.period:g}")
    return found
