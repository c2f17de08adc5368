"""Executions in pieces: the events since the last piece, and the present state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from zeno_orbits.arrays import Vector
from zeno_orbits.simulation.events import Event


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A part of an execution between two checks.

    Attributes:
        events: Events of the piece, in order.
        states: States after the steps, ``(n, n_x)``.
        time: End time [s].
        state: State at the end, ``(n_x,)``.
        locked: Whether contact persists at the end.
    """

    events: Sequence[Event]
    states: Vector
    time: float
    state: Vector
    locked: bool
