# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""Phase portraits and time series (the paper's Figs. 4 and 5a)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from zeno_orbits.arrays import Vector
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.report.plots.style import (
    AFTER,
    BEFORE,
    FULL_WIDTH,
    INK,
    JUMP,
    TINTS,
    add_legend,
    label_of,
    mark_completion,
    panels_of,
    paths_of,
    portraits_of,
    share_time,
    symbol_of,
)
from zeno_orbits.simulation import Execution, Mode

_EDGE = 0.01
"""Part of a picture in which an impact would be hidden by its frame."""


def plot_portraits(problem: Problem, execution: Execution, *, width: float = FULL_WIDTH) -> Figure:
    """Return the phase portraits of a problem: arcs by mode, resets, Zeno points, releases.

    Args:
        problem: The problem; its ``portraits`` say what is drawn against what.
        execution: What to draw.
        width: Width of the picture [in].
    """
    figure, panels = portraits_of(problem, width, height=2.5)
    impacts = execution.impacts
    for ax, pair in panels:
        for _, states, look in paths_of(execution):
            ax.plot(*states[:, pair].T, **look)
        if impacts:
            before = np.array([impact.state_minus[pair] for impact in impacts]).T
            after = np.array([impact.state_plus[pair] for impact in impacts]).T
            ax.plot(*np.stack([before, after], axis=1), **JUMP)
            ax.plot(*after, **AFTER)
            ax.plot(*before, **BEFORE)
        mark_completion(ax, execution, pair)
    add_legend(figure, width)
    return figure


def plot_time_series(
    problem: Problem, execution: Execution, *, width: float = FULL_WIDTH
) -> Figure:
    """Return coordinates and currents over time, phases shaded, impacts as ticks on the upper edge.

    The clock of a forced problem, the states without a unit behind the velocities, is left out.

    Args:
        problem: The problem.
        execution: What to draw.
        width: Width of the picture [in].
    """
    n_q = problem.model(problem.symbols()).n_q
    behind = range(2 * n_q, len(problem.state_names))
    rows = [*range(n_q), *(row for row in behind if problem.state_units[row] != "1")]
    labels = [label_of(problem, row) for row in rows]
    return _over_time(execution, labels, lambda states: states[:, rows], width)


def plot_states(execution: Execution, *, width: float = FULL_WIDTH) -> Figure:
    """Return every state over time, for an execution whose problem and units are not known.

    Args:
        execution: What to draw.
        width: Width of the picture [in].
    """
    names = execution.state_names
    labels = [symbol_of(names, row) for row in range(len(names))]
    return _over_time(execution, labels, lambda states: states[:, : len(names)], width)


def plot_outputs(
    problem: Problem, values: ParameterValues, execution: Execution, *, width: float = FULL_WIDTH
) -> Figure:
    """Return the outputs of a problem over time, drawn as the states are.

    Args:
        problem: The problem; it has outputs.
        values: Its numbers.
        execution: What to draw.
        width: Width of the picture [in].
    """
    labels = [f"{output.name.replace('_', ' ')} [{output.unit}]" for output in problem.outputs]

    def entries(states: Vector) -> Vector:
        return problem.output_values(values, states[:, : len(problem.state_names)])

    return _over_time(execution, labels, entries, width)


def _over_time(
    execution: Execution,
    labels: Sequence[str],
    values: Callable[[Vector], Vector],
    width: float,
) -> Figure:
    """Return one panel a column of what is computed from the states."""
    figure, panels = panels_of(width, len(labels), height=max(1.25, 2.0 / len(labels)), columns=1)
    impacts = [impact.time for impact in execution.impacts]
    paths = [(times, values(states), look) for times, states, look in paths_of(execution)]
    for column, (ax, label) in enumerate(zip(panels, labels, strict=True)):
        for mode, start, end in drawn_phases_of(execution):
            ax.axvspan(start, end, color=TINTS[mode], lw=0, gid=mode.value)
        for times, drawn, look in paths:
            ax.plot(times, drawn[:, column], **look)
        ax.margins(y=0.14)
        ax.autoscale_view()
        edge = ax.get_xaxis_transform()
        ax.vlines(impacts, 0.91, 1.0, color=INK, lw=0.8, transform=edge, gid="impact")
        if impacts:
            ax.plot([], [], color=INK, ls="", marker="|", ms=7, label="impact")
        ax.set(ylabel=label, xlim=(execution.arcs[0].start_time, _end(execution)))
    share_time(figure, panels, "time $t$ [s]")
    add_legend(figure, width)
    return figure


def _end(execution: Execution) -> float:
    """Return where a picture ends: a little later, if an impact at the end would be on its edge."""
    start, end = execution.arcs[0].start_time, execution.end_time
    last = execution.impacts[-1].time if execution.impacts else start
    return end + _EDGE * (end - start) if last > end - _EDGE * (end - start) else end


def drawn_phases_of(execution: Execution) -> list[tuple[Mode, float, float]]:
    """Return mode, start and end of every phase; a Zeno tail belongs to the flights before it."""
    starts = [execution.arcs[0]]
    starts += [arc for last, arc in pairwise(execution.arcs) if arc.mode is not last.mode]
    times = [*(arc.start_time for arc in starts), execution.end_time]
    return [(arc.mode, *ends) for arc, ends in zip(starts, pairwise(times), strict=True)]
