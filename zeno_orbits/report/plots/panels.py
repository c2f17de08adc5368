# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The panels of a picture: a figure made for them, or axes that the caller already has."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem
from zeno_orbits.report.plots.style import COLUMN_WIDTH, TEXT
from zeno_orbits.report.symbols import label_of

_MOST_TICKS, _FEWEST_TICKS = 9, 2
"""Intervals between the ticks of an axis across."""
_SIGN, _BETWEEN, _BESIDE = 0.06, 0.1, 0.55
"""Width of a sign of a tick label, between two labels, and next to a panel [in]."""
_NO_MARKER = ("None", "none", "", " ", None)
_ABOVE = "above"
"""Name of a legend above the panels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Panels:
    """The panels of a picture.

    Attributes:
        figure: The figure that they belong to.
        axes: The panels, in order.
        width: Width of the figure [in].
        is_own: Whether the figure was made for them.
    """

    figure: Figure
    axes: tuple[Axes, ...]
    width: float
    is_own: bool

    def __iter__(self) -> Iterator[Axes]:
        """Yield the panels."""
        return iter(self.axes)

    @property
    def widths(self) -> list[float]:
        """Width of each panel with its labels [in]."""
        return [self.width * _share(ax) for ax in self.axes]

    def finished(self, time: str = "") -> Figure:
        """Return the figure, with texts of one size and a legend of the visible lines.

        Args:
            time: Label of the horizontal axis that all panels share, for the lowest panels. Others
                have ticks without labels, unless the panel below is of another width. By default
                each panel has its own label.
        """
        if time:
            # Axes of the caller may lie anywhere, and each is labelled.
            last = {_columns(ax): ax for ax in self.axes} if self.is_own else {}
            for ax in self.axes:
                place = ax.get_subplotspec()
                ax.tick_params(labelbottom=last.get(_columns(ax), ax) is ax)
                ax.set_xlabel("" if self.is_own and place and not place.is_last_row() else time)
        self.figure.align_ylabels([ax for ax in self.axes if ax.get_ylabel()])
        if self.is_own:
            for ax, width in zip(self.axes, self.widths, strict=True):
                _thin_out(ax, width)
                _fold_label(ax)
        # A colour bar is not a panel, but its texts are read together with the panel's texts.
        entries = _entries(self.figure.axes if self.is_own else self.axes)
        if self.is_own:
            self._legend_above(entries)
        elif entries:
            labels, handles = list(entries), list(entries.values())
            self.axes[0].legend(handles, labels, fontsize=TEXT - 1, framealpha=0.8)
        return self.figure

    def _legend_above(self, entries: dict[str, Any]) -> None:
        sizes = [0.42 + 0.047 * _length(label) for label in entries]
        rows = 1
        while (
            rows < len(sizes)
            and sum(max(sizes[k : k + rows]) for k in range(0, len(sizes), rows)) > self.width
        ):
            rows += 1
        legend = self.figure.legend(
            entries.values(),
            entries.keys(),
            loc="outside upper center",
            ncols=math.ceil(len(entries) / rows),
            fontsize=TEXT - 0.5,
            frameon=False,
            handlelength=1.5,
            handletextpad=0.5,
            columnspacing=1.2,
        )
        legend.set_gid(_ABOVE)


_NARROWEST, _WIDEST = 1.5, 60.0
"""Widths between which a picture can be drawn [in]."""


def require_width(width: float) -> None:
    """Reject a width at which nothing can be drawn.

    Args:
        width: Width of the figure [in].

    Raises:
        InputError: If the width is too small or too large.
    """
    if not _NARROWEST <= width <= _WIDEST:
        limits = f"must lie in [{_NARROWEST:g}, {_WIDEST:g}] inches"
        raise InputError(f"Argument `width` {limits}, but it is {width:g}.")


def panels_of(
    width: float,
    n: int,
    *,
    height: float | Sequence[float],
    columns: int | None = None,
    rows: Sequence[int] = (),
    widths: Sequence[float] | None = None,
    axes: Sequence[Axes] = (),
) -> Panels:
    """Return panels, in a row on a page and stacked in a column, or the caller's axes.

    The panels of a row share its width, so that no row has an empty place.

    Args:
        width: Width of the figure [in].
        n: Number of panels.
        height: Height of each panel, or of each row [in].
        columns: Largest number of panels per row, by default three on a wide figure.
        rows: Number of panels of each row of a wide figure, by default as even as possible.
        widths: Relative widths of the columns, by default equal.
        axes: Axes to draw into, by default on a new figure.

    Raises:
        InputError: If the number of axes differs from the number of panels.
    """
    require_width(width)
    across = columns or (min(n, 3) if is_wide(width) else 1)
    n_rows = -(-n // across)
    even = [n // n_rows + (k < n % n_rows) for k in range(n_rows)]
    counts = rows if rows and is_wide(width) else even
    given = [height] * len(counts) if isinstance(height, float | int) else height
    if axes:
        return _existing(axes, n)
    figure = Figure(figsize=(width, sum(given) + 0.5), layout="constrained")
    cells = math.lcm(*counts)
    grid = figure.add_gridspec(len(counts), cells, height_ratios=given, width_ratios=widths)
    panels = tuple(
        figure.add_subplot(grid[row, k * cells // count : (k + 1) * cells // count])
        for row, count in enumerate(counts)
        for k in range(count)
    )
    return Panels(figure=figure, axes=panels, width=width, is_own=True)


def _existing(axes: Sequence[Axes], n: int) -> Panels:
    _require_axes(axes)
    if len(axes) != n:
        message = f"must be as many as the picture has panels, {n}, but there are {len(axes)}"
        raise InputError(f"Argument `axes` {message}.")
    figure = _figure_of(axes[0])
    width = float(figure_size(axes[0])[0])
    return Panels(figure=figure, axes=tuple(axes), width=width, is_own=False)


def _require_axes(axes: Sequence[object]) -> None:
    for one in axes:
        if not isinstance(one, Axes):
            kind = type(one).__name__
            raise InputError(
                f"Argument `axes` must be axes of matplotlib, but one of them is a `{kind}`."
            )


def figure_size(ax: Axes) -> Vector:
    """Return width and height of the figure that axes belong to [in]."""
    return np.array(_figure_of(ax).get_size_inches(), dtype=np.float64)


def _figure_of(ax: Axes) -> Figure:
    figure = ax.get_figure(root=True)
    if figure is None:
        raise InputError("Argument `axes` must belong to a figure.")
    return figure


def is_wide(width: float) -> bool:
    """Return True if panels have room side by side."""
    return width > 1.5 * COLUMN_WIDTH


def portraits_of(
    problem: Problem, width: float, *, height: float, axes: Sequence[Axes] = ()
) -> tuple[Panels, list[tuple[Axes, list[int]]]]:
    """Return labelled panels, one per portrait of a problem.

    Args:
        problem: The problem.
        width: Width of the figure [in].
        height: Height of a panel [in].
        axes: Axes to draw into, by default on a new figure.

    Returns:
        The panels, and each panel with the indices of the two states that it shows.
    """
    pairs = [[problem.state_names.index(name) for name in pair] for pair in problem.portraits]
    panels = panels_of(width, len(pairs), height=height, axes=axes)
    for ax, (across, up) in zip(panels, pairs, strict=True):
        ax.set(xlabel=label_of(problem, across), ylabel=label_of(problem, up))
    return panels, list(zip(panels, pairs, strict=True))


def add_title(figure: Figure, title: str, axes: Sequence[Axes] = ()) -> None:
    """Add a title to a figure, above its legend if the legend is above the panels.

    Args:
        figure: The picture.
        title: The title.
        axes: Axes of the caller, if the figure was drawn into them. The first axes get the title.
    """
    above = [legend for legend in figure.legends if legend.get_gid() == _ABOVE]
    if axes:
        axes[0].set_title(title, fontsize=TEXT + 1)
    elif above:
        above[0].set_title(title, prop=FontProperties(size=TEXT + 1))
    else:
        figure.suptitle(title, fontsize=TEXT + 1)


def _thin_out(ax: Axes, width: float) -> None:
    """Leave no more ticks on a linear axis across than have room for their labels.

    Args:
        ax: The panel.
        width: Its width with all that belongs to it [in].
    """
    locator, (left, right) = ax.xaxis.get_major_locator(), sorted(ax.get_xlim())
    if not isinstance(locator, MaxNLocator):
        return
    for most in range(_MOST_TICKS, _FEWEST_TICKS - 1, -1):
        locator.set_params(nbins=most)
        ticks = [tick for tick in locator.tick_values(left, right) if left <= tick <= right]
        labels = ax.xaxis.get_major_formatter().format_ticks(ticks)
        if sum(_SIGN * len(label) + _BETWEEN for label in labels) <= width - _BESIDE:
            return


def _columns(ax: Axes) -> range | None:
    """Return the columns that a panel spans in its grid, if it lies in one."""
    place = ax.get_subplotspec()
    return None if place is None else place.colspan


def _share(ax: Axes) -> float:
    """Return the width of a panel with its labels, relative to the figure."""
    place = ax.get_subplotspec()
    if place is None:
        return float(ax.get_position(original=True).width)
    return len(place.colspan) / place.get_gridspec().ncols


def _fold_label(ax: Axes) -> None:
    """Fold the label of the vertical axis if it is longer than its panel, units in one piece."""
    height = float(ax.get_position(original=True).height * figure_size(ax)[1])
    label, most = ax.get_ylabel(), int(height / _LETTER)
    if _length(label) > most:
        whole = re.sub(r"\[.*\]$", lambda unit: unit[0].replace(" ", "\N{NO-BREAK SPACE}"), label)
        ax.set_ylabel(textwrap.fill(whole, most, break_long_words=False, break_on_hyphens=False))


_LETTER = 0.06
"""Height of a letter of a vertical label [in]."""


def _entries(panels: Sequence[Axes]) -> dict[str, Any]:
    """Return the handle of every visible artist by label, with all texts set to one size."""
    entries: dict[str, Any] = {}
    for ax in panels:
        ax.tick_params(which="both", labelsize=TEXT - 1)
        for text in (ax.xaxis.label, ax.yaxis.label):
            text.set_fontsize(TEXT)
        for axis in (ax.xaxis, ax.yaxis):
            axis.get_offset_text().set_fontsize(TEXT - 1)
        handles, labels = ax.get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            if label not in entries and _is_seen(ax, handle):
                entries[label] = handle
    return entries


def _is_seen(ax: Axes, handle: Any) -> bool:
    """Return True unless a line lies outside its panel, or is a point without a marker.

    A line without points is a legend entry.
    """
    if not isinstance(handle, Line2D) or not np.size(handle.get_xdata()):
        return True
    # The query of the limits updates the transform to the drawn content.
    ax.get_xlim()
    path = handle.get_transform().transform_path(handle.get_path()).cleaned(remove_nans=True)
    vertices = np.asarray(path.vertices)
    # The last vertex of a clean path only ends it.
    is_point = len(vertices) > 1 and float(np.max(np.ptp(vertices[:-1], axis=0))) < 1.0
    if is_point and handle.get_marker() in _NO_MARKER:
        return False
    box = ax.bbox.padded(1.0)
    return box.count_contains(vertices) > 0 or path.intersects_bbox(box, filled=False)


def _length(label: str) -> int:
    """Return the width of a label in signs. A command of a formula is one sign or an accent."""
    plain = re.sub(r"\\(?:d?dot|mathrm)|[${}_]", "", label)
    return len(re.sub(r"\\[a-z]+", "x", plain))
