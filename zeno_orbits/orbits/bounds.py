"""Bounds on quantities of an orbit, and how far these stay inside."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.simulation import Extent

_KEPT = 1e-9
"""Part of its size by which a quantity may pass its bound: the accuracy of a simulation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """The range that a quantity must keep to.

    Attributes:
        name: The quantity: a signal, bounded at all times, or a number of the whole orbit.
        lower: Smallest allowed value.
        upper: Largest allowed value.
    """

    name: str
    lower: float = -math.inf
    upper: float = math.inf

    def __post_init__(self) -> None:
        """Refuse bounds that exclude nothing, or everything."""
        if not self.lower <= self.upper:
            wanted = "must have bounds LOWER <= UPPER"
            raise InputError(f"Argument `{self.name}` {wanted}, but they are {self.text}.")
        if not (math.isfinite(self.lower) or math.isfinite(self.upper)):
            wanted = "must have a finite bound"
            raise InputError(f"Argument `{self.name}` {wanted}, but it has {self.text}.")

    @property
    def text(self) -> str:
        """The bounds as they are typed, a colon between them, an open end empty."""
        ends = ("" if math.isinf(end) else f"{end:g}" for end in (self.lower, self.upper))
        return ":".join(ends)


def excess(bound: Bound, extent: Extent) -> float:
    """Return by how much a quantity passes its bounds; negative inside them."""
    return max(bound.lower - extent.lowest, extent.highest - bound.upper)


def allowance(bound: Bound, extent: Extent) -> float:
    """Return by how much a quantity may pass its bounds: the accuracy of a simulation."""
    ends = (abs(end) for end in (bound.lower, bound.upper) if math.isfinite(end))
    return _KEPT * max(extent.largest, *ends)


def is_kept(bound: Bound, extent: Extent) -> bool:
    """Return True if a quantity stays within its bounds, to the accuracy of its measurement."""
    return excess(bound, extent) <= max(allowance(bound, extent), extent.error)


def objection_to(bounds: Sequence[Bound], extents: Mapping[str, Extent]) -> str:
    """Return a clause on the bounds that are not kept and by how much; empty if all are."""
    broken = [
        f"`{bound.name}` leaves its bounds {bound.text} by {excess(bound, extents[bound.name]):.3g}"
        for bound in bounds
        if not is_kept(bound, extents[bound.name])
    ]
    return f"{'; '.join(broken)}." if broken else ""


def asked_and_reached(
    bounds: Sequence[Bound], extents: Mapping[str, Extent]
) -> list[dict[str, Any]]:
    """Return the bounds asked of an orbit with the range that it reaches, as plain data."""
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
