"""Orbits whose restitution depends on the impact speed: their checks, derivatives and refusals."""

from __future__ import annotations

import copy
import math
import random
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.maps.test_two_walls import law_machine_of, problem_of
from tests.reference import library_truth as truth
from tests.support.impact_laws import LAWS, ball
from tests.support.orbits import shot_orbit
from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits import EventQuantities, closed_return, digest_of, same_equations
from zeno_orbits.simulation import SimulationSettings

OF_CLOSING = 1e-9
"""The solver closes an orbit to 1e-10 of its size."""


@cache
def _marble() -> zo.Orbit:
    return zo.find_orbit("marble_table").unwrap()


def test_all_searches_find_the_same_orbit() -> None:
    known = truth.vibrating_table(dict(_marble().parameters))
    for orbit in (_marble(), shot_orbit("marble_table")):
        assert orbit.zeno_time == pytest.approx(float(known.zeno_time), rel=OF_CLOSING)
        assert zo.verify(orbit).passed


def test_a_false_law_fails_its_checks() -> None:
    dynamics = zo.load_problem("marble_table").dynamics(
        _marble().values(zo.load_problem("marble_table"))
    )
    right = dynamics.restitution_at
    assert right is not None
    seen = zo.verify(
        _marble(), dynamics=replace(dynamics, restitution_at=lambda v: right(v) + 1e-6 * v)
    )
    assert set(seen.failed) == {"restitution", "impact_energy"}
    fastest = -_marble().impacts[0].state_minus["speed"]
    assert seen.residuals["restitution"] == pytest.approx(1e-6 * fastest, rel=1e-6)


def test_an_orbit_of_another_law_is_refused() -> None:
    parameters = {**_marble().parameters, "fall": 0.2 + 1e-6}
    seen = zo.verify(replace(_marble(), parameters=parameters))
    assert not seen.passed
    assert "impact_sequence" in seen.failed


def test_laws_that_differ_only_at_speed_have_other_equations() -> None:
    marble = digest_of(ball(LAWS["linear"]))
    assert same_equations(marble, digest_of(ball(LAWS["linear"])))
    assert not same_equations(marble, digest_of(ball(LAWS["exponential"])))
    # Of a micromechanism, whose law does not hold at 1 m/s.
    small, other = (ball(lambda v, p, _, c=c: p["e0"] - c * v) for c in (1e4, 1.5e4))
    assert not same_equations(digest_of(small), digest_of(other))


def test_the_loss_of_impacts_moves_as_its_differences() -> None:
    problem = zo.load_problem("marble_table")
    names = [*problem.names]
    chosen = tuple(names.index(name) for name in ("restitution", "fall", "A"))

    def losses(step: float, place: int) -> tuple[EventQuantities, float, float]:
        values = problem.values(parameters=dict(_marble().parameters))
        name = names[chosen[place]]
        values = values.replaced({name: values.parameters[name] + step})
        graph = problem.graph_dynamics(values)
        start = np.array(problem.state_vector(_marble().start_state))
        # The release moves with the amplitude alone.
        sine = values.parameters["g"] / (values.parameters["A"] * values.parameters["omega"] ** 2)
        start[2:] = math.sqrt(1 - sine**2), sine
        found = closed_return(
            graph,
            start,
            section="release stop",
            n_returns=1,
            guess=_marble().period,
            settings=SimulationSettings(),
            parameters=chosen,
        )
        quantities = EventQuantities.of(graph, found, chosen)
        (lost,) = quantities.readings("stop.energy_lost")
        return quantities, lost.value, float(np.ravel(lost.by)[-3 + place])

    for place in range(3):
        _, _, slope = losses(0.0, place)
        h = 1e-4
        f = [losses(k * h, place)[1] for k in (-2, -1, 1, 2)]
        difference = (f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * h)
        assert slope == pytest.approx(difference, rel=1e-7)


@pytest.mark.slow
def test_a_family_in_the_fall_has_the_orbits_of_the_recursion() -> None:
    family = zo.continue_orbit(_marble(), ("fall", 0.0, 0.5)).families[0]
    assert {round(family.first.at.value, 9), round(family.last.at.value, 9)} == {0.0, 0.5}
    for point in family.points[:: max(1, len(family.points) // 3)]:
        known = truth.vibrating_table({**_marble().parameters, "fall": point.value})
        contact = _marble().period - float(known.zeno_time)
        assert point.margins["contact duration"] == pytest.approx(contact, rel=1e-10)


@pytest.mark.slow
def test_an_orbit_of_two_stops_with_laws_is_verified_and_its_false_law_is_not() -> None:
    problem = problem_of(law_machine_of(random.Random(5)))
    orbit = zo.find_orbit(problem).unwrap()
    assert zo.verify(orbit, problem=problem).passed
    graph: Any = copy.copy(problem.graph_dynamics(orbit.values(problem)))
    view_of = graph.view

    def wrong(mode: Any, stop: int) -> HybridDynamics:
        view = view_of(mode, stop)
        right = view.restitution_at
        return replace(view, restitution_at=lambda v: right(v) + 1e-6)

    graph.view = wrong
    seen = zo.verify(orbit, problem=problem, dynamics=graph)
    assert set(seen.failed) == {"restitution", "impact_energy"}
