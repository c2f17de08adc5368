# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""Pictures of executions and of the region of Theorem 1: values in, a ``Figure`` out.

No pyplot and no global settings, so a picture looks the same wherever it is drawn. Every function
takes a width in inches: ``COLUMN_WIDTH`` stacks the panels for one column of a paper,
``FULL_WIDTH`` sets them side by side. The colours are those of Okabe and Ito.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.errors import InputError
from zeno_orbits.execution import Arc, Ending, Execution, Impact, Mode, ZenoPoint
from zeno_orbits.problem import Problem

COLUMN_WIDTH = 3.4
"""Width of one column of a paper [in]."""
FULL_WIDTH = 7.0
"""Width of a page of two columns [in]."""

_TEXT = 8.0
_INK = "#333333"
_TINTS = {Mode.FREE: "#E3F0F8", Mode.LOCKED: "#FBE0CE"}
_BLUES = LinearSegmentedColormap.from_list("depth", ["#3C8DC0", "#E6F2F9"])
_ARCS: dict[Mode, dict[str, Any]] = {
    Mode.FREE: {"color": "#0072B2", "lw": 1.2, "label": "free arc"},
    Mode.LOCKED: {"color": "#D55E00", "lw": 1.8, "label": "locked arc", "zorder": 2.5},
}
_TAIL: dict[str, Any] = _ARCS[Mode.FREE] | {"ls": ":", "label": "Zeno tail, summed"}
_LAW: dict[str, Any] = {"color": "#E69F00", "lw": 1.4, "label": "first-order law"}
_JUMP: dict[str, Any] = {"color": _INK, "lw": 0.8, "ls": (0, (4, 2)), "label": "reset"}
_SPOT: dict[str, Any] = {"ls": "", "marker": "o", "mec": _INK, "mew": 0.8, "zorder": 4}
_BEFORE: dict[str, Any] = _SPOT | {
    "ms": 4.2,
    "mfc": "none",
    "label": "before impact",
    "gid": "impact",
}
_AFTER: dict[str, Any] = _SPOT | {"ms": 2.2, "mfc": _INK, "label": "after impact"}
_RELEASE: dict[str, Any] = _SPOT | {
    "marker": "s",
    "ms": 6.5,
    "mec": "#009E73",
    "mew": 1.4,
    "mfc": "none",
}
_ZENO: dict[str, Any] = _SPOT | {"marker": "*", "ms": 8, "mew": 0.6, "mfc": "#F0E442", "zorder": 5}
_REMAINING = r"time to Zeno point $t_\infty - t$ [s]"
_GREEK = ("alpha", "beta", "gamma", "delta", "theta", "phi", "varphi", "psi", "eta", "xi", "omega")


def plot_portraits(problem: Problem, execution: Execution, *, width: float = FULL_WIDTH) -> Figure:
    """Return the phase portraits of a scene: arcs by mode, resets, Zeno points, releases.

    Args:
        problem: The scene; its ``portraits`` say what is drawn against what.
        execution: What to draw.
        width: Width of the picture [in].
    """
    pairs = [[problem.state_names.index(name) for name in pair] for pair in problem.portraits]
    figure, panels = _panels(width, len(pairs), height=2.5)
    impacts = execution.impacts
    for ax, pair in zip(panels, pairs, strict=True):
        for _, states, look in _paths(execution):
            ax.plot(*states[:, pair].T, **look)
        if impacts:
            before = np.array([impact.state_minus[pair] for impact in impacts]).T
            after = np.array([impact.state_plus[pair] for impact in impacts]).T
            ax.plot(*np.stack([before, after], axis=1), **_JUMP)
            ax.plot(*after, **_AFTER)
            ax.plot(*before, **_BEFORE)
        _mark_completion(ax, execution, pair)
        ax.set(xlabel=_label(problem, pair[0]), ylabel=_label(problem, pair[1]))
    _add_legend(figure, width)
    return figure


