"""Orbits of many impacts, over which errors grow ten thousandfold, against exact flights."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import zeno_orbits as zo
from tests.reference.exact_flights import clearly_settled
from zeno_orbits.integrators import Tolerance
from zeno_orbits.search import SearchSettings, orbit_at_gains, orbit_by_shooting
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.verification import verify

TABLE = zo.load_problem("vibrating_table")
THIRTEEN, TWELVE = (1.7418556394, 0.5932036159), (2.3016969492986425, 0.5050780226385477)
"""Largest acceleration in units of gravity, and restitution."""
FINEST = SimulationSettings(tolerance=Tolerance(relative=1e-14, absolute=1e-15))


def shaken(table: tuple[float, float], omega: float) -> zo.ParameterValues:
    acceleration, restitution = table
    return TABLE.values(
        parameters={
            "A": acceleration * 9.81 / omega**2,
            "omega": omega,
            "restitution": restitution,
            "g": 9.81,
        }
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "omega"), [(THIRTEEN, 30.0), (THIRTEEN, 0.01), (TWELVE, 30.0), (TWELVE, 1.0)]
)
def test_a_search_returns_the_orbit_that_the_motion_settles_to(
    table: tuple[float, float], omega: float
) -> None:
    truth = clearly_settled(*table, 1500)
    assert truth is not None
    orbit = zo.find_orbit(TABLE, parameters=shaken(table, omega).parameters).unwrap()
    # A repelling orbit of one turn is near, and a way round by other restitutions leads to it.
    assert orbit.period * omega / (2 * math.pi) == pytest.approx(truth.turns, rel=1e-9)
    seen = zo.verify(orbit, problem=TABLE)
    assert seen.passed
    assert seen.stable


def test_an_orbit_is_not_refused_for_what_errors_of_the_check_itself_grow_to() -> None:
    orbit = orbit_by_shooting(TABLE, shaken(THIRTEEN, 30.0), simulation=FINEST).unwrap()
    assert len(orbit.impacts) > 25
    # Local errors of 1e-12 are 1e-8 at its last impacts.
    assert verify(orbit, TABLE).passed
    last = orbit.phases[0].impacts[-1]
    late = replace(last, time=last.time + 1e-8 * orbit.period)
    impacts = (*orbit.phases[0].impacts[:-1], late)
    wrong = orbit.with_phases((replace(orbit.phases[0], impacts=impacts),))
    assert verify(wrong, TABLE).failed == ("impact_sequence",)


def test_a_motion_closes_its_orbit_where_program_and_simulation_never_agree() -> None:
    never = SearchSettings(n_starts=0, rounds=1, agreement=1e-17)
    found = orbit_at_gains(TABLE, TABLE.values(), settings=never)
    orbit = found.unwrap()
    assert "simulation alone closes the orbit" in found.detail
    # It moves with the table, which turns at 30 rad/s.
    assert orbit.period == pytest.approx(2 * math.pi / 30, rel=1e-11)
    assert verify(orbit, TABLE).passed
