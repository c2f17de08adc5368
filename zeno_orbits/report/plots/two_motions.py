# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The Zeno model with another motion beside it: a rig's or a recording's (the paper's Fig. 5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment import Counterpart
from zeno_orbits.model import HybridDynamics, Problem
from zeno_orbits.report.plots.orbit import drawn_phases_of
from zeno_orbits.report.plots.style import (
    ARCS,
    COLUMN_WIDTH,
    JUMP,
    TEXT,
    TINTS,
    ZENO,
    add_legend,
    label_of,
    panels_of,
    paths_of,
    portraits_of,
    share_time,
)
from zeno_orbits.report.zeno_neighbourhood import close_up
from zeno_orbits.simulation import Execution, Mode

_OTHER: dict[str, Any] = {"color": "black", "lw": 0.7, "zorder": 3.5}
_MODEL: dict[Mode, dict[str, Any]] = {
    Mode.FREE: ARCS[Mode.FREE] | {"lw": 2.0, "color": "#56B4E9", "label": "Zeno model, free"},
    Mode.LOCKED: ARCS[Mode.LOCKED] | {"lw": 3.2, "label": "Zeno model, locked"},
}
"""Wide, so that the other motion is seen on top; told apart by shade and width in grey, too."""
_TIME = "time since a release [s]"
_CLOSER = 15.0
"""Factor by which the gap is enlarged to show the contact with the stop."""


def plot_beside_over_time(
    problem: Problem,
    execution: Execution,
    counterpart: Counterpart,
    *,
    width: float = COLUMN_WIDTH,
) -> Figure:
    """Return the coordinates of both motions over time, the model's locked phases shaded.

    Args:
        problem: The problem.
        execution: The model's motion from a release on.
        counterpart: The other motion, from a release on.
        width: Width of the picture [in].
    """
    figure, panels = _coordinates(problem, execution, width)
    for row, ax in enumerate(panels):
        for times, states, look in _paths(execution):
            ax.plot(times, states[:, row], **look)
        ax.plot(counterpart.times, counterpart.states[:, row], label=counterpart.label, **_OTHER)
        ax.set(xlim=(0.0, execution.end_time))
    share_time(figure, panels, _TIME)
    add_legend(figure, width)
    return figure


def plot_beside_by_phase(
    problem: Problem,
    execution: Execution,
    counterpart: Counterpart,
    *,
    width: float = COLUMN_WIDTH,
) -> Figure:
    """Return the coordinates of both motions over the phase, each in periods of its own.

    What is left of a difference is one of shape; that of the periods stands above, in numbers. All
    cycles of the other motion are drawn on top of each other.

    Args:
        problem: The problem.
        execution: The model's motion over one period from its release on.
        counterpart: The other motion, from a release on.
        width: Width of the picture [in].
    """
    own = execution.end_time
    figure, panels = _coordinates(problem, execution, width, unit=own)
    phases, numbers = np.modf(counterpart.times / counterpart.period)
    ends = [*np.flatnonzero(np.diff(numbers) > 0.0) + 1]
    for row, ax in enumerate(panels):
        for times, states, look in _paths(execution):
            ax.plot(times / own, states[:, row], **look)
        # A cycle's last sample and the next one's first are no line across the picture.
        x, y = (np.insert(one, ends, math.nan) for one in (phases, counterpart.states[:, row]))
        ax.plot(x, y, label=counterpart.label, **_OTHER)
        ax.set(xlim=(0.0, 1.0))
    periods = f"own periods: model {own:.5g} s, other {counterpart.period:.5g} s"
    panels[0].set_title(periods, size=TEXT)
    share_time(figure, panels, "phase from release [own periods]")
    add_legend(figure, width)
    return figure


def plot_beside_impacts(
    problem: Problem,
    dynamics: HybridDynamics,
    execution: Execution,
    counterpart: Counterpart,
    *,
    width: float = COLUMN_WIDTH,
) -> Figure:
    """Return the gap of both motions from the first impact of a period to beyond its release.

    Above, the axis holds the rebounds, and the great flight before them leaves it at the top; below
    it is enlarged, for what takes the place of the locked phase in the other motion.

    Args:
        problem: The problem.
        dynamics: It at the orbit's numbers.
        execution: The model's motion over one period or more; the first one is shown.
        counterpart: The other motion.
        width: Width of the picture [in].
    """
    figure, panels = panels_of(width, 2, height=1.4, columns=1)
    first, release = execution.impacts[0].time, _first_release(execution)
    window = (first - 0.12 * (release - first), release + 0.12 * (release - first))
    zeno, label = execution.zeno_points[0], f"gap $h$ [{problem.gap_unit}]"
    for ax, closer in zip(panels, (1.0, _CLOSER), strict=True):
        highest = _draw_gaps(ax, dynamics, execution, counterpart, first, window) / closer
        ax.plot(zeno.time, 0.0, label="Zeno point", **ZENO)
        ax.axhline(0.0, color="black", lw=0.4, zorder=1)
        ax.set(xlim=window, ylim=(-0.25 * highest * closer**0.5, 1.25 * highest), ylabel=label)
    share_time(figure, panels, _TIME)
    add_legend(figure, width)
    return figure


