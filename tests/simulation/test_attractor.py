"""What a motion settles to, from made-up sequences: no simulation, and the same in any units."""

import math
import re

import numpy as np
import pytest

from zeno_orbits.simulation import (
    AttractorKind,
    Motion,
    SectionReturn,
    bounds_of,
    changes,
    growth_of,
    has_left,
    is_still,
    outcome_of,
    repetitions,
    scale_of,
)
from zeno_orbits.simulation.attractor import TEN_TURNS, keeps_holding

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


def lawful(at_rest, bend, n=12):
    """Amplitudes of n + 1 returns from 1 by the law of growth."""
    values = [1.0]
    for _ in range(n):
        values.append(values[-1] * math.exp(at_rest + bend * values[-1] ** 2))
    return values


def test_growth_near_rest_follows_its_law_down_to_zero():
    assert growth_of(lawful(-0.05, -0.02, n=30)).dies_out
    assert growth_of(lawful(-0.05, 0.03, n=60)).dies_out
    # Falls to an orbit of amplitude sqrt(0.02 / 0.06), where growth begins.
    assert not growth_of(lawful(0.02, -0.06)).dies_out
    # Grows.
    assert growth_of(lawful(0.05, -0.01)).factor > 1.0
    assert not growth_of(lawful(0.05, -0.01)).dies_out


def test_the_words_of_a_kind_end_a_sentence_that_begins_with_the_motion():
    words = [kind.value for kind in AttractorKind]
    assert all(re.fullmatch(r"[a-z]+([ -][a-z]+)*", word) for word in words)


def test_a_motion_grows_from_a_thousandth_a_return():
    for last, outcome in ((1.001, AttractorKind.UNDECIDED), (1.0015, AttractorKind.GROWS)):
        found = outcome_of(Motion(units=UNITS, amplitudes=[1.0, last]), close=1e-6)
        assert found.outcome is outcome


def test_sizes_are_largest_moduli_and_never_nearly_zero():
    assert scale_of([np.array([-3.0, 1.0]), np.array([2.0, -5.0])], ("m", "A")).tolist() == [3, 5]
    # A thousandth of the others of its unit, and of nothing else.
    one_unit = scale_of([np.array([5.0, 0.0, 1e-4, 2.0])], ("m", "m", "A", "m"))
    assert one_unit == pytest.approx([5.0, 5e-3, 1e-4, 2.0], rel=1e-15)
    # Below a ten-millionth of all others it is the error of a time, and has their size.
    lone = [192e-7, 128 * 1e-7, 64e-7, 0.0, 128.0]
    alone = scale_of([np.array(lone)], ("m", "A", "rad", "V", "m/s"))
    assert alone.tolist() == [192e-7, 128.0, 128.0, 128.0, 128.0]
    assert scale_of([np.zeros(2)], ("m", "A")).tolist() == [1.0, 1.0]


def test_two_returns_are_enough_to_repeat_and_one_is_not():
    met = returns(lambda _: [1.0, 0.3, 2.0, 0.0], n=2)
    assert [one.returns for one in repetitions(met, UNITS, close=1e-6, apart=0.01)] == [1]
    assert repetitions(met[:1], UNITS, close=1e-6, apart=0.01) == ()
    assert repetitions([], UNITS, close=1e-6, apart=0.01) == ()


def test_returns_repeat_if_they_are_nearer_than_asked():
    met = [SectionReturn(time=t, state=np.array([t]), size=np.array([4.0])) for t in (1.0, 2.0)]
    assert repetitions(met, ("m",), close=0.25, apart=0.01) == ()
    (found,) = repetitions(met, ("m",), close=0.26, apart=0.01)
    assert found.change == 0.25


