"""What a motion settles to, from made-up sequences: no simulation, and the same in any units."""

import math

import numpy as np
import pytest

from zeno_orbits.simulation.attractor import (
    TEN_TURNS,
    AttractorKind,
    Motion,
    SectionReturn,
    bounds_of,
    changes,
    growth_of,
    has_left,
    is_still,
    keeps_holding,
    outcome_of,
    repetitions,
    scale_of,
)

UNITS = ("m", "rad", "m/s", "rad/s")


def returns(state_at, n=12, time=1.5):
    return [SectionReturn(time=time * k, state=np.array(state_at(k))) for k in range(n)]


def circling(period, decay=0.0):
    """Returns that repeat after `period` of them, and come nearer by exp(-decay) each."""
    return returns(
        lambda k: [
            1.0 + 0.1 * math.cos(2 * math.pi * k / period) + 0.05 * math.exp(-decay * k),
            0.3 + 0.1 * math.sin(2 * math.pi * k / period),
            2.0,
            0.0,
        ],
        n=30,
    )


@pytest.mark.parametrize("period", [1, 2, 3, 5, 8])
def test_a_motion_repeats_after_its_returns_and_no_multiple_of_them(period):
    found = outcome_of(Motion(units=UNITS, returns=circling(period)), close=1e-6)
    assert found.outcome is AttractorKind.REPEATS
    assert found.repetitions[0].returns == period


def test_a_motion_that_throws_over_as_it_settles_repeats_after_one():
    settling = returns(lambda k: [1.0 + 0.01 * (-0.6) ** k, 0.3, 2.0, 0.0], n=40)
    found = outcome_of(Motion(units=UNITS, returns=settling), close=1e-6)
    assert [one.returns for one in found.repetitions] == [1]


def test_a_motion_that_has_not_come_near_yet_is_undecided():
    found = outcome_of(Motion(units=UNITS, returns=circling(7.3)), close=1e-6)
    assert found.outcome is AttractorKind.UNDECIDED
    assert outcome_of(Motion(units=UNITS), close=1e-6).outcome is AttractorKind.UNDECIDED


def test_the_answer_comes_in_order_of_what_is_certain():
    steady = circling(1)
    assert outcome_of(Motion(units=UNITS, returns=steady, gone="x"), close=1e-6).escaped == "x"
    still = outcome_of(Motion(units=UNITS, returns=steady, still=True), close=1e-6)
    assert still.outcome is AttractorKind.RESTS
    wandering = Motion(units=UNITS, returns=circling(7.3), held=True)
    assert outcome_of(wandering, close=1e-6).outcome is AttractorKind.HELD


@pytest.mark.parametrize(
    ("factor", "outcome"),
    [
        (0.8, AttractorKind.DIES_OUT),
        (1.05, AttractorKind.GROWS),
        (1.0 + 2.9e-12, AttractorKind.UNDECIDED),
    ],
)
def test_a_trend_is_growth_or_decay_only_beyond_rounding(factor, outcome):
    amplitudes = [factor**k for k in range(12)]
    found = outcome_of(Motion(units=UNITS, amplitudes=amplitudes), close=1e-6)
    assert found.outcome is outcome
    assert found.trend == pytest.approx(factor)


