"""What sections are made of: a head over parts, and the places where plots will stand."""

from __future__ import annotations

from zeno_orbits.report.page.markup import Html, joined, tag


def section(name: str, title: str, *parts: Html) -> Html:
    """Return a section with its head, named for links and screen readers."""
    head = tag("h2", title, id=f"{name}-title")
    return tag("section", head, joined(parts), id=name, aria_labelledby=f"{name}-title")


def plot_place(name: str, caption: str, decades: int = 0) -> Html:
    """Return the place of a plot, with buttons to zoom into the Zeno point where that helps."""
    parts = [tag("div", id=f"plot-{name}", class_="plot", role="img", aria_label=caption)]
    if decades:
        words_of = {"all": "Whole period", "out": "10 × out", "in": "10 × closer"}
        buttons = [
            tag(
                "button",
                text,
                type="button",
                data_plot=name,
                data_zoom=step,
                aria_controls=f"plot-{name}",
            )
            for step, text in words_of.items()
        ]
        window = tag("output", "", id=f"window-{name}", aria_live="polite")
        parts.insert(0, tag("div", *buttons, window, class_="buttons"))
    parts.append(tag("figcaption", caption))
    return tag("figure", *parts)
