"""Removed commands, options and integrators: refused in one line that suggests the successor."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from tests.support.commands import ask, assert_refused
from zeno_orbits.aliases import FORMER
from zeno_orbits.cli import build_parser

(_SUBPARSERS,) = (
    one for one in build_parser()._actions if isinstance(one, argparse._SubParsersAction)
)
COMMANDS = {
    name: {word for action in one._actions for word in action.option_strings}
    for name, one in _SUBPARSERS.choices.items()
}
"""Command to its options in all their forms."""
REMOVED = [
    (command, option)
    for command, known in COMMANDS.items()
    for option, successors in FORMER.items()
    if option.startswith("-") and option not in known and set(successors) & known
]


def _successor(command: str, option: str) -> str:
    return next(new for new in FORMER[option] if new in COMMANDS[command])


@pytest.mark.parametrize(("command", "option"), REMOVED)
def test_a_removed_option_is_refused_with_its_successor(command: str, option: str) -> None:
    said = f"{option}: unknown option. Did you mean `{_successor(command, option)}`?"
    # Without the arguments that the command requires: the removed option is refused first.
    assert_refused(ask(command, option, "Kp=1:2"), said)
    assert_refused(ask(command, f"{option}=Kp=1:2"), said)


def test_every_removed_option_and_each_of_its_successors_has_a_command() -> None:
    reached = {(option, _successor(command, option)) for command, option in REMOVED}
    table = {(old, new) for old, news in FORMER.items() if old.startswith("-") for new in news}
    assert reached == table


@pytest.mark.parametrize("command", ["conditions", "fidelity", "trade"])
def test_a_removed_command_is_refused_with_its_successor(command: str) -> None:
    new = FORMER[command][-1]
    assert new in COMMANDS
    assert_refused(ask(command, "bouncing_ball"), f"`{command}`. Did you mean `{new}`?")


@pytest.mark.parametrize("command", ["simulate", "search"])
def test_a_removed_integrator_is_refused_with_its_successor(command: str) -> None:
    words = ("--engine: unknown name `taylor`. Did you mean `automatic`?",)
    assert_refused(ask(command, "motor_pendulum", "--engine", "taylor"), *words)


@pytest.mark.parametrize("command", COMMANDS)
def test_an_option_must_be_written_in_full(command: str) -> None:
    said = "--jso: unknown option. Did you mean `--json`?"
    assert_refused(ask(command, "--jso"), said)


def test_an_unknown_option_is_named_before_the_option_that_is_missing() -> None:
    said = "--paramter: unknown option. Did you mean `--parameter`?"
    assert_refused(ask("continue", "motor_pendulum", "--paramter", "Kp=1:2"), said)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("form", [("-o", "time.png"), ("-otime.png",), ("--output=time.png",)])
def test_a_picture_is_no_recording(form: tuple[str, ...], here: Path) -> None:
    answer = ask("simulate", "bouncing_ball", "--until", "0.3", *form)
    label = form[0] if len(form) == 1 else " ".join(form)
    wanted = f"{label}: must name a table of samples, such as time.csv"
    assert_refused(answer, wanted, "--plot draws pictures.")
    assert list(here.iterdir()) == []


def test_a_parameter_with_a_range_starts_where_it_is_set() -> None:
    # A gain that is set is no decision variable, a parameter with a range starts at its value.
    words = ("--set", "Kp=4", "--vary", "R=2:4", "--set", "R=9")
    assert_refused(ask("search", "motor_pendulum", *words), "--set R=9: must start in its range")
