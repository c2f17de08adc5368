"""Events that meet: kinks on a stop, stops struck together, switches on one surface, openings.

Each truth is a closed form, or flights that this file integrates itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal, localcontext
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import zeno_orbits as zo
from tests.reference.linear_masses import LinearMasses
from tests.support.mechanisms import machine_of
from zeno_orbits.errors import ChatterError
from zeno_orbits.simulation import (
    EventDerivatives,
    SimulationSettings,
    ZenoPoint,
    event_name,
    simulate,
)

G = 9.81
LOCATED = 1e-10
"""Of times and states: a hundred times the tolerance of the integrator."""
RESTED = 2e-12
"""Of times of rest: rounding of the heights, over twenty impacts."""

LINE = {"x": "m", "dx": "m/s"}
Formula = Callable[[ca.SX, ca.SX], ca.SX]


pytestmark = pytest.mark.usefixtures("both_loops")


def named(run: zo.Execution, *kinds: str) -> list[tuple[str, float]]:
    """Return the events of some kinds, each with its time."""
    words = {"Impact": "impact", "ZenoPoint": "zeno", "Release": "release", "SwitchEvent": "switch"}
    found: list[tuple[str, float]] = []
    for event in run.events:
        kind = words[type(event).__name__]
        if not kinds or kind in kinds:
            owner = event.name if isinstance(event, zo.SwitchEvent) else event.stop
            found.append((f"{kind} {owner}", event.time))
    return found


def require(found: list[tuple[str, float]], expected: list[tuple[str, float]]) -> None:
    """Require events with their times."""
    assert [name for name, _ in found] == [name for name, _ in expected]
    assert [time for _, time in found] == pytest.approx([t for _, t in expected], abs=LOCATED)


# A kink that lies on a stop.


def ball(force: Formula, restitution: float) -> zo.Problem:
    """Return a ball over a floor, with a further force."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=G * q,
            passive_force=force(q, v),
            stops=(zo.Stop(name="floor", gap=q, restitution=p["e"]),),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    return machine_of(model, LINE, {"e": restitution})


def bounces(height: float, g: float, e: float) -> tuple[Iterator[float], float]:
    """Return the times of the impacts of a ball, and their limit."""
    first = math.sqrt(2 * height / g)

    def times() -> Iterator[float]:
        time, flight = first, 2 * first * e
        while True:
            yield time
            time, flight = time + flight, flight * e

    return times(), first * (1 + e) / (1 - e)


ON_THE_STOP: dict[str, tuple[Formula, float]] = {
    "bumper": (lambda q, _: 300 * ca.fmax(-q, 0), 0.0),
    "bumper written from below": (lambda q, _: -300 * ca.fmin(q, 0), 0.0),
    "damper": (lambda q, v: -20 * ca.if_else(q < 0, v, 0), 0.0),
    "jump": (lambda q, _: ca.if_else(q < 0, 40, -2), 2.0),
    "half of the modulus": (lambda q, _: 50 * (ca.fabs(q) - q) - 1, 1.0),
    "two kinks": (lambda q, v: 100 * ca.fmax(-q, 0) - ca.if_else(q < 0, v, 0), 0.0),
}
"""Force, and the weight that it adds above the floor."""


@pytest.mark.parametrize("e", [0.0, 0.4, 0.8])
@pytest.mark.parametrize("name", ON_THE_STOP)
def test_a_kink_on_a_stop_is_never_passed(name: str, e: float) -> None:
    force, weight = ON_THE_STOP[name]
    times, limit = bounces(1.0, G + weight, e)
    run = zo.simulate(ball(force, e), until=limit + 0.2, start={"x": 1.0})
    seen = [impact.time for impact in run.impacts]
    assert seen == pytest.approx([next(times) for _ in seen], abs=LOCATED)
    assert [point.time for point in run.zeno_points] == pytest.approx([limit], abs=LOCATED)
    assert not run.switches
    assert run.arcs[-1].closed == ("floor",)


# Stops that are struck together.


