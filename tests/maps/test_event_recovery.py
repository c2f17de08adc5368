"""Recovery of machines with several stops or switches: closed forms and an independent loop."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

import zeno_orbits as zo
from tests.reference import kneed_walker
from tests.reference.event_loop import Accuracy, simulated
from tests.reference.several_stops import ImpactPair, TwoSided, impact_pair, two_sided
from tests.support.cases import fast
from tests.support.commands import MISUSE, YES, ask
from tests.support.orbits import event_orbit
from tests.support.units import Units, in_units
from zeno_orbits.maps import read_recovery

Array = np.ndarray


def fine(**settings: Any) -> zo.RecoverySettings:
    return replace(zo.RecoverySettings(error=1e-3, samples=50), **settings)


def drawn_inside(found: zo.Recovery, drawn: np.random.Generator, part: float = 1.0) -> Array:
    """Return coordinates drawn uniformly from a part of the ball."""
    d = len(found.norm)
    z = drawn.standard_normal(d)
    z *= part * found.radius * drawn.uniform() ** (1 / d) / np.linalg.norm(z)
    return np.linalg.inv(np.linalg.cholesky(found.norm).T) @ z


def length(found: zo.Recovery, change: Array) -> float:
    """Return the norm of a difference of states of the section, to first order."""
    y = np.linalg.lstsq(found.directions, change, rcond=None)[0]
    return float(np.sqrt(y @ found.norm @ y))


# A hopper, and a ceiling above it.


@pytest.mark.slow
@pytest.mark.parametrize("seed", fast(1, range(3)))
def test_a_hopper_recovers_by_its_multiplier_and_from_every_speed(seed: int) -> None:
    # The square of the speed maps to e^2 v^2 + 2 a s: every v > 0 returns, and the multiplier is
    # e^2. So the ball ends where the speed after the impact vanishes.
    drawn = random.Random(seed)
    a, s, e = drawn.uniform(15.0, 40.0), drawn.uniform(0.03, 0.2), drawn.uniform(0.3, 0.8)
    orbit = zo.find_orbit("hopper", parameters={"a": a, "s": s, "restitution": e}).unwrap()
    found = zo.recovery(orbit, settings=fine(part=1e-3, seed=seed))
    assert found.spectral_radius == pytest.approx(e**2, rel=1e-8)
    assert found.contraction == pytest.approx(e**2, rel=1e-8)
    assert found.periods == math.ceil(math.log(1e-3) / math.log(e**2))
    assert found.time == pytest.approx(found.periods * orbit.period, rel=1e-12)
    launch = e * math.sqrt(2 * a * s / (1 - e**2))
    assert 1 - 2e-3 < found.extents["speed"] / launch <= 1.0
    assert found.extents["height"] == pytest.approx(0.0, abs=1e-12)


def under_a_ceiling(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a hopper under a ceiling."""
    height, speed = ca.SX.sym("height"), ca.SX.sym("speed")
    pushes = ca.logic_and(speed > 0, height < p["s"])
    mass = zo.HybridLagrangian.from_energies(
        q=height,
        v=speed,
        kinetic=speed**2 / 2,
        potential=9.81 * height,
        applied_force=ca.if_else(pushes, p["a"], 0),
        stops=(
            zo.Stop(name="floor", gap=height, restitution=p["restitution"]),
            zo.Stop(name="ceiling", gap=p["H"] - height, restitution=p["restitution"]),
        ),
    )
    return zo.hybrid_system(mass, zo.no_drive(mass))


