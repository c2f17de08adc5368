"""One name per concept: a walk over all commands and public functions."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.pages import ROOT
from zeno_orbits.aliases import FORMER
from zeno_orbits.api import NAMES, names_table
from zeno_orbits.cli import build_parser


def _commands() -> dict[str, list[argparse.Action]]:
    (found,) = (
        action
        for action in build_parser()._actions
        if isinstance(action, argparse._SubParsersAction)
    )
    return {name: list(one._actions) for name, one in found.choices.items()}


def _functions() -> dict[str, Callable[..., Any]]:
    every = {name: getattr(zo, name) for name in zo.__all__}
    return {name: one for name, one in every.items() if inspect.isfunction(one)}


COMMANDS, FUNCTIONS = _commands(), _functions()

SAME = {
    "simulate": ["simulate"],
    "search": ["search_gains", "find_orbit"],
    "verify": ["verify"],
    "stability": ["floquet_multipliers"],
    "prove": ["prove", "prove_branch"],
    "map": ["parameter_map"],
    "continue": ["continue_orbit"],
    "push": ["largest_push"],
    "recovery": ["recovery"],
    "feedback": ["design_feedback"],
    "scatter": ["scatter"],
    "work-precision": ["work_precision"],
    "rig": ["simulate_rig", "simulate_experiment", "simulate_periods"],
    "compare": ["compare", "compare_transient"],
    "identify": ["identify"],
    "report": ["report_page"],
    "reduced-models": ["reduced_model_errors"],
    "zeno-condition": ["zeno_condition"],
}
"""A command to the functions that do its work."""

PYTHON_ONLY = {
    *("on_progress", "on_estimate", "settings", "plan", "dynamics"),
    # One option, `--set`, has both.
    *("gains", "parameters"),
    # Positional arguments of the command.
    *("orbit", "recording"),
    # `--part`, `--only`, `--without`, `--exact-pwm`; `--cycles` chooses among two functions.
    *("rig", "periods", "settle"),
}
"""Arguments that are values, and have no option of their name."""


def _options(command: str) -> Iterator[tuple[str, argparse.Action]]:
    """Yield the name of each option or positional argument of a command."""
    for action in COMMANDS[command]:
        long = [word for word in action.option_strings if word.startswith("--")]
        yield (long[-1].removeprefix("--").replace("-", "_") if long else action.dest), action


@pytest.mark.parametrize("command", SAME)
def test_every_argument_of_a_function_is_an_option_of_its_command(command: str) -> None:
    options = {name for name, _ in _options(command)}
    for name in SAME[command]:
        arguments = set(inspect.signature(FUNCTIONS[name]).parameters)
        assert arguments - options - PYTHON_ONLY == set()


@pytest.mark.parametrize("command", COMMANDS)
def test_an_option_of_a_shared_concept_has_its_name_form_and_meaning(command: str) -> None:
    for name, action in _options(command):
        row = NAMES.get(name)
        if row is not None and action.option_strings:
            assert action.option_strings == [row.option]
            assert action.metavar == row.form
            assert action.help is not None
            assert action.help.startswith(row.meaning)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_an_argument_of_a_shared_concept_has_its_name_and_its_option_in_the_help(
    function: str,
) -> None:
    work = FUNCTIONS[function]
    arguments = set(inspect.signature(work).parameters)
    if function != "execution_distance":
        # That function compares a first and a second execution.
        assert not {old for old, (new, *_) in FORMER.items() if new in NAMES} & arguments
    if work.__module__.startswith("zeno_orbits.api."):
        lines = (work.__doc__ or "").splitlines()
        shown = [line for line in lines if line.strip().startswith("Command line: ")]
        known = [NAMES[name] for name in inspect.signature(work).parameters if name in NAMES]
        assert len(shown) == bool(known)
        for row in known:
            assert f"`{row.option} {row.form}`" in shown[0]


def test_every_signature_prints_in_words_of_a_user() -> None:
    for work in FUNCTIONS.values():
        text = str(inspect.signature(work))
        assert " at 0x" not in text
        assert "Named" not in text
        assert "Numbers" not in text
        assert "Span" not in text


def test_the_documented_table_is_the_table_of_the_program() -> None:
    assert names_table() in (ROOT / "docs" / "names.md").read_text()


def _orbit() -> zo.Orbit:
    return zo.find_orbit_by_shooting("forced_oscillator").unwrap()


@pytest.mark.parametrize("bad", ["k", ("k",), ("k", 1.0), (1.0, 2.0, 3.0), ("k", 1.0, 2.0, 3)])
def test_a_parameter_without_its_range_is_refused(bad: Any) -> None:
    with pytest.raises(zo.InputError, match="Argument `parameter` must "):
        zo.continue_orbit(_orbit(), bad)


@pytest.mark.slow
def test_a_second_parameter_is_given_like_the_first() -> None:
    found = zo.continue_orbit(_orbit(), ("A", 0.6, 1.0), parameter2=("stop", -0.85, -0.75))
    (boundary,) = found.boundaries
    # The contact force just vanishes at A = -stop (tests/README.md).
    assert boundary.names == ("A", "stop")
    assert np.array(boundary.x) == pytest.approx(-np.array(boundary.y), abs=1e-6)
