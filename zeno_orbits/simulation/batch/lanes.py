"""The numbers of many lanes: what each of them needs to take its next step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Rows, Vector

FREE, FLIGHT, LOCKED = 0, 1, 2
"""Modes of a lane: free from a release or a start, rescaled after an impact, on the stop."""


Mask = NDArray[np.bool_]


def true_rows(mask: Mask) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return where a mask is true, ``(m,)``; `np.flatnonzero` takes four times as long."""
    found: Any = mask.nonzero()[0]
    return found


@dataclass(slots=True, kw_only=True)
class Lanes:
    """The state of every lane; arrays of length ``n_lanes``, changed in place by the batch.

    Attributes:
        alive: Whether a lane runs.
        leader: The lane that takes its decisions, itself as a rule.
        mode: ``FREE``, ``FLIGHT`` or ``LOCKED``.
        y: State of its flow, the scaled gap and gap rate behind it in a flight.
        p: Its gains and parameters, the speed of its flight behind them.
        tolerance: Local error allowed.
        until: When it ends [s].
        leg_time: When its leg started [s].
        unit: Length of one unit of the flow's own time [s].
        offset: Time since the start of the leg, in the flow's own.
        size: Size of its next step.
        guard: Guard and its rate.
        on_guard: Whether the guard has not been positive yet.
        refused: Whether the last step was refused.
        largest: Change that the guard may make in a step, at most so far in this leg.
        steps: Steps accepted so far.
        restitution: Of its stop.
        impacts: Impacts since the last release or start.
        struck: Gap rate before the first of them; negative.
        zeno_time: Time of the last Zeno point since then [s]; NaN without.
        zeno_acceleration: Gap acceleration there.
        largest_rate: Largest rate of each state at the starts of its legs, ``(n_lanes, n_x)``.
        reach: Largest modulus of each coordinate in the first half of its time.
    """

    alive: NDArray[np.bool_]
    leader: Rows
    mode: NDArray[np.int8]
    y: Vector
    p: Vector
    tolerance: Vector
    until: Vector
    leg_time: Vector
    unit: Vector
    offset: Vector
    size: Vector
    guard: Vector
    on_guard: NDArray[np.bool_]
    refused: NDArray[np.bool_]
    largest: Vector
    steps: Rows
    restitution: Vector
    impacts: Rows
    struck: Vector
    zeno_time: Vector
    zeno_acceleration: Vector
    largest_rate: Vector
    reach: Vector
    free_slots: list[int] = field(default_factory=list[int])


def empty_lanes(n_lanes: int, n_x: int, n_q: int, n_p: int) -> Lanes:
    """Return lanes none of which runs.

    Args:
        n_lanes: How many.
        n_x: Number of states.
        n_q: Number of coordinates.
        n_p: Number of gains and parameters.
    """

    def zeros() -> Vector:
        return np.zeros(n_lanes)

    def flags() -> NDArray[np.bool_]:
        return np.zeros(n_lanes, dtype=bool)

    def counts() -> Rows:
        return np.zeros(n_lanes, dtype=np.intp)

    return Lanes(
        alive=flags(),
        leader=np.arange(n_lanes, dtype=np.intp),
        mode=np.zeros(n_lanes, dtype=np.int8),
        y=np.zeros((n_lanes, n_x + 2)),
        p=np.zeros((n_lanes, n_p + 1)),
        tolerance=zeros(),
        until=zeros(),
        leg_time=zeros(),
        unit=np.ones(n_lanes),
        offset=zeros(),
        size=zeros(),
        guard=np.zeros((n_lanes, 2)),
        on_guard=flags(),
        refused=flags(),
        largest=zeros(),
        steps=counts(),
        restitution=zeros(),
        impacts=counts(),
        struck=zeros(),
        zeno_time=zeros(),
        zeno_acceleration=zeros(),
        largest_rate=np.zeros((n_lanes, n_x)),
        reach=np.zeros((n_lanes, n_q)),
        free_slots=list(range(n_lanes))[::-1],
    )
