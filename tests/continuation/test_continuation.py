"""Families of Zeno orbits: special points and ends against truths that were found otherwise."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.closed_forms import StoppedOscillator
from tests.reference.reference_orbit import PERIOD, RELEASE
from tests.support.releases import closed_at_release
from tests.support.returns import next_release, release_section
from zeno_orbits import HybridLagrangian, full_drive, hybrid_system
from zeno_orbits.continuation import (
    ContinuationSettings,
    Family,
    FamilySteps,
    SecondParameter,
    SpecialCurve,
    SpecialPointKind,
    family_of_orbit,
    orbit_amplitude,
    start_orbit,
)
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import HybridDynamics, bind, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import event_orbit_of, orbit_by_shooting
from zeno_orbits.simulation import SimulationSettings, simulate

PENDULUM = load_problem("motor_pendulum")
OSCILLATOR = load_problem("forced_oscillator")
SCALE = np.array([1.0, 1.0, 10.0, 10.0, 2.0])
SETTINGS = SimulationSettings()
MACHINES = Path(__file__).parents[1] / "support" / "machines"
COARSE = ContinuationSettings(steps=FamilySteps(first=0.05, longest=0.1))


def pendulum(**numbers: float) -> HybridDynamics:
    gains = {name: numbers.pop(name) for name in ("Kp", "Kd") if name in numbers}
    values = PENDULUM.values(gains=gains, parameters=numbers)
    return PENDULUM.dynamics(values)


@cache
def pendulum_orbit(**numbers: float) -> Orbit:
    gains = {name: numbers[name] for name in ("Kp", "Kd") if name in numbers}
    rest = {name: value for name, value in numbers.items() if name not in gains}
    return start_orbit(PENDULUM, PENDULUM.values(gains=gains, parameters=rest))


@cache
def oscillator_orbit(**numbers: float) -> Orbit:
    return start_orbit(OSCILLATOR, OSCILLATOR.values(parameters=numbers))


def only(continuation_families: tuple[Family, ...]) -> Family:
    (family,) = continuation_families
    return family


@pytest.mark.slow
def test_the_forced_oscillator_loses_its_release_where_the_force_just_reaches_the_stop() -> None:
    # The stop lets go where A cos t < stop, which happens at all for A > 0.8 only.
    orbit = oscillator_orbit()
    family = only(family_of_orbit(OSCILLATOR, orbit, "A", (0.5, 1.2), settings=COARSE).families)
    assert family.first.kind is SpecialPointKind.RELEASE_LOST
    assert family.first.at.value == pytest.approx(0.8, abs=1e-9)
    assert abs(family.first.at.value - 0.8) < 10 * family.first.error < 1e-9
    assert family.last.kind is SpecialPointKind.BOUND
    for point in family.points:
        # In closed form: released at arccos(stop / A), whatever else.
        assert point.state["cosine"] == pytest.approx(-0.8 / point.value, abs=1e-11)
        assert point.period == pytest.approx(2 * math.pi, abs=1e-9)


def still_locks(stop: float) -> bool:
    """Return True if the oscillator's impacts accumulate before the stop would let go again."""
    oscillator = StoppedOscillator(damping=1.9, stop=stop, restitution=0.5)
    deadline = oscillator.release_time + 2 * math.pi
    time, approach = oscillator.next_impact(oscillator.release_time, 0.0)
    while approach > 1e-14:
        if time > deadline or math.cos(time) < stop:
            return False
        speed = oscillator.restitution * approach
        # The flight is over before the stop lets go, or the mass is gone.
        acceleration = math.cos(time) - oscillator.damping * -speed - stop
        if acceleration <= 0.0:
            return False
        try:
            duration, approach = oscillator.short_flight(time, speed)
        except (OverflowError, ZeroDivisionError):
            return False
        if not (0.0 < duration < deadline - time and approach > 0.0):
            return False
        time += duration
    return True


