"""The numbers of a recording beside an orbit's: contacts, signals and portraits.

Source: theory (56), (57).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.contact_events import CycleEvents
from zeno_orbits.experiment.comparison.deviations import (
    Deviations,
    Estimate,
    apex,
    delay,
    greatest,
    portrait_distance,
    root_mean_square,
)
from zeno_orbits.experiment.comparison.stop_level import Stop
from zeno_orbits.experiment.orbit_table import OrbitTable, measurable
from zeno_orbits.model import Problem

_BIASED = 0.25
"""Part of the error of one release by which noise may move all of them."""
_OUTLIER = 6.0
"""Cycles this far from the middle one, in standard deviations, do not count."""


Number = Callable[[CycleEvents], tuple[float, float]]
"""A number of one cycle and its standard error; NaN where it is not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """One number of the record beside the orbit's.

    Attributes:
        name: What it is.
        unit: Its unit.
        orbit: The orbit's.
        data: The record's; NaN where the record does not tell.
        error: Standard error of the record's; NaN where it is not known.
    """

    name: str
    unit: str
    orbit: float
    data: float
    error: float


def contact_metrics(
    table: OrbitTable, events: Sequence[CycleEvents], where: Alignment, stop: Stop, unit: str
) -> Iterator[Metric]:
    """Yield when and how the gap closes, rests and opens, over the cycles.

    Args:
        table: The orbit.
        events: What each cycle shows.
        where: Where the orbit is in the recording.
        stop: The stop as the gap shows it.
        unit: Of the gap.
    """
    first, zeno, period = table.first_impact, table.zeno_time, table.period
    restitution_hidden, chatter_hidden = np.max([one.hidden for one in events], axis=0).tolist()
    late, opening = where.error, _opening_bias(events)

    def row(name: str, own: float, number: Number, *shared: float, unit: str = "s") -> Metric:
        found = _over_cycles([number(one) for one in events])
        # What all cycles share does not fall with their number.
        random = found.error if math.isfinite(found.error) else 0.0
        error = math.hypot(random, *shared) or math.nan
        return Metric(name=name, unit=unit, orbit=own, data=found.value, error=error)

    def impact(one: CycleEvents) -> tuple[float, float]:
        return one.first_impact, one.errors[0]

    def speed(one: CycleEvents) -> tuple[float, float]:
        return one.speed, one.errors[1]

    def restitution(one: CycleEvents) -> tuple[float, float]:
        return one.restitution, one.errors[2]

    def chatter_end(one: CycleEvents) -> tuple[float, float]:
        return one.chatter_end, one.errors[3]

    def chatter(one: CycleEvents) -> tuple[float, float]:
        return one.chatter_end - one.first_impact, one.errors[3]

    def locked(one: CycleEvents) -> tuple[float, float]:
        return one.release - one.chatter_end, math.hypot(one.errors[3], one.errors[4])

    def release(one: CycleEvents) -> tuple[float, float]:
        return one.release, one.errors[4]

    own_speed, e = table.cycle.impacts[0].approach_rate, _restitution(table)
    yield row("first impact time", first, impact, late)
    yield row("first impact speed", own_speed, speed, unit=f"{unit}/s")
    yield row("restitution seen", e, restitution, restitution_hidden, unit="1")
    yield row("end of chatter", zeno, chatter_end, late, chatter_hidden)
    yield row("chatter duration", zeno - first, chatter, chatter_hidden)
    yield row("locked duration", period - zeno, locked, chatter_hidden, opening)
    yield row("release time", period, release, late, opening)
    error = stop.noise / math.sqrt(len(events))
    yield Metric(name="gap while locked", unit=unit, orbit=0.0, data=stop.level, error=error)


def _opening_bias(events: Sequence[CycleEvents]) -> float:
    """Return by how much all times of release may be off together.

    A gap opens like the third power of the time: noise moves the release of a fit to one side.
    """
    errors = [one.errors[4] for one in events if math.isfinite(one.errors[4])]
    return _BIASED * float(np.median(errors)) if errors else 0.0


