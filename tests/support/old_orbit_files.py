"""Plain data of orbits of one stop as versions up to 0.3.0 wrote them: formats 1 and 2."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from zeno_orbits.orbits import Orbit, OrbitImpact, OrbitPhase


def old_data(orbit: Orbit) -> dict[str, Any]:
    """Return an orbit in format 1, or in format 2 if it has several phases or no contact.

    Args:
        orbit: The orbit, of a machine with one stop.
    """
    one = orbit.shape.text in ("zeno", "plastic")
    entries = orbit.as_json()
    for name in ("sequence", "start_state", "events"):
        del entries[name]
    if not one:
        return entries | {"format": 2, "phases": [_phase(phase) for phase in orbit.phases]}
    return entries | {
        "format": 1,
        "release_state": dict(orbit.release_state),
        "impacts": _impacts(orbit.impacts),
        "zeno_time": orbit.zeno_time,
        "zeno_state": dict(orbit.zeno_state),
    }


def _phase(phase: OrbitPhase) -> dict[str, Any]:
    zeno = {}
    if phase.zeno_state is not None:
        zeno = {"zeno_time": phase.zeno_time, "zeno_state": dict(phase.zeno_state)}
    return {
        "kind": phase.kind.value,
        "start_time": phase.start_time,
        "start_state": dict(phase.start_state),
        "impacts": _impacts(phase.impacts),
        **zeno,
    }


def _impacts(impacts: Sequence[OrbitImpact]) -> list[dict[str, Any]]:
    return [{"time": one.time, "state_minus": dict(one.state_minus)} for one in impacts]
