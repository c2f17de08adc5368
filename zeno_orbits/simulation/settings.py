"""Accuracy and limits of a simulation, and the task of one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import require_counts
from zeno_orbits.integrators import Automatic, Engine, Tolerance
from zeno_orbits.model import GraphDynamics, HybridDynamics
from zeno_orbits.simulation.zeno.completion import Completion, ZenoPassage
from zeno_orbits.work import Checked, Progress, silent


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationSettings(Checked):
    """Accuracy and limits of a simulation.

    Attributes:
        engine: The integrator.
        tolerance: Local error of the integrator.
        completion: Method by which a Zeno point is reached.
        contact: Relative threshold, in the problem's scales, below which a gap, gap rate or gap
            acceleration counts as zero.
        far: Bound of the coordinates, beyond which the execution ends with an error. It is a single
            bound for all coordinates, or one bound per coordinate.
        most_impacts: Largest number of impacts in a sequence, and of declared switches in all,
            before the execution is aborted.
        most_steps: Largest number of steps of all arcs before the execution is aborted. Each step
            is stored for dense output, at about 400 bytes.
    """

    engine: Engine = field(default_factory=Automatic)
    tolerance: Tolerance = field(default_factory=Tolerance)
    completion: Completion = field(default_factory=ZenoPassage)
    contact: float = 1e-12
    far: float | tuple[float, ...] = math.inf
    most_impacts: int = 100_000
    most_steps: int = 2_000_000

    def __post_init__(self) -> None:
        """Refuse values of a wrong kind, and numbers below one."""
        Checked.__post_init__(self)
        require_counts(most_impacts=self.most_impacts, most_steps=self.most_steps)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulationTask:
    """A simulation task.

    Attributes:
        dynamics: The system at fixed parameter values, or the graph of modes of a machine with
            several stops or switches.
        state: Initial state, ``(n_x,)``, at time 0.
        until: End time [s].
        most_releases: Number of releases after which the execution ends.
        most_impacts: Number of impacts that end a flight, after which the execution ends.
        settings: Accuracy and limits.
        on_progress: Called with the simulated part of the time.
        goes_on: Whether the state continues an earlier execution, or is near a state of it. Then it
            may violate its constraints by the errors of that execution.
        past: Name of a declared switch that has just occurred at the start, or empty.
        graph: The system as a graph of modes.
    """

    dynamics: HybridDynamics | GraphDynamics
    state: Vector
    until: float
    most_releases: float = math.inf
    most_impacts: float = math.inf
    settings: SimulationSettings = field(default_factory=SimulationSettings)
    on_progress: Progress = silent
    goes_on: bool = False
    past: str = ""
    graph: GraphDynamics = field(init=False)

    def __post_init__(self) -> None:
        """Look at the system as a graph of modes."""
        object.__setattr__(self, "graph", self.dynamics.as_graph())

    def report(self, reached: float) -> None:
        """Report the simulated time [s]: a part of a long time is 0 % for long."""
        done = f"simulating, {reached:.5g} of {self.until:g} s"
        self.on_progress(done, reached / self.until)

    @property
    def past_switch(self) -> int:
        """One more than the index of the switch that has just occurred, 0 for none, -1 for any."""
        if self.goes_on:
            return -1
        declared = self.graph.switch_names[: self.graph.n_declared]
        return declared.index(self.past) + 1 if self.past in declared else 0