def plot_beside_portraits(
    problem: Problem,
    execution: Execution,
    counterpart: Counterpart,
    *,
    width: float = COLUMN_WIDTH,
) -> Figure:
    """Return the phase portraits of both motions.

    Args:
        problem: The problem; its ``portraits`` say what is drawn against what.
        execution: The model's motion.
        counterpart: The other motion.
        width: Width of the picture [in].
    """
    figure, panels = portraits_of(problem, width, height=2.0)
    for ax, pair in panels:
        for _, states, look in _paths(execution):
            ax.plot(*states[:, pair].T, **look)
        for impact in execution.impacts:
            ax.plot(*np.array([impact.state_minus[pair], impact.state_plus[pair]]).T, **JUMP)
        ax.plot(*counterpart.states[:, pair].T, label=counterpart.label, **_OTHER)
        for zeno in execution.zeno_points:
            ax.plot(*zeno.state[pair], label="Zeno point", **ZENO)
    add_legend(figure, width)
    return figure


def plot_beside_zeno_point(
    problem: Problem,
    dynamics: HybridDynamics,
    execution: Execution,
    counterpart: Counterpart,
    *,
    width: float = COLUMN_WIDTH,
) -> Figure:
    """Return gap rate over gap of both motions near the Zeno point, which is the origin.

    Args:
        problem: The problem.
        dynamics: It at the orbit's numbers.
        execution: The model's motion.
        counterpart: The other motion.
        width: Width of the picture [in].
    """
    figure, (ax,) = panels_of(width, 1, height=2.2)
    unit, zoom = problem.gap_unit, close_up(execution, dynamics)
    for _, states, look in _paths(execution):
        gaps, rates = _gap_and_rate(dynamics, states)
        ax.plot(gaps, rates, **look)
    for impact in execution.impacts:
        rate = impact.approach_rate
        ax.plot([0.0, 0.0], [rate, -dynamics.restitution * rate], **JUMP)
    gaps, rates = _gap_and_rate(dynamics, counterpart.states)
    ax.plot(gaps, rates, label=counterpart.label, **_OTHER)
    ax.plot(0.0, 0.0, label="Zeno point", **ZENO)
    fast = dynamics.restitution * -zoom.impacts[0].approach_rate
    # Of the rebounds; where there are none, of the last part of the flight.
    high = max((float(np.max(zoom.gaps(arc)[1])) for arc in zoom.flights), default=0.0)
    if high == 0.0:
        high = 0.1 * max(float(np.max(zoom.gaps(arc)[1])) for arc in zoom.arcs)
        fast = -zoom.impacts[0].approach_rate
    ax.set(xlim=(-0.25 * high, 1.15 * high), ylim=(-1.6 * fast, 1.25 * fast))
    ax.set(xlabel=f"gap $h$ [{unit}]", ylabel=rf"gap rate $\dot h$ [{unit}/s]")
    add_legend(figure, width)
    return figure


def _coordinates(
    problem: Problem, execution: Execution, width: float, unit: float = 1.0
) -> tuple[Figure, list[Axes]]:
    """Return a panel a coordinate over time in some unit, the model's locked phases shaded."""
    n_q = problem.model(problem.symbols()).n_q
    figure, panels = panels_of(width, n_q, height=1.15, columns=1)
    for row, ax in enumerate(panels):
        for mode, start, end in drawn_phases_of(execution):
            word = "locked phase" if mode is Mode.LOCKED else None
            ax.axvspan(
                start / unit, end / unit, color=TINTS[mode], lw=0, gid=mode.value, label=word
            )
        ax.set(ylabel=label_of(problem, row))
    return figure, panels


def _paths(execution: Execution) -> list[tuple[Vector, Vector, dict[str, Any]]]:
    """Return times, states and look of every arc of the model."""
    looks = {id(look): _MODEL[mode] for mode, look in ARCS.items()}
    return [(t, x, looks.get(id(look), _MODEL[Mode.FREE])) for t, x, look in paths_of(execution)]


def _draw_gaps(
    ax: Axes,
    dynamics: HybridDynamics,
    execution: Execution,
    counterpart: Counterpart,
    first: float,
    window: Sequence[float],
) -> float:
    """Draw both gaps over a window of time, and return the highest of the model's rebounds."""
    highest = 0.0
    for times, states, look in _paths(execution):
        gaps, _ = _gap_and_rate(dynamics, states)
        seen = (times >= window[0]) & (times <= window[1])
        ax.plot(times[seen], gaps[seen], **look)
        rebound = seen & (times >= first) & (times <= execution.zeno_points[0].time)
        highest = float(np.max(gaps[rebound], initial=highest))
    seen = (counterpart.times >= window[0]) & (counterpart.times <= window[1])
    gaps, _ = _gap_and_rate(dynamics, counterpart.states[seen])
    ax.plot(counterpart.times[seen], gaps, label=counterpart.label, **_OTHER)
    return highest or float(np.nanmax(gaps, initial=1e-300))


def _gap_and_rate(dynamics: HybridDynamics, states: Vector) -> tuple[Vector, Vector]:
    """Return gaps and their rates along states, NaN where a coordinate or velocity is not known."""
    n = 2 * dynamics.n_q
    gaps, rates = np.full(len(states), math.nan), np.full(len(states), math.nan)
    for k, state in enumerate(states):
        if np.all(np.isfinite(state[:n])):
            known = np.nan_to_num(state[: len(dynamics.state_names)])
            gaps[k], rates[k] = dynamics.gap(known), dynamics.gap_rate(known)
    return gaps, rates


def _first_release(execution: Execution) -> float:
    zeno = execution.zeno_points[0].time
    return next((r.time for r in execution.releases if r.time > zeno), execution.end_time)
