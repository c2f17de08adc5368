"""Lagrangian mechanics in symbols: from energies to `M`, `C v + N`, the gap and its Jacobian.

Source: [MurrayLiSastry1994]_ for the Lagrangian form, theory (1.1) and (1.6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.model.clock import Clock, Time
from zeno_orbits.model.expressions.identities import values_near_one
from zeno_orbits.model.expressions.operations import without_calls
from zeno_orbits.model.stops import ABSENT, Stop
from zeno_orbits.work import checked

_ROUNDING, _ADDED = 1e-10, 1e-14
"""Rounding of a formula that vanishes, over its own size and over all formulas beside it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HybridLagrangian:
    r"""A mechanism with its stops: the tuple (Q, L, h) of [Ames2006]_, before any drive acts.

    The law is :math:`M(q)\,\dot v + \mathrm{bias}(q, v) = F`, with `F` the generalized force of the
    drives, on the admissible set :math:`h(q) \ge 0` (theory (1.1)).

    Attributes:
        q: Configuration symbols, ``(n_q,)``.
        v: Velocity symbols, ``(n_q,)``.
        mass_matrix: :math:`M(q)`, ``(n_q, n_q)``.
        bias: :math:`C(q, v)\,v + N(q)` minus the passive forces, ``(n_q,)``.
        gap: :math:`h(q)`, scalar. The stop is :math:`h = 0`. With ``stops`` it is the first gap.
            Without a stop it is the constant 1.
        potential: :math:`U(q)`, scalar [J].
        passive_force: Forces that depend on ``(q, v)`` alone, friction for instance, ``(n_q,)``.
        holonomic: :math:`\eta(q)`, ``(n_eta,)``. The motion satisfies :math:`\eta = 0` (paper eq.
            6).
        applied_force: External forces, as functions of ``(q, v)`` and the clock, ``(n_q,)``.
        clock: Clock or `Time` of the external forces, or ``None`` without forces that change with
            time.
        stops: The stops with names, each with its restitution, or empty.
    """

    q: ca.SX
    v: ca.SX
    mass_matrix: ca.SX
    bias: ca.SX
    gap: ca.SX
    potential: ca.SX
    passive_force: ca.SX
    holonomic: ca.SX
    applied_force: ca.SX
    clock: Clock | Time | None = None
    stops: tuple[Stop, ...] = ()

    @property
    def has_gap(self) -> bool:
        """True for one stop without a name, whose restitution belongs to the system."""
        return not (self.stops or self.gap.is_constant())

    @classmethod
    @checked
    def from_energies(
        cls,
        *,
        q: ca.SX,
        v: ca.SX,
        kinetic: ca.SX,
        potential: ca.SX,
        gap: ca.SX | None = None,
        passive_force: ca.SX | None = None,
        holonomic: ca.SX | None = None,
        applied_force: ca.SX | None = None,
        clock: Clock | Time | None = None,
        stops: Sequence[Stop] = (),
    ) -> HybridLagrangian:
        r"""Derive the equations of motion of :math:`L = T - U`.

        .. math:: M = \partial^2 T / \partial v^2,\qquad
            \mathrm{bias} = \partial_q (M v)\,v - \partial_q T + \partial_q U
            - F_\mathrm{passive} - F_\mathrm{applied}

        Args:
            q: Configuration symbols, ``(n_q,)``.
            v: Velocity symbols, ``(n_q,)``.
            kinetic: :math:`T(q, v)` [J], quadratic in ``v``.
            potential: :math:`U(q)` [J].
            gap: :math:`h(q)` of the one stop.
            passive_force: Friction and other forces of ``(q, v)``, ``(n_q,)``, by default absent.
            holonomic: :math:`\eta(q)`, ``(n_eta,)``, by default absent.
            applied_force: External forces, ``(n_q,)``, as functions of ``(q, v)`` and the clock, by
                default absent. Their work counts as input.
            clock: The clock whose states the forces hold, if they change with time.
            stops: Stops with names, in place of ``gap``. Without both, the mechanism moves freely.

        Returns:
            The mechanism.

        Raises:
            ValueError: If an energy, a gap or a constraint depends on a forbidden symbol, or if
                both ``gap`` and ``stops`` are given.
        """
        require_symbols("q", q)
        require_symbols("v", v)
        require_scalar("kinetic", kinetic)
        require_scalar("potential", potential)
        friction, applied = _column(passive_force, q.numel()), _column(applied_force, q.numel())
        eta = _column(holonomic, 0)
        # Calls are expanded before derivatives are taken: these would be other calls.
        kinetic, potential = without_calls(kinetic), without_calls(potential)
        gap = None if gap is None else without_calls(gap)
        mass_matrix = ca.hessian(kinetic, v)[0]
        _require_shapes(q, v=v, passive_force=friction, applied_force=applied)
        gaps = _gaps(gap, stops)
        of_positions = {"gap": ca.vertcat(ca.SX(0, 1), *gaps), "potential": potential}
        _require_timeless(clock, kinetic=kinetic, **of_positions, holonomic=eta)
        _require_still(v, **of_positions, holonomic=eta)
        _require_gaps(gaps, q)
        _require_quadratic(kinetic, v, mass_matrix)
        return cls(
            q=q,
            v=v,
            mass_matrix=mass_matrix,
            bias=_bias(q, v, mass_matrix, kinetic, potential, friction, applied),
            gap=gaps[0] if gaps else ABSENT.gap,
            potential=potential,
            passive_force=friction,
            holonomic=eta,
            applied_force=applied,
            clock=clock,
            stops=tuple(stops),
        )

    @classmethod
    @checked
    def from_matrices(
        cls,
        *,
        q: ca.SX,
        v: ca.SX,
        mass_matrix: ca.SX,
        coriolis: ca.SX,
        gravity: ca.SX,
        gap: ca.SX | None = None,
        potential: ca.SX | None = None,
        holonomic: ca.SX | None = None,
        applied_force: ca.SX | None = None,
        clock: Clock | Time | None = None,
        stops: Sequence[Stop] = (),
    ) -> HybridLagrangian:
        r"""Use the matrices of :math:`M(q)\,\dot v + C(q, v)\,v + N(q, v) = F` as given.

        The part of `N` that is not the gradient of the potential counts as a passive force. If a
        potential is given, this part must vanish at rest. Otherwise the energy balance, in which
        every passive force is a loss, would also hold for a wrong potential.

        Args:
            q: Configuration symbols, ``(n_q,)``.
            v: Velocity symbols, ``(n_q,)``.
            mass_matrix: :math:`M(q)`, symmetric, ``(n_q, n_q)``.
            coriolis: :math:`C(q, v)`, ``(n_q, n_q)``, with :math:`v^\top(\dot M - 2C)v = 0`.
            gravity: :math:`N(q, v)`: weights, springs and friction, on the left side, ``(n_q,)``.
            gap: :math:`h(q)`.
            potential: :math:`U(q)` [J], for the energy balance, by default zero.
            holonomic: As for `from_energies`.
            applied_force: As for `from_energies`.
            clock: As for `from_energies`.
            stops: As for `from_energies`.

        Returns:
            The mechanism.

        Raises:
            ValueError: If a shape does not fit, the mass matrix is not symmetric, the Coriolis
                matrix belongs to another mass matrix, or the potential belongs to another force.
        """
        require_symbols("q", q)
        require_symbols("v", v)
        # Calls are expanded before derivatives are taken: these would be other calls.
        mass_matrix, coriolis = without_calls(mass_matrix), without_calls(coriolis)
        gravity = without_calls(gravity)
        potential = None if potential is None else without_calls(potential)
        _require_square(q.numel(), mass_matrix=mass_matrix, coriolis=coriolis)
        _require_still(v, mass_matrix=mass_matrix)
        energy = ca.SX(0) if potential is None else potential
        require_scalar("potential", energy)
        _require_shapes(q, v=v, gravity=gravity)
        _require_inertia("mass_matrix", mass_matrix)
        _require_symmetric(mass_matrix)
        _require_power_of_none(mass_matrix, coriolis, q, v)
        if potential is not None:
            _require_potential(ca.vec(gravity), ca.gradient(potential, q), v)
        derived = cls.from_energies(
            q=q,
            v=v,
            kinetic=ca.dot(v, ca.mtimes(mass_matrix, v)) / 2,
            potential=energy,
            gap=gap,
            passive_force=ca.gradient(energy, q) - ca.vec(gravity),
            holonomic=holonomic,
            applied_force=applied_force,
            clock=clock,
            stops=stops,
        )
        bias = ca.mtimes(coriolis, v) + ca.vec(gravity) - derived.applied_force
        return replace(derived, mass_matrix=mass_matrix, bias=bias)

    @property
    def kinetic(self) -> ca.SX:
        r"""Kinetic energy :math:`\tfrac12 v^\top M v` [J]."""
        return ca.dot(self.v, ca.mtimes(self.mass_matrix, self.v)) / 2


