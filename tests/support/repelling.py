"""The repelling orbit of the reference pendulum that a feedback once per period keeps."""

from __future__ import annotations

import zeno_orbits as zo

KD = -1.579094074075361
GAINS = {"Kp": 2.5, "Kd": KD}
START = {"theta1": 0.361422331844671, "dtheta1": -5.874916190354418, "current": -3.333635846498841}


def repelling_orbit() -> zo.Orbit:
    """Return the orbit, from the gains and the state at its release."""
    return zo.find_orbit_by_shooting("motor_pendulum", gains=GAINS, start=START).unwrap()
