r"""Return maps along a line of parameters, with exact derivatives and the margins of each return.

A return map takes a section to itself. Returns are computed in the full state, so that they can be
composed:

.. math:: D(P_2 \circ P_1) = \partial_x P_2\; D P_1 + \partial_s P_2

Orbits with a Zeno point return from release to release. Orbits without a Zeno point return from
impact to impact. Their section is the set of states just after an impact, :math:`h = 0`,
:math:`\dot h > 0`. Its dimension is :math:`n_x - 1` minus the number of holonomic rows. Source:
theory (5.5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from threading import get_ident
from typing import ClassVar, Protocol, Self

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import CompiledSystem, HybridDynamics, bind
from zeno_orbits.orbits import (
    IMPACT_ROWS,
    RELEASE_ROWS,
    Line,
    Margin,
    MarginKind,
    ReturnDerivative,
    Saddle,
    Section,
    differentials_of,
    nearest_saddle,
    passage_of,
    project_to_section,
    relaxed_settings,
    return_derivative,
    section_along,
)
from zeno_orbits.simulation import (
    Arc,
    Ending,
    EventDerivatives,
    Execution,
    Impact,
    Mode,
    SimulationSettings,
    least_inside,
    simulate,
    steady_turn,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferentiatedReturn:
    """A return and its derivatives in the full state.

    Attributes:
        time: Duration of the return [s].
        end: State at its end, ``(n_x,)``.
        by_state: Derivative of `end` with respect to the start, ``(n_x, n_x)``.
        by_parameter: Derivative of `end` with respect to the position on the line, ``(n_x,)``.
        margins: Distance from each kind of loss.
        volume: Product of the multipliers by Liouville's formula if the orbit closes, or ``None``
            if the formula does not apply (theory (5.9)).
        turns: Number of turns of the clock in that time. 0 without a steadily turning clock.
    """

    time: float
    end: Vector
    by_state: Vector
    by_parameter: Vector
    margins: Mapping[Margin, float]
    volume: float | None = None
    turns: float = 0.0


class LazyMargins(Mapping[Margin, float]):
    """Margins that are computed at their first use.

    Most returns are trials of Newton's method and do not need margins.

    Args:
        measure: Function that computes the margins.
    """

    def __init__(self, measure: Callable[[], Mapping[Margin, float]]) -> None:
        self._measure: Callable[[], Mapping[Margin, float]] | None = measure
        self._values: Mapping[Margin, float] = {}

    def _measured(self) -> Mapping[Margin, float]:
        if self._measure is not None:
            # The function keeps a whole execution alive. It is released here.
            self._values, self._measure = self._measure(), None
        return self._values

    def __reduce__(self) -> tuple[type[dict[Margin, float]], tuple[dict[Margin, float]]]:
        """Return the computed margins, because other processes do not have the execution."""
        return dict, (dict(self._measured()),)

    def __getitem__(self, key: Margin) -> float:
        return self._measured()[key]

    def __iter__(self) -> Iterator[Margin]:
        return iter(self._measured())

    def __len__(self) -> int:
        return len(self._measured())


class ReturnMap(Protocol):
    """A section and its return map, along a line of parameters."""

    @property
    def line(self) -> Line:
        """The line."""
        ...

    @property
    def n_places(self) -> int:
        """Number of places of its margins."""
        ...

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion from a state of the section to the next.

        Args:
            x: The state, ``(n_x,)``.
            s: Position on the line.
            horizon: Longest time to wait [s].

        Raises:
            ZenoOrbitsError: If the motion does not return within the horizon, or the return is not
                differentiable.
        """
        ...

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return the section around one of its states.

        Args:
            x: The state, ``(n_x,)``.
            s: Position on the line.
            scale: Size of each state, ``(n_x,)``.
        """
        ...

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        """Return the state of the section nearest to a state.

        Args:
            x: The state, ``(n_x,)``.
            s: Position on the line.
            scale: Size of each state, ``(n_x,)``.
        """
        ...

    def restitution(self, s: float, place: int = 0) -> float:
        """Return the coefficient of restitution of the stop of a margin.

        Args:
            s: Position on the line.
            place: Place of the margin.
        """
        ...

    def saddle(self, x: Vector, s: float, *, horizon: float) -> Saddle | None:
        """Return the saddle near the slowest state of the motion from a state, or ``None``.

        Args:
            x: The state, ``(n_x,)``.
            s: Position on the line.
            horizon: Longest time to wait [s].
        """
        ...

    def loosened(self) -> ReturnMap:
        """Return the same map at a looser tolerance. The change is an error estimate."""
        ...

    def moved_to(self, line: Line) -> ReturnMap:
        """Return the same map along another line."""
        ...


@lru_cache(maxsize=8)
def _system_at(compiled: CompiledSystem, values: tuple[float, ...], thread: int) -> HybridDynamics:
    """Return the system at some values, which a return and its section share in one thread.

    Its calls write to memory of their own, so that two threads must not share a system.
    """
    del thread
    return bind(compiled, values)


@dataclass(frozen=True, kw_only=True)
class SectionReturns:
    """Base of the return maps on a section of the contact.

    Attributes:
        compiled: Functions of the problem.
        line: The line of parameters.
        settings: Accuracy.
        rows: Conditions that define the section, an attribute of the class.
    """

    compiled: CompiledSystem
    line: Line
    settings: SimulationSettings
    rows: ClassVar[tuple[int, ...]]

    @property
    def n_places(self) -> int:
        """Number of places of its margins."""
        return 1

    def dynamics(self, s: float) -> HybridDynamics:
        """Return the system at a position on the line."""
        return _system_at(self.compiled, tuple(self.line.at(s).tolist()), get_ident())

    def restitution(self, s: float, place: int = 0) -> float:
        """Return the coefficient of restitution at a position on the line."""
        del place
        return self.dynamics(s).restitution

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return the section around one of its states."""
        return section_along(self.dynamics(s), self.line, self.rows, x, scale)

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        """Return the state of the section nearest to a state."""
        return project_to_section(self.dynamics(s), self.rows, x, scale)

    def saddle(self, x: Vector, s: float, *, horizon: float) -> Saddle | None:
        """Return the saddle near the slowest state of the motion from a state, or ``None``."""
        dynamics = self.dynamics(s)
        run = simulate(dynamics, x, until=horizon, settings=self.settings)
        return saddle_of_arcs(dynamics, run.arcs)

    def moved_to(self, line: Line) -> Self:
        """Return the same map along another line."""
        return replace(self, line=line)

    def loosened(self) -> Self:
        """Return the same map at a looser tolerance."""
        return replace(self, settings=relaxed_settings(self.settings, factor=LOOSER))


