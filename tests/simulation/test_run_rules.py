"""What an execution makes of a start, an event or an impact, at and on both sides of each limit."""

# pyright: reportPrivateUsage=false

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
from zeno_orbits.errors import ChatterError, InputError, RunawayError, SimulationError
from zeno_orbits.integrators import RungeKutta
from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.scale import OwnScale
from zeno_orbits.simulation import reference_run
from zeno_orbits.simulation.arc_follower import ArcFollower, ArcStart
from zeno_orbits.simulation.completion import (
    FixedImpacts,
    Truncation,
    ZenoPassage,
)
from zeno_orbits.simulation.execution import Ending, Execution, Mode
from zeno_orbits.simulation.reference_run import ReferenceRun as _Run
from zeno_orbits.simulation.simulator import SimulationSettings, simulate
from zeno_orbits.simulation.zeno_limit import TailEstimate, ZenoLimit

G = 9.81


def _ball(e: float = 0.5, **own: Any) -> HybridDynamics:
    ball = BALL.at(m=1.0, g=G, c=0.0, e=e)
    return replace(ball, scaling=lambda: OwnScale(**own)) if own else ball


def _run(dynamics: HybridDynamics, **chosen: Any) -> _Run:
    settings = SimulationSettings(**chosen)
    follower = ArcFollower(
        dynamics=dynamics,
        engine=RungeKutta(),
        tolerance=Tolerance(),
        until=10.0,
        contact=settings.contact,
        far=math.inf,
        most_steps=1000,
    )
    return _Run(
        dynamics=dynamics,
        settings=settings,
        follower=follower,
        most_releases=math.inf,
        most_impacts=math.inf,
    )


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
    run = _run(_ball(), contact=0.25)
    start = run.admitted(np.array([gap, rate]))
    assert start is not None
    assert start.mode is mode
    assert start.time == 0.0
    assert start.speed == speed
    assert run.n_impacts == (1 if rate < -0.5 else 0)
    if mode is Mode.LOCKED:
        assert start.state.tolist() == [0.0, 0.0]
    elif rate >= 0.0:
        assert start.state.tolist() == [gap, rate]


def test_a_gap_below_zero_by_more_than_that_is_refused() -> None:
    with pytest.raises(InputError, match=r"gap >= 0, but it is -0\.26"):
        _run(_ball(), contact=0.25).admitted(np.array([-0.26, 0.0]))


@pytest.mark.parametrize(("part", "mode"), [(0.9, Mode.LOCKED), (1.1, Mode.FREE)])
def test_what_counts_as_zero_is_a_part_of_the_sizes_of_the_problem(part: float, mode: Mode) -> None:
    dynamics = _ball(gap=1e3, gap_rate=1e-3)
    for state in ((part * 1e-12 * 1e3, 0.0), (0.0, part * 1e-12 * 1e-3)):
        start = _run(dynamics).admitted(np.array(state))
        assert start is not None
        assert start.mode is mode


def test_all_numbers_of_a_state_must_be_finite() -> None:
    for state in ((math.nan, math.nan), (1.0, math.nan), (math.inf, 1.0)):
        with pytest.raises(InputError, match="finite"):
            _run(_ball()).admitted(np.array(state))


def _on_circle(radius: float, outward: float = 0.0) -> Vector:
    """Return a state on a circle of some radius, and with a velocity off it."""
    return radius * np.array([0.6, 0.8, 0.0, 0.0]) + outward * np.array([0.0, 0.0, 0.6, 0.8])


@pytest.mark.parametrize("sizes", [(), (1.0, 1.0, 1e-3, 1.0)])
def test_a_state_off_its_constraint_by_a_billionth_is_refused(sizes: tuple[float, ...]) -> None:
    # The constraint x^2 + y^2 = l^2 changes by 2 (x^2 + y^2) where x and y do by their sizes, which
    # are 1 at least: by 2 (0.6 + 0.8) here. That of the velocities is x dx + y dy, twice.
    circle = replace(CIRCLE.at(m=1.0, l=1.0, g=G, e=0.5), scaling=lambda: OwnScale(sizes=sizes))
    least = np.ones(4)
    least[: len(sizes)] = sizes
    by_place = 2 * (0.6 * 1.0 + 0.8 * 1.0)
    by_velocity = 2 * (0.6 * least[2] + 0.8 * least[3])
    run = _run(circle)
    for sign in (-1.0, 1.0):
        for part, refused in ((0.9e-9, False), (1.1e-9, True)):
            for state in (
                _on_circle(1.0 + sign * part * by_place / 2),
                _on_circle(1.0, sign * part * by_velocity / 2),
            ):
                if refused:
                    with pytest.raises(InputError, match="constraints, but it is off by"):
                        run.admitted(state)
                else:
                    assert run.admitted(state) is not None


