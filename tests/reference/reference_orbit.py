"""The reference orbit, measured beforehand by a Taylor integration and Newton on the return map."""

from __future__ import annotations

RELEASE = (0.1985068301199, 0.0, -5.2365375521764, 0.0, -1.8591703843225)
PERIOD = 1.81371293903044
FIRST_IMPACT = 0.9809551249210
FIRST_RATE = -16.909711305434
ZENO_TIME = 1.3200260238375
ZENO_STATE = (1.236168909791, 0.0, 1.749207992260, 0.0, -0.460250671559)
MULTIPLIER = -0.0193686
"""The largest; the other one is zero to rounding."""
PERIODS = {0.0: 1.82033892548, 0.1: 1.81767797277, 0.3: 1.81128512357}
"""Restitution to period."""

ORBIT_KEYS = {
    "format",
    "problem",
    "parameters",
    "gains",
    "shape",
    "period",
    "sequence",
    "start_state",
    "events",
    "floquet_multipliers",
    "certificate",
    "versions",
}
"""Entries that an orbit file must have: the contract (docs/orbit_file.md)."""
