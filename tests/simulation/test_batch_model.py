"""A problem in rows: functions of a table with plain numbers, and how rows are called."""

from importlib import import_module
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from zeno_orbits.integrators import fall_source
from zeno_orbits.integrators.rosenbrock import rosenbrock_step
from zeno_orbits.model import USUAL, OwnScale
from zeno_orbits.model.library import load_problem
from zeno_orbits.simulation.batch import model as rows_module
from zeno_orbits.simulation.batch.model import (
    Columns,
    _filled,
    _padded,
    batch_model,
    model_in_rows,
)

TABLE = load_problem("vibrating_table")
NUMBERS = {"m": 2.0, "A": 1.0, "omega": 2.0, "g": 2.0, "restitution": 0.25}
P = np.array(TABLE.values(parameters=NUMBERS).vector)
X = (0.5, -3.0, 0.6, 0.8)
"""Height, speed, and a phase at which the gap's acceleration is 4 * 0.8 - 2 [m/s^2]."""


def test_what_holds_at_a_point_is_told_of_every_row():
    model = model_in_rows(TABLE)
    x = np.array([X, (0.0, 1.0, 1.0, 0.0)])
    p = np.tile(P, (2, 1))
    # The multiplier is minus the mass of 2 kg times the acceleration.
    contact = [[0.5, -3.0, 1.2, -2.4, -2.0 * 4.0 * 2.0 * 0.6], [0.0, 1.0, -2.0, 4.0, -16.0]]
    assert model.contact(x, p)[0] == pytest.approx(np.array(contact))
    assert model.restitution(x, p)[0].tolist() == [[0.25], [0.25]]
    rate = np.array([[-3.0], [-1.0]])
    assert model.rebound(p, rate)[0].ravel() == pytest.approx([0.75, 0.25])
    assert model.reset(x, p, rate)[0][0] == pytest.approx([0.5, 0.75, 0.6, 0.8])
    state, acceleration, flow = model.resting(x, p)
    assert state == pytest.approx(np.array([[0.0, 0.0, 0.6, 0.8], [0.0, 0.0, 1.0, 0.0]]))
    assert acceleration.ravel() == pytest.approx([1.2, -2.0])
    assert flow == pytest.approx(np.array([[0.0, 0.0, -1.6, 1.2], [0.0, 0.0, 0.0, 2.0]]))


def test_a_model_knows_its_states_its_clock_and_its_sizes():
    model = model_in_rows(TABLE)
    assert model.state_names == TABLE.state_names
    assert (model.n_q, model.n_x, model.n_p, model.clock) == (1, 4, 5, (2, 3))
    assert model.moving == [0, 1]
    assert (model.own, model.absolute) == (USUAL, 0.1)
    small = model_in_rows(TABLE, OwnScale(sizes=(1e-3, 2.0, 3.0, 4.0)))
    assert small.absolute == pytest.approx(1e-4)
    assert [flow.n_y for flow in (model.free, model.locked, model.flight)] == [4, 4, 6]
    assert load_problem("bouncing_ball").compiled().clock == ()


def test_the_modes_have_their_own_flows_and_guards():
    model, x, p = model_in_rows(TABLE), np.array([X]), P[None]
    assert model.free.rate(x, p) == pytest.approx(np.array([[-3.0, 1.2, -1.6, 1.2]]))
    assert model.free.guard(x, p) == pytest.approx(np.array([[0.5, -3.0]]))
    on = np.array([[0.0, 0.0, 0.6, 0.8]])
    assert model.locked.rate(on, p) == pytest.approx(np.array([[0.0, 0.0, -1.6, 1.2]]))
    assert model.locked.guard(on, p) == pytest.approx(np.array([[-2.4, -9.6]]))
    # In its own time, of a speed of 0.5, all of that is half as fast but the scaled gap.
    y, numbers = np.array([[*X, 0.3, 0.7]]), np.append(P, 0.5)[None]
    flight = np.array([[-1.5, 0.6, -0.8, 0.6, 0.7, 1.2]])
    assert model.flight.rate(y, numbers) == pytest.approx(flight)
    assert model.flight.guard(y, numbers) == pytest.approx(np.array([[0.3, 0.7]]))


@pytest.mark.parametrize("x", [X, (0.5, -3.0, 1.0, 0.0)])
@pytest.mark.parametrize("sizes", [(), (1e3, 2.0, 0.5, 0.1)])
def test_the_error_of_a_step_is_told_in_the_sizes_of_the_problem(sizes, x):
    own = OwnScale(sizes=sizes)
    model, size, relative = model_in_rows(TABLE, own), 0.3, 1e-4
    mode = TABLE.compiled().free
    y, h = ca.SX.sym("y", 4), ca.SX.sym("h")
    parts = rosenbrock_step(
        lambda state: mode.rate(state, P), ca.jacobian(mode.rate(y, P), y), y, h
    )
    plain = ca.Function("step", [y, h], [*parts])
    after, miss = (np.array(part).ravel() for part in plain(x, size))
    scale = relative * (0.1 * own.states(4) + np.maximum(np.abs(x), np.abs(after)))
    found, error, guard = model.free.attempt(
        np.array([x, x]), np.tile(P, (2, 1)), np.array([size, 0.0]), np.full(2, relative)
    )
    assert found[0] == pytest.approx(after, rel=1e-14)
    assert error[0] == pytest.approx(np.sqrt(np.mean((miss / scale) ** 2)), rel=1e-9)
    assert guard[0] == pytest.approx(after[:2], rel=1e-14)
    # A step of no size changes nothing.
    assert found[1] == pytest.approx(x, rel=1e-15)
    assert error[1] == 0.0


