"""Rules that complete a sequence of impacts: at its limit, extrapolated or followed, or at a cut.

Source: [OrAmes2011]_ for the cut, theory (2.3), (2.7) and (2.8).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from zeno_orbits.errors import positive_number
from zeno_orbits.integrators import RungeKutta, Stepper, Tolerance
from zeno_orbits.model import HybridDynamics, require_zeno_points
from zeno_orbits.simulation.event_rules import is_geometric
from zeno_orbits.simulation.zeno.rescaled_flight import rescaled_flights
from zeno_orbits.simulation.zeno.zeno_limit import (
    TailEstimate,
    ZenoLimit,
    combine,
    extrapolate,
    law_error,
)
from zeno_orbits.simulation.zeno.zeno_passage import is_settled, pass_through
from zeno_orbits.work import Checked, require_kinds

_FIRST_TRY = 6
"""Number of impacts that determine whether a sequence has settled on its curve.

The curve is tried after this number of impacts, and again whenever the number of impacts has grown
fourfold.
"""
_TRIES = frozenset(_FIRST_TRY * 4**k for k in range(16))

_WORTHWHILE = 100
"""Equivalent cost of the curve, in flights. Fewer flights are simulated one by one."""

_STILL_HOLDS = 0.2
"""Ratio of the gap acceleration at the estimated Zeno point to its value at the last impact, above
which the curve is tried: contact is then expected to persist."""

FINEST = Tolerance(relative=1e-14, absolute=1e-15)
"""Local error of flights whose error is magnified by `1 / (1 - e)`."""


class Completion(Protocol):
    """A rule that determines when and at which point a sequence of impacts ends."""

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the Zeno point, or ``None`` if more impacts are to be resolved.

        Args:
            dynamics: The system.
            estimates: The Zeno point to first order from every impact of the sequence so far.
        """
        ...


def require_completion(completion: Completion, restitutions: Callable[[], Iterable[float]]) -> None:
    """Refuse a rule that ends sequences of impacts by force, if no impacts accumulate.

    Args:
        completion: The rule.
        restitutions: Function that returns the restitution of every stop.

    Raises:
        InputError: If the restitution of every stop is 1.
    """
    if not isinstance(completion, ZenoExtrapolation | ZenoPassage):
        require_zeno_points(min(restitutions(), default=0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenoExtrapolation(Checked):
    """Complete at the extrapolated Zeno limit (theory (2.7)).

    Attributes:
        tolerance: Largest estimated error of the limit, relative to ``1 + |x|``.
        resolved: Impacts are resolved one by one at least until their speed has fallen to this part
            of the first impact's speed.
    """

    tolerance: float = 1e-12
    resolved: float = 1e-3

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the Zeno point if the impacts so far determine it accurately enough."""
        last = estimates[-1]
        if last.speed > self.resolved * estimates[0].speed:
            return None
        raw = combine(estimates, dynamics.own)
        if raw.error > self.tolerance:
            return None
        error = raw.error + law_error(dynamics, estimates, raw)
        if error > self.tolerance:
            return None
        limit = ZenoLimit(time=raw.time, state=dynamics.on_stop(raw.state), error=error)
        at_limit = dynamics.gap_acceleration(limit.state)
        return limit if is_geometric(at_limit, last.gap_acceleration) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenoPassage(Checked):
    """Complete at the Zeno limit, and omit the intermediate impacts if they are many.

    If more than a hundred flights remain, the curve of the impacts is followed directly to its end
    (theory (2.8)). Then the number of flights does not grow as ``e`` approaches 1. If fewer flights
    remain, or the curve cannot be followed, the method is ``ZenoExtrapolation``. The tail of such a
    Zeno point begins at the impact from which the curve was followed. ``tail`` and ``last_speed``
    belong to that impact and need not be small.

    Attributes:
        tolerance: Largest estimated error of the limit, relative to ``1 + |x|``. Along a curve it
            applies to each piece, and the bound is ``1e-14 / (1 - e)`` if that is larger, due to
            rounding.
        resolved: Part of the first speed at which a resolved impact sequence would end.
        engine: The integrator of flights that are not recorded.
    """

    tolerance: float = 1e-12
    resolved: float = 1e-3
    engine: Stepper = field(default_factory=RungeKutta)

    @property
    def one_by_one(self) -> ZenoExtrapolation:
        """The same limit with all intermediate impacts, for callers that count them."""
        return ZenoExtrapolation(tolerance=self.tolerance, resolved=self.resolved)

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the Zeno point if the impacts so far determine it, or if their curve is found."""
        limit = self.one_by_one.limit(dynamics, estimates)
        if limit is not None:
            return limit
        left = self._flights_left(dynamics.restitution, estimates)
        if left < _WORTHWHILE or not _is_due(dynamics, estimates):
            return None
        last = estimates[-1]
        return pass_through(
            dynamics,
            rescaled_flights(dynamics, self.engine, FINEST.times(dynamics.own.least)),
            last.impact_time,
            last.resting,
            last.speed,
            self.tolerance,
            most_flights=left,
        )

    def _flights_left(self, restitution: float, estimates: Sequence[TailEstimate]) -> int:
        """Return the approximate number of flights that a resolved impact sequence still needs."""
        if restitution == 0.0 or estimates[-1].speed == 0.0:
            return 0
        ratio = self.resolved * estimates[0].speed / estimates[-1].speed
        return max(0, round(math.log(ratio) / math.log(restitution)))


def _is_due(dynamics: HybridDynamics, estimates: Sequence[TailEstimate]) -> bool:
    """Return True if the curve is worth a try after the last impact."""
    last, e, own = estimates[-1], dynamics.restitution, dynamics.own
    again = len(estimates) in _TRIES
    if not is_settled(estimates, e, own):
        return False
    if not again and is_settled(estimates[:-1], e, own):
        return False
    holds = dynamics.gap_acceleration(dynamics.on_stop(last.state)) / last.gap_acceleration
    return holds > _STILL_HOLDS


@dataclass(frozen=True, slots=True, kw_only=True)
class Truncation:
    """Complete by the paper's rule: the first impact slower than `delta` is made plastic.

    Attributes:
        delta: Impact speed below which the sequence is cut (paper, section III).
    """

    delta: float

    def __post_init__(self) -> None:
        """Refuse a speed that is not positive."""
        require_kinds(self)
        positive_number("delta", self.delta)

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the cut, as if it were the Zeno point, if the last impact was slow enough."""
        last = estimates[-1]
        if last.speed >= dynamics.speed_after(-self.delta):
            return None
        error = last.time - last.impact_time
        return ZenoLimit(time=last.impact_time, state=last.resting, error=error)


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedImpacts(Checked):
    """Complete after a fixed number of impacts, at their extrapolated limit with any error.

    Attributes:
        n_impacts: Impacts resolved in a sequence.
    """

    n_impacts: int

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the extrapolated Zeno point at the last impact, or ``None`` before."""
        if len(estimates) < self.n_impacts:
            return None
        return extrapolate(dynamics, estimates)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlasticAfter(Checked):
    """Complete at an impact of a sequence, as if it were plastic: smooth in every parameter.

    Attributes:
        n_impacts: Which impact, counted from 1.
    """

    n_impacts: int

    def limit(
        self, dynamics: HybridDynamics, estimates: Sequence[TailEstimate]
    ) -> ZenoLimit | None:
        """Return the impact, or ``None`` before it."""
        del dynamics
        last = estimates[-1]
        if len(estimates) < self.n_impacts:
            return None
        return ZenoLimit(time=last.impact_time, state=last.resting, error=0.0)
