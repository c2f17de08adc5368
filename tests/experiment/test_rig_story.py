"""Machines with stiff stops tell the story of their orbits, on every problem with a contact phase.

Theory (6.6): a contact lasts some `sqrt(m_n / k)`, and a machine differs from its orbit by as much,
relative to the period. So the stiffness is chosen by what part of the period a contact lasts.
"""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from zeno_orbits.errors import InputError
from zeno_orbits.experiment import RigComparison, compare_cycles, settle_rig, tabulate_orbit
from zeno_orbits.model import Contact, Problem, Rig, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import orbit_by_shooting

MACHINES = Path(__file__).parents[1] / "support" / "machines"
LOCKED = (
    "curved_surface",
    "forced_oscillator",
    "motor_cart",
    "motor_pendulum",
    "motor_valve",
    "torque_pendulum",
    "two_motors",
    "vibrating_table",
)


def orbit_of(problem: Problem) -> Orbit:
    return orbit_by_shooting(problem, problem.values()).unwrap()


def machine(problem: Problem, orbit: Orbit, share: float) -> RigComparison:
    """Return the cycles of a machine whose contacts last a share of the period, over pi."""
    dynamics = problem.dynamics(orbit.values(problem))
    inertia = dynamics.normal_inertia(np.array(problem.state_vector(orbit.zeno_state)))
    stop = Contact(stiffness=inertia / (share * orbit.period) ** 2)
    settled = settle_rig(orbit, problem, Rig(contact=stop), cycles=4)
    return compare_cycles(orbit, problem, settled)


def distances(found: RigComparison) -> dict[str, float]:
    """Return how far the machine's numbers are from the orbit's: times in periods, others of 1.

    A locked coordinate that is zero counts in the way of an impact's speed over a period.
    """
    orbit, mean = asdict(found.orbit), asdict(found.mean)
    way = abs(orbit["impact_rate"]) * orbit["period"]
    size = {name: abs(value) or way for name, value in orbit.items()}
    size |= dict.fromkeys(("impact_time", "lock_time", "period"), orbit["period"])
    return {name: abs(mean[name] - orbit[name]) / size[name] for name in orbit}


@pytest.mark.slow
@pytest.mark.parametrize("name", LOCKED)
def test_a_machine_tends_to_its_orbit_as_the_stop_stiffens(name: str) -> None:
    problem = load_problem(name)
    orbit = orbit_of(problem)
    soft, stiff = (machine(problem, orbit, share) for share in (1e-3, 1e-5))
    assert not soft.drifting
    assert not stiff.drifting
    for what, away in distances(stiff).items():
        # The square root of the compliance: a hundredth, where the number is off at all. The end of
        # the chatter goes up and down by a contact more or less.
        before = distances(soft)[what]
        assert away < max(before / (10 if what.startswith("lock") else 50), 1e-7), what
        assert before < 0.05, what
    assert stiff.portrait < soft.portrait / 3
    assert max(asdict(stiff.spread).values()) < 1e-4 * orbit.period


@pytest.mark.parametrize(
    ("name", "shape"), [("impact_oscillator", "impact"), ("two_tone_table", "zeno*2")]
)
def test_a_motion_of_another_shape_is_refused_by_name(name: str, shape: str) -> None:
    problem = load_problem(name)
    orbit, reason = orbit_of(problem), re.escape(f"but its shape is `{shape}`")
    with pytest.raises(InputError, match=reason):
        settle_rig(orbit, problem, Rig(), cycles=1, settle=1)
    # Nor are recordings held against it.
    with pytest.raises(InputError, match=reason):
        tabulate_orbit(orbit, problem, problem.state_names[:1])
