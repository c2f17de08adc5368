# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""The style of pictures: Okabe and Ito's colours, marks of events, safe files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser
from matplotlib.text import Text

from zeno_orbits.simulation import Execution, Mode
from zeno_orbits.work import checked, require_picture, write_whole

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
TINTS = {Mode.FREE: "#E3F0F8", Mode.LOCKED: "#F9DBC6"}
BLUES = LinearSegmentedColormap.from_list("depth", ["#3C8DC0", "#E6F2F9"])
ARCS: dict[Mode, dict[str, Any]] = {
    Mode.FREE: {"color": "#0072B2", "lw": 1.2, "label": "free arc"},
    Mode.LOCKED: {"color": "#D55E00", "lw": 2.4, "label": "contact phase", "zorder": 2.5},
}
TAIL: dict[str, Any] = ARCS[Mode.FREE] | {"ls": ":", "label": "Zeno tail, summed"}
LOOKS = {mode.value: look for mode, look in ARCS.items()} | {"tail": TAIL}
"""Kind of a path to how it is drawn."""
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


@checked
def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, PDF or SVG, atomically and reproducibly.

    Args:
        figure: The figure.
        path: Path of the file, whose suffix determines the format.

    Raises:
        InputError: If the suffix is not supported, or the file cannot be written.
    """
    path = Path(path)
    require_picture(path, "path")
    write_whole(path, rendered(figure, path.suffix.lower()[1:]), "path")


def rendered(figure: Figure, kind: str) -> bytes:
    """Return a picture as the bytes of a file, the same every time.

    Args:
        figure: The picture.
        kind: ``png``, ``pdf`` or ``svg``.
    """
    keep_legible(figure)
    dates: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    picture = io.BytesIO()
    with mpl.rc_context({"pdf.fonttype": 42, "svg.hashsalt": "zeno_orbits"}):
        figure.savefig(picture, format=kind, dpi=300, metadata=dates.get(kind, {}))
    return picture.getvalue()


def keep_legible(figure: Figure) -> None:
    """Draw texts with dollar signs that are not formulas as they are.

    A name in a file may contain one dollar sign, or text between two that is not a formula.

    Args:
        figure: The picture.
    """
    for text in figure.findobj(lambda one: isinstance(one, Text) and "$" in one.get_text()):
        if isinstance(text, Text):
            try:
                for line in text.get_text().split("\n"):
                    _FORMULAS.parse(line)
            except ValueError:
                text.set_parse_math(False)


_FORMULAS = MathTextParser("path")


def mark_completion(ax: Axes, execution: Execution, pair: Sequence[int]) -> None:
    """Mark releases and Zeno points in the plane of two states.

    Args:
        ax: The panel.
        execution: The execution.
        pair: Indices of the two states.
    """
    for release in execution.releases:
        ax.plot(*release.state[list(pair)], label="release", **RELEASE)
    for zeno in execution.zeno_points:
        ax.plot(*zeno.state[list(pair)], label="Zeno point", **ZENO)
