"""The numbers of a recording's contacts beside an orbit's (theory (56))."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.contact_events import CycleEvents
from zeno_orbits.experiment.comparison.estimate import Estimate, mean_over_cycles
from zeno_orbits.experiment.comparison.stop_level import Stop
from zeno_orbits.experiment.orbit_table import OrbitTable

_BIASED = 0.25
"""Part of the error of one release by which noise may move all of them."""


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


def metric(name: str, unit: str, orbit: float, found: Estimate) -> Metric:
    """Return a number of the record beside the orbit's.

    Args:
        name: What it is.
        unit: Its unit.
        orbit: The orbit's.
        found: The record's, with its standard error.
    """
    return Metric(name=name, unit=unit, orbit=orbit, data=found.value, error=found.error)


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

    def row(
        name: str,
        unit: str,
        own: float,
        number: Callable[[CycleEvents], Estimate],
        *shared: float,
    ) -> Metric:
        found = mean_over_cycles([number(one) for one in events])
        # What all cycles share does not fall with their number.
        error = math.hypot(found.error if math.isfinite(found.error) else 0.0, *shared)
        return metric(name, unit, own, Estimate(value=found.value, error=error or math.nan))

    def chatter(one: CycleEvents) -> Estimate:
        return one.chatter_end.since(one.first_impact, one.chatter_end.error)

    def locked(one: CycleEvents) -> Estimate:
        return one.release.since(one.chatter_end, one.release.error, one.chatter_end.error)

    own_speed, e = table.cycle.impacts[0].approach_rate, _restitution(table)
    yield row("first impact time", "s", first, lambda one: one.first_impact, late)
    yield row("first impact speed", f"{unit}/s", own_speed, lambda one: one.speed)
    yield row("restitution seen", "1", e, lambda one: one.restitution, restitution_hidden)
    yield row("end of chatter", "s", zeno, lambda one: one.chatter_end, late, chatter_hidden)
    yield row("chatter duration", "s", zeno - first, chatter, chatter_hidden)
    yield row("locked duration", "s", period - zeno, locked, chatter_hidden, opening)
    yield row("release time", "s", period, lambda one: one.release, late, opening)
    error = stop.noise / math.sqrt(len(events))
    yield metric("gap while locked", unit, 0.0, Estimate(value=stop.level, error=error))


def _opening_bias(events: Sequence[CycleEvents]) -> float:
    """Return by how much all times of release may be off together.

    A gap opens like the third power of the time: noise moves the release of a fit to one side.
    """
    errors = [one.release.error for one in events if math.isfinite(one.release.error)]
    return _BIASED * float(np.median(errors)) if errors else 0.0


def _restitution(table: OrbitTable) -> float:
    """Return the restitution that an orbit's first impact shows."""
    cycle = table.cycle
    if len(cycle.impacts) < 2 or not cycle.rescaled_flights:
        return 0.0
    # The unit of time of a rescaled flight is the speed that it starts with.
    return float(cycle.rescaled_flights[0].time_unit / -cycle.impacts[0].approach_rate)
