"""Derivatives in the loop are those of the formulas in Python, along the same steps."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from tests.loop.agreement import looped, needs_compiler, task_of
from tests.support.cases import fast, often
from tests.support.one_stop import one_stop_problems
from tests.support.returns import multipliers_at
from tests.support.units import Units, in_units
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import Radau, RungeKutta, Tolerance
from zeno_orbits.model import GraphDynamics, HybridDynamics
from zeno_orbits.simulation import (
    EventDerivatives,
    Execution,
    PlasticAfter,
    SaltationDerivative,
    SimulationSettings,
    SimulationTask,
    ZenoExtrapolation,
    simulate,
)
from zeno_orbits.simulation.derivatives.sensitivity import VariationalEquation

pytestmark = needs_compiler

ROUNDING = 1e-11
"""Of the largest entry of a column, where the motion itself is no worse conditioned."""

CHATTER = SimulationSettings(completion=ZenoExtrapolation())
ENGINES = {"explicit": RungeKutta(), "implicit": Radau(), "usual": CHATTER.engine}
COMBINED = [(name, "usual") for name in one_stop_problems()] + [
    # One constraint on a curve, and one motor: the rules of a step do not depend on the problem.
    (name, engine)
    for name in ("curved_surface", "motor_pendulum")
    for engine in ("explicit", "implicit")
]


def _rows(derivatives: EventDerivatives, run: Execution) -> Vector:
    """Return time, states and gap rate of the start, the end and every event of each arc."""
    return np.array(
        [
            np.vstack([shift.time, shift.state, shift.rate])
            for one in derivatives.passages(run)
            for shift in (one.start, one.end, *(each for c in one.crossings for each in c[1:]))
        ]
    )


def _sides(
    system: GraphDynamics | HybridDynamics, chosen: tuple[int, ...], run: Execution
) -> float:
    """Return the distance of the derivatives by the loop from those in Python."""
    by_loop, in_python = (
        _rows(EventDerivatives(system, chosen, Tolerance(), in_python=alone), run)
        for alone in (False, True)
    )
    return _distance(by_loop, in_python)


def _require_equal(task: SimulationTask, chosen: tuple[int, ...]) -> Execution:
    run = looped(task).execution
    assert run is not None
    distance = _sides(task.dynamics, chosen, run)
    assert distance < ROUNDING or distance < _of_one_rounding(task, chosen, run)
    return run


def _distance(found: Vector, expected: Vector) -> float:
    assert found.shape == expected.shape
    sizes = 1 + np.max(np.abs(expected), axis=1, keepdims=True)
    return float(np.max(np.abs(found - expected) / sizes, initial=0.0))


def _of_one_rounding(task: SimulationTask, chosen: tuple[int, ...], run: Execution) -> float:
    """Return how far the derivatives in Python move if the start is rounded once."""
    moved = looped(replace(task, state=np.nextafter(task.state, np.inf))).execution
    assert moved is not None
    alone = EventDerivatives(task.dynamics, chosen, Tolerance(), in_python=True)
    return _distance(_rows(alone, moved), _rows(alone, run))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "until"),
    fast(1, [("kneed_walker", 0.5), ("relay", 0.05), ("clapper", 8.0), ("limited_pendulum", 1.0)]),
)
def test_every_event_of_several_stops_and_switches_moves_as_in_python(
    name: str, until: float
) -> None:
    problem = zo.load_problem(name)
    graph = problem.graph_dynamics(problem.values())
    x = np.array(problem.state_vector(problem.starts[0]))
    motion = simulate(graph, x, until=until, settings=CHATTER)
    assert motion.events
    chosen = tuple(range(min(4, graph.p.size)))
    found, expected = (
        _rows(EventDerivatives(graph, chosen, Tolerance(), in_python=alone), motion)
        for alone in (False, True)
    )
    assert found.shape == expected.shape
    assert len(found) == 2 * len(motion.events) + 2 * len(motion.arcs)
    states = np.max([np.abs(arc.end_state) for arc in motion.arcs], axis=0)
    # Rounding counts beside the largest change, if start and parameters change by their own sizes.
    changes = np.append(states, np.abs(graph.p[list(chosen)]))
    largest = np.max(np.abs(expected) * changes, axis=(0, 2))
    off = np.max(np.abs(found - expected) * changes, axis=(0, 2))
    fastest = max((abs(one.approach_rate) for one in motion.impacts), default=0.0)
    assert np.all(off <= ROUNDING * np.maximum(largest, [until, *states, fastest]))


@pytest.mark.parametrize(("name", "engine"), fast(3, COMBINED))
def test_every_arc_moves_as_in_python(name: str, engine: str) -> None:
    settings = SimulationSettings(completion=ZenoExtrapolation(), engine=ENGINES[engine])
    task = task_of(zo.load_problem(name), until=0.7, settings=settings)
    assert task.dynamics.formulas is not None
    n_p = task.dynamics.formulas.values.size
    # Four parameters fill the lanes of most problems and overflow those of some.
    _require_equal(task, tuple(range(0, n_p, max(1, n_p // 4))))


@pytest.mark.slow
@pytest.mark.parametrize("name", often(2, sorted(one_stop_problems())[2::3]))
def test_every_arc_moves_by_every_parameter_as_in_python(name: str) -> None:
    problem = zo.load_problem(name)
    for start in range(len(problem.starts)):
        task = task_of(problem, until=4.0, start=start, settings=CHATTER)
        assert task.dynamics.formulas is not None
        _require_equal(task, tuple(range(task.dynamics.formulas.values.size)))


@pytest.mark.parametrize("restitution", [0.0, 0.05, 0.95])
@pytest.mark.parametrize("name", ["falling_pendulum"])
def test_it_is_the_same_at_any_restitution(name: str, restitution: float) -> None:
    values = {"restitution": restitution}
    task = task_of(zo.load_problem(name), until=1.2, values=values, settings=CHATTER)
    run = _require_equal(task, (0, 1))
    assert run.impacts


@pytest.mark.slow
def test_it_is_the_same_in_millimetres_and_milliseconds() -> None:
    units = Units(mass=1e3, length=1e3, time=1e3)
    problem = in_units(zo.load_problem("falling_pendulum"), units)
    run = _require_equal(task_of(problem, until=4e3, settings=CHATTER), (0, 1, 2))
    assert run.zeno_points


def test_threads_carry_the_same_derivatives() -> None:
    task = task_of(zo.load_problem("motor_pendulum"), until=2.0, settings=CHATTER)
    run = looped(task).execution
    assert run is not None
    derivatives = EventDerivatives(task.dynamics, (0, 1), Tolerance())
    expected = _rows(derivatives, run).tolist()
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: _rows(derivatives, run).tolist(), range(16)))
    assert all(one == expected for one in found)


MULTIPLIERS = """
import numpy as np, zeno_orbits as zo
from tests.support.returns import multipliers_at
problem = zo.load_problem("motor_pendulum")
x = np.array([0.1985068301199, 0, -5.2365375521764, 0, -1.8591703843225])
print(repr(multipliers_at(problem.dynamics(problem.values()), x, 1.81371293903044)[0].real))
"""


@pytest.mark.slow
def test_multipliers_are_the_same_without_compiled_code() -> None:
    root = Path(__file__).resolve().parents[2]
    said: list[float] = []
    for loop in ("use", "never"):
        environment = {**os.environ, "ZENO_ORBITS_LOOP": loop, "PYTHONPATH": str(root)}
        done = subprocess.run(
            [sys.executable, "-c", MULTIPLIERS],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
            timeout=300,
        )
        said.append(float(done.stdout))
    one, other = said
    # Implicit steps end at other last digits, which one period magnifies a hundred times.
    assert one == pytest.approx(other, abs=1e-13)
    assert one == pytest.approx(-0.0193686140388, abs=1e-12)


def test_multipliers_and_cut_returns_take_their_derivatives_from_the_loop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refused(*_: object, **__: object) -> SaltationDerivative:
        raise AssertionError("derivatives are carried in Python")

    monkeypatch.setattr(VariationalEquation, "struck", refused)
    problem = zo.load_problem("motor_pendulum")
    x = np.array([0.1985068301199, 0, -5.2365375521764, 0, -1.8591703843225])
    found = multipliers_at(problem.dynamics(problem.values()), x, 1.81371293903044)
    assert abs(found[0]) == pytest.approx(0.0193686140388, abs=1e-12)
    cut = SimulationSettings(completion=PlasticAfter(n_impacts=3))
    run = looped(task_of(problem, until=2.0, settings=cut)).execution
    assert run is not None
    derivatives = EventDerivatives(problem.dynamics(problem.values()), (), Tolerance())
    assert len(list(derivatives.passages(run))) == len(run.arcs)


def test_states_and_numbers_that_are_no_motion_end_in_numbers() -> None:
    rng = np.random.default_rng(3)
    problem = zo.load_problem("motor_pendulum")
    task = task_of(problem, until=0.4, settings=CHATTER)
    run = looped(task).execution
    assert run is not None
    for special in (np.nan, np.inf, 1e300, -1e-300):
        derivatives = EventDerivatives(task.dynamics, (0,), Tolerance())
        start = derivatives.at_start()
        start.state[rng.integers(5)] = special
        assert len(list(derivatives.passages(run, start))) == len(run.arcs)
