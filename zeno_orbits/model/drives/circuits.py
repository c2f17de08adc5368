r"""Drives: the contributions of circuits and additional states to a mechanism, and circuit laws.

Every drive is a `Drive`: states with their rates, a generalized force and powers. A circuit is a
drive whose law follows from a field coenergy :math:`W(i, u, q)` (paper eq. 2, theory (1.10)). A
bank of DC motors is the circuit with :math:`W = i^\top L i / 2 + i^\top K S^\top q`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, cast

import casadi as ca

from zeno_orbits.model.drives.motors import MotorBank
from zeno_orbits.model.expressions.operations import expand_calls
from zeno_orbits.model.lagrangian import HybridLagrangian, require_symbols
from zeno_orbits.work import checked, require_kinds

Entries = tuple[tuple[str, ca.SX], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Circuit:
    r"""Inductors, capacitors, resistances and sources, with the energy of their fields.

    .. math:: \frac{d}{dt}\frac{\partial W}{\partial i} = V - R\,i + A\,u,\qquad
        \frac{d}{dt}\frac{\partial W}{\partial u} = -A^\top i - G\,u,\qquad
        F = \frac{\partial W}{\partial q}

    Attributes:
        currents: :math:`i`, symbols of the inductor currents, ``(n_i,)`` [A].
        coenergy: :math:`W(i, u, q)`, convex in the currents and voltages [J].
        resistance: :math:`R`, ``(n_i, n_i)`` [ohm].
        source: :math:`V`, a formula of ``q``, ``v``, ``i``, ``u``, further states, clock and gains,
            ``(n_i,)`` [V].
        voltages: :math:`u`, symbols of the capacitor voltages, ``(n_u,)`` [V], by default empty.
        conductance: :math:`G`, ``(n_u, n_u)`` [1/ohm], by default zero.
        incidence: :math:`A`, ``(n_i, n_u)``, the voltages in each loop, by default zero.
    """

    currents: ca.SX
    coenergy: ca.SX
    resistance: ca.SX
    source: ca.SX
    voltages: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    conductance: ca.SX | None = None
    incidence: ca.SX | None = None

    def __post_init__(self) -> None:
        """Reject entries that are not symbols, and matrices whose shapes do not fit."""
        require_kinds(self)
        expand_calls(self)
        n_i, n_u = self.currents.numel(), self.voltages.numel()
        require_symbols("currents", self.currents)
        require_symbols("voltages", self.voltages)
        if n_i + n_u == 0:
            wanted = "must hold the symbol of a current or a voltage"
            raise ValueError(f"Argument `currents` {wanted}, but it is empty.")
        if not self.coenergy.is_scalar():
            wanted = f"must be one energy, but its shape is {self.coenergy.shape}"
            raise ValueError(f"Argument `coenergy` {wanted}.")
        if self.source.numel() != n_i:
            raise ValueError(
                f"Argument `source` must have {n_i} entries, one per current, "
                f"but it has {self.source.numel()}."
            )
        shapes = {"resistance": (n_i, n_i), "conductance": (n_u, n_u), "incidence": (n_i, n_u)}
        for name, shape in shapes.items():
            given = getattr(self, name)
            matrix = ca.SX(*shape) if given is None else given
            if matrix.shape != shape:
                raise ValueError(
                    f"Argument `{name}` must be of shape {shape}, but it is {matrix.shape}."
                )
            object.__setattr__(self, name, matrix)


class Held(NamedTuple):
    """States that are set at an event, and are constant otherwise.

    Attributes:
        states: The states, ``(n,)``.
        at: The event.
        after: The states just after it, ``(n,)``.
    """

    states: ca.SX
    at: str
    after: ca.SX


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """States, a force and their powers that act on a mechanism in addition to its own forces.

    Attributes:
        states: Currents, voltages and additional states, ``(n,)``, empty at reduced fidelities.
        rates: Time derivatives of the states, ``(n,)``.
        force: Generalized force on the mechanism, ``(n_q,)``.
        input_power: Power that sources deliver [W].
        copper_loss: Power lost in resistances and conductances [W].
        other_loss: Other power lost [W]. It includes the loss of additional states, and the
            electrical minus the mechanical power of an air gap, which is zero if the torque and the
            back-EMF constants are equal.
        stored_energy: Energy of fields and additional states [J].
        motor_current: Current of every motor or inductor, a state or not, ``(n_M,)`` [A].
        motor_voltage: Source voltage of every motor or inductor, ``(n_M,)`` [V].
        added_inertia: Constant and symmetric addition to the mass matrix, ``(n_q, n_q)``, empty
            except for a corrected drive. The mechanism then also strikes its stop with that
            inertia, and `complete` corrects the restitution for it.
        after_impact: The states after an impact, ``(n,)``, or ``None`` if impacts do not change
            them.
        motors: The motors of a bank, or ``None`` for other drives.
        kinds: Required kind of unit of each state: ``current``, ``voltage`` or an empty text.
        inertia: Second derivatives of the coenergy, which must be positive definite. It is empty
            without a coenergy.
        entries: Arguments of the drive: names with their formulas.
        is_balanced: False if a force acts whose powers are not given.
        motion: Voltages induced by the motion in the loop of every motor or inductor, ``(n_M,)``
            [V].
        fed: Function from other source voltages, ``(n_M,)``, to the drive that they feed, or
            ``None`` for a drive without sources.
        joins: The drives that were combined, or empty for a single drive.
        holds: Those of its states that are set at events.
        frictions: Names of its parts with dry friction, ``(n_f,)``.
        sides: Sides of these parts, which are states, ``(n_f,)``.
        sliding: Their relative rates, ``(n_f,)``.
        torques: Their forces while they slip, ``(n_f,)``.
        static: Largest forces while they stick, ``(n_f,)``.
        sticks: 1 for a part that sticks, and else 0, ``(n_f,)``.
    """

    states: ca.SX
    rates: ca.SX
    force: ca.SX
    input_power: ca.SX
    copper_loss: ca.SX
    other_loss: ca.SX
    stored_energy: ca.SX
    motor_current: ca.SX
    motor_voltage: ca.SX
    added_inertia: ca.SX
    after_impact: ca.SX | None = None
    motors: MotorBank | None = None
    kinds: tuple[str, ...] = ()
    inertia: ca.SX = field(default_factory=lambda: ca.SX(0, 0))
    entries: Entries = ()
    is_balanced: bool = True
    motion: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    fed: Callable[[ca.SX], Drive] | None = None
    joins: tuple[Drive, ...] = ()
    holds: tuple[Held, ...] = ()
    frictions: tuple[str, ...] = ()
    sides: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    sliding: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    torques: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    static: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    sticks: ca.SX = field(default_factory=lambda: ca.SX(0, 1))

    @property
    def current(self) -> ca.SX:
        """The states, by the name that they had in version 0.2."""
        return self.states

    @property
    def parts(self) -> tuple[Drive, ...]:
        """The drives that it was made of, itself if it was made of none."""
        return self.joins or (self,)


class Field(NamedTuple):
    r"""The coenergy's derivatives, of which the law of a circuit is made.

    Attributes:
        currents: :math:`i`.
        voltages: :math:`u`.
        inertia: :math:`\partial^2 W / \partial(i, u)^2`: inductances and capacitances.
        motion: :math:`\partial^2 W / \partial(i, u)\,\partial q\;v`: voltages and currents that the
            motion induces.
        force: :math:`\partial W / \partial q`.
        stored_energy: :math:`i^\top \phi + u^\top Q - W`.
        conversion_loss: Electrical less mechanical power.
    """

    currents: ca.SX
    voltages: ca.SX
    inertia: ca.SX
    motion: ca.SX
    force: ca.SX
    stored_energy: ca.SX
    conversion_loss: ca.SX


class Network(NamedTuple):
    """The network that connects the fields of a circuit, as in `Circuit`."""

    resistance: ca.SX
    conductance: ca.SX
    incidence: ca.SX
    source: ca.SX


@checked
def circuit_drive(mechanism: HybridLagrangian, circuit: Circuit) -> Drive:
    r"""Return the drive of a circuit: currents, voltages and force (paper eq. 2, theory (1.10)).

    .. math:: \frac{\partial^2 W}{\partial x^2}\,\dot x
        = \begin{pmatrix} V - R\,i + A\,u \\ -A^\top i - G\,u \end{pmatrix}
        - \frac{\partial^2 W}{\partial x\,\partial q}\,v,\qquad x = (i, u)

    The stored energy is :math:`i^\top\phi + u^\top Q - W`, the input power :math:`V^\top i`, the
    loss :math:`i^\top R\,i + u^\top G\,u`.

    Args:
        mechanism: The mechanism.
        circuit: The circuit.

    Raises:
        ValueError: If the coenergy depends on velocities or time, or if it gives a current no
            flux or a voltage no charge that changes with it.
    """
    states = ca.vertcat(circuit.currents, circuit.voltages)
    coenergy = circuit.coenergy
    _require_coenergy(mechanism, circuit)
    momenta = ca.gradient(coenergy, states)
    fields = Field(
        currents=circuit.currents,
        voltages=circuit.voltages,
        inertia=ca.hessian(coenergy, states)[0],
        motion=ca.jtimes(momenta, mechanism.q, mechanism.v),
        force=ca.gradient(coenergy, mechanism.q),
        stored_energy=ca.dot(states, momenta) - coenergy,
        conversion_loss=ca.SX(0),
    )
    parts = {
        name: cast("ca.SX", getattr(circuit, name))
        for name in ("coenergy", "resistance", "conductance", "incidence", "source")
    }
    network = Network(*(parts[name] for name in Network._fields))
    return network_drive(fields, network, entries=tuple(parts.items()))


def network_drive(
    fields: Field,
    network: Network,
    *,
    is_algebraic: bool = False,
    motors: MotorBank | None = None,
    entries: Entries = (),
) -> Drive:
    """Return the drive of fields in a network: the common law of all circuits and motors.

    Args:
        fields: Derivatives of the coenergy.
        network: Network that connects the fields.
        is_algebraic: Whether the currents are algebraic variables and not states.
        motors: The motors, for a motor bank.
        entries: Arguments of the drive, for error messages.
    """

    def fed(source: ca.SX) -> Drive:
        return network_drive(
            fields,
            network._replace(source=source),
            is_algebraic=is_algebraic,
            motors=motors,
            entries=entries,
        )

    i, u = fields.currents, fields.voltages
    lost = ca.mtimes(network.resistance, i)
    states = rates = ca.SX(0, 1)
    if not is_algebraic:
        loop = network.source - lost + ca.mtimes(network.incidence, u)
        node = -ca.mtimes(network.incidence.T, i) - ca.mtimes(network.conductance, u)
        states = ca.vertcat(i, u)
        rates = ca.solve(fields.inertia, ca.vertcat(loop, node) - fields.motion)
    kinds = ("current",) * i.numel() + ("voltage",) * u.numel()
    return Drive(
        states=states,
        rates=rates,
        force=fields.force,
        input_power=ca.dot(network.source, i),
        copper_loss=ca.dot(i, lost) + ca.dot(u, ca.mtimes(network.conductance, u)),
        other_loss=fields.conversion_loss,
        stored_energy=ca.SX(0) if is_algebraic else fields.stored_energy,
        motor_current=i,
        motor_voltage=network.source,
        added_inertia=ca.SX(fields.force.numel(), fields.force.numel()),
        motors=motors,
        kinds=() if is_algebraic else kinds,
        inertia=ca.SX(0, 0) if is_algebraic else fields.inertia,
        entries=entries,
        motion=fields.motion[: i.numel()],
        fed=fed,
    )


def _require_coenergy(mechanism: HybridLagrangian, circuit: Circuit) -> None:
    """Refuse a coenergy of anything but currents, voltages and coordinates, and one without."""
    clock = ca.SX(0, 1) if mechanism.clock is None else mechanism.clock.state
    for others, what in ((mechanism.v, "the velocity"), (clock, "the clock")):
        if others.numel() and ca.depends_on(circuit.coenergy, others):
            wanted = "must depend on currents, voltages and coordinates only"
            raise ValueError(f"Argument `coenergy` {wanted}, but it depends on {what}.")
    states = ca.vertcat(circuit.currents, circuit.voltages)
    inertia = ca.hessian(circuit.coenergy, states)[0]
    for k in range(states.numel()):
        if inertia[k, :].is_zero():
            is_current = k < circuit.currents.numel()
            kind, stored = ("current", "flux") if is_current else ("voltage", "charge")
            raise ValueError(
                f"Argument `coenergy` must give every {kind} a {stored} that grows with it, "
                f"but `{states[k]}` lacks it."
            )
