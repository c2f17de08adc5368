"""A system with one stop as a graph of modes with one mode, for runs that know only graphs."""

from __future__ import annotations

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model.domains import undefined_ahead
from zeno_orbits.model.modes import GraphMode
from zeno_orbits.model.numeric.graph_dynamics import GraphDynamics, states_ahead
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics


class OneStop(GraphDynamics):
    """The graph of a system that is given by functions, such as a hand-written model.

    It has one mode, one stop, and no switch.
    """

    def __init__(  # pyright: ignore[reportMissingSuperCall]
        self, dynamics: HybridDynamics, stop: str = ""
    ) -> None:
        """Keep the system.

        Args:
            dynamics: The system.
            stop: Name of its stop.
        """
        self._dynamics = dynamics
        self.state_names = dynamics.state_names
        self.stop_names = (stop,)
        self.switch_names = ()
        self.n_declared = 0
        self.causes = ()
        self.held: tuple[int, ...] = ()
        self.sides_of_friction = ()
        self.frictional = range(0)
        self.open_mode = (), ()
        self.p = np.zeros(0) if dynamics.formulas is None else dynamics.formulas.values

    @property
    def n_q(self) -> int:
        """Number of coordinates."""
        return self._dynamics.n_q

    def setter_at(self, event: str) -> None:
        """Return that no event sets states."""

    def view(self, mode: GraphMode, stop: int) -> HybridDynamics:
        """Return the system, whatever is asked for."""
        del mode, stop
        return self._dynamics

    def undefined_ahead(self, x: Vector, time: float) -> str:
        """Return what ends a flow at a state: a formula that is infinite or undefined ahead.

        Args:
            x: The state, ``(n_x,)``.
            time: Time there, whose rounding the flow cannot resolve [s].

        Returns:
            A clause that names the formula and the state. It is empty without such a formula, and
            for a hand-written model, whose formulas are unknown.
        """
        known = None if self._dynamics.formulas is None else self._dynamics.formulas.system.source
        if known is None:
            return ""
        system, parameters = known
        rests = self._rests(self._dynamics, x)
        flow = self._dynamics.locked if rests else self._dynamics.free
        states = states_ahead(x, flow.rate(x)[: x.size], self._dynamics.own.time, time)
        inputs = system.state, parameters
        return undefined_ahead(system.mechanism, system.drive, inputs, [x, *states], self.p)

    def has_infinite_slope(self, x: Vector) -> bool:
        """Return False: the roots of functions are unknown."""
        del x
        return False

    def delassus(self, x: Vector) -> Vector:
        r"""Return :math:`J W J^\top` of the stop, ``(1, 1)``."""
        return np.array([[1.0 / self._dynamics.normal_inertia(x)]])
