# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The style of pictures: Okabe and Ito's colours, labels with units, one legend, safe files."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties

from zeno_orbits.arrays import Vector
from zeno_orbits.model import Problem
from zeno_orbits.simulation import Ending, Execution, Mode
from zeno_orbits.work import require_picture, write_whole

COLUMN_WIDTH = 3.4
"""Width of one column of a paper [in]."""
FULL_WIDTH = 7.0
"""Width of a page of two columns [in]."""

TEXT = 8.0
"""Size of the text [pt]."""
INK = "#333333"
PALETTE = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7"),
    *("#E69F00", "#56B4E9", "#7F7F7F", "#000000"),
)
"""Colours of lines, in turn."""
LEAST_ERROR = 1e-17
"""Errors below this are drawn at it: their axis is logarithmic."""
TINTS = {Mode.FREE: "#E3F0F8", Mode.LOCKED: "#F9DBC6"}
BLUES = LinearSegmentedColormap.from_list("depth", ["#3C8DC0", "#E6F2F9"])
ARCS: dict[Mode, dict[str, Any]] = {
    Mode.FREE: {"color": "#0072B2", "lw": 1.2, "label": "free arc"},
    Mode.LOCKED: {"color": "#D55E00", "lw": 2.4, "label": "locked arc", "zorder": 2.5},
}
TAIL: dict[str, Any] = ARCS[Mode.FREE] | {"ls": ":", "label": "Zeno tail, summed"}
LAW: dict[str, Any] = {"color": "#E69F00", "lw": 1.4, "label": "first-order law"}
JUMP: dict[str, Any] = {"color": INK, "lw": 0.8, "ls": (0, (4, 2)), "label": "reset"}
_SPOT: dict[str, Any] = {"ls": "", "marker": "o", "mec": INK, "mew": 0.8, "zorder": 4}
BEFORE: dict[str, Any] = _SPOT | {
    "ms": 4.2,
    "mfc": "none",
    "label": "before impact",
    "gid": "impact",
}
AFTER: dict[str, Any] = _SPOT | {"ms": 2.2, "mfc": INK, "label": "after impact"}
RELEASE: dict[str, Any] = _SPOT | {
    "marker": "s",
    "ms": 6.5,
    "mec": "#009E73",
    "mew": 1.4,
    "mfc": "none",
}
ZENO: dict[str, Any] = _SPOT | {"marker": "*", "ms": 8, "mew": 0.6, "mfc": "#F0E442", "zorder": 5}
_GREEK = ("alpha", "beta", "gamma", "delta", "theta", "phi", "varphi", "psi", "eta", "xi", "omega")


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a picture as PNG, PDF or SVG, whole or not at all, the same bytes every time.

    Args:
        figure: The picture.
        path: Where; the suffix says the format.

    Raises:
        InputError: If the suffix is another one, or the file cannot be written.
    """
    path = Path(path)
    require_picture(path)
    write_whole(path, rendered(figure, path.suffix.lower()[1:]))


def rendered(figure: Figure, kind: str) -> bytes:
    """Return a picture as the bytes of a file, the same every time.

    Args:
        figure: The picture.
        kind: ``png``, ``pdf`` or ``svg``.
    """
    dates: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    picture = io.BytesIO()
    with mpl.rc_context({"pdf.fonttype": 42, "svg.hashsalt": "zeno_orbits"}):
        figure.savefig(picture, format=kind, dpi=300, metadata=dates.get(kind, {}))
    return picture.getvalue()


def panels_of(
    width: float, n: int, *, height: float, columns: int | None = None
) -> tuple[Figure, list[Axes]]:
    """Return a figure of equal panels, side by side on a page and stacked in a column.

    Args:
        width: Width of the figure [in].
        n: Number of panels.
        height: Height of a panel [in].
        columns: Panels in a row; by default up to three where the figure is wide.
    """
    across = columns or (min(n, 3) if width > 1.5 * COLUMN_WIDTH else 1)
    down = -(-n // across)
    figure = Figure(figsize=(width, height * down + 0.5), layout="constrained")
    panels = [figure.add_subplot(down, across, k + 1) for k in range(n)]
    return figure, panels


def portraits_of(
    problem: Problem, width: float, *, height: float
) -> tuple[Figure, list[tuple[Axes, list[int]]]]:
    """Return a figure with a labelled panel for each portrait of a problem.

    Args:
        problem: The problem.
        width: Width of the figure [in].
        height: Height of a panel [in].

    Returns:
        The figure; each panel with the places of the two states that it shows.
    """
    pairs = [[problem.state_names.index(name) for name in pair] for pair in problem.portraits]
    figure, panels = panels_of(width, len(pairs), height=height)
    for ax, (across, up) in zip(panels, pairs, strict=True):
        ax.set(xlabel=label_of(problem, across), ylabel=label_of(problem, up))
    return figure, list(zip(panels, pairs, strict=True))


def share_time(figure: Figure, panels: Sequence[Axes], label: str) -> None:
    """Give stacked panels one axis of time, shown below the lowest, and align their labels.

    Args:
        figure: The figure.
        panels: Its panels, from top to bottom.
        label: Label of the axis of time.
    """
    for ax in panels:
        ax.tick_params(labelbottom=ax is panels[-1])
    panels[-1].set_xlabel(label)
    figure.align_ylabels(panels)


def add_legend(figure: Figure, width: float) -> None:
    """Set every text to one size and put a legend of what is drawn above the panels."""
    entries: dict[str, Any] = {}
    for ax in figure.axes:
        ax.tick_params(which="both", labelsize=TEXT - 1)
        for text in (ax.xaxis.label, ax.yaxis.label):
            text.set_fontsize(TEXT)
        handles, labels = ax.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    sizes = [0.42 + 0.047 * len(label) for label in entries]
    rows = 1
    while (
        rows < len(sizes)
        and sum(max(sizes[k : k + rows]) for k in range(0, len(sizes), rows)) > width
    ):
        rows += 1
    legend = figure.legend(
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


_ABOVE = "above"
"""Name of a legend above the panels."""


def add_title(figure: Figure, title: str) -> None:
    """Put a title on top of a picture, above its legend if that stands above the panels."""
    above = [legend for legend in figure.legends if legend.get_gid() == _ABOVE]
    if above:
        above[0].set_title(title, prop=FontProperties(size=TEXT + 1))
    else:
        figure.suptitle(title, fontsize=TEXT + 1)


def paths_of(execution: Execution) -> list[tuple[Vector, Vector, dict[str, Any]]]:
    """Return times, states and look of every arc; Zeno tails too short to see are left out."""
    paths: list[tuple[Vector, Vector, dict[str, Any]]] = []
    least = 0.004 * (execution.end_time - execution.arcs[0].start_time)
    for arc in execution.arcs:
        if arc.ending is not Ending.ZENO:
            paths.append((*arc.sampled(), ARCS[arc.mode]))
        elif arc.end_time - arc.start_time > least:
            paths.append((*arc.sampled(2), TAIL))
    return paths


def mark_completion(ax: Axes, execution: Execution, pair: Sequence[int]) -> None:
    """Mark releases and Zeno points in the plane of two states.

    Args:
        ax: The panel.
        execution: The execution.
        pair: Places of the two states.
    """
    for release in execution.releases:
        ax.plot(*release.state[list(pair)], label="release", **RELEASE)
    for zeno in execution.zeno_points:
        ax.plot(*zeno.state[list(pair)], label="Zeno point", **ZENO)


def label_of(problem: Problem, index: int) -> str:
    """Return the label of an axis that shows a state, with its unit."""
    return f"{symbol_of(problem.state_names, index)} [{problem.state_units[index]}]"


def symbol_of(names: Sequence[str], index: int) -> str:
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
