# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The work-precision diagram of a trade: time against error, one line per engine."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.precision import WorkPrecision
from zeno_orbits.report.plots.panels import panels_of
from zeno_orbits.report.plots.style import FULL_WIDTH, INK, PALETTE
from zeno_orbits.report.trade_lines import LEAST_ERROR, front_line, trade_lines

_FULL, _OPEN = "osD^vP*", "<>dph"
"""Markers of integrators, and of the other varied settings."""


def plot_trade(
    trade: WorkPrecision, *, width: float = FULL_WIDTH, axes: Sequence[Axes] = ()
) -> Figure:
    """Return the work-precision diagram.

    Args:
        trade: The measurements. Trials that took another mode sequence are omitted.
        width: Width of the picture [in].
        axes: One panel to draw into, by default on a new figure.
    """
    panels = panels_of(width, 1, height=3.4, axes=axes)
    (ax,) = panels
    lines = trade_lines(trade)
    for k, line in enumerate(lines):
        markers = _FULL if line.is_engine else _OPEN
        ax.plot(
            line.errors,
            line.milliseconds,
            color=PALETTE[k % len(PALETTE)],
            marker=markers[k % len(markers)],
            ls="-" if line.is_engine else ":",
            lw=1.0,
            ms=4.0 if line.is_engine else 5.0,
            mfc=None if line.is_engine else "none",
            label=line.label,
        )
    front = front_line(trade)
    ax.plot(
        front.errors, front.milliseconds, color=INK, lw=3.0, alpha=0.2, zorder=1, label=front.label
    )
    ax.set(xscale="log", yscale="log", xlabel="relative error [1]", ylabel="processor time [ms]")
    if not lines:
        # Logarithmic axes find no limits of their own where nothing is.
        ax.set(xlim=(LEAST_ERROR, 1.0), ylim=(1.0, 1e3))
    ax.invert_xaxis()
    ax.grid(visible=True, which="major", lw=0.4, alpha=0.5)
    return panels.finished()
