"""The rooms: each first page tells what it is for, what it offers, and what it may import."""

from __future__ import annotations

import ast
import re
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "zeno_orbits"
ROOMS = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))
MODULES = ("aliases", "arrays", "errors")
"""At the bottom, below all rooms."""


def _floors() -> list[list[str]]:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contracts = settings["tool"]["importlinter"]["contracts"]
    (layers,) = (one["layers"] for one in contracts if one.get("containers") == ["zeno_orbits"])
    return [re.findall(r"\w+", floor) for floor in layers]


def _below(room: str) -> set[str]:
    floors = _floors()
    level = next(k for k, floor in enumerate(floors) if room in floor)
    return {name for floor in floors[level + 1 :] for name in floor}


def _charter(room: str) -> str:
    text = (PACKAGE / room / "__init__.py").read_text()
    return ast.get_docstring(ast.parse(text)) or ""


def _section(room: str, name: str) -> str:
    found = re.search(rf"^{name}: (.*?)(?:\n\n|\Z)", _charter(room), re.MULTILINE | re.DOTALL)
    assert found is not None, f"{room} has no line `{name}:`"
    return found[1]


def _imported(room: str) -> set[str]:
    names: set[str] = set()
    for path in (PACKAGE / room).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("zeno_orbits."):
                names.add((node.module or "").split(".")[1])
    return names - {room}


def test_there_are_at_most_sixteen_rooms_below_the_front_door_and_fifteen_floors() -> None:
    assert len(set(ROOMS) - {"api"}) <= 16
    assert len(_floors()) <= 15
    assert {name for floor in _floors() for name in floor} >= set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_says_what_it_may_import_and_imports_no_more(room: str) -> None:
    said = set(re.findall(r"\w+", _section(room, "Imports").split(".")[0]))
    assert said <= _below(room)
    assert _imported(room) <= said


@pytest.mark.parametrize("room", ROOMS)
def test_what_a_room_says_it_offers_is_there(room: str) -> None:
    offered = set(import_module(f"zeno_orbits.{room}").__all__)
    said = set(re.findall(r"`(\w+)`", _section(room, "Offers")))
    assert said
    assert said <= offered


@pytest.mark.parametrize("room", ROOMS)
def test_no_door_offers_a_name_that_is_one_of_its_modules(room: str) -> None:
    modules = {path.stem for path in (PACKAGE / room).iterdir()}
    assert not modules & set(import_module(f"zeno_orbits.{room}").__all__)