@pytest.mark.slow
def test_the_locked_arc_of_the_forced_oscillator_vanishes_where_the_closed_form_says() -> None:
    orbit, box = oscillator_orbit(), (-0.9, 0.2)
    family = only(family_of_orbit(OSCILLATOR, orbit, "stop", box, settings=COARSE).families)
    low, high = 0.05, 0.15
    assert still_locks(low)
    assert not still_locks(high)
    for _ in range(45):
        middle = (low + high) / 2
        low, high = (middle, high) if still_locks(middle) else (low, middle)
    assert family.last.kind is SpecialPointKind.LOCK_VANISHES
    assert family.last.at.value == pytest.approx(low, abs=1e-9)
    assert abs(family.last.at.value - low) < 10 * family.last.error < 1e-8


@pytest.mark.slow
def test_a_locked_arc_that_vanishes_after_a_few_impacts_is_found_by_later_ones() -> None:
    # Cut after two impacts, the sequence is on the separatrix far beyond the end.
    buzzer = zo.load_problem(Path(__file__).parents[1] / "support" / "machines" / "buzzer.py")
    orbit = orbit_by_shooting(buzzer, buzzer.values()).unwrap()
    family = only(family_of_orbit(buzzer, orbit, "omega", (15.0, 25.0)).families)
    assert family.last.kind is SpecialPointKind.LOCK_VANISHES
    assert family.last.error < 1e-7
    low, high = 24.0, 24.5
    for _ in range(22):
        middle = (low + high) / 2
        dynamics = buzzer.dynamics(buzzer.values(parameters={"omega": middle}))
        run = simulate(dynamics, buzzer.state_vector(buzzer.starts[0]), until=40.0 / middle * 6.0)
        # Twenty turns of the clock, then as many in which it locks every time or never.
        locks = any(point.time > 0.5 * run.end_time for point in run.zeno_points)
        low, high = (middle, high) if locks else (low, middle)
    assert family.last.at.value == pytest.approx(low, abs=high - low + family.last.error)


@pytest.mark.slow
def test_the_family_in_the_restitution_ends_where_simulations_stop_closing() -> None:
    orbit = pendulum_orbit(restitution=0.4)
    family = only(family_of_orbit(PENDULUM, orbit, "restitution", (0.0, 0.5)).families)
    assert family.first.kind is SpecialPointKind.BOUND
    # Not a rounding error below it, where no restitution is.
    assert family.first.at.value == 0.0
    assert family.last.kind is SpecialPointKind.LOCK_VANISHES
    assert family.last.error < 1e-8
    low, high = 0.41, 0.42
    x = np.array(list(orbit.release_state.values()))
    while high - low > 1e-9:
        middle = (low + high) / 2
        try:
            machine = PENDULUM.graph_dynamics(PENDULUM.values(parameters={"restitution": middle}))
            found = closed_at_release(machine, x, period=1.8, settings=SETTINGS)
        except SimulationError:
            high = middle
        else:
            low, x = middle, found.end
    # Close to the end a return may fail to be resolved a little early: a lock of 1e-6 s is none.
    assert low - 1e-9 < family.last.at.value < high + 3e-9


@pytest.mark.slow
def test_close_to_the_end_of_the_locked_arc_the_family_is_right_to_many_digits() -> None:
    from tests.reference.many_digits.fixed_point import extended_orbit

    # Where 1e-5 of the restitution is left, and some milliseconds of the lock.
    orbit, value = pendulum_orbit(restitution=0.41), 0.41678
    point = only(family_of_orbit(PENDULUM, orbit, "restitution", (0.4, value)).families).points[-1]
    assert point.margins["contact duration"] < 2e-3
    values = PENDULUM.values(parameters={"restitution": value})
    exact = extended_orbit(PENDULUM, values, list(point.state.values()), digits=15)
    assert point.period == pytest.approx(float(exact.period), abs=1e-10)
    for one, other in zip(point.state.values(), exact.release_state, strict=True):
        assert one == pytest.approx(float(other), abs=1e-9)


@pytest.mark.slow
def test_periods_of_the_family_in_the_restitution_are_those_measured_beforehand() -> None:
    orbit = pendulum_orbit(restitution=0.1)
    box = (0.0, 0.1)
    family = only(family_of_orbit(PENDULUM, orbit, "restitution", box, settings=COARSE).families)
    assert family.points[0].period == pytest.approx(1.82033892548, abs=1e-10)
    assert family.points[-1].period == pytest.approx(1.81767797277, abs=1e-10)


