"""Orbits closed by simulation are the orbits that other routes find, or are said to be none."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import PERIOD, PERIODS, RELEASE, ZENO_STATE, ZENO_TIME
from tests.support import sheets
from tests.support.mechanisms import clocked_oscillator
from tests.support.orbits import changed
from tests.support.returns import next_release, release_return, release_section
from zeno_orbits import HybridLagrangian, StateLimit, hybrid_system, no_drive
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.integrators import Automatic, Engine, Radau
from zeno_orbits.model import CompletedSystem, Problem, load_problem
from zeno_orbits.orbits import (
    Orbit,
)
from zeno_orbits.search import (
    OrbitNotClosedError,
    SearchStatus,
    orbit_at_gains,
    orbit_by_shooting,
    search_orbits,
)
from zeno_orbits.search.closing.limits import beyond_limits
from zeno_orbits.simulation import SimulationSettings, Truncation, simulate
from zeno_orbits.verification import VerificationSettings, multipliers_of, verify

SETTINGS = SimulationSettings()
PULL = 0.02
"""How strongly the repelling clock leaves its circle."""


def simulated_by(engine: Engine) -> SimulationSettings:
    return replace(SETTINGS, engine=engine)


def repelling_clock(pull: float = PULL) -> Problem:
    """Return the clocked oscillator whose clock leaves `y^2 + y'^2 = 1`, which it stays on else."""

    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        away = pull * (q[1] ** 2 + v[1] ** 2 - 1) * v[1]
        mechanism = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=ca.sumsqr(q) / 2,
            gap=FORCED.stop - q[0],
            passive_force=ca.vertcat(q[1] - FORCED.damping * v[0], away),
        )
        return hybrid_system(mechanism, no_drive(mechanism), p["restitution"])

    return replace(clocked_oscillator(FORCED, attracting=True), model=model)


# Orbits that are known.


@pytest.mark.parametrize("engine", [Automatic(), Radau()], ids=["Automatic", "Radau"])
def test_the_orbit_is_the_reference_orbit(problem: Problem, engine: Engine) -> None:
    closed = orbit_by_shooting(problem, problem.values(), simulation=simulated_by(engine))
    orbit = closed.unwrap()
    # The reference has 13 digits; integration adds its tolerance, 1e-12.
    assert orbit.period == pytest.approx(PERIOD, rel=2e-12)
    assert orbit.zeno_time == pytest.approx(ZENO_TIME, rel=5e-12)
    assert list(orbit.release_state.values()) == pytest.approx(RELEASE, rel=1e-11, abs=1e-12)
    assert list(orbit.zeno_state.values()) == pytest.approx(ZENO_STATE, rel=1e-11, abs=1e-11)
    assert closed.miss <= 1e-12


@pytest.mark.parametrize("restitution", PERIODS)
def test_other_restitutions_have_their_known_periods(problem: Problem, restitution: float) -> None:
    values = problem.values(parameters={"restitution": restitution})
    # Of eleven decimals the last is not sure: at 0.1 the 25 digits of tests/reference/many_digits
    # end in 2738 where these say 277; they confirm ours to 3e-14.
    assert orbit_by_shooting(problem, values).unwrap().period == pytest.approx(
        PERIODS[restitution], abs=5e-11
    )


@pytest.mark.slow
def test_simulation_and_collocation_find_the_same_orbit(problem: Problem) -> None:
    values = problem.values(gains={"Kp": 4.0})
    closed, found = (
        orbit_by_shooting(problem, values).unwrap(),
        orbit_at_gains(problem, values).unwrap(),
    )
    # The search promises agreement with a simulation to 3e-10.
    assert closed.period == pytest.approx(found.period, rel=1e-9)
    for name, value in closed.release_state.items():
        assert value == pytest.approx(found.release_state[name], rel=1e-9, abs=1e-9)


@pytest.mark.slow
def test_an_orbit_closed_by_one_engine_is_certified_on_the_hand_written_model(
    problem: Problem,
) -> None:
    orbit = orbit_by_shooting(problem, problem.values(gains={"Kp": 3.0})).unwrap()
    settings = VerificationSettings(use_reference=True, n_periods=1)
    certificate = verify(orbit, problem, settings=settings)
    assert certificate.passed, certificate.verdict()


def test_the_orbit_of_a_problem_without_gains_has_the_period_of_its_clock() -> None:
    problem = clocked_oscillator(FORCED, attracting=True)
    orbit = orbit_by_shooting(problem, problem.values()).unwrap()
    assert orbit.period == pytest.approx(2 * math.pi, abs=1e-10)


def test_an_orbit_at_other_gains_is_a_start(problem: Problem, orbit: Orbit) -> None:
    values = problem.values(gains={"Kp": 2.6})
    near = orbit_by_shooting(problem, values, near=orbit, simulation=SETTINGS)
    assert near.unwrap().gains["Kp"] == 2.6
    settled = orbit_by_shooting(problem, values, simulation=SETTINGS).unwrap()
    assert near.unwrap().period == pytest.approx(settled.period, rel=1e-11)


# A repelling orbit: returns alone lead away from it.


def test_a_repelling_orbit_is_closed_from_near_it() -> None:
    problem = repelling_clock()
    attracting = clocked_oscillator(FORCED, attracting=True)
    # Both clocks share the circle, and so the orbit on it.
    known = orbit_by_shooting(attracting, attracting.values(), simulation=SETTINGS).unwrap()
    off = {**known.release_state}
    off = {**off, "y": 1.003 * off["y"], "dy": 1.003 * off["dy"]}
    near = changed(known, release_state=off)
    closed = orbit_by_shooting(problem, problem.values(), near=near, simulation=SETTINGS).unwrap()
    assert closed.period == pytest.approx(2 * math.pi, abs=1e-9)
    release = closed.release_state
    # Off the circle it would grow by exp(2 pi PULL) a period, 1.13.
    assert math.hypot(release["y"], release["dy"]) == pytest.approx(1.0, abs=1e-10)


def test_an_orbit_that_is_left_later_is_certified_by_its_first_period() -> None:
    pull = 0.5
    problem, attracting = repelling_clock(pull), clocked_oscillator(FORCED, attracting=True)
    known = orbit_by_shooting(attracting, attracting.values(), simulation=SETTINGS).unwrap()
    # Outside by 1e-11, the clock is off by exp(pi) more after every turn, and soon diverges.
    off = {name: known.release_state[name] * (1 + 1e-11) for name in ("y", "dy")}
    # The equations of its clock are others on purpose.
    orbit = changed(known, release_state={**known.release_state, **off}, problem_digest=())
    machine = problem.dynamics(orbit.values(problem))
    with pytest.raises(SimulationError):
        simulate(machine, list(orbit.release_state.values()), until=12 * orbit.period)
    certificate = verify(orbit, problem, settings=VerificationSettings(n_periods=12))
    assert certificate.passed, certificate.verdict()
    assert certificate.unstable
    # Areas of the clock grow at the rate 2 pull y'^2, as at the rate pull over a turn.
    assert certificate.multipliers[0] == pytest.approx(math.exp(2 * math.pi * pull), abs=1e-7)


FOLD = -1.6218
"""`Kd` at which the pendulum's orbits turn round, at `Kp = 2.5`: two above it, none below."""