def require_symbols(name: str, states: ca.SX) -> None:
    """Refuse states that are formulas, or two that are one symbol.

    Args:
        name: Argument that holds them.
        states: The states.
    """
    seen = set[int]()
    for k in range(states.numel()):
        entry: Any = states[k]
        if not entry.is_symbolic() or entry.element_hash() in seen:
            what = "the same symbol twice" if entry.is_symbolic() else f"`{entry}`"
            raise ValueError(f"Argument `{name}` must hold symbols, but it holds {what}.")
        seen.add(entry.element_hash())


def require_separate(states: ca.SX, mechanism: HybridLagrangian) -> None:
    """Refuse further states of which one belongs to the mechanism or its clock.

    Args:
        states: The states.
        mechanism: The mechanism.
    """
    clock = ca.SX(0, 1) if mechanism.clock is None else mechanism.clock.state
    own = {"a coordinate": mechanism.q, "a velocity": mechanism.v, "the clock": clock}
    for what, symbols in own.items():
        if symbols.numel() and ca.depends_on(states, symbols):
            wanted = f"must hold separate symbols, but one is {what} of the mechanism"
            raise ValueError(f"Argument `states` {wanted}.")


def require_scalar(name: str, formula: ca.SX) -> None:
    """Refuse a matrix in place of one formula.

    Args:
        name: Argument that holds it.
        formula: The formula.
    """
    if not formula.is_scalar():
        wanted = f"must be one number or formula, but its shape is {formula.shape}"
        raise ValueError(f"Argument `{name}` {wanted}.")


