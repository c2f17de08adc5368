"""A compiled system at fixed values of its gains and parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import FlowWithEvent
from zeno_orbits.model.contact import (
    GAP,
    GAP_ACCELERATION,
    GAP_RATE,
    MULTIPLIER,
    MULTIPLIER_RATE,
    ImpactLaw,
)
from zeno_orbits.model.numeric.calls import Call, LandingCall, ResetCall, RestingCall
from zeno_orbits.model.numeric.casadi_calls import caller
from zeno_orbits.model.numeric.compiled import CompiledSystem
from zeno_orbits.model.numeric.compiled_flow import CompiledFlow, FlowMemory
from zeno_orbits.model.numeric.derivatives import Differentiation
from zeno_orbits.model.numeric.differentials import BoundDifferentials, derivative_formulas
from zeno_orbits.model.numeric.hybrid_dynamics import BoundFormulas, FusedStop, HybridDynamics
from zeno_orbits.model.numeric.own_scale import own_scale
from zeno_orbits.model.scale import UNIT_SCALES, CharacteristicScales


def bind(
    compiled: CompiledSystem,
    values: Sequence[float] | Vector,
    scale: Callable[[], CharacteristicScales] | None = None,
) -> HybridDynamics:
    """Return the system at fixed values of gains and parameters.

    Args:
        compiled: The functions.
        values: Parameter vector ``p``, gains then parameters.
        scale: Function that returns the characteristic scales, by default those at the starts.
    """
    p = np.array(values, dtype=np.float64)
    plain = _plain_dynamics(compiled, p, lambda: scaling())
    fused = FusedStop(
        resting=RestingCall(compiled.resting, p),
        landed=LandingCall(compiled.landing, p),
        parts=plain.stop_parts,
    )

    @lru_cache(maxsize=8)
    def derivatives(chosen: tuple[int, ...]) -> BoundDifferentials:
        return BoundDifferentials(derivative_formulas(compiled.differentiable, chosen), p)

    derivable = Differentiation(by=derivatives, parts=plain.derivable_parts)

    @lru_cache(maxsize=1)
    def scaling() -> CharacteristicScales:
        if scale is not None:
            return scale()
        starts = compiled.starts(p)
        if not starts:
            return UNIT_SCALES
        whole = replace(plain, formulas=formulas)
        units, clock, further = compiled.state_units, compiled.clock, compiled.further
        return compiled.known_scales.at(
            p, 0, lambda: own_scale(whole, starts, units, clock, further)
        )

    formulas = BoundFormulas(system=compiled, values=p, parts=plain.formula_parts)
    return replace(
        plain,
        fused_stop=fused,
        differentiation=derivable,
        formulas=formulas,
        scaling=scaling,
    )


def _at_speeds(function: ca.Function, p: Vector) -> Callable[[float], float]:
    """Return a function of parameters and one speed, as a function of the speed."""
    given, result = np.zeros(1), np.zeros(1)
    evaluate = caller(function, (p, given), (result,))

    def at(speed: float) -> float:
        given[0] = speed
        evaluate()
        return float(result[0])

    return at


def _plain_dynamics(
    compiled: CompiledSystem, p: Vector, scaling: Callable[[], CharacteristicScales]
) -> HybridDynamics:
    """Return the system with one call of compiled code for each of its functions.

    Args:
        compiled: The functions.
        p: Gains and parameters.
        scaling: Function that returns the characteristic scales.
    """
    contact = Call(compiled.contact, p)
    impulse = Call(compiled.impulse, p)
    law = ImpactLaw(float(impulse(np.zeros(compiled.n_x), 2)[0]))
    of_speed = speed_after = None
    if compiled.coefficient is not None:
        of_speed = _at_speeds(compiled.coefficient, p)
        speed_after = _at_speeds(compiled.rebound, p)
    energy = Call(compiled.energy, p)
    holonomic = Call(compiled.holonomic, p)

    def weights() -> tuple[float, ...]:
        return scaling().weights(compiled.n_x)

    flights = FlowMemory(compiled.flight, lambda: scaling().flight_weights(compiled.n_x))

    def flight(speed: float) -> FlowWithEvent:
        numbers = np.empty(p.size + 1)
        numbers[:-1], numbers[-1] = p, speed
        return CompiledFlow(compiled.flight, numbers, flights)

    return HybridDynamics(
        state_names=compiled.state_names,
        n_q=compiled.n_q,
        restitution=law.restitution,
        restitution_at=of_speed,
        speed_after=speed_after or law.speed_after,
        free=CompiledFlow(compiled.free, p, FlowMemory(compiled.free, weights)),
        locked=CompiledFlow(compiled.locked, p, FlowMemory(compiled.locked, weights)),
        flight=flight,
        gap=lambda x: float(contact(x)[GAP]),
        gap_rate=lambda x: float(contact(x)[GAP_RATE]),
        gap_acceleration=lambda x: float(contact(x)[GAP_ACCELERATION]),
        multiplier=lambda x: float(contact(x)[MULTIPLIER]),
        multiplier_rate=lambda x: float(contact(x)[MULTIPLIER_RATE]),
        reset_map=ResetCall(compiled.reset, p),
        impulse_direction=lambda x: impulse(x, 0).copy(),
        normal_inertia=lambda x: float(impulse(x, 1)[0]),
        energy=lambda x: float(energy(x)[0]),
        holonomic=lambda x: holonomic(x).copy(),
        clock=compiled.clock,
    )
