"""Margins as distances in the free numbers until an orbit is lost or ceases to attract."""

from __future__ import annotations

import pytest

import zeno_orbits as zo
from tests.support.commands import YES, ask
from zeno_orbits import MaxMargin
from zeno_orbits.continuation import family_of_orbit
from zeno_orbits.model import load_problem
from zeno_orbits.search import SearchSettings, orbit_at_gains, search_orbits

ONCE = SearchSettings(n_starts=0)


def widest(
    name: str, free: dict[str, tuple[float, float]], *, start: dict[str, float] | None = None
) -> tuple[zo.Orbit, float, str]:
    """Return the orbit of the widest margin, its margin, and the sentences on it."""
    problem = load_problem(name)
    values = problem.values(numbers=start or {})
    result = search_orbits(problem, values, free=free, objective=MaxMargin(), settings=ONCE)
    extent = result.candidates[0].extents["persistence"]
    return result.unwrap(), extent.lowest, result.detail


@pytest.mark.slow
def test_the_margin_in_one_number_is_the_distance_to_the_known_end_of_the_family() -> None:
    # The force just reaches the stop at A = 0.8, and nothing ends at larger forces.
    orbit, margin, detail = widest("forced_oscillator", {"A": (0.7, 1.3)})
    assert orbit.parameters["A"] == pytest.approx(1.3, abs=1e-9)
    assert margin == pytest.approx((1.3 - 0.8) / 0.6, abs=1e-6)
    assert "The nearest loss is at A = 0.8: the release is not transversal." in detail


@pytest.mark.slow
def test_the_margin_in_two_numbers_is_the_smaller_of_the_known_distances() -> None:
    # The orbit ends where A = 0.8 k. Both distances grow toward the corner.
    orbit, margin, _ = widest("forced_oscillator", {"A": (0.7, 1.0), "k": (0.9, 1.1)})
    assert orbit.parameters["A"] == pytest.approx(1.0, abs=1e-9)
    assert orbit.parameters["k"] == pytest.approx(0.9, abs=1e-9)
    assert margin == pytest.approx(min((1.0 - 0.8 * 0.9) / 0.3, 1.0), abs=1e-6)


@pytest.mark.weekly
@pytest.mark.slow
def test_opposite_losses_leave_the_middle_between_them() -> None:
    # At k the stiffness may grow to A / 0.8. What ends the orbit below is found by `continue`.
    free = {"A": (0.7, 1.3), "k": (0.5, 1.5), "restitution": (0.1, 0.95)}
    orbit, margin, _ = widest("forced_oscillator", free)
    problem = load_problem("forced_oscillator")
    family = family_of_orbit(problem, orbit, "k", (0.05, 1.7)).families[0]
    low, high = sorted(one.at.value for one in (family.first, family.last))
    assert high == pytest.approx(1.3 / 0.8, abs=1e-6)
    k = orbit.parameters["k"]
    assert margin == pytest.approx(min(k - low, high - k), abs=1e-4)
    assert margin == pytest.approx((high - low) / 2, abs=2e-4)


@pytest.mark.slow
def test_an_orbit_that_ceases_to_attract_counts_as_lost() -> None:
    orbit, margin, _ = widest("motor_pendulum", {"Kd": (-2.0, 0.0)})
    problem = load_problem("motor_pendulum")
    family = family_of_orbit(problem, orbit, "Kd", (-2.0, 0.0)).families[0]
    # The family goes on beyond its fold, unstable.
    fold = next(one.at.value for one in family.special if one.kind.value == "fold")
    ends = [one.at.value for one in (family.first, family.last)]
    vanishes = min(ends, key=lambda value: abs(value + 0.186))
    assert orbit.gains["Kd"] == pytest.approx((fold + vanishes) / 2, abs=1e-3)
    assert margin == pytest.approx((vanishes - fold) / 4, abs=3e-4)


@pytest.mark.slow
def test_a_parameter_may_reach_the_last_value_that_makes_sense() -> None:
    # Impacts without restitution end nothing: the orbit is then a simple one.
    orbit, margin, detail = widest("forced_oscillator", {"restitution": (0.1, 0.95)})
    assert "It persists for restitution = 0 to 0.9" in detail
    assert orbit.parameters["restitution"] == pytest.approx(0.1, abs=1e-6)
    assert 0.9 < margin <= 1.0


@pytest.mark.slow
def test_a_margin_keeps_the_bounds() -> None:
    problem = load_problem("forced_oscillator")
    result = search_orbits(
        problem,
        problem.values(),
        free={"A": (0.7, 1.3)},
        objective=MaxMargin(),
        bounds=[zo.Bound(name="energy", upper=0.008569559586875221)],
        settings=ONCE,
    )
    # The work at A = 0.9, as a simulation of that orbit measures it.
    assert result.unwrap().parameters["A"] == pytest.approx(0.9, abs=2e-4)
    assert orbit_at_gains(problem, problem.values(parameters={"A": 0.9})).orbit is not None


@pytest.mark.slow
def test_zeno_orbits_that_persist_are_preferred_to_an_orbit_that_is_soon_lost() -> None:
    # Of the valve, orbits with six impacts and without a Zeno point are lost at Kp + 0.5 %.
    answer = ask("search", "motor_valve", "--objective", "margin", "--json")
    assert answer.code == YES
    assert answer.data["shape"] == "zeno"
    problem = load_problem("motor_valve")
    for factor in (0.75, 1.25):
        gains = dict(answer.data["gains"])
        gains["Kp"] *= factor
        near = orbit_at_gains(problem, problem.values(gains=gains)).unwrap()
        assert near.shape.text == "zeno"
