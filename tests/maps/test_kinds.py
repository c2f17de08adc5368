"""Kinds of attractors: periods in turns of the clock, chaos, growth, against exact flights."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Mapping

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.linear_flights import TURN, Flights, Oscillator, flights, repeats
from tests.support.commands import YES, ask
from tests.support.mechanisms import oscillator
from zeno_orbits.maps import Attractor, AttractorClass, attractors_at
from zeno_orbits.model import load_problem
from zeno_orbits.simulation import AttractorKind

FORCED = load_problem("forced_oscillator")
START = {"speed": 1.0, "cosine": 1.0}
CHAOTIC = Oscillator(c=0.15, stop=-0.044, restitution=0.77, omega=5.423, amplitude=1.9425)


def found_at(machine: Oscillator) -> Attractor:
    """Return the attractor that a map names."""
    parameters = {
        "c": machine.c,
        "stop": machine.stop,
        "restitution": machine.restitution,
        "omega": machine.omega,
        "A": machine.amplitude,
    }
    (found,) = attractors_at(FORCED, [FORCED.values(parameters=parameters)], start=START)
    return found


def exponent_of(seen: Flights) -> float:
    """Return the largest Lyapunov exponent by the tangents of exact flights [1/s]."""
    (first, before), (last, after) = seen.marks[len(seen.marks) // 10], seen.marks[-1]
    return (after - before) / (last - first)


def machine_of(drawn: random.Random) -> Oscillator:
    """Return a random machine."""
    return Oscillator(
        c=drawn.uniform(0.02, 0.4),
        stop=drawn.uniform(-0.3, 0.5),
        restitution=drawn.uniform(0.1, 0.8),
        omega=drawn.uniform(0.8, 4.0),
        amplitude=drawn.uniform(0.5, 2.0),
    )


def agrees(machine: Oscillator, found: Attractor, turns: int) -> bool | None:
    """Return whether a map names what exact flights do; None where these have not settled."""
    seen = flights(machine, 0.0, 1.0, turns * TURN / machine.omega)
    late = [time for time, *_ in seen.impacts if time > 0.7 * turns * TURN / machine.omega]
    if len(late) < 5:
        return found.kind is AttractorKind.REPEATS
    truth = repeats(machine, seen)
    if truth is None:
        return True if found.kind is AttractorKind.CHAOTIC else None
    _, period, held = truth
    fate = AttractorClass.ZENO if held else AttractorClass.NO_ZENO
    return (found.kind, found.turns, found.fate) == (AttractorKind.REPEATS, period, fate)


@pytest.mark.slow
def test_random_machines_have_the_periods_of_exact_flights() -> None:
    drawn = random.Random(3)
    machines = [machine_of(drawn) for _ in range(4)]
    answers = [agrees(one, found_at(one), 300) for one in machines]
    assert False not in answers
    assert answers.count(True) >= 3


@pytest.mark.slow
def test_thirty_random_machines_have_the_kinds_of_exact_flights() -> None:
    drawn = random.Random(5)
    machines = [machine_of(drawn) for _ in range(30)]
    answers = [agrees(one, found_at(one), 1500) for one in machines]
    assert False not in answers
    assert answers.count(True) >= 27


@pytest.mark.slow
def test_a_chaotic_motion_has_the_exponent_of_the_tangents_of_exact_flights() -> None:
    found = found_at(CHAOTIC)
    seen = flights(CHAOTIC, 0.0, 1.0, 400 * TURN / CHAOTIC.omega)
    assert repeats(CHAOTIC, seen) is None
    # Three standard deviations, and the error of the truth over 360 turns.
    assert abs(found.exponent - exponent_of(seen)) < found.exponent_error + 0.05


@pytest.mark.slow
def test_a_bounded_motion_without_a_period_is_chaotic_and_does_not_grow() -> None:
    found = found_at(CHAOTIC)
    assert (found.fate, found.kind) == (AttractorClass.UNSETTLED, AttractorKind.CHAOTIC)
    assert found.phrase == "chaotic motion"
    assert 0.0 < found.exponent_error < found.exponent


def test_a_stable_orbit_has_the_exponent_of_its_largest_multiplier() -> None:
    # Without a Zeno point: the multipliers of a stable orbit are exp(exponent times period).
    machine = Oscillator(c=0.1, stop=1.0, restitution=0.8, omega=1.0, amplitude=1.0)
    found = found_at(machine)
    seen = flights(machine, 0.0, 1.0, 400 * TURN)
    truth = math.exp(exponent_of(seen) * found.period)
    # Bounded factors of the eigenvectors over 360 periods.
    assert found.spectral_radius == pytest.approx(truth, rel=0.01)


def test_a_motion_that_gains_by_every_cycle_grows() -> None:
    # Half a cycle gains exp(0.04 pi), and an impact takes a tenth: 1.02 together.
    pumped = oscillator(damping=-0.08)
    values = pumped.values(parameters={"restitution": 0.9})
    (found,) = attractors_at(pumped, [values], start={"x": 20.0}, until=150.0)
    assert (found.fate, found.kind) == (AttractorClass.UNSETTLED, AttractorKind.GROWS)
    assert found.phrase == "growing motion"


def test_a_motion_that_misses_its_stop_repeats_after_a_turn_of_the_clock() -> None:
    machine = Oscillator(c=0.3, stop=5.0, restitution=0.5, omega=2.0, amplitude=1.0)
    found = found_at(machine)
    assert (found.fate, found.turns) == (AttractorClass.NO_ZENO, 1)
    assert found.period == pytest.approx(TURN / 2.0, rel=1e-9)


def test_a_motion_that_leaves_its_stop_late_repeats_after_the_time_that_its_exponent_asks_for() -> (
    None
):
    # By hand: the steady oscillation has the amplitude 0.077, and the stop is at 0.1195. Light
    # damping: the last impact of the transient comes in the second half of the map's 300 turns.
    machine = Oscillator(
        c=0.051141332284229166,
        stop=0.1195194045552612,
        restitution=0.746064266722971,
        omega=3.8607004067581454,
        amplitude=1.0620545307524605,
    )
    amplitude = machine.amplitude / math.hypot(1 - machine.omega**2, machine.c * machine.omega)
    assert amplitude < machine.stop
    found = found_at(machine)
    assert (found.fate, found.turns) == (AttractorClass.NO_ZENO, 1)
    assert found.period == pytest.approx(TURN / machine.omega, rel=1e-9)


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("damping", [0.1, 0.2, 0.3, 0.4, 0.5])
def test_a_damped_motion_that_never_strikes_comes_to_rest(damping: float, named: bool) -> None:
    free = oscillator(damping=damping, named=named)
    (found,) = attractors_at(free, [free.values()], until=60.0 / damping)
    assert found.fate is AttractorClass.REST


@pytest.mark.parametrize("named", [False, True])
def test_a_motion_that_overflows_has_escaped(named: bool) -> None:
    # It grows as exp(0.95 t), beyond the largest number after 750 s.
    falling = oscillator(stiffness=-1.0, named=named)
    (found,) = attractors_at(falling, [falling.values()], until=2000.0)
    assert (found.fate, found.escaped) == (AttractorClass.ESCAPE, "x")


@pytest.mark.slow
def test_arcs_that_all_end_on_their_stop_show_no_escape() -> None:
    # The limit never acts: this is the motor pendulum, whose second link stays on its side.
    limited = load_problem("limited_pendulum")
    values = limited.values(parameters={"U": 100.0, "restitution": 0.45})
    for until in (3.0, 5.0, 8.0):
        (found,) = attractors_at(limited, [values], until=until)
        assert found.fate is not AttractorClass.ESCAPE


@pytest.mark.slow
def test_a_limit_that_never_acts_leaves_the_attractor() -> None:
    # Four impacts a period, after Zeno points whose impacts depend on the accuracy.
    found = [
        attractors_at(problem, [problem.values(parameters=numbers)])[0]
        for problem, numbers in (
            (load_problem("limited_pendulum"), {"U": 100.0, "restitution": 0.45}),
            (load_problem("motor_pendulum"), {"restitution": 0.45}),
        )
    ]
    assert [one.fate for one in found] == 2 * [AttractorClass.NO_ZENO]
    assert found[0].period == pytest.approx(found[1].period, rel=1e-10)
    assert found[0].multipliers[0] == pytest.approx(found[1].multipliers[0], abs=1e-5)


def two_frequencies() -> zo.Problem:
    """Return a ball on a table that a clock and an oscillator of another frequency shake."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        clock = zo.Clock.at(p["omega"])
        shaken = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=p["k"] * q[1] ** 2 / 2,
            gap=q[0],
            # The oscillator drives the ball, and nothing drives the oscillator.
            applied_force=ca.vertcat(-1.0 + 1.5 * clock.sine + 0.1 * q[1], 0.0),
            clock=clock,
        )
        return zo.hybrid_system(shaken, zo.no_drive(shaken), p["restitution"])

    return zo.Problem(
        name="two_frequencies",
        title="ball on a table with two frequencies",
        source="textbook",
        state_names=("height", "z", "speed", "dz", "cosine", "sine"),
        state_units=("m", "m", "m/s", "m/s", "1", "1"),
        parameters=(
            zo.Quantity.positive("omega", 1.0, "rad/s", "frequency of the clock"),
            zo.Quantity.positive("k", math.sqrt(2.0), "1/s^2", "stiffness"),
            zo.Quantity.restitution(0.3),
        ),
        gains=(),
        model=model,
        starts=({"cosine": 1.0, "z": 1.0},),
        portraits=(("height", "speed"),),
        amplitude_of="height",
    )


@pytest.mark.slow
def test_a_motion_with_two_frequencies_is_quasi_periodic() -> None:
    # The frequencies are 1 and 2^(1/4); the ball forgets all but their phases at every Zeno point.
    problem = two_frequencies()
    (found,) = attractors_at(problem, [problem.values()])
    assert (found.fate, found.kind) == (AttractorClass.UNSETTLED, AttractorKind.QUASI_PERIODIC)
    assert abs(found.exponent) < 1e-3
    assert found.phrase == "quasi-periodic motion"
    assert np.isnan(found.period)


def test_simulate_names_the_attractor_of_a_map() -> None:
    words = ("simulate", "vibrating_table", "--until", "1", "--settle")
    answer = ask(*words)
    assert answer.code == YES
    assert "Attractor: Zeno periodic orbit, period 1; period 0.20943951 s;" in answer.out
    values = load_problem("vibrating_table").values()
    (found,) = attractors_at(load_problem("vibrating_table"), [values])
    named = json.loads(ask(*words, "--json").out)["attractor"]
    # The start of a command and of a map is the problem's first.
    assert named == json.loads(json.dumps(found.as_json()))
