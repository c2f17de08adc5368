"""The parts of a virtual rig by themselves: contact law, forces, pulses, readings, numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from benchmarks.rig_convergence import orbit_distance, spring_contact
from tests.support.cases import fast
from tests.support.disc import DISC, INERTIA
from zeno_orbits import Friction
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.experiment import (
    RigSettings,
    settle_rig,
)
from zeno_orbits.experiment.rig import (
    damping_number,
    effective_restitution,
)
from zeno_orbits.experiment.rig.controller import ArcReadings, BridgeLeg, Encoders, level, pulse
from zeno_orbits.experiment.rig.cycle_comparison import (
    OrbitCurve,
    drift,
    orbit_curve,
)
from zeno_orbits.experiment.rig.forces import (
    averaged_voltage,
    contact_force,
    teeth_torque,
)
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import (
    Contact,
    Controller,
    Gear,
    HBridge,
    Problem,
    Rig,
    Sensors,
    load_reference,
    rig_with_numbers,
    without_parts,
)
from zeno_orbits.orbits import Orbit

ROUNDING = float(np.finfo(float).eps)
RESTITUTIONS = (1e-3, 0.05, 0.2, 0.5, 0.9, 0.999)


# ------------------------------------------------------------------ damping and restitution


@pytest.mark.parametrize("e", RESTITUTIONS)
def test_the_damping_number_solves_its_equation_to_fifty_digits(e: float) -> None:
    number = damping_number(e)
    with mpmath.workdps(60):
        exact_e = mpmath.mpf(e)

        # In s with e u = 1 - exp(-s), so that 1 - e u keeps its digits for small e.
        def missing(s: mpmath.mpf) -> mpmath.mpf:
            u = (1 - mpmath.exp(-s)) / exact_e
            return mpmath.log(1 + u) + s - (1 + exact_e) * u

        # The equation itself tells where to look: s = (1 + e) u - log(1 + u), which says 50 digits
        # only once `findroot` has been there.
        guess = (1 + exact_e) * mpmath.mpf(number) - mpmath.log(1 + mpmath.mpf(number))
        s = mpmath.findroot(missing, guess)
        exact = float((1 - mpmath.exp(-s)) / exact_e)
    # The equation is of third order in 1 - e near a second-order zero: rounding over 1 - e.
    assert number == pytest.approx(exact, rel=30 * ROUNDING / (1 - e))


@pytest.mark.parametrize("e", fast(1, RESTITUTIONS))
@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_a_mass_in_the_contact_leaves_with_the_restitution_that_it_is_damped_for(
    e: float, exponent: float
) -> None:
    """The equation of motion itself, at unit mass, stiffness and speed, by another integrator."""
    number = damping_number(e)

    def out(_t: float, y: tuple[float, float]) -> float:
        return y[0] if y[1] < 0.0 else 1.0

    out.terminal = True  # type: ignore[attr-defined]
    motion = solve_ivp(
        lambda _t, y: (y[1], -(abs(y[0]) ** exponent) * np.sign(y[0]) * (1 + number * y[1])),
        (0.0, 1e4),
        (0.0, 1.0),
        method="Radau",
        events=out,
        rtol=1e-10,
        atol=1e-12,
    )
    left = -motion.y_events[0][-1][1]
    # Tolerance of the integrator, times the few thousand by which strong damping amplifies it.
    assert left == pytest.approx(e, rel=1e-6, abs=1e-9)


def test_the_usual_formula_for_weak_damping_would_be_far_off_here() -> None:
    """3/2 (1 - e) is the limit for e -> 1; at 0.2 it asks for a quarter of the damping."""
    assert damping_number(0.9999) == pytest.approx(1.5e-4, rel=2e-4)
    assert damping_number(0.2) > 4 * 1.5 * 0.8
    assert effective_restitution(1.5 * 0.8) > 0.5


@pytest.mark.slow
@given(st.floats(1e-6, 1 - 1e-6))
def test_restitution_and_damping_number_are_inverse_to_each_other(e: float) -> None:
    assert effective_restitution(damping_number(e)) == pytest.approx(e, abs=50 * ROUNDING / (1 - e))


def test_the_damping_number_has_its_limits() -> None:
    assert damping_number(1.0) == 0.0
    assert math.isinf(damping_number(0.0))
    assert effective_restitution(0.0) == 1.0
    assert effective_restitution(math.inf) == 0.0
    # For strong damping e u -> 1.
    assert 1e-3 * damping_number(1e-3) == pytest.approx(1.0, abs=1e-12)
    for wrong in (-0.1, 1.1, math.nan):
        with pytest.raises(InputError, match="`restitution` must lie in"):
            damping_number(wrong)
    with pytest.raises(InputError, match="`number` must be at least 0"):
        effective_restitution(-1.0)


# ---------------------------------------------------------------------------------- forces


def at(expression: ca.SX, symbols: list[ca.SX], *values: float) -> float:
    """Return an expression at numbers."""
    return float(ca.Function("f", symbols, [expression])(*values))


def test_the_stop_pushes_and_never_pulls() -> None:
    depth, rate = ca.SX.sym("depth"), ca.SX.sym("rate")
    force = contact_force(Contact(stiffness=8.0, exponent=1.5), ca.SX(2.0), depth, rate)
    assert at(force, [depth, rate], 0.25, 0.0) == pytest.approx(8 * 0.125, rel=4 * ROUNDING)
    assert at(force, [depth, rate], 0.25, 0.5) == pytest.approx(8 * 0.125 * 2, rel=4 * ROUNDING)
    assert at(force, [depth, rate], 0.25, -3.0) == 0.0


def test_teeth_carry_nothing_inside_the_play_and_push_on_either_side() -> None:
    twist, rate = ca.SX.sym("twist"), ca.SX.sym("rate")
    gear = Gear(rotor_inertia=1.0, play=0.2, stiffness=50.0, loss=1.0)
    torque = teeth_torque(gear, twist, rate)
    inside = [at(torque, [twist, rate], angle, 5.0) for angle in (-0.1, -0.05, 0.0, 0.1)]
    assert inside == [0.0] * 4
    assert at(torque, [twist, rate], 0.3, 0.0) == pytest.approx(10.0)
    assert at(torque, [twist, rate], -0.3, 0.0) == pytest.approx(-10.0)
    assert at(torque, [twist, rate], -0.3, -1.0) == pytest.approx(-20.0)


BRIDGE = HBridge(supply=10.0, frequency=1e4, dead_time=1e-6, diode_drop=0.5)
LOST = (10.0 + 2 * 0.5) * 1e-6 * 1e4
STALL = ca.SX(10.0)


@pytest.mark.parametrize(
    ("asked", "current", "mean"),
    [
        (4.0, 3.0, 4.0 - LOST),  # driving: the dead time takes
        (4.0, -3.0, 4.0 + LOST),  # braking: it gives
        (-4.0, -3.0, -4.0 + LOST),
        (4.0, 0.0, 4.0),  # the ripple takes the current through zero: neither
        (25.0, 3.0, 10.0 - LOST),  # no more than the supply
        (0.5 * LOST, 3.0, 0.0),  # a pulse shorter than the dead time is none
    ],
)
def test_an_averaged_bridge_loses_what_its_dead_times_take(
    asked: float, current: float, mean: float
) -> None:
    voltage, i = ca.SX.sym("voltage"), ca.SX.sym("i")
    averaged = averaged_voltage(BRIDGE, voltage, i, ca.SX(1e-3), STALL)
    # The roundings of the two signs are below exp(-20) here.
    assert at(averaged, [voltage, i], asked, current) == pytest.approx(mean, abs=1e-8)


# ---------------------------------------------------------------------------------- pulses


@pytest.mark.parametrize("share", [0.0, 0.005, 0.02, 0.5, 0.98, 0.995, 1.0])
@pytest.mark.parametrize("current", [2.0, -2.0])
def test_the_mean_of_the_pulses_is_what_the_averaged_bridge_says(
    share: float, current: float
) -> None:
    edges = [*pulse(BRIDGE, share), (1 / BRIDGE.frequency, BridgeLeg.LOW)]
    spans = [later[0] - first[0] for first, later in pairwise(edges)]
    levels = [level(BRIDGE, leg, 1.0, current) for _, leg in edges[:-1]]
    mean = sum(span * value for span, value in zip(spans, levels, strict=True)) * BRIDGE.frequency
    assert sum(spans) == pytest.approx(1 / BRIDGE.frequency)
    assert min(spans) > 0.0
    voltage, i = ca.SX.sym("voltage"), ca.SX.sym("i")
    # Without ripple, as the current is held here.
    averaged = at(
        averaged_voltage(BRIDGE, voltage, i, ca.SX(1e9), STALL), [voltage, i], 10 * share, current
    )
    # A pulse or a pause shorter than the dead time keeps both transistors off for its own length
    # and one dead time; the averaged law does not know that, and errs by what a dead time weighs.
    exact = 0.01 < share < 0.99 or share in {0.0, 1.0}
    full = {0.0: 0.0, 1.0: 10.0}
    assert mean == pytest.approx(full.get(share, averaged), abs=1e-9 if exact else 2 * LOST)


def test_full_and_no_voltage_need_no_edges() -> None:
    assert pulse(BRIDGE, 0.0) == ((0.0, BridgeLeg.LOW),)
    assert pulse(BRIDGE, 1.0) == ((0.0, BridgeLeg.HIGH),)
    assert level(BRIDGE, BridgeLeg.NONE, 1.0, 0.0) == 0.0


# -------------------------------------------------------------------------------- readings


def reader(sensors: Sensors | None, seed: int = 0) -> Encoders:
    """Return a reader of one coordinate every millisecond."""
    return Encoders(sensors, Controller(period=1e-3), 1, np.random.default_rng(seed))


def test_without_sensors_the_state_itself_is_read() -> None:
    x = np.array([0.1234, 5.0, -1.0])
    assert reader(None).read(x) is x


def test_encoders_give_whole_steps_and_rates_are_their_differences() -> None:
    step = 0.01
    machine = reader(Sensors(resolution=step))
    first = machine.read(np.array([0.1249, 5.0, -1.0]))
    later = machine.read(np.array([0.1351, 5.0, -1.0]))
    assert first.tolist() == pytest.approx([0.12, 5.0, -1.0])
    assert later.tolist() == pytest.approx([0.14, (0.14 - 0.12) / 1e-3, -1.0])


def test_the_filter_of_a_ramp_comes_to_its_slope_as_a_low_pass_does() -> None:
    tau, slope = 5e-3, 3.0
    machine = reader(Sensors(filter_time=tau))
    readings = [machine.read(np.array([slope * k * 1e-3, 0.0, 0.0])) for k in range(21)]
    # The first rate is that of the state, 0 here; each difference then counts 1 - exp(-T/tau).
    assert readings[20][1] == pytest.approx(slope * (1 - math.exp(-20e-3 / tau)), rel=1e-12)


def test_noise_comes_from_its_seed() -> None:
    noisy = Sensors(noise=0.1, current_noise=0.5)
    x = np.zeros(3)
    one, same, other = (reader(noisy, seed).read(x)[0] for seed in (1, 1, 2))
    assert one == same != other
    assert reader(noisy).currents(np.zeros(2)).shape == (2,)
    draws = np.array([machine.read(x)[0] for machine in [reader(noisy)] for _ in range(4000)])
    # Standard error of a standard deviation from n draws: 1 / sqrt(2 n), here 1.1 %; four of them.
    assert np.std(draws) == pytest.approx(0.1, rel=4 / math.sqrt(2 * 4000))


def test_an_event_of_a_parabola_is_read_exactly_between_two_readings() -> None:
    arc = ArcReadings(0.02, 1)
    for k in range(101):
        time = k * 1e-3
        arc.add(time, np.array([0.3 + 2.0 * time - 40.0 * time**2, 0.0, 7.0]))
    known = arc.estimate(0.1004, np.array([9.0, 9.0, 7.0]))
    exact = [0.3 + 2.0 * 0.1004 - 40.0 * 0.1004**2, 2.0 - 80.0 * 0.1004, 7.0]
    assert known == pytest.approx(exact, rel=1e-10)
    # Readings before a jump would bend the parabola: they are dropped, and three are no fit.
    arc.clear()
    for k in range(3):
        arc.add(0.2 + k * 1e-3, np.array([1.0, 0.0, 0.0]))
    last = np.array([0.5, -1.0, 0.0])
    assert arc.estimate(0.2025, last) is last
    assert not arc.fits(0.2025)
    assert ArcReadings(0.0, 1).fits(0.0)


def test_the_error_of_a_rate_falls_with_the_readings_as_least_squares_says() -> None:
    n, sigma, spacing = 60, 1e-3, 1e-3
    random = np.random.default_rng(2)

    def rate() -> float:
        arc = ArcReadings(n * spacing, 1)
        for k, error in enumerate(random.normal(0.0, sigma, n)):
            arc.add((k - n + 1) * spacing, np.array([error, 0.0]))
        return float(arc.estimate(0.0, np.zeros(2))[1])

    # Slope of a parabola at its end, exactly: (X'X)^-1 of 1, t, t^2 at t = 1 - n, ..., 0.
    times = np.arange(1 - n, 1) * spacing
    powers = np.vander(times, 3, increasing=True)
    exact = sigma * math.sqrt(float(np.linalg.inv(powers.T @ powers)[1, 1]))
    assert exact == pytest.approx(math.sqrt(192 / n**3) * sigma / spacing, rel=0.1)
    found = np.std([rate() for _ in range(1000)])
    assert found == pytest.approx(exact, rel=4 / math.sqrt(2 * 1000))


# --------------------------------------------------------------------------------- numbers


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: Contact(stiffness=0.0), "stiffness"),
        (lambda: Contact(exponent=0.5), "exponent"),
        (lambda: Contact(slowest=0.0), "slowest"),
        (lambda: Friction(coulomb=-1.0), "coulomb"),
        (lambda: Friction(viscous=-1.0), "viscous"),
        (lambda: Gear(rotor_inertia=0.0), "rotor_inertia"),
        (lambda: Gear(rotor_inertia=1.0, play=-0.1), "play"),
        (lambda: HBridge(supply=-12.0), "supply"),
        (lambda: HBridge(supply=12.0, dead_time=3e-5), "dead_time"),
        (lambda: HBridge(supply=math.nan), "supply"),
        (lambda: Controller(period=0.0), "period"),
        (lambda: Controller(period=1e-3, delay=-1e-3), "delay"),
        (lambda: Sensors(resolution=-1.0), "resolution"),
        (lambda: Sensors(window=-0.01), "window"),
        (lambda: Sensors(window=math.inf), "window"),
        (lambda: Rig(sensors=Sensors()), "controller"),
        (
            lambda: Rig(controller=Controller(period=1e-3), sensors=Sensors(window=0.003)),
            "sensors.window",
        ),
    ],
)
def test_a_number_out_of_its_range_is_refused_by_name(make: object, name: str) -> None:
    with pytest.raises(InputError, match=f"^Argument `{name}` must .*, but .*[.]$"):
        make()  # type: ignore[operator]


def test_numbers_of_a_rig_are_changed_by_name_and_parts_are_added() -> None:
    rig = Rig(friction={"a": Friction(coulomb=1.0)}, gears={1: Gear(rotor_inertia=2.0)})
    changed = rig_with_numbers(
        rig,
        {
            "contact.stiffness": 7.0,
            "friction.a.viscous": 3.0,
            "friction.b.coulomb": 4.0,
            "gears.1.play": 0.1,
            "controller.period": 0.01,
        },
    )
    assert changed.contact == replace(rig.contact, stiffness=7.0)
    assert changed.friction == {"a": Friction(coulomb=1.0, viscous=3.0), "b": Friction(coulomb=4.0)}
    assert changed.gears == {1: Gear(rotor_inertia=2.0, play=0.1)}
    assert changed.controller == Controller(period=0.01)
    assert hash(changed) != hash(rig)
    assert hash(rig_with_numbers(rig, {})) == hash(rig)
    assert rig.contact == Contact()
    two = {"a": Friction(coulomb=1.0), "b": Friction()}
    turned = {name: two[name] for name in ("b", "a")}
    assert Rig(friction=two) == Rig(friction=turned)
    assert hash(Rig(friction=two)) == hash(Rig(friction=turned))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("spring.stiffness", "Known: contact, bridge, controller, sensors"),
        ("contact.softness", "Known: contact.stiffness, contact.exponent"),
        ("contact.a.stiffness", "Known: contact.stiffness"),
        ("friction.coulomb", "Known: friction.COORDINATE.coulomb"),
        ("gears.one.play", "must be a number in `gears.MOTOR.NAME`, but it is `one`"),
        ("gears.1.play", "`gears.1.rotor_inertia` must be given for a part that is added"),
    ],
)
def test_a_number_that_no_part_has_is_refused_with_those_that_there_are(
    name: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        rig_with_numbers(Rig(), {name: 1.0})


def test_without_its_controller_a_machine_has_no_sensors_either() -> None:
    rig = Rig(controller=Controller(period=1e-3), sensors=Sensors(), friction={"a": Friction()})
    assert without_parts(rig, ["controller"]) == replace(rig, controller=None, sensors=None)
    assert without_parts(rig, ["friction"]).friction == {}


FINE = RigSettings(tolerance=Tolerance(relative=1e-12, absolute=1e-14))


# -------------------------------------------------------------------- friction, gears, bridges


@pytest.mark.slow
def test_teeth_give_back_what_their_loss_leaves() -> None:
    """Without a motor's torque the impact of the teeth is the contact law of the stop once more."""
    rotor, joint, loss, slip = 0.015, INERTIA - 0.015, 0.5, 1.5
    gear = Gear(rotor_inertia=rotor, play=0.02, stiffness=4000.0, loss=loss)
    values = DISC.values(parameters={"K": 1e-12})
    # Dry friction holds nothing here: the joint is stopped by hand, by starting it at rest and the
    # rotor through a current that has gone before it touches.
    from zeno_orbits.experiment.rig.machine import machine

    built = machine(DISC, Rig(gears={1: gear}))
    p = np.array(values.vector)
    numbers = np.concatenate([p, [0.0], [0.0]])

    def rate(_t: float, y: Vector) -> Vector:
        return np.array(built.mode().rate(y, numbers)).ravel()

    motion = solve_ivp(
        rate,
        (0.0, 0.05),
        (0.0, 0.0, 0.0, 0.0, slip),
        method="DOP853",
        rtol=1e-11,
        atol=1e-13,
        max_step=2e-4,
    )
    touched = motion.y[3] - motion.y[0] > 0.01
    after = motion.y[:, np.argmax(touched) + np.argmin(touched[np.argmax(touched) :])]
    e = effective_restitution(loss * slip)
    assert after[4] - after[1] == pytest.approx(-e * slip, rel=1e-6)
    assert rotor * after[4] + joint * after[1] == pytest.approx(rotor * slip, rel=1e-9)


