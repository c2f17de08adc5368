r"""Derivatives of the flows, the impacts and the Zeno points of a stop in a mode.

The Zeno point moves according to the formula of its extrapolation, theory (4.4). Every derivative
has one column per state of the start and per chosen parameter. The compiled loop has the same
formulas, and this module is their reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import FlowWithEvent, Tolerance
from zeno_orbits.model import Differentials, FlowDifferential, HybridDynamics
from zeno_orbits.simulation.events import Impact, ZenoPoint
from zeno_orbits.simulation.execution import Arc, Mode
from zeno_orbits.simulation.zeno.zeno_limit import (
    TailEstimate,
    estimate_tail,
    join,
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


def change_of(gradient: Vector, state: Vector) -> Vector:
    """Return the change of a function at an event, due to state and parameters.

    Args:
        gradient: Derivatives of the function, ``(..., n_x + k)``.
        state: Derivatives of the state, ``(n_x, n_x + k)``.
    """
    n_x, m = state.shape
    parameters = np.eye(m - n_x, m, n_x)
    return np.asarray(gradient[..., :n_x] @ state + gradient[..., n_x:] @ parameters)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactDerivative:
    """An impact of a sequence that accumulates.

    Attributes:
        impact: The impact.
        estimate: The Zeno point to first order from it.
        shift: How it moves, after the reset.
        before: The impact before it, if the estimate is the line through both.
    """

    impact: Impact
    estimate: TailEstimate
    shift: SaltationDerivative
    before: ImpactDerivative | None = None


@dataclass(frozen=True, kw_only=True)
class VariationalEquation:
    """Derivatives of one view: of its flows, its impacts and its Zeno points.

    Attributes:
        dynamics: The system of the view.
        differentials: Its derivatives.
        n_parameters: Number of parameters of the derivatives.
        tolerance: Local error of steps that have to be taken anew.
        in_python: Whether the loop is left out, as by the reference.
    """

    dynamics: HybridDynamics
    differentials: Differentials
    n_parameters: int
    tolerance: Tolerance
    in_python: bool = False

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

    def struck(self, impact: Impact, before: SaltationDerivative) -> SaltationDerivative:
        """Return the derivatives of the state and the gap rate after an impact."""
        reset = self.differentials.reset(impact.state_minus, impact.approach_rate)
        inputs = np.concatenate([before.state, before.rate[None, :], self.parameters])
        by_rate, *by_parameters = self.differentials.speed_after(impact.approach_rate)
        rate = by_rate * before.rate + by_parameters @ self.parameters
        return SaltationDerivative(time=before.time, state=reset @ inputs, rate=rate)

    def joined(
        self,
        bounces: Sequence[ImpactDerivative],
        impact: Impact,
        after: SaltationDerivative,
        beside: frozenset[int] = frozenset(),
    ) -> list[ImpactDerivative]:
        """Return a sequence with one more impact, or a new sequence if it does not continue.

        Args:
            bounces: The sequence so far.
            impact: The impact.
            after: Derivatives after its reset.
            beside: The switches of dry friction in the flight before it.
        """
        speed = self.dynamics.speed_after(impact.approach_rate)
        estimate = estimate_tail(self.dynamics, impact.time, impact.state_plus, speed)
        if estimate is None:
            return []
        known = list(bounces) if bounces and speed < bounces[-1].estimate.speed else []
        *others, last = join([one.estimate for one in known], estimate, beside)
        before = known[-1] if last.beside else None
        found = ImpactDerivative(impact=impact, estimate=last, shift=after, before=before)
        return [*(known if others else ()), found]

    def zeno_point(
        self, zeno: ZenoPoint, bounces: Sequence[ImpactDerivative]
    ) -> SaltationDerivative:
        """Return the derivatives of a Zeno point.

        Args:
            zeno: The Zeno point.
            bounces: The impacts of its sequence.
        """
        shift = bounces[-1].shift
        if not zeno.tail == 0.0 < zeno.last_speed:
            return self._limit(bounces, zeno.state)
        # A plastic reset cut the sequence.
        on_stop = self.differentials.resting(bounces[-1].impact.state_plus)[: self.n_x]
        state = change_of(on_stop, shift.state)
        return SaltationDerivative(time=shift.time, state=state, rate=np.zeros_like(shift.rate))

    def _limit(self, bounces: Sequence[ImpactDerivative], state: Vector) -> SaltationDerivative:
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
            state=change_of(on_stop, shift[:-1]),
            rate=np.zeros(self.restitution.size),
        )

    def _tail(self, bounce: ImpactDerivative) -> Vector:
        """Return the derivatives of the first-order Zeno state of an impact, then of its time."""
        if bounce.before is not None:
            return self._tail_beside(bounce.before, bounce)
        n_x, x, shift = self.n_x, bounce.impact.state_plus, bounce.shift
        resting, e = self.dynamics.resting(x), self.dynamics.restitution
        moved = change_of(self.differentials.resting(x), shift.state)
        acceleration = resting.gap_acceleration
        unit = tail_time(1.0, acceleration, e)
        remaining = unit * bounce.estimate.speed
        longer = unit * shift.rate
        longer += remaining * (self.restitution / (1 - e) - moved[n_x] / acceleration)
        state = moved[:n_x] + resting.rate[:, None] * longer + remaining * moved[n_x + 1 :]
        return np.concatenate([state, [shift.time + longer]])

    def _tail_beside(self, before: ImpactDerivative, last: ImpactDerivative) -> Vector:
        r"""Return the same for the line through two impacts.

        .. math:: \delta x = \delta x_1 + r\,(\delta x_1 - \delta x_0) + (x_1 - x_0)\,\delta r,
            \qquad r = \frac{w_1}{w_0 - w_1}
        """
        first, second = self._rested(before), self._rested(last)
        one, other = before.estimate, last.estimate
        fall = one.speed - other.speed
        by_share = one.speed * last.shift.rate - other.speed * before.shift.rate
        moved = np.append(other.resting - one.resting, other.impact_time - one.impact_time)
        line = second + other.speed / fall * (second - first)
        return np.asarray(line + moved[:, None] * (by_share / fall**2))

    def _rested(self, bounce: ImpactDerivative) -> Vector:
        """Return the derivatives of the state of an impact on its stop, then of its time."""
        on_stop = self.differentials.resting(bounce.impact.state_plus)[: self.n_x]
        return np.vstack([change_of(on_stop, bounce.shift.state), bounce.shift.time])
