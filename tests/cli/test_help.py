"""The help: its examples run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

import zeno_orbits
from tests.support.commands import (
    MISUSE,
    NO,
    YES,
    Answer,
    ask,
    examples,
    raising,
)
from tests.support.pages import ROOT, blocks, commands
from zeno_orbits.cli import build_parser
from zeno_orbits.errors import ZenoOrbitsError

pytestmark = pytest.mark.usefixtures("here")


COMMANDS = (
    *(
        "problems",
        "zeno-condition",
        "simulate",
        "reduced-models",
        "search",
        "verify",
        "work-precision",
        "plot",
    ),
    *("map", "rig"),
)


EVERY = tuple(
    re.findall(
        r"^  (?!zeno-orbits )([a-z][a-z-]*)(?: |$)",
        build_parser().format_help(),
        flags=re.MULTILINE,
    )
)


def test_every_command_is_known_to_the_tests_of_its_examples() -> None:
    elsewhere = {"new", "continue", "compare", "identify", "report", "figures", "prove", "export"}
    elsewhere |= {"push", "recovery", "feedback", "scatter", "stability", "read"}
    assert set(EVERY) == {*COMMANDS, *elsewhere, "completion", "cache"}


@pytest.mark.parametrize("command", EVERY)
def test_the_help_of_a_command_shows_examples_of_it(command: str) -> None:
    shown = examples(command)
    assert shown
    assert shown[0][0] == command
    assert all(example[0] in EVERY for example in shown)


@pytest.mark.parametrize("command", [None, *EVERY])
def test_no_word_of_the_help_is_cut_in_eighty_columns(
    command: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for word in ("--help", "--help-all") if command else ("--help",):
        lines = ask(*filter(None, (command, word))).out.splitlines()
        assert [line for line in lines if len(line) > 80] == []


@pytest.mark.parametrize("command", EVERY)
def test_an_option_is_called_repeatable_at_most_once(command: str) -> None:
    text = " ".join(ask(command, "--help-all").out.split())
    entries = re.split(r" (?=--?[a-z])", text)
    assert [entry for entry in entries if entry.count("(repeatable)") > 1] == []


@pytest.mark.parametrize("command", EVERY)
def test_the_help_of_common_options_fits_a_screen_and_names_the_rest(command: str) -> None:
    short, whole = (ask(command, word).out for word in ("--help", "--help-all"))
    assert len(short.splitlines()) <= 24
    assert "--help-all" in short
    options = set(re.findall(r"--[a-z0-9-]+", short))
    assert options <= set(re.findall(r"--[a-z0-9-]+", whole))
    assert "examples:" in short


@pytest.mark.parametrize("command", EVERY)
def test_the_short_help_cuts_no_sentence_inside_a_word(command: str) -> None:
    whole = " ".join(ask(command, "--help-all").out.split())
    lines = ask(command, "--help").out.splitlines()
    told = [found[1] for line in lines if (found := re.match(r"  -\S.*?  +(\S.*)", line))]
    assert told
    for clause in told:
        assert re.search(re.escape(clause) + r"(?!\w)", whole), clause


@pytest.mark.parametrize("command", EVERY)
def test_options_stand_in_groups_and_those_of_every_command_come_last(command: str) -> None:
    lines = ask(command, "--help-all").out.splitlines()
    titles = [line.removesuffix(":") for line in lines if re.fullmatch(r"[a-z ]+:", line)]
    groups = (
        "problem",
        "machine",
        "objective",
        "range",
        "effort",
        "accuracy",
        "parallel",
        "output",
    )
    known = ["arguments", *groups, "options"]
    shown = [title for title in titles if title in known]
    assert shown == [title for title in known if title in shown]
    assert "output" in shown
    options = [
        found[1]
        for line in lines
        if (found := re.match(r"  (?:-\w(?: \w+)?, )?(--[a-z0-9-]+)", line))
    ]
    assert len(set(options)) == len(options)
    common = ["--json", "--verbose", "--debug", "--help", "--help-all"]
    assert [option for option in options if option in common] == common
    own = options[options.index("--help-all") + 1 :]
    alone = ("--with-motor", "--with-circuit", "--check", "--compile", "--clear")
    assert all(option in alone for option in own)


def test_the_bare_command_prints_the_help_and_is_misuse() -> None:
    assert ask() == Answer(MISUSE, ask("--help").out, "")


def test_the_program_tells_its_version() -> None:
    assert ask("--version") == Answer(YES, f"zeno-orbits {zeno_orbits.__version__}\n", "")


def test_the_help_of_the_program_names_every_command_and_the_exit_codes() -> None:
    answer = ask("--help")
    assert answer.code == YES
    assert "exit codes: 0 yes; 1" in answer.out
    assert "example" in answer.out
    for command in EVERY:
        assert command in answer.out


LONG_WORDS = {"--objective", "reference", "--measure", "work-precision"}


# The examples of `map` take minutes, and one a cluster: `test_maps.py` runs smaller ones.
EXAMPLES = tuple(
    example for command in COMMANDS if command != "map" for example in examples(command)
)


QUICK = tuple(example for example in EXAMPLES if not LONG_WORDS & set(example))


LONG = tuple(example for example in EXAMPLES if LONG_WORDS & set(example))


ON_PAGES = [
    {*shlex.split(line)}
    for page in (ROOT / "docs").glob("*.md")
    for block in blocks(page)
    if block.language == "sh" and not block.left_out
    for line in commands(block)
]
"""Words of each command that `test_pages` runs."""

HERE = tuple(
    example
    for example in LONG
    if "--scheduler" not in example and not any({*example} <= words for words in ON_PAGES)
)
"""Those that need no cluster and that no page runs; `test_cluster` has one."""


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(one, marks=[pytest.mark.weekly] * (one[0] == "rig" or "--rigorous" in one))
        for one in QUICK
    ],
    ids=" ".join,
)
@pytest.mark.slow
def test_a_quick_example_of_the_help_runs(example: list[str], orbit_file: Path) -> None:
    assert orbit_file.exists()
    assert ask(*example).code == YES


@pytest.mark.parametrize("example", LONG, ids=" ".join)
def test_a_long_example_of_the_help_is_understood(
    example: list[str], orbit_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert orbit_file.exists()
    reached = raising(ZenoOrbitsError("The work would begin here."))
    names = "search_gains verify work_precision reduced_model_errors"
    for name in names.split():
        monkeypatch.setattr(f"zeno_orbits.api.{name}", reached)
    answer = ask(*example)
    assert answer.code == NO
    assert answer.err == "zeno-orbits: The work would begin here.\n"


@pytest.mark.weekly
@pytest.mark.slow
@pytest.mark.parametrize("example", HERE, ids=" ".join)
def test_a_long_example_of_the_help_runs(example: list[str], orbit_file: Path) -> None:
    assert orbit_file.exists()
    assert ask(*example).code == YES
