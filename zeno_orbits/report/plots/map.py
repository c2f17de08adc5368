# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""A map as a picture: regions by colour, contours inside the region of Zeno orbits, boundaries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
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
from zeno_orbits.maps import Attractor, AttractorClass, Axis, Boundary, ParameterMap
from zeno_orbits.report.plots.panels import figure_size, panels_of
from zeno_orbits.report.plots.style import COLUMN_WIDTH, FULL_WIDTH, INK, TEXT
from zeno_orbits.report.symbols import quantity_label
from zeno_orbits.simulation import AttractorKind

_PERIODS = {1: "#4393C3", 2: "#009E73", 4: "#005A43", 8: "#5D3A9B"}
_OTHER_PERIODS = (
    "#8C7AA9",
    "#1B4F72",
    "#66C2A5",
    "#C2A5CF",
    "#3F7F4F",
    "#A6BDDB",
    "#7A5195",
    "#00429D",
    "#93C4D2",
    "#A5D5A7",
    "#2C1E5B",
)
_WITHOUT_ZENO = ("#CC79A7", "#8E2D6E", "#F0B8D6", "#E7298A", "#67001F", "#B07AA1", "#FBB4AE")
_PLAIN = {
    AttractorClass.SIMPLE: "#A6D854",
    AttractorClass.REST: "#FFFFFF",
    AttractorClass.HELD: "#C6DBEF",
    AttractorClass.FAILED: "#000000",
}
_ESCAPES = ("#D55E00", "#E69F00", "#8C510A", "#B2182B")
_UNSETTLED = "#F0E442"
_GROWING, _DYING = "#8F8F8F", "#DADADA"
_KINDS = {
    AttractorKind.CHAOTIC: "#4D4D4D",
    AttractorKind.QUASI_PERIODIC: "#B3A369",
    AttractorKind.GROWS: _GROWING,
}
_PERIOD: dict[str, Any] = {"colors": "black", "linewidths": 0.7}
_RADIUS: dict[str, Any] = {"colors": "white", "linewidths": 0.9, "linestyles": "dashed"}
_RADII = (0.2, 0.4, 0.6, 0.8, 0.9)
_BESIDE = 0.8
"""Width relative to a page from which the legend is to the right of the map. Else it is below."""
_SHAPE = {True: 0.5, False: 0.72}
"""Height over width, the legend below not counted."""
_ENTRY = 0.145
"""Height of an entry of the legend [in]."""
_TWO_COLUMNS = 1.3 * COLUMN_WIDTH
"""Width from which on the legend below has two columns [in]."""
_LONGEST = 13
"""Longest period with an entry of its own in the legend, in turns of the clock."""
_TWO_LABELS = 40
"""Longest entry, in letters, with which two columns fit."""
_BOUNDARIES = ("-", "--", "-.", ":")


