"""The theorem of a proved branch: its ranges, its ends and its sentences (`docs/proof.md`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import groupby
from typing import Any

from zeno_orbits.proof.checker.branch_verdict import end_text
from zeno_orbits.proof.theorem import Proof

_STABILITY = {1: "exponentially stable", -1: "unstable", 0: "of undecided stability"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ProvedRange:
    """A range of a proved branch.

    Attributes:
        low: Lower end of the parameter, exactly.
        high: Upper end.
        stability: 1 for stable and -1 for unstable fixed points, 0 if neither is proved.
        n_records: Number of inclusions.
    """

    low: Fraction
    high: Fraction
    stability: int
    n_records: int


@dataclass(frozen=True, slots=True, kw_only=True)
class BranchEnd:
    """An end of a proved branch.

    Attributes:
        value: Value of the parameter, exactly.
        reason: Reason why the proof does not continue, empty at the end of the interval.
        near: Kind and value of the nearest special point of a continuation, which is not proved.
    """

    value: Fraction
    reason: str = ""
    near: tuple[str, float] | None = None

    def sentence(self, name: str) -> str:
        """Return the end as a sentence."""
        told = f"The proof ends at {name} = {end_text(self.value)}: {self.reason}."
        if self.near is None:
            return told
        kind, value = self.near
        return f"{told} Near it, by continuation and without proof: {kind} at {value:.10g}."


@dataclass(frozen=True, slots=True, kw_only=True)
class BranchEstimate:
    """Estimate of the work, from the first ranges.

    Attributes:
        ranges: Number of ranges.
        seconds: Processor time [s].
    """

    ranges: int
    seconds: float

    def sentence(self, workers: int) -> str:
        """Return the estimate as a sentence.

        Args:
            workers: Number of processes.
        """
        minutes = self.seconds / workers / 60
        return (
            f"Estimate: {self.ranges} ranges, {minutes:.2g} minutes in {workers} processes"
            f" ({self.seconds:.3g} s of processor time)."
        )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class BranchProof:
    """Result of a proof of a branch: a theorem with its certificate, or the failed claim.

    Attributes:
        problem: Name of the problem.
        name: The gain or parameter.
        asked: Ends of the requested interval.
        claim: Name of the claim that could not be proved at the orbit, empty otherwise.
        reason: Reason of the failure.
        here: Proof of the orbit at its own value of the parameter.
        ranges: The ranges, from the lowest value to the highest. Neighbours share a value.
        ends: The lower and the upper end of the branch.
        held: Derived parameters that depend on the parameter by default, and keep their values.
        certificate: Plain data for the complete check of the proof, empty without a proof.
        wall_time: Time for the search of the proof [s].
        versions: Software that the prover uses.
    """

    problem: str
    name: str
    asked: tuple[float, float]
    claim: str = ""
    reason: str = ""
    here: Proof | None = None
    ranges: tuple[ProvedRange, ...] = ()
    ends: tuple[BranchEnd, BranchEnd] = (
        BranchEnd(value=Fraction(0)),
        BranchEnd(value=Fraction(0)),
    )
    held: tuple[str, ...] = ()
    certificate: Mapping[str, Any]
    wall_time: float = 0.0
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        """Return one line: the verdict and the number of ranges."""
        return f"<BranchProof of {self.problem}: {self.verdict()} ranges={len(self.ranges)}>"

    @property
    def proved(self) -> bool:
        """True if the branch is proved over some interval."""
        return not self.claim

    @property
    def low(self) -> Fraction:
        """Lower end of the proved interval: the requested end, if it is reached."""
        return max(self.ranges[0].low, Fraction(self.asked[0]))

    @property
    def high(self) -> Fraction:
        """Upper end of the proved interval: the requested end, if it is reached."""
        return min(self.ranges[-1].high, Fraction(self.asked[1]))

    @property
    def complete(self) -> bool:
        """True if the branch is proved over the whole interval."""
        ends = Fraction(self.asked[0]), Fraction(self.asked[1])
        return self.proved and (self.low, self.high) == ends

    @property
    def n_records(self) -> int:
        """Number of inclusions in the certificate."""
        return sum(one.n_records for one in self.ranges)

    def with_special_points(self, points: Sequence[tuple[str, float]]) -> BranchProof:
        """Return the proof with the nearest special point next to each early end.

        Args:
            points: Kind and value of the special points of a continuation.
        """

        def named(end: BranchEnd) -> BranchEnd:
            near = min(points, key=lambda one: abs(one[1] - float(end.value)), default=None)
            return replace(end, near=near) if end.reason else end

        low, high = self.ends
        return replace(self, ends=(named(low), named(high)))

    def verdict(self) -> str:
        """Return the verdict as one sentence."""
        if not self.proved:
            return f"Not proved: `{self.claim}`: {self.reason}."
        what = f"the return map of `{self.problem}` has a curve of fixed points"
        return f"Proved by inclusions: {what}, {self._interval}."

    def statements(self) -> list[str]:
        """Return the numbered statements, one per entry."""
        if self.here is None or not self.ranges:
            return []
        motion = self.here.statements()[0].removeprefix("(1) From every point of box 1 ")
        parts = stable_parts(self.ranges, self.low, self.high)
        signs = [0, *(sign for sign, _, _ in parts), 0]
        changes = [
            a * b < 0 and not sign for a, sign, b in zip(signs, signs[1:], signs[2:], strict=False)
        ]
        return [
            f"(1) For each value of {self.name} in a range, from every point of its box {motion}",
            "(2) P is analytic on each box, together with its range.",
            f"(3) For each value of {self.name} in a range, P has exactly one fixed point in its"
            " box.",
            f"(4) These fixed points form one curve that is analytic in {self.name},"
            f" {self._interval}.",
            *(
                f"(5) The fixed point is {_STABILITY[sign]} for {self.name} from {a} to {b}."
                + " Its stability changes there." * change
                for (sign, a, b), change in zip(parts, changes, strict=True)
            ),
        ]

    def lines(self) -> list[str]:
        """Return the theorem, line by line."""
        if self.here is None or not self.ranges:
            return [self.verdict()]
        values = ", ".join(
            f"{name} = {value!r}" for name, value in self.here.values.items() if name != self.name
        )
        widths = [float(one.high - one.low) for one in self.ranges]
        lines = [
            f"Theorem. Problem `{self.problem}`, {self._interval}. P is the return map.",
            f"Values, each the double next to its decimal: {values}.",
        ]
        if self.held:
            lines.append(f"Held fixed, though derived by default: {', '.join(self.held)}.")
        count = f"{len(self.ranges)} ranges of widths {min(widths):.3g} to {max(widths):.3g}"
        lines.append(f"The certificate has {count}, each with a box of the section.")
        lines += self.statements()
        lines += [end.sentence(self.name) for end in self.ends if end.reason]
        known = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        return [
            *lines,
            "",
            f"Proof: {self.n_records} inclusions in ball arithmetic, found in"
            f" {self.wall_time:.0f} s.",
            f"Trusted: the formulas of the problem; {known}; this program.",
        ]

    def as_json(self) -> dict[str, Any]:
        """Return the theorem as plain data, without its certificate."""
        found: dict[str, Any] = {
            "proved": self.proved,
            "complete": self.complete if self.ranges else False,
            "problem": self.problem,
            "branch": {"name": self.name, "low": self.asked[0], "high": self.asked[1]},
            "claim": self.claim,
            "reason": self.reason,
            "wall_time": self.wall_time,
            "versions": dict(self.versions),
        }
        if self.here is None or not self.ranges:
            return found
        return found | {
            "statements": self.statements(),
            "low": end_text(self.low),
            "high": end_text(self.high),
            "ends": [end.sentence(self.name) if end.reason else "" for end in self.ends],
            "parameters": {n: x for n, x in self.here.values.items() if n != self.name},
            "ranges": [
                {"low": end_text(one.low), "high": end_text(one.high), "stability": one.stability}
                for one in self.ranges
            ],
            "inclusions": self.n_records,
        }

    @property
    def _interval(self) -> str:
        return f"for {self.name} from {end_text(self.low)} to {end_text(self.high)}"


def stable_parts(
    ranges: Sequence[Any], low: Fraction, high: Fraction
) -> list[tuple[int, str, str]]:
    """Return the parts of a branch with one stability: its sign, and both ends as text.

    Args:
        ranges: The ranges in order.
        low: Lower end of the branch.
        high: Upper end.
    """
    found = list[tuple[int, str, str]]()
    for sign, group in groupby(ranges, key=lambda one: one.stability):
        part = list(group)
        ends = max(low, part[0].low), min(high, part[-1].high)
        found.append((sign, end_text(ends[0]), end_text(ends[1])))
    return found