@pytest.mark.parametrize(("sizes", "refused"), [((), False), ((1.0, 1.0, 1.0, 0.5), True)])
def test_a_small_constraint_of_usual_numbers_may_be_off_by_a_billionth_of_one(
    sizes: tuple[float, ...], refused: bool
) -> None:
    # On a circle of a hundredth the constraint changes by no more than 0.028.
    radius = 0.01
    circle = replace(CIRCLE.at(m=1.0, l=radius, g=G, e=0.5), scaling=lambda: OwnScale(sizes=sizes))
    state = _on_circle(radius + 0.9e-9 / (2 * radius))
    run = _run(circle)
    if refused:
        with pytest.raises(InputError, match="off by 9e-10"):
            run.admitted(state)
    else:
        assert run.admitted(state) is not None


def test_a_clock_off_its_circle_is_named_and_another_constraint_is_not_called_a_clock() -> None:
    problem = load_problem("forced_oscillator")
    dynamics = problem.dynamics(problem.values())
    names = problem.state_names
    first, second = (names[k] for k in dynamics.clock)
    x = np.array(problem.state_vector(problem.starts[0]))
    x[list(dynamics.clock)] = 0.5, 0.25
    with pytest.raises(InputError) as caught:
        _run(dynamics).admitted(x)
    told = str(caught.value)
    assert f"`{first}` and `{second}` on the unit circle" in told
    assert "they are 0.5 and 0.25" in told
    assert told.endswith(f"starts with {first}=1.")


# Impacts and landings.


def test_only_a_gap_that_closes_is_an_impact() -> None:
    run = _run(_ball())
    for rate in (0.0, 0.5):
        with pytest.raises(SimulationError, match=f"gap rate is {rate:.3g}") as caught:
            run.impact(2.0, np.array([0.0, rate]), rate)
        assert caught.value.time == 2.0
        assert caught.value.state == (0.0, rate)
    assert run.events == []


@pytest.mark.parametrize("rate", [1e-3, 2.0])
def test_a_gap_that_opens_again_where_a_flight_ends_flies_on(rate: float) -> None:
    run = _run(_ball())
    state = np.array([0.0, rate])
    start = run.landing(2.0, state, rate)
    assert start is not None
    assert (start.mode, start.time, start.speed) == (Mode.FREE, 2.0, rate)
    assert start.state is state
    assert run.events == []
    struck = run.landing(2.0, np.array([0.0, -rate]), -rate)
    assert struck is not None
    assert struck.speed == rate / 2
    assert len(run.events) == 1


@pytest.mark.parametrize(("rate", "asked"), [(-0.5, True), (-0.51, False)])
def test_an_impact_that_leaves_no_more_than_rounding_asks_whether_the_stop_holds(
    monkeypatch: pytest.MonkeyPatch, rate: float, asked: bool
) -> None:
    modes: list[Mode] = []
    usual = _Run.on_stop

    def on_stop(self: _Run, time: float, x: Vector) -> ArcStart:
        start = usual(self, time, x)
        modes.append(start.mode)
        return start

    monkeypatch.setattr(_Run, "on_stop", on_stop)
    run = _run(_ball(), contact=0.25)
    start = run.impact(2.0, np.array([0.0, rate]), rate)
    assert modes == ([Mode.LOCKED] if asked else [])
    # It holds, and the speed is not zero: the limit of its bounces is still to come.
    assert start is not None
    assert (start.mode, start.speed) == (Mode.FREE, -rate / 2)
    assert start.resting is not None
    assert start.impact is run.events[0]


def test_a_stop_that_lets_go_of_a_slow_impact_releases_it_without_a_speed() -> None:
    # The weight of 10 is gone at the clock 2.
    run = _run(fading_ball(10.0, 5.0, 0.5), contact=0.25)
    start = run.impact(2.0, np.array([0.0, 3.0, -0.5, 1.0]), -0.5)
    assert start is not None
    assert (start.mode, start.speed, start.impact) == (Mode.FREE, None, None)
    assert start.state.tolist() == [0.0, 3.0, 0.0, 1.0]


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
    assert told == [("simulating", 0.0), ("simulating", 1.0)]
    assert [arc.mode for arc in run.arcs] == [Mode.LOCKED]
    assert run.zeno_points[0].time == 0.0


# The Zeno point of a sequence.


def _after_impact(run: _Run, speed: float, time: float = 2.0, clock: float = 0.0) -> ArcStart:
    before = np.array([0.0, clock, -speed / run.dynamics.restitution, 1.0])
    start = run.impact(time, before, -speed / run.dynamics.restitution)
    assert start is not None
    return start


def _told(run: _Run, start: ArcStart, estimates: list[TailEstimate]) -> ArcStart | None:
    assert start.speed is not None
    return run._zeno_point(start, start.speed, estimates)


