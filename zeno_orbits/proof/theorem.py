"""The theorem that a certificate proves: its boxes, its enclosures and its sentences.

`docs/proof.md` contains each sentence in the same words. Printed conclusions contain the proved
conclusions: intervals and discs are rounded outward, bounds upward. Printed hypotheses are
contained in the proved hypotheses: values and ranges are exact, and a box inside a box is rounded
inward.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from zeno_orbits.work import (
    decimal_above,
    decimal_between,
    enclosed_decimal,
    enclosing_decimal,
    enclosing_disc,
)

_NORM_DIGITS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class ProvedInterval:
    """An enclosed number.

    Attributes:
        low: Lower end, exactly.
        high: Upper end, exactly.
    """

    low: Fraction
    high: Fraction

    @property
    def text(self) -> str:
        """Decimal midpoint and radius of an interval that contains this interval."""
        return enclosing_decimal(self.low, self.high)

    @property
    def inner_text(self) -> str:
        """Decimal midpoint and radius of an interval that lies in this interval."""
        return enclosed_decimal(self.low, self.high)

    @property
    def width(self) -> float:
        """Width, rounded up."""
        return double_above(self.high - self.low)

    def holds(self, value: float) -> bool:
        """Return True if a number lies in the interval."""
        return self.low <= Fraction(value) <= self.high

    def misses(self, value: float) -> float:
        """Return the distance of a number from the interval, 0 for a number inside."""
        return float(max(Fraction(0), self.low - Fraction(value), Fraction(value) - self.high))

    def reaches(self, value: float) -> Fraction:
        """Return the largest distance of a number from any number of the interval."""
        return max(self.high - Fraction(value), Fraction(value) - self.low)


@dataclass(frozen=True, slots=True, kw_only=True)
class MultiplierDisc:
    """A disc of the complex plane. The union of all discs contains the multipliers.

    Attributes:
        centre: Centre of the disc.
        radius: Its radius.
    """

    centre: complex
    radius: float

    @property
    def text(self) -> str:
        """Decimal centre and radius of a disc that contains this disc."""
        parts = (self.centre.real, self.centre.imag, self.radius)
        return enclosing_disc(*(Fraction(part) for part in parts))


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Enclosures of a periodic orbit.

    Attributes:
        period: Period [s].
        zeno_times: Time of each Zeno point since the start [s].
        impact_times: Times of the individually resolved impacts since the start [s].
        start_state: State name to value at the start of the period.
        multipliers: Discs whose union contains all multipliers. Each disc that is separate from the
            others contains one multiplier.
        norm: Bound of the norm of the return map's derivative in the basis of the discs.
    """

    period: ProvedInterval
    zeno_times: tuple[ProvedInterval, ...]
    impact_times: tuple[ProvedInterval, ...]
    start_state: Mapping[str, ProvedInterval]
    multipliers: tuple[MultiplierDisc, ...]
    norm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionBox:
    """A set of releases: one full state for each value of the coordinates of the section.

    Over the same coordinates the section may have further states, which do not belong to the set.
    The intervals of the other states exclude these.

    Attributes:
        coordinates: Coordinate of the section to the interval of the box, empty if the section is a
            single point.
        others: Every other state to an interval that contains its values in the set.
        around: Other state to a larger interval: the set contains each release with its coordinates
            in the box and its other states in these intervals. States that every release shares are
            missing.
    """

    coordinates: Mapping[str, ProvedInterval]
    others: Mapping[str, ProvedInterval]
    around: Mapping[str, ProvedInterval]

    def lying(self) -> dict[str, str]:
        """Return for each state an interval that contains its values in the set, as text."""
        return {name: one.text for name, one in {**self.coordinates, **self.others}.items()}

    def contained(self) -> dict[str, str]:
        """Return intervals as text. The set contains each release whose states lie in them."""
        others = {
            name: decimal_between(one.low, one.high, self.around[name].low, self.around[name].high)
            for name, one in self.others.items()
            if name in self.around
        }
        return {name: one.inner_text for name, one in self.coordinates.items()} | others

    def lines(self, name: str, *, element: str = "release") -> list[str]:
        """Return the set as sentences.

        Args:
            name: Name of the set.
            element: Word for a state of the section.
        """
        point = [] if self.coordinates else [f"{name} is a single point of the section."]
        around, within = (_listed(one) for one in (self.lying(), self.contained()))
        contains = f"{name} contains each {element} with {within}." if within else ""
        return [*point, f"{name} lies in {around}.", *filter(None, [contains])]

    def as_json(self) -> dict[str, Any]:
        """Return the set as plain data."""
        lying, contained = self.lying(), self.contained()
        return {
            "coordinates": {name: lying[name] for name in self.coordinates},
            "contains": {name: contained[name] for name in self.coordinates},
            "others": {name: lying[name] for name in self.others},
            "others_contain": {name: contained[name] for name in self.around},
        }


