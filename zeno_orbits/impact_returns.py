r"""From impact to impact: the return map of orbits without a Zeno point.

The section are the states just after an impact, :math:`h = 0`, :math:`\dot h > 0`, of dimension
:math:`n_x - 1` less the holonomic rows. A flight ends at the next impact and its reset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zeno_orbits.dynamics import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.execution import Ending
from zeno_orbits.extrema import least_inside
from zeno_orbits.monodromy import differentials_of
from zeno_orbits.perturbations import Perturbations
from zeno_orbits.return_maps import Loss, Margin, Return, SectionReturns
from zeno_orbits.sections import IMPACT_ROWS, projected
from zeno_orbits.simulate import simulate


@dataclass(frozen=True, kw_only=True)
class ImpactReturns(SectionReturns):
    """From just after an impact to just after the next."""

    rows = IMPACT_ROWS

    def follow(self, x: Vector, s: float, *, horizon: float) -> Return:
        """Return the flight from an impact to the next, and its derivatives.

        Raises:
            SimulationError: If the stop is not left, or not struck again within the horizon.
        """
        dynamics, line = self.dynamics(s), self.line
        speed = dynamics.gap_rate(x)
        if not speed > self.settings.contact:
            raise SimulationError("The stop is not left", time=0.0, state=tuple(x.tolist()))
        run = simulate(dynamics, x, until=horizon, releases=1, impacts=1, settings=self.settings)
        if not run.impacts or run.arcs[0].ending is not Ending.IMPACT:
            raise SimulationError("There is no next impact", time=horizon, state=tuple(x.tolist()))
        arc, impact = run.arcs[0], run.impacts[0]
        perturbations = Perturbations(
            dynamics=dynamics,
            differentials=differentials_of(dynamics, line.moving),
            n_parameters=len(line.moving),
            tolerance=self.settings.tolerance,
        )
        after = perturbations.struck(impact, perturbations.flown(arc, perturbations.launched(x)))
        n_x = x.size
        end = projected(dynamics, IMPACT_ROWS, impact.state_plus, np.ones(n_x))
        margins = {Margin(loss=Loss.FIRST_IMPACT): -impact.approach_rate}
        least = least_inside(arc, dynamics.gap, dynamics.gap_rate)
        if least is not None:
            margins[Margin(loss=Loss.NEAR_MISS)] = least
        return Return(
            time=impact.time,
            end=end,
            by_state=after.state[:, :n_x],
            by_parameter=after.state[:, n_x:] @ line.slopes,
            margins=margins,
        )
