"""Periods made by hand, of which every number is known: nothing is integrated."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from zeno_orbits.simulation import Arc, Ending, Impact, Mode, ZenoPoint


def system(**parts: Any) -> Any:
    """Return a system whose state is the gap, its rate and the multiplier."""
    named = {
        "n_q": 1,
        "restitution": 0.5,
        "gap": lambda x: float(x[0]),
        "gap_rate": lambda x: float(x[1]),
        "multiplier": lambda x: float(x[2]),
        "gap_acceleration": lambda x: -10.0 * float(x[2]),
        "multiplier_rate": lambda x: -100.0 * float(x[2]),
        "normal_inertia": lambda x: 2.0 + float(x[2]),
        "energy": lambda x: (2.0 + float(x[2])) * float(x[1]) ** 2 / 2,
        "holonomic": lambda _: np.array([]),
        "impulse_direction": lambda _: np.array([0.0, 1.0, 0.0]),
        "on_stop": lambda x: np.array([0.0, 0.0, x[2]]),
        "differentiation": None,
    }
    made = SimpleNamespace(**{**named, **parts})
    made.as_graph = lambda stop: SimpleNamespace(
        stop_names=(stop,), mode_of=lambda _, sides: ((), sides), view=lambda *_: made
    )
    return made


def state(*entries: float) -> Any:
    """Return a state."""
    return np.array(entries, dtype=float)


def impact(time: float, before: Sequence[float], after: Sequence[float] | None = None) -> Impact:
    """Return an impact; by default it halves the speed and turns it round."""
    rate = before[1]
    plus = state(before[0], -0.5 * rate, *before[2:]) if after is None else state(*after)
    return Impact(time=time, state_minus=state(*before), state_plus=plus, approach_rate=rate)


def zeno(time: float, x: Sequence[float], **parts: float) -> ZenoPoint:
    """Return a Zeno point with a tail of a tenth of a second."""
    named = {"limit_error": 0.0, "tail": 0.1, "last_speed": 0.25, **parts}
    return ZenoPoint(time=time, state=state(*x), **named)


def arc(
    mode: Mode,
    times: Sequence[float],
    states: Sequence[Sequence[float]],
    *,
    flow: Sequence[Sequence[float]] | None = None,
    unit: float = 1.0,
) -> Arc:
    """Return an arc through states; ``flow`` are those of the flow itself, if they differ.

    Without ``flow`` between two states it is straight.
    """
    inner = np.array(states if flow is None else flow, dtype=float)
    straight = flow is None and len(states) == 2
    steps = SimpleNamespace(
        times=(np.array(times) - times[0]) / unit,
        states=inner,
        duration=(times[-1] - times[0]) / unit,
    )
    return Arc(
        mode=mode,
        start_time=times[0],
        end_time=times[-1],
        start_state=state(*states[0]),
        end_state=state(*states[-1]),
        ending=Ending.IMPACT if mode is Mode.FREE else Ending.RELEASE,
        impact_index=0,
        time_unit=unit,
        trajectory=None if straight else steps,
    )
