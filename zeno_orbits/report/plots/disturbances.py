# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""Results on disturbances of an orbit: the largest pushes, and the scatter of its quantities."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.errors import InputError
from zeno_orbits.maps import Pushes, Scatter, ScatterRow
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
        _draw_pushes(ax, panel)
        along = direction_symbol(panel.direction, math_symbol)
        ax.set(xlabel="phase [1]", ylabel=f"impulse along {along} [{panel.unit}]")
    return panels.finished()


def _draw_pushes(ax: Axes, panel: PushPanel) -> None:
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


_BINS, _SPAN = 40, 4.0
"""Bars of a panel, and half its width in standard deviations."""
_LEAST = 1e-9
"""Deviation relative to the value below which a quantity does not scatter."""


def plot_scatter(found: Scatter, *, width: float = FULL_WIDTH, axes: Sequence[Axes] = ()) -> Figure:
    """Return the distribution of each quantity that scatters, with the normal one to first order.

    Args:
        found: The scatter.
        width: Width of the picture [in].
        axes: Panels to draw into, one for each quantity. The default is a new figure.

    Raises:
        InputError: If nothing scatters, or no period counts.
    """
    shown = [row for row in found.rows if row.deviation > _LEAST * max(abs(row.orbit), _LEAST)]
    if not shown:
        raise InputError("Argument `found` must have a quantity that scatters.")
    panels = panels_of(width, len(shown), height=2.2, axes=axes)
    for ax, row in zip(panels, shown, strict=True):
        _draw_distribution(ax, row, found)
    return panels.finished()


def _draw_distribution(ax: Axes, row: ScatterRow, found: Scatter) -> None:
    """Draw a histogram of deviations from the orbit, and the normal density to first order."""
    largest = _SPAN * max(row.linear, row.deviation)
    power = 3 * math.floor(math.log10(largest) / 3)
    unit, linear = 10.0**power, row.linear / 10.0**power
    values, half = (found.samples[row.name] - row.orbit) / unit, largest / unit
    ax.hist(
        values,
        bins=np.linspace(-half, half, _BINS + 1).tolist(),
        density=True,
        color=PALETTE[0],
        alpha=0.35,
        lw=0,
        label="simulated",
    )
    if linear > 0.0:
        x = np.linspace(-half, half, 201)
        density = np.exp(-((x / linear) ** 2) / 2) / (linear * math.sqrt(2 * math.pi))
        ax.plot(x, density, color=INK, lw=1.2, label="to first order")
    tens = "" if power == 0 else rf"$10^{{{power}}}$ "
    ax.set(
        xlabel=f"{row.name} minus orbit [{tens}{row.unit}]", ylabel="density", xlim=(-half, half)
    )
