"""A run can be interrupted anywhere, copied, and carried out in many threads."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from tests.support.one_stop import one_stop_problems
from zeno_orbits.arrays import Vector
from zeno_orbits.loop import LoopRecord, LoopRun, RunSettings, binding, filled, program_of
from zeno_orbits.simulation import SimulationTask, run_settings

pytestmark = needs_compiler

PROBLEMS = ["motor_pendulum", "curved_surface", "two_tone_table"]


def _task(name: str, until: float = 3.0) -> SimulationTask:
    problem = zo.load_problem(name)
    return SimulationTask(
        dynamics=problem.dynamics(problem.values()),
        state=np.array(problem.state_vector(problem.starts[0])),
        until=until,
    )


def _begun(task: SimulationTask, settings: list[RunSettings] | None = None) -> LoopRun:
    formulas = task.graph.first.formulas
    assert formulas is not None
    program = program_of(formulas.system)
    assert program is not None
    return LoopRun(program, filled(settings or run_settings(task)), formulas.values, task.state)


def _ended(run: LoopRun, **rows: int) -> LoopRecord:
    for _ in range(100_000):
        if run.resume(**rows) == binding.DONE:
            return run.record()
    raise AssertionError("the run does not end")


def _require_equal(found: LoopRecord, expected: LoopRecord, n_x: int) -> None:
    # Only flights fill the last two entries of a state, and only implicit steps all of a row.
    assert found.steps.shape == expected.steps.shape
    assert found.steps[:, : 2 + n_x].tolist() == expected.steps[:, : 2 + n_x].tolist()
    assert found.events.tolist() == expected.events.tolist()
    assert found.arcs[:, : binding.ARC_WIDTH + 2 * n_x].tolist() == (
        expected.arcs[:, : binding.ARC_WIDTH + 2 * n_x].tolist()
    )
    assert len(found.polynomials) == len(expected.polynomials)


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize(
    "rows",
    [
        {"steps": 1},
        {"steps": 7, "polynomials": 1},
        {"arcs": 3},
        {"events": 6},
        {"steps": 2, "polynomials": 2, "arcs": 4, "events": 7},
    ],
    ids=str,
)
def test_a_run_that_is_interrupted_is_the_same(name: str, rows: dict[str, int]) -> None:
    task = _task(name)
    whole = _ended(_begun(task))
    _require_equal(_ended(_begun(task), **rows), whole, len(task.state))


@pytest.mark.parametrize("name", PROBLEMS)
def test_a_copy_goes_on_by_itself(name: str) -> None:
    task = _task(name)
    whole = _ended(_begun(task))
    run = _begun(task)
    for _ in range(9):
        run.resume(steps=5, polynomials=5)
    other = run.copy()
    first = _ended(run)
    _require_equal(first, whole, len(task.state))
    _require_equal(_ended(other), whole, len(task.state))


@pytest.mark.parametrize(
    ("kind", "least"), [("steps", 1), ("polynomials", 1), ("arcs", 3), ("events", 6)]
)
def test_a_record_that_is_too_short_for_one_event_is_refused(kind: str, least: int) -> None:
    run = _begun(_task("motor_pendulum"))
    with pytest.raises(
        ValueError, match=f"`{kind}` must be at least {least}, but it is {least - 1}"
    ):
        run.resume(**{kind: least - 1})


def test_a_run_tells_where_it_is() -> None:
    task = _task("curved_surface")
    run = _begun(task)
    before = 0.0
    while run.resume(steps=20) != binding.DONE:
        time, mode, state = run.now()
        assert before <= time <= task.until
        assert mode in (binding.FREE, binding.LOCKED, binding.FLIGHT)
        assert np.all(np.isfinite(state))
        before = time
    assert before > 0.5 * task.until


def test_a_sequence_longer_than_the_memory_for_it_is_the_same() -> None:
    # At e = 0.97 some 230 impacts are resolved, and memory is there for 64 at first.
    problem = zo.load_problem("bouncing_ball")
    values = problem.values(parameters={"restitution": 0.97})
    task = SimulationTask(dynamics=problem.dynamics(values), state=np.array([1.0, 0.0]), until=60.0)
    record = _ended(_begun(task, run_settings(task, completion=binding.EXTRAPOLATION)))
    impacts = record.events[record.events[:, 0] == binding.IMPACT]
    assert len(impacts) > 200
    zeno = record.events[record.events[:, 0] == binding.ZENO]
    fall = float(np.sqrt(2 / 9.81))
    assert zeno[0, 1] == pytest.approx(fall * 1.97 / 0.03, rel=1e-12)


def test_threads_do_not_disturb_each_other() -> None:
    tasks = [_task(name, until=1.5) for name in PROBLEMS]
    alone = [_ended(_begun(task)) for task in tasks]

    def again(k: int) -> tuple[int, LoopRecord]:
        return k, _ended(_begun(tasks[k]), steps=16)

    with ThreadPoolExecutor(max_workers=4) as pool:
        for k, found in pool.map(again, [n % len(tasks) for n in range(48)]):
            _require_equal(found, alone[k], len(tasks[k].state))


def test_without_records_there_are_events_alone() -> None:
    task = _task("curved_surface")
    whole = _ended(_begun(task))
    record = _ended(_begun(task, run_settings(task, records=False)))
    assert len(record.steps) == len(record.arcs) == 0
    assert record.events.tolist() == whole.events.tolist()


def test_an_explicit_step_from_a_state_is_that_of_the_plain_flow() -> None:
    task = _task("motor_pendulum")
    formulas = task.graph.first.formulas
    assert formulas is not None
    program, values = program_of(formulas.system), formulas.values
    assert program is not None
    rng = np.random.default_rng(3)
    tolerance = task.settings.tolerance
    for _ in range(20):
        x: Vector = rng.uniform(-0.5, 0.5, task.state.size)
        size = 10.0 ** rng.uniform(-5, -3)
        found = program.states_after(values, binding.LOCKED, 1.0, x[None], np.array([size]))
        expected, _ = task.dynamics.locked.attempt(x, size, tolerance)
        assert found[0].tolist() == expected.tolist()


@pytest.mark.slow
def test_every_state_and_number_ends_in_a_status() -> None:
    # NaN, infinity and sizes without sense among them: no call may crash or go on for ever.
    rng = np.random.default_rng(0)
    special = [np.nan, np.inf, -np.inf, 0.0, 1e308, -1e308, 5e-324]
    seen: set[int] = set()
    tasks = [_task(name) for name in one_stop_problems()]
    for k in range(10_000):
        task = tasks[k % len(tasks)]
        formulas = task.graph.first.formulas
        assert formulas is not None
        program = program_of(formulas.system)
        assert program is not None
        x = task.state * rng.uniform(-2, 2, task.state.size) + rng.normal(size=task.state.size)
        p = formulas.values * rng.uniform(0.5, 1.5, formulas.values.size)
        for array in (x, p):
            for _ in range(rng.integers(0, 3)):
                array[rng.integers(array.size)] = special[rng.integers(len(special))]
        settings = run_settings(task, until=10.0 ** rng.uniform(-3, 1), most_steps=200)
        run = LoopRun(program, filled(settings), p, x)
        for _ in range(50):
            status = run.resume()
            seen.add(status)
            if status == binding.CURVE:
                run.answer(None)
            elif status != binding.FULL:
                break
        else:
            raise AssertionError("a run does not end")
        run.close()
    assert {binding.DONE, binding.MANY_STEPS, binding.NOT_FINITE} <= seen


def test_a_step_that_became_infinite_is_shortened() -> None:
    # A uniform rise without end: steps grow eightfold until they overflow, and the flight must end.
    task = replace(_task("bouncing_ball"), state=np.array([1.0, 1e-3]), until=1e308)
    values = np.array(
        [0.0 if name == "g" else 0.5 for name in zo.load_problem("bouncing_ball").symbols()]
    )
    settings = run_settings(task, until=math.inf, most_steps=5000, reach=(math.inf,))
    formulas = task.graph.first.formulas
    assert formulas is not None
    program = program_of(formulas.system)
    assert program is not None
    run = LoopRun(program, filled(settings), values, task.state)
    status = binding.FULL
    while status == binding.FULL:
        status = run.resume()
    assert status in (binding.DONE, binding.TOO_STIFF, binding.MANY_STEPS, binding.BEYOND)
