"""What an execution makes of a start or an impact, at and on both sides of each limit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.support.families import BALL, CIRCLE
from tests.support.mechanisms import fading_ball, forced_oscillator, oscillator_state
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ChatterError, InputError, RunawayError
from zeno_orbits.model import CharacteristicScales, HybridDynamics, load_problem
from zeno_orbits.simulation import (
    Ending,
    Execution,
    FixedImpacts,
    Mode,
    SimulationSettings,
    Truncation,
    ZenoPassage,
    simulate,
)

G = 9.81


def _ball(e: float = 0.5, **own: Any) -> HybridDynamics:
    ball = BALL.at(m=1.0, g=G, c=0.0, e=e)
    return replace(ball, scaling=lambda: CharacteristicScales(**own)) if own else ball


def _begun(dynamics: HybridDynamics, state: Any, **chosen: Any) -> Execution:
    """Return the first nanosecond of an execution."""
    return simulate(dynamics, state, until=1e-9, settings=SimulationSettings(**chosen))


# Starts.


@pytest.mark.parametrize(
    ("gap", "rate", "mode", "speed"),
    [
        (0.25, 0.0, Mode.LOCKED, None),
        (-0.25, 0.0, Mode.LOCKED, None),
        (0.26, 0.0, Mode.FREE, None),
        (0.0, 0.25, Mode.LOCKED, None),
        (0.0, -0.25, Mode.LOCKED, None),
        (0.0, 0.26, Mode.FREE, 0.26),
        # An impact, and half of the rate.
        (0.0, -0.6, Mode.FREE, 0.3),
    ],
)
def test_a_start_rests_within_what_counts_as_zero_and_else_flies_or_impacts(
    gap: float, rate: float, mode: Mode, speed: float | None
) -> None:
    run = _begun(_ball(), (gap, rate), contact=0.25)
    first = run.arcs[0]
    assert (first.mode, first.start_time) == (mode, 0.0)
    assert len(run.impacts) == (1 if rate < -0.5 else 0)
    if mode is Mode.LOCKED:
        assert first.start_state.tolist() == [0.0, 0.0]
    else:
        flies = [gap, rate if speed is None else speed]
        # One multiplication by the restitution is rounded.
        assert first.start_state == pytest.approx(flies, rel=1e-15)


def test_a_gap_below_zero_by_more_than_that_is_refused() -> None:
    with pytest.raises(InputError, match=r"gap >= 0, but it is -0\.26"):
        _begun(_ball(), (-0.26, 0.0), contact=0.25)


@pytest.mark.parametrize(("part", "mode"), [(0.9, Mode.LOCKED), (1.1, Mode.FREE)])
def test_what_counts_as_zero_is_a_part_of_the_sizes_of_the_problem(part: float, mode: Mode) -> None:
    dynamics = _ball(gap=1e3, gap_rate=1e-3)
    for state in ((part * 1e-12 * 1e3, 0.0), (0.0, part * 1e-12 * 1e-3)):
        assert _begun(dynamics, state).arcs[0].mode is mode


def test_all_numbers_of_a_state_must_be_finite() -> None:
    for state in ((math.nan, math.nan), (1.0, math.nan), (math.inf, 1.0)):
        with pytest.raises(InputError, match="finite"):
            _begun(_ball(), state)


def _on_circle(radius: float, outward: float = 0.0) -> Vector:
    """Return a state on a circle of some radius, and with a velocity off it."""
    return radius * np.array([0.6, 0.8, 0.0, 0.0]) + outward * np.array([0.0, 0.0, 0.6, 0.8])


@pytest.mark.parametrize("sizes", [(), (1.0, 1.0, 1e-3, 1.0)])
def test_a_state_off_its_constraint_by_a_billionth_is_refused(sizes: tuple[float, ...]) -> None:
    # The constraint x^2 + y^2 = l^2 changes by 2 (x^2 + y^2) where x and y do by their sizes, which
    # are 1 at least: by 2 (0.6 + 0.8) here. That of the velocities is x dx + y dy, twice.
    circle = replace(
        CIRCLE.at(m=1.0, l=1.0, g=G, e=0.5), scaling=lambda: CharacteristicScales(sizes=sizes)
    )
    least = np.ones(4)
    least[: len(sizes)] = sizes
    by_place = 2 * (0.6 * 1.0 + 0.8 * 1.0)
    by_velocity = 2 * (0.6 * least[2] + 0.8 * least[3])
    for sign in (-1.0, 1.0):
        for part, refused in ((0.9e-9, False), (1.1e-9, True)):
            for state in (
                _on_circle(1.0 + sign * part * by_place / 2),
                _on_circle(1.0, sign * part * by_velocity / 2),
            ):
                if refused:
                    with pytest.raises(InputError, match="constraints, but it is off by"):
                        _begun(circle, state)
                else:
                    assert _begun(circle, state).arcs


@pytest.mark.parametrize(("sizes", "refused"), [((), False), ((1.0, 1.0, 1.0, 0.5), True)])
def test_a_small_constraint_of_usual_numbers_may_be_off_by_a_billionth_of_one(
    sizes: tuple[float, ...], refused: bool
) -> None:
    # On a circle of a hundredth the constraint changes by no more than 0.028.
    radius = 0.01
    circle = replace(
        CIRCLE.at(m=1.0, l=radius, g=G, e=0.5), scaling=lambda: CharacteristicScales(sizes=sizes)
    )
    state = _on_circle(radius + 0.9e-9 / (2 * radius))
    if refused:
        with pytest.raises(InputError, match="off by 9e-10"):
            _begun(circle, state)
    else:
        assert _begun(circle, state).arcs


def test_a_clock_off_its_circle_is_named_and_another_constraint_is_not_called_a_clock() -> None:
    problem = load_problem("forced_oscillator")
    dynamics = problem.dynamics(problem.values())
    names = problem.state_names
    first, second = (names[k] for k in dynamics.clock)
    x = np.array(problem.state_vector(problem.starts[0]))
    x[list(dynamics.clock)] = 0.5, 0.25
    with pytest.raises(InputError) as caught:
        _begun(dynamics, x)
    told = str(caught.value)
    assert f"`{first}` and `{second}` on the unit circle" in told
    assert "they are 0.5 and 0.25" in told
    assert told.endswith(f"add {first}=1 for the start of a turn.")


# Impacts.


def test_a_plastic_impact_is_its_own_zeno_point_without_an_error() -> None:
    run = simulate(_ball(0.0), (1.0, 0.0), until=1.0)
    (zeno,) = run.zeno_points
    assert zeno.limit_error == 0.0
    assert zeno.tail == 0.0
    assert zeno.last_speed == 0.0
    assert zeno.time == run.impacts[0].time
    assert [(arc.ending, arc.impact_index) for arc in run.arcs] == [
        (Ending.IMPACT, 0),
        (Ending.HORIZON, 1),
    ]


def test_an_execution_stops_after_so_many_impacts_that_end_flights() -> None:
    fallen = simulate(_ball(), (1.0, 0.0), until=5.0, impacts=2)
    assert [arc.ending for arc in fallen.arcs] == [Ending.IMPACT, Ending.IMPACT]
    assert [arc.impact_index for arc in fallen.arcs] == [0, 1]
    assert len(fallen.impacts) == 2
    # The impact that an execution starts with ends no flight.
    for count in (1, 2):
        struck = simulate(_ball(), (0.0, -2.0), until=5.0, impacts=count)
        assert len(struck.arcs) == count
        assert len(struck.impacts) == count + 1


def test_what_came_before_an_error_is_on_the_error() -> None:
    settings = SimulationSettings(most_impacts=3)
    with pytest.raises(ChatterError) as caught:
        simulate(_ball(0.9), (1.0, 0.0), until=40.0, settings=settings)
    before = caught.value.execution
    assert isinstance(before, Execution)
    # More than three after the first.
    assert len(before.impacts) == 5
    assert caught.value.time == before.end_time
    with pytest.raises(RunawayError) as early:
        simulate(_ball(), (1.0, 9.0), until=1.0, settings=SimulationSettings(far=1.5))
    assert early.value.execution is None


def test_impacts_are_counted_in_each_sequence_by_itself() -> None:
    settings = SimulationSettings(completion=FixedImpacts(n_impacts=5), most_impacts=5)
    start = oscillator_state(0.0, FORCED.stop, 0.0)
    dynamics = forced_oscillator(FORCED, FORCED.restitution)
    run = simulate(dynamics, start, until=20.0, releases=3, settings=settings)
    assert len(run.impacts) == 10


def test_progress_begins_at_nothing_where_an_execution_begins_at_its_zeno_point() -> None:
    told: list[tuple[str, float | None]] = []
    settings = SimulationSettings(completion=Truncation(delta=0.1))
    run = simulate(
        _ball(),
        (0.0, -0.01),
        until=4.0,
        settings=settings,
        on_progress=lambda what, part: told.append((what, part)),
    )
    assert told == [("simulating", 0.0), ("simulating, 4 of 4 s", 1.0)]
    assert [arc.mode for arc in run.arcs] == [Mode.LOCKED]
    assert run.zeno_points[0].time == 0.0


# The Zeno point of a sequence.


def test_the_tail_of_a_curve_that_was_followed_is_the_curve() -> None:
    speed = 0.7 * (1 - 0.99) * 10.0 / 2
    rule = SimulationSettings(completion=ZenoPassage())
    run = simulate(fading_ball(10.0, 0.0, 0.99), (0.0, 0.3, speed, 1.0), until=2.0, settings=rule)
    (tail,) = (arc for arc in run.arcs if arc.ending is Ending.ZENO)
    (zeno,) = run.zeno_points
    assert zeno.time == pytest.approx(0.7, abs=1e-10)
    assert tail.trajectory is not None
    assert tail.time_unit == 1.0
    assert tail.duration == zeno.time - tail.start_time
    # The clock of the states on the stop is the time.
    for part in (0.25, 0.5, 0.9):
        time = tail.start_time + part * tail.duration
        assert tail.state_at(time) == pytest.approx([0.0, 0.3 + time, 0.0, 1.0], abs=1e-10)


# On the stop.


def test_the_mode_on_the_stop_is_told_by_the_acceleration_or_by_the_rate_where_that_is_zero() -> (
    None
):
    # The weight of 10 is gone at the clock 2.
    dynamics = fading_ball(10.0, 5.0, 0.5)
    for clock, rate, mode in (
        (1.0, 1.0, Mode.LOCKED),
        (3.0, 1.0, Mode.FREE),
        # At no weight it depends on whether the weight comes or goes.
        (2.0, 1.0, Mode.FREE),
        (2.0, -1.0, Mode.LOCKED),
    ):
        assert _begun(dynamics, (0.0, clock, 0.0, rate)).arcs[0].mode is mode
