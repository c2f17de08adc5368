"""Result of the check of a branch: its ranges, their connections and the proved sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import groupby
from typing import Any, NamedTuple

from zeno_orbits.work import exact_decimal

_LONGEST = 24
"""Largest number of characters of an exact decimal."""
_STABILITY = {1: "exponentially stable", -1: "unstable"}


class CheckedRange(NamedTuple):
    """A range after its check. The ends are integers, in units of the certificate.

    Attributes:
        low: Lower end.
        high: Upper end.
        failure: The first claim that does not hold, with its reason, or an empty text.
        stability: 1 for stable and -1 for unstable fixed points, 0 if neither is proved.
        inside: True if the return map contracts the box.
        kind: Numbers of releases, of Zeno points, and True for plastic impacts.
        told: Events in order, for a machine with several stops, switches or kinks.
    """

    low: int
    high: int
    failure: str
    stability: int
    inside: bool
    kind: tuple[int, int, bool]
    told: tuple[str, ...]

    @classmethod
    def of(cls, found: Mapping[str, Any], low: int, high: int) -> CheckedRange:
        """Return a range from the result of a worker."""
        claims: Sequence[tuple[str, bool, str]] = [tuple(one) for one in found["claims"]]
        failure = next((f"`{name}`: {why}" for name, ok, why in claims if not ok), "")
        known = {name for name, ok, _ in claims if ok}
        inside = bool(found.get("inside", False))
        stability = 1 if "stable" in known or inside else -1 if "repelling" in known else 0
        events: Sequence[Any] = found["events"] or [0, 0, 0, 0, False, []]
        kind = int(events[2]), int(events[3]), bool(events[4])
        return cls(low, high, failure, stability, inside, kind, tuple(events[5]))


@dataclass(frozen=True, slots=True, kw_only=True)
class BranchTheorem:
    """Hypotheses of the theorem of a branch.

    Attributes:
        problem: Name of the problem.
        digest: SHA-256 of the problem's formulas.
        parameters: Every other gain and parameter.
        name: The gain or parameter of the branch.
        section: Section at which the periods start.
    """

    problem: str
    digest: str
    parameters: Mapping[str, float]
    name: str
    section: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BranchVerdict:
    """Result of a check of a branch.

    Attributes:
        theorem: Its hypotheses.
        ranges: The ranges in order.
        gap: Where two neighbouring ranges are not connected, or an empty text.
        bits: Unit of the ends of the ranges.
        unchecked: True if the ranges leave a gap, so that none of them was checked.
    """

    theorem: BranchTheorem
    ranges: tuple[CheckedRange, ...]
    gap: str
    bits: int
    unchecked: bool = False

    @property
    def ok(self) -> bool:
        """True if each range is proved and all are connected."""
        return not self.gap and not any(one.failure for one in self.ranges)

    @property
    def problem(self) -> str:
        """Name of the problem."""
        return self.theorem.problem

    @property
    def interval(self) -> str:
        """The interval of the parameter, as text."""
        ends = self._end(self.ranges[0].low), self._end(self.ranges[-1].high)
        return f"{self.theorem.name} from {ends[0]} to {ends[1]}"

    def verdict(self) -> str:
        """Return the verdict as one sentence."""
        for k, one in enumerate(self.ranges):
            if one.failure and not self.unchecked:
                return f"Not proved: range {k + 1}: {one.failure}."
        if self.gap:
            return f"Not proved: {self.gap}."
        return (
            f"Proved: for each {self.interval} there is a {self._kind} of `{self.problem}`, and its"
            f" fixed points of the return map form one curve that is analytic in"
            f" {self.theorem.name}."
        )

    def hypotheses(self) -> list[str]:
        """Return the hypotheses, line by line."""
        one = self.theorem
        numbers = ", ".join(f"{name} = {value!r}" for name, value in one.parameters.items())
        return [
            f"Problem `{one.problem}`, formulas {one.digest}.",
            f"Other parameters, the doubles nearest to: {numbers}.",
            f"Section: {one.section}.",
            f"Ranges: {len(self.ranges)}, for {self.interval}.",
        ]

    def conclusions(self) -> list[str]:
        """Return the conclusions, line by line, or an empty list unless every claim is proved."""
        if not self.ok:
            return []
        lines = [self.verdict()]
        name = self.theorem.name
        lines.append(f"For each {name} of a range, its box holds exactly one of these points.")
        if all(one.inside for one in self.ranges):
            lines.append("The return map contracts each box: one periodic orbit passes through it.")
        for sign, group in groupby(self.ranges, key=lambda one: one.stability):
            part = list(group)
            ends = f"{self._end(part[0].low)} to {self._end(part[-1].high)}"
            if sign:
                told = f"The fixed point is {_STABILITY[sign]} for {name} from {ends}."
            else:
                told = f"No stability is claimed for {name} from {ends}."
            lines.append(told)
        if self.ranges[0].told:
            lines.append(f"Events in order: {', '.join(self.ranges[0].told)}.")
        return lines

    def lines(self) -> list[str]:
        """Return the theorem, line by line."""
        return [*self.hypotheses(), *(self.conclusions() or [self.verdict()])]

    def as_json(self) -> dict[str, Any]:
        """Return the verdict as plain data."""
        one = self.theorem
        return {
            "problem": one.problem,
            "digest": one.digest,
            "parameters": dict(one.parameters),
            "branch": one.name,
            "low": self._end(self.ranges[0].low),
            "high": self._end(self.ranges[-1].high),
            "section": one.section,
            "statement": self.conclusions(),
            "verdict": self.verdict(),
            "ranges": [
                {
                    "low": self._end(part.low),
                    "high": self._end(part.high),
                    "ok": not part.failure,
                    "evidence": part.failure,
                    "stability": part.stability,
                }
                for part in self.ranges
            ],
            "connected": not self.gap,
        }

    @property
    def _kind(self) -> str:
        _, points, plastic = self.ranges[0].kind
        if plastic:
            return "periodic orbit with plastic impacts"
        return "Zeno periodic orbit" if points else "periodic orbit without a Zeno point"

    def _end(self, m: int) -> str:
        return end_text(Fraction(m, 1 << self.bits))


def end_text(x: Fraction) -> str:
    """Return an end of a range exactly: a short decimal, a double by its name, or hexadecimal."""
    text, nearest = exact_decimal(x), float(x)
    if len(text) <= _LONGEST:
        return text
    if Fraction(nearest) == x:
        return f"(the double {nearest!r})"
    power = x.denominator.bit_length() - 1
    return f"{'-' if x < 0 else ''}{abs(x.numerator):#x}p-{power}"
