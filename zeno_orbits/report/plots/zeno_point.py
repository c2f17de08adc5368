# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The neighbourhood of a Zeno point (the paper's Figs. 5b and 5d)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from zeno_orbits.errors import InputError
from zeno_orbits.model import GraphDynamics, HybridDynamics, Problem, unit_quotient
from zeno_orbits.report.plots.looks import UNNAMED, Looks, looks_of
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
from zeno_orbits.report.zeno_neighbourhood import CloseUp, close_ups
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
    """Return the neighbourhood of the last Zeno point of every stop, one row per stop.

    The first panel of a row shows the gap over time. The second panel shows the gap over the time
    left to the Zeno point, on logarithmic axes, on which the flights are self-similar. The third
    panel shows the impact speeds over that time, with the first-order law of ``zeno.tail_time``. If
    a single impact reaches the Zeno point, this sequence does not exist. Then the gap rate over the
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
    zooms, unit, looks = close_ups(execution, dynamics), problem.gap_unit, looks_of(execution)
    if not zooms:
        raise InputError("Argument `execution` lacks a Zeno point.")
    many: list[Callable[[Axes, CloseUp, str, Looks], None]]
    many, single = [_draw_gap, _draw_flights, _draw_speeds], [_draw_gap, _draw_closing]
    rows = [many if zoom.flights else single for zoom in zooms]
    counts = [len(draws) for draws in rows]
    panels = panels_of(width, sum(counts), height=2.1, rows=counts, axes=axes)
    drawn = [(zoom, draw) for zoom, draws in zip(zooms, rows, strict=True) for draw in draws]
    for ax, (zoom, draw) in zip(panels, drawn, strict=True):
        draw(ax, zoom, unit, looks)
    return panels.finished()


def _draw_gap(ax: Axes, zoom: CloseUp, unit: str, looks: Looks) -> None:
    first, end = zoom.impacts[0].time, zoom.zeno.time
    length = end - first if zoom.flights else 0.3 * (end - zoom.arcs[0].start_time)
    start = first - (0.1 if zoom.flights else 1.0) * length
    highest = 0.0
    for arc in zoom.arcs:
        times, gaps = zoom.gaps(arc)
        ax.plot(times, gaps, **looks.arc(arc.mode.value, arc.closed))
        shown = times >= (first if zoom.flights else start)
        highest = float(np.max(gaps[shown & (times <= end)], initial=highest))
    for offsets, gaps in zoom.tail():
        ax.plot(end + offsets, gaps, **LAW)
    ax.plot(end, 0.0, label="Zeno point", **ZENO)
    ax.set(xlim=(start, min(end + 0.25 * length, zoom.arcs[-1].end_time + 0.05 * length)))
    ax.set(xlabel="time $t$ [s]", ylabel=f"gap $h${_of_stop(zoom)} [{unit}]")
    ax.set_ylim(-0.05 * highest, 1.1 * highest)


def _draw_flights(ax: Axes, zoom: CloseUp, unit: str, _looks: Looks) -> None:
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
    ax.set(xlabel=_REMAINING, ylabel=f"gap $h${_of_stop(zoom)} [{unit}]")


def _draw_speeds(ax: Axes, zoom: CloseUp, unit: str, _looks: Looks) -> None:
    ax.plot(*zoom.law(zoom.tail()), **LAW)
    ax.plot(*zoom.speeds(), **BEFORE)
    e = zoom.dynamics.restitution
    ax.text(0.95, 0.92, f"$e$ = {e:g}", transform=ax.transAxes, ha="right", va="top", size=TEXT)
    _logarithmic(ax)
    speed = unit_quotient(unit, "s")
    ax.set(xlabel=_REMAINING, ylabel=rf"impact speed $|\dot h|${_of_stop(zoom)} [{speed}]")


def _draw_closing(ax: Axes, zoom: CloseUp, unit: str, looks: Looks) -> None:
    impact = zoom.impacts[-1]
    for arc in zoom.arcs:
        rates = [zoom.dynamics.gap_rate(state) for state in arc.sampled(160)[1]]
        ax.plot(zoom.gaps(arc)[1], rates, **looks.arc(arc.mode.value, arc.closed))
    ax.plot([0.0, 0.0], [impact.approach_rate, 0.0], **JUMP)
    ax.plot(0.0, impact.approach_rate, **BEFORE)
    ax.plot(0.0, 0.0, label="Zeno point", **ZENO)
    ax.set(xlabel=f"gap $h${_of_stop(zoom)} [{unit}]")
    ax.set(ylabel=rf"gap rate $\dot h${_of_stop(zoom)} [{unit_quotient(unit, 's')}]")


def _of_stop(zoom: CloseUp) -> str:
    """Return the words that add the name of a stop to a label, if it has a name."""
    return "" if zoom.zeno.stop in ("", *UNNAMED) else f" of {zoom.zeno.stop}"


def _logarithmic(ax: Axes) -> None:
    """Set both axes logarithmic, time running towards the Zeno point on the right."""
    ax.set(xscale="log", yscale="log")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(numticks=5))
        axis.set_minor_locator(NullLocator())
    ax.invert_xaxis()
