"""HTML from values: whatever is no `Html` is text, and is escaped."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def html_of(value: str) -> Html:
    """Return a value as HTML: as it is if it is that already, escaped if not."""
    return value if isinstance(value, Html) else Html(escape(value))


def joined(parts: Iterable[str]) -> Html:
    """Return the parts one after the other, one a line."""
    return Html("\n".join(html_of(part) for part in parts))


def tag(name: str, *children: str, **attributes: str) -> Html:
    """Return an element.

    Args:
        name: Its name.
        children: What it holds; text is escaped.
        attributes: A trailing underscore is dropped, as in ``class_``; others become hyphens.
    """
    pairs = (
        f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for key, value in attributes.items()
    )
    inside = "".join(html_of(child) for child in children)
    return Html(f"<{name}{''.join(pairs)}>{inside}</{name}>")


def table(
    caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()
) -> Html:
    """Return a table that scrolls by itself where the page is narrow, or folds if it ends in words.

    Args:
        caption: What it shows.
        heads: Heads of the columns.
        rows: Cells; the first of a row is its head.
        numbers: Columns of numbers, set to the right.
    """
    kinds = ["number" if k in numbers else "text" for k in range(len(heads))]
    head = tag(
        "tr",
        *(
            tag("th", text, scope="col", class_=kind)
            for text, kind in zip(heads, kinds, strict=True)
        ),
    )
    body = [
        tag(
            "tr",
            tag("th", row[0], scope="row", class_=kinds[0]),
            *(tag("td", cell, class_=kind) for cell, kind in zip(row[1:], kinds[1:], strict=True)),
        )
        for row in rows
    ]
    inside = tag("table", tag("caption", caption), tag("thead", head), tag("tbody", *body))
    # A region that scrolls must be reachable by keyboard.
    kind = "wide stack" if len(heads) > 3 and len(heads) - 1 not in numbers else "wide"
    return tag("div", inside, class_=kind, tabindex="0", role="region", aria_label=caption)


def data_of(data: Any) -> Html:
    """Return data as JSON that may stand inside a script element, whatever texts it holds."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Html(text)
