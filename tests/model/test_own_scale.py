"""The own scale of a problem: everyday sizes are 1, others go with the units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.elastic_machines import line
from tests.support.families import CIRCLE
from tests.support.mechanisms import machine_of
from tests.support.one_stop import one_stop_problems
from tests.support.units import Units, in_units
from zeno_orbits.model import UNIT_SCALES, CharacteristicScales, constraint_sizes, own_time

TABLE = zo.load_problem("vibrating_table")


@pytest.mark.parametrize("name", one_stop_problems())
def test_a_bundled_problem_has_everyday_sizes_in_si_units(name: str) -> None:
    problem = zo.load_problem(name)
    own = problem.dynamics(problem.values()).own
    ones = (own.time, own.gap, own.gap_rate, own.gap_acceleration, own.multiplier, *own.sizes)
    assert set(ones) == {1.0}
    assert own.least == own.energy == 1.0


def test_sizes_far_from_one_are_those_of_the_machine() -> None:
    # g / omega^2 = 1.09e-8 km, over omega^-1 = 3.3e7 ns, and so on: nearest powers of a thousand.
    table = in_units(TABLE, Units(length=1e-6, time=1e9))
    own = table.dynamics(table.values()).own
    length, time = 9.81 / 900 * 1e-6, 1e9 / 30
    # With the table's own acceleration, 1.4 times gravity, on top.
    length *= 1 + 0.015 * 900 / 9.81
    for size, known in (
        (own.time, time),
        (own.gap, length),
        (own.gap_rate, length / time),
        (own.gap_acceleration, length / time**2),
        (own.multiplier, 0.05 * length / time**2),
        (own.sizes[0], length),
        (own.sizes[1], length / time),
    ):
        assert math.log10(size) % 3 == pytest.approx(0.0, abs=1e-9)
        assert abs(math.log10(size / known)) <= 1.5
    assert own.sizes[2:] == ()
    assert own.states(4) == pytest.approx([*own.sizes, 1.0, 1.0])
    assert own.rates(1, 3) == pytest.approx([own.sizes[1], own.sizes[1] / own.time, 1 / own.time])
    assert own.least == min(own.sizes)
    assert own.energy == own.multiplier * own.gap


def test_a_state_that_is_next_to_nothing_gets_the_largest_size() -> None:
    own = CharacteristicScales(sizes=(1e-6, 1e3))
    sizes = np.array([2e-6, 1e-7, 3.0])
    # In own sizes 2, 1e-10 and 3; the speed has none of its own.
    assert own.not_small(sizes, 1e-9) == pytest.approx([2e-6, 3e3, 3.0])
    assert own.not_small(np.zeros(3), 1e-9) == pytest.approx([1e-6, 1e3, 1.0])
    assert UNIT_SCALES.not_small(sizes, 1e-9) == pytest.approx(sizes)


def test_numbers_beyond_all_sizes_do_not_warn() -> None:
    values = TABLE.values(parameters={"omega": 1e200, "A": 1e-300})
    assert TABLE.dynamics(values).own.least <= 1.0


@pytest.mark.parametrize("stiffness", [1e-3, 0.37, 0.74, 3.7, 60.0, 1e6])
def test_masses_that_move_freely_as_a_whole_have_the_time_of_their_oscillation(
    stiffness: float,
) -> None:
    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        masses = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=(1.3 * v[0] ** 2 + 0.9 * v[1] ** 2) / 2,
            potential=p["k"] * (q[1] - q[0]) ** 2 / 2,
            stops=(zo.Stop(name="wall", gap=q[1] + 0.3, restitution=0.7),),
        )
        return zo.hybrid_system(masses, zo.no_drive(masses))

    problem = machine_of(model, line(2), {"k": stiffness})
    dynamics = problem.graph_dynamics(problem.values()).first
    known = 2 * math.pi * math.sqrt(1.3 * 0.9 / 2.2 / stiffness)
    # The double eigenvalue zero is rounded to 1e-8, which may turn.
    assert own_time(dynamics, np.zeros(4)) == pytest.approx(known, rel=1e-9)
    start = {"q0": 0.1, "q1": 0.1, "v0": -2.0, "v1": -2.0}
    run = zo.simulate(problem, until=0.21, start=start)
    assert run.impacts[0].time == pytest.approx(0.2, abs=1e-12)


def test_a_constraint_has_the_size_of_its_terms() -> None:
    bob = CIRCLE.at(m=0.7, l=400.0, g=9.81e3, e=0.5)
    x = np.array([400.0 * math.sin(0.5), -400.0 * math.cos(0.5), 0.0, 0.0])
    # x^2 + y^2 - l^2, then its rate 2 (x x' + y y') with speeds of size 1.
    expected = [2 * 400.0**2, 800.0 * (math.sin(0.5) + math.cos(0.5))]
    assert constraint_sizes(bob, x) == pytest.approx(expected, rel=1e-12)


def pressed(p: Mapping[str, ca.SX], *, has_far: bool = True) -> zo.CompletedSystem:
    """Return a mass that a force presses to a stop, tied by a soft spring to another mass."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    clock = zo.Clock.at(p["omega"])
    masses = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(p["m"] * v[0] ** 2 + v[1] ** 2) / 2,
        potential=p["F"] * q[0] + p["k"] * (q[1] - q[0]) ** 2 / 2,
        applied_force=ca.vertcat(0.0, 1e-9 * p["F"] * clock.sine),
        clock=clock,
        stops=(
            zo.Stop(name="near", gap=q[0] + p["d"] - p["e"], restitution=0.5),
            zo.Stop(name="far", gap=2 * p["d"] - q[0], restitution=0.5),
        )[: 1 + has_far],
    )
    return zo.hybrid_system(masses, zo.no_drive(masses))


