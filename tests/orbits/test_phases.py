"""Executions cut into phases: accumulations, plastic impacts, single impacts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.support.mechanisms import forced_oscillator, oscillator_state
from zeno_orbits.errors import SimulationError
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.orbits.period import cycle_of, placed
from zeno_orbits.orbits.phases import follow_each_other, kinds_of, phases_of
from zeno_orbits.orbits.shape import ONE_ZENO, OrbitShape, PhaseKind
from zeno_orbits.simulation.execution import Mode
from zeno_orbits.simulation.simulator import SimulationSettings, simulate

TURN = 2 * math.pi
LOCKED = oscillator_state(0.0, FORCED.stop, 0.0)
STRIKING = {"distance": 0.0, "speed": 1.3565863500759056, "cosine": 0.9971170206482185}


@pytest.fixture(name="oscillator", scope="module")
def _oscillator() -> HybridDynamics:
    return forced_oscillator(FORCED, FORCED.restitution)


@pytest.fixture(name="striker", scope="module")
def _striker() -> HybridDynamics:
    problem = load_problem("impact_oscillator")
    return problem.dynamics(problem.values())


def _strike() -> np.ndarray:
    sine = math.sqrt(1 - STRIKING["cosine"] ** 2)
    return np.array([0.0, STRIKING["speed"], STRIKING["cosine"], sine])


def _table(amplitude: float) -> HybridDynamics:
    problem = load_problem("vibrating_table")
    values = problem.values(parameters={"A": amplitude, "restitution": 0.0})
    return problem.dynamics(values)


def test_an_accumulation_and_what_follows_it_are_one_phase(oscillator: HybridDynamics) -> None:
    phases = phases_of(simulate(oscillator, LOCKED, until=3.5 * TURN))
    assert kinds_of(phases) == 3 * (PhaseKind.ZENO,)
    assert follow_each_other(phases)
    for phase in phases:
        assert len(phase.flights) == len(phase.impacts)
        assert phase.locked is not None
        assert phase.arcs == (*phase.flights, phase.locked)
        assert phase.zeno is not None
        assert phase.impacts[-1].time < phase.zeno.time < phase.end.time


def test_whatever_falls_on_a_plastic_stop_stays_or_is_let_go() -> None:
    # As the closed form of test_shapes has it: stays and is thrown at once, in turns.
    run = simulate(_table(0.048), (0.0, 0.0, 1.0, 0.0), until=3.0)
    kinds = kinds_of(phases_of(run)[-4:])
    assert set(zip(kinds[::2], kinds[1::2], strict=True)) == {(PhaseKind.IMPACT, PhaseKind.PLASTIC)}
    assert follow_each_other(phases_of(run))


def test_every_impact_is_a_phase_while_the_stop_does_not_hold(striker: HybridDynamics) -> None:
    run = simulate(striker, _strike(), until=3.5 * TURN)
    phases = phases_of(run, _strike(), held=False)
    assert kinds_of(phases) == 3 * (PhaseKind.IMPACT,)
    assert phases[0].start.time == 0.0
    assert follow_each_other(phases)
    # Without its start the first impact is where the first phase begins.
    assert len(phases_of(run, held=False)) == 2
    assert phases_of(run) == ()


def test_an_execution_ends_just_after_the_impacts_that_were_asked_for(
    striker: HybridDynamics,
) -> None:
    run = simulate(striker, _strike(), until=100.0, impacts=2)
    assert len(run.impacts) == 2
    assert run.end_time == run.impacts[-1].time == pytest.approx(2 * TURN, rel=1e-9)
    # One that begins with an impact has still to fly.
    falling = _strike() * np.array([1.0, -1.0, 1.0, 1.0])
    assert len(simulate(striker, falling, until=100.0, impacts=1).arcs) == 1


def test_a_start_after_an_impact_keeps_its_speed_and_loses_its_gap(
    striker: HybridDynamics, oscillator: HybridDynamics
) -> None:
    off = _strike() + np.array([1e-9, 0.0, 0.0, 0.0])
    moved = placed(striker, OrbitShape.parsed("impact"), off)
    assert striker.gap(moved) == pytest.approx(0.0, abs=1e-16)
    assert moved[1] == off[1]
    rested = placed(oscillator, ONE_ZENO, np.array(LOCKED) + 1e-9)
    assert oscillator.gap_rate(rested) == pytest.approx(0.0, abs=1e-16)


def test_a_period_of_another_shape_is_refused(
    striker: HybridDynamics, oscillator: HybridDynamics
) -> None:
    settings = SimulationSettings()
    cycle = cycle_of(
        striker, _strike(), OrbitShape.parsed("impact*2"), horizon=20.0, settings=settings
    )
    assert cycle.end.time == pytest.approx(2 * TURN, rel=1e-9)
    with pytest.raises(SimulationError, match="another shape than `zeno`"):
        cycle_of(striker, _strike(), ONE_ZENO, horizon=20.0, settings=settings)
    # Too short a time for two.
    twice = OrbitShape.parsed("zeno*2")
    start = np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))
    with pytest.raises(SimulationError, match="another shape than `zeno\\*2`: zeno"):
        cycle_of(oscillator, start, twice, horizon=8.0, settings=settings)


def test_a_locked_start_is_released_before_its_first_phase(oscillator: HybridDynamics) -> None:
    start = np.array(LOCKED)
    cycle = cycle_of(oscillator, start, ONE_ZENO, horizon=20.0, settings=SimulationSettings())
    assert cycle.execution.arcs[0].mode is Mode.LOCKED
    assert cycle.start.time == pytest.approx(FORCED.release_time, abs=1e-11)


def test_a_start_that_the_stop_holds_for_a_moment_is_no_end_of_the_impacts() -> None:
    table = load_problem("vibrating_table")
    start = np.array([0.0, 0.0, 1.0, 0.0])
    run = simulate(table.dynamics(table.values()), start, until=0.15)
    assert run.arcs[0].mode is Mode.LOCKED
    phases = phases_of(run, start, held=False)
    assert [phase.kind for phase in phases] == [PhaseKind.IMPACT] * len(run.impacts)
    assert phases[0].start.time == 0.0
    assert [phase.impacts for phase in phases] == [(impact,) for impact in run.impacts]


def test_a_start_that_rounding_has_locked_is_where_the_first_phase_starts() -> None:
    table = load_problem("vibrating_table")
    values = table.values().parameters
    early = math.asin(values["g"] / (values["A"] * values["omega"] ** 2)) - 1e-7
    start = np.array([0.0, 0.0, math.cos(early), math.sin(early)])
    run = simulate(table.dynamics(table.values()), start, until=0.3)
    assert run.releases[0].time == pytest.approx(1e-7 / values["omega"], rel=1e-4)
    first = phases_of(run, start)[0]
    assert (first.start.time, first.start.state.tolist()) == (0.0, start.tolist())