def plot_time_series(
    problem: Problem, execution: Execution, *, width: float = FULL_WIDTH
) -> Figure:
    """Return coordinates and currents over time, phases shaded, impacts as ticks on the upper edge.

    Args:
        problem: The scene.
        execution: What to draw.
        width: Width of the picture [in].
    """
    n_q = problem.model(problem.symbols()).n_q
    rows = [*range(n_q), *range(2 * n_q, len(problem.state_names))]
    figure, panels = _panels(width, len(rows), height=max(1.25, 2.0 / len(rows)), columns=1)
    impacts = [impact.time for impact in execution.impacts]
    for ax, row in zip(panels, rows, strict=True):
        for mode, start, end in _phases(execution):
            ax.axvspan(start, end, color=_TINTS[mode], lw=0, gid=mode.value)
        for times, states, look in _paths(execution):
            ax.plot(times, states[:, row], **look)
        ax.margins(y=0.14)
        ax.autoscale_view()
        edge = ax.get_xaxis_transform()
        ax.vlines(impacts, 0.91, 1.0, color=_INK, lw=0.8, transform=edge, gid="impact")
        if impacts:
            ax.plot([], [], color=_INK, ls="", marker="|", ms=7, label="impact")
        ax.set(ylabel=_label(problem, row), xlim=(execution.arcs[0].start_time, execution.end_time))
        ax.tick_params(labelbottom=ax is panels[-1])
    panels[-1].set_xlabel("time $t$ [s]")
    figure.align_ylabels(panels)
    _add_legend(figure, width)
    return figure


def plot_zeno_zoom(
    problem: Problem, execution: Execution, dynamics: HybridDynamics, *, width: float = FULL_WIDTH
) -> Figure:
    """Return the neighbourhood of the last Zeno point.

    The gap over time; the gap over the time left to the Zeno point, on logarithmic axes, on which
    the flights repeat themselves; the impact speeds over that time, with the first-order law of
    ``zeno.tail_time``. Where a single impact reaches the Zeno point there is no such sequence, and
    the gap rate over the gap takes the place of the last two.

    Args:
        problem: The scene.
        execution: It reaches a Zeno point.
        dynamics: The system that was simulated.
        width: Width of the picture [in].

    Raises:
        InputError: If the execution reaches no Zeno point.
    """
    zoom = _zoom(problem, execution, dynamics)
    draws: list[Callable[[Axes, _Zoom], None]] = [_draw_gap]
    draws += [_draw_flights, _draw_speeds] if zoom.flights else [_draw_closing]
    figure, panels = _panels(width, len(draws), height=2.1)
    for ax, draw in zip(panels, draws, strict=True):
        draw(ax, zoom)
    _add_legend(figure, width)
    return figure


