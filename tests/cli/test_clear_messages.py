"""Mistakes at the start: one line with the option as typed, the problem and the remedy."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from tests.support.commands import (
    INTERRUPTED,
    MISUSE,
    NO,
    YES,
    ask,
    assert_refused,
    contents,
    interrupted_when,
    raising,
)
from tests.support.orbits import event_orbit
from zeno_orbits import api

pytestmark = pytest.mark.usefixtures("here")

MAP = ("map", "motor_pendulum", "--x", "Kp=2:3", "--y", "Kd=-2:-1")
SEARCH = ("search", "motor_pendulum")
REFUSED: Mapping[str, tuple[tuple[str, ...], str]] = {
    "a problem where an orbit belongs": (
        ("verify", "motor_pendulum"),
        "ORBIT.json: `motor_pendulum` is a problem: run "
        "`zeno-orbits search motor_pendulum -o orbit.json` first.",
    ),
    "a problem file where an orbit belongs": (("plot", "mine.py"), "`mine.py` is a problem: run"),
    "decimal comma": (
        ("simulate", "motor_pendulum", "--set", "Kp=2,5"),
        "--set: must have a number for `Kp`, but it is `2,5`. Write a decimal point: 2.5.",
    ),
    "several names": (
        ("simulate", "motor_pendulum", "--start", "theta1=1,theta2=2"),
        "--start: must have a number for `theta1`, but it is `1,theta2=2`. Repeat the option",
    ),
    "range with a count": (
        ("continue", "motor_pendulum", "--parameter", "restitution=0:0.5:3"),
        "--parameter: must be NAME=LOW:HIGH, but it is `restitution=0:0.5:3`.",
    ),
    "beginning of a name": (
        ("continue", "motor_pendulum", "--parameter", "rest=0:0.5"),
        "unknown parameter `rest`. Did you mean `restitution`? Known: ",
    ),
    "several stops": (
        ("zeno-condition", "clapper"),
        "`clapper` has 2 stops, and the Zeno condition is computed for one. Run `simulate`",
    ),
    "no count": ((*MAP[:-1], "Kd=-2:-1:0"), "--y: must have a COUNT of at least 2 points"),
    "two counts": ((*MAP[:-1], "Kd=-2:-1:4:5"), "--y: "),
    "spreadsheet": (
        (*SEARCH, "-o", "out.xlsx"),
        "-o out.xlsx: must name a JSON file, such as out.json.",
    ),
    "spreadsheet of a map": (
        (*MAP, "-o", "m.xlsx"),
        "-o m.xlsx: must name a JSON file, such as m.json.",
    ),
    "empty output": ((*SEARCH, "-o", ""), "-o: the value is empty."),
    "empty output after =": ((*SEARCH, "--output="), "--output: the value is empty."),
    "empty name": (("new", ""), "NAME: the value is empty."),
    "short option": ((*MAP, "-j", "0"), "-j: must be a positive whole number, but it is `0`"),
    "short option with its value": ((*MAP, "-j0"), "-j: must be a positive whole number"),
    "long option": ((*MAP, "--workers", "0"), "--workers: must be a positive whole number"),
    "file of an option": (
        (*SEARCH, "--near", "none.json"),
        "--near none.json: Orbit file `none.json` cannot be read",
    ),
    "orbit of a map": ((*MAP, "--orbit", "none.json"), "--orbit none.json: Orbit file `none.json`"),
    "problem of a wrong name": (
        ("simulate", "motor_pendulm"),
        "PROBLEM motor_pendulm: unknown problem `motor_pendulm`. Did you mean `motor_pendulum`? "
        "Known: bouncing_ball, ",
    ),
    "name with a digit": (
        ("new", "1abc"),
        "NAME 1abc: must begin with a letter and hold letters, digits and underscores only",
    ),
    "objective without a number": (
        (*SEARCH, "--objective", "period"),
        "--objective: `period` lacks its value. Write period=SECONDS.",
    ),
    "endless": (
        ("simulate", "motor_pendulum", "--until", "inf"),
        "--until inf: must be a finite, positive number of seconds, but it is inf.",
    ),
    "objective without value": (
        (*SEARCH, "--objective", "period="),
        "--objective: `period=` lacks its value. Write period=SECONDS.",
    ),
    "objective with a value": ((*SEARCH, "--objective", "energy=3"), "`energy` takes no value"),
    "objective of a wrong name": (
        (*SEARCH, "--objective", "enrgy"),
        "--objective: unknown objective `enrgy`. Did you mean `energy`? Known: nearest, ",
    ),
    "part of a wrong value": (
        ("rig", "motor_pendulum", "--part", "contact.stiffness=-1"),
        "--part contact.stiffness=-1: must be greater than 0, but it is -1.",
    ),
    "parameter of a wrong name": (
        ("continue", "motor_pendulum", "--parameter", "Q=1:2"),
        "--parameter Q=1:2: unknown parameter `Q`. Known: Kp, Kd, ",
    ),
    "noise without a file": (
        ("simulate", "motor_pendulum", "--noise", "1e-3"),
        "--noise 1e-3: needs -o DATA.csv: it changes the file alone.",
    ),
    "rate without a file": (
        ("simulate", "motor_pendulum", "--rate", "100"),
        "--rate 100: needs -o DATA.csv: it changes the file alone.",
    ),
    "noise of a rig without a file": (
        ("rig", "bouncing_ball", "--noise", "0.1"),
        "--noise 0.1: needs -o DATA.csv: it changes the file alone.",
    ),
    "recording as JSON": (
        ("simulate", "motor_pendulum", "-o", "a.json"),
        "-o a.json: must name a table of samples, such as a.csv: --json prints JSON.",
    ),
    "recording of a rig as JSON": (
        ("rig", "motor_pendulum", "-o", "a.json"),
        "-o a.json: must name a table of samples, such as a.csv: --json prints JSON.",
    ),
    "recording of a rig as a picture": (
        ("rig", "motor_pendulum", "-o", "a.png"),
        "-o a.png: must name a table of samples, such as a.csv",
    ),
    "two values for one option": (
        ("simulate", "motor_pendulum", "--set", "Kp=2", "Kd=-1"),
        "Unrecognized arguments: Kd=-1. Give every value with its own option: --set Kd=-1.",
    ),
    "option that sets gains": (
        (*SEARCH, "--gains", "Kp=2"),
        "--gains: unknown option. Did you mean `--set`?",
    ),
    "section of one stop": (
        (*SEARCH, "--section", "release"),
        "must be an event of the motion (impact stop, release stop, zeno stop), "
        "but it is `release`.",
    ),
    "milliseconds": (
        (*SEARCH, "--vary", "Kp=1:5", "--objective", "period=1800"),
        "--objective period=1800: asks for a period of 1800 s, but the orbits seen have periods of "
        "1.666 to 1.946 s. Give the period in seconds.",
    ),
}


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(one, marks=[pytest.mark.slow] if one == "milliseconds" else [])
        for one in REFUSED
    ],
)
def test_a_mistake_is_one_line_with_its_remedy(case: str) -> None:
    words, told = REFUSED[case]
    answer = ask(*words)
    assert_refused(answer)
    assert told in answer.err


def test_a_negative_number_with_an_exponent_is_a_value(orbit_file: Path) -> None:
    answer = ask("compare", orbit_file, "none.csv", "--t-start", "-1e-1")
    assert "Data file `none.csv` cannot be read" in answer.err
    missing = ask("compare", orbit_file, "none.csv", "--t-start")
    assert_refused(missing, "--t-start: a value is missing.")


@pytest.mark.slow
def test_the_axes_of_a_map_may_give_their_number_of_points() -> None:
    one = ask("map", "bouncing_ball", "--x", "m=1:2:3", "--y", "g=5:9:2", "-j", "1", "--json")
    assert [one.data[side]["count"] for side in "xy"] == [3, 2]
    words = ("--x", "m=1:2:3", "--y", "g=5:9", "--grid", "7x2", "-j", "1", "--json")
    assert ask("map", "bouncing_ball", *words).data["x"]["count"] == 3


@pytest.mark.parametrize(("angle", "turns"), [("60", "9.55"), ("-90", "14.3")])
def test_a_start_in_degrees_is_noted(angle: str, turns: str) -> None:
    words = ("simulate", "motor_pendulum", f"--start=theta1={angle}", "--until", "0.01")
    answer = ask(*words)
    note = f"note: --start theta1={angle}: in radians this is {turns} turns"
    assert answer.err.count("\n") == 1
    assert note in answer.err
    assert ask(*words[:-2], "--start=theta2=3", "--until", "0.01").err.count("theta2") == 0


@pytest.mark.slow
def test_continue_takes_an_orbit_file_as_the_function_takes_an_orbit(orbit_file: Path) -> None:
    words = ("--parameter", "Kp=2.4:2.6", "-j", "1", "--json")
    by_command = ask("continue", orbit_file, *words)
    assert by_command.code == YES
    by_function = zo.continue_orbit(orbit_file, ("Kp", 2.4, 2.6))
    assert by_command.data == json.loads(json.dumps(by_function.as_json()))
    assert "not needed" in ask("continue", orbit_file, "--near", orbit_file, *words).err


@pytest.mark.slow
def test_the_orbit_of_an_own_problem_is_continued_with_its_file(tmp_path: Path) -> None:
    assert ask("new", "mine").code == YES
    zo.write_orbit(zo.find_orbit("mine.py").unwrap(), "orbit.json")
    (tmp_path / "far").mkdir()
    Path("mine.py").rename(tmp_path / "far" / "mine.py")
    words = ("continue", "orbit.json", "--parameter", "c=0.99:1.01", "-j", "1")
    assert "--problem" in ask(*words).err
    assert ask(*words, "--problem", tmp_path / "far" / "mine.py").code == YES


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ('{"a": 1', "it is not complete JSON"),
        ("{}", "curves are missing. `continue --parameter2 ... -o FILE` writes boundary files."),
    ],
)
def test_a_broken_file_of_boundaries_is_named(content: str, told: str) -> None:
    Path("b.json").write_text(content)
    answer = ask(*MAP, "--plot", "m.png", "--boundaries", "b.json")
    assert_refused(answer, "--boundaries b.json: Boundary file `b.json`: ", told)


@pytest.mark.parametrize(
    ("problem", "cause"),
    [
        ("clapper", "has several stops"),
        ("limited_pendulum", "has a kink of the state"),
        ("hopper", "has "),
    ],
)
def test_a_study_names_what_a_machine_of_further_modes_has(problem: str, cause: str) -> None:
    told = f"one flow off the stop and one on it are needed here, but `{problem}` {cause}"
    assert_refused(ask("work-precision", problem), told)


BROKEN: Mapping[str, tuple[Any, str]] = {
    "no entry": ({}, "`format` must be a positive whole number, but it is missing."),
    "list": ([1], "must be an object with names, but it is [1]."),
    "newer": (
        {"format": 9},
        "its format is 9, and the newest this version reads is 3. Update zeno_orbits.\n",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_orbit_file_is_named_with_the_command_that_writes_one(case: str) -> None:
    content, told = BROKEN[case]
    Path("broken.json").write_text(json.dumps(content))
    for command in ("verify", "stability", "prove"):
        answer = ask(command, "broken.json")
        assert_refused(answer, "Orbit file `broken.json`: ", told)
        # A newer file is an orbit file: writing another one is no remedy.
        assert ("`search PROBLEM -o FILE` writes" in answer.err) == (case != "newer")
        assert "must hold" not in answer.err


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["one stop", "events"])
def test_a_billion_periods_are_refused_before_anything_is_integrated(
    kind: str, orbit_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "events":
        zo.write_orbit(event_orbit("hopper"), orbit_file)
    monkeypatch.setattr(api, "verify", raising(AssertionError("integrated")))
    answer = ask("verify", orbit_file, "--periods", "1000000000")
    assert_refused(answer, "--periods 1000000000: needs more steps than a simulation may take: ver")


def test_an_abandoned_folder_of_this_user_is_removed_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    names = ("zeno-orbits-0123abcd", "zeno-orbits-89abcdef", "other-012345678")
    folders = [tmp_path / name for name in names]
    for folder in folders:
        folder.mkdir()
        (folder / "part").write_text("1")
    (tmp_path / "zeno-orbits-link0000").symlink_to(folders[2], target_is_directory=True)
    old = time.time() - 8 * 86_400
    for folder in (folders[0], folders[2]):
        os.utime(folder, (old, old))
    # The checkpoint of a map is made before its first point.
    words = ("map", "bouncing_ball", "--x", "m=1:2", "--y", "g=5:9", "--grid", "2x2", "-j", "1")
    with interrupted_when(lambda _stage, _part: True):
        assert ask(*words).code == INTERRUPTED
    assert [folder.exists() for folder in folders] == [False, True, True]


def test_too_many_periods_are_refused_with_the_remedy(
    orbit_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = api.verification_settings

    def settings(**asked: Any) -> zo.VerificationSettings:
        one = made(**asked)
        return replace(one, simulation=replace(one.simulation, most_steps=500))

    monkeypatch.setattr(api, "verification_settings", settings)
    answer = ask("verify", orbit_file, "--periods", "2000")
    assert_refused(answer, "--periods 2000: needs more steps than a simulation may take: verify")


@pytest.mark.slow
def test_an_export_without_a_compiler_is_one_line(here: Path) -> None:
    # Other code than that of any installed package, whose library would serve this one as well.
    source = Path(zo.__file__).parents[1]
    for name in ("zeno_orbits", "problems"):
        shutil.copytree(source / name, here / name)
    with (here / "zeno_orbits/loop/check.c").open("a") as code:
        code.write("/* Other code. */\n")
    environment = {**os.environ, "CC": "nothing", "ZENO_ORBITS_CACHE": str(here / "cache")}
    environment["PYTHONPATH"] = str(here)
    words = [sys.executable, "-m", "zeno_orbits", "export", "motor_pendulum", "-o", "c"]
    ended = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert "cannot be exported: `CC` must name a C compiler" in ended.stderr


def test_what_a_problem_file_prints_is_not_among_the_json() -> None:
    assert ask("new", "mine").code == YES
    text = Path("mine.py").read_text().replace("    q, v =", '    print("in model")\n    q, v =')
    Path("mine.py").write_text(f'print("at the top")\n{text}')
    answer = ask("simulate", "mine.py", "--until", "0.1", "--json")
    assert answer.data["problem"] == "mine"
    assert "at the top" in answer.err
    assert "in model" in answer.err
    refused = ask("simulate", "mine.py", "--until", "-1", "--json")
    assert refused.data["error"] == "InputError"


RESTING = """
import casadi as ca
import zeno_orbits as zo


