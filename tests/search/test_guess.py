"""First guesses: motions that repeat, and the reasons why others do not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import PERIOD
from tests.support.mechanisms import (
    falling_away,
    forced_oscillator,
    oscillator_state,
    pushed_away,
    spring_mass,
)
from zeno_orbits.errors import InputError, RunawayError, SimulationError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import (
    CharacteristicScales,
    HybridDynamics,
    Problem,
    StateLimit,
    load_problem,
    own_time,
)
from zeno_orbits.orbits import EventSequence
from zeno_orbits.search import TransientSettings, run_to_attractor
from zeno_orbits.search.shooting import guess
from zeno_orbits.search.shooting.guess import FollowedMotion, back_on_constraints
from zeno_orbits.search.shooting.recurrence import Recurring
from zeno_orbits.simulation import (
    Execution,
    Impact,
    Mode,
    SimulationSettings,
    ZenoExtrapolation,
    simulate,
)

SHORT = TransientSettings(horizon=30.0)
LOCKED = oscillator_state(0.0, FORCED.stop, 0.0)


def test_the_pendulum_settles_to_the_declared_period(
    machine: HybridDynamics, problem: Problem
) -> None:
    settling = run_to_attractor(machine, [problem.state_vector({"theta1": 0.6})])
    assert settling.reason == ""
    assert settling.cycle is not None
    # The motion repeats to 1e-6; what is left shrinks by 0.02 a period.
    assert settling.cycle.period == pytest.approx(PERIOD, abs=1e-6)
    assert settling.cycle.drift(settling.cycle.scale()) < TransientSettings().settled


def test_a_motion_that_repeats_from_the_start_is_known_at_once() -> None:
    settling = run_to_attractor(
        forced_oscillator(FORCED, 0.5), [LOCKED], replace(SHORT, chunk=20.0)
    )
    assert settling.cycle is not None
    assert settling.cycle.period == pytest.approx(2 * math.pi, abs=1e-8)


def test_a_coordinate_beyond_its_escape_is_told_in_the_words_of_the_problem() -> None:
    problem = load_problem("motor_pendulum")
    whirling = problem.state_vector({"theta1": 0.6, "dtheta1": 60.0})
    settling = run_to_attractor(
        problem.dynamics(problem.values()), [whirling], SHORT, problem=problem
    )
    assert settling.cycle is None
    assert settling.reason in {escape.phrase for escape in problem.escapes.values()}


def test_a_mass_that_leaves_for_good_runs_away_though_nobody_says_how_far_is_far() -> None:
    # It grows by e^t: by more than e^7 = 1096 in the second half of 15 s.
    settling = run_to_attractor(
        pushed_away(1.0), [(1.0, 1.0)], TransientSettings(horizon=15.0, chunk=1.0)
    )
    assert settling.cycle is None
    assert settling.reason == "x0 runs away"


def test_a_mass_that_flies_far_at_a_steady_speed_has_not_run_away() -> None:
    settling = run_to_attractor(falling_away(1.0), [(0.0, 1.0)], SHORT)
    assert settling.reason == "no release is followed by a Zeno point after 30 s"
    assert settling.undecided


@pytest.mark.parametrize(
    ("name", "numbers", "period"),
    [
        ("forced_oscillator", {"A": 2000.0}, 2 * math.pi),
        # A table that tosses as high as 1.376 g at any frequency has the orbit of any other.
        ("vibrating_table", {"omega": 0.1, "A": 1350.0}, 2 * math.pi / 0.1),
        ("vibrating_table", {"omega": 0.03, "A": 15_000.0}, 2 * math.pi / 0.03),
        ("torque_pendulum", {"omega": 2 * math.pi / 150.0}, 150.0),
    ],
)
def test_slow_and_large_motions_are_waited_for_in_their_own_scales(
    name: str, numbers: dict[str, float], period: float
) -> None:
    problem = load_problem(name)
    dynamics = problem.dynamics(problem.values(parameters=numbers))
    starts = [problem.state_vector(start) for start in problem.starts]
    settling = run_to_attractor(dynamics, starts, problem=problem)
    assert settling.reason == ""
    assert settling.cycle is not None
    assert settling.cycle.period == pytest.approx(period, rel=1e-6)


@pytest.mark.parametrize("omega", [0.1, 0.03])
def test_a_table_too_slow_to_toss_anything_is_told_to_come_to_rest(omega: float) -> None:
    problem = load_problem("vibrating_table")
    dynamics = problem.dynamics(problem.values(parameters={"omega": omega}))
    settling = run_to_attractor(
        dynamics, [problem.state_vector(problem.starts[0])], problem=problem
    )
    assert settling.reason == "the motion comes to rest"


def test_a_mass_that_is_held_while_its_clock_turns_does_not_rest() -> None:
    # It starts on its stop, which lets go after a good part of a turn: many looks later.
    problem = load_problem("forced_oscillator")
    dynamics = problem.dynamics(problem.values())
    start = problem.state_vector(problem.starts[0])
    settling = run_to_attractor(dynamics, [start], TransientSettings(chunk=0.1), problem=problem)
    assert settling.reason == ""


def test_the_own_time_of_a_problem_is_that_of_its_clock_or_its_slowest_oscillation() -> None:
    table = load_problem("vibrating_table")
    start = np.array(table.state_vector(table.starts[0]))
    assert own_time(table.dynamics(table.values()), start) == pytest.approx(2 * math.pi / 30.0)
    spring = spring_mass(1.0, 0.5)
    assert own_time(spring, np.array([0.5, 0.0])) == pytest.approx(2 * math.pi)
    ball = load_problem("bouncing_ball")
    falling = own_time(ball.dynamics(ball.values()), np.array([1.0, 0.0]))
    assert falling == pytest.approx(2 * math.pi / math.sqrt(9.81))


@pytest.mark.parametrize("rounding", [1e-17, -1e-17])
def test_a_start_on_the_ground_has_the_own_time_of_one_a_rounding_beside_it(
    rounding: float,
) -> None:
    ball = load_problem("bouncing_ball")
    dynamics = ball.dynamics(ball.values())
    exact, rounded = (own_time(dynamics, np.array([at, 1.0])) for at in (0.0, rounding))
    assert rounded == exact


def test_a_link_on_its_stop_does_not_rest_while_a_slow_current_grows() -> None:
    # The inductance is a hundred times the valve's own: the current takes seconds to lift the link.
    valve = load_problem("motor_valve")
    values = valve.values(parameters={"L": 10.0, "restitution": 0.05})
    dynamics, start = valve.dynamics(values), valve.state_vector(valve.starts[0])
    settling = run_to_attractor(dynamics, [start], problem=valve)
    *_, before, last = simulate(dynamics, start, until=120.0).impacts
    assert settling.cycle is not None, settling.reason
    # The state repeats to `settled`, 1e-6 of its size.
    assert settling.cycle.period == pytest.approx(last.time - before.time, rel=1e-5)


def test_a_mass_at_rest_off_its_stop_rests() -> None:
    settling = run_to_attractor(spring_mass(1.0, 0.5), [(0.0, 0.0)], SHORT)
    assert settling.reason == "the motion comes to rest"
    assert not settling.undecided


def test_a_mass_that_swings_without_impacts_has_no_zeno_point() -> None:
    settling = run_to_attractor(spring_mass(1.0, 0.5), [(0.5, 0.0)], SHORT)
    assert settling.reason == "no release is followed by a Zeno point after 30 s"


def test_a_mass_that_bounces_for_ever_has_no_zeno_point(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.5})
    bouncing = problem.dynamics(values)
    settling = run_to_attractor(bouncing, [problem.state_vector({"theta1": 0.6})], SHORT)
    assert settling.cycle is None
    assert settling.reason.endswith("after 30 s")


def test_a_start_that_cannot_be_simulated_says_so() -> None:
    right = forced_oscillator(FORCED, 0.5)
    wrong = replace(right, reset_map=lambda x, rate: right.reset_map(x, -rate))
    settling = run_to_attractor(wrong, [LOCKED], SHORT)
    words = "the simulation fails: the reset map sends the state into the stop"
    assert settling.reason.lower() == words


def test_the_first_start_that_settles_is_taken() -> None:
    settling = run_to_attractor(
        forced_oscillator(FORCED, 0.5), [(-2.0, 0.0, 0.0, 0.0), LOCKED], SHORT
    )
    assert settling.cycle is not None


def test_every_reason_is_told_once() -> None:
    resting, swinging = (0.0, 0.0), (0.5, 0.0)
    settling = run_to_attractor(spring_mass(1.0, 0.5), [resting, swinging, resting], SHORT)
    assert settling.reason == (
        "the motion comes to rest / no release is followed by a Zeno point after 30 s"
    )


@pytest.mark.parametrize(
    ("horizon", "chunk", "runs"), [(25.0, 10.0, 3), (5.0, 1.0, 5), (3.0, 10.0, 1)]
)
def test_a_motion_is_not_followed_beyond_the_horizon(
    monkeypatch: pytest.MonkeyPatch, horizon: float, chunk: float, runs: int
) -> None:
    lengths: list[float] = []

    def counted(*arguments: Any, until: float, **options: Any) -> Execution:
        lengths.append(until)
        return simulate(*arguments, until=until, **options)

    monkeypatch.setattr(guess, "simulate", counted)
    settling = run_to_attractor(
        spring_mass(1.0, 0.5), [(0.5, 0.0)], replace(SHORT, horizon=horizon, chunk=chunk)
    )
    assert settling.reason == f"no release is followed by a Zeno point after {horizon:g} s"
    # The last look may go over the horizon by less than a chunk.
    assert lengths == [chunk] * runs


def test_a_motion_that_still_drifts_is_a_guess_if_it_drifts_little(
    machine: HybridDynamics, problem: Problem
) -> None:
    # With a multiplier of 0.02 the third or fourth period repeats to 1e-3 but not to 1e-15.
    start = problem.state_vector({"theta1": 0.6})
    strict = TransientSettings(horizon=10.0, settled=0.0)
    assert run_to_attractor(machine, [start], strict).cycle is not None
    hopeless = run_to_attractor(machine, [start], replace(strict, usable=0.0))
    assert hopeless.cycle is None
    assert hopeless.reason == "its periods differ after 10 s"


@pytest.mark.parametrize(
    ("what", "numbers"),
    [
        ("clock", {"rho": 0.2, "lean": 0.15, "c": 0.02}),
        ("stop", {"rho": 0.05, "lean": 0.4, "c": 0.05}),
    ],
)
def test_a_long_loose_simulation_does_not_drift_off_what_a_start_has_to_keep(
    what: str, numbers: dict[str, float]
) -> None:
    # Without being put back, the state leaves clock or stop by 1e-8, and no simulation admits it.
    problem = load_problem("curved_surface")
    dynamics = problem.dynamics(problem.values(parameters=numbers))
    settling = run_to_attractor(dynamics, [problem.state_vector(start) for start in problem.starts])
    assert (settling.cycle is not None) == (what == "clock")


def test_a_motion_that_comes_back_after_more_than_a_chunk_is_found() -> None:
    # The period is 2 pi; every look but those from a release is shorter by far.
    settling = run_to_attractor(forced_oscillator(FORCED, 0.5), [LOCKED], replace(SHORT, chunk=1.0))
    assert settling.cycle is not None
    assert settling.cycle.period == pytest.approx(2 * math.pi, abs=1e-8)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_a_state_is_put_back_on_its_constraint_in_any_unit(unit: float) -> None:
    def holonomic(state: np.ndarray) -> np.ndarray:
        return np.array([(state[0] ** 2 + state[1] ** 2) / unit**2 - 1.0])

    circle: Any = SimpleNamespace(holonomic=holonomic, own=CharacteristicScales())
    off = unit * np.array([0.6, 0.8001])
    back = back_on_constraints(circle, off, locked=False)
    # One step of Newton's method leaves the square of what was off, 1.6e-4.
    assert abs(holonomic(back)[0]) < 1e-7 < abs(holonomic(off)[0])
    assert back == pytest.approx(off, rel=2e-4)


# ---------------------------------------------------------------------------- motions made up


def _machine(**changes: Any) -> Any:
    """Return a machine of two coordinates whose rates are its states, ten times these if locked."""
    told: dict[str, Any] = {
        "n_q": 2,
        "state_names": ("a", "b", "da", "db"),
        "clock": (),
        "restitution": 0.5,
        "own": CharacteristicScales(),
        "free": SimpleNamespace(rate=lambda x: -x),
        "locked": SimpleNamespace(rate=lambda x: 10 * x),
        "holonomic": lambda _: np.zeros(0),
        "on_stop": lambda x: np.array([0.0, *x[1:]]),
    }
    return SimpleNamespace(**told | changes)


def _piece(
    length: float,
    end: Sequence[float] = (1.0, 1.0, 1.0, 1.0),
    *,
    locked: bool = False,
    releases: Sequence[tuple[float, Sequence[float]]] = (),
    found: Sequence[Any] = (),
    impacts: Sequence[Impact] = (),
    events: int = 0,
) -> Any:
    """Return what was seen between two looks; it has an event if it has a release or an impact."""
    let_go = tuple(SimpleNamespace(time=time, state=np.array(state)) for time, state in releases)
    return SimpleNamespace(
        end_time=length,
        end_state=np.array(end),
        arcs=[SimpleNamespace(mode=Mode.LOCKED if locked else Mode.FREE)],
        releases=let_go,
        zeno_points=[],
        impacts=list(impacts),
        events=[*let_go, *impacts, *(events * [None])],
        own=CharacteristicScales(),
        found=list(found),
    )


def _lap(change: float = 1.0, *, since: float = 1.0, speed: float = 1.0) -> Any:
    """Return a return that changes each state by a part of its size, 1."""
    phases = [SimpleNamespace(kind=kind) for kind in EventSequence.parsed("zeno").phases]
    return SimpleNamespace(
        state_names=("a", "b", "da", "db"),
        start=SimpleNamespace(time=0.0, state=since * np.ones(4)),
        end=SimpleNamespace(time=1.0, state=(since + change) * np.ones(4)),
        period=1.0,
        phases=phases,
        impacts=[SimpleNamespace(approach_rate=-speed), SimpleNamespace(approach_rate=-100.0)],
        scale_at_events=lambda: np.ones(4),
    )


def _limits(**changes: Any) -> guess._Watch:
    told: dict[str, Any] = {
        "settings": SimulationSettings(),
        "settled": 1e-6,
        "usable": 0.1,
        "horizon": 8.0,
        "chunk": 1.0,
        "turn": 100.0,
        "phrases": {},
    }
    return guess._Watch(**told | changes)


@dataclass
class Told:
    """Pieces of a motion that are seen one after the other, the last for ever, and what was asked.

    Attributes:
        monkeypatch: Where they are put.
        asked: State, patience and whether it is at a release, at each look.
    """

    monkeypatch: pytest.MonkeyPatch
    asked: list[tuple[list[float], float, bool]]

    def pieces(self, *pieces: Any) -> None:
        """Let the motion consist of these."""
        left = list(pieces)

        def look(_: Any, state: Any, _watch: Any, patience: float, *, at_release: bool) -> Any:
            self.asked.append((np.array(state).tolist(), patience, at_release))
            piece = left.pop(0) if len(left) > 1 else left[0]
            if isinstance(piece, Exception):
                raise piece
            return piece

        self.monkeypatch.setattr(guess, "_to_next_look", look)
        self.monkeypatch.setattr(guess, "cycles", lambda run, **_: run.found)


@pytest.fixture(name="told")
def _told(monkeypatch: pytest.MonkeyPatch) -> Told:
    return Told(monkeypatch=monkeypatch, asked=[])


START = np.array([0.0, 1.0, 1.0, 1.0])


def _followed(
    told: Told, *pieces: Any, wanted: Any = None, start: Any = START, **limits: Any
) -> FollowedMotion:
    told.pieces(*pieces)
    del told.asked[:]
    return guess._settle_from(_machine(), start, _limits(**limits), wanted)


@pytest.mark.parametrize(("horizon", "looks"), [(8.0, 4), (8.1, 5), (7.9, 4)])
def test_a_motion_is_looked_at_until_its_time_is_over(
    told: Told, horizon: float, looks: int
) -> None:
    found = _followed(told, _piece(2.0, events=1), horizon=horizon)
    assert len(told.asked) == looks
    assert found == FollowedMotion(
        cycle=None,
        reason=f"no release is followed by a Zeno point after {horizon:g} s",
        undecided=True,
    )


def test_a_motion_goes_on_from_its_last_release_if_it_ends_there_and_else_from_its_end(
    told: Told,
) -> None:
    at, later = (0.5, 2.0, 3.0, 4.0), (9.0, 8.0, 7.0, 6.0)
    _followed(
        told,
        _piece(2.0, later, releases=[(1.0, later), (2.0, at)]),
        _piece(2.0, later, releases=[(1.0, at)]),
        _piece(2.0, at, locked=True),
        _piece(2.0, later, events=1),
    )
    # On its stop a state is put onto it.
    assert [one for one, *_ in told.asked] == [
        [0.0, 1.0, 1.0, 1.0],
        [*at],
        [*later],
        [0.0, *at[1:]],
    ]
    assert [released for *_, released in told.asked] == [False, True, False, False]


def test_a_motion_that_does_not_come_back_to_its_release_is_waited_for_twice_as_long(
    told: Told,
) -> None:
    released = _piece(1.0, releases=[(1.0, START)])
    silent = _piece(1.0, events=1)
    _followed(told, released, silent, silent, released, released, silent, released, silent)
    assert [patience for _, patience, _ in told.asked] == [1, 1, 2, 2, 2, 2, 4, 4]


def test_a_return_that_repeats_is_taken_at_once(told: Told) -> None:
    lap = _lap(1e-7)
    found = _followed(told, _piece(1.0, releases=[(1.0, START)], found=[lap]))
    assert found == FollowedMotion(cycle=lap)
    assert len(told.asked) == 1
    wanted = _followed(
        told, _piece(1.0, releases=[(1.0, START)], found=[lap]), wanted=EventSequence.parsed("zeno")
    )
    assert wanted.cycle is lap


def test_a_motion_that_settles_to_another_shape_is_followed_no_longer(told: Told) -> None:
    lap = _lap(1e-7)
    piece = _piece(1.0, releases=[(1.0, START)], found=[lap])
    found = _followed(told, piece, wanted=EventSequence.parsed("zeno*2"))
    assert len(told.asked) == 1
    assert found.reason == "the motion settles to an orbit of shape `zeno`"
    assert not found.undecided


def test_the_nearest_period_is_a_guess_when_the_time_is_over(told: Told) -> None:
    laps = [_lap(0.09, since=1.0 + 0.09 * k) for k in range(8)]
    pieces = [_piece(1.0, releases=[(1.0, START)], found=[lap]) for lap in laps]
    assert _followed(told, *pieces).cycle is laps[-1]
    assert len(told.asked) == 8
    worse = _followed(told, *pieces, usable=0.08)
    assert worse.cycle is None
    assert worse.reason == "its periods differ after 8 s"


def test_a_motion_whose_first_impacts_fade_dies_out(told: Told) -> None:
    fading = [
        _piece(1.0, releases=[(1.0, START)], found=[_lap(since=since, speed=speed)])
        for since, speed in ((1.0, 1.0), (2.0, 0.9e-3))
    ]
    found = _followed(told, *fading)
    assert found == FollowedMotion(cycle=None, reason="the motion decays")
    assert len(told.asked) == 2
    # It is told when there is a return only.
    quiet = _followed(told, *fading[:1], _piece(1.0, releases=[(1.0, START)]))
    assert quiet.reason != "the motion decays"


def test_a_coordinate_that_runs_away_is_told_in_the_words_of_the_problem_or_of_the_simulation(
    told: Told,
) -> None:
    state = (1.0, 1.0)
    for coordinate, words in (("a", "it falls off"), ("b", "it is gone"), ("", "it is gone")):
        gone = RunawayError("it is gone", time=1.0, state=state, coordinate=coordinate)
        found = _followed(told, gone, phrases={"a": "it falls off"})
        assert found == FollowedMotion(cycle=None, reason=words)
    failure = SimulationError("The Step is small", time=1.0, state=state)
    found = _followed(told, _piece(1.0, events=1), failure)
    assert found == FollowedMotion(cycle=None, reason="the simulation fails: the Step is small")


STILL = (0.5e-6, 0.5e-6, 0.5e-6, 0.5e-6)


@pytest.mark.parametrize(("turn", "looks"), [(3.0, 4), (3.1, 5)])
def test_a_motion_that_is_still_for_a_turn_of_the_clock_rests(
    told: Told, turn: float, looks: int
) -> None:
    found = _followed(told, _piece(1.0, START + 1.0), _piece(1.0, STILL), turn=turn)
    assert found == FollowedMotion(cycle=None, reason="the motion comes to rest")
    assert len(told.asked) == looks
    nothing = _followed(told, _piece(1.0, np.zeros(4)), turn=turn)
    assert nothing.reason == "the motion comes to rest"
    assert len(told.asked) == looks - 1


@pytest.mark.parametrize(
    "between",
    [_piece(1.0, (0.0, 0.0, 1.0, 0.0)), _piece(1.0, STILL, events=1)],
    ids=["moved", "an event"],
)
def test_a_motion_that_moves_in_between_is_waited_for_anew(told: Told, between: Any) -> None:
    still = _piece(1.0, STILL)
    found = _followed(told, _piece(1.0), still, still, between, still, still, still, turn=3.0)
    assert found.reason == "the motion comes to rest"
    assert len(told.asked) == 7


def test_rates_are_compared_with_the_largest_so_far_those_before_an_impact_included(
    told: Told,
) -> None:
    fast = np.array([1e7, 1e7, 1e7, 1e7])
    hit = Impact(time=0.5, state_minus=fast, state_plus=fast, approach_rate=-1.0)
    found = _followed(told, _piece(1.0, impacts=[hit]), _piece(1.0), turn=3.0)
    # What moves at a rate of 1 is still beside ten million.
    assert found.reason == "the motion comes to rest"
    assert len(told.asked) == 4
    found = _followed(told, _piece(1.0, fast), _piece(1.0), turn=3.0, horizon=20.0)
    assert found.reason == "the motion comes to rest"
    assert _followed(told, _piece(1.0), turn=3.0).reason.endswith("after 8 s")
    # On its stop its rates are ten times its state.
    found = _followed(told, _piece(1.0, locked=True), _piece(1.0, 0.9e-5 * np.ones(4)), turn=3.0)
    assert found.reason == "the motion comes to rest"


def test_a_motion_that_is_held_for_more_than_half_its_time_is_said_to_stay(told: Told) -> None:
    held, flown = _piece(1.0, locked=True), _piece(1.0, events=1)
    found = _followed(told, *(3 * [flown]), *(5 * [held]))
    assert found == FollowedMotion(
        cycle=None, reason="the motion stays on its stop for 5 s", waited=8.0
    )
    for pieces in (
        [*(4 * [flown]), *(4 * [held])],
        # A flight in between, or an event, counts anew.
        [*(4 * [held]), flown, *(3 * [held])],
        [*(4 * [held]), _piece(1.0, locked=True, events=1), *(3 * [held])],
    ):
        found = _followed(told, *pieces)
        assert found.reason == "no release is followed by a Zeno point after 8 s"
        assert found.waited == 0.0
    assert _followed(told, held).reason == "the motion stays on its stop for 8 s"
    # What was held at last is all that counts.
    found = _followed(told, flown, _piece(1.0, locked=True, events=1), *(6 * [held]))
    assert found.reason == "the motion stays on its stop for 6 s"


def test_a_coordinate_a_thousand_times_as_far_as_in_the_first_half_runs_away(told: Told) -> None:
    def far(size: float, sign: float = 1.0) -> Any:
        return _piece(1.0, (0.0, sign * size, 0.0, 0.0), events=1)

    # It starts at 1 and is at 2 before half the time is over.
    pieces = [far(1.0), far(1.0), far(2.0, -1.0), far(1e9), far(1e9), far(1e9), far(1e9)]
    assert _followed(told, *pieces, far(2001.0, -1.0)).reason == "b runs away"
    assert _followed(told, *pieces, far(1999.0)).reason.endswith("after 8 s")
    # Where it starts counts, too: `a` is at zero there.
    assert _followed(told, *(7 * [far(0.5)]), far(1001.0)).reason == "b runs away"
    for start in (START, -START):
        found = _followed(told, *(7 * [far(0.5)]), far(999.0), start=start)
        assert found.reason.endswith("after 8 s")


def test_rates_are_those_of_all_states_but_the_clock() -> None:
    machine = _machine(clock=(1, 3))
    state = np.array([1.0, 2.0, -3.0, 4.0])
    assert guess._rates(machine, state, locked=False).tolist() == [1.0, 3.0]
    assert guess._rates(machine, state, locked=True).tolist() == [10.0, 30.0]
    hits = [
        Impact(time=0.5, state_minus=k * state, state_plus=state, approach_rate=-1.0)
        for k in (2.0, 5.0)
    ]
    (first,) = guess._rates_at_impacts(machine, _piece(1.0, impacts=hits))
    assert first.tolist() == [2.0, 6.0]
    assert guess._rates_at_impacts(machine, _piece(1.0)) == []


def test_a_motion_with_a_clock_can_be_followed(told: Told) -> None:
    told.pieces(_piece(1.0), _piece(1.0, (9.0, 9.0, 0.0, 9.0)))
    clocked = _machine(clock=(0, 1, 3))
    found = guess._settle_from(clocked, START, _limits(turn=3.0), None)
    assert found.reason == "the motion comes to rest"


# Several starts.


@dataclass
class _Starts:
    """Motions that are followed from starts, as they are told to end."""

    ends: list[FollowedMotion]
    asked: list[tuple[list[float], float, Any]]

    def __call__(self, _: Any, state: Any, watch: Any, wanted: Any) -> FollowedMotion:
        self.asked.append((state.tolist(), watch.horizon, wanted))
        return self.ends.pop(0)


@pytest.mark.parametrize(("waited", "left"), [(0.0, 9.0), (5.0, 4.0), (7.0, 3.0), (100.0, 3.0)])
def test_what_was_waited_for_one_start_is_taken_from_the_next_down_to_a_third(
    monkeypatch: pytest.MonkeyPatch, waited: float, left: float
) -> None:
    ended = FollowedMotion(cycle=None, reason="it stays", waited=waited)
    repeats = FollowedMotion(cycle=_lap())
    starts = _Starts(ends=[ended, repeats], asked=[])
    monkeypatch.setattr(guess, "_settle_from", starts)
    monkeypatch.setattr(guess, "own_time", lambda *_: 1.0)
    settings, wanted = TransientSettings(horizon=9.0), EventSequence.parsed("plastic")
    assert run_to_attractor(_machine(), [(0.0,), (1.0,)], settings, wanted) is repeats
    # The stop is not plastic.
    zeno = EventSequence.parsed("zeno")
    assert starts.asked == [([0.0], 9.0, zeno), ([1.0], pytest.approx(left), zeno)]


def test_what_was_waited_adds_up_and_any_start_may_be_undecided(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(guess, "own_time", lambda *_: 1.0)
    ends = [
        FollowedMotion(cycle=None, reason="it stays", waited=1.0),
        FollowedMotion(cycle=None, reason="it goes", waited=2.0, undecided=True),
        FollowedMotion(cycle=None, reason="it stays"),
    ]
    starts = _Starts(ends=[*ends], asked=[])
    monkeypatch.setattr(guess, "_settle_from", starts)
    found = run_to_attractor(_machine(), 3 * [(0.0,)], TransientSettings(horizon=9.0))
    assert found == FollowedMotion(cycle=None, reason="it stays / it goes", undecided=True)
    assert [left for _, left, _ in starts.asked] == [9.0, 8.0, 6.0]
    assert [wanted for *_, wanted in starts.asked] == [None, None, None]
    monkeypatch.setattr(guess, "_settle_from", _Starts(ends=[ends[0]], asked=[]))
    assert not run_to_attractor(_machine(), [(0.0,)]).undecided


# Limits of the wait.


def test_the_wait_is_measured_in_the_problems_own_time_unless_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(guess, "own_time", lambda *_: 2.0)
    machine, state = _machine(), np.zeros(4)
    alone = guess._watch(machine, state, TransientSettings(), None)
    assert (alone.horizon, alone.chunk, alone.turn) == (115 * 2.0, 6 * 2.0, 2.0)
    assert (alone.settings.far, alone.phrases) == (math.inf, {})
    assert (alone.settled, alone.usable) == (1e-6, 0.1)
    told = TransientSettings(horizon=7.0, chunk=3.0, settled=0.25, usable=0.5)
    watch = guess._watch(machine, state, told, None)
    assert (watch.horizon, watch.chunk, watch.settled, watch.usable) == (7.0, 3.0, 0.25, 0.5)
    assert watch.settings == replace(told.simulation, far=math.inf)


def test_the_wait_knows_how_far_coordinates_of_a_problem_may_go(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guess, "own_time", lambda *_: 2.0)
    escapes = {"theta2": StateLimit(beyond=3.0, phrase="it falls off")}
    pendulum = replace(problem, escapes=escapes)
    watch = guess._watch(_machine(), np.zeros(5), TransientSettings(), pendulum)
    # Ten turns of a link of which nothing is said.
    assert watch.settings.far == (pytest.approx(20 * math.pi), 3.0)
    assert watch.phrases == {"theta2": "it falls off"}
    assert watch.horizon == 115 * 2.0
    shaken = load_problem("forced_oscillator")
    machine = _machine(n_q=shaken.dynamics(shaken.values()).n_q)
    assert guess._watch(machine, np.zeros(4), TransientSettings(), shaken).horizon == 300 * 2.0


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.inf, math.nan])
def test_a_time_to_wait_that_is_not_positive_is_refused(wrong: float) -> None:
    with pytest.raises(InputError, match="`until` must be a positive number"):
        TransientSettings(horizon=wrong)
    with pytest.raises(InputError, match="`chunk` must be a positive number"):
        TransientSettings(chunk=wrong)


def test_a_motion_is_settled_more_loosely_than_it_is_verified() -> None:
    usual = TransientSettings()
    assert (usual.settled, usual.usable) == (1e-6, 0.1)
    assert usual.simulation.tolerance == Tolerance(relative=1e-8, absolute=1e-10)
    assert usual.simulation.completion == ZenoExtrapolation(tolerance=1e-11)
    assert (FollowedMotion(cycle=None).undecided, FollowedMotion(cycle=None).reason) == (False, "")


# A period made anew.


def test_a_period_that_was_not_followed_in_one_piece_is_simulated_from_its_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Any] = []
    cycle = _lap()

    def simulated(_: Any, start: Any, shape: Any, *, horizon: float, settings: Any) -> Any:
        asked.append((start.tolist(), shape, horizon, settings))
        return cycle

    monkeypatch.setattr(guess, "cycle_of", simulated)
    monkeypatch.setattr(guess, "place_on_section", lambda _machine, shape, x: (shape, x)[1])
    settings = SimulationSettings()
    shape = EventSequence.parsed("zeno*2")
    found = Recurring(shape=shape, start=START + 1.0, period=3.0, change=0.0)
    assert guess._period(_machine(), found, settings) == FollowedMotion(cycle=cycle)
    assert asked == [((START + 1.0).tolist(), shape, 6.0, settings)]
    whole = replace(found, cycle=_lap())
    assert guess._period(_machine(), whole, settings).cycle is whole.cycle

    def fails(*_: Any, **__: Any) -> Any:
        raise SimulationError("The Step is small", time=1.0, state=(1.0,))

    monkeypatch.setattr(guess, "cycle_of", fails)
    failed = guess._period(_machine(), found, settings)
    assert failed == FollowedMotion(cycle=None, reason="the Step is small")


@pytest.mark.parametrize("at_release", [False, True])
def test_a_look_is_at_the_next_release_or_after_a_while(
    monkeypatch: pytest.MonkeyPatch, at_release: bool
) -> None:
    watch, seen = _limits(chunk=3.0), _piece(1.0)
    asked: list[Any] = []

    def kept(*arguments: Any, **named: Any) -> Any:
        asked.append((*arguments[1:], named))
        return seen

    monkeypatch.setattr(guess, "simulate" if not at_release else "to_next_release", kept)
    assert guess._to_next_look(_machine(), START, watch, 5.0, at_release=at_release) is seen
    named = {"horizon": 5.0} if at_release else {"until": 3.0, "releases": 1}
    assert asked == [(START, named | {"settings": watch.settings})]


def test_a_state_is_put_back_on_several_constraints_by_the_shortest_step() -> None:
    # Planes x + y = 1 and z = 2; the step is of least length in units of the states' sizes.
    rows = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    machine: Any = _machine(holonomic=lambda x: rows @ x - np.array([1.0, 2.0]))
    back = back_on_constraints(machine, np.array([2.0, 4.0, 2.5]), locked=False)
    # Off by 5: at sizes 2 and 4 the parts of the step are as 4 to 16.
    assert back == pytest.approx([2.0 - 1.0, 4.0 - 4.0, 2.0], abs=1e-8)
    # A state that nearly vanishes is given the largest size.
    small = back_on_constraints(machine, np.array([1e-9, 4.0, 2.5]), locked=False)
    assert small == pytest.approx([-1.5, 2.5, 2.0], abs=1e-8)
    # A thousandth of the largest is small, more is a size of its own: 1.5 to 1000 here.
    own = back_on_constraints(machine, np.array([6e-3, 4.0, 2.5]), locked=False)
    assert own == pytest.approx([6e-3, 4.0 - 3.006, 2.0], abs=1e-5)
    # Off by 1, at sizes 2 and 4 again.
    negative = back_on_constraints(machine, np.array([-2.0, 4.0, 2.5]), locked=False)
    assert negative == pytest.approx([-2.0 - 0.2, 4.0 - 0.8, 2.0], abs=1e-8)
    untouched = np.array([1.0, 2.0, 3.0, 4.0])
    assert back_on_constraints(_machine(), untouched, locked=False) is untouched
    stopped = back_on_constraints(_machine(), untouched, locked=True)
    assert stopped.tolist() == [0.0, 2.0, 3.0, 4.0]
