"""Single flights that are not recorded."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import DOP853, LSODA

from tests.reference.closed_forms import FORCED
from tests.support.mechanisms import fading_ball, falling_away, forced_oscillator, oscillator_state
from zeno_orbits.integrators import Engine, RungeKutta, SciPy
from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.simulation.rescaled_flight import rescaled_flights

FINE = Tolerance(relative=1e-14, absolute=1e-15)


@pytest.mark.parametrize("speed", [1.0, 1e-3, 1e-9, 1e-200])
def test_a_flight_of_a_ball_lasts_as_long_as_in_the_textbook(speed: float) -> None:
    flight = rescaled_flights(fading_ball(10.0, 0.0, 0.9), RungeKutta(), FINE)
    landing = flight(np.array([0.0, 0.0, speed, 1.0]), speed)
    assert landing is not None
    duration, state, rate = landing
    assert duration == pytest.approx(speed / 5, rel=1e-14)
    assert rate == pytest.approx(-speed, rel=1e-14)
    assert state[1] == pytest.approx(speed / 5, rel=1e-14)


@pytest.mark.parametrize("engine", [RungeKutta(), SciPy(method=DOP853), SciPy(method=LSODA)])
@pytest.mark.parametrize("speed", [0.3, 1e-2, 1e-6])
def test_a_flight_ends_where_its_power_series_does(engine: Engine, speed: float) -> None:
    dynamics = forced_oscillator(FORCED, FORCED.restitution)
    tolerance = Tolerance(relative=1e-12, absolute=1e-13)
    flight = rescaled_flights(dynamics, engine, tolerance)
    landing = flight(np.array(oscillator_state(0.4, FORCED.stop, -speed)), speed)
    assert landing is not None
    duration, approach = FORCED.short_flight(0.4, speed)
    assert landing[0] == pytest.approx(duration, rel=1e-9)
    assert -landing[2] == pytest.approx(approach, rel=1e-9)


def test_a_flight_that_the_stop_does_not_pull_back_is_given_up() -> None:
    flight = rescaled_flights(falling_away(1.0), RungeKutta(), FINE)
    assert flight(np.array([0.0, 0.1]), 0.1) is None


def test_a_flight_along_which_the_pull_ends_is_given_up() -> None:
    # The weight is gone after 0.1 s, the flight would last 0.2 s and more.
    flight = rescaled_flights(fading_ball(10.0, 100.0, 0.9), RungeKutta(), FINE)
    assert flight(np.array([0.0, 0.0, 1.0, 1.0]), 1.0) is None


def test_a_flight_of_too_many_steps_is_given_up() -> None:
    flight = rescaled_flights(fading_ball(10.0, 0.0, 0.9), RungeKutta(largest_step=1e-5), FINE)
    assert flight(np.array([0.0, 0.0, 1.0, 1.0]), 1.0) is None
    coarse = rescaled_flights(fading_ball(10.0, 0.0, 0.9), RungeKutta(largest_step=1e-3), FINE)
    assert coarse(np.array([0.0, 0.0, 1.0, 1.0]), 1.0) is not None


def test_a_state_that_is_not_finite_gives_no_flight() -> None:
    flight = rescaled_flights(fading_ball(10.0, 1.0, 0.9), RungeKutta(), FINE)
    assert flight(np.array([0.0, np.nan, 1.0, 1.0]), 1.0) is None
