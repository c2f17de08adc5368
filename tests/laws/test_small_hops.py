r"""Flights lower than the rounding of the gap: a table whose acceleration hardly exceeds gravity.

With :math:`A \omega^2 = g (1 + \delta)` a ball that rests on the table is released where
:math:`\sin \omega t = 1 / (1 + \delta)` and lands after about
:math:`4 \sqrt{2 \delta} / \omega`. The exact landing is the root of an elementary function. The
gap acceleration is at most :math:`\delta g`, so its rounding limits the accuracy to a part
:math:`\epsilon / \delta`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi
import mpmath
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import zeno_orbits as zo
from zeno_orbits import HybridLagrangian, MotorBank, full_drive, hybrid_system
from zeno_orbits.model import CompletedSystem, Problem, Quantity, load_problem
from zeno_orbits.simulation import (
    Execution,
    SimulationSettings,
    SimulationTask,
    by_reference,
    simulate,
)

OMEGA, G = 30.0, 9.81
ENOUGH = SimulationSettings(most_steps=20_000)


def _run(delta: float, phase: float, omega: float = OMEGA) -> Execution:
    """Return a turn of the ball that rests on the table at a phase."""
    problem = load_problem("vibrating_table")
    if omega != OMEGA:
        # It falls for half a second: the table is far faster.
        problem = replace(problem, starts=({"height": 1.0, "cosine": 1.0},))
    numbers = {"A": G * (1 + delta) / omega**2, "omega": omega, "g": G}
    dynamics = problem.dynamics(problem.values(numbers=numbers))
    start = (0.0, 0.0, math.cos(phase), math.sin(phase))
    return simulate(dynamics, start, until=1.2 * 2 * math.pi / omega, settings=ENOUGH)


def _landing(delta: float, begin: float | None) -> tuple[float, float]:
    """Return duration and final gap rate of the flight from a phase, by default the release."""
    with mpmath.workdps(60):
        factor = 1 + mpmath.mpf(delta)
        start = mpmath.asin(1 / factor) if begin is None else mpmath.mpf(begin)

        def gap(a: mpmath.mpf) -> mpmath.mpf:
            # Over g / omega^2, with a the angle since the start.
            fallen = factor * (mpmath.sin(start) - mpmath.sin(start + a) + a * mpmath.cos(start))
            return fallen - a**2 / 2

        wide = 4 * mpmath.sqrt(2 * mpmath.mpf(delta))
        angle = mpmath.findroot(gap, (wide / 2, 1.2 * wide), solver="anderson")
        rate = factor * (mpmath.cos(start) - mpmath.cos(start + angle)) - angle
        return float(angle / OMEGA), float(rate * G / OMEGA)


@pytest.mark.parametrize("delta", [1e-4, 1e-6, 1e-8, 1e-9])
@pytest.mark.parametrize("phase", [0.0, 2.5, 4.0])
def test_a_release_that_hardly_happens_lands_where_the_closed_form_does(
    delta: float, phase: float
) -> None:
    found = _run(delta, phase)
    release = found.releases[0].time
    first = next(impact for impact in found.impacts if impact.time > release)
    duration, rate = _landing(delta, None)
    lost = 1e-9 + 1e-14 / delta
    assert abs(first.time - release - duration) <= lost * duration + 4 * np.spacing(first.time)
    assert abs(first.approach_rate - rate) <= lost * abs(rate)
    assert found.zeno_points


@pytest.mark.parametrize("delta", [0.1, 1e-3, 1e-6])
@pytest.mark.parametrize("omega", [1e3, 1e4, 1e5, 1e6])
def test_a_hop_lands_alike_on_a_table_that_is_far_faster_than_the_fall(
    omega: float, delta: float
) -> None:
    found = _run(delta, 0.0, omega)
    release = found.releases[0].time
    first = next(impact for impact in found.impacts if impact.time > release)
    duration, rate = (one * OMEGA / omega for one in _landing(delta, None))
    lost = 1e-9 + 1e-14 / delta
    assert abs(first.time - release - duration) <= lost * duration + 4 * np.spacing(first.time)
    assert abs(first.approach_rate - rate) <= lost * abs(rate)
    assert found.zeno_points


@pytest.mark.parametrize("delta", [1e-4, 1e-6, 1e-8])
def test_a_start_inside_such_a_flight_lands_where_the_closed_form_does(delta: float) -> None:
    found = _run(delta, math.pi / 2)
    duration, rate = _landing(delta, math.pi / 2)
    assert found.impacts[0].time == pytest.approx(duration, rel=1e-9 + 1e-14 / delta)
    assert found.impacts[0].approach_rate == pytest.approx(rate, rel=1e-9 + 1e-14 / delta)


# A motor presses a mass against a plastic stop, and a constant force pulls it away. The voltage
# induced by the speed has weakened the current: after the impact the force wins until the current
# has grown again, in a time of the order of L / R.

MASS, RESISTANCE, CONSTANT, VOLTAGE, PULL, WAY = 1.38, 1.66, 1.15, 3.0, 1.8, 0.97


def _pressed(inductance: float) -> Problem:
    def model(p: Mapping[str, casadi.SX]) -> CompletedSystem:
        q, v = casadi.SX.sym("q"), casadi.SX.sym("v")
        motor = MotorBank(
            selection=casadi.SX([1.0]),
            resistance=casadi.SX(RESISTANCE),
            inductance=p["L"],
            torque_constant=casadi.SX(CONSTANT),
            emf_constant=casadi.SX(CONSTANT),
            voltage=casadi.SX(VOLTAGE),
        )
        stop = zo.Stop(name="wall", gap=WAY - q, restitution=0.0)
        mechanism = HybridLagrangian.from_energies(
            q=q, v=v, kinetic=MASS * v**2 / 2, potential=PULL * q, stops=(stop,)
        )
        return hybrid_system(mechanism, full_drive(mechanism, motor))

    return Problem(
        name="pressed",
        title="A mass that a motor presses against a plastic stop",
        source="an affine system",
        state_names=("q", "v", "i"),
        state_units=("m", "m/s", "A"),
        parameters=(Quantity.positive("L", inductance, "H", "inductance"),),
        gains=(),
        model=model,
        starts=({"v": 1.6},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


def _thrown_back(inductance: float, current: float) -> tuple[float, float, float]:
    """Return duration, final gap rate and final current of the flight after the impact.

    Times count in units of the circuit's own, so that no number is small.
    """
    unit = inductance / RESISTANCE
    affine = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, CONSTANT / MASS, -PULL / MASS],
            [0.0, -CONSTANT * unit / RESISTANCE, -1.0, VOLTAGE / RESISTANCE],
            [0.0, 0.0, 0.0, 0.0],
        ]
    )

    def state(time: float) -> np.ndarray:
        return expm(affine * time) @ np.array([0.0, 0.0, current, 1.0])

    late = next(time for time in np.arange(0.5, 50.0, 0.5) if state(time)[0] > 0.0)
    end = brentq(lambda time: state(time)[0], late - 0.5, late, xtol=1e-14, rtol=1e-15)
    _, rate, last, _ = state(end)
    return end * unit, -float(rate) * unit, float(last)


@pytest.mark.parametrize("inductance", [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("is_reference", [False, True])
def test_a_plastic_stop_throws_a_mass_off_until_its_current_has_grown(
    inductance: float, is_reference: bool
) -> None:
    problem = _pressed(inductance)
    graph = problem.graph_dynamics(problem.values())
    start = np.array(problem.state_vector(problem.starts[0]))
    if is_reference:
        settings = SimulationSettings()
        found = by_reference(
            SimulationTask(dynamics=graph, state=start, until=2.0, settings=settings)
        )
    else:
        found = simulate(graph, start, until=2.0)
    first, second = found.impacts[:2]
    wait, rate, current = _thrown_back(inductance, float(first.state_plus[2]))
    assert abs(second.time - first.time - wait) <= 1e-8 * wait + 4 * np.spacing(first.time)
    assert second.approach_rate == pytest.approx(rate, rel=1e-7)
    assert float(second.state_minus[2]) == pytest.approx(current, rel=1e-8)
    assert [zeno.time for zeno in found.zeno_points] == [second.time]
    assert not found.releases
