# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""Families over their parameter: period, amplitude and spectral radius, and boundaries in two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zeno_orbits.continuation import (
    Continuation,
    Family,
    FamilyPoint,
    HeldFamilies,
    SpecialCurve,
    SpecialPointKind,
    orbit_amplitude,
)
from zeno_orbits.model import Problem
from zeno_orbits.report.plots.panels import panels_of
from zeno_orbits.report.plots.style import (
    COLUMN_WIDTH,
    FULL_WIDTH,
    INK,
    PALETTE,
)
from zeno_orbits.report.symbols import math_symbol, quantity_label

_DOUBLINGS = 4
"""Period doublings that have a colour of their own."""
_SPOT: dict[str, Any] = {"ls": "", "ms": 6.5, "mew": 1.0, "mec": INK, "zorder": 5}
_MARKS: dict[SpecialPointKind, dict[str, Any]] = {
    SpecialPointKind.FOLD: {"marker": "o", "mfc": "#F0E442"},
    SpecialPointKind.FLIP: {"marker": "D", "mfc": "#CC79A7", "ms": 5.5},
    SpecialPointKind.TORUS: {"marker": "h", "mfc": "#56B4E9"},
    SpecialPointKind.BRANCHING: {"marker": "P", "mfc": "#E69F00"},
    SpecialPointKind.LOCK_VANISHES: {"marker": "*", "mfc": "#F0E442", "ms": 10.0},
    SpecialPointKind.THEOREM_LOST: {"marker": "X", "mfc": "#56B4E9"},
    SpecialPointKind.GRAZING: {"marker": "v", "mfc": "#E69F00"},
    SpecialPointKind.EARLIER_GRAZING: {"marker": "^", "mfc": "#E69F00"},
    SpecialPointKind.RELEASE_LOST: {"marker": "s", "mfc": "#009E73", "ms": 5.5},
    SpecialPointKind.EARLIER_RELEASE: {"marker": "p", "mfc": "#009E73"},
    SpecialPointKind.EVENTS_MEET: {"marker": "d", "mfc": "#D55E00"},
    SpecialPointKind.SWITCH_LOST: {"marker": "s", "mfc": "#7F7F7F", "ms": 5.5},
    SpecialPointKind.SWITCH_ENTERS: {"marker": "d", "mfc": "#7F7F7F"},
    SpecialPointKind.ARMING: {"marker": "p", "mfc": "#7F7F7F"},
    SpecialPointKind.AMPLITUDE_ZERO: {"marker": "o", "mfc": "white"},
    SpecialPointKind.REJOINS: {"marker": ".", "mfc": INK},
    SpecialPointKind.GAVE_UP: {"marker": "x", "mfc": INK},
}


def plot_families(
    found: Continuation,
    problem: Problem,
    *,
    width: float = FULL_WIDTH,
    axes: Sequence[Axes] = (),
) -> Figure:
    """Return solution branches over their parameter, stable parts solid, unstable parts dashed.

    The panels are period, amplitude and spectral radius. A period that a clock keeps constant has
    no panel.

    Args:
        found: The continuation.
        problem: The problem, for units.
        width: Width of the picture [in].
        axes: Panels to draw into, three or with a constant period two, by default on a new figure.
    """
    main = found.families[0]
    unit = problem.state_units[problem.state_names.index(problem.amplitude_of)]
    symbol = math_symbol(problem.amplitude_of, problem.state_names)
    quantities: list[tuple[str, Callable[[FamilyPoint], float]]] = [
        ("period [s]", lambda point: point.period),
        (f"amplitude of {symbol} [{unit}]", _amplitudes(found, problem)),
        ("spectral radius [1]", lambda point: point.spectral_radius),
    ]
    if _has_constant_period(found):
        del quantities[0]
    panels = panels_of(width, len(quantities), height=2.3, axes=axes)
    for ax, (label, value) in zip(panels, quantities, strict=True):
        for family in found.families:
            doublings = family.n_returns.bit_length() - 1
            _draw(ax, family, value, PALETTE[doublings % _DOUBLINGS])
        ax.set(xlabel=_named(problem, main.parameter), ylabel=label)
        ax.margins(0.06)
        ax.ticklabel_format(useOffset=False)
        _hide_rounding(ax)
    _show_radii(panels.axes[-1], found)
    for ax, (_, value) in zip(panels, quantities, strict=True):
        _mark_all(ax, found, value)
    return panels.finished()


