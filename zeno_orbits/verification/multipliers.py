"""Floquet multipliers of an orbit, from the first period of its integration."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import (
    IMPACT_ROWS,
    RELEASE_ROWS,
    REST_ROWS,
    EventReturn,
    Multipliers,
    derivative_of_return,
    estimated_errors,
    is_one_sided,
    multipliers_of_return,
    relaxed_tolerance,
    section_around,
)
from zeno_orbits.simulation import (
    EventDerivatives,
    SimulationSettings,
    state_after,
    state_before,
)
from zeno_orbits.verification.claim import Claim
from zeno_orbits.verification.integration import Run, followed

_LEAST = 1e-12
"""Least error of a multiplier, because two computations may agree by chance."""
_DIFFERENCE = 2e-5
"""Displacement in scaled section coordinates, at which its cube equals the integration error."""


def multipliers_along(
    graph: GraphDynamics,
    claim: Claim,
    run: Run,
    settings: SimulationSettings,
    noise: float = 0.0,
) -> Multipliers:
    """Return the multipliers of the first period of an integration.

    For a machine with formulas, the derivatives are exact. The error estimate is their change at
    looser tolerances, one period later: an orbit that is not closed has a larger error. For a
    machine of plain functions, differences of the return map are used.

    Args:
        graph: The graph of modes.
        claim: The orbit as claimed.
        run: The integration, with at least one period.
        settings: Accuracy.
        noise: Relative error of a returned state. It is only used with differences.

    Raises:
        SimulationError: If a slightly displaced state does not return, or an event has no
            derivative.
    """
    if graph.first.differentiation is None:
        return _by_differences(graph, claim, run, settings, noise)
    found = _return_of(graph, run, settings)
    values, others = multipliers_of_return(graph, found), tuple[complex, ...]()
    if values:
        again = followed(graph, claim, found.end, relaxed_tolerance(settings), 1)
        if again.periods:
            with suppress(ZenoOrbitsError):
                slope = derivative_of_return(graph, _return_of(graph, again, settings))[2]
                others = eigenvalues(slope)[: len(values)]
    event, section, jacobian = derivative_of_return(graph, found)
    errors = estimated_errors(values, others, _LEAST)
    if is_one_sided(graph, found) or _meets_a_root(graph, found):
        errors = (math.inf,) * max(1, len(values))
    return Multipliers(
        values=values, errors=errors, jacobian=jacobian, section=section, event=event
    )


def _return_of(graph: GraphDynamics, run: Run, settings: SimulationSettings) -> EventReturn:
    """Return the first period of an integration with derivatives."""
    first, execution = run.periods[0], run.execution
    if execution is None:
        raise AssertionError("A motion with a period has an execution.")
    return EventReturn(
        start=run.start,
        end=first.state,
        period=first.end,
        events=execution.events[: execution.events.index(first.events[-1]) + 1],
        execution=execution,
        differentiation=EventDerivatives(graph, (), settings.tolerance),
    )


def _meets_a_root(graph: GraphDynamics, found: EventReturn) -> bool:
    """Return True if a root of a formula has an infinite derivative at an event."""
    states = (x for event in found.events for x in (state_before(event), state_after(event)))
    return any(map(graph.has_infinite_slope, states))


def _by_differences(
    graph: GraphDynamics, claim: Claim, run: Run, settings: SimulationSettings, noise: float
) -> Multipliers:
    """Return the multipliers by central differences of returns, for two displacements.

    The second displacement is twice the first. Their extrapolation is accurate to fourth order.
    """
    first, kind = run.periods[0], claim.section.partition(" ")[0]
    contact = claim.contacts(graph)[0]
    rows = RELEASE_ROWS if contact.released else REST_ROWS if contact.rests else IMPACT_ROWS
    scale = graph.own.not_zero(np.max(np.abs([arc.end_state for arc in first.arcs]), axis=0))
    section = section_around(contact.view, rows, run.start, scale)

    def image(direction: int, distance: float) -> Vector:
        coordinates = np.zeros(section.dimension)
        coordinates[direction] = distance
        start = contact.placed(section.state(contact.view, coordinates))
        moved = followed(graph, claim, start, settings, 1)
        if not moved.periods:
            raise SimulationError(moved.trouble, time=claim.period, state=tuple(start.tolist()))
        return section.coordinates(moved.periods[0].state)

    def differences(distance: float) -> Vector:
        columns = [
            (image(k, distance) - image(k, -distance)) / (2 * distance)
            for k in range(section.dimension)
        ]
        return np.stack(columns, axis=1) if columns else np.zeros((0, 0))

    near, far = differences(_DIFFERENCE), differences(2 * _DIFFERENCE)
    jacobian = (4 * near - far) / 3
    values = eigenvalues(jacobian)
    return Multipliers(
        values=values,
        errors=estimated_errors(values, eigenvalues(near), noise / _DIFFERENCE),
        jacobian=jacobian,
        section=section,
        event=kind,
    )
