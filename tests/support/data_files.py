"""Files of every kind that the package reads, as plain data, and the commands that read files."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import zeno_orbits as zo
from tests.support.certificates import forced_oscillator
from zeno_orbits.cli import build_parser
from zeno_orbits.model import load_problem

_STATE = {"q": 0.1, "v": 1.0}
_ORBIT = {
    "parameters": {"m": 1.0},
    "gains": {},
    "period": 2.0,
    "floquet_multipliers": [[0.5, 0.0]],
    "certificate": {},
    "versions": {"numpy": "1.2"},
}
_PUSH = {"phase": 0.0, "direction": {"q": 1.0}, "mode": "free", "largest": 0.2, "error": 0.001}
_PUSH |= {"beyond": "rest", "searched": 0.5, "unit": "N s"}


@cache
def _map() -> dict[str, Any]:
    return zo.parameter_map("bouncing_ball", x=("g", 5, 10, 2), y=("m", 1, 2, 2)).as_json()


@cache
def _certificate() -> dict[str, Any]:
    return forced_oscillator(load_problem("forced_oscillator"))


def contents_by_kind(problem: str) -> dict[str, Any]:
    """Return name to content of one file of every kind that names a problem.

    Args:
        problem: The text of the entry `problem`.
    """
    impact = {"time": 0.5, "state_minus": _STATE}
    phase = {"start_state": _STATE, "impacts": [impact], "zeno_state": _STATE}
    return {
        "orbit_1.json": _ORBIT
        | {"format": 1, "problem": problem, "release_state": _STATE, "impacts": [impact]}
        | {"zeno_time": 0.6, "zeno_state": _STATE},
        "orbit_2.json": _ORBIT
        | {"format": 2, "problem": problem, "shape": "zeno*2"}
        | {
            "phases": [
                phase | {"kind": "zeno", "start_time": 0.0, "zeno_time": 0.6},
                phase
                | {"kind": "zeno", "start_time": 1.0, "zeno_time": 1.8}
                | {"impacts": [impact | {"time": 1.5}]},
            ]
        },
        "orbit_3.json": _ORBIT
        | {"format": 3, "problem": problem, "sequence": ["impact stop"], "start_state": _STATE}
        | {"events": [{"name": "impact stop", "time": 2.0, "state": _STATE}]},
        "proof.json": _certificate() | {"problem": problem},
        "pushes.json": {
            "pushes": [_PUSH, _PUSH | {"direction": {"q": -1.0}}],
            "problem": problem,
            "gains": {},
            "parameters": {"m": 1.0},
        }
        | {"period": 2.0, "spectral_radius": 0.5, "phases": 1, "steps": 1, "reach": 1.0}
        | {"error": 0.01, "until": 10.0, "least": _PUSH, "versions": {}},
        "recovery.json": {"norm": [[1.0]], "problem": problem, "gains": {}, "parameters": {}}
        | {"period": 2.0, "spectral_radius": 0.5, "contraction": 0.5, "part": 0.1, "periods": 1}
        | {
            "time": 2.0,
            "directions": [[1.0], [0.0]],
            "radius": 0.1,
            "extents": {"q": 0.1, "v": 0.0},
        }
        | {"units": {"q": "m", "v": "m/s"}, "tests": 1, "samples": 10, "confidence": 0.9}
        | {"lost_share": 1 - 0.05**0.1, "error": 0.01, "seed": 0, "versions": {}},
        "trade.json": {"problem": problem, "work": "until 1 s", "truth": "closed form"}
        | {"truth_error": 1e-12, "trials": []},
        "map.json": _map() | {"problem": problem},
        "family.json": {"problem": problem, "parameter": "m", "points": []}
        | {"boundaries": [{"name": "fold", "parameters": ["m", "g"], "x": [1, 2], "y": [1, 2]}]},
    }


def write_files(folder: Path, contents: Mapping[str, Any]) -> list[Path]:
    """Write JSON files, and return their paths."""
    for name, content in contents.items():
        (folder / name).write_text(json.dumps(content), encoding="utf-8")
    return [folder / name for name in contents]


_NOT_READ = {"output", "picture", "checkpoint"}
"""Options that name files to write."""


def reading_commands(file: Path, *, output: Path) -> Iterator[list[str]]:
    """Yield the words of every command, with a file at each place that takes a path or a target.

    Args:
        file: The file. It also stands at every other place of a command that needs one.
        output: Path of the output of commands that need one.
    """
    (commands,) = (
        action
        for action in build_parser()._actions
        if isinstance(action, argparse._SubParsersAction)
    )
    for name, parser in commands.choices.items():
        if name in ("completion", "cache", "problems", "new"):
            continue
        positional = [action for action in parser._actions if not action.option_strings]
        words = [name, *(str(file) for _ in positional)]
        for action in parser._actions:
            if action.required and action.option_strings:
                words += _given(action, output)
        if any(action.dest == "workers" for action in parser._actions):
            words += ["--workers", "2"]
        yield words
        for action in parser._actions:
            if action.type is Path and action.option_strings and action.dest not in _NOT_READ:
                yield [*words, action.option_strings[-1], str(file)]
                if name == "prove":
                    yield [name, action.option_strings[-1], str(file)]


def _given(action: argparse.Action, output: Path) -> list[str]:
    """Return a required option with a value."""
    values = {"output": str(output), "parameter": "m=1:2", "x": "m=1:2", "y": "g=1:2"}
    return [action.option_strings[-1], values.get(action.dest, "m")]
