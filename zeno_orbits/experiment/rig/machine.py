r"""The functions of a machine: one flow off the stop, one in a compliant contact, no reset.

The state is that of the problem, ``(q, v, i)`` and its clock, then angle and rate of every rotor
behind a gear. Where the problem has a restitution, the machine has a contact force along
:math:`\nabla h` (theory (48)); all else that a rig has are forces and voltages (theory (50), (51)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.experiment.rig.forces import (
    averaged_voltage,
    contact_force,
    friction_force,
    teeth_torque,
)
from zeno_orbits.model import (
    CompletedSystem,
    ModeFunctions,
    MotorBank,
    OwnScale,
    Problem,
    Rig,
    Switching,
    accelerate,
    dense_function,
    mode_functions,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Machine:
    """The functions of a machine in ``(y, P)``; ``P`` is ``(p, held voltages, damping factor)``.

    Attributes:
        state_names: Name of each entry of ``y``; those of the problem first.
        n_x: Number of the problem's states.
        n_q: Number of coordinates.
        n_motors: Number of motors.
        holds: Whether the voltages are held, and not those of the feedback at every instant.
        free: Off the stop; its guard is the gap.
        contact: In contact; its guard is the penetration.
        observe: ``(y, P) -> (contact force, gap, gap rate, normal inertia)``.
        motors: ``(y, P) -> (currents, terminal voltages)``, each ``(n_motors,)``.
        command: ``(x measured, p) -> voltages`` that the feedback asks for.
        rest: ``(x, p) -> y`` with every rotor in the middle of its play, turning with its joint.
        inertia: ``(x, p) -> M`` without what is on the motors' side of gears, ``(n_q, n_q)``.
    """

    state_names: tuple[str, ...]
    n_x: int
    n_q: int
    n_motors: int
    holds: bool
    free: ModeFunctions
    contact: ModeFunctions
    observe: ca.Function
    motors: ca.Function
    command: ca.Function
    rest: ca.Function
    inertia: ca.Function

    def weights(self, own: OwnScale, rates: float = 1.0) -> tuple[float, ...]:
        """Return the sizes that local errors are absolute in; rotors turn by radians.

        Args:
            own: Sizes of the problem's numbers.
            rates: Further factor of the velocities.
        """
        n_rotors = (len(self.state_names) - self.n_x) // 2
        rotor = (1 / own.least, 1 / (own.time * own.least))
        states = np.array(own.weights(self.n_x))
        states[self.n_q : 2 * self.n_q] *= rates
        return (*states.tolist(), *(n_rotors * rotor))


@lru_cache(maxsize=16)
def machine(problem: Problem, rig: Rig) -> Machine:
    """Build the functions of a problem's machine, once for the same parts.

    Args:
        problem: The problem.
        rig: What it has.

    Raises:
        InputError: If the rig has a part that the problem has no place for.
    """
    symbols = problem.symbols()
    system = problem.model(symbols)
    require_place(problem, system, rig)
    parts = _Parts(problem, system, rig)
    p = ca.vertcat(*symbols.values())
    numbers = ca.vertcat(p, parts.held, parts.damping)
    force = contact_force(rig.contact, parts.damping, -system.gap, -system.gap_rate)
    guard = ca.vertcat(system.gap, system.gap_rate)

    def function(name: str, *outputs: ca.SX) -> ca.Function:
        return dense_function(name, [parts.state, numbers], list(outputs))

    def mode(name: str, force: ca.SX, guard: ca.SX) -> ModeFunctions:
        return mode_functions(name, parts.state, numbers, parts.rate(force), guard)

    return Machine(
        state_names=(*problem.state_names, *parts.rotor_names),
        n_x=system.state.numel(),
        n_q=system.n_q,
        n_motors=parts.held.numel(),
        holds=parts.holds,
        free=mode("off", ca.SX(0), guard),
        contact=mode("on", force, -guard),
        observe=function("observe", ca.vertcat(force, guard, system.normal_inertia)),
        motors=function("motors", parts.current, parts.terminal),
        command=dense_function("command", [system.state, p], [system.motor_voltage]),
        rest=dense_function("rest", [system.state, p], [parts.rest]),
        inertia=dense_function("inertia", [system.state, p], [parts.inertia]),
    )


def require_place(problem: Problem, system: CompletedSystem, rig: Rig) -> None:
    """Refuse parts that a problem has no place for.

    Args:
        problem: The problem.
        system: Its completed system.
        rig: The parts.

    Raises:
        InputError: With the part at fault.
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
        if not 1 <= motor <= n_motors:
            known = f"must number one of {n_motors} motors"
            raise InputError(f"Argument `gears` {known}, but it has the number {motor}.")
    if n_motors == 0 and (rig.bridge is not None or rig.controller is not None):
        message = f"must have motors for a bridge or a controller, but `{problem.name}` has none"
        raise InputError(f"Argument `problem` {message}.")
    if rig.bridge is not None and drive.current.numel() == 0:
        message = "must have its currents as states for a bridge, but they follow at once in"
        raise InputError(f"Argument `problem` {message} `{problem.name}`.")


