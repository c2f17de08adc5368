# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""Distributions of the times and states of an orbit that scatters, one panel for each."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.errors import InputError
from zeno_orbits.maps import Scatter, ScatterRow
from zeno_orbits.report.plots.panels import panels_of
from zeno_orbits.report.plots.style import FULL_WIDTH, INK, PALETTE

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
        _draw(ax, row, found)
    return panels.finished()


def _draw(ax: Axes, row: ScatterRow, found: Scatter) -> None:
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
