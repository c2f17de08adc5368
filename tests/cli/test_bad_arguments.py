"""Bad arguments: each is refused in one line that names it, and leaves nothing behind."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.support.commands import (
    PUBLISHED_GAINS,
    YES,
    ask,
    assert_refused,
    contents,
)

pytestmark = pytest.mark.usefixtures("here")


def simulating(*arguments: str) -> tuple[str, ...]:
    return ("simulate", "motor_pendulum", *arguments)


def searching(*arguments: str) -> tuple[str, ...]:
    return ("search", "motor_pendulum", "-o", "f.json", *arguments)


BAD_ARGUMENTS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "unknown command": (("frobnicate",), ("frobnicate", "search")),
    "command with a slip": (("serach", "motor_pendulum"), ("`serach`. Did you mean `search`?",)),
    "option with a slip": (searching("--vray", "Kp=1:2"), ("--vray", "Did you mean `--vary`?")),
    "choice with a slip": (simulating("--engine", "explict"), ("Did you mean `explicit`?",)),
    "problem with a slip": (("search", "motor_pendulm"), ("Did you mean `motor_pendulum`?",)),
    "gain with a slip": (simulating("--set", "kp=1"), ("`kp`. Did you mean `Kp`?",)),
    "parameter with a slip": (simulating("--set", "restution=0"), ("mean `restitution`?",)),
    "state with a slip": (simulating("--start", "thta2=1"), ("Did you mean `theta2`?",)),
    "objective with a slip": (searching("--objective", "enrgy"), ("Did you mean `energy`?",)),
    "gain with a wrong letter": (simulating("--set", "Kq=1"), ("Did you mean `Kp`?",)),
    "bound with a slip": (searching("--bounds", "curent=:1"), ("Did you mean `current`?",)),
    "part with a slip": (
        ("rig", "motor_pendulum", "--part", "contact.stifness=1e5"),
        ("Did you mean `contact.stiffness`?",),
    ),
    "family in an unknown number": (
        ("continue", "motor_pendulum", "--parameter", "e=0:0.5"),
        ("--parameter", "`e`", "restitution"),
    ),
    "unknown option": (("problems", "--frobnicate"), ("--frobnicate",)),
    "no problem": (("simulate",), ("Missing: PROBLEM.",)),
    "no value": (simulating("--until"), ("--until: a value is missing.",)),
    "unknown problem": (("search", "pendulum"), ("`pendulum`", "motor_pendulum")),
    "unknown problem, conditions": (
        ("zeno-condition", "pendulum"),
        ("`pendulum`", "motor_pendulum"),
    ),
    "unknown parameter": (simulating("--set", "m3=1"), ("`m3`", "m2")),
    "unknown gain": (simulating("--set", "Ki=1"), ("`Ki`", "Kp")),
    "unknown gain to search": (searching("--vary", "Ki=1:2"), ("`Ki`", "Kp")),
    "unknown gain to fix": (searching("--set", "Ki=1"), ("`Ki`", "Kp")),
    "gain of a problem without gains": (("simulate", "bouncing_ball", "--set", "Kp=1"), ("Kp",)),
    "gain starts outside": (
        searching("--set", "Kp=9", "--vary", "Kp=1:3"),
        ("--set Kp=9:", "[1, 3]"),
    ),
    "gain not a number": (searching("--set", "Kp=abc"), ("Kp", "`abc`")),
    "gain not finite": (searching("--set", "Kp=inf"), ("Kp", "finite")),
    "bounds reversed": (searching("--vary", "Kp=5:1"), ("Kp", "5:1")),
    "bounds equal": (searching("--vary", "Kp=2:2"), ("Kp", "2:2")),
    "bounds not finite": (searching("--vary", "Kp=1:inf"), ("Kp", "inf")),
    "bounds twice": (searching("--vary", "Kp=1:5", "--vary", "Kp=2:3"), ("Kp", "twice")),
    "parameter unknown": (searching("--vary", "Q=1:2"), ("--vary", "`Q`", "restitution")),
    "parameter beyond its range": (searching("--vary", "restitution=0.1:1.1"), ("restitution",)),
    "parameter reversed": (searching("--vary", "R=4:2"), ("R", "4:2")),
    "parameter starts outside": (searching("--vary", "R=2:4", "--set", "R=9"), ("R", "9")),
    "parameter without colon": (searching("--vary", "R=1"), ("--vary", "LOW:HIGH")),
    "bound unknown": (searching("--bounds", "angle=:1"), ("--bounds", "`angle`", "theta2")),
    "bound without colon": (searching("--bounds", "theta2=1"), ("--bounds", "LOWER:UPPER")),
    "bound of nothing": (searching("--bounds", "theta2=:"), ("theta2", "finite")),
    "bound reversed": (searching("--bounds", "theta2=2:1"), ("theta2", "2:1")),
    "bound twice": (
        searching("--bounds", "period=:2", "--bounds", "period=1:"),
        ("--bounds", "twice"),
    ),
    "peak of nothing": (searching("--objective", "peak"), ("--objective", "peak=SIGNAL")),
    "peak unknown": (searching("--objective", "peak=torque"), ("`torque`", "voltage")),
    "contraction of what is fixed": (
        searching(*PUBLISHED_GAINS, "--objective", "contraction"),
        ("--objective", "contraction"),
    ),
    "from nowhere": (searching("--near", "none.json"), ("none.json",)),
    "candidates 0": (searching("--candidates", "0"), ("--candidates", "`0`")),
    "bounds without colon": (searching("--vary", "Kp=1"), ("LOW:HIGH", "`Kp=1`")),
    "bounds not numbers": (searching("--vary", "Kp=a:b"), ("Kp", "`a`")),
    "mass negative": (simulating("--set", "m1=-0.3"), ("m1", "greater than 0", "-0.3")),
    "mass zero": (simulating("--set", "m1=0"), ("m1", "greater than 0")),
    "restitution 1.2": (simulating("--set", "restitution=1.2"), ("restitution", "[0, 1]", "1.2")),
    "restitution -0.1": (simulating("--set", "restitution=-0.1"), ("restitution", "-0.1")),
    "restitution nan": (simulating("--set", "restitution=nan"), ("restitution", "nan")),
    "restitution inf": (simulating("--set", "restitution=inf"), ("restitution", "inf")),
    "restitution 1, conditions": (
        ("zeno-condition", "motor_pendulum", "--set", "restitution=1"),
        ("--set restitution=1", "less than 1", "a Zeno point"),
    ),
    "parameter without value": (simulating("--set", "m1"), ("NAME=VALUE", "m1")),
    "parameter without name": (simulating("--set", "=1"), ("NAME=VALUE", "`=1`")),
    "parameter not a number": (simulating("--set", "m1=abc"), ("m1", "`abc`")),
    "parameter empty": (simulating("--set", "m1="), ("m1", "number")),
    "parameter twice": (simulating("--set", "m1=1", "--set", "m1=2"), ("m1", "twice")),
    "no rotor inertia: link 2 too long": (
        simulating("--set", "I2=0.02"),
        ("no rotor inertia", "0.355825", "1.48333"),
    ),
    "no rotor inertia: link 1 too long": (
        simulating("--set", "lc1=3"),
        ("no rotor inertia", "J_rotor must not be negative"),
    ),
    "until 0": (simulating("--until", "0"), ("--until", "positive")),
    "until negative": (simulating("--until", "-1"), ("--until", "positive")),
    "until nan": (simulating("--until", "nan"), ("--until", "nan")),
    "until infinite": (simulating("--until", "inf"), ("--until", "inf")),
    "until not a number": (simulating("--until", "soon"), ("--until", "`soon`")),
    "unknown state": (simulating("--start", "phi=1"), ("`phi`", "theta1")),
    "start not finite": (simulating("--start", "theta1=nan"), ("theta1", "nan")),
    "start inside the stop": (simulating("--start", "theta2=-0.1"), ("gap >= 0", "-0.1")),
    "objective unknown": (searching("--objective", "speed"), ("--objective", "`speed`", "energy")),
    "objective empty": (searching("--objective", ""), ("--objective: the value is empty",)),
    "objective of no stop": (searching("--objective", "impacts="), ("--objective", "`impacts=`")),
    "objective twice": (
        searching("--objective", "energy", "--objective", "margin"),
        ("--objective", "once", "energy and margin"),
    ),
    "number with an underscore": (searching("--set", "Kp=2_5"), ("Kp", "`2_5`")),
    "bounds with an underscore": (searching("--vary", "Kp=1_0:20"), ("Kp", "`1_0`")),
    "radius too small": (
        searching("--bounds", "spectral_radius=:1e-5"),
        ("`spectral_radius`", "0.0001", ":1e-05"),
    ),
    "period without target": (searching("--objective", "period"), ("`period` lacks its value",)),
    "period negative": (searching("--objective", "period=-1"), ("--objective", "-1")),
    "period zero": (searching("--objective", "period=0"), ("--objective", "positive")),
    "period not finite": (searching("--objective", "period=nan"), ("--objective", "nan")),
    "amplitude negative": (searching("--objective", "amplitude=-2"), ("--objective", "-2")),
    "energy with a target": (searching("--objective", "energy=3"), ("--objective",)),
    "nearest an unknown gain": (searching("--objective", "nearest:Ki=1"), ("`Ki`", "Kp")),
    "nearest a fixed gain": (
        searching("--set", "Kp=2", "--objective", "nearest:Kp=3"),
        ("Kp", "Kd"),
    ),
    "nearest without value": (searching("--objective", "nearest:Kp"), ("NAME=VALUE", "Kp")),
    "period with all gains fixed": (
        searching(*PUBLISHED_GAINS, "--objective", "period=1.8"),
        ("--objective", "Add --vary NAME=LOW:HIGH"),
    ),
    "starts 0": (searching("--n-starts", "0"), ("--n-starts", "`0`")),
    "starts negative": (searching("--n-starts", "-3"), ("--n-starts", "`-3`")),
    "seed not a number": (searching("--seed", "x"), ("--seed", "`x`")),
    "seed negative": (searching("--seed", "-1"), ("seed",)),
    "search into a missing folder": (
        ("search", "motor_pendulum", "-o", "none/f.json"),
        ("-o ", "none/f.json"),
    ),
    "search into a folder": (("search", "motor_pendulum", "-o", "."), ("-o ", "folder")),
    "simulate into a missing folder": (
        simulating("--plot", "none/f.png"),
        ("--plot ", "none/f.png"),
    ),
    "simulate into a folder": (simulating("-o", "."), ("-o ", "folder")),
    "simulate into an unknown format": (
        simulating("--plot", "f.gif"),
        ("--plot ", ".png", "f.gif"),
    ),
    "simulate into no format": (simulating("--plot", "f"), ("--plot ", ".png")),
    "conditions into an unknown format": (
        ("zeno-condition", "motor_pendulum", "--plot", "f.gif"),
        ("--plot ", ".png", "f.gif"),
    ),
    "conditions into a missing folder": (
        ("zeno-condition", "motor_pendulum", "--plot", "none/f.png"),
        ("--plot ", "none/f.png"),
    ),
    "trade for no time": (
        ("work-precision", "bouncing_ball", "--until", "0"),
        ("--until", "positive"),
    ),
    "trade for nan": (("work-precision", "bouncing_ball", "--until", "nan"), ("--until", "nan")),
    "trade without end": (
        ("work-precision", "bouncing_ball", "--until", "inf"),
        ("--until", "inf"),
    ),
    "trade into a missing folder": (
        ("work-precision", "bouncing_ball", "-o", "none/t.json"),
        ("-o ", "none/t.json"),
    ),
    "trade drawn into a missing folder": (
        ("work-precision", "bouncing_ball", "--plot", "none/t.png"),
        ("--plot", "none/t.png"),
    ),
    "trade drawn in an unknown format": (
        ("work-precision", "bouncing_ball", "--plot", "t.gif"),
        (".png", "t.gif"),
    ),
    **{
        f"accuracy {value} of {command[0]}": (
            (*command, f"--accuracy={value}"),
            ("--accuracy", "[1e-12, 0.01]", f"it is {value}."),
        )
        for command in (simulating("--plot", "f.png"), searching(*PUBLISHED_GAINS))
        for value in ("nan", "0", "1e-20", "1")
    },
    "accuracy not a number": (simulating("--accuracy", "good"), ("--accuracy", "`good`")),
    "engine unknown": (simulating("--engine", "euler"), ("--engine", "`euler`", "implicit")),
    "plot into an unknown format": (("plot", "o.json", "--format", "gif"), ("gif", "svg")),
    "plot an unknown kind": (("plot", "o.json", "--kind", "pie"), ("pie", "portraits")),
    "verify nothing": (("verify",), ("ORBIT.json",)),
    "orbit file missing": (
        ("verify", "none.json"),
        ("Orbit file `none.json` cannot be read (No such file or directory).", "The folder"),
    ),
    "problem file not there": (
        ("simulate", "./none.py"),
        ("Problem file `none.py` cannot be read",),
    ),
    "orbit file missing, plot": (("plot", "none.json", "-o", "pictures"), ("`none.json`", "read")),
    "orbit file a folder": (("verify", "."), ("Orbit file", "read")),
    "problem file missing": (("simulate", "none.py"), ("`none.py`",)),
    "problem a folder without model": (("simulate", "."), ("model.py",)),
}


@pytest.mark.parametrize("case", BAD_ARGUMENTS)
def test_bad_arguments_are_refused_in_one_line(case: str, here: Path) -> None:
    arguments, words = BAD_ARGUMENTS[case]
    assert_refused(ask(*arguments), *words)
    assert contents(here) == {}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("verify", "orbit.json", "--tolerance", "0"), ("--tolerance", "(0, 1)")),
        (("verify", "orbit.json", "--tolerance=-1e-9"), ("--tolerance",)),
        (("verify", "orbit.json", "--tolerance", "nan"), ("--tolerance",)),
        (("verify", "orbit.json", "--tolerance", "1"), ("--tolerance",)),
        (("verify", "orbit.json", "--periods", "0"), ("--periods", "`0`")),
        (("verify", "orbit.json", "--model", "guessed"), ("--model", "reference")),
        (("verify", "orbit.json", "--problem", "bouncing_ball"), ("bouncing_ball",)),
        (("verify", "orbit.json", "--problem", "none.py"), ("`none.py`",)),
        *(
            (("verify", "orbit.json", f"--accuracy={value}"), ("--accuracy", f"it is {value}."))
            for value in ("nan", "1e-20", "1")
        ),
        (
            ("verify", "orbit.json", "--engine", "taylor"),
            ("--engine: ", "`taylor`", "Did you mean `automatic`?"),
        ),
        (("plot", "orbit.json", "--problem", "bouncing_ball", "-o", "p"), ()),
        (("plot", "orbit.json", "-o", "orbit.json"), ("-o ", "folder")),
        (("plot", "orbit.json", "-o", "orbit.json/p"), ("-o ", "folder")),
    ],
    ids=lambda value: " ".join(value[2:]) if value and value[0] in ("verify", "plot") else "",
)
def test_a_good_orbit_with_bad_arguments_is_refused_in_one_line(
    arguments: tuple[str, ...], words: tuple[str, ...], orbit_file: Path, here: Path
) -> None:
    before = contents(here)
    assert orbit_file.name in before
    assert_refused(ask(*arguments), *words)
    assert contents(here) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("search", "motor_pendulum", "-o", "closed/f.json"),
        ("simulate", "motor_pendulum", "--plot", "closed/f.png"),
        ("plot", "orbit.json", "-o", "closed"),
        ("plot", "orbit.json", "-o", "closed/pictures"),
    ],
)
def test_a_closed_folder_is_refused(
    arguments: tuple[str, ...], orbit_file: Path, here: Path
) -> None:
    closed = here / "closed"
    closed.mkdir(mode=0o500)
    if os.access(closed, os.W_OK):
        pytest.skip("this user may write anywhere")
    assert orbit_file.exists()
    assert_refused(ask(*arguments), "-o ", "closed")
    assert list(closed.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ("map", "motor_pendulum", "--x", "Kp=1:5", "--y", "Kd=-2:0"),
        ("work-precision", "bouncing_ball"),
        ("continue", "motor_pendulum", "--parameter", "Kp=2:3"),
    ],
    ids=lambda arguments: arguments[0],
)
@pytest.mark.parametrize("picture", ["a.png", "./a.png"])
def test_a_picture_may_not_be_written_over_the_output(
    arguments: tuple[str, ...], picture: str, here: Path
) -> None:
    (here / "a.json").symlink_to("a.png")
    answer = ask(*arguments, "-o", "a.json", "--plot", picture)
    assert_refused(answer, f"--plot {picture}: must be another file than `output`")
    assert [path.name for path in here.iterdir()] == ["a.json"]


_FILES = {
    "search": (("motor_pendulum",), "a JSON file", "x.json"),
    "search relay": (("relay",), "a JSON file", "x.json"),
    "map": (("motor_pendulum", "--x", "Kp=1:5", "--y", "Kd=-2:0"), "a JSON file", "x.json"),
    "continue": (("motor_pendulum", "--parameter", "Kp=2:3"), "a JSON file", "x.json"),
    "work-precision": (("bouncing_ball",), "a JSON file", "x.json"),
    "prove": (("orbit.json",), "a JSON file", "x.json"),
    "push": (("orbit.json",), "a JSON file", "x.json"),
    "recovery": (("orbit.json",), "a JSON file", "x.json"),
    "stability": (("orbit.json",), "a JSON file", "x.json"),
    "feedback": (("orbit.json", "--input", "Kp"), "a JSON file", "x.json"),
    "identify": (("orbit.json", "none.csv", "--fit", "R"), "a JSON file", "x.json"),
    "simulate": (("motor_pendulum",), "a table of samples", "x.csv"),
    "rig": (("motor_pendulum",), "a table of samples", "x.csv"),
    "report": (("orbit.json",), "a web page", "x.html"),
    "plot": (("orbit.json",), "a folder", "x"),
    "figures": (("orbit.json",), "a folder", "x"),
    "export": (("bouncing_ball",), "a folder", "x"),
}
"""A command to its arguments, the kind of its output, and a name that is allowed."""


@pytest.mark.parametrize("ending", [".csv", ".json", ".html", ".png", ".xlsx", ".py", ".PDF"])
@pytest.mark.parametrize("command", _FILES)
def test_a_name_of_another_kind_of_file_is_refused_before_the_work(
    command: str, ending: str, orbit_file: Path, here: Path
) -> None:
    arguments, noun, allowed = _FILES[command]
    if allowed == f"x{ending}":
        return
    before = contents(here)
    assert orbit_file.name in before
    answer = ask(command.split()[0], *arguments, "-o", f"x{ending}")
    assert_refused(answer, f"-o x{ending}: must name {noun}, such as {allowed}")
    assert contents(here) == before


@pytest.mark.parametrize(
    "command",
    [
        ("simulate",),
        ("search",),
        ("map", "--x", "Kp=1:5", "--y", "Kd=-2:0"),
        ("export", "-o", "c"),
        ("zeno-condition",),
        ("reduced-models",),
        ("work-precision",),
    ],
    ids=lambda command: command[0],
)
def test_a_result_in_place_of_a_problem_is_refused_with_its_problem(
    command: tuple[str, ...], orbit_file: Path
) -> None:
    words = (
        "Problem file `orbit.json`: it is a result about the problem `motor_pendulum`.",
        "Give `motor_pendulum` in its place.",
    )
    assert_refused(ask(command[0], orbit_file.name, *command[1:]), *words)


def test_a_name_without_a_known_ending_is_allowed(here: Path) -> None:
    for name in ("a", "a.run", "a.txt"):
        assert ask("simulate", "bouncing_ball", "--until", "0.1", "-o", name).code == YES
    (here / "b.png").mkdir()
    # A folder that exists may have any name.
    assert ask("export", "bouncing_ball", "-o", "b.png").code == YES
    assert (here / "b.png" / "bouncing_ball.c").is_file()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("--set", "Rr=3"),
            "--set Rr=3: unknown gain or parameter `Rr`. Did you mean `R`? Known: Kp, ",
        ),
        (
            ("--set=Rr=3",),
            "--set=Rr=3: unknown gain or parameter `Rr`. Did you mean `R`? Known: Kp, ",
        ),
        (("--set", "Kp=2", "--set", "Ki=3"), "--set Ki=3: unknown gain or parameter `Ki`."),
        (
            ("--start", "theta3=1"),
            "--start theta3=1: unknown state `theta3`. Did you mean `theta",
        ),
    ],
)
def test_an_unknown_name_is_told_as_it_was_typed_with_the_nearest_one_first(
    words: tuple[str, ...], told: str
) -> None:
    answer = ask("simulate", "motor_pendulum", *words)
    assert_refused(answer)
    assert answer.err.startswith(f"zeno-orbits: {told}")
    as_data = ask("simulate", "motor_pendulum", *words, "--json")
    assert as_data.data["message"].startswith(told)
