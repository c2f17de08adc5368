"""The order of the pages, read out of `docs/README.md`: its headings, and what they list."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

_OTHERS = "More"


def navigation(root: Path) -> Mapping[str, Mapping[str, str]]:
    """Return caption to pages, these as paths from the root of the repository, with their titles.

    A page of `docs/` that is listed nowhere comes under a caption of its own, the last.
    """
    captions: dict[str, dict[str, str]] = {}
    listing = root / "docs" / "README.md"
    caption = ""
    for line in listing.read_text().splitlines():
        if line.startswith("## "):
            caption = line.removeprefix("## ")
        elif entry := re.match(r"- \[([^\]]+)\]\(([^)#]+)\)", line):
            page = (listing.parent / entry[2]).resolve().relative_to(root.resolve())
            captions.setdefault(caption, {})[str(page)] = entry[1]
    listed = {page for pages in captions.values() for page in pages} | {"docs/README.md"}
    there = sorted(f"docs/{path.name}" for path in (root / "docs").glob("*.md"))
    others = {page: "" for page in there if page not in listed}
    return captions | ({_OTHERS: others} if others else {})
