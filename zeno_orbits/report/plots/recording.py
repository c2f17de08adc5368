# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""Recordings over an orbit by phase, and transients beside the fitted motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.experiment import (
    Comparison,
    Deviations,
    FittedTrial,
    PeriodTable,
    Portrait,
    TransientFit,
    measurable,
    recorded_portraits_of,
)
from zeno_orbits.model import Problem
from zeno_orbits.report.plots.panels import is_wide, panels_of
from zeno_orbits.report.plots.style import FULL_WIDTH, INK, TEXT, TINTS
from zeno_orbits.report.symbols import label_of, quantity_label
from zeno_orbits.simulation import Mode

_ORBIT: dict[str, Any] = {"color": "#56B4E9", "lw": 2.4, "label": "orbit", "zorder": 2}
_DATA: dict[str, Any] = {"color": "black", "lw": 0.8, "label": "mean over cycles", "zorder": 3}
"""The orbit wide and light, so that the recording is seen on top of it."""
_DOTS: dict[str, Any] = {"color": "#777777", "ls": "", "marker": "."}
_SPREAD: dict[str, Any] = {"color": "#777777", "alpha": 0.4, "lw": 0, "label": "spread"}
_MOST_DOTS = 4000


def plot_comparison(
    problem: Problem,
    found: Comparison,
    *,
    width: float = FULL_WIDTH,
    axes: Sequence[Axes] = (),
) -> Figure:
    """Return a recording over an orbit, signal by signal, and its portraits.

    Left: the samples folded into one period, their mean and the orbit. Right: the mean deviation
    and the standard deviation of the samples around it. Phases are shaded, and impacts are dashed.
    Each motion is drawn in units of its own period. The two periods are printed above.

    Args:
        problem: The problem.
        found: The comparison, which must have an alignment.
        width: Width of the picture [in].
        axes: Axes to draw into, two per signal and one per portrait, by default on a new figure.

    Raises:
        InputError: If the recording is not periodic, so that nothing can be drawn.
    """
    deviations, where = found.deviations, found.where
    if deviations is None or where is None:
        raise InputError("Argument `found` lacks deviations to draw.")
    portraits = recorded_portraits_of(problem, found.signals)
    n, across = len(found.signals), 2 if is_wide(width) else 1
    heights = [1.25] * (2 * n // across) + [2.2] * -(-len(portraits) // across)
    panels = panels_of(width, 2 * n + len(portraits), height=heights, columns=across, axes=axes)
    periods = f"orbit {deviations.table.period:.6g} s, recording {where.period:.6g} s"
    panels.axes[0].set_title(f"period: {periods}", size=TEXT)
    panels.axes[1].set_title("recording less orbit", size=TEXT)
    time = found.recording.time
    chosen = np.unique(np.linspace(0, len(time) - 1, min(len(time), _MOST_DOTS)).astype(np.int64))
    sampled = (chosen, np.mod(where.phases(time[chosen]), 1.0))
    for k, name in enumerate(found.signals):
        left, right = panels.axes[2 * k : 2 * k + 2]
        _draw_signal(left, found, deviations, k, sampled)
        _draw_deviation(right, deviations, k)
        left.set_ylabel(_label(problem, name))
        right.set_ylabel(f"deviation [{measurable(problem)[name]}]")
        for ax in (left, right):
            _shade(ax, deviations.table)
            last = k == n - 1 or not panels.is_own
            ax.tick_params(labelbottom=last)
            if last:
                ax.set_xlabel(f"phase from {_start_of(found)} [own periods]")
    for ax, portrait in zip(panels.axes[2 * n :], portraits, strict=True):
        _draw_portrait(ax, problem, deviations, portrait)
    return panels.finished()


def _start_of(found: Comparison) -> str:
    """Return the event at which the orbit's period starts."""
    return "release" if found.orbit.has_phases else found.orbit.section


def _draw_signal(
    ax: Axes,
    found: Comparison,
    deviations: Deviations,
    k: int,
    sampled: tuple[NDArray[np.int64], Vector],
) -> None:
    """Draw a signal over the phase: samples by index and phase, their mean, the orbit."""
    table, (chosen, phases) = deviations.table, sampled
    samples = found.recording.signal(found.signals[k]).values[chosen]
    ax.plot(phases, samples, ms=1.2, zorder=1, **_DOTS)
    ax.plot([], [], ms=5.0, label=found.recording.label, **_DOTS)
    ax.plot(table.nodes.times / table.period, table.nodes.values[:, k], **_ORBIT)
    ax.plot(deviations.phases, deviations.orbit[:, k] + deviations.average[:, k], **_DATA)


def _draw_deviation(ax: Axes, found: Deviations, k: int) -> None:
    mean, spread = found.average[:, k], found.spread[:, k]
    ax.fill_between(found.phases, mean - spread, mean + spread, **_SPREAD)
    ax.plot(found.phases, mean, **_DATA)
    ax.axhline(0.0, color=_ORBIT["color"], lw=_ORBIT["lw"], zorder=1)


def _shade(ax: Axes, table: PeriodTable) -> None:
    """Shade the phases in contact and the other phases, and mark the impacts."""
    ax.axvspan(0.0, 1.0, color=TINTS[Mode.FREE], lw=0, zorder=0)
    for one in (one for own in table.sequences.values() for one in own):
        for time in one.impacts:
            at = time % table.period / table.period
            ax.axvline(at, color=INK, lw=0.5, ls=(0, (3, 2)), zorder=1)
        if one.zeno is not None and one.release is not None:
            begin = one.zeno % table.period / table.period
            end = begin + (one.release - one.zeno) / table.period
            # A contact beyond the end of the period continues at its start.
            for turn in (0.0, 1.0):
                span = (max(begin - turn, 0.0), min(end - turn, 1.0))
                if span[0] < span[1]:
                    ax.axvspan(*span, color=TINTS[Mode.LOCKED], lw=0, zorder=0)
    ax.set_xlim(0.0, 1.0)


def _draw_portrait(ax: Axes, problem: Problem, deviations: Deviations, portrait: Portrait) -> None:
    axes, _ = deviations.columns(portrait)
    ax.plot(*deviations.table.nodes.values[:, axes].T, **_ORBIT)
    points = deviations.curve(portrait)
    closed: Vector = np.concatenate([points, points[:1]])
    ax.plot(*closed.T, **_DATA)
    first, second = portrait.signals
    ax.set(xlabel=_label(problem, first), ylabel=_label(problem, second))


def _label(problem: Problem, name: str) -> str:
    if name in problem.state_names:
        return label_of(problem, problem.state_names.index(name))
    return quantity_label(name, measurable(problem)[name])


_MOST_TRIALS = 12
"""Trials that are drawn. A picture of more is not legible."""
_MILLI = 1e3


def plot_transient(
    found: TransientFit, *, width: float = FULL_WIDTH, axes: Sequence[Axes] = ()
) -> Figure:
    """Return transients beside the fitted motion, with the deviations.

    Left: the samples and the fitted motion. Right: recorded minus fitted. Samples beside impacts
    that do not count are gray. Impacts of the fitted motion are dashed. Event times have one panel,
    recorded minus fitted times over time.

    Args:
        found: The fit.
        width: Width of the picture [in].
        axes: Axes to draw into, two per signal and one per trial with event times, by default on a
            new figure.

    Raises:
        InputError: If there is nothing to draw.
    """
    trials = found.trials[:_MOST_TRIALS]
    signals = [(one, k) for one in trials for k in range(len(one.names))]
    events = [one for one in trials if len(one.event_times)]
    n = 2 * len(signals) + len(events)
    if not n:
        raise InputError("Argument `found` has neither signals nor event times to draw.")
    panels = panels_of(width, n, height=1.5, columns=2, axes=axes)
    for place, (one, k) in enumerate(signals):
        left, right = panels.axes[2 * place : 2 * place + 2]
        _draw_trial(left, right, one, k)
    for ax, one in zip(panels.axes[2 * len(signals) :], events, strict=True):
        ax.plot(one.event_times, _MILLI * one.event_rests, "k.", ms=4)
        ax.axhline(0.0, color="#777777", lw=0.6)
        ax.set_ylabel("event time minus fit [ms]")
        ax.set_xlabel("time [s]")
        ax.set_title(one.label, size=TEXT)
    return panels.finished()


def _draw_trial(left: Axes, right: Axes, one: FittedTrial, k: int) -> None:
    """Draw a signal of a trial, and its deviation from the fitted motion."""
    counts = one.seen[:, k] > 0.0
    off = one.recorded[:, k] - one.fitted[:, k]
    left.plot(one.time, one.recorded[:, k], ".", color="#777777", ms=2.5, label="recording")
    left.plot(one.time, one.fitted[:, k], color="#0072B2", lw=1.0, label="fitted motion")
    right.plot(one.time[~counts], off[~counts], ".", color="#bbbbbb", ms=2.5)
    right.plot(one.time[counts], off[counts], ".", color="black", ms=2.5)
    right.axhline(0.0, color="#777777", lw=0.6)
    size = float(np.max(np.abs(off[counts]), initial=0.0)) or 1.0
    right.set_ylim(-1.2 * size, 1.2 * size)
    left.set_ylabel(quantity_label(one.names[k], one.units[k]))
    right.set_ylabel(f"deviation [{one.units[k]}]")
    left.set_title(one.label, size=TEXT)
    right.set_title("recording minus fitted motion", size=TEXT)
    for ax in (left, right):
        ax.set_xlabel("time [s]")
        for time in one.impacts:
            ax.axvline(float(time), color="#777777", lw=0.4, ls="--")
