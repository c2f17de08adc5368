"""What tests of several commands share: an orbit file, an empty folder, formulas once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.support.commands import (
    PUBLISHED_GAINS,
    Answer,
    ask,
)
from zeno_orbits.model import Problem
from zeno_orbits.model import formulas as symbolic


@pytest.fixture(name="searched", scope="session")
def _searched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Answer, Path]:
    """The published gains, searched once, and the file that came of it."""
    path = tmp_path_factory.mktemp("orbits") / "orbit.json"
    return ask("search", "motor_pendulum", *PUBLISHED_GAINS, "-o", path, "--json"), path


@pytest.fixture(name="orbit_data")
def _orbit_data(searched: tuple[Answer, Path]) -> dict[str, Any]:
    return json.loads(searched[1].read_text())


@pytest.fixture(name="here")
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture(name="orbit_file")
def _orbit_file(searched: tuple[Answer, Path], here: Path) -> Path:
    """A copy of the orbit file in the working folder."""
    path = here / "orbit.json"
    path.write_bytes(searched[1].read_bytes())
    return path


@pytest.fixture(name="formulas", scope="package", autouse=True)
def _formulas() -> Any:
    """Let SymPy simplify the acceleration of each problem once, not in every test."""
    known: dict[str, Any] = {}
    simplify = symbolic.acceleration_formula

    def remembered(problem: Problem) -> Any:
        if problem.name not in known:
            known[problem.name] = simplify(problem)
        return known[problem.name]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(symbolic, "acceleration_formula", remembered)
        yield
