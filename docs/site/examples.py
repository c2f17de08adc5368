"""The examples of `docs/examples.md`: a heading there names what its example is of."""

from __future__ import annotations

import re


def examples(page: str) -> dict[str, str]:
    """Return public name to its example, of the page that has a heading for each."""
    found: dict[str, str] = {}
    for section in re.split(r"^### ", page, flags=re.MULTILINE)[1:]:
        heading, _, text = section.partition("\n")
        text = re.split(r"^## ", text, flags=re.MULTILINE)[0].strip()
        found |= dict.fromkeys(re.findall(r"`(\w+)`", heading), text)
    return found
