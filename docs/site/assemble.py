"""Lay out the pages for Sphinx: those that GitHub shows, and those that code writes.

`python docs/site/assemble.py FOLDER` fills the folder. Links stay as they are, since the pages keep
their places; the front page is the README of the repository.
"""

from __future__ import annotations

import inspect
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from commands import command_page
from examples import examples
from formulas import joined
from navigation import folded, navigation

import zeno_orbits
from zeno_orbits.work import TableRepr

ROOT = Path(__file__).parents[2]
ELSEWHERE = ("CODE_OF_CONDUCT.md", "CONTRIBUTING.md", "CHANGELOG.md", "LICENSE", "CITATION.cff")
READ_BY_DEVELOPERS = ("tests/README.md", "benchmarks/README.md")
REFERENCE, COMMANDS = "docs/reference.md", "docs/commands.md"
EXAMPLES = "docs/examples.md"


def assemble(folder: Path) -> None:
    """Write everything that the site is made of into an empty folder."""
    for name in ("docs/pictures", "notebooks"):
        shutil.copytree(ROOT / name, folder / name)
    pages = [*ELSEWHERE, *READ_BY_DEVELOPERS]
    pages += [f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md")]
    below = folded(ROOT)
    for name in pages:
        text = _for_sphinx((ROOT / name).read_text())
        _, inside = below.get(name, ("", {}))
        tree = _toctree([f"{title} </{page}>" for page, title in inside.items()]) if inside else ()
        _write(folder / name, "\n".join([text, *tree]))
    _write(folder / COMMANDS, command_page())
    _write_reference(folder)
    front = _with_cards(_for_sphinx((ROOT / "README.md").read_text()))
    _write(folder / "index.md", "\n".join([front, *_toctrees()]))


def _for_sphinx(text: str) -> str:
    """Return a page whose anchors are targets, and whose links lead to pages of the site."""
    text = re.sub(r'^<a id="([^"]+)"></a>\n', r"(\1)=\n", text, flags=re.MULTILINE)
    text = re.sub(r'^- <a id="([^"]+)"></a>', r"- (\1)=\n  ", text, flags=re.MULTILINE)
    text = joined(text)
    return text.replace("](../README.md", "](../index.md")


def _with_cards(text: str) -> str:
    """Return the front page with its first list as cards beside each other."""
    return re.sub(r"(?:^- .*\n)+", r"```{container} cards\n\g<0>```\n", text, count=1, flags=re.M)


def _toctrees() -> Iterator[str]:
    parts = folded(ROOT)
    hidden = {page for _, inside in parts.values() for page in inside}
    for caption, pages in navigation(ROOT).items():
        titles = {page: parts[page][0] if page in parts else title for page, title in pages.items()}
        shown = [
            f"{title} <{page}>" if title else page
            for page, title in titles.items()
            if page not in hidden
        ]
        if REFERENCE in pages:
            shown.insert(0, COMMANDS)
        yield from _toctree(shown, caption)
    yield from _toctree(["docs/README.md", *READ_BY_DEVELOPERS], "For developers")


def _toctree(pages: list[str], caption: str = "") -> Iterator[str]:
    heading = [f":caption: {caption}"] if caption else []
    yield from ("", "```{toctree}", ":hidden:", *heading, "", *pages, "```")


def _write_reference(folder: Path) -> None:
    """Write a page for each public name, and link the page that lists them to these."""
    page = (folder / REFERENCE).read_text()
    names = listed_names(page)
    page = re.sub(
        r"^\| (`.*?`) \|",
        lambda row: "| " + re.sub(r"`(\w+)`", r"[`\1`](api/\1.md)", row[1]) + " |",
        page,
        flags=re.MULTILINE,
    )
    pages = [f"api/{name}.md" for name in names]
    _write(folder / REFERENCE, "\n".join([page, *_toctree(pages)]))
    shown = examples((ROOT / EXAMPLES).read_text())
    for name in names:
        directive = ("```{eval-rst}", *_directive(name), "```", "")
        text = "\n".join([f"# `{name}`", "", *directive, "## Example", "", shown[name], ""])
        _write(folder / "docs" / "api" / f"{name}.md", text)


def listed_names(page: str) -> list[str]:
    """Return the public names that the first column of the reference lists, in order."""
    rows = re.findall(r"^\| (`.*?`) \|", page, re.MULTILINE)
    return [name for row in rows for name in re.findall(r"`(\w+)`", row)]


def _directive(name: str) -> tuple[str, ...]:
    value = getattr(zeno_orbits, name)
    if inspect.isclass(value):
        # Results share how they become tables; nothing else of a base class is for users.
        shared = ("   :inherited-members:",) if issubclass(value, TableRepr) else ()
        return (f".. autoclass:: zeno_orbits.{name}", "   :members:", *shared)
    if inspect.isfunction(value):
        return (f".. autofunction:: zeno_orbits.{name}",)
    # The text of a value stands where it is defined.
    stub = Path(zeno_orbits.__file__).with_suffix(".pyi").read_text()
    home = re.search(rf"^from \.(\S+) import {name} as", stub, re.MULTILINE)
    where = f"zeno_orbits.{home[1]}" if home else "zeno_orbits"
    return (f".. autodata:: {where}.{name}", "   :no-value:")


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


if __name__ == "__main__":
    assemble(Path(sys.argv[1]))
