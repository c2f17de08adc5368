"""A completed system at fixed numbers: the flows, guards and resets that a simulator needs.

Both models of a problem end here, the compiled CasADi one and a hand-written one, so a checker
cannot tell which of them it integrates.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Scalar, Vector
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import GuardedFlow, PlainFlow, light_value
from zeno_orbits.model.numeric.derivatives import Differentiation
from zeno_orbits.model.scale import OwnScale, usual

_BEYOND = ": the drive's correction is as large as what it corrects; take the full problem."


@light_value
class Resting:
    r"""A state moved onto the stop, and what happens there.

    Attributes:
        state: Gap and gap rate zero, ``(n_x,)``.
        gap_acceleration: :math:`\ddot h` of the free flow there.
        rate: :math:`\dot x` of the locked flow there, ``(n_x,)``.
    """

    state: Vector
    gap_acceleration: float
    rate: Vector


@light_value
class Landed(Resting):
    """What an impact leads to: the state after it, moved onto the stop, and as it is.

    Attributes:
        state_plus: State just after it, ``(n_x,)``.
        gap_rate: Of that state.
    """

    state_plus: Vector
    gap_rate: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FusedStop:
    """All that an impact asks of the stop in one evaluation, and the functions that it stands for.

    Attributes:
        resting: From a state to its rest.
        landed: From a state before an impact and its gap rate to what the impact leads to.
        parts: What they are made of, as ``HybridDynamics.stop_parts`` lists it.
    """

    resting: Callable[[Vector], Resting]
    landed: Callable[[Vector, float], Landed]
    parts: tuple[object, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class HybridDynamics:
    r"""A completed hybrid system as numeric functions of the state ``x``, ``(n_x,)``.

    Attributes:
        state_names: Name of each state.
        restitution: :math:`e` of the slowest impacts.
        speed_after: Gap rate after an impact, from the one before it.
        free: Flow off the stop; its guard is the gap.
        locked: Flow on the stop; its guard is the multiplier.
        flight: From the speed `w` after an impact to the rescaled flow of
            ``(x, h / w^2, (dh/dt) / w)`` in the scaled time ``t / w``; its guard is ``h / w^2``
            (theory (14)). It stays accurate down to ``w = 0``.
        gap: :math:`h(x)`.
        gap_rate: :math:`\dot h(x)`.
        gap_acceleration: :math:`\ddot h(x)` of the free flow.
        multiplier: :math:`\lambda(x)`.
        multiplier_rate: :math:`\dot\lambda(x)` along the locked flow.
        reset_map: State after an impact, from the state before it and its gap rate.
        impulse_direction: :math:`W J^\top / (J W J^\top)` in the velocity entries, ``(n_x,)``.
        normal_inertia: :math:`1 / (J W J^\top)`.
        energy: Mechanical and magnetic energy [J].
        holonomic: :math:`(\eta, \dot\eta)`, ``(2 n_eta,)``; zero on admissible states.
        n_q: Number of coordinates; ``x`` begins with them, then as many velocities.
        fused_stop: The methods `resting` and `landed` in one evaluation, if there is such a thing.
            It serves as long as the functions that it stands for are this system's own.
        differentiation: Its derivatives, if it has formulas. They serve as long, too.
        clock: Places of the clock in the state; the last of `holonomic` is how far it is off its
            circle.
        scaling: From nothing to the sizes of its numbers, if it knows them.
    """

    state_names: tuple[str, ...]
    n_q: int
    restitution: float
    speed_after: Callable[[float], float]
    free: GuardedFlow
    locked: GuardedFlow
    flight: Callable[[float], GuardedFlow]
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
    clock: tuple[int, ...] = ()
    scaling: Callable[[], OwnScale] = usual

    def __post_init__(self) -> None:
        """Refuse a restitution that is none, as a corrected drive beyond its reach has."""
        if self.fused_stop is not None and self.fused_stop.parts != self.stop_parts:
            # A part was replaced, by a wrong one in a test for instance: the whole is no longer it.
            object.__setattr__(self, "fused_stop", None)
        derivable = self.differentiation
        if derivable is not None and derivable.parts != self.derivable_parts:
            object.__setattr__(self, "differentiation", None)
        if not 0.0 <= self.restitution < 1.0:
            message = f"must lie in [0, 1) at these numbers, but it is {self.restitution:g}"
            reason = "." if not math.isnan(self.restitution) else _BEYOND
            raise InputError(f"Argument `restitution` {message}{reason}")

    @property
    def own(self) -> OwnScale:
        """Sizes of its numbers."""
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
        )

    def resting(self, x: Vector) -> Resting:
        """Return the state moved onto the stop, as by `on_stop`, and what happens there."""
        if self.fused_stop is not None:
            return self.fused_stop.resting(x)
        state = self.on_stop(x)
        return Resting(
            state=state,
            gap_acceleration=self.gap_acceleration(state),
            rate=self.locked.rate(state),
        )

    def landed(self, x: Vector, approach_rate: float) -> Landed:
        """Return what an impact leads to, by the reset map and `resting`.

        Args:
            x: State before it, ``(n_x,)``.
            approach_rate: Gap rate before it, exactly.
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
        """Return the state moved onto the stop, gap and gap rate zero, along the impulse.

        The velocity part is the plastic reset; the position part only takes away rounding.
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
) -> Callable[[float], GuardedFlow]:
    """Return the rescaled flights (theory (14)) of a system given by plain functions.

    Args:
        free_flow: From a state to ``dx/dt`` off the stop.
        gap_acceleration: From a state to the second time derivative of the gap.
    """

    def flight(speed: float) -> GuardedFlow:
        def field(y: Vector) -> Vector:
            x = y[:-2]
            return np.concatenate([speed * free_flow(x), [y[-1], gap_acceleration(x)]])

        return PlainFlow(field=field, guard_and_rate=lambda y: (float(y[-2]), float(y[-1])))

    return flight
