# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The Zeno model compared with another motion, of a rig or a recording (the paper's Fig. 5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment import MatchedRun
from zeno_orbits.model import HybridDynamics, Problem, unit_quotient
from zeno_orbits.report.paths import drawn_paths, drawn_phases_of
from zeno_orbits.report.plots.panels import Panels, panels_of, portraits_of
from zeno_orbits.report.plots.style import ARCS, COLUMN_WIDTH, JUMP, TEXT, TINTS, ZENO
from zeno_orbits.report.symbols import label_of
from zeno_orbits.report.zeno_neighbourhood import close_ups
from zeno_orbits.simulation import Execution, Mode

_OTHER: dict[str, Any] = {"color": "black", "lw": 0.7, "zorder": 3.5}
_FREE = ARCS[Mode.FREE] | {"lw": 2.0, "color": "#56B4E9", "label": "Zeno model, free"}
_MODEL: dict[str, dict[str, Any]] = {
    "free": _FREE,
    "tail": _FREE,
    "locked": ARCS[Mode.LOCKED] | {"lw": 3.2, "label": "Zeno model, contact"},
}
"""A wide line, so that the other motion is visible on top. Shade and width differ in grey as
well."""
_TIME = "time since a release [s]"
_CLOSER = 15.0
"""Factor by which the gap is enlarged to show the contact with the stop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoMotions:
    """The motion of the model and another motion.

    Attributes:
        problem: The problem.
        dynamics: The problem at the orbit's parameter values.
        model: The model's motion, from a release.
        other: The other motion, from a release.
    """

    problem: Problem
    dynamics: HybridDynamics
    model: Execution
    other: MatchedRun


def plot_beside_over_time(two: TwoMotions, *, width: float = COLUMN_WIDTH) -> Figure:
    """Return the coordinates of both motions over time, the model's contact phases shaded."""
    panels = _coordinates(two, width)
    for row, ax in enumerate(panels):
        for path in drawn_paths(two.model):
            ax.plot(path.times, path.states[:, row], **_MODEL[path.kind])
        ax.plot(two.other.times, two.other.states[:, row], label=two.other.label, **_OTHER)
        ax.set(xlim=(0.0, two.model.end_time))
    return panels.finished(_TIME)


def plot_beside_by_phase(two: TwoMotions, *, width: float = COLUMN_WIDTH) -> Figure:
    """Return the coordinates of both motions over the phase, each in units of its own period.

    A visible difference is a difference in shape. The difference of the periods is printed above.
    All cycles of the other motion are drawn on top of each other.

    Args:
        two: The motions, the model's over one period.
        width: Width of the picture [in].
    """
    own, other = two.model.end_time, two.other
    panels = _coordinates(two, width, unit=own)
    phases, numbers = np.modf(other.times / other.period)
    ends = [*np.flatnonzero(np.diff(numbers) > 0.0) + 1]
    for row, ax in enumerate(panels):
        for path in drawn_paths(two.model):
            ax.plot(path.times / own, path.states[:, row], **_MODEL[path.kind])
        # The last sample of a cycle and the first sample of the next cycle are not connected by a
        # line.
        x, y = (np.insert(one, ends, math.nan) for one in (phases, other.states[:, row]))
        ax.plot(x, y, label=other.label, **_OTHER)
        ax.set(xlim=(0.0, 1.0))
    periods = f"own periods: model {own:.5g} s, other {other.period:.5g} s"
    panels.axes[0].set_title(periods, size=TEXT)
    return panels.finished("phase from release [own periods]")


def plot_beside_impacts(two: TwoMotions, *, width: float = COLUMN_WIDTH) -> Figure:
    """Return the gap of both motions from the first impact of a period to a time after its release.

    In the upper panel the axis contains the rebounds, and the long flight before them exceeds it.
    The lower panel is enlarged and shows the behaviour of the other motion during the contact
    phase.

    Args:
        two: The motions. The first period of the model is shown.
        width: Width of the picture [in].
    """
    panels = panels_of(width, 2, height=1.4, columns=1)
    first, release = two.model.impacts[0].time, _first_release(two.model)
    window = (first - 0.12 * (release - first), release + 0.12 * (release - first))
    zeno, label = two.model.zeno_points[0], f"gap $h$ [{two.problem.gap_unit}]"
    for ax, closer in zip(panels, (1.0, _CLOSER), strict=True):
        highest = _draw_gaps(ax, two, first, window) / closer
        ax.plot(zeno.time, 0.0, label="Zeno point", **ZENO)
        ax.axhline(0.0, color="black", lw=0.4, zorder=1)
        ax.set(xlim=window, ylim=(-0.25 * highest * closer**0.5, 1.25 * highest), ylabel=label)
    return panels.finished(_TIME)


