"""Zeno limits that are wrong, which a verification must find."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation import TailEstimate, ZenoExtrapolation, ZenoLimit


@dataclass(frozen=True, kw_only=True)
class FalseLimit(ZenoExtrapolation):
    """The extrapolated limit, with another time or state between two times.

    Attributes:
        delay: Error of its time [s].
        place: The state that is wrong.
        off: Error of this state.
        since: First time of a limit that is wrong.
        until: Last time of a limit that is wrong.
    """

    delay: float = 0.0
    place: int = 0
    off: float = 0.0
    since: float = -math.inf
    until: float = math.inf

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the limit with its errors."""
        limit = ZenoExtrapolation().limit(dynamics, estimates)
        if limit is None or not self.since < limit.time < self.until:
            return limit
        state = limit.state.copy()
        state[self.place] += self.off
        return replace(limit, time=limit.time + self.delay, state=state)