def plot_held_families(
    held: HeldFamilies,
    problem: Problem,
    *,
    width: float = FULL_WIDTH,
    axes: Sequence[Axes] = (),
) -> Figure:
    """Return families over their parameter: attracting, repelling, and kept by feedback.

    The panels are the period, the spectral radius without and with feedback, and the effort of the
    feedback.

    Args:
        held: The families with their feedbacks.
        problem: The problem, for units.
        width: Width of the picture [in].
        axes: Three panels to draw into, by default on a new figure.
    """
    main = held.found.families[0]
    panels = panels_of(width, 3, height=2.3, axes=axes)
    period, radius, effort = panels
    values: tuple[Callable[[FamilyPoint], float], ...] = (
        lambda point: point.period,
        lambda point: point.spectral_radius,
    )
    for family, points in zip(held.found.families, held.points, strict=True):
        for ax, value in zip((period, radius), values, strict=True):
            _draw(ax, family, value, PALETTE[0])
        kept = [point for point in points if not point.reason]
        at = [point.value for point in kept]
        dots: dict[str, Any] = {"ls": "", "marker": ".", "ms": 5.0, "color": PALETTE[1]}
        dots["label"] = "kept by feedback"
        period.plot(at, [point.period for point in kept], **dots)
        radius.plot(at, [point.held_radius for point in kept], **dots)
        effort.plot(at, [point.effort for point in kept], **dots)
    labels = ("period [s]", "spectral radius [1]", "effort [1]")
    for ax, label in zip(panels, labels, strict=True):
        ax.set(xlabel=_named(problem, main.parameter), ylabel=label)
        ax.margins(0.06)
        ax.ticklabel_format(useOffset=False)
    effort.set_ylim(bottom=0.0)
    _show_radii(radius, held.found)
    return panels.finished()


def plot_boundaries(
    found: Continuation,
    problem: Problem,
    *,
    width: float = COLUMN_WIDTH,
    axes: Sequence[Axes] = (),
) -> Figure:
    """Return the bifurcation curves in the plane of two parameters.

    Args:
        found: The continuation, with at least one bifurcation curve.
        problem: The problem, for units.
        width: Width of the picture [in].
        axes: One panel to draw into, by default on a new figure.
    """
    panels = panels_of(width, 1, height=0.75 * width, axes=axes)
    (ax,) = panels
    _draw_boundaries(ax, found.boundaries)
    names = found.boundaries[0].names
    ax.set(xlabel=_named(problem, names[0]), ylabel=_named(problem, names[1]))
    return panels.finished()


_BOUNDARIES: dict[SpecialPointKind, tuple[str, Any]] = {
    SpecialPointKind.FOLD: ("#0072B2", "-"),
    SpecialPointKind.FLIP: ("#CC79A7", "-"),
    SpecialPointKind.TORUS: ("#56B4E9", "-"),
    SpecialPointKind.LOCK_VANISHES: ("#D55E00", "--"),
    SpecialPointKind.AMPLITUDE_ZERO: ("#009E73", ":"),
    SpecialPointKind.GRAZING: ("#E69F00", "-."),
    SpecialPointKind.EARLIER_GRAZING: ("#E69F00", (0, (1, 1))),
    SpecialPointKind.RELEASE_LOST: (INK, "-."),
    SpecialPointKind.EARLIER_RELEASE: (INK, ":"),
}


