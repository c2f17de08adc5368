"""Overlay of an orbit and a recording by the recording's period and the best phase shift, if any.

Comparisons and pictures of a recording and an orbit use this overlay.

Source: theory (6.7), (6.8).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.experiment.comparison.alignment import Alignment, aligned
from zeno_orbits.experiment.comparison.event_contacts import SeenEvents
from zeno_orbits.experiment.orbit_table import (
    GAP,
    PeriodTable,
    measurable,
    tabulate_events,
    tabulate_orbit,
)
from zeno_orbits.experiment.recordings.periodicity import Periodicity, periodicity
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import Problem, powers_of
from zeno_orbits.orbits import Orbit

_REPEATS = 0.4
"""Part of the variance that repeats in a record that shows an orbit, at least."""
_PAIRS = 6.0
"""Cycles that tell a doubled period from a motion that has not settled."""
_LIKE = 0.6
"""Correlation of a signal with the orbit's, at least."""
RELATED = 0.2
"""Least correlation of other signals if the contacts match a Zeno orbit."""
_ALTERNATES = 0.02
"""Cycles that differ in turn by this part of the signals' size are of twice the period."""
_UNLIKE_HALVES = 0.5
"""Cycles of a machine with two halves, such as legs, that differ in turn by this part at most."""
_ONCE, _MOST_OFF = 1.5, 0.3
"""Periods of the orbit from which a record of two halves is laid over one period, and the part of
the orbit's period by which that of the record may differ then."""
_SEVERAL = 0.05
"""Part of a period by which the orbit's may differ from several periods of a record."""
_MULTIPLES = (2, 3, 4)
"""Periods of the orbit after which a motion may repeat."""
_SCALED = 1.6
"""Ratio of periods from which the times are more likely scaled than those of another machine."""
_SURE = 4.0
"""Number of standard errors above which a difference is significant."""
_LARGEST = 1e100
"""The sum of squares of larger values would overflow."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Overlay:
    """An orbit aligned with a recording.

    Attributes:
        names: Names of the signals that the orbit and the recording share.
        time: Times of the recording, ``(n_t,)`` [s].
        values: Signals of the recording, one row each, ``(n_s, n_t)``.
        found: Periodicity of the signals, or of the contact channels without signals.
        table: The orbit, whose first signals are the shared signals.
        where: Alignment of the orbit with the recording.
        seen: Contacts of the channels of stops that the orbit strikes.
        halves: Whether halves of the machine, such as legs, take turns.
        coordinates: Names of the coordinates of the machine.
    """

    names: tuple[str, ...]
    time: Vector
    values: Vector
    found: Periodicity
    table: PeriodTable
    where: Alignment
    seen: SeenEvents
    halves: bool = False
    coordinates: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        """True if phases mean something: signals repeat and no unit or sign is mistaken."""
        mistaken = any(one.suspicion for one in self.where.likeness)
        mistaken = mistaken or bool(self.where.time_suspicion or self.where.swapped)
        return self.repeats and not mistaken

    @property
    def repeats(self) -> bool:
        """True if signals repeat, or the edges of channels alone: no harmonics fit contacts."""
        return self.found.repeats >= _REPEATS or (not self.names and self.seen.repeats)

    @property
    def n_cycles(self) -> float:
        """Periods that the recording covers, to a tenth: three whole ones may be 2.9999."""
        return round(self.found.n_cycles, 1)

    @property
    def alternates(self) -> bool:
        """True if the samples of every other period differ."""
        size, noise = self.found.alternation, self.found.alternation_noise
        return size > _ALTERNATES and size > _SURE * noise

    @property
    def halves_differ(self) -> bool:
        """True if every other period differs, by as much as halves of a machine may be unlike."""
        return self.halves and self.alternates and self.found.alternation < _UNLIKE_HALVES

    @property
    def shows_exchange(self) -> bool:
        """True if recorded coordinates jump where halves of the machine exchange their names."""
        return self.halves and any(name in self.coordinates for name in self.names)

    @property
    def may_alternate(self) -> bool:
        """True if every other period differs, or is sampled at other phases."""
        return self.alternates and not self.found.paired and not self.halves_differ

    def reasons(self, *, alike: float = _LIKE) -> list[str]:
        """Return the reasons why the recording shows no such orbit, most serious first.

        Args:
            alike: Least correlation of a signal with the orbit's signal. A value below the default
                is used if the contacts identify the kind of motion. They identify the direction of
                time as well. The result is empty if the recording may show such an orbit.
        """
        found, ratio = self.found, self.found.period / self.table.period
        reasons: list[str] = []
        if not self.repeats:
            reasons.append(f"only {100 * found.repeats:.0f} % of the signals' variance repeats")
        if self.where.time_suspicion:
            asked = f"probably {self.where.time_suspicion}, correct its unit"
            reasons.append(f"the period is {ratio:.6g} times the orbit's: {asked}")
        if self.where.swapped:
            one, other = self.where.swapped
            # A motion that fits after an exchange has no other fault.
            return [*reasons, f"`{one}` and `{other}` look swapped: exchange their column titles"]
        if self.where.backward and alike >= _LIKE:
            reasons.append("it runs backward: the orbit reversed in time is more like it")
        for one in self.where.likeness:
            if one.suspicion:
                numbers = f"correlation {one.correlation:.2f}, {abs(one.gain):.4g} times as large"
                reasons.append(f"`{one.name}` looks like {one.suspicion} ({numbers}): correct it")
            elif one.differs and one.correlation < alike:
                reasons.append(
                    f"`{one.name}` moves differently: its correlation with the orbit is "
                    f"{one.correlation:.2f}"
                )
        return [*self._other_clock(), *reasons, *self._multiples(ratio)]

    def _other_clock(self) -> list[str]:
        """Return that the times look scaled, if no signal is alike at another period."""
        strange = [one.differs and one.correlation < _LIKE for one in self.where.likeness]
        if self.where.time_suspicion or not strange or not all(strange):
            return []
        # The overlay may have several periods of the record in one of the orbit.
        once = periodicity(self.time, self.values)
        ratio = 1.0 if once is None else once.period / self.table.period
        if 1.0 / _SCALED < ratio < _SCALED or any(abs(ratio / k - 1.0) < 0.1 for k in _MULTIPLES):
            return []
        return [f"the period is {ratio:.3g} times the orbit's: check the column of times"]

    def _multiples(self, ratio: float) -> list[str]:
        """Return why the motion is one of several of the orbit's periods, if it is."""
        found = self.found
        reasons: list[str] = []
        if self.alternates and found.paired and not self.halves_differ:
            doubled = f"the period is doubled, {2 * found.period:.6g} s"
            if self.n_cycles < _PAIRS:
                doubled = f"the motion has not settled (take a later --t-start), or {doubled}"
            reasons.append(
                f"every other cycle differs by {100 * found.alternation:.2g} % of the signals: "
                f"{doubled}"
            )
        unlike = any(one.differs and one.correlation < _LIKE for one in self.where.likeness)
        reasons += [
            f"the motion repeats after {multiple} of the orbit's periods only"
            for multiple in _MULTIPLES
            if unlike and abs(ratio / multiple - 1.0) < 0.1
        ]
        return reasons


