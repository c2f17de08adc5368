r"""One period and its exact derivatives, through every impact and the Zeno point.

Source: [LeineNijmeijer2004]_, theory (24) to (27).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import Differentials, HybridDynamics
from zeno_orbits.orbits.looser_run import extrapolated
from zeno_orbits.orbits.period import cycle_of, first_return, placed, to_next_release
from zeno_orbits.orbits.phases import Phase, phases_of
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.simulation import (
    Arc,
    Bounce,
    EventShift,
    Execution,
    Mode,
    Perturbations,
    SimulationSettings,
)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class PeriodDerivative:
    """The end of a period of any shape, and its derivatives.

    Attributes:
        start: Where it starts, on its section, ``(n_x,)``.
        end: Where it ends, ``(n_x,)``.
        by_state: Derivative of the end by the start, ``(n_x, n_x)``.
        period: Its length [s].
    """

    start: Vector
    end: Vector
    by_state: Vector
    period: Sensitivity


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
    perturbations = _perturbations(dynamics, chosen, settings)
    closed = replace(settings, completion=extrapolated(settings))
    start = dynamics.on_stop(x)
    execution = to_next_release(dynamics, start, horizon=horizon, settings=closed)
    release = first_return(execution)
    if release is None:
        raise SimulationError("There is no next release", time=horizon, state=tuple(x.tolist()))
    phases = phases_of(execution, start)
    if not phases or phases[0].flight is not _first_flight(execution):
        raise SimulationError(
            "The return has no derivative: the stop is touched without an impact, or more than one "
            "Zeno point is passed",
            time=release.time,
            state=tuple(release.state.tolist()),
        )
    here = _begun(perturbations, execution, release.time)
    passages = [passed(perturbations, phases[0], here)]
    for phase in phases[1:]:
        # Only a plastic impact that lets go is a phase before the one that holds.
        passages.append(passed(perturbations, phase, passages[-1].end))
    passage = replace(passages[-1], first=passages[0].first)
    found = _derivative(perturbations, execution, start, phases[-1], passage, chosen)
    rate = replace(found.first_rate, value=phases[0].impacts[0].approach_rate)
    return replace(found, first_rate=rate)


def period_derivative(
    dynamics: HybridDynamics,
    x: Vector,
    shape: OrbitShape,
    *,
    horizon: float,
    settings: SimulationSettings,
) -> PeriodDerivative:
    """Return where a period of a shape ends, and its derivatives (theory (45)).

    Args:
        dynamics: The system; it must have formulas.
        x: Where it starts, on its section, ``(n_x,)``.
        shape: Its shape.
        horizon: Longest time to wait [s].
        settings: Accuracy, as for `return_derivative`.

    Raises:
        InputError: If the system has no formulas.
        SimulationError: If the motion has another shape, or its end no derivative.
    """
    perturbations = _perturbations(dynamics, (), settings)
    closed = replace(settings, completion=extrapolated(settings))
    start = placed(dynamics, shape, x)
    cycle = cycle_of(dynamics, start, shape, horizon=horizon, settings=closed)
    end = cycle.end
    if shape.starts_at_release:
        here = _begun(perturbations, cycle.execution, end.time)
    else:
        here = perturbations.launched(start)
    for phase in cycle.phases:
        here = passed(perturbations, phase, here).end
    _require_finite(here, end.time, end.state)
    return PeriodDerivative(
        start=start,
        end=end.state,
        by_state=here.state,
        period=Sensitivity(value=end.time, by_state=here.time, by_parameters=np.zeros(0)),
    )


_AT_ONCE = 1e-6
"""A start that locks for less than this part of a return is locked by rounding: it is released."""


def differentials_of(dynamics: HybridDynamics, chosen: tuple[int, ...]) -> Differentials:
    """Return the derivatives of a system by its states and chosen parameters.

    Raises:
        InputError: If the system has no formulas.
    """
    if dynamics.differentiation is None:
        raise InputError("Argument `dynamics` must have formulas, but it has plain functions.")
    return dynamics.differentiation.by(chosen)


@dataclass(frozen=True, slots=True, kw_only=True)
class EventMotion:
    """Motion of the events of a phase with its start.

    Attributes:
        first: The first impact, before its reset.
        zeno: The Zeno point, if there is one.
        end: The end.
    """

    first: EventShift
    zeno: EventShift | None
    end: EventShift


def passed(perturbations: Perturbations, phase: Phase, here: EventShift) -> EventMotion:
    """Return how the events of a phase move with its start.

    Args:
        perturbations: The equations of perturbations.
        phase: The phase.
        here: Motion of its start.
    """
    bounces: list[Bounce] = []
    landings: list[EventShift] = []
    for arc, impact in zip(phase.flights, phase.impacts, strict=True):
        landings.append(perturbations.flown(arc, here))
        here = perturbations.struck(impact, landings[-1])
        if phase.zeno is not None:
            bounces = perturbations.joined(bounces, impact, here)
    if phase.zeno is None or phase.locked is None:
        return EventMotion(first=landings[0], zeno=None, end=here)
    zeno = perturbations.limit(bounces, phase.zeno.state)
    end = perturbations.released(phase.locked, zeno)
    return EventMotion(first=landings[0], zeno=zeno, end=end)


def _perturbations(
    dynamics: HybridDynamics, chosen: tuple[int, ...], settings: SimulationSettings
) -> Perturbations:
    return Perturbations(
        dynamics=dynamics,
        differentials=differentials_of(dynamics, chosen),
        n_parameters=len(chosen),
        tolerance=settings.tolerance,
    )


def _first_flight(execution: Execution) -> Arc | None:
    return next((arc for arc in execution.arcs if arc.mode is Mode.FREE), None)


def _begun(perturbations: Perturbations, execution: Execution, end: float) -> EventShift:
    """Return how a start at a release moves: with the locked flow, if it is locked for long."""
    here, first = perturbations.at_start(), execution.arcs[0]
    if first.mode is Mode.LOCKED and first.end_time > _AT_ONCE * end:
        return perturbations.released(first, here)
    return here


def _derivative(
    perturbations: Perturbations,
    execution: Execution,
    start: Vector,
    phase: Phase,
    passage: EventMotion,
    chosen: tuple[int, ...],
) -> ReturnDerivative:
    """Return what an execution to the next release tells, with derivatives."""
    zeno, moved, end = phase.zeno, passage.zeno, passage.end
    release = phase.end
    if zeno is None or moved is None:
        raise SimulationError(
            "The return passes no Zeno point",
            time=release.time,
            state=tuple(release.state.tolist()),
        )
    _require_finite(end, release.time, release.state)
    bend = perturbations.of_gap_acceleration(zeno.state, moved)
    n_x = start.size

    def sensitivity(value: float, shift: Vector) -> Sensitivity:
        return Sensitivity(value=value, by_state=shift[:n_x], by_parameters=shift[n_x:])

    acceleration = perturbations.dynamics.gap_acceleration(zeno.state)
    return ReturnDerivative(
        parameters=chosen,
        start=start,
        end=release.state,
        by_state=end.state[:, :n_x],
        by_parameters=end.state[:, n_x:],
        period=sensitivity(release.time, end.time),
        zeno_time=sensitivity(zeno.time, moved.time),
        locked_time=sensitivity(release.time - zeno.time, end.time - moved.time),
        gap_acceleration=sensitivity(acceleration, bend),
        first_rate=sensitivity(phase.impacts[0].approach_rate, passage.first.rate),
        execution=execution,
    )


def _require_finite(end: EventShift, time: float, state: Vector) -> None:
    if not np.all(np.isfinite(end.state)):
        raise SimulationError(
            "The return has no finite derivative", time=time, state=tuple(state.tolist())
        )
