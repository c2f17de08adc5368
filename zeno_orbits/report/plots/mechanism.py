# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""A mechanism at its release and its circuit, drawn from the problem (the paper's Fig. 3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Circle, Rectangle

from zeno_orbits.errors import InputError
from zeno_orbits.model import Drive, ParameterValues, Problem
from zeno_orbits.report.motion import GROUND, STOP, MachineMotion, frame_of, machine_motion
from zeno_orbits.report.paths import stops_of, switches_of
from zeno_orbits.report.plots.looks import Looks, looks_of
from zeno_orbits.report.plots.style import ARCS, COLUMN_WIDTH, INK, TEXT
from zeno_orbits.report.symbols import math_symbol
from zeno_orbits.simulation import Execution

_GHOSTS = 12
"""Positions of the mechanism along the period, drawn pale under its position at the release."""
_WIDTH, _HEIGHT, _DEPTH = 1.7, 1.75, 1.0
"""Width of an element, distance of two loops and height of one, in units of the drawing."""

_MARGIN = 0.06
"""Free space left and right [in]."""

_EDGE = 0.2
_TITLES = {False: "mechanism at the release", True: "mechanism at the start of the period"}
"""Title of a mechanism, for a machine with one stop and for one with named stops or switches."""


class ElementKind(Enum):
    """Kind of an element of a circuit."""

    SOURCE = "source"
    RESISTANCE = "resistance"
    INDUCTANCE = "inductance"
    CAPACITOR = "capacitor"
    MOTOR = "motor"


@dataclass(frozen=True, slots=True, kw_only=True)
class Element:
    """An element of a circuit.

    Attributes:
        kind: Kind of the element.
        label: Symbol of the element in matplotlib's notation.
    """

    kind: ElementKind
    label: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """The loop of one current.

    Attributes:
        current: Symbol of the current.
        elements: Its elements in order.
    """

    current: str
    elements: Sequence[Element]


def plot_mechanism(
    problem: Problem,
    values: ParameterValues,
    execution: Execution,
    period: float,
    *,
    width: float = COLUMN_WIDTH,
) -> Figure:
    """Return the mechanism at the start of an orbit above the loops of its circuit.

    A problem without a circuit has the mechanism alone, one without a drawing the circuit alone.

    Args:
        problem: The problem.
        values: Its numbers.
        execution: One period from the release on.
        period: [s].
        width: Width of the picture [in].

    Raises:
        InputError: If the problem has neither a drawing nor a circuit.
    """
    loops = circuit_loops(problem)
    if problem.drawing is None and not loops:
        message = f"must have a drawing or a circuit, but `{problem.name}` has neither"
        raise InputError(f"Argument `problem` {message}.")
    rows: list[float] = [] if problem.drawing is None else [width]
    if loops:
        (left, right), (low, high) = _frame(loops)
        rows.append(0.25 + width * (high - low) / (right - left))
    # With equal axes, the layout leaves labels a point less than it should.
    figure = Figure(figsize=(width, sum(rows)), layout=ConstrainedLayoutEngine(w_pad=_MARGIN))
    panels = figure.subplots(len(rows), 1, squeeze=False, height_ratios=rows)[:, 0].tolist()
    if problem.drawing is not None:
        motion = machine_motion(problem, values, execution, period, n=_GHOSTS)
        named = bool(stops_of(execution) or switches_of(execution))
        _draw_mechanism(panels[0], motion, looks_of(execution))
        panels[0].set_title(f"(a) {_TITLES[named]}" if loops else "mechanism", size=TEXT)
    if loops:
        _draw_loops(panels[-1], loops)
        panels[-1].set_title("(b) circuit" if len(rows) > 1 else "circuit", size=TEXT)
    return figure


