r"""Default stop with a stated penetration, for a problem that declares no parts of a machine.

An undamped spring of stiffness `k` is compressed by :math:`v \sqrt{m_n / k}` in an impact of speed
`v` with the normal inertia :math:`m_n`. It is compressed by :math:`m_n a / k` under the load of a
contact phase, where `a` is the acceleration that the stop prevents. The damping for the restitution
(theory (49)) reduces the compression in an impact. So
:math:`k = \max(m_n v^2 / \delta^2, m_n a / \delta)` keeps the penetration below :math:`\delta`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.experiment.rig.machine import machine
from zeno_orbits.model import Call, Contact, ParameterValues, Problem, Rig
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.simulation import Mode, simulate

PENETRATION = 1e-3
"""Penetration of a default stop at most, in parts of the highest gap."""
DEEP = 1e-2
"""Relative penetration from which a rig is reported to differ from the model with a stiff stop."""
_SLOWEST = 1e-6
"""Speed, in parts of the greatest impact's, below which damping grows no further."""
_TIMES = 20.0
"""Time that a motion is followed to find its impacts, in the problem's own."""


def default_rig(
    problem: Problem, *, orbit: ZenoOrbit | None = None, values: ParameterValues | None = None
) -> Rig:
    """Return the parts that a problem declares, otherwise a single stop of stated penetration.

    Args:
        problem: The problem.
        orbit: Orbit that determines the impact speeds and contact load of the stop. The default is
            the motion from the problem's first initial state.
        values: Gains and parameters, by default the values of the orbit or the defaults of the
            problem.
    """
    if problem.rig is not None:
        return problem.rig
    if orbit is not None:
        start = problem.state_vector(orbit.release_state)
        return Rig(contact=_stop(problem, orbit.values(problem), start, orbit.period))
    known = values or problem.values()
    until = _TIMES * problem.dynamics(known).own.time
    return Rig(contact=_stop(problem, known, problem.initial_state(), until))


def _stop(
    problem: Problem, values: ParameterValues, start: tuple[float, ...], until: float
) -> Contact:
    """Return the stop for a motion, or by the problem's scales if the motion is without impacts."""
    dynamics = problem.dynamics(values)
    own, usual = dynamics.own, Contact()
    sized = Contact(
        stiffness=usual.stiffness * own.multiplier / own.gap,
        slowest=usual.slowest * own.gap_rate,
    )
    try:
        motion = simulate(dynamics, start, until=until)
    except SimulationError:
        return sized
    observe = _observer(problem, values)
    ends = [observe(arc.end_state) for arc in motion.arcs if arc.mode is Mode.FREE]
    heights = [observe(x)[1] for arc in motion.arcs for x in arc.sampled(50)[1]]
    speed = max((-rate for _, _, rate, _ in ends), default=0.0)
    height = max(heights, default=0.0)
    if not (speed > 0.0 and height > 0.0):
        return sized
    inertia = max(one for _, _, _, one in ends)
    locked = [arc for arc in motion.arcs if arc.mode is Mode.LOCKED]
    loads = [-dynamics.gap_acceleration(x) for arc in locked for x in arc.sampled(20)[1]]
    load = max(loads, default=0.0)
    depth = PENETRATION * height
    stiffness = inertia * max(speed**2 / depth**2, load / depth)
    return Contact(stiffness=stiffness, slowest=_SLOWEST * speed)


def _observer(
    problem: Problem, values: ParameterValues
) -> Callable[[Vector], tuple[float, float, float, float]]:
    """Return the function from a state to force, gap, gap rate and normal inertia."""
    built = machine(problem, Rig())
    p = np.asarray(values.vector, dtype=np.float64)
    rest = Call(built.rest, p)
    seen = Call(built.observe, np.concatenate([p, np.zeros(built.n_motors), [0.0]]))

    def observe(x: Vector) -> tuple[float, float, float, float]:
        force, gap, rate, inertia = seen(rest(x).copy()).tolist()
        return force, gap, rate, inertia

    return observe
