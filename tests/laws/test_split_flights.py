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
import pytest

import zeno_orbits as zo
from tests.support.mechanisms import machine_of
from zeno_orbits.simulation import ZenoPoint

ca: Any = casadi
G, HEIGHT = 9.81, 1.0


pytestmark = pytest.mark.usefixtures("both_loops")


def zeno_time(e: float, k: float) -> float:
    """Return the time at which the impacts of a ball that falls from a height accumulate."""
    rate, limit = math.sqrt(G * k), math.sqrt(G / k)
    # The cosh of a time of fall is exp(k h), here from the squared speed.
    speed = limit * math.sqrt(-math.expm1(-2 * k * HEIGHT))
    times = [math.acosh(math.exp(k * HEIGHT)) / rate]
    while speed > 1e-13:
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