@pytest.fixture(name="behind_the_fold", scope="module")
def _behind_the_fold(problem: Problem) -> Orbit:
    """The repelling orbit of the pendulum at `Kd = -1.6`, which no simulation settles to.

    The family of orbits is followed round its fold: from release state and gain along the null
    vector of `(dP/dx - 1, dP/dp)`, and back onto it by Newton's method at right angles to that.
    """
    place = problem.names.index("Kd")
    entries = np.array(problem.values(gains={"Kd": -1.6}).vector)
    start = orbit_by_shooting(
        problem, problem.values(gains={"Kd": -1.6}), simulation=SETTINGS
    ).unwrap()
    z = np.append(list(start.release_state.values()), -1.6)
    # The release state changes far more than the gain there.
    size = np.array([1.0, 1.0, 5.0, 5.0, 1.0, 2.0])
    ahead, period = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -1.0]), start.period

    def looked_at(z: Vector) -> tuple[Vector, Vector, Vector, float]:
        entries[place] = z[-1]
        machine = problem.dynamics(entries)
        x = release_section(machine, z[:-1], size[:-1]).state(machine, np.zeros(2))
        seen = release_return(machine, x, guess=period, parameters=(place,))
        matrix = np.hstack([seen.by_state - np.eye(5), seen.by_parameters]) * size
        return np.append(x, z[-1]), seen.end - x, matrix, seen.period

    z, miss, matrix, period = looked_at(z)
    for _ in range(25):
        null = np.linalg.svd(matrix)[2][-1]
        ahead = null * np.sign(null @ ahead)
        z = z + 0.01 * size * ahead
        for _ in range(6):
            z, miss, matrix, period = looked_at(z)
            if np.max(np.abs(miss)) < 1e-8:
                break
            right = np.append(miss, 0.0)
            z = z - size * np.linalg.lstsq(np.vstack([matrix, ahead]), right, rcond=None)[0]
        if ahead[-1] > 0.0 and z[-1] > -1.6:
            break
    names = problem.state_names
    near = changed(
        start,
        release_state=dict(zip(names, z[:-1].tolist(), strict=True)),
        period=period,
        gains={**start.gains, "Kd": float(z[-1])},
    )
    values = problem.values(gains={"Kd": -1.6})
    return orbit_by_shooting(problem, values, near=near, simulation=SETTINGS).unwrap()


