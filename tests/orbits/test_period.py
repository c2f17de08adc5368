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
    followed,
    period,
    place_on_section,
)
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
