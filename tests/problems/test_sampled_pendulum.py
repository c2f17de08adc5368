"""The pendulum with a sampled controller: its orbit, an independent event loop, and the limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.event_loop import Contact, Machine, Reset, simulated

SAMPLES = 12
"""Samples in a period at the default sampling time."""


@cache
def _orbit() -> zo.Orbit:
    return zo.find_orbit("sampled_pendulum", until=25.0).unwrap()


def by_hand(p: Mapping[str, float], first_sample: float) -> Machine:
    """Return the machine in numbers, with samples counted in time."""
    a = p["I1"] + p["J_rotor"] + p["m1"] * p["lc1"] ** 2 + p["m2"] * p["L1"] ** 2
    b, c = p["I2"] + p["m2"] * p["lc2"] ** 2, p["m2"] * p["L1"] * p["lc2"]
    d, e = p["m1"] * p["lc1"] + p["m2"] * p["L1"], p["m2"] * p["lc2"]

    def mass(q: Any) -> np.ndarray:
        coupled = b + c * math.cos(q[1])
        return np.array([[a + b + 2 * c * math.cos(q[1]), coupled], [coupled, b]])

    def force(_t: float, q: Any, v: Any, z: Any, _branches: Any) -> np.ndarray:
        swirl = c * math.sin(q[1])
        lower = p["g"] * e * math.sin(q[0] + q[1])
        upper = p["g"] * d * math.sin(q[0])
        torque = p["K_torque"] * z[0]
        return np.array(
            [
                torque + swirl * (2 * v[0] + v[1]) * v[1] - upper - lower,
                -swirl * v[0] ** 2 - lower,
            ]
        )

    def rate(_t: float, _q: Any, v: Any, z: Any, _branches: Any) -> np.ndarray:
        return np.array([(z[1] - p["R"] * z[0] - p["K_emf"] * v[0]) / p["L"], 0.0])

    turn = 2 * math.pi / p["sampling"]
    sample = Reset(
        name="sample",
        guard=lambda t, _q, _v, _z: -math.sin(turn * (t - first_sample)),
        armed=lambda t, _q, _v, _z: math.cos(turn * (t - first_sample)),
        after=lambda _t, q, v, z: (q, v, np.array([z[0], -p["Kp"] * q[0] - p["Kd"] * v[0]])),
    )
    stop = Contact(
        name="stop",
        gap=lambda q: q[1],
        normal=lambda _: np.array([0.0, 1.0]),
        restitution=p["restitution"],
    )
    return Machine(n=2, mass=mass, force=force, rate=rate, contacts=(stop,), resets=(sample,))


@pytest.mark.slow
def test_a_sampled_pendulum_has_an_orbit_of_a_whole_number_of_samples() -> None:
    orbit = _orbit()
    assert orbit.certificate["passed"]
    assert orbit.certificate["stable"]
    assert orbit.period == pytest.approx(SAMPLES * orbit.parameters["sampling"], rel=1e-13)
    samples = [event.time for event in orbit.events if event.name == "switch sample"]
    assert len(samples) == SAMPLES
    assert np.diff(samples) == pytest.approx(orbit.parameters["sampling"], abs=1e-12)


@pytest.mark.slow
def test_an_independent_event_loop_returns_after_the_same_events() -> None:
    orbit = _orbit()
    samples = [event.time for event in orbit.events if event.name == "switch sample"]
    numbers = {**orbit.parameters, **orbit.gains}
    names = ("theta1", "theta2", "dtheta1", "dtheta2", "current", "held")
    start = [orbit.start_state[name] for name in names]
    machine = by_hand(numbers, samples[0])
    run = simulated(machine, start, orbit.period * (1 + 1e-9), closed=("stop",))
    assert run.refused is None
    assert run.unsure is None
    for kind, word in (("release", "release stop"), ("switch", "switch sample")):
        hand = [event.time for event in run.events if event.kind == kind]
        ours = [event.time for event in orbit.events if event.name == word]
        assert ours == pytest.approx(hand, abs=1e-9), word
    zeno = next(event for event in run.events if event.kind == "zeno")
    assert zeno.time == pytest.approx(orbit.period, abs=1e-9)
    assert zeno.after == pytest.approx(start, abs=1e-8)


def lagged(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return the pendulum with a first-order lag in place of the hold."""
    plain = zo.load_problem("motor_pendulum").model(p)
    held, motors = ca.SX.sym("held"), plain.drive.motors
    assert motors is not None
    motor = zo.full_drive(plain.mechanism, replace(motors, voltage=held))
    lag = zo.Auxiliary(states=held, rate=(motors.voltage - held) / p["lag"])
    return zo.hybrid_system(plain.mechanism, (motor, lag), p["restitution"])


@pytest.mark.slow
def test_the_period_exceeds_the_continuous_one_by_the_effect_of_half_a_sample() -> None:
    plain = zo.load_problem("motor_pendulum")
    problem = replace(
        plain,
        name="lagged",
        model=lagged,
        state_names=(*plain.state_names, "held"),
        state_units=(*plain.state_units, "V"),
        parameters=(*plain.parameters, zo.Quantity.positive("lag", 0.0025, "s", "lag")),
        fidelities={},
        reference=None,
        rig=None,
    )
    continuous, late = (zo.find_orbit(one).unwrap().period for one in (plain, problem))
    # A held voltage is late by half a sample, and a lag of that time has the same first order.
    first_order = (late - continuous) / 0.0025
    orbit = _orbit()
    half = orbit.parameters["sampling"] / 2
    assert orbit.period == pytest.approx(continuous + first_order * half, abs=0.1 * (2 * half) ** 2)
    assert orbit.period - continuous > 0.9 * first_order * half
