r"""Derivatives of the events of an execution by its start and its parameters, one after the other.

An event is where a guard :math:`g` vanishes along a flow :math:`f`. With the perturbation `V` at
an equal time it moves by

.. math:: \delta t = -\frac{\nabla g\,V + g_p Q}{\dot g}, \qquad \delta x = V + f\,\delta t

(theory (25)). The Zeno point moves as the formula of its extrapolation says (theory (26)).
Everything has one column for every state of the start and every chosen parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import (
    GAP,
    GAP_ACCELERATION,
    GAP_RATE,
    MULTIPLIER,
    Differentials,
    HybridDynamics,
)
from zeno_orbits.simulation.execution import Arc, Impact
from zeno_orbits.simulation.state_transition import carried
from zeno_orbits.simulation.zeno_limit import (
    TailEstimate,
    estimate_tail,
    limit_slopes,
    limit_weights,
    spread_nodes,
    tail_time,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class EventShift:
    """Derivatives of an event.

    Attributes:
        time: Of its time, ``(m,)``.
        state: Of the state there, ``(n_x, m)``.
        rate: Of the gap rate there, where it is an impact: before it, or after it, ``(m,)``.
    """

    time: Vector
    state: Vector
    rate: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounce:
    """An impact of a sequence that accumulates.

    Attributes:
        impact: The impact.
        estimate: The Zeno point to first order from it.
        shift: How it moves, after the reset.
    """

    impact: Impact
    estimate: TailEstimate
    shift: EventShift


@dataclass(frozen=True, kw_only=True)
class Perturbations:
    """Derivatives along an execution.

    Attributes:
        dynamics: The system.
        differentials: Its derivatives.
        n_parameters: How many parameters they are by.
        tolerance: Local error of steps that have to be taken anew.
    """

    dynamics: HybridDynamics
    differentials: Differentials
    n_parameters: int
    tolerance: Tolerance

    @property
    def n_x(self) -> int:
        """Number of states."""
        return len(self.dynamics.state_names)

    @cached_property
    def parameters(self) -> Vector:
        """Perturbations of the parameters, ``(k, m)``."""
        return np.eye(self.n_parameters, self.n_x + self.n_parameters, self.n_x)

    @cached_property
    def restitution(self) -> Vector:
        """Perturbations of the restitution, ``(m,)``."""
        return self.differentials.restitution @ self.parameters

    def at_start(self) -> EventShift:
        """Return the start, which moves as it is told to."""
        state = np.eye(self.n_x, self.n_x + self.n_parameters)
        zero = np.zeros(state.shape[1])
        return EventShift(time=zero, state=state, rate=zero)

    def launched(self, x: Vector) -> EventShift:
        """Return a start just after an impact, its gap rate included."""
        start = self.at_start()
        rate = self._total(self.differentials.contact(x)[GAP_RATE], start.state)
        return EventShift(time=start.time, state=start.state, rate=rate)

    def flown(self, arc: Arc, start: EventShift) -> EventShift:
        """Return how the impact moves that ends a flight, before its reset."""
        end = arc.flow_state_at(arc.duration)
        if end.size == self.n_x:
            return self._free(arc, start)
        return self._rescaled(arc, start, end)

    def _free(self, arc: Arc, start: EventShift) -> EventShift:
        flow, differential = self.dynamics.free, self.differentials.free
        v = carried(flow, differential, arc, self.tolerance, start.state, self.parameters)
        contact = self.differentials.contact(arc.end_state)
        delay = -self._total(contact[GAP], v) / self.dynamics.gap_rate(arc.end_state)
        state = v + flow.rate(arc.end_state)[:, None] * delay
        return EventShift(
            time=start.time + delay, state=state, rate=self._total(contact[GAP_RATE], state)
        )

    def _rescaled(self, arc: Arc, start: EventShift, end: Vector) -> EventShift:
        """Follow a flight in its own variables: its speed is a parameter that moves, too."""
        speed = arc.time_unit
        flow, differential = self.dynamics.flight(speed), self.differentials.flight(speed)
        launched = np.concatenate([start.state, np.zeros((2, start.time.size))])
        q = np.concatenate([self.parameters, start.rate[None, :]])
        v = carried(flow, differential, arc, self.tolerance, launched, q)
        delay = -v[-2] / end[-1]
        moved = v + flow.rate(end)[:, None] * delay
        return EventShift(
            time=start.time + arc.duration * start.rate + speed * delay,
            state=moved[: self.n_x],
            rate=end[-1] * start.rate + speed * moved[-1],
        )

    def struck(self, impact: Impact, before: EventShift) -> EventShift:
        """Return how the state and the gap rate after an impact move."""
        reset = self.differentials.reset(impact.state_minus, impact.approach_rate)
        inputs = np.concatenate([before.state, before.rate[None, :], self.parameters])
        by_rate, *by_parameters = self.differentials.speed_after(impact.approach_rate)
        rate = by_rate * before.rate + by_parameters @ self.parameters
        return EventShift(time=before.time, state=reset @ inputs, rate=rate)

    def joined(self, bounces: Sequence[Bounce], impact: Impact, after: EventShift) -> list[Bounce]:
        """Return a sequence with one more impact, or a new one where it does not go on.

        Args:
            bounces: The sequence so far.
            impact: The impact.
            after: Derivatives after its reset.
        """
        speed = self.dynamics.speed_after(impact.approach_rate)
        estimate = estimate_tail(self.dynamics, impact.time, impact.state_plus, speed)
        if estimate is None:
            return []
        goes_on = not bounces or speed < bounces[-1].estimate.speed
        return [
            *(bounces if goes_on else ()),
            Bounce(impact=impact, estimate=estimate, shift=after),
        ]

    def limit(self, bounces: Sequence[Bounce], state: Vector) -> EventShift:
        r"""Return how the Zeno point of a sequence moves.

        .. math:: \delta x_\infty = \sum_k \alpha_k\,\delta x_k
            + \sum_{j,k} \frac{\partial \alpha_k}{\partial \ln w_j}\,\frac{\delta w_j}{w_j}\,x_k

        Args:
            bounces: The impacts of the sequence.
            state: The Zeno state.
        """
        chosen = [bounces[k] for k in spread_nodes([b.estimate.speed for b in bounces])]
        speeds = [bounce.estimate.speed for bounce in chosen]
        weights = np.array(limit_weights(speeds), dtype=np.float64)
        tails = np.array([self._tail(bounce) for bounce in chosen])
        shift: Vector = np.einsum("k,kim->im", weights, tails)
        if len(chosen) > 1:
            last = chosen[-1].estimate
            # The weights add up to one: only differences of the estimates count.
            states = np.array([b.estimate.state - last.state for b in chosen])
            times = np.array([b.estimate.time - last.time for b in chosen])
            logarithms = np.array([b.shift.rate / b.estimate.speed for b in chosen])
            reweighted = limit_slopes(speeds) @ logarithms
            shift += np.concatenate([states.T, times[None, :]]) @ reweighted
        on_stop = self.differentials.resting(state)[: self.n_x]
        return EventShift(
            time=shift[-1],
            state=self._total(on_stop, shift[:-1]),
            rate=np.zeros(self.restitution.size),
        )

    def _tail(self, bounce: Bounce) -> Vector:
        """Return how the first-order Zeno state and, below it, time of an impact move."""
        n_x, x, shift = self.n_x, bounce.impact.state_plus, bounce.shift
        resting, e = self.dynamics.resting(x), self.dynamics.restitution
        moved = self._total(self.differentials.resting(x), shift.state)
        acceleration = resting.gap_acceleration
        unit = tail_time(1.0, acceleration, e)
        remaining = unit * bounce.estimate.speed
        longer = unit * shift.rate
        longer += remaining * (self.restitution / (1 - e) - moved[n_x] / acceleration)
        state = moved[:n_x] + resting.rate[:, None] * longer + remaining * moved[n_x + 1 :]
        return np.concatenate([state, [shift.time + longer]])

    def released(self, arc: Arc, zeno: EventShift) -> EventShift:
        """Return how the release at the end of a locked arc moves."""
        x, dynamics = arc.end_state, self.dynamics
        flow, differential = dynamics.locked, self.differentials.locked
        v = carried(flow, differential, arc, self.tolerance, zeno.state, self.parameters)
        gradient = self.differentials.contact(x)[MULTIPLIER]
        delay = -self._total(gradient, v) / dynamics.multiplier_rate(x)
        moved = v + flow.rate(x)[:, None] * delay
        on_stop = self.differentials.resting(x)[: self.n_x]
        return EventShift(
            time=zeno.time + delay,
            state=self._total(on_stop, moved),
            rate=np.zeros(self.restitution.size),
        )

    def of_gap_acceleration(self, x: Vector, shift: EventShift) -> Vector:
        """Return how the gap acceleration at an event moves, ``(m,)``."""
        return self._total(self.differentials.contact(x)[GAP_ACCELERATION], shift.state)

    def _total(self, gradient: Vector, state: Vector) -> Vector:
        """Return the change of what has a gradient, by the state and by the parameters."""
        return gradient[..., : self.n_x] @ state + gradient[..., self.n_x :] @ self.parameters
