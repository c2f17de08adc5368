"""Starts and releases at which gap, gap rate and multiplier are zero, against power series.

A mass of 1 kg slides along a straight stop at 1 m/s, and a force that depends on its place pulls it
off. So the gap acceleration is that force at the time, in closed form, in whatever units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import pytest

import zeno_orbits as zo
from tests.support.mechanisms import machine_of, slider
from zeno_orbits.integrators import Engine, Radau, RungeKutta
from zeno_orbits.simulation import Mode, SimulationSettings, simulate


@pytest.mark.parametrize("size", [1.0, 1e-3])
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_the_first_derivative_that_is_not_zero_decides_whether_the_stop_holds(
    order: int, size: float
) -> None:
    # The pull is +- size t^n, and with the upper sign the gap size t^(n + 2) / (n + 1) / (n + 2).
    start = (0.0, 0.0, 1.0, 0.0)
    opened = simulate(slider(lambda x: size * x**order), start, until=1.0)
    assert [arc.mode for arc in opened.arcs] == [Mode.FREE]
    height = size / (order + 1) / (order + 2)
    assert opened.end_state[1] == pytest.approx(height, rel=1e-11, abs=0.0)
    held = simulate(slider(lambda x: -size * x**order), start, until=1.0)
    assert [arc.mode for arc in held.arcs] == [Mode.LOCKED]
    assert held.end_state[1] == 0.0


@pytest.mark.parametrize("phase", [0.0, math.pi])
def test_a_leg_at_its_stop_starts_with_either_sign_of_a_sine(phase: float) -> None:
    # The pull sin(x + phase) - x cos(phase) starts as -+ x^3 / 6.
    dynamics = slider(lambda x: ca.sin(x + phase) - x * math.cos(phase))
    found = simulate(dynamics, (0.0, 0.0, 1.0, 0.0), until=1.0)
    assert found.arcs[0].mode is (Mode.LOCKED if phase == 0.0 else Mode.FREE)


@pytest.mark.parametrize("engine", [RungeKutta(), Radau()], ids=("explicit", "implicit"))
@pytest.mark.parametrize("excess", [4e-13, 1e-11, 1e-9, 2e-7, 1e-5])
def test_a_multiplier_that_only_just_reaches_zero_lets_go_for_a_moment(
    excess: float, engine: Engine
) -> None:
    # The pull e - (t - 1)^2 releases at 1 - s with s = sqrt(e). From there it is 2 s t - t^2, the
    # gap s t^3 / 3 - t^4 / 12, which closes at 4 s with the speed 16 s^3 / 3.
    found = simulate(
        slider(lambda x: excess - (x - 1) ** 2),
        (0.0, 0.0, 1.0, 0.0),
        until=2.0,
        settings=SimulationSettings(engine=engine),
    )
    half = math.sqrt(excess)
    # A multiplier rounded to 1e-16 moves its root by that over its slope 2 s.
    rounding = 2e-16 / half
    assert found.releases[0].time == pytest.approx(1 - half, abs=rounding + 1e-15)
    first = found.impacts[0]
    assert first.time == pytest.approx(1 + 3 * half, abs=10 * rounding + 1e-15)
    assert -first.approach_rate == pytest.approx(16 * half**3 / 3, rel=30 * rounding / half + 1e-9)
    assert len(found.zeno_points) == 1
    assert found.arcs[-1].mode is Mode.LOCKED


def test_a_multiplier_that_ends_above_zero_does_not_let_go() -> None:
    found = simulate(slider(lambda x: -1e-9 - (x - 1) ** 2), (0.0, 0.0, 1.0, 0.0), until=2.0)
    assert not found.events


@pytest.mark.parametrize("off", [-1e-17, 0.0, 1e-17, 1e-13, 1e-9])
@pytest.mark.parametrize("speed", [0.0, 1e-17, 1e-3, 2.0])
def test_a_start_that_is_off_its_stop_by_rounding_is_one_on_it(off: float, speed: float) -> None:
    def model(_parameters: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        floor = zo.Stop(name="floor", gap=q, restitution=0.5)
        ball = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=10 * q, stops=(floor,)
        )
        return zo.hybrid_system(ball, zo.no_drive(ball))

    ball = replace(machine_of(model, {"x": "m", "v": "m/s"}), starts=({"x": off, "v": speed},))
    run = zo.simulate(ball, until=1.0)
    assert run.arcs[-1].mode is Mode.LOCKED
    if max(off, speed) < 1e-15:
        assert not run.events
        return
    lands = math.sqrt(speed**2 + 2 * 10 * max(off, 0.0))
    # With e = 1/2 the flights after the first take twice the time of its fall from the top.
    rests = (speed + lands) / 10 + 2 * lands / 10
    assert [event.time for event in run.zeno_points] == pytest.approx([rests], abs=1e-12)
