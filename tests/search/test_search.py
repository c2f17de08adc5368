"""Searches end at the orbits of independent simulations, or say why they found none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.reference.reference_orbit import (
    FIRST_IMPACT,
    FIRST_RATE,
    PERIOD,
    PERIODS,
    RELEASE,
    ZENO_STATE,
    ZENO_TIME,
)
from tests.support.cases import fast
from zeno_orbits import MinEnergy, NearestGains, OrbitNotFoundError, TargetAmplitude, TargetPeriod
from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem, load_problem, load_reference
from zeno_orbits.orbits import ONE_ZENO, Orbit
from zeno_orbits.search import (
    SearchResult,
    SearchSettings,
    SearchStatus,
    TransientSettings,
    Verdict,
    orbit_at_gains,
    search_orbits,
)
from zeno_orbits.simulation import Execution, simulate
from zeno_orbits.verification import OrbitCertificate, VerificationSettings, verify

ACCURACY = 1e-8
"""What is promised of an orbit; the first one is within 1e-11 of the declared numbers."""
IMPATIENT = SearchSettings(settling=TransientSettings(horizon=40.0))


def _one_period(orbit: Orbit, problem: Problem) -> Execution:
    """Return the period after the release, on the model that was written by hand."""
    by_hand = load_reference(problem).dynamics(orbit.values(problem))
    start = by_hand.on_stop(np.array(list(orbit.release_state.values())))
    run = simulate(by_hand, start, until=1.3 * orbit.period)
    assert run.releases
    return run


def _box(problem: Problem) -> dict[str, tuple[float, float]]:
    return {gain.name: (gain.lower, gain.upper) for gain in problem.gains}


# At fixed gains.


@pytest.mark.parametrize("inductance", [1e-6, pytest.param(1e-8, marks=pytest.mark.slow)])
def test_a_current_that_decays_within_nanoseconds_leaves_the_orbit_of_the_reduced_model(
    problem: Problem, inductance: float
) -> None:
    found = orbit_at_gains(problem, problem.values(parameters={"L": inductance}))
    assert found.status is SearchStatus.FOUND
    reduced = load_problem("motor_pendulum@corrected")
    without = orbit_at_gains(reduced, reduced.values(parameters={"L": inductance}))
    # The reduced model errs by 4e-7 at 2 mH and by the square of L: by less than rounding here.
    # Each search agrees with its simulation to 3e-10.
    assert found.unwrap().period == pytest.approx(without.unwrap().period, rel=6e-10)


def test_the_orbit_at_the_published_gains_is_the_declared_one(orbit: Orbit) -> None:
    assert orbit.period == pytest.approx(PERIOD, abs=ACCURACY)
    assert list(orbit.release_state.values()) == pytest.approx(RELEASE, abs=ACCURACY)
    assert orbit.zeno_time == pytest.approx(ZENO_TIME, abs=ACCURACY)
    assert list(orbit.zeno_state.values()) == pytest.approx(ZENO_STATE, abs=ACCURACY)
    first = orbit.impacts[0]
    assert first.time == pytest.approx(FIRST_IMPACT, abs=ACCURACY)
    assert first.state_minus["dtheta2"] == pytest.approx(FIRST_RATE, abs=ACCURACY)


def test_a_search_reports_how_well_it_did(found: SearchResult) -> None:
    assert found.status is SearchStatus.FOUND
    assert found.detail == ""
    assert found.agreement <= SearchSettings().agreement
    assert 0.0 < found.closure_error <= SearchSettings().transcription.closure_tolerance
    assert max(found.residuals.values()) < 1e-9
    assert found.n_unknowns > 1000
    assert found.iterations >= 1
    assert 0.0 < found.solve_time < found.wall_time
    assert [attempt.status for attempt in found.attempts] == [SearchStatus.FOUND]


@pytest.mark.slow
def test_a_finer_mesh_of_the_program_agrees_better(problem: Problem) -> None:
    usual = SearchSettings()
    seen: list[float] = []
    for tolerance in (1e-2, 1e-4, 1e-6):
        mesh = replace(usual.transcription, mesh_tolerance=tolerance)
        loose = replace(usual, agreement=1.0, rounds=1, transcription=mesh)
        found = orbit_at_gains(problem, problem.values(), settings=loose)
        # The orbit is that of the simulation at every mesh.
        assert found.unwrap().period == pytest.approx(PERIOD, abs=ACCURACY)
        seen.append(found.agreement)
    assert 1e-6 < seen[0] < 1e-2
    assert seen[2] < 1e-2 * seen[1] < 1e-4 * seen[0] * 100


@pytest.mark.parametrize(("restitution", "period"), fast(2, list(PERIODS.items())))
def test_other_restitutions_have_their_declared_periods(
    problem: Problem, restitution: float, period: float
) -> None:
    result = orbit_at_gains(problem, problem.values(parameters={"restitution": restitution}))
    assert result.unwrap().period == pytest.approx(period, abs=ACCURACY)
    assert (result.closure_error == 0.0) == (restitution == 0.0)


@pytest.mark.parametrize(
    ("parameters", "gains"), fast(1, [({"R": 2.0}, {}), ({"R": 4.0}, {}), ({}, {"Kp": 4.0})])
)
def test_the_orbit_is_where_a_long_simulation_ends(
    problem: Problem, parameters: dict[str, float], gains: dict[str, float]
) -> None:
    values = problem.values(parameters=parameters, gains=gains)
    orbit = orbit_at_gains(problem, values).unwrap()
    dynamics = problem.dynamics(values)
    # The largest multiplier is 0.37 in size: 27 periods shrink any start to 1e-11.
    run = simulate(dynamics, problem.state_vector({"theta1": 0.6}), until=50.0)
    early, late = run.releases[-2:]
    assert late.time - early.time == pytest.approx(orbit.period, abs=ACCURACY)
    assert late.state == pytest.approx(np.array(list(orbit.release_state.values())), abs=ACCURACY)
    # What the search calls an orbit must pass the check that follows it.
    certificate = verify(orbit, problem, settings=VerificationSettings(n_periods=1))
    assert certificate.passed, certificate.verdict()


# Free gains.


@pytest.mark.parametrize("period", [1.75, pytest.param(1.90, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_a_wanted_period_is_reached(problem: Problem, period: float) -> None:
    wanted = TargetPeriod(target=period)
    result = search_orbits(problem, problem.values(), free=_box(problem), objective=wanted)
    orbit = result.unwrap()
    run = _one_period(orbit, problem)
    assert run.releases[-1].time == pytest.approx(period, abs=ACCURACY)
    assert verify(orbit, problem, settings=VerificationSettings(n_periods=1)).passed
    for name, (lower, upper) in _box(problem).items():
        assert lower <= orbit.gains[name] <= upper


@pytest.mark.slow
def test_one_free_gain_is_enough_for_a_period(problem: Problem) -> None:
    result = search_orbits(
        problem,
        problem.values(),
        free={"Kd": (-1.5, -0.4)},
        objective=TargetPeriod(target=1.82),
    )
    orbit = result.unwrap()
    assert orbit.gains["Kp"] == 2.5
    run = _one_period(orbit, problem)
    assert run.releases[-1].time == pytest.approx(1.82, abs=ACCURACY)


@pytest.mark.slow
def test_a_wanted_amplitude_is_reached(problem: Problem) -> None:
    wanted = TargetAmplitude(state="theta1", target=1.2)
    result = search_orbits(problem, problem.values(), free=_box(problem), objective=wanted)
    orbit = result.unwrap()
    run = _one_period(orbit, problem)
    times = np.linspace(0.0, orbit.period, 4001)
    angles = np.array([run.state_at(float(time))[0] for time in times])
    ends = []
    for sign in (1, -1):
        # The parabola through the three highest samples is right to the fourth power of the step.
        k = int(np.argmax(sign * angles))
        around = np.array([run.state_at(float(t))[0] for t in times[k - 1 : k + 2]])
        fit = np.polynomial.Polynomial.fit(times[k - 1 : k + 2], around, 2)
        ends.append(float(fit(fit.deriv().roots()[0])))
    assert (ends[0] - ends[1]) / 2 == pytest.approx(1.2, abs=ACCURACY)


@pytest.mark.slow
def test_less_energy_is_found_where_gains_may_give(
    problem: Problem, certificate: OrbitCertificate
) -> None:
    once = SearchSettings(n_starts=0)
    result = search_orbits(
        problem, problem.values(), free={"Kd": (-1.1, -0.9)}, objective=MinEnergy(), settings=once
    )
    orbit = result.unwrap()
    spent = verify(orbit, problem, settings=VerificationSettings(n_periods=1)).energies
    assert spent["input_work"] < 0.9 * certificate.energies["input_work"]
    assert -1.1 <= orbit.gains["Kd"] <= -0.9


def test_gains_that_have_an_orbit_are_their_own_nearest(problem: Problem) -> None:
    target = {"Kp": 3.0, "Kd": -0.9}
    result = search_orbits(
        problem, problem.values(), free=_box(problem), objective=NearestGains(target=target)
    )
    assert result.unwrap().gains == target


def test_a_target_outside_the_box_is_met_at_its_edge(problem: Problem) -> None:
    result = search_orbits(
        problem,
        problem.values(),
        free={"Kp": (2.0, 3.0)},
        objective=NearestGains(target={"Kp": 9.0}),
    )
    assert result.unwrap().gains == pytest.approx({"Kp": 3.0, "Kd": -1.0}, abs=1e-6)


# No orbit.


@pytest.mark.slow
def test_a_restitution_beyond_the_family_leaves_no_zeno_orbit(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.5})
    result = orbit_at_gains(problem, values, settings=IMPATIENT, shape=ONE_ZENO)
    # A period on the way to its orbit without a Zeno point may pass for a guess.
    assert result.status in (SearchStatus.NO_GUESS, SearchStatus.NOT_SOLVED)
    assert result.orbit is None
    # The family ends near 0.417.
    assert "Orbits could be followed to restitution = 0.416" in result.detail
    assert "there the contact phase vanishes" in result.detail


@pytest.mark.slow
def test_motion_that_grows_or_dies_out_slowly_is_no_orbit(problem: Problem) -> None:
    result = orbit_at_gains(problem, problem.values(gains={"Kd": -0.1}), settings=IMPATIENT)
    # It changes so little a period that it may pass for a guess; the program then finds nothing.
    assert result.status in (SearchStatus.NO_GUESS, SearchStatus.NOT_SOLVED)
    assert result.orbit is None
    assert result.detail


def test_a_ball_has_no_orbit() -> None:
    ball = load_problem("bouncing_ball")
    result = orbit_at_gains(ball, ball.values(), settings=IMPATIENT)
    assert result.status is SearchStatus.NO_GUESS
    assert result.detail == "The motion comes to rest."
    with pytest.raises(OrbitNotFoundError, match="No simulation settled") as caught:
        result.unwrap()
    assert caught.value.result is result


def test_orbits_are_looked_for_from_the_given_states_alone(problem: Problem) -> None:
    # Hanging still, the machine stays as it is; from the problem's own starts it settles.
    hanging = {"theta1": 0.0}
    result = search_orbits(problem, problem.values(), free={}, initial_states=[hanging])
    assert result.status is SearchStatus.NO_GUESS
    assert "rest" in result.detail
    with pytest.raises(InputError, match="knee"):
        search_orbits(problem, problem.values(), free={}, initial_states=[{"knee": 1.0}])


@pytest.mark.slow
def test_an_orbit_that_nobody_accepts_is_not_returned(problem: Problem) -> None:
    seen: list[Orbit] = []

    def refuse(orbit: Orbit) -> Verdict:
        seen.append(orbit)
        return Verdict(objection="it is too plain")

    result = search_orbits(
        problem,
        problem.values(),
        free={"Kp": (2.4, 2.6)},
        accept=refuse,
        settings=replace(IMPATIENT, n_starts=1),
    )
    assert result.status is SearchStatus.NOT_ACCEPTED
    assert result.orbit is None
    assert result.detail == "it is too plain"
    # The orbit of the program is refused, and that of shooting.
    assert len(seen) >= len(result.attempts) == 2
    assert {attempt.detail for attempt in result.attempts} == {"it is too plain"}


def test_progress_is_told_in_order(problem: Problem) -> None:
    told: list[str] = []
    result = search_orbits(
        problem,
        problem.values(),
        free={},
        accept=lambda _: Verdict(),
        on_progress=lambda stage, _: told.append(stage),
    )
    assert result.status is SearchStatus.FOUND
    assert told[0] == "start 1: simulating Kp = 2.5, Kd = -1"
    assert told[-1] == "start 1: verifying"


# Misuse.


@pytest.mark.parametrize("bounds", [(2.0, 2.0), (3.0, 2.0), (2.0, np.inf), (np.nan, 2.0)])
def test_a_box_that_is_empty_or_endless_is_refused(
    problem: Problem, bounds: tuple[float, float]
) -> None:
    with pytest.raises(InputError, match="`vary` must have finite bounds LOWER < UPPER for `Kp`"):
        search_orbits(problem, problem.values(), free={"Kp": bounds})


def test_a_gain_that_the_problem_does_not_have_is_refused(problem: Problem) -> None:
    with pytest.raises(InputError, match=r"`vary`: unknown name `Ki`.*Known: Kp, Kd, "):
        search_orbits(problem, problem.values(), free={"Ki": (1.0, 2.0)})


def test_a_target_of_a_gain_that_the_problem_does_not_have_is_refused(problem: Problem) -> None:
    with pytest.raises(InputError, match="Ki"):
        search_orbits(
            problem,
            problem.values(),
            free={"Kp": (1.0, 2.0)},
            objective=NearestGains(target={"Ki": 1.0}),
            settings=replace(IMPATIENT, n_starts=0),
        )


@pytest.mark.weekly
@pytest.mark.slow
def test_an_orbit_is_kept_where_the_way_to_the_nearest_gains_is_lost() -> None:
    pendulum = load_problem("motor_pendulum")
    # At Kd = 0.5 the motion dies out. The linearized pendulum neither grows nor shrinks at -0.1864.
    result = search_orbits(
        pendulum,
        pendulum.values(gains={"Kd": 0.5}),
        free={"Kp": (2.0, 3.0), "Kd": (-1.2, 0.6)},
        settings=SearchSettings(n_starts=4),
    )
    assert result.status is SearchStatus.FOUND
    found = result.unwrap()
    assert verify(found, pendulum).passed
    assert "the amplitude is zero" in result.detail
    assert -0.25 < found.gains["Kd"] < -0.1


@pytest.mark.parametrize("wanted", [1e-12, 1e-10, 1e-6, 1e-2])
def test_an_accuracy_asks_for_an_agreement_below_it_and_changes_nothing_else(wanted: float) -> None:
    given = SearchSettings(n_starts=3, seed=7)
    chosen = given.for_accuracy(wanted)
    assert chosen.agreement < wanted
    assert chosen.transcription.closure_tolerance <= wanted
    assert chosen.transcription.mesh_tolerance <= 1e-2
    same = replace(chosen, agreement=given.agreement, transcription=given.transcription)
    assert same == given
