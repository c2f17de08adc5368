"""Results of a continuation: families, their points, special points and ends, and their JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

from zeno_orbits.arrays import spectral_radius
from zeno_orbits.model import RecordedFile
from zeno_orbits.work import Columns, TableRepr, by_name

FORMAT = 1
"""Version of the file format."""


class SpecialPointKind(Enum):
    """Kinds of special points of a family. The value is the name in the output."""

    START = "start"
    FOLD = "fold"
    FLIP = "flip"
    TORUS = "Neimark-Sacker"
    BRANCHING = "branch point"
    LOCK_VANISHES = "contact phase vanishes"
    THEOREM_LOST = "d2h/dt2 = 0, multiplier rising"
    GRAZING = "first impact grazes"
    EARLIER_GRAZING = "earlier contact grazes"
    LATER_GRAZING = "later impact grazes"
    RELEASE_LOST = "release not transversal"
    EARLIER_RELEASE = "earlier release"
    EVENTS_MEET = "two events meet"
    SWITCH_LOST = "switch not transversal"
    SWITCH_ENTERS = "switch enters"
    ARMING = "arming changes"
    AMPLITUDE_ZERO = "amplitude zero"
    PERIOD_INFINITE = "period to infinity"
    BOUND = "end of the range"
    CLOSED = "family closes"
    REJOINS = "joins half the period"
    MOST_STEPS = "number of steps"
    GAVE_UP = "gave up"

    @property
    def located(self) -> bool:
        """True for a point of the problem, False for a start or stop of the continuation."""
        return self not in _OF_THE_CONTINUATION


_OF_THE_CONTINUATION = (
    SpecialPointKind.START,
    SpecialPointKind.BOUND,
    SpecialPointKind.CLOSED,
    SpecialPointKind.REJOINS,
    SpecialPointKind.MOST_STEPS,
    SpecialPointKind.GAVE_UP,
)
_ON_THE_UNIT_CIRCLE = (
    SpecialPointKind.FOLD,
    SpecialPointKind.FLIP,
    SpecialPointKind.TORUS,
    SpecialPointKind.BRANCHING,
)
"""Kinds at which a multiplier has modulus 1.

