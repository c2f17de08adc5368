"""Extremes of signals along simulated arcs, against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.made_arcs import START, ramp
from zeno_orbits.arrays import Vector
from zeno_orbits.model import load_problem
from zeno_orbits.simulation import (
    Arc,
    Extent,
    extent_of,
    lows_inside,
    peaks,
    samples_inside,
    signal,
    signal_names,
    simulate,
)

NEAR = 1e-8


def at_time(function: Callable[[float], float]) -> Callable[[Vector], float]:
    """A function of the flow's own time as one of the state."""
    return lambda x: function(float(x[0]))


def inner(found: list[Any]) -> list[Any]:
    """The peaks between the ends."""
    return [peak for peak in found if 0.0 < peak.fraction < 1.0]


def pairs(found: list[Any]) -> list[tuple[float, float]]:
    """Where peaks lie, as fractions of their arc, and what they are."""
    return [(peak.fraction, peak.value) for peak in found]


def spike(place: float, width: float) -> Callable[[Vector], float]:
    """A signal that is 1 at a time and next to nothing a few widths beside it."""
    return at_time(lambda t: math.exp(-(((t - place) / width) ** 2)))


def least_inside(
    arc: Arc, value: Callable[[np.ndarray], float], rate: Callable[[np.ndarray], float]
) -> float | None:
    """Return the least local minimum of a function inside an arc, or ``None`` without any."""
    (lows,) = lows_inside([samples_inside(arc)], lambda states: np.array([rate(x) for x in states]))
    return min((value(x) for x in lows.states), default=None)


@pytest.fixture(name="clock", scope="module")
def _clock() -> Arc:
    """An arc of 9 rad of a clock, its cosine and sine in ``x[2]`` and ``x[3]``."""
    table = load_problem("vibrating_table")
    values = table.values()
    until = 9.0 / values.number("omega")
    run = simulate(table.dynamics(values), (1e3, 0.0, 1.0, 0.0), until=until)
    (arc,) = run.arcs
    return arc


def test_the_least_inside_an_arc_is_its_lowest_minimum_not_its_ends(clock: Arc) -> None:
    least = least_inside(clock, lambda x: float(x[2]), lambda x: -float(x[3]))
    assert least == pytest.approx(-1.0, abs=NEAR)
    # -cos has its one minimum inside at a whole turn, though it begins with the same value.
    turned = least_inside(clock, lambda x: -float(x[2]), lambda x: float(x[3]))
    assert turned == pytest.approx(-1.0, abs=NEAR)
    tilted = least_inside(clock, lambda x: float(x[2]) + 5.0, lambda x: -float(x[3]))
    assert tilted == pytest.approx(4.0, abs=NEAR)


def test_a_function_that_only_rises_has_no_least_value_inside(clock: Arc) -> None:
    assert least_inside(clock, lambda _: 0.0, lambda _: 1.0) is None


def test_an_arc_that_takes_no_time_has_no_inside(clock: Arc) -> None:
    moment = replace(clock, end_time=clock.start_time, trajectory=None)
    assert least_inside(moment, lambda x: float(x[2]), lambda x: -float(x[3])) is None


def test_peaks_are_the_turning_points_between_the_ends(clock: Arc) -> None:
    highest = peaks(lambda x: float(x[2]), clock, 1.0)
    lowest = peaks(lambda x: float(x[2]), clock, -1.0)
    assert max(peak.value for peak in highest) == pytest.approx(1.0, abs=NEAR)
    assert [p.value for p in lowest if 0 < p.fraction < 1] == pytest.approx([-1.0], abs=NEAR)
    (inner,) = [p for p in highest if 0.0 < p.fraction < 1.0]
    assert inner.fraction == pytest.approx(2 * math.pi / 9.0, abs=1e-4)
    extent = extent_of(lambda x: float(x[2]) - 3.0, [clock])
    assert (extent.lowest, extent.highest) == pytest.approx((-4.0, -2.0), abs=NEAR)
    assert extent.largest == pytest.approx(4.0, abs=NEAR)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_ends_of_an_arc_are_peaks_and_a_slope_has_no_others(sign: float) -> None:
    found = peaks(at_time(lambda t: 3.0 - 2.0 * t), ramp(0.0, 1.0, 8.0), sign)
    assert pairs(found) == [(0.0, 3.0), (1.0, -13.0)]