def masses(
    restitutions: tuple[float, ...], coupling: float = 0.0, spring: float = 0.0
) -> zo.Problem:
    """Return masses over a floor each. A coupling of inertia or a spring joins the first two."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        n = len(restitutions)
        q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2 + p["c"] * v[0] * v[-1],
            potential=G * ca.sum1(q) + p["k"] * (q[0] - q[-1]) ** 2 / 2,
            stops=tuple(
                zo.Stop(name=f"s{k}", gap=q[k], restitution=e) for k, e in enumerate(restitutions)
            ),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    n = len(restitutions)
    states = {f"x{k}": "m" for k in range(n)} | {f"v{k}": "m/s" for k in range(n)}
    return machine_of(model, states, {"c": coupling, "k": spring})


@pytest.mark.parametrize(
    "restitutions",
    [(0.5, 0.7), (0.3, 0.0), (0.0, 0.6), (0.0, 0.0), (0.2, 0.4, 0.6), (0.7, 0.0, 0.3), (0.0,) * 3],
)
def test_stops_that_are_not_coupled_may_be_struck_together(restitutions: tuple[float, ...]) -> None:
    n = len(restitutions)
    limits = [bounces(1.0, G, e)[1] for e in restitutions]
    start = {f"x{k}": 1.0 for k in range(n)}
    run = zo.simulate(masses(restitutions), until=max(limits) + 0.1, start=start)
    for k, e in enumerate(restitutions):
        seen = [impact.time for impact in run.impacts if impact.stop == f"s{k}"]
        times, limit = bounces(1.0, G, e)
        assert seen == pytest.approx([next(times) for _ in seen], abs=LOCATED)
        rests = [point.time for point in run.zeno_points if point.stop == f"s{k}"]
        assert rests == pytest.approx([limit], abs=LOCATED)
    assert set(run.arcs[-1].closed) == {f"s{k}" for k in range(n)}
    assert run.end_state == pytest.approx(np.zeros(2 * n), abs=LOCATED)


def test_a_spring_does_not_couple_impacts() -> None:
    # Both masses fall alike until they are struck together. Then x' = x0 - x1 oscillates.
    k, (e, f) = 30.0, (0.9, 0.6)
    until = math.sqrt(2 / G) + 0.2
    run = zo.simulate(masses((e, f), spring=k), until=until, start={"x0": 1.0, "x1": 1.0})
    assert len(run.impacts) == 2
    speed, omega = math.sqrt(2 * G), math.sqrt(2 * k)
    mean, apart = (
        (e + f) * speed / 2 * 0.2 - G * 0.02,
        (e - f) * speed / omega * math.sin(0.2 * omega),
    )
    assert run.end_state[:2] == pytest.approx([mean + apart / 2, mean - apart / 2], abs=LOCATED)


@pytest.mark.parametrize("coupling", [0.2, -0.2, 1e-3])
def test_stops_that_are_coupled_may_not_be_struck_together(coupling: float) -> None:
    start = {"x0": 1.0, "x1": 1.0}
    with pytest.raises(zo.SimultaneousEventsError) as caught:
        zo.simulate(masses((0.5, 0.5), coupling), until=2.0, start=start)
    assert caught.value.time == pytest.approx(math.sqrt(2 * (1 + coupling) / G), abs=LOCATED)
    assert "impact s0 and impact s1" in str(caught.value)


def zeno_times(run: zo.Execution) -> dict[str, float]:
    """Return the Zeno time of every stop, which comes to rest once."""
    found = [(event.stop, event.time) for event in run.events if isinstance(event, ZenoPoint)]
    assert len(dict(found)) == len(found)
    return dict(found)


@pytest.mark.parametrize("later", [0.0, 1e-7, 3e-6, 1e-4])
@pytest.mark.parametrize(("e", "f"), [(0.5, 0.5), (0.2, 0.6), (0.7, 0.4)])
def test_impacts_that_accumulate_on_uncoupled_stops_have_a_limit_each(
    e: float, f: float, later: float
) -> None:
    _, first = bounces(1.0, G, e)
    # The time of rest goes with the root of the height.
    height = ((first + later) / bounces(1.0, G, f)[1]) ** 2
    run = zo.simulate(masses((e, f)), until=9.0, start={"x0": 1.0, "x1": height})
    expected = {"s0": first, "s1": first + later}
    assert zeno_times(run) == pytest.approx(expected, abs=RESTED)
    errors = [point.limit_error for point in run.zeno_points]
    assert max(errors) < RESTED
    assert run.arcs[-1].closed == ("s0", "s1")
    assert run.end_state.tolist() == [0.0, 0.0, 0.0, 0.0]
    times = [event.time for event in run.events]
    assert times == sorted(times)


def at_rest_after(times: Sequence[float], e: Sequence[float]) -> dict[str, float]:
    """Return the heights from which masses come to rest at given times."""
    return {
        f"x{k}": G / 2 * (time * (1 - one) / (1 + one)) ** 2
        for k, (time, one) in enumerate(zip(times, e, strict=True))
    }


@pytest.mark.parametrize(
    ("e", "times"),
    [
        ((0.544788062428101, 0.6965553594097043), (1.0000144636506272, 0.9999966359237445)),
        (
            (0.6665088072217578, 0.2322941970871144, 0.6013463591146928),
            (1.0000618326325692, 0.9999915491498421, 1.0000000092792625),
        ),
    ],
)
def test_a_low_flight_keeps_its_height_when_another_mass_strikes(
    e: tuple[float, ...], times: tuple[float, ...]
) -> None:
    # One mass is lower than 1e-12 m, in the midst of a flight, when another strikes.
    run = zo.simulate(masses(e), until=2.0, start=at_rest_after(times, e))
    expected = {f"s{k}": time for k, time in enumerate(times)}
    assert zeno_times(run) == pytest.approx(expected, abs=RESTED)


@pytest.mark.parametrize("e", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("later", [1e-14, 3e-13, 1e-11, 3e-10, 4e-9])
def test_equal_masses_that_are_struck_at_nearly_one_time_keep_their_own(
    e: float, later: float
) -> None:
    height = 0.7
    low = G / 2 * (math.sqrt(2 * height / G) + later) ** 2
    limits = [bounces(one, G, e)[1] for one in (height, low)]
    run = zo.simulate(masses((e, e)), until=1.1 * limits[1], start={"x0": height, "x1": low})
    expected = {f"s{k}": limit for k, limit in enumerate(limits)}
    assert zeno_times(run) == pytest.approx(expected, abs=RESTED)


def test_a_third_mass_may_strike_before_two_others_have_come_to_rest() -> None:
    e, first = 0.8, math.sqrt(1 / G)
    times = (first, first + 2.5576791767789597e-05, first + 3.8514246902821014e-08)
    start = {f"x{k}": G / 2 * time**2 for k, time in enumerate(times)}
    run = zo.simulate(masses((e,) * 3), until=10.0, start=start)
    expected = {f"s{k}": bounces(x, G, e)[1] for k, x in enumerate(start.values())}
    assert zeno_times(run) == pytest.approx(expected, abs=RESTED)


def dragged_limit(height: float, mu: float, e: float) -> float:
    """Return the time of rest of a mass that falls with the drag ``-mu v |v|``, in closed form."""
    root, time = math.sqrt(mu * G), 0.0
    while height > 1e-40:
        x = mu * height
        time += math.log1p(math.expm1(x) + math.sqrt(math.expm1(2 * x))) / root
        speed = e * math.sqrt(-G / mu * math.expm1(-2 * x))
        time += math.atan(speed * math.sqrt(mu / G)) / root
        height = math.log1p(mu * speed**2 / G) / (2 * mu)
    return time


@pytest.mark.slow
@pytest.mark.parametrize("e", [0.1, 0.3])
def test_a_flight_whose_top_is_below_the_tolerance_of_its_gap_has_not_landed(e: float) -> None:
    # The drag has a kink at the top of each flight, and masses are in flights that are as low.
    mu, heights = 0.2, (0.7594606948266885, 0.7594606948261099, 0.7594606948230385)

    def model(_parameters: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.dot(v, v) / 2,
            potential=G * ca.sum1(q),
            passive_force=-mu * v * ca.fabs(v),
            stops=tuple(zo.Stop(name=f"s{k}", gap=q[k], restitution=e) for k in range(3)),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    states = {f"x{k}": "m" for k in range(3)} | {f"v{k}": "m/s" for k in range(3)}
    start = {f"x{k}": height for k, height in enumerate(heights)}
    run = zo.simulate(machine_of(model, states), until=2.0, start=start)
    expected = {f"s{k}": dragged_limit(height, mu, e) for k, height in enumerate(heights)}
    assert zeno_times(run) == pytest.approx(expected, abs=RESTED)


DAMPED = [
    (
        LinearMasses(
            inverse=np.diag([0.5, 0.7]),
            damping=np.diag([2.0, 1.3]),
            stiffness=np.diag([1.0, 2.0]),
            weight=(13.0, 7.0),
            restitutions=(0.53, 0.6),
        ),
        (1.0, 0.5042672597683924),
        (1.4915281243591423, 1.491528127456069),
    ),
    (
        LinearMasses(
            inverse=np.diag([0.8, 0.5, 0.7]),
            damping=np.array([[1.0, -0.4, 0.2], [-0.2, 0.6, 0.3], [0.0, 0.5, 0.5]]),
            stiffness=np.diag([0.8, 1.4, 0.7]),
            weight=(13.0, 15.0, 14.0),
            restitutions=(0.62, 0.65),
        ),
        (1.0, 0.44996274705696687, 0.5),
        (1.6395083530094323, 1.6395083613933288),
    ),
    (
        LinearMasses(
            inverse=np.diag([0.9, 0.5]),
            damping=np.diag([0.3, 3.3]),
            stiffness=np.diag([1.7, 1.8]),
            weight=(18.0, 14.0),
            restitutions=(0.7, 0.3),
        ),
        (1.0, 4.95596582760697),
        (1.8430613958181576, 1.8430713956357099),
    ),
]
"""Damped masses, heights from which two come to rest nearly at once, and when, by 45 digits."""


@pytest.mark.slow
@pytest.mark.parametrize(("masses", "heights", "rests"), DAMPED)
def test_the_times_of_rest_of_damped_masses_have_all_digits(
    masses: LinearMasses, heights: Sequence[float], rests: Sequence[float]
) -> None:
    assert [float(one) for one in masses.rests(heights)] == pytest.approx(rests, abs=1e-15)


@pytest.mark.parametrize(("masses", "heights", "rests"), DAMPED)
def test_limits_under_forces_that_depend_on_gap_rates_are_within_their_error(
    masses: LinearMasses, heights: Sequence[float], rests: Sequence[float]
) -> None:
    n = len(heights)

    def model(_parameters: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.dot(v, ca.DM(np.linalg.inv(masses.inverse)) @ v) / 2,
            potential=ca.dot(q, ca.DM(masses.stiffness) @ q) / 2 + ca.dot(q, ca.DM(masses.weight)),
            passive_force=-ca.DM(masses.damping) @ v,
            stops=tuple(
                zo.Stop(name=f"s{k}", gap=q[k], restitution=e)
                for k, e in enumerate(masses.restitutions)
            ),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    states = {f"x{k}": "m" for k in range(n)} | {f"v{k}": "m/s" for k in range(n)}
    start = {f"x{k}": height for k, height in enumerate(heights)}
    run = zo.simulate(machine_of(model, states), until=max(rests) + 1e-3, start=start)
    points = {event.stop: event for event in run.events if isinstance(event, ZenoPoint)}
    for k, rest in enumerate(rests):
        point = points[f"s{k}"]
        stated = point.limit_error * (1 + rest)
        assert abs(point.time - rest) < stated + RESTED
        assert stated < 1e-8


@pytest.mark.slow
def test_uncoupled_stops_have_their_own_limits() -> None:
    random = np.random.default_rng(20261129)
    for _ in range(60):
        n = int(random.integers(2, 4))
        e = tuple(random.uniform(0.1, 0.7, n).tolist())
        apart = 10 ** random.uniform(-13, -0.5, n) * random.choice([-1, 1], n)
        times = tuple((1 + apart).tolist())
        run = zo.simulate(masses(e), until=2.5, start=at_rest_after(times, e))
        expected = {f"s{k}": time for k, time in enumerate(times)}
        assert zeno_times(run) == pytest.approx(expected, abs=RESTED)


def test_limits_that_meet_have_no_derivatives() -> None:
    problem = masses((0.5, 0.5))
    graph, settings = problem.graph_dynamics(problem.values()), SimulationSettings()
    run = simulate(graph, np.array([1.0, 1.0, 0.0, 0.0]), until=9.0, settings=settings)
    with pytest.raises(zo.SimulationError, match="without an impact"):
        list(EventDerivatives(graph, (), settings.tolerance).passages(run))


def test_a_stop_that_has_come_to_rest_counts_no_more() -> None:
    # The second mass comes to rest a thousandth of a second after the first, which it follows.
    e, f, later = 0.5, 0.3, 1e-3
    height = ((bounces(1.0, G, e)[1] + later) / bounces(1.0, G, f)[1]) ** 2
    run = zo.simulate(masses((e, f)), until=9.0, start={"x0": 1.0, "x1": height})
    first, second = zeno_times(run).values()
    assert second - first == pytest.approx(later, abs=1e-9)


# A reset that sends a closed stop into itself.


def kicked(e: float, kick: float, first: float) -> zo.Problem:
    """Return a ball at rest on a floor, which a timer kicks downwards."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v, timer = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("timer")
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=G * q,
            stops=(zo.Stop(name="floor", gap=q, restitution=p["e"]),),
        )
        switch = zo.Switch(name="kick", guard=timer, v_after=ca.SX(kick), others_after=ca.SX(100.0))
        clock = zo.Auxiliary(states=timer, rate=ca.SX(-1.0))
        return zo.hybrid_system(mechanism, clock, switches=(switch,))

    states = LINE | {"timer": "s"}
    return replace(machine_of(model, states, {"e": e}), starts=({"timer": first},))


