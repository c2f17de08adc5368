"""Compiled kernels in rows: the batch and the derivatives give what they give interpreted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from tests.support.compiling import fresh_system, needs_compiler, use_folder
from zeno_orbits.model import bind, load_problem
from zeno_orbits.model.numeric.compiled_derivatives import VariationFunctions
from zeno_orbits.simulation.batch.batch import Batch
from zeno_orbits.simulation.batch.model import BatchModel, Columns, batch_model
from zeno_orbits.simulation.batch.outcomes import LaneEvent

pytestmark = needs_compiler

ROUNDING = 1e-11
"""Some hundred events, each with a root to a few units in the last place."""


@pytest.fixture(autouse=True)
def _folder(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[None]:
    """Kernels that all processes of a session share."""
    use_folder(monkeypatch, tmp_path_factory.getbasetemp().parent / "kernels")
    return iter([None])


def events_of(model: BatchModel, name: str, n: int, until: float) -> list[LaneEvent]:
    """Return the events of a few lanes, in order."""
    problem, batch = load_problem(name), Batch(model, n)
    p = np.tile(problem.values().vector, (n, 1))
    x = np.tile(problem.state_vector(problem.starts[0]), (n, 1)) * np.linspace(0.8, 1.2, n)[:, None]
    batch.start(p, x, 1e-8, np.full(n, until))
    events: list[LaneEvent] = []
    while batch.n_running:
        events.extend(batch.round())
    return events


@pytest.mark.parametrize(
    "name", ["bouncing_ball", pytest.param("motor_pendulum", marks=pytest.mark.slow)]
)
def test_a_compiled_batch_has_the_events_of_an_interpreted_one_to_rounding(name: str) -> None:
    system = fresh_system(name)
    compiled = events_of(batch_model(system), name, 5, 4.0)
    plain = events_of(batch_model(system.interpreted()), name, 5, 4.0)
    assert len(compiled) > 5
    # Steps are the same to the last bit; falls inside them are found by a C code of their own.
    assert [(type(one), one.lane) for one in compiled] == [(type(one), one.lane) for one in plain]
    for mine, other in zip(compiled, plain, strict=True):
        assert mine.time == pytest.approx(other.time, rel=ROUNDING)
        assert mine.state == pytest.approx(other.state, rel=ROUNDING, abs=ROUNDING)


def test_columns_are_compiled_and_pass_on_what_is_not_finite() -> None:
    system = fresh_system("bouncing_ball")
    model = batch_model(system)
    x = np.array([[0.3, np.nan], [np.inf, 1.0], [-0.0, 2.0]])
    p = np.tile(load_problem("bouncing_ball").values().vector, (3, 1))
    found = model.resting(x, p)
    assert model.resting._compiled is not None
    expected = Columns(system.resting)(x, p)
    for mine, other in zip(found, expected, strict=True):
        assert np.array_equal(mine, other, equal_nan=True)
    assert [len(one) for one in model.resting(x[:0], p[:0])] == [0, 0, 0]


@pytest.mark.parametrize(
    "name", ["motor_valve", pytest.param("motor_pendulum", marks=pytest.mark.slow)]
)
def test_compiled_perturbations_are_the_interpreted_ones_to_the_last_bit(name: str) -> None:
    problem = load_problem(name)
    values, rng = problem.values().vector, np.random.default_rng(1)
    n = len(problem.state_names)
    y = np.array(problem.state_vector(problem.starts[0])) + 0.1
    v, q = rng.normal(size=(n, n + 1)), rng.normal(size=(1, n + 1))
    found: list[tuple[np.ndarray, float, np.ndarray]] = []
    system = fresh_system(name)
    for one in (system, system.interpreted()):
        derivatives = bind(one, values).differentiation
        assert derivatives is not None
        free = derivatives.by((0,)).free
        stages = np.array([y + 0.01 * k for k in range(7)])
        found.append((*free.step(y, 1e-3, v, q), free.linear(stages).copy()))
    for mine, other in zip(*found, strict=True):
        assert np.array_equal(mine, other)


def test_a_variational_equation_that_was_compiled_builds_no_formulas() -> None:
    system = fresh_system("motor_valve")
    functions = VariationFunctions(system.free, (0,), 4)
    assert functions.kernels.library() is not None
    assert "step" not in vars(functions)
    assert system.free.kernels.library() is not None
    assert not {"step", "jacobian"} & set(vars(system.free))
