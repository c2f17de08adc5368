r"""Complete a mechanism and its drive: guard, reset map, multiplier, locked flow, Theorem 1.

Everything is an expression in the state ``x = (q, v, i)`` and the named parameters of the problem,
gains and restitution among them. Source: [OrAmes2011]_, paper eqs (5)-(8), theory (5)-(12).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import cast

import casadi as ca

from zeno_orbits.model.contact import ContactQuantities, ImpactLaw
from zeno_orbits.model.drives import Drive
from zeno_orbits.model.lagrangian import HybridLagrangian


@dataclass(frozen=True, slots=True, kw_only=True)
class CompletedSystem:
    r"""A completed hybrid system in symbols.

    Attributes:
        n_q: Any of coordinates.
        state: ``x = (q, v, i)``, the clock of a forced problem and any ledger states, ``(n_x,)``.
        free_flow: :math:`\dot x` off the stop, ``(n_x,)`` (theory (5)).
        locked_flow: :math:`\dot x` on the stop, ``(n_x,)`` (theory (8)).
        gap: :math:`h`.
        gap_rate: :math:`\dot h`.
        gap_acceleration: :math:`\ddot h` of the free flow, the quantity of Theorem 1.
        multiplier: :math:`\lambda` that keeps :math:`\ddot h = 0` on the stop.
        multiplier_rate: :math:`\dot\lambda` along the locked flow.
        impulse_direction: :math:`W J^\top / (J W J^\top)` as a change of state, ``(n_x,)``.
        normal_inertia: :math:`1 / (J W J^\top)`, the inertia that an impact feels.
        law: The law of an impact, its numbers in symbols.
        energy: Kinetic, potential and magnetic energy [J].
        input_power: Power delivered by the sources and by forces from outside [W].
        copper_loss: Power lost in the windings [W].
        other_loss: Power lost to passive forces and to unequal motor constants [W].
        holonomic: :math:`(\eta, \dot\eta)`, ``(2 n_eta,)``, and the clock's distance from its
            circle; zero on admissible states.
        motor_current: Current of every motor, a state or not, ``(n_M,)`` [A].
        motor_voltage: Voltage of every motor, ``(n_M,)`` [V].
        mechanism: What was completed, the inertia that a corrected drive adds included.
        drive: Its drive.
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
    drive: Drive

    @property
    def restitution(self) -> ca.SX:
        """Coefficient of restitution of the slowest impacts."""
        return self.law.restitution

    @property
    def law_numbers(self) -> ca.SX:
        """The numbers of the law of impact, the restitution first."""
        return cast("ca.SX", ca.vertcat(*self.law))

    @property
    def contact(self) -> ContactQuantities:
        """The five quantities by which a state flies, strikes, rests on its stop or leaves it."""
        return ContactQuantities(
            self.gap, self.gap_rate, self.gap_acceleration, self.multiplier, self.multiplier_rate
        )

    @property
    def clock(self) -> tuple[int, ...]:
        """Places of the clock in the state; none where nothing is forced."""
        if self.mechanism.clock is None:
            return ()
        first = 2 * self.n_q + self.drive.current.numel()
        return tuple(range(first, first + self.mechanism.clock.state.numel()))


def complete(lagrangian: HybridLagrangian, drive: Drive, restitution: ca.SX) -> CompletedSystem:
    r"""Build the completed hybrid system of a mechanism, its drive and its stop.

    With :math:`W` the inverse mass on the holonomic constraints (theory (6)) and
    :math:`J = \partial h / \partial q`:

    .. math:: \lambda = -\ddot h_\mathrm{free} / (J W J^\top),\qquad
        v^+ = v^- - (1 + e)\,\frac{J v^-}{J W J^\top}\,W J^\top

    Args:
        lagrangian: The mechanism.
        drive: Its drive.
        restitution: Coefficient of restitution :math:`e`, a symbol or a number in [0, 1).

    Returns:
        The completed system.

    Raises:
        ValueError: If a corrected drive would make the restitution change with the state.

    Source: [Moreau1988]_ for the impact law, theory (6)-(9), and (20) for a corrected drive.
    """
    if drive.added_inertia.nnz():
        weighted = replace(lagrangian, mass_matrix=lagrangian.mass_matrix + drive.added_inertia)
        restitution = _corrected_restitution(lagrangian, weighted, ca.SX(restitution))
        lagrangian = weighted
    q, v = lagrangian.q, lagrangian.v
    inverse_mass, free_acceleration = accelerate(lagrangian, drive.force)
    normal = ca.jacobian(lagrangian.gap, q).T
    response = ca.mtimes(inverse_mass, normal)
    normal_inertia = 1 / ca.dot(normal, response)
    gap_rate = ca.dot(normal, v)
    gap_acceleration = ca.dot(normal, free_acceleration) + ca.jtimes(gap_rate, q, v)
    multiplier = -gap_acceleration * normal_inertia

    extra, extra_rate, off_circle = _appended(lagrangian, drive)
    state = ca.vertcat(q, v, extra)
    locked_acceleration = free_acceleration + multiplier * response
    locked_flow = ca.vertcat(v, locked_acceleration, extra_rate)
    direction = ca.vertcat(
        ca.SX.zeros(q.numel()), response * normal_inertia, ca.SX.zeros(extra.numel())
    )
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
        law=ImpactLaw(ca.SX(restitution)),
        energy=lagrangian.kinetic + lagrangian.potential + drive.magnetic_energy,
        input_power=drive.input_power + ca.dot(lagrangian.applied_force, v),
        copper_loss=drive.copper_loss,
        other_loss=drive.conversion_loss - ca.dot(lagrangian.passive_force, v),
        holonomic=ca.vertcat(lagrangian.holonomic, eta_rate, off_circle),
        motor_current=drive.motor_current,
        motor_voltage=drive.motor_voltage,
        mechanism=lagrangian,
        drive=drive,
    )