def plot_map(
    found: ParameterMap,
    *,
    boundaries: Sequence[Boundary] = (),
    width: float = 1.4 * COLUMN_WIDTH,
    axes: Sequence[Axes] = (),
) -> Figure:
    """Return a map as a figure: one cell per point, and contours if there are enough points.

    The axes end at the range of the map, so that the outer cells are cut in half.

    Args:
        found: The map.
        boundaries: Curves to draw on top.
        width: Width of the picture [in].
        axes: One panel to draw into, by default on a new figure.
    """
    beside = width >= _BESIDE * FULL_WIDTH
    panels = panels_of(width, 1, height=_SHAPE[beside] * width - 0.5, axes=axes)
    (ax,) = panels
    ax.set_xlabel(quantity_label(found.x.name, found.x.unit), fontsize=TEXT)
    ax.set_ylabel(quantity_label(found.y.name, found.y.unit), fontsize=TEXT)
    ax.tick_params(labelsize=TEXT - 1)
    handles = _draw_cells(ax, found)
    curves = _inside(found, boundaries)
    handles += _draw_contours(ax, found, [points for alike in curves.values() for points in alike])
    handles += _draw_boundaries(ax, curves)
    handles += _draw_sections(ax, found)
    look: dict[str, Any] = {"fontsize": TEXT - 1, "handlelength": 2.6}
    if not panels.is_own:
        ax.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.02, 1.0), **look)
        return panels.figure
    longest = max((len(str(handle.get_label())) for handle in handles), default=0)
    columns = 2 if width >= _TWO_COLUMNS and not beside and longest <= _TWO_LABELS else 1
    if not beside:
        rows = -(-len(handles) // columns) + 1
        panels.figure.set_figheight(panels.figure.get_figheight() + _ENTRY * rows)
    panels.figure.legend(
        handles=handles,
        ncols=columns,
        columnspacing=1.0,
        loc="outside right upper" if beside else "outside lower center",
        frameon=False,
        **look,
    )
    return panels.figure


def _draw_cells(ax: Axes, found: ParameterMap) -> list[Any]:
    """Draw one cell per point, in the colour of its attractor."""
    x, y, attractors = found.finest()
    phrases = _phrases(attractors)
    looks: dict[str, str] = {}
    for phrase, (one, k) in phrases.items():
        looks[phrase] = _colour(one, k, set(looks.values()))
    order = list(looks)
    codes = np.array([order.index(_label(one)) for one in attractors]).reshape(y.count, x.count)
    ax.pcolormesh(
        *(np.array(axis.values()) for axis in (x, y)),
        codes,
        cmap=ListedColormap(list(looks.values())),
        vmin=-0.5,
        vmax=len(order) - 0.5,
        shading="nearest",
        rasterized=True,
        # With few cells, edges separate them. With many cells, edges would hide them.
        edgecolors="#BBBBBB" if min(x.count, y.count) < _FEWEST else "none",
        linewidth=0.3,
    )
    ax.set(xlim=(found.x.lower, found.x.upper), ylim=(found.y.lower, found.y.upper))
    edge: dict[str, Any] = {"edgecolor": INK, "linewidth": 0.4}
    return [Patch(facecolor=colour, label=phrase, **edge) for phrase, colour in looks.items()]


def _label(attractor: Attractor) -> str:
    """Return the legend label of an attractor. All orbits with long periods share one label."""
    if attractor.turns <= _LONGEST:
        return attractor.phrase
    return f"{attractor.fate.value}, more than {_LONGEST} turns"


def _phrases(attractors: Sequence[Attractor]) -> dict[str, tuple[Attractor, int]]:
    """Return each phrase with one of its attractors and its index among escapes."""
    found: dict[str, Attractor] = {}
    for one in attractors:
        found.setdefault(_label(one), one)
    fates = list(AttractorClass)

    def place(phrase: str) -> tuple[int, int, int, str]:
        one = found[phrase]
        return fates.index(one.fate), one.returns, one.turns, phrase

    order = sorted(found, key=place)
    escapes = [phrase for phrase in order if found[phrase].fate is AttractorClass.ESCAPE]
    return {p: (found[p], escapes.index(p) if p in escapes else 0) for p in order}


def _colour(attractor: Attractor, escape: int, used: Set[str]) -> str:
    """Return the color of an attractor, of orbits one that no other period has.

    Args:
        attractor: The attractor.
        escape: Its number among escapes.
        used: Colors of the attractors before it.
    """
    n = max(attractor.returns, attractor.turns)
    if attractor.fate is AttractorClass.ZENO:
        return _unused((_PERIODS.get(n, _OTHER_PERIODS[0]), *_OTHER_PERIODS), used)
    if attractor.fate is AttractorClass.NO_ZENO:
        return _unused(_WITHOUT_ZENO, used)
    if attractor.fate is AttractorClass.ESCAPE:
        return _ESCAPES[escape % len(_ESCAPES)]
    if attractor.fate is AttractorClass.UNSETTLED:
        if attractor.kind in _KINDS:
            return _KINDS[attractor.kind]
        growing = {"growing": _GROWING, "decaying": _DYING}
        return growing.get(attractor.phrase.rpartition(", ")[2], _UNSETTLED)
    return _PLAIN[attractor.fate]


def _unused(colours: Sequence[str], used: Set[str]) -> str:
    """Return the first color that is not used, or the last."""
    return next((colour for colour in colours if colour not in used), colours[-1])


def _draw_contours(ax: Axes, found: ParameterMap, curves: Sequence[Vector]) -> list[Line2D]:
    """Draw period and spectral radius in the region of orbits of period 1.

    Args:
        ax: The panel.
        found: The map.
        curves: Curves that are drawn on top later, from which labels keep a distance.
    """
    if min(found.shape) < _FEWEST or found.orbits:
        # An orbit is the same in all of its basin.
        return []
    first = [
        one.fate in (AttractorClass.ZENO, AttractorClass.SIMPLE) and one.returns == 1
        for one in found.attractors
    ]
    inside = np.reshape(first, found.shape)
    handles: list[Line2D] = []
    fields: list[tuple[Vector, Any, dict[str, Any], str]] = [
        (found.numbers("period"), 6, _PERIOD, "period [s]"),
        (found.numbers("spectral_radius"), list(_RADII), _RADIUS, "spectral radius [1]"),
    ]
    drawn: list[tuple[QuadContourSet, list[list[Vector]]]] = []
    for values, levels, look, label in fields:
        shown = np.ma.masked_where(~inside | ~np.isfinite(values), values)
        # A contour needs a cell with four corners, and a field that changes by more than its error.
        if shown.count() < _CORNERS or np.ma.ptp(shown) <= _ERROR * np.ma.max(np.abs(shown)):
            continue
        lines = ax.contour(found.x.values(), found.y.values(), shown, levels=levels, **look)
        pieces = _long_pieces(ax, lines)
        if any(pieces):
            drawn.append((lines, pieces))
            dash = "--" if look is _RADIUS else "-"
            colour = "#999999" if look is _RADIUS else "black"
            handles.append(Line2D([], [], color=colour, ls=dash, lw=0.9, label=label))
    taken: list[Vector] = []
    for lines, pieces in drawn:
        others = [p for known, all_of in drawn if known is not lines for q in all_of for p in q]
        _label_lines(ax, lines, pieces, [*others, *map(_dense, curves)], taken)
    return handles


_FEWEST = 12
"""Points along an axis from which on contours are more than a guess between cells."""
_CORNERS = 4
_ERROR = 1e-6
"""Relative error of the numbers of a map."""
_SHORT = 0.15
"""Part of an axis below which a piece of a contour is a speck between cells, and is left out."""
_LONG = 0.6
"""Part of an axis that a contour line must span to be labelled."""
_EDGE = 0.05
"""Part of an axis at its ends where no label fits."""
_CLEAR, _LEGIBLE = 0.7, 0.25
"""Distance from a line, in sizes of a label, that is clear of it, and that can still be read."""
_ROOM = np.array([0.45, 0.17])
"""Width and height that a label needs [in]."""
_PANEL = 0.7
"""Part of a picture that its panel fills, at least."""


def _shares(ax: Axes, points: Vector) -> Vector:
    """Return points of a plane in parts of its axes."""
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    return (points - np.array([left, low])) / np.array([right - left, high - low])


def _long_pieces(ax: Axes, lines: QuadContourSet) -> list[list[Vector]]:
    """Return the pieces of contour lines above a minimum size, level by level."""
    kept: list[list[Vector]] = []
    for path in lines.get_paths():
        pieces = [np.asarray(piece) for piece in path.to_polygons(closed_only=False)]
        kept.append([p for p in pieces if np.max(np.ptp(_shares(ax, p), axis=0)) > _SHORT])
    lines.set_paths([_joined(pieces) for pieces in kept])
    return kept


def _joined(pieces: Sequence[Vector]) -> Path:
    return Path.make_compound_path(*map(Path, pieces)) if pieces else Path(np.empty((0, 2)))


def _label_lines(
    ax: Axes,
    lines: QuadContourSet,
    pieces: Sequence[Sequence[Vector]],
    others: Sequence[Vector],
    taken: list[Vector],
) -> None:
    """Label the long contour lines of every level, off other labels and, if it can be, off lines.

    Args:
        ax: The panel.
        lines: The contours.
        pieces: Their pieces, level by level.
        others: The pieces of the other field's contours.
        taken: Positions of labels, in axes fractions. The positions of the new labels are added.
    """
    spots: list[tuple[float, float]] = []
    room = _ROOM / (_PANEL * figure_size(ax))
    crossing = np.concatenate([_shares(ax, piece) for piece in others] or [np.empty((0, 2))])
    for alike in pieces:
        found: list[tuple[float, Vector]] = []
        for piece in alike:
            places = _shares(ax, piece)
            if np.max(np.ptp(places, axis=0)) <= _LONG:
                continue
            inside = np.all((places > _EDGE) & (places < 1 - _EDGE), axis=1)
            for other in taken:
                inside &= np.any(np.abs(places - other) > room, axis=1)
            apart = np.max(np.abs(places[:, None] - crossing) / room, axis=2)
            nearest = np.where(inside, np.min(apart, axis=1, initial=_CLEAR), 0.0)
            # The middle of the clear stretch, or else the nearest point to it.
            fits = np.flatnonzero(nearest >= min(np.max(nearest), _CLEAR))
            at = fits[np.argmin(np.abs(fits - len(piece) / 2))]
            found.append((float(nearest[at]), piece[at]))
        best = max((clear for clear, _ in found), default=0.0)
        chosen = [spot for clear, spot in found if clear == best > _LEGIBLE]
        spots += [(float(x), float(y)) for x, y in chosen]
        taken += [_shares(ax, spot) for spot in chosen]
    ax.clabel(lines, fontsize=TEXT - 2, fmt="%.4g", manual=spots)


def _dense(curve: Vector) -> Vector:
    """Return a curve with points between its corners."""
    corners = np.arange(len(curve))
    places = np.linspace(0, len(curve) - 1, _BETWEEN * len(curve))
    return np.stack([np.interp(places, corners, curve[:, k]) for k in range(2)], axis=1)


_BETWEEN = 20
"""Points for a corner of a curve."""


def _inside(found: ParameterMap, boundaries: Sequence[Boundary]) -> dict[str, list[Vector]]:
    """Return the curves that pass through the plane, by their names."""
    plane = Bbox.from_extents(found.x.lower, found.y.lower, found.x.upper, found.y.upper)
    curves: dict[str, list[Vector]] = {}
    for boundary in boundaries:
        points = np.array(boundary.points).reshape(-1, 2)
        if Path(points).intersects_bbox(plane, filled=False):
            curves.setdefault(boundary.name, []).append(points)
    return curves


def _draw_boundaries(ax: Axes, curves: Mapping[str, Sequence[Vector]]) -> list[Line2D]:
    """Draw curves. Curves with the same name look alike."""
    handles: list[Line2D] = []
    for (name, alike), dash in zip(curves.items(), cycle(_BOUNDARIES), strict=False):
        look: dict[str, Any] = {"color": "black", "lw": 1.6, "ls": dash}
        for points in alike:
            ax.plot(*points.T, **look)
        handles.append(Line2D([], [], label=name, **look))
    return handles


def _draw_sections(ax: Axes, found: ParameterMap) -> list[Line2D]:
    """Draw where the orbits of a map over states pass their section, as far as it is inside."""
    points = [(one.state[found.x.name], one.state[found.y.name]) for one in found.orbits]
    inside = [(x, y) for x, y in points if _is_on(found.x, x) and _is_on(found.y, y)]
    if not inside:
        return []
    look: dict[str, Any] = {"marker": "o", "mfc": "white", "mec": INK, "ms": 5, "ls": "none"}
    ax.plot(*np.array(inside).T, **look)
    return [Line2D([], [], label="orbit at its section", **look)]


def _is_on(axis: Axis, value: float) -> bool:
    return axis.lower <= value <= axis.upper