@dataclass(frozen=True, kw_only=True)
class ReleaseReturns(SectionReturns):
    """Return map from release to release, through a Zeno point."""

    rows = RELEASE_ROWS

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion from a release to the next."""
        dynamics, line = self.dynamics(s), self.line
        found = return_derivative(
            dynamics, x, horizon=horizon, settings=self.settings, parameters=line.moving
        )
        return DifferentiatedReturn(
            time=found.period.value,
            end=found.end,
            by_state=found.by_state,
            by_parameter=found.by_parameters @ line.slopes,
            margins=LazyMargins(lambda: self._margins(dynamics, found)),
            turns=turns_of_clock(dynamics, x, found.period.value),
        )

    def _margins(self, dynamics: HybridDynamics, found: ReturnDerivative) -> Mapping[Margin, float]:
        run = found.execution
        arcs = [arc for arc in run.arcs if arc.end_time <= found.period.value]
        flight = next(arc for arc in arcs if arc.mode is Mode.FREE)
        zeno = run.zeno_points[0]
        locked = next(arc for arc in reversed(arcs) if arc.mode is Mode.LOCKED)
        states = [found.start, zeno.state, run.impacts[0].state_plus]
        states += [_inside(arc, part) for arc in (flight, locked) for part in _PARTS]
        ranges = np.delete(np.ptp(np.array(states), axis=0), self.compiled.clock)
        sizes = np.delete(dynamics.own.states(found.start.size), self.compiled.clock)
        margins = {
            Margin(loss=MarginKind.AMPLITUDE): float(np.max(ranges / sizes)),
            Margin(loss=MarginKind.FREQUENCY): 1 / found.period.value,
            Margin(loss=MarginKind.LOCK): found.locked_time.value,
            Margin(loss=MarginKind.ACCELERATION): -found.gap_acceleration.value,
            Margin(loss=MarginKind.FIRST_IMPACT): -found.first_rate.value,
            Margin(loss=MarginKind.RELEASE_RATE): -dynamics.multiplier_rate(found.end),
        }
        margins.update(_stall(dynamics, arcs, found.period.value))
        kept = _least_kept(dynamics, run)
        if kept is not None:
            margins[Margin(loss=MarginKind.LATER_IMPACT)] = kept
        least_gap = _least_gap(dynamics, flight)
        if least_gap is not None:
            margins[Margin(loss=MarginKind.NEAR_MISS)] = least_gap
        hold = least_inside(locked, dynamics.multiplier, dynamics.multiplier_rate)
        if hold is not None:
            margins[Margin(loss=MarginKind.ADHESION)] = hold
        return margins


_PARTS = (0.25, 0.5, 0.75)
"""Fractions of an arc at which states are compared. Since they are fixed, the range is smooth."""


def _inside(arc: Arc, part: float) -> Vector:
    # The flow of a rescaled flight has further states.
    return arc.flow_state_at(part * arc.duration)[: len(arc.start_state)]


LOOSER = 30.0
"""Factor on the tolerances for the second computation of a point."""
PATIENCE = 4.0
"""Longest time to wait for a return, in periods of the start."""


def saddle_of_arcs(dynamics: HybridDynamics, arcs: Sequence[Arc]) -> Saddle | None:
    """Return the saddle near the slowest state of a motion, or ``None``.

    Args:
        dynamics: The system.
        arcs: Arcs of the motion.
    """
    if dynamics.clock:
        # A clock does not rest.
        return None
    sizes = dynamics.own.states(len(arcs[0].start_state))
    return nearest_saddle(
        arcs, lambda arc: dynamics.locked if arc.mode is Mode.LOCKED else dynamics.free, sizes
    )


def _stall(dynamics: HybridDynamics, arcs: Sequence[Arc], time: float) -> dict[Margin, float]:
    """Return the margin of a motion that stalls at a saddle, if one is near."""
    saddle = saddle_of_arcs(dynamics, arcs)
    if saddle is None:
        return {}
    return {Margin(loss=MarginKind.STALL): float(np.exp(-saddle.rate * time))}


def _least_gap(dynamics: HybridDynamics, flight: Arc) -> float | None:
    """Return the least gap inside a flight, or ``None`` if the gap has no minimum inside."""
    return least_inside(flight, dynamics.gap, dynamics.gap_rate)


def _least_kept(dynamics: HybridDynamics, run: Execution) -> float | None:
    """Return the least ratio of impact speed to initial speed over the flights between impacts.

    The ratio tends to one as impacts accumulate, and to zero only if an impact grazes. Return
    ``None`` if there is only one impact.
    """
    rates = [impact.approach_rate for impact in run.impacts]
    kept = [
        -after / dynamics.speed_after(before)
        for before, after in pairwise(rates)
        if dynamics.restitution > 0.0
    ]
    return min(kept, default=None)


class OnSection:
    """Base of return maps with the section and the line of another return map."""

    @property
    def base(self) -> ReturnMap:
        """The other return map."""
        raise NotImplementedError

    @property
    def line(self) -> Line:
        """The line of parameters."""
        return self.base.line

    @property
    def n_places(self) -> int:
        """Number of places of its margins."""
        return self.base.n_places

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return the section around one of its states."""
        return self.base.frame(x, s, scale)

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        """Return the state of the section nearest to a state."""
        return self.base.projected(x, s, scale)

    def saddle(self, x: Vector, s: float, *, horizon: float) -> Saddle | None:
        """Return the saddle near the slowest state of the motion from a state, or ``None``."""
        return self.base.saddle(x, s, horizon=horizon)

    def restitution(self, s: float, place: int = 0) -> float:
        """Return the coefficient of restitution of the stop of a margin."""
        return self.base.restitution(s, place)


