# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""States and outputs over time (the paper's Fig. 5a), long runs as envelopes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.arrays import Vector
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.report.paths import ArcPath, drawn_paths, drawn_phases_of, shown_states
from zeno_orbits.report.plots.looks import Looks, looks_of
from zeno_orbits.report.plots.panels import is_wide, panels_of
from zeno_orbits.report.plots.style import ARCS, FULL_WIDTH, ZENO
from zeno_orbits.report.symbols import label_of, math_symbol, quantity_label
from zeno_orbits.simulation import Execution, Mode

TIME = "time $t$ [s]"
_EDGE = 0.01
"""Part of a picture in which an impact would be hidden by its frame."""
_MOST_TURNS = 60
"""Maxima and minima an inch from which on a curve is drawn as its envelope."""
_MOST_EVENTS = 30
"""Largest number of distinguishable impacts or phases per inch, above which none is drawn
singly."""
_PLACES = 1000
"""Number of distinguishable points along an axis of time."""
_LEVELS = 25
"""Number of distinguishable levels of a panel, roughly. Smaller swings are ignored."""
_BINS = 60
"""Steps of an envelope an inch, at most."""
_TURNS_A_BIN = 8
"""Maxima and minima that a step of an envelope spans at least, so that it is the same all over."""
_ENVELOPE: dict[str, Any] = {
    "color": ARCS[Mode.FREE]["color"],
    "alpha": 0.5,
    "lw": 0.8,
    "label": "range of the motion",
}

Columns = Callable[[Vector], Vector]
"""Function from states ``(m, n_x)`` to the drawn quantities, ``(m, n)``."""


def plot_time_series(
    problem: Problem,
    execution: Execution,
    *,
    width: float = FULL_WIDTH,
    axes: Sequence[Axes] = (),
) -> Figure:
    """Return coordinates, their velocities and currents over time.

    Phases are shaded in the colours of their closed stops, Zeno points are marked, impacts are
    ticks on the upper edge, and switches are lines. The clock
    states of a forced problem, which follow the velocities and are dimensionless, are omitted. A
    motion that oscillates too fast for the figure is drawn as the range that it covers.

    Args:
        problem: The problem.
        execution: The execution to draw.
        width: Width of the picture [in].
        axes: Axes to draw into, one per panel, by default on a new figure.
    """
    rows = shown_states(problem)
    labels = [label_of(problem, row) for row in rows]
    return _over_time(execution, labels, lambda states: states[:, rows], width, axes)


def plot_states(
    execution: Execution, *, width: float = FULL_WIDTH, axes: Sequence[Axes] = ()
) -> Figure:
    """Return every state over time, for an execution whose problem and units are unknown.

    Args:
        execution: The execution to draw.
        width: Width of the picture [in].
        axes: Axes to draw into, one per state, by default on a new figure.
    """
    names = execution.state_names
    labels = [math_symbol(name, names) for name in names]
    return _over_time(execution, labels, lambda states: states[:, : len(names)], width, axes)


def plot_outputs(
    problem: Problem,
    values: ParameterValues,
    execution: Execution,
    *,
    width: float = FULL_WIDTH,
    axes: Sequence[Axes] = (),
) -> Figure:
    """Return the outputs of a problem over time, drawn like the states.

    Args:
        problem: The problem, which must have outputs.
        values: Parameter values of the problem.
        execution: The execution to draw.
        width: Width of the picture [in].
        axes: Axes to draw into, one per output, by default on a new figure.
    """
    labels = [quantity_label(output.name, output.unit) for output in problem.outputs]

    def entries(states: Vector) -> Vector:
        return problem.output_values(values, states[:, : len(problem.state_names)])

    return _over_time(execution, labels, entries, width, axes)


