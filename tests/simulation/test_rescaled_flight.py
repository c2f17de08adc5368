"""Single flights that are not recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.integrate import DOP853, LSODA

from tests.reference.closed_forms import FORCED
from tests.support.mechanisms import fading_ball, falling_away, forced_oscillator, oscillator_state
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import RungeKutta, SciPy, Stepper, Tolerance
from zeno_orbits.simulation.zeno.rescaled_flight import rescaled_flights

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
def test_a_flight_ends_where_its_power_series_does(engine: Stepper, speed: float) -> None:
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


@dataclass
class Made:
    """A system, its engine and its steps in one: a scaled gap as a function of time and its rate.

    The state is the gap's acceleration, which each step gives at its end.
    """

    gap: Callable[[float], float]
    rate: Callable[[float], float]
    size: float = 1.0
    accelerations: tuple[float, ...] = (-1.0,)
    state_names: tuple[str, ...] = ("acceleration",)
    start: float = 0.0

    def gap_acceleration(self, x: Vector) -> float:
        (acceleration,) = x
        return float(acceleration)

    def flight(self, speed: float) -> None:
        """A flow that nobody follows."""

    def steps(self, *_: object) -> Any:
        for k, acceleration in enumerate(self.accelerations):
            yield Made(self.gap, self.rate, self.size, (acceleration,), start=k * self.size)

    @property
    def after(self) -> Vector:
        return self.state_at(self.size)

    def state_at(self, offset: float) -> Vector:
        time = self.start + offset
        return np.array([*self.accelerations, self.gap(time), self.rate(time)])


def landing_of(made: Any) -> tuple[float, Vector, float] | None:
    """The end of the flight at a gap rate of 3."""
    return rescaled_flights(made, made, FINE)(np.array([-1.0]), 3.0)


@pytest.mark.parametrize("acceleration", [0.0, 0.5])
def test_a_flight_is_given_up_where_the_stop_does_not_pull_at_the_end_of_a_step(
    acceleration: float,
) -> None:
    def found(*accelerations: float) -> tuple[float, Vector, float] | None:
        made = Made(lambda t: t - 0.5 * t**2, lambda t: 1.0 - t, accelerations=accelerations)
        return landing_of(made)

    landing = found(-1.0, -1.0, -1.0)
    assert landing is not None
    assert (landing[0], landing[2]) == pytest.approx((3.0 * 2.0, 3.0 * -1.0), rel=1e-14)
    assert found(-1.0, acceleration, -1.0) is None


def test_a_flight_may_land_at_the_very_end_of_a_step() -> None:
    made = Made(lambda t: t - t**2, lambda t: 1.0 - 2.0 * t)
    landing = landing_of(made)
    assert landing is not None
    assert (landing[0], landing[2]) == (3.0, -3.0)
    assert landing_of(Made(lambda t: t, lambda _: 1.0)) is None


@pytest.mark.parametrize("duration", [1e-4, 1.0, 1e4])
def test_a_landing_is_as_exact_in_a_short_flight_as_in_a_long_one(duration: float) -> None:
    # A parabola of that duration in a step by half as long: Newton's method squares what is left.
    made = Made(
        lambda t: t - t**2 / duration, lambda t: 1.0 - 2.0 * t / duration, size=1.5 * duration
    )
    landing = landing_of(made)
    assert landing is not None
    assert landing[0] == pytest.approx(3.0 * duration, rel=1e-14)


def test_a_landing_is_found_from_either_side() -> None:
    # The gap is flat at the end of the step, and the first correction goes far back.
    made = Made(lambda t: 1.5 - t + 0.8 * (t - 1.5) ** 2, lambda t: -1 + 1.6 * (t - 1.5), size=2.0)
    landing = landing_of(made)
    assert landing is not None
    assert (landing[0], landing[2]) == pytest.approx((3.0 * 1.5, -3.0), rel=1e-14)