def _draw_mechanism(ax: Axes, motion: MachineMotion, looks: Looks) -> None:
    """Draw a mechanism at its start, with the rest of its period in a pale colour."""
    across, upwards = frame_of(motion)
    ax.set(xlim=across, ylim=upwards)
    label_lengths(ax)
    ax.set_aspect("equal")
    for name, corners in motion.lines.items():
        # A stop on a moving link is drawn once, as the joints and links are enough to see it move.
        for k in (0,) if name in (STOP, GROUND) else reversed(range(len(motion.times))):
            look: dict[str, Any] = {"color": INK, "lw": 2.5, "zorder": 4}
            if k:
                closed = motion.closed[k]
                colour = looks.colour(closed) if closed else ARCS[motion.modes[k]]["color"]
                look = {"color": colour, "lw": 1.2, "alpha": 0.35, "zorder": 2}
            if corners.shape[1] == 1:
                look |= {"marker": "o", "ms": 3 if k else 5, "mfc": "white", "ls": ""}
            ax.plot(*corners[k].T, solid_capstyle="round", **look)


def label_lengths(ax: Axes) -> None:
    """Label the axes of a drawing in metres, in powers of ten for a small machine.

    Args:
        ax: The panel.
    """
    ax.set_xlabel("across [m]", size=TEXT)
    ax.set_ylabel("upwards [m]", size=TEXT)
    ax.tick_params(labelsize=TEXT)
    ax.ticklabel_format(scilimits=(-3, 4))
    ax.locator_params(axis="x", nbins=7)
    for axis in (ax.xaxis, ax.yaxis):
        axis.get_offset_text().set_fontsize(TEXT)


def circuit_loops(problem: Problem) -> list[Loop]:
    """Return the loop of each current of a problem, its elements by their symbols.

    A capacitor of several loops has the same symbol in each. Elements of drives whose currents
    follow at once are the same.

    Args:
        problem: The problem.
    """
    system = problem.model(problem.symbols())
    states = {system.state[k].element_hash(): name for k, name in enumerate(problem.state_names)}
    loops: list[Loop] = []
    for part in system.drive.parts:
        entries = dict(part.entries)
        if part.motors is not None:
            loops += _motor_loops(entries, part, states)
        elif "incidence" in entries:
            loops += _field_loops(entries, part, states, system.state[: system.n_q])
    return loops


def _motor_loops(
    entries: Mapping[str, ca.SX], part: Drive, states: Mapping[int, str]
) -> list[Loop]:
    loops: list[Loop] = []
    for k in range(part.motor_current.numel()):
        elements = [
            *_element(ElementKind.SOURCE, part.motor_voltage[k], "V"),
            *_element(ElementKind.RESISTANCE, entries["resistance"][k, k], "R"),
            *_element(ElementKind.INDUCTANCE, entries["inductance"][k, k], "L"),
            Element(kind=ElementKind.MOTOR, label="M"),
        ]
        loops.append(Loop(current=_current(part.motor_current[k], states), elements=elements))
    return loops


def _field_loops(
    entries: Mapping[str, ca.SX], part: Drive, states: Mapping[int, str], q: ca.SX
) -> list[Loop]:
    n_i = part.kinds.count("current")
    currents, voltages = part.states[:n_i], part.states[n_i:]
    coupling = ca.jacobian(ca.gradient(entries["coenergy"], currents), q)
    loops: list[Loop] = []
    for k in range(n_i):
        elements = _element(ElementKind.SOURCE, entries["source"][k], "V")
        elements += _element(ElementKind.RESISTANCE, entries["resistance"][k, k], "R")
        inductance = part.inertia[k, k]
        # An inductance that moves is the motor itself.
        moves = ca.depends_on(inductance, q)
        elements += _element(ElementKind.INDUCTANCE, inductance, "L(q)" if moves else "L")
        for j in range(voltages.numel()):
            if not entries["incidence"][k, j].is_zero():
                name = states[voltages[j].element_hash()]
                elements.append(Element(kind=ElementKind.CAPACITOR, label=math_symbol(name)))
        if not moves and not coupling[k, :].is_zero():
            elements.append(Element(kind=ElementKind.MOTOR, label="M"))
        loops.append(Loop(current=_current(currents[k], states), elements=elements))
    return loops


def _current(current: ca.SX, states: Mapping[int, str]) -> str:
    """Return the symbol of a current, which is a plain symbol for a current that is not a state."""
    name = states.get(current.element_hash(), "i") if current.is_symbolic() else "i"
    return math_symbol(name)