@pytest.mark.parametrize(
    ("e", "kick", "first"),
    [(0.0, -1.0, 0.5), (0.0, -3.0, 0.1), (0.5, -1.0, 0.5), (0.6, -2.0, 0.3), (0.2, -0.1, 1.0)],
)
def test_a_reset_into_a_closed_stop_is_an_impact(e: float, kick: float, first: float) -> None:
    limit = first - 2 * e * kick / (G * (1 - e))
    run = zo.simulate(kicked(e, kick, first), until=limit + 0.1)
    assert run.impacts[0].time == pytest.approx(first, abs=LOCATED)
    assert run.impacts[0].approach_rate == pytest.approx(kick, rel=LOCATED)
    assert [point.time for point in run.zeno_points] == pytest.approx([limit], abs=LOCATED)
    assert named(run, "switch") == [("switch kick", pytest.approx(first, abs=LOCATED))]
    # The stop opens if the ball bounces.
    assert len(run.releases) == (e > 0.0)
    assert run.arcs[-1].closed == ("floor",)


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_a_reset_whose_guard_goes_on_falling_occurs_once(e: float) -> None:
    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=G * q[1],
            stops=(zo.Stop(name="floor", gap=q[1], restitution=p["e"]),),
        )
        bump = zo.Switch(name="bump", guard=1 - q[0], v_after=ca.vertcat(v[0], -2))
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism), switches=(bump,))

    problem = machine_of(model, {"x": "m", "y": "m", "dx": "m/s", "dy": "m/s"}, {"e": e})
    run = zo.simulate(problem, until=2.0, start={"dx": 2.0})
    assert named(run, "switch") == [("switch bump", pytest.approx(0.5, abs=LOCATED))]
    assert run.impacts[0].approach_rate == pytest.approx(-2.0, rel=LOCATED)
    assert run.zeno_points[-1].time == pytest.approx(0.5 + 4 * e / (G * (1 - e)), abs=LOCATED)
    assert run.end_state == pytest.approx([4.0, 0.0, 2.0, 0.0], abs=LOCATED)


