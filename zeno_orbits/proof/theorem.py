"""What a proof says: the bounds, and the theorem on one page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flint import ctx

from zeno_orbits.proof.balls import Ball, size

_BITS = 256
"""Length of numbers here: enough for the ends of an enclosure."""
_DIGITS = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class ProvedInterval:
    """A number that is enclosed.

    Attributes:
        low: Exact lower end, a ball of radius zero.
        high: Exact upper end.
    """

    low: Ball
    high: Ball

    @property
    def text(self) -> str:
        """Midpoint to the digits that are certain, and the half width."""
        with ctx.workprec(_BITS):
            return self.low.union(self.high).str(_DIGITS)

    @property
    def width(self) -> float:
        """Width, rounded up."""
        with ctx.workprec(_BITS):
            return size(self.high - self.low)

    def holds(self, value: float) -> bool:
        """Return True if a number lies in it."""
        return bool(self.low <= value) and bool(self.high >= value)

    def misses(self, value: float) -> float:
        """Return how far a number is outside; 0 inside."""
        with ctx.workprec(_BITS):
            return max(0.0, float(self.low - value), float(value - self.high))


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiplierDisc:
    """A disc of the complex plane that holds a multiplier.

    Attributes:
        centre: Its middle.
        radius: Its radius.
    """

    centre: complex
    radius: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """What is enclosed of a periodic orbit.

    Attributes:
        period: [s].
        zeno_times: Of each Zeno point, since the start [s].
        impact_times: Of the impacts that were resolved one by one, since the start [s].
        start_state: State name to value where the period starts.
        multipliers: Discs; those apart from the others hold one multiplier each.
        norm: Bound of the norm of the return map's derivative in the basis of the discs.
    """

    period: ProvedInterval
    zeno_times: tuple[ProvedInterval, ...]
    impact_times: tuple[ProvedInterval, ...]
    start_state: Mapping[str, ProvedInterval]
    multipliers: tuple[MultiplierDisc, ...]
    norm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Proof:
    """The answer to whether an orbit exists: a theorem with its certificate, or why there is none.

    Attributes:
        problem: Name of the problem.
        claim: Name of the first claim that could not be proved; empty if all were.
        reason: Why not.
        box: Coordinate of the section to its middle and radius.
        over: Gain or parameter to the middle and radius of its interval.
        plastic: Whether the stop takes all speed, so that a single impact holds.
        inside: Whether the return map takes the box into itself.
        stable: Whether the orbit is proved to attract.
        repelling: Whether a multiplier is proved to lie outside the unit circle.
        bounds: What is enclosed; None without a proof.
        certificate: Plain data from which everything can be checked; empty without a proof.
        n_records: Inclusions in it.
        wall_time: What it took [s].
        versions: What the prover stands on.
    """

    problem: str
    claim: str = ""
    reason: str = ""
    box: Mapping[str, tuple[float, float]]
    over: Mapping[str, tuple[float, float]]
    plastic: bool = False
    inside: bool = False
    stable: bool = False
    repelling: bool = False
    bounds: Bounds | None = None
    certificate: Mapping[str, Any]
    n_records: int = 0
    wall_time: float
    versions: Mapping[str, str]

    @property
    def proved(self) -> bool:
        """True if the orbit is proved to exist."""
        return not self.claim

    def verdict(self) -> str:
        """Return one sentence."""
        if not self.proved:
            return f"Not proved: `{self.claim}`: {self.reason}."
        return f"Proved by inclusions: {self._kind()} of `{self.problem}` exists."

    def as_json(self) -> dict[str, Any]:
        """Return the theorem as plain data, without its certificate."""
        found: dict[str, Any] = {
            "proved": self.proved,
            "problem": self.problem,
            "claim": self.claim,
            "reason": self.reason,
            "wall_time": self.wall_time,
            "versions": dict(self.versions),
        }
        if self.bounds is None:
            return found
        bounds = self.bounds
        return found | {
            "box": {name: list(ends) for name, ends in self.box.items()},
            "over": {name: list(ends) for name, ends in self.over.items()},
            "inside": self.inside,
            "stable": self.stable,
            "repelling": self.repelling,
            "period": bounds.period.text,
            "zeno_times": [one.text for one in bounds.zeno_times],
            "start_state": {name: one.text for name, one in bounds.start_state.items()},
            "multipliers": [
                [one.centre.real, one.centre.imag, one.radius] for one in bounds.multipliers
            ],
            "norm": bounds.norm,
            "inclusions": self.n_records,
        }

    def _kind(self) -> str:
        kind = "a stable" if self.stable else "a repelling" if self.repelling else "a"
        return f"{kind} Zeno periodic orbit"

    def lines(self) -> list[str]:
        """Return the theorem on one page, line by line."""
        if self.bounds is None:
            return [self.verdict()]
        lines = [f"Theorem. Problem `{self.problem}`, its parameters exactly the stored doubles."]
        if self.over:
            ranges = ", ".join(f"{name} in {m!r} +- {r:g}" for name, (m, r) in self.over.items())
            lines.append(f"For every value of {ranges} at once:")
        lines += self._statement(self.bounds)
        lines += ["", "Enclosed:"]
        lines.append(f"  period      {self.bounds.period.text} s")
        lines += [f"  Zeno point  {one.text} s" for one in self.bounds.zeno_times]
        lines += [f"  {name:<11} {one.text}" for name, one in self.bounds.start_state.items()]
        for disc in self.bounds.multipliers:
            middle = f"{disc.centre.real:.10g}"
            if disc.centre.imag:
                middle += f" {disc.centre.imag:+.10g}i"
            lines.append(f"  multiplier  {middle} +- {disc.radius:.1e}")
        known = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        lines += [
            "",
            f"Proof: {self.n_records} inclusions in balls, found in {self.wall_time:.0f} s.",
            f"Trusted: the problem's CasADi expressions; {known}; this program.",
            "Not claimed: anything of motions outside the box, or of the machine itself.",
        ]
        return lines

    def _statement(self, bounds: Bounds) -> list[str]:
        places = ", ".join(f"{name} = {m:.10g} +- {r:.1e}" for name, (m, r) in self.box.items())
        points = len(bounds.zeno_times)
        again = "" if points == 1 else f"; so {points} times, the last time on the section"
        strikes = "once, plastically," if self.plastic else "infinitely often up to a Zeno point,"
        lines = [
            f"(1) From every point of the release section with {places}"
            if places
            else "(1) From the release section, here a single point,",
            f"    the motion leaves the stop, strikes it {strikes} is held by it and",
            f"    released{again}. In between it touches nothing.",
        ]
        if not self.box:
            return [*lines, "(2) The motion returns to that point: it is periodic."]
        onto = "takes the box into its interior" if self.inside else "need not stay in the box"
        lines.append(f"(2) The return map is analytic on the box, and {onto}.")
        lines.append("(3) Exactly one periodic orbit passes through the box.")
        if self.stable:
            norm = f"{bounds.norm:.6g}"
            lines.append(f"(4) It is exponentially stable: norm of the map's derivative {norm}.")
        elif self.repelling:
            lines.append("(4) It repels: a multiplier lies outside the unit circle.")
        return lines
