"""Falls of the guards of lanes in compiled code: against a closed form, and against the rows."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.compiling import fresh_system, needs_compiler, use_folder
from zeno_orbits.maps import classify
from zeno_orbits.maps.attractors import Attractor
from zeno_orbits.model import load_problem
from zeno_orbits.simulation.batch.events import first_falls
from zeno_orbits.simulation.batch.model import BatchFlow, BatchModel, batch_model

pytestmark = needs_compiler

GRAVITY = 9.81
TOLERANCE = 1e-3
ROUNDING = 1e-13
"""A root is exact to `DOUBLES`, squared, of its step, and to the rounding of the guard's values."""


@pytest.fixture
def model(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Callable[[str], BatchModel]:
    """Models of problems with compiled kernels, which all tests of a session share on disk."""
    use_folder(monkeypatch, Path(tmp_path_factory.getbasetemp().parent / "kernels"))
    return lambda name: batch_model(fresh_system(name))


def falls_both_ways(
    flow: BatchFlow, y: np.ndarray, p: np.ndarray, size: np.ndarray, on_guard: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the falls inside steps by compiled code, and by the rows in NumPy."""
    tolerance = np.full(len(y), TOLERANCE)
    before, after = flow.guard(y, p), flow.attempt(y, p, size, tolerance)[2]
    numbers = np.column_stack([size, tolerance, on_guard, before, after])

    def dense(rows: np.ndarray, offset: np.ndarray) -> np.ndarray:
        return flow.attempt(y[rows], p[rows], offset, tolerance[rows])[2]

    compiled = flow.falls(y, p, numbers)
    assert compiled is not None
    return compiled, first_falls(dense, size, before, after, on_guard)


def test_a_ball_falls_when_its_parabola_says_so(model: Callable[[str], BatchModel]) -> None:
    # h + v t - g t^2 / 2 = 0, within a step of 1 s or after it.
    problem = load_problem("bouncing_ball")
    rng = np.random.default_rng(1)
    height, speed = rng.uniform(0.0, 4.0, 200), rng.uniform(-5.0, 5.0, 200)
    height[::4], speed[::4] = 0.0, np.abs(speed[::4])
    time = (speed + np.sqrt(speed**2 + 2 * GRAVITY * height)) / GRAVITY
    expected = np.where(time <= 1.0, time, np.nan)
    p = np.tile(problem.values().vector, (200, 1))
    y = np.column_stack([height, speed])
    found, rows = falls_both_ways(model("bouncing_ball").free, y, p, np.ones(200), height == 0.0)
    assert np.isnan(expected).any()
    assert np.allclose(found, expected, rtol=ROUNDING, atol=ROUNDING, equal_nan=True)
    assert np.allclose(rows, expected, rtol=ROUNDING, atol=ROUNDING, equal_nan=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["forced_oscillator", "vibrating_table"])
def test_compiled_falls_are_those_of_the_rows_in_every_mode(
    name: str, model: Callable[[str], BatchModel]
) -> None:
    rng, problem, batch = np.random.default_rng(2), load_problem(name), model(name)
    n = 20_000
    for flow, flies in ((batch.free, False), (batch.locked, False), (batch.flight, True)):
        y = rng.uniform(-1.0, 1.0, (n, flow.n_y))
        p = np.tile(np.append(problem.values().vector, [0.1] * flies), (n, 1))
        size, on_guard = 10 ** rng.uniform(-3.0, 0.0, n), np.zeros(n, dtype=bool)
        if flies:
            on_guard[::2] = True
            y[::2, -2:] = 0.0, 1.0
        error = flow.attempt(y, p, size, np.full(n, TOLERANCE))[1]
        lawful = (error <= 1.0) & (on_guard | (flow.guard(y, p)[:, 0] > 0.0))
        y, p, size, on_guard = y[lawful], p[lawful], size[lawful], on_guard[lawful]
        compiled, rows = falls_both_ways(flow, y, p, size, on_guard)
        assert np.isfinite(rows).sum() > 20
        assert np.array_equal(np.isnan(compiled), np.isnan(rows))
        assert np.allclose(compiled, rows, rtol=1e-10, atol=ROUNDING, equal_nan=True)


@pytest.mark.slow
def test_a_map_of_compiled_steps_says_what_an_interpreted_one_says(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    use_folder(monkeypatch, Path(tmp_path_factory.getbasetemp().parent / "kernels"))
    problem, system = load_problem("motor_pendulum"), fresh_system("motor_pendulum")
    settings = [
        problem.values(gains={"Kp": kp, "Kd": kd})
        for kp in (1.5, 2.5, 4.0)
        for kd in (-1.8, -1.0, -0.3)
    ]
    answers: list[tuple[Attractor, ...]] = []
    for functions in (system, system.interpreted()):
        rows = batch_model(functions, problem.dynamics(settings[0]).own)
        monkeypatch.setattr(classify, "model_in_rows", lambda _problem, _own, rows=rows: rows)
        answers.append(classify.attractors_at(problem, settings))
        compiled = rows.free.falls(np.zeros((0, 5)), np.zeros((0, rows.n_p)), np.zeros((0, 7)))
        assert (compiled is None) == (functions is not system)
    for found, expected in zip(*answers, strict=True):
        told, wanted = (
            replace(one, period=0.0, state={}, margins={}, multipliers=(), trend=0.0)
            for one in (found, expected)
        )
        assert told == wanted
        # The tolerance of the orbit; a step less or more moves it by a part of that.
        assert found.period == pytest.approx(expected.period, rel=1e-9, nan_ok=True)
    assert len({one.fate for one in answers[0]}) > 1