@pytest.mark.parametrize(("e", "kick"), [(0.5, 2.0), (0.0, 1.0)])
def test_a_reset_away_from_a_closed_stop_is_a_release(e: float, kick: float) -> None:
    run = zo.simulate(kicked(e, kick, 0.5), until=0.5 + 2 * kick / G + 0.01)
    require(
        named(run)[:3],
        [("switch kick", 0.5), ("release floor", 0.5), ("impact floor", 0.5 + 2 * kick / G)],
    )


# Switches on one surface.


def pulled(pulls: tuple[float, float], loss: float, armed: str) -> zo.Problem:
    """Return a mass that is pulled to zero from both sides, by a side that switches set."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v, side = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("side")
        above = (1 + side) / 2
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=ca.SX(0),
            passive_force=-pulls[0] * above + pulls[1] * (1 - above),
            gap=q + 100,
        )
        by = {"side": (side, -side), "speed": (-v, v), "always": (ca.SX(1), ca.SX(1))}[armed]
        switches = (
            zo.Switch(
                name="down", guard=q, armed=by[0], v_after=loss * v, others_after=ca.SX(-1.0)
            ),
            zo.Switch(name="up", guard=-q, armed=by[1], v_after=loss * v, others_after=ca.SX(1.0)),
        )
        mode = zo.Auxiliary(states=side, rate=ca.SX(0))
        return zo.hybrid_system(mechanism, (mode,), p["e"], switches=switches)

    start = {"x": 1.0, "side": 1.0}
    return replace(machine_of(model, LINE | {"side": "1"}, {"e": 0.5}), starts=(start,))


@pytest.mark.parametrize("armed", ["side", "speed", "always"])
@pytest.mark.parametrize(
    ("pulls", "loss"), [((1.0, 1.0), 1.0), ((2.0, 0.3), 1.0), ((1.0, 3.0), 0.8)]
)
def test_opposite_switches_on_one_surface_take_turns(
    pulls: tuple[float, float], loss: float, armed: str
) -> None:
    time, speed = math.sqrt(2 / pulls[0]), math.sqrt(2 * pulls[0])
    expected: list[tuple[str, float]] = []
    for k in range(12):
        expected.append((("down", "up")[k % 2], time))
        speed *= loss
        time += 2 * speed / pulls[(k + 1) % 2]
    run = zo.simulate(pulled(pulls, loss, armed), until=expected[-1][1] + 1e-3)
    require(named(run), [(f"switch {name}", t) for name, t in expected])


LANDINGS = {
    "armed and falling": (1.0, 0.0, True),
    "rising": (1.0, 5.0, False),
    "not armed": (-1.0, 0.0, False),
    "armed by rounding alone": (1e-13, 0.0, True),
}


@pytest.mark.parametrize("name", LANDINGS)
def test_a_switch_that_another_switch_leads_to_is_decided_by_its_rate_and_arming(name: str) -> None:
    armed, lift, occurs = LANDINGS[name]

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        mechanism = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=G * q, gap=q + 1000
        )
        switches = (
            zo.Switch(name="far", guard=q - 1, q_after=ca.SX(0.3), v_after=v + lift),
            zo.Switch(name="near", guard=q - 0.3, armed=armed, v_after=-v),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism), p["e"], switches=switches)

    # It falls from 2 to 1 in `first`, and goes on at 0.3 with the speed `speed`, reversed or not.
    first, until = math.sqrt(2 / G), math.sqrt(2 / G) + 0.03
    speed = lift - math.sqrt(2 * G) * (-1 if occurs else 1)
    run = zo.simulate(machine_of(model, LINE, {"e": 0.5}), until=until, start={"x": 2.0})
    require(named(run), [(f"switch {k}", first) for k in (["far"] + ["near"] * occurs)])
    wanted = [0.3 + 0.03 * speed - G * 0.03**2 / 2, speed - G * 0.03]
    assert run.end_state == pytest.approx(wanted, abs=LOCATED)


def test_switches_that_lead_to_each_other_at_once_are_refused() -> None:
    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        mechanism = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=G * q, gap=q + 1000
        )
        switches = (
            zo.Switch(name="one", guard=q - 1, q_after=ca.SX(0.5)),
            zo.Switch(name="other", guard=q - 0.5, q_after=ca.SX(1.0)),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism), p["e"], switches=switches)

    with pytest.raises(ChatterError) as caught:
        zo.simulate(machine_of(model, LINE, {"e": 0.5}), until=2.0, start={"x": 2.0})
    assert caught.value.time == pytest.approx(math.sqrt(2 / G), abs=LOCATED)


def runner(angle: float, stiffness: float) -> zo.Problem:
    """Return a running mass on a leg that is a spring, from its touch-down to its take-off."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v, stance = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("stance")
        leg = ca.norm_2(q)
        push = stance * stiffness * (1 - leg) / leg
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=G * q[1],
            passive_force=push * q,
            gap=q[1] + 10,
        )
        foot = ca.vertcat(-math.cos(angle), q[1])
        switches = (
            zo.Switch(
                name="down",
                guard=q[1] - math.sin(angle),
                armed=-v[1] * (1 - stance),
                q_after=foot,
                others_after=ca.SX(1.0),
            ),
            zo.Switch(
                name="off",
                guard=1 - leg,
                armed=stance * ca.dot(q, v),
                q_after=ca.vertcat(0, q[1]),
                others_after=ca.SX(0.0),
            ),
        )
        mode = zo.Auxiliary(states=stance, rate=ca.SX(0))
        return zo.hybrid_system(mechanism, (mode,), p["e"], switches=switches)

    states = {"x": "m", "y": "m", "vx": "m/s", "vy": "m/s", "stance": "1"}
    return machine_of(model, states, {"e": 0.0})


