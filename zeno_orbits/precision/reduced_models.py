r"""Errors of reduced models in an orbit: estimated from reduced models alone, and measured.

The quasi-static model has an error of :math:`O(L/R)`, the corrected model of :math:`O((L/R)^2)`
(theory (1.12)). So their difference is the error of the quasi-static model, to first order. Both
avoid the thin boundary layers that make the full problem slow. Source: theory (1.12), (1.13).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem
from zeno_orbits.orbits import (
    ONE_ZENO,
    EventReturn,
    SectionMode,
    closed_return,
    events_of_shape,
    largest_states,
    orbit_event_name,
    sequence_of,
)
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.simulation import Impact, Mode, SimulationSettings, ZenoPoint

QUASI_STATIC, CORRECTED = "quasi_static", "corrected"
"""Names with which a problem declares the two reduced models."""

LANDMARKS = ("period", "first_impact", "zeno_time", "release", "zeno_state")
"""Quantities by which two orbits are compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReductionCost:
    """The error of a reduced model in an orbit.

    Errors are relative as in a certificate: times to the period, states to their size over it.

    Attributes:
        problem: The reduced problem.
        n_states: Number of its states.
        n_full_states: Number of states of the full problem.
        layer: Longest time constant of the currents, `L/R` for a single motor [s].
        rate: Fastest relative change of a velocity along the reduced orbit [1/s]. ``layer * rate``
            is the small parameter of the expansion.
        estimate: Error by landmark, from reduced models alone. For the quasi-static model it tends
            to the actual error. For the corrected model it is an order of magnitude.
        measured: Error by landmark, relative to the full problem. Empty without a measurement.
    """

    problem: str
    n_states: int
    n_full_states: int
    layer: float
    rate: float
    estimate: Mapping[str, float]
    measured: Mapping[str, float]

    @property
    def bound(self) -> dict[str, float]:
        """Largest possible error of the reduced model by landmark.

        For the quasi-static model the estimate is the first term that the model omits. For the
        corrected model it is the order of magnitude of that term. Each further term is assumed to
        be at most ten times ``layer * rate`` times the previous term. Theory (1.12) gives its order
        but not its constant, and at the Zeno point it contains a logarithm.
        """
        return {name: self.bounded(error) for name, error in self.estimate.items()}

    def bounded(self, estimate: float) -> float:
        """Return the largest possible error for an estimate."""
        if self.problem.endswith(f"@{QUASI_STATIC}"):
            return estimate * (1.0 + _CONSTANT * self.layer * self.rate)
        return estimate * _CONSTANT


_CONSTANT = 10.0
"""Largest ratio of two successive terms of the expansion, divided by ``layer * rate``."""


def errors_of_reduced_models(
    problem: Problem, values: ParameterValues, *, measure: bool = False
) -> dict[str, ReductionCost]:
    """Return the errors of both reduced models by fidelity (theory (1.13)).

    The difference of their orbits is the error of the quasi-static model, to first order. This
    difference times ``layer * rate`` is the order of magnitude of the corrected model's error.

    Args:
        problem: The full problem, which declares both reduced models.
        values: Its parameter values.
        measure: True if the orbit of the full problem is also computed.

    Raises:
        InputError: If the problem does not declare both models.
        OrbitNotFoundError: If no orbit of the quasi-static problem is found at these values.
        SimulationError: If another model does not have an orbit nearby. The reduction is then not
            valid.
    """
    reduced = {word: problem.at_fidelity(word) for word in (QUASI_STATIC, CORRECTED)}
    quasi_static = reduced[QUASI_STATIC]
    orbit = orbit_at_gains(quasi_static, quasi_static.shared(values), shape=ONE_ZENO).unwrap()
    period = orbit.period
    release = np.array(quasi_static.state_vector(orbit.release_state))
    machine, full = _dynamics(quasi_static, values), _dynamics(problem, values)
    static = reduced_orbit_near(quasi_static, values, release, period)
    better = reduced_orbit_near(reduced[CORRECTED], values, static.start, period)
    truth = reduced_orbit_near(problem, values, better.start, period) if measure else None
    layer, rate = layer_time(full, release), _rate(machine, static)
    first = landmark_errors(static, better)
    second = {name: error * layer * rate for name, error in first.items()}
    return {
        word: ReductionCost(
            problem=reduced[word].name,
            n_states=len(release),
            n_full_states=len(problem.state_names),
            layer=layer,
            rate=rate,
            estimate=estimate,
            measured={} if truth is None else landmark_errors(cycle, truth),
        )
        for word, cycle, estimate in (
            (QUASI_STATIC, static, first),
            (CORRECTED, better, second),
        )
    }


