# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""A hybrid system and its completion as graphs (the paper's Fig. 2)."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from zeno_orbits.execution import Mode
from zeno_orbits.plots.style import COLUMN_WIDTH, INK, TEXT, TINTS
from zeno_orbits.problem import Problem, Setting

_FREE = (0.23, 0.5)
_LOCKED = (0.8, 0.5)
_SIZE = (0.36, 0.3)
_ARROW: dict[str, Any] = {
    "arrowstyle": "-|>",
    "mutation_scale": 9.0,
    "color": INK,
    "lw": 1.0,
    "shrinkA": 0.0,
    "shrinkB": 0.0,
}


def plot_graph(problem: Problem, setting: Setting, *, width: float = COLUMN_WIDTH) -> Figure:
    r"""Return the completed system as a graph.

    Two modes: the flow off the stop with its impacts, an edge from the mode to itself, and the flow
    on the stop. The Zeno point :math:`h = \dot h = 0, \lambda > 0` leads to the stop, the release
    :math:`\lambda = 0` from it. Without the right half it is the hybrid system itself.

    Args:
        problem: The scene.
        setting: Its numbers.
        width: Width of the picture [in].
    """
    figure = Figure(figsize=(width, 0.75 * width), layout="constrained")
    ax = figure.add_subplot()
    ax.set(xlim=(0.0, 1.0), ylim=(0.06, 1.12))
    ax.set_axis_off()
    e = setting.parameters["restitution"]
    _mode(ax, _FREE, Mode.FREE, "off the stop", r"$\dot x = f(x)$", r"$h \geq 0$")
    _mode(
        ax,
        _LOCKED,
        Mode.LOCKED,
        "on the stop",
        r"$\dot x = f_\lambda(x)$",
        r"$h = 0,\ \lambda > 0$",
    )
    half, high = _SIZE[0] / 2, _SIZE[1] / 2
    left, right = _FREE[0] + half, _LOCKED[0] - half
    _edge(ax, (left, 0.56), (right, 0.56), "arc3,rad=-0.35")
    _edge(ax, (right, 0.44), (left, 0.44), "arc3,rad=-0.35")
    top = _FREE[1] + high
    _edge(ax, (_FREE[0] - 0.08, top), (_FREE[0] + 0.08, top), "arc3,rad=-2.0")
    middle = (left + right) / 2
    _word(ax, middle, 0.74, "Zeno point\n$h = \\dot h = 0$")
    _word(ax, middle, 0.26, "release\n$\\lambda = 0$")
    words = f"impact at $h = 0,\\ \\dot h < 0$:\n$\\dot h_+ = -e\\,\\dot h_-$,  $e$ = {e:g}"
    _word(ax, _FREE[0] + 0.18, 1.0, words, "left")
    states = ", ".join(problem.state_names)
    _word(
        ax,
        0.5,
        0.13,
        f"$x$ = ({states})" if len(states) < 50 else f"{len(problem.state_names)} states",
    )
    return figure


def _mode(ax: Axes, at: tuple[float, float], mode: Mode, *words: str) -> None:
    (x, y), (wide, high) = at, _SIZE
    box = FancyBboxPatch(
        (x - wide / 2, y - high / 2),
        wide,
        high,
        boxstyle="round,pad=0,rounding_size=0.05",
        fc=TINTS[mode],
        ec=INK,
        lw=1.0,
        gid=mode.value,
    )
    ax.add_patch(box)
    _word(ax, x, y, "\n".join(words))


def _edge(ax: Axes, start: tuple[float, float], end: tuple[float, float], bend: str) -> None:
    ax.add_patch(FancyArrowPatch(start, end, connectionstyle=bend, **_ARROW))


def _word(ax: Axes, x: float, y: float, words: str, side: str = "center") -> None:
    ax.text(x, y, words, ha=side, va="center", size=TEXT, color=INK, linespacing=1.4)
