r"""Return maps along a line of parameters, with exact derivatives and the margins of each return.

A return map takes a section to itself. Returns are computed in the full state, so that they can be
composed:

.. math:: D(P_2 \circ P_1) = \partial_x P_2\; D P_1 + \partial_s P_2

Orbits with a Zeno point return from release to release. Those without one return from impact to
impact: the section are the states just after an impact, :math:`h = 0`, :math:`\dot h > 0`, of
dimension :math:`n_x - 1` less the holonomic rows. Source: theory (37).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from typing import ClassVar, Protocol, Self

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import CompiledSystem, HybridDynamics, bind
from zeno_orbits.orbits import (
    IMPACT_ROWS,
    RELEASE_ROWS,
    Line,
    Section,
    differentials_of,
    loosened,
    projected,
    return_derivative,
    section_along,
)
from zeno_orbits.simulation import (
    Arc,
    Ending,
    Execution,
    Mode,
    Perturbations,
    SimulationSettings,
    least_inside,
    simulate,
)


class Loss(Enum):
    """Kinds of margins: numbers that are positive along a family. The value is the word shown.

    ``AMPLITUDE`` is the largest range of any state over a few fixed phases of a return, in the
    problem's own sizes: smooth along a family, and zero where the motion stands still. The
    amplitude that a problem names is `orbit_amplitude`.
    """

    AMPLITUDE = "amplitude"
    LOCK = "locked time"
    ACCELERATION = "acceleration onto the stop at the Zeno point"
    FIRST_IMPACT = "speed of the first impact"
    NEAR_MISS = "least gap before the first impact"
    LATER_IMPACT = "speed of a later impact, as part of that of the flight before it"
    RELEASE_RATE = "rate of the multiplier at the release"
    ADHESION = "least multiplier on the locked arc"
    CUT = "distance from the separatrix of the impacts"


@dataclass(frozen=True, slots=True, kw_only=True)
class Margin:
    """A margin of one of several returns.

    Attributes:
        loss: Its kind.
        place: The return, counted from 0.
    """

    loss: Loss
    place: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentiatedReturn:
    """A return and its derivatives in the full state.

    Attributes:
        time: How long it takes [s].
        end: Where it ends, ``(n_x,)``.
        by_state: Derivative of the end by the start, ``(n_x, n_x)``.
        by_parameter: Derivative of the end by the place on the line, ``(n_x,)``.
        margins: Its distance from each loss.
    """

    time: float
    end: Vector
    by_state: Vector
    by_parameter: Vector
    margins: Mapping[Margin, float]


class ReturnMap(Protocol):
    """A section and its return map, along a line of parameters."""

    @property
    def line(self) -> Line:
        """The line."""
        ...

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion from a state of the section to the next.

        Args:
            x: The state, ``(n_x,)``.
            s: Place on the line.
            horizon: Longest time to wait [s].

        Raises:
            ZenoOrbitsError: If nothing comes back within the horizon, or not differentiably.
        """
        ...

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return the section around a state of it.

        Args:
            x: The state, ``(n_x,)``.
            s: Place on the line.
            scale: Size of each state, ``(n_x,)``.
        """
        ...

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        """Return the state of the section nearest to a state.

        Args:
            x: The state, ``(n_x,)``.
            s: Place on the line.
            scale: Size of each state, ``(n_x,)``.
        """
        ...

    def restitution(self, s: float) -> float:
        """Return the coefficient of restitution at a place on the line."""
        ...

    def loosened(self) -> ReturnMap:
        """Return the same map at a looser tolerance: what that changes is an error estimate."""
        ...

    def moved_to(self, line: Line) -> ReturnMap:
        """Return the same map along another line."""
        ...


@dataclass(frozen=True, kw_only=True)
class SectionReturns:
    """Base of the return maps on a section of the contact.

    Attributes:
        compiled: Functions of the problem.
        line: The parameters.
        settings: Accuracy.
        rows: Conditions of the section, of the class.
    """

    compiled: CompiledSystem
    line: Line
    settings: SimulationSettings
    rows: ClassVar[tuple[int, ...]]

    def dynamics(self, s: float) -> HybridDynamics:
        """Return the system at a place on the line."""
        return bind(self.compiled, self.line.at(s).tolist())

    def restitution(self, s: float) -> float:
        """Return the coefficient of restitution at a place on the line."""
        return self.dynamics(s).restitution

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return the section around a state of it."""
        return section_along(self.dynamics(s), self.line, self.rows, x, scale)

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        """Return the state of the section nearest to a state."""
        return projected(self.dynamics(s), self.rows, x, scale)

    def moved_to(self, line: Line) -> Self:
        """Return the same map along another line."""
        return replace(self, line=line)

    def loosened(self) -> Self:
        """Return the same map at a looser tolerance."""
        return replace(self, settings=loosened(self.settings, factor=_LOOSER))


