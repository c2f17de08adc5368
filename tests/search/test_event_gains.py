"""Gains of machines with several stops against closed forms and an independent search."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo

# The hopper: impact speed v with v^2 = 2 a s / (1 - e^2), loss a s, multiplier e^2.
A, S, E = 20.0, 0.1, 0.5


def _search(free: dict[str, tuple[float, float]], **options: Any) -> zo.EventSearchResult:
    return zo.search_event_gains(
        "hopper", free=free, parameters={"a": A, "s": S, "restitution": E}, **options
    )


def test_the_least_loss_that_keeps_an_impact_speed_has_its_closed_form() -> None:
    bound = zo.Bound(name="stop.impact_speed", lower=2.0)
    found = _search({"a": (5.0, 40.0)}, objective=zo.MinImpactLoss(), bounds=[bound])
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    assert found.free["a"] == pytest.approx(4.0 * (1 - E**2) / (2 * S), rel=1e-6)
    assert found.value == pytest.approx(4.0 * (1 - E**2) / 2, rel=1e-6)
    assert found.asked[0]["kept"]
    assert found.mean is None


def test_the_nearest_values_that_keep_a_bound_touch_it() -> None:
    bound = zo.Bound(name="stop.impact_speed", upper=2.0)
    found = _search({"a": (5.0, 40.0)}, bounds=[bound])
    assert found.free["a"] == pytest.approx(15.0, rel=1e-6)
    inside = _search({"a": (5.0, 40.0)}, bounds=[replace(bound, upper=3.0)])
    assert inside.free["a"] == A


def test_a_prescribed_period_is_reached() -> None:
    period = zo.find_event_orbit("hopper", parameters={"a": 23.0, "s": S, "restitution": E}).period
    found = _search({"a": (5.0, 40.0)}, objective=zo.TargetPeriod(target=period))
    assert found.orbit is not None
    assert found.orbit.period == pytest.approx(period, rel=1e-7)
    assert found.free["a"] == pytest.approx(23.0, rel=1e-5)


def test_the_fastest_contraction_is_at_the_least_restitution() -> None:
    found = _search({"restitution": (0.3, 0.6)}, objective=zo.MinSpectralRadius())
    assert found.free["restitution"] == pytest.approx(0.3, abs=1e-6)
    assert found.value == pytest.approx(0.09, abs=1e-6)


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


def test_bounds_that_no_orbit_keeps_are_named_with_their_excess() -> None:
    found = _search({"a": (5.0, 40.0)}, bounds=[zo.Bound(name="stop.impact_speed", lower=9.0)])
    assert found.orbit is None
    fastest = math.sqrt(2 * 40.0 * S / (1 - E**2))
    assert f"by {9.0 - fastest:.3g}" in found.detail


def test_an_orbit_without_the_events_of_an_objective_is_refused() -> None:
    with pytest.raises(zo.InputError, match=r"`objective` must be about events .* `bounce_time`"):
        _search({"a": (5.0, 40.0)}, objective=zo.MinBounceTime())
    with pytest.raises(zo.InputError, match=r"`keep` must be about events .* `stop.zeno_time`"):
        _search({"a": (5.0, 40.0)}, bounds=[zo.Bound(name="stop.zeno_time", upper=1.0)])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"objective": zo.MinEnergy()}, "must be one of nearest, period, contraction"),
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


def test_objectives_about_impacts_need_several_stops_in_this_version() -> None:
    with pytest.raises(zo.InputError, match="several stops or switches"):
        zo.search_gains("vibrating_table", free={"A": (0.9, 1.1)}, objective=zo.MinImpactLoss())


# A relay whose voltage is cut at t1 and comes back at t2. The numbers are from a simplex search in
# a program that shares no code with this one.


@pytest.mark.slow
def test_the_softest_landing_is_the_end_of_a_family_at_which_the_impact_vanishes() -> None:
    found = zo.search_event_gains("relay_soft", objective=zo.MinImpactLoss(stop="closed"))
    assert found.orbit is None
    assert "`closed` vanishes" in found.detail
    assert found.free["t1"] == pytest.approx(1.17589e-3, abs=2e-7)
    assert found.free["t2"] == pytest.approx(3.48276e-3, abs=2e-6)
    (least,) = found.least_speeds
    assert least.name == "closed.impact_speed"


@pytest.mark.slow
def test_the_robust_landing_is_at_least_as_good_as_that_of_a_simplex_search() -> None:
    uncertain = {"ks": (52.25, 57.75), "R": (47.5, 52.5)}
    found = zo.search_event_gains(
        "relay_soft", objective=zo.MinImpactLoss(stop="closed", uncertain=uncertain)
    )
    assert found.orbit is not None
    assert found.orbit.certificate["passed"]
    assert found.worst <= 4.34e-4
    assert found.free["t1"] == pytest.approx(1.20713e-3, abs=2e-8)
    assert found.free["t2"] == pytest.approx(2.49154e-3, abs=2e-7)
    # No corner is worse, by orbits that are found from rest.
    for stiffness in uncertain["ks"]:
        for resistance in uncertain["R"]:
            orbit = zo.find_event_orbit(
                "relay_soft",
                gains=found.free,
                parameters={"ks": stiffness, "R": resistance},
            )
            lost = orbit.certificate["quantities"]["closed.energy_lost"][0]
            assert lost <= found.worst * (1 + 1e-9)
    assert np.isfinite(found.mean or math.nan)
