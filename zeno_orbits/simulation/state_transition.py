r"""Perturbations carried along an arc: the state transition of theory (24).

They take the steps of the arc itself. A step of DOP853 of state and perturbation together is the
derivative of the step; a step of Radau IIA is one linear system,

.. math:: Z = \Delta t\,(A \otimes I)\,\bigl(J_i\,(V + Z_i) + F_i\,Q\bigr)_i, \qquad V^+ = V + Z_s

with the Jacobians at its stages. It serves as well where an explicit step is stable for the state
alone. Where an engine has other steps the arc is stepped once more.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import (
    Automatic,
    Collocation,
    ExplicitStep,
    GuardedFlow,
    RadauStep,
    RecordedTrajectory,
    Step,
    SteppedTrajectory,
    Tolerance,
    radau_scheme,
)
from zeno_orbits.model import N_STAGES, FlowDifferential
from zeno_orbits.simulation.execution import Arc


def carried(
    flow: GuardedFlow,
    differential: FlowDifferential,
    arc: Arc,
    tolerance: Tolerance,
    v: Vector,
    q: Vector,
) -> Vector:
    """Return the perturbations at the end of an arc, its duration held fixed, ``(n_y, m)``.

    Args:
        flow: The flow that was followed.
        differential: Its variational equation.
        arc: The arc.
        tolerance: Local error of steps that are taken anew.
        v: Perturbations at its start, ``(n_y, m)``.
        q: Perturbations of the flow's parameters, ``(n_q, m)``.
    """
    for _, after in courses(flow, differential, arc, tolerance, v, q):
        v = after
    return v


def courses(
    flow: GuardedFlow,
    differential: FlowDifferential,
    arc: Arc,
    tolerance: Tolerance,
    v: Vector,
    q: Vector,
    *,
    parts: int = 1,
) -> Iterator[tuple[float, Vector]]:
    """Yield the flow's own time and the perturbations after every step of an arc.

    Args:
        flow: The flow that was followed.
        differential: Its variational equation.
        arc: The arc.
        tolerance: Local error of steps that are taken anew.
        v: Perturbations at its start, ``(n_y, m)``.
        q: Perturbations of the flow's parameters, ``(n_q, m)``.
        parts: How often in every step, evenly; each time from the beginning of the step.
    """
    for step in _steps(flow, arc, tolerance):
        whole = min(step.size, arc.duration - step.start)
        before = v
        for part in range(1, parts + 1):
            size = whole * part / parts
            if isinstance(step, RadauStep):
                v = _implicit(differential, step, radau_scheme(N_STAGES), size, before, q)
            else:
                v, error = differential.step(step.before, size, before, q)
                if not error <= max(_GROWS, _SHARE * tolerance.relative):
                    # The state, on its slow manifold, does not feel a fast perturbation grow.
                    v = _implicit(differential, step, radau_scheme(N_STAGES), size, before, q)
            yield step.start + size, v


_GROWS = 1e-8
_SHARE = 1e3
"""Relative error of an explicit step above which it is no good for perturbations; in tolerances."""


def _steps(flow: GuardedFlow, arc: Arc, tolerance: Tolerance) -> Iterator[Step]:
    """Yield the steps of an arc, the last of which may reach beyond its end."""
    way = arc.trajectory
    kinds = (ExplicitStep, RadauStep)
    known = isinstance(way, SteppedTrajectory | RecordedTrajectory)
    if known and all(isinstance(step, kinds) for step in way.steps):
        yield from way.steps
        return
    y = arc.flow_state_at(0.0)
    for step in Automatic().steps(flow, y, tolerance, arc.duration):
        yield step
        if step.start + step.size >= arc.duration:
            return


def _implicit(
    differential: FlowDifferential,
    step: Step,
    scheme: Collocation,
    size: float,
    v: Vector,
    q: Vector,
) -> Vector:
    """Return the perturbations after a step of Radau IIA, along the states of a step."""
    s, n_y, m = scheme.n_stages, len(v), v.shape[1]
    linear = differential.linear(_stages(step, scheme, size))
    jacobians = linear[:, :, :n_y].transpose(1, 0, 2)
    coupled = size * scheme.matrix[:, None, :, None] * jacobians
    matrix = np.eye(s * n_y) - np.reshape(coupled, (s * n_y, s * n_y))
    slopes = np.reshape(linear @ np.concatenate([v, q]), (s, n_y * m))
    right = np.reshape(size * scheme.matrix @ slopes, (s * n_y, m))
    stages = np.reshape(np.linalg.solve(matrix, right), (s, n_y, m))
    return np.asarray(v + stages[-1], dtype=np.float64)


def _stages(step: Step, scheme: Collocation, size: float) -> Vector:
    """Return the states at the stages of a part of a step, ``(s, n_y)``."""
    if isinstance(step, RadauStep):
        places = size / step.size * scheme.nodes
        return step.before + places[:, None] ** scheme.powers @ step.coefficients
    return np.array([step.state_at(size * place) for place in scheme.nodes])
