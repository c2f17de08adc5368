"""Single arcs behind a made-up engine: what it is asked, and what is made of its answer."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from zeno_orbits.errors import PenetrationError, RunawayError, SimulationError
from zeno_orbits.integrators import Segment, SegmentResult, Termination, Tolerance
from zeno_orbits.model import CharacteristicScales
from zeno_orbits.simulation import Ending, Mode
from zeno_orbits.simulation.arc_follower import ArcFollower, ArcStart

OWN = CharacteristicScales(gap=2.0, multiplier=5.0, gap_acceleration=8.0)
TOLERANCE = Tolerance(relative=1e-7, absolute=1e-8)
UNTIL = 10.0
NAMES = ("a", "b", "da", "db", "current")
STATE = np.array([0.1, -0.2, 3.0, -4.0, 50.0])


class Told:
    """An engine that gives one answer, and keeps what it was asked."""

    leg: Segment

    def __init__(self, outcome: Termination, duration: float) -> None:
        self.outcome, self.duration = outcome, duration
        self.trajectory: Any = object()

    def follow(self, leg: Segment) -> SegmentResult:
        self.leg = leg
        return SegmentResult(
            outcome=self.outcome,
            duration=self.duration,
            state=2 * leg.y,
            trajectory=self.trajectory,
        )


def follower(engine: Any = None, *, far: Any = math.inf, most_steps: int = 10**9) -> ArcFollower:
    dynamics: Any = SimpleNamespace(n_q=2, state_names=NAMES, own=OWN)
    return ArcFollower(
        dynamics=dynamics,
        engine=engine,
        tolerance=TOLERANCE,
        until=UNTIL,
        contact=1e-3,
        far=far,
        most_steps=most_steps,
    )


def follow(engine: Told, start: ArcStart, **limits: Any) -> tuple[Any, Any, ArcFollower]:
    flow: Any = "flow"
    one = follower(engine, **limits)
    arc, state = one.follow(start, flow, Ending.IMPACT, impact_index=7, on_guard=True)
    return arc, state, one


@pytest.mark.parametrize(("mode", "rounding"), [(Mode.FREE, 2e-3), (Mode.LOCKED, 5e-3)])
def test_an_arc_that_ends_at_its_guard_has_its_natural_ending(mode: Mode, rounding: float) -> None:
    engine = Told(Termination.FALL, 1.5)
    arc, state, _ = follow(engine, ArcStart(mode=mode, time=4.0, state=STATE))
    leg = engine.leg
    assert (leg.flow, leg.on_guard, leg.tolerance) == ("flow", True, TOLERANCE)
    assert leg.y.tolist() == STATE.tolist()
    assert (leg.horizon, leg.rounding, leg.reach) == (6.0, rounding, None)
    assert (arc.mode, arc.ending, arc.impact_index) == (mode, Ending.IMPACT, 7)
    assert (arc.start_time, arc.end_time, arc.time_unit) == (4.0, 5.5, 1.0)
    assert arc.start_state.tolist() == STATE.tolist()
    assert arc.end_state.tolist() == state.tolist() == (2 * STATE).tolist()
    assert arc.trajectory is engine.trajectory


def test_a_rescaled_flight_counts_in_its_speed_and_carries_its_scaled_gap() -> None:
    engine = Told(Termination.FALL, 3.0)
    arc, state, _ = follow(engine, ArcStart(mode=Mode.FREE, time=4.0, state=STATE, speed=0.5))
    leg = engine.leg
    assert leg.y.tolist() == [*STATE.tolist(), 0.0, 1.0]
    assert (leg.horizon, leg.rounding) == (12.0, 1e-3 / 8.0)
    assert (arc.end_time, arc.time_unit) == (5.5, 0.5)
    assert arc.end_state.tolist() == (2 * STATE).tolist()
    assert state.tolist() == [*(2 * STATE).tolist(), 0.0, 2.0]


def test_an_arc_that_time_cuts_ends_exactly_then() -> None:
    engine = Told(Termination.HORIZON, 6.0 - 1e-12)
    arc, _, _ = follow(engine, ArcStart(mode=Mode.FREE, time=4.0, state=STATE))
    assert (arc.end_time, arc.ending) == (UNTIL, Ending.HORIZON)


def test_an_arc_that_leaves_the_admissible_set_tells_when_and_where() -> None:
    start = ArcStart(mode=Mode.FREE, time=4.0, state=STATE, speed=0.5)
    with pytest.raises(PenetrationError) as caught:
        follow(Told(Termination.LEFT, 3.0), start)
    assert caught.value.time == 5.5
    assert caught.value.state == tuple((2 * STATE).tolist())


def test_a_motion_is_gone_beyond_the_bound_of_any_of_its_coordinates() -> None:
    engine = Told(Termination.FALL, 1.0)
    start = ArcStart(mode=Mode.FREE, time=4.0, state=STATE, speed=0.5)
    for far, reach in ((3.0, [3.0, 3.0]), ((3.0, 9.0), [3.0, 9.0]), ((math.inf, 9.0), None)):
        _, _, one = follow(engine, start, far=far)
        assert engine.leg.reach is not None
        assert engine.leg.reach.tolist() == (reach or [math.inf, 9.0])
        # On the bound it is not beyond; velocities have none.
        one._watch(1, 2.0, np.array([-3.0, 3.0, 99.0, 99.0, 99.0]))
        with pytest.raises(RunawayError) as caught:
            one._watch(1, 2.0, np.array([-2.0, -9.1, 99.0, 99.0, 99.0]))
        assert caught.value.coordinate == "b"
        assert caught.value.time == 5.0
        assert caught.value.state == (-2.0, -9.1, 99.0, 99.0, 99.0)
    with pytest.raises(RunawayError) as caught:
        follower(far=(3.0, 9.0))._watch(1, 2.0, np.array([-3.1, 9.1, 0.0, 0.0, 0.0]))
    assert caught.value.coordinate == "a"


def test_the_steps_of_all_arcs_count() -> None:
    one = follower(most_steps=100)
    one._watch(60, 1.0, STATE)
    one._watch(40, 1.5, STATE)
    with pytest.raises(SimulationError, match="100 steps") as caught:
        one._watch(1, 2.0, STATE)
    assert caught.value.time == 2.0
    assert caught.value.state == tuple(STATE.tolist())


def looked_at(speeds: list[float], times: list[float], most_steps: int) -> ArcFollower:
    """A follower after looks at 25 000 steps, 50 000 and so on, at speeds of `db` and times."""
    one, steps = follower(most_steps=most_steps), 0
    for k, (speed, time) in enumerate(zip(speeds, times, strict=True)):
        wanted = 25_000 * 2**k
        y = np.array([1e6, 1e6, 0.5, -speed, 1e6])
        # The largest speed since the look before counts, and not that of the last step.
        one._watch(wanted - 1 - steps, time, y)
        y = np.array([1e6, 1e6, 0.5, -1.0, 1e6])
        one._watch(1, time, y)
        steps = wanted
    return one


TIMES = [1.0, 1.5, 1.75, 2.0]
"""The last 100 000 steps take 0.25 s: the 8 s that are left would take 3 200 000."""


def test_a_motion_that_speeds_up_is_given_up_when_its_steps_will_not_last() -> None:
    rising = [1.0, 1.5, 2.25, 3.375]
    looked_at(rising, TIMES, 3_400_000)
    with pytest.raises(RunawayError, match=r"db grows.* 100000 .* 3e") as caught:
        looked_at(rising, TIMES, 3_399_999)
    assert caught.value.time == 2.0
    assert caught.value.state == (1e6, 1e6, 0.5, -1.0, 1e6)
    # If no time has passed at all the steps never last.
    with pytest.raises(RunawayError, match="inf"):
        looked_at(rising, [1.0, 1.5, 2.0, 2.0], 10**15)


def test_a_motion_that_slows_down_once_or_was_looked_at_three_times_goes_on() -> None:
    looked_at([1.0, 1.5, 2.25, 3.374], TIMES, 300_000)
    looked_at([1.0, 1.5, 2.24, 9.0], TIMES, 300_000)
    looked_at([1.0, 9.0, 99.0], TIMES[:3], 150_000)
    # Only the last four looks count.
    with pytest.raises(RunawayError):
        looked_at([9.0, 1.0, 1.5, 2.25, 3.375], [0.5, *TIMES], 500_000)
