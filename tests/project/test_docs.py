"""The documents say what is so: links lead somewhere, citations exist, the site has every page."""

import json
import re
from collections import Counter
from pathlib import Path

import pytest

import zeno_orbits as zo
from docs.site.commands import command_page
from docs.site.docstrings import linked
from docs.site.examples import examples
from docs.site.formulas import joined, unbroken
from docs.site.navigation import folded, navigation
from zeno_orbits.verification import RESIDUALS

ROOT = Path(__file__).parents[2]
THEORY = ROOT / "docs" / "theory.md"
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
SOURCES = sorted([*(ROOT / "zeno_orbits").rglob("*.py"), *(ROOT / "problems").rglob("*.py")])


def _anchors(document: Path) -> set[str]:
    return set(re.findall(r'<a id="([^"]+)"></a>', document.read_text()))


def test_the_readme_is_short_and_shows_an_orbit_near_its_top() -> None:
    lines = (ROOT / "README.md").read_text().splitlines()
    assert len(lines) < 120
    assert any(line.startswith("![") for line in lines[:12])


def test_every_link_of_a_document_leads_somewhere() -> None:
    links = [
        (document, target)
        for document in DOCUMENTS
        for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text())
        if not target.startswith("http")
    ]
    for document, target in links:
        name, _, anchor = target.partition("#")
        path = (document.parent / name).resolve() if name else document
        assert path.exists(), (document.name, target)
        assert not anchor or anchor in _anchors(path), (document.name, target)


def test_no_two_documents_have_an_anchor_of_one_name() -> None:
    named = Counter(name for document in DOCUMENTS for name in _anchors(document))
    assert [name for name, n in named.items() if n > 1] == []


def _equations() -> Counter[str]:
    """Return equation number to the number of pages that contain it, the list apart."""
    pages = [path for path in (ROOT / "docs").glob("*.md") if path != THEORY]
    anchors = [re.fullmatch(r"eq-(\d+)-(\d+)", name) for path in pages for name in _anchors(path)]
    return Counter(f"{anchor[1]}.{anchor[2]}" for anchor in anchors if anchor)


def test_the_list_of_the_theory_leads_to_every_equation_and_each_has_one_page() -> None:
    cell = r"\((\d+\.\d+)\) \[(.+)\]\((\w+\.md)#eq-(\d+)-(\d+)\)"
    former = r'<a id="eq-(\d+)"></a>\((\d+)\)'
    rows = re.findall(rf"^\| {cell} \| {former} \|$", THEORY.read_text(), re.MULTILINE)
    for shown, title, page, chapter, number, anchor, old in rows:
        assert shown == f"{chapter}.{number}"
        assert anchor == old
        assert f"\n### ({shown}) {title}\n" in (THEORY.parent / page).read_text()
    assert set(_equations().values()) == {1}
    assert [row[0] for row in rows] == sorted(
        _equations(), key=lambda number: [int(part) for part in number.split(".")]
    )


def test_a_page_of_the_theory_numbers_its_equations_in_order() -> None:
    pages = re.findall(r"^\| \[.*\]\((theory_\w+\.md)\) \| (.*) \|$", THEORY.read_text(), re.M)
    assert len(pages) == 6
    for chapter, (name, stated) in enumerate(pages, 1):
        page = (THEORY.parent / name).read_text()
        titles = re.findall(r"^### \((\d+\.\d+)\) ", page, re.MULTILINE)
        assert titles == [f"{chapter}.{k}" for k in range(1, len(titles) + 1)]
        assert stated == f"({titles[0]}) to ({titles[-1]})"
        assert f"This page contains the equations {stated}." in page


def test_every_equation_that_a_docstring_cites_exists() -> None:
    numbers = set(_equations())
    for source in SOURCES:
        for cited in re.findall(r"theory ((?:\(\d+\)(?:, | and |-)?)+)", source.read_text()):
            assert set(re.findall(r"\d+\.\d+", cited)) <= numbers, (source.name, cited)


def test_every_source_that_a_docstring_cites_is_listed() -> None:
    listed = (ROOT / "docs" / "references.md").read_text()
    for source in SOURCES:
        for key in re.findall(r"\[(\w+)\]_", source.read_text()):
            assert f"[{key}]" in listed, (source.name, key)


def test_every_residual_is_explained_in_the_theory() -> None:
    theory = (ROOT / "docs" / "theory_orbits.md").read_text()
    assert all(f"`{name}`" in theory for name in RESIDUALS)


def test_every_page_is_in_the_navigation_of_the_site_once() -> None:
    captions = navigation(ROOT)
    listed = [page for pages in captions.values() for page in pages]
    assert len(listed) == len(set(listed))
    pages = [*(ROOT / "docs").glob("*.md"), *(ROOT / "notebooks").glob("*.ipynb")]
    there = {str(page.relative_to(ROOT)) for page in pages} - {"docs/README.md"}
    assert there <= set(listed)


def test_a_page_that_the_list_of_documents_lacks_comes_last(tmp_path: Path) -> None:
    docs = tmp_path / "docs"
    docs.mkdir()
    for name in ("here", "new"):
        (docs / f"{name}.md").write_text("# A page")
    (docs / "README.md").write_text("# Documents\n\n## How to\n\n- [Here](here.md): a page.\n")
    assert navigation(tmp_path) == {"How to": {"docs/here.md": "Here"}, "More": {"docs/new.md": ""}}


