"""The orbits that the documents name are proved, with the accuracy that they say."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import pytest

import zeno_orbits as zo
from tests.reference.many_digits.fixed_point import extended_orbit
from tests.support.cases import often
from zeno_orbits.orbits import Orbit
from zeno_orbits.proof import ProofSettings, prove_orbit
from zeno_orbits.search import orbit_at_gains

pytestmark = pytest.mark.slow

GAINS = {"Kp": 2.5, "Kd": -1.0}
_DIGITS = Fraction("1e-24")


@pytest.fixture(scope="module")
def reference(orbit: Orbit) -> Orbit:
    return orbit


@pytest.mark.weekly
def test_the_reference_orbit_is_proved_around_its_many_digits(reference: Orbit) -> None:
    proof = zo.prove(reference)
    assert proof.proved, proof.verdict()
    assert proof.stable
    assert proof.inside
    bounds = proof.bounds
    assert bounds is not None
    assert bounds.period.width < 1e-16
    assert max(disc.radius for disc in bounds.multipliers) < 1e-7
    problem = zo.load_problem("motor_pendulum")
    start = list(reference.release_state.values())
    many = extended_orbit(problem, reference.values(problem), start, digits=25)
    for enclosed, truth in (
        (bounds.period, many.period),
        (bounds.zeno_times[0], many.zeno_points[0].time),
        *zip(bounds.start_state.values(), many.release_state, strict=True),
        *zip(bounds.impact_times, (one.time for one in many.impacts), strict=False),
    ):
        # The many digits are good to 1e-25.
        assert enclosed.low - _DIGITS <= Fraction(str(truth)) <= enclosed.high + _DIGITS


@pytest.mark.parametrize("restitution", often(1, [0.0, 0.3]))
def test_orbits_at_other_restitutions_are_proved(restitution: float) -> None:
    found = zo.find_orbit_by_shooting(
        "motor_pendulum", gains=GAINS, parameters={"restitution": restitution}
    ).unwrap()
    proof = zo.prove(found, radius=1e-9)
    assert proof.proved, proof.verdict()
    assert proof.stable


def test_a_whole_interval_of_a_gain_is_proved_at_once(reference: Orbit) -> None:
    proof = zo.prove(reference, interval={"Kp": 1e-8})
    assert proof.proved, proof.verdict()
    assert proof.stable


@pytest.mark.weekly
def test_a_box_of_a_millionth_is_made_wider_until_it_is_taken_into_itself(
    reference: Orbit,
) -> None:
    proof = zo.prove(reference, radius=1e-6)
    assert proof.proved, proof.verdict()
    assert proof.inside
    assert proof.stable
    for centre, radius in proof.box.values():
        assert radius >= 0.999e-6 * abs(centre)


def test_an_orbit_that_repels_is_proved_by_krawczyks_operator() -> None:
    problem = zo.load_problem("motor_pendulum")
    values = problem.values(gains={"Kp": 4.3, "Kd": -1.55})
    found = orbit_at_gains(problem, values, shape=zo.EventSequence.parsed("zeno")).unwrap()
    proof = zo.prove(found, radius=1e-9)
    assert proof.proved, proof.verdict()
    assert proof.repelling
    assert not proof.inside


@pytest.mark.weekly
def test_an_orbit_just_beyond_the_end_of_its_family_is_not_proved() -> None:
    # The contact phase vanishes at e = 0.41678996771.
    parameters = {"restitution": 0.4167}
    found = zo.find_orbit_by_shooting("motor_pendulum", gains=GAINS, parameters=parameters).unwrap()
    beyond = replace(found, parameters={**found.parameters, "restitution": 0.4168})
    problem = zo.load_problem("motor_pendulum")
    proof = prove_orbit(beyond, problem, settings=ProofSettings(radius=1e-9))
    assert not proof.proved
    assert proof.claim == "period"
