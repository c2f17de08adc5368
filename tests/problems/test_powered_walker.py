"""The walker on flat ground with two motors: an independent event loop, energy, and 100 steps."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference import kneed_walker
from tests.reference.event_loop import simulated
from tests.support.orbits import event_orbit

WEIGHT = 1.6 * 9.8
"""Of two legs of 0.55 kg each and a hip of 0.5 kg [N]."""

_orbit = partial(event_orbit, "powered_walker")


def _state(state: Any) -> np.ndarray:
    return np.array([state[name] for name in ("q1", "q2", "q3", "dq1", "dq2", "dq3")])


def _step(orbit: zo.Orbit) -> float:
    """Return the distance of the feet of both straight legs at heel strike [m]."""
    strike = orbit.events[-1].state
    return math.sin(strike["q2"]) - math.sin(strike["q1"])


@pytest.mark.slow
def test_an_independent_event_loop_returns_after_the_same_events_with_the_same_energy() -> None:
    orbit = _orbit()
    assert orbit.certificate["passed"]
    assert orbit.certificate["stable"]
    assert orbit.sequence == ("zeno knee", "switch heel strike")
    start = _state(orbit.start_state)
    machine = kneed_walker.walker(0.2, slope=0.0, drive=kneed_walker.motors)
    run = simulated(machine, (*start, 0.0), 1.05 * orbit.period, closed=("knee",))
    strike = next(event for event in run.events if event.kind == "switch")
    assert strike.time == pytest.approx(orbit.period, abs=1e-10)
    assert strike.after[:6] == pytest.approx(start, abs=1e-9)
    assert strike.after[6] == pytest.approx(orbit.certificate["energies"]["input_work"], abs=1e-9)
    knee = next(event for event in run.events if event.kind == "impact")
    rest = next(event for event in run.events if event.kind == "zeno")
    times = {event.name: event.time for event in reversed(orbit.events)}
    assert times["impact knee"] == pytest.approx(knee.time, abs=1e-10)
    assert times["zeno knee"] == pytest.approx(rest.time, abs=1e-10)


@pytest.mark.slow
def test_the_walk_has_the_stated_speed_and_cost_of_transport() -> None:
    orbit = _orbit()
    energies, step = orbit.certificate["energies"], _step(orbit)
    assert step / orbit.period == pytest.approx(0.368, abs=5e-4)
    cost = energies["input_work"] / (WEIGHT * step)
    assert cost == pytest.approx(0.121, abs=5e-4)
    # What neither heats the motors nor is lost in a knee is lost at heel strike.
    losses = energies["copper_loss"] + energies["impact_loss"] + energies["switch_loss"]
    assert energies["input_work"] == pytest.approx(losses, abs=1e-10)


def test_the_swing_foot_stays_above_the_ground() -> None:
    orbit = _orbit()
    run = zo.simulate("powered_walker", until=orbit.period, start=orbit.start_state)
    times, states = run.sampled()
    inside = (times > 0.02 * orbit.period) & (times < 0.98 * orbit.period)
    stance, thigh, shank = np.cos(states[inside, :3]).T
    assert np.min(stance - (thigh + shank) / 2) > 1e-4


@pytest.mark.parametrize("part", [pytest.param(0.9, marks=pytest.mark.slow), 1.1])
def test_the_walk_survives_a_hundred_steps_from_a_perturbed_start(part: float) -> None:
    orbit = _orbit()
    start = dict(orbit.start_state)
    for name in ("dq1", "dq2", "dq3"):
        start[name] *= part
    run = zo.simulate("powered_walker", until=105 * orbit.period, start=start)
    steps = np.diff([0.0, *(event.time for event in run.switches)])
    assert len(steps) >= 100
    assert abs(steps[0] - orbit.period) > 0.01 * orbit.period
    assert steps[-1] == pytest.approx(orbit.period, abs=1e-11)


def test_without_current_the_walk_ends() -> None:
    # On flat ground each heel strike takes energy, and nothing gives it back.
    run = zo.simulate(
        "powered_walker", until=20.0, start=_orbit().start_state, parameters={"R": 1e9}
    )
    assert len(run.switches) < 10
    assert abs(run.end_state[0]) > math.pi / 2


@pytest.mark.slow
def test_a_search_finds_gains_for_a_faster_and_cheaper_step() -> None:
    found = zo.search_gains("powered_walker", objective=zo.TargetPeriod(target=0.55))
    orbit = found.orbit
    assert orbit is not None
    assert orbit.certificate["passed"]
    assert orbit.certificate["stable"]
    assert orbit.period == pytest.approx(0.55, abs=1e-10)
    assert orbit.sequence == ("zeno knee", "switch heel strike")
    cost = orbit.certificate["energies"]["input_work"] / (WEIGHT * _step(orbit))
    assert _step(orbit) / orbit.period == pytest.approx(0.362, abs=1e-3)
    assert cost == pytest.approx(0.0865, abs=1e-3)
    assert orbit.gains != _orbit().gains
