r"""Functions of a machine: a flow for every set of touched stops and every branch of its kinks.

The state is the problem's state ``(q, v, i)`` and clock, then the angle and rate of every rotor
driven through a gear, then the side of every part of the rig with dry friction. In place of the
restitution, each stop has a contact force along :math:`\nabla h` (theory (6.1)). The other parts of
a rig are forces and voltages (theory (6.3), (6.4)). Contacts are smooth, so only a declared switch
resets the state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.experiment.rig.dry_friction import (
    GUARDS_PER_PART,
    DryParts,
    HeldFlow,
    held_motion,
)
from zeno_orbits.experiment.rig.forces import (
    averaged_voltage,
    contact_force,
    inductive_current,
    teeth_torque,
)
from zeno_orbits.model import (
    CharacteristicScales,
    CompletedSystem,
    Drive,
    ModeFunctions,
    ModeGraph,
    Problem,
    PwmSettings,
    Rig,
    accelerate,
    dense_function,
    mode_functions,
    system_of_stop,
)

_Mode = tuple[tuple[int, ...], tuple[bool, ...], int, bool]
"""Touched stops, sides of the kinks, guard, and for a switch the sign of its guard."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Machine:
    """The functions of a machine in ``(y, P)``, with ``P = (p, held voltages, damping factors)``.

    Attributes:
        state_names: Name of each entry of ``y``, first the states of the problem.
        n_x: Number of the problem's states.
        n_q: Number of coordinates.
        n_motors: Number of motors.
        sensed: Index of the current's state of each motor, or -1 if the current is no state.
        stop_names: Name of each stop.
        holds: Whether the voltages are held between updates instead of following the feedback
            continuously.
        observe: ``(y, P) -> (contact forces, gaps, gap rates, normal inertias)``, each of all
            stops.
        motors: ``(y, P) -> (currents, terminal voltages)``, each ``(n_motors,)``.
        command: ``(x measured, p) -> voltages`` commanded by the feedback.
        rest: ``(x, p) -> y`` with every rotor in the middle of its backlash and turning with its
            joint, and the sides of the rig's dry friction at zero.
        dry_names: Name of each part with dry friction.
        dry_sides: Index of the side of each in ``y``.
        inertia: ``(x, p) -> M`` without the parts on the motor side of gears, ``(n_q, n_q)``.
    """

    state_names: tuple[str, ...]
    n_x: int
    n_q: int
    n_motors: int
    sensed: tuple[int, ...]
    stop_names: tuple[str, ...]
    holds: bool
    observe: ca.Function
    motors: ca.Function
    command: ca.Function
    rest: ca.Function
    inertia: ca.Function
    dry_names: tuple[str, ...]
    dry_sides: tuple[int, ...]
    _branch: Callable[[tuple[bool, ...], tuple[int, ...]], _Parts] = field(repr=False)
    _graph: ModeGraph = field(repr=False)
    _branches: dict[tuple[tuple[bool, ...], tuple[int, ...]], _Parts] = field(
        default_factory=dict["tuple[tuple[bool, ...], tuple[int, ...]]", "_Parts"], repr=False
    )
    _modes: dict[_Mode, ModeFunctions] = field(
        default_factory=dict["_Mode", "ModeFunctions"], repr=False
    )

    _loads: dict[tuple[tuple[bool, ...], tuple[int, ...]], ca.Function] = field(
        default_factory=dict["tuple[tuple[bool, ...], tuple[int, ...]]", "ca.Function"], repr=False
    )

    @property
    def n_watched(self) -> int:
        """Number of gaps among the guards: of a machine without stops it is 1."""
        return self._graph.n_watched

    @property
    def first_dry(self) -> int:
        """Index of the first guard of dry friction, after all stops and switches."""
        return self.n_watched + len(self._graph.switch_names)

    def load(self, touched: tuple[int, ...], sides: tuple[bool, ...]) -> ca.Function:
        """Return ``(y, P) ->`` what decides which parts with dry friction slip: a `DryLoad`.

        Args:
            touched: Indices of the touched stops.
            sides: Side of every kink.
        """
        if (sides, touched) not in self._loads:
            parts = self._parts(touched, sides)
            given = [parts.state, parts.numbers]
            self._loads[sides, touched] = dense_function("dry", given, [parts.stuck(touched).load])
        return self._loads[sides, touched]

    def _parts(self, touched: tuple[int, ...], sides: tuple[bool, ...]) -> _Parts:
        if (sides, touched) not in self._branches:
            self._branches[sides, touched] = self._branch(sides, touched)
        return self._branches[sides, touched]

    def mode(
        self,
        touched: Sequence[int] = (),
        sides: Sequence[bool] = (),
        guard: int = 0,
        *,
        above: bool = True,
    ) -> ModeFunctions:
        """Return the flow of a mode with a guard: the gap of an open stop, or the penetration.

        Args:
            touched: Indices of the touched stops.
            sides: Side of every kink, True where its condition is positive.
            guard: Index of the stop, or of a switch after all stops, or of a guard of dry friction
                after these.
            above: True for the guard of a switch, False for its negative.
        """
        key = (tuple(touched), tuple(sides), guard, above)
        if key not in self._modes:
            self._modes[key] = self._built(*key)
        return self._modes[key]

    def _built(
        self, touched: tuple[int, ...], sides: tuple[bool, ...], guard: int, above: bool
    ) -> ModeFunctions:
        parts = self._parts(touched, sides)
        rate = parts.rate(touched)
        if guard < self.n_watched:
            sign = -1 if guard in touched else 1
            watched = sign * ca.vertcat(parts.gaps[guard], parts.gap_rates[guard])
            return mode_functions("machine", parts.state, parts.numbers, rate, watched)
        if guard < self.first_dry:
            value = self._graph.guard(sides, guard - self.n_watched)
        else:
            value = parts.dry_guard(touched, *divmod(guard - self.first_dry, GUARDS_PER_PART))
        value = value if above else -value
        slope = ca.jtimes(value, parts.state, rate)
        watched = ca.vertcat(value, slope, ca.jtimes(slope, parts.state, rate))
        return mode_functions(
            "machine", parts.state, parts.numbers, rate, watched[:2], watched=watched
        )

    def weights(self, own: CharacteristicScales, rates: float = 1.0) -> tuple[float, ...]:
        """Return the scales of the absolute local errors. The scale of a rotor angle is one radian.

        Args:
            own: Characteristic scales of the problem.
            rates: Additional factor of the velocity scales.
        """
        n_added = sum(k >= self.n_x for k in self.dry_sides)
        n_rotors = (len(self.state_names) - self.n_x - n_added) // 2
        rotor = (1 / own.least, 1 / (own.time * own.least))
        states = np.array(own.weights(self.n_x))
        states[self.n_q : 2 * self.n_q] *= rates
        return (*states.tolist(), *(n_rotors * rotor), *(n_added * (1 / own.least,)))


