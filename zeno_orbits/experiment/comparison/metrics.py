"""Contact quantities of a recording next to the orbit's quantities (theory (6.9))."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.contact_fit import ContactFit
from zeno_orbits.experiment.comparison.estimate import Estimate
from zeno_orbits.experiment.orbit_table import OrbitTable
from zeno_orbits.model import unit_quotient
from zeno_orbits.work import Columns


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """A quantity of the record and of the orbit.

    Attributes:
        name: Name of the quantity.
        unit: Unit of the quantity.
        orbit: Value for the orbit.
        data: Value for the record, NaN if the record does not determine it.
        error: Standard error of the record's value, NaN if it is unknown.
        rounding: Largest error by the rounding of samples, which is part of the standard error.
    """

    name: str
    unit: str
    orbit: float
    data: float
    error: float
    rounding: float = 0.0

    def largest_error(self, multiple: float) -> float:
        """Return a multiple of the random error, plus the largest error by rounding."""
        random = math.sqrt(max(self.error**2 - self.rounding**2, 0.0))
        return multiple * random + self.rounding

    def as_json(self) -> dict[str, Any]:
        """Return the quantity as plain data, with null for unknown values."""
        return {
            "unit": self.unit,
            "orbit": plain_number(self.orbit),
            "data": plain_number(self.data),
            "difference": plain_number(self.data - self.orbit),
            "standard_error": plain_number(self.error),
        }


def named_metric(metrics: Sequence[Metric], name: str) -> Metric:
    """Return a quantity by its name.

    Raises:
        InputError: If no quantity has this name.
    """
    for one in metrics:
        if one.name == name:
            return one
    known = ", ".join(one.name for one in metrics)
    raise InputError(f"Argument `metric` must be one of {known}, but it is `{name}`.")


def metric_columns(metrics: Sequence[Metric]) -> Columns:
    """Return the values of the recording next to the values of the orbit."""
    names = ("name", "unit", "orbit", "data", "error")
    return {name: [getattr(one, name) for one in metrics] for name in names}


def plain_number(value: float) -> float | None:
    """Return a number for JSON, with null for an unknown value."""
    return float(value) if math.isfinite(value) else None


def metric(name: str, unit: str, orbit: float, found: Estimate) -> Metric:
    """Return a quantity of the record and of the orbit.

    Args:
        name: Name of the quantity.
        unit: Unit of the quantity.
        orbit: Value for the orbit.
        found: Value for the record, with its standard error.
    """
    return Metric(
        name=name,
        unit=unit,
        orbit=orbit,
        data=found.value,
        error=found.error,
        rounding=found.rounding,
    )


def contact_metrics(
    table: OrbitTable, found: ContactFit, where: Alignment, unit: str
) -> Iterator[Metric]:
    """Yield times, speed and restitution of the contacts.

    Args:
        table: The orbit.
        found: The contacts of the recording.
        where: Alignment of the orbit with the recording. Its error contributes to the times since
            the release.
        unit: Unit of the gap.
    """
    first, zeno, period = table.first_impact, table.zeno_time, table.period
    own_speed = table.impacts[0].approach_rate
    e = table.rebound_speed / -own_speed
    yield metric("first impact time", "s", first, found.landing.unsure(where.error))
    yield metric("first impact speed", unit_quotient(unit, "s"), own_speed, found.speed)
    yield metric("restitution seen", "1", e, found.restitution.unsure(found.rebound_doubt))
    yield metric("end of chatter", "s", zeno, found.chatter_end.unsure(where.error))
    yield metric("chatter duration", "s", zeno - first, found.chatter)
    yield metric("contact duration", "s", period - zeno, found.contact)
    yield metric("release time", "s", period, found.release.unsure(where.error))
    yield metric("gap in contact", unit, 0.0, found.level)
