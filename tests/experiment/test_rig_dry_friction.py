"""Dry friction of the rig: closed forms, another event loop, the simulation, the stiff limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.friction_loop import LinearMachine
from tests.support.disc import DISC, ELECTRIC
from tests.support.linear_friction import problem_of, start_of
from tests.support.mechanisms import machine_of
from zeno_orbits.errors import InputError
from zeno_orbits.experiment import RigSettings, run_rig
from zeno_orbits.integrators import Tolerance

FINE = RigSettings(tolerance=Tolerance(relative=1e-12, absolute=1e-14))


def mass_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a mass on a spring."""
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    mass = zo.HybridLagrangian.from_energies(
        q=x, v=v, kinetic=v**2 / 2, potential=p["k"] * x**2 / 2
    )
    return zo.hybrid_system(mass, zo.no_drive(mass))


MASS = machine_of(mass_model, {"x": "m", "v": "m/s"}, {"k": 4.0})


@pytest.mark.parametrize("start", [3.1, 1.9, -0.2])
def test_dry_friction_of_the_rig_takes_a_fixed_amplitude_in_every_swing(start: float) -> None:
    torque, k = 1.0, 4.0
    rig = zo.Rig(friction={"x": zo.Friction(coulomb=torque)})
    run = run_rig(MASS, MASS.values(), rig, (start, 0.0), 12.0, settings=FINE)
    # Every half swing of pi / 2 s is a cosine about T / k on the side that it came from.
    times, x, swing = run.times, np.full(run.times.size, start), math.pi / math.sqrt(k)
    place, begun = start, 0.0
    while abs(place) > torque / k:
        centre = math.copysign(torque / k, place)
        during = (times >= begun) & (times < begun + swing)
        x[during] = centre + (place - centre) * np.cos(math.sqrt(k) * (times[during] - begun))
        place, begun = 2 * centre - place, begun + swing
        x[times >= begun] = place
    assert run.of("x") == pytest.approx(x, abs=1e-11)
    assert run.of("v")[-1] == 0.0
    assert np.array_equal(run.of("side_x") == 0.0, times >= begun)


def test_a_disc_breaks_away_when_the_current_has_risen_to_its_friction() -> None:
    volts, constant = 1.0, 0.05
    dry = 0.6 * constant * volts / ELECTRIC["R"]
    values = DISC.values(gains={"V0": volts})
    rig = zo.Rig(friction={"angle": zo.Friction(coulomb=dry)})
    run = run_rig(DISC, values, rig, (0.0, 0.0, 0.0), 0.004, settings=FINE)
    # i = V / R (1 - exp(-R t / L)) while it sticks.
    breaks = -ELECTRIC["L"] / ELECTRIC["R"] * math.log(1 - 0.6)
    sticks = run.of("side_angle") == 0.0
    assert np.array_equal(sticks, run.times < breaks)
    assert np.all(run.of("rate")[sticks] == 0.0)
    assert np.all(run.of("rate")[~sticks] >= 0.0)


@pytest.mark.slow
def test_a_declared_part_moves_in_the_rig_as_in_the_simulation() -> None:
    problem = zo.load_problem("stick_slip")
    start = problem.state_vector(problem.starts[0], problem.values())
    run = run_rig(problem, problem.values(), zo.Rig(), start, 30.0, settings=FINE)
    # Nothing is compliant here, so the loops of the simulation must find the same motion.
    found = zo.simulate(problem, until=30.0)
    assert run.states[-1] == pytest.approx(found.end_state, abs=1e-12)
    assert run.of("side_pad")[-1] == found.end_state[-1]


@pytest.mark.parametrize(("excess", "stays"), [(0.9, True), (-0.9, True), (1.1, False)])
def test_a_part_sticks_on_a_touched_stop_within_its_friction(excess: float, stays: bool) -> None:
    weight, stiffness, torque = 9.81, 1e4, 0.5

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        x, v = ca.SX.sym("x"), ca.SX.sym("v")
        block = zo.HybridLagrangian.from_energies(
            q=x, v=v, kinetic=v**2 / 2, potential=weight * x, gap=x
        )
        return zo.hybrid_system(block, zo.no_drive(block), p["e"])

    problem = machine_of(model, {"x": "m", "v": "m/s"}, {"e": 0.5})
    depth = (weight + excess * torque) / stiffness
    # A stop that is damped as at 1e9 m/s is next to undamped.
    contact = zo.Contact(stiffness=stiffness, slowest=1e9)
    rig = zo.Rig(contact=contact, friction={"x": zo.Friction(coulomb=torque)})
    run = run_rig(problem, problem.values(), rig, (-depth, 0.0), 0.05, settings=FINE)
    assert np.all(run.in_contact)
    # Off the border the block swings about the place where the stop carries weight and friction.
    centre = depth if stays else (weight + torque) / stiffness
    swing = math.pi / math.sqrt(stiffness)
    last = 2 * centre - depth
    assert run.of("x")[run.times > swing] == pytest.approx(-last, rel=1e-9)
    assert run.contact_force[-1] == pytest.approx(stiffness * last, rel=1e-9)
    assert [side == 0.0 for side in run.of("side_x")[[0, -1]]] == [stays, True]


