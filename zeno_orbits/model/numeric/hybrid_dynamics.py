"""A completed system at fixed parameter values: the flows, guards and resets of a simulator.

The compiled CasADi model and the hand-written model of a problem both have this interface, so a
checker integrates both in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zeno_orbits.arrays import Scalar, Vector
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import FlowWithEvent, PlainFlow
from zeno_orbits.model.numeric.derivatives import Differentiation
from zeno_orbits.model.numeric.stop_states import ContactProjection, Landed
from zeno_orbits.model.scale import CharacteristicScales, usual

if TYPE_CHECKING:
    from zeno_orbits.model.numeric.compiled import CompiledSystem
    from zeno_orbits.model.numeric.graph_dynamics import GraphDynamics

_BEYOND = ": the drive's correction is as large as the corrected value; use the full problem."

_ADDED = " (a corrected drive adds its current layer)."


@dataclass(frozen=True, slots=True, kw_only=True)
class FusedStop:
    """All quantities that an impact needs in one evaluation, and the functions that it replaces.

    Attributes:
        resting: Function from a state to its `ContactProjection`.
        landed: Function from a state before an impact and its gap rate to the `Landed` result.
        parts: The replaced functions, as listed by ``HybridDynamics.stop_parts``.
    """

    resting: Callable[[Vector], ContactProjection]
    landed: Callable[[Vector, float], Landed]
    parts: tuple[object, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoundFormulas:
    """The formulas of a system with parameter values, for evaluation outside of Python.

    Attributes:
        system: The functions of the problem.
        values: Gains and parameters, ``(n_p,)``.
        parts: The functions that the formulas represent, as listed by
            ``HybridDynamics.formula_parts``.
    """

    system: CompiledSystem
    values: Vector
    parts: tuple[object, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class HybridDynamics:
    r"""A completed hybrid system as numeric functions of the state ``x``, ``(n_x,)``.

    Attributes:
        state_names: Name of each state.
        restitution: :math:`e` of the slowest impacts.
        speed_after: Function from the gap rate before an impact to the gap rate after it.
        free: Flow off the stop. Its guard is the gap.
        locked: Flow on the stop. Its guard is the multiplier.
        flight: Function from the speed `w` after an impact to the rescaled flow of ``(x, h / w^2,
            (dh/dt) / w)`` in the scaled time ``t / w``. Its guard is ``h / w^2`` (theory (2.6)).
            The flow is accurate down to ``w = 0``.
        gap: :math:`h(x)`.
        gap_rate: :math:`\dot h(x)`.
        gap_acceleration: :math:`\ddot h(x)` of the free flow.
        multiplier: :math:`\lambda(x)`.
        multiplier_rate: :math:`\dot\lambda(x)` along the constrained flow.
        reset_map: State after an impact, from the state before it and its gap rate.
        impulse_direction: :math:`W J^\top / (J W J^\top)` in the velocity entries, ``(n_x,)``.
        normal_inertia: :math:`1 / (J W J^\top)`.
        energy: Mechanical and magnetic energy [J].
        holonomic: :math:`(\eta, \dot\eta)`, ``(2 n_eta,)``, zero on admissible states.
        n_q: Number of coordinates. The state ``x`` begins with the coordinates, then the
            velocities.
        fused_stop: The methods `resting` and `landed` in one evaluation, if available. It is valid
            as long as this system's functions are the replaced functions.
        differentiation: Derivatives, if the system has formulas. They are valid under the same
            condition.
        formulas: Formulas, if the system has any. They are valid under the same condition.
        clock: Indices of the clock in the state. The last entry of `holonomic` is the distance of
            the clock from its circle.
        scaling: Function without arguments that returns the characteristic scales, if they are
            known.
        restitution_at: Function from the speed of an impact to :math:`e`, if it depends on the
            speed.
    """

    state_names: tuple[str, ...]
    n_q: int
    restitution: float
    speed_after: Callable[[float], float]
    free: FlowWithEvent
    locked: FlowWithEvent
    flight: Callable[[float], FlowWithEvent]
    gap: Scalar
    gap_rate: Scalar
    gap_acceleration: Scalar
    multiplier: Scalar
    multiplier_rate: Scalar
    reset_map: Callable[[Vector, float], Vector]
    impulse_direction: Callable[[Vector], Vector]
    normal_inertia: Scalar
    energy: Scalar
    holonomic: Callable[[Vector], Vector]
    fused_stop: FusedStop | None = None
    differentiation: Differentiation | None = None
    formulas: BoundFormulas | None = None
    clock: tuple[int, ...] = ()
    scaling: Callable[[], CharacteristicScales] = usual
    restitution_at: Callable[[float], float] | None = None

    def __post_init__(self) -> None:
        """Reject an invalid restitution, as from a corrected drive outside its validity."""
        if self.fused_stop is not None and self.fused_stop.parts != self.stop_parts:
            # A part was replaced, by a wrong one in a test for instance: the whole is no longer it.
            object.__setattr__(self, "fused_stop", None)
        derivable = self.differentiation
        if derivable is not None and derivable.parts != self.derivable_parts:
            object.__setattr__(self, "differentiation", None)
        if self.formulas is not None and self.formulas.parts != self.formula_parts:
            object.__setattr__(self, "formulas", None)
        if self.restitution_at is not None and not 0.0 < self.restitution < 1.0:
            limit = round(float(self.restitution), 9) + 0.0
            plastic = "For plastic impacts, write a constant restitution of 0."
            raise InputError(
                "Argument `restitution` must have a limit between 0 and 1 at speed 0 if it depends "
                f"on `impact_speed`, but the limit is {limit:g}. "
                f"{plastic if limit == 0.0 else 'Change the values of the law.'}"
            )
        if not 0.0 <= self.restitution <= 1.0:
            # All digits: a formula may exceed 1 by rounding.
            message = f"must lie in [0, 1] at these values, but it is {float(self.restitution)}"
            reason = _BEYOND if math.isnan(self.restitution) else _ADDED
            if self.restitution < 0.0:
                reason = "."
            raise InputError(f"Argument `restitution` {message}{reason}")

    def restitution_of(self, speed: float) -> float:
        """Return the restitution of an impact.

        Args:
            speed: Speed at which it closes the gap.
        """
        return self.restitution if self.restitution_at is None else self.restitution_at(speed)

    def as_graph(self, stop: str = "") -> GraphDynamics:
        """Return the system as a graph of one mode.

        Args:
            stop: Name of its stop.
        """
        from zeno_orbits.model.numeric.one_stop import OneStop

        return OneStop(self, stop)

    @property
    def own(self) -> CharacteristicScales:
        """Characteristic scales of the system."""
        return self.scaling()

    @property
    def stop_parts(self) -> tuple[object, ...]:
        """The functions that `resting` and `landed` are made of."""
        gap = (self.gap, self.gap_rate, self.gap_acceleration)
        return (*gap, self.impulse_direction, self.locked, self.reset_map)

    @property
    def derivable_parts(self) -> tuple[object, ...]:
        """Everything that derivatives are derivatives of."""
        contact = (self.multiplier, self.multiplier_rate, self.holonomic)
        return (
            *self.stop_parts,
            *contact,
            self.free,
            self.flight,
            self.speed_after,
            self.restitution,
            self.restitution_at,
        )

    @property
    def formula_parts(self) -> tuple[object, ...]:
        """All parts that an execution depends on, except the characteristic scales."""
        return (*self.derivable_parts, self.normal_inertia)

    def resting(self, x: Vector) -> ContactProjection:
        """Return the state projected onto the stop by `on_stop`, with its accelerations."""
        if self.fused_stop is not None:
            return self.fused_stop.resting(x)
        state = self.on_stop(x)
        return ContactProjection(
            state=state,
            gap_acceleration=self.gap_acceleration(state),
            rate=self.locked.rate(state),
        )

    def landed(self, x: Vector, approach_rate: float) -> Landed:
        """Return the result of an impact, by the reset map and `resting`.

        Args:
            x: State before the impact, ``(n_x,)``.
            approach_rate: Exact gap rate before the impact.
        """
        if self.fused_stop is not None:
            return self.fused_stop.landed(x, approach_rate)
        state_plus = self.reset_map(x, approach_rate)
        resting = self.resting(state_plus)
        return Landed(
            state=resting.state,
            gap_acceleration=resting.gap_acceleration,
            rate=resting.rate,
            state_plus=state_plus,
            gap_rate=self.gap_rate(state_plus),
        )

    def on_stop(self, x: Vector) -> Vector:
        """Return the state projected onto the stop, with zero gap and gap rate, along the impulse.

        The projection of the velocity is the plastic reset. The projection of the position removes
        only rounding.
        """
        if self.fused_stop is not None:
            return self.fused_stop.resting(x).state
        projected = x.copy()
        gap, direction = self.gap(projected), self.impulse_direction(projected)
        if gap != 0.0:
            n_q = self.n_q
            projected[:n_q] -= gap * direction[n_q : 2 * n_q]
            direction = self.impulse_direction(projected)
        projected -= self.gap_rate(projected) * direction
        return projected


def plain_flight(
    free_flow: Callable[[Vector], Vector], gap_acceleration: Scalar
) -> Callable[[float], FlowWithEvent]:
    """Return the rescaled flights (theory (2.6)) of a system given by plain functions.

    Args:
        free_flow: Function from a state to ``dx/dt`` off the stop.
        gap_acceleration: Function from a state to the second time derivative of the gap.
    """

    def flight(speed: float) -> FlowWithEvent:
        def field(y: Vector) -> Vector:
            x = y[:-2]
            return np.concatenate([speed * free_flow(x), [y[-1], gap_acceleration(x)]])

        return PlainFlow(field=field, guard_and_rate=lambda y: (float(y[-2]), float(y[-1])))

    return flight
