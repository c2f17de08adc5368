# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The largest pushes of an orbit over its phase, one panel for each direction."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.maps import Pushes
from zeno_orbits.report.plots.panels import panels_of
from zeno_orbits.report.plots.style import FULL_WIDTH, INK, PALETTE, TINTS
from zeno_orbits.report.push_panels import PushPanel, push_panels
from zeno_orbits.report.symbols import direction_symbol, math_symbol
from zeno_orbits.simulation import Mode

_ROOM = 1.12
"""Height of a panel over the largest impulse in it."""


def plot_pushes(found: Pushes, *, width: float = FULL_WIDTH, axes: Sequence[Axes] = ()) -> Figure:
    """Return the largest impulses over the phase, negative senses below zero.

    Args:
        found: The pushes.
        width: Width of the picture [in].
        axes: Panels to draw into, one for each direction. The default is a new figure.
    """
    shown = push_panels(found)
    panels = panels_of(width, len(shown), height=2.4, axes=axes)
    for ax, panel in zip(panels, shown, strict=True):
        _draw(ax, panel)
        along = direction_symbol(panel.direction, math_symbol)
        ax.set(xlabel="phase [1]", ylabel=f"impulse along {along} [{panel.unit}]")
    return panels.finished()


def _draw(ax: Axes, panel: PushPanel) -> None:
    """Draw both signs of one direction: returning pushes are filled, lost pushes are marked."""
    step = panel.step
    for phase in panel.contact:
        ax.axvspan(
            phase - step / 2, phase + step / 2, color=TINTS[Mode.LOCKED], lw=0, label="contact"
        )
    at, ends = zip(*panel.lost, *panel.kept, strict=True)
    ax.bar(at, ends, width=0.8 * step, color=PALETTE[0], alpha=0.35, lw=0, label="returns")
    if panel.lost:
        ax.plot(
            *zip(*panel.lost, strict=True),
            ls="",
            marker="o",
            ms=4,
            color=PALETTE[1],
            label="lost beyond",
        )
    if panel.kept:
        ax.plot(
            *zip(*panel.kept, strict=True),
            ls="",
            marker="o",
            ms=4,
            mfc="none",
            color=INK,
            label="end of the scan",
        )
    ax.axhline(0.0, color=INK, lw=0.6)
    top = _ROOM * max(abs(end) for end in ends)
    low, high = panel.phases[0] - step / 2, panel.phases[-1] + step / 2
    ax.set(xlim=(low, high), ylim=(-top, top))