class _Parts:
    """The expressions of a machine, made of those of its problem."""

    def __init__(self, problem: Problem, system: CompletedSystem, rig: Rig) -> None:
        self._system, self._rig, self._mechanism = system, rig, system.mechanism
        self._coordinates = problem.state_names[: system.n_q]
        self._motors = system.drive.motors
        n_motors = system.motor_voltage.numel()
        self.held, self.damping = ca.SX.sym("held", n_motors), ca.SX.sym("damping")
        self._exact = rig.bridge is not None and rig.bridge.switching is Switching.EXACT
        self.holds = n_motors > 0 and (rig.controller is not None or self._exact)
        self._rotors = {motor: ca.SX.sym(f"rotor{motor}", 2) for motor in sorted(rig.gears)}
        self.rotor_names = [f"{d}rotor{motor}" for motor in self._rotors for d in ("", "d")]
        self.state = ca.vertcat(system.state, *self._rotors.values())
        self.rest = ca.vertcat(system.state, *(self._joint(motor) for motor in self._rotors))
        self.inertia = self._inertia()
        self._driven = self._voltage()
        self.current = self._current()
        drop = 0.0 if rig.bridge is None else rig.bridge.resistance
        self.terminal = self._driven - drop * self.current

    def rate(self, force: ca.SX) -> ca.SX:
        """Return the time derivative of the state under a force of the stop."""
        mechanism, motors = self._mechanism, self._motors
        forces = ca.jacobian(mechanism.gap, mechanism.q).T * force + self._friction()
        rotor_rates: list[ca.SX] = []
        if motors is None:
            forces += self._system.drive.force
        else:
            torque, rotor_rates = self._torques(motors)
            forces += ca.mtimes(motors.selection, torque)
        _, acceleration = accelerate(replace(mechanism, mass_matrix=self.inertia), forces)
        clock = ca.SX(0, 1) if mechanism.clock is None else mechanism.clock.rate
        return ca.vertcat(mechanism.v, acceleration, self._current_rate(), clock, *rotor_rates)

    def _inertia(self) -> ca.SX:
        mass = self._mechanism.mass_matrix
        if self._motors is None:
            return mass
        for motor, gear in self._rig.gears.items():
            axis = self._motors.selection[:, motor - 1]
            mass -= gear.rotor_inertia * ca.mtimes(axis, axis.T)
        return mass

    def _voltage(self) -> ca.SX:
        """Return the voltage that the bridges make, before the drop over their transistors."""
        asked = self.held if self.holds else self._system.motor_voltage
        if self._rig.bridge is None or self._exact or self._motors is None:
            return asked
        inductance = ca.diag(self._motors.inductance)
        stall = self._rig.bridge.supply / ca.diag(self._motors.resistance)
        current = self._system.motor_current
        return averaged_voltage(self._rig.bridge, asked, current, inductance, stall)

    def _current(self) -> ca.SX:
        if self._motors is None or self._system.drive.current.numel():
            return self._system.motor_current
        return ca.solve(self._motors.resistance, self._driven - self._emf(self._motors))

    def _current_rate(self) -> ca.SX:
        if self._motors is None or not self._system.drive.current.numel():
            return ca.SX(0, 1)
        lost = ca.mtimes(self._motors.resistance, self.current) + self._emf(self._motors)
        return ca.solve(self._motors.inductance, self.terminal - lost)

    def _emf(self, motors: MotorBank) -> ca.SX:
        speed = ca.densify(ca.mtimes(motors.selection.T, self._mechanism.v))
        for motor, rotor in self._rotors.items():
            speed[motor - 1] = rotor[1]
        return ca.mtimes(motors.emf_constant, speed)

    def _torques(self, motors: MotorBank) -> tuple[ca.SX, list[ca.SX]]:
        """Return the torques on the joints, and the rates of the rotors behind gears."""
        torque = ca.densify(ca.mtimes(motors.torque_constant, self.current))
        rates: list[ca.SX] = []
        for motor, rotor in self._rotors.items():
            gear = self._rig.gears[motor]
            twist, slip = ca.vertsplit(rotor - self._joint(motor))
            teeth = teeth_torque(gear, twist, slip)
            net = torque[motor - 1] - teeth
            rates.append(ca.vertcat(rotor[1], net / gear.rotor_inertia))
            torque[motor - 1] = teeth
        return torque, rates

    def _joint(self, motor: int) -> ca.SX:
        """Return angle and rate of the joint that a motor turns."""
        if self._motors is None:
            raise ValueError("Argument `motor` must be one of the problem's, but it has none.")
        axis = self._motors.selection[:, motor - 1]
        return ca.vertcat(ca.dot(axis, self._mechanism.q), ca.dot(axis, self._mechanism.v))

    def _friction(self) -> ca.SX:
        v = self._mechanism.v
        force = ca.SX.zeros(v.numel())
        for name, friction in self._rig.friction.items():
            k = self._coordinates.index(name)
            force[k] = friction_force(friction, v[k])
        return force
