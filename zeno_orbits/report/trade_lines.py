"""A trade as lines to draw, time over error, and as a table of its cheapest settings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from zeno_orbits.precision import SAME_WORK, TimedSetting, WorkPrecision
from zeno_orbits.report.table import TableColumn, number_column, shown_size, text_column

LEAST_ERROR = 2.0**-53
"""Rounding of a number: errors below it are drawn at it, as their axis is logarithmic."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TradeLine:
    """A line of a work-precision diagram.

    Attributes:
        label: Label of the line.
        is_engine: Whether the line belongs to an integrator, which is drawn solid.
        errors: Relative errors.
        milliseconds: Processor times [ms].
    """

    label: str
    is_engine: bool
    errors: tuple[float, ...]
    milliseconds: tuple[float, ...]


def trade_lines(trade: WorkPrecision) -> list[TradeLine]:
    """Return one line per engine, closure and model, without unsuccessful trials."""
    drawn = [t for t in trade.trials if t.sweep in SAME_WORK and math.isfinite(t.error)]
    groups = [(label, list(trials)) for label, trials in groupby(drawn, key=lambda t: t.label)]
    return [
        _line(label, trials[0].sweep == "engine", sorted(trials, key=lambda trial: trial.value))
        for label, trials in groups
    ]


def front_line(trade: WorkPrecision) -> TradeLine:
    """Return the line of the trials on the Pareto front of time and error."""
    return _line("nothing is faster and better", False, trade.front)


def _line(label: str, is_engine: bool, trials: Sequence[TimedSetting]) -> TradeLine:
    return TradeLine(
        label=label,
        is_engine=is_engine,
        errors=tuple(max(trial.error, LEAST_ERROR) for trial in trials),
        milliseconds=tuple(1e3 * trial.seconds for trial in trials),
    )


_ACCURACIES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)

Cheapest = tuple[float, TimedSetting | None]
"""An accuracy, and the cheapest trial that reaches it, if one does."""

CHEAPEST: list[TableColumn[Cheapest]] = [
    number_column("accuracy [1]", lambda one: f"{one[0]:.0e}"),
    text_column("cheapest setting", lambda one: _setting(one[1])),
    number_column("time [ms]", lambda one: f"{1e3 * one[1].seconds:.2f}" if one[1] else ""),
    number_column("error [1]", lambda one: shown_size(one[1].error) if one[1] else ""),
]


def cheapest_of(trade: WorkPrecision) -> list[Cheapest]:
    """Return the cheapest trial for each accuracy."""
    return [(accuracy, trade.cheapest(accuracy)) for accuracy in _ACCURACIES]


def shown_value(trial: TimedSetting) -> str:
    """Return the varied setting of a trial: a count of impacts, or a tolerance."""
    return f"{trial.value:g}" if trial.sweep == "impacts" else f"{trial.value:.0e}"


def _setting(trial: TimedSetting | None) -> str:
    return "none" if trial is None else f"{trial.label}, {shown_value(trial)}"
