"""Attractors that coexist at the same values, and objectives that improve up to an end."""

from __future__ import annotations

import math

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.commands import YES, ask
from zeno_orbits.model import load_problem
from zeno_orbits.simulation import simulate

TABLE = load_problem("vibrating_table")


def impacts_per_turn(orbit: zo.Orbit, *, turns: int = 20) -> float:
    """Return the impacts per turn of the clock of a motion from the start of an orbit."""
    values = orbit.values(TABLE)
    turn = 2 * math.pi / values.number("omega")
    start = np.array(TABLE.state_vector(orbit.start_state))
    run = simulate(TABLE.dynamics(values), start, until=turns * turn)
    return len(run.impacts) / turns


@pytest.mark.slow
def test_both_attractors_of_a_table_are_found_from_other_initial_states() -> None:
    result = zo.search_gains(
        TABLE, vary={}, parameters={"A": 0.02}, settings=zo.SearchSettings(candidates=3)
    )
    orbits = {one.orbit.shape.text: one.orbit for one in result.candidates}
    assert set(orbits) == {"zeno", "impact"}
    # A load that leaves after each impact keeps e^2 of the phase volume per impact and turn.
    once = next(one for one in result.candidates if one.orbit.shape.text == "impact")
    assert once.certificate is not None
    restitution = once.orbit.parameters["restitution"]
    assert once.certificate.spectral_radius == pytest.approx(restitution, abs=1e-6)
    # Both persist by themselves.
    assert impacts_per_turn(orbits["impact"]) == pytest.approx(1.0, abs=0.1)
    assert impacts_per_turn(orbits["zeno"]) > 3.0
    assert result.n_states > 0


def test_the_command_states_where_it_looked_for_further_orbits() -> None:
    answer = ask("search", "vibrating_table", "--set", "A=0.02", "--candidates", "3")
    assert answer.code == YES
    looked = "1 start and 24 initial states at the values of the best orbit led to 2 orbits."
    assert f"1 fewer than requested: {looked}" in answer.out


@pytest.mark.slow
def test_an_energy_that_falls_to_the_end_of_the_family_is_answered_with_the_end() -> None:
    # The force just reaches the stop at A = 0.8, where the orbit shrinks to nothing.
    result = zo.search_gains(
        "forced_oscillator",
        vary={"A": (0.7, 1.3)},
        parameters={"A": 0.85},
        objective=zo.MinEnergy(),
        bounds=[zo.Bound(name="distance", upper=0.5)],
        settings=zo.SearchSettings(n_starts=0),
    )
    orbit = result.unwrap()
    assert 0.8 < orbit.parameters["A"] < 0.81
    assert "followed to A = 0.8, not beyond: there the release is not transversal" in result.detail


@pytest.mark.slow
def test_a_target_out_of_reach_states_the_distance_of_each_bound() -> None:
    oscillator = load_problem("forced_oscillator")
    result = zo.search_gains(
        oscillator,
        vary={"A": (0.9, 1.1)},
        objective=zo.TargetAmplitude(state=oscillator.amplitude_of, target=5.0),
        bounds=[zo.Bound(name=oscillator.amplitude_of, upper=10.0)],
        settings=zo.SearchSettings(n_starts=0),
    )
    assert result.orbit is None
    # The largest force leads to the largest amplitude, far below the target and the bound.
    assert "A = 1.1" in result.detail
    assert "missed: `an amplitude of 5 of" in result.detail
    assert f"; `{oscillator.amplitude_of}` is within :10 by 9." in result.detail


@pytest.mark.slow
def test_a_bound_that_no_orbit_keeps_is_named_instead_of_the_target() -> None:
    oscillator = load_problem("forced_oscillator")
    result = zo.search_gains(
        oscillator,
        vary={"A": (0.9, 1.1)},
        objective=zo.TargetAmplitude(state=oscillator.amplitude_of, target=0.2),
        bounds=[zo.Bound(name="distance", upper=0.01)],
        settings=zo.SearchSettings(n_starts=0),
    )
    assert result.orbit is None
    # At the smallest force the mass moves 0.0208 away from its stop.
    assert "at A = 0.9 (A at its bound 0.9)" in result.detail
    assert "`distance` leaves its bounds :0.01 by 0.0108." in result.detail
    assert "missed:" not in result.detail
