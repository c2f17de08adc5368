"""Two motions side by side: their distances by the loop equal those of single turns."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from tests.loop.agreement import needs_compiler
from zeno_orbits.errors import SimulationError
from zeno_orbits.loop import GraphProgram, LoopRun, binding, filled
from zeno_orbits.model import CompiledGraph, load_problem
from zeno_orbits.simulation import SimulationTask, run_settings, transient_settings
from zeno_orbits.simulation.compiled.programs import add_asked, graph_program
from zeno_orbits.simulation.lyapunov import pair_by_loop, rates_turn_by_turn

pytestmark = needs_compiler

SETTINGS = transient_settings(1e-10)
TURNS = 12
CASES: tuple[tuple[str, float, dict[str, float]], ...] = (
    ("vibrating_table", 0.2, {"A": 0.0232}),
    ("vibrating_table", 0.2, {"restitution": 0.0}),
    ("motor_pendulum", 0.5, {}),
    ("torque_pendulum", 0.7, {"restitution": 0.97}),
    ("clapper", 0.4, {}),
    ("limited_pendulum", 0.3, {}),
    ("relay", 0.01, {}),
    ("hopper", 0.3, {}),
)
"""Machines with no, one and two stops, with switches and kinks; the time of a turn; parameters."""


def task_from_start(name: str, until: float, values: dict[str, float]) -> SimulationTask:
    """Return a motion from the first start of a bundled problem."""
    problem = load_problem(name)
    return SimulationTask(
        dynamics=problem.graph_dynamics(problem.values(parameters=values)),
        state=np.array(problem.state_vector(problem.starts[0])),
        until=until,
        settings=SETTINGS,
        goes_on=True,
    )


@pytest.mark.parametrize(("name", "turn", "values"), CASES)
def test_distances_of_a_pair_equal_those_of_single_turns_in_every_bit(
    name: str, turn: float, values: dict[str, float]
) -> None:
    task = task_from_start(name, turn, values)
    scale = 0.1 + np.abs(task.state)
    clock = task.graph.first.clock
    direction = np.array([0.0 if k in clock else (-1.0) ** k for k in range(scale.size)])
    turns = islice(rates_turn_by_turn(task, direction, scale), TURNS)
    single = [one for one in turns if one is not None]
    with closing(pair_by_loop(task, direction, scale)) as pair:
        # In two calls, between which nothing is lost.
        found = [*pair.rates(5), *pair.rates(TURNS - 5)]
    # A contact that forgets makes both motions one, which has no rate.
    assert len(single) >= 4
    assert found == single


def test_a_pair_whose_motion_leaves_every_bound_ends_with_its_error() -> None:
    whole = task_from_start("vibrating_table", 0.2, {})
    task = replace(whole, settings=transient_settings(1e-10, far=(1e-3,)))
    scale = np.ones(task.state.size)
    with (
        closing(pair_by_loop(task, np.ones(task.state.size), scale)) as pair,
        pytest.raises(SimulationError),
    ):
        pair.rates(40)


def end_of(run: LoopRun, program: GraphProgram, compiled: CompiledGraph) -> list[float]:
    """Return the last state of a run, which gets the views that it asks for."""
    status = binding.FULL
    while status != binding.DONE:
        status = run.resume()
        assert status in (binding.DONE, binding.FULL, binding.MODE)
        if status == binding.MODE:
            add_asked(compiled, program, program.asked_for(run.detail().about))
    return run.record().arcs[-1, binding.ARC_WIDTH :][: 2 * program.n_x].tolist()


def test_a_run_that_takes_memory_of_another_run_keeps_its_own_parameters() -> None:
    first, other = (task_from_start("clapper", 20.0, {"d": one}) for one in (1.0, 1.05))
    compiled, known = first.graph.compiled, graph_program(first.graph.compiled)
    assert isinstance(known, GraphProgram)
    program = GraphProgram(known.library, known.formulas)
    program.add(dict(islice(known.views.items(), 1)), {})
    begun = LoopRun(program, filled(run_settings(first)), first.graph.p, first.state)
    n_views = len(program.views)
    # The other run asks for the views, and leaves its memory with its parameters in them.
    between = LoopRun(program, filled(run_settings(other)), other.graph.p, other.state)
    end_of(between, program, compiled)
    between.close()
    assert len(program.views) > n_views
    found = end_of(begun, program, compiled)
    alone = LoopRun(program, filled(run_settings(first)), first.graph.p, first.state)
    assert found == end_of(alone, program, compiled)
