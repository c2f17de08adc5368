r"""Propagation of perturbations along an arc, in plain Python: state transition of theory (4.2).

The perturbations use the steps of the arc itself. A DOP853 step of state and perturbation together
is the derivative of the step. A step of Radau IIA is one linear system,

.. math:: Z = \Delta t\,(A \otimes I)\,\bigl(J_i\,(V + Z_i) + F_i\,Q\bigr)_i, \qquad V^+ = V + Z_s

with the Jacobians at its stages. This system also applies if an explicit step is stable for the
state alone. An arc with steps of another kind is integrated again. Source:
[HairerNorsettWanner1993]_, I.14. The compiled loop has the same formulas, and this module is their
reference.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import (
    N_STAGES,
    Automatic,
    Collocation,
    ExplicitStep,
    FlowWithEvent,
    RadauStep,
    Step,
    SteppedTrajectory,
    Tolerance,
    explicit_attempt,
    radau_scheme,
)
from zeno_orbits.model import FlowDifferential
from zeno_orbits.simulation.execution import Arc
from zeno_orbits.simulation.recorded import LoopTrajectory


def courses(
    flow: FlowWithEvent,
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
        flow: The flow of the arc.
        differential: Its variational equation.
        arc: The arc.
        tolerance: Local error of repeated steps.
        v: Perturbations at the start of the arc, ``(n_y, m)``.
        q: Perturbations of the flow's parameters, ``(n_q, m)``.
        parts: Number of evenly spaced outputs per step, each computed from the beginning of the
            step.
    """
    for step in _steps(flow, arc, tolerance):
        whole = min(step.size, arc.duration - step.start)
        before = v
        for part in range(1, parts + 1):
            size = whole * part / parts
            v = _after(flow, differential, step, size, before, q, trusted(tolerance))
            yield step.start + size, v


def carried_within(
    flow: FlowWithEvent,
    differential: FlowDifferential,
    arc: Arc,
    tolerance: Tolerance,
    before: Vector,
    q: Vector,
    offsets: Vector,
) -> Vector:
    """Return the perturbations inside the steps of an arc, ``(n, n_y, m)``.

    Args:
        flow: The flow of the arc.
        differential: Its variational equation.
        arc: The arc.
        tolerance: Local error of repeated steps.
        before: Perturbations at the start of every step, ``(n_steps, n_y, m)``.
        q: Perturbations of the flow's parameters, ``(n_q, m)``.
        offsets: The flow's own times since the start of the arc, ``(n,)``.
    """
    steps = list(_steps(flow, arc, tolerance))
    starts = np.array([step.start for step in steps])
    found: list[Vector] = []
    for offset in map(float, offsets):
        k = max(int(np.searchsorted(starts, offset, side="right")) - 1, 0)
        size = offset - steps[k].start
        v = before[k]
        if size > 0.0:
            v = _after(flow, differential, steps[k], size, v, q, trusted(tolerance))
        found.append(v)
    return np.array(found)


_GROWS = 1e-8
_SHARE = 1e3


def trusted(tolerance: Tolerance) -> float:
    """Return the relative error up to which an explicit step serves for perturbations.

    Args:
        tolerance: Local error of the steps of the state.
    """
    return max(_GROWS, _SHARE * tolerance.relative)


def _steps(flow: FlowWithEvent, arc: Arc, tolerance: Tolerance) -> Iterator[Step]:
    """Yield the steps of an arc, the last of which may reach beyond its end."""
    way = arc.trajectory
    kinds = (ExplicitStep, RadauStep)
    known = isinstance(way, SteppedTrajectory | LoopTrajectory)
    if known and all(isinstance(step, kinds) for step in way.steps):
        yield from way.steps
        return
    y = arc.flow_state_at(0.0)
    for step in Automatic().steps(flow, y, tolerance, arc.duration):
        yield step
        if step.start + step.size >= arc.duration:
            return


def _after(
    flow: FlowWithEvent,
    differential: FlowDifferential,
    step: Step,
    size: float,
    v: Vector,
    q: Vector,
    most: float,
) -> Vector:
    """Return the perturbations after a part of a step."""
    if not isinstance(step, RadauStep):
        after, error = _explicit(flow, differential, step.before, size, v, q)
        if error <= most:
            return after
        # The state, on its slow manifold, does not feel a fast perturbation grow.
    return _implicit(differential, step, radau_scheme(N_STAGES), size, v, q)


def _explicit(
    flow: FlowWithEvent,
    differential: FlowDifferential,
    y: Vector,
    size: float,
    v: Vector,
    q: Vector,
) -> tuple[Vector, float]:
    """Return the perturbations after a step of DOP853, and their error, relative."""

    def rate(both: Vector) -> Vector:
        linear = differential.linear(both[None, :, 0])[0]
        return np.column_stack([flow.rate(both[:, 0]), linear @ np.concatenate([both[:, 1:], q])])

    after, fifth, _ = explicit_attempt(rate, np.column_stack([y, v]), size)
    error = np.max(np.abs(size * fifth[:, 1:]), axis=0)
    sizes = np.max(np.abs(after[:, 1:]), axis=0)
    # The error of a zero column is zero.
    relative = error / np.where(sizes == 0.0, 1.0, sizes)
    return after[:, 1:], float(np.max(relative, initial=0.0))


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
