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


@pytest.mark.parametrize("omega", [30.0, 1.0, 0.01])
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
