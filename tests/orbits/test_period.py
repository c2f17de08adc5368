"""What is simulated for one period, and what is told if it is none."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.executions import at, execution_of
from zeno_orbits.errors import SimulationError
from zeno_orbits.orbits import (
    ONE_ZENO,
    EventSequence,
    cycle_of,
    first_return,
    followed,
    period,
    place_on_section,
)
from zeno_orbits.orbits.period import later_releases, to_release
from zeno_orbits.simulation import Execution, SimulationSettings

SETTINGS = SimulationSettings()
START = at(0.0, 1.0)
STOP: Any = SimpleNamespace(restitution=0.5)
"""A system that is never asked for more: its simulations are given."""


class Simulated:
    """Stands for `simulate`: gives executions in turn and remembers what was asked."""

    def __init__(self, *executions: Execution) -> None:
        self.left = list(executions)
        self.asked: list[dict[str, Any]] = []

    def __call__(self, _dynamics: Any, x: Any, **asked: Any) -> Execution:
        assert x is START
        assert asked.pop("settings") is SETTINGS
        self.asked.append(asked)
        return self.left.pop(0)


@pytest.fixture(name="simulated")
def _simulated(monkeypatch: pytest.MonkeyPatch) -> Simulated:
    given = Simulated()
    monkeypatch.setattr(period, "simulate", given)
    return given


RETURN = (("i", 1.0), ("z", 2.0), ("r", 3.0))
TWO = (*RETURN, ("i", 4.0), ("z", 5.0), ("r", 6.0))


def test_releases_count_after_the_first_flight() -> None:
    locked = execution_of(("r", 0.5), *RETURN, ("l", 9.0))
    assert [release.time for release in later_releases(locked)] == [3.0]
    assert [release.time for release in later_releases(execution_of(*TWO))] == [3.0, 6.0]
    assert later_releases(execution_of(("r", 0.5))) == ()
    first = first_return(execution_of(*TWO))
    assert first is not None
    assert first.time == 3.0
    assert first_return(execution_of(("l", 9.0))) is None


@pytest.mark.parametrize(
    ("first", "count", "again"),
    [
        (execution_of(*RETURN), 1, False),
        (execution_of(*TWO), 2, False),
        # Released first: that release is none of those waited for.
        (execution_of(("r", 0.5)), 1, True),
        (execution_of(("r", 0.5), *RETURN), 2, True),
        # The horizon came first: there is no more to wait for.
        (execution_of(("l", 9.0)), 1, False),
        (execution_of(*RETURN, ("f", 9.0)), 2, False),
        (execution_of(("r", 0.5), ("f", 9.0)), 2, False),
    ],
)
def test_one_release_more_is_waited_for_if_the_first_comes_before_a_flight(
    simulated: Simulated, first: Execution, count: int, *, again: bool
) -> None:
    second = execution_of(*TWO)
    simulated.left = [first, second]
    found = to_release(STOP, START, count, horizon=9.0, settings=SETTINGS)
    assert found is (second if again else first)
    counts = [count, count + 1] if again else [count]
    assert simulated.asked == [{"until": 9.0, "releases": n} for n in counts]


@pytest.mark.parametrize(
    ("shape", "n_periods", "asked"),
    [
        ("zeno", 1, {"releases": 1}),
        ("zeno*2", 3, {"releases": 6}),
        # Falls that the stop throws off are no releases.
        ("impact*2,plastic", 3, {"releases": 3}),
        ("impact", 1, {"impacts": 1}),
        ("impact*2", 3, {"impacts": 6}),
    ],
)
def test_periods_are_followed_until_their_releases_or_impacts_have_passed(
    simulated: Simulated, shape: str, n_periods: int, asked: dict[str, int]
) -> None:
    simulated.left = [execution_of(("f", 1.0))]
    followed(
        STOP,
        START,
        EventSequence.parsed(shape),
        horizon=7.0,
        settings=SETTINGS,
        n_periods=n_periods,
    )
    assert simulated.asked == [{"until": 7.0, **asked}]


def test_by_default_one_period_is_followed(simulated: Simulated) -> None:
    simulated.left = [execution_of(*TWO)]
    followed(STOP, START, EventSequence.parsed("zeno*2"), horizon=7.0, settings=SETTINGS)
    assert simulated.asked == [{"until": 7.0, "releases": 2}]


def test_the_period_that_an_execution_begins_with_is_the_one(simulated: Simulated) -> None:
    run = execution_of(*TWO)
    simulated.left = [run, run]
    # At this restitution a shape with a plastic impact is one with an accumulation.
    cycle = cycle_of(STOP, START, EventSequence.parsed("plastic"), horizon=9.0, settings=SETTINGS)
    assert (cycle.start.time, cycle.end.time) == (0.0, 3.0)
    assert cycle.phases[0].flight is run.arcs[0]


@pytest.mark.parametrize(
    ("run", "shape", "seen", "time"),
    [
        (execution_of(*RETURN, ("f", 9.0)), "zeno*2", "zeno", 3.0),
        # What was seen is told up to the phases that were wanted.
        (
            execution_of(("i", 1.0), ("p", 2.0), ("r", 3.0), ("p", 4.0), ("r", 5.0)),
            "zeno*2",
            "impact, plastic",
            3.0,
        ),
        (execution_of(("f", 9.0)), "zeno", "no phase", 9.5),
        (execution_of(("i", 1.0), ("i", 2.0), ("f", 9.0)), "impact*3", "impact, impact", 2.0),
        # Impacts of their own are told where impacts were wanted, and no accumulation.
        (execution_of(*RETURN), "impact*2", "impact", 1.0),
    ],
)
def test_a_motion_of_another_shape_tells_which_phases_it_has_and_where_they_end(
    simulated: Simulated, run: Execution, shape: str, seen: str, time: float
) -> None:
    simulated.left = [run]
    with pytest.raises(SimulationError) as caught:
        cycle_of(STOP, START, EventSequence.parsed(shape), horizon=9.5, settings=SETTINGS)
    assert caught.value.reason.endswith(f"not `{shape}`: {seen}")
    assert (caught.value.time, caught.value.state) == (time, (0.0, 1.0))


def test_a_start_is_moved_along_the_impulse_by_its_gap_and_no_other_way() -> None:
    def system(restitution: float) -> Any:
        # Two coordinates, their velocities and one state more.
        return SimpleNamespace(
            restitution=restitution,
            n_q=2,
            gap=lambda x: x[0] + x[1],
            impulse_direction=lambda _: np.array([9.0, 9.0, 0.75, 0.25, 9.0]),
            on_stop=lambda _: START,
        )

    impact = EventSequence.parsed("impact")
    x = np.array([0.5, -0.25, 1.0, 2.0, 3.0])
    moved = place_on_section(system(0.5), impact, x)
    assert moved.tolist() == [0.5 - 0.1875, -0.25 - 0.0625, 1.0, 2.0, 3.0]
    assert x.tolist() == [0.5, -0.25, 1.0, 2.0, 3.0]
    exact = np.array([0.5, -0.5, 1.0, 2.0, 3.0])
    assert place_on_section(system(0.5), impact, exact) is exact
    for shape, restitution in ((impact, 0.0), (ONE_ZENO, 0.5), (ONE_ZENO, 0.0)):
        assert place_on_section(system(restitution), shape, x) is START