@pytest.mark.slow
def test_at_the_fold_in_the_damping_gain_differences_have_a_multiplier_of_one() -> None:
    orbit = pendulum_orbit(Kd=-1.6)
    family = only(family_of_orbit(PENDULUM, orbit, "Kd", (-1.7, -1.55)).families)
    (fold,) = family.special
    assert fold.kind is SpecialPointKind.FOLD
    assert fold.error < 1e-10
    dynamics = pendulum(Kd=fold.at.value)
    x = np.array(list(fold.at.state.values()))
    _, end = next_release(dynamics, x, guess=PERIOD)
    assert np.max(np.abs(end - x) / SCALE) < 1e-9
    inside = [p for p in family.points if abs(p.value + 1.6) < 0.02]
    assert {p.stable for p in inside} == {True, False}
    section, width = release_section(dynamics, x, SCALE), 1e-5
    columns: list[np.ndarray] = []
    for k in range(section.dimension):
        sides = [section.state(dynamics, sign * width * np.eye(2)[k]) for sign in (1, -1)]
        ends = [next_release(dynamics, y, guess=PERIOD)[1] for y in sides]
        columns.append(section.coordinates(ends[0]) - section.coordinates(ends[1]))
    values = np.linalg.eigvals(np.stack(columns, axis=1) / (2 * width))
    # Rounding of a return, 1e-12, over the width; and its square by the curvature.
    assert np.min(np.abs(values - 1)) < 1e-6


def linear_growth(kd: float) -> float:
    """Return the factor by which a return of the linearized pendulum grows its state.

    The mechanism is written anew to second order about the hanging position: constant inertia,
    quadratic potential. Its return map is homogeneous, so one factor says it all.
    """
    values = PENDULUM.values(gains={"Kd": kd})
    n = {**values.gains, **values.parameters}
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    rate1, rate2 = v[0], v[0] + v[1]
    inertia = n["I1"] + n["J_rotor"] + n["m1"] * n["lc1"] ** 2
    tip = n["L1"] * rate1 + n["lc2"] * rate2
    kinetic = (inertia * rate1**2 + n["m2"] * tip**2 + n["I2"] * rate2**2) / 2
    stiff1 = n["g"] * (n["m1"] * n["lc1"] + n["m2"] * n["L1"])
    stiff2 = n["g"] * n["m2"] * n["lc2"]
    potential = (stiff1 * q[0] ** 2 + stiff2 * (q[0] + q[1]) ** 2) / 2
    mechanism = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=kinetic, potential=potential, gap=q[1]
    )
    from zeno_orbits import MotorBank
    from zeno_orbits.model import compile_system

    motor = MotorBank(
        selection=ca.SX([1, 0]),
        resistance=ca.SX(n["R"]),
        inductance=ca.SX(n["L"]),
        torque_constant=ca.SX(n["K_torque"]),
        emf_constant=ca.SX(n["K_emf"]),
        voltage=-n["Kp"] * q[0] - kd * v[0],
    )
    system = hybrid_system(mechanism, full_drive(mechanism, motor), ca.SX(n["restitution"]))
    dynamics = bind(compile_system(system, {}, PENDULUM.state_names), [])
    x, growth = np.array([0.02, 0.0, -0.5, 0.0, -0.2]), 0.0
    x = projected_release(dynamics, x)
    for _ in range(6):
        _, end = next_release(dynamics, x, guess=PERIOD)
        size = float(np.linalg.norm(end))
        growth = size / float(np.linalg.norm(x))
        x = end / size
    return growth


def projected_release(dynamics: HybridDynamics, x: np.ndarray) -> np.ndarray:
    """Return a release state of a linear system: the multiplier is linear in the current."""
    at_zero = x.copy()
    at_zero[-1] = 0.0
    slope = dynamics.multiplier(np.array([0.0, 0.0, 0.0, 0.0, 1.0]))
    at_zero[-1] = -dynamics.multiplier(at_zero) / slope
    return at_zero


