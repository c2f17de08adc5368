r"""Orbits closed by simulation: Newton's method on the return map, at given gains.

On its section the orbit is the root of :math:`P(y) - y` (theory (18), (45)). The slope of
:math:`P` is taken from the returns themselves, a rank-one correction each [Broyden1965]_: a return
costs a few times less than an exact slope. Where that does not converge, as on an orbit that
repels, the exact slope is taken (theory (27)).

It is faster than the collocation program by far, and less can be said of it: the orbit comes from
the simulator, which the checker uses, too. Certify it with another engine than it was
closed with, or with the model written by hand, or take `find_orbit`, which shares the model alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.compiled import bind
from zeno_orbits.completion import ZenoExtrapolation
from zeno_orbits.cycle import Cycle, cycle_of, round_again
from zeno_orbits.dynamics import HybridDynamics, Tolerance, Vector
from zeno_orbits.engines import Taylor
from zeno_orbits.errors import InputError, SimulationError, ZenoOrbitsError
from zeno_orbits.guess import SettlingSettings, settle
from zeno_orbits.models import compiled_model
from zeno_orbits.orbit import OrbitImpact, OrbitPhase, ZenoOrbit, versions
from zeno_orbits.phases import Phase, follow_each_other, kinds_of, phases_of
from zeno_orbits.poincare import ReleaseSection, return_slope, section_around
from zeno_orbits.problem import Problem, Setting
from zeno_orbits.quantities import RUNAWAY
from zeno_orbits.returns import placed
from zeno_orbits.sections import rows_of
from zeno_orbits.shape import ONE_ZENO, OrbitShape
from zeno_orbits.simulate import SimulationSettings, simulate

_REPEATS = 1e-12
"""Change of the release over a period that counts as none, relative."""
_STALLED = 1e-8
"""Change that rounding may leave where the flow is stiff; more than this is no orbit."""
_OWN = 1e-6
"""The same, relative to the size of the period itself: a motion that dies out repeats, too."""
_MOST_RETURNS = 16
_SHORTER = 4.0
"""Divisor of a step that did not help although its slope was exact."""
_NEAR = (1e-2, 1e-4)
"""How far a motion has settled when it is closed: early, and if that fails, late."""
_ROUGH = 1e-6
"""Accuracy of the motion on its way there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosedCycle:
    """A period that repeats.

    Attributes:
        cycle: The period, simulated from its release.
        miss: Change of the release over it, relative.
        returns: Returns that it took, those for a slope not counted.
    """

    cycle: Cycle
    miss: float
    returns: int


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
        result: How it ended.
    """

    def __init__(self, result: Closing) -> None:
        super().__init__(result.detail)
        self.result = result


def close_orbit(
    problem: Problem,
    setting: Setting,
    *,
    near: ZenoOrbit | None = None,
    simulation: SimulationSettings | None = None,
    on_progress: Callable[[str], None] | None = None,
    shape: OrbitShape | None = None,
) -> Closing:
    """Return the orbit at given gains to which a simulation settles, or one near another orbit.

    The simulator makes the orbit here and checks it in `verify`: an error of the simulator that is
    the same in both is not seen. Verify with another engine, or `use_reference`, or both.

    Args:
        problem: The scene.
        setting: Its numbers.
        near: An orbit of the scene to start from, at these numbers or near them; else the scene's
            starts are followed until the motion nearly repeats.
        simulation: Engine and accuracy; by default Taylor's method at full accuracy where heyoka is
            installed and the scene analytic, else the default engine.
        on_progress: Called with the name of each stage as it begins.
        shape: The orbit's shape; by default that of ``near``, or what the motion settles to.

    Raises:
        InputError: If ``near`` is of another scene or shape, or ``simulation`` asks for what is
            missing.
    """
    if near is not None and near.problem != problem.name:
        message = f"must be of scene `{problem.name}`, but it is of `{near.problem}`"
        raise InputError(f"Argument `near` {message}.")
    if near is not None:
        shape = near.shape.agreed(shape)

    def tell(stage: str) -> None:
        if on_progress is not None:
            on_progress(stage)

    if simulation is not None:
        return _closed(problem, setting, near, shape, simulation, tell)
    try:
        return _closed(problem, setting, near, shape, SimulationSettings(engine=Taylor()), tell)
    except InputError:
        # No heyoka or no formulas for it; what else is wrong is wrong for every engine.
        return _closed(problem, setting, near, shape, SimulationSettings(), tell)


def close_cycle(
    dynamics: HybridDynamics,
    release: Vector,
    *,
    scale: Vector,
    period: float,
    settings: SimulationSettings,
    slope: Vector | None = None,
    shape: OrbitShape = ONE_ZENO,
) -> ClosedCycle:
    r"""Return the period of a shape that repeats, near a state where one starts.

    With :math:`r_k = P(y_k) - y_k`, steps :math:`(1 - J) s_k = r_k`, and after each
    :math:`J \leftarrow J + (r_{k+1} - r_k - (J - 1) s_k) s_k^\top / s_k^\top s_k`. Where a step
    does not halve the residual, the next one starts from the better point with the exact slope
    there (theory (27)), and is shortened if that does not help.

    Args:
        dynamics: The system.
        release: A state near the orbit's start, mostly a release, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Of the orbit, roughly [s].
        settings: Engine and accuracy.
        slope: Derivative of the return map in the section around ``release``, if it is known.
        shape: The shape.

    Raises:
        SimulationError: If a start does not return, no return repeats, or only rest does.
    """
    rows = rows_of(shape, dynamics.restitution)
    section = section_around(dynamics, rows, placed(dynamics, shape, release), scale)
    one, at = np.eye(section.dimension), np.zeros(section.dimension)
    j = np.zeros_like(one) if slope is None else slope
    best: _Trial | None = None
    exact, share = slope is not None, 1.0
    for count in range(1, _MOST_RETURNS + 1):
        trial = _tried(dynamics, section, at, shape, period, settings, needed=best is None)
        if trial is not None and trial.change <= _REPEATS:
            return _sized(trial, count)
        if trial is not None and best is not None:
            if trial.change <= _STALLED and trial.change >= best.change:
                return _sized(best, count)
            j = _broyden(j, best, trial)
        if trial is not None and (best is None or trial.change < best.change / 2):
            # A slope that was known beforehand counts for the first point only.
            best, exact, share = trial, exact and best is None, 1.0
        elif best is not None:
            # Returns alone do not close in: the orbit repels, or attracts hardly.
            if trial is not None and trial.change < best.change:
                best, exact, share = trial, False, 1.0
            if exact:
                share /= _SHORTER
            else:
                start = best.cycle.start.state
                j = return_slope(
                    dynamics, start, scale=scale, period=period, settings=settings, shape=shape
                )
                exact = True
        if best is not None:
            # Least squares: at a fold of a family the matrix is singular, and that is no crash.
            at = best.at + share * np.linalg.lstsq(one - j, best.miss, rcond=None)[0]
    raise SimulationError(
        f"No return repeats, the last misses by {np.inf if best is None else best.change:.1e}",
        time=period,
        state=tuple(release.tolist()),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Trial:
    """A return from a point of the section.

    Attributes:
        at: Coordinates of the point.
        cycle: The return.
        miss: Coordinates of its end minus those of the point.
    """

    at: Vector
    cycle: Cycle
    miss: Vector

    @property
    def change(self) -> float:
        """How far the return is from repeating."""
        return float(np.max(np.abs(self.miss), initial=0.0))


def _sized(trial: _Trial, count: int) -> ClosedCycle:
    """Return a return that repeats, unless only its size has gone to zero.

    Raises:
        SimulationError: If it does not repeat in units of its own size.
    """
    cycle = trial.cycle
    if cycle.drift(cycle.scale_at_events()) > _OWN:
        raise SimulationError(
            "What repeats is no orbit, its size goes to zero",
            time=cycle.period,
            state=tuple(cycle.start.state.tolist()),
        )
    return ClosedCycle(cycle=cycle, miss=trial.change, returns=count)


def _tried(
    dynamics: HybridDynamics,
    section: ReleaseSection,
    at: Vector,
    shape: OrbitShape,
    period: float,
    settings: SimulationSettings,
    *,
    needed: bool,
) -> _Trial | None:
    """Return the return from a point; where there is none, nothing, unless it is needed."""
    start = placed(dynamics, shape, section.state(dynamics, at))
    try:
        cycle = cycle_of(dynamics, start, shape, horizon=2 * period, settings=settings)
    except SimulationError:
        if needed:
            raise
        return None
    return _Trial(at=at, cycle=cycle, miss=section.coordinates(cycle.end.state) - at)


def _broyden(j: Vector, before: _Trial, after: _Trial) -> Vector:
    """Return the slope after a step that has told more of it."""
    step = after.at - before.at
    length = float(step @ step)
    if length == 0.0:
        return j
    told = after.miss - before.miss + step
    return j + np.outer(told - j @ step, step) / length


def cycle_near(
    dynamics: HybridDynamics,
    x: Vector,
    *,
    period: float,
    settings: SimulationSettings,
    shape: OrbitShape = ONE_ZENO,
) -> Cycle:
    """Return the first period of a shape of the motion from a state near the start of one.

    Args:
        dynamics: The system.
        x: A state on the stop, mostly near a release or at one, ``(n_x,)``.
        period: Roughly [s].
        settings: Engine and accuracy.
        shape: The shape.

    Args:
        dynamics: The system.
        x: The state, ``(n_x,)``.
        period: Its period, roughly [s].
        settings: How accurately to follow it.

    Raises:
        SimulationError: If there is none within two periods.
    """
    wanted = shape.at_restitution(dynamics.restitution)
    run = simulate(dynamics, x, until=2 * period, settings=settings)
    phases = phases_of(run, x, held=wanted.starts_at_release)
    n = wanted.n_phases
    for k in range(len(phases) - n + 1):
        some = phases[k : k + n]
        if kinds_of(some) == wanted.phases and follow_each_other(some):
            return Cycle(state_names=dynamics.state_names, phases=some)
    what = "No Zeno point and release follow"
    if not wanted.has_one_release:
        what = f"No period of shape `{wanted.text}` follows"
    raise SimulationError(what, time=2 * period, state=tuple(x.tolist()))


def _closed(
    problem: Problem,
    setting: Setting,
    near: ZenoOrbit | None,
    wanted: OrbitShape | None,
    simulation: SimulationSettings,
    tell: Callable[[str], None],
) -> Closing:
    dynamics = bind(compiled_model(problem), setting.values())
    detail = ""
    for settled in _NEAR if near is None else (np.inf,):
        try:
            tell("simulating")
            if near is None:
                cycle = _settled(dynamics, problem, settled, wanted, simulation)
            else:
                x = placed(dynamics, near.shape, np.array(problem.state_vector(near.start_state)))
                cycle = cycle_near(
                    dynamics, x, period=near.period, settings=simulation, shape=near.shape
                )
            tell("closing the orbit")
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
        detail = round_again(closed.cycle)
        if detail:
            continue
        orbit = orbit_of(closed.cycle, problem, setting)
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
        far=RUNAWAY,
    )
    settings = SettlingSettings(settled=settled, simulation=rough)
    settling = settle(dynamics, starts, settings, wanted)
    if settling.cycle is None:
        raise _NoGuessError(f"{settling.reason[0].upper()}{settling.reason[1:]}.")
    return settling.cycle


def orbit_of(cycle: Cycle, problem: Problem, setting: Setting) -> ZenoOrbit:
    """Return a period that repeats as an orbit without a certificate.

    Args:
        cycle: The period.
        problem: Its scene.
        setting: The scene's numbers.
    """

    def named(state: Vector) -> Mapping[str, float]:
        return dict(zip(problem.state_names, state.tolist(), strict=True))

    return ZenoOrbit(
        problem=problem.name,
        parameters=dict(setting.parameters),
        gains=dict(setting.gains),
        period=cycle.period,
        phases=tuple(_phase_of(phase, cycle.start.time, named) for phase in cycle.phases),
        certificate={},
        versions=versions(),
    )


def _phase_of(
    phase: Phase, start: float, named: Callable[[Vector], Mapping[str, float]]
) -> OrbitPhase:
    return OrbitPhase(
        kind=phase.kind,
        start_time=phase.start.time - start,
        start_state=named(phase.start.state),
        impacts=tuple(
            OrbitImpact(time=impact.time - start, state_minus=named(impact.state_minus))
            for impact in phase.impacts
        ),
        zeno_time=None if phase.zeno is None else phase.zeno.time - start,
        zeno_state=None if phase.zeno is None else named(phase.zeno.state),
    )
