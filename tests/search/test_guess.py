"""First guesses: motions that repeat, and the reasons why others do not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import PERIOD
from tests.support.mechanisms import falling_away, forced_oscillator, oscillator_state, spring_mass
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import Problem
from zeno_orbits.search import guess
from zeno_orbits.search.guess import SettlingSettings, settle
from zeno_orbits.simulation.execution import Execution
from zeno_orbits.simulation.simulator import simulate

SHORT = SettlingSettings(horizon=30.0)
LOCKED = oscillator_state(0.0, FORCED.stop, 0.0)


def test_the_pendulum_settles_to_the_declared_period(
    machine: HybridDynamics, problem: Problem
) -> None:
    settling = settle(machine, [problem.state_vector({"theta1": 0.6})])
    assert settling.reason == ""
    assert settling.cycle is not None
    # The motion repeats to 1e-6; what is left shrinks by 0.02 a period.
    assert settling.cycle.period == pytest.approx(PERIOD, abs=1e-6)
    assert settling.cycle.drift(settling.cycle.scale()) < SettlingSettings().settled


def test_a_motion_that_repeats_from_the_start_is_known_at_once() -> None:
    settling = settle(forced_oscillator(FORCED, 0.5), [LOCKED], replace(SHORT, chunk=20.0))
    assert settling.cycle is not None
    assert settling.cycle.period == pytest.approx(2 * math.pi, abs=1e-8)


def test_a_mass_that_leaves_for_good_runs_away() -> None:
    settling = settle(falling_away(1.0), [(0.0, 1.0)], SHORT)
    assert settling.cycle is None
    assert settling.reason == "x0 runs away"


def test_a_mass_at_rest_off_its_stop_dies_out() -> None:
    settling = settle(spring_mass(1.0, 0.5), [(0.0, 0.0)], SHORT)
    assert settling.reason == "the motion dies out"


def test_a_mass_that_swings_without_impacts_has_no_zeno_point() -> None:
    settling = settle(spring_mass(1.0, 0.5), [(0.5, 0.0)], SHORT)
    assert settling.reason == "no release is followed by a Zeno point after 30 s"


def test_a_mass_that_bounces_for_ever_has_no_zeno_point(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.5})
    bouncing = problem.dynamics(values)
    settling = settle(bouncing, [problem.state_vector({"theta1": 0.6})], SHORT)
    assert settling.cycle is None
    assert settling.reason.endswith("after 30 s")


def test_a_start_that_cannot_be_simulated_says_so() -> None:
    right = forced_oscillator(FORCED, 0.5)
    wrong = replace(right, reset_map=lambda x, rate: right.reset_map(x, -rate))
    settling = settle(wrong, [LOCKED], SHORT)
    words = "the simulation stops: the reset map sends the state into the stop"
    assert settling.reason.lower() == words


def test_the_first_start_that_settles_is_taken() -> None:
    settling = settle(forced_oscillator(FORCED, 0.5), [(-2.0, 0.0, 0.0, 0.0), LOCKED], SHORT)
    assert settling.cycle is not None


def test_every_reason_is_told_once() -> None:
    resting, swinging = (0.0, 0.0), (0.5, 0.0)
    settling = settle(spring_mass(1.0, 0.5), [resting, swinging, resting], SHORT)
    assert settling.reason == (
        "the motion dies out / no release is followed by a Zeno point after 30 s"
    )


@pytest.mark.parametrize(
    ("horizon", "chunk", "runs"), [(25.0, 10.0, 3), (5.0, 1.0, 5), (3.0, 10.0, 1)]
)
def test_a_motion_is_not_followed_beyond_the_horizon(
    monkeypatch: pytest.MonkeyPatch, horizon: float, chunk: float, runs: int
) -> None:
    lengths: list[float] = []

    def counted(*arguments: Any, until: float, **options: Any) -> Execution:
        lengths.append(until)
        return simulate(*arguments, until=until, **options)

    monkeypatch.setattr(guess, "simulate", counted)
    settling = settle(
        spring_mass(1.0, 0.5), [(0.5, 0.0)], replace(SHORT, horizon=horizon, chunk=chunk)
    )
    assert settling.reason == f"no release is followed by a Zeno point after {horizon:g} s"
    # The last look may go over the horizon by less than a chunk.
    assert lengths == [chunk] * runs


def test_a_motion_that_still_drifts_is_a_guess_if_it_drifts_little(
    machine: HybridDynamics, problem: Problem
) -> None:
    # With a multiplier of 0.02 the third or fourth period repeats to 1e-3 but not to 1e-15.
    start = problem.state_vector({"theta1": 0.6})
    strict = SettlingSettings(horizon=10.0, settled=0.0)
    assert settle(machine, [start], strict).cycle is not None
    hopeless = settle(machine, [start], replace(strict, usable=0.0))
    assert hopeless.cycle is None
    assert hopeless.reason == "its periods differ after 10 s"


@pytest.mark.parametrize(
    ("what", "numbers"),
    [
        ("clock", {"rho": 0.2, "lean": 0.15, "c": 0.02}),
        ("stop", {"rho": 0.05, "lean": 0.4, "c": 0.05}),
    ],
)
def test_a_long_loose_simulation_does_not_drift_off_what_a_start_has_to_keep(
    what: str, numbers: dict[str, float]
) -> None:
    # Without being put back, the state leaves clock or stop by 1e-8, and no simulation admits it.
    problem = load_problem("curved_surface")
    dynamics = problem.dynamics(problem.values(parameters=numbers))
    settling = settle(dynamics, [problem.state_vector(start) for start in problem.starts])
    assert (settling.cycle is not None) == (what == "clock")


def test_a_motion_that_comes_back_after_more_than_a_chunk_is_found() -> None:
    # The period is 2 pi; every look but those from a release is shorter by far.
    settling = settle(forced_oscillator(FORCED, 0.5), [LOCKED], replace(SHORT, chunk=1.0))
    assert settling.cycle is not None
    assert settling.cycle.period == pytest.approx(2 * math.pi, abs=1e-8)