@pytest.mark.slow
def test_the_amplitude_vanishes_where_the_linearized_pendulum_neither_grows_nor_shrinks() -> None:
    orbit = pendulum_orbit(Kd=-0.3)
    family = only(family_of_orbit(PENDULUM, orbit, "Kd", (-0.35, 0.0)).families)
    assert family.last.kind is SpecialPointKind.AMPLITUDE_ZERO
    assert family.last.error < 1e-8
    value, step = family.last.at.value, 1e-3
    slope = (linear_growth(value + step) - linear_growth(value - step)) / (2 * step)
    assert (linear_growth(value) - 1) / slope == pytest.approx(0.0, abs=1e-8)


@pytest.mark.slow
def test_a_boundary_in_two_parameters_is_where_the_closed_form_says() -> None:
    # The release is lost on the line A = -stop.
    second = SecondParameter(
        name="stop", box=(-0.82, -0.78), kinds=(SpecialPointKind.RELEASE_LOST,)
    )
    found = family_of_orbit(OSCILLATOR, oscillator_orbit(), "A", (0.7, 1.1), second=second)
    (boundary,) = found.boundaries
    assert boundary.names == ("A", "stop")
    sums = np.array(boundary.x) + np.array(boundary.y)
    assert np.max(np.abs(sums)) < 1e-8
    assert min(boundary.y) == pytest.approx(-0.82, abs=1e-6)
    assert max(boundary.y) == pytest.approx(-0.78, abs=1e-6)
    assert boundary.ends == (SpecialPointKind.BOUND.value, SpecialPointKind.BOUND.value)
    assert isinstance(boundary, SpecialCurve)
    assert boundary.as_json()["name"] == "release not transversal"


