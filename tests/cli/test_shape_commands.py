"""The commands, given orbits of other shapes: they work, or say in one line what they need."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from zeno_orbits.cli import main

STRUCK = ("search", "impact_oscillator", "--set", "omega=0.5", "--set", "stop=0.5")
"""Three impacts a period."""


@pytest.fixture(name="file", scope="module")
def _file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("shapes") / "orbit.json"
    assert main([*STRUCK, "-o", str(path)]) == 0
    return path


def _one_line(capsys: pytest.CaptureFixture[str], *words: str) -> None:
    text = capsys.readouterr().err
    assert text.startswith("zeno-orbits: ")
    assert text.count("\n") == 1
    for word in words:
        assert word in text


@pytest.mark.slow
def test_the_orbit_is_shown_phase_by_phase(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*STRUCK]) == 0
    text = capsys.readouterr().out
    assert "impact*3" in text
    assert "phase 3: first impact" in text
    assert "Verified: a stable periodic orbit without a Zeno point (shape impact*3)" in text


@pytest.mark.parametrize(
    ("words", "restitution", "named"),
    [
        (("motor_pendulum", "--set", "Kp=2.5", "--set", "Kd=-1"), "0", "simple"),
        (("motor_pendulum", "--set", "Kp=2.5", "--set", "Kd=-1"), "0.01", "Zeno"),
        (("kneed_walker",), "0", "simple"),
        pytest.param(("kneed_walker",), "0.01", "Zeno", marks=pytest.mark.slow),
    ],
)
def test_an_orbit_of_plastic_impacts_is_not_called_a_zeno_orbit(
    words: tuple[str, ...], restitution: str, named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["search", *words, "--set", f"restitution={restitution}"]) == 0
    text = capsys.readouterr().out
    assert f"Verified: a stable {named} periodic orbit" in text
    other = {"simple": "Zeno", "Zeno": "simple"}[named]
    assert f"{other} periodic orbit" not in text


def test_the_file_is_verified_and_its_certificate_says_the_shape(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["verify", str(file), "--json"]) == 0
    seen = json.loads(capsys.readouterr().out)
    assert seen["passed"]
    assert seen["shape"] == "impact*3"
    assert seen["floquet_multipliers"]


def _phase_out(data: dict[str, Any]) -> None:
    del data["events"][1]
    data |= {"shape": "impact*2", "sequence": data["sequence"][1:]}


def _impact_out(data: dict[str, Any]) -> None:
    data["events"][1]["name"] = "zeno stop"


def _swapped(data: dict[str, Any]) -> None:
    one, two = data["events"][:2]
    one["after"], two["after"] = two["after"], one["after"]


def _twice(data: dict[str, Any]) -> None:
    turn = data["period"]
    later = json.loads(json.dumps(data["events"]))
    for event in later:
        event["time"] += turn
    data["events"][-1]["after"] = data["start_state"]
    data |= {"events": data["events"] + later, "period": 2 * turn, "shape": "impact*6"}
    data["sequence"] *= 2


def _count(data: dict[str, Any]) -> None:
    data["shape"] = "impact*4"


@pytest.mark.parametrize(
    ("spoil", "code", "word"),
    [
        (_phase_out, 1, "Refused: "),
        (_impact_out, 2, "its `sequence` is `impact stop, impact stop, impact stop`, but its"),
        (_swapped, 1, "`phases` = "),
        (_twice, 1, "the margin `phases_apart` = 0.0e+00 is not positive"),
        (_count, 2, "its `shape` is `impact*4`, but its events are `impact stop, "),
    ],
)
def test_a_file_that_was_tampered_with_is_refused(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], spoil: Any, code: int, word: str
) -> None:
    data = json.loads(file.read_text(encoding="utf-8"))
    spoil(data)
    path = tmp_path / "false.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    assert main(["verify", str(path)]) == code
    answer = capsys.readouterr()
    assert word in " ".join((answer.out + answer.err).split())


@pytest.mark.slow
def test_pictures_of_an_orbit_without_a_zeno_point_are_those_it_has(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plot", str(file), "-o", str(tmp_path)]) == 0
    assert {path.stem for path in tmp_path.iterdir()} == {"portraits", "time"}
    capsys.readouterr()
    assert main(["plot", str(file), "--kind", "zeno", "-o", str(tmp_path)]) == 2
    _one_line(capsys, "--kind zeno: ", "without a Zeno point")


@pytest.mark.slow
def test_a_family_with_several_impacts_per_period_is_followed(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["continue", "impact_oscillator", "--parameter", "omega=0.4:0.6", "--near", str(file)]
    assert main([*words, "--max-points", "2"]) == 0
    assert "Family in omega, 3 returns per period" in capsys.readouterr().out


@pytest.mark.parametrize("shape", ["bounce", "zeno,impact", "plastic,impact", "zeno*0"])
def test_a_shape_that_is_none_is_refused_in_one_line(
    shape: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main([*STRUCK, "--shape", shape])
    assert left.value.code == 2
    _one_line(capsys, "--shape: ", f"`{shape}`")


@pytest.mark.slow
def test_a_shape_that_is_not_there_is_a_no(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*STRUCK, "--shape", "impact", "--json"]) == 1
    assert not json.loads(capsys.readouterr().out)["found"]


@pytest.mark.slow
def test_an_orbit_to_start_from_has_the_shape_that_is_asked_for(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["search", "impact_oscillator", "--near", str(file), "--shape", "zeno"]) == 2
    _one_line(capsys, "must be the shape `impact*3` of the orbit to start from")
    moved = ["search", "impact_oscillator", "--near", str(file), "--set", "omega=0.51", "--json"]
    assert main(moved) == 0
    assert json.loads(capsys.readouterr().out)["shape"] == "impact*3"


@pytest.mark.slow
def test_a_margin_that_a_shape_has_not_is_no_bound_for_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["search", "impact_oscillator", "--vary", "A=0.5:2", "--objective", "energy"]
    assert main([*words, "--bounds", "locked_time=0.1:"]) == 2
    _one_line(capsys, "--bounds ", "`impact stop`", "`locked_time`")
