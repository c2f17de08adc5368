"""A trade as lines to draw: time over error, one line an engine, closure or model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from zeno_orbits.precision import SAME_WORK, Trial, WorkPrecision

LEAST_ERROR = 2.0**-53
"""Rounding of a number: errors below it are drawn at it, as their axis is logarithmic."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TradeLine:
    """A line of a work-precision diagram.

    Attributes:
        label: Its name.
        is_engine: Whether it is that of an engine, which is drawn solid.
        errors: Relative errors.
        milliseconds: Processor times [ms].
    """

    label: str
    is_engine: bool
    errors: tuple[float, ...]
    milliseconds: tuple[float, ...]


def trade_lines(trade: WorkPrecision) -> list[TradeLine]:
    """Return a line for each engine, closure and model; trials without a result are left out."""
    drawn = [t for t in trade.trials if t.sweep in SAME_WORK and math.isfinite(t.error)]
    groups = [(label, list(trials)) for label, trials in groupby(drawn, key=lambda t: t.label)]
    return [
        _line(label, trials[0].sweep == "engine", sorted(trials, key=lambda trial: trial.value))
        for label, trials in groups
    ]


def front_line(trade: WorkPrecision) -> TradeLine:
    """Return the line of the trials that no other one beats in both time and error."""
    return _line("nothing is faster and better", False, trade.front)


def _line(label: str, is_engine: bool, trials: Sequence[Trial]) -> TradeLine:
    return TradeLine(
        label=label,
        is_engine=is_engine,
        errors=tuple(max(trial.error, LEAST_ERROR) for trial in trials),
        milliseconds=tuple(1e3 * trial.seconds for trial in trials),
    )