def stride(apex: float, speed: float, angle: float, stiffness: float) -> tuple[float, float, float]:
    """Return the time of the fall, of the stance, and the next apex, by SciPy alone."""
    fall = math.sqrt(2 * (apex - math.sin(angle)) / G)

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        leg = math.hypot(y[0], y[1])
        push = stiffness * (1 - leg) / leg
        return np.array([y[2], y[3], push * y[0], push * y[1] - G])

    def length(_: float, y: np.ndarray) -> float:
        return math.hypot(y[0], y[1]) - 1 + 1e-15 * (_ == 0)

    length.terminal, length.direction = True, 1.0  # type: ignore[attr-defined]
    start = [-math.cos(angle), math.sin(angle), speed, -G * fall]
    found: Any = solve_ivp(rate, (0, 2), start, "DOP853", events=length, rtol=1e-13, atol=1e-13)
    _, y, _, w = found.y_events[0][0]
    return fall, float(found.t_events[0][0]), float(y + w**2 / (2 * G))


@pytest.mark.parametrize(
    ("degrees", "stiffness", "energy"),
    [
        (68.0, 250.0, 22.3),
        (68.0, 250.0, 21.8),
        (66.0, 200.0, 22.3),
        (64.0, 200.0, 26.0),
        (70.0, 300.0, 22.3),
    ],
)
def test_a_running_leg_keeps_its_gait(degrees: float, stiffness: float, energy: float) -> None:
    # In a symmetric gait the mass takes off at the height at which it touches down.
    angle = math.radians(degrees)

    def off(apex: float) -> float:
        return stride(apex, math.sqrt(2 * (energy - G * apex)), angle, stiffness)[2] - apex

    apexes = np.linspace(math.sin(angle) + 2e-3, math.sin(angle) + 0.1, 6)
    values = [off(float(apex)) for apex in apexes]
    k = next(k for k in range(5) if values[k] * values[k + 1] < 0)
    apex = float(brentq(off, apexes[k], apexes[k + 1], xtol=1e-15))
    speed = math.sqrt(2 * (energy - G * apex))
    fall, stance, _ = stride(apex, speed, angle, stiffness)
    expected = [
        (f"switch {name}", 2 * n * fall + n * stance + (fall if name == "down" else fall + stance))
        for n in range(5)
        for name in ("down", "off")
    ]
    run = zo.simulate(
        runner(angle, stiffness), until=expected[-1][1] + 1e-3, start={"y": apex, "vx": speed}
    )
    found = named(run)
    assert [name for name, _ in found] == [name for name, _ in expected]
    assert [t for _, t in found] == pytest.approx([t for _, t in expected], abs=1e-8)