@lru_cache(maxsize=16)
def machine(problem: Problem, rig: Rig) -> Machine:
    """Build the functions of a problem's machine, once for the same parts.

    Args:
        problem: The problem.
        rig: Parts of the machine.

    Raises:
        InputError: If the problem does not support a part of the rig.
    """
    symbols = problem.symbols()
    system = problem.model(symbols)
    require_place(problem, system, rig)
    p = ca.vertcat(*symbols.values())
    graph = system.graph

    dry = DryParts.of(system, problem.state_names[: system.n_q], rig)

    def branch(sides: tuple[bool, ...], touched: tuple[int, ...]) -> _Parts:
        one = system_of_stop(graph, ((), sides), 0, touched)
        return _Parts(problem, one, graph, rig, p, dry.of_drive(one.drive))

    parts = _Parts(problem, system, graph, rig, p, dry)

    def function(name: str, *outputs: ca.SX) -> ca.Function:
        return dense_function(name, [parts.state, parts.numbers], list(outputs))

    parts.dry.require_free(system)
    seen = ca.vertcat(parts.forces, parts.gaps, parts.gap_rates, parts.normal_inertias)
    return Machine(
        state_names=(*problem.state_names, *parts.rotor_names, *parts.dry.added_names),
        n_x=system.state.numel(),
        n_q=system.n_q,
        n_motors=parts.held.numel(),
        sensed=_current_states(system),
        stop_names=tuple(one.name for one in graph.stops),
        holds=parts.holds,
        observe=function("observe", seen),
        motors=function("motors", parts.current, parts.terminal),
        command=dense_function("command", [system.state, p], [system.motor_voltage]),
        rest=dense_function("rest", [system.state, p], [parts.rest]),
        inertia=dense_function("inertia", [system.state, p], [parts.inertia]),
        dry_names=parts.dry.names,
        dry_sides=_places(parts.dry.sides, parts.state),
        _branch=branch,
        _graph=graph,
    )


