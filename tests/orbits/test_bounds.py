"""Bounds say what they bound, and by how much they are passed."""

from __future__ import annotations

import math

import pytest

from zeno_orbits.errors import InputError
from zeno_orbits.orbits.bounds import (
    Bound,
    asked_and_reached,
    excess,
    is_kept,
    objection_to,
)
from zeno_orbits.simulation.signals import Extent


@pytest.mark.parametrize(("lower", "upper"), [(2.0, 1.0), (math.nan, 1.0), (0.0, math.nan)])
def test_bounds_the_wrong_way_round_are_refused(lower: float, upper: float) -> None:
    with pytest.raises(InputError, match="`theta2` must have bounds LOWER <= UPPER"):
        Bound(name="theta2", lower=lower, upper=upper)


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
    first, second = asked_and_reached(bounds, extents)
    assert (first["upper"], first["lower"], first["highest"], first["kept"]) == (
        1.0,
        None,
        1.5,
        False,
    )
    assert second["kept"]


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(("passed", "kept"), [(1e-10, True), (1e-8, False)])
def test_a_bound_may_be_passed_by_rounding_and_no_more_in_any_unit(
    unit: float, passed: float, *, kept: bool
) -> None:
    upper = Bound(name="current", upper=2.0 * unit)
    above = Extent(lowest=-unit, highest=(2.0 + 2.0 * passed) * unit)
    assert is_kept(upper, above) is kept
    assert (objection_to([upper], {"current": above}) == "") is kept
    lower = Bound(name="current", lower=-2.0 * unit)
    below = Extent(lowest=-(2.0 + 2.0 * passed) * unit, highest=unit)
    assert is_kept(lower, below) is kept