def lay_over(
    orbit: Orbit,
    problem: Problem,
    recording: Recording,
    names: Sequence[str],
    *,
    also: Sequence[str] = (),
    channels: Mapping[str, Vector] | None = None,
) -> Overlay | None:
    """Return the overlay of an orbit and a recording, or ``None`` if the period is not seen.

    Args:
        orbit: The orbit.
        problem: Its problem.
        recording: The recording.
        names: Names of the common signals, by `shared_signals`.
        also: Names of other signals that the table of the orbit is to hold.
        channels: Contact channels by the name of their stop. They place the orbit if no signal
            does.

    Raises:
        SimulationError: If the orbit does not return.
    """
    names, channels = tuple(names), channels or {}
    time = recording.time
    values = np.array([recording.signal(name).values for name in names]).reshape(-1, len(time))
    rows = values if names else np.array(list(channels.values()))
    graph = problem.graph_dynamics(orbit.values(problem))
    halves = graph.exchanges_coordinates
    found = _periodicity(time, rows, orbit.period, halves=halves)
    if found is None or found.n_cycles < 1.0:
        return None
    if not orbit.has_phases:
        table = tabulate_events(orbit, problem, (*names, *also))
    else:
        table = tabulate_orbit(orbit, problem, (*names, *also, GAP))
    where = aligned(table, time, values, found, names) if names else None
    period = _single(found.period, table.period) if where is None else where.period
    seen = SeenEvents.of(time, channels, table.sequences, table.period, period)
    if where is None or not math.isfinite(where.error):
        where = _by_contacts(time, seen, found, where)
    return Overlay(
        names=names,
        time=time,
        values=values,
        found=found,
        table=table,
        where=where,
        seen=seen,
        halves=halves,
        coordinates=problem.state_names[: graph.n_q],
    )


