"""The order of the pages, read out of `docs/README.md`: its headings, and what they list.

A section is a caption of the navigation. A part of a section is folded: its first page stands under
the title of the part, and the other pages of the part below that page.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

_OTHERS = "More"


def navigation(root: Path) -> Mapping[str, Mapping[str, str]]:
    """Return caption to pages, these as paths from the root of the repository, with their titles.

    A page of `docs/` that is listed nowhere comes under a caption of its own, the last.
    """
    captions: dict[str, dict[str, str]] = {}
    for caption, _, page, title in _entries(root):
        captions.setdefault(caption, {})[page] = title
    listed = {page for pages in captions.values() for page in pages} | {"docs/README.md"}
    there = sorted(f"docs/{path.name}" for path in (root / "docs").glob("*.md"))
    others = {page: "" for page in there if page not in listed}
    return captions | ({_OTHERS: others} if others else {})


def folded(root: Path) -> Mapping[str, tuple[str, Mapping[str, str]]]:
    """Return the first page of each part to the title of the part and the pages below it."""
    parts: dict[str, dict[str, str]] = {}
    for _, part, page, title in _entries(root):
        if part:
            parts.setdefault(part, {})[page] = title
    return {
        first: (part, {page: title for page, title in pages.items() if page != first})
        for part, pages in parts.items()
        for first in [next(iter(pages))]
    }


def _entries(root: Path) -> Iterator[tuple[str, str, str, str]]:
    """Yield the section, the part, the path and the title of every listed page."""
    listing = root / "docs" / "README.md"
    caption = part = ""
    for line in listing.read_text().splitlines():
        if line.startswith("## "):
            caption, part = line.removeprefix("## "), ""
        elif line.startswith("### "):
            part = line.removeprefix("### ")
        elif entry := re.match(r"- \[([^\]]+)\]\(([^)#]+)\)", line):
            page = (listing.parent / entry[2]).resolve().relative_to(root.resolve())
            yield caption, part, str(page), entry[1]
