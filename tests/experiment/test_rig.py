"""Runs of a virtual rig, held against closed forms and against SciPy on models written by hand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import zeno_orbits as zo
from benchmarks.rig_convergence import fit_order
from tests.support.cases import fast
from tests.support.disc import DISC, ELECTRIC, INERTIA
from zeno_orbits import Friction, hybrid_system
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, RunawayError, SimulationError
from zeno_orbits.experiment import (
    RigRun,
    RigSettings,
    Source,
    compare_cycles,
    recording_of,
    run_rig,
    settle_rig,
)
from zeno_orbits.experiment.rig import (
    cut_cycles,
    damping_number,
    default_rig,
)
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import (
    CompletedSystem,
    Contact,
    Controller,
    Gear,
    HBridge,
    Problem,
    PwmSettings,
    Rig,
    Sensors,
    load_problem,
    load_reference,
)
from zeno_orbits.orbits import Orbit

FINE = RigSettings(tolerance=Tolerance(relative=1e-12, absolute=1e-14))
STIFF = Contact(stiffness=1e6)

# --------------------------------------------------------- a disc that a motor turns, and no stop


def disc_matrix(resistance: float, constant: float = ELECTRIC["K"]) -> Vector:
    """Return the disc as ``d(angle, rate, current, voltage)/dt``, the voltage held."""
    matrix = np.zeros((4, 4))
    matrix[0, 1] = 1.0
    matrix[1, 2] = constant / INERTIA
    matrix[2] = np.array([0.0, -constant, -resistance, 1.0]) / ELECTRIC["L"]
    return matrix


# -------------------------------------------------------------------------------- the contact


def ball_by_scipy(e: float, exponent: float, stiffness: float, speed: float) -> tuple[float, float]:
    """Return when a ball that meets the floor at a speed leaves it, and how fast, under gravity."""
    alpha, g = damping_number(e) / speed, 9.81

    def rate(_t: float, y: Vector) -> tuple[float, float]:
        depth = -y[0]
        force = stiffness * math.copysign(abs(depth) ** exponent, depth)
        return y[1], force * max(0.0, 1 - alpha * y[1]) - g

    def out(_t: float, y: Vector) -> float:
        return y[0] if y[1] > 0.0 else -1.0

    out.terminal = True  # type: ignore[attr-defined]
    out.direction = 1.0  # type: ignore[attr-defined]
    motion = solve_ivp(
        rate, (0.0, 1.0), (0.0, -speed), method="DOP853", events=out, rtol=3e-13, atol=1e-15
    )
    return float(motion.t_events[0][0]), float(motion.y_events[0][0][1])


@pytest.mark.parametrize("e", [0.1, 0.2, 0.8])
@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_a_ball_leaves_the_floor_when_and_as_fast_as_scipy_says(e: float, exponent: float) -> None:
    ball, stiffness, speed = load_problem("bouncing_ball"), 2e7, 3.0
    run = run_rig(
        ball,
        ball.values(parameters={"restitution": e}),
        Rig(contact=Contact(stiffness=stiffness, exponent=exponent)),
        (0.0, -speed),
        0.1,
        settings=FINE,
    )
    lasted, left = ball_by_scipy(e, exponent, stiffness, speed)
    touch = run.touches[0]
    # Both at tolerances of 1e-12 and less, over some twenty steps.
    assert touch.end - touch.start == pytest.approx(lasted, rel=1e-9)
    assert touch.depart_rate == pytest.approx(left, rel=1e-9)
    # Gravity acts for as long as the contact lasts; without it the restitution would be exact.
    assert touch.depart_rate == pytest.approx(e * speed, abs=9.81 * lasted)


def test_the_restitution_does_not_depend_on_the_speed_of_the_impact() -> None:
    ball = load_problem("bouncing_ball")
    values = ball.values(parameters={"restitution": 0.4, "g": 1e-9})
    for speed in (0.01, 1.0, 100.0):
        run = run_rig(
            ball, values, Rig(contact=Contact(stiffness=1e6)), (1e-3 * speed, -speed), 0.1
        )
        touch = run.touches[0]
        # Gravity changes the speed by g times 5 ms.
        assert -touch.depart_rate / touch.approach_rate == pytest.approx(0.4, abs=1e-8)


def test_a_ball_comes_to_rest_in_the_floor_after_a_finite_number_of_contacts() -> None:
    """No Zeno point: where the weight bends the floor by as much as the impact, it stays in it."""
    ball = load_problem("bouncing_ball")
    stiffness, g = 1e6, 9.81
    values = ball.values(parameters={"restitution": 0.2})
    run = run_rig(ball, values, Rig(contact=Contact(stiffness=stiffness)), (1.0, 0.0), 3.0)
    resting = run.touches[-1]
    slow = g / math.sqrt(stiffness)
    fall = math.sqrt(2 * g)
    # Impacts k = 0, 1, ... meet the floor at e^k of the first speed, down to about `slow`.
    most = math.log(fall / slow) / math.log(5)
    assert len(run.touches) == pytest.approx(most + 1, abs=1.5)
    assert math.isinf(resting.end)
    assert run.gap[-1] == pytest.approx(-g / stiffness, rel=1e-6)
    assert run.contact_force[-1] == pytest.approx(g, rel=1e-6)


@pytest.mark.slow
def test_the_rig_of_the_pendulum_moves_as_scipy_moves_the_one_written_by_hand(
    problem: Problem, orbit: Orbit
) -> None:
    """Contact force, normal inertia and feedback, through the first impact and into the second."""
    stiffness = 1e4
    values = orbit.values(problem)
    by_hand = load_reference(problem).dynamics(values)
    number = damping_number(values.number("restitution"))
    start = np.array(problem.state_vector(orbit.release_state))

    def pushed(x: Vector, alpha: float) -> Vector:
        depth, closing = -by_hand.gap(x), -by_hand.gap_rate(x)
        force = stiffness * depth * max(0.0, 1 + alpha * closing)
        return by_hand.free.rate(x) + force / by_hand.normal_inertia(x) * by_hand.impulse_direction(
            x
        )

    def meets(_t: float, x: Vector) -> float:
        return by_hand.gap(x)

    meets.terminal = True  # type: ignore[attr-defined]
    time, x = 0.0, start
    for touching in (False, True, False, True):
        meets.direction = 1.0 if touching else -1.0  # type: ignore[attr-defined]
        alpha = number / -by_hand.gap_rate(x) if touching else 0.0
        arc = solve_ivp(
            lambda _t, y, a=alpha, on=touching: pushed(y, a) if on else by_hand.free.rate(y),
            (time, 2.0),
            x,
            method="DOP853",
            events=meets,
            rtol=3e-14,
            atol=1e-14,
            first_step=1e-5,
        )
        time, x = float(arc.t_events[0][-1]), arc.y_events[0][-1]
    run = run_rig(
        problem, values, Rig(contact=Contact(stiffness=stiffness)), start, 1.3, settings=FINE
    )
    touch = run.touches[1]
    # SciPy's events are located on dense output of order 7: some 1e-9 of a step of milliseconds.
    assert touch.end == pytest.approx(time, abs=1e-9)
    assert touch.end_state == pytest.approx(x, rel=1e-8, abs=1e-9)


def test_energy_that_a_contact_takes_is_that_of_newtons_law() -> None:
    """Two coordinates: the kinetic metric makes the inertia that the contact feels."""
    pendulum = load_problem("motor_pendulum")
    values = pendulum.values()
    hand = load_reference(pendulum).dynamics(values)
    run = run_rig(
        pendulum,
        values,
        Rig(contact=Contact(stiffness=1e9)),
        pendulum.state_vector({"theta1": 0.5, "theta2": 1e-6, "dtheta2": -8.0}),
        0.01,
        settings=FINE,
    )
    touch = run.touches[0]
    lost = hand.energy(touch.state) - hand.energy(touch.end_state)
    inertia = hand.normal_inertia(touch.state)
    expected = (1 - 0.2**2) / 2 * inertia * touch.approach_rate**2
    # Gravity and motor act for the 5 us of the contact: 25 rad/s^2 against 8 rad/s.
    assert lost == pytest.approx(expected, rel=1e-4)


def test_a_curved_stop_gives_back_the_restitution_in_its_own_metric() -> None:
    """The gap is no coordinate and its gradient turns: the force acts along it, all the same."""
    bowl = load_problem("curved_surface")
    e = bowl.values().number("restitution")
    start = bowl.state_vector({"x": 0.05, "y": 0.1, "dx": 0.5, "cosine": 1.0})
    ratios: list[float] = []
    for stiffness in (1e6, 1e8):
        rig = Rig(contact=Contact(stiffness=stiffness))
        touch = run_rig(bowl, bowl.values(), rig, start, 0.2, settings=FINE).touches[0]
        ratios.append(-touch.depart_rate / touch.approach_rate - e)
    # What acts beside the contact does so for its length, which falls with the square root.
    assert abs(ratios[0]) < 1e-2
    assert ratios[0] / ratios[1] == pytest.approx(10.0, rel=0.05)


# -------------------------------------------------------------------- friction, gears, bridges


def test_a_gear_of_very_stiff_teeth_is_none(problem: Problem) -> None:
    """Taken out of the mass matrix and put back behind teeth, the rotor moves as it did."""
    start = problem.state_vector({"theta1": 0.6, "theta2": 1.5})

    def final(gears: Mapping[int, Gear]) -> Vector:
        rig = Rig(gears=dict(gears))
        run = run_rig(problem, problem.values(), rig, start, 0.2, settings=FINE)
        assert not run.touches
        return run.states[-1, :5]

    rigid = final({})
    away = [
        float(np.max(np.abs(final({1: Gear(rotor_inertia=0.0175, stiffness=k)}) - rigid)))
        for k in (1e5, 1e6)
    ]
    # Angles twist by torque over stiffness; the vibration of the teeth that begins with it is as
    # fast as the root of it, so rates differ by its root.
    assert away[1] < away[0] < 0.02
    assert away[0] / away[1] == pytest.approx(math.sqrt(10), rel=0.5)


@pytest.mark.slow
def test_dry_and_viscous_friction_let_a_disc_run_down_as_their_closed_forms_say() -> None:
    values = DISC.values(parameters={"K": 1e-12})
    dry, start = 0.004, 2.0
    run = run_rig(
        DISC,
        values,
        Rig(friction={"angle": Friction(coulomb=dry)}),
        (0.0, start, 0.0),
        12.0,
        settings=FINE,
    )
    # J dv/dt = -c sign(v): v is straight to 0 at J v / c = 10 s, and stays there.
    expected = np.maximum(0.0, start - dry / INERTIA * run.times)
    assert run.of("rate") == pytest.approx(expected, abs=1e-12)
    assert run.of("rate")[-1] == 0.0
    apart = np.abs(run.times - INERTIA * start / dry) > 1e-9
    assert np.array_equal((run.of("side_angle") == 0.0)[apart], (expected == 0.0)[apart])
    viscous = 0.01
    run = run_rig(
        DISC,
        values,
        Rig(friction={"angle": Friction(viscous=viscous)}),
        (0.0, start, 0.0),
        2.0,
        settings=FINE,
    )
    assert run.of("rate") == pytest.approx(
        start * np.exp(-viscous * run.times / INERTIA), abs=1e-10
    )


def test_a_rotor_crosses_its_play_freely_and_strikes_the_teeth_with_their_restitution() -> None:
    """Two free inertias: momentum stays, the play is crossed at the relative speed, teeth lose."""
    rotor, play, loss = 0.015, 0.02, 0.5
    values = DISC.values(parameters={"K": 1e-12})
    gear = Gear(rotor_inertia=rotor, play=play, stiffness=4000.0, loss=loss)
    rig = Rig(gears={1: gear}, friction={})
    joint = INERTIA - rotor
    run = run_rig(DISC, values, rig, (0.0, 0.0, 0.0), 0.2, settings=FINE)
    assert run.state_names == ("angle", "rate", "current", "rotor1", "drotor1")
    # A state of the problem starts rotor and joint together; a current sets the rotor going alone.
    values = DISC.values(gains={"V0": 1.0}, parameters={"K": 0.05})
    run = run_rig(DISC, values, rig, (0.0, 0.0, 0.5), 0.3, settings=FINE)
    held = run.of("rotor1") - run.of("angle") < play / 2
    before = np.argmin(held)
    assert np.all(run.of("rate")[:before] == 0.0)
    # The torque K i makes all the momentum that there is.
    torque_time = np.concatenate(
        [
            [0.0],
            np.cumsum(
                np.diff(run.times) * 0.05 * (run.of("current")[1:] + run.of("current")[:-1]) / 2
            ),
        ]
    )
    momentum = rotor * run.of("drotor1") + joint * run.of("rate")
    # The trapezoidal rule over the current, whose layer of 1.5 ms has records every 1 ms.
    assert momentum == pytest.approx(torque_time, abs=2e-2 * float(np.max(torque_time)))


def test_a_current_ripples_between_its_two_closed_forms() -> None:
    """An RL circuit under pulses: exponentials between the edges, periodic from its own valley."""
    supply, frequency, asked, drop = 12.0, 5e3, 4.0, 0.5
    tau, share, period = ELECTRIC["L"] / (ELECTRIC["R"] + drop), asked / supply, 1 / frequency
    final = supply / (ELECTRIC["R"] + drop)
    peak = final * (1 - math.exp(-share * period / tau)) / (1 - math.exp(-period / tau))
    valley = peak * math.exp(-(1 - share) * period / tau)
    bridge = HBridge(
        supply=supply, resistance=drop, frequency=frequency, switching=PwmSettings.EXACT
    )
    run = run_rig(
        DISC,
        DISC.values(gains={"V0": asked}, parameters={"K": 1e-12}),
        Rig(bridge=bridge),
        (0.0, 0.0, valley),
        20 * period,
        settings=replace(FINE, spacing=period / 7),
    )
    phase = np.mod(run.times + 1e-12, period) - 1e-12
    rising = final + (valley - final) * np.exp(-phase / tau)
    falling = peak * np.exp(-(phase - share * period) / tau)
    expected = np.where(phase < share * period, rising, falling)
    assert run.of("current") == pytest.approx(expected, rel=1e-9)
    # The terminals see the supply less the drop over the transistors, or the drop alone.
    on = run.voltage[:, 0] + drop * run.of("current")
    assert set(np.round(on[:-1], 9)) == {0.0, supply}


@pytest.mark.parametrize("asked", [4.0, -4.0])
def test_an_averaged_bridge_gives_the_mean_current_of_an_exact_one(asked: float) -> None:
    bridge = HBridge(supply=12.0, resistance=0.5, frequency=5e3, dead_time=2e-6, diode_drop=0.7)
    values = DISC.values(gains={"V0": asked}, parameters={"K": 1e-12})

    def current(switching: PwmSettings) -> Vector:
        rig = Rig(bridge=replace(bridge, switching=switching))
        settings = replace(FINE, spacing=1e-6, keep_from=0.03)
        run = run_rig(DISC, values, rig, (0.0, 0.0, asked / 2.5), 0.03 + 2e-4, settings=settings)
        return run.of("current")[:200]

    exact, averaged = current(PwmSettings.EXACT), current(PwmSettings.AVERAGED)
    # The rectangle rule over one period of 200 points, with the kinks of its edges.
    assert np.ptp(exact) > 0.1
    assert np.mean(exact) == pytest.approx(np.mean(averaged), abs=2e-4)


# -------------------------------------------------------------------------------- the controller


@pytest.mark.parametrize("delay", [0.0, 0.7e-3, 2e-3, 4.6e-3])
def test_a_sampled_disc_moves_as_matrix_exponentials_say(delay: float) -> None:
    period, gains = 2e-3, {"V0": 3.0, "Kp": 4.0, "Kd": 0.3}
    rig = Rig(controller=Controller(period=period, delay=delay))
    run = run_rig(DISC, DISC.values(gains=gains), rig, (0.1, 1.0, 0.0), 0.05, settings=FINE)
    matrix = disc_matrix(ELECTRIC["R"])
    y = np.array([0.1, 1.0, 0.0, 0.0])
    edges = sorted(
        [(k * period, False) for k in range(26)] + [(k * period + delay, True) for k in range(25)]
    )
    time, commands, taken = 0.0, list[float](), 0
    for edge, takes_over in edges:
        if edge > 0.05 - 1e-12:
            break
        y = expm(matrix * (edge - time)) @ y
        time = edge
        if takes_over:
            y[3], taken = commands[taken], taken + 1
        else:
            commands.append(gains["V0"] - gains["Kp"] * y[0] - gains["Kd"] * y[1])
    y = expm(matrix * (0.05 - time)) @ y
    assert run.states[-1] == pytest.approx(y[:3], rel=1e-9)


@pytest.mark.slow
def test_the_noise_of_a_current_reaches_the_voltage_of_its_law() -> None:
    sigma, gain = 0.05, 2.0
    sampled = Controller(period=2e-3)

    def run(noise: float, ki: float) -> RigRun:
        rig = Rig(controller=sampled, sensors=Sensors(current_noise=noise))
        values = DISC.values(gains={"V0": 3.0, "Ki": ki})
        return run_rig(DISC, values, rig, (0.0, 0.0, 0.0), 2.0, seed=4)

    noisy = run(sigma, gain)
    n = len(noisy.record.times)
    # The voltage between two readings is the law of what was read, and the record has the reading.
    middle = np.searchsorted(noisy.times, noisy.record.times[:-1] + 5e-4)
    asked = 3.0 - gain * noisy.record.currents[:-1, 0]
    assert noisy.voltage[middle, 0] == pytest.approx(asked, rel=1e-12)
    current = np.interp(noisy.record.times, noisy.times, noisy.of("current"))
    errors = noisy.record.currents[:, 0] - current
    # Four standard errors of a standard deviation from n draws.
    assert np.std(errors[10:]) == pytest.approx(sigma, rel=4 / math.sqrt(2 * n))
    steps = [np.std(np.diff(one.voltage[middle[20:], 0])) for one in (noisy, run(0.0, gain))]
    assert steps[0] > gain * sigma
    assert steps[1] < 1e-3
    # A law without the current moves as with an exact sensor, to the last digit.
    assert np.array_equal(run(sigma, 0.0).states, run(0.0, 0.0).states)


def test_a_held_state_takes_the_current_that_the_sensor_gives() -> None:
    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        disc = DISC.model(p)
        seen = ca.SX.sym("seen")
        far = zo.Switch(name="far", guard=1.0 - disc.mechanism.q, others_after=None)
        hold = zo.Hold(states=seen, at="switch far", after=disc.drive.motor_current)
        return hybrid_system(disc.mechanism, (disc.drive, hold), p["restitution"], switches=(far,))

    names, units = (*DISC.state_names, "seen"), (*DISC.state_units, "A")
    problem = replace(DISC, name="seeing", model=model, state_names=names, state_units=units)
    values = problem.values(gains={"V0": 3.0})

    def seen(noise: float) -> tuple[float, float]:
        rig = Rig(controller=Controller(period=1e-3), sensors=Sensors(current_noise=noise))
        run = run_rig(problem, values, rig, (0.9, 4.0, 0.0, 0.0), 0.1, seed=1)
        held = float(run.of("seen")[-1])
        return held, float(np.min(np.abs(run.record.currents - held)))

    exact, noisy = seen(0.0), seen(0.05)
    # What is held is a reading, not the current between two readings.
    assert exact[1] == noisy[1] == 0.0
    assert 1e-3 < abs(noisy[0] - exact[0]) < 0.25


@pytest.mark.slow
def test_fast_sampling_tends_to_the_feedback_of_the_model_at_first_order() -> None:
    gains = {"V0": 3.0, "Kp": 4.0, "Kd": 0.3}

    def final(rig: Rig) -> Vector:
        values = DISC.values(gains=gains)
        return run_rig(DISC, values, rig, (0.1, 1.0, 0.0), 0.1, settings=FINE).states[-1]

    ideal = final(Rig())
    away = [
        float(np.max(np.abs(final(Rig(controller=Controller(period=period))) - ideal)))
        for period in (1e-4, 1e-5)
    ]
    # A hold delays by half a period: first order. The second is the period over L/R, 1.5 ms.
    assert away[0] / away[1] == pytest.approx(10.0, rel=0.05)


@pytest.mark.slow
def test_a_run_is_the_same_for_the_same_seed_and_another_for_another(problem: Problem) -> None:
    rig = replace(default_rig(problem), gears={})
    assert rig.sensors is not None
    assert rig.sensors.noise > 0.0
    start = problem.state_vector(problem.starts[0])

    def final(rig: Rig, seed: int) -> list[float]:
        return run_rig(problem, problem.values(), rig, start, 0.2, seed=seed).states[-1].tolist()

    assert final(rig, 3) == final(rig, 3) != final(rig, 4)
    quiet = replace(rig, sensors=replace(rig.sensors, noise=0.0, current_noise=0.0))
    assert final(quiet, 3) == final(quiet, 4)


# ---------------------------------------------------------------------- near an orbit of the model


def period_error(orbit: Orbit, problem: Problem, contact: Contact) -> float:
    """Return how much longer a cycle of the rig is than the orbit."""
    settled = settle_rig(orbit, problem, Rig(contact=contact), cycles=1, settle=6, settings=FINE)
    return settled.cycles[-1].period - orbit.period


@pytest.mark.slow
def test_the_rig_tends_to_the_zeno_orbit_as_the_square_root_of_its_compliance(
    problem: Problem, orbit: Orbit
) -> None:
    errors = [period_error(orbit, problem, Contact(stiffness=k)) for k in (1e4, 1e6, 1e8)]
    orders = [math.log(errors[k] / errors[k + 1]) / math.log(100) for k in range(2)]
    # Theory (6.6): 1/2, the next term smaller by the contact's length over the current's layer.
    assert orders[0] == pytest.approx(0.5, abs=0.02)
    assert orders[1] == pytest.approx(0.5, abs=0.003)
    assert abs(errors[2]) < 1e-6


def test_settled_cycles_begin_and_end_at_releases_and_repeat(
    problem: Problem, orbit: Orbit
) -> None:
    settled = settle_rig(orbit, problem, Rig(contact=Contact(stiffness=1e4)), cycles=2)
    first, second = settled.cycles
    assert first.release == 0.0
    assert first.end == second.release
    assert settled.run.times[0] >= 0.0
    assert settled.run.times[-1] <= second.end
    assert np.all(np.diff(settled.run.times) >= 0.0)
    assert first.impacts == second.impacts >= 3
    # What is left falls to 1e-8 of the distance from the orbit at the start, itself some 1e-4.
    assert first.period == pytest.approx(second.period, abs=1e-9)
    assert first.impact.approach_rate < -10.0
    locked = (settled.run.times > first.lock + 0.01) & (settled.run.times < first.end - 0.01)
    assert np.all(settled.run.in_contact[locked])
    assert np.all(settled.run.contact_force[locked] > 0.0)
    assert np.all(settled.run.contact_force >= 0.0)


@pytest.mark.slow
def test_a_machine_that_does_not_lock_is_told_so(problem: Problem, orbit: Orbit) -> None:
    stuck = Rig(friction={"theta1": Friction(coulomb=0.5)})
    with pytest.raises(
        SimulationError, match=r"made \d cycles? with a lasting contact, but 3 were expected"
    ):
        settle_rig(orbit, problem, stuck, cycles=1, settle=2)


def test_no_cycle_at_all_is_refused(problem: Problem, orbit: Orbit) -> None:
    for cycles, settle in ((0, 1), (1, -1)):
        with pytest.raises(InputError, match="`cycles` must be at least 1, and `settle`"):
            settle_rig(orbit, problem, Rig(), cycles=cycles, settle=settle)


def test_touches_without_a_long_one_hold_no_cycle(orbit: Orbit, problem: Problem) -> None:
    settled = settle_rig(orbit, problem, Rig(contact=STIFF), cycles=2, settle=2)
    touches = settled.run.touches
    assert len(cut_cycles(touches, orbit)) >= 1
    assert cut_cycles([t for t in touches if t.end - t.start < 0.1], orbit) == ()


@pytest.mark.slow
def test_the_comparison_tells_means_spreads_and_where_the_machine_is_farthest(
    problem: Problem, orbit: Orbit
) -> None:
    settled = settle_rig(orbit, problem, Rig(contact=Contact(stiffness=1e5)), cycles=2)
    comparison = compare_cycles(orbit, problem, settled)
    assert comparison.orbit.period == orbit.period
    assert comparison.mean.period == pytest.approx(orbit.period, abs=1e-4)
    assert comparison.spread.period < 1e-9
    assert comparison.drifting is None
    # Farthest while the contact takes the place of the reset: at the first impact.
    assert comparison.portrait_at == pytest.approx(orbit.impacts[0].time / orbit.period, abs=0.01)
    assert comparison.as_json()["source"] == "simulated"


def test_a_power_law_is_fitted_with_its_order() -> None:
    k = np.array([1.0, 10.0, 100.0, 1000.0])
    fit = fit_order(k, -3.0 * k**-0.4)
    assert (fit.order, fit.coefficient) == pytest.approx((0.4, 3.0))
    assert fit.error < 1e-12
    rough = fit_order(k, 3.0 * k**-0.4 * np.array([1.1, 0.9, 1.1, 0.9]))
    assert rough.error > 0.01
    for wrong, message in (([1.0, 2.0], "three or more"), ([1.0, 0.0, 1.0, 1.0], "zero")):
        with pytest.raises(ValueError, match=message):
            fit_order(k[: len(wrong)], wrong)


# -------------------------------------------------------------------------------------- refusals


def test_a_part_that_the_problem_has_no_place_for_is_refused_by_name(problem: Problem) -> None:
    start = problem.state_vector({})
    ball = load_problem("bouncing_ball")
    cases = (
        (
            problem,
            Rig(friction={"knee": Friction()}),
            "`friction` must name one of theta1, theta2",
        ),
        (
            problem,
            Rig(gears={2: Gear(rotor_inertia=0.01)}),
            "`gears` must number one of 1 motors",
        ),
        (ball, Rig(controller=Controller(period=1e-3)), "must have motors for a bridge"),
        (
            problem.at_fidelity("quasi_static"),
            Rig(bridge=HBridge(supply=12.0)),
            "states for a bridge",
        ),
        (
            problem.at_fidelity("corrected"),
            Rig(),
            "currents as states, or none at all, for a rig",
        ),
        (problem, Rig(gears={1: Gear(rotor_inertia=1.0)}), "`rotor_inertia` must be below"),
    )
    for problem, rig, message in cases:
        given = start[: len(problem.state_names)]
        with pytest.raises(InputError, match=message):
            run_rig(problem, problem.values(), rig, given, 0.1)


def test_a_plastic_impact_a_wrong_state_and_a_wrong_time_are_refused(problem: Problem) -> None:
    start, values = problem.state_vector({}), problem.values()
    plastic = problem.values(parameters={"restitution": 0.0})
    with pytest.raises(
        InputError, match="`restitution` must be greater than 0 for a compliant contact"
    ):
        run_rig(problem, plastic, Rig(), start, 1.0)
    with pytest.raises(InputError, match="`start` must be of shape"):
        run_rig(problem, values, Rig(), start[:4], 1.0)
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="`until` must be a positive number"):
            run_rig(problem, values, Rig(), start, wrong)


def test_a_machine_that_runs_away_says_which_coordinate_did(problem: Problem) -> None:
    wild = problem.values(gains={"Kd": -6.0})
    with pytest.raises(RunawayError, match=r"`theta[12]` ran away"):
        run_rig(problem, wild, Rig(), problem.state_vector({"theta1": 1.0}), 20.0)


# ------------------------------------------------------------------------------- any other problem


@pytest.mark.parametrize(
    "name", fast(2, ["two_motors", "motor_cart", "motor_valve", "forced_oscillator"])
)
def test_other_problems_have_a_rig_too(name: str) -> None:
    problem = load_problem(name)
    rig = Rig(contact=Contact(stiffness=1e5))
    if problem.state_names[-1].startswith("current"):
        rig = replace(rig, controller=Controller(period=1e-3), bridge=HBridge(supply=24.0))
    start = problem.state_vector(problem.starts[0])
    run = run_rig(problem, problem.values(), rig, start, 1.0)
    assert np.all(np.isfinite(run.states))
    assert float(np.min(run.gap)) > -0.1
    recording = recording_of(run, problem)
    assert recording.source is Source.SIMULATED
    assert (
        recording.names[: problem.model(problem.symbols()).n_q]
        == problem.state_names[:2][: problem.model(problem.symbols()).n_q]
    )


@pytest.mark.slow
def test_a_reduced_model_without_currents_has_a_rig_with_a_controller(problem: Problem) -> None:
    reduced = problem.at_fidelity("quasi_static")
    rig = Rig(controller=Controller(period=1e-4))
    start = (0.6, 0.3, 0.0, 0.0)
    ideal, sampled = (
        run_rig(reduced, reduced.values(), r, start, 0.2).states[-1] for r in (Rig(), rig)
    )
    # First order in the period: 1e-4 s at accelerations of some 30 rad/s^2 over 0.2 s.
    assert sampled == pytest.approx(ideal, abs=1e-2)
    assert not np.allclose(sampled, ideal, atol=1e-7)


@pytest.mark.slow
def test_a_run_is_recorded_with_names_and_units_as_simulated(problem: Problem) -> None:
    start = problem.state_vector(problem.starts[0])
    run = run_rig(problem, problem.values(), default_rig(problem), start, 0.1)
    recording = recording_of(run, problem, {"seed": "0"})
    assert recording.names == ("theta1", "theta2", "current", "contact")
    assert [signal.unit for signal in recording.signals] == ["rad", "rad", "A", "1"]
    assert recording.problem == problem.name
    assert recording.notes["seed"] == "0"
    assert np.diff(recording.time) == pytest.approx(1e-3)
    step = 2 * math.pi / 8192
    steps = recording.signal("theta1").values / step
    assert steps == pytest.approx(np.round(steps), abs=1e-9)
    ideal = run_rig(problem, problem.values(), Rig(), start, 0.1)
    exact = recording_of(ideal, problem)
    assert exact.time == pytest.approx(np.arange(len(exact.time)) * 1e-3, abs=1e-12)
    assert len(exact.time) >= 100
    assert exact.signal("theta1").values == pytest.approx(
        np.interp(exact.time, ideal.times, ideal.of("theta1"))
    )
    assert asdict(ideal.rig)["controller"] is None
