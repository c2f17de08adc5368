"""Forward integration from the claimed start of an orbit over several periods."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits import (
    LOOSER,
    Cycle,
    EventSequence,
    Moment,
    first_cycles,
    followed,
    kinds_of,
    phases_of,
    place_on_section,
    relaxed_tolerance,
)
from zeno_orbits.simulation import Arc, Execution, Mode, SimulationSettings, ZenoExtrapolation
from zeno_orbits.verification.claim import Claim


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstCycle:
    """The first integrated period, and the sizes that residuals are relative to.

    Attributes:
        cycle: The period.
        largest: Largest size of each state over the period, with tails, ``(n_x,)``.
        scale: The same sizes with zeros replaced, ``(n_x,)``.
        gap: Largest gap.
        force: Largest multiplier.
    """

    cycle: Cycle
    largest: Vector
    scale: Vector
    gap: float
    force: float

    @property
    def zeno_error(self) -> float:
        """Largest estimated error of a Zeno limit with exact impacts. 0 without a Zeno point."""
        return max((point.limit_error for point in self.cycle.zeno_points), default=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """The integrated orbit.

    Attributes:
        first: The first period, if it has the phases of the claim.
        returns: Times and states at the ends of all periods.
        integration_error: Relative difference from an integration at a looser tolerance.
        trouble: Reason why the integration ended early. Empty if it did not.
    """

    first: FirstCycle | None
    returns: tuple[Moment, ...]
    integration_error: float
    trouble: str


_LONGEST = 1e200
"""Longest time to wait [s]. Beyond it the time of a rescaled flight overflows."""


_REPETITIONS = ((LOOSER, 1.0), (LOOSER / 10.0, 3.0))
"""Factors on the tolerances of a second integration, and the largest observed ratio of the error
to the difference. A state inside a long step may differ by more than the looser tolerance."""


_GROWN = 1e3
"""Residual, in units of the tolerance, up to which it may be an error of the integration."""
_FINER = 1e-2
"""Tolerances of the decisive integration, in units of the usual tolerances."""

Seen = TypeVar("Seen")


def decisive(
    observed: Callable[[SimulationSettings], Seen],
    worst: Callable[[Seen], float],
    settings: SimulationSettings,
    enough: float,
) -> tuple[Seen, SimulationSettings]:
    """Return an observation and its settings, at finer tolerances if it is near to sufficient.

    Over many impacts the errors of the integration may have grown to the size of a residual.

    Args:
        observed: Function of settings. It returns the observation with them.
        worst: Function of an observation. It returns the largest residual.
        settings: Settings of the first observation.
        enough: Largest residual that passes.
    """
    seen = observed(settings)
    if not 1.0 < worst(seen) / enough < _GROWN:
        return seen, settings
    finer = relaxed_tolerance(settings, factor=_FINER)
    return observed(finer), finer


def error_by_repetition(
    difference: Callable[[SimulationSettings], float], settings: SimulationSettings, enough: float
) -> float:
    """Return the error of an integration, from its differences to looser integrations.

    Args:
        difference: Function of settings. It returns the difference to an integration with them,
            infinite if that integration does not return.
        settings: Settings of the integration.
        enough: A larger error is estimated again by a less loose integration.
    """
    error = math.inf
    for factor, share in _REPETITIONS:
        error = min(error, share * difference(relaxed_tolerance(settings, factor=factor)))
        if error <= enough:
            break
    return error


def observe(
    dynamics: HybridDynamics,
    claim: Claim,
    simulation: SimulationSettings,
    n_periods: int,
    enough: float = math.inf,
) -> Observation:
    """Integrate from the claimed start over several periods. Repeat the first less accurately.

    Args:
        dynamics: The system.
        claim: The orbit as claimed.
        simulation: Accuracy.
        n_periods: Number of returns. The claimed period is only used to limit the waiting time.
        enough: A larger integration error is estimated again by a less loose integration.
    """
    shape = claim.shape.at_restitution(dynamics.restitution)
    start = place_on_section(dynamics, shape, claim.start)
    horizon = min((n_periods + 0.5) * claim.period, _LONGEST)
    try:
        run = followed(
            dynamics, start, shape, horizon=horizon, settings=simulation, n_periods=n_periods
        )
    except ZenoOrbitsError as error:
        if n_periods == 1:
            return _nothing(str(error).removesuffix("."))
        # If the motion leaves its orbit later, the first period is still valid.
        first = observe(dynamics, claim, simulation, 1, enough)
        return replace(first, trouble=first.trouble or str(error).removesuffix("."))
    found = first_cycles(run, start, shape)
    if not found:
        return _nothing(f"{_missing(run, start, shape)} within {horizon:.4g} s")
    first = _measured(dynamics, found[0])
    end = first.cycle.end

    def difference(settings: SimulationSettings) -> float:
        loose = replace(settings, completion=ZenoExtrapolation(tolerance=1e-10))
        try:
            again = followed(dynamics, start, shape, horizon=1.5 * end.time, settings=loose)
        except ZenoOrbitsError:
            return math.inf
        cycles = first_cycles(again, start, shape)
        return distance(cycles[0].end.state, end.state, first.scale) if cycles else math.inf

    return Observation(
        first=first,
        returns=tuple(cycle.end for cycle in found),
        integration_error=error_by_repetition(difference, simulation, enough),
        trouble="",
    )


def _nothing(trouble: str) -> Observation:
    return Observation(first=None, returns=(), integration_error=math.inf, trouble=trouble)


def _missing(execution: Execution, start: Vector, shape: EventSequence) -> str:
    """Return a clause on the reason why an execution does not begin with a period of a shape."""
    if shape.starts_at_release and not execution.returns(execution.end_time):
        return "No release occurs"
    if shape.starts_at_release and not execution.zeno_points:
        return "No Zeno point occurs"
    phases = phases_of(execution, start, held=shape.starts_at_release)[: shape.n_phases]
    seen = ", ".join(kind.value for kind in kinds_of(phases)) or "none"
    return f"There are not the phases `{shape.text}`, but {seen}"


def _measured(dynamics: HybridDynamics, cycle: Cycle) -> FirstCycle:
    """Return a period with its sizes."""
    arcs = cycle.execution.arcs
    states = np.concatenate([arc.flow_states[:, : len(cycle.end.state)] for arc in arcs])
    locked = [x for arc in arcs if arc.mode is Mode.LOCKED for x in arc.flow_states]
    locked += [point.state for point in cycle.zeno_points]
    largest = np.max(np.abs(states), axis=0)
    return FirstCycle(
        cycle=cycle,
        largest=largest,
        scale=np.where(largest > 0.0, largest, 1.0),
        gap=max(_largest_gap(dynamics, arc) for arc in arcs),
        force=max((abs(dynamics.multiplier(x)) for x in locked), default=1.0),
    )


def _largest_gap(dynamics: HybridDynamics, arc: Arc) -> float:
    """Return the largest gap of an arc. A rescaled flight computes it during integration."""
    states = arc.flow_states
    if arc.mode is Mode.FREE and states.shape[1] > len(arc.start_state):
        return float(np.max(np.abs(states[:, -2]))) * arc.time_unit**2
    return max(abs(dynamics.gap(x)) for x in states)


def distance(a: Vector, b: Vector, scale: Vector) -> float:
    """Return the largest difference of two states, each entry in units of its scale.

    Args:
        a: First state, ``(n_x,)``.
        b: Second state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
    """
    return float(np.max(np.abs(a - b) / scale))
