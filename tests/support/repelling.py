"""The repelling orbit of the reference pendulum that a feedback once per period keeps."""

from __future__ import annotations

from functools import cache

import zeno_orbits as zo

KD = -1.579094074075361
START = {"theta1": 0.361422331844671, "dtheta1": -5.874916190354418, "current": -3.333635846498841}


@cache
def repelling_orbit() -> zo.Orbit:
    """Return the orbit at Kp = 2.5 and this Kd."""
    gains = {"Kp": 2.5, "Kd": KD}
    return zo.find_orbit_by_shooting("motor_pendulum", gains=gains, start=START).unwrap()
