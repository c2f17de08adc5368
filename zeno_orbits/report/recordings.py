"""A recording beside an orbit as sentences and a table, for terminal and page."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zeno_orbits.report.table import (
    TableColumn,
    number_column,
    prefixed,
    shown_number,
    shown_with_error,
    text_column,
    with_unit,
)

if TYPE_CHECKING:
    from zeno_orbits.experiment import Comparison, Metric

_ROUNDING = 1e-15
"""Coordinates of this size at the stop are rounding."""
_NAMED = 4
"""Differing quantities that are named."""


def comparison_lines(found: Comparison) -> list[str]:
    """Return the verdict on a recording in words.

    Args:
        found: The comparison.
    """
    from zeno_orbits.experiment import ComparisonVerdict

    if found.verdict is ComparisonVerdict.THIS_ORBIT:
        return ["The recording shows this orbit: all quantities agree within their errors."]
    kind = "a Zeno orbit" if found.is_zeno else "an orbit"
    if found.verdict is ComparisonVerdict.NO_ORBIT:
        why = (f"  {one}." for one in found.reasons)
        return [f"The recording does not show {kind} of this machine:", *why]
    named = [f"  {one.name} {_beside(one)}" for one in found.differences[:_NAMED]]
    others = len(found.differences) - len(named)
    values = [*named, *([f"  and {others} more"] if others else [])]
    if found.verdict is ComparisonVerdict.UNDECIDED:
        why = (f"  {one}." for one in found.unresolved)
        if not values:
            return [f"The recording cannot decide whether the machine moves on {kind}:", *why]
        other = f"and cannot decide whether it shows {kind} of this machine with other values"
        return ["The recording does not show this orbit:", *values, f"{other}:", *why]
    return [f"The recording shows {kind} of this machine with other values:", *values]


def _beside(one: Metric) -> str:
    unit, size = prefixed(one.unit, one.orbit, one.data)
    data = with_unit(shown_with_error(one.data / size, one.error / size), unit)
    return f"{data} instead of {with_unit(seven(one.orbit / size), unit)}"


def known(value: float, form: str, otherwise: str = "-") -> str:
    """Return a value in a format, or another text if it is not finite.

    Args:
        value: The value.
        form: Its format.
        otherwise: The other text.
    """
    return f"{value:{form}}" if math.isfinite(value) else otherwise


def seven(value: float) -> str:
    """Return a value with seven digits, and rounding errors of zero as zero.

    Args:
        value: The value.
    """
    return shown_number(value, 7) if abs(value) > _ROUNDING else "0"


def comparison_columns(found: Comparison) -> list[TableColumn[Metric]]:
    """Return the columns of the quantities of a recording next to the orbit's.

    Args:
        found: The comparison.
    """

    def scale(one: Metric) -> tuple[str, float]:
        return prefixed(one.unit, one.orbit, one.data)

    def shown(one: Metric, value: float, otherwise: str, sign: str = "") -> str:
        size = scale(one)[1]
        if not math.isfinite(value):
            return otherwise
        return shown_with_error(value / size, one.error / size, sign=sign)

    return [
        text_column("quantity", lambda one: one.name),
        number_column("orbit", lambda one: seven(one.orbit / scale(one)[1])),
        number_column(found.recording.label, lambda one: shown(one, one.data, "not resolved")),
        number_column("difference", lambda one: shown(one, one.data - one.orbit, "-", "+")),
        number_column("standard error", lambda one: known(one.error / scale(one)[1], ".2g")),
        text_column("unit", lambda one: scale(one)[0]),
    ]
