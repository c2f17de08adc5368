"""Continue orbits along a straight line of values, from a known orbit (theory (5.4))."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import HybridDynamics, ParameterValues
from zeno_orbits.orbits import (
    Cycle,
    EventSequence,
    Orbit,
    StepControl,
    StepError,
    orbit_multipliers,
)
from zeno_orbits.search.cycles import closed_cycle
from zeno_orbits.search.homotopy.line import Followed, LinePoint, follow_line, values_on_line
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.simulation import SimulationSettings

_STEPS = StepControl(first=0.25, shortest=1e-4)
"""First and smallest step, as parts of the line."""

_LOST = {
    "amplitude": "the amplitude is zero",
    "locked_time": "the locked arc vanishes",
    "gap_acceleration": "d2h/dt2 at the Zeno point is zero",
    "first_impact_speed": "the first impact grazes",
    "release_rate": "the release is not transversal",
    "attraction": "the orbit loses stability",
}
"""Ends of a family. A cause precedes the margins that vanish in proportion to it (theory (5.8))."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Line:
    r"""The straight line between two sets of values: :math:`p(s) = (1 - s)\,p_0 + s\,p_1`.

    Attributes:
        search: The search.
        first: :math:`p_0`.
        last: :math:`p_1`.
        shape: The shape of the orbits.
        attracting: True if orbits that are not stable are rejected.
    """

    search: SearchProblem
    first: ParameterValues
    last: ParameterValues
    shape: EventSequence
    attracting: bool = False


def follow(
    search: SearchProblem,
    near: Cycle | Orbit,
    easy: ParameterValues,
    wanted: ParameterValues,
    *,
    steps: StepControl = _STEPS,
    attracting: bool = False,
) -> Followed[Cycle]:
    """Continue an orbit along a straight line of values.

    The next initial state is predicted by the secant through the last two orbits, and corrected by
    closing the orbit by simulation.

    Args:
        search: The search.
        near: An orbit, exact or approximate.
        easy: Values of this orbit.
        wanted: Target values.
        steps: Lengths of steps, as parts of the line.
        attracting: Reject orbits that are not stable.
    """
    if isinstance(near, Cycle):
        start = near.start.state
    else:
        start = np.array(search.problem.state_vector(near.start_state))
    line = _Line(search=search, first=easy, last=wanted, shape=near.shape, attracting=attracting)
    try:
        first = _closed(line, 1.0 if easy == wanted else 0.0, start, near.period)
    except (SimulationError, StepError):
        return Followed(orbit=None, values=easy, arrived=False, left=1.0, end=0.0)
    return follow_line(
        first,
        lambda part, guess, here: _closed(line, part, guess, here.orbit.period),
        easy,
        wanted,
        steps=steps,
        losses=_LOST,
        tell=search.tell,
    )


def _closed(line: _Line, part: float, guess: Vector, period: float) -> LinePoint[Cycle]:
    """Return the orbit at a point of a line, closed from a guess.

    Args:
        line: The line.
        part: Position on the line, from 0 to 1.
        guess: A state near the orbit's start, ``(n_x,)``.
        period: Approximate period of the orbit [s].

    Raises:
        SimulationError: If no orbit closes.
        StepError: If the values or the guess are not valid.
    """
    values = values_on_line(line.first, line.last, part)
    try:
        dynamics = line.search.dynamics(values)
        cycle = closed_cycle(
            line.search.problem.graph_dynamics(values),
            guess,
            shape=line.shape,
            period=period,
            settings=SimulationSettings(),
        )
    except (InputError, np.linalg.LinAlgError) as error:
        # These values are not valid for the problem, or the guess is not a valid state.
        raise StepError(str(error)) from error
    margins = _margins(dynamics, cycle)
    if line.attracting:
        margins["attraction"] = _attraction(dynamics, cycle)
    return LinePoint(part=part, start=cycle.start.state, orbit=cycle, margins=margins)


def _margins(dynamics: HybridDynamics, cycle: Cycle) -> dict[str, float]:
    held = [(phase.zeno, phase.end) for phase in cycle.phases if phase.zeno is not None]
    margins = {
        "amplitude": _amplitude(dynamics, cycle),
        "first_impact_speed": min(-p.impacts[0].approach_rate for p in cycle.phases),
    }
    if held:
        margins["locked_time"] = min(end.time - zeno.time for zeno, end in held)
        margins["gap_acceleration"] = min(-dynamics.gap_acceleration(z.state) for z, _ in held)
        margins["release_rate"] = min(-dynamics.multiplier_rate(end.state) for _, end in held)
    return margins


def _attraction(dynamics: HybridDynamics, cycle: Cycle) -> float:
    """Return the distance of the spectral radius from 1.

    Raises:
        StepError: If the orbit is not stable.
    """
    multipliers = orbit_multipliers(
        dynamics,
        cycle.start.state,
        scale=cycle.scale_at_events(),
        period=cycle.period,
        settings=SimulationSettings(),
        shape=cycle.shape,
    )
    left = 1.0 - multipliers.spectral_radius
    if not left > multipliers.error:
        raise StepError(f"The orbit is not stable: its spectral radius is {1.0 - left:.6g}")
    return left


_PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Parts of an arc at which states are compared. They are fixed, so the range varies smoothly."""


def _amplitude(dynamics: HybridDynamics, cycle: Cycle) -> float:
    """Return the largest relative range of a state, except the clock's states, over a period."""
    n_x = cycle.start.state.size
    states = [arc.flow_state_at(part * arc.duration)[:n_x] for arc in cycle.arcs for part in _PARTS]
    ranges = np.ptp(np.array(states), axis=0) / dynamics.own.states(n_x)
    return float(np.max(np.delete(ranges, dynamics.clock)))
