# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""Phase portraits (the paper's Fig. 4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.arrays import Vector
from zeno_orbits.model import Problem
from zeno_orbits.report.paths import ArcPath, drawn_paths
from zeno_orbits.report.plots.looks import Looks, looks_of, mark_switches
from zeno_orbits.report.plots.panels import portraits_of
from zeno_orbits.report.plots.style import (
    AFTER,
    BEFORE,
    FULL_WIDTH,
    JUMP,
    mark_completion,
)
from zeno_orbits.simulation import Execution

_LONG = 0.35
"""Length of an arc, in widths of its panel, from which on an arrow shows its direction."""
_MOST_ARROWS = 6
"""Arcs of a panel that have an arrow, the longest first."""


def plot_portraits(
    problem: Problem,
    execution: Execution,
    *,
    width: float = FULL_WIDTH,
    axes: Sequence[Axes] = (),
) -> Figure:
    """Return the phase portraits of a problem: arcs by mode, resets and events.

    Args:
        problem: The problem, whose ``portraits`` name the axes.
        execution: The execution to draw.
        width: Width of the picture [in].
        axes: Axes to draw into, one per portrait, by default on a new figure.
    """
    panels, pairs = portraits_of(problem, width, height=2.5, axes=axes)
    impacts, paths, looks = execution.impacts, drawn_paths(execution), looks_of(execution)
    for ax, pair in pairs:
        for path in paths:
            ax.plot(*path.states[:, pair].T, **looks.path(path))
        if impacts:
            before = np.array([impact.state_minus[pair] for impact in impacts]).T
            after = np.array([impact.state_plus[pair] for impact in impacts]).T
            ax.plot(*np.stack([before, after], axis=1), **JUMP)
            ax.plot(*after, **AFTER)
            ax.plot(*before, **BEFORE)
        mark_completion(ax, execution, pair)
        mark_switches(ax, execution, looks, pair)
        _add_arrows(ax, paths, looks, pair)
    return panels.finished()


def _add_arrows(ax: Axes, paths: Sequence[ArcPath], looks: Looks, pair: Sequence[int]) -> None:
    """Show the direction of the longest arcs by an arrow in the middle of each."""
    ranges = np.array([np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim())])
    curves = [(looks.path(path)["color"], path.states[:, list(pair)]) for path in paths]
    found = [(*_middle(curve, ranges), colour) for colour, curve in curves]
    found = sorted((one for one in found if one[0] > _LONG), key=lambda one: -one[0])
    for _, ends, colour in found[:_MOST_ARROWS]:
        ax.annotate(
            "",
            xy=tuple(ends[1]),
            xytext=tuple(ends[0]),
            arrowprops={
                "arrowstyle": "-|>",
                "mutation_scale": 11.0,
                "color": colour,
                "shrinkA": 0.0,
                "shrinkB": 0.0,
            },
            gid="direction",
        )


def _middle(curve: Vector, ranges: Vector) -> tuple[float, Vector]:
    """Return the length of a curve in ranges of its panel, and a short chord in its middle."""
    steps = np.sqrt(np.sum((np.diff(curve, axis=0) / ranges) ** 2, axis=1))
    lengths = np.concatenate([[0.0], np.cumsum(steps)])
    length = float(lengths[-1])
    ends = np.zeros((2, 2))
    for k, part in enumerate((0.49, 0.51)):
        ends[k] = [float(np.interp(part * length, lengths, curve[:, j])) for j in range(2)]
    return length, ends
