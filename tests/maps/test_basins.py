"""Maps over states: basins against closed forms, refinement along boundaries, files, refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.antidamped_spring import PROBLEM, SETS, numbers, threshold
from tests.support.cases import fast
from tests.support.commands import MISUSE, ask
from zeno_orbits.errors import InputError, MapFileError
from zeno_orbits.maps import AttractorClass, ParameterMap, read_map, write_map

SPRING = numbers(*SETS[0])


def spring_map(*, columns: int = 3, rows: int = 3, refine: int = 0) -> ParameterMap:
    return zo.parameter_map(
        PROBLEM,
        x=("x", 0.0, 4.0, columns),
        y=("v", -4.0, 4.0, rows),
        parameters=SPRING,
        refine=refine,
    )


@pytest.mark.parametrize(("a", "weight", "restitution"), fast(5, SETS))
def test_a_map_has_the_threshold_of_one_flight_and_one_impact_to_1e_8(
    a: float, weight: float, restitution: float
) -> None:
    v = threshold(a, weight, restitution)
    found = zo.parameter_map(
        PROBLEM,
        x=("x", 0.0, 0.01 * v, 2),
        y=("v", v * (1 - 1e-8), v * (1 + 1e-8), 2),
        parameters=numbers(a, weight, restitution),
        # So near the threshold a motion needs hundreds of impacts to leave it.
        until=3000.0,
    )
    below, above = found.attractors[0], found.attractors[2]
    assert (below.fate, above.fate) == (AttractorClass.REST, AttractorClass.ESCAPE)


@pytest.mark.weekly
@pytest.mark.slow
def test_a_refined_map_is_the_full_map_of_the_finest_grid() -> None:
    # The boundary is a smooth curve, and cells are smaller than its bends.
    coarse, full = spring_map(columns=6, rows=9, refine=2), spring_map(columns=21, rows=33)
    x, y, attractors = coarse.finest()
    assert (x, y) == (full.x, full.y)
    assert [one.phrase for one in attractors] == [one.phrase for one in full.attractors]
    assert len(coarse.attractors) + len(coarse.between) < 0.6 * len(full.attractors)


@pytest.mark.slow
def test_a_refined_point_is_the_attractor_of_its_own_state() -> None:
    found = spring_map(refine=2)
    x, y, _ = found.finest()
    assert found.between
    for one in found.between[:: len(found.between) // 5]:
        state = {"x": x.values()[one.column], "v": y.values()[one.row]}
        (alone,) = zo.parameter_map(
            PROBLEM,
            x=("x", state["x"], state["x"] + 1.0, 2),
            y=("v", state["v"], state["v"] + 1.0, 2),
            parameters=SPRING,
        ).attractors[:1]
        assert alone.fate is one.attractor.fate


def test_below_its_first_flip_every_start_of_the_shaken_ball_returns() -> None:
    # The acceleration of the table is 1.38 g: the ball is thrown once a turn.
    found = zo.parameter_map("vibrating_table", x=("height", 0.0, 0.05, 4), y=("speed", -1, 1, 4))
    assert {one.phrase for one in found.attractors} == {"Zeno periodic orbit, period 1"}
    (orbit,) = found.orbits
    assert {one.period for one in found.attractors} == {orbit.period}
    assert orbit.period == pytest.approx(2 * np.pi / 30.0, rel=1e-9)


@pytest.mark.slow
def test_orbits_of_one_kind_have_numbers_where_there_are_two() -> None:
    # The ball comes back once in two turns: on the even ones or on the odd ones.
    found = zo.parameter_map(
        "vibrating_table",
        x=("height", 0.0, 0.06, 4),
        y=("speed", -1.5, 1.5, 4),
        parameters={"A": 0.03},
    )
    assert len({one.phrase for one in found.orbits}) == len(found.orbits)


def test_an_axis_may_be_a_state_and_the_other_a_parameter() -> None:
    v = threshold(*SETS[0])
    found = zo.parameter_map(
        PROBLEM,
        x=("restitution", 0.5, 0.8, 2),
        y=("v", v * (1 + 1e-6), 1.1 * v, 2),
        parameters={"a": 0.1, "weight": 1.0},
        start={},
    )
    # At 0.5 impacts take more than a flight gives.
    fates = [one.fate for one in found.attractors]
    assert fates == [
        AttractorClass.REST,
        AttractorClass.ESCAPE,
        AttractorClass.REST,
        AttractorClass.ESCAPE,
    ]


def test_a_map_starts_where_the_period_of_an_orbit_starts_at_its_numbers() -> None:
    orbit = zo.find_orbit("motor_pendulum", gains={"Kp": 2.6}).unwrap()
    at = orbit.start_state
    found = zo.parameter_map(
        "motor_pendulum",
        x=("theta1", at["theta1"], at["theta1"] + 0.2, 2),
        y=("dtheta1", at["dtheta1"] - 0.1, at["dtheta1"], 2),
        orbit=orbit,
    )
    assert found.gains["Kp"] == 2.6
    assert found.start["current"] == at["current"]
    (known,) = found.orbits
    assert known.period == pytest.approx(orbit.period, rel=1e-9)
    assert {one.period for one in found.attractors} == {known.period}


@pytest.mark.slow
def test_a_map_file_keeps_the_refinement_and_the_orbits(tmp_path: Path) -> None:
    found = spring_map(refine=2)
    write_map(found, tmp_path / "map.json")
    assert read_map(tmp_path / "map.json").as_json() == found.as_json()
    assert json.loads((tmp_path / "map.json").read_text()) == found.as_json()


@pytest.mark.slow
def test_a_point_outside_the_finest_grid_is_refused(tmp_path: Path) -> None:
    data = spring_map(refine=1).as_json()
    data["between"][0]["row"] = 99
    (tmp_path / "map.json").write_text(json.dumps(data))
    with pytest.raises(MapFileError, match=r"between\[0\]\.row` must be 0 to 4"):
        read_map(tmp_path / "map.json")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("--x", "heigth=0:1", "--y", "speed=0:1"),
            "unknown name `heigth`. Did you mean `height`?",
        ),
        (("--x", "height=1:0", "--y", "speed=0:1"), "LOWER < UPPER for `height`"),
        (("--x", "height=0:1", "--y", "sine=0:1"), "must not be a state of the clock"),
        (("--x", "height=0:1", "--y", "height=0:2"), "another name than `x`"),
        (
            ("--x", "height=0:1", "--y", "speed=0:1", "--start", "speed=1"),
            "`speed` has an initial value",
        ),
        (("--x", "height=0:1", "--y", "speed=0:1", "--refine", "11"), "--refine 11: must be a"),
        (
            ("--x", "height=0:1", "--y", "speed=0:1", "--grid", "900x900", "--refine", "3"),
            "must lead to at most 10000000 points",
        ),
    ],
)
def test_an_axis_that_makes_no_sense_is_one_line(words: tuple[str, ...], told: str) -> None:
    answer = ask("map", "vibrating_table", *words)
    assert (answer.code, answer.out, answer.err.count("\n")) == (MISUSE, "", 1)
    assert told in answer.err


def test_the_orbit_of_another_problem_is_refused(orbit: zo.Orbit) -> None:
    with pytest.raises(InputError, match="must be the problem `motor_pendulum` of the orbit"):
        zo.parameter_map(PROBLEM, x=("x", 0, 1, 2), y=("v", 0, 1, 2), orbit=orbit)