@dataclass(frozen=True, kw_only=True)
class ReleaseReturns(SectionReturns):
    """From release to release, through a Zeno point."""

    rows = RELEASE_ROWS

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion from a release to the next."""
        dynamics, line = self.dynamics(s), self.line
        found = return_derivative(
            dynamics, x, horizon=horizon, settings=self.settings, parameters=line.moving
        )
        run = found.execution
        arcs = [arc for arc in run.arcs if arc.end_time <= found.period.value]
        flight = next(arc for arc in arcs if arc.mode is Mode.FREE)
        zeno = run.zeno_points[0]
        locked = next(arc for arc in reversed(arcs) if arc.mode is Mode.LOCKED)
        states = [found.start, zeno.state, run.impacts[0].state_plus]
        states += [_inside(arc, part) for arc in (flight, locked) for part in _PARTS]
        ranges = np.delete(np.ptp(np.array(states), axis=0), self.compiled.clock)
        sizes = np.delete(dynamics.own.states(len(x)), self.compiled.clock)
        margins = {
            Margin(loss=Loss.AMPLITUDE): float(np.max(ranges / sizes)),
            Margin(loss=Loss.LOCK): found.locked_time.value,
            Margin(loss=Loss.ACCELERATION): -found.gap_acceleration.value,
            Margin(loss=Loss.FIRST_IMPACT): -found.first_rate.value,
            Margin(loss=Loss.RELEASE_RATE): -dynamics.multiplier_rate(found.end),
        }
        kept = _least_kept(dynamics, run)
        if kept is not None:
            margins[Margin(loss=Loss.LATER_IMPACT)] = kept
        least_gap = _least_gap(dynamics, flight)
        if least_gap is not None:
            margins[Margin(loss=Loss.NEAR_MISS)] = least_gap
        hold = least_inside(locked, dynamics.multiplier, dynamics.multiplier_rate)
        if hold is not None:
            margins[Margin(loss=Loss.ADHESION)] = hold
        return DifferentiatedReturn(
            time=found.period.value,
            end=found.end,
            by_state=found.by_state,
            by_parameter=found.by_parameters @ line.slopes,
            margins=margins,
        )


_PARTS = (0.25, 0.5, 0.75)
"""Parts of an arc at which states are compared; fixed ones, so that their range is smooth."""


def _inside(arc: Arc, part: float) -> Vector:
    return arc.flow_state_at(part * arc.duration)


_LOOSER = 30.0
"""Factor of the tolerances at which a point is located a second time."""


def _least_gap(dynamics: HybridDynamics, flight: Arc) -> float | None:
    """Return the least gap inside a flight, if it has a minimum there."""
    return least_inside(flight, dynamics.gap, dynamics.gap_rate)


def _least_kept(dynamics: HybridDynamics, run: Execution) -> float | None:
    """Return the least part of its speed at the start that a flight between impacts lands with.

    It tends to one as impacts accumulate, and to zero only where one of them grazes. Returns
    ``None`` if the first impact is the last one.
    """
    rates = [impact.approach_rate for impact in run.impacts]
    kept = [
        -after / dynamics.speed_after(before)
        for before, after in pairwise(rates)
        if dynamics.restitution > 0.0
    ]
    return min(kept, default=None)


class OnSection:
    """Base of return maps that have the section and the line of another one."""

    @property
    def base(self) -> ReturnMap:
        """The other return map."""
        raise NotImplementedError

    @property
    def line(self) -> Line:
        """The line of parameters."""
        return self.base.line

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return the section around a state of it."""
        return self.base.frame(x, s, scale)

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        """Return the state of the section nearest to a state."""
        return self.base.projected(x, s, scale)

    def restitution(self, s: float) -> float:
        """Return the coefficient of restitution at a place on the line."""
        return self.base.restitution(s)