If rounding leaves the modulus below 1, the orbit is not therefore stable.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyPoint:
    """An orbit of a family.

    Attributes:
        value: Value of the parameter that the family is followed in.
        state: State name to value at the section.
        period: Period [s]. Infinite at the end of a family whose motion stalls.
        multipliers: Multipliers of the return map, the largest first.
        margins: Margins by name. The name has the number of the return if there are several.
        miss: Largest relative difference of the return from the state.
        multiplier_error: Estimated error of the multipliers. Infinite if no estimate exists.
    """

    value: float
    state: Mapping[str, float]
    period: float
    multipliers: tuple[complex, ...]
    margins: Mapping[str, float]
    miss: float
    multiplier_error: float = 0.0

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of a multiplier."""
        return spectral_radius(self.multipliers)

    @property
    def stable(self) -> bool:
        """True if the orbit is stable: the spectral radius is below 1 by more than its error."""
        return self.spectral_radius + self.multiplier_error < 1.0

    @property
    def undecided(self) -> bool:
        """True if the spectral radius differs from 1 by no more than its error."""
        return not abs(self.spectral_radius - 1.0) > self.multiplier_error

    def as_json(self) -> dict[str, Any]:
        """Return the point as plain data."""
        return {
            "value": self.value,
            "period": finite_or_none(self.period),
            "state": dict(self.state),
            "multipliers": [[mu.real, mu.imag] for mu in self.multipliers],
            "multiplier_error": finite_or_none(self.multiplier_error),
            "stable": self.stable,
            "undecided": self.undecided,
            "margins": dict(self.margins),
            "miss": self.miss,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class SpecialPoint:
    """A special point or an end of a family.

    Attributes:
        kind: Its kind.
        at: The orbit. At an end, it is the limit of the orbits.
        error: Estimated error of the parameter's value. Zero if the value is given.
        index: Index of the family's point before it.
        detail: Additional information.
    """

    kind: SpecialPointKind
    at: FamilyPoint
    error: float
    index: int
    detail: str = ""

    @property
    def stable(self) -> bool:
        """True if the orbit is stable. False at a special point with a multiplier of modulus 1."""
        return self.kind not in _ON_THE_UNIT_CIRCLE and self.at.stable

    def as_json(self) -> dict[str, Any]:
        """Return the point as plain data."""
        return {
            "kind": self.kind.value,
            "index": self.index,
            "error": self.error,
            "detail": self.detail,
            **self.at.as_json(),
            "stable": self.stable,
        }


def finite_or_none(value: float) -> float | None:
    """Return a finite number unchanged and any other as ``None``, for JSON."""
    return value if math.isfinite(value) else None


_MOST_NAMED = 8
"""Largest number of named points per family, and of families, in a printed result."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Family(TableRepr):
    """A connected piece of a family, in order along it.

    Attributes:
        problem: Name of the problem.
        parameter: Name of the parameter in which it is followed.
        gains: Gains by name, with the values at the start.
        parameters: Parameters by name, with the values at the start. Derived parameters are
            included and held fixed.
        n_returns: Number of returns after which its orbits close.
        points: The orbits.
        special: Special points, in order.
        first: The end before the first point.
        last: The end after the last point.
        resolution: Distance in the parameter below which two special points of one kind may have
            been missed.
    """

    problem: str
    parameter: str
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    n_returns: int
    points: tuple[FamilyPoint, ...]
    special: tuple[SpecialPoint, ...]
    first: SpecialPoint
    last: SpecialPoint
    resolution: float = math.inf

    def __repr__(self) -> str:
        """Return one line: the range of the parameter and the named points."""
        named = [f"{one.kind.value} at {one.at.value:.6g}" for one in self.named[:_MOST_NAMED]]
        more = len(self.named) - len(named)
        rest = [f"and {more} more"] if more else []
        return (
            f"<Family of {self.problem} in {self.parameter}: points={len(self.points)}, "
            f"n_returns={self.n_returns}; {', '.join([*named, *rest])}>"
        )

    def _columns(self) -> Columns:
        """Return the orbits in order, including the named orbits."""
        return _orbits_of((self,))

    def _shown_columns(self) -> Columns:
        """Return the named orbits."""
        return _named_of((self,))

    @property
    def named(self) -> tuple[SpecialPoint, ...]:
        """All points with a name, ends included, in order along the family."""
        return (self.first, *self.special, self.last)

    def as_json(self) -> dict[str, Any]:
        """Return the family as plain data."""
        return {
            "n_returns": self.n_returns,
            "resolution": finite_or_none(self.resolution),
            "points": [point.as_json() for point in self.points],
            "special": [point.as_json() for point in self.special],
            "ends": [self.first.as_json(), self.last.as_json()],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class SpecialCurve:
    """A special point followed in two parameters.

    Attributes:
        kind: Its kind.
        names: The two parameters.
        x: Values of the first parameter, in order along the curve.
        y: Values of the second parameter.
        errors: Estimated error of each point, relative to the ranges.
        ends: Reason of the ending, at either end.
        cusps: Indices of the points that are cusps of a fold, where two folds meet.
    """

    kind: SpecialPointKind
    names: tuple[str, str]
    x: tuple[float, ...]
    y: tuple[float, ...]
    errors: tuple[float, ...]
    ends: tuple[str, str]
    cusps: tuple[int, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return the curve as plain data: a polyline with a name."""
        return {
            "name": self.kind.value,
            "parameters": list(self.names),
            "x": list(self.x),
            "y": list(self.y),
            "errors": list(self.errors),
            "ends": list(self.ends),
            "cusps": list(self.cusps),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class HalfCurve:
    """A special point followed in two parameters, in one direction.

    Attributes:
        x: Values of the first parameter, in order, including the start of the curve.
        y: Values of the second parameter.
        errors: Estimated error of each point, relative to the ranges.
        end: Reason of the ending.
        cusps: Indices of the points that are cusps of a fold.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]
    errors: tuple[float, ...]
    end: str
    cusps: tuple[int, ...] = ()

    @property
    def closes(self) -> bool:
        """True if the curve returns to its start. It is then the whole curve."""
        return self.end == SpecialPointKind.CLOSED.value


def whole_curve(
    kind: SpecialPointKind,
    names: tuple[str, str],
    first: HalfCurve,
    second: HalfCurve | None = None,
) -> SpecialCurve:
    """Return a curve from its halves.

    Args:
        kind: Its kind.
        names: The two parameters.
        first: Half of the curve from the special point to the end of the curve.
        second: Half of the curve from the special point to the beginning of the curve. It is not
            needed if the first half closes.
    """
    if second is None:
        second = replace(first, x=first.x[:1], y=first.y[:1], errors=first.errors[:1], cusps=())
    shift = len(second.x) - 1
    return SpecialCurve(
        kind=kind,
        names=names,
        x=(*second.x[:0:-1], *first.x),
        y=(*second.y[:0:-1], *first.y),
        errors=(*second.errors[:0:-1], *first.errors),
        ends=(second.end, first.end),
        cusps=(*(shift - k for k in second.cusps[::-1]), *(shift + k for k in first.cusps)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Continuation(TableRepr):
    """The result of a continuation.

    Attributes:
        families: The family of the start, then the families that branch off.
        boundaries: Curves of special points in two parameters.
        versions: Version by name, of the software that computed it.
        problem_digest: Digest of the equations of the problem, empty if it is unknown.
        problem_file: File of the problem, or None if the problem is bundled. Not compared.
    """

    families: tuple[Family, ...]
    boundaries: tuple[SpecialCurve, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    problem_digest: tuple[float, ...] = ()
    problem_file: RecordedFile | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        """Return one line per family, and the number of boundaries."""
        shown = "".join(f"\n  {family!r}" for family in self.families[:_MOST_NAMED])
        counts = f"families={len(self.families)}, boundaries={len(self.boundaries)}"
        return f"<Continuation: {counts}{shown}>"

    def _columns(self) -> Columns:
        """Return the orbits of all families, family by family."""
        return _orbits_of(self.families)

    def _shown_columns(self) -> Columns:
        """Return the named orbits."""
        return _named_of(self.families)

    def as_json(self) -> dict[str, Any]:
        """Return everything as the plain data of a family file, without `problem_file`."""
        main = self.families[0]
        return {
            "format": FORMAT,
            "problem": main.problem,
            "parameter": main.parameter,
            "gains": dict(main.gains),
            "parameters": dict(main.parameters),
            "families": [family.as_json() for family in self.families],
            "boundaries": [boundary.as_json() for boundary in self.boundaries],
            "versions": dict(self.versions),
            **({"problem_digest": list(self.problem_digest)} if self.problem_digest else {}),
        }


def _orbits_of(families: Sequence[Family]) -> Columns:
    """Return all orbits of families, in order along each."""
    rows: list[tuple[int, SpecialPoint | None, FamilyPoint]] = []
    for k, family in enumerate(families):
        named = {id(one.at): one for one in family.named}
        points = list(family.points)
        for one in reversed(family.named):
            if all(one.at is not point for point in points):
                points.insert(0 if one is family.first else one.index + 1, one.at)
        rows += [(k, named.get(id(point)), point) for point in points]
    return {
        "family": [k for k, _, _ in rows],
        "name": ["" if one is None else one.kind.value for _, one, _ in rows],
        families[0].parameter: [point.value for _, _, point in rows],
        "period": [point.period for _, _, point in rows],
        "stable": [(one or point).stable for _, one, point in rows],
        "spectral_radius": [point.spectral_radius for _, _, point in rows],
        **by_name([point.margins for _, _, point in rows]),
        **by_name([point.state for _, _, point in rows]),
    }


def _named_of(families: Sequence[Family]) -> Columns:
    """Return the named orbits of families."""
    named = [(k, one) for k, family in enumerate(families) for one in family.named]
    return {
        "family": [k for k, _ in named],
        "name": [one.kind.value for _, one in named],
        families[0].parameter: [one.at.value for _, one in named],
        "error": [one.error for _, one in named],
        "period": [one.at.period for _, one in named],
        "spectral_radius": [one.at.spectral_radius for _, one in named],
    }
