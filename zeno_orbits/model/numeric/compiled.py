"""CasADi functions of a model, compiled from its expressions. `compiled_flow` adds the flows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, cast

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, shown
from zeno_orbits.model.contact import (
    GAP,
    GAP_ACCELERATION,
    GAP_RATE,
    MULTIPLIER,
    ContactQuantities,
    ImpactLaw,
)
from zeno_orbits.model.declared.starts import Starts, no_starts
from zeno_orbits.model.hybrid import CompletedSystem
from zeno_orbits.model.numeric.calls import Call
from zeno_orbits.model.numeric.compiled_flow import (
    ModeFunctions,
    dense_function,
    mode_functions,
    weighted,
)
from zeno_orbits.model.numeric.differentials import (
    DifferentiableFunctions,
)
from zeno_orbits.model.numeric.known_scales import KnownScales
from zeno_orbits.model.scale import CharacteristicScales


@dataclass(frozen=True, kw_only=True)
class CompiledSystem:
    """The functions of a completed system in ``(x, p)``, where ``p`` holds gains, then parameters.

    Attributes:
        state_names: Name of each state.
        n_q: Number of coordinates.
        clock: Indices of the clock in the state.
        free: The mode off the stop, in ``(x, p)``.
        locked: The mode on the stop, in ``(x, p)``.
        flight: The rescaled flight, in ``((x, h / w^2, (dh/dt) / w), (p, w))`` (theory (2.6)).
        contact: ``(x, p) -> (gap, gap_rate, gap_acceleration, multiplier, multiplier_rate)``.
        impulse: ``(x, p) -> (impulse_direction, normal_inertia, law_numbers)``, the restitution of
            the slowest impacts first.
        coefficient: ``(p, speed of an impact) -> restitution``, if it depends on the speed.
        rebound: ``(p, approach rate) -> gap rate after the impact``.
        reset: ``(x, p, approach rate) -> x after the impact``.
        resting: ``(x, p) -> (x on the stop, its gap_acceleration, its constrained flow)``.
        powers: ``(x, p) -> (input_power, copper_loss, other_loss)`` [W].
        energy: ``(x, p) -> energy`` [J].
        holonomic: ``(x, p) -> (eta, eta_rate)``.
        motors: ``(x, p) -> (current, voltage)`` of every motor, each ``(n_M,)``.
        starts: From ``p`` to the initial states of the problem, if they are known.
        state_units: Units of the states of the problem.
        further: Indices of the states of circuits and additional states, except currents of motors.
        is_balanced: Whether all powers are given, so that the energy balance can be checked.
        source: The completed system, whose formulas messages name, with the symbols of ``p``.
    """

    state_names: tuple[str, ...]
    n_q: int
    clock: tuple[int, ...]
    free: ModeFunctions
    locked: ModeFunctions
    flight: ModeFunctions
    contact: ca.Function
    impulse: ca.Function
    coefficient: ca.Function | None
    rebound: ca.Function
    reset: ca.Function
    resting: ca.Function
    powers: ca.Function
    energy: ca.Function
    holonomic: ca.Function
    motors: ca.Function
    starts: Starts = no_starts
    state_units: tuple[str, ...] = ()
    further: tuple[int, ...] = ()
    is_balanced: bool = True
    source: tuple[CompletedSystem, ca.SX] | None = field(default=None, compare=False)

    @cached_property
    def known_scales(self) -> KnownScales:
        """Scales that were computed with these functions."""
        return KnownScales()

    @cached_property
    def differentiable(self) -> DifferentiableFunctions:
        """The functions that are differentiated."""
        return DifferentiableFunctions(
            rates=(self.free.rate, self.locked.rate, self.flight.rate),
            contact=self.contact,
            holonomic=self.holonomic,
            impulse=self.impulse,
            rebound=self.rebound,
            reset=self.reset,
            resting=self.resting,
        )

    @cached_property
    def landing(self) -> ca.Function:
        """Reset and projection of an impact.

        ``(x, p, approach rate) -> (x after it, its gap_rate, then as `resting` of that)``.
        """
        x, p, rate = (ca.SX.sym(f"i{k}", self.reset.size1_in(k)) for k in range(3))
        after = self.reset(x, p, rate)
        gap_rate = self.contact(after, p)[GAP_RATE]
        outputs = [after, gap_rate, *self.resting(after, p)]
        return dense_function("landing", [x, p, rate], outputs)

    def interpreted(self) -> CompiledSystem:
        """Return the same functions, which the compiled loop does not carry out."""
        free, locked, flight = (
            replace(mode, interpreted=True) for mode in (self.free, self.locked, self.flight)
        )
        return replace(self, free=free, locked=locked, flight=flight)

    def weighted(
        self, own: CharacteristicScales
    ) -> tuple[ModeFunctions, ModeFunctions, ModeFunctions]:
        """Return all modes, free, locked and flight, with local errors absolute in given sizes."""
        weights = own.weights(self.n_x)
        flight = own.flight_weights(self.n_x)
        return (
            weighted(self.free, weights),
            weighted(self.locked, weights),
            weighted(self.flight, flight),
        )

    @property
    def n_x(self) -> int:
        """Number of states."""
        return len(self.state_names)

    def contact_at(self, x: Any, p: Any) -> ContactQuantities:
        """Return the contact quantities at symbols or values of state and parameters."""
        return ContactQuantities.of(self.contact(x, p))

    def law_at(self, p: Any) -> ImpactLaw:
        """Return the law of an impact at symbols or values of the parameters."""
        slowest = cast("Any", self.impulse)(ca.DM.zeros(self.n_x), p)[2][0]
        return ImpactLaw(
            slowest, None if self.coefficient is None else partial(self.coefficient, p)
        )


def compile_system(
    system: CompletedSystem, symbols: Mapping[str, ca.SX], state_names: Sequence[str]
) -> CompiledSystem:
    """Build the functions of a completed system.

    Args:
        system: The completed system.
        symbols: Its named parameters, in the order of ``p``.
        state_names: One name a state.

    Raises:
        ValueError: If the names do not fit the states, or an expression holds another symbol.
    """
    if system.state.numel() != len(state_names):
        message = (
            f"Argument `state_names` must name {system.state.numel()} states, "
            f"but it names {len(state_names)}."
        )
        raise ValueError(message)
    parameters = ca.vertcat(*symbols.values())
    contact = cast("ca.SX", ca.vertcat(*system.contact))
    powers = ca.vertcat(system.input_power, system.copper_loss, system.other_loss)

    def function(name: str, *outputs: ca.SX) -> ca.Function:
        return dense_function(name, [system.state, parameters], list(outputs))

    scaled_gap, speed = ca.SX.sym("eta", 2), ca.SX.sym("w")
    gap, force = contact[GAP : GAP_ACCELERATION + 1], contact[MULTIPLIER:]
    flight_rate = ca.vertcat(speed * system.free_flow, scaled_gap[1], system.gap_acceleration)
    return CompiledSystem(
        state_names=tuple(state_names),
        n_q=system.n_q,
        clock=system.clock,
        free=mode_functions(
            "free", system.state, parameters, system.free_flow, gap[:2], watched=gap
        ),
        locked=mode_functions(
            "locked", system.state, parameters, system.locked_flow, force, watched=force
        ),
        flight=mode_functions(
            "flight",
            ca.vertcat(system.state, scaled_gap),
            ca.vertcat(parameters, speed),
            flight_rate,
            scaled_gap,
            watched=ca.vertcat(gap[0] / speed**2, gap[1] / speed, gap[2]),
        ),
        contact=function("contact", contact),
        impulse=function(
            "impulse", system.impulse_direction, system.normal_inertia, system.law_numbers
        ),
        coefficient=None
        if system.law.of_speed is None
        else dense_function("coefficient", [parameters, speed], [system.law.at(speed)]),
        rebound=dense_function("rebound", [parameters, speed], [system.law.speed_after(speed)]),
        reset=dense_function("reset", [system.state, parameters, speed], [_reset(system, speed)]),
        resting=function("resting", *_resting(system)),
        powers=function("powers", powers),
        energy=function("energy", system.energy),
        holonomic=function("holonomic", system.holonomic),
        motors=function("motors", system.motor_current, system.motor_voltage),
        further=system.further,
        is_balanced=system.drive.is_balanced,
        source=(system, parameters),
    )


def tabulate(
    formula: ca.SX,
    system: CompletedSystem,
    symbols: Mapping[str, ca.SX],
    values: Sequence[float],
    states: Vector,
) -> Vector:
    """Return a formula's entries at states.

    Args:
        formula: A column of expressions in the system's states and named parameters, ``(m,)``.
        system: The completed system.
        symbols: Its named parameters, in the order of ``values``.
        values: Their numbers.
        states: ``(n, n_x)``.

    Returns:
        One row a state, ``(n, m)``.

    Raises:
        InputError: If the states are not rows of numbers.
    """
    rows = np.asarray(states)
    if rows.ndim != 2 or rows.shape[1] != system.state.numel() or rows.dtype.kind not in "fiu":
        wanted = f"must be an array of {system.state.numel()} columns"
        raise InputError(f"Argument `states` {wanted}, but it is {shown(states)}.")
    inputs = [system.state, ca.vertcat(*symbols.values())]
    call = Call(dense_function("table", inputs, [formula]), np.asarray(values, dtype=np.float64))
    return np.array([call(x).copy() for x in rows])


def _reset(system: CompletedSystem, approach_rate: ca.SX) -> ca.SX:
    """Return the state after an impact: the law of impact along the impulse, theory (1.7).

    The rate is given, and exact where the state holds only rounding.
    """
    return system.state - system.law.rate_drop(approach_rate) * system.impulse_direction


def _resting(system: CompletedSystem) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the state moved onto the stop as by ``HybridDynamics.on_stop``, and its rates."""
    x, n_q, direction = system.state, system.n_q, system.impulse_direction
    moved = ca.vertcat(x[:n_q] - system.gap * direction[n_q : 2 * n_q], x[n_q:])
    rate, direction = ca.substitute([system.gap_rate, direction], [x], [moved])
    resting = moved - rate * direction
    flows = [system.gap_acceleration, system.locked_flow]
    acceleration, locked = ca.substitute(flows, [x], [resting])
    return resting, acceleration, locked
