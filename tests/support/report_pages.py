"""What a report's page holds: the data of its plots, its tables, tiles and commands."""

from __future__ import annotations

import json
import re
import shlex
from html import unescape
from typing import Any


def plotted(page: str) -> dict[str, Any]:
    """Return the data that the plots of a page draw."""
    (data,) = re.findall(r'id="data">(.*?)</script>', page, re.DOTALL)
    return json.loads(data)


def tables_in(page: str, section: str) -> list[dict[str, list[str]]]:
    """Return the tables of a section of a page: heading to cells."""
    (inside,) = re.findall(rf'<section id="{section}".*?</section>', page, re.DOTALL)
    found: list[dict[str, list[str]]] = []
    for table in re.findall(r"<table>.*?</table>", inside, re.DOTALL):
        headings, *rows = (_cells(row) for row in re.findall(r"<tr>.*?</tr>", table, re.DOTALL))
        columns = zip(*rows, strict=True)
        found.append(dict(zip(headings, map(list, columns), strict=True)))
    return found


def tiles_in(page: str) -> dict[str, tuple[str, str]]:
    """Return the main numbers of a page: name to number and unit."""
    tile = r"<dt>(.*?)</dt><dd>(.*?) <span class=\"unit\">(.*?)</span>"
    return {
        _text(name): (_text(number), _text(unit)) for name, number, unit in re.findall(tile, page)
    }


def commands_in(page: str) -> list[list[str]]:
    """Return the words of the commands that a page shows."""
    shown = re.findall(r"<pre[^>]*><code>(.*?)</code></pre>", page, re.DOTALL)[0]
    return [shlex.split(line) for line in _text(shown).splitlines()]


def _cells(row: str) -> list[str]:
    return [_text(cell) for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.DOTALL)]


def _text(cell: str) -> str:
    return unescape(re.sub(r"<[^>]+>", "", cell))
