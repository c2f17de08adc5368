"""Orbits closed by simulation: from the attractor of a motion at given gains to an orbit.

This method is much faster than the collocation program, but it proves less: the orbit comes from
the simulator, which the checker also uses. Certify the orbit with another engine than the engine
that closed it, or with the model written by hand, or use `find_orbit`, which shares only the model
with the checker.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, ZenoOrbitsError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem
from zeno_orbits.orbits import (
    Cycle,
    EventSequence,
    Orbit,
    OrbitImpact,
    OrbitPhase,
    Phase,
    minimal_period,
    new_orbit,
    place_on_section,
    round_again,
)
from zeno_orbits.search.shooting.fixed_point import cycle_near, newton_on_return_map
from zeno_orbits.search.shooting.guess import TransientSettings, run_to_attractor
from zeno_orbits.simulation import SimulationSettings, ZenoExtrapolation
from zeno_orbits.work import Progress, silent

_NEAR = (1e-2, 1e-4)
"""Change over a period at which the orbit is closed: first an early attempt, then a late one."""
_ROUGH = 1e-6
"""Accuracy of the motion until then."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShootingResult:
    """Outcome of closing an orbit by simulation, successful or not.

    Attributes:
        orbit: The orbit, not verified, or ``None`` after a failure.
        miss: Relative change of the orbit's release over a period. Infinite without an orbit.
        returns: Number of simulated returns.
        detail: Reason of a failure, as a sentence. Empty after a success.
    """

    orbit: Orbit | None
    miss: float = np.inf
    returns: int = 0
    detail: str = ""

    def unwrap(self) -> Orbit:
        """Return the orbit.

        Raises:
            OrbitNotClosedError: If no orbit was closed. The error contains this result.
        """
        if self.orbit is None:
            raise OrbitNotClosedError(self)
        return self.orbit


class OrbitNotClosedError(ZenoOrbitsError):
    """No simulation was closed to an orbit.

    Attributes:
        result: The outcome.
    """

    def __init__(self, result: ShootingResult) -> None:
        super().__init__(result.detail)
        self.result = result


def orbit_by_shooting(
    problem: Problem,
    values: ParameterValues,
    *,
    near: Orbit | None = None,
    simulation: SimulationSettings | None = None,
    on_progress: Progress = silent,
    shape: EventSequence | None = None,
) -> ShootingResult:
    """Return the orbit at given gains to which a simulation converges, or an orbit near `near`.

    The simulator creates the orbit here and checks it in `verify`. An error of the simulator that
    is the same in both is not detected. Verify with another engine, or `use_reference`, or both.

    Args:
        problem: The problem.
        values: Values of its gains and parameters.
        near: An orbit of the problem to start from, at these values or near them. By default the
            problem's initial states are simulated until the motion nearly repeats.
        simulation: Engine and accuracy. The default is `SimulationSettings()`.
        on_progress: Called with the name of each stage at its beginning.
        shape: The orbit's shape. The default is the shape of ``near``, or of the attractor.

    Raises:
        InputError: If ``near`` belongs to another problem or has a different shape, or if
            ``simulation`` requires a missing component.
    """
    if near is not None and near.problem != problem.name:
        message = f"must be of problem `{problem.name}`, but it is of `{near.problem}`"
        raise InputError(f"Argument `near` {message}.")
    if near is not None:
        shape = near.shape.agreed(shape)
    simulation = simulation or SimulationSettings()
    return _closed(problem, values, near, shape, simulation, on_progress)