def test_theory_proofs_and_benchmarks_are_folded() -> None:
    parts = folded(ROOT)
    assert [title for title, _ in parts.values()] == ["Theory", "Proofs", "Benchmarks"]
    listed = [page for pages in navigation(ROOT).values() for page in pages]
    for first, (_, inside) in parts.items():
        assert inside
        assert first not in inside
        assert {first, *inside} <= {*listed}
    assert {f"docs/{path.name}" for path in (ROOT / "docs").glob("theory_*.md")} == {
        *parts["docs/theory.md"][1]
    }


def test_a_part_of_a_section_is_folded_below_its_first_page(tmp_path: Path) -> None:
    docs = tmp_path / "docs"
    docs.mkdir()
    entries = "".join(f"- [{name.upper()}]({name}.md)\n" for name in "bcd")
    parts = f"## One\n\n- [A](a.md)\n\n### Part\n\n{entries}\n## Two\n\n- [E](e.md)\n"
    listing = f"# Documents\n\n{parts}"
    (docs / "README.md").write_text(listing)
    assert folded(tmp_path) == {"docs/b.md": ("Part", {"docs/c.md": "C", "docs/d.md": "D"})}
    assert [*navigation(tmp_path)] == ["One", "Two"]


def test_the_readme_starts_with_three_ways_in() -> None:
    text = (ROOT / "README.md").read_text()
    ways = re.findall(r"^- \*\*(.+?):\*\* .*\]\((.+?)\)", text[: text.index("![")], re.MULTILINE)
    assert [name for name, _ in ways] == ["Find an orbit", "Check an orbit", "Your own machine"]


def test_options_of_commands_are_not_broken_and_outputs_stay_as_they_are() -> None:
    words = 'zeno-orbits map a-b --t-end<span class="w"> </span>1<span class="w"> </span>-o x'
    command = f'<div class="highlight-sh notranslate"><pre>{words}\n</pre>'
    output = '<div class="highlight-text notranslate"><pre>a --t-end -1</pre>'
    shown = unbroken(command + output)
    assert re.findall(r'<span class="option">(.*?)</span>', shown) == ["--t-end", "-o"]
    assert re.sub(r'<span class="option">(.*?)</span>', r"\1", shown) == command + output
    assert shown.endswith(output)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_asks_predicts_asserts_and_ends_with_exercises(path: Path) -> None:
    cells = json.loads(path.read_text())["cells"]
    first, last = ("".join(cells[k]["source"]) for k in (0, -1))
    assert first.startswith("# ")
    assert re.search(r"\*{0,2}Question[.:]", first)
    assert "prediction |" in first
    checks = cells[-2]
    assert checks["cell_type"] == "code"
    assert "hide-input" in checks["metadata"]["tags"]
    assert "".join(checks["source"]).splitlines()[-1].strip().startswith("assert ")
    assert last.startswith("## Exercises\n")
    assert len(re.findall(r"^\d\. ", last.split("<details>")[0], re.MULTILINE)) == 2


def test_pages_and_notebooks_import_from_the_front_door_alone() -> None:
    texts = [path.read_text() for path in [*DOCUMENTS, *NOTEBOOKS]]
    assert not re.findall(r"from zeno_orbits\.\w+", "\n".join(texts))


def test_every_file_that_a_change_may_need_exists() -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text()
    table = page[page.index("## Where to change what") : page.index("## House rules")]
    named = re.findall(r"`((?:zeno_orbits|docs)/[\w./]+)`", table)
    assert len(named) > 15
    assert all((ROOT / name).exists() for name in named), named


def test_docstrings_cite_by_links_on_the_site() -> None:
    cited = "As in theory (5.5) to (5.8), and theory (1.7). Source: [Keller1977]_."
    links = [f":ref:`({k}) <eq-{k.replace('.', '-')}>`" for k in ("5.5", "5.8", "1.7")]
    source = ":ref:`[Keller1977] <Keller1977>`"
    wanted = f"As in theory {links[0]} to {links[1]}, and theory {links[2]}. Source: {source}."
    assert linked(cited) == wanted


def test_punctuation_stays_with_the_formula_before_it_on_the_site() -> None:
    together = '<span style="white-space: nowrap">$b$,</span>'
    assert joined("With $a$ and $b$, as in (1).") == f"With $a$ and {together} as in (1)."
    for code in ("`$a$, $b$.`", "```sh\necho $a$, $b$.\n```"):
        assert joined(code) == code


def test_the_page_of_the_command_line_has_every_command_and_option() -> None:
    page = command_page()
    for name in ("search", "verify", "continue", "map"):
        assert f"## `{name}`" in page
    assert "`--bounds NAME=LOWER:UPPER`" in page
    assert "zeno-orbits search motor_pendulum -o orbit.json" in page


def test_every_public_name_has_an_example() -> None:
    shown = examples((ROOT / "docs" / "examples.md").read_text())
    assert sorted(shown) == sorted(zo.__all__)
    for name, text in shown.items():
        assert "```python" in text
        assert re.search(rf"\b{name}\b", text), name


def test_every_dependency_is_accounted_for() -> None:
    project = (ROOT / "pyproject.toml").read_text()
    named = set(re.findall(r'^    "([a-z-]+)>=', project, re.MULTILINE))
    explained = (ROOT / "docs" / "dependencies.md").read_text()
    assert named
    assert all(name in explained for name in named)
