r"""One period and its exact derivatives, through every impact and the Zeno point.

Source: [LeineNijmeijer2004]_, theory (24) to (27).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.completion import ZenoExtrapolation, ZenoPassage
from zeno_orbits.differentials import GAP, GAP_RATE, Differentials
from zeno_orbits.dynamics import HybridDynamics, Tolerance, Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.execution import Ending, Execution, Impact, Mode, Release, ZenoPoint
from zeno_orbits.perturbations import Bounce, EventShift, Perturbations
from zeno_orbits.returns import first_return, to_next_release
from zeno_orbits.simulate import SimulationSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """A number and its derivatives.

    Attributes:
        value: The number.
        by_state: By the release state that a period starts from, ``(n_x,)``.
        by_parameters: By the chosen parameters, ``(k,)``.
    """

    value: float
    by_state: Vector
    by_parameters: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class ReturnDerivative:
    r"""A return to the release and its derivatives.

    A start on the section is taken as a state of the free flow: a perturbation off it does not
    lock. A start that does lock, longer than by rounding, follows the locked flow to its release.

    Attributes:
        parameters: Places in ``p`` of the parameters that were chosen, ``(k,)``.
        start: Release state `x` that it starts from, ``(n_x,)``.
        end: State of the next release, :math:`P(x)`, ``(n_x,)``.
        by_state: :math:`\partial P / \partial x`, ``(n_x, n_x)``.
        by_parameters: :math:`\partial P / \partial p` at the same `x`, ``(n_x, k)``.
        period: Time of the return [s].
        zeno_time: Time of the Zeno point [s].
        locked_time: Time from the Zeno point to the release [s]; it vanishes where chatter ends
            at the release.
        gap_acceleration: :math:`\ddot h` at the Zeno point; it vanishes with Theorem 1.
        first_rate: Gap rate at the first impact; it vanishes where that grazes.
        execution: The simulation.
    """

    parameters: tuple[int, ...]
    start: Vector
    end: Vector
    by_state: Vector
    by_parameters: Vector
    period: Sensitivity
    zeno_time: Sensitivity
    locked_time: Sensitivity
    gap_acceleration: Sensitivity
    first_rate: Sensitivity
    execution: Execution


def return_derivative(
    dynamics: HybridDynamics,
    x: Vector,
    *,
    horizon: float,
    settings: SimulationSettings,
    parameters: Sequence[int] = (),
) -> ReturnDerivative:
    """Return the next release after a release, and its derivatives.

    Args:
        dynamics: The system; it must have formulas.
        x: A release state, ``(n_x,)``.
        horizon: Longest time to wait [s].
        settings: Accuracy. The Zeno point is always the extrapolated limit of its impacts, made
            one by one.
        parameters: Places in ``p`` of the parameters to differentiate by, gains first.

    Raises:
        InputError: If the system has no formulas: it is written by hand, or a part was replaced.
        SimulationError: If there is no return within the horizon, or it is not differentiable.
    """
    chosen = tuple(parameters)
    differentials = differentials_of(dynamics, chosen)
    closed = replace(settings, completion=extrapolated(settings))
    start = dynamics.on_stop(x)
    execution = to_next_release(dynamics, start, horizon=horizon, settings=closed)
    release = first_return(execution)
    if release is None:
        raise SimulationError("There is no next release", time=horizon, state=tuple(x.tolist()))
    perturbations = Perturbations(
        dynamics=dynamics,
        differentials=differentials,
        n_parameters=len(chosen),
        tolerance=settings.tolerance,
    )
    found = _derivative(perturbations, execution, start, release)
    return replace(found, parameters=chosen)


def monodromy_matrix(dynamics: HybridDynamics, derivative: ReturnDerivative) -> Vector:
    r"""Return the state transition over a period of fixed length, ``(n_x, n_x)``.

    .. math:: \Phi(T) = \frac{\partial P}{\partial x} - f(P)\,\frac{\partial T}{\partial x}

    On a periodic orbit its eigenvalues are 1, for :math:`f` itself, the multipliers, and zeros.
    """
    along = dynamics.locked.rate(derivative.end)
    return derivative.by_state - np.outer(along, derivative.period.by_state)


def saltation_matrix(dynamics: HybridDynamics, impact: Impact) -> Vector:
    r"""Return what an impact makes of a perturbation at an equal time, ``(n_x, n_x)``.

    .. math:: \Xi = R_x + \frac{(f(x^+) - R_x f(x^-))\,\nabla h^\top}{\dot h^-}, \qquad
        R_x = \frac{\partial R}{\partial x}

    Args:
        dynamics: The system; it must have formulas.
        impact: The impact.

    Raises:
        InputError: If the system has no formulas.

    Source: [LeineNijmeijer2004]_, theory (25).
    """
    differentials = differentials_of(dynamics, ())
    x, n_x = impact.state_minus, len(impact.state_minus)
    contact = differentials.contact(x)
    reset = differentials.reset(x, impact.approach_rate)
    jump = reset[:, :n_x] + reset[:, n_x, None] * contact[GAP_RATE]
    before, after = dynamics.free.rate(x), dynamics.free.rate(impact.state_plus)
    return jump + (after - jump @ before)[:, None] * contact[GAP] / impact.approach_rate


_AT_ONCE = 1e-6
"""A start that locks for less than this part of a return is locked by rounding: it is released."""


def extrapolated(settings: SimulationSettings) -> ZenoExtrapolation:
    """Return the completion that visits the impacts, as accurate as what is asked for."""
    completion = settings.completion
    if isinstance(completion, ZenoPassage):
        return completion.one_by_one
    return completion if isinstance(completion, ZenoExtrapolation) else ZenoExtrapolation()


def loosened(
    settings: SimulationSettings, factor: float, *, resolved: float = 1.0
) -> SimulationSettings:
    """Return settings whose errors are larger by far: of the steps, and of the Zeno limit.

    Args:
        settings: The settings.
        factor: Of the tolerances.
        resolved: Factor of the speed from which on impacts may be left.
    """
    tolerance, completion = settings.tolerance, extrapolated(settings)
    return replace(
        settings,
        tolerance=Tolerance(
            relative=factor * tolerance.relative, absolute=factor * tolerance.absolute
        ),
        completion=ZenoExtrapolation(
            tolerance=factor * completion.tolerance,
            resolved=min(resolved * completion.resolved, max(completion.resolved, _MOST_RESOLVED)),
        ),
    )


_MOST_RESOLVED = 0.5
"""Beyond this an impact sequence is hardly resolved at all."""


def differentials_of(dynamics: HybridDynamics, chosen: tuple[int, ...]) -> Differentials:
    """Return the derivatives of a system by its states and chosen parameters.

    Raises:
        InputError: If the system has no formulas.
    """
    if dynamics.differentiation is None:
        raise InputError("Argument `dynamics` must have formulas, but it has plain functions.")
    return dynamics.differentiation.by(chosen)


def _derivative(
    perturbations: Perturbations, execution: Execution, start: Vector, release: Release
) -> ReturnDerivative:
    """Return what an execution to the next release tells, with derivatives."""
    arcs, events = list(execution.arcs), execution.events
    here = perturbations.at_start()
    if arcs[0].mode is Mode.LOCKED:
        lock = arcs.pop(0)
        if lock.end_time > _AT_ONCE * release.time:
            here = perturbations.released(lock, here)
    impacts = [event for event in events if isinstance(event, Impact)]
    zenos = [event for event in events if isinstance(event, ZenoPoint)]
    flights = [arc for arc in arcs if arc.ending is Ending.IMPACT]
    if len(zenos) != 1 or len(flights) != len(impacts) or arcs[-1].ending is not Ending.RELEASE:
        raise SimulationError(
            "The return has no derivative: the stop is touched without an impact, or more than one "
            "Zeno point is passed",
            time=release.time,
            state=tuple(release.state.tolist()),
        )
    bounces: list[Bounce] = []
    landings: list[EventShift] = []
    for arc, impact in zip(flights, impacts, strict=True):
        landings.append(perturbations.flown(arc, here))
        here = perturbations.struck(impact, landings[-1])
        bounces = perturbations.joined(bounces, impact, here)
    zeno = perturbations.limit(bounces, zenos[0].state)
    end = perturbations.released(arcs[-1], zeno)
    bend = perturbations.of_gap_acceleration(zenos[0].state, zeno)
    n_x = start.size

    def sensitivity(value: float, shift: Vector) -> Sensitivity:
        return Sensitivity(value=value, by_state=shift[:n_x], by_parameters=shift[n_x:])

    if not np.all(np.isfinite(end.state)):
        raise SimulationError(
            "The return has no finite derivative",
            time=release.time,
            state=tuple(release.state.tolist()),
        )
    acceleration = perturbations.dynamics.gap_acceleration(zenos[0].state)
    return ReturnDerivative(
        parameters=(),
        start=start,
        end=release.state,
        by_state=end.state[:, :n_x],
        by_parameters=end.state[:, n_x:],
        period=sensitivity(release.time, end.time),
        zeno_time=sensitivity(zenos[0].time, zeno.time),
        locked_time=sensitivity(release.time - zenos[0].time, end.time - zeno.time),
        gap_acceleration=sensitivity(acceleration, bend),
        first_rate=sensitivity(impacts[0].approach_rate, landings[0].rate),
        execution=execution,
    )