def chain(seed: int) -> LinearMachine:
    """Return a random linear machine with friction along its first coordinates, and no stop."""
    machine = LinearMachine.random(seed)
    m = len(machine.rows)
    return replace(
        machine,
        normal=np.zeros(machine.n),
        rows=np.eye(machine.n)[:m],
        belts=np.zeros(m),
        statics=machine.torques,
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 3, 5, 17, 23, 28])
def test_random_machines_stick_and_slip_as_another_event_loop_says(seed: int) -> None:
    machine, until, spacing = chain(seed), 6.0, 1e-3
    problem = problem_of(machine, is_bare=True)
    rig = zo.Rig(
        friction={f"q{j}": zo.Friction(coulomb=t) for j, t in enumerate(machine.torques.tolist())}
    )
    x = np.append(start_of(LinearMachine.random(seed), 1000 + seed), 0.0)
    settings = replace(FINE, spacing=spacing)
    run = run_rig(problem, problem.values(), rig, tuple(x.tolist()), until, settings=settings)
    found: list[tuple[float, str]] = []
    for j in range(len(machine.rows)):
        sides = run.of(f"side_q{j}")
        for k in np.flatnonzero(np.diff(sides)):
            word = "stick" if sides[k + 1] == 0 else "slip" if sides[k] == 0 else "turn"
            side = {0: "", 1: " up", -1: " down"}[int(sides[k + 1])]
            found.append((run.times[k + 1], f"{word} f{j}{side}"))
    wanted = list(machine.events(np.append(x, 1.0), until))
    assert len(wanted) >= 3
    # So there is one event between two records.
    apart = [b - a for (a, _), (b, _) in pairwise(wanted)]
    assert min(apart) > spacing
    assert [name for _, name in sorted(found)] == [name for _, name in wanted]
    assert [t for t, _ in sorted(found)] == pytest.approx([t for t, _ in wanted], abs=spacing)


@pytest.mark.slow
def test_the_pendulum_with_friction_is_the_limit_of_the_rig_with_that_part_alone() -> None:
    torque = 0.002
    numbers = {"T_gear": torque, "T_static": torque}
    orbit = zo.find_orbit_by_shooting("sticking_pendulum", parameters=numbers).unwrap()
    bare = zo.find_orbit_by_shooting("motor_pendulum").unwrap()
    assert abs(orbit.period - bare.period) > 1e-4

    def away(stiffness: float, *, declared: bool) -> float:
        contact = zo.Contact(stiffness=stiffness)
        rig = zo.Rig(contact=contact)
        if not declared:
            rig = replace(rig, friction={"theta1": zo.Friction(coulomb=torque)})
        known = orbit if declared else bare
        run = zo.simulate_periods(known, rig=rig, periods=2, settle=8)
        first, second = (one.end for one in run.touches if one.end - one.start > 0.05)
        return second - first - orbit.period

    soft, stiff = away(1e6, declared=True), away(4e6, declared=True)
    # The distance falls with the root of the stiffness, theory (6.6).
    assert soft / stiff == pytest.approx(2.0, rel=0.02)
    assert 2 * stiff - soft == pytest.approx(0.0, abs=1e-6)
    # The same part, declared by the problem or by the rig, is the same machine. Local errors move
    # single periods on a stiff stop by up to 2e-7 s (docs/rig.md); the friction moves them by 1e-4.
    assert away(4e6, declared=False) == pytest.approx(stiff, abs=2e-7)


def test_friction_along_a_rate_that_a_declared_part_has_is_refused() -> None:
    problem = zo.load_problem("stick_slip")
    rig = zo.Rig(friction={"x": zo.Friction(coulomb=0.5)})
    start = problem.state_vector(problem.starts[0], problem.values())
    with pytest.raises(InputError, match=r"`friction` must leave out `x`: .* holds its rate"):
        run_rig(problem, problem.values(), rig, start, 1.0)
    viscous = zo.Rig(friction={"x": zo.Friction(viscous=0.5)})
    assert run_rig(problem, problem.values(), viscous, start, 0.1).states.shape[1] == 3


def pushed_model(push: str, is_part: bool, _: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a mass with a motor and a force with a kink, of its own or of a part of the drive."""
    x, v, u = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("u")
    force = ca.SX(eval(push, {"x": x, "v": v, "ca": ca}))
    mass = zo.HybridLagrangian.from_energies(
        q=x,
        v=v,
        kinetic=v**2 / 2,
        potential=2 * x**2,
        passive_force=ca.SX(0) if is_part else force,
    )
    motor = zo.MotorBank(
        selection=ca.SX(1),
        resistance=ca.SX(2),
        inductance=ca.SX(0.3),
        torque_constant=ca.SX(0.5),
        emf_constant=ca.SX(0.5),
        voltage=0.3 - 0.1 * v,
    )
    further = zo.Auxiliary(states=u, rate=-u, force=force if is_part else ca.SX(0))
    return zo.hybrid_system(mass, (zo.full_drive(mass, motor), further))


@pytest.mark.parametrize("push", ["-0.3 * ca.sign(x)", "ca.if_else(x > 0.1, -1, 0.5)"])
def test_a_kink_of_a_drive_beside_a_motor_is_an_event_of_the_rig(push: str) -> None:
    units, start = {"x": "m", "v": "m/s", "i": "A", "u": "1"}, (1.0, 0.2, 0.0, 0.0)
    ends: list[np.ndarray] = []
    for is_part in (False, True):
        problem = machine_of(partial(pushed_model, push, is_part), units, {})
        run = run_rig(problem, problem.values(), zo.Rig(), start, 9.0, settings=FINE)
        ends.append(run.states[-1])
    # The steps are the same, so both machines have the same error.
    assert ends[1] == pytest.approx(ends[0], abs=1e-12)