@pytest.mark.parametrize("omega", [1e-7, 1e3])
@pytest.mark.parametrize("k", [0.0, 1e-10, 1e-3])
@pytest.mark.parametrize(("m", "F", "d"), [(1e-9, 1e-2, 1e-6), (1.0, 10.0, 0.1), (1e-6, 1e6, 1e-3)])
def test_an_open_gap_is_open_however_slow_the_clock_and_the_spring_are(
    m: float, F: float, d: float, k: float, omega: float
) -> None:
    values = {"m": m, "F": F, "d": d, "k": k, "omega": omega, "e": 0.0}
    problem = machine_of(pressed, line(2) | {"cosine": "1", "sine": "1"}, values)
    fall = math.sqrt(2 * d * m / F)
    run = zo.simulate(problem, until=1.1 * fall)
    # The soft spring delays the impact by a part of about k t^2 / 12 m.
    assert run.impacts[0].time == pytest.approx(fall, rel=1e-9 + k * fall**2 / m)


def test_a_gap_that_is_the_rounding_of_parameters_is_closed() -> None:
    values = {"m": 1.0, "F": 10.0, "d": 0.1 + 0.2, "k": 0.0, "omega": 1e-3, "e": 0.3}
    assert 0.0 < values["d"] - values["e"] < 1e-16
    model = partial(pressed, has_far=False)
    problem = machine_of(model, line(2) | {"cosine": "1", "sine": "1"}, values)
    assert problem.graph_dynamics(problem.values()).own.time >= 1.0
    run = zo.simulate(problem, until=1.0)
    assert [arc.mode.value for arc in run.arcs] == ["locked"]


def walls_in_two_units(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a mass between two walls, whose gaps are in metres and in micrometres."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=v**2 / 2,
        potential=p["k"] * q**2 / 2,
        stops=(
            zo.Stop(name="left", gap=q + 1, restitution=0.5),
            zo.Stop(name="right", gap=1e6 * (1 - q), restitution=0.5),
        ),
    )
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism))


@pytest.mark.slow
def test_scales_do_not_depend_on_what_was_asked_for_before() -> None:
    # More values than are kept, with times from nanoseconds to years.
    rates = 10.0 ** np.linspace(-9.0, 9.0, 70)

    def scales_of(problem: zo.Problem, order: int) -> list[CharacteristicScales]:
        found: dict[float, CharacteristicScales] = {}
        for omega in [*rates[::order], *rates]:
            values = problem.values(parameters={"omega": float(omega), "A": 10 / float(omega) ** 2})
            found[float(omega)] = problem.dynamics(values).own
        return [found[float(omega)] for omega in rates]

    forward = scales_of(TABLE, 1)
    assert forward == scales_of(replace(TABLE, name="copy"), -1)
    # Powers of a thousand.
    assert len({one.time for one in forward}) == 7


def test_each_stop_has_the_scale_of_its_own_gap() -> None:
    walls = machine_of(walls_in_two_units, line(1), {"k": 1.0})
    for _ in range(2):
        # The second machine has the scales of the first one.
        left, right = walls.graph_dynamics(walls.values()).open_views
        assert (left.own.gap, right.own.gap) == (1.0, 1e6)
