r"""One period and its exact derivatives, through every impact and the Zeno point.

Source: [LeineNijmeijer2004]_, theory (4.2) to (4.5).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import GAP_ACCELERATION, Differentials, HybridDynamics
from zeno_orbits.orbits.looser_run import extrapolated
from zeno_orbits.orbits.period import cycle_and_run, first_return, place_on_section, to_next_release
from zeno_orbits.orbits.phases import Phase, phases_of
from zeno_orbits.orbits.shape import EventSequence
from zeno_orbits.simulation import (
    Arc,
    ArcPassage,
    EventDerivatives,
    Execution,
    Mode,
    SaltationDerivative,
    SimulationSettings,
    change_of,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """A scalar and its derivatives.

    Attributes:
        value: The scalar.
        by_state: Derivative with respect to the release state at the start, ``(n_x,)``.
        by_parameters: Derivative with respect to the chosen parameters, ``(k,)``.
    """

    value: float
    by_state: Vector
    by_parameters: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class ReturnDerivative:
    r"""A return to the release and its derivatives.

    A start on the section is a state of the free flow: a perturbation off the section does not
    cause contact. If the start is in contact for longer than rounding explains, the motion follows
    the contact flow to its release.

    Attributes:
        parameters: Indices in ``p`` of the chosen parameters, ``(k,)``.
        start: Release state `x` at the start, ``(n_x,)``.
        end: State of the next release, :math:`P(x)`, ``(n_x,)``.
        by_state: :math:`\partial P / \partial x`, ``(n_x, n_x)``.
        by_parameters: :math:`\partial P / \partial p` at the same `x`, ``(n_x, k)``.
        period: Time of the return [s].
        zeno_time: Time of the Zeno point [s].
        locked_time: Time from the Zeno point to the release [s]. It vanishes if the impacts
            accumulate at the release.
        gap_acceleration: :math:`\ddot h` at the Zeno point. It vanishes at the limit of Theorem 1.
        first_rate: Gap rate at the first impact. It vanishes if the impact grazes.
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
        start: State at the start, on its section, ``(n_x,)``.
        end: State at the end, ``(n_x,)``.
        by_state: Derivative of `end` with respect to `start`, ``(n_x, n_x)``.
        period: Duration of the period [s].
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
        dynamics: The system. It must have formulas.
        x: A release state, ``(n_x,)``.
        horizon: Longest time to wait [s].
        settings: Accuracy. The Zeno point is always the extrapolated limit of its impacts, which
            are computed one by one.
        parameters: Indices in ``p`` of the parameters of the derivatives, gains first.

    Raises:
        InputError: If the system does not have formulas: it is written by hand, or a part was
            replaced.
        SimulationError: If the motion does not return within the horizon, or the return is not
            differentiable.
    """
    derivatives = EventDerivatives(dynamics, parameters, settings.tolerance)
    closed = replace(settings, completion=extrapolated(settings))
    start = dynamics.on_stop(x)
    execution = to_next_release(dynamics, start, horizon=horizon, settings=closed)
    release = first_return(execution)
    if release is None:
        raise SimulationError("No release follows", time=horizon, state=tuple(x.tolist()))
    phases = phases_of(execution, start)
    if not phases or phases[0].flight is not _first_flight(execution):
        raise SimulationError(
            "The derivative of the return is undefined: the stop is touched without an impact, "
            "or more than one Zeno point is passed",
            time=release.time,
            state=tuple(release.state.tolist()),
        )
    first = first_that_counts(execution, release.time)
    passages = derivatives.passages(execution, first=first)
    return _derivative(derivatives, execution, start, phases, passages)


def period_derivative(
    dynamics: HybridDynamics,
    x: Vector,
    shape: EventSequence,
    *,
    horizon: float,
    settings: SimulationSettings,
) -> PeriodDerivative:
    """Return the end of a period of a shape, and its derivatives (theory (3.6)).

    Args:
        dynamics: The system. It must have formulas.
        x: State at the start of the period, on its section, ``(n_x,)``.
        shape: The shape of the period.
        horizon: Longest time to wait [s].
        settings: Accuracy, as for `return_derivative`.

    Raises:
        InputError: If the system does not have formulas.
        SimulationError: If the motion has a different shape, or its end is not differentiable.
    """
    derivatives = EventDerivatives(dynamics, (), settings.tolerance)
    closed = replace(settings, completion=extrapolated(settings))
    start = place_on_section(dynamics, shape, x)
    # Derivatives are propagated along the whole run. The extracted cycle does not record them.
    cycle, run = cycle_and_run(dynamics, start, shape, horizon=horizon, settings=closed)
    end = cycle.end
    first = first_that_counts(run, end.time) if shape.starts_at_release else 0
    last = cycle.phases[-1].arcs[-1]
    here = passage_of(last, derivatives.passages(run, first=first)).after
    _require_finite(here, end.time, end.state)
    return PeriodDerivative(
        start=start,
        end=end.state,
        by_state=here.state,
        period=Sensitivity(value=end.time, by_state=here.time, by_parameters=np.zeros(0)),
    )


def differentials_of(dynamics: HybridDynamics, chosen: tuple[int, ...]) -> Differentials:
    """Return the derivatives of a system with respect to its states and chosen parameters.

    Raises:
        InputError: If the system does not have formulas.
    """
    if dynamics.differentiation is None:
        raise InputError("Argument `dynamics` must have formulas, but it has plain functions.")
    return dynamics.differentiation.by(chosen)


def _first_flight(execution: Execution) -> Arc | None:
    return next((arc for arc in execution.arcs if arc.mode is Mode.FREE), None)


_AT_ONCE = 1e-6
"""Contact time at the start, relative to the return, below which it is due to rounding.

