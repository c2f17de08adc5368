"""Tests whether a motion converges to an orbit, on linear maps, for which their laws are exact."""

import numpy as np
import pytest

from zeno_orbits.arrays import Vector
from zeno_orbits.maps.approach import (
    Approach,
    all_come_nearer,
    is_approached,
    places_on_the_way,
    steps_towards,
)
from zeno_orbits.maps.attractors import Attractor, AttractorClass
from zeno_orbits.maps.known import KnownOrbit, Recognition, distinct_orbits
from zeno_orbits.maps.newton import limit_of_steps

SKEW = np.array([[1.0, 3.0], [0.0, 1.0]])
"""Eigenvectors of the maps. They are not orthogonal: a length may grow although a map contracts."""


def linear_map(*multipliers: float) -> Vector:
    return SKEW @ np.diag(multipliers) @ np.linalg.inv(SKEW)


@pytest.mark.parametrize("direction", [0, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_may_differ_from_the_linear_prediction_by_half_of_it(
    direction: int, sign: float
) -> None:
    a, before = linear_map(0.7, -0.4), np.array([0.3, -0.1])
    step = np.max(np.abs(before - a @ before))
    assert is_approached(before, a @ before, a, 0.0)
    for share, agrees in ((0.49, True), (0.51, False)):
        after = a @ before
        after[direction] += sign * share * step
        assert is_approached(before, after, a, 0.0) is agrees


def test_a_step_below_the_error_of_a_return_agrees() -> None:
    a, orbit = linear_map(0.7, -0.4), np.zeros(2)
    assert is_approached(orbit, np.array([1e-9, -1e-9]), a, 1.01e-9)
    assert not is_approached(orbit, np.array([1e-9, -1e-9]), a, 0.99e-9)


def test_a_slow_motion_passes_equal_parts_of_the_way_to_its_orbit() -> None:
    origin = np.array([0.3, -0.6])
    places = places_on_the_way(origin, linear_map(0.9, -0.4))
    assert places[-1] == pytest.approx(origin)
    steps = np.diff(places, axis=0, prepend=np.zeros((1, 2)))
    assert steps == pytest.approx(np.tile(origin / len(places), (len(places), 1)))


def test_an_alternating_motion_also_passes_the_mirrored_places() -> None:
    origin = np.array([0.3, -0.6])
    one_side = places_on_the_way(origin, linear_map(0.9, -0.4))
    both = places_on_the_way(origin, linear_map(-0.9, 0.4))
    assert both == pytest.approx(np.concatenate([one_side, -one_side]))


def test_a_spiral_has_no_straight_way() -> None:
    turn = 0.9 * np.array([[0.6, -0.8], [0.8, 0.6]])
    assert len(places_on_the_way(np.array([0.3, -0.6]), turn)) == 0


@pytest.mark.parametrize("multipliers", [(0.9, 0.2), (-0.9, 0.2), (0.5, 0.5), (0.97, -0.97)])
def test_every_point_comes_nearer_under_a_contraction(multipliers: tuple[float, float]) -> None:
    a = linear_map(*multipliers)
    places = np.random.default_rng(1).normal(size=(40, 2))
    images = places @ a.T
    assert all_come_nearer(places, images, a)
    for k in (0, 17, 39):
        moved = images.copy()
        moved[k] = places[k]
        assert not all_come_nearer(places, moved, a)


def test_a_quarter_of_the_rate_of_the_multipliers_is_required() -> None:
    a, places = linear_map(0.8, 0.1), np.array([[0.3, 0.1], [-0.2, 0.4]])
    assert all_come_nearer(places, 0.949 * places, a)
    assert not all_come_nearer(places, 0.951 * places, a)
    assert not all_come_nearer(places, -0.951 * places, a)


def test_the_last_steps_towards_an_orbit_are_counted() -> None:
    orbit, scale = np.array([1.0, 2.0]), np.array([1.0, 10.0])
    distances = [0.5, 0.9, 0.3, 0.1, 0.03]
    ways = np.array([[0.5, -1.0], [1.0, 0.0], [-1.0, 0.9], [0.0, 1.0], [1.0, 1.0]])
    passed = [orbit + d * way * scale for d, way in zip(distances, ways, strict=True)]
    assert steps_towards(passed[::-1], orbit, scale, 0.0) == 3
    assert steps_towards(passed[::-1], orbit, scale, 1.0) == 4
    assert steps_towards([orbit, orbit + 0.1 * scale, orbit], orbit, scale, 0.0) == 1


def test_an_approach_is_shared_if_its_returns_come_at_the_same_times() -> None:
    times = (1.0, 2.5, 4.0, 6.0)
    approach = Approach(times=times, captured=2)
    # The mean time of a return is 1.5.
    for late, shared in ((0.014, True), (0.016, False), (-0.014, True), (-0.016, False)):
        other = Approach(times=(1.0, 2.5, 4.0 + late, 9.0), captured=0)
        assert approach.is_shared_by(other) is shared
    assert not approach.is_shared_by(Approach(times=(1.0, 2.5), captured=0))


UNIT = np.array([0.01, 1.0])
"""Sizes of the states of the orbits below."""


def known(*states: tuple[float, float], rate: float = 0.5, period: float = 2.0) -> KnownOrbit:
    return KnownOrbit(
        attractor=Attractor(fate=AttractorClass.ZENO, returns=len(states), period=period),
        section="release stop",
        states=states,
        scale=tuple(UNIT),
        rate=rate,
    )


DOUBLE = known((0.01, 1.0), (0.01, -2.0))


def seen(orbit: KnownOrbit, order: list[int], distances: list[float], reached: float = 0.0) -> bool:
    """Return True if the last of some crossings shows that a motion converges to an orbit."""
    recognition = Recognition(orbit=orbit, reached=reached)
    found = False
    for place, distance in zip(order, distances, strict=True):
        found = recognition.sees(np.array(orbit.states[place]) + distance * UNIT)
    return found


def test_a_motion_that_comes_nearer_over_a_period_converges() -> None:
    # With the multiplier 0.5 a quarter of its rate is a factor of 0.875 over a period.
    for share, converges in ((0.874, True), (0.876, False)):
        assert seen(DOUBLE, [0, 1, 0], [0.004, 0.001, 0.004 * share]) is converges
    assert not seen(DOUBLE, [0, 1], [0.004, 0.001])


def test_a_motion_in_another_order_does_not_converge() -> None:
    assert not seen(DOUBLE, [0, 0, 0, 0], [0.004, 0.002, 0.001, 0.0005])
    assert seen(DOUBLE, [0, 0, 1, 0], [0.004, 0.002, 0.001, 0.0005])


def test_a_motion_has_to_come_near_for_a_whole_period() -> None:
    # Near is one percent of 1 - 0.5.
    assert not seen(DOUBLE, [0, 1, 0], [0.0051, 0.001, 0.001])
    assert not seen(DOUBLE, [0, 1, 0], [0.0049, 0.0051, 0.001])
    assert seen(DOUBLE, [0, 1, 0], [0.0049, 0.0049, 0.001])


def test_a_distance_within_the_error_of_the_motion_is_enough() -> None:
    assert seen(DOUBLE, [0, 1, 0], [1e-9, 1e-9, 2e-9], reached=3e-9)
    assert not seen(DOUBLE, [0, 1, 0], [1e-9, 1e-9, 4e-9], reached=3e-9)


def test_a_motion_that_stays_near_is_not_waited_for_without_end() -> None:
    recognition = Recognition(orbit=DOUBLE, reached=0.0)
    assert not recognition.may_see
    waits = [recognition.may_see]
    for k in range(12):
        assert not recognition.sees(np.array(DOUBLE.states[k % 2]) + 0.004 * UNIT)
        waits.append(recognition.may_see)
    # Over its first periods the motion may still show it.
    assert all(waits[1:5])
    assert not any(waits[-3:])


def test_equal_orbits_are_one_and_orbits_of_one_kind_are_numbered() -> None:
    again = known((0.01, -2.0), (0.01, 1.0))
    assert distinct_orbits([DOUBLE, again]) == (DOUBLE,)
    assert DOUBLE.attractor.number == 0
    others = [known((0.01, 1.0), (0.01, -2.1)), known((0.01, 1.0), (0.01, -2.0), period=2.1)]
    single = known((0.01, 1.0))
    numbers = [one.attractor.number for one in distinct_orbits([DOUBLE, single, *others])]
    assert numbers == [1, 0, 2, 3]


def test_an_orbit_passes_each_of_its_states_and_no_other() -> None:
    for state in DOUBLE.states:
        assert DOUBLE.passes(np.array(state) + 0.9e-4 * UNIT)
        assert not DOUBLE.passes(np.array(state) + 1.1e-4 * UNIT)
    assert not DOUBLE.passes(np.array([0.01, 0.0]))


def test_the_limit_of_a_linear_motion_along_one_direction_is_its_fixed_point() -> None:
    scale, last = np.array([1.0, 10.0, 0.1]), np.array([0.3, -2.0, 0.05])
    away = 1e-3 * np.array([1.0, 2.0, 3.0]) * scale
    for multiplier in (0.9, 0.2, -0.7):
        # The last state is a return at a distance of `away` from the limit.
        before, earlier = (last + (1.0 / multiplier**k - 1.0) * away for k in (1, 2))
        found = limit_of_steps(last, before, earlier, scale)
        assert found == pytest.approx(last - away, abs=1e-12)
    # Steps that become longer, or no steps, lead nowhere.
    assert np.array_equal(limit_of_steps(last, last + away, last + 1.5 * away, scale), last)
    assert np.array_equal(limit_of_steps(last, last, last, scale), last)
