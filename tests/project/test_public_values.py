"""Public values survive pickling, copying and other processes, and ``==`` has an answer."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.clusters import dask_cluster

_BUNDLED = zo.bundled_problems()["bouncing_ball"].read_text(encoding="utf-8")
BALL = _BUNDLED.replace('"bouncing_ball"', '"own_ball"').replace(
    "restitution(0.8)", "restitution(0.5)"
)
"""A file of the user's own."""

WAYS: tuple[Callable[[Any], Any], ...] = (
    lambda value: pickle.loads(pickle.dumps(value)),
    copy.copy,
    copy.deepcopy,
)


def ball_file(folder: Path) -> Path:
    path = folder / "own_ball.py"
    path.write_text(BALL, encoding="utf-8")
    return path


def end_of(problem: zo.Problem) -> tuple[str, float, zo.Execution]:
    """Simulate in whatever process this is."""
    execution = zo.simulate(problem, until=2.0)
    return problem.name, execution.zeno_points[0].time, execution


def failed(path: Path) -> None:
    raise zo.OrbitFileError(path, "the test raises it")


def zeno_time(g: float, height: float) -> float:
    """Closed form for restitution 1/2: the fall, then a geometric series of flights."""
    fall = np.sqrt(2 * height / g)
    return float(fall * (1 + 2 * 0.5 / (1 - 0.5)))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "value",
    [
        zo.SearchSettings(),
        zo.SimulationSettings(),
        zo.VerificationSettings(),
        zo.ContinuationSettings(),
        zo.ExecutionPlan(place=zo.Workers(count=1)),
        zo.Bound(name="period", lower=1.0, upper=2.0),
        zo.WorkPrecisionSettings.quick(),
        zo.Rig(),
        zo.EventSequence.parsed("zeno*2"),
        zo.Quantity.positive("m", 1.0, "kg", "mass"),
        zo.MinEnergy(),
    ],
    ids=lambda value: type(value).__name__,
)
def test_settings_are_equal_to_their_copies(value: object, way: Callable[[Any], Any]) -> None:
    assert way(value) == value


@pytest.mark.parametrize("way", WAYS)
def test_results_are_equal_to_their_copies(
    way: Callable[[Any], Any], found: zo.SearchResult, certificate: zo.OrbitCertificate
) -> None:
    orbit = found.unwrap()
    plane = zo.parameter_map("bouncing_ball", x=("g", 5, 10, 2), y=("m", 1, 2, 2))
    returns = zo.return_map(orbit)
    for value in (found, orbit, certificate, plane, zo.floquet_multipliers(orbit), returns):
        assert way(value) == value
    other = zo.floquet_multipliers(orbit)
    assert replace(other, jacobian=other.jacobian + 1e-9) != other
    assert replace(plane, until=plane.until + 1.0) != plane


def test_maps_of_one_file_that_was_read_twice_are_equal(tmp_path: Path) -> None:
    path = tmp_path / "vibrating_table.py"
    path.write_bytes(zo.bundled_problems()["vibrating_table"].read_bytes())
    found = zo.find_orbit(zo.load_problem(path)).unwrap()
    first, second = (zo.return_map(found, problem=zo.load_problem(path)) for _ in range(2))
    assert first.problem is not second.problem
    assert first == second
    assert replace(second, problem=zo.load_problem("vibrating_table")) != first


@pytest.mark.slow
def test_runs_and_recordings_of_a_machine_are_compared_by_their_numbers() -> None:
    problem = zo.load_problem("motor_pendulum")
    run = zo.simulate_rig(problem, until=0.4)
    assert run == zo.simulate_rig(problem, until=0.4)
    assert run != zo.simulate_rig(problem, until=0.5)
    recording = zo.sample_execution(problem, zo.simulate(problem, until=0.4))
    for way in WAYS:
        assert way(run) == run
        assert way(recording) == recording
        assert way(recording.signals[0]) == recording.signals[0]
    assert zo.crop(recording, 0.1) != recording


@pytest.mark.parametrize("engine", ["automatic", "explicit", "implicit"])
def test_an_execution_has_the_same_states_in_every_bit_after_a_round_trip(engine: str) -> None:
    from zeno_orbits.integrators import engine_named

    settings = zo.SimulationSettings(engine=engine_named(engine))
    execution = zo.simulate("motor_pendulum", until=2.0, settings=settings)
    for way in WAYS:
        other = way(execution)
        assert other == execution
        for time in np.linspace(0.0, 2.0, 57):
            assert np.array_equal(other.state_at(time), execution.state_at(time))
    longer = zo.simulate("motor_pendulum", until=2.1, settings=settings)
    assert longer != execution


