"""A spot of 4 mm on a path of 1 m: a search gives the true orbit, and the checker passes no other.

The ball is released where the lift of table and magnet reaches its weight: the root of an
elementary function. A search for events that misses the spot returns the orbit without it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from scipy.optimize import brentq

from tests.support.magnet_spot import PROBLEM, WIDTH
from zeno_orbits.integrators import FlowWithEvent, PlainFlow
from zeno_orbits.maps import Axis, Plane, map_of_plane
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.verification import verify
from zeno_orbits.work import ExecutionPlan, Workers

A, OMEGA, G, PULL, SPOT = 0.015, 30.0, 9.81, 12.0, 0.3


def _weight_less_lift(angle: float) -> float:
    magnet = PULL * math.exp((math.cos(angle - SPOT) - 1) / WIDTH**2)
    return G - A * OMEGA**2 * math.sin(angle) - magnet


def test_the_search_finds_the_orbit_with_two_releases() -> None:
    orbit = orbit_at_gains(PROBLEM, PROBLEM.values()).unwrap()
    at_magnet = brentq(_weight_less_lift, SPOT - 3 * WIDTH, SPOT, xtol=1e-15)
    assert orbit.shape.text == "zeno*2"
    assert orbit.period == pytest.approx(2 * math.pi / OMEGA, rel=1e-11)
    released = sorted(phase.start_state["sine"] for phase in orbit.phases)
    assert released == pytest.approx([math.sin(at_magnet), G / (A * OMEGA**2)], abs=1e-9)
    assert verify(orbit, PROBLEM).passed


def test_a_map_counts_the_release_at_the_magnet_where_it_is_strong_enough() -> None:
    # The stop presses with g - A omega^2 sin(spot) = 5.82 N at the spot of a mass of 1 kg.
    plane = Plane(
        source=PROBLEM,
        x=Axis(name="pull", lower=5.0, upper=12.0, count=3),
        y=Axis(name="restitution", lower=0.25, upper=0.35, count=2),
        start=(0.0, 0.0, 1.0, 0.0),
        until=20.0,
    )
    found = map_of_plane(plane, ExecutionPlan(place=Workers(count=1), chunk=6))
    assert [attractor.returns for attractor in found.attractors] == [1, 2, 2] * 2
    assert _weight_less_lift(SPOT) + PULL == pytest.approx(5.82, abs=0.01)


@pytest.fixture(scope="module")
def unaware() -> Orbit:
    """The orbit without the magnet, claimed of the machine with it."""
    orbit = orbit_at_gains(PROBLEM, PROBLEM.values(parameters={"pull": 0.0})).unwrap()
    assert verify(orbit, PROBLEM).passed
    return replace(orbit, parameters={**orbit.parameters, "pull": PULL})


def test_an_orbit_that_passes_the_spot_is_refused(unaware: Orbit) -> None:
    assert not verify(unaware, PROBLEM).passed


@pytest.mark.slow
def test_samples_at_bounded_steps_refuse_it_where_the_search_for_events_is_blind(
    unaware: Orbit,
) -> None:
    machine = PROBLEM.dynamics(unaware.values(PROBLEM))

    def without_bounds(flow: FlowWithEvent) -> PlainFlow:
        return PlainFlow(field=flow.rate, guard_and_rate=flow.guard)

    blind = replace(
        machine, locked=without_bounds(machine.locked), free=without_bounds(machine.free)
    )
    seen = verify(unaware, PROBLEM, dynamics=blind)
    # Alone: the blind integration returns where the claim does.
    assert seen.failed == ("adhesion",)
    # The least multiplier is that at the spot, in units of the largest: where the table falls
    # fastest, which is while the ball lies on it.
    least = min(_weight_less_lift(SPOT + k * 1e-4) for k in range(-200, 200))
    assert seen.residuals["adhesion"] == pytest.approx(-least / (G + A * OMEGA**2), rel=0.02)
