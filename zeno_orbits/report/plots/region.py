# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The region of Theorem 1: Zeno equilibria with d2h/dt2 < 0 (the paper's section IV)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import HybridDynamics, Problem, unit_quotient
from zeno_orbits.report.paths import drawn_paths
from zeno_orbits.report.plots.panels import panels_of
from zeno_orbits.report.plots.style import BLUES, FULL_WIDTH, LOOKS, ZENO, mark_completion
from zeno_orbits.report.symbols import label_of
from zeno_orbits.simulation import Execution, Mode
from zeno_orbits.work import checked


@checked
def plot_zeno_set(
    problem: Problem,
    dynamics: HybridDynamics,
    execution: Execution | None = None,
    *,
    width: float = 0.7 * FULL_WIDTH,
    axes: Sequence[Axes] = (),
) -> Figure:
    """Return the region of Zeno equilibria where d2h/dt2 < 0 (Theorem 1).

    The axes are the first coordinate that the stop leaves free and the first current, or that
    coordinate's velocity in a problem without current. Every other state is zero or determined by
    the stop. With a single coordinate the region is a curve over the current or the velocity.

    Args:
        problem: The problem.
        dynamics: The problem at fixed parameter values.
        execution: Execution whose contact phases, Zeno points and releases are drawn over the
            region.
        width: Width of the picture [in].
        axes: One panel to draw into, by default on a new figure.

    Raises:
        InputError: If the problem has constraints or a clock, because its equilibria do not fill
            such a plane.
    """
    if not has_zeno_region(dynamics):
        raise InputError(
            f"Argument `kind`: `{problem.name}` has a clock or a holonomic constraint, so its Zeno "
            "equilibria do not fill a plane (`region`). Choose another kind, such as `portraits`."
        )
    n_q, base = dynamics.n_q, _base(problem, dynamics)
    across = _free_coordinate(dynamics, base)
    up = 2 * n_q if len(problem.state_names) > 2 * n_q else n_q + (across or 0)
    panels = panels_of(width, 1, height=0.6 * width, axes=axes)
    (ax,) = panels
    speed_unit = unit_quotient(problem.gap_unit, "s")
    acceleration_unit = unit_quotient(speed_unit, "s").replace("^2", "$^2$")
    acceleration = rf"$\ddot h$ [{acceleration_unit}]"
    reach = _reach(problem, dynamics, execution, up)
    if across is None:
        _draw_curve(ax, dynamics, base, up, reach)
        ax.set(xlabel=label_of(problem, up), ylabel=acceleration)
    else:
        reaches = (_reach(problem, dynamics, execution, across), reach)
        filled = _draw_plane(ax, dynamics, base, (across, up), reaches)
        if filled is not None:
            panels.figure.colorbar(filled, ax=ax, pad=0.02).set_label(acceleration)
        ax.set(xlabel=label_of(problem, across), ylabel=label_of(problem, up))
    if execution is not None:
        _overlay_orbit(ax, dynamics, execution, across, up)
    return panels.finished()


def has_zeno_region(dynamics: HybridDynamics) -> bool:
    """Return True if the Zeno equilibria fill a plane of states: no constraint, no clock."""
    return not dynamics.holonomic(np.zeros(len(dynamics.state_names))).size


def _base(problem: Problem, dynamics: HybridDynamics) -> Vector:
    """Return zero if that is on the stop, else the coordinates of the problem's first start."""
    base = np.zeros(len(dynamics.state_names))
    if abs(dynamics.gap(base)) > 1e-12:
        base[: dynamics.n_q] = _starts(problem, dynamics)[0][: dynamics.n_q]
    return base


def _starts(problem: Problem, dynamics: HybridDynamics) -> Sequence[Sequence[float]]:
    """Return the starts of the problem at the values of its dynamics."""
    formulas = dynamics.formulas
    if formulas is None:
        return [problem.initial_state()]
    return formulas.system.starts(formulas.values)


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
    """Draw the region over a plane. An axis of currents grows until it shows the boundary."""

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
    ax.fill_between([], [], color=BLUES(0.6), label=r"$\ddot h < 0$")
    if highest > 0.0:
        ax.contour(columns, rows, field, levels=[0.0], colors="black", linewidths=1.2)
        ax.plot([], [], color="black", lw=1.2, label=r"$\ddot h = 0$")
    levels = np.asarray(MaxNLocator(7).tick_values(lowest, 0.0))
    return ax.contourf(columns, rows, field, levels=levels[levels <= 0.0], cmap=BLUES)


def _draw_curve(ax: Axes, dynamics: HybridDynamics, base: Vector, up: int, reach: float) -> None:
    grid = np.linspace(-reach, reach, 201)
    states = np.tile(_on_stop(dynamics, base, {}), (len(grid), 1))
    states[:, up] = grid
    values = np.array([dynamics.gap_acceleration(state) for state in states])
    ax.plot(grid, values, color="black", lw=1.2, label=r"$\ddot h$")
    ax.axhline(0.0, color="black", lw=0.6)
    look: dict[str, Any] = {"color": BLUES(0.6), "label": r"$\ddot h < 0$"}
    ax.fill_between(grid, values, 0.0, where=values < 0.0, **look)
    ax.margins(x=0.0, y=0.12)


def _overlay_orbit(
    ax: Axes, dynamics: HybridDynamics, execution: Execution, across: int | None, up: int
) -> None:
    if across is None:
        for zeno in execution.zeno_points:
            acceleration = dynamics.gap_acceleration(zeno.state)
            ax.plot(zeno.state[up], acceleration, label="Zeno point", **ZENO)
        return
    for path in drawn_paths(execution):
        if path.kind == Mode.LOCKED.value:
            ax.plot(*path.states[:, [across, up]].T, **LOOKS[path.kind])
    mark_completion(ax, execution, (across, up))


def _reach(
    problem: Problem, dynamics: HybridDynamics, execution: Execution | None, index: int
) -> float:
    """Return the range of an axis: half a turn, else the range of the execution or the starts."""
    if problem.state_units[index] == "rad":
        return math.pi
    if execution is not None:
        seen = np.concatenate([arc.sampled()[1][:, index] for arc in execution.arcs])
    else:
        seen = np.array(_starts(problem, dynamics))[:, index]
    return 1.2 * float(np.max(np.abs(seen), initial=0.0)) or 1.0