def _listed(values: Mapping[str, str]) -> str:
    return ", ".join(f"{name} = {text}" for name, text in values.items())


@dataclass(frozen=True, slots=True, kw_only=True)
class ProvedBox(SectionBox):
    """A box of the release section with exactly one fixed point of the return map.

    Attributes:
        included: True if the return map maps the box into its interior, and so contracts it.
        norm: Bound of the norm of the return map's derivative on the box, in the basis of the
            certificate.
    """

    included: bool
    norm: float


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Proof:
    """Result of a proof that an orbit exists: a theorem with its certificate, or the failed claim.

    Attributes:
        problem: Name of the problem.
        claim: Name of the first claim that could not be proved, empty if all claims were proved.
        reason: Reason of the failure.
        boxes: The box of the theorem, then optionally a smaller box in it, from which enclosures
            and stability are taken.
        basin_box: Set of initial states that the return map maps into its interior. None unless
            `--basin` was given and the checker accepted the set.
        no_basin: Reason why `--basin` proved no set of initial states that is larger than box 1, or
            an empty text.
        attracted: True if every execution from this set is proved to converge to the orbit.
        values: Gain or parameter to value.
        over: Gain or parameter to the middle and radius of its interval.
        held: Derived parameters that depend on one of `over` by default, and keep their values.
        plastic: True if the restitution is zero, so that a single impact starts the contact.
        impacts: Number of impacts per return to the section of the states just after an impact, or
            0 for the section of releases.
        releases: Number of releases of the section's stop per return, or of passages of the
            section's switch.
        stop: Name of the section's stop, empty for a machine with one stop and no switch.
        switch: Name of the switch before which the period starts, empty for other sections.
        beside: Names of the stops that are closed on the section, except that of its release.
        events: Events of the period in order, for a machine with several stops, switches or kinks.
        stable: True if the fixed point of the return map is proved to be stable.
        repelling: True if a multiplier is proved to lie outside the unit circle.
        bounds: Enclosures of the orbit, None without a proof.
        certificate: Plain data for the complete check of the proof, empty without a proof.
        n_records: Number of inclusions in the certificate.
        wall_time: Time for the search of the proof [s].
        versions: Software that the prover uses.
    """

    problem: str
    claim: str = ""
    reason: str = ""
    boxes: tuple[ProvedBox, ...] = ()
    basin_box: SectionBox | None = None
    no_basin: str = ""
    attracted: bool = False
    values: Mapping[str, float]
    over: Mapping[str, tuple[float, float]]
    held: tuple[str, ...] = ()
    plastic: bool = False
    impacts: int = 0
    releases: int = 0
    stop: str = ""
    switch: str = ""
    beside: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    stable: bool = False
    repelling: bool = False
    bounds: Bounds | None = None
    certificate: Mapping[str, Any]
    n_records: int = 0
    wall_time: float
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        """Return one line: the verdict and the number of inclusions."""
        return f"<Proof of {self.problem}: {self.verdict()} inclusions={self.n_records}>"

    @property
    def proved(self) -> bool:
        """True if the orbit is proved to exist."""
        return not self.claim

    @property
    def basin(self) -> Mapping[str, ProvedInterval]:
        """Intervals of the coordinates of the set of initial states, empty without a set."""
        return self.basin_box.coordinates if self.basin_box else {}

    @property
    def box(self) -> dict[str, tuple[float, float]]:
        """Coordinate of the section to middle and radius of an interval that contains the box."""
        return {
            name: _middle_and_radius(one.low, one.high)
            for box in self.boxes[:1]
            for name, one in box.coordinates.items()
        }

    @property
    def initial_states(self) -> dict[str, float]:
        """Coordinate to the half-width of the largest set that the return map maps into itself.

        It is `basin`, or box 1 if the return map maps it into its interior. Half-widths are rounded
        down.
        """
        pairs = self.initial_box.coordinates.items() if self.initial_box else ()
        return {name: double_below((one.high - one.low) / 2) for name, one in pairs}

    @property
    def initial_box(self) -> SectionBox | None:
        """The largest set that the return map maps into itself, or None if no set is proved."""
        return self.basin_box or (self.boxes[0] if self.inside else None)

    @property
    def inside(self) -> bool:
        """True if the return map contracts the box into its interior.

        Then exactly one periodic orbit passes through the box.
        """
        return bool(self.boxes) and self.boxes[0].included

    def verdict(self) -> str:
        """Return the verdict as one sentence."""
        if not self.proved:
            return f"Not proved: `{self.claim}`: {self.reason}."
        how = ", which is exponentially stable" if self.stable else ""
        how = ", which is unstable" if self.repelling else how
        found = f"the return map of `{self.problem}` has exactly one fixed point in the box"
        return f"Proved by inclusions: {found}{how}."

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
        basin: dict[str, Any] = self.basin_box.as_json() if self.basin_box else {}
        return found | {
            "statements": self.statements(),
            "section": self._section,
            "box": {name: list(ends) for name, ends in self.box.items()},
            "boxes": [
                box.as_json() | {"inclusion": box.included, "norm": double_above(box.norm)}
                for box in self.boxes
            ],
            "parameters": dict(self.values),
            "over": {name: list(ends) for name, ends in self.over.items()},
            "basin": basin.get("coordinates", {}),
            "basin_contains": basin.get("contains", {}),
            "basin_others": basin.get("others", {}),
            "basin_others_contain": basin.get("others_contain", {}),
            "no_basin": self.no_basin,
            "attracted": self.attracted,
            "inside": self.inside,
            "stable": self.stable,
            "repelling": self.repelling,
            "events": list(self.events),
            "period": bounds.period.text,
            "zeno_times": [one.text for one in bounds.zeno_times],
            "start_state": {name: one.text for name, one in bounds.start_state.items()},
            "multipliers": [_disc_of_doubles(one) for one in bounds.multipliers],
            "norm": double_above(bounds.norm),
            "inclusions": self.n_records,
        }

    def lines(self) -> list[str]:
        """Return the theorem on one page, line by line."""
        if self.bounds is None:
            return [self.verdict()]
        returns = self.impacts or self.releases
        event = "impact" if self.impacts else "passage" if self.switch else "release"
        which = "the next" if returns == 1 else f"{event} {returns} after it"
        after = "just after " if self.impacts else "just before " if self.switch else ""
        lines = [
            f"Theorem. Problem `{self.problem}`. P is the return map, from {self._section} to"
            f" {after}{which}."
        ]
        lines += self._hypotheses()
        lines += self.statements()
        if not self.inside:
            lines.append(
                "Statement (4), about a single periodic orbit, is not proved: P was not shown to"
                " map box 1 into itself."
            )
        if self.no_basin:
            lines.append(f"No set of initial states is proved beyond box 1: {self.no_basin}.")
        lines += ["", "Enclosures, for the fixed point of P:"]
        lines.append(f"  period      {self.bounds.period.text} s")
        held = [one for one in self.events if one.startswith(("Zeno", "plastic"))]
        names = [one.rpartition(" o")[0] for one in held] or ["Zeno point"] * len(
            self.bounds.zeno_times
        )
        lines += [
            f"  {name:11s} {one.text} s"
            for name, one in zip(names, self.bounds.zeno_times, strict=True)
        ]
        lines += [f"  {name:<11} {one.text}" for name, one in self.bounds.start_state.items()]
        if self.bounds.multipliers:
            lines.append(
                "The multipliers lie in the union of the discs, one in each separate disc:"
            )
        lines += [f"  disc        {disc.text}" for disc in self.bounds.multipliers]
        known = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        widest = "the set of initial states" if self.basin_box else "box 1"
        lines += [
            "",
            f"Proof: {self.n_records} inclusions in ball arithmetic, found in"
            f" {self.wall_time:.0f} s.",
            f"Trusted: the formulas of the problem; {known}; this program.",
            f"Not claimed: motions that start outside {widest}; that the real machine has this"
            " orbit.",
        ]
        return lines

    def statements(self) -> list[str]:
        """Return the numbered statements, one per entry."""
        if self.bounds is None:
            return []
        first, last = self.boxes[0], len(self.boxes)
        into = " P maps box 1 into its interior." if first.included else ""
        found = [
            f"(1) {self._motion(len(self.bounds.zeno_times))}",
            f"(2) P is analytic on box 1.{into}",
            "(3) P has exactly one fixed point in box 1.",
        ]
        if last > 1:
            found[-1] += f" It lies in box {last}."
        if self.inside:
            found.append("(4) Exactly one periodic orbit passes through box 1.")
        if self.stable:
            found.append(
                f"(5) The fixed point of P is exponentially stable: {self._contraction()}."
            )
        elif self.repelling:
            where = "one multiplier lies outside the unit circle"
            found.append(f"(5) The fixed point of P is unstable ({where}).")
        if self.basin_box:
            to = " Every execution from it converges to the periodic orbit."
            found.append(
                "(6) P maps the set of initial states into its interior."
                + (to if self.attracted else "")
            )
        return found

    def _hypotheses(self) -> list[str]:
        values = ", ".join(f"{name} = {value!r}" for name, value in self.values.items())
        lines = [f"Values, each the double next to its decimal: {values}."]
        if self.over:
            ranges = ", ".join(f"{name} = {m!r} +- {r!r}" for name, (m, r) in self.over.items())
            lines.append(
                f"The statements hold for each {ranges}, with all other values held fixed."
            )
            lines.append(
                "Middles and radii of these ranges are the doubles next to their decimals."
            )
            if self.held:
                lines.append(f"Held fixed, though derived by default: {', '.join(self.held)}.")
        for number, box in enumerate(self.boxes, start=1):
            lines += box.lines(f"Box {number}", element=self._element)
        if self.basin_box:
            lines += self.basin_box.lines("The set of initial states")
        return lines

    @property
    def _section(self) -> str:
        if self.switch:
            return f"the state just before switch `{self.switch}`{self._contact}"
        at = f" of stop `{self.stop}`" if self.stop else ""
        found = f"the state just after an impact{at}" if self.impacts else f"a release{at}"
        return f"{found}{self._contact}"

    @property
    def _contact(self) -> str:
        closed = " and ".join(f"`{name}`" for name in self.beside)
        return f" in contact with {closed}" if closed else ""

    @property
    def _element(self) -> str:
        found = "state just after an impact" if self.impacts else "release"
        return f"{'state just before the switch' if self.switch else found}{self._contact}"

    def _contraction(self) -> str:
        """Return the reason of stability: a norm below 1, or the inclusion of box 1."""
        norm = Fraction(self.bounds.norm) if self.bounds else Fraction(1)
        if norm >= 1:
            return "P contracts box 1"
        told = decimal_above(norm, _NORM_DIGITS)
        where = f"on box {len(self.boxes)}"
        norm_in = "the norm of DP (largest row sum) in the basis of the certificate"
        return f"{where} {norm_in} is at most {told}"

    def _motion(self, n_phases: int) -> str:
        if self.events:
            returns = " It returns to just before the switch." if self.switch else ""
            return (
                "From every point of box 1 the completed execution has these events in turn, and"
                f" no others: {', '.join(self.events)}. Between them each closed stop is under"
                " pressure, and all other gaps are positive. The switches are crossed"
                f" transversally.{returns}"
            )
        if self.impacts:
            count = "one impact" if self.impacts == 1 else f"{self.impacts} impacts"
            return (
                f"From every point of box 1 the completed execution has {count}, transversal and"
                " with flights before and between them, and returns just after the last impact"
                " to the section."
            )
        impacts = (
            "has one impact, which is plastic"
            if self.plastic
            else "has infinitely many impacts that accumulate at a Zeno point"
        )
        times = f" This happens {n_phases} times in turn." if n_phases > 1 else ""
        return (
            "From every point of box 1 the completed execution leaves the stop at once,"
            f" {impacts}, stays in contact under pressure, and is released transversally on the"
            f" section.{times}"
        )


def double_above(x: Fraction | float) -> float:
    """Return a double whose printed decimal is an upper bound of a number."""
    found = float(x)
    while math.isfinite(found) and Fraction(repr(found)) < x:
        found = math.nextafter(found, math.inf)
    return found


def double_below(x: Fraction | float) -> float:
    """Return a double whose printed decimal is a lower bound of a number."""
    return -double_above(-Fraction(x))


def _middle_and_radius(low: Fraction, high: Fraction) -> tuple[float, float]:
    """Return doubles whose printed decimals are middle and radius of an enclosing interval."""
    middle = float((low + high) / 2)
    printed = Fraction(repr(middle))
    return middle, double_above(max(high - printed, printed - low))


def _disc_of_doubles(disc: MultiplierDisc) -> list[float]:
    """Return doubles whose printed decimals are centre and radius of an enclosing disc."""
    re, im = disc.centre.real, disc.centre.imag
    off = abs(Fraction(repr(re)) - Fraction(re)) + abs(Fraction(repr(im)) - Fraction(im))
    return [re, im, double_above(Fraction(disc.radius) + off)]
