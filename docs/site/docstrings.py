"""What docstrings cite becomes links: `theory (1.7)` the equation, `[Keller1977]_` the source."""

from __future__ import annotations

import re
from typing import Any

_EQUATIONS = re.compile(r"theory\s\(\d+\.\d+\)(?:(?:,\s|\sand\s|\sto\s|-)\(\d+\.\d+\))*")
_NUMBER = re.compile(r"\((\d+)\.(\d+)\)")
_KEY = re.compile(r"\[(\w+)\]_")


def linked(text: str) -> str:
    """Return a docstring with its citations as references."""
    text = _EQUATIONS.sub(lambda cited: _NUMBER.sub(r":ref:`(\1.\2) <eq-\1-\2>`", cited[0]), text)
    return _KEY.sub(r":ref:`[\1] <\1>`", text)


def _link(_app: Any, _what: str, _name: str, _of: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = linked("\n".join(lines)).split("\n")


def _readable(
    _app: Any,
    _what: str,
    _name: str,
    _of: Any,
    _options: Any,
    signature: str | None,
    returned: str | None,
) -> tuple[str | None, str | None]:
    """Return a signature that parses: a default that is made anew has no expression."""
    words = re.sub(r"<function (\w+)(?: at \w+)?>", r"\1", signature or "")
    return words.replace("<factory>", "...") or None, returned


def setup(app: Any) -> dict[str, bool]:
    """Connect with autodoc."""
    app.connect("autodoc-process-signature", _readable)
    app.connect("autodoc-process-docstring", _link)
    return {"parallel_read_safe": True}
