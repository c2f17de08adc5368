"""Searches of the pendulum in other units of mass, length and time find the same orbit."""

from __future__ import annotations

import math

import pytest

from tests.support.units import PENDULUM, Units
from zeno_orbits import MinPeak, NearestGains, TargetAmplitude
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import Bound
from zeno_orbits.search import Objective, SearchSettings, orbit_at_gains, search_orbits

ONCE = SearchSettings(n_starts=0)
SAME = 1e-7
"""Asked of gains: solutions agree with a simulation to 3e-10, optima with each other to 1e-8."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.parametrize(
        "units",
        [
            Units(time=1e3),
            Units(mass=1e3, length=1e3),
            Units(mass=1e-3, length=1e-3, time=1e-3),
        ],
        ids=["ms", "g, mm", "t, km, ks"],
    ),
]


def _in(units: Units, values: ParameterValues) -> ParameterValues:
    return ParameterValues(
        gains=units.numbers(values.gains, PENDULUM),
        parameters=units.numbers(values.parameters, PENDULUM),
    )


def _box(units: Units, **box: tuple[float, float]) -> dict[str, tuple[float, float]]:
    factor = {name: units.factor(PENDULUM[name]) for name in box}
    return {name: (low * factor[name], high * factor[name]) for name, (low, high) in box.items()}


def test_an_orbit_is_followed_to_other_gains(problem: Problem, units: Units) -> None:
    def period(units: Units) -> float:
        first = orbit_at_gains(problem, _in(units, problem.values())).unwrap()
        other = _in(units, problem.values(gains={"Kp": 4.0}))
        result = search_orbits(problem, other, free={}, near=first, settings=ONCE)
        return result.unwrap().period / units.time

    assert period(units) == pytest.approx(period(Units()), rel=1e-9)


@pytest.mark.parametrize(
    ("objective", "bound"),
    [
        (MinPeak(signal="current"), ("locked_time", 0.485, (0, 0, 1))),
        (TargetAmplitude(state="theta1", target=1.59), ("period", 1.8, (0, 0, 1))),
        (NearestGains(target={}), ("first_impact_speed", 17.1, (0, 0, -1))),
    ],
    ids=["peak", "amplitude", "bound"],
)
def test_free_gains_are_the_same(
    problem: Problem,
    units: Units,
    objective: Objective,
    bound: tuple[str, float, tuple[int, int, int]],
) -> None:
    name, least, dimension = bound

    def gains(units: Units) -> dict[str, float]:
        result = search_orbits(
            problem,
            _in(units, problem.values()),
            free=_box(units, Kp=(2.0, 3.5)),
            objective=objective,
            bounds=(Bound(name=name, lower=least * units.factor(dimension), upper=math.inf),),
            settings=ONCE,
        )
        found = result.unwrap().gains
        return {name: value / units.factor(PENDULUM[name]) for name, value in found.items()}

    assert gains(units) == pytest.approx(gains(Units()), rel=SAME)
