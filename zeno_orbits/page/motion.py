"""The motion in a report: the places of its plots, and its events as numbers."""

from __future__ import annotations

from collections.abc import Sequence

from zeno_orbits.closeup import close_up
from zeno_orbits.execution import Execution, Impact, ZenoPoint
from zeno_orbits.page.markup import Html, table, tag
from zeno_orbits.page.places import plot_place, section
from zeno_orbits.page.subject import Subject

_MOST_EVENTS = 40
"""Rows of the table of events."""


def _events(subject: Subject, execution: Execution) -> Html:
    """Return a table of what happens when."""
    rows: list[Sequence[str]] = []
    for event in execution.events:
        speed, word = "", "release"
        if isinstance(event, Impact):
            speed, word = f"{-event.approach_rate:.6g}", "hit"
        elif isinstance(event, ZenoPoint):
            word = f"Zeno point, {event.tail:.2g} s after the last hit followed"
        rows.append((f"{event.time:.12g}", word, speed))
    if len(rows) > _MOST_EVENTS:
        half = _MOST_EVENTS // 2
        between = ("...", f"and {len(rows) - 2 * half} more", "")
        rows = [*rows[:half], between, *rows[-half:]]
    unit = subject.problem.gap_unit
    heads = ("time [s]", "event", f"speed of the hit [{unit}/s]")
    inside = table("Events of one period, times since its start", heads, rows, (0, 2))
    return tag("details", tag("summary", "All events as numbers"), inside)


def motion(subject: Subject) -> Html:
    """Return the places of the phase portraits, the states over time and the zoom."""
    if subject.execution is None:
        sentence = f"The motion could not be followed, so there are no pictures: {subject.trouble}."
        return section("motion", "The motion", tag("p", sentence, class_="warning"))
    portraits = [
        plot_place(f"portrait-{k}", f"Phase portrait, {y} over {x}, over one period.")
        for k, (x, y) in enumerate(subject.problem.portraits)
    ]
    parts = [
        tag(
            "p",
            "Blue: off the stop. Orange and thick: resting on it. Rings: before a hit, dots: "
            "after it; a dashed line joins them. Star: the Zeno point. Square: the release.",
        ),
        tag("div", *portraits, class_="pair"),
        plot_place(
            "series", "All states over one period; shaded while on the stop, hits as lines.", 5
        ),
        _events(subject, subject.execution),
    ]
    if subject.execution.zeno_points:
        several = bool(close_up(subject.execution, subject.dynamics).flights)
        parts += _zoom(several=several)
    return section("motion", "The motion", *parts)


def _zoom(*, several: bool) -> list[Html]:
    """Return the places of the zoom; with several hits, on logarithmic axes as well."""
    head = tag("h3", "Zoom into the Zeno point")
    gap = plot_place("zeno", "Gap over time near the Zeno point.", 12)
    if not several:
        said = "A single hit leads to the Zeno point: nothing piles up, and nothing repeats itself."
        return [head, tag("p", f"{said} Time is counted from the Zeno point."), gap]
    return [
        head,
        tag(
            "p",
            "Each step is ten times closer. Where the hits pile up, the picture repeats itself "
            "at every scale. Time is counted from the Zeno point. Dashed: flights too short to "
            "be simulated one by one, by the law they tend to.",
        ),
        gap,
        tag(
            "p",
            "The same on logarithmic axes, on which equal distances are equal ratios: time "
            "runs to the right and never arrives. First the gap, then the speed of the hits.",
        ),
        tag(
            "div",
            plot_place("gaps", "Gap over the time left to the Zeno point, logarithmic axes."),
            plot_place("speeds", "Speed of the hits over the time left, logarithmic axes."),
            class_="pair",
        ),
    ]
