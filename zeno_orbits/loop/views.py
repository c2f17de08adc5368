"""Keys of the tables of a graph: views, which are stops in modes, and sides of switches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from zeno_orbits.loop import binding as c


class View(NamedTuple):
    """An open stop in a mode.

    Attributes:
        closed: The closed stops beside the stop.
        stop: The stop.
        sides: Side of every kink, True where its condition is positive.
    """

    closed: tuple[int, ...]
    stop: int
    sides: tuple[bool, ...]

    @property
    def key(self) -> int:
        """The key in the library."""
        return c.view_key(_mode_key(self.closed, self.sides), self.stop)


class SwitchSide(NamedTuple):
    """The sign of a switch's guard in a mode.

    Attributes:
        closed: The closed stops.
        sides: Side of every kink.
        switch: The switch.
        positive: Whether its guard is positive there.
    """

    closed: tuple[int, ...]
    sides: tuple[bool, ...]
    switch: int
    positive: bool

    @property
    def key(self) -> int:
        """The key in the library."""
        return c.side_key(_mode_key(self.closed, self.sides), self.switch, int(self.positive))


def _mode_key(closed: Sequence[int], sides: Sequence[bool]) -> int:
    bits = sum(1 << k for k, side in enumerate(sides) if side)
    return c.mode_key(sum(1 << k for k in closed), bits)
