"""The comparison with others: its laws are the problem's, and its judgement does not flatter."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import beside_others
from benchmarks.others import work
from zeno_orbits.model import load_problem, load_reference

TRUTH = {"rate": 1500.0, "state": [0.1, 0.2, 0.3, 0.4, 0.5], "locks": 11}


def _row(state: list[float], locks: int | None = 11) -> beside_others.Row:
    return {
        "method": "theirs",
        "rate": 1500.0,
        "accuracy": 1e-6,
        "state": state,
        "locks": locks,
        "seconds": [3.0, 1.0, 2.0],
    }


@pytest.mark.parametrize("rate", [1.5e3, 1e6])
def test_the_lean_laws_are_those_of_the_problem(rate: float) -> None:
    problem = load_problem("motor_pendulum")
    lean = work.pendulum(rate)
    problem_file = load_reference(problem).dynamics(problem.values(parameters=work.declared(rate)))
    rng = np.random.default_rng(7)
    # Both evaluate a dozen terms in other orders; the current's rate carries the factor 1/L.
    close = {"rel": 1e-12, "abs": 1e-12 * rate}
    for _ in range(20):
        x = rng.normal(size=5)
        assert lean.rates(x.tolist()) == pytest.approx(problem_file.free.rate(x).tolist(), **close)
        on_stop = problem_file.on_stop(np.array([x[0], 0.0, x[2], 0.0, x[4]]))
        theta1, _, rate1, _, current = on_stop.tolist()
        locked = problem_file.locked.rate(on_stop)[[0, 2, 4]].tolist()
        assert lean.locked_rates((theta1, rate1, current)) == pytest.approx(locked, **close)
        hold = -problem_file.gap_acceleration(on_stop)
        assert lean.hold(theta1, current) == pytest.approx(hold, rel=1e-10, abs=1e-10)
        strike = np.array([x[0], 0.0, x[2], -abs(x[3]), x[4]])
        after = problem_file.reset_map(strike, float(strike[3])).tolist()
        assert lean.impact(strike.tolist(), lean.restitution) == pytest.approx(after, rel=1e-12)


def test_the_calibrated_numbers_are_those_of_the_problem() -> None:
    problem = load_problem("motor_pendulum")
    problem_file = problem.values().parameters
    assert work.declared(work.REFERENCE_RATE) == pytest.approx(dict(problem_file), rel=1e-12)


def test_a_time_between_two_runs_lies_on_the_power_law_through_them() -> None:
    runs = [(error, 3.0 * error**-0.25) for error in (1e-4, 1e-7, 1e-11)]
    assert beside_others.time_at(1e-9, runs) == pytest.approx(3.0 * 1e-9**-0.25, rel=1e-12)


def test_a_run_that_is_slower_and_less_accurate_than_another_does_not_count() -> None:
    runs = [(1e-4, 1.0), (1e-8, 2.0)]
    assert beside_others.time_at(1e-6, [*runs, (1e-5, 5.0), (1e-6, 9.0)]) == (
        beside_others.time_at(1e-6, runs)
    )


def test_more_accurate_than_asked_costs_what_it_costs_and_never_accurate_has_no_time() -> None:
    runs = [(1e-7, 1.0), (1e-9, 2.0)]
    assert beside_others.time_at(1e-4, runs) == 1.0
    assert beside_others.time_at(1e-10, runs) is None
    assert beside_others.time_at(1e-10, []) is None


def test_an_error_is_relative_to_the_scale_of_its_state() -> None:
    state = [0.1, 0.2, 0.3, 0.4 + 17.0 * 1e-6, 0.5]
    (judged,) = beside_others.judge([_row(state)], {1500.0: TRUTH})
    assert judged["error"] == pytest.approx(1e-6, rel=1e-9)
    assert judged["median"] == 2.0
    assert "failure" not in judged


def test_a_run_that_missed_a_lock_is_a_failure_however_near_it_ends() -> None:
    (judged,) = beside_others.judge([_row(TRUTH["state"], locks=10)], {1500.0: TRUTH})
    assert judged["failure"].startswith("missed impacts")


@pytest.mark.parametrize("wrong", [859.0, float("nan")])
def test_another_motion_is_a_failure(wrong: float) -> None:
    (judged,) = beside_others.judge([_row([0.1, wrong, 0.3, 0.4, 0.5], None)], {1500.0: TRUTH})
    assert judged["failure"].startswith("another motion")


def test_failures_have_no_part_in_times_or_in_confirming_the_truth() -> None:
    (judged,) = beside_others.judge([_row(TRUTH["state"], locks=10)], {1500.0: TRUTH})
    assert beside_others.times_at([judged], [1e-6]) == {}
    assert beside_others.confirmation([judged], 1500.0) is None


def test_the_truth_is_not_confirmed_by_the_integrator_that_it_comes_from() -> None:
    own = _row(TRUTH["state"]) | {"method": "heyoka by hand", "error": 0.0}
    other = _row(TRUTH["state"]) | {"error": 1e-9}
    assert beside_others.confirmation([own, other], 1500.0) == (1e-9, "theirs")
    assert beside_others.confirmation([own], 1500.0) is None


def test_a_competitor_that_is_not_there_is_left_out_with_a_reason() -> None:
    answer = beside_others.run("scipy_loop", "/no/such/python", "ball", [])
    assert answer == {"missing": "there is no /no/such/python"}
