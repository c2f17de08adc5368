"""Impacts that accumulate while a kink changes its side in every flight, near restitution 1.

The truth is a closed form: a ball with the drag ``k |v| v`` falls by ``log(cosh)`` and rises by
``log(cos)``, so each flight is known from its first speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.mechanisms import machine_of
from zeno_orbits.simulation import EventDerivatives, SimulationSettings, ZenoPoint, simulate

ca: Any = casadi
G, HEIGHT = 9.81, 1.0


pytestmark = pytest.mark.usefixtures("both_loops")


def zeno_time(e: float, k: float, height: float = HEIGHT) -> float:
    """Return the time at which the impacts of a ball that falls from a height accumulate."""
    rate, limit = math.sqrt(G * k), math.sqrt(G / k)
    # The cosh of a time of fall is exp(k h), here from the squared speed.
    speed = limit * math.sqrt(-math.expm1(-2 * k * height))
    # acosh(exp(x)), which is accurate for small x in this form.
    times = [2 * math.asinh(math.sqrt(math.expm1(k * height) / 2)) / rate]
    least = 1e-13 * speed
    while speed > least:
        up = e * speed
        size = (up / limit) ** 2
        down = up / math.sqrt(1 + size)
        times.append((math.atan(up / limit) + math.atanh(down / limit)) / rate)
        speed = down
    return math.fsum(times)


def ball(ceiling: bool, force: Any) -> zo.Problem:
    """Return a ball over a floor, with a ceiling that it does not reach."""

    def model(p: Mapping[str, Any]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        floor = zo.Stop(name="floor", gap=q, restitution=p["e"])
        above = (zo.Stop(name="ceiling", gap=3 - q, restitution=p["e"]),) if ceiling else ()
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=G * q,
            passive_force=force(q, v, p["k"]),
            stops=(floor, *above),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    problem = machine_of(model, {"q": "m", "v": "m/s"}, {"e": 0.95, "k": 0.1})
    return replace(problem, starts=({"q": HEIGHT},))


DRAG = {
    "fabs": lambda _, v, k: -k * ca.fabs(v) * v,
    "if_else": lambda _, v, k: ca.if_else(v > 0, -k, k) * v**2,
    "fmax": lambda _, v, k: k * (ca.fmax(-v, 0) ** 2 - ca.fmax(v, 0) ** 2),
    "nested": lambda q, v, k: -k * v * ca.fmin(ca.fabs(v), ca.if_else(q < 5, 1e3, 0)),
}
"""The same drag, written with other kinks."""


@pytest.mark.parametrize("ceiling", [False, True], ids=["one stop", "two stops"])
@pytest.mark.parametrize(
    ("how", "e"),
    [("fabs", 0.9), ("fabs", 0.97), ("if_else", 0.95), ("fmax", 0.94), ("nested", 0.96)],
)
def test_impacts_whose_flights_a_kink_splits_accumulate_at_the_true_time(
    how: str, e: float, ceiling: bool
) -> None:
    motion = zo.simulate(ball(ceiling, DRAG[how]), until=30.0, parameters={"e": e})
    (zeno,) = (one for one in motion.events if isinstance(one, ZenoPoint))
    assert zeno.time == pytest.approx(zeno_time(e, 0.1), rel=1e-11)


def test_the_closed_form_without_drag_is_the_geometric_series() -> None:
    e, fall = 0.9, math.sqrt(2 * HEIGHT / G)
    assert zeno_time(e, 1e-7) == pytest.approx(fall * (1 + e) / (1 - e), rel=1e-6)


STRIKER = {
    "over the floor": (lambda q, d: q - d, 1.0),
    "under a ceiling": (lambda q, d: d - q, -1.0),
    "with a lever": (lambda q, d: q / 4 - d, 0.25),
}
"""Gaps of a mass over a stop, and their slopes."""


def dragged(kind: str, how: str) -> zo.Problem:
    """Return a mass over an offset stop, whose gap has the acceleration ``-G`` and the drag."""
    gap, slope = STRIKER[kind]

    def model(p: Mapping[str, Any]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        height = gap(q, p["d"])
        stop = zo.Stop(name="stop", gap=height, restitution=p["e"])
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=G * q / slope,
            passive_force=DRAG[how](height, slope * v, p["k"]) / slope,
            stops=(stop,),
        )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism))

    return machine_of(model, {"q": "m", "v": "m/s"}, {"e": 0.3, "k": 0.1, "d": 0.5})


@pytest.mark.parametrize("height", [2.0**-18, 2.0**-23, 2.0**-26])
@pytest.mark.parametrize("kind", STRIKER)
@pytest.mark.parametrize("how", ["fabs", "fmax", "nested"])
def test_hops_below_the_resolution_of_the_gap_are_split_where_their_mass_is_at_rest(
    how: str, kind: str, height: float
) -> None:
    _, slope = STRIKER[kind]
    start = {"q": (0.5 + (height if slope > 0.0 else -height)) / abs(slope)}
    motion = zo.simulate(dragged(kind, how), until=1.0, start=start, parameters={"k": 3e3})
    (zeno,) = (one for one in motion.events if isinstance(one, ZenoPoint))
    # The distance from the offset stop has the rounding of the coordinate.
    assert zeno.time == pytest.approx(zeno_time(0.3, 3e3, height), rel=1e-8)
    assert zeno.state == pytest.approx([0.5 / abs(slope), 0.0], abs=1e-15)
    gaps = [abs(slope * one.state_minus[0]) - 0.5 for one in motion.impacts]
    assert max(map(abs, gaps)) < 1e-15


def test_the_zeno_time_of_a_low_drop_moves_with_its_height() -> None:
    graph = dragged("over the floor", "fabs").graph_dynamics([0.3, 3e3, 0.5])
    height, settings = 2.0**-20, SimulationSettings()
    run = simulate(graph, np.array([0.5 + height, 0.0]), until=1.0, settings=settings)
    ways = EventDerivatives(graph, (), settings.tolerance).passages(run)
    (slope,) = (
        before.time[0]
        for way in ways
        for event, before, _ in way.crossings
        if isinstance(event, ZenoPoint)
    )
    step = 1e-4 * height
    times = [zeno_time(0.3, 3e3, height + sign * step) for sign in (1, -1)]
    assert slope == pytest.approx((times[0] - times[1]) / (2 * step), rel=1e-7)


@pytest.mark.parametrize("height", [1e-7, 1e-9, 1e-11])
@pytest.mark.parametrize("ceiling", [False, True], ids=["one stop", "two stops"])
@pytest.mark.parametrize("how", ["fabs", "fmax"])
def test_a_start_just_above_a_stop_is_no_contact(how: str, ceiling: bool, height: float) -> None:
    machine = ball(ceiling, DRAG[how])
    motion = zo.simulate(machine, until=1.0, start={"q": height}, parameters={"e": 0.4})
    (zeno,) = (one for one in motion.events if isinstance(one, ZenoPoint))
    assert motion.impacts[0].approach_rate == pytest.approx(-math.sqrt(2 * G * height), rel=1e-7)
    assert zeno.time == pytest.approx(zeno_time(0.4, 0.1, height), rel=1e-8)