def _over_time(
    execution: Execution,
    labels: Sequence[str],
    columns: Columns,
    width: float,
    axes: Sequence[Axes],
) -> Figure:
    """Return one panel per column of a function of the states."""
    n = len(labels)
    across = 2 if is_wide(width) and n > 1 else 1
    panels = panels_of(width, n, height=max(1.25, 2.0 / n), columns=across, axes=axes)
    paths, looks = drawn_paths(execution), looks_of(execution)
    values = [columns(path.states) for path in paths]
    turns = [_turns([one[:, column] for one in values]) for column in range(n)]
    # Velocities jump and have more extremes: the slowest state determines the duration of a swing.
    crowded = zip(turns, panels.widths, strict=True)
    fewest = min((count for count, room in crowded if count > _MOST_TURNS * room), default=0)
    for column, (ax, label, room) in enumerate(zip(panels, labels, panels.widths, strict=True)):
        drawn = [one[:, column] for one in values]
        if turns[column] > _MOST_TURNS * room:
            _draw_envelope(ax, paths, drawn, min(round(_BINS * room), fewest // _TURNS_A_BIN))
        else:
            for path, one in zip(paths, drawn, strict=True):
                ax.plot(path.times, one, **looks.path(path))
        ax.margins(y=0.14)
        ax.autoscale_view()
        _mark_phases(ax, execution, looks, room)
        _mark_zeno_points(ax, execution, columns, column, room)
        _mark_events(ax, execution, looks, room)
        ax.set(ylabel=label, xlim=(execution.arcs[0].start_time, _end(execution)))
    return panels.finished(TIME)


def _turns(drawn: Sequence[Vector]) -> int:
    """Return the number of visible maxima and minima of a motion."""
    values = np.concatenate(drawn)
    levels = np.round(_LEVELS * (values - np.min(values)) / (np.ptp(values) or 1.0))
    slopes = np.sign(np.diff(levels))
    slopes = slopes[slopes != 0.0]
    return int(np.count_nonzero(slopes[1:] != slopes[:-1]))


def _draw_envelope(ax: Axes, paths: Sequence[ArcPath], drawn: Sequence[Vector], bins: int) -> None:
    """Draw the least and the largest value of each of many short intervals."""
    times, values = np.concatenate([path.times for path in paths]), np.concatenate(drawn)
    edges = np.linspace(float(times[0]), float(times[-1]), bins + 1)
    # Each interval begins with the last sample before it, so that none is empty.
    starts = np.maximum(np.searchsorted(times, edges[:-1], side="right") - 1, 0)
    ends = np.searchsorted(times, edges[1:], side="right")
    low = [float(np.min(values[a:b])) for a, b in zip(starts, ends, strict=True)]
    high = [float(np.max(values[a:b])) for a, b in zip(starts, ends, strict=True)]
    middles = [edges[0], *(edges[:-1] + edges[1:]) / 2, edges[-1]]
    ax.fill_between(middles, [low[0], *low, low[-1]], [high[0], *high, high[-1]], **_ENVELOPE)


def _mark_phases(ax: Axes, execution: Execution, looks: Looks, room: float) -> None:
    """Shade phases in the colours of their closed stops, one above the other."""
    phases = drawn_phases_of(execution)
    if len(phases) > _MOST_EVENTS * room:
        return
    for phase in phases:
        tints = looks.tints(phase)
        for k, tint in enumerate(tints):
            bottom, top = k / len(tints), (k + 1) / len(tints)
            look: dict[str, Any] = {"color": tint, "lw": 0, "gid": phase.mode.value}
            ax.axvspan(phase.start, phase.end, bottom, top, **look)


def _mark_zeno_points(
    ax: Axes, execution: Execution, columns: Columns, column: int, room: float
) -> None:
    """Mark Zeno points, unless there are too many phases to be seen."""
    if len(drawn_phases_of(execution)) <= _MOST_EVENTS * room:
        for zeno in execution.zeno_points:
            value = columns(zeno.state[None, :])[0, column]
            ax.plot(zeno.time, value, label="Zeno point", **ZENO)


def _mark_events(ax: Axes, execution: Execution, looks: Looks, room: float) -> None:
    """Mark impacts by ticks and switches by lines, unless there are too many to be seen."""
    edge = ax.get_xaxis_transform()
    impacts: dict[tuple[str, str], list[float]] = {}
    for impact in execution.impacts:
        impacts.setdefault(looks.impact(impact), []).append(impact.time)
    if _is_clear([impact.time for impact in execution.impacts], execution, room):
        for (colour, label), times in impacts.items():
            ax.vlines(times, 0.91, 1.0, color=colour, lw=0.8, transform=edge, gid="impact")
            ax.plot([], [], color=colour, ls="", marker="|", ms=7, label=label)
    if _is_clear([switch.time for switch in execution.switches], execution, room):
        for switch in execution.switches:
            look = looks.switch(switch)
            ax.axvline(switch.time, lw=0.9, zorder=1.8, gid="switch", **look)


def _is_clear(times: Sequence[float], execution: Execution, room: float) -> bool:
    """Return True if there are events, and few enough to be drawn singly."""
    return bool(times) and _apart(times, execution) <= _MOST_EVENTS * room


def _apart(times: Sequence[float], execution: Execution) -> int:
    """Return the number of distinguishable events. Events that accumulate at a point count once."""
    shares = np.array(times) / (execution.end_time - execution.arcs[0].start_time)
    return len(np.unique(np.floor(_PLACES * shares)))


def _end(execution: Execution) -> float:
    """Return the end of a figure, which is later if an event at the end would be on its edge."""
    start, end = execution.arcs[0].start_time, execution.end_time
    last = max([start, *(one.time for one in (*execution.impacts, *execution.switches))])
    return end + _EDGE * (end - start) if last > end - _EDGE * (end - start) else end
