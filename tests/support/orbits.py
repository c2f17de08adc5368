"""Orbits that several files of tests ask for, and orbits with some of their numbers changed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import zeno_orbits as zo
from zeno_orbits.orbits import Orbit

_OF_PHASE = {"release_state": "start_state", "start_state": "start_state"}
_ENTRIES = {"kind", "start_time", "impacts", "zeno_time", "zeno_state", *_OF_PHASE}


@cache
def event_orbit(name: str, section: str | None = None, **numbers: float) -> zo.Orbit:
    """Return the orbit of events of a bundled problem, which a process searches once.

    Args:
        name: Of the problem.
        section: Where the period starts.
        numbers: Parameters by name.
    """
    return zo.find_orbit(name, parameters=numbers, section=section).unwrap()


@cache
def shot_orbit(name: str) -> zo.Orbit:
    """Return the orbit of a bundled problem by shooting, which a process searches once."""
    return zo.find_orbit_by_shooting(name).unwrap()


def changed(orbit: Orbit, place: int = 0, **entries: Any) -> Orbit:
    """Return an orbit with other entries; those of a phase are changed in one of them.

    Args:
        orbit: The orbit.
        place: Which phase.
        entries: Name of each entry, as its file calls it, to its value.
    """
    inner = {_OF_PHASE.get(k, k): v for k, v in entries.items() if k in _ENTRIES}
    outer = {k: v for k, v in entries.items() if k not in _ENTRIES}
    if not inner:
        return replace(orbit, **outer)
    phases = list(orbit.phases)
    phases[place] = replace(phases[place], **inner)
    return replace(orbit, **outer).with_phases(phases)