def _places(symbols: ca.SX, state: ca.SX) -> tuple[int, ...]:
    """Return the indices of symbols in a state."""
    states = ca.vertsplit(state)
    return tuple(
        k
        for one in (symbols[j] for j in range(symbols.numel()))
        for k, x in enumerate(states)
        if ca.is_equal(one, x)
    )


def _current_states(system: CompletedSystem) -> tuple[int, ...]:
    """Return the index of each motor's current in the state, or -1 if it is not a state."""
    states = ca.vertsplit(system.state)
    found: list[int] = []
    for current in ca.vertsplit(system.motor_current):
        equal = [k for k, state in enumerate(states) if ca.is_equal(state, current)]
        found.append(equal[0] if equal else -1)
    return tuple(found)


def require_place(problem: Problem, system: CompletedSystem, rig: Rig) -> None:
    """Reject parts that a problem does not support.

    Args:
        problem: The problem.
        system: Its completed system.
        rig: The parts.

    Raises:
        InputError: If the problem does not support a part. The message names the part.
    """
    drive, coordinates = system.drive, problem.state_names[: system.n_q]
    n_motors = system.motor_voltage.numel()
    if drive.added_inertia.nnz():
        wanted = "must have its currents as states, or none at all, for a rig"
        raise InputError(f"Argument `problem` {wanted}, but `{problem.name}` corrects for them.")
    for name in rig.friction:
        if name not in coordinates:
            known = ", ".join(coordinates)
            raise InputError(
                f"Argument `friction` must name one of {known}, but it names `{name}`."
            )
    for motor in rig.gears:
        _coupling(system, motor)
    moved = system.graph.switches
    if rig.gears and any(one.q_after is not None or one.v_after is not None for one in moved):
        wanted = "must be left out of a machine whose switches change coordinates or velocities"
        raise InputError(f"Argument `gears` {wanted}.")
    if n_motors == 0 and (rig.bridge is not None or rig.controller is not None):
        message = f"must have motors for a bridge or a controller, but `{problem.name}` lacks them"
        raise InputError(f"Argument `problem` {message}.")
    if rig.bridge is not None and system.motor_voltage.is_zero():
        wanted = "must have a voltage source for a bridge"
        raise InputError(f"Argument `problem` {wanted}, but `{problem.name}` lacks it.")
    if rig.bridge is not None and drive.states.numel() == 0:
        message = "must have its currents as states for a bridge, but they follow at once in"
        raise InputError(f"Argument `problem` {message} `{problem.name}`.")


class _Coupling(NamedTuple):
    """How the rotor of a motor is coupled to its joint and to the loops of the circuit.

    Attributes:
        axis: Angle of the joint per coordinate, ``(n_q,)``.
        emf: Voltages in all loops per rate of the rotor, ``(n_M,)``.
        torque: Torque on the rotor per current of each loop, ``(n_M,)``.
    """

    axis: ca.SX
    emf: ca.SX
    torque: ca.SX


def _coupling(system: CompletedSystem, motor: int) -> _Coupling:
    """Return the coupling of a motor.

    Each motor of a motor bank has its own axis. The current of a circuit loop drives a motor if its
    flux is linear in one coordinate. The axis is that coordinate.

    Args:
        system: The completed system of the problem.
        motor: Index of the motor, from 1.

    Raises:
        InputError: If the current drives no motor.
    """
    n_motors = system.motor_voltage.numel()
    if not 1 <= motor <= n_motors:
        known = f"must number one of {n_motors} motors"
        raise InputError(f"Argument `gears` {known}, but it has the number {motor}.")
    loops = [(part, k) for part in system.drive.parts for k in range(part.motor_voltage.numel())]
    part, own = loops[motor - 1]
    first, n = motor - 1 - own, part.motor_voltage.numel()
    emf, torque = ca.SX.zeros(n_motors), ca.SX.zeros(n_motors)
    if part.motors is not None:
        emf[first : first + n] = part.motors.emf_constant[:, own]
        torque[first : first + n] = part.motors.torque_constant[own, :].T
        return _Coupling(part.motors.selection[:, own], emf, torque)
    mechanism = system.mechanism
    rates = ca.jacobian(part.motion[own], mechanism.v)
    turned = [j for j in range(rates.numel()) if not rates[j].is_zero()]
    if len(turned) != 1 or ca.depends_on(rates, system.state):
        wanted = f"must stand on a motor: the flux of current {motor} must grow with one coordinate"
        raise InputError(f"Argument `gears` {wanted} at a constant rate.")
    emf[motor - 1] = torque[motor - 1] = rates[turned[0]]
    axis = ca.SX.zeros(mechanism.q.numel())
    axis[turned[0]] = 1
    return _Coupling(axis, emf, torque)