def model(p):
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    stops = tuple(
        zo.Stop(name=name, gap=gap, restitution=0.5)
        for name, gap in (("left", 1 + q), ("right", 1 - q))
    )
    mass = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=q**2 / 2, passive_force=-p["c"] * v, stops=stops
    )
    return zo.hybrid_system(mass, zo.no_drive(mass))


PROBLEM = zo.Problem(
    name="resting",
    title="a damped mass between two stops",
    source="tests",
    state_names=("q", "v"),
    state_units=("m", "m/s"),
    parameters=(zo.Quantity.positive("c", 0.2, "1/s", "damping"),),
    gains=(),
    model=model,
    starts=({"v": 5.0},),
    portraits=(("q", "v"),),
    amplitude_of="q",
)
"""


@pytest.mark.parametrize("start", ["5", "0.1"])
def test_a_search_whose_motion_comes_to_rest_says_so(start: str) -> None:
    Path("resting.py").write_text(RESTING)
    answer = ask("search", "resting.py", "--start", f"v={start}", "-o", "o.json")
    assert answer.code == NO
    assert "comes to rest" in answer.out
    assert "longer" not in answer.out


_OSCILLATOR = """
import casadi as ca
import zeno_orbits as zo

print("The file runs.")

def model(p):
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    clock = zo.Time() if {timed} else None
    mass = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=p["m"] * v**2 / 2, potential=p["k"] * q**2 / 2, gap=q + 1, clock=clock
    )
    return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"])