def test_beside_the_attracting_orbit_there_is_a_repelling_one(
    problem: Problem, behind_the_fold: Orbit
) -> None:
    values = problem.values(gains={"Kd": -1.6})
    settled = orbit_by_shooting(problem, values, simulation=SETTINGS).unwrap()
    # They are apart by 0.11 s, and meet at the fold.
    assert behind_the_fold.period - settled.period == pytest.approx(0.108, abs=2e-3)
    assert behind_the_fold.gains["Kd"] > FOLD


@pytest.mark.slow
def test_a_repelling_orbit_of_the_pendulum_is_verified_and_called_unstable(
    problem: Problem, behind_the_fold: Orbit
) -> None:
    for by_hand in (False, True):
        settings = VerificationSettings(use_reference=by_hand)
        certificate = verify(behind_the_fold, problem, settings=settings)
        assert certificate.passed, certificate.verdict()
        assert certificate.unstable
        assert not certificate.stable
        assert "an unstable Zeno periodic orbit" in certificate.verdict()
        assert "drift" not in certificate.residuals


def test_the_multiplier_of_a_repelling_orbit_is_that_of_differences(
    problem: Problem, behind_the_fold: Orbit
) -> None:
    machine = problem.dynamics(behind_the_fold.values(problem))
    x = np.array(list(behind_the_fold.release_state.values()))
    scale, period = np.abs(x) + 1.0, behind_the_fold.period
    exact = multipliers_of(behind_the_fold, problem)
    section = release_section(machine, x, scale)

    def image(coordinates: Vector) -> Vector:
        start = section.state(machine, coordinates)
        _, end = next_release(machine, start, guess=period)
        return section.coordinates(end)

    def slope(step: float) -> Vector:
        columns = [(image(step * one) - image(-step * one)) / (2 * step) for one in np.eye(2)]
        return np.transpose(columns)

    measured = (4 * slope(2e-5) - slope(4e-5)) / 3
    # The two charts may be turned against each other.
    assert np.poly(exact.jacobian) == pytest.approx(np.poly(measured), abs=1e-7)
    largest = max(np.linalg.eigvals(measured), key=abs)
    assert exact.values[0] == pytest.approx(largest, abs=1e-7)
    assert exact.values[0].real == pytest.approx(2.23, abs=0.01)
    assert exact.error < 1e-9


# No orbit.


def test_a_problem_without_an_orbit_says_why() -> None:
    ball = load_problem("bouncing_ball")
    closed = orbit_by_shooting(ball, ball.values())
    assert closed.orbit is None
    assert closed.miss == math.inf
    assert closed.detail
    with pytest.raises(OrbitNotClosedError) as caught:
        closed.unwrap()
    assert caught.value.result is closed


@pytest.mark.slow
def test_a_motion_that_shrinks_to_rest_is_no_orbit(problem: Problem, orbit: Orbit) -> None:
    # With so large an inductance all orbits have shrunk: the return map's fixed point is rest.
    values = problem.values(parameters={"L": 10.0})
    closed = orbit_by_shooting(problem, values, near=orbit)
    assert closed.orbit is None
    assert closed.detail.startswith("The known orbit is lost after")
    assert orbit_by_shooting(problem, values).orbit is None


