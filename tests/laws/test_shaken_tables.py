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
def tables() -> list[tuple[float, float, Truth | None]]:
    """Acceleration, restitution and truth of random tables."""
    drawn = random.Random(2)
    asked = [(drawn.uniform(1.5, 3.3), drawn.uniform(0.0, 0.7)) for _ in range(14)]
    return [(*numbers, clearly_settled(*numbers, 250)) for numbers in asked]


@pytest.mark.parametrize("omega", [30.0, 1.0, 0.01])
def test_a_map_names_the_periods_of_random_tables(
    tables: list[tuple[float, float, Truth | None]], omega: float
) -> None:
    problem = zo.load_problem("vibrating_table")
    settings = [
        problem.values(
            parameters={"A": g * GRAVITY / omega**2, "omega": omega, "restitution": e, "g": GRAVITY}
        )
        for g, e, _ in tables
    ]
    turns = [one.period * omega / TURN for one in attractors_at(problem, settings)]
    pairs = zip((truth for *_, truth in tables), turns, strict=True)
    known = [(truth, n) for truth, n in pairs if truth is not None]
    short = [(truth, n) for truth, n in known if 0 < truth.turns <= 22]
    assert len(short) >= 10
    assert len({truth.turns for truth, _ in short}) > 2
    for truth, n in short:
        assert n == pytest.approx(truth.turns, rel=1e-7)