def test_a_problem_is_pickled_as_its_source_and_its_changes(tmp_path: Path) -> None:
    path = ball_file(tmp_path)
    for problem in (
        zo.load_problem("motor_pendulum"),
        zo.load_problem("motor_pendulum@corrected"),
        zo.load_problem(path),
        replace(zo.load_problem(path), starts=({"height": 2.0},)),
    ):
        data = pickle.dumps(problem)
        assert len(data) < 1000
        other = pickle.loads(data)
        assert other == problem
        assert hash(other) == hash(problem)
        assert (other.name, other.starts) == (problem.name, problem.starts)
        assert copy.deepcopy(problem) == problem
    assert zo.load_problem(path) == zo.load_problem(path)
    assert replace(zo.load_problem(path), starts=({"height": 2.0},)) != zo.load_problem(path)


def test_a_pickled_problem_whose_file_has_changed_is_refused(tmp_path: Path) -> None:
    path = ball_file(tmp_path)
    data = pickle.dumps(zo.load_problem(path))
    path.write_text(BALL.replace("9.81", "1.62"), encoding="utf-8")
    with pytest.raises(zo.InputError, match="the same file") as caught:
        pickle.loads(data)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["spawn", "forkserver"])
def test_a_problem_reaches_new_processes_and_its_execution_comes_back(
    kind: str, tmp_path: Path
) -> None:
    problem = replace(zo.load_problem(ball_file(tmp_path)), starts=({"height": 2.0},))
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context(kind)) as pool:
        name, time, execution = pool.submit(end_of, problem).result(timeout=120)
        error = pool.submit(failed, tmp_path).exception(timeout=120)
    assert name == "own_ball"
    # The tolerance of the simulation.
    assert time == pytest.approx(zeno_time(9.81, 2.0), rel=1e-9)
    assert execution == zo.simulate(problem, until=2.0)
    assert isinstance(error, zo.OrbitFileError)
    assert error.path == tmp_path


@pytest.mark.slow
def test_a_problem_goes_through_joblib(tmp_path: Path) -> None:
    joblib: Any = pytest.importorskip("joblib")
    problem = zo.load_problem(ball_file(tmp_path))
    runs = joblib.Parallel(n_jobs=2)(joblib.delayed(end_of)(problem) for _ in range(2))
    for _, time, execution in runs:
        assert time == pytest.approx(zeno_time(9.81, 1.0), rel=1e-9)
        assert execution == zo.simulate(problem, until=2.0)


@pytest.mark.slow
def test_a_problem_goes_through_a_dask_cluster(tmp_path: Path) -> None:
    distributed: Any = pytest.importorskip("distributed", reason="needs the extra `cluster`")
    problem = zo.load_problem(ball_file(tmp_path))
    with dask_cluster(tmp_path) as cluster:
        cluster.start_worker()
        with distributed.Client(cluster.address) as client:
            _, time, execution = client.submit(end_of, problem).result(timeout=120)
    assert time == pytest.approx(zeno_time(9.81, 1.0), rel=1e-9)
    assert execution == zo.simulate(problem, until=2.0)


@pytest.mark.slow
def test_several_workers_take_a_problem_that_has_a_file(tmp_path: Path) -> None:
    problem = zo.load_problem(ball_file(tmp_path))
    axes = {"x": ("g", 5.0, 10.0, 2), "y": ("restitution", 0.2, 0.6, 2)}
    here, there = (zo.parameter_map(problem, **axes, workers=n) for n in (1, 2))  # pyright: ignore[reportArgumentType]
    assert here == there
    changed = replace(problem, title="another")
    with pytest.raises(zo.InputError, match="several workers need a file"):
        zo.parameter_map(changed, **axes, workers=2)  # pyright: ignore[reportArgumentType]


def test_a_problem_and_settings_show_themselves_in_a_few_lines() -> None:
    assert repr(zo.load_problem("motor_pendulum")).startswith("<Problem motor_pendulum: ")
    assert len(repr(zo.load_problem("motor_pendulum"))) < 200
    for settings in (zo.SearchSettings(), zo.SimulationSettings(), zo.ContinuationSettings()):
        assert len(repr(settings)) < 1000
        assert "array" not in repr(settings)
