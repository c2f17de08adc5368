"""Orbits along lines of values: a known orbit at other values, and the loss of an orbit.

An orbit keeps its event sequence. It is lost where a margin of an event vanishes, or where it loses
stability.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector, spectral_radius
from zeno_orbits.errors import InputError, SimulationError, ZenoOrbitsError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import (
    Bound,
    EventReturn,
    Margin,
    MarginKind,
    StepControl,
    StepError,
    at_section,
    closed_return,
    excess,
    margins_of_return,
    multipliers_of_return,
    orbit_event_name,
    section_of_family,
    sequence_of,
)
from zeno_orbits.search.closing.line import Followed, LinePoint, follow_line, values_on_line
from zeno_orbits.search.optimum.points import OrbitAtValues, OrbitsOverValues
from zeno_orbits.work import Progress, silent

TO_LOSS = StepControl(first=0.05, longest=0.05, shortest=1e-5)
"""Steps to a loss, in units of ranges. They may skip a narrower window without an orbit."""
TO_VALUES = StepControl(first=0.25, shortest=1e-4)
"""Steps to other values, as parts of the line."""

_LOST = {
    MarginKind.AMPLITUDE: "the amplitude is zero",
    MarginKind.LOCK: "the contact phase before {} vanishes",
    MarginKind.FIRST_IMPACT: "the first impact of {} grazes",
    MarginKind.LATER_IMPACT: "a later impact of {} grazes",
    MarginKind.RELEASE_RATE: "{} is not transversal",
    MarginKind.SWITCH_RATE: "{} is not transversal",
    MarginKind.EVENTS: "{} meets the event before it",
    MarginKind.NEAR_MISS: "a stop is touched before {}",
    MarginKind.ADHESION: "contact ends before {}",
    MarginKind.OPENING: "contact does not end at {}",
    MarginKind.ARMED: "the arming at {} changes",
    MarginKind.SWITCH_MISS: "a switch acts before {}",
    MarginKind.FREQUENCY: "the period tends to infinity",
}
"""Losses at an event. A cause precedes the margins that vanish with it (theory (5.8))."""
_ATTRACTION = "attraction"


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitPaths:
    """The orbits of a search over its free values.

    Attributes:
        orbits: The orbits, which counts those that are closed.
        free: Name to range of the free values.
        bounds: Bounds that the orbits must keep.
        on_progress: Called with the stage.
    """

    orbits: OrbitsOverValues
    free: Mapping[str, tuple[float, float]]
    bounds: tuple[Bound, ...] = ()
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
        self,
        near: EventReturn,
        here: ParameterValues,
        wanted: ParameterValues,
        *,
        steps: StepControl = TO_LOSS,
        is_stable: bool = True,
    ) -> Followed:
        """Follow an orbit along a line of values, until it loses an event or its stability.

        Args:
            near: The orbit.
            here: Its values.
            wanted: Values at the end of the line.
            steps: Lengths of steps, as parts of the line.
            is_stable: Whether orbits that are not stable are lost.
        """
        section, x = section_of_family(near)

        def closed(part: float, guess: Vector, period: float) -> LinePoint:
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
            margins: dict[str, float] = {}
            if is_stable:
                radius = spectral_radius(multipliers_of_return(graph, found))
                if not radius < 1.0:
                    raise StepError(f"The orbit is not stable: its spectral radius is {radius:.6g}")
                margins[_ATTRACTION] = 1.0 - radius
            for one, value in margins_of_return(graph, found).items():
                margins[_name(one)] = min(value, margins.get(_name(one), value))
            return LinePoint(part=part, start=found.start, orbit=found, margins=margins)

        try:
            first = closed(1.0 if here == wanted else 0.0, x, near.period)
        except (SimulationError, StepError) as error:
            return Followed(
                orbit=None, values=here, arrived=False, refusal=str(error), left=1.0, end=0.0
            )
        return follow_line(
            first,
            lambda part, guess, last: closed(part, guess, last.orbit.period),
            here,
            wanted,
            steps=steps,
            losses=_losses(section.sequence),
            tell=self.tell,
        )

    def back(self, found: EventReturn, values: ParameterValues, section: str) -> EventReturn:
        """Return a followed orbit from the event at which the orbits of a search start.

        Args:
            found: The orbit.
            values: Its values.
            section: Name of the event.

        Raises:
            SimulationError: If the orbit lacks the event, or does not return.
        """
        graph = self.problem.graph_dynamics(values)
        return at_section(graph, found, section, self.orbits.simulation)

    def slack(self, values: ParameterValues, near: EventReturn) -> Vector:
        """Return the distance of each bounded quantity from its bounds, positive inside.

        Args:
            values: Values of the orbit.
            near: The orbit.

        Raises:
            StepError: If the event of a bound does not occur.
        """
        point = self._point(values, near)
        return np.array([-excess(bound, point.extent(bound.name)) for bound in self.bounds])

    def keeps(self, values: ParameterValues, near: EventReturn) -> bool:
        """Return True if an orbit keeps all bounds, to the accuracy of a simulation.

        Args:
            values: Values of the orbit.
            near: The orbit.
        """
        try:
            return not self._point(values, near).objection(self.bounds)
        except ZenoOrbitsError:
            return False

    def _point(self, values: ParameterValues, near: EventReturn) -> OrbitAtValues:
        graph, chosen = self.problem.graph_dynamics(values), near.differentiation.chosen
        return OrbitAtValues(values=values, graph=graph, found=near, chosen=chosen)

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
        _name(Margin(loss=loss, place=place)): _said(clause, event)
        for loss, clause in _LOST.items()
        for place, event in enumerate(sequence)
    }
    return {**found, _ATTRACTION: "the orbit loses stability"}


def _said(clause: str, event: str) -> str:
    """Return a loss with its event. A stop without a name of its own is not named."""
    kind, _, name = event.partition(" ")
    if name != "stop":
        return clause.format(f"`{event}`")
    return re.sub(r" (before|of) \{\}", "", clause).format(f"the {kind}")
