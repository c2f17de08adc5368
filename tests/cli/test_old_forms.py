"""Old commands and options: each gives the answer of its new form, and one line about it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from tests.support.commands import MISUSE, YES, Answer, ask
from zeno_orbits.cli.old_forms import COMMANDS, OPTIONS

pytestmark = pytest.mark.usefixtures("here")

PAIRS = {
    "conditions": "zeno-condition bouncing_ball",
    "fidelity": "reduced-models bouncing_ball",
    "trade": "work-precision bouncing_ball --until 0",
    "simulate --gain": "simulate motor_pendulum --set Kp=2.4 --until 0.3",
    "simulate --initial": "simulate bouncing_ball --start height=1.5 --until 0.3",
    "simulate --t-end": "simulate bouncing_ball --until 0.3",
    "simulate --most-steps": "simulate bouncing_ball --max-steps 1 --until 3",
    "simulate --data": "simulate bouncing_ball --until 0.3 --output data.csv",
    "simulate --output": "simulate bouncing_ball --until 0.3 --plot time.png",
    "simulate -o": "simulate bouncing_ball --until 0.3 --plot time.png",
    "zeno-condition --gain": "zeno-condition bouncing_ball --set Kp=1",
    "zeno-condition --output": "zeno-condition bouncing_ball --plot none/region.png",
    "zeno-condition -o": "zeno-condition bouncing_ball --plot none/region.png",
    "reduced-models --gain": "reduced-models bouncing_ball --set Kp=1",
    "search --gain": "search motor_pendulum --vary Kp=5:1",
    "search --free": "search motor_pendulum --vary R=5:1",
    "search --fix": "search motor_pendulum --set Q=1",
    "search --keep": "search motor_pendulum --bounds theta2=2:1",
    "search --bound": "search motor_pendulum --bounds theta2=2:1",
    "search --initial": "search motor_pendulum --start Q=1",
    "search --starts": "search motor_pendulum --n-starts 0",
    "search --max-time": "search motor_pendulum --until soon",
    "search --from": "search motor_pendulum --near none.json",
    "push --direction": "push none.json --directions theta1=1",
    "push --max-time": "push none.json --until soon",
    "prove --over": "prove orbit.json --interval Kp",
    "map --gain": "map motor_pendulum --x Kp=1:2 --y Kd=-1:0 --set Q=1",
    "map --initial": "map motor_pendulum --x Kp=1:2 --y Kd=-1:0 --start Q=1",
    "map --picture": "map motor_pendulum --x Kp=1:2 --y Kd=-1:0 --plot map.gif",
    "map --points": "map motor_pendulum --x Kp=1:2 --y Kd=-1:0 --grid 2",
    "map --max-time": "map motor_pendulum --x Kp=1:2 --y Kd=-1:0 --until soon",
    "continue --gain": "continue motor_pendulum --parameter Kp=1:2 --near none.json --set Kd=-1",
    "continue --from": "continue motor_pendulum --parameter Kp=1:2 --near none.json",
    "continue --initial": "continue motor_pendulum --parameter Kp=1:2 --start theta1=1",
    "continue --picture": "continue motor_pendulum --parameter Kp=1:2 --plot family.gif",
    "continue --in": "continue motor_pendulum --parameter Q=1:2",
    "continue --second": "continue motor_pendulum --parameter Kp=1:2 --parameter2 Q=1:2",
    "continue --steps": "continue motor_pendulum --parameter Kp=1:2 --max-points 0",
    "continue --point": "continue motor_pendulum --parameter Kp=1:2 --kind fold",
    "work-precision --gain": "work-precision bouncing_ball --set Kp=1",
    "work-precision --initial": "work-precision bouncing_ball --start Q=1",
    "work-precision --t-end": "work-precision bouncing_ball --until 0",
    "work-precision --picture": "work-precision bouncing_ball --plot study.gif",
    "rig --gain": "rig orbit.json --set Kp=2",
    "rig --initial": "rig orbit.json --start theta1=1",
    "rig --t-end": "rig orbit.json --until 2",
    "rig --exact": "rig motor_pendulum --only friction --exact-pwm",
    "compare --from": "compare orbit.json none.csv --t-start 1",
    "compare --to": "compare orbit.json none.csv --t-end 1",
    "compare --picture": "compare orbit.json none.csv --plot compared.gif",
    "identify --gain": "identify motor_pendulum none.csv --fit R --set Kp=2",
    "identify --from": "identify motor_pendulum none.csv --fit R --t-start 1",
    "identify --to": "identify motor_pendulum none.csv --fit R --t-end 1",
    "figures --data": "figures orbit.json -o figures --kind graph --recording none.csv",
    "export --gain": "export bouncing_ball -o exported --set Kp=1",
    "export --initial": "export bouncing_ball -o exported --start Q=1",
    "export --t-end": "export bouncing_ball -o exported --until 0",
}
"""An old command, or a command with an old option, to a whole command line in the new form."""


def test_every_old_form_has_its_command_line() -> None:
    options = {f"{command} {old}" for command, olds in OPTIONS.items() for old in olds}
    assert set(PAIRS) == {*COMMANDS, *options}


def _in_old_form(key: str) -> list[str]:
    command, _, option = key.partition(" ")
    words = shlex.split(PAIRS[key])
    if not option:
        return [command, *words[1:]]
    new = OPTIONS[command][option]
    assert new in words
    return [option if word == new else word for word in words]


def _timeless(answer: Answer) -> tuple[int, str, str]:
    return answer.code, re.sub(r"\d+\.\d+ s", "", answer.out), answer.err


@pytest.mark.parametrize("key", PAIRS)
def test_an_old_form_answers_as_the_new_one_and_names_it(key: str, here: Path) -> None:
    new = ask(*shlex.split(PAIRS[key]))
    for path in here.iterdir():
        if path.is_file():
            path.unlink()
    old = ask(*_in_old_form(key))
    command, _, option = key.partition(" ")
    told = (option, OPTIONS[command][option]) if option else (command, COMMANDS[command])
    clause = f" `{told[0]}` is now `{told[1]}`."
    if new.code == YES:
        note = f"zeno-orbits: note:{clause} The old form will be removed.\n"
        assert old.err.endswith(note)
        rest = old.err.removesuffix(note)
    else:
        # An error is one line, which names the old form at its end.
        assert old.err.count("\n") == new.err.count("\n")
        assert clause in old.err
        rest = old.err.replace(clause, "")
    said = Answer(old.code, old.out, rest.replace(".", ""))
    assert _timeless(said) == _timeless(Answer(new.code, new.out, new.err.replace(".", "")))


@pytest.mark.parametrize("form", [("-o", "time.png"), ("-otime.png",), ("--output=time.png",)])
def test_a_picture_that_was_named_with_the_option_of_data_is_drawn(
    form: tuple[str, ...], here: Path
) -> None:
    answer = ask("simulate", "bouncing_ball", "--until", "0.3", *form)
    assert answer.code == YES
    assert (here / "time.png").read_bytes().startswith(b"\x89PNG")
    assert answer.err.count("\n") == 1


def test_a_new_form_prints_no_note(here: Path) -> None:
    answer = ask("simulate", "bouncing_ball", "--until", "0.3", "-o", "data.csv")
    assert (answer.code, answer.err) == (YES, "")
    assert (here / "data.csv").read_text().count("\n") > 100


def test_an_image_is_no_data(here: Path) -> None:
    answer = ask("simulate", "bouncing_ball", "--until", "0.3", "-o", "time.gif")
    assert answer.code == MISUSE
    assert (
        answer.err == "zeno-orbits: -o time.gif: must name a table of samples, such as time.csv: "
        "--json prints JSON, --plot draws pictures.\n"
    )
    assert list(here.iterdir()) == []


def test_old_values_of_a_search_keep_their_meaning() -> None:
    # A gain that is fixed is no unknown, and a parameter that is free starts where it is set.
    answer = ask("search", "motor_pendulum", "--fix", "Kp=4", "--free", "R=2:4", "--set", "R=9")
    assert answer.code == MISUSE
    assert "--set R=9: must start in its range [2, 4]" in answer.err