# Impacts that come close to each other, and impacts that accumulate.


def stacked(mass: float, e: float) -> zo.Problem:
    """Return two balls on top of each other over a floor."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v[0] ** 2 / 2 + mass * v[1] ** 2 / 2,
            potential=G * (q[0] + mass * q[1]),
            stops=(
                zo.Stop(name="floor", gap=q[0], restitution=p["e"]),
                zo.Stop(name="between", gap=q[1] - q[0], restitution=p["e"]),
            ),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    states = {"y1": "m", "y2": "m", "v1": "m/s", "v2": "m/s"}
    return machine_of(model, states, {"e": e})


def flown(
    mass: float, e: float, heights: tuple[float, float], until: float
) -> list[tuple[str, float]]:
    """Return the impacts of stacked balls by parabolas of 50 digits, until they come too close."""
    with localcontext() as context:
        context.prec = 50
        g, r, m, none = Decimal(G), Decimal(e), Decimal(mass), Decimal(0)
        low, gap = Decimal(heights[0]), Decimal(heights[1]) - Decimal(heights[0])
        v, w, time = none, none, none
        found: list[tuple[str, float]] = []
        while True:
            to_floor = (v + (v * v + 2 * g * low).sqrt()) / g
            to_ball = -gap / w if w < 0 else Decimal("inf")
            step = min(to_floor, to_ball)
            time += step
            if time > until or step < Decimal("1e-20"):
                return found
            low, gap, v = low + v * step - g * step**2 / 2, gap + w * step, v - g * step
            if to_floor < to_ball:
                low, v, w = none, -r * v, w + v + r * v
                found.append(("impact floor", float(time)))
            else:
                gap, push = none, -(1 + r) * w * m / (1 + m)
                v, w = v - push, -r * w
                found.append(("impact between", float(time)))


@pytest.mark.parametrize(
    ("mass", "e", "heights", "resolved"),
    [
        (2.0, 0.95, (0.1, 0.101), 60),
        (2.0, 0.9, (0.1, 0.102), 60),
        (3.0, 0.85, (0.1, 0.13), 40),
        (1.5, 0.7, (0.3, 0.31), 20),
        (2.0, 0.6, (0.5, 0.7), 12),
        (4.0, 0.8, (0.2, 0.25), 30),
    ],
)
def test_impacts_that_come_close_do_not_accumulate(
    mass: float, e: float, heights: tuple[float, float], resolved: int
) -> None:
    exact = flown(mass, e, heights, 9.0)
    start = {"y1": heights[0], "y2": heights[1]}
    with pytest.raises(zo.SimultaneousEventsError, match=r"accumulate|coincide") as caught:
        zo.simulate(stacked(mass, e), until=9.0, start=start)
    assert caught.value.execution is not None
    found = named(caught.value.execution, "impact")[:resolved]
    assert len(found) == resolved
    assert [name for name, _ in found] == [name for name, _ in exact[:resolved]]
    assert [t for _, t in found] == pytest.approx([t for _, t in exact[:resolved]], abs=1e-8)
    # Errors grow from impact to impact where the restitution is large.
    assert caught.value.time == pytest.approx(exact[-1][1], rel=1e-2)


@pytest.mark.parametrize(
    ("mass", "e", "heights"), [(0.5, 0.8, (0.2, 0.25)), (1.0, 0.6, (0.5, 0.7))]
)
def test_the_lower_ball_may_rest_before_the_upper(
    mass: float, e: float, heights: tuple[float, float]
) -> None:
    exact = flown(mass, e, heights, 9.0)
    start = {"y1": heights[0], "y2": heights[1]}
    run = zo.simulate(stacked(mass, e), until=9.0, start=start)
    rest = next(point for point in run.zeno_points if point.stop == "floor")
    assert rest.time == pytest.approx(exact[-1][1], abs=1e-9)
    found = [(name, time) for name, time in named(run, "impact") if time < rest.time]
    require(found, exact[: len(found)])
    # The upper ball goes on as a ball on a floor.
    after = [one for one in run.impacts if one.time > rest.time]
    limit = after[0].time - 2 * e * after[0].approach_rate / (G * (1 - e))
    assert run.zeno_points[-1].time == pytest.approx(limit, abs=1e-9)
    assert run.end_state == pytest.approx(np.zeros(4), abs=1e-9)


# Contact that ends by another event.


def lifted(force: Formula, *, e: float = 0.0) -> zo.Problem:
    """Return a mass on a floor with a force of the clock's cosine and sine."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v, clock = ca.SX.sym("q"), ca.SX.sym("v"), zo.Clock.at(p["omega"])
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=G * q,
            passive_force=-0.5 * v,
            applied_force=force(clock.cosine, clock.sine),
            clock=clock,
            stops=(zo.Stop(name="floor", gap=q, restitution=e),),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    states = LINE | {"cosine": "1", "sine": "1"}
    return replace(machine_of(model, states, {"omega": 2.0}), starts=({"cosine": 1.0},))


JUMPS: dict[str, tuple[Formula, float]] = {
    "comparison": (lambda _, s: ca.if_else(s > 0.6, 15, 0), math.asin(0.6) / 2),
    "sign": (lambda _, s: 7.5 * (1 + ca.sign(s - 0.5)), math.asin(0.5) / 2),
    "product": (lambda c, s: ca.if_else(c < 0.2, 15 + s, 0), math.acos(0.2) / 2),
    "two": (
        lambda c, s: ca.if_else(s > 0.3, 4, 0) + ca.if_else(c < 0.5, 9, 0),
        math.acos(0.5) / 2,
    ),
    "difference": (lambda c, s: ca.if_else(s > c, 12, 1), math.pi / 8),
}


