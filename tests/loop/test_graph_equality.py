"""The loop and the reference of several stops and switches agree on every event."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from benchmarks import random_graphs
from tests.loop.agreement import looped, needs_compiler
from tests.loop.refused import REFUSED
from tests.loop.shaken import shaken
from tests.support.cases import fast
from tests.support.elastic_machines import BLOCKS
from tests.support.random_machines import RandomMachine
from zeno_orbits.errors import RunawayError, SimulationError, SimultaneousEventsError
from zeno_orbits.integrators import Engine, Radau, RungeKutta
from zeno_orbits.loop import LoopRun, binding, filled
from zeno_orbits.simulation import (
    Arc,
    Event,
    Execution,
    Impact,
    SimulationSettings,
    SimulationTask,
    SwitchEvent,
    by_reference,
    run_settings,
    whole_program,
)

pytestmark = needs_compiler

EXPLICIT = SimulationSettings(engine=RungeKutta())
PROBLEMS = Path(__file__).parents[2] / "problems"
ROUNDING = 1e-11
"""Of implicit steps, as in `test_equality`."""
BUNDLED: tuple[tuple[str, float, dict[str, float]], ...] = (
    ("clapper", 30.0, {}),
    ("hopper", 5.0, {}),
    ("kneed_walker", 2.0, {}),
    ("limited_pendulum", 3.0, {}),
    ("limited_pendulum", 3.0, {"U": 1000.0}),
    ("relay", 0.09, {}),
)


def both(
    problem: zo.Problem,
    until: float,
    values: Mapping[str, float],
    settings: SimulationSettings,
    limits: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
) -> list[tuple[Execution | None, SimulationError | None]]:
    """Return what the loop and the reference give: executions, and the errors that ended them."""
    graph = problem.graph_dynamics(problem.values(parameters=dict(values)))
    task = SimulationTask(
        dynamics=graph,
        state=np.array(problem.state_vector(start or problem.starts[0])),
        until=until,
        settings=settings,
        most_releases=(limits or {}).get("releases", np.inf),
        most_impacts=(limits or {}).get("impacts", np.inf),
    )
    loop = looped(task)
    try:
        return [(loop.execution, loop.error), (by_reference(task, plain=False), None)]
    except SimulationError as error:
        return [(loop.execution, loop.error), (error.execution, error)]


def words(one: Event | Arc) -> list[object]:
    """Return everything but the numbers of an event or arc."""
    return [type(one), *(v for v in _values(one) if not isinstance(v, float | np.ndarray))]


def numbers(one: Event | Arc) -> list[float]:
    """Return the numbers of an event or arc."""
    found: list[float] = []
    for value in _values(one):
        if isinstance(value, float):
            found.append(value)
        elif isinstance(value, np.ndarray):
            found += np.asarray(value, dtype=np.float64).tolist()
    return found


def _values(one: Event | Arc) -> list[object]:
    return [getattr(one, field.name) for field in fields(one) if field.name != "trajectory"]


def require_agreement(
    problem: zo.Problem,
    until: float,
    values: Mapping[str, float],
    settings: SimulationSettings,
    tolerance: float,
    limits: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
) -> Execution | None:
    """Require the same events, arcs and errors, in every bit if the tolerance is zero."""
    (found, error), (expected, reason) = both(problem, until, values, settings, limits, start)
    assert type(error) is type(reason)
    assert (found is None) == (expected is None)
    if found is None or expected is None:
        return None
    for mine, others in ((found.events, expected.events), (found.arcs, expected.arcs)):
        assert [words(one) for one in mine] == [words(other) for other in others]
        for one, other in zip(mine, others, strict=True):
            if tolerance == 0.0:
                assert numbers(one) == numbers(other)
            else:
                assert numbers(one) == pytest.approx(numbers(other), rel=tolerance, abs=tolerance)
    if tolerance == 0.0:
        assert str(error) == str(reason)
        for one, other in zip(found.arcs, expected.arcs, strict=True):
            assert one.flow_times.tolist() == other.flow_times.tolist()
            assert one.flow_states.tolist() == other.flow_states.tolist()
    return found


@pytest.mark.slow
def test_elastic_impacts_on_several_stops_are_the_same() -> None:
    start = {"q0": 1.0, "q1": 2.0, "v1": -1.0}
    run = require_agreement(BLOCKS, 50.0, {"M": 2500.0}, EXPLICIT, 0.0, start=start)
    assert run is not None
    assert len(run.impacts) == 157
    walker = zo.load_problem("kneed_walker")
    run = require_agreement(walker, 3.0, {"restitution": 1.0}, EXPLICIT, 0.0)
    assert run is not None
    assert not run.zeno_points


@pytest.mark.slow
@pytest.mark.parametrize("engine", [RungeKutta(), Radau()], ids=["explicit", "implicit"])
@pytest.mark.parametrize("half_periods", fast(1, [2, 4, 5]))
@pytest.mark.parametrize("name", fast(1, ["relay", "relay_soft"]))
def test_a_switch_at_the_end_of_the_time_does_not_count(
    name: str, half_periods: int, engine: Engine
) -> None:
    # The voltage switches at every half period of 0.02 s, of `relay_soft` also at `t1` and `t2` of
    # every period. The times of the switches are inexact, and fall on both sides of the end.
    problem, settings = zo.load_problem(name), SimulationSettings(engine=engine)
    further = 2 * ((half_periods + 1) // 2) if name == "relay_soft" else 0
    until = 0.02 * half_periods
    for end in (until, np.nextafter(until, 0.0), np.nextafter(until, 1.0)):
        for run, error in both(problem, float(end), {}, settings):
            assert error is None
            assert run is not None
            assert sum(isinstance(one, SwitchEvent) for one in run.events) == (
                half_periods - 1 + further
            )
            assert len(run.impacts) == (7 + (name == "relay_soft")) * half_periods + (
                half_periods // 2 if name == "relay" else 0
            )
            assert run.end_time == end


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("clapper", {"place": 1.0, "speed": 0.1, "cosine": 1.0}),
        ("clapper", {"place": -1.0, "speed": -0.1, "cosine": 1.0}),
        ("relay", {"z": 0.0, "dz": -0.5, "cosine": 1.0}),
    ],
)
def test_a_start_on_a_stop_that_moves_into_it_is_an_impact(
    name: str, start: dict[str, float]
) -> None:
    # Tables that no run has filled: the first question of this run is about the struck stop.
    problem = zo.load_problem(str(PROBLEMS / f"{name}.py"))
    execution = require_agreement(problem, 1e-3, {}, EXPLICIT, 0.0, start=start)
    assert execution is not None
    first = execution.events[0]
    assert isinstance(first, Impact)
    assert (first.time, first.approach_rate) == (0.0, -abs(start.get("speed", start.get("dz", 0))))


@pytest.mark.parametrize(("name", "until", "values"), BUNDLED)
def test_explicit_steps_give_the_same_bits(
    name: str, until: float, values: dict[str, float]
) -> None:
    run = require_agreement(zo.load_problem(name), until, values, EXPLICIT, 0.0)
    assert run is not None
    assert len(run.events) >= 10


@pytest.mark.parametrize(("name", "until", "values"), fast(3, BUNDLED))
def test_the_default_engine_gives_the_same_to_rounding(
    name: str, until: float, values: dict[str, float]
) -> None:
    settings = SimulationSettings()
    assert require_agreement(zo.load_problem(name), until, values, settings, ROUNDING) is not None


@pytest.mark.parametrize("limits", [{"releases": 3}, {"impacts": 7}], ids=str)
def test_a_run_ends_at_the_same_release_or_impact(limits: dict[str, float]) -> None:
    run = require_agreement(zo.load_problem("relay"), 0.2, {}, EXPLICIT, 0.0, limits)
    assert run is not None
    assert run.end_time < 0.2


def test_a_run_beyond_its_bounds_ends_with_the_same_error() -> None:
    settings = replace(EXPLICIT, far=0.1)
    (_, error), (_, reason) = both(zo.load_problem("clapper"), 30.0, {}, settings)
    assert type(error) is RunawayError
    assert str(error) == str(reason)


@pytest.mark.parametrize("name", REFUSED)
def test_a_motion_is_refused_by_both_in_the_same_words(name: str) -> None:
    problem, words_of_it = REFUSED[name]
    require_agreement(problem, 6.0, {}, EXPLICIT, 0.0)
    (_, error), (_, reason) = both(problem, 6.0, {}, EXPLICIT)
    assert str(error) == str(reason)
    assert words_of_it in str(error)


@pytest.mark.slow
def test_a_kink_that_changes_the_acceleration_in_every_flight_is_refused_by_both() -> None:
    problem = random_graphs.problem(random_graphs.drawn(7, 129))
    (_, error), (_, reason) = both(problem, 6.0, {}, EXPLICIT)
    assert type(error) is SimultaneousEventsError
    assert str(error) == str(reason)
    assert "the switch `kink 1` changes" in str(error)


@pytest.mark.parametrize("name", ["clapper", "kneed_walker", "limited_pendulum"])
def test_a_run_goes_on_after_every_step(name: str) -> None:
    problem = zo.load_problem(name)
    graph = problem.graph_dynamics(problem.values())
    state = np.array(problem.state_vector(problem.starts[0]))
    task = SimulationTask(dynamics=graph, state=state, until=2.0, settings=EXPLICIT)
    whole = looped(task).execution
    program = whole_program(graph.compiled)
    assert whole is not None
    assert not isinstance(program, str)
    run = LoopRun(program, filled(run_settings(task)), graph.p, state)
    fewest = 2 + 4 * len(graph.stop_names) + graph.n_declared
    status = binding.FULL
    while status == binding.FULL:
        with pytest.raises(ValueError, match=f"`events` must be at least {fewest}"):
            run.resume(events=fewest - 1)
        status = run.resume(steps=1, polynomials=1, arcs=3, events=fewest)
    assert status == binding.DONE
    record, n_x = run.record(), len(state)
    expected = [numbers(event) for event in whole.events]
    assert record.events[:, 1].tolist() == [row[0] for row in expected]
    ends = record.arcs[:, binding.ARC_WIDTH + n_x :][:, :n_x]
    assert ends.tolist() == [arc.end_state.tolist() for arc in whole.arcs]


@pytest.mark.parametrize("index", fast(3, range(8)))
def test_random_machines_give_the_same_bits(index: int) -> None:
    problem = random_graphs.problem(random_graphs.drawn(11, index))
    require_agreement(problem, 6.0, {}, EXPLICIT, 0.0)


@pytest.mark.parametrize("seed", fast(2, range(20)))
def test_machines_with_nested_kinks_give_the_same_bits(seed: int) -> None:
    machine = RandomMachine(seed=seed)
    found = require_agreement(machine.problem(), 2.0, {}, EXPLICIT, 0.0, start=machine.start)
    assert found is not None


@pytest.mark.slow
@pytest.mark.parametrize("index", fast(1, range(8)))
def test_random_machines_with_more_parts_give_the_same_bits(index: int) -> None:
    problem = random_graphs.problem(random_graphs.widened(random_graphs.drawn(12, index)))
    require_agreement(problem, 6.0, {}, EXPLICIT, 0.0)


@pytest.mark.parametrize("seed", [1, 22])
def test_impacts_on_a_stop_while_others_are_closed_give_the_same_bits(seed: int) -> None:
    require_agreement(shaken(seed), 2.0, {}, EXPLICIT, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_many_machines_with_closed_stops_give_the_same_bits(seed: int) -> None:
    require_agreement(shaken(seed), 8.0, {}, EXPLICIT, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("index", range(8, 40))
def test_many_random_machines_give_the_same_bits(index: int) -> None:
    problem = random_graphs.problem(random_graphs.drawn(11, index))
    require_agreement(problem, 6.0, {}, EXPLICIT, 0.0)