def test_an_orbit_of_another_problem_is_no_start(orbit: Orbit) -> None:
    ball = load_problem("bouncing_ball")
    with pytest.raises(InputError, match="must be of problem `bouncing_ball`"):
        orbit_by_shooting(ball, ball.values(), near=orbit)


# What the quick ways share with the long ones.


def test_stages_are_told(problem: Problem) -> None:
    told: list[str] = []
    orbit_by_shooting(
        problem,
        problem.values(),
        simulation=SETTINGS,
        on_progress=lambda stage, _: told.append(stage),
    )
    assert told == ["settling"]


def test_cuts_from_the_last_common_impact_are_the_cuts_from_the_release(
    problem: Problem, orbit: Orbit
) -> None:
    machine = problem.dynamics(orbit.values(problem))
    seen = verify(orbit, problem, settings=VerificationSettings(n_periods=1))
    release = machine.on_stop(np.array(RELEASE))
    whole = release_return(machine, release, guess=PERIOD)
    when = (whole.events[-2].time + whole.period) / 2
    truth = whole.execution.state_at(when)
    flown = whole.execution.states_at(np.linspace(0.0, whole.period, 10_001))
    size = np.max(np.abs(flown), axis=0)
    assert len(seen.delta_sweep) == 4
    for cut in seen.delta_sweep:
        rule = replace(SETTINGS, completion=Truncation(delta=cut.delta))
        run = simulate(machine, release, until=when, settings=rule)
        error = np.max(np.abs(run.end_state - truth) / size)
        # The same impacts, from states that differ by the integration's error.
        assert cut.speed == pytest.approx(abs(run.impacts[-1].approach_rate), rel=1e-8)
        assert cut.error == pytest.approx(error, rel=1e-3, abs=1e-11)


@pytest.mark.slow
def test_an_orbit_beyond_an_escape_is_refused_in_the_words_of_the_problem(
    problem: Problem, orbit: Orbit
) -> None:
    # The shoulder swings by 1.2 rad and more.
    escapes = {"theta1": StateLimit(beyond=1.0, phrase="link 1 swings too far")}
    strict = replace(problem, escapes=escapes)
    values = strict.values()
    closed = orbit_by_shooting(strict, values, near=orbit, simulation=SETTINGS)
    assert closed.detail.startswith("Link 1 swings too far: `theta1` reaches 1.")
    assert orbit_by_shooting(strict, values, simulation=SETTINGS).detail == "Link 1 swings too far."
    near = search_orbits(strict, values, free={}, near=orbit)
    assert (near.orbit, near.status) == (None, SearchStatus.NOT_FOLLOWED)
    assert near.detail == closed.detail
    alone = orbit_at_gains(strict, values)
    assert (alone.orbit, alone.status) == (None, SearchStatus.NO_GUESS)
    assert "link 1 swings too far" in alone.detail


# ---------------------------------------------------------------------------- by the steps


def test_a_period_goes_beyond_an_escape_on_either_side_and_on_any_arc(problem: Problem) -> None:
    escapes = {
        "theta2": StateLimit(beyond=3.0, phrase="it falls off"),
        "theta1": StateLimit(beyond=2.0, phrase="it swings"),
    }
    strict = replace(problem, escapes=escapes)

    def of(*places: tuple[float, float]) -> Any:
        flows = [np.array([[one, other, 99.0], [0.0, 0.0, 99.0]]) for one, other in places]
        return SimpleNamespace(arcs=[SimpleNamespace(flow_states=flow) for flow in flows])

    def beyond(*places: tuple[float, float]) -> str:
        return beyond_limits(strict, of(*places).arcs)

    assert beyond((2.0, 3.0), (-2.0, -3.0)) == ""
    first = beyond((0.0, -3.25), (2.5, 0.0))
    assert first == "It falls off: `theta2` reaches 3.25, beyond 3"
    second = beyond((2.5, 3.0), (0.0, 0.0))
    assert second == "It swings: `theta1` reaches 2.5, beyond 2"


def test_an_orbit_with_a_state_that_decays_to_nothing_is_closed() -> None:
    # Only rounding is left of the further state, which then changes by many times its size.
    machine = sheets.problem_of("three sheets", 0.0)
    orbit = orbit_by_shooting(machine, machine.values()).unwrap()
    assert orbit.period == pytest.approx(2 * math.pi, rel=1e-12)
    assert abs(orbit.start_state["y"]) < 1e-12
