# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""A hybrid system and its completion as a pair of graphs (the paper's Fig. 2)."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.report.plots.style import COLUMN_WIDTH, INK, TEXT, TINTS
from zeno_orbits.report.symbols import math_symbol
from zeno_orbits.simulation import Mode

_SIZE = (1.22, 0.72)
"""Width and height of a mode. Lengths here are in inches of a figure that is one column wide."""
_HEIGHTS = (1.2, 2.24)
"""Of the two panels."""
_ARROW: dict[str, Any] = {
    "arrowstyle": "-|>",
    "mutation_scale": 9.0,
    "color": INK,
    "lw": 1.0,
    "shrinkA": 0.0,
    "shrinkB": 0.0,
}
_LONGEST = 58
"""Signs of the names of states that fit on a line."""


def plot_graph(problem: Problem, values: ParameterValues, *, width: float = COLUMN_WIDTH) -> Figure:
    r"""Return a hybrid system and its completion as graphs, one above the other.

    Above, the simple hybrid system :math:`(D_h, G_h, R_h, f)`: one domain with its flow, and the
    impact that leads from the guard back into it. Its impacts may accumulate, and then it ends.
    Below, its completion: the Zeno point :math:`h = \dot h = 0, \lambda > 0` leads on to a second
    domain, the stop, and the release :math:`\lambda = 0` leads back.

    Args:
        problem: The problem.
        values: Its numbers.
        width: Width of the picture [in].
    """
    whole = sum(_HEIGHTS)
    figure = Figure(figsize=(width, width * whole / COLUMN_WIDTH))
    share = _HEIGHTS[1] / whole
    panels = (figure.add_axes((0, share, 1, 1 - share)), figure.add_axes((0, 0, 1, share)))
    for ax, height in zip(panels, _HEIGHTS, strict=True):
        ax.set(xlim=(0.0, COLUMN_WIDTH), ylim=(0.0, height))
        ax.set_axis_off()
    has_motors = problem.compiled().motors.numel_out(0) > 0
    kind = "electromechanical hybrid" if has_motors else "hybrid"
    _draw_system(panels[0], f"(a) simple {kind} system", problem.first_system(values).restitution)
    _draw_completion(panels[1], "(b) its completion", _states(problem))
    return figure


def _draw_system(ax: Axes, title: str, restitution: float) -> None:
    middle = (0.76, 0.46)
    _word(ax, 0.15, 1.08, title, "left")
    _draw_domain(ax, middle, Mode.FREE, "off the stop", r"$D_h$: $h \geq 0$", r"$\dot x = f(x)$")
    right = middle[0] + _SIZE[0] / 2
    _edge(ax, (right, middle[1] + 0.16), (right, middle[1] - 0.16), "arc3,rad=-1.9")
    impact = (
        "impact\n"
        r"guard $G_h$: $h = 0,\ \dot h \leq 0$" + "\n"
        r"reset $R_h$: $\dot h_+ = -e\,\dot h_-$" + f"\n$e$ = {restitution:g}"
    )
    _word(ax, right + 0.42, middle[1], impact, "left")


def _draw_completion(ax: Axes, title: str, states: str) -> None:
    free, locked = (0.76, 0.98), (COLUMN_WIDTH - 0.76, 0.98)
    half, high = _SIZE[0] / 2, _SIZE[1] / 2
    _word(ax, 0.15, 2.1, title, "left")
    _draw_domain(ax, free, Mode.FREE, "off the stop", r"$D_h$: $h \geq 0$", r"$\dot x = f(x)$")
    _draw_domain(
        ax,
        locked,
        Mode.LOCKED,
        "on the stop",
        r"$h = \dot h = 0,\ \lambda > 0$",
        r"$\dot x = f_\lambda(x)$",
    )
    top = free[1] + high
    _edge(ax, (free[0] - 0.44, top), (free[0] - 0.1, top), "arc3,rad=-1.75")
    _word(ax, free[0] - 0.06, top + 0.26, "impact:\n$R_h$ on $G_h$", "left")
    left, right = free[0] + half, locked[0] - half
    _edge(ax, (left, free[1] + 0.14), (right, free[1] + 0.14), "arc3,rad=-0.4")
    _edge(ax, (right, free[1] - 0.14), (left, free[1] - 0.14), "arc3,rad=-0.4")
    _word(
        ax, (left + right) / 2 + 0.2, top + 0.26, "Zeno point:\n$h = \\dot h = 0,\\ \\lambda > 0$"
    )
    _word(ax, (left + right) / 2, 0.46, "release: $\\lambda = 0$")
    _word(ax, COLUMN_WIDTH / 2, 0.14, states)


def _draw_domain(ax: Axes, at: tuple[float, float], mode: Mode, *words: str) -> None:
    (x, y), (wide, high) = at, _SIZE
    box = FancyBboxPatch(
        (x - wide / 2, y - high / 2),
        wide,
        high,
        boxstyle="round,pad=0,rounding_size=0.12",
        fc=TINTS[mode],
        ec=INK,
        lw=1.0,
        gid=mode.value,
    )
    ax.add_patch(box)
    _word(ax, x, y, "\n".join(words))


def _states(problem: Problem) -> str:
    """Return the components of the state, as symbols if they fit on a line."""
    names = problem.state_names
    if sum(map(len, names)) > _LONGEST:
        return f"$x$: {len(names)} states"
    return f"$x$: {', '.join(math_symbol(name, names) for name in names)}"


def _edge(ax: Axes, start: tuple[float, float], end: tuple[float, float], bend: str) -> None:
    ax.add_patch(FancyArrowPatch(start, end, connectionstyle=bend, **_ARROW))


def _word(ax: Axes, x: float, y: float, words: str, side: str = "center") -> None:
    ax.text(x, y, words, ha=side, va="center", size=TEXT, color=INK, linespacing=1.35)
