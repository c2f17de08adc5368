"""Bounds on quantities of an orbit, and distances of the quantities from their bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from zeno_orbits.errors import InputError, any_number
from zeno_orbits.simulation import Extent
from zeno_orbits.work import require_kinds

_KEPT = 1e-9
"""Largest violation of a bound, relative to the quantity's size: the accuracy of a simulation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """The allowed range of a quantity.

    Attributes:
        name: The quantity: a signal, bounded at all times, or a scalar of the whole orbit.
        lower: Smallest allowed value.
        upper: Largest allowed value.
    """

    name: str
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        """Reject bounds that allow every value, or none."""
        for end in (self.lower, self.upper):
            any_number(self.name, end)
        require_kinds(self)
        if not self.lower <= self.upper:
            wanted = "must have bounds LOWER <= UPPER"
            raise InputError(f"Argument `{self.name}` {wanted}, but they are {self.text}.")
        if not (math.isfinite(self.lower) or math.isfinite(self.upper)):
            wanted = "must have a finite bound"
            raise InputError(f"Argument `{self.name}` {wanted}, but it has {self.text}.")

    @property
    def text(self) -> str:
        """The bounds in the format of the input: with a colon between, and an open end empty."""
        ends = ("" if math.isinf(end) else f"{end:g}" for end in (self.lower, self.upper))
        return ":".join(ends)


def excess(bound: Bound, extent: Extent) -> float:
    """Return the violation of the bounds by a quantity, negative inside the bounds."""
    return max(bound.lower - extent.lowest, extent.highest - bound.upper)


def allowance(bound: Bound, extent: Extent) -> float:
    """Return the largest accepted violation of the bounds: the accuracy of a simulation."""
    ends = (abs(end) for end in (bound.lower, bound.upper) if math.isfinite(end))
    return _KEPT * max(extent.largest, *ends)


def is_kept(bound: Bound, extent: Extent) -> bool:
    """Return True if a quantity is within its bounds, to the accuracy of its computation."""
    return excess(bound, extent) <= max(allowance(bound, extent), extent.error)


def objection_to(bounds: Sequence[Bound], extents: Mapping[str, Extent]) -> str:
    """Return a clause with the violated bounds and the violations. It is empty without any."""
    broken = [
        f"`{bound.name}` leaves its bounds {bound.text} by {excess(bound, extents[bound.name]):.3g}"
        for bound in bounds
        if not is_kept(bound, extents[bound.name])
    ]
    return f"{'; '.join(broken)}." if broken else ""


def asked_and_reached(
    bounds: Sequence[Bound], extents: Mapping[str, Extent]
) -> list[dict[str, Any]]:
    """Return the requested bounds of an orbit and the ranges that it reaches, as plain data."""
    return [
        {
            "quantity": bound.name,
            "lower": bound.lower if math.isfinite(bound.lower) else None,
            "upper": bound.upper if math.isfinite(bound.upper) else None,
            "lowest": extents[bound.name].lowest,
            "highest": extents[bound.name].highest,
            "kept": is_kept(bound, extents[bound.name]),
        }
        for bound in bounds
    ]
