r"""Newton's step to a periodic orbit on its section, from returns that a batch made.

A *bundle* starts from a state of the section and from states displaced by :math:`\epsilon` along
each section coordinate, all following the first one's steps. Where they return tells :math:`P` and
its derivative, and with them the fixed point to second order and the multipliers (theory (18)).
The section is that of the releases, or of the states just after an impact where an orbit has no
Zeno point and so no release (theory (41)).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues
from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits import IMPACT_ROWS, RELEASE_ROWS, Section, projected, section_around
from zeno_orbits.simulation import Released, Struck

_DISPLACED = 1e-6
"""Displacement in scaled section coordinates.

Steps are shared, so a difference has the noise of rounding and roots alone, some 1e-14.
"""

_OFF = 0.3 * _DISPLACED
"""A state that is off its section by less, in scaled states, has good differences."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DisplacedStates:
    """A state of a section and its displaced neighbours.

    Attributes:
        section: The chart around the state.
        states: The state, then one neighbour for each section coordinate, ``(m + 1, n_x)``.
    """

    section: Section
    states: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchReturn:
    """A return over a period: its end and its numbers.

    Attributes:
        state: Where it returns, ``(n_x,)``.
        numbers: Period first, then the margins of a certificate in order, ``(n,)``.
    """

    state: Vector
    numbers: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class FixedPoint:
    """Newton's step towards a fixed point of the return map.

    Attributes:
        distance: Length of the step in section coordinates; its square is what remains, about.
        jacobian: Derivative of the return map, ``(m, m)``.
        state: The point, ``(n_x,)``.
        numbers: Period and margins there.
    """

    distance: float
    jacobian: Vector
    state: Vector
    numbers: Vector

    @property
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

    The state is off its section by what the flow drifts from the stop. Where that is no small part
    of a displacement, it is moved there as its neighbours are.

    Args:
        dynamics: The system.
        rows: Rows of the contact that vanish on the section.
        x: The state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.

    Raises:
        SimulationError: If there is no section near the state.
    """
    x = x if rows == RELEASE_ROWS else projected(dynamics, rows, x, scale)
    section = section_around(dynamics, rows, x, scale)
    eye = _DISPLACED * np.eye(section.dimension)
    centre = section.state(dynamics, np.zeros(section.dimension))
    off = np.max(np.abs(centre - x) / scale)
    states = [x if off < _OFF else centre, *(section.state(dynamics, row) for row in eye)]
    return DisplacedStates(section=section, states=np.array(states))


def _of_releases(dynamics: HybridDynamics, events: Sequence[Released]) -> BatchReturn:
    """Return what the releases of one period tell, margins at their smallest."""
    margins = np.array(
        [
            (
                -event.zeno_acceleration,
                -event.struck,
                -dynamics.multiplier_rate(event.state),
                event.time - event.zeno_time,
            )
            for event in events
        ]
    )
    numbers = np.append(events[-1].time, margins.min(axis=0))
    return BatchReturn(state=events[-1].state, numbers=numbers)


def _of_impacts(_: HybridDynamics, events: Sequence[Struck]) -> BatchReturn:
    """Return what the impacts of one period tell."""
    slowest = min(-event.rate for event in events)
    return BatchReturn(state=events[-1].state, numbers=np.array([events[-1].time, slowest]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """The events at which motions meet a section.

    Attributes:
        event: Their kind.
        rows: Rows of the contact that vanish on the section.
        margins: Names of the margins, as in a certificate.
        cycle: From the system and the events of one period, with times from its start, to what
            they tell.
        far: Longest step of Newton's method from the motion, relative; the orbit has to be here.
    """

    event: type[Released | Struck]
    rows: tuple[int, ...]
    margins: tuple[str, ...]
    cycle: Callable[[HybridDynamics, Sequence[Any]], BatchReturn]
    far: float


RELEASES = Crossing(
    event=Released,
    rows=RELEASE_ROWS,
    margins=("gap_acceleration", "first_impact_speed", "release_transversality", "locked_time"),
    cycle=_of_releases,
    far=0.8,
)
IMPACTS = Crossing(
    event=Struck,
    rows=IMPACT_ROWS,
    margins=("first_impact_speed",),
    cycle=_of_impacts,
    far=0.02,
)


def newton_step(
    dynamics: HybridDynamics,
    section: Section,
    cycles: Sequence[BatchReturn],
    jacobian: Vector | None,
) -> FixedPoint:
    """Return Newton's step from the centre of a section.

    Args:
        dynamics: The system.
        section: The chart around the state that returned.
        cycles: Its return, then those of its neighbours, if there are any.
        jacobian: Derivative of the return map to take without neighbours.
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
