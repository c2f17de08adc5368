"""What accuracy costs: trials held against a better truth, and the front of those worth taking."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.reference.many_digits.execution import extended_execution
from tests.reference.reference_orbit import PERIOD, RELEASE
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.model import Problem, load_problem
from zeno_orbits.precision import (
    SAME_WORK,
    TimedSetting,
    WorkPrecision,
    WorkPrecisionSettings,
    measure_work_precision,
)
from zeno_orbits.precision.reference import true_landmarks
from zeno_orbits.precision.trials import engines
from zeno_orbits.simulation import EventKind, simulate

TINY = WorkPrecisionSettings(
    until=1.02 * PERIOD,
    repeats=1,
    tolerances=(1e-4, 1e-9),
    slow_from=1e-4,
    cuts=(1.0, 1e-1),
    impacts=(2, 6),
    meshes=(),
)


@pytest.fixture(name="measured", scope="module")
def _measured(problem: Problem) -> WorkPrecision:
    """Two releases and a Zeno point, from rest."""
    return measure_work_precision(
        problem, problem.values(), (0.6, 0.0, 0.0, 0.0, 0.0), settings=replace(TINY, until=3.0)
    )


def trial(seconds: float, error: float, **others: Any) -> TimedSetting:
    return TimedSetting(
        **{"sweep": "engine", "name": "x", "value": 1e-6, **others}, seconds=seconds, error=error
    )


def traded(*trials: TimedSetting) -> WorkPrecision:
    return WorkPrecision(problem="p", work="w", truth="t", truth_error=1e-25, trials=trials)


def errors(found: WorkPrecision, sweep: str, name: str | None = None) -> list[float]:
    return [t.error for t in found.trials if t.sweep == sweep and name in (None, t.name)]


# -------------------------------------------------------------------------------- measuring


def test_every_sweep_is_measured_and_nothing_fails(measured: WorkPrecision) -> None:
    swept = {t.sweep for t in measured.trials}
    assert swept == set(SAME_WORK)
    names = {t.name for t in measured.trials if t.sweep == "engine"}
    again = {f"{name}, interpreted" for name in ("automatic", "explicit", "implicit")}
    assert names == set(engines()) | (again if shutil.which("cc") else set())
    assert not any(t.trouble for t in measured.trials)
    assert all(0.0 < t.seconds < math.inf for t in measured.trials)
    assert all(t.error < math.inf for t in measured.trials)


def test_the_truth_is_far_more_certain_than_any_trial(measured: WorkPrecision) -> None:
    assert measured.truth == "double precision at 1e-14 by an implicit method"
    assert measured.truth_error < 0.1 * min(t.error for t in measured.trials)


@pytest.mark.parametrize("name", ["automatic", "explicit", "implicit"])
def test_a_tighter_tolerance_errs_less(name: str, measured: WorkPrecision) -> None:
    loose, tight = errors(measured, "engine", name)
    assert tight < 1e-8
    assert loose > 10 * tight


def test_the_cut_errs_by_the_cube_of_its_speed(measured: WorkPrecision) -> None:
    """Theory (2.3): ten times slower, a thousand times better, but for where impacts fall."""
    coarse, fine = errors(measured, "cut")
    assert 30 * fine < coarse


def test_more_impacts_before_the_limit_err_less(measured: WorkPrecision) -> None:
    few, many = errors(measured, "impacts")
    assert many < 1e-3 * few


def test_a_reduced_model_errs_by_its_model_and_not_by_its_tolerance(
    measured: WorkPrecision,
) -> None:
    loose, tight = errors(measured, "fidelity", "quasi_static")
    assert tight == pytest.approx(loose, rel=0.05)
    # Measured on its orbit: 2.6e-4 of the period, and more of the state.
    assert 1e-5 < tight < 1e-2
    assert errors(measured, "fidelity", "corrected")[-1] < 0.1 * tight


@pytest.mark.slow
def test_progress_names_what_is_measured_and_rises(problem: Problem) -> None:
    said: list[tuple[str, float]] = []
    few = replace(TINY, tolerances=(1e-4,), slow_from=1.0, cuts=(), impacts=())
    measure_work_precision(
        problem,
        problem.values(),
        RELEASE,
        settings=few,
        on_progress=lambda what, part: said.append((what, part)),
    )
    assert said[0] == ("computing the truth", 0.0)
    assert ("engine: automatic, 1e-04") in [what for what, _ in said]
    parts = [part for _, part in said]
    assert parts == sorted(parts)
    assert parts[-1] <= 1.0


@pytest.mark.slow
def test_meshes_are_solved_where_there_is_an_orbit_and_say_why_where_there_is_none(
    problem: Problem,
) -> None:
    none = replace(
        TINY, tolerances=(1e-4,), slow_from=1.0, cuts=(), impacts=(), meshes=(1e-2, 1e-5)
    )
    found = measure_work_precision(problem, problem.values(), RELEASE, settings=none)
    coarse, fine = (t for t in found.trials if t.sweep == "mesh")
    assert fine.error < 0.1 * coarse.error
    assert "mesh" not in {t.sweep for t in found.front}
    ball = load_problem("bouncing_ball")
    missing = measure_work_precision(
        ball, ball.values(), (1.0, 0.0), settings=replace(none, until=5.0)
    )
    (row,) = (t for t in missing.trials if t.sweep == "mesh")
    assert math.isinf(row.error)
    assert "No simulation settled" in row.trouble


# --------------------------------------------------------------------------------- the truth


@pytest.mark.parametrize(
    ("name", "until"), [("motor_pendulum", 1.02 * PERIOD), ("motor_valve", 3.0)]
)
@pytest.mark.slow
def test_the_truth_is_that_of_many_digits_within_its_error(name: str, until: float) -> None:
    problem = load_problem(name)
    values = problem.values()
    start = RELEASE if name == "motor_pendulum" else problem.state_vector({})
    truth = true_landmarks(problem.dynamics(values), start, until)
    exact = extended_execution(problem, values, start, until=until)
    assert exact.error < 1e-20
    assert len(exact.releases) == len(truth.marks) > 0
    last = truth.marks[-1].time
    for known, found in zip(exact.releases, truth.marks, strict=True):
        assert abs(float(known.time) - found.time) / last < truth.error
        miss = np.abs(np.array(known.state, dtype=float) - found.state) / truth.scale
        assert np.max(miss) < truth.error
    # The integrators may differ by rounding only.
    assert truth.error < 1e-13


def test_the_truth_of_a_stiff_problem_is_that_of_its_limit() -> None:
    # R / L = 1e8: some 2e8 decay times; the truth without a current is off by them.
    problem = load_problem("motor_pendulum")
    values = problem.values(parameters={"L": 1e-8})
    truth = true_landmarks(problem.dynamics(values), RELEASE, 1.02 * PERIOD)
    assert truth.error < 1e-12
    reduced = problem.at_fidelity("quasi_static")
    left_out = reduced.dynamics(reduced.shared(values))
    without = true_landmarks(left_out, RELEASE[:4], 1.02 * PERIOD)
    # Theory (1.12): the error of the reduction is of the order of L / R.
    assert abs(truth.marks[-1].time - without.marks[-1].time) < 1e-6


def test_the_truth_is_judged_by_the_largest_state_on_the_way(problem: Problem) -> None:
    dynamics = problem.dynamics(problem.values())
    truth = true_landmarks(dynamics, RELEASE, 1.02 * PERIOD)
    assert {mark.kind for mark in truth.marks} == {EventKind.RELEASE}
    assert abs(truth.marks[-1].time - PERIOD) < 1e-13
    # At its releases the second link does not turn; on the way it does.
    assert np.all(truth.scale > [1.0, 1.0, 5.0, 5.0, 1.0])


def test_nothing_to_judge_by_is_said(problem: Problem) -> None:
    with pytest.raises(ZenoOrbitsError, match="no event within"):
        measure_work_precision(
            problem, problem.values(), (0.6, 0.1, 0.0, 0.0, 0.0), settings=replace(TINY, until=1e-3)
        )


@pytest.mark.parametrize("until", [0.0, -1.0, math.nan, math.inf])
def test_a_horizon_that_is_none_is_refused(until: float, problem: Problem) -> None:
    with pytest.raises(InputError, match="`until`"):
        measure_work_precision(
            problem, problem.values(), RELEASE, settings=replace(TINY, until=until)
        )


# --------------------------------------------------------------------------------- the front


def test_the_front_holds_what_no_other_beats(measured: WorkPrecision) -> None:
    front = measured.front
    assert front
    comparable = [t for t in measured.trials if t.sweep in SAME_WORK]
    for best in front:
        assert not any(t.seconds < best.seconds and t.error < best.error for t in comparable)
    for t in comparable:
        assert any(
            best.seconds <= t.seconds and best.error <= max(t.error, 4e-15) for best in front
        )


def test_a_trial_that_another_one_beats_is_not_on_the_front() -> None:
    fast, middle, slow = trial(1.0, 1e-2), trial(2.0, 1e-4), trial(3.0, 1e-6)
    beaten, lost = trial(2.5, 1e-3), trial(0.5, math.inf)
    other_work = trial(0.1, 1e-9, sweep="mesh")
    assert traded(beaten, slow, lost, fast, other_work, middle).front == (fast, middle, slow)
    assert traded(lost, other_work).front == ()


def test_errors_below_rounding_are_not_smaller_than_each_other() -> None:
    lucky, quick = trial(2.0, 1e-23), trial(1.0, 1e-16)
    assert traded(lucky, quick).front == (quick,)


def test_the_cheapest_is_the_fastest_that_is_accurate_enough() -> None:
    fast, slow = trial(1.0, 1e-4), trial(3.0, 1e-8)
    found = traded(slow, fast, trial(2.0, 1e-3))
    assert found.cheapest(1e-3) is fast
    assert found.cheapest(1e-4) is fast
    assert found.cheapest(0.99e-4) is slow
    assert found.cheapest(1e-9) is None


def test_as_json_nothing_is_infinite_and_the_front_is_marked() -> None:
    lost = trial(math.inf, math.inf, trouble="It fell.")
    good = trial(1.0, 1e-6)
    data = json.loads(json.dumps(traded(lost, good).as_json(), allow_nan=False))
    assert data["problem"] == "p"
    assert [t["on_front"] for t in data["trials"]] == [False, True]
    assert (data["trials"][0]["seconds"], data["trials"][0]["error"]) == (None, None)
    assert data["trials"][0]["trouble"] == "It fell."
    unsure = replace(traded(good), truth_error=math.inf).as_json()
    assert json.loads(json.dumps(unsure, allow_nan=False))["truth_error"] is None


@pytest.mark.slow
def test_the_window_holds_what_the_problem_is_about() -> None:
    quick = replace(
        TINY, until=None, least=3.0, tolerances=(1e-8,), cuts=(1e-1, 1e-3), impacts=(2,), meshes=()
    )
    table = load_problem("forced_oscillator")
    start = table.state_vector(table.starts[0])
    # In the first three seconds nothing strikes.
    assert simulate(table.dynamics(table.values()), start, until=3.0).impacts == ()
    found = measure_work_precision(table, table.values(), start, settings=quick)
    assert "1 Zeno point" in found.work
    assert all(trial.n_impacts > 0 for trial in found.trials if trial.sweep == "engine")


@pytest.mark.slow
def test_a_window_holds_the_zeno_point_of_a_falling_ball() -> None:
    quick = replace(TINY, until=None, least=3.0, tolerances=(1e-8,), cuts=(), impacts=(), meshes=())
    ball = load_problem("bouncing_ball")
    found = measure_work_precision(ball, ball.values(), (1.0, 0.0), settings=quick)
    # The closed form, and the part by which a window is longer.
    zeno_time = math.sqrt(2.0 / 9.81) * (1.0 + 0.8) / (1.0 - 0.8)
    assert float(found.work.split()[0]) == pytest.approx(1.1 * zeno_time, rel=5e-3)
