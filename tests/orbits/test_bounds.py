"""Bounds say what they bound, and by how much they are passed."""

from __future__ import annotations

import math

import pytest

from zeno_orbits.errors import InputError
from zeno_orbits.orbits import Bound, allowance, asked_and_reached, excess, objection_to
from zeno_orbits.simulation import Extent


@pytest.mark.parametrize(("lower", "upper"), [(2.0, 1.0), (math.nan, 1.0), (0.0, math.nan)])
def test_bounds_the_wrong_way_round_are_refused(lower: float, upper: float) -> None:
    with pytest.raises(InputError, match="`theta2` must have bounds LOWER <= UPPER"):
        Bound(name="theta2", lower=lower, upper=upper)


def test_bounds_that_meet_ask_for_a_value_and_one_finite_end_is_enough() -> None:
    assert Bound(name="theta2", lower=1.5, upper=1.5).text == "1.5:1.5"
    assert Bound(name="theta2", lower=-1.5).text == "-1.5:"
    with pytest.raises(InputError, match="LOWER <= UPPER, but they are 2:1"):
        Bound(name="theta2", lower=2.0, upper=1.0)


def test_bounds_that_bound_nothing_are_refused() -> None:
    with pytest.raises(InputError, match="`theta2` must have a finite bound, but it has :"):
        Bound(name="theta2")


def test_the_excess_is_the_distance_beyond_the_nearer_end() -> None:
    bound = Bound(name="i", lower=-1.0, upper=2.0)
    assert excess(bound, Extent(lowest=-0.5, highest=1.5)) == -0.5
    assert excess(bound, Extent(lowest=-1.25, highest=1.5)) == 0.25
    assert excess(bound, Extent(lowest=0.0, highest=3.0)) == 1.0
    assert bound.text == "-1:2"
    assert Bound(name="i", upper=2.0).text == ":2"


def test_what_a_bound_allows_is_a_billionth_of_the_largest_number_beside_it() -> None:
    narrow, wide = Extent(lowest=-0.5, highest=0.25), Extent(lowest=-8.0, highest=0.25)
    both = Bound(name="i", lower=-4.0, upper=2.0)
    assert allowance(both, narrow) == pytest.approx(4e-9, rel=1e-15)
    assert allowance(both, wide) == pytest.approx(8e-9, rel=1e-15)
    assert allowance(Bound(name="i", upper=2.0), narrow) == pytest.approx(2e-9, rel=1e-15)


def is_kept(bound: Bound, extent: Extent) -> bool:
    return objection_to([bound], {bound.name: extent}) == ""


def test_the_larger_of_rounding_and_the_error_of_the_measurement_is_forgiven() -> None:
    bound = Bound(name="i", upper=1.0)
    assert is_kept(bound, Extent(lowest=0.0, highest=1.5, error=0.5))
    assert not is_kept(bound, Extent(lowest=0.0, highest=1.5, error=0.49))
    assert is_kept(bound, Extent(lowest=0.0, highest=1.0 + 1e-10, error=1e-12))


def test_a_bound_is_kept_to_the_accuracy_of_the_measurement_and_no_further() -> None:
    bound = Bound(name="mu", upper=0.5)
    assert is_kept(bound, Extent(lowest=0.5, highest=0.5))
    assert not is_kept(bound, Extent(lowest=0.5, highest=0.5 + 1e-8))
    assert is_kept(bound, Extent(lowest=0.5, highest=0.5 + 1e-8, error=2e-8))
    assert not is_kept(bound, Extent(lowest=math.nan, highest=math.nan))


def test_an_objection_names_what_is_passed_and_by_how_much() -> None:
    bounds = (Bound(name="a", upper=1.0), Bound(name="b", lower=0.0))
    extents = {"a": Extent(lowest=0.0, highest=1.5), "b": Extent(lowest=0.0, highest=9.0)}
    assert objection_to(bounds, extents) == "`a` leaves its bounds :1 by 0.5."
    assert objection_to(bounds[1:], extents) == ""
    low = {"a": extents["a"], "b": Extent(lowest=-2.0, highest=9.0)}
    assert objection_to(bounds, low) == (
        "`a` leaves its bounds :1 by 0.5; `b` leaves its bounds 0: by 2."
    )


def test_what_is_asked_stands_beside_what_is_reached() -> None:
    bounds = (Bound(name="a", upper=1.0), Bound(name="b", lower=0.0))
    extents = {"a": Extent(lowest=0.0, highest=1.5), "b": Extent(lowest=0.25, highest=9.0)}
    assert asked_and_reached(bounds, extents) == [
        {
            "quantity": "a",
            "lower": None,
            "upper": 1.0,
            "lowest": 0.0,
            "highest": 1.5,
            "kept": False,
        },
        {
            "quantity": "b",
            "lower": 0.0,
            "upper": None,
            "lowest": 0.25,
            "highest": 9.0,
            "kept": True,
        },
    ]


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(("passed", "kept"), [(1e-10, True), (1e-8, False)])
def test_a_bound_may_be_passed_by_rounding_and_no_more_in_any_unit(
    unit: float, passed: float, *, kept: bool
) -> None:
    upper = Bound(name="current", upper=2.0 * unit)
    above = Extent(lowest=-unit, highest=(2.0 + 2.0 * passed) * unit)
    assert is_kept(upper, above) is kept
    lower = Bound(name="current", lower=-2.0 * unit)
    below = Extent(lowest=-(2.0 + 2.0 * passed) * unit, highest=unit)
    assert is_kept(lower, below) is kept