@dataclass(frozen=True, kw_only=True)
class Composed(OnSection):
    """Composition of several returns, under which an orbit of a higher period closes.

    Attributes:
        maps: The return maps, all with the same section and line.
    """

    maps: tuple[ReturnMap, ...]

    @property
    def base(self) -> ReturnMap:
        """The return map with the same section and line."""
        return self.maps[0]

    @property
    def n_places(self) -> int:
        """Number of places of its margins."""
        return len(self.maps) * self.base.n_places

    def moved_to(self, line: Line) -> Composed:
        """Return the same map along another line."""
        return Composed(maps=tuple(one.moved_to(line) for one in self.maps))

    def loosened(self) -> Composed:
        """Return the same map at a looser tolerance."""
        return Composed(maps=tuple(one.loosened() for one in self.maps))

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion up to the last return."""
        end, by_state, by_parameter = x, np.eye(x.size), np.zeros(x.size)
        time, turns, margins = 0.0, 0.0, list[Mapping[Margin, float]]()
        volumes = list[float | None]()
        for one in self.maps:
            found = one.follow(end, s, horizon=horizon)
            volumes.append(found.volume)
            by_state = found.by_state @ by_state
            by_parameter = found.by_state @ by_parameter + found.by_parameter
            end, time, turns = found.end, time + found.time, turns + found.turns
            margins.append(found.margins)
        return DifferentiatedReturn(
            time=time,
            end=end,
            by_state=by_state,
            by_parameter=by_parameter,
            margins=LazyMargins(lambda: _placed(margins, self.base.n_places)),
            volume=_product(volumes),
            turns=turns,
        )


@dataclass(frozen=True, kw_only=True)
class ImpactReturns(SectionReturns):
    """Return map from just after an impact to just after the next impact."""

    rows = IMPACT_ROWS

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the flight from an impact to the next, and its derivatives.

        Raises:
            SimulationError: If contact persists, or no impact follows within the horizon.
        """
        dynamics, line = self.dynamics(s), self.line
        speed = dynamics.gap_rate(x)
        if not speed > self.settings.contact * dynamics.own.gap_rate:
            raise SimulationError("Contact does not end", time=0.0, state=tuple(x.tolist()))
        run = simulate(dynamics, x, until=horizon, releases=1, impacts=1, settings=self.settings)
        if not run.impacts or run.arcs[0].ending is not Ending.IMPACT:
            raise SimulationError("No impact follows", time=horizon, state=tuple(x.tolist()))
        arc, impact = run.arcs[0], run.impacts[0]
        derivatives = EventDerivatives(dynamics, line.moving, self.settings.tolerance)
        after = passage_of(arc, derivatives.passages(run)).after
        n_x = x.size
        end = project_to_section(dynamics, IMPACT_ROWS, impact.state_plus, dynamics.own.states(n_x))
        return DifferentiatedReturn(
            time=impact.time,
            end=end,
            by_state=after.state[:, :n_x],
            by_parameter=after.state[:, n_x:] @ line.slopes,
            margins=LazyMargins(lambda: _margins_of_flight(dynamics, arc, impact)),
            volume=_volume(dynamics, arc, impact),
            turns=turns_of_clock(dynamics, x, impact.time),
        )