Such a start counts as released.
"""


def first_that_counts(execution: Execution, end: float) -> int:
    """Return the index of the first arc whose flow propagates a perturbation of the start.

    It is the contact flow if the start is in contact for long, and the free flow otherwise.

    Args:
        execution: The execution from the release.
        end: Time of the end of the return [s].
    """
    first = execution.arcs[0]
    return int(first.mode is Mode.LOCKED and first.end_time <= _AT_ONCE * end)


def passage_of(arc: Arc, passages: Iterable[ArcPassage]) -> ArcPassage:
    """Return the passage of an arc.

    Args:
        arc: The arc.
        passages: Passages, up to this arc at least.

    Raises:
        SimulationError: If an event up to the end of the arc has no derivative.
    """
    return next(passage for passage in passages if passage.arc is arc)


def _derivative(
    derivatives: EventDerivatives,
    execution: Execution,
    start: Vector,
    phases: Sequence[Phase],
    passages: Iterator[ArcPassage],
) -> ReturnDerivative:
    """Return the results of an execution to the next release, with derivatives."""
    zeno, locked = phases[-1].zeno, phases[-1].locked
    release = phases[-1].end
    if zeno is None or locked is None:
        raise SimulationError(
            "The return lacks a Zeno point",
            time=release.time,
            state=tuple(release.state.tolist()),
        )
    # Only a plastic impact with immediate release is a phase before the phase with contact.
    first = passage_of(phases[0].flight, passages).end
    contact = passage_of(locked, passages)
    moved, end = contact.start, contact.after
    _require_finite(end, release.time, release.state)
    dynamics, n_x = derivatives.graph.first, start.size
    by = differentials_of(dynamics, derivatives.chosen).contact(zeno.state)
    bend = change_of(by[GAP_ACCELERATION], moved.state)

    def sensitivity(value: float, shift: Vector) -> Sensitivity:
        return Sensitivity(value=value, by_state=shift[:n_x], by_parameters=shift[n_x:])

    acceleration = dynamics.gap_acceleration(zeno.state)
    return ReturnDerivative(
        parameters=derivatives.chosen,
        start=start,
        end=release.state,
        by_state=end.state[:, :n_x],
        by_parameters=end.state[:, n_x:],
        period=sensitivity(release.time, end.time),
        zeno_time=sensitivity(zeno.time, moved.time),
        locked_time=sensitivity(release.time - zeno.time, end.time - moved.time),
        gap_acceleration=sensitivity(acceleration, bend),
        first_rate=sensitivity(phases[0].impacts[0].approach_rate, first.rate),
        execution=execution,
    )


def _require_finite(end: SaltationDerivative, time: float, state: Vector) -> None:
    if not np.all(np.isfinite(end.state)):
        raise SimulationError(
            "The derivative of the return is not finite", time=time, state=tuple(state.tolist())
        )