def _appended(lagrangian: HybridLagrangian, drive: Drive) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the states beyond ``(q, v)``, their rates, and what is zero on the clock's circle."""
    clock = lagrangian.clock
    if clock is None:
        return drive.current, drive.current_rate, ca.SX(0, 1)
    states = ca.vertcat(drive.current, clock.state)
    return states, ca.vertcat(drive.current_rate, clock.rate), clock.off_circle


def audited(system: CompletedSystem) -> CompletedSystem:
    """Append the energy ledger to the state: work in, copper loss and other losses since the start.

    The three ledger states [J] drive nothing; an impact leaves them as they are.
    """
    return _with_ledger(system, 1.0)


@lru_cache(maxsize=16)
def audited_in(unit: float) -> Callable[[CompletedSystem], CompletedSystem]:
    """Return what `audited` does with a ledger in another unit, the same function for the same.

    Args:
        unit: Of energy [J]; a ledger in units of its size is followed to that.
    """
    return audited if unit == 1.0 else partial(_with_ledger, unit=unit)


def _with_ledger(system: CompletedSystem, unit: float) -> CompletedSystem:
    ledger = ca.SX.sym("ledger", 3)
    powers = ca.vertcat(system.input_power, system.copper_loss, system.other_loss) / unit
    return replace(
        system,
        state=ca.vertcat(system.state, ledger),
        free_flow=ca.vertcat(system.free_flow, powers),
        locked_flow=ca.vertcat(system.locked_flow, powers),
        impulse_direction=ca.vertcat(system.impulse_direction, ca.SX.zeros(3)),
    )


def accelerate(lagrangian: HybridLagrangian, force: ca.SX) -> tuple[ca.SX, ca.SX]:
    r"""Return the inverse mass on the holonomic constraints and the free acceleration.

    .. math:: W = M^{-1} - M^{-1} H^\top (H M^{-1} H^\top)^{-1} H M^{-1},\qquad
        a = W (F - \mathrm{bias}) - M^{-1} H^\top (H M^{-1} H^\top)^{-1} \dot H v

    with :math:`H = \partial\eta / \partial q` (theory (6)).
    """
    q, v, eta = lagrangian.q, lagrangian.v, lagrangian.holonomic
    inverse_mass = ca.inv(lagrangian.mass_matrix)
    net_force = force - lagrangian.bias
    if eta.numel() == 0:
        return inverse_mass, ca.mtimes(inverse_mass, net_force)
    jacobian = ca.jacobian(eta, q)
    response = ca.mtimes(inverse_mass, jacobian.T)
    gain = ca.mtimes(response, ca.inv(ca.mtimes(jacobian, response)))
    constrained = inverse_mass - ca.mtimes(gain, response.T)
    drift = ca.jtimes(ca.mtimes(jacobian, v), q, v)
    return constrained, ca.mtimes(constrained, net_force) - ca.mtimes(gain, drift)


def _corrected_restitution(
    bare: HybridLagrangian, weighted: HybridLagrangian, restitution: ca.SX
) -> ca.SX:
    r"""Return the restitution that an impact and the current layer behind it have together.

    .. math:: 1 + \tilde e = (1 + e)\,\frac{J \tilde W J^\top}{J W J^\top}

    with :math:`\tilde W` the inverse mass with the added inertia (theory (20)). Below zero it is
    zero: the layer presses on the stop, which holds. It is NaN where the ratio is no correction
    any more, below a half or above two, so that no impact passes silently.

    Raises:
        ValueError: If it changes with the state on the stop.
    """
    share = _on_stop(bare, _normal_response(weighted) / _normal_response(bare))
    if ca.depends_on(share, bare.q):
        raise ValueError(
            "Argument `drive` must leave the restitution constant on the stop, "
            "but its correction changes with the configuration."
        )
    corrected = (1 + restitution) * share - 1
    sound = ca.logic_and(ca.logic_and(share > 0.5, share < 2), corrected < 1)
    return ca.if_else(sound, ca.fmax(corrected, 0), ca.SX(math.nan))


def _normal_response(lagrangian: HybridLagrangian) -> ca.SX:
    """Return the change of the gap rate for a unit impulse of the stop."""
    inverse_mass, _ = accelerate(lagrangian, ca.SX.zeros(lagrangian.q.numel()))
    normal = ca.jacobian(lagrangian.gap, lagrangian.q).T
    return ca.dot(normal, ca.mtimes(inverse_mass, normal))


def _on_stop(lagrangian: HybridLagrangian, expression: ca.SX) -> ca.SX:
    """Return an expression of the configuration on the stop, where a coordinate tells the gap."""
    for k in range(lagrangian.q.numel()):
        coordinate = lagrangian.q[k]
        slope = ca.jacobian(lagrangian.gap, coordinate)
        if slope.nnz() and not ca.depends_on(slope, lagrangian.q):
            rest = ca.substitute(lagrangian.gap, coordinate, ca.SX(0))
            return ca.simplify(ca.substitute(expression, coordinate, -rest / slope))
    return expression
