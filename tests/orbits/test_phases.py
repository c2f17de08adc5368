"""Executions cut into phases: accumulations, plastic impacts, single impacts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.support.executions import at, execution_of
from tests.support.mechanisms import forced_oscillator, oscillator_state
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import HybridDynamics, load_problem
from zeno_orbits.orbits import (
    ONE_ZENO,
    EventSequence,
    Phase,
    PhaseKind,
    cycle_of,
    follow_each_other,
    kinds_of,
    phases_of,
    place_on_section,
)
from zeno_orbits.simulation import Execution, Mode, SimulationSettings, simulate

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
    moved = place_on_section(striker, EventSequence.parsed("impact"), off)
    assert striker.gap(moved) == pytest.approx(0.0, abs=1e-16)
    assert moved[1] == off[1]
    rested = place_on_section(oscillator, ONE_ZENO, np.array(LOCKED) + 1e-9)
    assert oscillator.gap_rate(rested) == pytest.approx(0.0, abs=1e-16)


def test_a_period_of_another_shape_is_refused(
    striker: HybridDynamics, oscillator: HybridDynamics
) -> None:
    settings = SimulationSettings()
    cycle = cycle_of(
        striker, _strike(), EventSequence.parsed("impact*2"), horizon=20.0, settings=settings
    )
    assert cycle.end.time == pytest.approx(2 * TURN, rel=1e-9)
    with pytest.raises(SimulationError, match="shape of the motion is not `zeno`"):
        cycle_of(striker, _strike(), ONE_ZENO, horizon=20.0, settings=settings)
    # Too short a time for two.
    twice = EventSequence.parsed("zeno*2")
    start = np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))
    with pytest.raises(SimulationError, match="shape of the motion is not `zeno\\*2`: zeno"):
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


# Executions made by hand: which arcs and events belong to which phase.

START = at(0.0, 1.0)
ONCE = (("i", 1.0), ("i", 1.5), ("z", 2.0), ("r", 3.0))


def _spans(phases: tuple[Phase, ...]) -> list[tuple[str, float, float]]:
    """Return kind, start and end of each phase."""
    return [(phase.kind.value, phase.start.time, phase.end.time) for phase in phases]


def _later(legs: tuple[tuple[str, float], ...], time: float) -> tuple[tuple[str, float], ...]:
    return tuple((letter, end + time) for letter, end in legs)


def test_every_part_of_a_phase_is_where_it_belongs() -> None:
    run = execution_of(*ONCE, ("i", 4.0), ("z", 5.0), ("r", 6.0), ("f", 7.0))
    first, second = phases_of(run, START)
    arcs, zenos = run.arcs, run.zeno_points
    assert (first.kind, second.kind) == (PhaseKind.ZENO, PhaseKind.ZENO)
    assert (first.start.time, first.start.state.tolist()) == (0.0, [0.0, 1.0])
    assert (first.flight, first.rescaled_flights) == (arcs[0], (arcs[1],))
    assert first.impacts == run.impacts[:2]
    assert (first.zeno, first.locked) == (zenos[0], arcs[3])
    assert (first.end.time, first.end.state.tolist()) == (3.0, [3.0, 0.0])
    assert first.arcs == (arcs[0], arcs[1], arcs[3])
    assert second.start is first.end
    assert (second.flight, second.rescaled_flights) == (arcs[4], ())
    assert second.impacts == run.impacts[2:]
    assert (second.zeno, second.locked, second.end.time) == (zenos[1], arcs[6], 6.0)
    assert _spans(phases_of(run)) == [("zeno", 3.0, 6.0)]


def test_an_execution_that_ends_locked_has_no_further_phase() -> None:
    run = execution_of(*ONCE, ("i", 4.0), ("z", 5.0), ("l", 9.0))
    assert _spans(phases_of(run, START)) == [("zeno", 0.0, 3.0)]
    assert phases_of(execution_of(("l", 9.0)), START) == ()


@pytest.mark.parametrize(
    "middle",
    [
        # A touch that is no impact, no Zeno point, two of them, no flight at all.
        (("t", 4.0), ("i", 4.5), ("z", 5.0), ("r", 6.0)),
        (("i", 4.0), ("r", 6.0)),
        (("i", 4.0), ("z", 4.5), ("i", 4.75), ("z", 5.0), ("r", 6.0)),
        (("r", 6.0),),
    ],
)
def test_a_return_that_is_no_phase_is_left_out_and_the_next_one_is_whole(
    middle: tuple[tuple[str, float], ...],
) -> None:
    phases = phases_of(execution_of(*ONCE, *middle, *_later(ONCE, 6.0)), START)
    assert _spans(phases) == [("zeno", 0.0, 3.0), ("zeno", 6.0, 9.0)]
    assert not follow_each_other(phases)
    assert follow_each_other(phases[:1])


def test_chatter_that_ends_at_the_release_itself_belongs_to_the_phase_before() -> None:
    run = execution_of(("i", 1.0), ("z", 2.0), ("r", 2.0), ("i", 3.0), ("z", 4.0), ("r", 5.0))
    assert _spans(phases_of(run, START)) == [("zeno", 0.0, 2.0), ("zeno", 2.0, 5.0)]


@pytest.mark.parametrize(("moment", "begins"), [(1e-7, 0.0), (2e-6, 0.0), (2.1e-6, 2.1e-6)])
def test_a_start_locked_for_a_millionth_of_the_execution_is_released_at_once(
    moment: float, begins: float
) -> None:
    run = execution_of(("r", moment), ("i", 0.25), ("z", 0.5), ("r", 0.75), ("f", 2.0))
    assert _spans(phases_of(run, START)) == [("zeno", begins, 0.75)]
    # Without its start the first release is the start.
    found = phases_of(run)
    assert [phase.start.time for phase in found] == ([] if begins == 0.0 else [begins])


def test_a_phase_that_is_short_beside_the_execution_is_one() -> None:
    short = (("i", 1e-7), ("z", 2e-7), ("r", 3e-7))
    run = execution_of(*short, ("i", 0.5), ("z", 0.75), ("r", 1.0))
    assert _spans(phases_of(run, START)) == [("zeno", 0.0, 3e-7), ("zeno", 3e-7, 1.0)]


def test_falls_on_a_plastic_stop_are_phases_of_their_own_until_it_holds() -> None:
    run = execution_of(("i", 1.0), ("i", 2.0), ("p", 3.0), ("r", 4.0), ("p", 5.0), ("r", 6.0))
    phases = phases_of(run, START)
    assert _spans(phases) == [
        ("impact", 0.0, 1.0),
        ("impact", 1.0, 2.0),
        ("plastic", 2.0, 4.0),
        ("plastic", 4.0, 6.0),
    ]
    arcs, impacts = run.arcs, run.impacts
    assert [phase.flights for phase in phases] == [(arcs[k],) for k in (0, 1, 2, 4)]
    assert [phase.impacts for phase in phases] == [(impact,) for impact in impacts]
    assert [phase.locked for phase in phases] == [None, None, arcs[3], arcs[5]]
    assert [phase.zeno for phase in phases] == [None, None, *run.zeno_points]
    assert phases[0].arcs == (arcs[0],)
    assert phases[1].start.state.tolist() == phases[0].end.state.tolist() == [1.0, 1.0]


@pytest.mark.parametrize(("tail", "speed"), [(0.0, 0.1), (0.1, 0.0)])
def test_an_accumulation_that_is_cut_at_an_impact_is_no_plastic_one(
    tail: float, speed: float
) -> None:
    run = execution_of(("i", 1.0), ("p", 3.0), ("r", 4.0))
    zeno = replace(run.zeno_points[0], tail=tail, last_speed=speed)
    events = tuple(zeno if event is run.zeno_points[0] else event for event in run.events)
    (phase,) = phases_of(replace(run, events=events), START)
    assert phase.kind is PhaseKind.ZENO
    assert len(phase.impacts) == 2


def test_impacts_end_phases_of_their_own_up_to_the_first_arc_that_holds() -> None:
    run = execution_of(("i", 1.0), ("i", 2.5), ("z", 3.0), ("r", 4.0), ("i", 5.0))
    phases = phases_of(run, START, held=False)
    assert _spans(phases) == [("impact", 0.0, 1.0), ("impact", 1.0, 2.5)]
    assert [phase.flights for phase in phases] == [(run.arcs[0],), (run.arcs[1],)]
    assert phases[1].start.state.tolist() == [1.0, 1.0]
    at_once = execution_of(("p", 1.0), ("r", 1.0), ("i", 2.0))
    assert _spans(phases_of(at_once, START, held=False)) == [("impact", 0.0, 1.0)]


def test_a_touch_between_impacts_leaves_out_its_phase_and_the_one_after() -> None:
    run: Execution = execution_of(("r", 0.5), ("i", 1.0), ("t", 2.0), ("i", 3.0), ("i", 4.0))
    phases = phases_of(run, START, held=False)
    assert _spans(phases) == [("impact", 0.0, 1.0), ("impact", 3.0, 4.0)]
    assert not follow_each_other(phases)
    touched = execution_of(("t", 1.0), ("r", 1.5), ("i", 2.0), ("i", 3.0))
    assert phases_of(touched, START, held=False) == ()
