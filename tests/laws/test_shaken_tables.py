"""Periods of balls on shaken tables, fast, slow and very slow ones, against exact flights.

`benchmarks/shaken_tables.py` asks more of them, and asks searches as well.
"""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.exact_flights import TURN, Truth, clearly_settled, flight_time, settled
from tests.support.cases import fast
from zeno_orbits.maps import attractors_at

GRAVITY = 9.81


def test_a_flight_of_the_truth_ends_on_the_table() -> None:
    drawn = random.Random(3)
    for _ in range(200):
        acceleration, phase = drawn.uniform(1.5, 3.3), drawn.uniform(0.0, TURN)
        speed = 10.0 ** drawn.uniform(-3, 1)
        s = flight_time(acceleration, phase, speed)
        table = acceleration * (math.sin(phase + s) - math.sin(phase))
        up = speed + acceleration * math.cos(phase)
        assert up * s - s**2 / 2 == pytest.approx(table, abs=1e-12)
        # And nowhere before.
        at = np.linspace(0.0, s, 400)[1:-1]
        assert np.all(up * at - at**2 / 2 > acceleration * (np.sin(phase + at) - np.sin(phase)))


def test_the_truth_knows_the_orbit_of_the_bundled_table() -> None:
    values = zo.load_problem("vibrating_table").values().parameters
    acceleration = values["A"] * values["omega"] ** 2 / values["g"]
    found = settled(acceleration, values["restitution"], 10)
    assert (found.turns, found.rests) == (1, True)


@pytest.fixture(scope="module")
def tables() -> list[tuple[float, float, Truth]]:
    """Acceleration, restitution and truth of random tables that settle to up to 22 turns."""
    drawn = random.Random(2)
    found: list[tuple[float, float, Truth]] = []
    while len(found) < 8:
        numbers = drawn.uniform(1.5, 3.3), drawn.uniform(0.0, 0.7)
        truth = clearly_settled(*numbers, 100)
        if truth is not None and 0 < truth.turns <= 22:
            found.append((*numbers, truth))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("omega", fast(1, [30.0, 1.0, 0.01]))
def test_a_map_names_the_periods_of_random_tables(
    tables: list[tuple[float, float, Truth]], omega: float
) -> None:
    problem = zo.load_problem("vibrating_table")
    settings = [
        problem.values(
            parameters={"A": g * GRAVITY / omega**2, "omega": omega, "restitution": e, "g": GRAVITY}
        )
        for g, e, _ in tables
    ]
    turns = [one.period * omega / TURN for one in attractors_at(problem, settings)]
    wanted = [truth.turns for *_, truth in tables]
    assert turns == pytest.approx(wanted, rel=1e-7)
    assert len(set(wanted)) > 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("acceleration", "restitution", "turns"),
    # Two first impacts in two turns, each followed by a second one before the table throws it.
    [(2.863950206399586, 0.0364932547995305, 2)],
)
def test_a_map_names_orbits_of_sequences_of_impacts_that_never_rest(
    acceleration: float, restitution: float, turns: int
) -> None:
    truth = clearly_settled(acceleration, restitution, 200)
    assert truth == Truth(turns=turns, rests=False)
    problem = zo.load_problem("vibrating_table")
    shaken = {"A": acceleration * GRAVITY / 30.0**2, "omega": 30.0, "restitution": restitution}
    (found,) = attractors_at(problem, [problem.values(parameters=shaken)])
    assert found.period * 30.0 / TURN == pytest.approx(turns, rel=1e-7)
    # All impacts of a period reset the ball, but few so hard: e squared for each, at most.
    assert 0.0 < found.spectral_radius < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("acceleration", "restitution"),
    # At local errors of 1e-6, 1e-7 and 1e-8 it comes to rest after 40, 54 and 89 turns.
    [(1.573275637205788, 0.6868547407037112)],
)
def test_a_map_names_no_period_that_its_own_errors_decide(
    acceleration: float, restitution: float
) -> None:
    changed = [settled((1 + part) * acceleration, restitution, 100) for part in (1e-11, 1e-9)]
    assert changed[0] != changed[1]
    problem = zo.load_problem("vibrating_table")
    shaken = {"omega": 30.0, "restitution": restitution}
    amplitude = acceleration * GRAVITY / 30.0**2
    settings = [
        problem.values(parameters=shaken | {"A": amplitude * (1 + part)})
        for part in (-1e-11, 0.0, 1e-12, 1e-11, 1e-10)
    ]
    found = attractors_at(problem, settings, until=100 * TURN / 30.0)
    assert all(math.isnan(one.period) for one in found)
    # Where some end and others do not within the time limit, the reason is named.
    assert {one.detail for one in found} <= {"", "its attractor depends on the smallest errors"}