# ---------------------------------------------------------------------- near an orbit of the model


@pytest.mark.slow
def test_each_further_contact_of_the_chatter_adds_its_length(
    problem: Problem, orbit: Orbit
) -> None:
    """Theory (6.6), without a fitted number, between one stiffness and the next by 1/e^2."""
    e, curve = 0.2, orbit_curve(orbit, problem, n_per_arc=50)
    scaled: list[float] = []
    for k in (1e7, 1e7 / e**2):
        rig = Rig(contact=Contact(stiffness=k))
        settled = settle_rig(orbit, problem, rig, cycles=1, settle=6, settings=FINE)
        scaled.append(orbit_distance(orbit, problem, curve, settled).lock_time * math.sqrt(k))
    lasting, left = spring_contact(e, 0.0)
    load = 1e-4
    slower = (left - spring_contact(e, load)[1]) / (load * lasting)
    hand = load_reference(problem).dynamics(orbit.values(problem))
    inertia = hand.normal_inertia(np.array(problem.state_vector(orbit.zeno_state)))
    expected = lasting * math.sqrt(inertia) * (1 - 2 * slower / (1 - e))
    # The next terms are smaller by the length of a contact over that of the first flights, 1e-3 at
    # the softer of the two; the bracket is a quarter of what it is the difference of.
    assert scaled[1] - scaled[0] == pytest.approx(expected, rel=0.02)


