"""Executions made by hand: no motion, but arcs and events at times that are chosen."""

from __future__ import annotations

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.simulation import Arc, Ending, Event, Execution, Impact, Mode, Release, ZenoPoint

_ENDINGS = {
    "i": Ending.IMPACT,
    "t": Ending.IMPACT,
    "p": Ending.IMPACT,
    "z": Ending.ZENO,
    "r": Ending.RELEASE,
    "f": Ending.HORIZON,
    "l": Ending.HORIZON,
}


def execution_of(*legs: tuple[str, float]) -> Execution:
    """Return an execution of arcs, each a letter for what it is and the time of its end.

    A flight goes to an impact (``i``), to a touch without one (``t``), to a plastic impact (``p``),
    to the Zeno point as the tail of an accumulation (``z``) or to the end (``f``), a locked arc to
    a release (``r``) or to the end (``l``). The state is
    the time and a number, -1 before an impact, 1 after it and 0 elsewhere.
    """
    arcs: list[Arc] = []
    events: list[Event] = []
    time = 0.0
    for letter, end in legs:
        arc = Arc(
            mode=Mode.LOCKED if letter in "rl" else Mode.FREE,
            start_time=time,
            end_time=end,
            start_state=at(time),
            end_state=at(end),
            ending=_ENDINGS[letter],
            impact_index=sum(isinstance(event, Impact) for event in events),
            time_unit=1.0,
            trajectory=None,
        )
        arcs.append(arc)
        if letter in "ip":
            events.append(
                Impact(time=end, state_minus=at(end, -1), state_plus=at(end, 1), approach_rate=-1.0)
            )
        if letter in "zp":
            tail = end - time if letter == "z" else 0.0
            events.append(
                ZenoPoint(time=end, state=at(end), limit_error=0.0, tail=tail, last_speed=tail)
            )
        if letter == "r":
            events.append(Release(time=end, state=at(end)))
        time = end
    return Execution(state_names=("time", "side"), arcs=tuple(arcs), events=tuple(events))


def at(time: float, side: float = 0.0) -> Vector:
    """Return the state of such an execution."""
    return np.array([time, side])
