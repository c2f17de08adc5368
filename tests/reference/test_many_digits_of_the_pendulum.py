"""The reference orbit in many digits: closed, as measured, and as a hand-written pendulum flies."""

from decimal import Decimal

import mpmath as mp
import numpy as np
import pytest

from tests.reference import reference_orbit as measured
from tests.reference.hand_pendulum import HandPendulum
from tests.reference.many_digits.execution import extended_execution
from tests.reference.many_digits.fixed_point import ExtendedOrbit, extended_orbit
from tests.support.returns import multipliers_at
from zeno_orbits.model import load_problem
from zeno_orbits.simulation import simulate

PENDULUM = load_problem("motor_pendulum")


@pytest.fixture(scope="module")
def orbit() -> ExtendedOrbit:
    """The reference orbit to 25 digits, from a guess of five."""
    guess = [float(f"{value:.5g}") for value in measured.RELEASE]
    return extended_orbit(PENDULUM, PENDULUM.values(), guess, digits=25)


@pytest.mark.slow
def test_a_period_is_the_simulated_one_to_the_simulators_digits() -> None:
    values = PENDULUM.values()
    times = (0.3, 1.2, 1.3, 1.6, 1.9)
    truth = extended_execution(
        PENDULUM, values, measured.RELEASE, until=2.0, times=times, digits=12
    )
    assert truth.error < 1e-12
    dynamics = PENDULUM.dynamics(values)
    execution = simulate(dynamics, measured.RELEASE, until=2.0)
    # The simulator promises 1e-11 a period.
    for sample, time in zip(truth.samples, times, strict=True):
        state = [float(value) for value in sample.state]
        assert execution.state_at(time) == pytest.approx(state, rel=2e-10, abs=2e-10)
    assert float(truth.zeno_points[0].time) == pytest.approx(measured.ZENO_TIME, abs=1e-11)
    assert float(truth.releases[-1].time) == pytest.approx(measured.PERIOD, abs=1e-11)


@pytest.mark.slow
def test_the_orbit_is_the_measured_one(orbit: ExtendedOrbit) -> None:
    # The measured figures close to 6e-15 and are printed to 13 or 14 digits.
    assert float(orbit.period) == pytest.approx(measured.PERIOD, abs=2e-14)
    release = [float(value) for value in orbit.release_state]
    assert release == pytest.approx(measured.RELEASE, abs=1e-12)
    assert float(orbit.impacts[0].time) == pytest.approx(measured.FIRST_IMPACT, abs=1e-13)
    assert float(orbit.impacts[0].approach_rate) == pytest.approx(measured.FIRST_RATE, abs=1e-12)
    (zeno,) = orbit.zeno_points
    assert float(zeno.time) == pytest.approx(measured.ZENO_TIME, abs=1e-13)
    state = [float(value) for value in zeno.state]
    assert state == pytest.approx(measured.ZENO_STATE, abs=1e-11)
    assert orbit.multipliers[0].real == pytest.approx(measured.MULTIPLIER, abs=5e-8)
    assert orbit.closure < 1e-27
    assert orbit.error < 1e-25


@pytest.mark.slow
def test_exact_multipliers_are_those_of_differences_in_many_digits(orbit: ExtendedOrbit) -> None:
    values = PENDULUM.values()
    dynamics = PENDULUM.dynamics(values)
    release = np.array([float(value) for value in orbit.release_state])
    found = multipliers_at(dynamics, release, float(orbit.period))
    # Differences of 20 digits at 1e-6: their square times the third derivative is left.
    for exact, known in zip(found, orbit.multipliers, strict=True):
        assert exact == pytest.approx(known, abs=1e-11)


@pytest.mark.slow
def test_a_longer_computation_changes_no_certain_digit(orbit: ExtendedOrbit) -> None:
    longer = extended_orbit(PENDULUM, PENDULUM.values(), orbit.release_state, digits=36)
    numbers = zip(
        (
            orbit.period,
            *orbit.release_state,
            orbit.zeno_points[0].time,
            *orbit.zeno_points[0].state,
        ),
        (
            longer.period,
            *longer.release_state,
            longer.zeno_points[0].time,
            *longer.zeno_points[0].state,
        ),
        strict=True,
    )
    off = max(abs(a - b) / (1 + abs(b)) for a, b in numbers)
    assert off < Decimal(orbit.error)


@pytest.mark.slow
def test_the_first_two_flights_are_those_of_a_hand_written_pendulum(orbit: ExtendedOrbit) -> None:
    values = PENDULUM.values()
    with mp.workdps(45):
        hand = HandPendulum(numbers={**values.parameters, **values.gains})
        x = [mp.mpf(str(value)) for value in orbit.release_state]
        time = mp.mpf(0)
        for impact in orbit.impacts[:2]:
            duration, x = hand.next_impact(x)
            time += duration
            assert abs(time - mp.mpf(str(impact.time))) < mp.mpf(10) ** -30
            assert abs(x[3] - mp.mpf(str(impact.approach_rate))) < mp.mpf(10) ** -30 * 20
            x = hand.reset(x)