@dataclass(frozen=True, kw_only=True)
class Composed(OnSection):
    """Several returns, one after the other, under which an orbit of a higher period closes.

    Attributes:
        maps: The return maps, all of one section and one line.
    """

    maps: tuple[ReturnMap, ...]

    @property
    def base(self) -> ReturnMap:
        """The return map whose section and line it has."""
        return self.maps[0]

    def moved_to(self, line: Line) -> Composed:
        """Return the same map along another line."""
        return Composed(maps=tuple(one.moved_to(line) for one in self.maps))

    def loosened(self) -> Composed:
        """Return the same map at a looser tolerance."""
        return Composed(maps=tuple(one.loosened() for one in self.maps))

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion until the last of the returns."""
        end, by_state, by_parameter = x, np.eye(x.size), np.zeros(x.size)
        time, margins = 0.0, dict[Margin, float]()
        for place, one in enumerate(self.maps):
            found = one.follow(end, s, horizon=horizon)
            by_state = found.by_state @ by_state
            by_parameter = found.by_state @ by_parameter + found.by_parameter
            end, time = found.end, time + found.time
            margins |= {replace(key, place=place): value for key, value in found.margins.items()}
        return DifferentiatedReturn(
            time=time, end=end, by_state=by_state, by_parameter=by_parameter, margins=margins
        )


@dataclass(frozen=True, kw_only=True)
class ImpactReturns(SectionReturns):
    """From just after an impact to just after the next."""

    rows = IMPACT_ROWS

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the flight from an impact to the next, and its derivatives.

        Raises:
            SimulationError: If the stop is not left, or not struck again within the horizon.
        """
        dynamics, line = self.dynamics(s), self.line
        speed = dynamics.gap_rate(x)
        if not speed > self.settings.contact * dynamics.own.gap_rate:
            raise SimulationError("The stop is not left", time=0.0, state=tuple(x.tolist()))
        run = simulate(dynamics, x, until=horizon, releases=1, impacts=1, settings=self.settings)
        if not run.impacts or run.arcs[0].ending is not Ending.IMPACT:
            raise SimulationError("There is no next impact", time=horizon, state=tuple(x.tolist()))
        arc, impact = run.arcs[0], run.impacts[0]
        perturbations = Perturbations(
            dynamics=dynamics,
            differentials=differentials_of(dynamics, line.moving),
            n_parameters=len(line.moving),
            tolerance=self.settings.tolerance,
        )
        after = perturbations.struck(impact, perturbations.flown(arc, perturbations.launched(x)))
        n_x = x.size
        end = projected(dynamics, IMPACT_ROWS, impact.state_plus, dynamics.own.states(n_x))
        margins = {Margin(loss=Loss.FIRST_IMPACT): -impact.approach_rate}
        least = least_inside(arc, dynamics.gap, dynamics.gap_rate)
        if least is not None:
            margins[Margin(loss=Loss.NEAR_MISS)] = least
        return DifferentiatedReturn(
            time=impact.time,
            end=end,
            by_state=after.state[:, :n_x],
            by_parameter=after.state[:, n_x:] @ line.slopes,
            margins=margins,
        )
