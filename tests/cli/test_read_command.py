"""The command `read`: what it prints of a file, what it writes, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.commands import MISUSE, NO, YES, ask, examples
from zeno_orbits.experiment import read_recording

TRACK = "frame,y\n" + "".join(f"{k},{512 - k * k}\n" for k in range(12))
SAID = (
    *("--frame-rate", "200", "--column", "y=height"),
    *("--unit", "height=-0.5 mm", "--zero", "height=512"),
)


@pytest.fixture
def track(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a track in pixels, to work in."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "track.csv"
    path.write_text(TRACK)
    return path


def test_a_track_in_pixels_becomes_a_recording_in_metres(track: Path) -> None:
    answer = ask("read", track.name, *SAID, "-o", "drop.csv")
    assert answer.code == YES, answer.err
    assert "A recording of 12 rows from 0 to 0.055 s, 200 rows a second." in answer.out
    assert "Written: drop.csv" in answer.out
    found = read_recording(track.parent / "drop.csv")
    assert found.signal("height").unit == "m"
    assert found.signal("height").values == pytest.approx([5e-4 * k * k for k in range(12)])


def test_a_part_is_written(track: Path) -> None:
    words = ("--t-start", "0.01", "--t-end", "0.02", "-o", "part.csv")
    assert ask("read", track.name, *SAID, *words).code == YES
    assert read_recording(track.parent / "part.csv").time == pytest.approx([0.01, 0.015, 0.02])


def test_what_cannot_be_used_is_named(track: Path) -> None:
    answer = ask("read", track.name, "--frame-rate", "200")
    assert answer.code == NO
    assert "Not a recording: no column is a signal with a unit." in answer.out
    assert "column `y` lacks a unit: write for instance `y [rad]`" in answer.out


def test_the_description_is_data(track: Path) -> None:
    answer = ask("read", track.name, *SAID, "--json")
    data = json.loads(answer.out)
    assert data["rows"] == 12
    assert data["rows_per_second"] == pytest.approx(200.0)
    assert [one["role"] for one in data["columns"]] == ["time", "signal"]
    assert data["columns"][1]["extent"] == pytest.approx([0.0, 0.0605, 0])


def test_signals_of_a_problem_are_known(track: Path) -> None:
    track.write_text("time [s],theta1 [deg],other [m]\n0,1,2\n1,2,3\n")
    answer = ask("read", track.name, "--problem", "motor_pendulum")
    assert answer.code == YES
    assert "not a signal of the problem" in " ".join(answer.out.split())
    track.write_text("time [s],theta1 [m]\n0,1\n1,2\n")
    answer = ask("read", track.name, "--problem", "motor_pendulum")
    assert answer.code == NO
    assert "the signal is in rad" in answer.out


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--column", "z=height"), "--column z=height: unknown name `z`. Known: frame, y"),
        (("--column", "y"), "must be NAME=TEXT"),
        (("--unit", "y=furlong"), "--unit y=furlong: `furlong` is not a unit"),
        (("--unit", "z=m"), "--unit z=m: unknown name `z`"),
        (("--zero", "y=low"), "have a number for `y`"),
        (("--frame-rate", "0"), "--frame-rate 0: must be a positive number"),
        (("--frame-rate", "200", "-o", "drop.csv"), "needs a recording, and the file is none"),
        (("--unit", "y=m", "--unit", "y=mm"), "must name `y` once"),
        (("--problem", "none.py"), "none.py"),
        (("-o", "drop.json"), "must name a table of samples"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(
    track: Path, words: tuple[str, ...], reason: str
) -> None:
    answer = ask("read", track.name, *words)
    assert answer.code == MISUSE
    assert reason in answer.err
    assert answer.err.count("\n") == 1
    assert sorted(path.name for path in track.parent.iterdir()) == ["track.csv"]


def test_the_examples_run(track: Path) -> None:
    for name in ("data.csv", "video.csv", "logger.csv"):
        (track.parent / name).write_text("time [s],theta1 [deg]\n0,1\n1,2\n")
    for words in examples("read"):
        answer = ask(*words)
        assert answer.code == YES, answer.err


def test_a_file_that_is_missing_is_named(track: Path) -> None:
    answer = ask("read", "none.csv")
    assert answer.code == MISUSE
    assert "none.csv" in answer.err
    assert track.exists()
