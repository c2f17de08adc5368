"""Stops with restitution 1: closed forms, an event loop over SciPy, and refusals.

Elastic impacts keep their speed, so they have no Zeno point. Whatever needs one is refused in one
line that names the restitution.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import fsolve

import zeno_orbits as zo
from tests.reference.elastic import Chain, blocks_impacts, blocks_speeds, chain
from tests.reference.linear_impacts import ImpactOscillator
from tests.support.cases import fast
from tests.support.commands import MISUSE, NO, YES, ask
from tests.support.elastic_machines import BLOCKS, line
from tests.support.mechanisms import machine_of, walled_oscillator
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ChatterError, InputError
from zeno_orbits.simulation import FixedImpacts, Impact, SimulationSettings, Truncation

G = 9.81
FALL = math.sqrt(2.0 / G)
"""Time of a fall from 1 m."""
PER_FLIGHT = 1e-14
"""Relative error of a flight at the default tolerance."""


@pytest.mark.parametrize(
    ("k", "count"), fast(4, [(0, 3), (1, 31), (2, 314), (3, 3141), (4, 31415)])
)
def test_two_blocks_and_a_wall_count_the_digits_of_pi(k: int, count: int) -> None:
    mass = 100.0**k
    found = zo.simulate(
        BLOCKS, until=20.0, parameters={"M": mass}, start={"q0": 1.0, "q1": 2.0, "v1": -1.0}
    )
    assert blocks_impacts(mass) == count
    assert len(found.events) == len(found.impacts) == count
    assert [one.stop for one in found.impacts[:3]] == ["block", "wall", "block"]
    # Rounding of one impact, relative to the speeds sqrt(M) and 1, for every impact.
    rounding = 1e-13 * count
    for n in (1, 2, count // 2, count):
        after = found.impacts[n - 1].state_plus[2:]
        inner, outer = blocks_speeds(mass, n, 1.0)
        assert after[0] == pytest.approx(inner, abs=rounding * math.sqrt(mass))
        assert after[1] == pytest.approx(outer, abs=rounding)


def test_two_blocks_lose_their_count_if_they_lose_energy() -> None:
    values = {"M": 100.0**2, "loss": 0.01}
    found = zo.simulate(
        BLOCKS, until=20.0, parameters=values, start={"q0": 1.0, "q1": 2.0, "v1": -1.0}
    )
    assert len(found.impacts) != 314


@pytest.mark.usefixtures("both_loops")
def test_an_elastic_ball_keeps_its_energy_and_period_over_a_thousand_impacts() -> None:
    n = 1000
    found = zo.simulate(
        "bouncing_ball",
        until=2 * FALL * n,
        parameters={"restitution": 1.0},
        start={"height": 1.0},
    )
    assert len(found.events) == len(found.impacts) == n
    times = np.array([one.time for one in found.impacts])
    k = np.arange(n)
    assert np.max(np.abs(times / (FALL * (1 + 2 * k)) - 1)) < PER_FLIGHT * n
    energies = np.array([one.approach_rate**2 / 2 for one in found.impacts])
    assert np.max(np.abs(energies / G - 1)) < PER_FLIGHT * n


@pytest.mark.usefixtures("both_loops")
@pytest.mark.parametrize("e", [1.0 - 1e-16, 1.0 - 1e-9, 0.9999])
def test_a_ball_that_is_nearly_elastic_has_its_geometric_impacts(e: float) -> None:
    n = 200
    found = zo.simulate(
        "bouncing_ball", until=FALL * 2 * n, parameters={"restitution": e}, start={"height": 1.0}
    )
    assert not found.zeno_points
    k = np.arange(len(found.impacts))
    assert len(k) >= n
    # The sum of a geometric series, without cancellation.
    series = e * -np.expm1(k * math.log(e)) / (1 - e)
    times = np.array([one.time for one in found.impacts])
    assert np.max(np.abs(times / (FALL * (1 + 2 * series)) - 1)) < PER_FLIGHT * n


@pytest.mark.usefixtures("both_loops")
@pytest.mark.parametrize(("e", "error"), [(0.9999, 1e-9), (1.0 - 1e-9, 1e-4)])
def test_a_ball_that_is_nearly_elastic_has_its_zeno_point(e: float, error: float) -> None:
    exact = FALL * (1 + e) / (1 - e)
    found = zo.simulate(
        "bouncing_ball", until=2 * exact, parameters={"restitution": e}, start={"height": 1.0}
    )
    (zeno,) = found.zeno_points
    # The bound due to rounding is 1e-14 / (1 - e).
    assert zeno.limit_error < error
    assert zeno.time == pytest.approx(exact, rel=zeno.limit_error)


def shaft(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a ball between a floor and a ceiling whose restitution is a formula."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=v**2 / 2,
        potential=G * q,
        stops=(
            zo.Stop(name="floor", gap=q, restitution=p["restitution"]),
            zo.Stop(name="ceiling", gap=1 - q, restitution=ca.exp(-p["absorption"])),
        ),
    )
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism))


SHAFT = machine_of(shaft, line(1), {"restitution": 0.5, "absorption": 0.0})


@pytest.mark.usefixtures("both_loops")
@pytest.mark.parametrize("absorption", [0.0, 0.1])
def test_each_stop_has_its_own_restitution(absorption: float) -> None:
    up, e, ceiling = 8.0, 0.5, math.exp(-absorption)
    found = zo.simulate(SHAFT, until=5.0, parameters={"absorption": absorption}, start={"v0": up})
    above = math.sqrt(up**2 - 2 * G)
    down = math.sqrt((ceiling * above) ** 2 + 2 * G)
    first = (up - above) / G
    second = first + (down - ceiling * above) / G
    assert [one.stop for one in found.impacts[:3]] == ["ceiling", "floor", "floor"]
    assert found.impacts[0].time == pytest.approx(first, rel=1e-12)
    assert found.impacts[1].time == pytest.approx(second, rel=1e-12)
    assert found.impacts[1].approach_rate == pytest.approx(-down, rel=1e-12)
    (zeno,) = found.zeno_points
    assert zeno.stop == "floor"
    assert zeno.time == pytest.approx(second + 2 * e * down / (G * (1 - e)), rel=1e-11)


@pytest.mark.usefixtures("both_loops")
def test_elastic_impacts_that_do_not_end_are_counted() -> None:
    # A ball on a table that shakes hops at a microscopic height for as long as it runs.
    settings = SimulationSettings(most_impacts=500)
    with pytest.raises(ChatterError, match=r"500 impacts.*elastic.*--max-impacts") as raised:
        zo.simulate(
            "vibrating_table",
            until=10.0,
            parameters={"restitution": 1.0},
            start={"speed": 1e-6, "cosine": 1.0},
            settings=settings,
        )
    assert raised.value.execution is not None
    assert len(raised.value.execution.impacts) == 501


# Random machines.


def chain_problem(one: Chain) -> zo.Problem:
    """Return a chain as a problem."""
    n = one.n

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v, clock = ca.SX.sym("q", n), ca.SX.sym("v", n), zo.Clock.at(p["omega"])
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.dot(ca.DM(one.mass), v**2) / 2,
            potential=ca.dot(ca.DM(one.stiffness), (q - ca.DM(one.place)) ** 2) / 2,
            passive_force=-ca.DM(one.damping) * v,
            applied_force=ca.DM(one.amplitude) * clock.cosine,
            clock=clock,
            stops=tuple(
                zo.Stop(name=str(k), gap=q[k] - (q[k - 1] if k else 0), restitution=float(e))
                for k, e in enumerate(one.restitution)
            ),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    return machine_of(model, line(n) | {"cosine": "1", "sine": "1"}, {"omega": one.omega})


def agree(run: zo.Execution, one: Chain, expected: list[tuple[float, int]]) -> bool:
    """Return True if an execution has the impacts of the event loop, as far as it is accurate."""
    impacts = [event for event in run.events if isinstance(event, Impact)]
    for found, (time, stop) in zip(impacts, expected, strict=False):
        # Impacts of curved chains magnify errors: 1e-11 grows by e^12 in the longest list.
        if found.stop != str(stop) or abs(found.time - time) > 1e-6:
            return False
        before = one.struck(stop, found.state_minus[: 2 * one.n])
        if np.max(np.abs(before - found.state_plus[: 2 * one.n])) > 1e-12 * 10:
            return False
    return len(impacts) >= len(expected)


def run_of(one: Chain, until: float, most: int) -> zo.Execution:
    """Return the execution of a chain, up to a refusal."""
    start = dict(zip(line(one.n), one.start.tolist(), strict=True)) | {"cosine": 1.0}
    settings = SimulationSettings(most_impacts=10 * most)
    try:
        return zo.simulate(chain_problem(one), until=until, start=start, settings=settings)
    except zo.SimulationError as error:
        if error.execution is None:
            raise
        return error.execution


@pytest.mark.usefixtures("both_loops")
@pytest.mark.parametrize("seed", fast(3, range(20)))
def test_random_chains_have_the_impacts_of_an_event_loop(seed: int) -> None:
    one = chain(np.random.default_rng(seed))
    expected = one.impacts(4.0, 25, 1e-4)
    assert expected
    run = run_of(one, 4.0, 25)
    assert agree(run, one, expected)
    if one.is_conservative:
        energies = [one.energy(event.state_plus) for event in run.impacts]
        assert energies == pytest.approx([one.energy(one.start)] * len(energies), rel=1e-11)
    # The comparison fails on a chain that is not quite elastic.
    other = replace(one, restitution=np.where(one.restitution == 1.0, 0.999, one.restitution))
    assert not agree(run, other, expected)


# Orbits.


def test_a_ball_that_bounces_for_ever_is_an_orbit_of_undecided_stability(tmp_path: Path) -> None:
    orbit = zo.find_orbit(
        "bouncing_ball", parameters={"restitution": 1.0}, allow_unstable=True
    ).unwrap()
    assert orbit.shape.text == "impact"
    # Every height has an orbit. The height of the start is known to the tolerance of a guess.
    speed = orbit.start_state["speed"]
    assert speed == pytest.approx(G * FALL, rel=1e-6)
    assert orbit.period == pytest.approx(2 * speed / G, rel=1e-12)
    certificate = zo.verify(orbit)
    assert certificate.passed
    assert "unknown stability" in certificate.verdict()
    multipliers = zo.floquet_multipliers(orbit)
    assert abs(multipliers.values[0] - 1) <= multipliers.error
    file = tmp_path / "ball.json"
    zo.write_orbit(orbit, file)
    assert "undecided" in ask("stability", str(file)).out


OSCILLATOR = machine_of(
    partial(walled_oscillator, wall=1),
    {"x": "m", "v": "m/s", "cosine": "1", "sine": "1"},
    {"restitution": 1.0, "c": 0.0, "omega": 1.5, "d": 0.2, "A": 1.0},
)


@pytest.mark.parametrize(
    ("case", "verdict"),
    [
        # omega, c, d, and the time and velocity just after an impact, to one digit.
        ((1.6329, 0.3805, 0.3527, 0.8, -0.4), "a stable"),
        ((1.7692, 0.2151, 0.4977, 0.8, -2.2), "a stable"),
        ((1.8653681121, 0.0, 0.745510066, -1.7, -3.0), "an unstable"),
        ((1.3874074965, 0.0, 0.7435143919, 0.0, -2.2), "of unknown stability"),
        ((2.2760133720, 0.0, 0.1501190500, 1.4, -0.5), "of unknown stability"),
    ],
)
def test_orbits_with_elastic_impacts_have_the_multipliers_of_the_saltation_matrix(
    case: tuple[float, ...], verdict: str
) -> None:
    omega, c, d, *near = case
    machine = ImpactOscillator(amplitude=1.0, omega=omega, damping=c, stop=d, restitution=1.0)
    time, velocity = fsolve(lambda u: machine.miss(*u), near, xtol=1e-14, full_output=True)[0]
    angle = omega * time
    orbit = zo.find_orbit(
        OSCILLATOR,
        parameters={"omega": omega, "c": c, "d": d},
        start={"x": d, "v": velocity, "cosine": math.cos(angle), "sine": math.sin(angle)},
        allow_unstable=True,
    ).unwrap()
    assert orbit.sequence == ("impact wall",)
    assert orbit.period == pytest.approx(machine.period, rel=1e-12)
    matrix: Vector = machine.monodromy(time, velocity)
    exact = np.linalg.eigvals(matrix)
    found = np.sort_complex(np.array(orbit.floquet_multipliers))
    assert found == pytest.approx(np.sort_complex(exact), abs=1e-9)
    assert abs(np.prod(found)) == pytest.approx(math.exp(-c * machine.period), rel=1e-9)
    assert orbit.certificate["passed"]
    assert verdict in orbit.certificate["verdict"]
    assert zo.verify(orbit, problem=OSCILLATOR).passed


@pytest.mark.slow
def test_a_family_ends_at_elastic_impacts_with_its_closed_form() -> None:
    c, omega, d = 0.3805, 1.6329, 0.3527
    machine = ImpactOscillator(amplitude=1.0, omega=omega, damping=c, stop=d, restitution=0.9)
    time, velocity = fsolve(lambda u: machine.miss(*u), (0.8, -1.8), xtol=1e-14)
    angle = omega * time
    orbit = zo.find_orbit(
        OSCILLATOR,
        parameters={"omega": omega, "c": c, "d": d, "restitution": 0.9},
        start={"x": d, "v": velocity, "cosine": math.cos(angle), "sine": math.sin(angle)},
    ).unwrap()
    (family,) = zo.continue_orbit(orbit, ("restitution", 0.8, 1.0), problem=OSCILLATOR).families
    assert max(point.value for point in family.points) == 1.0
    for point in family.points:
        there = replace(machine, restitution=point.value)
        time = math.atan2(point.state["sine"], point.state["cosine"]) / omega
        assert np.max(np.abs(there.miss(time, point.state["v"]))) < 1e-10
        product = math.prod(abs(mu) for mu in point.multipliers if abs(mu) > 1e-6)
        exact = point.value**2 * math.exp(-c * machine.period)
        assert product == pytest.approx(exact, rel=1e-8)


# Refusals.

NO_POINT = "must be less than 1 for a Zeno point, but it is 1"


@pytest.mark.parametrize(
    "words",
    [
        ("zeno-condition", "bouncing_ball", "--set", "restitution=1"),
        ("zeno-condition", "bouncing_ball", "--at", "height=0", "--set", "restitution=1"),
        ("simulate", "bouncing_ball", "--truncation", "0.01", "--set", "restitution=1"),
        ("search", "motor_pendulum", "--shape", "zeno", "--set", "restitution=1"),
        ("search", "motor_pendulum", "--shape", "zeno", "--vary", "restitution=0.2:1"),
        pytest.param(
            ("search", "kneed_walker", "--section", "zeno knee", "--set", "restitution=1"),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_commands_that_need_a_zeno_point_refuse_elastic_impacts(words: tuple[str, ...]) -> None:
    answer = ask(*words)
    assert answer.code == MISUSE
    assert not answer.out
    last = answer.err.strip().splitlines()[-1]
    assert f"restitution={words[-1].split('=')[1]}: {NO_POINT}" in last


def test_the_formula_of_the_restitution_is_evaluated() -> None:
    def ball(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        floor = zo.Stop(name="floor", gap=q, restitution=ca.cos(p["angle"]))
        mass = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=G * q, stops=(floor,)
        )
        return zo.hybrid_system(mass, zo.no_drive(mass))

    problem = machine_of(ball, line(1), {"angle": 0.0})
    with pytest.raises(InputError, match=NO_POINT):
        zo.zeno_condition(problem)
    assert zo.zeno_condition(problem, parameters={"angle": 0.5}).always


@pytest.mark.parametrize("value", ["1.0000000000001", "-1e-300", "nan", "1.5"])
def test_other_restitutions_beyond_one_are_refused(value: str) -> None:
    answer = ask("simulate", "bouncing_ball", "--until", "1", "--set", f"restitution={value}")
    assert answer.code == MISUSE
    assert len(answer.err.strip().splitlines()) == 1
    assert "restitution" in answer.err


@pytest.mark.parametrize(("absorption", "said"), [(-1e-15, "1.0000000000000"), (-0.1, "1.105")])
def test_a_formula_that_exceeds_one_is_refused_with_all_its_digits(
    absorption: float, said: str
) -> None:
    with pytest.raises(InputError, match=rf"must lie in \[0, 1\] at these values.*{said}"):
        zo.simulate(SHAFT, until=1.0, parameters={"absorption": absorption}, start={"v0": 8.0})


@pytest.mark.parametrize("rule", [Truncation(delta=0.01), FixedImpacts(n_impacts=3)])
def test_sequences_of_elastic_impacts_are_not_ended_by_force(rule: Truncation) -> None:
    settings = SimulationSettings(completion=rule)
    for problem, name in (("bouncing_ball", "height"), (SHAFT, "q0")):
        with pytest.raises(InputError, match=NO_POINT):
            zo.simulate(
                problem, parameters={"restitution": 1.0}, start={name: 0.5}, settings=settings
            )
    # One stop of the shaft is inelastic: its sequences may end.
    found = zo.simulate(SHAFT, until=5.0, start={"q0": 0.5}, settings=settings)
    assert len(found.zeno_points) == 1


@pytest.mark.slow
def test_an_orbit_with_a_zeno_point_is_false_for_elastic_impacts(
    orbit: zo.Orbit, tmp_path: Path
) -> None:
    elastic = replace(orbit, parameters={**orbit.parameters, "restitution": 1.0})
    certificate = zo.verify(elastic)
    assert not certificate.passed
    assert "elastic impacts have no Zeno point" in certificate.verdict()
    file = tmp_path / "elastic.json"
    zo.write_orbit(elastic, file)
    answer = ask("prove", str(file))
    assert answer.code == MISUSE
    assert NO_POINT in answer.err


def test_attractors_are_classified_up_to_restitution_one() -> None:
    found = zo.parameter_map("bouncing_ball", x=("restitution", 0.5, 1.0, 2), y=("g", 5.0, 9.0, 2))
    rest, bounces = found.attractors[0], found.attractors[1]
    assert rest.fate.value == "rest"
    # A motion that returns to itself counts as periodic, to the tolerance of the map.
    assert bounces.period == pytest.approx(2 * math.sqrt(2 / 5.0), rel=1e-5)


def test_the_attractor_of_an_elastic_machine_is_named() -> None:
    answer = ask("simulate", "bouncing_ball", "--until", "1", "--settle", "--set", "restitution=1")
    assert answer.code == YES
    assert "periodic orbit without a Zeno point" in answer.out


def test_a_limit_of_impacts_ends_a_command_in_one_line() -> None:
    answer = ask(
        *("simulate", "bouncing_ball", "--until", "100", "--max-impacts", "20"),
        *("--set", "restitution=1"),
    )
    assert answer.code == NO
    assert "More than 20 impacts" in answer.err