def plot_zeno_region(
    problem: Problem,
    dynamics: HybridDynamics,
    execution: Execution | None = None,
    *,
    width: float = 0.7 * FULL_WIDTH,
) -> Figure:
    """Return the region of Zeno equilibria where d2h/dt2 < 0 (Theorem 1).

    It lies over the first coordinate that the stop leaves free and the first current, or that
    coordinate's velocity in a scene without current; every other state is zero or as the stop
    demands. With a single coordinate it shrinks to a curve over the current or the velocity.

    Args:
        problem: The scene.
        dynamics: The scene at fixed numbers.
        execution: Its locked arcs, Zeno points and releases are laid over the region.
        width: Width of the picture [in].

    Raises:
        InputError: If the scene has holonomic constraints; its equilibria fill no such plane.
    """
    if dynamics.holonomic(np.zeros(len(dynamics.state_names))).size:
        raise InputError(
            "Argument `problem` must have no holonomic constraints to show its Zeno equilibria "
            f"in a plane, but `{problem.name}` has some."
        )
    n_q, base = dynamics.n_q, _base(problem, dynamics)
    across = _free_coordinate(dynamics, base)
    up = 2 * n_q if len(problem.state_names) > 2 * n_q else n_q + (across or 0)
    figure, (ax,) = _panels(width, 1, height=0.6 * width)
    acceleration = rf"$\ddot h$ [{_gap_unit(problem, dynamics)}/s$^2$]"
    reach = _reach(problem, execution, up)
    if across is None:
        _draw_curve(ax, dynamics, base, up, reach)
        ax.set(xlabel=_label(problem, up), ylabel=acceleration)
    else:
        reaches = (_reach(problem, execution, across), reach)
        filled = _draw_plane(ax, dynamics, base, (across, up), reaches)
        if filled is not None:
            figure.colorbar(filled, ax=ax, pad=0.02).set_label(acceleration)
        ax.set(xlabel=_label(problem, across), ylabel=_label(problem, up))
    if execution is not None:
        _overlay_orbit(ax, dynamics, execution, across, up)
    _add_legend(figure, width)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a picture as PNG, PDF or SVG, whole or not at all, the same bytes every time.

    Args:
        figure: The picture.
        path: Where; the suffix says the format.

    Raises:
        InputError: If the suffix is another one.
    """
    dates: dict[str, dict[str, Any]] = {".png": {}, ".pdf": {"CreationDate": None}}
    dates[".svg"] = {"Date": None}
    suffix = path.suffix.lower()
    if suffix not in dates:
        message = f"Argument `output` must end in .png, .pdf or .svg, but it is `{path.name}`."
        raise InputError(message)
    partial = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{suffix}")
    try:
        with mpl.rc_context({"pdf.fonttype": 42, "svg.hashsalt": "zeno_orbits"}):
            figure.savefig(partial, format=suffix[1:], dpi=300, metadata=dates[suffix])
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Zoom:
    """The last Zeno point, the impacts and flights that lead to it, all arcs but the tail."""

    arcs: tuple[Arc, ...]
    dynamics: HybridDynamics
    zeno: ZenoPoint
    impacts: tuple[Impact, ...]
    flights: tuple[Arc, ...]
    unit: str

    def gaps(self, arc: Arc) -> tuple[Vector, Vector]:
        """Return times and gaps along an arc, the latter without negative rounding."""
        times, states = _sampled(arc, 160)
        return times, np.array([max(self.dynamics.gap(state), 0.0) for state in states])

    def tail(self) -> list[tuple[Vector, Vector]]:
        """Return times and gaps of flights left out, by the first-order law: to 1/50 in speed."""
        e, pull = self.dynamics.restitution, -self.dynamics.gap_acceleration(self.zeno.state)
        n = math.ceil(math.log(0.02, e)) if self.zeno.tail > 0.0 else 0
        fractions = _ends_dense(160)
        flights: list[tuple[Vector, Vector]] = []
        for speed in self.zeno.last_speed * e ** np.arange(n):
            times = self.zeno.time + (2 * speed / pull) * (fractions - 1 / (1 - e))
            flights.append((times, 2 * speed**2 / pull * fractions * (1 - fractions)))
        return flights


def _zoom(problem: Problem, execution: Execution, dynamics: HybridDynamics) -> _Zoom:
    if not execution.zeno_points:
        raise InputError("Argument `execution` must reach a Zeno point, but it reaches none.")
    zeno = execution.zeno_points[-1]
    begin = max((r.time for r in execution.releases if r.time < zeno.time), default=0.0)
    impacts = tuple(event for event in execution.impacts if begin <= event.time <= zeno.time)
    resolved = [arc for arc in execution.arcs if arc.ending is not Ending.ZENO]
    arcs = tuple(arc for arc in resolved if arc.start_time >= begin)
    return _Zoom(
        arcs=arcs,
        dynamics=dynamics,
        zeno=zeno,
        impacts=impacts,
        flights=tuple(arc for arc in arcs if impacts[0].time <= arc.start_time < zeno.time),
        unit=_gap_unit(problem, dynamics),
    )


def _draw_gap(ax: Axes, zoom: _Zoom) -> None:
    first, end = zoom.impacts[0].time, zoom.zeno.time
    length = end - first if zoom.flights else 0.3 * (end - zoom.arcs[0].start_time)
    start = first - (0.1 if zoom.flights else 1.0) * length
    highest = 0.0
    for arc in zoom.arcs:
        times, gaps = zoom.gaps(arc)
        ax.plot(times, gaps, **_ARCS[arc.mode])
        shown = times >= (first if zoom.flights else start)
        highest = float(np.max(gaps[shown & (times <= end)], initial=highest))
    for times, gaps in zoom.tail():
        ax.plot(times, gaps, **_LAW)
    ax.plot(end, 0.0, label="Zeno point", **_ZENO)
    ax.set(xlim=(start, min(end + 0.25 * length, zoom.arcs[-1].end_time + 0.05 * length)))
    ax.set(xlabel="time $t$ [s]", ylabel=f"gap $h$ [{zoom.unit}]")
    ax.set_ylim(-0.05 * highest, 1.1 * highest)


def _draw_flights(ax: Axes, zoom: _Zoom) -> None:
    resolved, law = [zoom.gaps(arc) for arc in zoom.flights], zoom.tail()
    peaks = [float(max(gaps)) for _, gaps in (*resolved, *law)]
    lowest = 0.05 * min(peaks)
    for flights, look in ((resolved, _ARCS[Mode.FREE]), (law, _LAW)):
        for times, gaps in flights:
            gaps[[0, -1]] = 0.0
            seen = times < zoom.zeno.time
            ax.plot(zoom.zeno.time - times[seen], np.maximum(gaps[seen], 0.1 * lowest), **look)
    _logarithmic(ax)
    ax.set_ylim(lowest, 4 * max(peaks))
    ax.set(xlabel=_REMAINING, ylabel=f"gap $h$ [{zoom.unit}]")


def _draw_speeds(ax: Axes, zoom: _Zoom) -> None:
    e, pull = zoom.dynamics.restitution, -zoom.dynamics.gap_acceleration(zoom.zeno.state)
    seen = [impact for impact in zoom.impacts if impact.time < zoom.zeno.time]
    remaining = np.array([zoom.zeno.time - impact.time for impact in seen])
    ends = [zoom.zeno.time - times[0] for times, _ in zoom.tail()]
    reach = np.array([remaining[0], min(ends, default=remaining[-1])])
    ax.plot(reach, pull * (1 - e) / (2 * e) * reach, **_LAW)
    ax.plot(remaining, [-impact.approach_rate for impact in seen], **_BEFORE)
    ax.text(0.95, 0.92, f"$e$ = {e:g}", transform=ax.transAxes, ha="right", va="top", size=_TEXT)
    _logarithmic(ax)
    ax.set(xlabel=_REMAINING, ylabel=rf"impact speed $|\dot h|$ [{zoom.unit}/s]")


def _draw_closing(ax: Axes, zoom: _Zoom) -> None:
    impact = zoom.impacts[-1]
    for arc in zoom.arcs:
        rates = [zoom.dynamics.gap_rate(state) for state in _sampled(arc, 160)[1]]
        ax.plot(zoom.gaps(arc)[1], rates, **_ARCS[arc.mode])
    ax.plot([0.0, 0.0], [impact.approach_rate, 0.0], **_JUMP)
    ax.plot(0.0, impact.approach_rate, **_BEFORE)
    ax.plot(0.0, 0.0, label="Zeno point", **_ZENO)
    ax.set(xlabel=f"gap $h$ [{zoom.unit}]", ylabel=rf"gap rate $\dot h$ [{zoom.unit}/s]")


def _base(problem: Problem, dynamics: HybridDynamics) -> Vector:
    """Return zero if that is on the stop, else the coordinates of the scene's first start."""
    base = np.zeros(len(dynamics.state_names))
    if problem.starts and abs(dynamics.gap(base)) > 1e-12:
        base[: dynamics.n_q] = problem.state_vector(problem.starts[0])[: dynamics.n_q]
    return base


