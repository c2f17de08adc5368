"""Orbits of events along lines of values: a known orbit at other values, and the loss of an orbit.

An orbit keeps its event sequence. It is lost where a margin of an event vanishes, or where it loses
stability.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import (
    Bound,
    EventReturn,
    Margin,
    MarginKind,
    StepError,
    closed_return,
    excess,
    margins_of_return,
    multipliers_of_return,
    orbit_event_name,
    section_of_family,
    sequence_of,
)
from zeno_orbits.search.events.points import OrbitAtValues, OrbitsOverValues
from zeno_orbits.search.homotopy.line import Followed, LinePoint, follow_line, values_on_line
from zeno_orbits.search.homotopy.persistence import WAY
from zeno_orbits.work import Progress, silent

_LOST = {
    MarginKind.AMPLITUDE: "the amplitude is zero",
    MarginKind.LOCK: "the locked arc before `{}` vanishes",
    MarginKind.FIRST_IMPACT: "the first impact of `{}` grazes",
    MarginKind.LATER_IMPACT: "a later impact of `{}` grazes",
    MarginKind.RELEASE_RATE: "`{}` is not transversal",
    MarginKind.SWITCH_RATE: "`{}` is not transversal",
    MarginKind.EVENTS: "`{}` meets the event before it",
    MarginKind.NEAR_MISS: "a stop is touched before `{}`",
    MarginKind.ADHESION: "contact ends before `{}`",
    MarginKind.OPENING: "contact does not end at `{}`",
    MarginKind.ARMED: "the arming at `{}` changes",
    MarginKind.SWITCH_MISS: "a switch acts before `{}`",
    MarginKind.FREQUENCY: "the period tends to infinity",
}
"""Losses at an event. A cause precedes the margins that vanish with it (theory (5.8))."""
_ATTRACTION = "attraction"


@dataclass(frozen=True, slots=True, kw_only=True)
class EventWays:
    """The orbits of events of a search over its free values.

    Attributes:
        orbits: The orbits, which counts those that are closed.
        free: Name to range of the free values.
        bounds: Bounds that the orbits must keep.
        on_progress: Called with the stage.
    """

    orbits: OrbitsOverValues
    free: Mapping[str, tuple[float, float]]
    bounds: tuple[Bound, ...]
    on_progress: Progress = silent

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.orbits.problem

    @property
    def is_bounded(self) -> bool:
        """True if the orbits must keep bounds."""
        return bool(self.bounds)

    def follow(
        self, near: EventReturn, here: ParameterValues, wanted: ParameterValues
    ) -> Followed[EventReturn]:
        """Follow a stable orbit along a line of values, until it loses an event or its stability.

        Args:
            near: The orbit.
            here: Its values.
            wanted: Values at the end of the line.
        """
        section, x = section_of_family(near)

        def closed(part: float, guess: Vector, period: float) -> LinePoint[EventReturn]:
            try:
                graph = self.problem.graph_dynamics(values_on_line(here, wanted, part))
                found = closed_return(
                    graph,
                    guess,
                    section=section.name,
                    n_returns=section.n_returns,
                    guess=period,
                    settings=self.orbits.simulation,
                    mode=section.mode,
                    is_near=True,
                )
            except (InputError, np.linalg.LinAlgError) as error:
                # These values are not valid for the problem, or the guess is not a valid state.
                raise StepError(str(error)) from error
            self.orbits.n_orbits += 1
            sequence = sequence_of([orbit_event_name(event) for event in found.events])
            if sequence != section.sequence:
                raise StepError(f"The event sequence changes to `{', '.join(sequence)}`")
            radius = max(map(abs, multipliers_of_return(graph, found)), default=0.0)
            if not radius < 1.0:
                raise StepError(f"The orbit is not stable: its spectral radius is {radius:.6g}")
            margins: dict[str, float] = {}
            for one, value in margins_of_return(graph, found).items():
                margins[_name(one)] = min(value, margins.get(_name(one), value))
            margins[_ATTRACTION] = 1.0 - radius
            return LinePoint(part=part, start=found.start, orbit=found, margins=margins)

        try:
            first = closed(0.0, x, near.period)
        except (SimulationError, StepError) as error:
            return Followed(
                orbit=None, values=here, arrived=False, refusal=str(error), left=1.0, end=0.0
            )
        return follow_line(
            first,
            lambda part, guess, last: closed(part, guess, last.orbit.period),
            here,
            wanted,
            steps=WAY,
            losses=_losses(section.sequence),
            tell=self.tell,
        )

    def slack(self, values: ParameterValues, near: EventReturn) -> Vector:
        """Return the distance of each bounded quantity from its bounds, positive inside.

        Args:
            values: Values of the orbit.
            near: The orbit.

        Raises:
            StepError: If the event of a bound does not occur.
        """
        graph = self.problem.graph_dynamics(values)
        point = OrbitAtValues(values=values, graph=graph, found=near, chosen=())
        return np.array([-excess(bound, point.extent(bound.name)) for bound in self.bounds])

    def tell(self, stage: str) -> None:
        """Report progress.

        Args:
            stage: The stage.
        """
        self.on_progress(stage, None)


def _name(margin: Margin) -> str:
    return f"{margin.loss.name} {margin.place}"


def _losses(sequence: Sequence[str]) -> dict[str, str]:
    """Return the loss where each margin of an event sequence vanishes, causes first."""
    found = {
        _name(Margin(loss=loss, place=place)): clause.format(event)
        for loss, clause in _LOST.items()
        for place, event in enumerate(sequence)
    }
    return {**found, _ATTRACTION: "the orbit loses stability"}
