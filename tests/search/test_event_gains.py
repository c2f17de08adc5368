"""Gains of machines with several stops against closed forms and an independent search."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import zeno_orbits as zo
from tests.reference.relay_by_hand import lost_by_hand, period_by_hand, relay_by_hand
from tests.support.orbits import event_orbit
from tests.support.relays import UNCERTAIN, pulsed_relay, switching_times

# The hopper: impact speed v with v^2 = 2 a s / (1 - e^2), loss a s, multiplier e^2.
A, S, E = 20.0, 0.1, 0.5


def _search(free: dict[str, tuple[float, float]], **options: Any) -> zo.SearchResult:
    return zo.search_gains(
        "hopper", vary=free, parameters={"a": A, "s": S, "restitution": E}, **options
    )


def slow(*names: str) -> list[Any]:
    return [pytest.param(name, marks=pytest.mark.slow) for name in names]


@pytest.mark.slow
def test_the_least_loss_that_keeps_an_impact_speed_has_its_closed_form() -> None:
    bound = zo.Bound(name="stop.impact_speed", lower=2.0)
    found = _search({"a": (5.0, 40.0)}, objective=zo.MinImpactLoss(), bounds=[bound])
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    assert found.free["a"] == pytest.approx(4.0 * (1 - E**2) / (2 * S), rel=1e-6)
    assert found.value == pytest.approx(4.0 * (1 - E**2) / 2, rel=1e-6)
    assert found.asked[0]["kept"]
    assert found.mean is None


@pytest.mark.slow
def test_the_nearest_values_that_keep_a_bound_touch_it() -> None:
    bound = zo.Bound(name="stop.impact_speed", upper=2.0)
    found = _search({"a": (5.0, 40.0)}, bounds=[bound])
    assert found.free["a"] == pytest.approx(15.0, rel=1e-6)
    inside = _search({"a": (5.0, 40.0)}, bounds=[replace(bound, upper=3.0)])
    assert inside.free["a"] == A


@pytest.mark.slow
def test_a_prescribed_period_is_reached() -> None:
    period = (
        zo.find_orbit("hopper", parameters={"a": 23.0, "s": S, "restitution": E}).unwrap().period
    )
    found = _search({"a": (5.0, 40.0)}, objective=zo.TargetPeriod(target=period))
    assert found.orbit is not None
    assert found.orbit.period == pytest.approx(period, rel=1e-7)
    assert found.free["a"] == pytest.approx(23.0, rel=1e-5)


@pytest.mark.slow
def test_the_fastest_contraction_is_at_the_least_restitution() -> None:
    found = _search({"restitution": (0.3, 0.6)}, objective=zo.MinSpectralRadius())
    assert found.free["restitution"] == pytest.approx(0.3, abs=1e-6)
    assert found.value == pytest.approx(0.09, abs=1e-6)


@pytest.mark.slow
def test_the_worst_case_over_a_range_has_its_closed_form() -> None:
    # The corner with the least push decides the bound, and the one with the largest push the loss.
    found = _search(
        {"s": (0.05, 0.3)},
        objective=zo.MinImpactLoss(stop="stop", uncertain={"a": (15.0, 25.0)}),
        bounds=[zo.Bound(name="stop.impact_speed", lower=2.0)],
    )
    s = 4.0 * (1 - E**2) / (2 * 15.0)
    assert found.free["s"] == pytest.approx(s, rel=1e-6)
    assert found.value == pytest.approx(A * s, rel=1e-6)
    assert found.worst == pytest.approx(25.0 * s, rel=1e-6)
    assert found.worst_at == {"a": 25.0}
    assert found.mean == pytest.approx(20.0 * s, rel=1e-6)
    assert found.asked[0]["lowest"] == pytest.approx(2.0, rel=1e-6)


def test_an_orbit_of_many_events_is_compared_with_a_program_on_request(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("zeno_orbits.search.starts.strategy._MOST_COMPARED", 3)
    alone = zo.find_orbit("hopper")
    assert (alone.n_unknowns, alone.orbit is not None) == (0, True)
    asked = zo.find_orbit("hopper", method=zo.SearchMethod.PROGRAM)
    assert asked.n_unknowns > 0
    assert asked.orbit is not None
    assert asked.orbit.period == pytest.approx(alone.unwrap().period, rel=1e-9)


@pytest.mark.slow
def test_bounds_that_no_orbit_keeps_are_named_with_their_excess() -> None:
    found = _search({"a": (5.0, 40.0)}, bounds=[zo.Bound(name="stop.impact_speed", lower=9.0)])
    assert found.orbit is None
    fastest = math.sqrt(2 * 40.0 * S / (1 - E**2))
    assert f"by {9.0 - fastest:.3g}" in found.detail


@pytest.mark.slow
def test_an_orbit_without_the_events_of_an_objective_is_refused() -> None:
    with pytest.raises(zo.InputError, match=r"`objective` must be about events .* `bounce_time`"):
        _search({"a": (5.0, 40.0)}, objective=zo.MinBounceTime())
    with pytest.raises(zo.InputError, match=r"`bounds` must be about events .* `stop.zeno_time`"):
        _search({"a": (5.0, 40.0)}, bounds=[zo.Bound(name="stop.zeno_time", upper=1.0)])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"objective": zo.MinImpactLoss(stop="roof")}, "`roof`"),
        ({"objective": zo.MinImpactLoss(uncertain={"s": (0.2, 0.1)})}, "lower end below"),
        ({"objective": zo.MinImpactLoss(uncertain={"a": (1.0, 2.0)})}, "unknown `a`"),
        ({"bounds": [zo.Bound(name="roof.impact_speed", upper=1.0)]}, "`roof.impact_speed`"),
        ({"bounds": [zo.Bound(name="stop.impacts", upper=1.0)]}, "number `stop.impacts`"),
        ({"free": {"b": (0.0, 1.0)}}, "`b`"),
    ],
)
def test_invalid_searches_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(zo.InputError, match=words):
        _search(**{"free": {"a": (5.0, 40.0)}, **options})


@pytest.mark.slow
def test_a_search_from_several_starts_has_the_same_closed_forms() -> None:
    bound = zo.Bound(name="stop.impact_speed", lower=2.0)
    fixed = {"a": A, "s": S, "restitution": E}
    found = zo.search_gains(
        "hopper",
        vary={"a": (5.0, 40.0)},
        parameters=fixed,
        objective=zo.MinImpactLoss(),
        bounds=[bound],
    )
    best = found.candidates[0]
    assert found.unwrap().parameters["a"] == pytest.approx(4.0 * (1 - E**2) / (2 * S), rel=1e-6)
    assert best.score == pytest.approx(4.0 * (1 - E**2) / 2, rel=1e-6)
    assert best.starts == 2
    assert best.extents["stop.impact_speed"].lowest == pytest.approx(2.0, rel=1e-6)
    assert best.certificate is not None
    assert best.certificate.asked[0]["kept"]
    # The flights of a program share no step with the simulation.
    assert found.agreement < 1e-10
    assert found.n_unknowns > 50


@pytest.mark.slow
def test_the_worst_corner_is_the_score_of_a_search_from_several_starts() -> None:
    found = zo.search_gains(
        "hopper",
        vary={"s": (0.05, 0.3)},
        parameters={"a": A, "s": S, "restitution": E},
        objective=zo.MinImpactLoss(stop="stop", uncertain={"a": (15.0, 25.0)}),
        bounds=[zo.Bound(name="stop.impact_speed", lower=2.0)],
        settings=zo.SearchSettings(n_starts=0),
    )
    s = 4.0 * (1 - E**2) / (2 * 15.0)
    assert found.unwrap().parameters["s"] == pytest.approx(s, rel=1e-6)
    assert found.candidates[0].score == pytest.approx(25.0 * s, rel=1e-6)
    assert found.candidates[0].extents["stop.impact_speed"].lowest == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize("name", ["hopper", "clapper", *slow("relay", "kneed_walker")])
def test_the_orbit_of_any_machine_agrees_with_a_program(name: str) -> None:
    found = zo.search_gains(name, vary={})
    settled = zo.find_orbit(name).unwrap()
    assert found.agreement <= zo.SearchSettings().agreement
    assert found.unwrap().certificate["passed"]
    assert found.unwrap().sequence == settled.sequence
    assert found.unwrap().period == pytest.approx(settled.period, rel=1e-10)


# A machine with one stop: the ball on a shaking table, whose flights are parabolas less a sine.

MASS, TURNING, G, REBOUND = 0.05, 30.0, 9.81, 0.3


def table_impacts(amplitude: float) -> tuple[float, list[float], list[float]]:
    """Return the take-off, the times of the impacts with their limit, and their speeds."""

    def pull(time: float) -> float:
        return G - amplitude * TURNING**2 * math.sin(TURNING * time)

    def rise(time: float) -> float:
        return amplitude * TURNING * math.cos(TURNING * time)

    def flight(begin: float, speed: float) -> tuple[float, float]:
        """Return the time of the next impact, and the speed there."""

        def height(t: float) -> float:
            table = amplitude * (math.sin(TURNING * (begin + t)) - math.sin(TURNING * begin))
            return (speed + rise(begin)) * t - G * t**2 / 2 - table

        # Without a speed the first zero is the take-off itself.
        longest = 6 * speed / pull(begin) if speed else 0.15
        steps = np.linspace(0.0, longest, 1000)[3:]
        k = next(k for k, t in enumerate(steps) if height(float(t)) < 0.0)
        t = float(brentq(height, steps[k - 1], steps[k], xtol=1e-17))
        return begin + t, rise(begin + t) - (speed + rise(begin) - G * t)

    takeoff = math.asin(G / (amplitude * TURNING**2)) / TURNING
    times, speeds = list[float](), list[float]()
    begin, speed = takeoff, 0.0
    while not speeds or speeds[-1] > 1e-6:
        begin, struck = flight(begin, speed)
        times.append(begin)
        speeds.append(struck)
        speed = REBOUND * struck
    return takeoff, [*times, begin + 2 * speed / (pull(begin) * (1 - REBOUND))], speeds


def test_quantities_of_one_stop_have_their_closed_form() -> None:
    takeoff, times, speeds = table_impacts(0.015)
    found = event_orbit("vibrating_table").certificate["quantities"]
    wanted = {
        "release_time": takeoff,
        "impact_time": times[0],
        "impact_speed": speeds[0],
        "zeno_time": times[-1],
        "bounce_time": times[-1] - times[0],
        "impacts": sum(one > 0.01 * speeds[0] for one in speeds),
        "energy_lost": MASS * (1 - REBOUND**2) / 2 * sum(one**2 for one in speeds),
    }
    for word, value in wanted.items():
        assert found[f"stop.{word}"] == pytest.approx([value, value], rel=1e-7), word


@pytest.mark.slow
def test_one_stop_is_searched_for_a_bound_on_an_event_and_for_the_least_loss() -> None:
    bound = zo.Bound(name="stop.impact_speed", upper=0.4)
    found = zo.search_gains("vibrating_table", vary={"A": (0.012, 0.017)}, bounds=[bound])
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    assert table_impacts(found.free["A"])[2][0] == pytest.approx(0.4, rel=1e-7)
    least = zo.search_gains(
        "vibrating_table",
        vary={"A": (0.012, 0.017)},
        objective=zo.MinImpactLoss(),
        bounds=[zo.Bound(name="stop.impact_time", lower=0.13)],
    )
    _, times, speeds = table_impacts(least.free["A"])
    assert times[0] == pytest.approx(0.13, rel=1e-7)
    loss = MASS * (1 - REBOUND**2) / 2 * sum(one**2 for one in speeds)
    assert least.value == pytest.approx(loss, rel=1e-7)


# A relay whose voltage is cut at t1 and comes back at t2. The numbers are from a simplex search in
# a program that shares no code with this one.


@pytest.mark.slow
def test_the_softest_landing_is_the_end_of_a_family_at_which_the_impact_vanishes() -> None:
    once = zo.SearchSettings(n_starts=0)
    found = zo.search_gains("relay_soft", objective=zo.MinImpactLoss(stop="closed"), settings=once)
    assert found.orbit is None
    assert "`closed` vanishes" in found.detail
    assert found.free["t1"] == pytest.approx(1.17589e-3, abs=2e-7)
    assert found.free["t2"] == pytest.approx(3.48276e-3, abs=2e-6)
    (least,) = found.least_speeds
    assert least.name == "closed.impact_speed"


@pytest.mark.slow
def test_the_robust_landing_is_at_least_as_good_as_that_of_a_simplex_search() -> None:
    found = zo.search_gains(
        "relay_soft",
        objective=zo.MinImpactLoss(stop="closed", uncertain=UNCERTAIN),
        settings=zo.SearchSettings(n_starts=0),
    )
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    assert found.worst <= 4.34e-4
    assert found.free["t1"] == pytest.approx(1.20713e-3, abs=2e-8)
    assert found.free["t2"] == pytest.approx(2.49154e-3, abs=2e-7)
    # No corner is worse, by orbits that are found from rest.
    for stiffness in UNCERTAIN["ks"]:
        for resistance in UNCERTAIN["R"]:
            orbit = zo.find_orbit(
                "relay_soft",
                gains=found.free,
                parameters={"ks": stiffness, "R": resistance},
            ).unwrap()
            lost = orbit.certificate["quantities"]["closed.energy_lost"][0]
            assert lost <= found.worst * (1 + 1e-9)
    assert np.isfinite(found.mean or math.nan)


# Six switching times, as lengths of levels. The start is rounded from a global search.

SIX = (1.136e-3, 1.768e-3, 0.396e-3, 0.68e-3, 0.5675e-3, 1.9e-3)
BEST = (1.13371675, 2.96223735, 3.36195586, 4.26008844, 5.10589474, 6.99556498)
"""Switching times of the optimum [ms]."""
LOST = 1.06634747e-4
"""Energy lost at its worst corners [J]."""


@pytest.mark.weekly
@pytest.mark.slow
def test_six_switching_times_lose_a_quarter_of_what_two_lose() -> None:
    problem = pulsed_relay(SIX)
    found = zo.search_gains(problem, objective=zo.MinImpactLoss(stop="closed", uncertain=UNCERTAIN))
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    assert found.worst < 1.067e-4
    assert 4.33619e-4 / found.worst > 4.0
    times = [1e3 * time for time in switching_times(problem, found.free)]
    # The worst case is flat along some directions.
    assert times == pytest.approx(BEST, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", UNCERTAIN["ks"])
@pytest.mark.parametrize("resistance", UNCERTAIN["R"])
def test_a_program_that_shares_no_code_loses_no_more_at_a_corner(
    stiffness: float, resistance: float
) -> None:
    events = period_by_hand(relay_by_hand(stiffness, resistance, BEST))
    assert lost_by_hand(events, "closed") < LOST * (1 + 1e-5)
