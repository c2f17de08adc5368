"""Orbits that strike one stop of a machine of events, and meet no other event.

The oscillator has its closed form in `tests/reference/linear_impacts.py`: the multipliers are those
of the saltation matrix times a matrix exponential. Its stop moves with a parameter, and its place
is a state, so the set of states just after an impact moves too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq, fsolve

import zeno_orbits as zo
from tests.reference.linear_impacts import ImpactOscillator
from tests.support.cases import fast
from tests.support.mechanisms import machine_of, walled_oscillator
from zeno_orbits.continuation import SpecialPointKind
from zeno_orbits.maps import AttractorClass
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import EventReturn, SectionMode, closed_return, start_by_parameters

STATES = {"x": "m", "v": "m/s", "cosine": "1", "sine": "1"}


OSCILLATOR = machine_of(
    partial(walled_oscillator, wall=1),
    STATES,
    {"restitution": 0.6, "c": 0.2, "omega": 1.5, "d": 0.2, "A": 1.0},
)
CASES = (
    # omega, c, d, e, and the time and velocity just after an impact, to one digit.
    (1.6329, 0.3805, 0.3527, 0.3014, 0.8, -0.4),
    (1.7692, 0.2151, 0.4977, 0.7904, 0.8, -2.2),
    (1.9026, 0.2951, 0.2508, 0.4945, 1.0, -0.7),
    (1.7784, 0.3985, 0.4592, 0.5300, 1.3, -0.4),
    (1.3441, 0.3671, -0.1183, 0.5716, 0.2, -0.7),
)


def _orbit_of(machine: ImpactOscillator, near: tuple[float, float]) -> tuple[float, float]:
    """Return time and velocity of the orbit in closed form, just after its impact."""
    root = fsolve(lambda u: machine.miss(*u), near, xtol=1e-14, full_output=True)[0]
    assert np.max(np.abs(machine.miss(*root))) < 1e-13
    return float(root[0]), float(root[1])


def _multipliers(machine: ImpactOscillator, time: float, velocity: float) -> list[complex]:
    found: list[complex] = np.linalg.eigvals(machine.monodromy(time, velocity)).tolist()
    return sorted(map(complex, found), key=lambda mu: (-abs(mu), -mu.imag))


def _case(case: tuple[float, ...]) -> tuple[ImpactOscillator, dict[str, float], dict[str, float]]:
    """Return an oscillator, its parameters, and its state just after an impact."""
    omega, c, d, e, time, velocity = case
    machine = ImpactOscillator(amplitude=1.0, omega=omega, damping=c, stop=d, restitution=e)
    time, velocity = _orbit_of(machine, (time, velocity))
    angle = omega * time
    state = {"x": d, "v": velocity, "cosine": math.cos(angle), "sine": math.sin(angle)}
    return machine, {"omega": omega, "c": c, "d": d, "restitution": e, "A": 1.0}, state


@pytest.mark.parametrize("case", CASES)
def test_the_multipliers_are_those_of_the_saltation_matrix(case: tuple[float, ...]) -> None:
    machine, parameters, state = _case(case)
    orbit = zo.find_orbit(OSCILLATOR, parameters=parameters, start=state).unwrap()
    assert orbit.sequence == ("impact wall",)
    assert dict(orbit.start_state) == pytest.approx(state, abs=1e-10)
    # The start is a state just after an impact, up to rounding.
    assert abs(orbit.start_state["x"] - machine.stop) < 1e-15
    time = math.atan2(orbit.start_state["sine"], orbit.start_state["cosine"]) / machine.omega
    exact = _multipliers(machine, time, orbit.start_state["v"])
    assert orbit.floquet_multipliers == pytest.approx(exact, abs=1e-9)
    product = machine.restitution**2 * math.exp(-machine.damping * machine.period)
    assert math.prod(map(abs, orbit.floquet_multipliers)) == pytest.approx(product, rel=1e-9)
    assert orbit.certificate["passed"]
    assert orbit.certificate["stable"]


def test_maps_have_the_multipliers_of_the_saltation_matrix() -> None:
    machine, parameters, _ = _case(CASES[0])
    fixed = {name: value for name, value in parameters.items() if name not in ("restitution", "d")}
    found = zo.parameter_map(
        OSCILLATOR,
        x=("restitution", 0.25, 0.3014, 2),
        y=("d", 0.34, 0.3527, 2),
        parameters=fixed,
    )
    for k, one in enumerate(found.attractors):
        e, d = found.x.values()[k % 2], found.y.values()[k // 2]
        there = replace(machine, restitution=e, stop=d)
        exact = _multipliers(there, *_orbit_of(there, (0.8, -0.4)))
        assert one.fate is AttractorClass.NO_ZENO
        assert one.sequence == ("impact wall",)
        assert one.multipliers == pytest.approx(exact, abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parameter", "box"),
    fast(1, [("d", (0.2, 0.45)), ("A", (0.9, 1.3)), ("restitution", (0.2, 0.5))]),
)
def test_families_have_their_closed_form(parameter: str, box: tuple[float, float]) -> None:
    machine, parameters, state = _case(CASES[0])
    orbit = zo.find_orbit(OSCILLATOR, parameters=parameters, start=state).unwrap()
    (family,) = zo.continue_orbit(orbit, (parameter, *box), problem=OSCILLATOR).families
    ends = {special.kind for special in (family.first, family.last)}
    assert ends == {SpecialPointKind.BOUND}
    assert len(family.points) > 5
    field = {"d": "stop", "A": "amplitude", "restitution": "restitution"}[parameter]
    for point in family.points:
        there = replace(machine, **{field: point.value})
        time = math.atan2(point.state["sine"], point.state["cosine"]) / machine.omega
        assert np.max(np.abs(there.miss(time, point.state["v"]))) < 1e-10
        assert point.state["x"] == pytest.approx(there.stop, abs=1e-13)
        exact = _multipliers(there, time, point.state["v"])
        assert [mu for mu in point.multipliers if abs(mu) > 1e-6] == pytest.approx(exact, abs=1e-8)


@pytest.mark.parametrize("parameter", ["d", "A", "restitution", "c"])
def test_an_orbit_moves_with_a_parameter_as_its_differences_do(parameter: str) -> None:
    _, parameters, state = _case(CASES[0])
    x = np.array([state[name] for name in STATES])
    order = list(OSCILLATOR.values().numbers)

    def closed(change: float) -> tuple[GraphDynamics, EventReturn]:
        values = {**parameters, parameter: parameters[parameter] + change}
        graph = OSCILLATOR.graph_dynamics(OSCILLATOR.values(parameters=values))
        found = closed_return(
            graph,
            x,
            section="impact wall",
            n_returns=1,
            guess=2 * math.pi / parameters["omega"],
            settings=zo.SimulationSettings(),
            parameters=[order.index(parameter)],
            mode=SectionMode(closed=(), sides=(), stop="wall"),
        )
        return graph, found

    step = 1e-4
    graph, found = closed(0.0)
    moved = start_by_parameters(graph, found)[:, 0]
    slope = (closed(step)[1].start - closed(-step)[1].start) / (2 * step)
    assert moved == pytest.approx(slope, abs=1e-6)


@pytest.mark.slow
def test_a_search_moves_the_stop_past_the_last_start() -> None:
    machine, parameters, state = _case(CASES[0])

    def impact_speed(stop: float) -> float:
        there = replace(machine, stop=stop)
        return -_orbit_of(there, (0.8, -0.4))[1] / machine.restitution

    found = zo.search_gains(
        OSCILLATOR,
        vary={"d": (0.28, 0.45)},
        parameters=parameters,
        start=state,
        bounds=[zo.Bound(name="wall.impact_speed", lower=1.44)],
    )
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    exact = brentq(lambda stop: impact_speed(stop) - 1.44, 0.3, machine.stop)
    assert found.free["d"] == pytest.approx(exact, abs=1e-6)


DUFFING = {"k": 1.0, "k3": 0.5, "h0": -0.3, "c": 0.15, "F": 2.0, "omega": 2.0}
STATED = {"h": "m", "v": "m/s", "cosine": "1", "sine": "1"}


def _duffing(p: Mapping[str, ca.SX], *, by_stops: bool) -> zo.CompletedSystem:
    """Return a mass on a cubic spring above a stop, declared by its stops or by its gap."""
    h, v, clock = ca.SX.sym("h"), ca.SX.sym("v"), zo.Clock.at(p["omega"])
    wall = zo.Stop(name="wall", gap=h, restitution=p["restitution"])
    mechanism = zo.HybridLagrangian.from_energies(
        q=h,
        v=v,
        kinetic=v**2 / 2,
        potential=p["k"] * (h - p["h0"]) ** 2 / 2 + p["k3"] * (h - p["h0"]) ** 4 / 4,
        passive_force=-p["c"] * v,
        applied_force=-p["F"] * clock.cosine,
        clock=clock,
        gap=None if by_stops else h,
        stops=(wall,) if by_stops else (),
    )
    return zo.hybrid_system(
        mechanism, zo.no_drive(mechanism), None if by_stops else p["restitution"]
    )


@pytest.mark.parametrize("force", [0.95, 1.4, 2.0])
def test_a_stop_and_a_gap_are_one_machine(force: float) -> None:
    by_stops = machine_of(partial(_duffing, by_stops=True), STATED, {"restitution": 0.6, **DUFFING})
    by_gap = machine_of(partial(_duffing, by_stops=False), STATED, {"restitution": 0.6, **DUFFING})
    one = zo.find_orbit(by_stops, parameters={"F": force}).unwrap()
    other = zo.find_orbit(by_gap, parameters={"F": force}).orbit
    assert other is not None
    assert one.period == pytest.approx(other.period, rel=1e-10)
    assert one.floquet_multipliers == pytest.approx(other.floquet_multipliers, abs=1e-8)


def _bead(p: Mapping[str, ca.SX], *, on_circle: bool) -> zo.CompletedSystem:
    """Return a driven pendulum against a stop, by its angle or by its place on a circle."""
    clock = zo.Clock.at(p["omega"])
    size = 1 if not on_circle else 2
    q, v = ca.SX.sym("q", size), ca.SX.sym("v", size)
    if on_circle:
        x, y = q[0], q[1]
        force = p["A"] * clock.cosine * ca.vertcat(-y, x) - p["c"] * v
        potential, gap = y, x + p["s"]
        held = (x**2 + y**2 - 1) / 2
    else:
        # The angle is zero below, and grows with x.
        force = p["A"] * clock.cosine - p["c"] * v
        potential, gap, held = -ca.cos(q), ca.sin(q) + p["s"], None
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.dot(v, v) / 2,
        potential=potential,
        applied_force=force,
        clock=clock,
        stops=(zo.Stop(name="wall", gap=gap, restitution=p["restitution"]),),
        holonomic=held,
    )
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism))


@pytest.mark.slow
def test_multipliers_do_not_depend_on_coordinates_with_a_constraint() -> None:
    own = {"A": 0.8, "c": 0.3, "omega": 1.5, "s": 0.1}
    angle = machine_of(partial(_bead, on_circle=False), STATED, {"restitution": 0.6, **own})
    places = {"x": "m", "y": "m", "vx": "m/s", "vy": "m/s", "cosine": "1", "sine": "1"}
    circle = machine_of(partial(_bead, on_circle=True), places, {"restitution": 0.6, **own})
    one = zo.find_orbit(angle).unwrap()
    other = zo.find_orbit(circle, start={"y": -1.0, "cosine": 1.0}).unwrap()
    assert one.sequence == other.sequence == ("impact wall",)
    assert one.period == pytest.approx(other.period, rel=1e-10)
    assert one.floquet_multipliers == pytest.approx(other.floquet_multipliers, abs=1e-8)


@pytest.mark.parametrize("omega", [1e-9, 1e-6, 1e-3])
def test_a_constraint_leaves_the_own_time_of_an_oscillation_under_a_slow_clock(
    omega: float,
) -> None:
    own = {"restitution": 0.6, "A": 0.01, "c": 0.0, "omega": omega, "s": 0.1}
    places = {"x": "m", "y": "m", "vx": "m/s", "vy": "m/s", "cosine": "1", "sine": "1"}
    start = {"x": math.sin(0.3), "y": -math.cos(0.3), "cosine": 1.0}
    circle = replace(machine_of(partial(_bead, on_circle=True), places, own), starts=(start,))
    angle = machine_of(partial(_bead, on_circle=False), STATED, own)
    first = next(iter(STATED))
    times = [
        zo.simulate(problem, until=3.0, start=begin).impacts[0].time
        for problem, begin in ((circle, start), (angle, {first: 0.3, "cosine": 1.0}))
    ]
    assert times[0] == pytest.approx(times[1], rel=1e-9)


@pytest.mark.slow
def test_zeno_points_of_the_transient_do_not_hide_an_orbit_of_impacts() -> None:
    numbers = {"restitution": 0.45}
    # The voltage never reaches this limit.
    limited = zo.find_orbit("limited_pendulum", parameters={**numbers, "U": 100.0}).unwrap()
    free = zo.find_orbit("motor_pendulum", parameters=numbers).orbit
    assert free is not None
    assert limited.sequence == ("impact stop",) * 4
    assert limited.period == pytest.approx(free.period, rel=1e-10)
    largest = [mu for mu in free.floquet_multipliers if abs(mu) > 1e-3]
    assert limited.floquet_multipliers[: len(largest)] == pytest.approx(largest, abs=1e-8)
