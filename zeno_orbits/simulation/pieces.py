"""Executions in pieces: the events since the last piece, and the present state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphMode
from zeno_orbits.simulation.events import Event


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A part of an execution between two checks.

    Attributes:
        events: Events of the piece, in order.
        states: States after the steps, ``(n, n_x)``.
        time: End time [s].
        state: State at the end, ``(n_x,)``.
        mode: Mode at the end.
        starts: Function that returns start time [s] and mode of each arc but the one that goes on.
    """

    events: Sequence[Event]
    states: Vector
    time: float
    state: Vector
    mode: GraphMode
    starts: Callable[[], Sequence[tuple[float, GraphMode]]] = tuple

    def mode_after(self, time: float) -> GraphMode:
        """Return the mode just after an event of the piece.

        Args:
            time: Time of the event [s].
        """
        return next((mode for start, mode in self.starts() if start >= time), self.mode)
