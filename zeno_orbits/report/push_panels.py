"""The largest pushes of an orbit as panels over the phase, for page and pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from zeno_orbits.maps import Push, Pushes
from zeno_orbits.simulation import Mode

Point = tuple[float, float]
"""A phase and an impulse, which is negative in the negative sense of its direction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PushPanel:
    """The pushes of one direction over the phase.

    Attributes:
        direction: Coordinate to entry of the generalized force, in the positive sense.
        unit: Unit of the impulses.
        phases: Phases, in order.
        contact: Phases at which the orbit is in contact.
        lost: Largest pushes.
        beyond: Motion after a larger impulse, as text, for each of ``lost``.
        kept: Ends of the scans without a loss.
    """

    direction: Mapping[str, float]
    unit: str
    phases: tuple[float, ...]
    contact: tuple[float, ...]
    lost: tuple[Point, ...]
    beyond: tuple[str, ...]
    kept: tuple[Point, ...]

    @property
    def step(self) -> float:
        """Distance between two phases."""
        return self.phases[1] - self.phases[0] if len(self.phases) > 1 else 1.0


def push_panels(found: Pushes) -> list[PushPanel]:
    """Return one panel per direction, with both senses of the direction."""
    groups: dict[frozenset[tuple[str, float]], list[Push]] = {}
    for push in found.pushes:
        line = frozenset((name, _sense(push) * entry) for name, entry in push.direction.items())
        groups.setdefault(line, []).append(push)
    return [_panel(pushes) for pushes in groups.values()]


def _panel(pushes: list[Push]) -> PushPanel:
    forward = [push for push in pushes if push.is_positive]
    lost = [push for push in pushes if math.isfinite(push.largest)]
    kept = [push for push in pushes if math.isnan(push.largest)]
    return PushPanel(
        direction=forward[0].direction,
        unit=forward[0].unit,
        phases=tuple(sorted({push.phase for push in pushes})),
        contact=tuple(push.phase for push in forward if push.mode == Mode.LOCKED.value),
        lost=tuple((push.phase, _sense(push) * push.largest) for push in lost),
        beyond=tuple(push.beyond for push in lost),
        kept=tuple((push.phase, _sense(push) * push.searched) for push in kept),
    )


def _sense(push: Push) -> float:
    return 1.0 if push.is_positive else -1.0
