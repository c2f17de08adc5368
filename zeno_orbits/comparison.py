"""A recording beside an orbit: is it such an orbit, and by how much do they differ.

Source: theory (54) to (57).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.alignment import Alignment, aligned
from zeno_orbits.compiled import bind
from zeno_orbits.contacts import (
    CycleEvents,
    Flight,
    GapModel,
    Stop,
    cycle_events,
    refined_stop,
    stop_level,
)
from zeno_orbits.cycle_tables import (
    GAP,
    Nodes,
    OrbitTable,
    gap_coordinates,
    measurable,
    measurement,
    table_of,
)
from zeno_orbits.deviations import (
    Deviations,
    Estimate,
    apex,
    delay,
    deviations,
    greatest,
    portrait_distance,
    root_mean_square,
)
from zeno_orbits.errors import InputError
from zeno_orbits.models import compiled_model
from zeno_orbits.orbit import ZenoOrbit
from zeno_orbits.periodicity import Periodicity, periodicity
from zeno_orbits.problem import Problem
from zeno_orbits.recordings import Recording
from zeno_orbits.units import powers_of

Vector = NDArray[np.float64]

_REPEATS = 0.4
"""Part of the variance that repeats in a record that shows an orbit, at least."""
_LIKE = 0.6
"""Correlation of a signal with the orbit's, at least."""
_ALTERNATES = 0.02
"""Cycles that differ in turn by this part of the signals' size are of twice the period."""
_SURE = 4.0
"""So many standard errors are no accident."""
_SEEN = 0.5
"""Part of the cycles that must show a locked phase and an impact."""
_OUTLIER = 6.0
_AT_ONCE = 1 << 18
_FEWEST_CYCLES = 6
_STRAY = 0.1
"""Part of the variance that does not repeat and is not said: harmonics leave some of jumps."""
_SETTLING = 3.0
"""Cycles whose deviation is larger by this factor than that of later ones have not settled."""
_CLIPPED = 0.01
"""Part of the samples that sit at an extreme in a signal that is cut off there."""


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """A recording beside an orbit.

    Attributes:
        orbit: The orbit.
        recording: The recording, whole.
        signals: Names of the signals that both have.
        period: How the recording repeats, if it does.
        where: Where the orbit is in it, if it does.
        deviations: By phase, if it does.
        stop: The stop as the gap shows it, if it does.
        events: What each cycle shows.
        metrics: The numbers.
        reasons: Why the recording shows no such orbit; empty if it does.
        remarks: What else is to be said.
    """

    orbit: ZenoOrbit
    recording: Recording
    signals: tuple[str, ...]
    period: Periodicity | None
    where: Alignment | None
    deviations: Deviations | None
    stop: Stop | None
    events: tuple[CycleEvents, ...]
    metrics: tuple[Metric, ...]
    reasons: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        """Whether the recording shows such an orbit, however far its numbers are off."""
        return not self.reasons

    def metric(self, name: str) -> Metric:
        """Return a number by its name.

        Raises:
            InputError: If there is none.
        """
        for metric in self.metrics:
            if metric.name == name:
                return metric
        known = ", ".join(metric.name for metric in self.metrics)
        raise InputError(f"Argument `metric` must be one of {known}, but it is `{name}`.")

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as plain data; what is not known is null."""
        source = self.recording.source
        return {
            "agrees": self.agrees,
            "reasons": list(self.reasons),
            "remarks": list(self.remarks),
            "problem": self.orbit.problem,
            "source": None if source is None else source.value,
            "signals": list(self.signals),
            "cycles": None if self.period is None else self.period.n_cycles,
            "release_time": None if self.where is None else _plain(self.where.release),
            "metrics": {
                metric.name: {
                    "unit": metric.unit,
                    "orbit": _plain(metric.orbit),
                    "data": _plain(metric.data),
                    "difference": _plain(metric.data - metric.orbit),
                    "standard_error": _plain(metric.error),
                }
                for metric in self.metrics
            },
        }


def compare(orbit: ZenoOrbit, problem: Problem, recording: Recording) -> Comparison:
    """Return a recording beside an orbit.

    Args:
        orbit: The orbit.
        problem: Its scene.
        recording: The recording; signals with names of the scene's states, motors or outputs count.

    Raises:
        InputError: If no signal is the scene's, or one has a unit of another kind.
        SimulationError: If the orbit does not return.
    """
    names = shared_signals(problem, recording)
    time = recording.time
    values = np.stack([recording.signal(name).values for name in names])
    remarks = list(_oddities(recording, problem, names))
    found = periodicity(time, values)
    if found is None or found.n_cycles < 1.0:
        whole = time[-1] - time[0]
        reason = f"no period is seen in {whole:.4g} s; the orbit's is {orbit.period:.4g} s"
        return _nothing(orbit, recording, names, [reason], remarks)
    if found.n_cycles < 3.0:
        remarks.append(f"only {found.n_cycles:.1f} cycles were recorded: errors are rough")
    table = table_of(orbit, problem, (*names, *_more_signals(problem, names)))
    where = aligned(table, time, values, found, names)
    period = Metric(
        name="period", unit="s", orbit=table.period, data=found.period, error=found.error
    )
    reasons = _shape_reasons(table, found, where)
    if found.repeats < _REPEATS or where.time_suspicion or _suspicious(where):
        # Numbers of signals that are mistaken for others would mislead.
        whole = _nothing(orbit, recording, names, reasons, remarks)
        return replace(whole, period=found, where=where, metrics=(period,))
    gap = recorded_gap(orbit, problem, recording)
    stop, events = _contacts(orbit, problem, time, gap, where)
    if gap is None:
        missing = "coordinates that the gap depends on were not recorded"
        remarks.append(f"impacts, locked phase and release are not told: {missing}")
    else:
        reasons += _contact_reasons(stop, events)
    if found.repeats < 1.0 - _STRAY:
        remarks.append(f"{100 * (1 - found.repeats):.2g} % of the signals' variance do not repeat")
    deviation = deviations(table, time, values, where)
    remarks += _settling(deviation, time, where)
    metrics = (
        period,
        *_event_metrics(table, events, where, stop, problem.gap_unit),
        *_signal_metrics(problem, table, deviation, names),
        *_portrait_metrics(deviation, table, _portraits(problem, names)),
    )
    return Comparison(
        orbit=orbit,
        recording=recording,
        signals=names,
        period=found,
        where=where,
        deviations=deviation,
        stop=stop,
        events=events,
        metrics=metrics,
        reasons=tuple(reasons),
        remarks=tuple(remarks),
    )


def _suspicious(where: Alignment) -> bool:
    return any(one.suspicion for one in where.likeness)


def _more_signals(problem: Problem, names: Sequence[str]) -> tuple[str, ...]:
    """Return what portraits need beside the recorded signals."""
    seconds = [second for _, second, _ in _portraits(problem, names)]
    return tuple(dict.fromkeys(second for second in seconds if second not in names))


def shared_signals(problem: Problem, recording: Recording) -> tuple[str, ...]:
    """Return the names of the recorded signals that a scene has.

    Raises:
        InputError: If there is none, one has a unit of another kind, or holds nothing.
    """
    known = measurable(problem)
    names = tuple(name for name in recording.names if name in known)
    if not names:
        has = ", ".join(recording.names) or "none"
        wanted = f"must have a signal of the scene ({', '.join(known)})"
        raise InputError(f"Argument `recording` {wanted}, but it has {has}.")
    for name in names:
        signal = recording.signal(name)
        if powers_of(signal.unit) != powers_of(known[name]):
            wanted = f"must have `{name}` in a unit like {known[name]}"
            raise InputError(f"Argument `recording` {wanted}, but it has {signal.unit}.")
        if not np.isfinite(signal.values).any():
            raise InputError(f"Argument `recording` must have values of `{name}`, but it has none.")
    return names


def recorded_gap(orbit: ZenoOrbit, problem: Problem, recording: Recording) -> Vector | None:
    """Return the gap at every time of a recording, or nothing if a coordinate of it is missing."""
    needed = gap_coordinates(problem)
    if not needed or any(name not in recording.names for name in needed):
        return None
    p = np.asarray(orbit.setting(problem).values(), dtype=np.float64)
    gap = measurement(problem, (GAP,))
    found = np.empty(len(recording.time))
    for at in range(0, len(found), _AT_ONCE):
        piece = slice(at, at + _AT_ONCE)
        states = np.zeros((len(found[piece]), len(problem.state_names)))
        for name in needed:
            column = problem.state_names.index(name)
            states[:, column] = recording.signal(name).values[piece]
        found[piece] = gap.values(states, p)[:, 0]
    return found


def gap_model(orbit: ZenoOrbit, problem: Problem, period: float) -> GapModel:
    """Return an orbit's gap, stretched to a period.

    Raises:
        SimulationError: If the orbit does not return.
    """
    table = table_of(orbit, problem, (GAP,))
    dynamics = bind(compiled_model(problem), tuple(table.p.tolist()))
    cycle, stretch = table.cycle, period / table.period
    starts = [cycle.start.time, *(impact.time for impact in cycle.impacts)]
    flights = tuple(
        Flight(
            start=(start - cycle.start.time) * stretch,
            end=(impact.time - cycle.start.time) * stretch,
            rate=impact.approach_rate / stretch,
            acceleration=dynamics.gap_acceleration(impact.state_minus) / stretch**2,
        )
        for start, impact in zip(starts, cycle.impacts, strict=False)
    )
    nodes = Nodes(
        times=table.nodes.times * stretch,
        values=table.nodes.values,
        slopes=table.nodes.slopes / stretch,
    )
    return GapModel(
        nodes=nodes,
        flights=flights,
        restitution=dynamics.restitution,
        zeno_time=table.zeno_time * stretch,
        period=period,
    )


def _contacts(
    orbit: ZenoOrbit, problem: Problem, time: Vector, gap: Vector | None, where: Alignment
) -> tuple[Stop | None, tuple[CycleEvents, ...]]:
    """Return the stop and what each cycle shows of it."""
    stop = None if gap is None else stop_level(gap)
    if gap is None or stop is None:
        return None, ()
    model = gap_model(orbit, problem, where.period)
    events = cycle_events(time, gap, stop, model, where.release)
    stop = refined_stop(time, gap, stop, events, where.release, where.period)
    return stop, cycle_events(time, gap, stop, model, where.release)


def _over_cycles(values: Sequence[float], errors: Sequence[float]) -> Estimate:
    """Return the mean over cycles and its standard error, at least what the noise makes it."""
    y, u = np.array(values), np.array(errors)
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


def _event_metrics(
    table: OrbitTable,
    events: Sequence[CycleEvents],
    where: Alignment,
    stop: Stop | None,
    unit: str,
) -> list[Metric]:
    if not events or stop is None:
        return []
    first = table.cycle.impacts[0]
    after = float(table.first_impact)
    zeno, period = table.zeno_time, table.period
    e = table_restitution(table)

    def over(number: Callable[[CycleEvents], tuple[float, float]]) -> Estimate:
        pairs = [number(one) for one in events]
        return _over_cycles([v for v, _ in pairs], [u for _, u in pairs])

    def both(*errors: float) -> float:
        return math.hypot(*errors)

    rows: list[tuple[str, str, float, Estimate, bool]] = [
        (
            "first impact time",
            "s",
            after,
            over(lambda one: (one.first_impact, one.errors[0])),
            True,
        ),
        (
            "first impact speed",
            f"{unit}/s",
            first.approach_rate,
            over(lambda one: (one.speed, one.errors[1])),
            False,
        ),
        (
            "restitution seen",
            "1",
            e,
            over(lambda one: (one.restitution, one.errors[2])),
            False,
        ),
        (
            "end of chatter",
            "s",
            zeno,
            over(lambda one: (one.chatter_end, one.errors[3])),
            True,
        ),
        (
            "chatter duration",
            "s",
            zeno - after,
            over(lambda one: (one.chatter_end - one.first_impact, one.errors[3])),
            False,
        ),
        (
            "locked duration",
            "s",
            period - zeno,
            over(lambda one: (one.release - one.chatter_end, both(one.errors[3], one.errors[4]))),
            False,
        ),
        ("release time", "s", period, over(lambda one: (one.release, one.errors[4])), True),
    ]
    # Times since the orbit's release are as uncertain as where that is.
    metrics = [
        Metric(
            name=name,
            unit=own_unit,
            orbit=own,
            data=found.value,
            error=both(found.error, where.error) if since else found.error,
        )
        for name, own_unit, own, found, since in rows
    ]
    error = stop.noise / math.sqrt(len(events))
    level = Metric(name="gap while locked", unit=unit, orbit=0.0, data=stop.level, error=error)
    return [*metrics, level]


def table_restitution(table: OrbitTable) -> float:
    """Return the restitution that an orbit's first impact shows."""
    cycle = table.cycle
    if len(cycle.impacts) < 2 or not cycle.hops:
        return 0.0
    hop = cycle.hops[0]
    # The unit of time of a rescaled flight is the speed that it starts with.
    return float(hop.time_unit / -cycle.impacts[0].approach_rate)


