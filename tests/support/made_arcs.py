"""Arcs whose one state is the time of their own flow: what is said of them is plain arithmetic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.simulation import Arc, Ending, Mode

START, UNIT = 4.0, 2.0


@dataclass(frozen=True)
class Ramp:
    """A flow whose one state is its own time, with another behind it as in a rescaled flight."""

    times: Vector

    @property
    def duration(self) -> float:
        return float(self.times[-1])

    @property
    def states(self) -> Vector:
        return np.column_stack([self.times, 99.0 + 0 * self.times])

    def state_at(self, offset: float) -> Vector:
        return np.array([offset, 99.0])

    def states_at(self, offsets: Vector) -> Vector:
        return np.column_stack([offsets, np.full(len(offsets), 99.0)])


def ramp(*times: float, start: float = START) -> Arc:
    """An arc whose state is its flow's own time, in units of 2 s, at these steps."""
    return Arc(
        mode=Mode.FREE,
        start_time=start,
        end_time=start + UNIT * times[-1],
        start_state=np.array([times[0]]),
        end_state=np.array([times[-1]]),
        ending=Ending.IMPACT,
        impact_index=0,
        time_unit=UNIT,
        trajectory=Ramp(np.array(times)),
    )
