r"""Complete a mechanism and its drive: guard, reset map, multiplier, constrained flow, Theorem 1.

Everything is an expression in the state ``x = (q, v, i)`` and the named parameters of the problem,
gains and restitution among them. Source: [OrAmes2011]_, paper eqs (5)-(8), theory (1.5)-(2.4).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca
import numpy as np

from zeno_orbits.model.clock import Clock, Time
from zeno_orbits.model.contact import (
    SLOWEST,
    ContactQuantities,
    ImpactLaw,
    at_impact_speed,
    impact_speed,
)
from zeno_orbits.model.drives.auxiliary import Part, joined_auxiliary
from zeno_orbits.model.drives.circuits import Drive
from zeno_orbits.model.expressions.identities import values_near_one
from zeno_orbits.model.friction import stuck_motion
from zeno_orbits.model.lagrangian import HybridLagrangian, accelerate
from zeno_orbits.model.modes import ModeGraph

_ROUNDING, _OF_STATES = 1e-9, 1e-14
"""Rounding of formulas over their size, and of a change of states with values of about 1."""


@dataclass(frozen=True, kw_only=True)
class CompletedSystem:
    r"""A completed hybrid system in symbols.

    Attributes:
        n_q: Number of coordinates.
        state: ``x = (q, v)``, the states of the drive (currents, voltages, additional states), the
            clock of a forced problem and any ledger states, ``(n_x,)``.
        free_flow: :math:`\dot x` off the stop, ``(n_x,)`` (theory (1.5)).
        locked_flow: :math:`\dot x` on the stop, ``(n_x,)`` (theory (1.8)).
        gap: :math:`h`.
        gap_rate: :math:`\dot h`.
        gap_acceleration: :math:`\ddot h` of the free flow, the quantity of Theorem 1.
        multiplier: :math:`\lambda` that keeps :math:`\ddot h = 0` on the stop.
        multiplier_rate: :math:`\dot\lambda` along the constrained flow.
        impulse_direction: :math:`W J^\top / (J W J^\top)` as a change of state, ``(n_x,)``. Its
            last entries are the changes of additional states in an impact.
        normal_inertia: :math:`1 / (J W J^\top)`, the effective inertia in an impact.
        law: The impact law, with symbols as parameters.
        energy: Kinetic and potential energy, and the energy of fields and of additional states [J].
        input_power: Power delivered by the sources and by external forces [W].
        copper_loss: Power lost in resistances and conductances [W].
        other_loss: Power lost to passive forces, to unequal motor constants and by additional
            states [W].
        holonomic: :math:`(\eta, \dot\eta)`, ``(2 n_eta,)``, and the clock's distance from its
            circle. All are zero on admissible states.
        motor_current: Current of every motor, a state or not, ``(n_M,)`` [A].
        motor_voltage: Voltage of every motor, ``(n_M,)`` [V].
        mechanism: The completed mechanism, including the inertia that a corrected drive adds.
        bare: The mechanism without that inertia.
        stop_restitution: Coefficient of restitution of the stop, without the current layer that a
            corrected drive adds to an impact. It may depend on `impact_speed`.
        drive: Drive of the mechanism.
        belt_power: Power that moving surfaces deliver to the parts that stick to them, off the stop
            and on it, ``(2,)`` [W].
        modes: The modes of a machine with several stops or switches, or ``None``. The other fields
            then describe its first stop alone.
        is_built: Whether it is as `hybrid_system` returns it. A copy with other formulas is not: no
            mechanism and no drive has them, and the modes are made from these.
    """

    n_q: int
    state: ca.SX
    free_flow: ca.SX
    locked_flow: ca.SX
    gap: ca.SX
    gap_rate: ca.SX
    gap_acceleration: ca.SX
    multiplier: ca.SX
    multiplier_rate: ca.SX
    impulse_direction: ca.SX
    normal_inertia: ca.SX
    law: ImpactLaw
    energy: ca.SX
    input_power: ca.SX
    copper_loss: ca.SX
    other_loss: ca.SX
    holonomic: ca.SX
    motor_current: ca.SX
    motor_voltage: ca.SX
    mechanism: HybridLagrangian
    bare: HybridLagrangian
    stop_restitution: ca.SX
    drive: Drive
    belt_power: ca.SX = field(default_factory=lambda: ca.SX(2, 1))
    modes: ModeGraph | None = None
    is_built: bool = field(default=False, init=False, repr=False, compare=False)

    def as_built(self) -> CompletedSystem:
        """Return the system, marked as built."""
        object.__setattr__(self, "is_built", True)
        return self

    @cached_property
    def graph(self) -> ModeGraph:
        """All modes of the machine. A stop without a declared graph has the name `stop`."""
        from zeno_orbits.model.graph import graph_of_one_stop

        return self.modes or graph_of_one_stop(self)

    @property
    def restitution(self) -> ca.SX:
        """Coefficient of restitution of the slowest impacts."""
        return self.law.restitution

    @property
    def law_numbers(self) -> ca.SX:
        """The restitution of the slowest impacts, then numbers that tell laws apart."""
        return self.law.numbers

    @property
    def contact(self) -> ContactQuantities:
        """The five quantities by which a state flies, strikes, rests on its stop or leaves it."""
        return ContactQuantities(
            self.gap, self.gap_rate, self.gap_acceleration, self.multiplier, self.multiplier_rate
        )

    @property
    def clock(self) -> tuple[int, ...]:
        """Indices of the clock in the state, empty for a problem without a clock that turns."""
        if not isinstance(self.mechanism.clock, Clock):
            return ()
        first = 2 * self.n_q + self.drive.states.numel()
        return tuple(range(first, first + self.mechanism.clock.state.numel()))

    @property
    def has_time(self) -> bool:
        """True if a clock does not turn, so no motion repeats."""
        return isinstance(self.mechanism.clock, Time)

    @property
    def further(self) -> tuple[int, ...]:
        """Indices of the states of circuits and of further states, without currents of motors."""
        places: list[int] = []
        first = 2 * self.n_q
        for part in self.drive.parts:
            n = part.states.numel()
            places += range(first, first + n) if part.motors is None else ()
            first += n
        return tuple(places)


def completed(
    lagrangian: HybridLagrangian,
    drive: Part | Sequence[Part],
    restitution: ca.SX,
) -> CompletedSystem:
    r"""Return the completed system of a mechanism with one stop, as `complete` describes it.

    Args:
        lagrangian: The mechanism.
        drive: Drive or additional states, or a tuple of several.
        restitution: Coefficient of restitution of the gap, a formula of parameters and
            `impact_speed`.
    """
    drive = joined_auxiliary(lagrangian, drive)
    bare, stop_restitution = lagrangian, ca.SX(restitution)
    if drive.added_inertia.nnz():
        weighted = replace(lagrangian, mass_matrix=lagrangian.mass_matrix + drive.added_inertia)
        restitution = _corrected_restitution(lagrangian, weighted, stop_restitution)
        lagrangian = weighted
    q, v = lagrangian.q, lagrangian.v
    inverse_mass, free_acceleration = accelerate(lagrangian, drive.force)
    normal = ca.jacobian(lagrangian.gap, q).T
    response = ca.mtimes(inverse_mass, normal)
    # The absent stop of a machine without stops has no normal, and no impulse acts along it.
    normal_inertia = 1 / ca.dot(normal, response) if normal.nnz() else ca.SX(0)
    extra, extra_rate, off_circle = _appended(lagrangian, drive)
    state = ca.vertcat(q, v, extra)
    pressed, pressed_inertia, belt_power = response, normal_inertia, ca.SX(2, 1)
    slipping = free_acceleration
    stuck = stuck_motion(lagrangian, drive, inverse_mass, free_acceleration, extra, extra_rate)
    if stuck is not None:
        # Bounded friction gives no impulse: only forces meet the parts that stick.
        slipping, free_acceleration = free_acceleration, stuck.acceleration
        pressed = ca.mtimes(stuck.inverse_mass, normal)
        pressed_inertia = 1 / ca.dot(normal, pressed) if normal.nnz() else ca.SX(0)
    gap_rate = ca.dot(normal, v)
    gap_acceleration = ca.dot(normal, free_acceleration) + ca.jtimes(gap_rate, q, v)
    multiplier = -gap_acceleration * pressed_inertia
    law = ImpactLaw.of_formula(restitution)

    locked_acceleration = free_acceleration + multiplier * pressed
    if stuck is not None:
        every = (slipping, slipping + multiplier * response)
        belt_power = ca.vertcat(*(stuck.belt_power(one) for one in every))
    locked_flow = ca.vertcat(v, locked_acceleration, extra_rate)
    velocity_change = response * normal_inertia
    direction = ca.vertcat(ca.SX.zeros(q.numel()), velocity_change, ca.SX.zeros(extra.numel()))
    if drive.after_impact is not None:
        change = _state_change(lagrangian, drive, gap_rate, velocity_change, law)
        direction[2 * q.numel() : 2 * q.numel() + change.numel()] = change
        # A contact force is the limit of many small impacts, so it changes the same states.
        locked_flow[2 * q.numel() :] -= gap_acceleration * direction[2 * q.numel() :]
    eta_rate = ca.jtimes(lagrangian.holonomic, q, v)
    return CompletedSystem(
        n_q=q.numel(),
        state=state,
        free_flow=ca.vertcat(v, free_acceleration, extra_rate),
        locked_flow=locked_flow,
        gap=lagrangian.gap,
        gap_rate=gap_rate,
        gap_acceleration=gap_acceleration,
        multiplier=multiplier,
        multiplier_rate=ca.jtimes(multiplier, state, locked_flow),
        impulse_direction=direction,
        normal_inertia=normal_inertia,
        law=law,
        belt_power=belt_power,
        energy=lagrangian.kinetic + lagrangian.potential + drive.stored_energy,
        input_power=drive.input_power + ca.dot(lagrangian.applied_force, v),
        copper_loss=drive.copper_loss,
        other_loss=drive.other_loss - ca.dot(lagrangian.passive_force, v),
        holonomic=ca.vertcat(lagrangian.holonomic, eta_rate, off_circle),
        motor_current=drive.motor_current,
        motor_voltage=drive.motor_voltage,
        mechanism=lagrangian,
        bare=bare,
        stop_restitution=stop_restitution,
        drive=drive,
    )


def _appended(lagrangian: HybridLagrangian, drive: Drive) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the states after ``(q, v)``, their rates, and the deviation of the clock."""
    clock = lagrangian.clock
    if clock is None:
        return drive.states, drive.rates, ca.SX(0, 1)
    states = ca.vertcat(drive.states, clock.state)
    return states, ca.vertcat(drive.rates, clock.rate), clock.off_circle