def _periodicity(time: Vector, rows: Vector, period: float, *, halves: bool) -> Periodicity | None:
    """Return the periodicity of rows: after several of their periods if the orbit has as many.

    Args:
        time: Increasing times, ``(n_t,)`` [s].
        rows: Signals or channels, one row each.
        period: Period of the orbit [s].
        halves: Whether halves of the machine take turns. The orbit of equal halves may repeat after
            one turn, while the record repeats after all of them.
    """
    found = periodicity(time, rows)
    if halves and (found is None or found.period > _ONCE * period):
        once = periodicity(time, rows, near=period)
        if once is not None and once.repeats > _REPEATS:
            near = abs(once.period / period - 1.0) < _MOST_OFF
            return once if near and once.alternation < _UNLIKE_HALVES else found
    turns = 1 if found is None else round(period / found.period)
    if found is None or turns < 2 or abs(period / found.period / turns - 1.0) > _SEVERAL:
        return found
    several = periodicity(time, rows, near=turns * found.period)
    return found if several is None or several.n_cycles < 1.0 else several


def _single(period: float, own: float) -> float:
    """Return the period of channels that repeat after several periods of the orbit.

    Samples that are synchronous with two periods show other edges in every other one.

    Args:
        period: Time after which the channels repeat [s].
        own: Period of the orbit [s].
    """
    turns = round(period / own)
    if turns < 2 or abs(period / own / turns - 1.0) > _SEVERAL:
        return period
    return period / turns


def _by_contacts(
    time: Vector, seen: SeenEvents, found: Periodicity, signals: Alignment | None
) -> Alignment:
    """Return the position of an orbit by the edges of contact channels.

    Args:
        time: Times of the recording, ``(n_t,)`` [s].
        seen: The contacts.
        found: Periodicity of the recording.
        signals: Alignment by signals that do not determine the time, if there are signals.
    """
    known = seen.period.known
    period, error = (seen.period.value, seen.period.error) if known else (found.period, found.error)
    middle = 0.5 * float(time[0] + time[-1])
    offset = seen.offset(middle, period)
    own = Alignment(
        release=middle + offset.value,
        error=offset.error,
        period=period,
        period_error=error,
        phase_error=(offset.error + 0.5 * float(np.ptp(time)) / period * error) / period,
        likeness=(),
        time_suspicion="",
        backward=False,
    )
    return own if signals is None else replace(own, likeness=signals.likeness)


def shared_signals(
    problem: Problem, recording: Recording, channels: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the names of the recorded signals that a problem has.

    Args:
        problem: The problem.
        recording: The recording.
        channels: Names of the contact channels that count as well. No signal is needed beside one.

    Raises:
        InputError: If no signal is shared, or one has a unit of another kind or no sound values.
    """
    known = measurable(problem)
    names = tuple(name for name in recording.names if name in known)
    if not names and not set(channels) & set(recording.names):
        has = ", ".join(recording.names) or "none"
        listed = ", ".join((*known, *channels))
        kinds = "signal or a contact channel" if channels else "signal"
        wanted = f"must have a {kinds} of the problem ({listed})"
        raise InputError(f"Argument `recording` {wanted}, but it has {has}.")
    for name in names:
        signal = recording.signal(name)
        if powers_of(signal.unit) != powers_of(known[name]):
            wanted = f"must have `{name}` in a unit like {known[name]}"
            raise InputError(f"Argument `recording` {wanted}, but it has {signal.unit}.")
    require_values(recording, names)
    return names


def require_values(recording: Recording, names: Sequence[str]) -> None:
    """Refuse signals without a value, and values whose squares are not finite.

    Args:
        recording: The recording.
        names: Names of its signals that count.

    Raises:
        InputError: If a signal lacks values, or a value is above 1e100.
    """
    if names and not any(np.any(np.isfinite(recording.signal(name).values)) for name in names):
        wanted = "lacks values: no signal of it has a number. Check its columns"
        raise InputError(f"Argument `recording` {wanted}.")
    for name in names:
        signal = recording.signal(name)
        values = signal.values[np.isfinite(signal.values)]
        if not len(values):
            raise InputError(f"Argument `recording` lacks values of `{name}`: delete its column.")
        largest = float(np.max(np.abs(values)))
        if largest > _LARGEST:
            wanted = f"must have values of `{name}` up to {_LARGEST:g}"
            place = int(np.nanargmax(np.abs(signal.values)))
            at = f"at t = {recording.time[place]:.7g} s: correct or empty the cell"
            raise InputError(f"Argument `recording` {wanted}, but it has {largest:g} {at}.")