def _signal_metrics(
    problem: Problem,
    table: OrbitTable,
    found: Deviations,
    names: Sequence[str],
) -> list[Metric]:
    units = measurable(problem)
    share = found.phases * table.period
    parts = {
        "in flight": share < table.first_impact,
        "in chatter": (share >= table.first_impact) & (share < table.zeno_time),
        "locked": share >= table.zeno_time,
    }
    metrics: list[Metric] = []
    for k, name in enumerate(names):
        unit = units[name]

        def add(what: str, own: float, one: Estimate, unit: str = unit, name: str = name) -> None:
            metrics.append(
                Metric(
                    name=f"{what} of {name}", unit=unit, orbit=own, data=one.value, error=one.error
                )
            )

        values = found.fine[:, :, k]
        add("highest", float(values.max()), apex(found, k, 1.0))
        add("lowest", float(values.min()), apex(found, k, -1.0))
        for part, chosen in parts.items():
            if chosen.any() and np.isfinite(found.average[chosen, k]).any():
                rms = root_mean_square(found, k, chosen.astype(np.float64))
                add(f"rms deviation {part}", 0.0, rms)
        add("greatest deviation", 0.0, greatest(found, k)[0])
        add("delay", 0.0, delay(found, k), "s")
    return metrics


def _portraits(problem: Problem, names: Sequence[str]) -> list[tuple[str, str, str]]:
    """Return both signals of each portrait that can be drawn, and whose slope the second is."""
    n_q = compiled_model(problem).n_q
    coordinates, velocities = problem.state_names[:n_q], problem.state_names[n_q : 2 * n_q]
    found: list[tuple[str, str, str]] = []
    for first, second in problem.portraits:
        if first not in names:
            continue
        if second in names:
            found.append((first, second, ""))
        elif second in velocities:
            of = coordinates[velocities.index(second)]
            if of in names:
                found.append((first, second, of))
    return found