@pytest.mark.parametrize("name", JUMPS)
def test_a_jump_of_a_force_that_ends_contact_is_a_release(name: str) -> None:
    force, time = JUMPS[name]
    run = zo.simulate(lifted(force), until=time + 0.05)
    assert named(run, "release") == [("release floor", pytest.approx(time, abs=LOCATED))]
    assert run.arcs[-1].closed == ()
    assert run.releases[0].state[:2] == pytest.approx([0.0, 0.0], abs=1e-15)


def pressed(name: str, time: float) -> zo.Problem:
    """Return a mass on a floor that another event opens at a time."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v, timer, push = (ca.SX.sym(k) for k in ("q", "v", "timer", "push"))
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=G * q,
            passive_force=2 * G * push,
            stops=(zo.Stop(name="floor", gap=q, restitution=p["e"]),),
        )
        parts = zo.Auxiliary(states=ca.vertcat(timer, push), rate=ca.SX([-1, 0]))
        far = ca.vertcat(100, push)
        resets: dict[str, dict[str, ca.SX]] = {
            "force": {"others_after": ca.SX([100, 1])},
            "speed": {"v_after": ca.SX(2), "others_after": far},
            "place": {"q_after": ca.SX(0.5), "others_after": far},
            "all": {
                "q_after": ca.SX(0.5),
                "v_after": ca.SX(1),
                "others_after": ca.SX([100, 1]),
            },
        }
        switch = zo.Switch(name="open", guard=timer, **resets[name])
        return zo.hybrid_system(mechanism, parts, switches=(switch,))

    states = LINE | {"timer": "s", "push": "1"}
    return replace(machine_of(model, states, {"e": 0.3}), starts=({"timer": time},))


@pytest.mark.parametrize("name", ["force", "speed", "place", "all"])
def test_a_switch_that_ends_contact_causes_a_release(name: str) -> None:
    q, v, a = {
        "force": (0, 0, G),
        "speed": (0, 2, -G),
        "place": (0.5, 0, -G),
        "all": (0.5, 1, G),
    }[name]
    run = zo.simulate(pressed(name, 0.7), until=0.8)
    require(named(run), [("switch open", 0.7), ("release floor", 0.7)])
    assert run.releases[0].state[:2] == pytest.approx([q, v], abs=LOCATED)
    wanted = [q + 0.1 * v + 0.005 * a, v + 0.1 * a]
    assert run.end_state[:2] == pytest.approx(wanted, abs=LOCATED)


def thrown(e: float) -> tuple[zo.Problem, zo.Orbit]:
    """Return a mass that a step of force lifts off its floor, and its orbit."""
    problem = lifted(lambda _, s: ca.if_else(s > 0.6, 15, 0), e=e)
    return problem, zo.find_orbit(problem, section="switch kink 1").unwrap()


@pytest.mark.parametrize("e", [0.0, 0.3])
def test_an_orbit_lists_the_release_that_a_jump_causes(e: float) -> None:
    problem, orbit = thrown(e)
    names = [event.name for event in orbit.events]
    release = names.index("release floor")
    assert names[release - 1] == "switch kink 1"
    assert orbit.events[release].time == orbit.events[release - 1].time
    assert orbit.period == pytest.approx(math.pi, abs=LOCATED)
    # Times of quantities count in the phase of the clock.
    times = zo.verify(orbit, problem=problem).quantities["floor.release_time"]
    assert times == pytest.approx((math.asin(0.6) / 2,) * 2, abs=LOCATED)
    assert orbit.certificate["passed"]


@pytest.mark.slow
def test_an_orbit_of_an_earlier_file_without_that_release_passes() -> None:
    problem, orbit = thrown(0.3)
    events = tuple(event for event in orbit.events if event.name != "release floor")
    assert len(events) == len(orbit.events) - 1
    assert zo.verify(replace(orbit, events=events), problem=problem).passed
    wrong = tuple(event for event in orbit.events if event.name != "zeno floor")
    assert not zo.verify(replace(orbit, events=wrong), problem=problem).passed


# Derivatives where events meet.


def forced_masses(n: int, e: float) -> zo.Problem:
    """Return `n` equal forced masses on springs, each with a stop."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v, clock = ca.SX.sym("q", n), ca.SX.sym("v", n), zo.Clock.at(p["omega"])
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=ca.sumsqr(q) / 2,
            passive_force=-0.3 * v,
            applied_force=ca.repmat(2 * clock.cosine, n, 1),
            clock=clock,
            stops=tuple(zo.Stop(name=f"s{k}", gap=q[k] + 0.2, restitution=e) for k in range(n)),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    states = {f"x{k}": "m" for k in range(n)} | {f"v{k}": "m/s" for k in range(n)}
    return machine_of(model, states | {"cosine": "1", "sine": "1"}, {"omega": 2.0})


def struck_twice(x: float, v: float, e: float) -> tuple[float, float]:
    """Return time and speed of the second impact of one mass, by SciPy alone."""

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        return np.array([y[1], 2 * math.cos(2 * t) - 0.3 * y[1] - y[0]])

    def gap(_: float, y: np.ndarray) -> float:
        return float(y[0]) + 0.2

    gap.terminal, gap.direction = True, -1.0  # type: ignore[attr-defined]
    t, y, speed = 0.0, np.array([x, v]), 0.0
    for _ in range(2):
        found: Any = solve_ivp(rate, (t, t + 9), y, "DOP853", events=gap, rtol=1e-12, atol=1e-13)
        t, speed = float(found.t[-1]), -float(found.y[1, -1])
        y = np.array([-0.2, e * speed])
    return t, speed