def plot_beside_portraits(two: TwoMotions, *, width: float = COLUMN_WIDTH) -> Figure:
    """Return the phase portraits of both motions, as defined by the problem's ``portraits``."""
    panels, pairs = portraits_of(two.problem, width, height=2.0)
    for ax, pair in pairs:
        for path in drawn_paths(two.model):
            ax.plot(*path.states[:, pair].T, **_MODEL[path.kind])
        for impact in two.model.impacts:
            ax.plot(*np.array([impact.state_minus[pair], impact.state_plus[pair]]).T, **JUMP)
        ax.plot(*two.other.states[:, pair].T, label=two.other.label, **_OTHER)
        for zeno in two.model.zeno_points:
            ax.plot(*zeno.state[pair], label="Zeno point", **ZENO)
    return panels.finished()


def plot_beside_zeno_point(two: TwoMotions, *, width: float = COLUMN_WIDTH) -> Figure:
    """Return gap rate over gap of both motions near the Zeno point, which is the origin."""
    panels = panels_of(width, 1, height=2.2)
    (ax,) = panels
    unit, zoom = two.problem.gap_unit, close_ups(two.model, two.dynamics)[-1]
    for path in drawn_paths(two.model):
        ax.plot(*_gap_and_rate(two.dynamics, path.states), **_MODEL[path.kind])
    for impact in two.model.impacts:
        rate = impact.approach_rate
        ax.plot([0.0, 0.0], [rate, two.dynamics.speed_after(rate)], **JUMP)
    other = _gap_and_rate(two.dynamics, two.other.states)
    ax.plot(*other, label=two.other.label, **_OTHER)
    ax.plot(0.0, 0.0, label="Zeno point", **ZENO)
    fast = two.dynamics.speed_after(zoom.impacts[0].approach_rate)
    # The range of the rebounds, or without rebounds the range of the last part of the flight.
    high = max((float(np.max(zoom.gaps(arc)[1])) for arc in zoom.flights), default=0.0)
    if high == 0.0:
        high = 0.1 * max(float(np.max(zoom.gaps(arc)[1])) for arc in zoom.arcs)
        fast = -zoom.impacts[0].approach_rate
    ax.set(xlim=(-0.25 * high, 1.15 * high), ylim=(-1.6 * fast, 1.25 * fast))
    ax.set(xlabel=f"gap $h$ [{unit}]", ylabel=rf"gap rate $\dot h$ [{unit_quotient(unit, 's')}]")
    return panels.finished()


def _coordinates(two: TwoMotions, width: float, unit: float = 1.0) -> Panels:
    """Return one panel per coordinate over time in some unit, the model's contact phases shaded."""
    panels = panels_of(width, two.dynamics.n_q, height=1.15, columns=1)
    for row, ax in enumerate(panels):
        for phase in drawn_phases_of(two.model):
            word = "contact phase" if phase.mode is Mode.LOCKED else None
            look: dict[str, Any] = {"color": TINTS[phase.mode], "lw": 0, "gid": phase.mode.value}
            ax.axvspan(phase.start / unit, phase.end / unit, label=word, **look)
        ax.set(ylabel=label_of(two.problem, row))
    return panels


def _draw_gaps(ax: Axes, two: TwoMotions, first: float, window: Sequence[float]) -> float:
    """Draw both gaps over a window of time, and return the highest of the model's rebounds."""
    highest = 0.0
    for path in drawn_paths(two.model):
        gaps, _ = _gap_and_rate(two.dynamics, path.states)
        seen = (path.times >= window[0]) & (path.times <= window[1])
        ax.plot(path.times[seen], gaps[seen], **_MODEL[path.kind])
        rebound = seen & (path.times >= first) & (path.times <= two.model.zeno_points[0].time)
        highest = float(np.max(gaps[rebound], initial=highest))
    seen = (two.other.times >= window[0]) & (two.other.times <= window[1])
    gaps, _ = _gap_and_rate(two.dynamics, two.other.states[seen])
    ax.plot(two.other.times[seen], gaps, label=two.other.label, **_OTHER)
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