def _state_change(
    lagrangian: HybridLagrangian,
    drive: Drive,
    gap_rate: ca.SX,
    velocity_change: ca.SX,
    law: ImpactLaw,
) -> ca.SX:
    r"""Return the change of additional states in an impulse, per change of the gap rate.

    The jump :math:`z^+ - z^-` must be the gap rate times its own derivative along the impulse, and
    that derivative must be the same for approach and separation, since contact is the limit of
    impacts. Both are tested at random values of the symbols, at which they cannot hold by accident.

    Raises:
        ValueError: If the jump does not have this form.
    """
    if drive.after_impact is None:
        return ca.SX(0, 1)
    jump = drive.after_impact - drive.states
    slope = ca.jtimes(jump, lagrangian.v, velocity_change)
    v = lagrangian.v
    mirrored = ca.substitute(slope, v, v - 2 * gap_rate * velocity_change)
    off = ca.veccat(jump - slope * gap_rate, slope - mirrored, jump, slope)
    n = 2 * jump.numel()
    for tried in values_near_one(off, [v]):
        size = float(np.max(np.abs(tried[n:])))
        if not np.max(np.abs(tried[:n])) <= max(_OF_STATES, _ROUNDING * size):
            raise ValueError(
                "Argument `after_impact` must change the states in proportion to the gap rate. "
                "An impact at zero speed then changes nothing."
            )
    return _of_any_speed(-slope / (1 + law.at(impact_speed)))


