r"""Offset of the clock of a second recording, by the signals that both recordings have.

Without a model, the offset is the lag with the largest normalized correlation of the deviations
from the means,

.. math:: \rho(l) = \frac{\sum_t a(t)\,b(t + l)}{\sqrt{\sum_t a(t)^2 \sum_t b(t + l)^2}},

with sums and means over the common samples, averaged over the shared signals. Units and scales of
the signals do not matter. The ratio of the rates of the clocks counts as 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.experiment.transients.event_record import event_kind_of

_MOST = 20_000
"""Samples of a recording at most, on an even grid."""
_OVERLAP, _LIKE = 0.25, 0.9
"""Part of the shorter recording that is common at least, and correlation of one motion at least."""
_AS_LIKE = 0.02
"""Difference of correlations up to which two offsets are equally likely."""
_STILL = 0.05
"""Spread of the common part, relative to that of the recordings, that has a shape."""
_TINY = 1e-300


def words_of_clocks(first: Recording, second: Recording) -> str:
    """Return what shared signals tell of the clock of a second recording.

    Args:
        first: A recording.
        second: A recording of the same motion on another clock.
    """
    has = {one.name for one in second.signals}
    shared = [
        one.name for one in first.signals if one.name in has and event_kind_of(one.name) is None
    ]
    if not shared:
        return (
            "the two files share no signal, so their clocks are related by a model alone: "
            "zeno-orbits identify PROBLEM FILE --second-file FILE"
        )
    spans = [float(one.time[-1] - one.time[0]) for one in (first, second)]
    steps = [float(np.median(np.diff(one.time))) for one in (first, second)]
    step = max(min(steps), max(spans) / _MOST)
    score = np.mean([_correlation(first, second, name, step) for name in shared], axis=0)
    by = ", ".join(f"`{name}`" for name in shared)
    k = int(np.argmax(score))
    if score[k] < _LIKE:
        most = f"the correlation of {by} is {max(float(score[k]), 0.0):.2g} at most"
        return f"{most}: the two files do not show one motion by these signals"
    rivals = _others(score, k)
    if len(rivals):
        apart = step * float(np.min(np.abs(rivals - k)))
        return (
            f"the motion repeats: offsets that are {apart:.4g} s apart are equally likely by {by}"
        )
    at = second.time[0] + step * (k - round(spans[0] / step))
    return (
        f"by {by}, the clock of the second file shows {at:.6g} s at the beginning of the first "
        f"file, within {max(step, *steps):.2g} s"
    )


def _others(score: Vector, best: int) -> NDArray[np.intp]:
    """Return other peaks of a correlation that are as high as the best one."""
    inner = score[1:-1]
    peaks = 1 + np.flatnonzero((inner >= score[:-2]) & (inner >= score[2:]))
    low = np.flatnonzero(score < score[best] / 2)
    left, right = low[low < best], low[low > best]
    # A peak ends where the correlation has halved.
    begin, end = (left[-1] if len(left) else 0), (right[0] if len(right) else len(score))
    apart = (peaks < begin) | (peaks > end)
    return peaks[apart & (score[peaks] > score[best] - _AS_LIKE)]


def _correlation(first: Recording, second: Recording, name: str, step: float) -> Vector:
    """Return the correlation at all lags of a grid, 0 where too little is common.

    The entry `k` belongs to the lag ``k - (n - 1)`` of the second file, of the `n` samples of the
    first one.
    """
    from scipy.signal import correlate

    rows = [_even(one, name, step) for one in (first, second)]
    (a, b), (seen_a, seen_b) = rows, [np.ones(len(row)) for row in rows]

    def lagged(x: Vector, y: Vector) -> Vector:
        found: Vector = correlate(y, x, mode="full", method="fft")
        return found

    common = np.maximum(np.rint(lagged(seen_a, seen_b)), 1.0)
    sum_a, sum_b = lagged(a, seen_b), lagged(seen_a, b)
    product = lagged(a, b) - sum_a * sum_b / common
    squares = lagged(a**2, seen_b) - sum_a**2 / common, lagged(seen_a, b**2) - sum_b**2 / common
    sizes = np.sqrt(np.maximum(squares[0], 0.0) * np.maximum(squares[1], 0.0))
    enough = common >= _OVERLAP * min(len(a), len(b))
    # Parts that hardly move have no shape.
    moves = sizes > _STILL * common * float(np.std(a) * np.std(b))
    return np.where(enough & moves, product / np.maximum(sizes, _TINY), 0.0)


def _even(one: Recording, name: str, step: float) -> Vector:
    """Return a signal without its mean on an even grid from its first time on."""
    values = one.signal(name).values
    known = np.isfinite(values)
    n = round(float(one.time[-1] - one.time[0]) / step) + 1
    if not known.any():
        return np.zeros(n)
    at = one.time[0] + step * np.arange(n)
    found = np.asarray(np.interp(at, one.time[known], values[known]), dtype=np.float64)
    return found - float(np.mean(found))