@pytest.mark.parametrize("metre", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("second", [1e-3, 1.0, 1e3])
def test_the_answer_is_the_same_in_any_units(metre, second):
    unit = np.array([metre, 1.0, metre / second, 1.0 / second])
    for period, close, decay in ((1, 1e-2, 0.3), (3, 1e-6, 2.0)):
        plain = circling(period, decay)
        scaled = [SectionReturn(time=second * one.time, state=unit * one.state) for one in plain]
        expected = outcome_of(Motion(units=UNITS, returns=plain), close=close)
        found = outcome_of(Motion(units=UNITS, returns=scaled), close=close)
        assert found.outcome is expected.outcome is AttractorKind.REPEATS
        for one, other in zip(found.repetitions, expected.repetitions, strict=True):
            assert one.returns == other.returns
            assert one.change == pytest.approx(other.change, rel=1e-6, abs=1e-12)


def test_sizes_between_returns_measure_states_that_vanish_at_the_returns():
    state = np.array([1e-14, 0.3, 2.0, 0.0])
    away = np.array([4e-14, 0.3, 2.0, 0.0])
    size = np.array([0.1, 0.5, 3.0, 1.0])
    met = [SectionReturn(time=float(k), state=[state, away][k % 2], size=size) for k in range(4)]
    assert repetitions(met, UNITS, close=1e-6, apart=0.01)[0].returns == 1


def test_changes_see_the_period_of_a_sequence_and_zero_states_do_not_blur_it():
    states = [np.array([1.0 + 0.1 * (k % 3), 1e-17 * k, 5.0, 0.0, 0.2]) for k in range(9)]
    found = changes(states, scale_of(states, ("rad", "rad", "rad/s", "rad/s", "A")))
    assert found[3] < 1e-12
    assert found[1] > 0.05
    assert found[2] > 0.05


def test_growth_near_rest_follows_its_law_down_to_zero():
    def amplitudes(at_rest, bend, n=12):
        values = [1.0]
        for _ in range(n):
            values.append(values[-1] * math.exp(at_rest + bend * values[-1] ** 2))
        return values

    assert growth_of(amplitudes(-0.05, -0.02)).dies_out
    assert growth_of(amplitudes(-0.05, 0.03)).dies_out
    # Falls to an orbit of amplitude sqrt(0.02 / 0.06), where growth begins.
    assert not growth_of(amplitudes(0.02, -0.06)).dies_out
    # Grows.
    assert growth_of(amplitudes(0.05, -0.01)).factor > 1.0
    assert not growth_of(amplitudes(0.05, -0.01)).dies_out


def test_a_motion_is_still_only_if_it_is_in_every_phase_of_the_clock():
    largest = np.array([[2.0, 30.0]])
    now = np.array([[[1e-7, 1e-6]]])
    assert is_still(now, largest).tolist() == [True]
    assert is_still(now, 1e-3 * largest).tolist() == [False]
    later = np.array([[[1e-7, 1e-6], [0.0, 1e-2]]])
    assert is_still(later, largest).tolist() == [False]
    # What has never moved is still but for rounding.
    assert is_still(1e-10 * now, 0 * largest).tolist() == [False]
    assert is_still(1e-10 * now, 0 * largest, 1e-12).tolist() == [True]


@pytest.mark.parametrize(("least", "holds"), [(0.01, True), (-0.01, False), (-1e-4, False)])
@pytest.mark.parametrize("omega", [1e-3, 30.0, -30.0])
def test_a_stop_lets_go_if_its_force_falls_through_zero_between_two_phases(least, holds, omega):
    # The lowest point lies in the middle between two phases.
    angle = np.linspace(0.0, 2 * np.pi, 65) + np.pi / 64
    force = 1 + least + np.cos(angle)
    slope = -omega * np.sin(angle)
    assert keeps_holding(force[None], slope[None], np.pi / 32 / omega).tolist() == [holds]


def test_a_stop_that_has_let_go_at_one_phase_does_not_hold():
    # At the first phase its force comes back, so that the cubic is positive from there on.
    force, slope = np.array([[-0.01, 1.0, 1.0]]), np.array([[10.0, 0.0, 0.0]])
    assert keeps_holding(force, slope, 1.0).tolist() == [False]
    assert keeps_holding(np.abs(force), slope, 1.0).tolist() == [True]


def test_a_force_that_rises_between_two_phases_holds_and_one_that_falls_may_not():
    force, slope = np.array([[1.0, 1.0]]), np.array([[6.0, -6.0]])
    assert keeps_holding(force, slope, 1.0).tolist() == [True]
    assert keeps_holding(force, -slope, 1.0).tolist() == [False]


def test_a_stop_without_a_clock_holds_while_its_force_is_positive():
    assert keeps_holding(np.array([[0.1], [-0.1]]), np.zeros((2, 1)), 0.0).tolist() == [True, False]


def test_what_the_problem_declares_is_gone_and_other_angles_after_ten_turns():
    bounds = bounds_of(("x", "a", "dx", "da"), UNITS, 2, {"x": 3.0})
    assert bounds.tolist() == [3.0, TEN_TURNS, math.inf, math.inf]
    assert bounds_of(("x", "a", "dx", "da"), UNITS, 2, {"a": 1.0})[1] == 1.0


def test_other_coordinates_have_left_once_they_are_far_beyond_where_they_ever_were():
    before = np.array([1e-3, 1e6, 0.0])
    assert has_left(np.array([2.0, 2e6, 5.0]), before).tolist() == [True, False, False]


def test_few_amplitudes_tell_their_mean_factor_alone() -> None:
    assert math.isnan(growth_of([]).factor)
    assert math.isnan(growth_of([1.0]).factor)
    assert growth_of([4.0, 2.0]).factor == pytest.approx(0.5)
    assert growth_of([1.0, 5.0, 4.0]).factor == pytest.approx(2.0)
    assert math.isnan(growth_of([0.0, 1.0]).factor)
    assert not growth_of([4.0, 2.0]).dies_out


def test_the_last_six_factors_tell_the_growth() -> None:
    early, late = [7.0, 3.0, 5.0], [1.1**k for k in range(7)]
    assert growth_of([*early, *late]).factor == pytest.approx(1.1, rel=1e-12)
    assert growth_of([*early, *(2.0 * a for a in late)]).factor == pytest.approx(1.1, rel=1e-12)


def test_a_motion_dies_out_as_soon_as_it_has_faded() -> None:
    assert growth_of([1.0, 0.9e-3]).dies_out
    assert not growth_of([1.0, 1.1e-3]).dies_out
    # Of the largest there ever was, and by the last one alone.
    assert growth_of([0.1, 1.0, 0.5, 0.9e-3]).dies_out
    assert not growth_of([1.0, 0.9e-3, 0.1]).dies_out
    assert growth_of([1.0, 0.0]).dies_out
    assert math.isnan(growth_of([1.0, 0.0]).factor)


def test_states_of_different_units_are_compared_in_the_problems_own_sizes():
    # A length that the stop holds at zero, beside a speed: in micrometres a second it is no less.
    states = [np.array([1e-17, 0.3, 2.0, 0.1]), np.array([-2e-17, 0.5, 1.0, 0.2])]
    usual = np.array([1e-6, 1.0, 1e-12, 1.0])
    plain = scale_of(states, UNITS)
    assert plain == pytest.approx([2.0, 0.5, 2.0, 0.2])
    scaled = [x * usual for x in states]
    assert scale_of(scaled, UNITS, usual) == pytest.approx(plain * usual)
    met = [SectionReturn(time=float(k), state=scaled[k % 2]) for k in range(6)]
    plainly = [SectionReturn(time=float(k), state=states[k % 2]) for k in range(6)]
    found = repetitions(met, UNITS, close=1e-6, apart=0.01, usual=usual)
    assert found == repetitions(plainly, UNITS, close=1e-6, apart=0.01)
    assert [one.returns for one in found] == [2]


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 16])
def test_a_motion_may_repeat_after_so_many_returns(n):
    met = returns(lambda k: [1.0 + 0.1 * (k % n), 0.2, 0.3, 0.4], n=2 * n + 2)
    assert repetitions(met, UNITS, close=1e-9, apart=0.01)[0].returns == n


def test_decay_that_is_not_clear_or_pauses_is_no_death():
    def amplitudes(at_rest, bend, n=12):
        values = [1.0]
        for _ in range(n):
            values.append(values[-1] * math.exp(at_rest + bend * values[-1] ** 2))
        return values

    # Its decay at rest would take five hundred returns for a factor of e.
    assert not growth_of(amplitudes(-0.002, -0.05)).dies_out
    assert growth_of(amplitudes(-0.02, -0.05)).dies_out
    paused = amplitudes(-0.05, -0.02)
    paused[-3] = paused[-4] * 1.001
    assert not growth_of(paused).dies_out
