# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""Transients beside the fitted motion: signals, deviations and event times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.errors import InputError
from zeno_orbits.experiment import FittedTrial, TransientFit
from zeno_orbits.report.plots.panels import panels_of
from zeno_orbits.report.plots.style import FULL_WIDTH, TEXT
from zeno_orbits.report.symbols import quantity_label

_MOST_TRIALS = 12
"""Trials that are drawn. A picture of more is not legible."""
_MILLI = 1e3


def plot_transient(
    found: TransientFit, *, width: float = FULL_WIDTH, axes: Sequence[Axes] = ()
) -> Figure:
    """Return transients beside the fitted motion, with the deviations.

    Left: the samples and the fitted motion. Right: recorded minus fitted. Samples beside impacts
    that do not count are gray. Impacts of the fitted motion are dashed. Event times have one panel,
    recorded minus fitted times over time.

    Args:
        found: The fit.
        width: Width of the picture [in].
        axes: Axes to draw into, two per signal and one per trial with event times, by default on a
            new figure.

    Raises:
        InputError: If there is nothing to draw.
    """
    trials = found.trials[:_MOST_TRIALS]
    signals = [(one, k) for one in trials for k in range(len(one.names))]
    events = [one for one in trials if len(one.event_times)]
    n = 2 * len(signals) + len(events)
    if not n:
        raise InputError("Argument `found` has neither signals nor event times to draw.")
    panels = panels_of(width, n, height=1.5, columns=2, axes=axes)
    for place, (one, k) in enumerate(signals):
        left, right = panels.axes[2 * place : 2 * place + 2]
        _draw_signal(left, right, one, k)
    for ax, one in zip(panels.axes[2 * len(signals) :], events, strict=True):
        ax.plot(one.event_times, _MILLI * one.event_rests, "k.", ms=4)
        ax.axhline(0.0, color="#777777", lw=0.6)
        ax.set_ylabel("event time minus fit [ms]")
        ax.set_xlabel("time [s]")
        ax.set_title(one.label, size=TEXT)
    return panels.finished()


def _draw_signal(left: Axes, right: Axes, one: FittedTrial, k: int) -> None:
    """Draw a signal of a trial, and its deviation from the fitted motion."""
    counts = one.seen[:, k] > 0.0
    off = one.recorded[:, k] - one.fitted[:, k]
    left.plot(one.time, one.recorded[:, k], ".", color="#777777", ms=2.5, label="recording")
    left.plot(one.time, one.fitted[:, k], color="#0072B2", lw=1.0, label="fitted motion")
    right.plot(one.time[~counts], off[~counts], ".", color="#bbbbbb", ms=2.5)
    right.plot(one.time[counts], off[counts], ".", color="black", ms=2.5)
    right.axhline(0.0, color="#777777", lw=0.6)
    size = float(np.max(np.abs(off[counts]), initial=0.0)) or 1.0
    right.set_ylim(-1.2 * size, 1.2 * size)
    left.set_ylabel(quantity_label(one.names[k], one.units[k]))
    right.set_ylabel(f"deviation [{one.units[k]}]")
    left.set_title(one.label, size=TEXT)
    right.set_title("recording minus fitted motion", size=TEXT)
    for ax in (left, right):
        ax.set_xlabel("time [s]")
        for time in one.impacts:
            ax.axvline(float(time), color="#777777", lw=0.4, ls="--")
