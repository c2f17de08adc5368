"""Proofs of orbits whose restitution depends on the impact speed, beside flights in many digits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import mpmath
import pytest

import zeno_orbits as zo
from tests.support.orbits import event_orbit
from zeno_orbits.proof import check_proof


def _zeno_time(p: dict[str, float]) -> Any:
    """Return the time of the Zeno point of the marble on the table, flight by flight in 90 digits.

    The sum ends where a flight changes it by less than 1e-28. The rest is geometric.
    """
    real = mpmath.mpf
    amplitude, turn, g, slow, fall = (
        real(p[name]) for name in ("A", "omega", "g", "restitution", "fall")
    )
    phase = mpmath.asin(g / (amplitude * turn**2))
    time, rate = real(0), amplitude * turn * mpmath.cos(phase)
    height = amplitude * mpmath.sin(phase)

    def gap(d: Any) -> Any:
        table = amplitude * mpmath.sin(phase + turn * (time + d))
        return height + rate * d - g * d**2 / 2 - table

    flight = mpmath.findroot(gap, (real("0.1"), real("0.11")))
    while True:
        time += flight
        table_rate = amplitude * turn * mpmath.cos(phase + turn * time)
        speed = table_rate - (rate - g * flight)
        height = amplitude * mpmath.sin(phase + turn * time)
        bounce = (slow - fall * speed) * speed
        rate = table_rate + bounce
        pull = g - turn**2 * height
        flight = 2 * bounce / pull
        if flight < 1e-28:
            return time + flight / (1 - slow)
        for _ in range(60):
            flight += 2 * gap(flight) / (flight * pull)


@pytest.mark.slow
def test_the_zeno_point_of_a_marble_lies_in_its_interval() -> None:
    orbit = event_orbit("marble_table")
    proof = zo.prove(orbit)
    assert proof.bounds is not None
    (shown,) = proof.bounds.zeno_times
    with mpmath.workdps(90):
        middle, radius = map(mpmath.mpf, shown.text.split(" +- "))
        assert abs(_zeno_time(dict(orbit.parameters)) - middle) <= radius < 1e-18
    assert check_proof(proof.certificate).ok
    assert zo.enclose_period(orbit).enclosed


def _hopper() -> zo.Problem:
    """Return the hopper with ``e(v) = restitution / (1 + c v)``."""
    known = zo.load_problem("hopper")

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        system = known.model(p)
        law = p["restitution"] / (1 + p["c"] * zo.impact_speed)
        return zo.hybrid_system(system.mechanism, system.drive, law, switches=())

    c = zo.Quantity(name="c", unit="s/m", meaning="softening", default=0.05, lower=0.0)
    return replace(known, name="soft_hopper", model=model, parameters=(*known.parameters, c))


@pytest.mark.slow
def test_the_multiplier_of_a_hopper_lies_in_its_disc() -> None:
    """An impact with speed ``w`` throws the mass up with ``e(w) w``, and it falls with more."""
    problem = _hopper()
    p = problem.values().parameters
    orbit = zo.find_orbit(problem).unwrap()
    proof = zo.prove(orbit, problem=problem)
    verdict = check_proof(proof.certificate, problem)
    assert verdict.ok
    assert proof.bounds is not None
    gained = 2 * p["a"] * p["s"]

    def thrown(u: float) -> float:
        w = math.sqrt(u**2 + gained)
        return p["restitution"] * w / (1 + p["c"] * w)

    u = orbit.start_state["speed"]
    assert thrown(u) == pytest.approx(u, rel=1e-12)
    w = math.sqrt(u**2 + gained)
    expected = p["restitution"] / (1 + p["c"] * w) ** 2 * u / w
    ((middle, _, radius),) = proof.as_json()["multipliers"]
    assert abs(expected - middle) <= radius < 1e-9
