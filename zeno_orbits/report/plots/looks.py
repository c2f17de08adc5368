# pyright: reportUnknownMemberType=false
# The stubs of matplotlib leave most keyword arguments untyped.
"""Looks of arcs and events: by mode, and by name in a machine with several stops or switches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from zeno_orbits.report.paths import ArcPath, DrawnPhase, stops_of, switches_of
from zeno_orbits.report.plots.style import ARCS, INK, JUMP, LOOKS, TINTS
from zeno_orbits.simulation import Execution, Impact, Mode, SwitchEvent

_STOPS = (
    (str(ARCS[Mode.LOCKED]["color"]), TINTS[Mode.LOCKED]),
    ("#AA4499", "#F2DDEE"),
    ("#117733", "#D3EAD9"),
    ("#B8860B", "#F7EBC6"),
)
"""Colours of the contact phases and of their shading, one pair per stop, in turn."""
UNNAMED = ("stop",)
"""Stops of a machine with one stop, if its problem names none."""
_SWITCHES: tuple[dict[str, Any], ...] = (
    {"color": "#009E73", "ls": (0, (5, 2))},
    {"color": "#7F7F7F", "ls": (0, (1.5, 1.5))},
    {"color": "#000000", "ls": (0, (5, 1.5, 1, 1.5))},
    {"color": "#56B4E9", "ls": (0, (3, 3))},
)
"""Looks of the lines that mark switches, in turn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Looks:
    """The looks of one execution. A stop or switch has the same look in all panels.

    Attributes:
        stops: Names of the stops, empty for a machine with one unnamed stop.
        switches: Names of the switches.
    """

    stops: tuple[str, ...]
    switches: tuple[str, ...]

    def path(self, path: ArcPath) -> dict[str, Any]:
        """Return the look of an arc, in the colour of the first of its closed stops."""
        return self.arc(path.kind, path.closed)

    def arc(self, kind: str, closed: Sequence[str]) -> dict[str, Any]:
        """Return the look of an arc of a kind, in the colour of the first of its closed stops."""
        look = LOOKS[kind]
        if kind != Mode.LOCKED.value or not closed:
            return look
        words = "" if self.stops == UNNAMED else f": {', '.join(closed)}"
        return look | {"color": self.colour(closed), "label": f"{look['label']}{words}"}

    def colour(self, closed: Sequence[str]) -> str:
        """Return the colour of a mode, given by the names of its closed stops.

        Args:
            closed: Names of the closed stops, at least one.
        """
        return _STOPS[self.stops.index(closed[0]) % len(_STOPS)][0]

    def mode(self, mode: Mode, closed: Sequence[str]) -> str:
        """Return the name of a mode.

        Args:
            mode: Off all stops, or on a stop.
            closed: Names of the closed stops, empty for a machine with one unnamed stop.
        """
        if self.stops in ((), UNNAMED):
            return "off the stop" if mode is Mode.FREE else "on the stop"
        return f"contact: {', '.join(closed)}" if closed else "no contact"

    def tints(self, phase: DrawnPhase) -> list[str]:
        """Return the colours that shade a phase, one per closed stop."""
        if not phase.closed:
            return [TINTS[phase.mode]]
        return [_STOPS[self.stops.index(name) % len(_STOPS)][1] for name in phase.closed]

    def impact(self, impact: Impact) -> tuple[str, str]:
        """Return the colour and the label of an impact: of its stop, if there are several."""
        if len(self.stops) < 2:
            return INK, "impact"
        return self.colour([impact.stop]), f"impact: {impact.stop}"

    def switch(self, event: SwitchEvent) -> dict[str, Any]:
        """Return the look of the line that marks a switch, with its label."""
        look = _SWITCHES[self.switches.index(event.name) % len(_SWITCHES)]
        return look | {"label": f"switch: {event.name}"}


def looks_of(execution: Execution) -> Looks:
    """Return the looks of an execution."""
    return Looks(stops=stops_of(execution), switches=switches_of(execution))


def mark_switches(ax: Axes, execution: Execution, looks: Looks, pair: Sequence[int]) -> None:
    """Mark switches in the plane of two states, and their resets.

    Args:
        ax: The panel.
        execution: The execution.
        looks: Its looks.
        pair: Indices of the two states.
    """
    for switch in execution.switches:
        ends = np.array([switch.state_minus, switch.state_plus])[:, list(pair)]
        if np.any(ends[0] != ends[1]):
            ax.plot(*ends.T, **JUMP)
        look = looks.switch(switch)
        mark: dict[str, Any] = {"ls": "", "marker": "D", "ms": 4.6, "mew": 1.1, "mfc": "white"}
        ax.plot(*ends[0], mec=look["color"], label=look["label"], zorder=4, gid="switch", **mark)