@pytest.mark.parametrize(
    ("parameter", "box", "reason"),
    [
        ("stiffness", (0.0, 1.0), "unknown parameter `stiffness`. Known: Kp, Kd"),
        ("Kd", (0.0, -2.0), "must have finite bounds LOWER < UPPER for `Kd`"),
        ("Kd", (-0.9, 0.0), "must contain the value of the orbit"),
        ("restitution", (0.0, 1.5), "must lie in"),
    ],
)
def test_a_range_that_is_none_is_refused(
    parameter: str, box: tuple[float, float], reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        family_of_orbit(PENDULUM, pendulum_orbit(), parameter, box)


def test_an_orbit_of_another_problem_and_one_that_does_not_close_are_refused() -> None:
    with pytest.raises(InputError, match="must be of problem `motor_pendulum`"):
        family_of_orbit(PENDULUM, oscillator_orbit(), "Kd", (-2.0, 0.0))
    closing = orbit_by_shooting(PENDULUM, PENDULUM.values())
    orbit = closing.unwrap()
    values = PENDULUM.values()
    graph = PENDULUM.graph_dynamics(values)
    found = closed_at_release(graph, np.array(RELEASE), period=1.8, settings=SETTINGS)
    again = event_orbit_of(PENDULUM, values, found)
    assert again.period == pytest.approx(orbit.period, abs=1e-10)


@pytest.mark.slow
def test_derived_numbers_are_held_when_another_one_changes() -> None:
    orbit = pendulum_orbit()
    box = (0.198, 0.202)
    family = only(family_of_orbit(PENDULUM, orbit, "L1", box, settings=COARSE).families)
    assert family.parameters["J_rotor"] == orbit.parameters["J_rotor"]
    # Calibrated anew the pendulum would be another one, with another orbit.
    follow = PENDULUM.values(parameters={"L1": 0.202})
    held = PENDULUM.values(
        parameters={**orbit.parameters, "L1": 0.202},
    )
    assert follow.parameters["J_rotor"] != held.parameters["J_rotor"]
    x = np.array(list(family.points[-1].state.values()))
    dynamics = PENDULUM.dynamics(held)
    time, end = next_release(dynamics, x, guess=PERIOD)
    assert np.max(np.abs(end - x) / SCALE) < 1e-9
    assert time == pytest.approx(family.points[-1].period, abs=1e-9)


@pytest.mark.weekly
@pytest.mark.slow
def test_the_pendulum_doubles_its_period_between_two_flips() -> None:
    orbit = pendulum_orbit(Kp=4.3, Kd=-1.35)
    found = family_of_orbit(PENDULUM, orbit, "Kd", (-1.7, -1.3))
    family, *doubled = found.families
    flips = [point for point in family.special if point.kind is SpecialPointKind.FLIP]
    assert [one.n_returns for one in doubled] == [2, 2]
    assert {one.last.kind for one in doubled} == {SpecialPointKind.REJOINS}
    low, high = sorted(point.at.value for point in flips)
    for flip in flips:
        # Half of a small displacement along the multiplier's direction comes back reversed.
        dynamics = pendulum(Kp=4.3, Kd=flip.at.value)
        x = np.array(PENDULUM.state_vector(flip.at.state))
        section = release_section(dynamics, x, SCALE)
        away = 1e-5

        def image(y: np.ndarray, section=section, dynamics=dynamics) -> np.ndarray:
            start = section.state(dynamics, y)
            return section.coordinates(next_release(dynamics, start, guess=PERIOD)[1])

        columns = [(image(away * e) - image(-away * e)) / (2 * away) for e in np.eye(2)]
        values = np.linalg.eigvals(np.stack(columns, axis=1))
        # Central differences err by the square of the displacement.
        assert float(np.min(np.abs(values + 1))) < 1e-5
    for one in doubled:
        # A branch starts one step beside its flip, and ends a step before the other.
        assert low - 1e-9 <= min(point.value for point in one.points) < low + 1e-3
        assert high - 1e-3 < max(point.value for point in one.points) <= high + 1e-9
        middle = one.points[len(one.points) // 2]
        dynamics = pendulum(Kp=4.3, Kd=middle.value)
        x = np.array(PENDULUM.state_vector(middle.state))
        _, once = next_release(dynamics, x, guess=PERIOD)
        _, twice = next_release(dynamics, once, guess=PERIOD)
        assert twice == pytest.approx(x, abs=1e-7)
        assert np.max(np.abs(once - x)) > 1e-2


def test_the_amplitude_of_a_point_is_half_the_travel_of_the_state_that_the_problem_names() -> None:
    orbit = oscillator_orbit()
    settings = ContinuationSettings(steps=FamilySteps(first=0.2, longest=0.4, most=1))
    family = only(family_of_orbit(OSCILLATOR, orbit, "A", (0.5, 1.5), settings=settings).families)
    point = next(point for point in family.points if point.value == pytest.approx(1.0, abs=1e-12))
    # In closed form: the first flight goes farthest from the stop.
    motion = StoppedOscillator(damping=1.9, stop=-0.8, restitution=0.5)
    start, (end, _) = motion.release_time, motion.next_impact(motion.release_time, 0.0)
    farthest = max(
        motion.stop - motion.motion(float(time), start, 0.0)[0]
        for time in np.linspace(start, end, 4001)
    )
    assert orbit_amplitude(OSCILLATOR, family, point) == pytest.approx(farthest / 2, rel=1e-6)


@pytest.mark.slow
def test_a_family_whose_section_is_a_point_ends_where_the_motion_jumps() -> None:
    """Every motion of the juggler is released at one phase: it returns there after 5 turns or 6."""
    juggler = zo.load_problem(MACHINES / "juggler.py")
    turn = 2 * math.pi / juggler.values().parameters["omega"]

    def orbit_at(amplitude: float) -> Orbit | None:
        return zo.find_orbit_by_shooting(juggler, parameters={"A": amplitude}).orbit

    start = orbit_at(0.11)
    assert start is not None
    (family,) = zo.continue_orbit(start, ("A", 0.09, 0.13), problem=juggler).families
    assert [end.kind for end in (family.first, family.last)] == [SpecialPointKind.LOCK_VANISHES] * 2
    low, high = family.first.at.value, family.last.at.value
    assert low < 0.11 < high
    assert all(abs(point.period / turn - 5) < 1e-9 for point in family.points)
    for amplitude in (*np.linspace(low, high, 12)[1:-1], low - 1e-6, high + 1e-6):
        found = orbit_at(float(amplitude))
        five = found is not None and abs(found.period / turn - 5) < 1e-6
        assert five == (low < amplitude < high)
