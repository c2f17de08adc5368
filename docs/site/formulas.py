"""Formulas keep the punctuation after them on their line, and options their hyphens."""

from __future__ import annotations

import re

_CODE = re.compile(r"(^```.*?^```|`[^`\n]+`)", re.MULTILINE | re.DOTALL)
_FORMULA = re.compile(r"\$[^$\n]+\$([,.;:)]*)")


def joined(text: str) -> str:
    """Return a page on which no line breaks between a formula and a mark after it.

    A browser may break a line on both sides of a formula, and ignores a word joiner there.
    """
    parts = _CODE.split(text)
    parts[::2] = [_FORMULA.sub(_together, part) for part in parts[::2]]
    return "".join(parts)


def _together(formula: re.Match[str]) -> str:
    return f'<span style="white-space: nowrap">{formula[0]}</span>' if formula[1] else formula[0]


_COMMANDS = re.compile(r'<div class="highlight-sh .*?</pre>', re.DOTALL)
_OPTION = re.compile(r"(?<=[\s>])--?\w[\w-]*")


def unbroken(body: str) -> str:
    """Return the HTML of a page whose commands break between words only, not inside an option."""
    return _COMMANDS.sub(
        lambda block: _OPTION.sub(r'<span class="option">\g<0></span>', block[0]), body
    )
