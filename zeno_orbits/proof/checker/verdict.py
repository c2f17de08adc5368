"""Result of a check: the theorem with all its hypotheses, and its claims one by one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, NamedTuple

from zeno_orbits.work import enclosing_decimal, exact_decimal


class ClaimVerdict(NamedTuple):
    """One claim: its name, whether it was proved, the evidence or the reason, and its box.

    Boxes are numbered from 1. The box of the motion of a pass is the box in which the motion
    starts.
    """

    name: str
    ok: bool
    evidence: str
    box: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Theorem:
    """The theorem of a certificate. All numbers are exact.

    Attributes:
        problem: Name of the problem.
        digest: SHA-256 of the problem's formulas.
        parameters: Every gain and parameter.
        over: Radius of the range of each parameter that varies.
        section: Section at which the period starts.
        box: First box, to which the theorem refers: coordinate of the section to middle and radius.
        smaller: The other boxes, which lie in the first box.
        others: For each box, every other state to a decimal interval. The box is the set of all
            states of the section with their coordinates in the box and their other states in these
            intervals.
        followed: True if the motion from the first box is proved.
        releases: Number of releases per period.
        events: All events of a period in order, in words, for a machine with several stops,
            switches or kinks. Impacts that accumulate belong to their Zeno point.
        impacts: Number of individually proved impacts per period.
        zeno_points: Number of Zeno points and of plastic impacts that start contact, per period.
        plastic: True if every contact starts with a single plastic impact.
        inside: True if the return map takes the first box into its interior, by the mean value
            form. Then it contracts the box (see `ProofVerdict.conclusions`).
        basin: Set of initial states of the section, empty without one.
        basin_others: The other states of this set, as in `others`.
        attracted: True if the return map takes this set into the first box, which it contracts.
    """

    problem: str
    digest: str
    parameters: Mapping[str, float]
    over: Mapping[str, Fraction]
    section: str = ""
    box: Mapping[str, tuple[Fraction, Fraction]] = field(default_factory=dict[str, Any])
    smaller: tuple[Mapping[str, tuple[Fraction, Fraction]], ...] = ()
    releases: int = 0
    events: tuple[str, ...] = ()
    impacts: int = 0
    zeno_points: int = 0
    plastic: bool = False
    inside: bool = False
    others: tuple[Mapping[str, str], ...] = ()
    followed: bool = False
    basin: Mapping[str, tuple[Fraction, Fraction]] = field(default_factory=dict[str, Any])
    basin_others: Mapping[str, str] = field(default_factory=dict[str, str])
    attracted: bool = False

    @property
    def kind(self) -> str:
        """Kind of the periodic orbit."""
        if self.plastic:
            return "periodic orbit with plastic impacts"
        return "Zeno periodic orbit" if self.zeno_points else "periodic orbit without a Zeno point"

    def hypotheses(self) -> list[str]:
        """Return the hypotheses, line by line."""
        numbers = ", ".join(f"{name} = {value!r}" for name, value in self.parameters.items())
        ranges = [
            f"{name} = (the double nearest to {self.parameters[name]!r}) +- {_exact(radius)}"
            for name, radius in self.over.items()
        ]
        struck = sum(one.startswith("plastic ") for one in self.events)
        held = "plastic contact" if self.plastic else "Zeno point"
        impacts = f"{_counted(self.impacts, 'impact')} proved one by one"
        points = _counted(self.zeno_points, held)
        if struck and not self.plastic:
            points = f"{_counted(self.zeno_points - struck, held)}"
            points += f", {_counted(struck, 'plastic contact')}"
        events = f"{impacts}, {points}, {_counted(self.releases, 'release')}"
        basin = "Set of initial states in the section"
        boxes = zip((self.box, *self.smaller), self.others, strict=True)
        return [
            f"Problem `{self.problem}`, formulas {self.digest}.",
            f"Parameters, the doubles nearest to: {numbers}.",
            *([f"Parameters that vary: {', '.join(ranges)}."] if ranges else []),
            f"Section: {self.section}.",
            *(f"Box {k} of the section: {_shown(*box)}." for k, box in enumerate(boxes, start=1)),
            *([f"{basin}: {_shown(self.basin, self.basin_others)}."] if self.basin else []),
            *([f"In a period: {events}."] if self.followed else []),
            *([f"Events in order: {', '.join(self.events)}."] if self.events else []),
        ]

    def as_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        motion: dict[str, Any] = {
            "kind": self.kind,
            "releases": self.releases,
            "impacts_one_by_one": self.impacts,
            "zeno_points": self.zeno_points,
            "plastic": self.plastic,
            "events": list(self.events),
        }
        return {
            "problem": self.problem,
            "digest": self.digest,
            "parameters": dict(self.parameters),
            "over": {name: _exact(radius) for name, radius in self.over.items()},
            "section": self.section,
            "box": _ends(self.box),
            "smaller_boxes": [_ends(box) for box in self.smaller],
            "other_states": [dict(one) for one in self.others],
            "basin": _ends(self.basin),
            "basin_other_states": dict(self.basin_others),
            "attracted": self.attracted,
            **(motion if self.followed else {}),
        }


def _ends(box: Mapping[str, tuple[Fraction, Fraction]]) -> dict[str, list[str]]:
    """Return middle and radius of each coordinate of a box, exactly."""
    return {name: [_exact(m), _exact(r)] for name, (m, r) in box.items()}


def _shown(box: Mapping[str, tuple[Fraction, Fraction]], others: Mapping[str, str]) -> str:
    """Return a box as exact numbers, and decimals that contain it, with its other states."""
    shown = [
        f"{name} = {_exact(m)} +- {_exact(r)} (within {enclosing_decimal(m - r, m + r)})"
        for name, (m, r) in box.items()
    ]
    beside = ", ".join(f"{name} = {text}" for name, text in others.items())
    return f"{', '.join(shown) or 'a single point'}; other states: {beside or 'none'}"


_LONGEST = 40
"""Largest number of characters of a printed decimal."""


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _exact(x: Fraction) -> str:
    """Return a binary fraction exactly: in decimals if they are short, otherwise in hexadecimal."""
    text = exact_decimal(x)
    if len(text) <= _LONGEST:
        return text
    sign, power = "-" if x < 0 else "", x.denominator.bit_length() - 1
    return f"{sign}{abs(x.numerator):#x}p-{power}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ProofVerdict:
    """Result of a check, claim by claim."""

    theorem: Theorem
    claims: tuple[ClaimVerdict, ...]

    @property
    def problem(self) -> str:
        """Name of the problem."""
        return self.theorem.problem

    @property
    def ok(self) -> bool:
        """True if every claim was proved, including the existence of an orbit."""
        return all(claim.ok for claim in self.claims) and any(
            claim.name == "exists" for claim in self.claims
        )

    @property
    def _known(self) -> dict[str, str]:
        """Proved results by the claim's name, from the smallest box if a name is repeated."""
        claims = sorted((claim for claim in self.claims if claim.ok), key=lambda one: one.box)
        return {claim.name: claim.evidence for claim in claims}

    def verdict(self) -> str:
        """Return the verdict as one sentence."""
        failed = next((claim for claim in self.claims if not claim.ok), None)
        if failed is not None:
            return f"Not proved: `{failed.name}`: {failed.evidence}."
        if not self.ok:
            return "Not proved: no claim states that an orbit exists."
        period = f"; period {self._known['period']} s" if "period" in self._known else ""
        what = f"a {self.theorem.kind} of `{self.problem}`"
        if self.theorem.over:
            each = f"for each value of {', '.join(self.theorem.over)} there is {what}"
            return f"Proved: {each}{period}."
        return f"Proved: {what} exists{period}."

    def conclusions(self) -> list[str]:
        """Return the conclusions, line by line, or an empty list unless every claim is proved.

        Inclusion in the mean value form shows more than a fixed point. With ``c`` the centre, ``r``
        the radii and ``[J]`` the derivatives over the box, it reads ``|P(c) - c| + |[J]| r < r``,
        row by row. So ``|[J]| r < r``: in the maximum norm weighted by the radii, the norm of each
        derivative is below 1. The return map contracts the box. So exactly one fixed point exists,
        all iterates of the return map from the box converge to it, no other periodic orbit passes
        through the box, and the fixed point is exponentially stable. A section without coordinates
        is a single point, for which all of these conclusions hold as well.
        """
        if not self.ok:
            return []
        known, lines, inside = self._known, [self.verdict()], self.theorem.inside
        if "unique" in known or inside:
            lines.append("The return map has exactly one fixed point in box 1.")
        if inside:
            lines.append("The return map takes box 1 into its interior and contracts it in the")
            lines[-1] += " maximum norm weighted by its radii: exactly one periodic orbit passes"
            lines[-1] += " through box 1."
        if "stable" in known or inside:
            lines.append("The fixed point of the return map is exponentially stable.")
        if "stable" in known:
            lines.append(f"{known['stable']}.")
        if "multipliers" in known:
            lines.append(f"{known['multipliers']}.")
        if "repelling" in known:
            lines.append("The fixed point of the return map is unstable: one multiplier lies")
            lines[-1] += f" outside the unit circle, in the disc {known['repelling']}."
        if "basin" in known:
            lines.append("The return map takes the set of initial states into its interior.")
        if self.theorem.attracted:
            lines.append("Every execution from the set converges to the periodic orbit.")
        return lines

    def lines(self) -> list[str]:
        """Return the theorem, line by line."""
        return [*self.theorem.hypotheses(), *(self.conclusions() or [self.verdict()])]

    def as_json(self) -> dict[str, Any]:
        """Return the verdict as plain data."""
        claims = [claim._asdict() for claim in self.claims]
        return {**self.theorem.as_json(), "statement": self.conclusions(), "claims": claims}
