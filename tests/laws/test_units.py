"""The same machine in other units gets the same answers from every command.

Laws hold in any units, so a problem with its numbers converted is the same machine; what is told of
it has to be the converted numbers. Only the rounding of these numbers differs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.units import Units, dimension_of, in_units

GRAMS = Units(mass=1e3, length=1e3, time=1e3)
"""Gram, millimetre, millisecond."""
FAR = [
    Units(length=length, time=time)
    for length in (1e-6, 1.0, 1e6)
    for time in (1e-6, 1.0, 1e6)
    if not length == time == 1.0
]
CORNERS = [units for units in FAR if 1.0 not in (units.length, units.time)]
MIXED = Units(mass=1e-3, length=1e3, time=1e-3)
PROBLEMS = (
    "vibrating_table",
    "forced_oscillator",
    "impact_oscillator",
    "motor_pendulum",
    "motor_valve",
    "motor_cart",
    "torque_pendulum",
    "two_tone_table",
    "curved_surface",
)
SAME = 1e-9
"""Relative; all but maps are far nearer."""

Told = dict[str, float]


def name_of(units: Units) -> str:
    return f"{units.mass:g}-{units.length:g}-{units.time:g}"


def simulated(problem: zo.Problem, units: Units) -> Told:
    """Return times of the last events, and the last state, in SI units."""
    periods = 2.2 * SIMULATED[problem.name] * units.time
    motion = zo.simulate(problem, until=periods)
    sizes = units.state([dimension_of(unit) for unit in problem.state_units])
    told = {f"impacts {len(motion.impacts)}": 1.0, f"releases {len(motion.releases)}": 1.0}
    told["last event"] = motion.events[-1].time / units.time
    ends = zip(problem.state_names, motion.end_state / sizes, strict=True)
    return told | {name: float(value) for name, value in ends}


SIMULATED = {
    "vibrating_table": 0.21,
    "forced_oscillator": 6.3,
    "impact_oscillator": 6.3,
    "motor_pendulum": 1.8,
    "motor_valve": 0.4,
    "motor_cart": 1.0,
    "torque_pendulum": 2.1,
    "two_tone_table": 0.21,
    "curved_surface": 0.21,
}
"""Period of the orbit of each, about [s]."""


def searched(problem: zo.Problem, units: Units) -> Told:
    """Return what a search and the check of its orbit tell, in SI units."""
    orbit = zo.find_orbit(problem).unwrap()
    seen = zo.verify(orbit, problem=problem)
    assert seen.passed, seen.verdict()
    dimensions = map(dimension_of, problem.state_units)
    sizes = dict(zip(problem.state_names, map(units.factor, dimensions), strict=True))
    told = {f"shape {orbit.shape.text}": 1.0, f"stable {seen.stable}": 1.0}
    told["period"] = orbit.period / units.time
    told["radius"] = 1.0 + seen.spectral_radius
    start = orbit.phases[0].start_state
    return told | {name: value / sizes[name] for name, value in start.items()}


def mapped(problem: zo.Problem, units: Units) -> Told:
    """Return what a map of four points tells, in SI units."""
    x, y = ((name, *_around(problem, name), 2) for name in _two(problem))
    plane = zo.parameter_map(problem, x=x, y=y)
    told: Told = {}
    for k, one in enumerate(plane.attractors):
        told[f"{k} {one.phrase}"] = 1.0
        told[f"{k} period"] = one.period / units.time
        # A map takes multipliers from steps of a local error of 1e-8: to 1e-5, as it promises 1e-3.
        told[f"{k} radius"] = 1.0 + 1e-4 * one.spectral_radius
    return told


def followed(problem: zo.Problem, _units: Units) -> Told:
    """Return what a family in the first number tells."""
    orbit = zo.find_orbit(problem).unwrap()
    name = _two(problem)[0]
    low, high = _around(problem, name)
    family = zo.continue_orbit(orbit, (name, low, high), problem=problem).families[0]
    told = {f"ends {sorted((family.first.kind.value, family.last.kind.value))}": 1.0}
    points = sorted((point.value, point.period) for point in family.points)
    values, periods = np.array(points).T
    at = np.linspace(low, high, 5)
    found = np.interp(at, values, periods) / SIMULATED[problem.name] / _units.time
    return told | {f"period {k}": float(value) for k, value in enumerate(found)}


def _two(problem: zo.Problem) -> tuple[str, str]:
    numbers = problem.values().number
    names = [name for name in problem.names if name not in {"restitution", "m", "c"}]
    first, second, *_ = [name for name in names if numbers(name)]
    return first, second


def _around(problem: zo.Problem, name: str) -> tuple[float, float]:
    value = problem.values().number(name)
    low, high = sorted((0.999 * value, 1.001 * value))
    return low, high


def difference(told: Told, wanted: Told) -> float:
    """Return the largest difference, relative to 1 or the number; the names must be the same."""
    assert sorted(told) == sorted(wanted)
    pairs = [(told[name], wanted[name]) for name in told]
    return max(
        abs(a - b) / max(abs(b), 1e-3) for a, b in pairs if not (np.isnan(a) and np.isnan(b))
    )


def require_same(
    ask: Callable[[zo.Problem, Units], Told], name: str, units: Units, within: float = SAME
) -> None:
    problem = zo.load_problem(name)
    assert difference(ask(in_units(problem, units), units), in_si(ask, name)) < within


@cache
def in_si(ask: Callable[[zo.Problem, Units], Told], name: str) -> Told:
    """Return what a command tells of a bundled problem as it is."""
    return ask(zo.load_problem(name), Units())


@pytest.mark.parametrize("units", fast(5, [GRAMS, MIXED, *FAR]), ids=name_of)
@pytest.mark.parametrize("name", ["vibrating_table", "motor_valve"])
def test_a_simulation_is_the_same(name: str, units: Units) -> None:
    require_same(simulated, name, units)


def test_steps_are_measured_in_the_size_of_each_state() -> None:
    # Velocities of 1e11 beside a clock of 1: one absolute error for all is rounding of velocities.
    require_same(simulated, "curved_surface", FAR[5])


@pytest.mark.parametrize("time", [1e-12, 1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e9])
def test_a_ball_thrown_from_its_stop_lands_in_any_unit_of_time(time: float) -> None:
    # It starts at height zero, so its speed alone tells its size.
    ball = zo.load_problem("bouncing_ball")
    ball = replace(ball, starts=({"speed": 1.0 / time},))
    g = 9.81 / time**2
    run = zo.simulate(ball, until=2.0 * time, parameters={"g": g, "restitution": 0.5})
    flight = 2.0 / time / g
    assert run.impacts[0].time == pytest.approx(flight, rel=1e-12)
    assert run.zeno_points[0].time == pytest.approx(2.0 * flight, rel=1e-11)


@pytest.mark.parametrize("omega", [1e-9, 1e-7, 1e-5])
@pytest.mark.parametrize("start", [{"cosine": 1.0}, {"distance": 0.1, "cosine": 1.0}])
def test_an_oscillator_strikes_in_its_own_time_under_a_force_of_years(
    start: Told, omega: float
) -> None:
    slow = replace(zo.load_problem("forced_oscillator"), starts=(start,))
    numbers = {"c": 0.0, "A": 0.2, "stop": -0.3, "omega": omega}
    run = zo.simulate(slow, until=3.0, parameters=numbers, start={"distance": 0.1, "cosine": 1.0})
    # About its rest at -0.5 it turns by the angle whose cosine is 5 / 6; the force hardly changes.
    assert run.impacts[0].time == pytest.approx(math.acos(5.0 / 6.0), rel=1e-9)


@pytest.mark.parametrize("units", [MIXED, FAR[0], FAR[2], FAR[5], FAR[7]], ids=name_of)
def test_a_map_is_the_same(units: Units) -> None:
    require_same(mapped, "vibrating_table", units)


@pytest.mark.parametrize("units", [FAR[2], FAR[5]], ids=name_of)
def test_an_orbit_is_the_same(units: Units) -> None:
    require_same(searched, "forced_oscillator", units)


@pytest.mark.slow
@pytest.mark.parametrize("units", [MIXED, *CORNERS[1:3]], ids=name_of)
@pytest.mark.parametrize("ask", [simulated, searched, mapped, followed])
@pytest.mark.parametrize("name", PROBLEMS)
def test_every_command_tells_the_same(
    name: str, ask: Callable[[zo.Problem, Units], Told], units: Units
) -> None:
    if ask is followed and name == "two_tone_table":
        pytest.skip("`continue` follows one release a period")
    require_same(ask, name, units)
