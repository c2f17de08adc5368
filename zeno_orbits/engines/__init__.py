"""Engines: how a flow is carried forward, step by step, until somebody stops it."""

from zeno_orbits.engines.protocol import Engine, Step
from zeno_orbits.engines.runge_kutta import RungeKutta
from zeno_orbits.engines.scipy import SciPy

__all__ = ["Engine", "RungeKutta", "SciPy", "Step"]
