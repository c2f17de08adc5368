"""Events that accumulate without a Zeno point of one stop: they end an execution with an error.

The events of a switch may accumulate, impacts may accumulate on several stops in turn, and a switch
may accumulate together with the impacts of a stop. Events of a switch are recognized by intervals
that shrink to a limit. Impacts in turn may come close to each other and part again, so they are
followed one by one until all their stops are at rest to the accuracy of a flight. No law continues
the motion beyond such a limit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.simulation.interruptions import accumulate_together, switches_accumulate

_IN_TURN, _IN_ROW = 16, 7
"""Impacts on several stops, and events of one switch, whose intervals are compared."""
_LAST, _CHANGES = 6, 3
"""Impacts, and changes of the stop among them, at least where they come in turn."""
_CORNER = 1e-6
"""Part of the problem's time within which impacts on two stops come in a corner."""
_SHORT = 1e-5
"""Part of the problem's time below which shrinking intervals of a switch accumulate."""
_FAST, _SOON = 0.2, 1e-3
"""Ratio of intervals that shrink in a few events, and the part of the problem's time below which
they do."""
_COMPARED = 4
"""Last events of a switch that are compared with a Zeno time."""
_FALLING, _ALIKE = 0.9, 0.1
"""Largest ratio of intervals that shrink to a limit, and the least ratio of two such ratios."""


@dataclass(slots=True)
class Accumulations:
    """The last impacts and switches of an execution.

    Attributes:
        impacts: Times and stops of the last impacts.
        switches: Times of the last switches, by name.
    """

    impacts: tuple[tuple[float, str], ...] = ()
    switches: dict[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])

    def see_impact(self, time: float, stop: str, at_rest: Callable[[set[str]], bool]) -> bool:
        """Record an impact, and return True if impacts accumulate on several stops in turn.

        Such impacts become ever more frequent at stops at rest.

        Args:
            time: Time of the event [s].
            stop: Name of the stop.
            at_rest: Whether all stops with these names have zero gap and gap rate there, to the
                accuracy of a flight.
        """
        self.impacts = (*self.impacts[1 - _IN_TURN :], (time, stop))
        if not self.come_in_turn:
            return False
        (first, _), (middle, _) = self.impacts[0], self.impacts[len(self.impacts) // 2]
        return time - middle < middle - first and at_rest({name for _, name in self.impacts})

    def see_switch(self, time: float, name: str, x: Vector, scale: float) -> None:
        """Record an event of a declared switch, unless such events accumulate.

        Args:
            time: Time of the event [s].
            name: Name of the switch.
            x: State after it, ``(n_x,)``.
            scale: The problem's time [s].

        Raises:
            ChatterError: If the intervals of the switch shrink to a limit.
        """
        times = (*self.switches.get(name, ())[1 - _IN_ROW :], time)
        self.switches[name] = times
        intervals = np.diff(times)
        shrink = len(times) == _IN_ROW and bool(np.all(np.diff(intervals) < 0.0))
        slow = shrink and intervals[-1] < _SHORT * scale
        last = intervals[-3:]
        fast = (
            len(last) == 3
            and bool(np.all(last[1:] < _FAST * last[:-1]))
            and last[-1] < _SOON * scale
        )
        if slow or fast:
            raise switches_accumulate(name, time, x)

    def require_no_switches(self, time: float, stop: str, x: Vector, scale: float) -> None:
        """Refuse a Zeno point at which events of a switch accumulate as well.

        Args:
            time: Zeno time [s].
            stop: Name of the stop.
            x: Zeno state, ``(n_x,)``.
            scale: The problem's time [s].

        Raises:
            SimultaneousEventsError: If the intervals of a switch shrink to the Zeno time.
        """
        for name, times in self.switches.items():
            intervals = np.diff([*times[-_COMPARED:], time])
            if len(intervals) < _COMPARED or not intervals[-1] < _SOON * scale:
                continue
            ratios = intervals[1:] / intervals[:-1]
            if np.max(ratios) < _FALLING and np.min(ratios) > _ALIKE * np.max(ratios):
                what = f"events of the switch `{name}` come"
                raise accumulate_together(stop, what, time, x)

    def forget(self, *stops: str) -> None:
        """Forget the impacts on stops, which have come to their limit.

        Args:
            stops: Names of the stops.
        """
        self.impacts = tuple(one for one in self.impacts if one[1] not in stops)

    def is_in_corner(self, scale: float) -> bool:
        """Return True if the last impacts on several stops nearly coincide.

        Args:
            scale: The problem's time [s].
        """
        if not self.come_in_turn:
            return False
        return self.impacts[-1][0] - self.impacts[-2][0] < _CORNER * scale

    def in_turn(self, time: float, x: Vector) -> SimulationError:
        """Return the error of impacts that accumulate on several stops in turn.

        Args:
            time: Time of the event [s].
            x: State there, ``(n_x,)``.
        """
        names = [name for _, name in self.impacts]
        others = sorted({*names} - {names[-1]})
        what = f"impacts on {', '.join(f'`{name}`' for name in others)} come"
        return accumulate_together(names[-1], what, time, x)

    def quiet(self, scale: float) -> float:
        """Return the time before which a Zeno point may be one of switches as well [s].

        Args:
            scale: The problem's time [s].
        """
        last = (times[-1] for times in self.switches.values() if len(times) >= _COMPARED)
        return max(last, default=-np.inf) + _SOON * scale

    @property
    def come_in_turn(self) -> bool:
        """True if the last impacts are on several stops in turn."""
        names = [name for _, name in self.impacts]
        changes = sum(one != other for one, other in pairwise(names))
        return len(names) >= _LAST and changes >= _CHANGES
