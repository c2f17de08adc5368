"""The commands `compare` and `identify`, and the data that `simulate` writes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.support.commands import MISUSE, NO, YES, ask, examples
from zeno_orbits import write_orbit, write_recording
from zeno_orbits.experiment import Source, read_recording
from zeno_orbits.orbits import Orbit, read_orbit


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A recording as `simulate` writes it."""
    path = tmp_path_factory.mktemp("recorded") / "data.csv"
    answer = ask(
        *("simulate", "motor_pendulum", "--until", "28", "--rate", "200"),
        *("-o", path, "--noise", "1e-3"),
    )
    assert answer.code == YES, answer.err
    return path.read_bytes()


@pytest.fixture
def folder(tmp_path: Path, orbit: Orbit, recorded: bytes, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an orbit and a recording, to work in."""
    monkeypatch.chdir(tmp_path)
    write_orbit(orbit, tmp_path / "orbit.json")
    (tmp_path / "data.csv").write_bytes(recorded)
    for name, height in (("drop.csv", 0.5), ("drop2.csv", 0.7)):
        answer = ask(
            *("simulate", "bouncing_ball", "--until", "3", "--rate", "100", "--noise", "2e-3"),
            *("--start", f"height={height}", "-o", name),
        )
        assert answer.code == YES, answer.err
    drop = read_recording("drop.csv")
    height = drop.signal("height")
    by_camera = replace(height, values=1.3 * height.values + 0.2)
    write_recording(replace(drop, signals=(by_camera,)), "track.csv")
    measured = read_recording("data.csv")
    current, angle = (measured.signal(name) for name in ("current", "theta1"))
    write_recording(replace(measured, signals=(current,)), "current.csv")
    write_recording(replace(measured, signals=(angle,)), "video.csv")
    return tmp_path


def test_simulated_data_say_that_they_are(folder: Path) -> None:
    found = read_recording(folder / "data.csv")
    assert found.source is Source.SIMULATED
    assert found.problem == "motor_pendulum"
    assert dict(found.notes) == {"noise": "0.001", "seed": "0"}
    assert len(found.time) == 28 * 200 + 1


@pytest.mark.slow
def test_the_examples_of_compare_run(folder: Path) -> None:
    data: dict[str, Any] = {}
    for example in examples("compare"):
        answer = ask(*example)
        assert answer.code == YES, answer.err
        # A narrow table breaks the heading: `simulated` stands below `recording,`.
        headings = " ".join(answer.out.split("first impact")[0].split())
        is_orbit = "orbit.json" in example and "--json" not in example
        assert not is_orbit or ("recording," in headings and "simulated" in headings)
        if "--json" in example:
            data = json.loads(answer.out)
    assert (folder / "compared.png").stat().st_size > 50_000
    assert (folder / "drop.png").stat().st_size > 20_000
    # From 12 s on the motion still settles a little.
    assert data["metrics"]["period"]["data"] == pytest.approx(1.81371293904, abs=3e-3)


@pytest.mark.weekly
@pytest.mark.slow
def test_the_examples_of_identify_run(folder: Path) -> None:
    for example in examples("identify"):
        answer = ask(*example)
        assert answer.code == YES, answer.err
    assert read_orbit(folder / "fitted_orbit.json").parameters["R"] == pytest.approx(3.0, rel=0.02)


@pytest.mark.slow
def test_an_orbit_gives_its_values_to_identify(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    values = ("--set", "Kp=2.2", "--set", "R=2.9")
    assert ask("search", "motor_pendulum", *values, "-o", "orbit.json").code == YES
    noise = ("--until", "28", "--rate", "200", "--noise", "1e-3")
    assert ask("simulate", "motor_pendulum", *values, *noise, "-o", "data.csv").code == YES
    words = ("identify", "orbit.json", "data.csv", "--t-start", "12", "--fit", "R")
    answer = ask(*words, "--orbit", "fitted.json")
    assert answer.code == YES, answer.err
    fitted = read_orbit(tmp_path / "fitted.json")
    assert fitted.gains["Kp"] == 2.2
    assert fitted.parameters["R"] == pytest.approx(2.9, rel=0.02)


@pytest.mark.slow
def test_a_false_recording_is_a_no_with_the_reason(folder: Path) -> None:
    text = (folder / "data.csv").read_text()
    (folder / "data.csv").write_text(text.replace("theta1 [rad]", "theta1 [deg]"))
    answer = ask("compare", "orbit.json", "data.csv", "--t-start", "12")
    assert answer.code == NO
    assert "`theta1` looks like radians labelled as degrees" in answer.out
    answer = ask("identify", "motor_pendulum", "data.csv", "--t-start", "12", "--fit", "R")
    assert answer.code == NO
    assert "radians labelled as degrees" in answer.err
    assert answer.err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("compare", "orbit.json", "none.csv"), "cannot be read"),
        (("compare", "orbit.json", "data.csv", "--plot", "x.gif"), "must end in .png"),
        (("compare", "orbit.json", "data.csv", "--t-start", "99"), "must leave two rows"),
        (("identify", "motor_pendulum", "data.csv", "--fit", "R=2"), "must be NAME=LOW:HIGH"),
        (("identify", "motor_pendulum", "data.csv", "--fit", "R,,L"), "must be NAME or"),
        (("identify", "motor_pendulum", "data.csv", "--fit", "Kp"), "gains are known"),
        (("identify", "motor_pendulum", "data.csv", "--fit", "R=4:2"), "must have a range"),
        (
            ("identify", "motor_pendulum", "data.csv", "--fit", "R", "-o", "no/f.json"),
            "must be in a writable folder",
        ),
        (
            ("identify", "motor_pendulum", "data.csv", "--fit", "R", "-o", "./data.csv"),
            "must be another file than the one that is read",
        ),
        (
            ("identify", "motor_pendulum", "data.csv", "--fit", "R", "-o", "f", "--orbit", "f"),
            "--orbit f: must be another file than `output`",
        ),
        (
            ("identify", "motor_pendulum", "data.csv", "--fit", "R", "--problem", "relay"),
            "--problem relay: must come with an orbit file",
        ),
        (("simulate", "motor_pendulum", "-o", "d.csv", "--rate", "0"), "--rate 0: must be"),
        (("simulate", "motor_pendulum", "-o", "d.csv", "--rate", "1e12"), "two to 10000000"),
        (("simulate", "motor_pendulum", "-o", "d.csv", "--rate", "1e-3"), "two to 10000000"),
        (
            ("simulate", "motor_pendulum", "-o", "d.csv", "--noise", "-1"),
            "--noise -1: must lie in [0, 1)",
        ),
        (("simulate", "motor_pendulum", "-o", "no/d.csv"), "the folder `no` does not exist"),
    ],
)
def test_misuse_is_one_line(folder: Path, arguments: tuple[str, ...], reason: str) -> None:
    assert folder.exists()
    answer = ask(*arguments)
    assert answer.code == MISUSE
    assert reason in answer.err
    assert answer.err.count("\n") == 1


@pytest.mark.slow
def test_a_drop_is_identified_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("--until", "1.6", "--rate", "100", "--noise", "2e-3", "--set", "restitution=0.6")
    assert ask("simulate", "bouncing_ball", *words, "-o", "drop.csv").code == YES
    fit = ("identify", "bouncing_ball", "drop.csv", "--fit", "restitution")
    answer = ask(*fit, "-o", "fitted.json", "--plot", "drop.png")
    assert answer.code == YES, answer.err
    assert answer.out.startswith("Model: no structure is left")
    data = json.loads((tmp_path / "fitted.json").read_text())
    low, high = data["fitted"]["restitution"]["interval"]
    assert low < 0.6 < high
    assert high - low < 0.01
    assert data["period"] is None
    assert (tmp_path / "drop.png").stat().st_size > 20_000
    compare = ("compare", "bouncing_ball", "drop.csv", "--set")
    assert ask(*compare, "restitution=0.6").code == YES
    answer = ask(*compare, "restitution=0.5", "--json")
    assert answer.code == NO
    assert json.loads(answer.out)["structure_left"] is True
    (tmp_path / "heard.csv").write_text("impact [s]\n1\n1.4\n1.68\n1.876\n", encoding="utf-8")
    answer = ask("read", "heard.csv")
    assert answer.code == YES
    assert "times of events" in answer.out
    answer = ask(*fit[:2], "heard.csv", "--fit", "restitution", "--initial", "height")
    assert answer.code == YES, answer.err


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--transient", "--orbit", "x.json"), "must go without --transient"),
        (("--initial", "hight"), "Did you mean `height`?"),
        (("--initial", "height,"), "must be NAME,NAME"),
        (("--start", "hight=1"), "Did you mean `height`?"),
        (("--trial", "none.csv"), "cannot be read"),
        (("--plot", "x.gif"), "must end in .png"),
    ],
)
def test_wrong_options_of_transients_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], reason: str
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("--until", "1.6", "--rate", "100")
    assert ask("simulate", "bouncing_ball", *words, "-o", "drop.csv").code == YES
    answer = ask("identify", "bouncing_ball", "drop.csv", "--fit", "restitution", *arguments)
    assert answer.code == MISUSE
    assert reason in answer.err
    assert not list(tmp_path.glob("x.*"))
