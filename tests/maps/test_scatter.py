"""Scatter of orbits: closed forms of a kicked ball, its own simulation, and exact derivatives."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.commands import ask
from zeno_orbits.maps import Scatter, ScatterSettings, scatter_of
from zeno_orbits.model import Problem

G, KICK, TURN, HEIGHT = 9.81, 1.0, 1.0, 0.03
"""Gravity, speed of a kick, time between kicks, height of the roof."""


def kicked_ball(*, roof: bool = False, fall: float = 0.0) -> zo.Problem:
    """Return a ball at rest on a floor that a clock kicks up once per turn.

    Every flight is a parabola, so its Zeno time is a sum of products of restitutions.

    Args:
        roof: Whether there is a roof that the kick reaches.
        fall: Fall of the restitution of the floor with the impact speed [s/m].
    """

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        h, v = ca.SX.sym("h"), ca.SX.sym("v")
        clock = zo.Clock.at(p["omega"])
        stops = [zo.Stop(name="floor", gap=h, restitution=p["e"] - fall * zo.impact_speed)]
        if roof:
            stops.append(zo.Stop(name="roof", gap=HEIGHT - h, restitution=p["e_roof"]))
        ball = zo.HybridLagrangian.from_energies(
            q=h, v=v, kinetic=v**2 / 2, potential=p["g"] * h, stops=tuple(stops), clock=clock
        )
        kick = zo.Switch(
            name="kick", guard=clock.sine, armed=-clock.cosine, v_after=ca.SX(p["kick"])
        )
        return zo.hybrid_system(ball, zo.no_drive(ball), switches=(kick,))

    quantity = zo.Quantity.positive
    return zo.Problem(
        name="kicked_ball",
        title="ball that a clock kicks",
        source="a test",
        state_names=("h", "v", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(
            quantity("omega", 2 * math.pi / TURN, "rad/s", "frequency of the kicks"),
            quantity("g", G, "m/s^2", "gravity"),
            quantity("kick", KICK, "m/s", "speed of a kick"),
            zo.Quantity(name="e", unit="1", meaning="restitution", default=0.5),
            *((quantity("e_roof", 0.6, "1", "restitution of the roof"),) if roof else ()),
        ),
        gains=(),
        model=model,
        starts=({"cosine": 1.0},),
        portraits=(("h", "v"),),
        amplitude_of="h",
    )


def _scatter(problem: zo.Problem, spread: Mapping[str, float], **settings: int) -> Scatter:
    orbit = zo.find_orbit(problem).unwrap()
    return scatter_of(problem, orbit, spread, settings=ScatterSettings(**settings))


@cache
def _of_ball(spread: float = 0.1, periods: int = 400) -> Scatter:
    return _scatter(kicked_ball(), {"restitution": spread}, periods=periods)


def _sum_of_products(
    e: float, spread: float, count: int, random: np.random.Generator, n: int = 60
) -> np.ndarray[Any, Any]:
    """Return samples of ``e1 + e1 e2 + ...`` with independent factors in [0, 1]."""
    factors = np.clip(e * (1 + spread * random.standard_normal((count, n))), 0.0, 1.0)
    return np.asarray(np.sum(np.cumprod(factors, axis=1), axis=1))


# The Zeno time of a ball, T = (2 w / g) (1 + e1 + e1 e2 + ...) after a kick. A period starts at the
# Zeno point, so the next kick comes TURN - T later.

KICKED = "switch kick"


@pytest.mark.slow
def test_the_zeno_time_of_a_ball_has_the_deviation_of_the_delta_method() -> None:
    e, spread = 0.5, 0.1
    row = _of_ball().row(KICKED)
    assert TURN - row.orbit == pytest.approx(2 * KICK / G / (1 - e), rel=1e-9)
    # With X = e1 + e1 e2 + ... and dX/d e_k = e^(k-1) / (1 - e).
    first_order = 2 * KICK / G * spread * e / (1 - e) / math.sqrt(1 - e**2)
    assert row.linear == pytest.approx(first_order, rel=1e-6)


@pytest.mark.slow
def test_the_simulated_moments_are_the_exact_ones() -> None:
    e, spread = 0.5, 0.1
    row, n = _of_ball().row(KICKED), _of_ball().samples[KICKED].size
    # X = e1 (1 + X') with independent e1 and X'. At 10 sigma truncation does not matter.
    squared = e**2 * (1 + spread**2)
    mean = e / (1 - e)
    second = squared * (1 + 2 * mean) / (1 - squared)
    exact = 2 * KICK / G * math.sqrt(second - mean**2)
    assert TURN - row.mean == pytest.approx(2 * KICK / G * (1 + mean), abs=4 * exact / math.sqrt(n))
    assert abs(row.deviation - exact) < 4 * row.error
    assert row.error < 0.04 * exact


@pytest.mark.slow
def test_the_simulated_quantiles_are_those_of_the_sum_of_products() -> None:
    row = _of_ball().row(KICKED)
    known = _sum_of_products(0.5, 0.1, 200_000, np.random.default_rng(7))
    low, high = 2 * KICK / G * (1 + np.quantile(known, (0.05, 0.95)))
    # A quantile of 5 % of 400 samples has a standard error of 0.011 at a density of 0.1 per sigma.
    assert TURN - row.high == pytest.approx(low, abs=0.4 * row.deviation)
    assert TURN - row.low == pytest.approx(high, abs=0.4 * row.deviation)


def test_the_time_between_zeno_points_scatters_by_both_of_its_ends() -> None:
    row, kicked = _of_ball().row("period"), _of_ball().row(KICKED)
    assert row.linear == pytest.approx(math.sqrt(2) * kicked.linear, rel=1e-9)
    assert abs(row.deviation - math.sqrt(2) * kicked.deviation) < 4 * row.error
    assert not _of_ball().lost


def test_the_period_of_a_clock_does_not_scatter() -> None:
    orbit = zo.find_orbit("marble_table").unwrap()
    found = zo.scatter(orbit, {"restitution": 0.07}, settings=zo.ScatterSettings(periods=40))
    assert found.row("period").deviation < 1e-12
    # Derivatives of the Zeno point are exact to the part of its tail.
    assert found.row("period").linear < 1e-5 * found.row("zeno stop").linear


@pytest.mark.weekly
@pytest.mark.slow
def test_motions_are_lost_as_often_as_the_ball_is_not_at_rest_at_the_kick() -> None:
    e, spread, turn = 0.5, 0.4, 0.6
    problem = kicked_ball()
    orbit = zo.find_orbit(problem, parameters={"omega": 2 * math.pi / turn}).unwrap()
    found = scatter_of(
        problem, orbit, {"restitution": spread}, settings=ScatterSettings(periods=2000)
    )
    random = np.random.default_rng(3)
    # Draws outside of [0, 1] are repeated.
    factors = e * (1 + spread * random.standard_normal((300_000, 80)))
    wrong = (factors < 0) | (factors > 1)
    while np.any(wrong):
        factors[wrong] = e * (1 + spread * random.standard_normal(int(np.sum(wrong))))
        wrong = (factors < 0) | (factors > 1)
    late = 2 * KICK / G * (1 + np.sum(np.cumprod(factors, axis=1), axis=1)) > turn
    probability = float(np.mean(late))
    assert found.lost > 10
    low, high = found.periods_until_lost_interval
    assert low < 1 / probability < high
    assert "the events of a period change" in found.reasons


def test_a_law_of_the_speed_scatters_by_its_recursion() -> None:
    spread, fall = 0.02, 0.1
    row = _scatter(kicked_ball(fall=fall), {"restitution": spread}, periods=3).row(KICKED)

    def zeno(place: int, factor: float) -> float:
        v, total = KICK, 1.0
        for k in range(80):
            v *= (0.5 - fall * v) * (factor if k == place else 1.0)
            total += v / KICK
        return 2 * KICK / G * total

    slopes = [(zeno(k, 1 + 1e-6) - zeno(k, 1 - 1e-6)) / 2e-6 for k in range(60)]
    assert row.linear == pytest.approx(spread * math.hypot(*slopes), rel=1e-5)


# Two stops, each with a scatter of its own.


def _under_roof(e_roof: float, e_floor: np.ndarray[Any, Any]) -> float:
    """Return the Zeno time of a kicked ball that strikes the roof once."""
    up = math.sqrt(KICK**2 - 2 * G * HEIGHT)
    down = e_roof * up
    v = math.sqrt(down**2 + 2 * G * HEIGHT)
    return (KICK - up) / G + (v - down) / G + 2 * v / G * float(np.sum(np.cumprod(e_floor)))


@pytest.mark.parametrize("stop", ["floor", "roof"])
def test_each_of_two_stops_scatters_as_its_own_differences(stop: str) -> None:
    spread = 0.05
    found = _scatter(kicked_ball(roof=True), {f"{stop}.restitution": spread}, periods=3)
    floor = np.full(80, 0.5)
    h = 1e-6
    if stop == "roof":
        slopes = [(_under_roof(0.6 + h, floor) - _under_roof(0.6 - h, floor)) / (2 * h) * 0.6]
    else:
        slopes = [
            (_under_roof(0.6, floor + h * unit) - _under_roof(0.6, floor - h * unit)) / (4 * h)
            for unit in np.eye(80)[:60]
        ]
    row = found.row(KICKED)
    assert TURN - row.orbit == pytest.approx(_under_roof(0.6, floor), rel=1e-9)
    assert row.linear == pytest.approx(spread * math.hypot(*slopes), rel=1e-5)


@pytest.mark.weekly
@pytest.mark.slow
def test_a_ball_under_a_roof_is_simulated_as_by_hand() -> None:
    problem = kicked_ball(roof=True)
    found = _scatter(problem, {"restitution": 0.1, "roof.restitution": 0.2}, periods=3000)
    random = np.random.default_rng(5)
    known = [
        _under_roof(
            0.6 * (1 + 0.2 * random.standard_normal()),
            0.5 * (1 + 0.1 * random.standard_normal(60)),
        )
        for _ in range(20_000)
    ]
    row = found.row(KICKED)
    assert abs(row.deviation - float(np.std(known))) < 4 * row.error
    assert TURN - row.mean == pytest.approx(
        float(np.mean(known)), abs=4 * row.deviation / math.sqrt(3000)
    )


# Orbits with a return map.


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "spread"),
    [
        ("motor_pendulum", {"restitution": 0.03}),
        ("impact_oscillator", {"restitution": 0.01, "speed": 0.005}),
        pytest.param("relay", {"restitution": 0.03}, marks=pytest.mark.weekly),
    ],
)
def test_small_scatter_is_linear(name: str, spread: Mapping[str, float]) -> None:
    problem = zo.load_problem(name)
    orbit = zo.find_orbit(problem).unwrap()
    found = scatter_of(problem, orbit, spread, settings=ScatterSettings(periods=2000))
    assert not found.lost
    rows = [row for row in found.rows if row.deviation > 1e-9 * abs(row.orbit)]
    assert len(rows) >= 3
    for row in rows:
        assert abs(row.deviation - row.linear) < 4 * row.error, row


def test_noise_of_a_state_decays_by_the_multipliers() -> None:
    problem = zo.load_problem("impact_oscillator")
    orbit = zo.find_orbit(problem).unwrap()
    found = scatter_of(problem, orbit, {"speed": 1e-3}, settings=ScatterSettings(periods=3))
    stability = zo.floquet_multipliers(orbit)
    # In two dimensions the covariance is the sum of the powers of the map, by hand.
    slope = stability.jacobian
    total, power = np.zeros((2, 2)), np.eye(2)
    names = [*stability.coordinates]
    assert names[0] == "speed"
    start = np.array([1e-3, 0.0])
    for _ in range(400):
        column = power @ start
        total += np.outer(column, column)
        power = slope @ power
    assert found.row("speed").linear == pytest.approx(math.sqrt(total[0, 0]), rel=1e-6)


# The same numbers, and refusals.


@pytest.mark.slow
def test_a_seed_gives_the_same_periods_and_another_seed_others() -> None:
    problem = kicked_ball()
    one, same = (_scatter(problem, {"restitution": 0.1}, periods=20) for _ in range(2))
    other = _scatter(problem, {"restitution": 0.1}, periods=20, seed=1)
    assert one.samples[KICKED].tolist() == same.samples[KICKED].tolist()
    assert one.samples[KICKED].tolist() != other.samples[KICKED].tolist()
    assert one.rows[0].linear == other.rows[0].linear


@pytest.mark.parametrize(
    ("spread", "wanted"),
    [
        ({"restitusion": 0.1}, "Did you mean `restitution`"),
        ({"wall.restitution": 0.1}, "`wall.restitution`"),
        ({"restitution": -0.1}, r"must lie in \[0, 1\)"),
        ({"restitution": 1.0}, r"must lie in \[0, 1\)"),
        ({"h": -1.0}, "must not be negative"),
        ({"h": math.nan}, "must be a finite number"),
        ({"restitution": 0.0}, "nothing scatters"),
        ({}, "nothing scatters"),
    ],
)
def test_a_wrong_spread_is_refused(spread: Mapping[str, float], wanted: str) -> None:
    with pytest.raises(zo.InputError, match=wanted):
        _scatter(kicked_ball(), spread, periods=3)


def test_an_orbit_that_does_not_attract_is_refused(problem: Problem, repelling: zo.Orbit) -> None:
    assert zo.floquet_multipliers(repelling).spectral_radius > 1
    with pytest.raises(zo.InputError, match="must be stable"):
        scatter_of(problem, repelling, {"restitution": 0.1})


@pytest.mark.slow
def test_the_command_prints_a_table_and_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    zo.write_orbit(zo.find_orbit("marble_table").unwrap(), "orbit.json")
    words = ("scatter", "orbit.json", "--periods", "40", "--plot", "scatter.png")
    answer = ask(*words, "-o", "scatter.json")
    assert answer.code == 0
    assert max(map(len, answer.out.splitlines())) <= 80
    assert "zeno stop [s]" in answer.out
    assert Path("scatter.png").stat().st_size > 1000
    data = json.loads(Path("scatter.json").read_text())
    assert data["spread"] == {"restitution": 0.07}
    assert data["periods_until_lost"] is None
    assert data == json.loads(ask(*words, "--json").out)
    refused = ask("scatter", "orbit.json", "--spread", "foo=1")
    assert refused.code == 2
    assert "`foo`" in refused.err