def _portrait_metrics(
    found: Deviations, table: OrbitTable, pairs: Sequence[tuple[str, str, str]]
) -> list[Metric]:
    metrics: list[Metric] = []
    columns = table.measured.names
    for first, second, of in pairs:
        pair = (columns.index(first), columns.index(second))
        both = portrait_distance(found, pair, columns.index(of) if of else None)
        for what, one in zip(("mean", "greatest"), both, strict=True):
            name = f"{what} distance in the portrait of {first} and {second}"
            metrics.append(Metric(name=name, unit="1", orbit=0.0, data=one.value, error=one.error))
    return metrics


def _oddities(recording: Recording, problem: Problem, names: Sequence[str]) -> list[str]:
    remarks: list[str] = []
    others = [name for name in recording.names if name not in names]
    if others:
        remarks.append(f"not signals of the scene, left out: {', '.join(others)}")
    if recording.scene and recording.scene.partition("@")[0] != problem.name.partition("@")[0]:
        remarks.append(f"the recording names the scene `{recording.scene}`, not `{problem.name}`")
    if recording.source is None:
        remarks.append("the recording does not say whether it was measured or simulated")
    for name in names:
        row = recording.signal(name).values
        row = row[np.isfinite(row)]
        for extreme in (float(row.max()), float(row.min())):
            share = float(np.mean(np.abs(row - extreme) <= 1e-9 * max(float(np.ptp(row)), 1e-300)))
            if _CLIPPED < share < 0.2 and len(np.unique(row[:2000])) > 200:
                what = f"{100 * share:.2g} % of its values are {extreme:.6g}"
                remarks.append(f"`{name}` looks cut off: {what}")
    return remarks


