"""Formulas inside sentences keep the punctuation after them on their line."""

from __future__ import annotations

import re

_CODE = re.compile(r"(^```.*?^```|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
_FORMULA = re.compile(r"(\$[^$\n]+\$)(?=[,.;:)])")
_JOINER = "&#8288;"


def joined(text: str) -> str:
    """Return a page with a word joiner between each formula and a mark after it.

    A browser may break a line on both sides of a formula, also before a comma.
    """
    parts = _CODE.split(text)
    parts[::2] = [_FORMULA.sub(rf"\1{_JOINER}", part) for part in parts[::2]]
    return "".join(parts)
