"""Number of returns or impacts after which a motion repeats, and the shape of this period."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import UNIT_SCALES, CharacteristicScales
from zeno_orbits.orbits import Cycle, EventSequence, PhaseKind
from zeno_orbits.simulation import PERIODS, Execution, Impact, SectionReturn, repetitions

MOST_IMPACTS = 12
"""Longest period in the search for periods without releases, in impacts."""

_APART = 0.01
"""Factor by which a longer period must reduce the change over a shorter period."""
_ANY = 1.0
"""Largest change of the start over a period with which a period of a given shape is a guess."""
_BETTER = 0.1
"""A longer period is the better guess if its change is below this part of the shorter's change."""
_KEPT = 4 * MOST_IMPACTS


@dataclass(frozen=True, slots=True, kw_only=True)
class Recurring:
    """A period that repeats exactly or roughly.

    Attributes:
        shape: Shape of the period.
        start: Start of the next period, ``(n_x,)``.
        period: Duration of the period [s].
        change: Relative change of the start over the period.
        cycle: The period itself, if it was simulated in one piece.
    """

    shape: EventSequence
    start: Vector
    period: float
    change: float
    cycle: Cycle | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedImpact:
    """An impact of a motion without releases, with its time."""

    time: float
    impact: Impact


@dataclass(frozen=True, slots=True, kw_only=True)
class Recurrence:
    """Events of a motion so far, for the detection of a period.

    Attributes:
        settled: Relative change that counts as zero.
        wanted: The target shape, or ``None`` for any shape.
        returns: The last returns, each from a release to the next, without a break.
        struck: The last impacts since the last contact.
        best: The period of the target shape that came nearest to repeating.
        own: Characteristic scales of the problem.
    """

    settled: float
    wanted: EventSequence | None
    returns: tuple[Cycle, ...] = ()
    struck: tuple[TimedImpact, ...] = ()
    best: Recurring | None = None
    own: CharacteristicScales = UNIT_SCALES

    def after(self, run: Execution, found: Sequence[Cycle], *, since: float) -> Recurrence:
        """Return the events after another piece of the motion.

        Args:
            run: The piece.
            found: The returns in this piece.
            since: Start time of the piece [s].
        """
        struck = [*self.struck, *(TimedImpact(time=since + i.time, impact=i) for i in run.impacts)]
        if run.releases or run.zeno_points:
            struck = []
        returns = [*(() if run.releases and not found else self.returns), *found]
        seen = replace(
            self,
            returns=tuple(returns[-_KEPT:]),
            struck=tuple(struck[-_KEPT:]),
            own=run.own,
        )
        nearest = [*seen.of_wanted_shape(), *(() if self.best is None else (self.best,))]
        return replace(seen, best=min(nearest, key=lambda one: one.change, default=None))

    def settled_to(self) -> Recurring | None:
        """Return the shortest period that repeats, or ``None``."""
        if self.returns:
            seen = _as_returns(self.returns)
            names = self.returns[0].state_names
            usual = self.own.states(len(names))
            found = repetitions(seen, names, close=self.settled, apart=_APART, usual=usual)
            if found:
                return self._after_returns(found[0].returns)
        nearest = math.inf
        for n in range(1, MOST_IMPACTS + 1):
            last = self._after_impacts(n)
            if last is None:
                return None
            if last.change < min(self.settled, _APART * nearest):
                return last
            nearest = min(nearest, last.change)
        return None

    def nearest(self, usable: float) -> Recurring | None:
        """Return the period that may serve as a guess, or ``None``.

        Args:
            usable: Largest change of the start over the period, if any shape is accepted.
        """
        if self.wanted is not None:
            best = self.best
            return best if best is not None and best.change < _ANY else None
        found = [self._after_returns(n) for n in PERIODS]
        if not self.returns:
            found = [self._after_impacts(n) for n in range(1, MOST_IMPACTS + 1)]
        usual = [one for one in found if one is not None and one.change < usable]
        if not usual:
            return None
        # A slow convergence with alternating sign is distinguished when the orbit is closed.
        return next((one for one in usual if one.change < _BETTER * usual[0].change), usual[0])

    def reason(self, horizon: float) -> str:
        """Return the reason of a missing guess, as a clause."""
        settled = self.settled_to()
        if settled is not None:
            return f"the motion settles to an orbit of shape `{settled.shape.text}`"
        if self.wanted is not None:
            return f"no period of shape `{self.wanted.text}` nearly repeats"
        what = "no release is followed by a Zeno point"
        if self.returns:
            what = "its periods differ"
        elif self.struck:
            what = f"{what}, and its impacts do not repeat,"
        return f"{what} after {horizon:g} s"

    def of_wanted_shape(self) -> list[Recurring]:
        """Return the periods of the target shape that end with the last event."""
        if self.wanted is None:
            return []
        if self.wanted.starts_at_release:
            found = [self._after_returns(n) for n in PERIODS]
        else:
            found = [self._after_impacts(self.wanted.n_phases)]
        return [one for one in found if one is not None and one.shape == self.wanted]

    def _after_returns(self, n: int) -> Recurring | None:
        """Return the last returns as one period."""
        if len(self.returns) < n:
            return None
        laps = self.returns[-n:]
        scale = np.max([lap.scale_at_events() for lap in laps], axis=0)
        first, last = laps[0].start.state, laps[-1].end.state
        return Recurring(
            shape=EventSequence(phases=tuple(p.kind for lap in laps for p in lap.phases)),
            start=last,
            period=sum(lap.period for lap in laps),
            change=float(np.max(np.abs(last - first) / scale)),
            cycle=laps[0] if n == 1 else None,
        )

    def _after_impacts(self, n: int) -> Recurring | None:
        """Return the last impacts as one period, if the motion contains twice as many impacts."""
        if len(self.struck) < 2 * n:
            return None
        last, before = self.struck[-n:], self.struck[-2 * n : -n]
        states = [x for one in last for x in (one.impact.state_minus, one.impact.state_plus)]
        scale = self.own.not_small(np.max(np.abs(states), axis=0), 1e-9)
        change = 0.0
        for one, other in zip(last, before, strict=True):
            apart = np.abs(one.impact.state_plus - other.impact.state_plus) / scale
            slower = abs(other.impact.approach_rate / one.impact.approach_rate - 1.0)
            change = max(change, float(np.max(apart)), slower)
        return Recurring(
            shape=EventSequence(phases=n * (PhaseKind.IMPACT,)),
            start=last[-1].impact.state_plus,
            period=last[-1].time - before[-1].time,
            change=change,
        )


def _as_returns(laps: Sequence[Cycle]) -> list[SectionReturn]:
    """Return the releases at the start and at the end of consecutive laps."""
    first = SectionReturn(
        time=laps[0].start.time, state=laps[0].start.state, size=laps[0].scale_at_events()
    )
    later = [
        SectionReturn(time=lap.end.time, state=lap.end.state, size=lap.scale_at_events())
        for lap in laps
    ]
    return [first, *later]
