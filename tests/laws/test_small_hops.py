r"""Flights lower than the rounding of the gap: a table whose acceleration hardly exceeds gravity.

With :math:`A \omega^2 = g (1 + \delta)` a ball that rests on the table is released where
:math:`\sin \omega t = 1 / (1 + \delta)` and lands after about
:math:`4 \sqrt{2 \delta} / \omega`. The exact landing is the root of an elementary function. The
gap acceleration is at most :math:`\delta g`, so its rounding limits the accuracy to a part
:math:`\epsilon / \delta`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import mpmath
import numpy as np
import pytest

from zeno_orbits.model import load_problem
from zeno_orbits.simulation import Execution, SimulationSettings, simulate

OMEGA, G = 30.0, 9.81
ENOUGH = SimulationSettings(most_steps=20_000)


def _run(delta: float, phase: float, omega: float = OMEGA) -> Execution:
    """Return a turn of the ball that rests on the table at a phase."""
    problem = load_problem("vibrating_table")
    if omega != OMEGA:
        # It falls for half a second: the table is far faster.
        problem = replace(problem, starts=({"height": 1.0, "cosine": 1.0},))
    numbers = {"A": G * (1 + delta) / omega**2, "omega": omega, "g": G}
    dynamics = problem.dynamics(problem.values(numbers=numbers))
    start = (0.0, 0.0, math.cos(phase), math.sin(phase))
    return simulate(dynamics, start, until=1.2 * 2 * math.pi / omega, settings=ENOUGH)


def _landing(delta: float, begin: float | None) -> tuple[float, float]:
    """Return duration and final gap rate of the flight from a phase, by default the release."""
    with mpmath.workdps(60):
        factor = 1 + mpmath.mpf(delta)
        start = mpmath.asin(1 / factor) if begin is None else mpmath.mpf(begin)

        def gap(a: mpmath.mpf) -> mpmath.mpf:
            # Over g / omega^2, with a the angle since the start.
            fallen = factor * (mpmath.sin(start) - mpmath.sin(start + a) + a * mpmath.cos(start))
            return fallen - a**2 / 2

        wide = 4 * mpmath.sqrt(2 * mpmath.mpf(delta))
        angle = mpmath.findroot(gap, (wide / 2, 1.2 * wide), solver="anderson")
        rate = factor * (mpmath.cos(start) - mpmath.cos(start + angle)) - angle
        return float(angle / OMEGA), float(rate * G / OMEGA)


@pytest.mark.parametrize("delta", [1e-4, 1e-6, 1e-8, 1e-9])
@pytest.mark.parametrize("phase", [0.0, 2.5, 4.0])
def test_a_release_that_hardly_happens_lands_where_the_closed_form_does(
    delta: float, phase: float
) -> None:
    found = _run(delta, phase)
    release = found.releases[0].time
    first = next(impact for impact in found.impacts if impact.time > release)
    duration, rate = _landing(delta, None)
    lost = 1e-9 + 1e-14 / delta
    assert abs(first.time - release - duration) <= lost * duration + 4 * np.spacing(first.time)
    assert abs(first.approach_rate - rate) <= lost * abs(rate)
    assert found.zeno_points


@pytest.mark.parametrize("delta", [0.1, 1e-3, 1e-6])
@pytest.mark.parametrize("omega", [1e3, 1e4, 1e5, 1e6])
def test_a_hop_lands_alike_on_a_table_that_is_far_faster_than_the_fall(
    omega: float, delta: float
) -> None:
    found = _run(delta, 0.0, omega)
    release = found.releases[0].time
    first = next(impact for impact in found.impacts if impact.time > release)
    duration, rate = (one * OMEGA / omega for one in _landing(delta, None))
    lost = 1e-9 + 1e-14 / delta
    assert abs(first.time - release - duration) <= lost * duration + 4 * np.spacing(first.time)
    assert abs(first.approach_rate - rate) <= lost * abs(rate)
    assert found.zeno_points


@pytest.mark.parametrize("delta", [1e-4, 1e-6, 1e-8])
def test_a_start_inside_such_a_flight_lands_where_the_closed_form_does(delta: float) -> None:
    found = _run(delta, math.pi / 2)
    duration, rate = _landing(delta, math.pi / 2)
    assert found.impacts[0].time == pytest.approx(duration, rel=1e-9 + 1e-14 / delta)
    assert found.impacts[0].approach_rate == pytest.approx(rate, rel=1e-9 + 1e-14 / delta)