@pytest.mark.parametrize(("e", "v"), [(0.5, 0.0), (0.7, 0.0), (0.8, 1.0), (0.6, -1.0), (0.4, 0.5)])
def test_derivatives_where_masses_are_struck_together_are_those_of_each(e: float, v: float) -> None:
    problem = forced_masses(2, e)
    start = {"x0": 0.5, "x1": 0.5, "v0": v, "v1": v, "cosine": 1.0}
    time, speed = struck_twice(0.5, v, e)
    run = zo.simulate(problem, until=time + 0.01, start=start)
    assert sorted(name for name, _ in named(run)) == ["impact s0"] * 2 + ["impact s1"] * 2
    graph = problem.graph_dynamics(problem.values())
    derivatives = EventDerivatives(graph, (), SimulationSettings().tolerance)
    crossings = [one for passage in derivatives.passages(run) for one in passage.crossings]
    h = 1e-5
    columns = [
        np.subtract(
            struck_twice(0.5 + h * a, v + h * b, e), struck_twice(0.5 - h * a, v - h * b, e)
        )
        / (2 * h)
        for a, b in ((1.0, 0.0), (0.0, 1.0))
    ]
    for event, before, _ in crossings[2:]:
        k = int(event_name(event)[-1])
        assert event.time == pytest.approx(time, abs=1e-9)
        assert before.state[2 + k, [k, 2 + k]] == pytest.approx([-c[1] for c in columns], abs=1e-6)
        assert before.time[[k, 2 + k]] == pytest.approx([c[0] for c in columns], abs=1e-6)
        assert before.state[2 + k, [1 - k, 3 - k]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert -run.impacts[-1].approach_rate == pytest.approx(speed, abs=1e-9)


# Stops that open together.


def released_masses(restitutions: Sequence[float], spring: float = 0.0) -> zo.Problem:
    """Return masses between two stops each, all under one force of a clock."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        n = len(restitutions)
        q, v, clock = ca.SX.sym("q", n), ca.SX.sym("v", n), zo.Clock.at(p["omega"])
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=ca.sumsqr(q) / 2 + spring * ca.sumsqr(q[0] - q[-1]) / 2,
            passive_force=-0.1 * v,
            applied_force=ca.repmat(5 * clock.cosine, n, 1),
            clock=clock,
            stops=tuple(
                zo.Stop(name=f"{name}{k}", gap=1 - sign * q[k], restitution=e)
                for k, e in enumerate(restitutions)
                for name, sign in (("up", 1), ("low", -1))
            ),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    n = len(restitutions)
    states = {f"x{k}": "m" for k in range(n)} | {f"v{k}": "m/s" for k in range(n)}
    return machine_of(model, states | {"cosine": "1", "sine": "1"}, {"omega": 0.3})


@pytest.mark.slow
@pytest.mark.parametrize("restitutions", [(0.3, 0.5), (0.2, 0.0), (0.4, 0.4), (0.0, 0.0)])
def test_masses_that_a_clock_releases_together_move_as_each_alone(
    restitutions: tuple[float, ...],
) -> None:
    whole = zo.simulate(released_masses(restitutions), until=40.0)
    found = named(whole, "zeno", "release")
    expected: list[tuple[str, float]] = []
    for k, e in enumerate(restitutions):
        alone = zo.simulate(released_masses([e]), until=40.0)
        events = named(alone, "zeno", "release")
        expected += [(name.replace("0", str(k)), time) for name, time in events]
        times = [time for name, time in found if name.endswith(str(k))]
        assert times == pytest.approx([time for _, time in events], abs=1e-9)
    assert sorted(name for name, _ in found) == sorted(name for name, _ in expected)
    releases = [time for name, time in found if name.startswith("release")]
    assert len(releases) == 2 * len(set(releases)) > 4


@pytest.mark.slow
@pytest.mark.parametrize("restitutions", [(0.3, 0.5), (0.2, 0.0)])
def test_derivatives_where_stops_open_together_are_those_of_each(
    restitutions: tuple[float, ...],
) -> None:
    def slopes(e: Sequence[float], stop: str) -> np.ndarray:
        """Return time and velocity at the first impact after a release, by the frequency."""
        problem = released_masses(e)
        graph, run = problem.graph_dynamics(problem.values()), zo.simulate(problem, until=12.0)
        derivatives = EventDerivatives(graph, (0,), SimulationSettings().tolerance)
        crossings = [one for passage in derivatives.passages(run) for one in passage.crossings]
        opened = run.releases[0].time
        event, before, _ = next(
            one
            for one in crossings
            if one[0].time > opened and event_name(one[0]) == f"impact {stop}"
        )
        k = int(stop[-1]) + len(e)
        assert before.time is not None
        return np.array([event.time, before.time[-1], before.state[k, -1]])

    for k, e in enumerate(restitutions):
        alone = slopes([e], "low0")
        assert slopes(restitutions, f"low{k}") == pytest.approx(alone, rel=1e-9)


@pytest.mark.slow
def test_equal_masses_on_a_spring_open_together() -> None:
    # The spring is without force as long as both move alike.
    pair = zo.simulate(released_masses([0.4, 0.4], spring=3.0), until=12.0)
    alone = zo.simulate(released_masses([0.4]), until=12.0)
    for k in (0, 1):
        found = [(n, t) for n, t in named(pair, "zeno", "release") if n.endswith(str(k))]
        times = [time for _, time in named(alone, "zeno", "release")]
        assert [time for _, time in found] == pytest.approx(times, abs=1e-9)
