"""Orbits closed by simulation: from what a motion settles to, at given gains, to an orbit.

It is faster than the collocation program by far, and less can be said of it: the orbit comes from
the simulator, which the checker uses, too. Certify it with another engine than it was
closed with, or with the model written by hand, or take `find_orbit`, which shares the model alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, ZenoOrbitsError
from zeno_orbits.integrators import Taylor, Tolerance
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem
from zeno_orbits.orbits import (
    Cycle,
    OrbitImpact,
    OrbitPhase,
    OrbitShape,
    Phase,
    ZenoOrbit,
    gone_round_twice,
    new_orbit,
    placed,
    round_again,
)
from zeno_orbits.search.fixed_point import close_cycle, cycle_near
from zeno_orbits.search.guess import SettlingSettings, settle
from zeno_orbits.simulation import SimulationSettings, ZenoExtrapolation
from zeno_orbits.work import Progress, silent

_NEAR = (1e-2, 1e-4)
"""Change over a period at which a motion is closed: early, and if that fails, late."""
_ROUGH = 1e-6
"""Accuracy of the motion on its way there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Closing:
    """Outcome of closing an orbit by simulation, successful or not.

    Attributes:
        orbit: The orbit, not verified, if there is one.
        miss: Change of its release over a period, relative; infinite without an orbit.
        returns: Returns that it took.
        detail: The reason in words, if there is no orbit.
    """

    orbit: ZenoOrbit | None
    miss: float = np.inf
    returns: int = 0
    detail: str = ""

    def unwrap(self) -> ZenoOrbit:
        """Return the orbit.

        Raises:
            OrbitNotClosedError: If there is none; the error carries this result.
        """
        if self.orbit is None:
            raise OrbitNotClosedError(self)
        return self.orbit


class OrbitNotClosedError(ZenoOrbitsError):
    """No simulation was closed to an orbit.

    Attributes:
        result: The outcome.
    """

    def __init__(self, result: Closing) -> None:
        super().__init__(result.detail)
        self.result = result


def close_orbit(
    problem: Problem,
    values: ParameterValues,
    *,
    near: ZenoOrbit | None = None,
    simulation: SimulationSettings | None = None,
    on_progress: Progress = silent,
    shape: OrbitShape | None = None,
) -> Closing:
    """Return the orbit at given gains to which a simulation settles, or one near another orbit.

    The simulator makes the orbit here and checks it in `verify`: an error of the simulator that is
    the same in both is not seen. Verify with another engine, or `use_reference`, or both.

    Args:
        problem: The problem.
        values: Its numbers.
        near: An orbit of the problem to start from, at these numbers or near them; by default the
            problem's starts are followed until the motion nearly repeats.
        simulation: Engine and accuracy; by default Taylor's method at full accuracy where heyoka is
            installed and the problem analytic, else the default engine.
        on_progress: Called with the name of each stage as it begins.
        shape: The orbit's shape; by default that of ``near``, or what the motion settles to.

    Raises:
        InputError: If ``near`` is of another problem or shape, or ``simulation`` asks for what is
            missing.
    """
    if near is not None and near.problem != problem.name:
        message = f"must be of problem `{problem.name}`, but it is of `{near.problem}`"
        raise InputError(f"Argument `near` {message}.")
    if near is not None:
        shape = near.shape.agreed(shape)
    if simulation is not None:
        return _closed(problem, values, near, shape, simulation, on_progress)
    taylor = SimulationSettings(engine=Taylor())
    try:
        return _closed(problem, values, near, shape, taylor, on_progress)
    except InputError:
        # No heyoka or no formulas for it; what else is wrong is wrong for every engine.
        return _closed(problem, values, near, shape, SimulationSettings(), on_progress)


def _closed(
    problem: Problem,
    values: ParameterValues,
    near: ZenoOrbit | None,
    wanted: OrbitShape | None,
    simulation: SimulationSettings,
    on_progress: Progress,
) -> Closing:
    dynamics = problem.dynamics(values)
    detail = ""
    for settled in _NEAR if near is None else (np.inf,):
        try:
            on_progress("simulating", None)
            if near is None:
                cycle = _settled(dynamics, problem, settled, wanted, simulation)
            else:
                x = placed(dynamics, near.shape, np.array(problem.state_vector(near.start_state)))
                cycle = cycle_near(
                    dynamics, x, period=near.period, settings=simulation, shape=near.shape
                )
            on_progress("closing the orbit", None)
            closed = close_cycle(
                dynamics,
                # What repels leads away from what is near.
                cycle.end.state if near is None else cycle.start.state,
                scale=cycle.scale_at_events(),
                period=cycle.period,
                settings=simulation,
                shape=cycle.shape,
            )
        except _NoGuessError as error:
            return Closing(orbit=None, detail=str(error))
        except SimulationError as error:
            detail = str(error)
            continue
        shorter = gone_round_twice(closed.cycle)
        if shorter is not None and near is None and wanted is None:
            # A motion that overshoots nearly repeats after two periods before it does after one.
            return _closed(problem, values, None, shorter, simulation, on_progress)
        detail = round_again(closed.cycle)
        if not detail and near is not None:
            # A motion that settles was held within the escapes all the way.
            detail = escape_of(problem, closed.cycle)
        if detail:
            continue
        orbit = orbit_of(closed.cycle, problem, values)
        return Closing(orbit=orbit, miss=closed.miss, returns=closed.returns)
    return Closing(orbit=None, detail=detail)


class _NoGuessError(ZenoOrbitsError):
    """No start settled."""


def _settled(
    dynamics: HybridDynamics,
    problem: Problem,
    settled: float,
    wanted: OrbitShape | None,
    simulation: SimulationSettings,
) -> Cycle:
    starts: Sequence[tuple[float, ...]] = [problem.state_vector(x) for x in problem.starts]
    tolerance = Tolerance(
        relative=max(simulation.tolerance.relative, _ROUGH),
        absolute=max(simulation.tolerance.absolute, _ROUGH),
    )
    rough = replace(
        simulation,
        tolerance=tolerance,
        completion=ZenoExtrapolation(tolerance=_ROUGH),
    )
    settings = SettlingSettings(settled=settled, simulation=rough)
    settling = settle(dynamics, starts, settings, wanted, problem)
    if settling.cycle is None:
        raise _NoGuessError(f"{settling.reason[0].upper()}{settling.reason[1:]}.")
    return settling.cycle


def escape_of(problem: Problem, cycle: Cycle) -> str:
    """Return the escape that a period goes beyond, as a sentence; empty if there is none."""
    for name, escape in problem.escapes.items():
        place = problem.state_names.index(name)
        size = max(float(np.max(np.abs(arc.flow_states[:, place]))) for arc in cycle.arcs)
        if size > escape.beyond:
            passed = f"`{name}` reaches {size:.4g}, beyond {escape.beyond:.4g}"
            return f"{escape.phrase[0].upper()}{escape.phrase[1:]}: {passed}."
    return ""


def named(problem: Problem, state: Vector) -> dict[str, float]:
    """Return state name to value."""
    return dict(zip(problem.state_names, map(float, state), strict=True))


def orbit_of(cycle: Cycle, problem: Problem, values: ParameterValues) -> ZenoOrbit:
    """Return a period that repeats as an orbit without a certificate.

    Args:
        cycle: The period.
        problem: Its problem.
        values: The problem's numbers.
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
