r"""Newton's step to a periodic orbit on its section, from returns of neighbouring motions.

A *bundle* starts from a state of the section and from states displaced by :math:`\epsilon` along
each section coordinate. The returns determine :math:`P` and its derivative, and therefore the fixed
point to second order and the multipliers (theory (3.3)).
The section contains the releases. If an orbit does not have a Zeno point and hence a release, it
contains the states just after an impact (theory (5.9)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues
from zeno_orbits.maps.crossings import ImpactRecord, ReleaseRecord
from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits import (
    IMPACT_ROWS,
    RELEASE_ROWS,
    Section,
    project_to_section,
    section_around,
)

_DISPLACED = 1e-6
"""Displacement in scaled section coordinates.

Neighbours usually have the same sequence of steps, with nearly the same sizes. Errors of the
integration then cancel in a difference. If a neighbour has another sequence, the difference
contains its local error.
"""

_OFF = 0.3 * _DISPLACED
"""Largest distance of a state from its section for accurate differences, in scaled states."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DisplacedStates:
    """A state of a section and its displaced neighbours.

    Attributes:
        section: The chart around the state.
        states: The state, then one neighbour per section coordinate, ``(m + 1, n_x)``.
    """

    section: Section
    states: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class PeriodReturn:
    """A return over a period: its end, its duration and its margins.

    Attributes:
        state: State at the end, ``(n_x,)``.
        numbers: Period, then the margins of a certificate in order, ``(n,)``.
    """

    state: Vector
    numbers: Vector


