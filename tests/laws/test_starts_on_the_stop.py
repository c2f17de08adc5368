"""Starts and releases at which gap, gap rate and multiplier are zero, against power series.

A mass of 1 kg slides along a straight stop at 1 m/s, and a force that depends on its place pulls it
off. So the gap acceleration is that force at the time, in closed form, in whatever units.
"""

from __future__ import annotations

import math

import casadi as ca
import pytest

from tests.support.mechanisms import slider
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
