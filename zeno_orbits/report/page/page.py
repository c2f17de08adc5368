"""The whole page: its head, its sections, its data and its scripts."""

from __future__ import annotations

import base64
import gzip
import hashlib
from importlib.resources import files

from zeno_orbits.report.page import sections
from zeno_orbits.report.page.markup import Html, data_of, joined, tag
from zeno_orbits.report.page.plot_data import curves_of
from zeno_orbits.report.page.plotly_bundle import Bundle
from zeno_orbits.report.page.sections import motion, reproduction
from zeno_orbits.report.page.subject import Subject


def page_of(subject: Subject, bundle: Bundle) -> str:
    """Return the page as text; the same subject gives the same text.

    Its own policy forbids it every request and every script but its own two, so that it stays
    offline and harmless even if a text of a problem were HTML.
    """
    script = files("zeno_orbits.report.page").joinpath("page.js").read_text(encoding="utf-8")
    style = files("zeno_orbits.report.page").joinpath("page.css").read_text(encoding="utf-8")
    library = gzip.decompress(base64.b64decode(bundle.packed)).decode()
    title = f"Zeno periodic orbit of {subject.orbit.problem}"
    policy = (
        f"default-src 'none'; script-src {_hashed(script)} {_hashed(library)}; "
        "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    head = joined(
        [
            Html('<meta charset="utf-8">'),
            Html(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
            Html('<meta name="viewport" content="width=device-width, initial-scale=1">'),
            Html('<link rel="icon" href="data:,">'),
            tag("title", title),
            tag("style", Html(style)),
        ]
    )
    body = joined(
        [
            tag("header", tag("h1", title), sections.banner(subject)),
            tag("main", _main(subject, bundle)),
            tag("script", data_of(curves_of(subject)), type="application/json", id="data"),
            tag("script", Html(bundle.packed), type="text/plain", id="library"),
            tag("script", Html(script)),
        ]
    )
    whole = tag("html", joined(["", tag("head", head), tag("body", body), ""]), lang="en")
    return f"<!doctype html>\n{whole}\n"


def _main(subject: Subject, bundle: Bundle) -> Html:
    note = "The pictures are drawn by JavaScript; all numbers and words are here without it."
    return joined(
        [
            tag("p", note, id="note", class_="warning"),
            sections.happens(subject),
            sections.asked(subject),
            motion(subject),
            sections.stability(subject),
            sections.checks(subject),
            sections.margins(subject),
            sections.trade(subject.trade),
            sections.parameters(subject),
            reproduction(subject, bundle),
        ]
    )


def _hashed(script: str) -> str:
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return f"'sha256-{digest}'"
