"""Nothing in the package knows the pendulum: other models of it are searched and verified, too."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import casadi as ca
import pytest

from zeno_orbits import (
    HybridLagrangian,
    MotorBank,
    full_drive,
    hybrid_system,
    ideal_torque_drive,
    quasi_static_drive,
)
from zeno_orbits.model import CompletedSystem, Problem, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.verification import OrbitCertificate, verify

PERIOD = 1.81371293903044
"""Of the reference orbit, measured by Taylor integration beforehand [s]."""

Symbols = Mapping[str, ca.SX]


def _links(p: Symbols, split_inertia: ca.SX | None = None) -> HybridLagrangian:
    """Return the two links; with a third coordinate that half of link 2's inertia turns with.

    The third coordinate is the absolute angle of link 2, tied to the others by a holonomic
    constraint, so that the motion is that of two coordinates and no mass is added.
    """
    n_q = 2 if split_inertia is None else 3
    q, v = ca.SX.sym("q", n_q), ca.SX.sym("v", n_q)
    rate1, rate2 = v[0], v[0] + v[1]
    inertia1 = p["I1"] + p["J_rotor"] + p["m1"] * p["lc1"] ** 2 + p["m2"] * p["L1"] ** 2
    inertia2 = p["I2"] + p["m2"] * p["lc2"] ** 2
    coupling = p["m2"] * p["L1"] * p["lc2"] * ca.cos(q[1])
    kinetic = inertia1 * rate1**2 / 2 + inertia2 * rate2**2 / 2 + coupling * rate1 * rate2
    potential = -p["g"] * (
        (p["m1"] * p["lc1"] + p["m2"] * p["L1"]) * ca.cos(q[0])
        + p["m2"] * p["lc2"] * ca.cos(q[0] + q[1])
    )
    if split_inertia is None:
        return HybridLagrangian.from_energies(
            q=q, v=v, kinetic=kinetic, potential=potential, gap=q[1]
        )
    kinetic += split_inertia * (v[2] ** 2 - rate2**2) / 2
    return HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=kinetic,
        potential=potential,
        gap=q[2] - q[0],
        holonomic=q[2] - q[0] - q[1],
    )


def _motor(links: HybridLagrangian, p: Symbols) -> MotorBank:
    return MotorBank(
        selection=ca.SX([1] + [0] * (links.q.numel() - 1)),
        resistance=p["R"],
        inductance=p["L"],
        torque_constant=p["K_torque"],
        emf_constant=p["K_emf"],
        voltage=-p["Kp"] * links.q[0] - p["Kd"] * links.v[0],
    )


def _quasi_static(p: Symbols) -> CompletedSystem:
    links = _links(p)
    return hybrid_system(links, quasi_static_drive(links, _motor(links, p)), p["restitution"])


def _ideal_torque(p: Symbols) -> CompletedSystem:
    links = _links(p)
    motor = _motor(links, p)
    torque = p["K_torque"] * (motor.voltage - p["K_emf"] * links.v[0]) / p["R"]
    drive = ideal_torque_drive(links, selection=motor.selection, torque=torque)
    return hybrid_system(links, drive, p["restitution"])


def _constrained(p: Symbols) -> CompletedSystem:
    links = _links(p, split_inertia=p["I2"] / 2)
    return hybrid_system(links, full_drive(links, _motor(links, p)), p["restitution"])


def _problem(model: Callable[[Symbols], CompletedSystem], **changes: object) -> Problem:
    return replace(load_problem("motor_pendulum"), model=model, reference=None, **changes)


def _without_current(model: Callable[[Symbols], CompletedSystem]) -> Problem:
    pendulum = load_problem("motor_pendulum")
    return _problem(
        model, state_names=pendulum.state_names[:4], state_units=pendulum.state_units[:4]
    )


def _found(problem: Problem, **parameters: float) -> tuple[Orbit, OrbitCertificate]:
    orbit = orbit_at_gains(problem, problem.values(parameters=parameters)).unwrap()
    return orbit, verify(orbit, problem)


@pytest.mark.slow
def test_a_drive_without_current_states_has_an_orbit_of_its_own() -> None:
    orbit, certificate = _found(_without_current(_quasi_static))
    assert certificate.passed
    assert len(orbit.release_state) == 4
    # The section of a four-state problem is a curve.
    assert len(certificate.multipliers) == 1


@pytest.mark.slow
def test_the_full_orbit_tends_to_the_quasi_static_one_with_the_inductance() -> None:
    limit, _ = _found(_without_current(_quasi_static))
    pendulum = load_problem("motor_pendulum")
    distances = [
        abs(_found(pendulum, L=inductance)[0].period - limit.period)
        for inductance in (0.002, 0.001, 0.0005)
    ]
    # First order in L/R: halving the inductance halves the distance, to a tenth.
    assert distances[0] / distances[1] == pytest.approx(2.0, rel=0.1)
    assert distances[1] / distances[2] == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
def test_an_ideal_torque_of_the_quasi_static_size_gives_the_same_orbit() -> None:
    by_motor, _ = _found(_without_current(_quasi_static))
    by_torque, certificate = _found(_without_current(_ideal_torque))
    assert certificate.passed
    # Both solvers are right to 3e-10.
    assert by_torque.period == pytest.approx(by_motor.period, rel=1e-9)


@pytest.mark.slow
def test_a_holonomic_constraint_in_place_of_a_coordinate_gives_the_same_orbit() -> None:
    names = ("theta1", "theta2", "phi2", "dtheta1", "dtheta2", "dphi2", "current")
    units = ("rad", "rad", "rad", "rad/s", "rad/s", "rad/s", "A")
    problem = _problem(
        _constrained,
        state_names=names,
        state_units=units,
        starts=({"theta1": 0.6, "phi2": 0.6},),
    )
    orbit, certificate = _found(problem)
    assert certificate.passed, certificate.verdict()
    assert certificate.residuals["holonomic"] < 1e-10
    assert len(certificate.multipliers) == 2
    assert orbit.period == pytest.approx(PERIOD, rel=1e-9)


def test_no_module_of_the_package_names_a_problem() -> None:
    package = Path(__file__).parents[2] / "zeno_orbits"
    # The command line shows examples; the loader's docstring may not need one.
    modules = [path for path in package.rglob("*.py") if "cli" not in path.parts]
    naming = [path.name for path in modules if "motor_pendulum" in path.read_text()]
    assert not naming
