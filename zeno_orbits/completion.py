"""When a sequence of impacts is complete: the extrapolated limit, or the paper's cut.

Source: [OrAmes2011]_ for the cut, theory (11) and (15).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from zeno_orbits.dynamics import HybridDynamics
from zeno_orbits.zeno import TailEstimate, ZenoLimit, extrapolate

_MAY_BEND = 0.1
"""Largest relative change of d2h/dt2 over a Zeno tail; beyond it the tail is not geometric yet."""


class Completion(Protocol):
    """A rule that says when, and where, a sequence of impacts ends."""

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the Zeno point, or nothing if more impacts are to be resolved.

        Args:
            dynamics: The system.
            estimates: The Zeno point to first order from every impact of the sequence so far.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenoExtrapolation:
    """Complete at the extrapolated Zeno limit (theory (15)).

    Attributes:
        tolerance: Largest estimated error of the limit, relative to ``1 + |x|``.
        resolved: Impacts are resolved one by one at least until their speed has fallen to this
            part of the first one's.
    """

    tolerance: float = 1e-12
    resolved: float = 1e-3

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the Zeno point if the impacts so far tell it well enough."""
        last = estimates[-1]
        if last.speed > self.resolved * estimates[0].speed:
            return None
        limit = extrapolate(dynamics, estimates)
        if limit.error > self.tolerance:
            return None
        bend = abs(dynamics.gap_acceleration(limit.state) - last.gap_acceleration)
        return limit if bend <= _MAY_BEND * abs(last.gap_acceleration) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Truncation:
    """Complete by the paper's rule: the first impact slower than `delta` is made plastic.

    Attributes:
        delta: Impact speed below which the sequence is cut (paper, section III).
    """

    delta: float

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the cut, as if it were the Zeno point, if the last impact was slow enough."""
        last = estimates[-1]
        if last.speed >= dynamics.restitution * self.delta:
            return None
        error = last.time - last.impact_time
        return ZenoLimit(time=last.impact_time, state=last.resting, error=error)


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedImpacts:
    """Complete after a number of impacts, at the limit that they tell, whatever its error.

    Attributes:
        n_impacts: Impacts resolved in a sequence.
    """

    n_impacts: int

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the extrapolated Zeno point at the last impact, or nothing before."""
        if len(estimates) < self.n_impacts:
            return None
        return extrapolate(dynamics, estimates)
