"""Every block of code on every page runs, and prints what the page says."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.support.pages import ROOT, SHOWN, blocks, commands, run_page
from zeno_orbits.cli import build_parser

PAGES = sorted(
    [
        *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
        *(ROOT / "docs").glob("*.md"),
        ROOT / "benchmarks" / "README.md",
    ]
)
SLOW = [page for page in PAGES if any(block.slow for block in blocks(page))]

LEFT_OUT = {
    ("CONTRIBUTING.md", "not run: installs"): 1,
    ("CONTRIBUTING.md", "not run: they run the tests"): 1,
    ("README.md", "command: run"): 1,
    ("README.md", "not run: installs"): 1,
    ("README.md", "command: test"): 1,
    ("benchmarks/README.md", "not run: takes a quiet machine"): 1,
    ("docs/performance.md", "not run: takes a quiet machine"): 4,
    ("docs/performance.md", "not run: a quarter of an hour"): 3,
    ("docs/performance.md", "not run: three minutes"): 1,
    ("docs/performance.md", "not run: takes other people's simulators and a quiet machine"): 1,
    ("docs/proof.md", "not run: takes minutes"): 1,
    ("docs/proof_file.md", "not run: needs a certificate"): 1,
    ("docs/pushes.md", "not run: minutes"): 1,
    ("docs/return_map.md", "not run: needs jax, and a test runs it where that is installed"): 1,
    ("docs/return_map.md", "not run: needs torch, and a test runs it where that is installed"): 1,
    ("docs/scale.md", "not run: minutes"): 1,
    ("docs/scale.md", "not run: needs a cluster"): 2,
    ("docs/tutorial.md", "not run: installs, as `.ci/run` does"): 1,
}
"""Blocks that no test runs, and why. The list may become shorter."""

LEFT_BEHIND = {
    "problems.md": [f"cam/{kind}.png" for kind in ("portraits", "time", "outputs", "zeno")],
    "tutorial.md": [
        "motion.png",
        *(f"pictures/{kind}.png" for kind in ("portraits", "time", "zeno", "region")),
    ],
}
"""Files that a page promises."""


@pytest.fixture(name="here", autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


LONG = {
    f"{name}.md"
    for name in (
        *("README", "accuracy", "examples", "families", "mapping", "measured_data", "no_orbit"),
        *("export", "feedback", "gallery", "impact_laws", "own_tests", "problems"),
        *("proof", "prove_an_orbit"),
        *("phone_recording", "pushes", "report", "scatter", "swing_down", "wrong_model"),
        *("rig", "scale", "searching", "several_stops"),
        *("stability", "tutorial", "tutorial_python", "what_a_proof_proves", "zeno_model"),
    )
}
"""Pages that take more than two seconds."""
LONGEST = {
    f"{name}.md" for name in ("several_stops", "rig", "examples", "measured_data", "searching")
}
"""Pages that take more than twenty seconds."""


def _marks(page: str) -> list[pytest.MarkDecorator]:
    return [pytest.mark.slow] * (page in LONG) + [pytest.mark.weekly] * (page in LONGEST)


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=_marks(page.name)) for page in PAGES],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_the_blocks_of_a_page_run(page: Path, here: Path) -> None:
    run_page(page, slow=False)
    for name in LEFT_BEHIND.get(page.name, ()):
        assert (here / name).is_file(), name


@pytest.mark.slow
@pytest.mark.weekly
@pytest.mark.parametrize("page", SLOW, ids=lambda page: page.name)
def test_the_blocks_of_a_page_run_with_the_slow_ones(page: Path) -> None:
    run_page(page, slow=True)


def test_no_block_is_left_out_that_is_not_listed_with_its_reason() -> None:
    left_out = Counter(
        (str(page.relative_to(ROOT)), block.mark)
        for page in PAGES
        for block in blocks(page)
        if block.left_out
    )
    assert left_out == LEFT_OUT


def test_every_block_of_a_page_says_what_it_is() -> None:
    for page in PAGES:
        for block in blocks(page):
            assert block.language in {*SHOWN, "python", "sh"}, (page.name, block.line)
            assert block.mark in {"", "slow"} or block.left_out or block.code, block.mark


def understood(words: Sequence[str]) -> None:
    """Check that the command line parses some words."""
    build_parser().parse_args(words)


def test_what_is_not_run_names_scripts_and_options_that_there_are() -> None:
    for block in (block for page in PAGES for block in blocks(page)):
        for line in commands(block) if block.language == "sh" else ():
            program, *words = shlex.split(line)
            if program == "zeno-orbits" and block.left_out:
                understood(words)
            elif program == "python":
                script = (ROOT / words[0]).read_text()
                for option in (word for word in words if word.startswith("--")):
                    assert f'"{option}"' in script, line


def test_the_commands_in_the_table_of_the_readme_are_understood() -> None:
    readme = (ROOT / "README.md").read_text()
    rows = re.findall(r"^\| `zeno-orbits ([^`]+)` \|", readme, re.M)
    # One command a row: `scripts/readme_table` runs each.
    assert len(rows) == readme.count("\n| `zeno-orbits ") > 10
    for row in rows:
        understood(shlex.split(row))


# The runner itself.


def _page(folder: Path, text: str) -> Path:
    page = folder / "page.md"
    page.write_text(text)
    return page


FAILING = {
    "a Python block": "```python\nassert False\n```",
    "a name that an empty folder does not have": "```python\nprint(orbit)\n```",
    "a command": "```sh\nzeno-orbits verify nowhere.json\n```",
    "a command that ends otherwise": "<!-- exit 1 -->\n```sh\nzeno-orbits problems\n```",
    "an output": "```python\nprint(1.5)\n```\n\n```text\n1.6\n```",
    "an output in another order": "```python\nprint(1, 2)\n```\n\n```text\n2\n1\n```",
    "another program": "```sh\nrm nothing\n```",
    "another language": "```julia\nf\n```",
    "an indented block": "Text.\n\n    zeno-orbits problems\n",
}


@pytest.mark.parametrize("what", FAILING)
def test_a_page_with_a_wrong_block_fails(what: str, here: Path) -> None:
    with pytest.raises((AssertionError, NameError)):
        run_page(_page(here, FAILING[what]), slow=False)


def test_outputs_may_leave_something_out_and_slow_blocks_wait(here: Path) -> None:
    text = "```python\nprint('one  two')\nprint('three')\n```\n\n```text\none two\n...ee\n```\n"
    slow = "\n<!-- slow -->\n```python\nraise ValueError('late')\n```\n\n```text\nnothing\n```\n"
    run_page(_page(here, text + slow), slow=False)
    with pytest.raises(ValueError, match="late"):
        run_page(_page(here, text + slow), slow=True)