def test_an_arc_that_takes_no_time_has_its_start_for_a_peak() -> None:
    arc = replace(ramp(0.0, 1.0), end_time=START, end_state=np.array([7.0]))
    assert pairs(peaks(at_time(lambda t: t + 5.0), arc, 1.0)) == [(0.0, 5.0)]
    # A flow of no duration in an arc of some: rounding, and no division by it.
    found = peaks(lambda _: 5.0, replace(ramp(0.0, 0.0), end_time=5.0), 1.0)
    assert pairs(found) == [(0.0, 5.0), (1.0, 5.0)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_peak_between_two_samples_is_polished(sign: float) -> None:
    def value(x: Vector) -> float:
        return sign * (6.0 - 2.0 * (float(x[0]) - 20.3) ** 2)

    (found,) = inner(peaks(value, ramp(0.0, 64.0), sign))
    assert found.value == pytest.approx(sign * 6.0, rel=1e-12)
    # The square root of rounding: so flat is a peak.
    assert found.fraction == pytest.approx(20.3 / 64, abs=1e-8)
    assert inner(peaks(value, ramp(0.0, 64.0), -sign)) == []


def test_two_equal_samples_beside_a_peak_are_one_peak_and_a_constant_has_none() -> None:
    # Whole times are samples, exactly.
    (found,) = inner(peaks(at_time(lambda t: -((t - 20.5) ** 2)), ramp(0.0, 64.0), 1.0))
    assert found.value == pytest.approx(0.0, abs=1e-12)
    assert inner(peaks(lambda _: 1.0, ramp(0.0, 64.0), 1.0)) == []


@pytest.mark.parametrize("sample", [1, 33, 63])
def test_a_spike_at_any_of_the_samples_is_found(sample: int) -> None:
    value = spike(sample / 64, 1e-3)
    (found,) = inner(peaks(value, ramp(0.0, 1.0), 1.0))
    assert (found.fraction, found.value) == pytest.approx((sample / 64, 1.0), abs=NEAR)


@pytest.mark.parametrize("duration", [0.5, 8.0])
def test_a_spike_between_the_samples_is_found_by_the_steps_of_the_engine(duration: float) -> None:
    place, width = 0.3557 * duration, 1e-4 * duration
    assert inner(peaks(spike(place, width), ramp(0.0, duration), 1.0)) == []
    beside = (place - width / 2, place + width / 3, place + 2 * width)
    steps = (0.0, *beside, duration)
    (found_by_steps,) = inner(peaks(spike(place, width), ramp(*steps), 1.0))
    assert found_by_steps.value == pytest.approx(1.0, abs=NEAR)
    assert found_by_steps.fraction == pytest.approx(0.3557, abs=NEAR)


def test_the_extent_over_arcs_is_that_of_all_of_them() -> None:
    late = replace(ramp(0.0, 1.0), start_state=np.array([-9.0]))
    extent = extent_of(at_time(lambda t: t + 1.0), [late, ramp(0.0, 5.0), ramp(0.0, 3.0)])
    assert (extent.lowest, extent.highest, extent.error) == (-8.0, 6.0, 0.0)
    assert extent.largest == 8.0
    assert Extent(lowest=-2.0, highest=3.0).largest == 3.0
    assert Extent(lowest=-4.0, highest=-3.0).largest == 4.0


@pytest.mark.parametrize("duration", [0.5, 20.0])
@pytest.mark.parametrize(("part", "counts"), [(0.5e-3, False), (1.5e-3, True), (0.5, True)])
@pytest.mark.parametrize("from_end", [False, True])
def test_a_minimum_counts_from_a_thousandth_inside(
    duration: float, part: float, counts: bool, from_end: bool
) -> None:
    place = duration * (1.0 - part if from_end else part)
    value, rate = at_time(lambda t: (t - place) ** 2 - 1.0), at_time(lambda t: t - place)
    least = least_inside(ramp(0.0, duration), value, rate)
    assert least == (pytest.approx(-1.0, abs=1e-12) if counts else None)
    highest = least_inside(ramp(0.0, duration), lambda x: -value(x), lambda x: -rate(x))
    assert highest is None


def test_the_lowest_of_many_minima_is_the_least() -> None:
    # Minima at 3/2 pi, 7/2 pi and 11/2 pi, each with the depth of its turn.
    depths = {0: 1.0, 1: 5.0, 2: 2.0}
    value = at_time(lambda t: depths[int(t / (2 * math.pi))] * math.sin(t))
    least = least_inside(ramp(0.0, 6 * math.pi - 1e-9), value, at_time(math.cos))
    assert least == pytest.approx(-5.0, abs=1e-12)


@pytest.mark.parametrize("part", [0.3, 30.3, 58.3])
def test_a_minimum_between_two_samples_is_found_by_the_steps_of_the_engine(part: float) -> None:
    # The function falls, rises from `low` to `high`, and falls on, all between two of 60 samples.
    low = 1e-3 + part / 59 * 0.998
    high = low + 0.4 / 59
    rate, value = at_time(lambda t: -(t - low) * (t - high)), at_time(lambda t: 7.0 + t - low)
    assert least_inside(ramp(0.0, 1.0), value, rate) is None
    least = least_inside(ramp(0.0, (low + high) / 2, 1.0), value, rate)
    assert least == pytest.approx(7.0, abs=1e-12)


def test_a_minimum_at_a_step_counts_and_a_function_at_rest_has_none() -> None:
    value, rate = at_time(lambda t: (t - 0.3) ** 2 - 1.0), at_time(lambda t: t - 0.3)
    assert least_inside(ramp(0.0, 0.3, 1.0), value, rate) == pytest.approx(-1.0, abs=1e-12)
    assert least_inside(ramp(0.0, 0.3, 1.0), lambda _: 1.0, lambda _: 0.0) is None


def test_signals_are_the_states_and_what_motors_see_each_once() -> None:
    def names(problem: str) -> tuple[str, ...]:
        return signal_names(load_problem(problem).compiled())

    one, two, none = (load_problem(n) for n in ("motor_cart", "two_motors", "vibrating_table"))
    assert set(names("motor_cart")) == {*one.state_names, "current", "voltage"}
    assert names("motor_cart")[: len(one.state_names)] == one.state_names
    # Their currents are states.
    assert names("two_motors") == (*two.state_names, "voltage1", "voltage2")
    assert names("vibrating_table") == none.state_names


def test_signals_of_two_motors_are_those_of_its_laws_of_control() -> None:
    problem = load_problem("two_motors")
    compiled, values = problem.compiled(), problem.values()
    x, p = np.array([0.3, 0.2, -1.5, 0.7, 0.11, 0.23]), values.number
    expected = {
        "theta2": 0.2,
        "current1": 0.11,
        "current2": 0.23,
        "voltage1": -p("Kp") * 0.3 + p("Kd") * 1.5,
        "voltage2": -p("Kp2") * (0.2 - p("rest")) - p("Kd2") * 0.7,
    }
    for name, number in expected.items():
        one = signal(compiled, name)
        assert one.name == name
        assert one.at(values.vector)(x) == pytest.approx(number, rel=1e-14)


def test_a_motor_without_inductance_has_the_current_of_ohms_law() -> None:
    problem = load_problem("motor_pendulum@quasi_static")
    compiled, values = problem.compiled(), problem.values()
    x, p = np.array([0.3, 0.2, -1.5, 0.7]), values.number
    voltage = -p("Kp") * 0.3 + p("Kd") * 1.5
    current = (voltage + p("K_emf") * 1.5) / p("R")
    assert signal(compiled, "voltage").at(values.vector)(x) == pytest.approx(voltage, rel=1e-14)
    assert signal(compiled, "current").at(values.vector)(x) == pytest.approx(current, rel=1e-14)