def test_the_sizes_of_the_last_eight_returns_count():
    def found(large):
        met = [
            SectionReturn(
                time=float(k),
                state=np.array([1.0 + 0.1 * (k % 2)]),
                size=np.array([1e6 if k == 10 - large else 1.0]),
            )
            for k in range(10)
        ]
        return repetitions(met, ("m",), close=1e-2, apart=0.01)[0].returns

    assert [found(large) for large in (1, 8, 9)] == [1, 1, 2]


def test_more_returns_must_come_nearer_by_a_hundred_where_nobody_says_how_much():
    def found(near):
        met = returns(lambda k: [1.0 + 0.1 * (k % 2) + near * (k == 2), 0.3, 2.0, 0.0], n=3)
        return outcome_of(Motion(units=UNITS, returns=met), close=1e-2).outcome

    # The changes are 0.1 and `near`.
    assert found(0.8e-3) is AttractorKind.REPEATS
    assert found(1.5e-3) is AttractorKind.UNDECIDED


def test_rates_of_either_sign_count_against_the_largest_of_their_own_motion():
    rates = np.array([[[-1e-6, 0.0]], [[-1.5e-6, 0.0]], [[-1.5e-6, 0.0]], [[0.0, 1e-9]]])
    largest = np.array([[1.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 0.0]])
    assert is_still(rates, largest).tolist() == [True, False, True, False]
    # A limit for each state.
    assert is_still(rates, largest, np.array([0.0, 1e-8])).tolist() == [True, False, True, True]


