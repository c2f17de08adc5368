"""Completed executions: closed forms, the reference orbit, admissible starts and false models."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, takewhile
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import DOP853

from tests.reference import closed_forms
from tests.reference.closed_forms import COCO, FORCED
from tests.reference.reference_orbit import (
    FIRST_IMPACT,
    FIRST_RATE,
    PERIOD,
    RELEASE,
    ZENO_STATE,
    ZENO_TIME,
)
from tests.support import machines
from tests.support.families import BALL, CART
from tests.support.mechanisms import (
    GRAVITY,
    bead_on_disc,
    forced_oscillator,
    oscillator_state,
    spring_mass,
)
from zeno_orbits.errors import (
    ChatterError,
    InputError,
    PenetrationError,
    RunawayError,
    SimulationError,
    StepSizeError,
)
from zeno_orbits.integrators import Engine, Radau, RungeKutta, SciPy, Tolerance
from zeno_orbits.model import HybridDynamics, Problem, bind, load_problem, load_reference
from zeno_orbits.simulation import (
    Ending,
    Execution,
    Impact,
    Mode,
    Release,
    SimulationSettings,
    Truncation,
    ZenoExtrapolation,
    ZenoPoint,
    simulate,
)

ACCURACY = 1e-11
"""What the default settings aim at, a period."""
HEIGHT, G = 1.0, 9.81


Pendulum = Callable[..., HybridDynamics]


@pytest.fixture(name="problem", scope="module")
def _problem() -> Problem:
    return load_problem("motor_pendulum")


@pytest.fixture(name="pendulum", scope="module")
def _pendulum(problem: Problem) -> Pendulum:
    compiled = problem.compiled()

    def at(**parameters: float) -> HybridDynamics:
        return bind(compiled, problem.values(parameters=parameters).vector)

    return at


@pytest.fixture(name="ball", scope="module")
def _ball() -> Pendulum:
    problem = load_problem("bouncing_ball")
    compiled = problem.compiled()

    def at(restitution: float) -> HybridDynamics:
        values = problem.values(parameters={"restitution": restitution})
        return bind(compiled, values.vector)

    return at


@pytest.fixture(name="one_period", scope="module")
def _one_period(pendulum: Pendulum) -> Execution:
    return simulate(pendulum(), RELEASE, until=5.0, releases=1)


# The bouncing ball.


@pytest.mark.parametrize("restitution", [0.0, 0.2, 0.5, 0.8, 0.9])
def test_the_ball_comes_to_rest_at_its_zeno_time(ball: Pendulum, restitution: float) -> None:
    execution = simulate(ball(restitution), (HEIGHT, 0.0), until=20.0)
    exact = closed_forms.ball_zeno_time(HEIGHT, G, restitution)
    (zeno,) = execution.zeno_points
    assert zeno.time == pytest.approx(exact, rel=1e-12)
    assert execution.arcs[-1].mode is Mode.LOCKED
    assert execution.end_state == pytest.approx(np.zeros(2), abs=0.0)
    assert execution.end_time == 20.0


@pytest.mark.parametrize("restitution", [0.0, 0.2, 0.5, 0.8, 0.9])
def test_every_impact_of_the_ball_has_its_time_and_speed(
    ball: Pendulum, restitution: float
) -> None:
    execution = simulate(ball(restitution), (HEIGHT, 0.0), until=20.0)
    for k, impact in enumerate(execution.impacts):
        speed = closed_forms.ball_impact_speed(HEIGHT, G, restitution, k)
        assert -impact.approach_rate == pytest.approx(speed, rel=1e-12)
        assert impact.time == pytest.approx(
            closed_forms.ball_impact_time(HEIGHT, G, restitution, k), rel=1e-12
        )
        assert impact.state_plus[1] == pytest.approx(restitution * speed, rel=1e-12)


def test_impacts_resolved_far_into_the_tail_keep_the_closed_form(ball: Pendulum) -> None:
    # Just before the Zeno time nothing can be extrapolated, so every impact is resolved.
    restitution = 0.5
    until = closed_forms.ball_zeno_time(HEIGHT, G, restitution) - 1e-9
    execution = simulate(ball(restitution), (HEIGHT, 0.0), until=until)
    n_exact = len(
        list(
            takewhile(
                lambda k: closed_forms.ball_impact_time(HEIGHT, G, restitution, k) < until,
                range(1000),
            )
        )
    )
    assert len(execution.impacts) == n_exact > 25
    for k, impact in enumerate(execution.impacts):
        speed = closed_forms.ball_impact_speed(HEIGHT, G, restitution, k)
        # Each impact multiplies the speed, so relative errors of a rounding or two add up.
        assert -impact.approach_rate == pytest.approx(speed, rel=1e-12)


@pytest.mark.parametrize("speed", [1.0, 1e-2, 1e-4])
def test_a_ball_launched_from_the_floor_bounces_to_rest(ball: Pendulum, speed: float) -> None:
    restitution = 0.8
    execution = simulate(ball(restitution), (0.0, speed), until=3.0)
    exact = 2 * speed / (G * (1 - restitution))
    assert execution.zeno_points[0].time == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("speed", [1e-5, 1e-8, 1e-11])
def test_a_ball_launched_very_slowly_bounces_to_rest(ball: Pendulum, speed: float) -> None:
    restitution = 0.8
    execution = simulate(ball(restitution), (0.0, speed), until=3.0)
    exact = 2 * speed / (G * (1 - restitution))
    # The speed counts as a contact below 1e-12, which is its absolute accuracy here.
    assert execution.zeno_points[0].time == pytest.approx(exact, rel=1e-12, abs=1e-12)


# Oscillators with a stop.


def _forced(restitution: float = FORCED.restitution) -> HybridDynamics:
    return forced_oscillator(FORCED, restitution)


LOCKED_START = oscillator_state(0.0, FORCED.stop, 0.0)


def test_the_forced_oscillator_releases_bounces_and_locks_as_in_the_closed_form() -> None:
    execution = simulate(_forced(), LOCKED_START, until=6.0)
    assert execution.arcs[0].mode is Mode.LOCKED
    assert execution.releases[0].time == pytest.approx(FORCED.release_time, abs=ACCURACY)
    assert execution.zeno_points[0].time == pytest.approx(5.06454057578434876, abs=ACCURACY)
    published = [4.6665292208296586, 4.8909848023223145, 4.9823919604720270]
    times = [impact.time for impact in execution.impacts]
    assert times[:3] == pytest.approx(published, abs=ACCURACY)
    for impact, (time, approach) in zip(execution.impacts, FORCED.impacts(), strict=False):
        assert impact.time == pytest.approx(time, abs=ACCURACY)
        assert -impact.approach_rate == pytest.approx(approach, rel=1e-10)


def test_the_forced_oscillator_repeats_after_exactly_one_turn() -> None:
    execution = simulate(_forced(), LOCKED_START, until=3 * 2 * math.pi)
    releases = [release.time for release in execution.releases]
    assert len(releases) == 3
    for early, late in pairwise(releases):
        assert late - early == pytest.approx(2 * math.pi, abs=ACCURACY)
    for turn in range(1, 4):
        state = execution.state_at(min(2 * math.pi * turn, execution.end_time))
        assert state == pytest.approx(np.array(LOCKED_START), abs=ACCURACY * turn)


def test_no_impact_is_invented_and_none_is_missed_before_the_zeno_point() -> None:
    until = FORCED.zeno_time() - 1e-8
    execution = simulate(_forced(), LOCKED_START, until=until)
    exact = list(takewhile(lambda impact: impact[0] < until, FORCED.impacts()))
    assert len(execution.impacts) == len(exact) > 20
    assert all(impact.approach_rate < 0.0 for impact in execution.impacts)
    for early, late in pairwise(execution.impacts):
        assert late.time > early.time
        assert -late.approach_rate < -early.approach_rate


def test_the_published_orbit_of_the_coco_oscillator_closes() -> None:
    phase, velocity = 0.07595216493831239, -1.3565863500759056
    start = oscillator_state(phase, COCO.stop, velocity)
    n_turns = 3
    execution = simulate(
        forced_oscillator(COCO, COCO.restitution), start, until=2 * math.pi * n_turns + 0.1
    )
    times = [impact.time for impact in execution.impacts]
    exact = [2 * math.pi * turn for turn in range(1, n_turns + 1)]
    assert times == pytest.approx(exact, abs=ACCURACY)
    for impact in execution.impacts:
        assert impact.state_plus == pytest.approx(np.array(start), abs=ACCURACY)


def test_a_bead_leaves_the_disc_where_its_weight_no_longer_turns_it() -> None:
    speed = 0.2
    execution = simulate(bead_on_disc(0.5), (0.0, 1.0, speed, 0.0), until=10.0, releases=1)
    (release,) = execution.releases
    assert release.state[1] == pytest.approx(2 / 3 + speed**2 / (3 * GRAVITY), abs=ACCURACY)
    assert np.hypot(*release.state[:2]) == pytest.approx(1.0, abs=ACCURACY)


# Admissible starts.


def test_a_start_off_the_stop_flies(ball: Pendulum) -> None:
    execution = simulate(ball(0.5), (1.0, 0.0), until=0.1)
    assert [arc.mode for arc in execution.arcs] == [Mode.FREE]
    assert execution.events == ()


def test_a_start_at_rest_on_a_stop_that_holds_is_locked(ball: Pendulum) -> None:
    execution = simulate(ball(0.5), (0.0, 0.0), until=0.1)
    assert [arc.mode for arc in execution.arcs] == [Mode.LOCKED]
    assert execution.events == ()


def test_a_start_on_the_stop_that_moves_in_impacts_at_once(ball: Pendulum) -> None:
    execution = simulate(ball(0.5), (0.0, -2.0), until=5.0)
    assert execution.impacts[0].time == 0.0
    assert execution.impacts[0].approach_rate == -2.0
    exact = 2 * 1.0 / (G * (1 - 0.5))
    assert execution.zeno_points[0].time == pytest.approx(exact, rel=1e-12)


def test_a_start_at_rest_on_a_stop_that_repels_leaves_at_once() -> None:
    phase = math.pi
    start = oscillator_state(phase, FORCED.stop, 0.0)
    execution = simulate(_forced(), start, until=3.0)
    assert execution.arcs[0].mode is Mode.FREE
    assert execution.releases == ()
    first, _ = FORCED.next_impact(phase, 0.0)
    assert execution.impacts[0].time == pytest.approx(first - phase, abs=ACCURACY)


def test_a_start_exactly_at_a_release_leaves_at_once() -> None:
    start = oscillator_state(FORCED.release_time, FORCED.stop, 0.0)
    execution = simulate(_forced(), start, until=3.0)
    first, _ = FORCED.next_impact(FORCED.release_time, 0.0)
    assert execution.impacts[0].time == pytest.approx(first - FORCED.release_time, abs=ACCURACY)


def test_a_start_as_the_stop_begins_to_hold_is_locked() -> None:
    # At minus the release phase the multiplier is zero and grows.
    start = oscillator_state(-FORCED.release_time, FORCED.stop, 0.0)
    execution = simulate(_forced(), start, until=6.0)
    assert execution.arcs[0].mode is Mode.LOCKED
    assert execution.releases[0].time == pytest.approx(2 * FORCED.release_time, abs=ACCURACY)


@pytest.mark.parametrize("early", [1e-6, 1e-9])
def test_a_lock_just_before_its_release_is_released(early: float) -> None:
    start = oscillator_state(FORCED.release_time - early, FORCED.stop, 0.0)
    execution = simulate(_forced(), start, until=3.0)
    first, _ = FORCED.next_impact(FORCED.release_time, 0.0)
    # The release from a multiplier of 0.6 early is sharp to a rounding divided by that slope.
    assert execution.releases[0].time == pytest.approx(early, abs=1e-14)
    delay = first - FORCED.release_time + early
    assert execution.impacts[0].time == pytest.approx(delay, abs=ACCURACY)


@pytest.mark.parametrize("early", [1.6e-12, 8e-13, 4e-13])
def test_a_lock_within_rounding_of_its_release_is_released(early: float) -> None:
    start = oscillator_state(FORCED.release_time - early, FORCED.stop, 0.0)
    execution = simulate(_forced(), start, until=3.0)
    first, _ = FORCED.next_impact(FORCED.release_time, 0.0)
    assert execution.impacts[0].time == pytest.approx(first - FORCED.release_time, abs=ACCURACY)


def test_a_very_light_ball_rests_as_a_heavy_one_does() -> None:
    problem = load_problem("bouncing_ball")
    values = problem.values(parameters={"m": 1e-15})
    light = problem.dynamics(values)
    execution = simulate(light, (0.0, 0.0), until=0.1)
    assert [arc.mode for arc in execution.arcs] == [Mode.LOCKED]


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ((-1e-3, 0.0), "must have a gap >= 0, but it is -0.001"),
        ((math.nan, 0.0), "must be finite"),
        ((1.0, math.inf), "must be finite"),
        ((1.0,), r"must have 2 entries, but its shape is \(1,\)"),
        ((1.0, 0.0, 0.0), r"must have 2 entries, but its shape is \(3,\)"),
    ],
)
def test_a_state_that_is_not_admissible_is_refused(
    ball: Pendulum, state: tuple[float, ...], words: str
) -> None:
    with pytest.raises(InputError, match=f"`state` {words}"):
        simulate(ball(0.5), state, until=1.0)


@pytest.mark.parametrize("until", [0.0, -1.0, math.nan, math.inf])
def test_a_horizon_that_is_not_a_positive_time_is_refused(ball: Pendulum, until: float) -> None:
    with pytest.raises(InputError, match="`until` must be a finite, positive number of seconds"):
        simulate(ball(0.5), (1.0, 0.0), until=until)


# Plastic impacts.


def test_a_plastic_impact_that_the_stop_can_hold_locks_at_once(pendulum: Pendulum) -> None:
    execution = simulate(pendulum(restitution=0.0), RELEASE, until=5.0, releases=1)
    assert [type(event) for event in execution.events] == [Impact, ZenoPoint, Release]
    assert execution.zeno_points[0].time == execution.impacts[0].time
    assert [arc.ending for arc in execution.arcs] == [Ending.IMPACT, Ending.RELEASE]


def test_a_plastic_impact_on_a_stop_that_repels_leaves_at_once() -> None:
    # At the phase pi the free mass would leave the stop, so it must not stick there.
    phase, approach = math.pi, 0.3
    lead = 1e-3
    position, velocity = FORCED.motion(phase - lead, phase, approach)
    start = oscillator_state(phase - lead, position, velocity)
    execution = simulate(_forced(restitution=0.0), start, until=2.2)
    first = execution.impacts[0]
    assert first.time == pytest.approx(lead, abs=ACCURACY)
    assert -first.approach_rate == pytest.approx(approach, abs=ACCURACY)
    assert [arc.mode for arc in execution.arcs[:2]] == [Mode.FREE, Mode.FREE]
    second, _ = FORCED.next_impact(phase, 0.0)
    assert execution.impacts[1].time == pytest.approx(second - phase + lead, abs=ACCURACY)
    assert execution.zeno_points[0].time == execution.impacts[1].time


# The reference orbit.


def test_the_release_state_of_the_reference_problem_comes_back(one_period: Execution) -> None:
    assert one_period.end_time == pytest.approx(PERIOD, abs=1e-10)
    assert one_period.end_state == pytest.approx(np.array(RELEASE), abs=1e-10)
    assert one_period.impacts[0].time == pytest.approx(FIRST_IMPACT, abs=1e-10)
    assert one_period.impacts[0].approach_rate == pytest.approx(FIRST_RATE, abs=1e-10)
    (zeno,) = one_period.zeno_points
    assert zeno.time == pytest.approx(ZENO_TIME, abs=1e-10)
    assert zeno.state == pytest.approx(np.array(ZENO_STATE), abs=1e-10)


@pytest.mark.parametrize(
    ("restitution", "period"), [(0.0, 1.82033892548), (0.1, 1.81767797277), (0.3, 1.81128512357)]
)
def test_other_restitutions_have_their_declared_periods(
    pendulum: Pendulum, restitution: float, period: float
) -> None:
    # The largest multiplier is about 0.02 in size: seven periods shrink a start that is 0.1 off
    # to rounding.
    execution = simulate(pendulum(restitution=restitution), RELEASE, until=30.0, releases=8)
    last, end = (release.time for release in execution.releases[-2:])
    assert end - last == pytest.approx(period, abs=1e-10)


def test_the_late_impacts_of_the_pendulum_fall_by_the_restitution(one_period: Execution) -> None:
    rates = [impact.approach_rate for impact in one_period.impacts]
    assert all(rate < 0.0 for rate in rates)
    # The ratio tends to e in proportion to the speed; the last speeds are about 1e-5 of the first.
    assert rates[-1] / rates[-2] == pytest.approx(0.2, rel=1e-4)


def test_the_hand_written_pendulum_runs_the_same_period(
    problem: Problem, one_period: Execution
) -> None:
    by_hand = load_reference(problem).dynamics(problem.values())
    execution = simulate(by_hand, RELEASE, until=5.0, releases=1)
    assert len(execution.impacts) == len(one_period.impacts)
    assert execution.end_time == pytest.approx(one_period.end_time, abs=1e-10)
    assert execution.end_state == pytest.approx(one_period.end_state, abs=1e-10)
    for left, right in zip(execution.impacts, one_period.impacts, strict=True):
        assert left.time == pytest.approx(right.time, abs=1e-10)
        assert left.approach_rate == pytest.approx(right.approach_rate, abs=1e-10)


@pytest.mark.parametrize(
    "engine", [SciPy(method=DOP853), RungeKutta(), Radau()], ids=["SciPy", "explicit", "implicit"]
)
def test_every_engine_runs_the_same_period(
    pendulum: Pendulum, one_period: Execution, engine: Engine
) -> None:
    settings = SimulationSettings(engine=engine, tolerance=Tolerance(relative=1e-11))
    execution = simulate(pendulum(), RELEASE, until=5.0, releases=1, settings=settings)
    assert execution.end_time == pytest.approx(one_period.end_time, abs=1e-9)
    assert execution.end_state == pytest.approx(one_period.end_state, abs=1e-9)
    (zeno,), (same,) = execution.zeno_points, one_period.zeno_points
    assert zeno.time == pytest.approx(same.time, abs=1e-9)
    assert zeno.state == pytest.approx(same.state, abs=1e-9)


# The paper's rule.


def test_cutting_the_sequence_is_of_third_order_at_a_later_time(
    pendulum: Pendulum, one_period: Execution
) -> None:
    dynamics = pendulum()
    later = 1.6  # inside the contact phase
    exact = one_period.state_at(later)
    errors, speeds = [], []
    for impact in one_period.impacts[1:4]:
        # A hair above this impact's speed, so that exactly this one is made plastic.
        delta = -impact.approach_rate * (1 + 1e-9)
        cut = simulate(
            dynamics,
            RELEASE,
            until=later,
            settings=SimulationSettings(completion=Truncation(delta=delta)),
        )
        assert cut.zeno_points[0].time == pytest.approx(impact.time, abs=1e-10)
        errors.append(float(np.max(np.abs(cut.end_state - exact))))
        speeds.append(delta)
    # About 2e-4, 1.4e-6, 1.1e-8 expected; the integration must not hide the last one.
    assert errors[-1] > 100 * ACCURACY
    for (big, small), (fast, slow) in zip(pairwise(errors), pairwise(speeds), strict=True):
        order = math.log(big / small) / math.log(fast / slow)
        assert order == pytest.approx(3.0, abs=0.35)


def test_the_first_slow_impact_is_the_one_that_is_cut(ball: Pendulum) -> None:
    delta = 0.1
    settings = SimulationSettings(completion=Truncation(delta=delta))
    execution = simulate(ball(0.8), (HEIGHT, 0.0), until=10.0, settings=settings)
    slow = [impact for impact in execution.impacts if -impact.approach_rate < delta]
    assert len(slow) == 1
    first = next(k for k in range(100) if closed_forms.ball_impact_speed(HEIGHT, G, 0.8, k) < delta)
    assert len(execution.impacts) == first + 1
    (zeno,) = execution.zeno_points
    exact = closed_forms.ball_impact_time(HEIGHT, G, 0.8, first)
    assert zeno.time == slow[0].time == pytest.approx(exact, rel=1e-12)
    assert zeno.tail == 0.0
    assert execution.end_state == pytest.approx(np.zeros(2), abs=0.0)


# False models.


@pytest.mark.parametrize("restitution", [0.0, 0.2])
def test_a_reset_map_of_the_wrong_sign_is_caught(pendulum: Pendulum, restitution: float) -> None:
    right = pendulum(restitution=restitution)
    wrong = replace(right, reset_map=lambda x, rate: right.reset_map(x, -rate))
    with pytest.raises(PenetrationError, match="reset map sends the state into the stop"):
        simulate(wrong, RELEASE, until=5.0)


def test_a_stop_that_is_taken_to_let_go_while_it_holds_is_caught(pendulum: Pendulum) -> None:
    right = pendulum()
    wrong = replace(
        right,
        multiplier=lambda x: -right.multiplier(x),
        gap_acceleration=lambda x: -right.gap_acceleration(x),
    )
    pressed = np.array(ZENO_STATE)
    with pytest.raises(PenetrationError, match="leaves the admissible set"):
        simulate(wrong, pressed, until=0.1)


def test_a_sequence_that_is_not_allowed_enough_impacts_is_given_up(ball: Pendulum) -> None:
    settings = SimulationSettings(most_impacts=3)
    with pytest.raises(ChatterError, match="More than 3 impacts"):
        simulate(ball(0.9), (HEIGHT, 0.0), until=40.0, settings=settings)


# Horizons.


@pytest.mark.parametrize(
    ("until", "mode"),
    [(0.5, Mode.FREE), (1.0, Mode.FREE), (1.31, Mode.FREE), (1.5, Mode.LOCKED)],
)
def test_a_horizon_inside_an_arc_cuts_it_there(
    pendulum: Pendulum, one_period: Execution, until: float, mode: Mode
) -> None:
    execution = simulate(pendulum(), RELEASE, until=until)
    assert execution.end_time == until
    assert execution.arcs[-1].mode is mode
    assert execution.arcs[-1].ending is Ending.HORIZON
    assert execution.end_state == pytest.approx(one_period.state_at(until), abs=ACCURACY)


@pytest.mark.parametrize("before", [1e-3, 1e-6, 1e-9, 1e-13])
def test_a_horizon_inside_a_zeno_tail_ends_there_without_a_zeno_point(
    ball: Pendulum, before: float
) -> None:
    restitution = 0.8
    until = closed_forms.ball_zeno_time(HEIGHT, G, restitution) - before
    execution = simulate(ball(restitution), (HEIGHT, 0.0), until=until)
    assert execution.end_time == until
    assert execution.zeno_points == ()
    # All that is left is a ball at most as fast as one that comes to rest after `before`.
    fastest = G * (1 - restitution) * before / (2 * restitution)
    assert abs(execution.end_state[1]) <= fastest * (1 + 1e-2) + ACCURACY


@pytest.mark.parametrize("nudge", [-1, 0, 1])
@pytest.mark.parametrize("restitution", [0.2, 0.8])
def test_a_horizon_at_the_zeno_time_itself_ends_there(
    ball: Pendulum, restitution: float, nudge: int
) -> None:
    zeno_time = closed_forms.ball_zeno_time(HEIGHT, G, restitution)
    until = zeno_time + nudge * math.ulp(zeno_time)
    execution = simulate(ball(restitution), (HEIGHT, 0.0), until=until)
    assert execution.end_time == pytest.approx(until, abs=0.0)
    assert execution.end_state == pytest.approx(np.zeros(2), abs=ACCURACY)


def test_the_execution_stops_at_the_asked_number_of_releases() -> None:
    execution = simulate(_forced(), LOCKED_START, until=100.0, releases=2)
    assert len(execution.releases) == 2
    assert execution.end_time == execution.releases[-1].time


def test_progress_reports_the_part_of_the_time_that_is_simulated(ball: Pendulum) -> None:
    parts: list[float] = []
    execution = simulate(
        ball(0.5), (HEIGHT, 0.0), until=3.0, on_progress=lambda _, part: parts.append(part or 0.0)
    )
    assert parts == sorted(parts)
    assert len(parts) > 1
    assert parts[-1] == execution.end_time / 3.0


# The execution as a function of time.


def test_the_configuration_is_continuous_and_the_state_outside_impacts(
    one_period: Execution,
) -> None:
    (zeno,) = one_period.zeno_points
    fastest = 10.0  # bounds dtheta1, dtheta2 and 1/20 of di/dt near the events
    impacts = {impact.time for impact in one_period.impacts}
    for early, late in pairwise(one_period.arcs):
        across = late.start_time - early.end_time
        assert across in (0.0, zeno.time - one_period.impacts[-1].time)
        jump = np.abs(late.start_state - early.end_state)
        assert np.all(jump[:2] <= fastest * across + ACCURACY)
        if early.end_time not in impacts:
            assert np.max(jump) < ACCURACY
    for arc in one_period.arcs:
        inside = np.linspace(arc.start_time, arc.end_time, 50)
        states = [arc.state_at(float(time)) for time in inside]
        largest = max(float(np.max(np.abs(np.diff(states, axis=0)))), 0.0)
        steepest = 2000.0  # di/dt just after an impact, about (Kd v) / L
        assert largest <= steepest * float(inside[1] - inside[0]) + ACCURACY


def test_no_time_is_missing_between_the_last_impact_and_the_zeno_point(
    one_period: Execution,
) -> None:
    for early, late in pairwise(one_period.arcs):
        assert late.start_time == early.end_time
    (tail,) = (arc for arc in one_period.arcs if arc.ending is Ending.ZENO)
    (zeno,) = one_period.zeno_points
    assert tail.start_time == one_period.impacts[-1].time
    assert tail.end_time == zeno.time
    assert tail.mode is Mode.FREE
    assert tail.trajectory is None
    assert tail.end_state.tolist() == zeno.state.tolist()


def test_the_configuration_inside_a_tail_is_of_second_order_in_its_speed(
    pendulum: Pendulum, one_period: Execution
) -> None:
    errors, speeds = [], []
    # Earlier impacts come where d2h/dt2 still changes too much for a tail.
    for n_impacts in (4, 5, 6):
        last = one_period.impacts[n_impacts - 1]
        share = last.approach_rate / one_period.impacts[0].approach_rate
        early = ZenoExtrapolation(tolerance=math.inf, resolved=share * (1 + 1e-9))
        settings = SimulationSettings(completion=early)
        coarse = simulate(pendulum(), RELEASE, until=1.6, settings=settings)
        assert len(coarse.impacts) == n_impacts
        (zeno,) = coarse.zeno_points
        inside = np.linspace(last.time, min(zeno.time, ZENO_TIME), 40)
        error = [
            np.max(np.abs(coarse.state_at(float(t))[:2] - one_period.state_at(float(t))[:2]))
            for t in inside
        ]
        errors.append(float(np.max(error)))
        speeds.append(zeno.last_speed)
    for (big, small), (fast, slow) in zip(pairwise(errors), pairwise(speeds), strict=True):
        order = math.log(big / small) / math.log(fast / slow)
        assert order == pytest.approx(2.0, abs=0.35)


def test_the_height_inside_the_tail_of_a_ball_is_below_its_next_hop(ball: Pendulum) -> None:
    restitution = 0.8
    execution = simulate(ball(restitution), (HEIGHT, 0.0), until=20.0)
    (zeno,) = execution.zeno_points
    last = execution.impacts[-1]
    for part in (0.1, 0.5, 0.9):
        height, speed = execution.state_at(last.time + part * (zeno.time - last.time))
        # The ball hops to w^2 / (2 g) with speeds up to w; the tail says zero for both.
        assert 0.0 <= height <= zeno.last_speed**2 / (2 * G)
        assert abs(speed) <= zeno.last_speed


def test_the_state_at_an_impact_is_the_later_one(one_period: Execution) -> None:
    first = one_period.impacts[0]
    assert one_period.state_at(first.time).tolist() == first.state_plus.tolist()
    before = one_period.state_at(math.nextafter(first.time, 0.0))
    assert before == pytest.approx(first.state_minus, abs=ACCURACY)


def test_the_state_inside_a_flight_of_the_ball_is_the_parabola(ball: Pendulum) -> None:
    execution = simulate(ball(0.5), (HEIGHT, 0.0), until=3.0)
    for time in np.linspace(0.0, closed_forms.ball_fall_time(HEIGHT, G), 37)[:-1]:
        exact = np.array([HEIGHT - G * time**2 / 2, -G * time])
        assert execution.state_at(float(time)) == pytest.approx(exact, abs=1e-13)


def test_samples_cover_the_whole_time_in_order(one_period: Execution) -> None:
    times, states = one_period.sampled(n_per_arc=50)
    assert times[0] == 0.0
    assert times[-1] == one_period.end_time
    assert np.all(np.diff(times) >= 0.0)
    assert states.shape == (len(times), 5)
    for arc in one_period.arcs:
        assert arc.start_time in times
        assert arc.end_time in times
    longest_gap = max(float(np.max(np.diff(times))), 0.0)
    assert longest_gap <= 2 * max(arc.end_time - arc.start_time for arc in one_period.arcs) / 50


def test_a_time_outside_the_execution_is_refused(one_period: Execution) -> None:
    with pytest.raises(ValueError, match=r"`time` must lie in \[0, 1\.81371\], but it is 2"):
        one_period.state_at(2.0)


# Flights between the ends of steps.


@pytest.mark.parametrize("engine", [RungeKutta, Radau])
@pytest.mark.parametrize("dip", [1e-2, 1e-4, 1e-6])
def test_a_fall_and_return_inside_one_step_is_not_missed(
    dip: float, engine: type[RungeKutta] | type[Radau]
) -> None:
    # x = cos t dips below -1 + dip for a time of 2 sqrt(2 dip) around pi; loose tolerances make
    # steps of about a second.
    settings = SimulationSettings(
        engine=engine(largest_step=1.5), tolerance=Tolerance(relative=1e-7, absolute=1e-9)
    )
    execution = simulate(spring_mass(1 - dip, 0.5), (1.0, 0.0), until=4.0, settings=settings)
    assert np.max(np.diff(execution.arcs[0].flow_times)) > 2 * math.sqrt(2 * dip)
    exact = math.acos(-1 + dip)
    # Near the turning point an error of the position counts by the inverse of the speed there.
    assert execution.impacts[0].time == pytest.approx(exact, abs=1e-7 / math.sqrt(2 * dip))


def test_a_mass_that_turns_before_the_stop_does_not_impact() -> None:
    execution = simulate(spring_mass(1 + 1e-6, 0.5), (1.0, 0.0), until=20.0)
    assert execution.impacts == ()
    assert execution.end_state == pytest.approx(
        np.array([math.cos(20.0), -math.sin(20.0)]), abs=ACCURACY
    )


def test_a_motion_that_dies_out_is_followed_to_rest() -> None:
    # Positive damping: the swing fades into the hanging equilibrium, where the stop neither holds
    # nor repels, and the contacts end in rounding.
    problem = load_problem("motor_pendulum")
    dynamics = problem.dynamics(problem.values(gains={"Kd": 2.0}))
    execution = simulate(dynamics, problem.state_vector(problem.starts[0]), until=60.0)
    assert execution.end_time == 60.0
    assert np.max(np.abs(execution.end_state)) < 1e-3
    speeds = [-impact.approach_rate for impact in execution.impacts]
    assert all(speed > 0.0 for speed in speeds)


@pytest.mark.parametrize("gain", [-10.0, -1e3])
@pytest.mark.slow
def test_a_motion_that_speeds_up_without_end_is_told_in_a_tenth_of_the_steps(gain: float) -> None:
    # Feedback of the wrong sign: the shoulder turns ever faster, and every turn takes its steps.
    problem = load_problem("motor_pendulum")
    dynamics = problem.dynamics(problem.values(gains={"Kd": gain}))
    with pytest.raises(RunawayError, match="dtheta1 grows without bound") as caught:
        simulate(dynamics, problem.state_vector(problem.starts[0]), until=10.0)
    # Looks come at 25 000 steps and at every doubling: the fourth ends it, at 200 000 of 2 million.
    assert "its last 100000 steps" in str(caught.value)
    assert caught.value.time is not None
    assert caught.value.time < 4.0


@pytest.mark.slow
def test_an_oscillation_of_many_steps_is_no_runaway() -> None:
    # Some 180 000 steps: the looks at 25 000, 50 000 and 100 000 see no speed that keeps growing.
    small = SimulationSettings(engine=RungeKutta(largest_step=1e-3), most_steps=200_000)
    execution = simulate(_forced(), LOCKED_START, until=50.0, settings=small)
    assert execution.end_time == 50.0


@pytest.mark.slow
def test_a_small_fast_machine_is_followed_for_thousands_of_periods() -> None:
    # A relay of a micrometre: 5570 periods in 440 000 steps. The looks see it in other phases.
    relay = load_problem(Path(machines.__file__).with_name("micro_relay.py"))
    period = 2 * math.pi / 1e5
    execution = simulate(
        relay.dynamics(relay.values()), relay.state_vector(relay.starts[0]), until=0.35
    )
    assert execution.end_time == 0.35
    # By hand: the force releases the beam at F sin = k bend.
    phase = math.asin(0.1 * 1e-6 / 1.7e-7) / (2 * math.pi)
    last = execution.releases[-1].time / period
    assert last - math.floor(last) == pytest.approx(phase, abs=1e-6)


# Horizons and heights at the end of the range of doubles.


def test_a_ball_at_rest_is_followed_to_any_time() -> None:
    execution = simulate(BALL.at(m=1.0, g=9.81, c=0.0, e=0.5), (1.0, 0.0), until=1e308)
    assert execution.end_time == 1e308
    assert execution.end_state.tolist() == [0.0, 0.0]


def test_a_ball_that_rises_beyond_every_number_ends_in_a_named_error() -> None:
    # h = 4.9 t^2 leaves the doubles at 6e153 s; an infinite state would be a plausible end.
    with pytest.raises(StepSizeError):
        simulate(BALL.at(m=1.0, g=-9.81, c=0.0, e=0.5), (1.0, 0.0), until=1e200)


@pytest.mark.parametrize("turn", [-1e-3, -1e-5, -1e-6, -1e-9, -1e-12])
def test_a_stop_that_lets_go_and_holds_again_within_rounding_holds(turn: float) -> None:
    # A cart stops dead while its bob passes the wall's height: the gap opens as a t^2/2 - b t^3/6.
    dynamics = CART.at(M=1.0, m=0.5, l=0.7, g=9.81, wall=-0.2, e=0.0)

    def run(rate: float) -> Execution:
        return simulate(dynamics, [0.3, 0.0, -2.0, rate], until=1.0)

    found, straight = run(turn), run(0.0)
    assert found.end_state == pytest.approx(straight.end_state, abs=10 * abs(turn) + 1e-10)
    after = found.impacts[0].state_plus
    a = dynamics.gap_acceleration(after)
    b = dynamics.multiplier_rate(after) / dynamics.normal_inertia(after)
    assert a > 0.0
    if len(found.impacts) == 1:
        # What is left out is below the rounding of a gap of 0.2.
        assert 2 * a**3 / (3 * b**2) < 4 * 0.2 * 2.0**-52
    else:
        # It closes after 3 a/b, at the speed 3 a^2 / (2 b).
        second = found.impacts[1]
        assert second.time - found.impacts[0].time == pytest.approx(3 * a / b, rel=1e-2)
        assert -second.approach_rate == pytest.approx(1.5 * a**2 / b, rel=1e-2)


@pytest.mark.parametrize("engine", [pytest.param(Radau(), marks=pytest.mark.slow), RungeKutta()])
def test_an_exact_graze_does_not_end_a_motion(engine: Engine) -> None:
    # `x'' = -x` swings as far as its stop: whether it touches is a matter of the last digit.
    drawn = np.random.default_rng(0)
    for _ in range(30):
        stop, phase = 10.0 ** drawn.uniform(-2, 2), drawn.uniform(0.3, 2.8)
        start = (stop * math.cos(phase), -stop * math.sin(phase))
        swing = spring_mass(stop, drawn.uniform(0.0, 0.9))
        run = simulate(swing, start, until=8.0, settings=SimulationSettings(engine=engine))
        end = np.array([math.cos(phase + 8.0), -math.sin(phase + 8.0)])
        # What a graze may lose is the speed at which rounding strikes, sqrt(2 * 1e-12).
        assert np.max(np.abs(run.end_state / stop - end)) < 3e-6


def test_a_motion_beyond_all_numbers_ends_in_an_error_of_ours(problem: Problem) -> None:
    dynamics = problem.dynamics(problem.values(gains={"Kp": -1e6}))
    start = problem.state_vector(problem.starts[0])
    with pytest.raises(SimulationError):
        simulate(dynamics, start, until=10.0)
