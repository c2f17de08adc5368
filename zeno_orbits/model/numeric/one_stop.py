"""A system with one stop as a graph of modes with one mode, for runs that know only graphs."""

from __future__ import annotations

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model.modes import GraphMode
from zeno_orbits.model.numeric.graph_dynamics import GraphDynamics
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics


class OneStop(GraphDynamics):
    """The graph of a system that is given by functions, such as a hand-written model.

    It has one mode, a stop without a name, and no switch.
    """

    def __init__(self, dynamics: HybridDynamics) -> None:  # pyright: ignore[reportMissingSuperCall]
        """Keep the system.

        Args:
            dynamics: The system.
        """
        self._dynamics = dynamics
        self.state_names = dynamics.state_names
        self.stop_names = ("",)
        self.switch_names = ()
        self.n_declared = 0
        self.open_mode = (), ()
        self.p = np.zeros(0) if dynamics.formulas is None else dynamics.formulas.values

    @property
    def n_q(self) -> int:
        """Number of coordinates."""
        return self._dynamics.n_q

    def view(self, mode: GraphMode, stop: int) -> HybridDynamics:
        """Return the system, whatever is asked for."""
        del mode, stop
        return self._dynamics

    def undefined_ahead(self, x: Vector, time: float) -> str:
        """Return an empty text: the formulas of a hand-written model are unknown."""
        del x, time
        return ""

    def delassus(self, x: Vector) -> Vector:
        r"""Return :math:`J W J^\top` of the stop, ``(1, 1)``."""
        return np.array([[1.0 / self._dynamics.normal_inertia(x)]])


def graph_of(system: HybridDynamics | GraphDynamics) -> GraphDynamics:
    """Return a system as a graph of modes.

    Args:
        system: The system, or its graph.
    """
    return OneStop(system) if isinstance(system, HybridDynamics) else system