@dataclass(frozen=True, kw_only=True)
class FixedPoint:
    """Newton's step towards a fixed point of the return map.

    Attributes:
        distance: Length of the step in section coordinates. The remaining error is about its
            square.
        jacobian: Derivative of the return map, ``(m, m)``.
        state: The fixed point, ``(n_x,)``.
        numbers: Period and margins at the fixed point.
    """

    distance: float
    jacobian: Vector
    state: Vector
    numbers: Vector

    @cached_property
    def multipliers(self) -> tuple[complex, ...]:
        """Eigenvalues of the derivative, the largest first."""
        return eigenvalues(self.jacobian)

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of a multiplier."""
        return max((abs(value) for value in self.multipliers), default=0.0)


def bundle_at(
    dynamics: HybridDynamics, rows: tuple[int, ...], x: Vector, scale: Vector
) -> DisplacedStates:
    """Return a state of a section and its neighbours.

    The state may be off its section by the drift of the flow from the stop. If this distance is not
    small compared with a displacement, the state is projected to the section, as are its
    neighbours.

    Args:
        dynamics: The system.
        rows: Rows of the contact that vanish on the section.
        x: The state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.

    Raises:
        SimulationError: If a section does not exist near the state.
    """
    return displaced(dynamics, chart_at(dynamics, rows, x, scale))


def chart_at(dynamics: HybridDynamics, rows: tuple[int, ...], x: Vector, scale: Vector) -> Section:
    """Return the chart of a section around a state, which is projected to it without releases.

    Args:
        dynamics: The system.
        rows: Rows of the contact that vanish on the section.
        x: The state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.

    Raises:
        SimulationError: If a section does not exist near the state.
    """
    x = x if rows == RELEASE_ROWS else project_to_section(dynamics, rows, x, scale)
    return section_around(dynamics, rows, x, scale)


def extrapolated(section: Section, before: Vector, earlier: Vector) -> Vector:
    r"""Return the limit of a motion by its last two steps, in section coordinates, ``(m,)``.

    With the steps :math:`u_1`, then :math:`u_0` to the centre, it is
    :math:`-\vartheta u_0,\ \vartheta = u_0 \cdot (u_0 - u_1) / |u_0 - u_1|^2`, which is exact for a
    linear map with one multiplier along these steps. It is zero, the centre, if the steps do not
    become shorter.

    Args:
        section: The chart around the last return.
        before: The return before, ``(n_x,)``.
        earlier: The return before that, ``(n_x,)``.
    """
    first, second = section.coordinates(earlier), section.coordinates(before)
    last, change = -second, first - 2.0 * second
    if not last @ last < (second - first) @ (second - first):
        return np.zeros(section.dimension)
    return -float(last @ change) / float(change @ change) * last


def displaced(
    dynamics: HybridDynamics, section: Section, *, neighbours: bool = True
) -> DisplacedStates:
    """Return the centre of a chart and its neighbours.

    Args:
        dynamics: The system.
        section: The chart.
        neighbours: False for the centre alone.

    Raises:
        SimulationError: If the section does not exist near the centre.
    """
    rows = _DISPLACED * np.eye(section.dimension) if neighbours else ()
    centre = section.state(dynamics, np.zeros(section.dimension))
    off = np.max(np.abs(centre - section.centre) / section.scale)
    first = section.centre if off < _OFF else centre
    states = [first, *(section.state(dynamics, row) for row in rows)]
    return DisplacedStates(section=section, states=np.array(states))


def _of_releases(dynamics: HybridDynamics, events: Sequence[ReleaseRecord]) -> PeriodReturn:
    """Return the period and the smallest margins over the releases of one period."""
    margins = np.array(
        [
            (
                math.nan
                if event.zeno_state is None
                else -dynamics.gap_acceleration(event.zeno_state),
                -event.struck,
                -dynamics.multiplier_rate(event.state),
                event.time - event.zeno_time,
            )
            for event in events
        ]
    )
    numbers = np.append(events[-1].time, margins.min(axis=0))
    return PeriodReturn(state=events[-1].state, numbers=numbers)


def _of_impacts(_: HybridDynamics, events: Sequence[ImpactRecord]) -> PeriodReturn:
    """Return the period and the slowest impact over the impacts of one period."""
    slowest = min(-event.rate for event in events)
    return PeriodReturn(state=events[-1].state, numbers=np.array([events[-1].time, slowest]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """The events at which motions cross a section.

    Attributes:
        rows: Rows of the contact that vanish on the section.
        margins: Names of the margins, as in a certificate.
        cycle: Function of the system and the events of one period, with times from its start. It
            returns the end, the period and the margins.
        far: Largest relative distance of the orbit from the motion in a Newton step.
    """

    rows: tuple[int, ...]
    margins: tuple[str, ...]
    cycle: Callable[[HybridDynamics, Sequence[Any]], PeriodReturn]
    far: float


RELEASES = Crossing(
    rows=RELEASE_ROWS,
    margins=("gap_acceleration", "first_impact_speed", "release_transversality", "locked_time"),
    cycle=_of_releases,
    far=0.8,
)
IMPACTS = Crossing(
    rows=IMPACT_ROWS,
    margins=("first_impact_speed",),
    cycle=_of_impacts,
    far=0.02,
)


def newton_step(
    dynamics: HybridDynamics,
    section: Section,
    cycles: Sequence[PeriodReturn],
    jacobian: Vector | None,
) -> FixedPoint:
    """Return Newton's step from the centre of a section.

    Args:
        dynamics: The system.
        section: The chart around the state that returned.
        cycles: Return of the state, then the returns of its neighbours, if available.
        jacobian: Derivative of the return map, for a state without neighbours.
    """
    image = section.coordinates(cycles[0].state)
    numbers = cycles[0].numbers
    rates = np.zeros((len(numbers), section.dimension))
    if jacobian is None:
        columns = [(section.coordinates(c.state) - image) / _DISPLACED for c in cycles[1:]]
        jacobian = np.stack(columns, axis=1) if columns else np.zeros((0, 0))
        slopes = [(c.numbers - numbers) / _DISPLACED for c in cycles[1:]]
        rates = np.stack(slopes, axis=1) if slopes else rates
    solved = np.linalg.solve(np.eye(section.dimension) - jacobian, image)
    z = np.asarray(solved, dtype=np.float64)
    return FixedPoint(
        distance=float(np.max(np.abs(z), initial=0.0)),
        jacobian=jacobian,
        state=section.state(dynamics, z),
        numbers=numbers + rates @ z,
    )