def test_a_drift_is_the_change_along_the_line_and_noise_makes_none() -> None:
    line = 3.0 + 0.5 * np.arange(5.0)
    assert drift(line) == pytest.approx((2.0, 0.0), abs=1e-13)
    noise = np.random.default_rng(0).normal(size=(2000, 6))
    taken_for_drift = sum(abs(change) > chance for change, chance in map(drift, noise))
    # Expected are 0.2 of 2000; four or more have a probability of 1e-4.
    assert taken_for_drift < 4
    drifts = noise + 30.0 * np.linspace(0.0, 1.0, 6)
    assert sum(abs(change) > chance for change, chance in map(drift, drifts)) > 1500
    # Numbers that go to and fro have no trend, however far they go.
    change, chance = drift(np.array([1.0, -1.0, 1.0, -1.0, 1.0]))
    assert abs(change) < chance


def test_distances_from_a_line_are_those_of_its_sides() -> None:
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    curve = OrbitCurve(times=np.arange(5.0), states=square, ranges=np.array([1.0, 1.0]))
    points = np.array([[0.5, 0.2], [0.5, -0.3], [2.0, 2.0], [1.0, 0.4], [0.0, 0.0]])
    # Posts stand 3e-4 apart; the side itself is found, so the distances are exact.
    assert curve.distances(points) == pytest.approx([0.2, 0.3, math.sqrt(2), 0.0, 0.0], abs=1e-15)
    stretched = replace(curve, ranges=np.array([1.0, 2.0]))
    assert stretched.distances(points)[1] == pytest.approx(0.15, abs=1e-15)


def test_an_orbit_lies_on_its_own_line(problem: Problem, orbit: Orbit) -> None:
    coarse, fine = (orbit_curve(orbit, problem, n_per_arc=n) for n in (1500, 2100))
    # Chords of 3e-4 of the size, and what is left out of flights shorter than that.
    assert np.max(fine.distances(coarse.states)) < 3e-4


# ------------------------------------------------------------------------------- any other problem