def test_a_step_beyond_all_numbers_is_never_good():
    x = np.array([[1e308, 1e308, 1.0, 0.0], [0.0, -1e308, 1.0, 0.0]])
    with np.errstate(all="ignore"):
        size, tolerance = np.full(2, 10.0), np.full(2, 1e-4)
        error = model_in_rows(TABLE).free.attempt(x, np.tile(P, (2, 1)), size, tolerance)[1]
    assert not (error <= 1.0).any()


def test_what_is_compiled_of_a_model_is_what_it_calls(monkeypatch):
    given = []

    def kernels(recipe):
        given.append(recipe)
        return SimpleNamespace(library=lambda: None, owe=lambda _: None)

    monkeypatch.setattr(rows_module, "Kernels", kernels)
    own = OwnScale(gap_acceleration=7.0, sizes=(1e3, 2.0, 0.5, 0.1))
    model = batch_model(TABLE.compiled(), own)
    batch_model(TABLE.compiled().interpreted(), own)
    recipe, interpreted = given
    assert interpreted is None
    module, _, maker = recipe.maker.partition(":")
    made = getattr(import_module(module), maker)(recipe.functions, recipe.numbers)
    named = {function.name(): function for function in made.functions}
    y, p = np.array([[*X, 0.3, 0.7]]), np.append(P, 0.5)[None]
    for flow, n_p in ((model.free, 5), (model.locked, 5), (model.flight, 6)):
        state, numbers = y[:, : flow.n_y], p[:, :n_p]
        found = flow.attempt(state, numbers, np.array([0.3]), np.array([1e-4]))
        wanted = named[flow._kernel](state[0], numbers[0], [0.3, 1e-4])
        for one, other in zip(found, wanted, strict=True):
            assert one.ravel().tolist() == np.array(other).ravel().tolist()
        assert {flow._step._kernel, flow._rate._kernel, flow._guard._kernel} <= set(named)
    points = (model.contact, model.restitution, model.rebound, model.reset, model.resting)
    assert {columns._kernel for columns in points} <= set(named)
    assert made.code.startswith(fall_source())
    assert "zk_falls" in made.code[len(fall_source()) :]


def test_falls_are_left_to_the_rows_until_there_is_compiled_code():
    assert model_in_rows(TABLE).free.falls(np.zeros((1, 4)), P[None], np.zeros((1, 7))) is None


@pytest.mark.parametrize(
    ("n", "padded"),
    [
        (0, 0),
        (1, 1),
        (2, 2),
        (3, 4),
        (4, 4),
        (5, 8),
        (9, 16),
        (16, 16),
        (17, 32),
        (32, 32),
        (33, 48),
    ],
)
def test_rows_are_filled_up_to_a_number_of_few_blocks(n, padded):
    assert _padded(n) == padded
    rows = np.arange(2.0 * n).reshape(n, 2)
    if n:
        filled = _filled(rows, padded)
        assert filled.shape == (padded, 2)
        assert filled[:n].tolist() == rows.tolist()
        assert (filled[n:] == rows[-1]).all()


def product():
    """A function of rows of two and of one, to rows of two and of one."""
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    return ca.Function("f", [x, y], [x * y, ca.sum1(x) + y])


def test_calls_that_are_not_compiled_yet_count_for_compiling():
    owed = []
    function = product()
    columns = Columns(function, SimpleNamespace(library=lambda: None, owe=owed.append), "kernel")
    columns(np.ones((5, 2)), np.ones((5, 1)))
    columns(np.ones((40, 2)), np.ones((40, 1)))
    # About a nanosecond for every instruction of every row.
    per_row = 1.2e-9 * function.n_instructions()
    assert owed == pytest.approx([5 * per_row, 40 * per_row])


def test_compiled_rows_are_asked_for_once_and_split_into_outputs():
    asked = []

    def rows(kernel, widths_in, widths_out):
        asked.append((kernel, widths_in, widths_out))

        def call(n, given, results):
            assert all(one.flags.c_contiguous and one.dtype == np.float64 for one in given)
            results[:, :2], results[:, 2:] = given[0] * given[1], 7.0 * n

        return call

    library = SimpleNamespace(rows=rows)
    columns = Columns(product(), SimpleNamespace(library=lambda: library), "kernel")
    x, y = np.arange(12).reshape(3, 4)[:, ::2], np.array([[2], [3], [4]])
    for _ in range(2):
        first, second = columns(x, y)
        assert first.tolist() == (x * y).tolist()
        assert second.tolist() == [[21.0]] * 3
    assert asked == [("kernel", [2, 1], [2, 1])]
