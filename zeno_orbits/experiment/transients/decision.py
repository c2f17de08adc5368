"""Settled orbit or transient: the decision from the recordings alone."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.overlay import require_values
from zeno_orbits.experiment.recordings.periodicity import periodicity
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.experiment.transients.event_record import has_event_times
from zeno_orbits.experiment.transients.seen_impacts import rest_begins

_CYCLES, _REPEATS = 2.0, 0.8
"""Periods, and part of the variance that repeats, of a settled recording at least."""
_SMALLER, _FEWEST = 0.6, 20
"""Ratio of the last to the first third of a decaying motion at most, and samples of a third."""


def transient_reason(recordings: Sequence[Recording], signals: Collection[str]) -> str:
    """Return why recordings are transients, empty if they may show a settled orbit.

    Args:
        recordings: The recordings.
        signals: Names of the signals of the problem.

    Raises:
        InputError: If a signal lacks values, or a value is above 1e100.
    """
    if len(recordings) > 1:
        return "several trials were given"
    (recording,) = recordings
    if has_event_times(recording):
        return "the recording holds times of events"
    named = [one for one in recording.signals if one.name in signals]
    if not named:
        return ""
    require_values(recording, [one.name for one in named])
    values: Vector = np.array([one.values for one in named])
    found = periodicity(recording.time, values)
    if found is not None and found.n_cycles >= _CYCLES and found.repeats >= _REPEATS:
        return ""
    begun = rest_begins(recording.time, values.T)
    if begun is not None:
        return f"the motion comes to rest at {begun:.4g} s"
    return "the motion decays" if _decays(values) else ""


def _decays(values: Vector) -> bool:
    """Return True if all signals move less in the last third than in the first one.

    Args:
        values: Signals, ``(n_s, n)``.
    """
    part = values.shape[1] // 3
    if part < _FEWEST:
        return False
    thirds = values[:, :part], values[:, -part:]
    if not all(np.all(np.isfinite(rows).any(axis=1)) for rows in thirds):
        return False
    first, last = (np.nanstd(rows, axis=1) for rows in thirds)
    return bool(np.all(last < _SMALLER * first))