def _on_stop(dynamics: HybridDynamics, base: Vector, chosen: Mapping[int, float]) -> Vector:
    """Return the base with the chosen entries, the others moved onto the stop, or else NaN."""
    n_q, x = dynamics.n_q, base.copy()
    x[list(chosen)] = list(chosen.values())
    for _ in range(20):
        gap, rate = dynamics.gap(x), dynamics.gap_rate(x)
        if abs(gap) < 1e-12 and abs(rate) < 1e-12:
            return x
        still = np.where(np.arange(len(x)) // n_q == 1, 0.0, x)
        units = np.eye(len(x))[n_q : 2 * n_q]
        normal = np.array([dynamics.gap_rate(still + unit) for unit in units])
        for shift, value in ((0, gap), (n_q, rate)):
            moved = [k for k in range(n_q) if k + shift not in chosen]
            slope = float(normal[moved] @ normal[moved])
            x[np.array(moved, dtype=int) + shift] -= value * normal[moved] / (slope or math.nan)
    return np.full_like(x, math.nan)


def _free_coordinate(dynamics: HybridDynamics, base: Vector) -> int | None:
    for k in range(dynamics.n_q):
        aside = [_on_stop(dynamics, base, {k: base[k] + step}) for step in (-0.01, 0.01)]
        if np.all(np.isfinite(aside)):
            return k
    return None


def _draw_plane(
    ax: Axes,
    dynamics: HybridDynamics,
    base: Vector,
    plane: tuple[int, int],
    reaches: tuple[float, float],
) -> ContourSet | None:
    """Draw the region over a plane; an axis of currents grows until it shows the boundary."""

    def spread(rows: Vector) -> Vector:
        chosen = [[dict(zip(plane, (a, b), strict=True)) for a in columns] for b in rows]
        states = [[_on_stop(dynamics, base, pair) for pair in row] for row in chosen]
        values = np.apply_along_axis(dynamics.gap_acceleration, -1, np.array(states))
        return np.ma.masked_invalid(values)

    columns, reach = np.linspace(-reaches[0], reaches[0], 101), reaches[1]
    if plane[1] == 2 * dynamics.n_q:
        zero, one = spread(np.array([0.0, 1.0]))
        boundary = 1.2 * float(np.max(np.abs(zero)) / max(np.min(np.abs(one - zero)), 1e-12))
        reach = boundary if reach < boundary < 20 * reach else reach
    rows = np.linspace(-reach, reach, 101)
    field = spread(rows)
    lowest, highest = float(np.min(field)), float(np.max(field))
    if lowest >= 0.0:
        return None
    ax.fill_between([], [], color=_BLUES(0.6), label=r"$\ddot h < 0$")
    if highest > 0.0:
        ax.contour(columns, rows, field, levels=[0.0], colors="black", linewidths=1.2)
        ax.plot([], [], color="black", lw=1.2, label=r"$\ddot h = 0$")
    levels = np.asarray(MaxNLocator(7).tick_values(lowest, 0.0))
    return ax.contourf(columns, rows, field, levels=levels[levels <= 0.0], cmap=_BLUES)


def _draw_curve(ax: Axes, dynamics: HybridDynamics, base: Vector, up: int, reach: float) -> None:
    grid = np.linspace(-reach, reach, 201)
    states = np.tile(_on_stop(dynamics, base, {}), (len(grid), 1))
    states[:, up] = grid
    values = np.array([dynamics.gap_acceleration(state) for state in states])
    ax.plot(grid, values, color="black", lw=1.2, label=r"$\ddot h$")
    ax.axhline(0.0, color="black", lw=0.6)
    look: dict[str, Any] = {"color": _BLUES(0.6), "label": r"$\ddot h < 0$"}
    ax.fill_between(grid, values, 0.0, where=values < 0.0, **look)
    ax.margins(x=0.0, y=0.12)


def _overlay_orbit(
    ax: Axes, dynamics: HybridDynamics, execution: Execution, across: int | None, up: int
) -> None:
    if across is None:
        for zeno in execution.zeno_points:
            acceleration = dynamics.gap_acceleration(zeno.state)
            ax.plot(zeno.state[up], acceleration, label="Zeno point", **_ZENO)
        return
    for _, states, look in _paths(execution):
        if look is _ARCS[Mode.LOCKED]:
            ax.plot(*states[:, [across, up]].T, **look)
    _mark_completion(ax, execution, (across, up))


def _reach(problem: Problem, execution: Execution | None, index: int) -> float:
    """Return how far an axis goes: half a turn, else what the execution or the starts need."""
    if problem.state_units[index] == "rad":
        return math.pi
    if execution is not None:
        seen = np.concatenate([_sampled(arc)[1][:, index] for arc in execution.arcs])
    else:
        seen = np.array([problem.state_vector(start)[index] for start in problem.starts])
    return 1.2 * float(np.max(np.abs(seen), initial=0.0)) or 1.0


def _ends_dense(n: int) -> Vector:
    return (1 - np.cos(np.linspace(0, np.pi, n))) / 2


def _sampled(arc: Arc, n: int = 60) -> tuple[Vector, Vector]:
    """Return times and states along an arc, close where it ends and where the integrator slowed."""
    stride = max(len(arc.steps) // (2 * n), 1)
    stops = [arc.time_unit * step.start for step in arc.steps[::stride]]
    times = arc.start_time + np.union1d(_ends_dense(n) * (arc.end_time - arc.start_time), stops)
    times = times[times < arc.end_time].tolist()
    states = [*(arc.state_at(time) for time in times), arc.end_state]
    return np.array([*times, arc.end_time]), np.array(states)


def _phases(execution: Execution) -> list[tuple[Mode, float, float]]:
    """Return mode, start and end of every phase; a Zeno tail belongs to the flights before it."""
    starts = [execution.arcs[0]]
    starts += [arc for last, arc in pairwise(execution.arcs) if arc.mode is not last.mode]
    times = [*(arc.start_time for arc in starts), execution.end_time]
    return [(arc.mode, *ends) for arc, ends in zip(starts, pairwise(times), strict=True)]


def _paths(execution: Execution) -> list[tuple[Vector, Vector, dict[str, Any]]]:
    """Return times, states and look of every arc; Zeno tails too short to see are left out."""
    paths: list[tuple[Vector, Vector, dict[str, Any]]] = []
    least = 0.004 * (execution.end_time - execution.arcs[0].start_time)
    for arc in execution.arcs:
        if arc.ending is not Ending.ZENO:
            paths.append((*_sampled(arc), _ARCS[arc.mode]))
        elif arc.end_time - arc.start_time > least:
            paths.append((*_sampled(arc, 2), _TAIL))
    return paths


def _mark_completion(ax: Axes, execution: Execution, pair: Sequence[int]) -> None:
    for release in execution.releases:
        ax.plot(*release.state[list(pair)], label="release", **_RELEASE)
    for zeno in execution.zeno_points:
        ax.plot(*zeno.state[list(pair)], label="Zeno point", **_ZENO)


def _label(problem: Problem, index: int) -> str:
    return f"{_symbol(problem.state_names, index)} [{problem.state_units[index]}]"


def _symbol(names: Sequence[str], index: int) -> str:
    """Return a state's name as it is written in a formula; a word stays a word."""
    name = names[index]
    dotted = name[0] == "d" and name[1:] in names
    stem = name[1:] if dotted else name
    base = stem.rstrip("0123456789")
    number = stem[len(base) :]
    letter = {"current": "i"}.get(base, rf"\{base}" if base in _GREEK else base)
    if len(letter) > 1 and letter[0] != "\\":
        return f"rate of {stem}" if dotted else name
    letter = rf"\dot{{{letter}}}" if dotted else letter
    return f"${letter}_{{{number}}}$" if number else f"${letter}$"


def _gap_unit(problem: Problem, dynamics: HybridDynamics) -> str:
    """Return the unit of the coordinates whose sum or difference the gap is, else only ``SI``."""
    n_q, units = dynamics.n_q, set[str]()
    for k in range(n_q):
        velocity = np.zeros(len(dynamics.state_names))
        velocity[n_q + k] = 1.0
        shifted = velocity + 0.3 * (np.arange(len(velocity)) < n_q)
        slopes = {abs(dynamics.gap_rate(x)) for x in (velocity, shifted)}
        if slopes - {0.0}:
            units.add(problem.state_units[k] if slopes == {1.0} else "SI")
    return units.pop() if len(units) == 1 else "SI"


def _panels(
    width: float, n: int, *, height: float, columns: int | None = None
) -> tuple[Figure, list[Axes]]:
    """Return a figure of equal panels, side by side on a page and stacked in a column."""
    across = columns or (min(n, 3) if width > 1.5 * COLUMN_WIDTH else 1)
    down = -(-n // across)
    figure = Figure(figsize=(width, height * down + 0.5), layout="constrained")
    panels = [figure.add_subplot(down, across, k + 1) for k in range(n)]
    return figure, panels


def _logarithmic(ax: Axes) -> None:
    """Set both axes logarithmic, time running towards the Zeno point on the right."""
    ax.set(xscale="log", yscale="log")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(numticks=5))
        axis.set_minor_locator(NullLocator())
    ax.invert_xaxis()


def _add_legend(figure: Figure, width: float) -> None:
    """Set every text to one size and put a legend of what is drawn above the panels."""
    entries: dict[str, Any] = {}
    for ax in figure.axes:
        ax.tick_params(which="both", labelsize=_TEXT - 1)
        for text in (ax.xaxis.label, ax.yaxis.label):
            text.set_fontsize(_TEXT)
        handles, labels = ax.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    sizes = [0.42 + 0.047 * len(label) for label in entries]
    rows = 1
    while (
        rows < len(sizes)
        and sum(max(sizes[k : k + rows]) for k in range(0, len(sizes), rows)) > width
    ):
        rows += 1
    figure.legend(
        entries.values(),
        entries.keys(),
        loc="outside upper center",
        ncols=math.ceil(len(entries) / rows),
        fontsize=_TEXT - 0.5,
        frameon=False,
        handlelength=1.5,
        handletextpad=0.5,
        columnspacing=1.2,
    )
