# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The work-precision diagram of a trade: time against error, a line an engine."""

from __future__ import annotations

import math
from itertools import groupby

from matplotlib.figure import Figure

from zeno_orbits.precision import SAME_WORK, WorkPrecision
from zeno_orbits.report.plots.style import (
    FULL_WIDTH,
    INK,
    LEAST_ERROR,
    PALETTE,
    add_legend,
    panels_of,
)

_FULL, _OPEN = "osD^vP*", "<>dph"
"""Markers of engines, and of what else is varied."""


def plot_trade(trade: WorkPrecision, *, width: float = FULL_WIDTH) -> Figure:
    """Return the work-precision diagram of a trade.

    Args:
        trade: What was measured; trials that went another way are left out.
        width: Width of the picture [in].
    """
    figure, (ax,) = panels_of(width, 1, height=3.4)
    drawn = [t for t in trade.trials if t.sweep in SAME_WORK and math.isfinite(t.error)]
    for k, (label, group) in enumerate(groupby(drawn, key=lambda trial: trial.label)):
        trials = sorted(group, key=lambda trial: trial.value)
        engine = trials[0].sweep == "engine"
        markers = _FULL if engine else _OPEN
        ax.plot(
            [max(trial.error, LEAST_ERROR) for trial in trials],
            [1e3 * trial.seconds for trial in trials],
            color=PALETTE[k % len(PALETTE)],
            marker=markers[k % len(markers)],
            ls="-" if engine else ":",
            lw=1.0,
            ms=4.0 if engine else 5.0,
            mfc=None if engine else "none",
            label=label,
        )
    front = trade.front
    ax.plot(
        [max(trial.error, LEAST_ERROR) for trial in front],
        [1e3 * trial.seconds for trial in front],
        color=INK,
        lw=3.0,
        alpha=0.2,
        zorder=1,
        label="nothing is faster and better",
    )
    ax.set(xscale="log", yscale="log", xlabel="relative error [1]", ylabel="processor time [ms]")
    if not drawn:
        # Logarithmic axes find no limits of their own where nothing is.
        ax.set(xlim=(LEAST_ERROR, 1.0), ylim=(1.0, 1e3))
    ax.invert_xaxis()
    ax.grid(visible=True, which="major", lw=0.4, alpha=0.5)
    add_legend(figure, width)
    return figure