def _column(given: ca.SX | None, n: int) -> ca.SX:
    """Return a column without calls, of ``n`` zeros if it is absent."""
    return ca.SX.zeros(n) if given is None else without_calls(ca.vec(given))


def _bias(
    q: ca.SX, v: ca.SX, mass: ca.SX, kinetic: ca.SX, potential: ca.SX, *forces: ca.SX
) -> ca.SX:
    r"""Return :math:`\partial_q (M v)\,v - \partial_q T + \partial_q U - F`, ``(n_q,)``."""
    inertial = ca.jtimes(ca.mtimes(mass, v), q, v) - ca.gradient(kinetic, q)
    bias = inertial + ca.gradient(potential, q)
    for force in forces:
        bias -= force
    return bias


def _require_gaps(gaps: Sequence[ca.SX], q: ca.SX) -> None:
    """Refuse a constant gap.

    Raises:
        ValueError: If one does not depend on the configuration.
    """
    if not all(ca.depends_on(one, q) for one in gaps):
        raise ValueError(
            "Argument `gap` must depend on the configuration, but it is constant. Write it with "
            "`q`."
        )


def _require_square(n_q: int, **matrices: ca.SX) -> None:
    """Refuse a matrix that does not have a row and a column per coordinate.

    Raises:
        ValueError: If there is one. The message names it.
    """
    for name, matrix in matrices.items():
        if matrix.shape != (n_q, n_q):
            wanted = f"must be of shape ({n_q}, {n_q})"
            raise ValueError(f"Argument `{name}` {wanted}, but it is {matrix.shape}.")


def _require_still(v: ca.SX, **expressions: ca.SX) -> None:
    for name, expression in expressions.items():
        if ca.depends_on(expression, v):
            wanted = (
                "must depend on the configuration only, but it depends on the velocity. Remove `v`"
            )
            raise ValueError(f"Argument `{name}` {wanted}.")


def _require_quadratic(kinetic: ca.SX, v: ca.SX, mass_matrix: ca.SX) -> None:
    rest = ca.vertcat(kinetic, ca.gradient(kinetic, v))
    rest = ca.substitute(rest, v, ca.SX.zeros(*v.shape))
    names = {v[k].name() for k in range(v.numel())}
    strangers = {one.name() for one in ca.symvar(ca.substitute(kinetic, v, ca.SX.zeros(*v.shape)))}
    if names & strangers:
        word = sorted(names & strangers)[0]
        told = f"must use the symbol `{word}` of `v`, but it holds another symbol of this name"
        raise ValueError(f"Argument `kinetic` {told}. Make each symbol once.")
    if ca.depends_on(mass_matrix, v) or not rest.is_zero():
        raise ValueError("Argument `kinetic` must be quadratic in the velocity, as `m * v**2 / 2`.")
    _require_inertia("kinetic", mass_matrix)


def _gaps(gap: ca.SX | None, stops: Sequence[Stop]) -> tuple[ca.SX, ...]:
    """Return the gaps of a mechanism.

    Raises:
        ValueError: If both arguments are given.
    """
    if gap is not None and stops:
        raise ValueError("Give either the argument `gap` or the argument `stops`, not both.")
    for stop in stops:
        if not ca.SX(stop.gap).is_scalar():
            shape = ca.SX(stop.gap).shape
            raise ValueError(
                f"Argument `gap` of the stop `{stop.name}` must be one formula, but its shape is "
                f"{shape}."
            )
    if gap is not None and not gap.is_scalar():
        raise ValueError(
            f"Argument `gap` must be one formula, but its shape is {gap.shape}. Declare several "
            "stops with `stops`."
        )
    return (gap,) if gap is not None else tuple(ca.SX(stop.gap) for stop in stops)