def _element(kind: ElementKind, value: ca.SX, plain: str) -> list[Element]:
    """Return an element labelled by its value, or by a plain symbol. It is empty for zero."""
    if value.is_zero():
        return []
    label = math_symbol(value.name()) if value.is_symbolic() else f"${plain}$"
    return [Element(kind=kind, label=label)]


def _frame(loops: Sequence[Loop]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the range of a drawing of loops across and upwards, in its units."""
    longest = max(
        sum(one.kind is not ElementKind.SOURCE for one in loop.elements) for loop in loops
    )
    right = (longest + 0.6) * _WIDTH
    return (-1.0, right + _EDGE), (-(len(loops) - 1) * _HEIGHT - _DEPTH - _EDGE, 0.8)


def _draw_loops(ax: Axes, loops: Sequence[Loop]) -> None:
    """Draw loops one below the other: a source on the left, the other elements along the top."""
    across, upwards = _frame(loops)
    ax.set_axis_off()
    ax.set_aspect("equal")
    ax.set(xlim=across, ylim=upwards, xticks=[], yticks=[])
    right = across[1] - _EDGE
    for number, loop in enumerate(loops):
        top, bottom = -number * _HEIGHT, -number * _HEIGHT - _DEPTH
        wire: dict[str, Any] = {"color": INK, "lw": 1.0, "zorder": 1}
        ax.plot([0.0, right, right, 0.0, 0.0], [top, top, bottom, bottom, top], **wire)
        ax.annotate(
            "", (0.45, top), (0.1, top), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.0}
        )
        ax.text(0.3, top + 0.15, loop.current, size=TEXT, ha="center", va="bottom", color=INK)
        along = [one for one in loop.elements if one.kind is not ElementKind.SOURCE]
        for source in loop.elements:
            if source.kind is ElementKind.SOURCE:
                _draw_source(ax, 0.0, (top + bottom) / 2, source.label)
        for k, one in enumerate(along):
            _draw_element(ax, (k + 1) * _WIDTH, top, one)


def _draw_source(ax: Axes, x: float, y: float, label: str) -> None:
    ax.add_patch(Circle((x, y), 0.24, fc="white", ec=INK, lw=1.0, zorder=2))
    ax.text(x, y + 0.08, "+", size=TEXT - 1, ha="center", va="center", color=INK)
    ax.text(x, y - 0.1, "\u2212", size=TEXT - 1, ha="center", va="center", color=INK)
    ax.text(x - 0.34, y, label, size=TEXT, ha="right", va="center", color=INK)


def _draw_element(ax: Axes, x: float, y: float, one: Element) -> None:
    """Draw an element around a point on a horizontal wire, with its symbol above it."""
    gap: dict[str, Any] = {"color": "white", "lw": 2.0, "zorder": 2}
    line: dict[str, Any] = {"color": INK, "lw": 1.0, "zorder": 3}
    plate: dict[str, Any] = {"color": INK, "lw": 1.6, "zorder": 3}
    if one.kind is ElementKind.RESISTANCE:
        ax.add_patch(
            Rectangle((x - 0.3, y - 0.11), 0.6, 0.22, fc="white", ec=INK, lw=1.0, zorder=3)
        )
    elif one.kind is ElementKind.INDUCTANCE:
        ax.plot([x - 0.32, x + 0.32], [y, y], **gap)
        turns = np.linspace(0.0, 4 * np.pi, 121)
        ax.plot(x - 0.32 + 0.64 * turns / (4 * np.pi), y + 0.16 * np.abs(np.sin(turns)), **line)
    elif one.kind is ElementKind.CAPACITOR:
        ax.plot([x - 0.07, x + 0.07], [y, y], **gap)
        for side in (-0.07, 0.07):
            ax.plot([x + side, x + side], [y - 0.2, y + 0.2], **plate)
    else:
        ax.add_patch(Circle((x, y), 0.24, fc="white", ec=INK, lw=1.0, zorder=3))
        ax.text(x, y, one.label, size=TEXT, ha="center", va="center", color=INK, zorder=4)
        return
    ax.text(x, y + 0.24, one.label, size=TEXT, ha="center", va="bottom", color=INK)