class _Motion(NamedTuple):
    """A motion without the forces of parts that stick.

    Attributes:
        inverse_mass: Inverse mass on the constraints, ``(n_q, n_q)``.
        acceleration: Acceleration, ``(n_q,)``.
        further: Rates of the states of the drive, of the clock and of every rotor.
    """

    inverse_mass: ca.SX
    acceleration: ca.SX
    further: tuple[ca.SX, ...]


class _Parts:
    """Expressions of a machine, built from the expressions of its problem."""

    def __init__(
        self,
        problem: Problem,
        system: CompletedSystem,
        graph: ModeGraph,
        rig: Rig,
        p: ca.SX,
        dry: DryParts,
    ) -> None:
        self._system, self._rig, self._mechanism = system, rig, system.mechanism
        self._coordinates = problem.state_names[: system.n_q]
        n_motors = system.motor_voltage.numel()
        stops = _one_by_one(graph)
        self.gaps = ca.vertcat(*(one.gap for one in stops))
        self.gap_rates = ca.vertcat(*(one.gap_rate for one in stops))
        self.normal_inertias = ca.vertcat(*(one.normal_inertia for one in stops))
        self.held = ca.SX.sym("held", n_motors)
        damping = ca.SX.sym("damping", len(stops))
        self.numbers = ca.vertcat(p, self.held, damping)
        self.forces = ca.vertcat(
            *(
                contact_force(rig.contact, damping[k], -one.gap, -one.gap_rate)
                for k, one in enumerate(stops)
            )
        )
        self._exact = rig.bridge is not None and rig.bridge.switching is PwmSettings.EXACT
        self.holds = n_motors > 0 and (rig.controller is not None or self._exact)
        self._rotors = {motor: ca.SX.sym(f"rotor{motor}", 2) for motor in sorted(rig.gears)}
        self._couplings = {motor: _coupling(system, motor) for motor in self._rotors}
        self.rotor_names = [f"{d}rotor{motor}" for motor in self._rotors for d in ("", "d")]
        self.dry = dry
        self.state = ca.vertcat(system.state, *self._rotors.values(), dry.added)
        joints = [self._joint(motor) for motor in self._rotors]
        self.rest = ca.vertcat(system.state, *joints, ca.SX.zeros(dry.added.numel()))
        self.inertia = self._inertia()
        driven, slip = self._voltage(), self._slip_emf()
        self.current = self._fed(driven - slip).motor_current
        drop = 0.0 if rig.bridge is None else rig.bridge.resistance
        self.terminal = driven - drop * bridged(system) * self.current
        self._drive = self._fed(self.terminal - slip)

    def rate(self, touched: Sequence[int]) -> ca.SX:
        """Return the time derivative of the state under the forces of the touched stops."""
        motion = self._motion(touched)
        acceleration = self.stuck(touched).acceleration if self.dry.names else motion.acceleration
        sides = ca.SX.zeros(self.dry.added.numel())
        return ca.vertcat(self._mechanism.v, acceleration, *motion.further, sides)

    def stuck(self, touched: Sequence[int]) -> HeldFlow:
        """Return the motion with the parts that stick held."""
        q, v = self._mechanism.q, self._mechanism.v
        motion = self._motion(touched)
        others = ca.vertcat(
            q, self.state[2 * q.numel() : self.state.numel() - self.dry.added.numel()]
        )
        drift = ca.jtimes(self.dry.rates, others, ca.vertcat(v, *motion.further))
        return held_motion(self.dry, v, motion.inverse_mass, motion.acceleration, drift)

    def dry_guard(self, touched: Sequence[int], part: int, kind: int) -> ca.SX:
        """Return a guard of a part: its rate, or what is left to slip up or down."""
        if kind == 0:
            return self.dry.rates[part]
        sign = 1 if kind == 1 else -1
        return self.dry.static[part] + sign * self.stuck(touched).forces[part]

    def _motion(self, touched: Sequence[int]) -> _Motion:
        """Return the motion with the friction of the parts that slip, and none of the others."""
        mechanism, drive = self._mechanism, self._drive
        pushes = ca.SX.zeros(self._system.n_q)
        for k in touched:
            pushes += ca.jacobian(self.gaps[k], mechanism.q).T * self.forces[k]
        forces = pushes + self._friction() + drive.force
        rotor_rates: list[ca.SX] = []
        for motor, (axis, _, torque_constants) in self._couplings.items():
            gear, rotor = self._rig.gears[motor], self._rotors[motor]
            torque = ca.dot(torque_constants, self.current)
            teeth = teeth_torque(gear, *ca.vertsplit(rotor - self._joint(motor)))
            forces += axis * (teeth - torque)
            rotor_rates.append(ca.vertcat(rotor[1], (torque - teeth) / gear.rotor_inertia))
        changes = drive.rates
        if drive.after_impact is not None:
            first = 2 * self._system.n_q
            direction = self._system.impulse_direction[first : first + changes.numel()]
            # Only a machine with one stop has such a drive.
            force = self.forces if touched else ca.SX(0)
            changes += direction * force / self._system.normal_inertia
        inverse_mass, acceleration = accelerate(
            replace(mechanism, mass_matrix=self.inertia), forces
        )
        clock = ca.SX(0, 1) if mechanism.clock is None else mechanism.clock.rate
        return _Motion(inverse_mass, acceleration, (changes, clock, *rotor_rates))

    def _inertia(self) -> ca.SX:
        mass = self._mechanism.mass_matrix
        for motor, gear in self._rig.gears.items():
            axis = self._couplings[motor].axis
            mass -= gear.rotor_inertia * ca.mtimes(axis, axis.T)
        return mass

    def _voltage(self) -> ca.SX:
        """Return the voltage that the bridges make, before the drop over their transistors."""
        asked = self.held if self.holds else self._system.motor_voltage
        bridge, drive = self._rig.bridge, self._system.drive
        if bridge is None or self._exact:
            return asked
        inductances: list[ca.SX] = []
        stalls: list[ca.SX] = []
        for part in drive.parts:
            inductance = ca.diag(part.inertia)[: part.motor_voltage.numel()]
            inductances.append(inductance)
            stalls.append(
                bridge.supply / ca.diag(part.motors.resistance)
                if part.motors is not None
                else inductive_current(bridge, inductance)
            )
        current = self._system.motor_current
        return averaged_voltage(
            bridge, asked, current, ca.vertcat(*inductances), ca.vertcat(*stalls)
        )

    def _slip_emf(self) -> ca.SX:
        """Return the induced voltages of geared rotors minus the voltages of their joints."""
        slip = ca.SX.zeros(self._system.motor_voltage.numel())
        for motor, coupling in self._couplings.items():
            slip += coupling.emf * (self._rotors[motor][1] - self._joint(motor)[1])
        return slip

    def _fed(self, source: ca.SX) -> Drive:
        """Return the drive under other source voltages."""
        drive = self._system.drive
        return drive if drive.fed is None else drive.fed(source)

    def _joint(self, motor: int) -> ca.SX:
        """Return angle and rate of the joint that a motor turns."""
        axis = self._couplings[motor].axis
        return ca.vertcat(ca.dot(axis, self._mechanism.q), ca.dot(axis, self._mechanism.v))

    def _friction(self) -> ca.SX:
        """Return the viscous friction of all coordinates, and the dry friction that slips."""
        v = self._mechanism.v
        force = self.dry.slipping(v)
        for name, friction in self._rig.friction.items():
            k = self._coordinates.index(name)
            force[k] -= friction.viscous * v[k]
        return force


def _one_by_one(graph: ModeGraph) -> list[CompletedSystem]:
    """Return the system of every stop, with all other stops open and any branch of the kinks."""
    mode = (), (True,) * len(graph.conditions)
    return [system_of_stop(graph, mode, k) for k in range(graph.n_watched)]


def bridged(system: CompletedSystem) -> ca.SX:
    """Return 1 for every loop with a voltage source, which a bridge makes, and 0 for the others."""
    sources = system.motor_voltage
    has_source = [0.0 if sources[k].is_zero() else 1.0 for k in range(sources.numel())]
    return ca.SX(has_source)
