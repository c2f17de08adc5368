"""The command `continue`: its file, its table, its picture, its refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.reference.reference_orbit import RELEASE
from tests.support.cases import often
from tests.support.commands import YES, ask, examples
from zeno_orbits import write_orbit
from zeno_orbits.cli import main
from zeno_orbits.continuation import (
    Continuation,
    Family,
    FamilyPoint,
    SpecialCurve,
    SpecialPoint,
    SpecialPointKind,
)
from zeno_orbits.model import load_problem
from zeno_orbits.report import plots
from zeno_orbits.report import terminal as report
from zeno_orbits.search import orbit_by_shooting

PENDULUM = load_problem("motor_pendulum")
IMPACTS = [
    "forced_oscillator",
    "--section",
    "impact",
    "--set",
    "c=0.1",
    "--set",
    "stop=1",
    "--set",
    "restitution=0.8",
    "--start",
    "speed=1",
    "--start",
    "cosine=1",
]


@pytest.mark.slow
def test_a_family_is_written_printed_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, picture = tmp_path / "family.json", tmp_path / "family.png"
    words = ["continue", *IMPACTS, "--parameter", "A=0.05:1.1"]
    assert main([*words, "-o", str(file), "--plot", str(picture)]) == 0
    told = capsys.readouterr().out
    assert "first impact" in told
    assert "fold" in told
    data = json.loads(file.read_text())
    assert data["format"] == 1
    assert (data["problem"], data["parameter"]) == ("forced_oscillator", "A")
    (family,) = data["families"]
    assert [special["kind"] for special in family["special"]] == ["fold"]
    assert {end["kind"] for end in family["ends"]} == {"first impact grazes", "end of the range"}
    values = [point["value"] for point in family["points"]]
    assert min(values) > 0.0999
    assert max(values) == pytest.approx(1.1, abs=1e-12)
    assert {"period", "state", "multipliers", "stable", "margins", "miss"} <= set(
        family["points"][0]
    )
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_family_starts_at_an_orbit_file_and_prints_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    orbit = orbit_by_shooting(PENDULUM, PENDULUM.values()).unwrap()
    file = tmp_path / "orbit.json"
    write_orbit(orbit, file)
    words = [
        "continue",
        "motor_pendulum",
        "--near",
        str(file),
        "--parameter",
        "Kp=2.4:2.6",
        "--json",
    ]
    assert main(words) == 0
    (family,) = json.loads(capsys.readouterr().out)["families"]
    starts = [point for point in family["points"] if point["value"] == pytest.approx(2.5, abs=1e-9)]
    assert len(starts) == 1
    assert list(starts[0]["state"].values()) == pytest.approx(RELEASE, abs=1e-10)
    # An orbit file has all numbers; more would contradict it.
    assert main([*words, "--set", "Kp=2"]) == 2
    assert f"--near {file}: cannot be combined with --set: " in capsys.readouterr().err


@pytest.mark.slow
def test_parameters_that_a_map_would_derive_anew_are_told_to_be_held(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "orbit.json"
    write_orbit(orbit_by_shooting(PENDULUM, PENDULUM.values()).unwrap(), file)
    words = ["continue", "motor_pendulum", "--near", str(file), "--parameter"]
    assert main([*words, "m1=0.2998:0.3002"]) == 0
    told = capsys.readouterr().out
    assert "Derived, and held at their initial values: J_rotor, K_torque, K_emf." in told
    # Nothing follows from the resistance.
    assert main([*words, "R=2.998:3.002"]) == 0
    assert "held" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["motor_pendulum", "--parameter", "Kd"], "must be NAME=LOW:HIGH"),
        (
            ["motor_pendulum", "--parameter", "Kd=-2:0", "--kind", "fold"],
            "--kind fold: needs --parameter2",
        ),
        (
            [
                "motor_pendulum",
                "--parameter",
                "Kd=-2:0",
                "--parameter2",
                "Kp=1:5",
                "--kind",
                "cusp",
            ],
            "Known: fold",
        ),
        (["motor_pendulum", "--parameter", "Kd=-2:0", "--start", "theta1=1"], "--section impact"),
        (
            ["forced_oscillator", "--parameter", "A=1:2", "--section", "impact"],
            "--section impact: needs --start",
        ),
        (["motor_pendulum", "--parameter", "Kd=-2:0", "--plot", "a.jpg"], "must end in .png"),
    ],
)
def test_what_does_not_fit_is_refused_before_any_work(words: list[str], reason: str) -> None:
    answer = ask("continue", *words)
    assert answer.code == 2
    assert reason in answer.err


def point(value: float, radius: float) -> FamilyPoint:
    return FamilyPoint(
        value=value,
        state={"theta1": 0.0},
        period=1.0 + value,
        multipliers=(complex(radius),),
        margins={"amplitude": 2.0 - value, "speed of the first impact": 1.0},
        miss=0.0,
    )


def family(kind: SpecialPointKind) -> Family:
    points = tuple(point(0.1 * k, 0.6 + 0.1 * k) for k in range(9))
    special = SpecialPoint(kind=SpecialPointKind.FLIP, at=point(0.4, 1.0), error=1e-10, index=4)
    first = SpecialPoint(kind=SpecialPointKind.BOUND, at=points[0], error=0.0, index=0)
    return Family(
        problem="motor_pendulum",
        parameter="Kd",
        gains={},
        parameters={},
        n_returns=1,
        points=points,
        special=(special,),
        first=first,
        last=replace(first, kind=kind, at=points[-1], index=8),
    )


def test_a_picture_has_stable_orbits_solid_unstable_ones_dashed_and_names_points() -> None:
    figure = plots.plot_families(
        Continuation(families=(family(SpecialPointKind.GRAZING),)), PENDULUM, width=plots.FULL_WIDTH
    )
    period = figure.axes[0]
    lines = [line for line in period.lines if line.get_marker() in (None, "None", "")]
    assert {line.get_linestyle() for line in lines} == {"-", "--"}
    (legend,) = figure.legends
    words = {text.get_text() for text in legend.get_texts()}
    assert words == {"stable", "unstable", "flip", "first impact grazes"}
    assert period.get_ylabel() == "period [s]"
    assert period.get_xlabel() == "$K_{d}$ [V s/rad]"


def test_boundaries_are_drawn_over_both_parameters() -> None:
    boundary = SpecialCurve(
        kind=SpecialPointKind.FOLD,
        names=("Kp", "Kd"),
        x=(1.0, 2.0),
        y=(-1.0, -2.0),
        errors=(0.0, 0.0),
        ends=("end of the range", "end of the range"),
    )
    found = Continuation(families=(family(SpecialPointKind.BOUND),), boundaries=(boundary,))
    (ax,) = plots.plot_boundaries(found, PENDULUM).axes
    assert ax.get_xlabel() == "$K_{p}$ [V/rad]"
    assert ax.get_ylabel() == "$K_{d}$ [V s/rad]"
    assert ax.lines[0].get_label() == "fold"


def test_a_cusp_is_printed_and_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    boundary = SpecialCurve(
        kind=SpecialPointKind.FOLD,
        names=("Kp", "Kd"),
        x=(1.0, 2.0, 1.5),
        y=(-1.0, -2.0, -1.5),
        errors=(0.0, 0.0, 0.0),
        ends=("end of the range", "end of the range"),
        cusps=(1,),
    )
    found = Continuation(families=(family(SpecialPointKind.BOUND),), boundaries=(boundary,))
    (ax,) = plots.plot_boundaries(found, PENDULUM).axes
    marks = [line.get_xydata() for line in ax.lines if line.get_label() == "cusp"]
    assert [mark.tolist() for mark in marks] == [[[2.0, -2.0]]]
    report.print_families(found)
    assert "cusp at Kp = 2, Kd = -2." in capsys.readouterr().out


def test_giving_up_is_an_answer_of_no(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = replace(family(SpecialPointKind.GAVE_UP).last, detail="the tangent turns too fast")
    found = Continuation(families=(replace(family(SpecialPointKind.BOUND), last=lost),))
    monkeypatch.setattr("zeno_orbits.continuation.family_of_impacts", lambda *_, **__: found)
    assert main(["continue", *IMPACTS, "--parameter", "A=0.5:1.1"]) == 1
    told = capsys.readouterr().out
    assert "gave up: the tangent turns too fast" in told


@pytest.mark.slow
@pytest.mark.parametrize("number", often(2, (0, 4, 1, 3, 2)))
def test_an_example_of_the_help_runs(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_orbit(orbit_by_shooting(PENDULUM, PENDULUM.values()).unwrap(), tmp_path / "orbit.json")
    shown = examples("continue")
    assert len(shown) == 5
    answer = ask(*shown[number])
    assert answer.code == YES, answer.err
