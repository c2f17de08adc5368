"""Disturbances of an orbit as sentences and tables, for terminal and page."""

from __future__ import annotations

import math
from collections import Counter
from fractions import Fraction
from typing import TYPE_CHECKING

from zeno_orbits.errors import counted
from zeno_orbits.report.push_panels import push_panels
from zeno_orbits.report.symbols import direction_symbol
from zeno_orbits.report.table import TableColumn, number_column, text_column
from zeno_orbits.work import decimal_below

if TYPE_CHECKING:
    from zeno_orbits.maps import Push, Pushes, Recovery


def least_pushes(found: Pushes) -> list[Push]:
    """Return the least push per direction and sense.

    Without a loss it is the push with the shortest scan.
    """
    groups: dict[frozenset[tuple[str, float]], list[Push]] = {}
    for push in found.pushes:
        groups.setdefault(frozenset(push.direction.items()), []).append(push)
    return [min(pushes, key=_rank) for pushes in groups.values()]


def _rank(push: Push) -> tuple[bool, float]:
    """Return the order of pushes: lost pushes first, then by size."""
    kept = math.isnan(push.largest)
    return kept, push.searched if kept else push.largest


def least_push_line(found: Pushes) -> str:
    """Return the least push of all as a sentence."""
    least = found.least
    if least is None:
        return "No impulse of the scan is lost."
    return (
        f"Least push: {least.largest:.6g} {least.unit} along {least.name} at phase "
        f"{least.phase:.4g}, +- {least.error:.1g}; beyond it: {least.beyond}."
    )


def scan_line(found: Pushes) -> str:
    """Return the extent of the search as sentences."""
    scan = f"{found.settings.steps} impulses scanned in each direction and sense"
    return f"{scan}. Each motion was simulated for {found.until:g} s at most."


def summary_line(found: Pushes) -> str:
    """Return the sizes that return at every phase, and the number of rows with a loss."""
    sizes: list[str] = []
    for panel in push_panels(found):
        least = min(abs(impulse) for _, impulse in (*panel.lost, *panel.kept))
        along = direction_symbol(panel.direction, str)
        sizes.append(f"{decimal_below(Fraction(least), 3)} {panel.unit} along {along}")
    ends = Counter(push.beyond for push in found.pushes if math.isfinite(push.largest))
    words = ", ".join(f"{beyond} {count}" for beyond, count in ends.most_common())
    return (
        f"At every phase and in both senses, the motion returns from each scanned impulse up to "
        f"{' and '.join(sizes)}. Rows with a lost impulse: {ends.total()} of {len(found.pushes)}"
        f"{f' ({words})' if words else ''}."
    )


_ROUNDING = 1e-13
"""Extent of a state, relative to the largest extent, that is rounding."""

PUSHES: list[TableColumn[Push]] = [
    number_column("phase [1]", lambda push: f"{push.phase:.4f}"),
    text_column("mode", lambda push: push.mode),
    text_column("direction", lambda push: push.name),
    number_column("largest", lambda push: _finite(push.largest, ".6g")),
    number_column("error", lambda push: _finite(push.error, ".1g")),
    number_column("searched", lambda push: f"{push.searched:.4g}"),
    text_column("unit", lambda push: push.unit),
    text_column("beyond", lambda push: push.beyond),
]
"""Columns of a table of pushes."""


def _finite(value: float, form: str) -> str:
    return f"{value:{form}}" if math.isfinite(value) else "none lost"


def recovery_lines(found: Recovery) -> list[str]:
    """Return the time of the recovery and the ball as sentences."""
    part, wait = found.settings.part, counted(found.periods, "period")
    first = (
        f"A small disturbance decays to {100 * part:g} % in {wait} ({found.time:.6g} s).",
        f"Factor {found.contraction:.4g} per period, spectral radius {found.spectral_radius:.4g}.",
    )
    if not len(found.norm):
        return [*first, "The section of the orbit is a single point."]
    if found.radius == 0.0:
        return [*first, "The smallest ball fails the test."]
    if found.radius == math.inf:
        return [*first, "All samples of every ball of the search return into it."]
    share = f"at most {100 * found.lost_share:.2g} % of the ball leaves it in a period"
    return [
        *first,
        f"Ball whose samples return into it: radius {found.radius:.4g} (scaled, no unit).",
        f"{found.settings.samples} samples return: with confidence "
        f"{100 * found.settings.confidence:g} %, {share}.",
    ]


def extents_of(found: Recovery) -> list[tuple[str, float]]:
    """Return the states that vary inside the ball by more than rounding, with the differences."""
    finite = {name: extent for name, extent in found.extents.items() if extent < math.inf}
    least = _ROUNDING * max(finite.values(), default=0.0)
    return [(name, extent) for name, extent in finite.items() if extent > least]


def extent_columns(found: Recovery) -> list[TableColumn[tuple[str, float]]]:
    """Return the columns of a table of extents."""
    return [
        text_column("state", lambda row: row[0]),
        number_column("extent", lambda row: f"{row[1]:.4g}"),
        text_column("unit", lambda row: found.units[row[0]]),
    ]
