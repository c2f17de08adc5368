"""Steps of a search that a whole search shows at its end only."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.reference.reference_orbit import PERIOD, RELEASE
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import ParameterValues
from zeno_orbits.orbits import Bound
from zeno_orbits.orbits.cycle import cycles
from zeno_orbits.search import fixed_point, homotopy, strategy
from zeno_orbits.search.homotopy import Followed
from zeno_orbits.search.number_notes import at_ends
from zeno_orbits.search.objectives import TargetAmplitude, TargetPeriod
from zeno_orbits.search.outcome import SearchStatus
from zeno_orbits.search.strategy import SearchStart
from zeno_orbits.search.transcription import constraints
from zeno_orbits.search.transcription.ipopt import Solution, SolveStatus
from zeno_orbits.search.trust_region import _BOXES, _is_held, trust_region_steps
from zeno_orbits.simulation.simulator import simulate


def gains(**values: float) -> ParameterValues:
    return ParameterValues(gains=values, parameters={})


@pytest.mark.parametrize(
    ("kp", "held"),
    [
        (2.5, False),
        (2.0, True),
        (3.0, True),
        (2.2, False),
    ],
)
def test_a_step_is_held_by_a_side_of_its_small_box(kp: float, held: bool) -> None:
    search: Any = SimpleNamespace(free={"Kp": (0.0, 10.0), "Kd": (-1.0, 1.0)})
    box = {"Kp": (2.0, 3.0), "Kd": (-0.5, 0.5)}
    assert _is_held(search, gains(Kp=kp, Kd=0.0), box) is held
    # The second number is looked at as well as the first.
    turned = {"Kd": (-0.5, 0.5), "Kp": (2.0, 3.0)}
    assert _is_held(search, gains(Kp=kp, Kd=0.0), turned) is held


@pytest.mark.parametrize("side", [0.0, 10.0])
def test_a_step_is_not_held_by_a_side_of_the_whole_box(side: float) -> None:
    search: Any = SimpleNamespace(free={"Kp": (0.0, 10.0)})
    box = {"Kp": (max(side - 1.0, 0.0), min(side + 1.0, 10.0))}
    assert not _is_held(search, gains(Kp=side), box)


def test_a_known_orbit_that_cannot_be_followed_is_no_guess() -> None:
    nowhere = Followed(cycle=None, values=gains(Kp=1.0), arrived=False)
    start, search = SearchStart(values=gains(Kp=2.0)), SimpleNamespace()
    outcome = strategy._along(search, start, nowhere, "the known orbit")  # type: ignore[arg-type]
    assert outcome.status is SearchStatus.NO_GUESS
    assert outcome.detail == "From the known orbit no orbit could be followed."


def test_the_rows_of_a_bound_say_which_end_they_hold() -> None:
    bound = Bound(name="current", lower=-2.0, upper=0.5)
    assert constraints._label(bound, 1.0) == "current >= -2"
    assert constraints._label(bound, -1.0) == "current <= 0.5"


def test_the_worst_rows_of_a_solution_are_its_three_largest_violations() -> None:
    sizes = {"a": 1e-9, "b": 3.0, "c": 0.5, "d": 2.0, "e": 1.0}
    found = Solution(
        status=SolveStatus.from_ipopt("Solve_Succeeded"),
        values={"x": np.zeros((1, 1))},
        residuals=sizes,
        objective=0.0,
        iterations=1,
        wall_time=0.0,
    )
    assert found.worst() == [("b", 3.0), ("d", 2.0), ("e", 1.0)]
    assert found.worst(1) == [("b", 3.0)]


@dataclass(frozen=True)
class _Box:
    """A search as far as steps in boxes are concerned."""

    free: dict[str, tuple[float, float]]


def test_boxes_grow_from_step_to_step_while_their_sides_hold_the_optimum() -> None:
    search: Any = _Box(free={"Kp": (0.0, 10.0)})
    widths: list[float] = []

    def to_the_upper_side(there: Any, _values: ParameterValues, cycle: Any) -> Any:
        low, high = there.free["Kp"]
        widths.append((high - low) / 10.0)
        reached = SimpleNamespace(values=gains(Kp=min(high, 9.0)), cycle=cycle)
        return SimpleNamespace(solution=reached, agreement=0.0, detail="")

    cycle: Any = None
    last = trust_region_steps(search, gains(Kp=5.0), cycle, to_the_upper_side)
    assert last.converged
    assert last.values.number("Kp") == 9.0
    # Twice half a box, and the growth of the second one.
    assert widths[0] == pytest.approx(2 * _BOXES.first)
    assert widths[1] == pytest.approx(2 * min(_BOXES.growth * _BOXES.first, _BOXES.longest))
    assert widths[1] > widths[0]


@pytest.mark.parametrize(("kp", "end"), [(3.0, "upper"), (2.0, "lower"), (2.5, "")])
def test_a_number_at_an_end_of_its_range_is_told_with_the_end(kp: float, end: str) -> None:
    pendulum = load_problem("motor_pendulum")
    values = pendulum.values(gains={"Kp": kp, "Kd": -1.0})
    told = (
        f"`Kp` = {kp:g} is the {end} end of its range 2:3: beyond it there may be a better orbit."
    )
    found = at_ends(pendulum, values, {"Kp": (2.0, 3.0), "Kd": (-1.5, -0.5)}, {})
    assert found == ([told] if end else [])
    # What was asked for is no compromise.
    assert at_ends(pendulum, values, {"Kp": (2.0, 3.0)}, {"Kp": kp}) == []


def test_objectives_say_what_they_wish() -> None:
    assert TargetPeriod(target=1.8).wish == "a period of 1.8 s"
    assert TargetAmplitude(target=0.25, state="theta1").wish == "an amplitude of 0.25 of theta1"


def test_the_margins_of_a_path_are_those_of_its_orbit(machine: HybridDynamics) -> None:
    start = np.array(RELEASE)
    (cycle,) = cycles(simulate(machine, start, until=1.5 * PERIOD), start=start)
    margins = homotopy._margins(machine, cycle)
    # To the digits that the declared orbit is given with.
    assert margins["first_impact_speed"] == pytest.approx(-cycle.impacts[0].approach_rate)
    assert margins["locked_time"] == pytest.approx(cycle.end.time - cycle.zeno.time)
    pressed = machine.multiplier(cycle.zeno.state) / machine.normal_inertia(cycle.zeno.state)
    assert margins["gap_acceleration"] == pytest.approx(pressed, rel=1e-6)
    assert min(margins.values()) > 0.0


@pytest.mark.parametrize(
    ("slope", "returns", "slopes"),
    # The start, a return that leads away, and the fixed point by the exact slope at the start; a
    # slope that is known leads there at once.
    [(None, 3, 1), (np.diag([3.0, -2.0]), 2, 0)],
)
def test_the_slope_is_taken_where_returns_alone_lead_away(
    slope: Any, returns: int, slopes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    matrix, taken = np.diag([3.0, -2.0]), []

    def tried(_dynamics: Any, _section: Any, at: Any, *_: Any, **__: Any) -> Any:
        cycle: Any = SimpleNamespace(
            start=SimpleNamespace(state=at), drift=lambda _: 0.0, scale_at_events=lambda: 1.0
        )
        return fixed_point._Trial(at=at, cycle=cycle, miss=matrix @ (at - 0.01) - (at - 0.01))

    def exact(*_: Any, **__: Any) -> Any:
        taken.append(matrix)
        return matrix

    section = SimpleNamespace(dimension=2)
    monkeypatch.setattr(fixed_point, "section_around", lambda *_: section)
    monkeypatch.setattr(fixed_point, "placed", lambda _dynamics, _shape, state: state)
    monkeypatch.setattr(fixed_point, "_tried", tried)
    monkeypatch.setattr(fixed_point, "return_slope", exact)
    machine: Any = SimpleNamespace(restitution=0.2)
    settings: Any = None
    found = fixed_point.close_cycle(
        machine, np.zeros(2), scale=np.ones(2), period=1.0, settings=settings, slope=slope
    )
    assert found.cycle.start.state == pytest.approx([0.01, 0.01], abs=1e-14)
    assert (found.returns, len(taken)) == (returns, slopes)