def _shape_reasons(table: OrbitTable, found: Periodicity, where: Alignment) -> list[str]:
    """Return why the signals show no such orbit, the gravest first."""
    reasons: list[str] = []
    if found.repeats < _REPEATS:
        reasons.append(f"only {100 * found.repeats:.0f} % of the signals' variance repeat")
    if where.time_suspicion:
        ratio = found.period / table.period
        reasons.append(f"the period is {ratio:.6g} times the orbit's: {where.time_suspicion}?")
    for one in where.likeness:
        if one.suspicion:
            numbers = f"correlation {one.correlation:.2f}, {abs(one.gain):.4g} times as large"
            reasons.append(f"`{one.name}` looks like {one.suspicion} ({numbers})")
        elif one.correlation < _LIKE:
            reasons.append(
                f"`{one.name}` moves otherwise: its correlation with the orbit's is "
                f"{one.correlation:.2f}"
            )
    if found.alternation > _ALTERNATES and found.alternation > _SURE * found.alternation_noise:
        reasons.append(
            f"cycles differ in turn by {100 * found.alternation:.2g} % of the signals: the period "
            f"is doubled, {2 * found.period:.6g} s"
        )
    ratio = found.period / table.period
    unlike = min((one.correlation for one in where.likeness), default=1.0) < _LIKE
    reasons += [
        f"the motion repeats after {multiple} of the orbit's periods only"
        for multiple in (2, 3, 4)
        if unlike and abs(ratio / multiple - 1.0) < 0.1
    ]
    return reasons