def _margins_of_flight(
    dynamics: HybridDynamics, arc: Arc, impact: Impact
) -> Mapping[Margin, float]:
    """Return the margins of a flight from an impact to the next."""
    margins = {
        Margin(loss=MarginKind.FREQUENCY): 1 / impact.time,
        Margin(loss=MarginKind.FIRST_IMPACT): -impact.approach_rate,
        **_stall(dynamics, [arc], impact.time),
    }
    least = _least_gap(dynamics, arc)
    if least is not None:
        margins[Margin(loss=MarginKind.NEAR_MISS)] = least
    return margins


def turns_of_clock(dynamics: HybridDynamics, x: Vector, time: float) -> float:
    """Return the number of turns of the clock in a time, 0 without a steadily turning clock.

    Args:
        dynamics: The system.
        x: Any state, ``(n_x,)``.
        time: The time [s].
    """
    turn = steady_turn(dynamics, x)
    return time / turn if turn else 0.0


def _placed(margins: Sequence[Mapping[Margin, float]], n_places: int) -> Mapping[Margin, float]:
    """Return the margins of several returns, those of each return after those before it."""
    return {
        replace(key, place=turn * n_places + key.place): value
        for turn, one in enumerate(margins)
        for key, value in one.items()
    }


def _product(factors: Sequence[float | None]) -> float | None:
    known = [factor for factor in factors if factor is not None]
    return math.prod(known) if len(known) == len(factors) else None


def _volume(dynamics: HybridDynamics, arc: Arc, impact: Impact) -> float | None:
    r"""Return the factor of phase volume over a flight and its impact.

    .. math:: \frac{w}{v}\,\frac{dw}{dv}\,\exp\int \operatorname{div} f\,dt

    with the gap rates `v` before and `w` after the impact. Return ``None`` if the divergence is not
    constant (then damping is not linear), or if holonomic rows couple the coordinates.
    """
    if dynamics.holonomic(impact.state_plus).size > bool(dynamics.clock):
        return None
    n_x = impact.state_plus.size
    places = np.linspace(0.0, arc.duration, _TRACES)
    traces = [np.trace(dynamics.free.jacobian(arc.flow_state_at(t)[:n_x])) for t in places]
    if np.ptp(traces) > _CONSTANT * max(np.max(np.abs(traces)), 1 / impact.time):
        return None
    before = abs(impact.approach_rate)
    speed_after = differentials_of(dynamics, ()).speed_after(impact.approach_rate)
    by_rate = abs(float(speed_after[0]))
    ratio = dynamics.speed_after(impact.approach_rate) / before
    return float(ratio * by_rate * np.exp(traces[0] * impact.time))


_TRACES, _CONSTANT = 7, 1e-12
"""Number of points at which the divergence is computed, and the largest relative change at which it
counts as constant."""
