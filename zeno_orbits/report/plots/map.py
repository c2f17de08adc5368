# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""A map as a picture: regions by colour, contours inside the region of Zeno orbits, boundaries."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.transforms import Bbox

from zeno_orbits.arrays import Vector
from zeno_orbits.maps import Attractor, Axis, Boundary, Fate, ParameterMap
from zeno_orbits.report.plots.style import COLUMN_WIDTH, FULL_WIDTH, INK, TEXT

_PERIODS = {1: "#4393C3", 2: "#009E73", 4: "#005A43", 8: "#5D3A9B"}
_OTHER_PERIOD = "#8C7AA9"
_PLAIN = {
    Fate.SIMPLE: "#A6D854",
    Fate.NO_ZENO: "#CC79A7",
    Fate.REST: "#FFFFFF",
    Fate.HELD: "#C6DBEF",
    Fate.FAILED: "#000000",
}
_ESCAPES = ("#D55E00", "#E69F00", "#8C510A", "#B2182B")
_UNSETTLED = "#F0E442"
_GROWING, _DYING = "#8F8F8F", "#DADADA"
_PERIOD: dict[str, Any] = {"colors": "black", "linewidths": 0.7}
_RADIUS: dict[str, Any] = {"colors": "white", "linewidths": 0.9, "linestyles": "dashed"}
_RADII = (0.2, 0.4, 0.6, 0.8, 0.9)
_BESIDE = 0.8
"""Part of a page from which on the legend stands beside the map, else below it."""
_SHAPE = {True: 0.5, False: 0.72}
"""Height over width, the legend below not counted."""
_ENTRY = 0.145
"""Height of an entry of the legend [in]."""
_TWO_COLUMNS = 1.3 * COLUMN_WIDTH
"""Width from which on the legend below has two columns [in]."""
_BOUNDARIES = ("-", "--", "-.", ":")


