"""Orbits of machines that a short pulse strikes, by the closed form of a damped flight.

A mass :math:`\\ddot x = -x - 2 d\\,\\dot x - w_0` rests on the floor :math:`x \\ge 0`. A pulse of
the area `I` and the width `w` throws it up once a turn, and it rests again before the next one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import pytest
from scipy.optimize import brentq

import zeno_orbits as zo
from tests.support.one_mass import one_mass

pytestmark = pytest.mark.slow

DAMPING, WEIGHT, AREA, AT, E = 0.15, 0.5, 1.0, 1.0, 0.4


def _problem(width: float) -> zo.Problem:
    def pulse(clock: zo.Clock | None, p: Mapping[str, ca.SX]) -> ca.SX:
        assert clock is not None
        levels = (0, AREA / p["width"], 0)
        return zo.piecewise(clock, levels=levels, times=(AT, AT + p["width"]))

    return one_mass(
        lambda m: pulse(m.clock, m.p) - m.x - 2 * DAMPING * m.v - WEIGHT,
        stops=lambda m: (zo.Stop(name="floor", gap=m.x, restitution=E),),
        start={"x": 0.5, "v": 0.0, "cosine": 1.0},
        omega=1.0,
        width=width,
    )


def _flown(x: float, v: float, load: float, time: float) -> tuple[float, float]:
    """Return place and speed after a time under a constant load, in closed form."""
    omega = math.sqrt(1.0 - DAMPING**2)
    a = x - load
    b = (v + DAMPING * a) / omega
    c, s, fall = math.cos(omega * time), math.sin(omega * time), math.exp(-DAMPING * time)
    rate = (b * omega - DAMPING * a) * c - (a * omega + DAMPING * b) * s
    return load + fall * (a * c + b * s), fall * rate


def _height(time: float, x: float, v: float) -> float:
    return _flown(x, v, -WEIGHT, time)[0]


def _impacts(width: float, count: int) -> list[float]:
    """Return the times of the first impacts after the start of the pulse."""
    x, v = _flown(0.0, 0.0, AREA / width - WEIGHT, width)
    time, found = width, list[float]()
    for _ in range(count):
        last = 2.0 * v / WEIGHT
        fall = float(brentq(_height, last / 4, last, args=(x, v)))
        v = -E * _flown(x, v, -WEIGHT, fall)[1]
        time, x = time + fall, 0.0
        found.append(time)
    return found


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6, 1e-7])
def test_the_orbit_of_a_short_pulse_is_found_and_is_the_closed_form(width: float) -> None:
    problem = _problem(width)
    orbit = zo.find_orbit(problem).unwrap()
    assert orbit.period == pytest.approx(2 * math.pi, rel=1e-9)
    assert zo.verify(orbit, problem=problem).passed
    pulse = next(one.time for one in orbit.events if one.name == "switch kink 1")
    motion = zo.simulate(problem, start=orbit.start_state, until=orbit.period)
    seen = [impact.time - pulse for impact in motion.impacts][:3]
    # The rounding of two switching times changes the area of the pulse.
    assert seen == pytest.approx(_impacts(width, 3), abs=1e-11 + 1e-14 / width)


def test_an_event_of_a_short_pulse_that_is_off_by_more_than_rounding_is_refused() -> None:
    problem = _problem(1e-7)
    orbit = zo.find_orbit(problem).unwrap()
    last = orbit.events[-1]
    moved = replace(last, state={**last.state, "sine": last.state["sine"] + 1e-6})
    certificate = zo.verify(replace(orbit, events=(*orbit.events[:-1], moved)), problem=problem)
    assert "`zeno_point`" in certificate.verdict()
    assert not certificate.passed
