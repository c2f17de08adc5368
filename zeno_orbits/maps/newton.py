r"""Newton's method for a periodic orbit on its release section, from returns that a batch made.

A *bundle* starts from a release state and from states displaced by :math:`\epsilon` along each
section coordinate, all following the first one's steps. Where they return tells
:math:`P` and its derivative, and with them the fixed point to second order and the multipliers
(theory (18)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.orbits.section import Section, release_section
from zeno_orbits.simulation.batch.outcomes import Released

_DISPLACED = 1e-6
"""Displacement in scaled section coordinates.

Steps are shared, so a difference has the noise of rounding and roots alone, some 1e-14.
"""

_OFF = 0.3 * _DISPLACED
"""A state that is off its section by less, in scaled states, has good differences."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bundle:
    """A release state and its displaced neighbours.

    Attributes:
        section: The chart around the state.
        states: The state, then one neighbour for each section coordinate, ``(m + 1, n_x)``.
    """

    section: Section
    states: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Cycle:
    """What a return over a period tells; numbers behind the state are treated alike.

    Attributes:
        state: Where it returns, ``(n_x,)``.
        numbers: Period first, then the margins of a certificate in order, ``(5,)``.
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


MARGINS = ("gap_acceleration", "first_impact_speed", "release_transversality", "locked_time")
"""As `residuals.margins_of` names them."""


def bundle_at(dynamics: HybridDynamics, x: Vector, scale: Vector) -> Bundle:
    """Return a release state and its neighbours.

    The state is off its section by what the locked flow drifts from the stop. Where that is no
    small part of a displacement, it is moved there as its neighbours are.
    """
    section = release_section(dynamics, x, scale)
    eye = _DISPLACED * np.eye(section.dimension)
    centre = section.state(dynamics, np.zeros(section.dimension))
    off = np.max(np.abs(centre - x) / scale)
    states = [x if off < _OFF else centre, *(section.state(dynamics, row) for row in eye)]
    return Bundle(section=section, states=np.array(states))


def cycle_of(dynamics: HybridDynamics, events: Sequence[Released]) -> Cycle:
    """Return what the releases of one period tell, margins at their smallest.

    Args:
        dynamics: The system, for the rate of the multiplier.
        events: The releases, times from the start of the period.
    """
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
    return Cycle(state=events[-1].state, numbers=numbers)


def newton_step(
    dynamics: HybridDynamics,
    section: Section,
    cycles: Sequence[Cycle],
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
