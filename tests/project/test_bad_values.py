"""Values of a wrong kind, at each argument: one line with the name of the argument."""

from __future__ import annotations

import json
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from zeno_orbits.errors import MapFileError
from zeno_orbits.experiment import RecordedSignal, Recording
from zeno_orbits.maps import read_map, write_map

PENDULUM = "motor_pendulum"


@pytest.mark.parametrize("bad", [1.0, "Kp", [("Kp", 1.0)], {1: 2.0}], ids=repr)
@pytest.mark.parametrize("argument", ["gains", "parameters", "start"])
def test_names_must_be_texts_in_a_mapping(argument: str, bad: Any) -> None:
    with pytest.raises(zo.InputError, match=f"`{argument}`"):
        zo.simulate(PENDULUM, **{argument: bad})


@pytest.mark.parametrize("box", [(), (3.0,), (1.0, None), ("1", 2.0), (1, 2, 3)], ids=repr)
def test_the_range_of_a_family_holds_two_numbers(box: Any, orbit: zo.Orbit) -> None:
    with pytest.raises(zo.InputError, match="`parameter`"):
        zo.continue_orbit(orbit, ("Kp", *box))


@pytest.mark.parametrize(
    "value", [2, np.float64(2.0), np.float32(2.0), np.int64(2), Fraction(2), Decimal(2)], ids=repr
)
def test_every_kind_of_real_number_is_taken(value: Any) -> None:
    found = zo.simulate("bouncing_ball", parameters={"g": value}, until=np.float64(1.0))
    assert found == zo.simulate("bouncing_ball", parameters={"g": 2.0}, until=1.0)


@pytest.mark.parametrize(
    ("entry", "value", "told"),
    [
        ("returns", -1, "`points[0].returns`"),
        ("returns", True, "`points[0].returns`"),
        ("returns", 1.5, "`points[0].returns`"),
        ("period", False, "`points[0].period`"),
        ("period", -1.0, "`points[0].period`"),
        ("period", float("nan"), "NaN"),
        ("period", float("inf"), "Infinity"),
        ("period", "nan", "`points[0].period`"),
        ("multipliers", [[1.0, "x"]], "`points[0].multipliers"),
        ("state", {"u": None}, "`points[0].state.u`"),
    ],
)
def test_a_map_file_with_a_false_entry_is_refused_with_its_name(
    entry: str, value: Any, told: str, tmp_path: Path
) -> None:
    path = tmp_path / "map.json"
    found = zo.parameter_map("bouncing_ball", x=("g", 5, 10, 2), y=("m", 1, 2, 2))
    write_map(found, path)
    assert read_map(path) == found
    data = json.loads(path.read_text())
    data["points"][0][entry] = value
    path.write_text(json.dumps(data))
    with pytest.raises(MapFileError) as caught:
        read_map(path)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("entry", "value"),
    [("until", True), ("until", -1.0), ("x", {"name": "g"}), ("gains", {"a": "b"}), ("points", 3)],
)
def test_a_map_file_with_a_false_head_is_refused(entry: str, value: Any, tmp_path: Path) -> None:
    path = tmp_path / "map.json"
    found = zo.parameter_map("bouncing_ball", x=("g", 5, 10, 2), y=("m", 1, 2, 2))
    path.write_text(json.dumps({**found.as_json(), entry: value}))
    with pytest.raises(MapFileError):
        read_map(path)


@pytest.mark.parametrize("told", [lambda: None, len, dict])
def test_a_function_for_progress_takes_a_text_and_a_part(told: Any, orbit: zo.Orbit) -> None:
    with pytest.raises(zo.InputError, match="Argument `on_progress` must"):
        zo.verify(orbit, on_progress=told)


TIMES = np.array([0.0, 1.0, 2.0])
SOUND: dict[str, Any] = {"source": None, "problem": "ball", "time": TIMES, "signals": ()}


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("time", [0.0, 1.0, 2.0]),
        ("time", "0 1 2"),
        ("signals", (TIMES,)),
        ("source", "measured"),
        ("problem", None),
        ("notes", "a note"),
        ("remarks", 3),
    ],
)
def test_a_recording_is_made_of_values_of_the_right_kinds(argument: str, value: Any) -> None:
    assert Recording(**SOUND).problem == "ball"
    with pytest.raises(zo.InputError, match=f"Argument `{argument}` must be"):
        Recording(**{**SOUND, argument: value})


def test_a_signal_is_made_of_values_of_the_right_kinds() -> None:
    with pytest.raises(zo.InputError, match="Argument `values` must be an array of NumPy"):
        RecordedSignal(name="q", unit="m", values=[0.0, 1.0])  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["nonsense", 3, None, "state", ["period"]])
def test_a_name_of_nothing_is_refused_by_methods_of_results(name: Any) -> None:
    ball = zo.load_problem("bouncing_ball")
    found = zo.parameter_map("bouncing_ball", x=("g", 5, 10, 2), y=("m", 1, 2, 2))
    for ask in (found.numbers, ball.values().number, ball.place, ball.quantity):
        with pytest.raises(zo.InputError, match="Argument `name`"):
            ask(name)
