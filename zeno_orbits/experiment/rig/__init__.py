"""The virtual rig: a problem as a physical machine would be, without a Zeno point. Always simulated.

``simulate_rig`` follows it from a state, ``rig_cycles`` lets it settle near an orbit of the model.
"""

from zeno_orbits.experiment.rig.contact_damping import damping_number, effective_restitution
from zeno_orbits.experiment.rig.cycles import (
    RigCycle,
    SettledRig,
    cut_cycles,
    default_rig,
    rig_cycles,
)
from zeno_orbits.experiment.rig.run import Record, RigRun, RigSettings, Touch
from zeno_orbits.experiment.rig.simulator import simulate_rig

__all__ = [
    "Record",
    "RigCycle",
    "RigRun",
    "RigSettings",
    "SettledRig",
    "Touch",
    "cut_cycles",
    "damping_number",
    "default_rig",
    "effective_restitution",
    "rig_cycles",
    "simulate_rig",
]