PROBLEM = zo.Problem(
    name="oscillator",
    title="mass on a spring, far from its stop",
    source="a test",
    state_names=("q", "v", *(["t"] if {timed} else [])),
    state_units=("m", "m/s", *(["s"] if {timed} else [])),
    parameters=(
        zo.Quantity.positive("m", 1.0, "kg", "mass"),
        zo.Quantity.positive("k", 1.0, "N/m", "stiffness"),
        zo.Quantity.restitution(0.5),
    ),
    gains=(),
    model=model,
    starts=({{"q": 0.5}},),
    portraits=(("q", "v"),),
    amplitude_of="q",
)
"""


def _oscillator(*, timed: bool) -> str:
    """Write the file of a mass on a spring, and return its name."""
    Path("oscillator.py").write_text(_OSCILLATOR.format(timed=timed))
    return "oscillator.py"


@pytest.mark.parametrize("command", ["search", "continue"])
def test_a_motion_without_events_is_told_as_such(command: str) -> None:
    words = ["--parameter", "m=1:2"] if command == "continue" else []
    answer = ask(command, _oscillator(timed=False), *words)
    assert answer.code == NO
    told = f"{answer.out}{answer.err}"
    assert "No event occurred in the simulated time. An orbit needs an impact or a switch." in told
    assert "settled" not in told
    # From beyond its stop it has impacts, and comes to rest.
    if command == "search":
        struck = ask(command, "oscillator.py", "--start", "q=3")
        assert "No event occurred" not in struck.out


@pytest.mark.parametrize("command", ["search", "continue", "map"])
def test_a_machine_with_a_time_has_no_orbit_in_any_command(command: str) -> None:
    words = {
        "search": [],
        "continue": ["--parameter", "m=1:2"],
        "map": ["--x", "m=1:2", "--y", "k=1:2"],
    }
    answer = ask(command, _oscillator(timed=True), *words[command])
    assert answer.code == MISUSE
    assert "its clock is a `zo.Time`" in answer.err
    assert "longer" not in answer.err


def test_a_problem_file_is_executed_once_per_content() -> None:
    file = _oscillator(timed=False)
    assert ask("simulate", file, "--until", "1").out.count("The file runs.") == 1
    # A changed file is executed again.
    Path(file).write_text(Path(file).read_text().replace("The file runs.", "It runs again."))
    assert ask("simulate", file, "--until", "1").out.count("It runs again.") == 1


@pytest.mark.slow
def test_workers_do_not_repeat_what_a_problem_file_prints(
    capfd: pytest.CaptureFixture[str],
) -> None:
    words = ["--x", "m=1:2", "--y", "k=1:2", "--grid", "2x2", "--until", "20", "-j", "2"]
    answer = ask("map", _oscillator(timed=False), *words)
    said = capfd.readouterr()
    assert f"{answer.out}{answer.err}{said.out}{said.err}".count("The file runs.") == 1


@pytest.mark.parametrize("form", [["-o", "{}"], ["-o{}"], ["--output={}"], ["--plot", "{}"]])
def test_a_file_with_a_slash_at_its_end_is_refused(here: Path, form: list[str]) -> None:
    words = [one.format("run.png/" if form[0] == "--plot" else "run/") for one in form]
    answer = ask("simulate", "bouncing_ball", "--until", "1", *words)
    assert_refused(answer, "names a folder: add the name of the file")
    assert contents(here) == {}
    if form[0] != "--plot":
        words = [one.rstrip("/") for one in words]
        assert ask("simulate", "bouncing_ball", "--until", "1", *words).code == YES
        assert Path("run").is_file()
