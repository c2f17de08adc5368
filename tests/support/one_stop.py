"""The bundled problems with one stop and no switch, and those with several stops or switches."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from zeno_orbits.model import bundled_problems, load_problem


@cache
def one_stop_problems() -> dict[str, Path]:
    """Return name to path of the bundled problems with one stop and no switch."""
    return {
        name: path for name, path in bundled_problems().items() if not load_problem(name).has_graph
    }


GRAPHS = {
    "relay": 0.09,
    "relay_soft": 0.09,
    "clapper": 30.0,
    "kneed_walker": 2.0,
    "hopper": 5.0,
    "limited_pendulum": 4.0,
    "sampled_pendulum": 4.0,
    "shaken_block": 12.0,
    "sticking_pendulum": 4.0,
    "stick_slip": 30.0,
    "guided_hammer": 1.0,
}
"""The bundled problems with several stops or switches, and a time with their events [s]."""