def test_a_sequence_begins_anew_where_its_speed_does_not_fall_or_the_stop_repels() -> None:
    # The weight of 10 is gone at the clock 2.
    run = _run(fading_ball(10.0, 5.0, 0.5), completion=FixedImpacts(n_impacts=10))
    estimates: list[TailEstimate] = []
    for speed, left in ((0.5, 1), (0.4, 2), (0.3, 3), (0.3, 1), (0.2, 2), (0.35, 1)):
        assert _told(run, _after_impact(run, speed), estimates) is None
        assert [len(estimates), estimates[-1].speed] == [left, speed]
    assert _told(run, _after_impact(run, 0.1, clock=3.0), estimates) is None
    assert estimates == []
    # A start that does not come from an impact tells nothing.
    launched = ArcStart(mode=Mode.FREE, time=0.0, state=np.zeros(4), speed=0.1)
    assert _told(run, launched, estimates) is None
    assert estimates == []


class _Known:
    """A completion that knows the limit."""

    def __init__(self, limit: ZenoLimit) -> None:
        self.known = limit

    def limit(self, *_given: object) -> ZenoLimit:
        return self.known


@pytest.mark.parametrize(
    ("time", "clock", "reached"),
    [
        (2.5, 0.5, True),
        # The end of the simulation, and a clock at which the stop lets go.
        (math.nextafter(10.0, 0.0), 0.5, True),
        (10.0, 0.5, False),
        (2.5, 3.0, False),
    ],
)
def test_a_zeno_point_is_reached_before_the_end_and_where_the_stop_holds(
    time: float, clock: float, reached: bool
) -> None:
    point = np.array([0.0, clock, 0.0, 1.0])
    limit = ZenoLimit(time=time, state=point, error=0.125)
    run = _run(fading_ball(10.0, 5.0, 0.5), completion=_Known(limit))
    start = _after_impact(run, 0.4)
    found = _told(run, start, [])
    if not reached:
        assert found is None
        assert run.arcs == []
        assert len(run.events) == 1
        return
    assert found is not None
    assert (found.mode, found.time, found.speed) == (Mode.LOCKED, time, None)
    execution = run.execution()
    (zeno,), (tail,) = execution.zeno_points, execution.arcs
    assert (zeno.time, zeno.limit_error, zeno.last_speed) == (time, 0.125, 0.4)
    assert zeno.tail == time - 2.0
    assert (tail.mode, tail.ending, tail.impact_index) == (Mode.FREE, Ending.ZENO, 1)
    assert (tail.start_time, tail.end_time) == (2.0, time)
    assert tail.duration == time - 2.0
    assert tail.start_state.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert tail.end_state is point
    assert tail.trajectory is None


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


# What neither holds nor repels.


@pytest.mark.parametrize(
    ("lift", "slack"), [(0.25, True), (-0.25, True), (0.26, False), (-0.26, False), (0.0, True)]
)
def test_an_acceleration_within_rounding_of_zero_neither_holds_nor_repels(
    lift: float, slack: bool
) -> None:
    x = np.array([0.0, 0.0])
    assert _run(_ball(), contact=0.25)._is_slack(x, lift) is slack
    large = _run(_ball(gap_acceleration=1e3), contact=0.25)
    assert large._is_slack(x, 1e3 * lift) is slack


def test_a_lift_asks_by_how_much_the_gap_opens_among_coordinates_as_large(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[float, ...]] = []

    def closes_at_once(*given: float) -> bool:
        asked.append(given)
        return True

    monkeypatch.setattr(reference_run, "closes_at_once", closes_at_once)
    dynamics = fading_ball(10.0, 5.0, 0.5)
    run = _run(dynamics)
    x = np.array([0.5, -7.0, 9.0, 11.0])
    for lift in (1e-9, 0.5, 3.0):
        assert run._is_slack(x, lift)
    assert not run._is_slack(x, -0.5)
    inertia, rate = dynamics.normal_inertia(x), dynamics.multiplier_rate(x)
    assert asked == [(lift, rate, inertia, 7.0) for lift in (1e-9, 0.5, 3.0)]


def test_the_mode_on_the_stop_is_told_by_the_acceleration_or_by_the_rate_where_that_is_zero() -> (
    None
):
    dynamics = fading_ball(10.0, 5.0, 0.5)
    run = _run(dynamics)
    for clock, rate, mode in (
        (1.0, 1.0, Mode.LOCKED),
        (3.0, 1.0, Mode.FREE),
        # At no weight it depends on whether the weight comes or goes.
        (2.0, 1.0, Mode.FREE),
        (2.0, -1.0, Mode.LOCKED),
    ):
        x = np.array([0.0, clock, 0.0, rate])
        start = run.on_stop(4.0, x)
        assert (start.mode, start.time, start.speed) == (mode, 4.0, None)
        assert start.state is x
