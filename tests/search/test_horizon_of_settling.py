"""A motion is simulated until its returns repeat, not for many of its slowest times.

Truth: a rimless wheel with damping, whose steps SciPy integrates.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca
import pytest
from scipy.integrate import solve_ivp

import zeno_orbits as zo
from tests.support.cases import fast

SLOPE = 0.08


def walker(g: float, damping: float, spokes: int, speed: float = 5.0) -> zo.Problem:
    """Return a rimless wheel on a slope. Upright, only its damping slows it down."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        wheel = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=p["g"] * ca.cos(q),
            passive_force=-p["damping"] * v,
            stops=(zo.Stop(name="fall", gap=q + 3, restitution=0.0),),
        )
        half = math.pi / spokes
        strike = zo.Switch(
            name="strike",
            guard=SLOPE + half - q,
            armed=v,
            q_after=q - 2 * half,
            v_after=v * math.cos(2 * half),
        )
        return zo.hybrid_system(wheel, zo.no_drive(wheel), switches=(strike,))

    positive = zo.Quantity.positive
    return zo.Problem(
        name="walker",
        title="rimless wheel",
        source="test",
        state_names=("q", "v"),
        state_units=("rad", "rad/s"),
        parameters=(
            positive("g", g, "1/s^2", "gravity over length"),
            positive("damping", damping, "1/s", "damping"),
        ),
        gains=(),
        model=model,
        starts=({"v": speed},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


def period_of(g: float, damping: float, spokes: int) -> tuple[float, float]:
    """Return the period of the gait and its speed just after a strike."""
    half, speed, period = math.pi / spokes, 1.5 * math.sqrt(g / 9.81), 0.0

    def struck(_: float, y: list[float]) -> float:
        return y[0] - SLOPE - half

    struck.terminal, struck.direction = True, 1.0  # type: ignore[attr-defined]
    for _ in range(60):
        step = solve_ivp(
            lambda _, y: [y[1], g * math.sin(y[0]) - damping * y[1]],
            (0.0, 50.0),
            [SLOPE - half, speed],
            events=struck,
            rtol=1e-11,
            atol=1e-12,
        )
        period, before = float(step.t[-1]), speed
        speed = float(step.y[1, -1]) * math.cos(2 * half)
        if abs(speed - before) < 1e-11:
            break
    return period, speed


MACHINES = [(9.81, 1e-3, 8), (9.81, 1e-4, 8), (3.7, 1e-3, 9), (1.62, 1e-5, 8), (25.0, 5e-3, 10)]


@pytest.mark.slow
@pytest.mark.parametrize(("g", "damping", "spokes"), fast(1, MACHINES))
def test_a_walker_with_weak_damping_is_found_by_a_default_search(
    g: float, damping: float, spokes: int
) -> None:
    """Its slowest time at the start is 2 pi / damping, thousands of steps."""
    period, speed = period_of(g, damping, spokes)
    problem = walker(g, damping, spokes)
    orbit = zo.search_gains(problem).orbit
    assert orbit is not None
    assert orbit.period == pytest.approx(period, rel=1e-8)
    assert orbit.start_state["v"] == pytest.approx(speed, rel=1e-8)


@pytest.mark.slow
def test_a_map_classifies_a_walker_with_weak_damping() -> None:
    plane = zo.parameter_map(
        walker(9.81, 1e-3, 8), x=("g", 8.0, 9.81, 2), y=("damping", 1e-4, 1e-3, 2)
    )
    truth = [period_of(g, c, 8)[0] for c in (1e-4, 1e-3) for g in (8.0, 9.81)]
    assert [one.period for one in plane.attractors] == pytest.approx(truth, rel=1e-8)


def test_a_motion_that_takes_all_steps_names_the_longest_time() -> None:
    problem = walker(9.81, 1e-3, 8)
    few = zo.SearchSettings(simulation=zo.SimulationSettings(most_steps=40))
    stopped, late = zo.find_orbit(problem, settings=few), zo.find_orbit(problem, until=0.01)
    assert (stopped.status.name, late.status.name) == ("NO_GUESS", "NO_EVENTS")
    assert "within 40 steps" in stopped.detail
    assert "strikes no stop and passes no switch" in late.detail
