"""Engines: how a flow is carried forward until its guard falls."""

from zeno_orbits.engines.automatic import Automatic
from zeno_orbits.engines.protocol import Engine, Leg, Outcome, Passage, Trajectory
from zeno_orbits.engines.radau import Radau
from zeno_orbits.engines.runge_kutta import RungeKutta
from zeno_orbits.engines.scipy import SciPy
from zeno_orbits.engines.taylor import Taylor

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