def _over_cycles(numbers: Sequence[tuple[float, float]]) -> Estimate:
    """Return the mean over cycles and its standard error, at least what the noise makes it.

    Args:
        numbers: Of each cycle, and their standard errors; NaN where they are not known.
    """
    y, u = np.array(numbers).T
    seen = np.isfinite(y)
    y, u = y[seen], u[seen]
    if not len(y):
        return Estimate(value=math.nan, error=math.nan)
    middle = float(np.median(y))
    width = 1.4826 * float(np.median(np.abs(y - middle)))
    kept = np.abs(y - middle) <= _OUTLIER * width if width > 0.0 else np.ones(len(y), dtype=bool)
    y, u = y[kept], u[kept]
    known = np.where(np.isfinite(u), u, 0.0)
    noise = float(np.sqrt(np.mean(known**2) / len(y)))
    scatter = float(np.std(y, ddof=1)) / math.sqrt(len(y)) if len(y) >= 3 else 0.0
    error = max(noise, scatter)
    return Estimate(value=float(y.mean()), error=error if error > 0.0 else math.nan)


def _restitution(table: OrbitTable) -> float:
    """Return the restitution that an orbit's first impact shows."""
    cycle = table.cycle
    if len(cycle.impacts) < 2 or not cycle.rescaled_flights:
        return 0.0
    hop = cycle.rescaled_flights[0]
    # The unit of time of a rescaled flight is the speed that it starts with.
    return float(hop.time_unit / -cycle.impacts[0].approach_rate)


def signal_metrics(problem: Problem, found: Deviations, names: Sequence[str]) -> Iterator[Metric]:
    """Yield extremes, sizes of the deviation and the delay of every signal.

    Args:
        problem: The problem.
        found: The deviations.
        names: Of the signals, in order.
    """
    units, table = measurable(problem), found.table
    share = found.phases * table.period
    parts = {
        "in flight": share < table.first_impact,
        "in chatter": (share >= table.first_impact) & (share < table.zeno_time),
        "locked": share >= table.zeno_time,
    }
    for k, name in enumerate(names):

        def number(what: str, own: float, one: Estimate, unit: str, name: str = name) -> Metric:
            called = f"{what} of {name}"
            return Metric(name=called, unit=unit, orbit=own, data=one.value, error=one.error)

        values, unit = found.fine[:, :, k], units[name]
        yield number("highest", float(values.max()), apex(found, k, 1.0), unit)
        yield number("lowest", float(values.min()), apex(found, k, -1.0), unit)
        for part, chosen in parts.items():
            if chosen.any() and np.isfinite(found.average[chosen, k]).any():
                rms = root_mean_square(found, k, chosen.astype(np.float64))
                yield number(f"rms deviation {part}", 0.0, rms, unit)
        yield number("greatest deviation", 0.0, greatest(found, k)[0], unit)
        yield number("delay", 0.0, delay(found, k), "s")


@dataclass(frozen=True, slots=True, kw_only=True)
class Portrait:
    """A plane in which a recorded cycle can be drawn.

    Attributes:
        signals: Names on both axes.
        rate_of: The recorded signal whose slope stands for the second one; empty if that was
            recorded itself.
    """

    signals: tuple[str, str]
    rate_of: str


def recorded_portraits_of(problem: Problem, names: Sequence[str]) -> tuple[Portrait, ...]:
    """Return the portraits of a problem that recorded signals can be drawn in.

    Args:
        problem: The problem.
        names: Of the recorded signals.
    """
    n_q = problem.compiled().n_q
    coordinates, velocities = problem.state_names[:n_q], problem.state_names[n_q : 2 * n_q]
    found: list[Portrait] = []
    for first, second in problem.portraits:
        rate_of = ""
        if second not in names and second in velocities:
            rate_of = coordinates[velocities.index(second)]
        if first in names and (rate_of or second) in names:
            found.append(Portrait(signals=(first, second), rate_of=rate_of))
    return tuple(found)


def portrait_metrics(found: Deviations, portraits: Sequence[Portrait]) -> Iterator[Metric]:
    """Yield how far the closed curves are apart, in every portrait."""
    columns = found.table.measured.names
    for one in portraits:
        first, second = one.signals
        pair = (columns.index(first), columns.index(second))
        both = portrait_distance(found, pair, columns.index(one.rate_of) if one.rate_of else None)
        for what, size in zip(("mean", "greatest"), both, strict=True):
            name = f"{what} distance in the portrait of {first} and {second}"
            yield Metric(name=name, unit="1", orbit=0.0, data=size.value, error=size.error)
