r"""Motions whose restitution scatters from impact to impact, followed one impact at a time.

Every impact on a stop draws its own restitution :math:`e\,(1 + \sigma \xi)` with a standard normal
:math:`\xi`, again if it leaves [0, 1]. The reset is linear in :math:`1 + e`,

.. math:: x^+ = x^- + \frac{1 + e\,(1 + \sigma \xi)}{1 + e}\,(x^+_e - x^-)

After impacts that are :math:`10^{-5}` times slower than the first one, the rest of a sequence has
its mean duration (theory (2.7)). That changes the variance of the Zeno time by a part of
:math:`10^{-10}`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import orbit_event_name, phases_of_events, sequence_of
from zeno_orbits.simulation import (
    Event,
    Execution,
    Impact,
    Release,
    SimulationSettings,
    ZenoPoint,
    simulate,
    state_after,
    state_before,
    tail_time,
)

_SLOW = 1e-5
"""Part of the first speed of a sequence below which the rest has its mean duration."""
_PATIENCE = 4.0
"""Periods of the orbit after which a motion that has not returned is lost."""
_MOST_LEGS = 100_000
"""Events of a period after which it is lost."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScatteredPeriod:
    """A period of a motion that scatters.

    Attributes:
        names: Name of every event.
        times: Times since the start of the period [s].
        on_section: State on the section at its end, before a reset, ``(n_x,)``.
        end: State from which the motion goes on, ``(n_x,)``.
    """

    names: tuple[str, ...]
    times: tuple[float, ...]
    on_section: Vector
    end: Vector


class LostError(Exception):
    """A motion that scatters has left the events of its orbit. The text is the reason."""


@dataclass(slots=True)
class _Way:
    """What is known of a period while it is followed."""

    x: Vector
    time: float
    names: list[str]
    times: list[float]
    fastest: dict[str, float]
    closed: frozenset[str] | None = None
    struck: str = ""

    def add(self, name: str, time: float) -> None:
        self.names.append(name)
        self.times.append(time)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScatteredMotion:
    """The motion of a machine whose restitutions scatter.

    Attributes:
        graph: The graph of modes.
        spreads: Relative standard deviation of the restitution of each stop, ``(n_stops,)``.
        sequence: Event sequence of a period.
        period: Period without scatter [s].
        settings: Accuracy.
    """

    graph: GraphDynamics
    spreads: tuple[float, ...]
    sequence: tuple[str, ...]
    period: float
    settings: SimulationSettings

    def followed(self, x: Vector, random: np.random.Generator) -> ScatteredPeriod:
        """Return the next period from a state just after the last event of a period.

        Args:
            x: The state, ``(n_x,)``.
            random: Source of the scatter.

        Raises:
            LostError: If the events are not those of the orbit, or the motion does not return.
        """
        way = _Way(x=x, time=0.0, names=[], times=[], fastest={})
        for _ in range(_MOST_LEGS):
            run = self._leg(way)
            self._opened(way, run)
            begin = way.time
            for event in run.events:
                way.time = begin + event.time
                end = self._passed(way, event, run, random)
                if end is not None:
                    return end
            if not run.events:
                break
        raise LostError("the motion does not return within four periods")

    def _leg(self, way: _Way) -> Execution:
        """Return the motion to the next impact. It starts at no switch: the guard is zero there."""
        left = _PATIENCE * self.period - way.time
        if not left > 0.0:
            raise LostError("the motion does not return within four periods")
        try:
            return simulate(self.graph, way.x, until=left, impacts=1, settings=self.settings)
        except (SimulationError, InputError) as error:
            raise LostError(f"the motion cannot be continued: {error}") from error

    def _opened(self, way: _Way, run: Execution) -> None:
        """Add the releases that the impact before a leg has caused."""
        if way.closed is None:
            return
        now = run.arcs[0].closed if run.arcs else ()
        for name in sorted(way.closed.difference(now, {way.struck})):
            way.add(f"release {name}", way.time)
        way.closed = None

    def _passed(
        self, way: _Way, event: Event, run: Execution, random: np.random.Generator
    ) -> ScatteredPeriod | None:
        """Pass an event, and return the period if it ends there."""
        name = orbit_event_name(event)
        way.x = np.asarray(state_after(event))
        if not way.names and isinstance(event, Release) and name == self.sequence[-1]:
            # By rounding a start at a release may be in contact for a while.
            return None
        if isinstance(event, ZenoPoint) and event.tail > 0.0:
            raise LostError(f"impacts on `{event.stop}` accumulate beside another stop")
        way.add(name, way.time)
        on_section = way.x if not name.startswith("switch ") else np.asarray(state_before(event))
        if isinstance(event, Impact):
            on_section = self._scatter(way, event, run, random)
        return self._ended(way, on_section)

    def _scatter(
        self, way: _Way, impact: Impact, run: Execution, random: np.random.Generator
    ) -> Vector:
        """Draw the restitution of an impact, and end its sequence if it is slow."""
        graph, k = self.graph, self.graph.stop_names.index(impact.stop)
        closed, sides = run.arcs[-1].mode_in(graph)
        view = graph.view((tuple(j for j in closed if j != k), sides), k)
        speed = -impact.approach_rate
        e = view.speed_after(impact.approach_rate) / speed
        drawn = _drawn(e, self.spreads[k], random)
        before, after = np.asarray(impact.state_minus), np.asarray(impact.state_plus)
        way.x = before + (after - before) * ((1 + drawn) / (1 + e))
        way.closed, way.struck = frozenset(graph.stop_names[j] for j in closed), impact.stop
        first = way.fastest.setdefault(impact.stop, speed)
        if drawn * speed > _SLOW * first:
            return way.x
        resting = view.resting(way.x)
        if resting.gap_acceleration < 0.0:
            left = tail_time(drawn * speed, resting.gap_acceleration, view.restitution)
            way.x = _on_circle(resting.state + left * resting.rate, graph.first.clock)
            way.time += left
            way.add(f"zeno {impact.stop}", way.time)
            del way.fastest[impact.stop]
        return way.x

    def _ended(self, way: _Way, on_section: Vector) -> ScatteredPeriod | None:
        """Return the period if all its events have passed.

        Raises:
            LostError: If there are other events.
        """
        if way.names[-1] != self.sequence[-1]:
            return None
        passed = sequence_of(way.names)
        if passed == self.sequence:
            return ScatteredPeriod(
                names=tuple(way.names), times=tuple(way.times), on_section=on_section, end=way.x
            )
        if len(passed) >= len(self.sequence) and passed[: len(self.sequence)] != self.sequence:
            raise LostError("the events of a period change")
        return None


def _on_circle(x: Vector, clock: Sequence[int]) -> Vector:
    """Return a state with the clock moved back onto its circle, which a straight step leaves."""
    turned = x.copy()
    if clock:
        turned[list(clock)] /= np.linalg.norm(x[list(clock)])
    return turned


def _drawn(e: float, spread: float, random: np.random.Generator) -> float:
    """Return a restitution with a relative standard deviation, in [0, 1]."""
    if spread == 0.0 or e == 0.0:
        return e
    while True:
        drawn = e * (1 + spread * float(random.standard_normal()))
        if 0.0 <= drawn <= 1.0:
            return drawn


def lasting_times(names: Sequence[str], times: Sequence[float], phases: int) -> list[float]:
    """Return the time of the last event of each phase of a period.

    Args:
        names: Names of its events.
        times: Their times.
        phases: Number of phases.
    """
    found = [times[phase[-1]] for phase in phases_of_events(names)]
    if len(found) != phases:
        raise LostError("the events of a period change")
    return found