def _of_any_speed(change: ca.SX) -> ca.SX:
    """Return a formula that holds the speed of the impact, but does not depend on it.

    Raises:
        ValueError: If it does depend on the speed, as random values of the symbols show.
    """
    if not ca.depends_on(change, impact_speed):
        return change
    speeds = (0.1 * ca.SX.sym("slow"), 0.3 * ca.SX.sym("fast"))
    slow, fast = (ca.substitute(change, impact_speed, speed) for speed in speeds)
    for row in values_near_one(ca.veccat(fast - slow, slow)):
        off, size = np.max(np.abs(row.reshape(2, -1)), axis=1)
        if not off <= max(_OF_STATES, _ROUNDING * float(size)):
            raise ValueError(
                "Argument `after_impact` must change the states in proportion to 1 + e, since "
                "the restitution e depends on the speed of the impact."
            )
    return at_impact_speed(change, SLOWEST)


def _corrected_restitution(
    bare: HybridLagrangian, weighted: HybridLagrangian, restitution: ca.SX
) -> ca.SX:
    r"""Return the combined restitution of an impact and the subsequent current layer.

    .. math:: 1 + \tilde e = (1 + e)\,\frac{J \tilde W J^\top}{J W J^\top}

    with :math:`\tilde W` the inverse mass with the added inertia (theory (1.12)). A negative value
    is replaced by zero: the layer presses on the stop, and contact persists. It is NaN if the ratio
    is below a half or above two, since the correction is then invalid. So no impact uses an invalid
    value silently.

    Raises:
        ValueError: If the restitution depends on the state on the stop.
    """
    response = _normal_response(bare)
    ratio = _normal_response(weighted) / response
    if bare.holonomic.numel():
        # Closed stops may hold the stop, which is then not struck.
        is_held = response <= _HELD * _normal_response(replace(bare, holonomic=ca.SX(0, 1)))
        ratio = ca.if_else(is_held, 1, ratio)
    share = _on_stop(bare, ratio)
    if ca.depends_on(share, bare.q):
        raise ValueError(
            "Argument `drive` must leave the restitution constant on the stop, "
            "but its correction changes with the configuration."
        )
    corrected = (1 + restitution) * share - 1
    sound = ca.logic_and(share > 0.5, share < 2)
    return ca.if_else(sound, ca.fmax(corrected, 0), ca.SX(math.nan))


_HELD = 1e-12
"""Part of the response of a stop to its impulse that is rounding, if closed stops hold it."""


def _normal_response(lagrangian: HybridLagrangian) -> ca.SX:
    """Return the change of the gap rate for a unit impulse of the stop."""
    inverse_mass, _ = accelerate(lagrangian, ca.SX.zeros(lagrangian.q.numel()))
    normal = ca.jacobian(lagrangian.gap, lagrangian.q).T
    return ca.dot(normal, ca.mtimes(inverse_mass, normal))


def _on_stop(lagrangian: HybridLagrangian, expression: ca.SX) -> ca.SX:
    """Return an expression of the configuration on the stop, if a coordinate determines the gap."""
    for k in range(lagrangian.q.numel()):
        coordinate = lagrangian.q[k]
        slope = ca.jacobian(lagrangian.gap, coordinate)
        if slope.nnz() and not ca.depends_on(slope, lagrangian.q):
            rest = ca.substitute(lagrangian.gap, coordinate, ca.SX(0))
            return ca.simplify(ca.substitute(expression, coordinate, -rest / slope))
    return expression
