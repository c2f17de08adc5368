"""Attractors with their numbers: the answer at one point of a map, and its plain data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from zeno_orbits.simulation.attractor import STEADY


class Fate(Enum):
    """Kinds of attractors. The value is the phrase shown to the user."""

    ZENO = "Zeno periodic orbit"
    SIMPLE = "simple periodic orbit"
    NO_ZENO = "periodic orbit without a Zeno point"
    REST = "rest"
    HELD = "stays on its stop"
    ESCAPE = "a coordinate runs away"
    UNSETTLED = "not settled yet"
    FAILED = "simulation failed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Attractor:
    """The attractor of a motion.

    Attributes:
        fate: Its kind. ``SIMPLE`` is an orbit that locks with the first impact: a plastic stop.
        returns: Releases a period, 1 for a period-1 orbit, 2 after a flip; 0 without releases.
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
    def phrase(self) -> str:
        """Its kind in the words of a legend."""
        if self.fate is Fate.ZENO:
            return f"{self.fate.value}, period {self.returns}"
        if self.fate is Fate.SIMPLE and self.returns > 1:
            return f"{self.fate.value}, period {self.returns}"
        if self.fate is Fate.ESCAPE:
            return self.detail or f"{self.escaped} runs away"
        if self.fate is Fate.UNSETTLED and self.trend > 1.0 + STEADY:
            return f"{self.fate.value}, growing"
        if self.fate is Fate.UNSETTLED and self.trend < 1.0 - STEADY:
            return f"{self.fate.value}, dying out"
        return self.fate.value

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of the multipliers; NaN without any."""
        return max((abs(value) for value in self.multipliers), default=float("nan"))


def attractor_json(attractor: Attractor) -> dict[str, Any]:
    """Return an attractor as plain data, every bit of it; what is unknown is left out."""
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
    }
    empty: tuple[object, ...] = ("", [], {})
    return {
        name: value
        for name, value in entries.items()
        if value not in empty and not (isinstance(value, float) and math.isnan(value))
    }


def attractor_from_json(entries: Mapping[str, Any]) -> Attractor:
    """Return the attractor of plain data.

    Raises:
        KeyError, TypeError, ValueError: If the data are not those of an attractor.
    """
    return Attractor(
        fate=Fate[str(entries["fate"]).upper()],
        returns=int(entries.get("returns", 0)),
        period=float(entries.get("period", math.nan)),
        multipliers=tuple(complex(*pair) for pair in entries.get("multipliers", ())),
        margins={str(k): float(v) for k, v in dict(entries.get("margins", {})).items()},
        state={str(k): float(v) for k, v in dict(entries.get("state", {})).items()},
        escaped=str(entries.get("escaped", "")),
        trend=float(entries.get("trend", math.nan)),
        detail=str(entries.get("detail", "")),
    )
