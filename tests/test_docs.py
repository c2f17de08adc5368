"""The documents say what is so: examples run, links lead somewhere, citations exist."""

import re
from pathlib import Path

import pytest

from zeno_orbits.certificate import RESIDUALS

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
SOURCES = sorted([*(ROOT / "zeno_orbits").rglob("*.py"), *(ROOT / "problems").rglob("*.py")])


def _anchors(document: Path) -> set[str]:
    return set(re.findall(r'<a id="([^"]+)"></a>', document.read_text()))


def test_the_readme_example_prints_a_verified_orbit(capsys: pytest.CaptureFixture[str]) -> None:
    block = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert block is not None
    exec(compile(block.group(1), "README.md", "exec"), {})
    assert capsys.readouterr().out.startswith("Verified: a stable Zeno periodic orbit")


def test_the_readme_is_short_and_shows_an_orbit_near_its_top() -> None:
    lines = (ROOT / "README.md").read_text().splitlines()
    assert len(lines) < 150
    assert any(line.startswith("![") for line in lines[:12])


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_of_a_document_leads_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text()):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        path = (document.parent / name).resolve() if name else document
        assert path.exists(), target
        if anchor:
            assert anchor in _anchors(path), target


def test_every_equation_that_a_docstring_cites_exists() -> None:
    numbers = {anchor.removeprefix("eq-") for anchor in _anchors(ROOT / "docs" / "theory.md")}
    for source in SOURCES:
        for cited in re.findall(r"theory ((?:\(\d+\)(?:, | and |-)?)+)", source.read_text()):
            assert set(re.findall(r"\d+", cited)) <= numbers, (source.name, cited)


def test_every_source_that_a_docstring_cites_is_listed() -> None:
    listed = (ROOT / "docs" / "references.md").read_text()
    for source in SOURCES:
        for key in re.findall(r"\[(\w+)\]_", source.read_text()):
            assert f"[{key}]" in listed, (source.name, key)


def test_every_residual_is_explained_in_the_theory() -> None:
    theory = (ROOT / "docs" / "theory.md").read_text()
    assert all(f"`{name}`" in theory for name in RESIDUALS)


def test_every_dependency_is_accounted_for() -> None:
    project = (ROOT / "pyproject.toml").read_text()
    named = set(re.findall(r'^    "([a-z-]+)>=', project, re.MULTILINE))
    explained = (ROOT / "docs" / "dependencies.md").read_text()
    assert named
    assert all(name in explained for name in named)
