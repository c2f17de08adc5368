"""Contacts of a recording, sequence by sequence, next to the sequences of an orbit of events."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.contact_edges import (
    Edge,
    SeenSequence,
    is_coarse,
    mean_of,
    period_of_edges,
    seen_contacts,
    seen_sequences,
)
from zeno_orbits.experiment.comparison.estimate import UNKNOWN, Estimate
from zeno_orbits.experiment.comparison.metrics import Metric, metric
from zeno_orbits.experiment.orbit_table import PeriodTable
from zeno_orbits.experiment.sequences import OrbitSequence, bounce_and_flight, longest_flight

_ALIKE = 2.0
"""Samples by which a flight and a contact may differ, so that sampling decides what is seen."""
_DOUBLED = 4.0
"""Standard errors beyond the sampling from which every other cycle differs."""
_PHASE = 0.01
"""Deviation of a first contact from its mean phase, in periods, with which contacts repeat."""
_SHARE = 0.25
"""Part of the orbit's contact phase that a lasting contact lasts at least."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stop:
    """The contacts of a stop in a recording and in the orbit.

    Attributes:
        name: Name of the stop.
        orbit: The orbit's sequences.
        seen: The recorded sequences that are whole, for each of the orbit's sequences.
        cycles: Number of the cycle of each.
        others: Number of recorded sequences that fit none of the orbit's.
        n_contacts: Number of contacts in the recording.
        coarse: Why its samples may miss contacts, or no text. Contacts of a stop at which impacts
            accumulate are judged sequence by sequence.
        lasts: Usual duration of a contact [s].
    """

    name: str
    orbit: tuple[OrbitSequence, ...]
    seen: tuple[tuple[SeenSequence, ...], ...]
    cycles: tuple[tuple[int, ...], ...]
    others: int
    n_contacts: int
    coarse: str = ""
    lasts: float = 0.0

    @property
    def silence(self) -> str:
        """The reason against the orbit if no contact is recorded, else no text."""
        return "" if self.n_contacts or self.coarse else f"the contact `{self.name}` never closes"

    def labels(self) -> list[str]:
        """Return the names of its sequences."""
        if len(self.orbit) == 1:
            return [self.name]
        return [f"{self.name} {k}" for k in range(1, len(self.orbit) + 1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenEvents:
    """The contacts of all stops in a recording.

    Attributes:
        stops: The stops with a channel.
        step: Time between two samples [s].
        orbit_period: Period of the orbit [s].
        period: Period by the edges.
        span: Duration of the recording [s].
    """

    stops: tuple[_Stop, ...]
    step: float
    orbit_period: float
    period: Estimate
    span: float

    @classmethod
    def of(
        cls,
        time: Vector,
        channels: Mapping[str, Vector],
        struck: Mapping[str, tuple[OrbitSequence, ...]],
        orbit_period: float,
        period: float,
    ) -> SeenEvents:
        """Return the contacts of the channels of stops that the orbit strikes."""
        step = float(np.median(np.diff(time)))
        stops = tuple(
            _stop(time, channels[name], name, sequences, orbit_period, period, step)
            for name, sequences in struck.items()
            if name in channels
        )
        series: list[list[Edge]] = []
        cycles: list[tuple[int, ...]] = []
        for stop in stops:
            parts = zip(stop.orbit, stop.seen, stop.cycles, strict=True)
            for sequence, found, numbers in parts:
                if stop.coarse or not _is_told(sequence, found):
                    continue
                series += [[one.begins[0] for one in found], [one.release for one in found]]
                cycles += [numbers, numbers]
        return cls(
            stops=stops,
            step=step,
            orbit_period=orbit_period,
            period=period_of_edges(series, cycles),
            span=float(time[-1] - time[0]),
        )

    @property
    def repeats(self) -> bool:
        """True if every sequence begins at one phase of the period, but for the sampling."""
        if not self.period.known or any(stop.others for stop in self.stops):
            return False
        most = self.step + _PHASE * self.period.value
        sequences = [
            np.array([one.begins[0].middle for one in found])
            - np.array(numbers) * self.period.value
            for stop in self.stops
            for found, numbers in zip(stop.seen, stop.cycles, strict=True)
        ]
        return bool(sequences) and all(len(x) > 2 and np.std(x) < most for x in sequences)

    def offset(self, start: float, period: float) -> Estimate:
        """Return the mean delay of first impacts against a start of the orbit's period."""
        late = [
            (one.begins[0].middle - start - sequence.impacts[0] + period / 2) % period - period / 2
            for stop in self.stops
            for sequence, found in zip(stop.orbit, stop.seen, strict=True)
            for one in found
        ]
        if not late:
            return Estimate(value=0.0, error=math.inf)
        spread = float(np.std(late)) if len(late) > 1 else period
        return Estimate(value=float(np.mean(late)), error=spread)

    def findings(self, *, partly: bool = False) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the reasons against such an orbit, and those why the samples do not decide.

        Args:
            partly: Whether the first bounce of a sequence is enough. By default every bounce must
                be resolved.
        """
        reasons: list[str] = []
        unresolved: list[str] = []
        for stop in self.stops:
            if stop.coarse:
                unresolved.append(stop.coarse)
                continue
            parts = zip(stop.labels(), stop.orbit, stop.seen, stop.cycles, strict=True)
            for label, sequence, found, numbers in parts:
                against, open_ = self._finding(stop, label, sequence, found, partly)
                reasons += against
                unresolved += open_
                told = not against and _is_told(sequence, found)
                if told and self._alternates(found, np.array(numbers)):
                    reasons.append(f"every other cycle of `{label}` differs: the period is doubled")
        return tuple(reasons), tuple(unresolved)

    def _finding(
        self,
        stop: _Stop,
        label: str,
        sequence: OrbitSequence,
        found: Sequence[SeenSequence],
        partly: bool,
    ) -> tuple[list[str], list[str]]:
        if stop.silence:
            return [stop.silence], []
        if not found and self._apart(stop, sequence) < stop.lasts + _ALIKE * self.step:
            flight = f"a flight beside `{label}` lasts {self._apart(stop, sequence):.3g} s"
            return [], [f"{flight} in the orbit, and a contact {stop.lasts:.3g} s, which hides it"]
        if not found:
            what = f"no whole sequence of contacts of `{label}` is seen in {self.span:.4g} s"
            return ([], [what]) if self.span < 2.5 * self.orbit_period else ([what], [])
        if stop.others > len(found) / 2:
            return [
                f"`{stop.name}` closes {stop.others} times at other times than in the orbit"
            ], []
        if sequence.zeno is None:
            return [], []
        short = min(one.fewest for one in found)
        if not all(one.is_resolved or (partly and one.n_sure > 1) for one in found):
            what = f"a contact or flight of `{label}` has {short} sample"
            return [], [f"bounces cannot be decided: {what}, and shorter ones may be missed"]
        if len(sequence.flights) and not any(one.contacts for one in found):
            lasts = f"the first of the orbit lasts {sequence.flights[0]:.3g} s"
            what = (
                f"no bounce of `{label}` is seen, {lasts}, and samples are {self.step:.3g} s apart"
            )
            return [], [f"bounces cannot be decided: {what}"]
        if sequence.release is not None:
            own = sequence.release - sequence.zeno
            lasts = float(np.median([one.release.middle - one.begins[-1].middle for one in found]))
            if lasts < _SHARE * own:
                what = f"the contact `{label}` lasts for {lasts:.3g} s at most"
                return [f"no contact phase is seen: {what}, the orbit's for {own:.3g} s"], []
        for one in found:
            lengths = np.diff([edge.middle for edge in one.begins])
            becomes_shorter = np.all(np.diff(sequence.flights) <= 0.0)
            if becomes_shorter and len(lengths) > 1 and np.any(np.diff(lengths) > 2 * self.step):
                return [f"the bounces of `{label}` do not become shorter"], []
        return [], []

    def _apart(self, stop: _Stop, sequence: OrbitSequence) -> float:
        """Return the time from a sequence of the orbit to the next one before or after it [s]."""
        begin, period = sequence.impacts[0], self.orbit_period
        away = [abs(one.impacts[0] - begin) % period for one in stop.orbit if one is not sequence]
        return min((min(one, period - one) for one in away), default=period)

    def _alternates(self, found: Sequence[SeenSequence], numbers: NDArray[np.int64]) -> bool:
        """Return True if edges of even and odd cycles are at different phases.

        If the sampling is synchronous with two periods, it alone moves an edge by up to a sample.
        """
        if min(np.sum(numbers % 2 == k) for k in (0, 1)) < 2 or not self.period.known:
            return False
        for edges in ([one.begins[0] for one in found], [one.release for one in found]):
            late = np.array([one.middle for one in edges]) - numbers * self.period.value
            parts = [late[numbers % 2 == k] for k in (0, 1)]
            spread = math.hypot(*(float(np.std(one)) / math.sqrt(len(one)) for one in parts))
            apart = abs(float(np.mean(parts[0]) - np.mean(parts[1])))
            if apart > self.step + _DOUBLED * spread:
                return True
        return False

    def unsure(self) -> tuple[str, ...]:
        """Return why the samples may miss first contacts, and with them the period."""
        return tuple(
            f"the first contact of `{label}` cannot be decided: samples are {self.step:.3g} s "
            f"apart, and shorter contacts and flights may be missed"
            for stop in self.stops
            for label, sequence, found in zip(stop.labels(), stop.orbit, stop.seen, strict=True)
            if found and not _is_told(sequence, found)
        )

    def metrics(
        self, table: PeriodTable, start: Estimate, period: Estimate, *, quantities: bool
    ) -> list[Metric]:
        """Return the quantities of all sequences.

        Args:
            table: The orbit.
            start: A time at which the period of the orbit starts [s].
            period: The period.
            quantities: Whether bounces are resolved, so that their quantities have a meaning.
        """
        found: list[Metric] = []
        for stop in self.stops:
            parts = zip(stop.labels(), stop.orbit, stop.seen, strict=True)
            for label, sequence, seen in parts:
                if not seen:
                    continue
                one = _Quantities(
                    label=label,
                    sequence=sequence,
                    seen=seen,
                    step=self.step,
                    period=period,
                    table=table,
                    start=start,
                    is_told=not stop.coarse and _is_told(sequence, seen),
                )
                found += one.times()
                if quantities and sequence.zeno is not None:
                    found += one.bounces()
        return found


def _stop(
    time: Vector,
    channel: Vector,
    name: str,
    sequences: tuple[OrbitSequence, ...],
    orbit_period: float,
    period: float,
    step: float,
) -> _Stop:
    contacts = seen_contacts(time, channel)
    lengths = [
        one.end.middle - one.begin.middle
        for one in contacts
        if one.begin is not None and one.end is not None
    ]
    longest = longest_flight(sequences, orbit_period) * period / orbit_period
    found = seen_sequences(contacts, time, longest, step)
    begins: Vector = np.array([one.begins[0].middle for one in found])
    first_impacts: Vector = np.array([one.impacts[0] for one in sequences])
    own: Vector = first_impacts * (period / orbit_period)
    accumulates = any(one.zeno is not None for one in sequences)
    coarse = "" if accumulates else coarse_channel(time, channel, name)
    bounce, flight = bounce_and_flight(sequences, orbit_period)
    if bounce >= flight:
        coarse = (
            f"contacts of `{name}` cannot be divided into sequences: in the orbit a flight within "
            f"one lasts {bounce:.3g} s, and the one before it {flight:.3g} s"
        )
    if not found:
        none = tuple(() for _ in sequences)
        return _Stop(
            name=name,
            orbit=sequences,
            seen=none,
            cycles=none,
            others=0,
            n_contacts=len(contacts),
            coarse=coarse,
        )
    # The distances between first impacts tell which sequence of the orbit is which.
    best, kinds, numbers = math.inf, np.zeros(len(found), dtype=np.int64), np.zeros(len(found))
    for first in range(len(own)):
        late: Vector = np.subtract.outer(begins - begins[0], own - own[first])
        turns: Vector = np.round(late / period)
        off = np.abs(late - turns * period)
        nearest = np.argmin(off, axis=1)
        total = float(np.sum(np.min(off, axis=1)))
        if total < best:
            best, kinds = total, nearest
            numbers = turns[np.arange(len(found)), nearest]
    seen = [[found[j] for j in np.flatnonzero(kinds == k)] for k in range(len(own))]
    cycles = [[int(numbers[j]) for j in np.flatnonzero(kinds == k)] for k in range(len(own))]
    twice = sum(len(one) - len(set(one)) for one in cycles)
    return _Stop(
        name=name,
        orbit=sequences,
        seen=tuple(tuple(one) for one in seen),
        cycles=tuple(tuple(one) for one in cycles),
        others=twice,
        n_contacts=len(contacts),
        coarse=coarse,
        lasts=float(np.median(lengths)) if lengths else 0.0,
    )


def coarse_channel(time: Vector, channel: Vector, name: str) -> str:
    """Return why the samples of a contact channel may miss contacts, or no text.

    Args:
        time: Times of the samples, ``(n_t,)`` [s].
        channel: 1 in contact and 0 off the stop, NaN where a sample is missing, ``(n_t,)``.
        name: Name of the stop.
    """
    contacts, step = seen_contacts(time, channel), float(np.median(np.diff(time)))
    if not is_coarse(contacts, step):
        return ""
    seen = "a contact or flight has 1 sample" if contacts else "none is seen"
    return (
        f"contacts of `{name}` cannot be decided: {seen}, samples are {step:.3g} s apart, and "
        "shorter ones may be missed"
    )


def _is_told(sequence: OrbitSequence, seen: Sequence[SeenSequence]) -> bool:
    """Return True if the samples tell the first contact of a sequence from a later one.

    Args:
        sequence: The sequence of the orbit.
        seen: The recorded sequences.
    """
    if sequence.zeno is None:
        return True
    if not len(sequence.flights):
        return all(one.is_resolved for one in seen)
    return all(one.begins_surely for one in seen)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Quantities:
    """The quantities of a sequence over all cycles."""

    label: str
    sequence: OrbitSequence
    seen: tuple[SeenSequence, ...]
    step: float
    period: Estimate
    table: PeriodTable
    start: Estimate
    is_told: bool

    def times(self) -> list[Metric]:
        """Return the first impact, the end of the chatter and the release, since the zero phase."""
        found = [self._time("impact_time", self.sequence.impacts[0], self._firsts())]
        if self.sequence.zeno is not None:
            found.append(self._time("zeno_time", self.sequence.zeno, self._lasts(), self._doubt()))
        if self.sequence.release is not None:
            found.append(self._time("release_time", self.sequence.release, self._releases()))
        return found

    def bounces(self) -> list[Metric]:
        """Return number and lengths of the bounces, bounce time and contact duration."""
        zeno, impacts = self.sequence.zeno, self.sequence.impacts
        if zeno is None:
            return []
        counts = np.array([len(one.begins) - 1 for one in self.seen], dtype=np.float64)
        spread = float(np.std(counts, ddof=1)) / math.sqrt(len(counts)) if len(counts) > 1 else 0.0
        contact = float(np.median([c for one in self.seen for c in one.contacts] or [self.step]))
        flights = self.sequence.flights
        # Sampling decides whether a flight that is about as long as a contact is seen.
        unsure = float(np.sum(np.abs(flights - contact) < _ALIKE * self.step))
        counted = Estimate(value=float(np.mean(counts)), error=math.hypot(spread, unsure))
        expected = float(np.sum(flights > max(contact, self.step)))
        found = [
            self._difference(
                "bounce_time", zeno - impacts[0], self._firsts(), self._lasts(), self._doubt()
            ),
            metric(f"{self.label}.bounces", "1", expected, counted),
        ]
        for k in range(int(np.min(counts))):
            own = impacts[k + 1] - impacts[k] if k + 1 < len(impacts) else math.nan
            earlier, later = (
                np.array([one.begins[j].middle for one in self.seen]) for j in (k, k + 1)
            )
            found.append(self._difference(f"bounce {k + 1}", own, earlier, later))
        if self.sequence.release is not None:
            own = self.sequence.release - zeno
            found.append(
                self._difference(
                    "contact_time", own, self._lasts(), self._releases(), self._doubt()
                )
            )
        return found

    def _firsts(self) -> Vector:
        """Return the begin of the first contact in every cycle [s]."""
        return np.array([one.begins[0].middle for one in self.seen])

    def _lasts(self) -> Vector:
        """Return the end of the bounces in every cycle [s].

        Contacts hide the bounces that are shorter than they are. Rigid bodies make all of them, a
        compliant stop none: half of their time is added.
        """
        return np.array([one.begins[-1].middle for one in self.seen]) + self._hidden() / 2

    def _doubt(self) -> float:
        """Return the error of the end of the bounces that the hidden ones leave [s]."""
        return float(np.mean(self._hidden())) / 2

    def _hidden(self) -> Vector:
        """Return the time of the orbit's bounces in the lasting contact, in every cycle [s]."""
        impacts, zeno = self.sequence.impacts, self.sequence.zeno or math.nan
        stretch = self.period.value / self.table.period
        places = [len(one.begins) - 1 for one in self.seen]
        return np.array(
            [stretch * (zeno - impacts[k]) if k < len(impacts) else 0.0 for k in places]
        )

    def _releases(self) -> Vector:
        """Return the end of the last contact in every cycle [s]."""
        return np.array([one.release.middle for one in self.seen])

    def _difference(
        self, word: str, own: float, earlier: Vector, later: Vector, doubt: float = 0.0
    ) -> Metric:
        estimate = mean_of(later - earlier, 2, self.step).unsure(doubt)
        return metric(f"{self.label}.{word}", "s", own, estimate)

    def _time(self, word: str, own: float, edges: Vector, doubt: float = 0.0) -> Metric:
        period, table = self.period.value, self.table
        if not self.is_told:
            return metric(f"{self.label}.{word}", "s", table.since_zero(own), UNKNOWN)
        # Cycles count from the start nearest to the middle, so an error of the period hardly moves.
        late = edges - self.start.value
        turns = np.round((late - own * period / table.period) / period)
        values = late - turns * period
        estimate = mean_of(values, 1, self.step).unsure(self.start.error).unsure(doubt)
        drift = float(np.mean(turns)) * self.period.error
        wanted = table.since_zero(own)
        since = estimate.value - own + wanted
        told = Estimate(value=since, error=math.hypot(estimate.error, drift))
        return metric(f"{self.label}.{word}", "s", wanted, told)