@pytest.mark.parametrize(("slope", "holds"), [(2.9, True), (3.0, False), (3.5, False)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_force_may_not_fall_to_zero_within_a_third_of_a_step(sign, slope, holds):
    # The hull of the cubic ends at 1 - slope / 3 beside the middle phase, on one side of it.
    force, rate = np.array([[10.0, 1.0, 10.0]]), np.array([[0.0, sign * slope, 0.0]])
    assert keeps_holding(force, rate, 1.0).tolist() == [holds]


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


def test_what_the_problem_declares_is_gone_and_other_angles_after_ten_turns():
    bounds = bounds_of(("x", "a", "dx", "da"), UNITS, 2, {"x": 3.0})
    assert bounds.tolist() == [3.0, TEN_TURNS, math.inf, math.inf]
    assert pytest.approx(10 * 2 * math.pi, rel=1e-15) == TEN_TURNS
    assert bounds_of(("x", "a", "dx", "da"), UNITS, 2, {"a": 1.0})[1] == 1.0


def test_other_coordinates_have_left_once_they_are_far_beyond_where_they_ever_were():
    before = np.array([1e-3, 1e6, 0.0])
    assert has_left(np.array([2.0, 2e6, 5.0]), before).tolist() == [True, False, False]
    assert has_left(np.array([-2.0, -2e6, -5.0]), before).tolist() == [True, False, False]
    assert has_left(np.array([1001.0, 1000.0]), np.ones(2)).tolist() == [True, False]


def test_few_amplitudes_tell_their_mean_factor_alone() -> None:
    assert math.isnan(growth_of([]).factor)
    assert math.isnan(growth_of([1.0]).factor)
    assert growth_of([4.0, 2.0]).factor == pytest.approx(0.5)
    assert growth_of([1.0, 5.0, 9.0]).factor == pytest.approx(3.0)
    assert growth_of([4.0, 0.5]).factor == pytest.approx(1 / 8)
    assert math.isnan(growth_of([0.0, 1.0]).factor)
    assert math.isnan(growth_of([1.0, 1.0, 0.0]).factor)
    assert not growth_of([4.0, 2.0]).dies_out


@pytest.mark.parametrize("n_before", [0, 1, 20])
def test_the_growth_is_the_mean_of_the_last_six_factors_and_no_others(n_before: int) -> None:
    amplitudes = np.cumprod([*([17.0] * n_before), 1.0, 2.0, 3.0, 5.0, 7.0, 11.0, 13.0])
    assert growth_of(amplitudes.tolist()).factor == pytest.approx(30030 ** (1 / 6), rel=1e-12)
    # Of a motion that has faded, too.
    falling = growth_of((1 / amplitudes).tolist())
    assert falling.dies_out
    assert falling.factor == pytest.approx(30030 ** (-1 / 6), rel=1e-12)


def test_the_last_six_factors_tell_the_growth() -> None:
    early, late = [7.0, 3.0, 5.0], [1.1**k for k in range(7)]
    assert growth_of([*early, *late]).factor == pytest.approx(1.1, rel=1e-12)
    assert growth_of([*early, *(2.0 * a for a in late)]).factor == pytest.approx(1.1, rel=1e-12)


def test_a_motion_dies_out_as_soon_as_it_has_faded() -> None:
    assert growth_of([1.0, 0.9e-3]).dies_out
    assert growth_of([1.0, 1e-3]).dies_out
    assert not growth_of([1.0, 1.1e-3]).dies_out
    assert growth_of([10.0, 0.9e-2]).dies_out
    assert not growth_of([10.0, 1.1e-2]).dies_out
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
    # Its decay at rest would take five hundred returns for a factor of e.
    assert not growth_of(lawful(-0.002, -0.05)).dies_out
    assert growth_of(lawful(-0.02, -0.05, n=80)).dies_out
    paused = lawful(-0.05, -0.02, n=40)
    paused[-3] = paused[-4] * 1.001
    assert not growth_of(paused).dies_out


def test_a_law_is_told_from_six_factors_and_not_from_fewer():
    assert not growth_of([0.5**k for k in range(7)]).dies_out
    assert growth_of([0.5**k for k in range(8)]).dies_out


@pytest.mark.parametrize("size", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("factor", [0.9, 0.98, 0.985, 0.996])
def test_a_fall_by_less_than_four_tells_no_death(size, factor):
    falls = math.log(0.25) / math.log(factor)
    assert not growth_of([size * factor**k for k in range(math.floor(falls))]).dies_out
    assert growth_of([size * factor**k for k in range(math.ceil(falls) + 2)]).dies_out


@pytest.mark.parametrize("turn", [0.3, 0.05, 0.01])
@pytest.mark.parametrize("phase", [0.0, 0.4, 1.1])
def test_the_beat_of_a_quasi_periodic_motion_is_no_death(turn, phase):
    # An oscillation beside a clock: displacement and velocity are never both small.
    angles = phase + turn * np.arange(400)
    beats = np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles))).tolist()
    assert not any(growth_of(beats[:n]).dies_out for n in range(2, 400))
    # Two of one unit that beat: from 2 to 0.55.
    beats = (1.275 + 0.725 * np.cos(angles)).tolist()
    assert not any(growth_of(beats[:n]).dies_out for n in range(2, 400))


@pytest.mark.parametrize(("pause", "dies"), [(1.002, False), (0.99, True)])
def test_every_factor_must_be_one_of_clear_decay(pause, dies):
    amplitudes = [0.9**k for k in range(12)]
    amplitudes += [amplitudes[-1] * pause * 0.9**k for k in range(1, 8)]
    assert amplitudes[-1] < amplitudes[0] / 4
    # A pause lies in the law's range.
    amplitudes = (
        [*amplitudes[:12], amplitudes[11] * pause, *amplitudes[12:]] if not dies else amplitudes
    )
    assert growth_of(amplitudes).dies_out is dies


@pytest.mark.parametrize(("kick", "dies"), [(0.006, True), (0.018, False), (0.04, False)])
@pytest.mark.parametrize("sign", [1, -1])
def test_factors_that_scatter_about_their_law_tell_no_death(kick, dies, sign):
    # One of equal rates is off: most of it is misfit, against a fifth of 0.05.
    rates = np.full(30, -0.05)
    rates[15] += sign * kick
    amplitudes = np.exp(np.cumsum([0.0, *rates]))
    assert growth_of(amplitudes.tolist()).dies_out is dies