def _require_shapes(q: ca.SX, **vectors: ca.SX) -> None:
    for name, vector in vectors.items():
        if vector.numel() != q.numel():
            message = (
                f"Argument `{name}` must have {q.numel()} entries, one per coordinate, "
                f"but it has {vector.numel()}."
            )
            raise ValueError(message)


def _require_timeless(clock: Clock | Time | None, **expressions: ca.SX) -> None:
    """Reject time dependence of expressions that are derived as time independent."""
    for name, expression in expressions.items():
        if clock is not None and ca.depends_on(expression, clock.state):
            wanted = "must not depend on the clock: use coordinates relative to the moving frame"
            raise ValueError(f"Argument `{name}` {wanted}, and an `applied_force`.")


def _require_inertia(name: str, mass_matrix: ca.SX) -> None:
    """Refuse a coordinate that no mass moves with."""
    for k in range(mass_matrix.shape[0]):
        if mass_matrix[k, :].is_zero():
            wanted = "must give every coordinate an inertia (a mass matrix that is not singular)"
            raise ValueError(f"Argument `{name}` {wanted}, but coordinate {k + 1} lacks it.")


def _require_potential(gravity: ca.SX, gradient: ca.SX, v: ca.SX) -> None:
    """Refuse a potential whose gradient is not the force at rest, at random values near 1.

    Each coordinate has its own unit, so each is compared with its own size.
    """
    still = ca.substitute(ca.horzcat(gravity, gradient), v, ca.SX.zeros(v.numel()))
    for row in values_near_one(still):
        force, slope = row.reshape(2, -1)
        left, sizes = np.abs(force - slope), np.max(np.abs([force, slope]), axis=0)
        over = left - _ROUNDING * sizes - _ADDED * float(np.max(sizes))
        k = int(np.argmax(over))
        if over[k] > 0.0:
            raise ValueError(
                "Argument `potential` must have the gradient that `gravity` is at rest, but "
                f"coordinate {k + 1} differs by {left[k]:.3g}: {force[k]:.9g} and {slope[k]:.9g}, "
                "with about 1 for every symbol."
            )


def _require_symmetric(mass_matrix: ca.SX) -> None:
    """Refuse a mass matrix that is not symmetric, each entry over the masses of its coordinates."""
    unit = 1 / ca.sqrt(ca.diag(mass_matrix))
    off = (mass_matrix - mass_matrix.T) * ca.mtimes(unit, unit.T)
    _require_zero("mass_matrix", "symmetric", ca.vec(off), ca.SX(1.0), _ROUNDING)


def _require_power_of_none(mass_matrix: ca.SX, coriolis: ca.SX, q: ca.SX, v: ca.SX) -> None:
    """Refuse a Coriolis matrix whose force has another power than the change of inertia.

    All velocities have about one kinetic energy, so that the unit of none hides that of another.
    """
    equal = v / ca.sqrt(ca.diag(mass_matrix))
    rate = ca.reshape(ca.jtimes(ca.vec(mass_matrix), q, v), mass_matrix.shape)
    off = ca.bilin(rate - 2 * coriolis, v, v)
    if off.is_zero():
        return
    size = ca.bilin(ca.fabs(rate) + 2 * ca.fabs(coriolis), ca.fabs(v), ca.fabs(v))
    least = ca.bilin(ca.fabs(mass_matrix), ca.fabs(v), ca.fabs(v)) * ca.norm_1(v)
    both = ca.substitute(ca.vertcat(off, size + _ADDED / _ROUNDING * least), v, equal)
    wanted = "consistent with the mass matrix, v'(dM/dt - 2C)v = 0"
    _require_zero("coriolis", wanted, both[0], both[1], _ROUNDING)


def _require_zero(name: str, wanted: str, off: ca.SX, size: ca.SX, rounding: float) -> None:
    """Refuse what does not vanish beside a size, by its form or at random values (`identities`)."""
    if off.is_zero():
        return
    for row in values_near_one(ca.vertcat(off, size)):
        if float(np.max(np.abs(row[:-1]))) > rounding * float(row[-1]):
            raise ValueError(f"Argument `{name}` is not {wanted}.")


def accelerate(lagrangian: HybridLagrangian, force: ca.SX) -> tuple[ca.SX, ca.SX]:
    r"""Return the inverse mass on the holonomic constraints and the free acceleration.

    .. math:: W = M^{-1} - M^{-1} H^\top (H M^{-1} H^\top)^{-1} H M^{-1},\qquad
        a = W (F - \mathrm{bias}) - M^{-1} H^\top (H M^{-1} H^\top)^{-1} \dot H v

    with :math:`H = \partial\eta / \partial q` (theory (1.6)).
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
