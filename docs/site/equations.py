"""Links into the list of equations, `theory.md#eq-7`, lead to the page of the equation instead."""

from __future__ import annotations

import re

_ENTRY = re.compile(r"\]\((\w+\.md)#eq-(\d+)\)")
_LINK = re.compile(r"\]\(((?:\.\./docs/)?)theory\.md#eq-(\d+)\)")


def direct(text: str, listing: str) -> str:
    """Return a page whose links to the list of equations lead past it.

    Sphinx knows no anchor in the cell of a table, and the reader wants the equation.
    """
    pages = {number: page for page, number in _ENTRY.findall(listing)}
    return _LINK.sub(lambda link: f"]({link[1]}{pages[link[2]]}#eq-{link[2]})", text)
