r"""Default stop with a stated penetration, for a problem that declares no parts of a machine.

An undamped spring of stiffness `k` is compressed by :math:`v \sqrt{m_n / k}` in an impact of speed
`v` with the normal inertia :math:`m_n`. It is compressed by :math:`m_n a / k` under the load of a
contact phase, where `a` is the acceleration that the stop prevents. The damping for the restitution
(theory (6.2)) reduces the compression in an impact. So
:math:`k = \max(m_n v^2 / \delta^2, m_n a / \delta)` keeps the penetration below :math:`\delta`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from zeno_orbits.errors import SimulationError
from zeno_orbits.experiment.rig.run import time_scale_of
from zeno_orbits.model import (
    Contact,
    GraphDynamics,
    ParameterValues,
    Problem,
    Rig,
)
from zeno_orbits.orbits import Orbit
from zeno_orbits.simulation import Execution, SimulationSettings, simulated_at_most

PENETRATION = 1e-3
"""Penetration of a default stop at most, in parts of the highest gap."""
DEEP = 1e-2
"""Relative penetration from which a rig is reported to differ from the model with a stiff stop."""
_SLOWEST = 1e-6
"""Speed, in parts of the greatest impact's, below which damping grows no further."""
_TIMES = 20.0
"""Time that a motion is followed to find its impacts, in the problem's own."""
_STEPS = 100_000
"""Steps after which it is not followed further: that time may be far longer than a period."""


def default_rig(
    problem: Problem,
    *,
    orbit: Orbit | None = None,
    values: ParameterValues | None = None,
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
        state = orbit.release_state if orbit.has_phases else orbit.start_state
        start = problem.state_vector(state)
        return Rig(contact=_stop(problem, orbit.values(problem), start, orbit.period))
    known = values or problem.values()
    until = _TIMES * time_scale_of(problem, known)
    return Rig(contact=_stop(problem, known, problem.initial_state(None, known), until))


def _stop(
    problem: Problem, values: ParameterValues, start: tuple[float, ...], until: float
) -> Contact:
    """Return the stop for a motion, or by the problem's scales if the motion is without impacts."""
    graph = problem.graph_dynamics(values)
    own, usual = graph.own, Contact()
    sized = Contact(
        stiffness=usual.stiffness * own.multiplier / own.gap,
        slowest=usual.slowest * own.gap_rate,
    )
    try:
        motion, _ = simulated_at_most(
            graph,
            start,
            until=until,
            most_steps=_STEPS,
            settings=SimulationSettings(),
        )
    except SimulationError:
        return sized
    struck = [one for one in _loads(graph, motion) if one.speed > 0.0 and one.height > 0.0]
    if not struck:
        return sized
    return Contact(
        stiffness=max(one.stiffness for one in struck),
        slowest=_SLOWEST * min(one.speed for one in struck),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Load:
    """The load of a stop in a motion.

    Attributes:
        speed: Largest impact speed.
        height: Largest gap.
        inertia: Largest normal inertia in an impact.
        pull: Largest acceleration that the stop prevents in a contact phase.
    """

    speed: float
    height: float
    inertia: float
    pull: float

    @property
    def stiffness(self) -> float:
        """Stiffness of the stop with the stated penetration."""
        depth = PENETRATION * self.height
        return self.inertia * max(self.speed**2 / depth**2, self.pull / depth)


def _loads(graph: GraphDynamics, motion: Execution) -> Iterator[_Load]:
    """Yield the load of every stop."""
    sampled = [x for arc in motion.arcs for x in arc.sampled(50)[1]]
    for k, name in enumerate(graph.stop_names):
        view = graph.view(graph.open_mode, k)
        struck = [one for one in motion.impacts if one.stop == name]
        inertias = [view.normal_inertia(one.state_minus) for one in struck]
        forces = [
            graph.holding(arc.mode_in(graph), k).multiplier(x)
            for arc in motion.arcs
            if name in arc.closed
            for x in arc.sampled(20)[1]
        ]
        inertia = max(inertias, default=0.0)
        yield _Load(
            speed=max((-one.approach_rate for one in struck), default=0.0),
            height=max(map(view.gap, sampled), default=0.0),
            inertia=inertia,
            pull=max(forces, default=0.0) / inertia if inertia else 0.0,
        )
