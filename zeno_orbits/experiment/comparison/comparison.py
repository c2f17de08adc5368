"""Comparison of a recording with an orbit: whether both show the same motion, and the deviations.

A stop gives two kinds of evidence: its gap, if the recorded signals determine it, and its contact
channel. The signals themselves are compared phase by phase.

Source: theory (6.7) to (6.10).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import counted
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.contact_fit import ContactFit, fit_contacts
from zeno_orbits.experiment.comparison.contact_gaps import contradictions
from zeno_orbits.experiment.comparison.deviations import N_BINS, Deviations, deviations
from zeno_orbits.experiment.comparison.estimate import UNKNOWN, Estimate, instruments_json
from zeno_orbits.experiment.comparison.event_contacts import coarse_channel
from zeno_orbits.experiment.comparison.gap_model import gap_model, recorded_gap
from zeno_orbits.experiment.comparison.gap_samples import stop_level
from zeno_orbits.experiment.comparison.instrument_errors import without_errors
from zeno_orbits.experiment.comparison.instruments import InstrumentReading
from zeno_orbits.experiment.comparison.metrics import (
    Metric,
    contact_metrics,
    metric,
    metric_columns,
    named_metric,
    plain_number,
)
from zeno_orbits.experiment.comparison.overlay import RELATED, Overlay, lay_over, shared_signals
from zeno_orbits.experiment.comparison.signal_metrics import (
    portrait_metrics,
    recorded_portraits_of,
    signal_metrics,
)
from zeno_orbits.experiment.comparison.verdict import (
    ComparisonVerdict,
    Finding,
    contact_finding,
    differing,
)
from zeno_orbits.experiment.orbit_table import OrbitTable, PeriodTable
from zeno_orbits.experiment.recordings.contacts import contact_channels, contact_names
from zeno_orbits.experiment.recordings.periodicity import Periodicity
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import Problem
from zeno_orbits.orbits import ZENO_ORBIT, Orbit
from zeno_orbits.work import Columns, TableRepr

__all__ = ["Comparison", "ComparisonVerdict", "Metric", "compare_recording"]


_FEWEST_CYCLES = 6
_TOLD_CYCLES, _CHANGES = 3.0, 0.03
"""Cycles that tell another orbit from a motion that has not settled, where every other cycle
differs by less than this part of the signals. Else more are needed."""
_FEWEST_SAMPLES = 6
"""Samples in a period below which a multiple of it may be found."""
_STRAY = 0.1
"""Part of the variance that may be nonperiodic without a remark: harmonics do not fit jumps."""
_SETTLING = 3.0
"""Factor over the deviation of later cycles above which a cycle counts as transient."""
_STRAYS, _FAR = 2e-3, 5.0
"""Largest part of the values that may be strays, and their distance in ranges of the others."""
_CLIPPED = 0.01
"""Part of the samples that sit at an extreme in a signal that is cut off there."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Comparison(TableRepr):
    """Comparison of a recording with an orbit.

    Attributes:
        orbit: The orbit.
        problem: Its problem.
        recording: The recording, whole.
        signals: Names of the signals that the orbit and the recording share.
        overlay: The orbit aligned with the recording, if the recording is periodic.
        contacts: Contacts with the stop, if the recorded gap shows a resting level.
        deviations: Deviations by phase, if the recording and the orbit show the same kind of
            motion.
        reasons: Reasons why the recording shows no such orbit of the machine, most serious first.
            It is empty if the recording shows such an orbit.
        unresolved: Reasons why the recording is inconclusive. It is empty for a conclusive
            recording.
        remarks: Further findings.
        instruments: Gains and offsets of channels that were determined, by ``CHANNEL.gain`` and
            ``CHANNEL.offset``. The recording is corrected by them.
        second_file: Comparison of a second file of the motion, its times on the first clock. Its
            findings count.
    """

    orbit: Orbit
    problem: Problem
    recording: Recording
    signals: tuple[str, ...]
    overlay: Overlay | None = None
    contacts: ContactFit | None = None
    deviations: Deviations | None = None
    reasons: tuple[str, ...] = ()
    unresolved: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    instruments: Mapping[str, Estimate] = field(default_factory=dict[str, Estimate])
    second_file: Comparison | None = None

    def __repr__(self) -> str:
        """Return one line: the verdict, the signals, and the reasons."""
        found = f"verdict={self.verdict.value}, signals={', '.join(self.signals)}"
        return (
            f"<Comparison with {self.orbit.problem}: {found} {' '.join(self.reasons)}".strip() + ">"
        )

    def _columns(self) -> Columns:
        """Return the values of the recording next to the values of the orbit."""
        return metric_columns(self.metrics)

    @property
    def period(self) -> Periodicity | None:
        """Periodicity of the recording, if it repeats."""
        return None if self.overlay is None else self.overlay.found

    @property
    def where(self) -> Alignment | None:
        """Position of the orbit in the recording, if that repeats."""
        return None if self.overlay is None else self.overlay.where

    @property
    def is_zeno(self) -> bool:
        """True if impacts accumulate in the orbit."""
        return self.orbit.kind == ZENO_ORBIT

    @cached_property
    def metrics(self) -> tuple[Metric, ...]:
        """Values of the recording and the orbit."""
        if self.overlay is None:
            return ()
        found, table, where = self.overlay.found, self.overlay.table, self.overlay.where
        if not self.overlay.holds:
            return (metric("period", "s", table.period, _period_of(found)),)
        seen = self.overlay.seen
        periods = [Estimate(value=where.period, error=where.period_error), seen.period]
        known = [one for one in periods if one.known and math.isfinite(one.error)]
        period = min(known, key=lambda one: one.error, default=_period_of(found))
        if not self.overlay.names and not seen.period.known and seen.unsure():
            period = UNKNOWN
        metrics = [metric("period", "s", table.period, period)]
        if self.contacts is not None and isinstance(table, OrbitTable):
            metrics += contact_metrics(table, self.contacts, where, self.problem.gap_unit)
        else:
            start = Estimate(value=where.release, error=where.error)
            metrics += seen.metrics(table, start, period, quantities=not any(seen.findings()))
        if self.deviations is not None:
            metrics += signal_metrics(self.problem, self.deviations, self.signals)
            portraits = recorded_portraits_of(self.problem, self.signals)
            metrics += portrait_metrics(self.deviations, portraits)
        return tuple(metrics)

    @cached_property
    def verdict(self) -> ComparisonVerdict:
        """Verdict on the recording."""
        if self.reasons:
            return ComparisonVerdict.NO_ORBIT
        if self.unresolved:
            return ComparisonVerdict.UNDECIDED
        others = self.second_file is not None and self.second_file.differences
        differs = self.differences or others
        return ComparisonVerdict.OTHER_VALUES if differs else ComparisonVerdict.THIS_ORBIT

    @cached_property
    def differences(self) -> tuple[Metric, ...]:
        """The quantities that differ from the orbit's by more than their errors."""
        if self.overlay is None:
            return ()
        return differing(self.metrics, self.overlay.table, self.signals)

    @property
    def agrees(self) -> bool:
        """True if the recording shows this orbit, or one of the machine with other values."""
        return self.verdict.shows_orbit

    def metric(self, name: str) -> Metric:
        """Return a number by its name.

        Raises:
            InputError: If no metric has this name.
        """
        return named_metric(self.metrics, name)

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as plain data, with null for unknown values."""
        source = self.recording.source
        return {
            "agrees": self.agrees,
            "verdict": self.verdict.value,
            "reasons": list(self.reasons),
            "unresolved": list(self.unresolved),
            "differences": [one.name for one in self.differences],
            "remarks": list(self.remarks),
            "problem": self.orbit.problem,
            "source": None if source is None else source.value,
            "signals": list(self.signals),
            "cycles": None if self.period is None else self.period.n_cycles,
            "release_time": None if self.where is None else plain_number(self.where.release),
            "instruments": instruments_json(self.instruments),
            "metrics": {one.name: one.as_json() for one in self.metrics},
            **({} if self.second_file is None else {"second_file": self.second_file.as_json()}),
        }


def compare_recording(
    orbit: Orbit,
    problem: Problem,
    recording: Recording,
    readings: Sequence[InstrumentReading] = (),
) -> Comparison:
    """Compare a recording with an orbit.

    Args:
        orbit: The orbit.
        problem: Its problem.
        recording: The recording. Signals with the name of a state, a motor or an output of the
            problem count, and contact channels.
        readings: Unknown gains and offsets of channels, which are determined first.

    Raises:
        InputError: If no signal or channel is known to the problem, the unit of a signal measures
            another quantity, or a channel is invalid.
        SimulationError: If the orbit is not periodic in simulation.
    """
    errors: Mapping[InstrumentReading, Estimate] = {}
    if readings:
        titles = contact_names(problem.graph_dynamics(orbit.values(problem)).stop_names)
        recording, errors = without_errors(orbit, problem, recording, readings, titles)
    named = {f"{one.channel}.{one.kind.value}": errors[one] for one in errors}
    found = replace(_compared(orbit, problem, recording), instruments=named)
    other = tuple(_other_problem(recording, problem)) if found.reasons else ()
    if not other:
        return found
    # Another machine is the first explanation of a difference.
    remarks = tuple(one for one in found.remarks if one not in other)
    return replace(found, reasons=(*other, *found.reasons), remarks=remarks)


def _compared(orbit: Orbit, problem: Problem, recording: Recording) -> Comparison:
    """Return the comparison, with another name of the problem as a remark alone."""
    values = orbit.values(problem)
    stops = problem.graph_dynamics(values).stop_names
    channels, titles = contact_channels(recording, stops), contact_names(stops)
    names = shared_signals(problem, recording, titles)
    remarks = _oddities(recording, problem, names, titles)
    begun = Comparison(orbit=orbit, problem=problem, recording=recording, signals=names)
    # Portraits need rates in addition to the recorded signals.
    seconds = [one.signals[1] for one in recorded_portraits_of(problem, names)]
    more = [name for name in seconds if name not in names]
    overlay = lay_over(
        orbit, problem, recording, names, also=tuple(dict.fromkeys(more)), channels=channels
    )
    step = float(np.median(np.diff(recording.time)))
    # The samples of a much slower motion are not few, whatever the orbit's period.
    slow = overlay is not None and overlay.found.period > _FEWEST_SAMPLES**2 * step
    if _FEWEST_SAMPLES * step > orbit.period and not slow:
        few = f"samples are {step:.3g} s apart, and the orbit's period is {orbit.period:.4g} s: "
        few += f"record {_FEWEST_SAMPLES:g} or more per period"
        return replace(begun, unresolved=(few,), remarks=tuple(remarks))
    # Channels that miss contacts show no period, though the motion may have one.
    missed = () if names else tuple(_missed(orbit, recording.time, channels))
    if overlay is not None and not names:
        missed += overlay.seen.unsure()
    if missed and (overlay is None or not overlay.holds):
        return replace(begun, overlay=overlay, unresolved=missed, remarks=tuple(remarks))
    if overlay is None:
        return replace(begun, reasons=(_no_period(begun),), remarks=tuple(remarks))
    reasons = overlay.reasons()
    if overlay.n_cycles < _TOLD_CYCLES:
        remarks.append(f"only {overlay.n_cycles:.1f} cycles were recorded: errors are rough")
    if not overlay.holds:
        # Numbers of signals that are mistaken for others would mislead.
        said, why = tuple(remarks), tuple(reasons)
        return replace(begun, overlay=overlay, reasons=why, remarks=said)
    contacts, seen = _contact_evidence(overlay, problem, recording, channels)
    if contacts is not None and not (seen.reasons or seen.unresolved or seen.unseen):
        reasons = overlay.reasons(alike=RELATED)
    against = contradictions(problem, values, recording, names, overlay.seen, channels)
    if contacts is not None:
        # The gap shows contact.
        against += tuple(one.silence for one in overlay.seen.stops if one.silence)
    remarks += _unlike_cycles(overlay)
    deviation = (
        deviations(overlay.table, recording.time, overlay.values, overlay.where) if names else None
    )
    settling = [] if deviation is None else _settling(deviation, recording.time, overlay.where)
    remarks += settling
    compared = replace(
        begun,
        overlay=overlay,
        # Values of a contact fit without contacts would be meaningless.
        contacts=None if seen.reasons else contacts,
        deviations=deviation,
        reasons=(*reasons, *seen.reasons, *against),
        unresolved=seen.unresolved,
        remarks=tuple(remarks),
    )
    doubts = [*seen.unresolved, *_few_samples(compared, overlay)]
    if compared.differences:
        doubts += seen.unseen
        if settling:
            # Values of a mean over the first cycles are those of no orbit.
            doubts.append("the first cycles are farther from the mean than the others are")
    return replace(compared, unresolved=tuple(doubts))


def _no_period(compared: Comparison) -> str:
    """Return why a recording shows no period."""
    recording = compared.recording
    rows = [recording.signal(name).values for name in compared.signals]
    if rows and all(np.nanmin(row) == np.nanmax(row) for row in rows):
        return "every signal is constant: check the columns and the instruments"
    whole, period = recording.time[-1] - recording.time[0], compared.orbit.period
    steps = np.diff(recording.time)
    pause = float(np.max(steps, initial=0.0))
    if pause > max(period, whole / 2):
        since = float(recording.time[int(np.argmax(steps))])
        return (
            f"no sample follows t = {since:.6g} s for {pause:.4g} s, and no period is seen: "
            "correct the times, or cut the recording with --t-start or --t-end"
        )
    seen = f"no period is seen in {whole:.4g} s, and the orbit's is {period:.4g} s"
    return f"{seen}: record a motion of several periods"


def _unlike_cycles(overlay: Overlay) -> Iterator[str]:
    """Yield what differs from cycle to cycle."""
    found = overlay.found
    if overlay.halves_differ:
        yield (
            f"every other cycle differs by {100 * found.alternation:.2g} % of the signals: halves "
            f"of the machine, such as legs, are unlike, or its period is doubled"
        )
    if found.repeats < 1.0 - _STRAY:
        yield f"{100 * (1 - found.repeats):.2g} % of the signals' variance does not repeat"


def _missed(orbit: Orbit, time: Vector, channels: Mapping[str, Vector]) -> Iterator[str]:
    """Yield why the channels of stops without a lasting contact may miss contacts."""
    if orbit.has_phases:
        return
    for stop, row in channels.items():
        if f"zeno {stop}" in orbit.sequence:
            continue
        found = coarse_channel(time, row, stop)
        if found:
            yield found


def _period_of(found: Periodicity) -> Estimate:
    return Estimate(value=found.period, error=found.error)


def _few_samples(compared: Comparison, overlay: Overlay) -> Iterator[str]:
    """Yield what a recording of few samples cannot decide."""
    if overlay.may_alternate:
        part = f"{100 * overlay.found.alternation:.2g} % of the signals"
        yield f"every other cycle differs by {part}, or is sampled at other phases"
    cycles, changes = overlay.n_cycles, overlay.found.alternation > _CHANGES
    least = _FEWEST_CYCLES if changes and not overlay.halves_differ else _TOLD_CYCLES
    if compared.differences and cycles < least:
        yield (
            f"{cycles:.1f} cycles do not tell another orbit from a motion that has not settled: "
            f"record {least:g} or more"
        )
    n = len(compared.recording.time)
    if compared.signals and n < 2 * N_BINS and compared.differences:
        # Nearly every bin of the phase has one sample.
        yield f"{n} samples are too few to separate a deviation from noise"
    if compared.signals and _by_clock_alone(compared.problem, overlay.table, compared.signals):
        yield f"{', '.join(compared.signals)} depend on the clock alone, and not on the motion"


def _by_clock_alone(problem: Problem, table: PeriodTable, names: Sequence[str]) -> bool:
    """Return True if recorded signals depend on nothing but the clock."""
    own = [k for k in range(len(problem.state_names)) if k not in problem.clock]
    slopes = table.measured.derivatives(table.states.values, table.p)
    return not np.any(slopes[:, : len(names)][:, :, own])


def _channel_finding(overlay: Overlay, channels: Mapping[str, Vector]) -> Finding:
    """Return the findings of the contact channels.

    Args:
        overlay: The orbit aligned with the recording.
        channels: Contact channels by the name of their stop.
    """
    table = overlay.table
    reasons, unresolved = overlay.seen.findings()
    others = {stop: row for stop, row in channels.items() if stop not in table.sequences}
    other = tuple(
        f"the contact `{stop}` closes, and the orbit does not touch it"
        if stop not in table.held
        else f"the contact `{stop}` opens, and the orbit keeps it closed"
        for stop, row in others.items()
        if np.any(row[np.isfinite(row)] != float(stop in table.held))
    )
    missing = ", ".join(f"`{stop}`" for stop in table.sequences if stop not in channels)
    known = table.accumulates or overlay.shows_exchange
    unseen: tuple[str, ...] = () if known else (_NO_PHASE,)
    if missing:
        unseen = (f"contacts cannot be seen on {missing}: {_no_channel(table)}",)
        if not overlay.names:
            unresolved = (*unresolved, *unseen)
    return Finding(reasons=(*reasons, *other), unresolved=unresolved, unseen=unseen)


def _no_channel(table: PeriodTable) -> str:
    if isinstance(table, OrbitTable):
        return "its channel, or coordinates that the gap depends on, were not recorded"
    return "no channel was recorded"


_NO_PHASE = "the orbit lacks accumulating impacts, by which the machine could be recognized"


def _contact_evidence(
    overlay: Overlay, problem: Problem, recording: Recording, channels: Mapping[str, Vector]
) -> tuple[ContactFit | None, Finding]:
    """Return the contacts of a recorded gap, and what gap or channels tell of the contacts."""
    table, where = overlay.table, overlay.where
    gap = recorded_gap(table, problem, recording) if isinstance(table, OrbitTable) else None
    if gap is None or not isinstance(table, OrbitTable):
        return None, _channel_finding(overlay, channels)
    # Without a resting level there is no contact.
    level = stop_level(gap)
    model = gap_model(table, problem, where.period)
    found = None if level is None else fit_contacts(overlay.time, gap, model, where, level)
    return found, contact_finding(found, table, overlay.time)


def _other_problem(recording: Recording, problem: Problem) -> list[str]:
    """Return a remark if a recording names another problem, in a list that is empty otherwise."""
    word = recording.problem
    if not word or word.partition("@")[0] == problem.name.partition("@")[0]:
        return []
    return [f"the recording names the problem `{word}`, not `{problem.name}` (line `# problem:`)"]


def _oddities(
    recording: Recording, problem: Problem, names: Sequence[str], channels: Sequence[str]
) -> list[str]:
    remarks: list[str] = []
    others = [name for name in recording.names if name not in (*names, *channels)]
    if others:
        remarks.append(f"not signals of the problem, left out: {', '.join(others)}")
    remarks += _other_problem(recording, problem)
    if recording.source is None:
        remarks.append("missing entry `source` of the recording (measured or simulated)")
    for name in names:
        row = recording.signal(name).values
        row = row[np.isfinite(row)]
        for extreme in (float(row.max()), float(row.min())):
            share = float(np.mean(np.abs(row - extreme) <= 1e-9 * max(float(np.ptp(row)), 1e-300)))
            if _CLIPPED < share < 0.2 and len(np.unique(row[:2000])) > 200:
                what = f"{100 * share:.2g} % of its values are {extreme:.6g}"
                remarks.append(f"`{name}` looks cut off: {what}")
        remarks += _stray(name, recording)
    return remarks


def _stray(name: str, recording: Recording) -> list[str]:
    """Return a remark on the few values of a signal that are far from all others."""
    row = recording.signal(name).values
    low, high = np.nanquantile(row, [_STRAYS, 1.0 - _STRAYS])
    reach = _FAR * (high - low)
    far = np.flatnonzero((row < low - reach) | (row > high + reach))
    if not far.size or reach == 0.0:
        return []
    most = far[np.argmax(np.abs(row[far] - low))]
    what = f"{counted(far.size, 'value')} far from all others"
    where = f"{row[most]:.6g} at {recording.time[most]:g} s"
    return [f"`{name}` has {what} ({where}): correct or empty {'it' if far.size == 1 else 'them'}"]


def _settling(found: Deviations, time: Vector, where: Alignment) -> list[str]:
    """Return a remark if the first cycles are farther from the mean than the others are."""
    sizes = found.sizes_in_turn()
    later = sizes[len(sizes) // 2 :]
    if len(sizes) < _FEWEST_CYCLES or not np.isfinite(later).any():
        return []
    usual = float(np.nanmedian(later))
    strange = np.flatnonzero(sizes > _SETTLING * usual)
    if not len(strange) or strange[0] > 1 or strange[-1] > len(sizes) // 2:
        return []
    begin = where.release + where.period * math.floor((time[0] - where.release) / where.period)
    until = begin + (int(strange[-1]) + 1) * where.period
    return [f"the motion is still settling at first: skip that part with --t-start {until:.4g}"]