def _closed(
    problem: Problem,
    values: ParameterValues,
    near: Orbit | None,
    wanted: EventSequence | None,
    simulation: SimulationSettings,
    on_progress: Progress,
) -> ShootingResult:
    dynamics = problem.dynamics(values)
    detail = ""
    for settled in _NEAR if near is None else (np.inf,):
        try:
            on_progress("simulating", None)
            if near is None:
                cycle = _settled(dynamics, problem, values, settled, wanted, simulation)
            else:
                x = place_on_section(
                    dynamics, near.shape, np.array(problem.state_vector(near.start_state))
                )
                cycle = cycle_near(
                    dynamics, x, period=near.period, settings=simulation, shape=near.shape
                )
            on_progress("closing the orbit", None)
            closed = newton_on_return_map(
                dynamics,
                # Near an unstable orbit the end of the period is farther away than its start.
                cycle.end.state if near is None else cycle.start.state,
                scale=cycle.scale_at_events(),
                period=cycle.period,
                settings=simulation,
                shape=cycle.shape,
            )
        except _NoGuessError as error:
            return ShootingResult(orbit=None, detail=str(error))
        except SimulationError as error:
            detail = str(error)
            continue
        shorter = minimal_period(closed.cycle)
        if shorter is not None and near is None and wanted is None:
            # If a motion overshoots, it nearly repeats after two periods first, later after each.
            return _closed(problem, values, None, shorter, simulation, on_progress)
        detail = round_again(closed.cycle)
        if not detail and near is not None:
            # Without `near`, the simulation itself checked the divergence limits.
            detail = escape_of(problem, closed.cycle)
        if detail:
            continue
        orbit = orbit_of(closed.cycle, problem, values)
        return ShootingResult(orbit=orbit, miss=closed.miss, returns=closed.returns)
    return ShootingResult(orbit=None, detail=detail)


class _NoGuessError(ZenoOrbitsError):
    """No simulation from an initial state converged."""


def _settled(
    dynamics: HybridDynamics,
    problem: Problem,
    values: ParameterValues,
    settled: float,
    wanted: EventSequence | None,
    simulation: SimulationSettings,
) -> Cycle:
    starts = problem.admissible_starts(values)
    tolerance = Tolerance(
        relative=max(simulation.tolerance.relative, _ROUGH),
        absolute=max(simulation.tolerance.absolute, _ROUGH),
    )
    rough = replace(
        simulation,
        tolerance=tolerance,
        completion=ZenoExtrapolation(tolerance=_ROUGH),
    )
    settings = TransientSettings(settled=settled, simulation=rough)
    settling = run_to_attractor(dynamics, starts, settings, wanted, problem)
    if settling.cycle is None:
        raise _NoGuessError(f"{settling.reason[0].upper()}{settling.reason[1:]}.")
    return settling.cycle


def escape_of(problem: Problem, cycle: Cycle) -> str:
    """Return a sentence on the divergence limit that a period exceeds, or an empty text."""
    for name, escape in problem.escapes.items():
        place = problem.state_names.index(name)
        size = max(float(np.max(np.abs(arc.flow_states[:, place]))) for arc in cycle.arcs)
        if size > escape.beyond:
            passed = f"`{name}` reaches {size:.4g}, beyond {escape.beyond:.4g}"
            return f"{escape.phrase[0].upper()}{escape.phrase[1:]}: {passed}."
    return ""


def named(problem: Problem, state: Vector) -> dict[str, float]:
    """Return a mapping of state name to value."""
    return dict(zip(problem.state_names, map(float, state), strict=True))


def orbit_of(cycle: Cycle, problem: Problem, values: ParameterValues) -> Orbit:
    """Convert a period that repeats to an orbit without a certificate.

    Args:
        cycle: The period.
        problem: Problem of the period.
        values: Values of the problem's gains and parameters.
    """
    start = cycle.start.time

    def phase_of(phase: Phase) -> OrbitPhase:
        return OrbitPhase(
            kind=phase.kind,
            start_time=phase.start.time - start,
            start_state=named(problem, phase.start.state),
            impacts=tuple(
                OrbitImpact(time=i.time - start, state_minus=named(problem, i.state_minus))
                for i in phase.impacts
            ),
            zeno_time=None if phase.zeno is None else phase.zeno.time - start,
            zeno_state=None if phase.zeno is None else named(problem, phase.zeno.state),
        )

    return new_orbit(
        problem,
        values,
        period=cycle.period,
        phases=tuple(map(phase_of, cycle.phases)),
    )
