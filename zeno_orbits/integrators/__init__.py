"""Engines: how a flow is carried forward until its guard falls."""

from zeno_orbits.integrators.automatic import Automatic
from zeno_orbits.integrators.dop853 import RungeKutta
from zeno_orbits.integrators.engine import Engine, Leg, Outcome, Passage, Trajectory
from zeno_orbits.integrators.radau import Radau
from zeno_orbits.integrators.scipy import SciPy
from zeno_orbits.integrators.taylor import Taylor

__all__ = [
    "Automatic",
    "Engine",
    "Leg",
    "Outcome",
    "Passage",
    "Radau",
    "RungeKutta",
    "SciPy",
    "Taylor",
    "Trajectory",
]