def plot_map(
    found: ParameterMap, *, boundaries: Sequence[Boundary] = (), width: float = 1.4 * COLUMN_WIDTH
) -> Figure:
    """Return a map as a picture.

    Args:
        found: The map.
        boundaries: Curves to draw on top.
        width: Width of the picture [in].
    """
    phrases = _phrases(found.attractors)
    beside = width >= _BESIDE * FULL_WIDTH
    height = _SHAPE[beside] * width
    figure = Figure(figsize=(width, height), layout="constrained")
    ax = figure.add_subplot()
    looks = {phrase: _colour(one, k) for phrase, (one, k) in phrases.items()}
    order = list(looks)
    codes = np.array([order.index(one.phrase) for one in found.attractors]).reshape(found.shape)
    ax.pcolormesh(
        *(np.array(axis.values()) for axis in (found.x, found.y)),
        codes,
        cmap=ListedColormap(list(looks.values())),
        vmin=-0.5,
        vmax=len(order) - 0.5,
        shading="nearest",
        rasterized=True,
    )
    edge: dict[str, Any] = {"edgecolor": INK, "linewidth": 0.4}
    handles: list[Any] = [
        Patch(facecolor=colour, label=phrase, **edge) for phrase, colour in looks.items()
    ]
    handles += _draw_contours(ax, found)
    handles += _draw_boundaries(ax, found, boundaries)
    ax.set_xlabel(_label(found.x), fontsize=TEXT)
    ax.set_ylabel(_label(found.y), fontsize=TEXT)
    ax.tick_params(labelsize=TEXT - 1)
    columns = 2 if width >= _TWO_COLUMNS and not beside else 1
    if not beside:
        figure.set_figheight(height + _ENTRY * (-(-len(handles) // columns) + 1))
    figure.legend(
        handles=handles,
        ncols=columns,
        columnspacing=1.0,
        loc="outside right upper" if beside else "outside lower center",
        fontsize=TEXT - 1,
        frameon=False,
        handlelength=2.6,
    )
    return figure


def _phrases(attractors: Sequence[Attractor]) -> dict[str, tuple[Attractor, int]]:
    """Return each phrase with an attractor it stands for and its number among escapes."""
    found: dict[str, Attractor] = {}
    for one in attractors:
        found.setdefault(one.phrase, one)
    fates = list(Fate)
    order = sorted(found, key=lambda p: (fates.index(found[p].fate), found[p].returns, p))
    escapes = [phrase for phrase in order if found[phrase].fate is Fate.ESCAPE]
    return {p: (found[p], escapes.index(p) if p in escapes else 0) for p in order}


def _colour(attractor: Attractor, escape: int) -> str:
    if attractor.fate is Fate.ZENO:
        return _PERIODS.get(attractor.returns, _OTHER_PERIOD)
    if attractor.fate is Fate.ESCAPE:
        return _ESCAPES[escape % len(_ESCAPES)]
    if attractor.fate is Fate.UNSETTLED:
        growing = {"growing": _GROWING, "dying out": _DYING}
        return growing.get(attractor.phrase.rpartition(", ")[2], _UNSETTLED)
    return _PLAIN[attractor.fate]


def _draw_contours(ax: Axes, found: ParameterMap) -> list[Line2D]:
    """Draw period and spectral radius where the motion settles to an orbit of period 1."""
    first = [one.fate in (Fate.ZENO, Fate.SIMPLE) and one.returns == 1 for one in found.attractors]
    inside = np.reshape(first, found.shape)
    handles: list[Line2D] = []
    fields: list[tuple[Vector, Any, dict[str, Any], str]] = [
        (found.numbers("period"), 6, _PERIOD, "period [s]"),
        (found.numbers("spectral_radius"), list(_RADII), _RADIUS, "spectral radius"),
    ]
    for values, levels, look, label in fields:
        shown = np.ma.masked_where(~inside | ~np.isfinite(values), values)
        # A contour needs a cell with four corners, and a field that changes.
        if shown.count() < _CORNERS or float(np.ma.ptp(shown)) == 0.0:
            continue
        lines = ax.contour(found.x.values(), found.y.values(), shown, levels=levels, **look)
        if any(len(path) for path in lines.get_paths()):
            _label_lines(ax, lines)
            dash = "--" if look is _RADIUS else "-"
            colour = "#999999" if look is _RADIUS else "black"
            handles.append(Line2D([], [], color=colour, ls=dash, lw=0.9, label=label))
    return handles


_CORNERS = 4
_LONG = 0.6
"""Part of an axis that a contour line must span to be labelled."""


def _label_lines(ax: Axes, lines: QuadContourSet) -> None:
    """Label every long contour line once, in its middle."""
    spots: list[tuple[float, float]] = []
    lowest = np.array([ax.get_xlim()[0], ax.get_ylim()[0]])
    span = np.array([ax.get_xlim()[1], ax.get_ylim()[1]]) - lowest
    polygons = (path.to_polygons(closed_only=False) for path in lines.get_paths())
    pieces = [np.asarray(piece) for level in polygons for piece in level]
    for piece in pieces:
        places = (piece - lowest) / span
        lengths = np.ptp(places, axis=0)
        along = int(np.argmax(lengths))
        if lengths[along] > _LONG:
            # Neighbours are labelled at different places, so that labels do not touch.
            wanted = _PLACES[len(spots) % len(_PLACES)]
            at = int(np.argmin(np.abs(places[:, along] - wanted)))
            if places[at].min() > _EDGE and places[at].max() < 1 - _EDGE:
                x, y = piece[at].tolist()
                spots.append((x, y))
    ax.clabel(lines, fontsize=TEXT - 2, fmt="%.4g", manual=spots)


_PLACES = (0.3, 0.5, 0.7)
"""Places along an axis at which contour lines are labelled, in turn."""
_EDGE = 0.05
"""Part of an axis at its ends where no label fits."""


def _draw_boundaries(ax: Axes, found: ParameterMap, boundaries: Sequence[Boundary]) -> list[Line2D]:
    """Draw the curves that pass through the plane, those of a name alike."""
    (left, right), (low, high) = _reach(found.x), _reach(found.y)
    plane = Bbox.from_extents(left, low, right, high)
    curves: dict[str, list[Vector]] = {}
    for boundary in boundaries:
        points = np.array(boundary.points).reshape(-1, 2)
        if Path(points).intersects_bbox(plane, filled=False):
            curves.setdefault(boundary.name, []).append(points)
    handles: list[Line2D] = []
    for (name, alike), dash in zip(curves.items(), cycle(_BOUNDARIES), strict=False):
        look: dict[str, Any] = {"color": "black", "lw": 1.6, "ls": dash}
        for points in alike:
            ax.plot(*points.T, **look)
        handles.append(Line2D([], [], label=name, **look))
    if curves:
        ax.set(xlim=(left, right), ylim=(low, high))
    return handles


def _reach(axis: Axis) -> tuple[float, float]:
    half = (axis.upper - axis.lower) / (axis.count - 1) / 2
    return axis.lower - half, axis.upper + half


def _label(axis: Axis) -> str:
    return f"{axis.name} [{axis.unit}]"