def _draw_boundaries(ax: Axes, boundaries: tuple[SpecialCurve, ...]) -> None:
    """Draw boundaries into axes, a colour and a dash a kind."""
    for boundary in boundaries:
        colour, dash = _BOUNDARIES.get(boundary.kind, (INK, "--"))
        ax.plot(boundary.x, boundary.y, color=colour, ls=dash, lw=1.4, label=boundary.kind.value)
        for k in boundary.cusps:
            ax.plot(
                [boundary.x[k]],
                [boundary.y[k]],
                ls="",
                marker="o",
                ms=4.5,
                color=colour,
                label="cusp",
            )


_MOST_RADIUS = 3.0


def _show_radii(ax: Axes, found: Continuation) -> None:
    """Draw the spectral radius, and keep 1 in view if multipliers diverge at an end."""
    ax.axhline(1.0, color=INK, lw=0.6, ls=(0, (1, 2)), zorder=1)
    largest = max(p.spectral_radius for family in found.families for p in family.points)
    ax.set_ylim(-0.04 * min(largest, _MOST_RADIUS), min(1.08 * max(largest, 1.0), _MOST_RADIUS))


def _hide_rounding(ax: Axes) -> None:
    """Widen the axis of a quantity that does not change, so that its rounding is not seen."""
    values = np.concatenate([np.asarray(line.get_ydata(), dtype=np.float64) for line in ax.lines])
    low, high = float(np.min(values)), float(np.max(values))
    if high - low < _CONSTANT * abs(high):
        ax.set_ylim(0.9 * low, 1.1 * high)


def _has_constant_period(found: Continuation) -> bool:
    """Return True if the period changes by its error alone."""
    periods = [point.period for family in found.families for point in family.points]
    return max(periods) - min(periods) < _CONSTANT * max(periods)


_CONSTANT = 1e-6
"""Relative change of a quantity below which it is an error of the computation."""


def _draw(ax: Axes, family: Family, value: Callable[[FamilyPoint], float], colour: str) -> None:
    """Draw a family piece by piece of one stability, ends included, neighbours joined."""
    # A flip at which a family begins is an orbit of half its period, marked on the other family.
    root = [] if family.first.kind is SpecialPointKind.FLIP else [family.first.at]
    points = [*root, *family.points, family.last.at]
    returns = "" if family.n_returns == 1 else f", {family.n_returns} returns"
    for stable, group in groupby(range(len(points)), key=lambda k: _is_stable(points[k])):
        piece = list(group)
        drawn = points[max(piece[0] - 1, 0) : piece[-1] + 1]
        ax.plot(
            [point.value for point in drawn],
            [value(point) for point in drawn],
            color=colour,
            lw=1.4,
            ls="-" if stable else (0, (3, 1.5)),
            label=f"{'stable' if stable else 'unstable'}{returns}",
        )


def _is_stable(point: FamilyPoint) -> bool:
    return point.stable


def _mark_all(ax: Axes, found: Continuation, value: Callable[[FamilyPoint], float]) -> None:
    low, high = ax.get_ylim()
    for family in found.families:
        for special in family.named:
            rooted = special is family.first and special.kind is SpecialPointKind.FLIP
            place = value(special.at)
            # A value that is unknown or outside the panel cannot be marked.
            if special.kind in _MARKS and not rooted and low <= place <= high:
                look = _SPOT | _MARKS[special.kind]
                ax.plot(special.at.value, place, label=special.kind.value, clip_on=False, **look)
    ax.set_ylim(low, high)


def _amplitudes(found: Continuation, problem: Problem) -> Callable[[FamilyPoint], float]:
    """Return the amplitude of each point, simulated once."""
    known = {
        id(point): orbit_amplitude(problem, family, point)
        for family in found.families
        for point in (*family.points, *(special.at for special in family.named))
    }
    return lambda point: known[id(point)]


def _named(problem: Problem, name: str) -> str:
    return quantity_label(name, problem.quantity(name).unit)
