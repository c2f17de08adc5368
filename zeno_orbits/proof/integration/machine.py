"""A machine in balls: one system for each stop and each side of its kinks, made when it is needed.

All systems have the same states. Those of one set of sides have the same free flow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from zeno_orbits.errors import ProofError
from zeno_orbits.model import ParameterValues, Problem, watched
from zeno_orbits.proof.arithmetic.balls import Ball
from zeno_orbits.proof.arithmetic.expressions import MachineView
from zeno_orbits.proof.integration.ball_system import BallSystem, PeriodStart


class BallMachine:
    """A problem at fixed parameter values, in balls.

    Attributes:
        stop_names: Names of the stops.
        switch_names: Names of the declared switches, then of the kinks.
        n_declared: Number of declared switches.
        section: The event at which the period starts.
        is_graph: True for a machine with several stops, switches or kinks.
    """

    def __init__(
        self,
        problem: Problem,
        values: ParameterValues,
        over: Mapping[str, float],
        period: float,
        *,
        section: PeriodStart,
        is_graph: bool,
    ) -> None:
        """Store what the systems are made of.

        Args:
            problem: The problem.
            values: Gains and parameters, taken exactly.
            over: Gains or parameters that become states of rate zero.
            period: Approximate duration of the motion [s].
            section: The event at which the period starts.
            is_graph: True for a machine with several stops, switches or kinks.

        Raises:
            ProofError: If the machine has a property that is not proved.
        """
        self._given = problem, values, over, period
        self.section, self.is_graph = section, is_graph
        self._views: dict[tuple[int, tuple[bool, ...], int], BallSystem] = {}
        self.stop_names: tuple[str, ...] = ("stop",)
        self.switch_names: tuple[str, ...] = ()
        self.n_declared = 0
        if is_graph:
            graph = problem.compiled_graph().graph
            reason = "a root of a formula is zero at an event" if graph.roots else ""
            if graph.has_current_layers:
                reason = "each impact has a layer of a corrected drive"
            if any(ca.SX(one.guard).is_constant() for one in graph.switches):
                reason = "a guard is constant"
            if any(graph.causes):
                reason = "an event of a stop sets states anew, and no lemma covers that"
            if graph.n_frictions:
                reason = "a part has dry friction, and no lemma covers a part that sticks"
            if reason:
                raise ProofError("shape", f"{reason}: `verify` checks such an orbit numerically")
            self.stop_names = tuple(one.name for one in watched(graph.stops))
            self.switch_names = graph.switch_names
            self.n_declared = len(graph.switches)

    def view(self, stop: int, sides: tuple[bool, ...], held: int = -1) -> BallSystem:
        """Return the system of a stop on given sides of the kinks, while another stop is held."""
        key = (stop, sides, held)
        if key not in self._views:
            problem, values, over, period = self._given
            view = MachineView(stop=stop, sides=sides, held=held) if self.is_graph else None
            self._views[key] = BallSystem(
                problem, values, over, period, section=self.section, view=view
            )
        return self._views[key]

    def beside(self, system: BallSystem) -> tuple[str, ...]:
        """Return the names of the stops that are closed on the section, but not released there.

        Args:
            system: The system at the start.
        """
        view = system.view
        own = [0 if view is None else view.stop] if self.section.locked else []
        held = [] if view is None or view.held < 0 else [view.held]
        return tuple(self.stop_names[k] for k in [*own, *held])

    def views(self, sides: tuple[bool, ...]) -> list[BallSystem]:
        """Return the systems of all stops on given sides of the kinks."""
        return [self.view(stop, sides) for stop in range(len(self.stop_names))]

    def sides_at(
        self, stop: int, before: tuple[bool, ...], box: Sequence[Ball], crossed: int | None = None
    ) -> tuple[bool, ...]:
        """Return the sides of all kinks on a box of states just after an event.

        Args:
            stop: The stop whose system is used.
            before: The sides before the event.
            box: The states.
            crossed: The kink that was crossed, whose condition is zero.

        Raises:
            ProofError: If the condition of another kink is not proved to differ from zero.
        """
        sides, first = list(before), self.n_declared
        if crossed is not None:
            sides[crossed] = not sides[crossed]
        for _ in range(2 * len(sides) + 1):
            guards = self.view(stop, tuple(sides)).guards(box)[first:]
            wrong = [
                k for k, (value, _) in enumerate(guards) if k != crossed and not bool(value > 0)
            ]
            if not wrong:
                return tuple(sides)
            k = wrong[0]
            if not bool(guards[k][0] < 0):
                what = f"`{self.switch_names[first + k]}` is not proved to differ from zero"
                raise ProofError("switch", f"the condition of {what} just after an event")
            if crossed is not None and k < crossed:
                raise ProofError("switch", "a kink changes the side of an earlier one")
            sides[k] = not sides[k]
        raise ProofError("switch", "the sides of the kinks are not consistent just after an event")
