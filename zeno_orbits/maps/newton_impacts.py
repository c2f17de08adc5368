r"""Newton's method for an orbit without a Zeno point, on the section of its impacts (theory (41)).

Such an orbit has no release. Its section are the states just after an impact, :math:`h = 0`, and a
*bundle* starts from one of them and its neighbours in the section.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues, null_space
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.maps.attractors import Attractor, Fate
from zeno_orbits.maps.newton_attempt import Lost
from zeno_orbits.maps.newton_request import Accuracy, Request
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.orbits.section import IMPACT_ROWS, conditions_gradient, projected
from zeno_orbits.simulation.batch.outcomes import Ended, Event, Struck

_DISPLACED = 1e-6
"""Displacement in scaled section coordinates, as of a bundle on the release section."""
_FAR = 0.02
"""An orbit farther off, in scaled states, is not one that the motion has come to."""
_MOST_ITERATIONS = 8


@dataclass(frozen=True, kw_only=True)
class ImpactBundle:
    """A state just after an impact and its neighbours.

    Attributes:
        dynamics: The system.
        accuracy: How accurately.
        period: Sequences of impacts after which they come back.
        span: Time of a period, about [s].
        scale: Size of each state, ``(n_x,)``.
        tangent: Orthonormal directions in the section, in scaled states, ``(n_x, d)``.
        states: The state, then one neighbour for each direction, ``(d + 1, n_x)``.
        strikes: Impacts that began a sequence, of each lane so far; filled as they are heard of.
        iterations: Steps of Newton's method that led here.
    """

    dynamics: HybridDynamics
    accuracy: Accuracy
    period: int
    span: float
    scale: Vector
    tangent: Vector
    states: Vector
    strikes: tuple[list[Struck], ...]
    iterations: int = 0

    def request(self) -> Request:
        """Return the lanes to run."""
        # The states are on the stop and leave it, as after a release.
        return Request(self.states, self.accuracy.orbit, True, 2 * self.span)

    def hear(self, rank: int, event: Event) -> ImpactBundle | Attractor | Lost | None:
        """Take an event of one of the lanes; once all have returned, make a step."""
        if isinstance(event, Ended):
            return Lost()
        if not isinstance(event, Struck):
            return None
        if len(self.strikes[rank]) < self.period:
            self.strikes[rank].append(event)
        if any(len(events) < self.period for events in self.strikes):
            return None
        ends = np.array([events[-1].state for events in self.strikes])
        jacobian = self.tangent.T @ ((ends[1:] - ends[0]) / self.scale).T / _DISPLACED
        missed = self.tangent.T @ ((ends[0] - self.states[0]) / self.scale)
        if not (np.all(np.isfinite(jacobian)) and np.all(np.isfinite(missed))):
            return Lost()
        return self._stepped(jacobian, missed)

    def _stepped(self, jacobian: Vector, missed: Vector) -> ImpactBundle | Attractor | Lost:
        multipliers = eigenvalues(jacobian)
        if max((abs(value) for value in multipliers), default=0.0) >= 1.0:
            return Lost()
        step = self.tangent @ np.linalg.solve(np.eye(len(jacobian)) - jacobian, missed)
        distance = float(np.max(np.abs(step), initial=0.0))
        if distance > _FAR or self.iterations >= _MOST_ITERATIONS:
            return Lost()
        state = self.states[0] + self.scale * step
        if distance > self.accuracy.exact:
            return self._around(state) or Lost()
        last = self.strikes[0][-1]
        rates = [event.rate for event in self.strikes[0]]
        return Attractor(
            fate=Fate.NO_ZENO,
            period=last.time,
            multipliers=multipliers,
            margins={"first_impact_speed": min(-rate for rate in rates)},
            state=dict(zip(self.dynamics.state_names, state.tolist(), strict=True)),
        )

    def _around(self, state: Vector) -> ImpactBundle | None:
        around = bundle_around(
            self.dynamics, self.accuracy, state, self.scale, self.period, self.span
        )
        return None if around is None else replace(around, iterations=self.iterations + 1)


def bundle_around(
    dynamics: HybridDynamics,
    accuracy: Accuracy,
    x: Vector,
    scale: Vector,
    period: int,
    span: float,
) -> ImpactBundle | None:
    """Return a state just after an impact with its neighbours, or nothing if it has none.

    Args:
        dynamics: The system.
        accuracy: How accurately.
        x: The state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Sequences of impacts after which it comes back.
        span: Time that takes, about [s].
    """
    try:
        x = projected(dynamics, IMPACT_ROWS, x, scale)
        gradient = conditions_gradient(dynamics, (), IMPACT_ROWS, x) * scale
        tangent = null_space(gradient, rcond=1e-9)
        beside = [
            projected(dynamics, IMPACT_ROWS, x + _DISPLACED * scale * way, scale)
            for way in tangent.T
        ]
    except (ZenoOrbitsError, np.linalg.LinAlgError):
        return None
    states = np.array([x, *beside])
    if not np.all(np.isfinite(states)):
        return None
    return ImpactBundle(
        dynamics=dynamics,
        accuracy=accuracy,
        period=period,
        span=span,
        scale=scale,
        tangent=tangent,
        states=states,
        strikes=tuple([] for _ in states),
    )