CEILING = zo.Problem(
    name="hopper_under_a_ceiling",
    title="hopper under a ceiling",
    source="these tests",
    state_names=("height", "speed"),
    state_units=("m", "m/s"),
    parameters=(
        zo.Quantity.positive("a", 20.0, "m/s^2", "acceleration of the push"),
        zo.Quantity.positive("s", 0.1, "m", "height below which it pushes"),
        zo.Quantity.positive("H", 1.0, "m", "height of the ceiling"),
        zo.Quantity.restitution(0.5),
    ),
    gains=(),
    model=under_a_ceiling,
    starts=({"height": 0.0, "speed": 1.0},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
)


@pytest.mark.slow
@pytest.mark.parametrize("above", [0.1, 0.01, 0.5, 10.0])
def test_a_ball_ends_where_the_ceiling_is_struck(above: float) -> None:
    # The apex of a hop is v^2 / 2 g + a s / g above the floor. One that is higher than the ceiling
    # has another event sequence, although it may return to the orbit.
    a, s, e, g = 20.0, 0.1, 0.5, 9.81
    launch = e * math.sqrt(2 * a * s / (1 - e**2))
    apex = (launch**2 / 2 + a * s) / g
    height = (1 + above) * apex
    orbit = zo.find_orbit(CEILING, parameters={"H": height}).unwrap()
    assert not any("ceiling" in name for name in orbit.sequence)
    found = zo.recovery(orbit, problem=CEILING, settings=fine())
    highest = math.sqrt(2 * (g * height - a * s))
    limit = min(highest - launch, launch)
    assert 1 - 2e-3 < found.extents["speed"] / limit <= 1 + 1e-9


# A ball on a shaken table below a far ceiling, with a further state that has a basin of its own.


def shaken(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    gap, speed, z = ca.SX.sym("gap"), ca.SX.sym("speed"), ca.SX.sym("z")
    clock = zo.Clock.at(p["omega"])
    ball = zo.HybridLagrangian.from_energies(
        q=gap,
        v=speed,
        kinetic=speed**2 / 2,
        potential=9.81 * gap,
        applied_force=p["A"] * p["omega"] ** 2 * clock.sine,
        clock=clock,
        stops=(
            zo.Stop(name="table", gap=gap, restitution=p["restitution"]),
            zo.Stop(name="ceiling", gap=1.0 - gap, restitution=p["restitution"]),
        ),
    )
    further = zo.Auxiliary(states=z, rate=-p["a"] * z + p["b"] * z**2)
    return zo.hybrid_system(ball, further)


SHAKEN = zo.Problem(
    name="shaken_below_a_ceiling",
    title="ball on a shaken table, and a state with a basin of its own",
    source="these tests",
    state_names=("gap", "speed", "z", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1", "1"),
    parameters=(
        zo.Quantity.positive("A", 0.015, "m", "amplitude of the table"),
        zo.Quantity.positive("omega", 30.0, "rad/s", "its frequency"),
        zo.Quantity.positive("a", 2.0, "1/s", "decay of the further state"),
        zo.Quantity.positive("b", 1.0, "1/s", "its growth"),
        zo.Quantity.restitution(0.3),
    ),
    gains=(),
    model=shaken,
    starts=({"cosine": 1.0, "z": 0.1},),
    portraits=(("gap", "speed"),),
    amplitude_of="gap",
)


@pytest.mark.slow
@pytest.mark.parametrize("seed", fast(1, range(3)))
def test_a_ball_reaches_the_boundary_of_the_basin_and_does_not_cross_it(seed: int) -> None:
    # z' = -a z + b z^2 decays below a / b and grows above it. A release fixes all other states.
    drawn = random.Random(seed)
    a = drawn.uniform(0.5, 20.0)
    b = a * 10 ** drawn.uniform(-1.0, 0.9)
    orbit = zo.find_orbit(SHAKEN, parameters={"a": a, "b": b}, section="release table").unwrap()
    found = zo.recovery(orbit, problem=SHAKEN, settings=fine(part=1e-3, seed=seed))
    period = 2 * math.pi / 30.0
    assert found.spectral_radius == pytest.approx(math.exp(-a * period), rel=1e-6)
    assert found.periods == math.ceil(math.log(1e3) / (a * period))
    assert 1 - 2e-3 < found.extents["z"] * b / a <= 1 + 1e-6
    assert [name for name, extent in found.extents.items() if extent > 1e-9] == ["z"]


@pytest.mark.slow
def test_a_slow_decay_has_its_number_of_periods() -> None:
    orbit = zo.find_orbit(
        SHAKEN, parameters={"a": 1e-4}, section="release table", start={"cosine": 1.0, "z": 0.0}
    ).unwrap()
    found = zo.recovery(orbit, problem=SHAKEN, settings=fine(samples=1, error=0.1))
    assert found.periods == pytest.approx(math.log(100) / (1e-4 * 2 * math.pi / 30), rel=1e-5)


def beside_a_resting_mass(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a ball on a shaken table, and a mass that rests on its own stop."""
    q, v, clock = ca.SX.sym("q", 2), ca.SX.sym("v", 2), zo.Clock.at(p["omega"])
    both = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2,
        potential=9.81 * ca.sum1(q),
        applied_force=ca.vertcat(p["A"] * p["omega"] ** 2 * clock.sine, 0),
        clock=clock,
        stops=(
            zo.Stop(name="table", gap=q[0], restitution=p["restitution"]),
            zo.Stop(name="bench", gap=q[1], restitution=p["restitution"]),
        ),
    )
    return zo.hybrid_system(both, zo.no_drive(both))


@pytest.mark.parametrize("section", fast(1, ["release table", "zeno table"]))
def test_a_stop_that_stays_closed_has_no_coordinates(section: str) -> None:
    problem = replace(
        SHAKEN,
        name="two_masses",
        state_names=("gap", "rest", "speed", "rest_speed", "cosine", "sine"),
        state_units=("m", "m", "m/s", "m/s", "1", "1"),
        parameters=tuple(one for one in SHAKEN.parameters if one.name not in "ab"),
        model=beside_a_resting_mass,
        starts=({"cosine": 1.0},),
    )
    orbit = zo.find_orbit(problem, section=section).unwrap()
    found = zo.recovery(orbit, problem=problem, settings=fine(samples=5))
    # The phase of the clock is the only one, and a release determines it.
    assert len(found.norm) == (section == "zeno table")
    assert found.periods == 1
    assert found.extents["rest"] == found.extents["rest_speed"] == 0.0


# A switch with a closed form, which is armed above a speed only, beside a mass on a bench.


def thrown(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a mass that a racket at height zero throws up, and one that its fall pulls up."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    masses = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2,
        potential=9.81 * q[0],
        applied_force=ca.vertcat(0, -1 - v[0] / p["most"]),
        stops=(
            zo.Stop(name="floor", gap=q[0] + 100, restitution=p["restitution"]),
            zo.Stop(name="bench", gap=q[1], restitution=p["restitution"]),
        ),
    )
    racket = zo.Switch(
        name="racket",
        guard=q[0],
        armed=-v[0] - p["least"],
        v_after=ca.vertcat(p["throw"] - p["e"] * v[0], v[1]),
    )
    return zo.hybrid_system(masses, zo.no_drive(masses), switches=(racket,))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("least", "most", "limit"),
    fast(
        1,
        [(1.5, 50.0, 1.5), (0.5, 4.5, 1.5), (0.5, 50.0, 2.5), (-9.0, 50.0, 3.0), (0.5, 3.5, 0.5)],
    ),
    ids=["armed later", "held", "armed", "falls", "held shortly"],
)
def test_a_ball_ends_where_the_switch_does_not_occur(
    least: float, most: float, limit: float
) -> None:
    # The speed u before the racket maps to throw + e u, and is throw / (1 - e) = 3 on the orbit. A
    # state before the racket has u > 0 and u > least, and u < most: the bench carries a force.
    throw, e = 1.8, 0.4
    problem = replace(
        CEILING,
        name="thrown",
        state_names=("height", "rest", "speed", "rest_speed"),
        state_units=("m", "m", "m/s", "m/s"),
        parameters=(
            zo.Quantity.positive("throw", throw, "m/s", "speed of a throw from rest"),
            zo.Quantity.positive("e", e, "1", "part of the speed that is reflected"),
            zo.Quantity(name="least", default=least, unit="m/s", meaning="least speed"),
            zo.Quantity.positive("most", most, "m/s", "speed that lifts the second mass"),
            zo.Quantity.restitution(0.5),
        ),
        model=thrown,
        starts=({"height": 0.0, "speed": 3.1},),
        portraits=(("height", "speed"),),
    )
    orbit = zo.find_orbit(problem).unwrap()
    found = zo.recovery(orbit, problem=problem, settings=fine())
    assert found.norm.shape == (1, 1)
    assert found.spectral_radius == pytest.approx(e, rel=1e-8)
    assert found.contraction == pytest.approx(e, rel=1e-8)
    assert found.periods == math.ceil(math.log(0.01) / math.log(e))
    assert 1 - 2e-3 < found.extents["speed"] / limit <= 1 + 1e-9


# Impacts without a Zeno point: closed forms of both machines with two stops.


def stable(make: Any, rate: Any, count: int) -> list[Any]:
    """Return machines whose spectral radius lies between 0.05 and 0.9."""
    rng, found = np.random.default_rng(25), list[Any]()
    while len(found) < count:
        one = make(rng)
        if 0.05 < rate(one) < 0.9:
            found.append(one)
    return found


def rate_of(o: TwoSided) -> float:
    """Return the spectral radius of a period, which is two halves."""
    return float(max(abs(o.multipliers)) ** 2)


@cache
def oscillators() -> list[TwoSided]:
    return stable(two_sided, rate_of, 4)


@pytest.mark.parametrize("k", fast(0, range(4)))
def test_a_two_sided_oscillator_recovers_by_its_multipliers(k: int) -> None:
    o = oscillators()[k]
    numbers = {"c": o.c, "omega": o.omega, "d": o.stop, "restitution": o.restitution}
    orbit = zo.find_orbit(
        "clapper",
        parameters={**numbers, "A": o.amplitude},
        start={
            "place": o.state(0.3 * o.half)[0],
            "speed": o.state(0.3 * o.half)[1],
            "cosine": math.cos(0.3 * math.pi + o.phase),
            "sine": math.sin(0.3 * math.pi + o.phase),
        },
    ).unwrap()
    assert set(orbit.sequence) == {"impact upper", "impact lower"}
    found = zo.recovery(orbit, settings=fine(samples=10, error=0.1))
    rate = rate_of(o)
    assert found.spectral_radius == pytest.approx(rate, rel=1e-7)
    assert rate * (1 - 1e-7) <= found.contraction < (1 + rate) / 2
    assert found.periods >= math.ceil(math.log(found.settings.part) / math.log(rate))


class Pair:
    """The clapper without spring and damping, with the closed form of its flights."""

    def __init__(self, o: ImpactPair) -> None:
        self.o, self.d = o, o.length / 2

    def flown(self, side: float, t: float, v: float) -> tuple[float, float] | None:
        """Return time and speed after the impact on the opposite stop, if it is the next one."""
        a, d, e = self.o.amplitude, self.d, self.o.restitution

        def place(s: Any) -> Any:
            return side * d + (v - a * math.sin(t)) * (s - t) - a * (np.cos(s) - math.cos(t))

        grid = t + np.linspace(0.0, 3 * math.pi, 1200)[1:]
        beyond = np.abs(place(grid)) >= d
        if side * v >= 0.0 or beyond[0] or not beyond.any():
            return None
        k = int(np.argmax(beyond))
        if side * place(grid[k]) > 0.0:
            return None
        s = brentq(lambda s: place(s) + side * d, grid[k - 1], grid[k], xtol=1e-15)
        return s, -e * (v + a * (math.sin(s) - math.sin(t)))

    def returned(self, side: float, t: float, v: float) -> tuple[float, float] | None:
        """Return phase and speed at the next impact on the same stop, with one on the other."""
        first = self.flown(side, t, v)
        second = None if first is None else self.flown(-side, *first)
        return None if second is None else (second[0] - 2 * math.pi, second[1])

    def derivative(self, side: float, t: float, v: float, step: float = 1e-5) -> Array:
        columns = list[Array]()
        for dt, dv in step * np.eye(2):
            ahead, behind = self.returned(side, t + dt, v + dv), self.returned(side, t - dt, v - dv)
            assert ahead is not None
            assert behind is not None
            columns.append((np.array(ahead) - np.array(behind)) / (2 * step))
        return np.array(columns).T

    def rate(self) -> float:
        # The mass leaves the lower end at the phase of a sine.
        t, v = self.o.phase - math.pi / 2, self.o.speed - self.o.amplitude * math.cos(self.o.phase)
        return float(max(abs(np.linalg.eigvals(self.derivative(-1.0, t, v)))))


def pair_rate(o: ImpactPair) -> float:
    return Pair(o).rate()


@cache
def recovering_pair(k: int) -> tuple[Pair, zo.Orbit, zo.Recovery]:
    o = stable(impact_pair, pair_rate, k + 1)[k]
    numbers = {"A": o.amplitude, "restitution": o.restitution, "d": o.length / 2}
    orbit = zo.find_orbit(
        "clapper",
        parameters={**numbers, "k": 0.0, "c": 0.0, "omega": 1.0},
        start={
            "place": -o.length / 2 + 1e-9,
            "speed": o.speed - o.amplitude * math.cos(o.phase),
            "cosine": math.sin(o.phase),
            "sine": -math.cos(o.phase),
        },
    ).unwrap()
    return Pair(o), orbit, zo.recovery(orbit, settings=fine(samples=100))


def side_of(orbit: zo.Orbit) -> float:
    return 1.0 if orbit.section == "impact upper" else -1.0


def phase_and_speed(state: Any) -> tuple[float, float]:
    return math.atan2(state["sine"], state["cosine"]), state["speed"]


@pytest.mark.parametrize("k", fast(0, range(2)))
def test_an_impact_pair_recovers_as_its_closed_form(k: int) -> None:
    pair, orbit, found = recovering_pair(k)
    t, v = phase_and_speed(orbit.start_state)
    matrix = pair.derivative(side_of(orbit), t, v)
    # Columns: changes of phase and speed by the section coordinates.
    to_phase = -orbit.start_state["sine"] * found.directions[2]
    to_phase += orbit.start_state["cosine"] * found.directions[3]
    lift = np.array([to_phase, found.directions[1]])
    slope = np.linalg.solve(lift, matrix @ lift)
    root = np.linalg.cholesky(found.norm).T
    factors = [
        np.linalg.norm(root @ np.linalg.matrix_power(slope, n) @ np.linalg.inv(root), 2)
        for n in range(1, found.periods + 1)
    ]
    assert found.spectral_radius == pytest.approx(pair.rate(), rel=1e-6)
    assert found.contraction == pytest.approx(factors[0], rel=1e-6)
    assert factors[-1] <= found.settings.part
    assert all(factor > found.settings.part for factor in factors[:-1])


@pytest.mark.slow
@pytest.mark.parametrize("k", range(2))
def test_states_of_the_ball_of_an_impact_pair_return_and_a_larger_ball_is_left(k: int) -> None:
    pair, orbit, found = recovering_pair(k)
    drawn, side = np.random.default_rng(k), side_of(orbit)
    start = np.array(list(orbit.start_state.values()))
    t, v = phase_and_speed(orbit.start_state)

    def drawn_start(y: Array) -> tuple[float, float]:
        state = start + found.directions @ y
        return math.atan2(state[3], state[2]), state[1]

    for _ in range(100):
        at: tuple[float, float] | None = drawn_start(drawn_inside(found, drawn, 0.98))
        for _ in range(3 * found.periods):
            assert at is not None
            at = pair.returned(side, *at)
        assert at is not None
        assert math.remainder(at[0] - t, 2 * math.pi) == pytest.approx(0.0, abs=1e-3)
        assert at[1] == pytest.approx(v, rel=1e-3)
    outside = 0
    for _ in range(100):
        y = drawn_inside(found, drawn)
        y *= 1.3 * found.radius / math.sqrt(y @ found.norm @ y)
        at = pair.returned(side, *drawn_start(y))
        if at is None:
            outside += 1
        else:
            change = np.array([0.0, at[1], math.cos(at[0]), math.sin(at[0])]) - start
            outside += length(found, np.array([0.0, *change[1:]])) > 1.3 * found.radius
    assert outside > 0


# The kneed walker: its section before heel strike is a plane.


@cache
def _walker() -> tuple[zo.Orbit, zo.Recovery]:
    orbit = zo.find_orbit("kneed_walker", parameters={"restitution": 0.0}).unwrap()
    return orbit, zo.recovery(orbit)


@pytest.mark.slow
def test_the_walker_with_plastic_knees_recovers_by_its_published_multipliers() -> None:
    _, found = _walker()
    rate = abs(0.3531363 + 0.552108j)
    assert found.norm.shape == (3, 3)
    assert found.spectral_radius == pytest.approx(rate, abs=1e-6)
    assert rate <= found.contraction < (1 + rate) / 2
    assert found.periods >= math.ceil(math.log(0.01) / math.log(rate))
    # Just before heel strike the swing leg is straight and its foot on the slope.
    assert found.extents["q1"] == pytest.approx(found.extents["q2"], rel=1e-9)
    assert found.extents["q2"] == pytest.approx(found.extents["q3"], rel=1e-9)


def next_strike(before: Array) -> Array | None:
    """Return the state before the next heel strike after one, by the independent loop."""
    machine = kneed_walker.walker(0.0)
    start = np.concatenate(machine.resets[0].after(0.0, before[:3], before[3:], np.empty(0))[:2])
    run = simulated(machine, start.tolist(), 1.2, accuracy=Accuracy(tolerance=1e-10))
    passed = [(event.kind, event.name) for event in run.events if event.kind != "impact"]
    if passed[:2] != [("zeno", "knee"), ("switch", "heel strike")]:
        return None
    return next(event.before for event in run.events if event.kind == "switch")[:6]


@pytest.mark.slow
def test_the_ball_of_the_walker_maps_into_itself_by_an_independent_loop() -> None:
    orbit, found = _walker()
    strike = np.array(list(orbit.events[-1].state.values()))
    drawn = np.random.default_rng(3)
    for _ in range(40):
        y = drawn_inside(found, drawn)
        end = next_strike(strike + found.directions @ y)
        assert end is not None
        assert length(found, end - strike) <= found.radius
    outside = 0
    for _ in range(20):
        y = drawn_inside(found, drawn)
        y *= 3.0 * found.radius / math.sqrt(y @ found.norm @ y)
        end = next_strike(strike + found.directions @ y)
        outside += end is None or length(found, end - strike) > 3.0 * found.radius
    assert outside > 0


@pytest.mark.slow
def test_a_disturbance_of_the_walker_decays_in_the_periods() -> None:
    orbit, found = _walker()
    strike = np.array(list(orbit.events[-1].state.values()))
    drawn = np.random.default_rng(5)
    for _ in range(2):
        y = drawn.standard_normal(3)
        y *= 1e-4 / math.sqrt(y @ found.norm @ y)
        at = strike + found.directions @ y
        for _ in range(found.periods):
            end = next_strike(at)
            assert end is not None
            at = end
        # Second order in the disturbance, and the orbit is known to 1e-10.
        assert length(found, at - strike) < found.settings.part * 1e-4 * 1.01 + 1e-8


# Clocks: a contact phase removes the whole disturbance.


@pytest.mark.slow
def test_a_relay_forgets_every_disturbance_in_a_period() -> None:
    orbit = event_orbit("relay")
    found = zo.recovery(orbit)
    assert found.periods == 1
    assert found.contraction < 1e-9
    assert found.norm == pytest.approx(np.eye(2), abs=1e-9)


@pytest.mark.slow
def test_the_ball_of_a_clapper_ends_where_its_stop_would_release_at_once() -> None:
    # On the stop d the force holds the mass against the spring while A cos(omega t) > k d. A start
    # at another phase leaves at once, without a release.
    orbit = event_orbit("clapper")
    found = zo.recovery(orbit, settings=fine())
    assert orbit.section == "zeno upper"
    assert found.periods == 1
    at = math.atan2(orbit.start_state["sine"], orbit.start_state["cosine"])
    release = math.acos(1.0 / 5.0)
    nearest = min(release - at, at + release)
    # Extents are of first order, along the tangent of the clock's circle. The next term is
    # tan(nearest / 2) sin(2 at) / 2 times the relative difference of the squared sizes of cosine
    # and sine, here 0.03.
    reach = math.hypot(found.extents["cosine"], found.extents["sine"])
    assert 1.0 < reach / math.sin(nearest) < 1.04


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "section"),
    fast(
        1,
        [
            ("hopper", "switch kink 1"),
            ("hopper", "switch kink 2"),
            ("limited_pendulum", "release stop"),
            ("limited_pendulum", "switch kink 1"),
            ("kneed_walker", "zeno knee"),
        ],
    ),
)
def test_the_spectral_radius_is_the_same_from_every_section(name: str, section: str) -> None:
    settings = zo.RecoverySettings(samples=1, error=0.5)
    usual = zo.recovery(event_orbit(name), settings=settings)
    orbit = event_orbit(name, section)
    found = zo.recovery(orbit, settings=settings)
    assert orbit.section == section
    assert found.spectral_radius == pytest.approx(usual.spectral_radius, abs=1e-9)


def pressed_on_a_wall(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a hopper that is pressed on a wall, which the impacts on the floor open."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    pushes = ca.logic_and(v[1] > 0, q[1] < p["s"])
    mass = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(ca.sumsqr(v) - 0.6 * v[0] * v[1]) / 2,
        potential=60.0 * q[0] + 9.81 * q[1],
        applied_force=ca.vertcat(0, ca.if_else(pushes, p["a"], 0)),
        stops=(
            zo.Stop(name="wall", gap=q[0], restitution=0.2),
            zo.Stop(name="floor", gap=q[1], restitution=p["restitution"]),
        ),
    )
    return zo.hybrid_system(mass, zo.no_drive(mass))


@pytest.mark.slow
def test_an_impact_that_opens_another_stop_and_its_release_start_the_same_period() -> None:
    problem = replace(
        CEILING,
        name="pressed_on_a_wall",
        state_names=("x", "height", "dx", "speed"),
        state_units=("m", "m", "m/s", "m/s"),
        parameters=tuple(one for one in CEILING.parameters if one.name != "H"),
        model=pressed_on_a_wall,
        starts=({"height": 0.0, "speed": 2.0},),
        portraits=(("height", "speed"),),
    )
    wall, *floor = (
        zo.recovery(
            zo.find_orbit(problem, section=section).unwrap(),
            problem=problem,
            settings=fine(samples=5, error=0.1),
        )
        for section in ("zeno wall", "impact floor", "release wall")
    )
    for found in floor:
        assert found.spectral_radius == pytest.approx(wall.spectral_radius, abs=1e-9)
        assert found.extents["x"] == found.extents["height"] == 0.0
    # The release is the consequence of the impact, so both start the same periods.
    assert floor[0].radius == pytest.approx(floor[1].radius, rel=1e-6)


# Units, files and refusals.


@pytest.mark.slow
@pytest.mark.parametrize(("name", "state"), [("hopper", "speed"), ("clapper", "cosine")])
def test_the_recovery_is_the_same_in_other_units(name: str, state: str) -> None:
    problem = zo.load_problem(name)
    settings = fine(samples=10)
    here = zo.recovery(zo.find_orbit(problem, until=400.0).unwrap(), settings=settings)
    units = Units(mass=1e3, length=1e2, time=1e3)
    other = in_units(problem, units)
    orbit = zo.find_orbit(other, until=400.0 * 1e3).unwrap()
    there = zo.recovery(orbit, problem=other, settings=settings)
    assert there.periods == here.periods
    assert there.time == pytest.approx(1e3 * here.time, rel=1e-9)
    assert there.contraction == pytest.approx(here.contraction, rel=1e-8, abs=1e-9)
    assert there.radius == pytest.approx(here.radius, rel=2e-3)
    factor = 1e2 / 1e3 if state == "speed" else 1.0
    assert there.extents[state] == pytest.approx(factor * here.extents[state], rel=2e-3)


@pytest.mark.slow
def test_the_command_writes_the_recovery_of_an_orbit_of_events(tmp_path: Path) -> None:
    orbit = event_orbit("hopper")
    path, file = tmp_path / "orbit.json", tmp_path / "recovery.json"
    zo.write_orbit(orbit, path)
    answer = ask("recovery", path, "-o", file)
    assert answer.code == YES
    assert answer.out.startswith("A small disturbance decays to 1 % in 4 periods (1.95781 s)")
    assert "300 samples return: with confidence 95 %" in answer.out
    assert json.loads(file.read_text()) == ask("recovery", path, "--json").data
    read = read_recovery(file)
    assert read.as_json() == zo.recovery(orbit).as_json()


def test_orbits_of_events_that_are_unstable_open_or_of_another_problem_are_refused(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(3)
    o = next(one for one in iter(lambda: two_sided(rng), None) if rate_of(one) > 1.5)
    unstable = zo.find_orbit(
        "clapper",
        parameters={
            "c": o.c,
            "omega": o.omega,
            "d": o.stop,
            "restitution": o.restitution,
            "A": o.amplitude,
        },
        start={
            "place": o.state(0.1 * o.half)[0],
            "speed": o.state(0.1 * o.half)[1],
            "cosine": math.cos(0.1 * math.pi + o.phase),
            "sine": math.sin(0.1 * math.pi + o.phase),
        },
        until=5.5 * o.half,
        allow_unstable=True,
    ).unwrap()
    hopper = event_orbit("hopper")
    faster = {**hopper.start_state, "speed": 1.1 * hopper.start_state["speed"]}
    for orbit, said in (
        (unstable, "must be stable, but its spectral radius is"),
        (replace(hopper, start_state=faster), "must be closed"),
    ):
        path = tmp_path / "orbit.json"
        zo.write_orbit(orbit, path)
        answer = ask("recovery", path)
        assert answer.code == MISUSE
        assert answer.err.count("\n") == 1
        assert said in answer.err
    zo.write_orbit(hopper, path)
    answer = ask("recovery", path, "--problem", "clapper")
    assert answer.code == MISUSE
    assert answer.err.count("\n") == 1
    assert "`hopper`" in answer.err
