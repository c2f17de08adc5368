"""The notebooks hold their outputs, and a fresh run prints the same words and numbers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest

from notebooks.run import differences
from tests.support.cases import often

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LARGEST = 600_000
"""Bytes of a notebook, pictures included: a code host shows it at once."""


def cells(path: Path) -> list[dict[str, Any]]:
    return json.loads(path.read_text())["cells"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_shows_what_it_prints_and_draws(path: Path) -> None:
    outputs = [one for cell in cells(path) for one in cell.get("outputs", ())]
    assert outputs
    draws = any("%matplotlib" in "".join(cell["source"]) for cell in cells(path))
    assert any("image/png" in one.get("data", {}) for one in outputs) == draws
    assert any(one["output_type"] == "stream" for one in outputs)
    assert path.stat().st_size < LARGEST


LONG = {"07_an_orbit_as_a_theorem", "08_a_map_and_its_bifurcation_curves"}
LONG |= {"10_how_hard_can_it_be_pushed"}
SHORT_FIRST = sorted(NOTEBOOKS, key=lambda path: path.stem in LONG)


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", often(len(NOTEBOOKS) - len(LONG), SHORT_FIRST), ids=lambda path: path.stem
)
def test_a_fresh_run_prints_what_is_stored(path: Path) -> None:
    # A process of its own: what kernels warn of is not ours.
    words = [sys.executable, str(ROOT / "notebooks" / "run.py"), "--compare", path.stem[:2]]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert run.returncode == 0, run.stdout + run.stderr[-2000:]


def printing(*lines: str, tags: tuple[str, ...] = ()) -> nbformat.NotebookNode:
    """Return a notebook of one cell that has printed some lines."""
    text = "\n".join(lines)
    output = nbformat.v4.new_output("stream", name="stdout", text=text)
    cell = nbformat.v4.new_code_cell("...", outputs=[output], metadata={"tags": list(tags)})
    return nbformat.v4.new_notebook(cells=[cell])


STORED = printing("period 1.813712939 s, residual 3.1e-12", "Verified")


@pytest.mark.parametrize(
    ("lines", "n_different"),
    [
        (("period 1.813712939 s, residual 3.2e-5", "Verified"), 1),
        (("period 1.813712940 s, residual 8.2e-13", "Verified"), 0),
        (("period 1.813718 s, residual 3.1e-12", "Verified"), 1),
        (("period 1.813712939 s, residual 3.1e-5", "Verified"), 1),
        (("period 1.813712939 s, residual 3.1e-12", "Refused"), 1),
        (("period 1.813712939 s, residual 3.1e-12",), 1),
    ],
)
def test_another_number_or_word_is_a_difference_and_rounding_is_none(
    lines: tuple[str, ...], n_different: int
) -> None:
    assert len(list(differences(STORED, printing(*lines)))) == n_different


def test_what_varies_is_not_compared() -> None:
    before, after = printing("12 ms", tags=("varies",)), printing("15 ms", tags=("varies",))
    assert not list(differences(before, after))
