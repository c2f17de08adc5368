r"""Derivatives of an execution's events with respect to its start and parameters, in Python.

An event is a point at which a guard :math:`g` vanishes along the flow :math:`f`. With the
perturbation `V` at an equal time it moves by

.. math:: \delta t = -\frac{\nabla g\,V + g_p Q}{\dot g}, \qquad \delta x = V + f\,\delta t

(theory (4.3)). The Zeno point moves according to the formula of its extrapolation (theory (4.4)).
Every derivative has one column per state of the start and per chosen parameter. The compiled loop
has the same formulas, and this module is their reference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import FlowWithEvent, Tolerance
from zeno_orbits.model import (
    GAP,
    GAP_ACCELERATION,
    GAP_RATE,
    MULTIPLIER,
    Differentials,
    FlowDifferential,
    HybridDynamics,
)
from zeno_orbits.simulation.derivatives.state_transition import carried
from zeno_orbits.simulation.execution import Arc, Ending, Execution, Impact, Mode, ZenoPoint
from zeno_orbits.simulation.zeno.zeno_limit import (
    TailEstimate,
    estimate_tail,
    limit_slopes,
    limit_weights,
    spread_nodes,
    tail_time,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SaltationDerivative:
    """Derivatives of an event.

    Attributes:
        time: Derivative of its time, ``(m,)``.
        state: Derivative of the state there, ``(n_x, m)``.
        rate: Derivative of the gap rate before or after it, if it is an impact, ``(m,)``.
    """

    time: Vector
    state: Vector
    rate: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactDerivative:
    """An impact of a sequence that accumulates.

    Attributes:
        impact: The impact.
        estimate: The Zeno point to first order from it.
        shift: How it moves, after the reset.
    """

    impact: Impact
    estimate: TailEstimate
    shift: SaltationDerivative


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcShifts:
    """Derivatives of the ends of an arc.

    Attributes:
        start: Derivatives of the start: after an impact, at a Zeno point or a release.
        end: Derivatives of the end, before an impact.
        after: Derivatives after the event at the end.
    """

    start: SaltationDerivative
    end: SaltationDerivative
    after: SaltationDerivative


def carried_in_python(
    perturbations: VariationalEquation, arc: Arc, mode: Mode, v: Vector, q: Vector
) -> Vector:
    """Return the perturbations at the end of an arc, its duration held fixed, ``(n_y, m)``.

    Args:
        perturbations: The equations of perturbations.
        arc: The arc.
        mode: Mode of its flow.
        v: Perturbations at its start, ``(n_y, m)``. A rescaled flight has two further rows.
        q: Perturbations of the flow's parameters, ``(n_q, m)``.
    """
    flow, differential = perturbations.flow_of(arc, mode, len(v))
    return carried(flow, differential, arc, perturbations.tolerance, v, q)


Carry = Callable[["VariationalEquation", Arc, Mode, Vector, Vector], Vector]
"""A function like `carried_in_python`."""


@dataclass(frozen=True, kw_only=True)
class VariationalEquation:
    """Derivatives along an execution.

    Attributes:
        dynamics: The system.
        differentials: Its derivatives.
        n_parameters: Number of parameters of the derivatives.
        tolerance: Local error of steps that have to be taken anew.
        carry: How perturbations are carried along an arc.
    """

    dynamics: HybridDynamics
    differentials: Differentials
    n_parameters: int
    tolerance: Tolerance
    carry: Carry = carried_in_python

    @property
    def n_x(self) -> int:
        """Number of states."""
        return len(self.dynamics.state_names)

    def flow_of(self, arc: Arc, mode: Mode, n_y: int) -> tuple[FlowWithEvent, FlowDifferential]:
        """Return the flow of an arc and its variational equation.

        Args:
            arc: The arc.
            mode: Its mode.
            n_y: Number of its states. A rescaled flight has two more than the system.
        """
        dynamics, by = self.dynamics, self.differentials
        if n_y > self.n_x:
            return dynamics.flight(arc.time_unit), by.flight(arc.time_unit)
        if mode is Mode.LOCKED:
            return dynamics.locked, by.locked
        return dynamics.free, by.free

    @cached_property
    def parameters(self) -> Vector:
        """Perturbations of the parameters, ``(k, m)``."""
        return np.eye(self.n_parameters, self.n_x + self.n_parameters, self.n_x)

    @cached_property
    def restitution(self) -> Vector:
        """Perturbations of the restitution, ``(m,)``."""
        return self.differentials.restitution @ self.parameters

    def at_start(self) -> SaltationDerivative:
        """Return the start with its prescribed derivatives."""
        state = np.eye(self.n_x, self.n_x + self.n_parameters)
        zero = np.zeros(state.shape[1])
        return SaltationDerivative(time=zero, state=state, rate=zero)

    def launched(self, x: Vector) -> SaltationDerivative:
        """Return a start just after an impact, its gap rate included."""
        start = self.at_start()
        rate = self._total(self.differentials.contact(x)[GAP_RATE], start.state)
        return SaltationDerivative(time=start.time, state=start.state, rate=rate)

    def flown(self, arc: Arc, start: SaltationDerivative) -> SaltationDerivative:
        """Return the derivatives of the impact at the end of a flight, before its reset."""
        end = arc.flow_state_at(arc.duration)
        if end.size == self.n_x:
            return self._free(arc, start)
        return self._rescaled(arc, start, end)

    def _free(self, arc: Arc, start: SaltationDerivative) -> SaltationDerivative:
        v = self.carry(self, arc, Mode.FREE, start.state, self.parameters)
        contact = self.differentials.contact(arc.end_state)
        delay = -self._total(contact[GAP], v) / self.dynamics.gap_rate(arc.end_state)
        state = v + self.dynamics.free.rate(arc.end_state)[:, None] * delay
        return SaltationDerivative(
            time=start.time + delay, state=state, rate=self._total(contact[GAP_RATE], state)
        )

    def _rescaled(self, arc: Arc, start: SaltationDerivative, end: Vector) -> SaltationDerivative:
        """Follow a flight in its own variables, in which its speed is also a parameter."""
        speed = arc.time_unit
        launched = np.concatenate([start.state, np.zeros((2, start.time.size))])
        q = np.concatenate([self.parameters, start.rate[None, :]])
        v = self.carry(self, arc, Mode.FREE, launched, q)
        delay = -v[-2] / end[-1]
        moved = v + self.dynamics.flight(speed).rate(end)[:, None] * delay
        return SaltationDerivative(
            time=start.time + arc.duration * start.rate + speed * delay,
            state=moved[: self.n_x],
            rate=end[-1] * start.rate + speed * moved[-1],
        )

    def struck(self, impact: Impact, before: SaltationDerivative) -> SaltationDerivative:
        """Return the derivatives of the state and the gap rate after an impact."""
        reset = self.differentials.reset(impact.state_minus, impact.approach_rate)
        inputs = np.concatenate([before.state, before.rate[None, :], self.parameters])
        by_rate, *by_parameters = self.differentials.speed_after(impact.approach_rate)
        rate = by_rate * before.rate + by_parameters @ self.parameters
        return SaltationDerivative(time=before.time, state=reset @ inputs, rate=rate)

    def joined(
        self, bounces: Sequence[ImpactDerivative], impact: Impact, after: SaltationDerivative
    ) -> list[ImpactDerivative]:
        """Return a sequence with one more impact, or a new sequence if it does not continue.

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
            ImpactDerivative(impact=impact, estimate=estimate, shift=after),
        ]

    def limit(self, bounces: Sequence[ImpactDerivative], state: Vector) -> SaltationDerivative:
        r"""Return the derivatives of the Zeno point of a sequence.

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
        return SaltationDerivative(
            time=shift[-1],
            state=self._total(on_stop, shift[:-1]),
            rate=np.zeros(self.restitution.size),
        )

    def _tail(self, bounce: ImpactDerivative) -> Vector:
        """Return the derivatives of the first-order Zeno state of an impact, then of its time."""
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

    def released(self, arc: Arc, zeno: SaltationDerivative) -> SaltationDerivative:
        """Return the derivatives of the release at the end of a locked arc."""
        x, dynamics = arc.end_state, self.dynamics
        v = self.carry(self, arc, Mode.LOCKED, zeno.state, self.parameters)
        gradient = self.differentials.contact(x)[MULTIPLIER]
        delay = -self._total(gradient, v) / dynamics.multiplier_rate(x)
        moved = v + dynamics.locked.rate(x)[:, None] * delay
        on_stop = self.differentials.resting(x)[: self.n_x]
        return SaltationDerivative(
            time=zeno.time + delay,
            state=self._total(on_stop, moved),
            rate=np.zeros(self.restitution.size),
        )

    def stopped(self, arc: Arc, start: SaltationDerivative) -> SaltationDerivative:
        """Return the derivatives of the end of an arc that ends at a given time."""
        x, end = arc.end_state, arc.flow_state_at(arc.duration)
        zero = np.zeros_like(start.time)
        v, q, later = start.state, self.parameters, start.time
        if end.size > self.n_x:
            v = np.concatenate([v, np.zeros((2, zero.size))])
            q = np.concatenate([q, start.rate[None, :]])
            later = (start.time + arc.duration * start.rate) / arc.time_unit
        v = self.carry(self, arc, arc.mode, v, q)
        flow, _ = self.flow_of(arc, arc.mode, len(v))
        state = (v - flow.rate(end)[:, None] * later)[: self.n_x]
        rate = zero
        if arc.mode is Mode.FREE:
            rate = self._total(self.differentials.contact(x)[GAP_RATE], state)
        return SaltationDerivative(time=zero, state=state, rate=rate)

    def rested(self, impact: Impact, after: SaltationDerivative) -> SaltationDerivative:
        """Return the derivatives of a Zeno point that results from a plastic reset at an impact."""
        on_stop = self.differentials.resting(impact.state_plus)[: self.n_x]
        state = self._total(on_stop, after.state)
        return SaltationDerivative(time=after.time, state=state, rate=np.zeros_like(after.rate))

    def along(
        self, execution: Execution, start: SaltationDerivative, first: int
    ) -> list[ArcShifts]:
        """Return the derivatives of the ends of the arcs, up to the first end without a derivative.

        At such an end the stop is touched without an impact.

        Args:
            execution: The execution.
            start: Derivatives of the start of its first arc that counts.
            first: Index of that arc.
        """
        impacts = {impact.time: impact for impact in execution.impacts}
        zenos = {zeno.time: zeno for zeno in execution.zeno_points}
        found, here, bounces = list[ArcShifts](), start, list[ImpactDerivative]()
        for place, arc in enumerate(execution.arcs[first:]):
            begin = end = here
            zeno = zenos.get(arc.start_time) if arc.mode is Mode.LOCKED else None
            if zeno is not None and bounces:
                begin = end = self._limit_of(zeno, bounces)
                bounces = []
            elif arc.mode is Mode.LOCKED and (zeno is not None or place > 0):
                break
            impact = impacts.get(arc.end_time)
            if arc.ending is Ending.HORIZON:
                end = self.stopped(arc, begin)
            elif arc.ending is Ending.RELEASE:
                end = self.released(arc, begin)
            elif arc.ending is Ending.IMPACT:
                if impact is None:
                    break
                end = self.flown(arc, begin)
            here = end
            if arc.ending is Ending.IMPACT and impact is not None:
                here = self.struck(impact, end)
                bounces = self.joined(bounces, impact, here)
            found.append(ArcShifts(start=begin, end=end, after=here))
        return found

    def _limit_of(
        self, zeno: ZenoPoint, bounces: Sequence[ImpactDerivative]
    ) -> SaltationDerivative:
        if zeno.tail == 0.0 < zeno.last_speed:
            return self.rested(bounces[-1].impact, bounces[-1].shift)
        return self.limit(bounces, zeno.state)

    def of_gap_acceleration(self, x: Vector, shift: SaltationDerivative) -> Vector:
        """Return the derivatives of the gap acceleration at an event, ``(m,)``."""
        return self._total(self.differentials.contact(x)[GAP_ACCELERATION], shift.state)

    def _total(self, gradient: Vector, state: Vector) -> Vector:
        """Return the change of a function with a given gradient, due to state and parameters."""
        return gradient[..., : self.n_x] @ state + gradient[..., self.n_x :] @ self.parameters