def _settling(found: Deviations, time: Vector, where: Alignment) -> list[str]:
    """Say so if the first cycles are farther from the mean of the others than those are."""
    sizes = found.sizes_in_turn()
    if len(sizes) < _FEWEST_CYCLES:
        return []
    usual = float(np.median(sizes[len(sizes) // 2 :]))
    strange = np.flatnonzero(sizes > _SETTLING * usual)
    if not len(strange) or strange[0] > 1 or strange[-1] > len(sizes) // 2:
        return []
    begin = where.release + where.period * math.floor((time[0] - where.release) / where.period)
    until = begin + (int(strange[-1]) + 1) * where.period
    return [f"the motion still settles at first; leave that out with --from {until:.4g}"]


def _contact_reasons(stop: Stop | None, events: Sequence[CycleEvents]) -> list[str]:
    if stop is None:
        return ["no locked phase is seen: the gap rests nowhere"]
    told = [one for one in events if math.isfinite(one.rest_start)]
    if not events:
        return []
    struck = [one for one in events if math.isfinite(one.first_impact)]
    reasons: list[str] = []
    if len(told) < _SEEN * len(events):
        reasons.append(
            f"no locked phase is seen in {len(events) - len(told)} of {len(events)} cycles"
        )
    if len(struck) < _SEEN * len(events):
        reasons.append(f"no impact is seen in {len(events) - len(struck)} of {len(events)} cycles")
    return reasons


def _nothing(
    orbit: ZenoOrbit,
    recording: Recording,
    names: tuple[str, ...],
    reasons: Sequence[str],
    remarks: Sequence[str],
) -> Comparison:
    return Comparison(
        orbit=orbit,
        recording=recording,
        signals=names,
        period=None,
        where=None,
        deviations=None,
        stop=None,
        events=(),
        metrics=(),
        reasons=tuple(reasons),
        remarks=tuple(remarks),
    )


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