def reduced_orbit_near(
    problem: Problem, values: ParameterValues, release: Vector, period: float
) -> EventReturn:
    """Return the periodic orbit of a problem near a release state of another fidelity.

    Currents that the other fidelity does not have start at rest, with zero rate.

    Args:
        problem: The problem.
        values: Parameter values of any fidelity.
        release: Release state of the other fidelity, the first entries of ``x``.
        period: Period of the other fidelity's orbit [s].

    Raises:
        SimulationError: If an orbit does not exist nearby.
    """
    graph = problem.graph_dynamics(problem.shared(values))
    x = np.concatenate([release, _resting_current(graph.first, release)])
    sequence = events_of_shape(ONE_ZENO)
    try:
        found = closed_return(
            graph,
            x,
            section=sequence[-1],
            n_returns=1,
            guess=period,
            settings=SimulationSettings(),
            by_returns=True,
            mode=SectionMode(closed=(), sides=(), stop="", released="stop"),
        )
        events = sequence_of([orbit_event_name(event) for event in found.events])
        if events == sequence:
            return found
        reason = f"it has the events `{', '.join(events)}`"
    except SimulationError as error:
        reason = error.reason
    raise SimulationError(
        f"The reduced model lacks an orbit near the orbit of the full model: {reason}",
        time=period,
        state=tuple(x.tolist()),
    )


def landmark_errors(reduced: EventReturn, other: EventReturn) -> dict[str, float]:
    """Return the relative differences by landmark, over the states of the reduced model.

    After a plastic impact, `e = 0`, the Zeno point is at the start of the current's boundary layer.
    In a reduced model it is after the layer. So ``zeno_state`` is then omitted.
    """
    n, period = len(reduced.start), other.period
    scale = largest_states(other.arcs, other.differentiation.graph)[:n]

    def apart(a: Vector, b: Vector) -> float:
        return float(np.max(np.abs(a - b[:n]) / scale))

    zenos = _zeno_point(reduced), _zeno_point(other)
    errors = {
        "period": abs(reduced.period - period) / period,
        "first_impact": abs(_first_impact(reduced) - _first_impact(other)) / period,
        "zeno_time": abs(zenos[0].time - zenos[1].time) / period,
        "release": apart(reduced.start, other.start),
        "zeno_state": apart(np.asarray(zenos[0].state), np.asarray(zenos[1].state)),
    }
    if min(one.last_speed for one in zenos) == 0.0:
        del errors["zeno_state"]
    return errors


def layer_time(dynamics: HybridDynamics, release: Vector) -> float:
    """Return the longest time constant of a problem's currents [s], 0 without currents.

    Args:
        dynamics: The full problem.
        release: Any of its states, or the first entries of a state.
    """
    rates, block = _current_rates(dynamics, release)
    return 0.0 if rates.size == 0 else float(1 / np.min(np.abs(np.linalg.eigvals(block))))


def _resting_current(dynamics: HybridDynamics, release: Vector) -> Vector:
    rates, block = _current_rates(dynamics, release)
    if rates.size == 0:
        return rates
    return np.asarray(np.linalg.solve(block, -rates), dtype=np.float64)


def _current_rates(dynamics: HybridDynamics, release: Vector) -> tuple[Vector, Vector]:
    """Return the rates of the currents at zero current, and their Jacobian in the currents.

    The law is linear in the currents (theory (1.2)), so unit currents give the derivative exactly.
    """
    n_x, first = len(dynamics.state_names), 2 * dynamics.n_q
    bare = np.concatenate([release[:first], np.zeros(n_x - first)])
    rates = dynamics.free.rate(bare)[first:]
    columns: list[Vector] = []
    for k in range(first, n_x):
        unit = bare.copy()
        unit[k] = 1.0
        columns.append(dynamics.free.rate(unit)[first:] - rates)
    return rates, np.stack(columns, axis=1) if columns else np.zeros((0, 0))


def _rate(dynamics: HybridDynamics, found: EventReturn) -> float:
    """Return the largest acceleration of a coordinate divided by its largest speed [1/s]."""
    n_q = dynamics.n_q
    speeds, accelerations = np.zeros(n_q), np.zeros(n_q)
    # Impacts that accumulate change velocities by jumps, not by accelerations.
    plain = [arc for arc in found.arcs if arc.trajectory is not None and not arc.stop]
    for arc in plain:
        flow = dynamics.locked if arc.mode is Mode.LOCKED else dynamics.free
        for time in np.linspace(arc.start_time, arc.end_time, 65):
            x = arc.state_at(float(time))
            speeds = np.maximum(speeds, np.abs(x[n_q : 2 * n_q]))
            accelerations = np.maximum(accelerations, np.abs(flow.rate(x)[n_q : 2 * n_q]))
    return float(np.max(accelerations / np.where(speeds > 0.0, speeds, np.inf)))


def _dynamics(problem: Problem, values: ParameterValues) -> HybridDynamics:
    return problem.dynamics(problem.shared(values))


def _first_impact(found: EventReturn) -> float:
    return next(event.time for event in found.events if isinstance(event, Impact))


def _zeno_point(found: EventReturn) -> ZenoPoint:
    return next(event for event in found.events if isinstance(event, ZenoPoint))
