# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The neighbourhood of a Zeno point (the paper's Figs. 5b and 5d)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from zeno_orbits.model import GraphDynamics, HybridDynamics, Problem, unit_quotient
from zeno_orbits.report.plots.looks import UNNAMED
from zeno_orbits.report.plots.panels import panels_of
from zeno_orbits.report.plots.style import (
    ARCS,
    BEFORE,
    FULL_WIDTH,
    JUMP,
    LAW,
    TEXT,
    ZENO,
)
from zeno_orbits.report.zeno_neighbourhood import CloseUp, close_up
from zeno_orbits.simulation import Execution, Mode
from zeno_orbits.work import checked

_REMAINING = r"time to Zeno point $t_\infty - t$ [s]"


@checked
def plot_zeno_neighbourhood(
    problem: Problem,
    execution: Execution,
    dynamics: HybridDynamics | GraphDynamics,
    *,
    width: float = FULL_WIDTH,
    axes: Sequence[Axes] = (),
) -> Figure:
    """Return the neighbourhood of the last Zeno point.

    The first panel shows the gap over time. The second panel shows the gap over the time left to
    the Zeno point, on logarithmic axes, on which the flights are self-similar. The third panel
    shows the impact speeds over that time, with the first-order law of ``zeno.tail_time``. If a
    single impact reaches the Zeno point, this sequence does not exist. Then the gap rate over the
    gap replaces the last two panels.

    Args:
        problem: The problem.
        execution: An execution with a Zeno point.
        dynamics: The system that was simulated.
        width: Width of the picture [in].
        axes: Axes to draw into, one per panel, by default on a new figure.

    Raises:
        InputError: If the execution does not reach a Zeno point.
    """
    zoom, unit = close_up(execution, dynamics), problem.gap_unit
    draws: list[Callable[[Axes, CloseUp, str], None]] = [_draw_gap]
    draws += [_draw_flights, _draw_speeds] if zoom.flights else [_draw_closing]
    panels = panels_of(width, len(draws), height=2.1, axes=axes)
    for ax, draw in zip(panels, draws, strict=True):
        draw(ax, zoom, unit)
    return panels.finished()


def _draw_gap(ax: Axes, zoom: CloseUp, unit: str) -> None:
    first, end = zoom.impacts[0].time, zoom.zeno.time
    length = end - first if zoom.flights else 0.3 * (end - zoom.arcs[0].start_time)
    start = first - (0.1 if zoom.flights else 1.0) * length
    highest = 0.0
    for arc in zoom.arcs:
        times, gaps = zoom.gaps(arc)
        ax.plot(times, gaps, **ARCS[arc.mode])
        shown = times >= (first if zoom.flights else start)
        highest = float(np.max(gaps[shown & (times <= end)], initial=highest))
    for offsets, gaps in zoom.tail():
        ax.plot(end + offsets, gaps, **LAW)
    ax.plot(end, 0.0, label="Zeno point", **ZENO)
    ax.set(xlim=(start, min(end + 0.25 * length, zoom.arcs[-1].end_time + 0.05 * length)))
    ax.set(xlabel="time $t$ [s]", ylabel=_gap_label(zoom, unit))
    ax.set_ylim(-0.05 * highest, 1.1 * highest)


def _draw_flights(ax: Axes, zoom: CloseUp, unit: str) -> None:
    end = zoom.zeno.time
    resolved = [(times - end, gaps) for times, gaps in map(zoom.gaps, zoom.flights)]
    law = zoom.tail()
    peaks = [float(max(gaps)) for _, gaps in (*resolved, *law)]
    lowest = 0.05 * min(peaks)
    for flights, look in ((resolved, ARCS[Mode.FREE]), (law, LAW)):
        for offsets, gaps in flights:
            gaps[[0, -1]] = 0.0
            seen = offsets < 0.0
            ax.plot(-offsets[seen], np.maximum(gaps[seen], 0.1 * lowest), **look)
    _logarithmic(ax)
    ax.set_ylim(lowest, 4 * max(peaks))
    ax.set(xlabel=_REMAINING, ylabel=_gap_label(zoom, unit))


def _draw_speeds(ax: Axes, zoom: CloseUp, unit: str) -> None:
    ax.plot(*zoom.law(zoom.tail()), **LAW)
    ax.plot(*zoom.speeds(), **BEFORE)
    e = zoom.dynamics.restitution
    ax.text(0.95, 0.92, f"$e$ = {e:g}", transform=ax.transAxes, ha="right", va="top", size=TEXT)
    _logarithmic(ax)
    ax.set(xlabel=_REMAINING, ylabel=rf"impact speed $|\dot h|$ [{unit_quotient(unit, 's')}]")


def _draw_closing(ax: Axes, zoom: CloseUp, unit: str) -> None:
    impact = zoom.impacts[-1]
    for arc in zoom.arcs:
        rates = [zoom.dynamics.gap_rate(state) for state in arc.sampled(160)[1]]
        ax.plot(zoom.gaps(arc)[1], rates, **ARCS[arc.mode])
    ax.plot([0.0, 0.0], [impact.approach_rate, 0.0], **JUMP)
    ax.plot(0.0, impact.approach_rate, **BEFORE)
    ax.plot(0.0, 0.0, label="Zeno point", **ZENO)
    ax.set(xlabel=_gap_label(zoom, unit), ylabel=rf"gap rate $\dot h$ [{unit_quotient(unit, 's')}]")


def _gap_label(zoom: CloseUp, unit: str) -> str:
    """Return the label of an axis that shows the gap, with the name of its stop."""
    words = "" if zoom.zeno.stop in ("", *UNNAMED) else f" of {zoom.zeno.stop}"
    return f"gap $h${words} [{unit}]"


def _logarithmic(ax: Axes) -> None:
    """Set both axes logarithmic, time running towards the Zeno point on the right."""
    ax.set(xscale="log", yscale="log")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(numticks=5))
        axis.set_minor_locator(NullLocator())
    ax.invert_xaxis()
