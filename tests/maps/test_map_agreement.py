"""The benchmark that holds maps against long runs notices what it is there to notice."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from benchmarks import map_agreement
from tests.reference.long_simulation import LongRun
from zeno_orbits.maps import Attractor, AttractorClass, Axis, Plane, map_of_plane
from zeno_orbits.model import locate_problem
from zeno_orbits.work import ExecutionPlan, Workers

ZENO = Attractor(fate=AttractorClass.ZENO, returns=1, period=1.8, multipliers=(0.5 + 0j,))


@pytest.mark.parametrize(
    "other",
    [
        replace(ZENO, fate=AttractorClass.SIMPLE),
        replace(ZENO, fate=AttractorClass.UNSETTLED),
        replace(ZENO, returns=2),
        replace(ZENO, period=1.8 * (1 + 2e-6)),
        replace(ZENO, multipliers=(0.502 + 0j,)),
        replace(ZENO, multipliers=()),
        Attractor(fate=AttractorClass.ESCAPE, escaped="theta1"),
    ],
)
def test_another_answer_is_a_disagreement(other: Attractor) -> None:
    def compared(fast: Attractor, slow: Attractor, near: bool = False) -> object:
        return map_agreement.Comparison(point=(1.0, 2.0), fast=fast, slow=slow, near_boundary=near)

    assert compared(ZENO, ZENO).agrees
    assert not compared(ZENO, other).agrees
    assert not compared(other, ZENO).agrees
    assert map_agreement._tell([compared(ZENO, other)], as_json=False) == 1
    assert map_agreement._tell([compared(ZENO, other, near=True)], as_json=False) == 0
    assert map_agreement._tell([compared(ZENO, ZENO)], as_json=True) == 0


@pytest.mark.parametrize(
    ("fast", "trend", "code"),
    [
        (Attractor(fate=AttractorClass.REST), 0.98, 0),
        (Attractor(fate=AttractorClass.REST), 1.02, 1),
        (ZENO, 1.0005, 0),
        (ZENO, 0.95, 1),
        (Attractor(fate=AttractorClass.ESCAPE, escaped="x"), 1.0005, 1),
    ],
)
def test_a_long_run_that_has_not_settled_is_excused_only_if_it_moves_as_the_map_says(
    fast: Attractor, trend: float, code: int
) -> None:
    slow = Attractor(fate=AttractorClass.UNSETTLED, trend=trend)
    one = map_agreement.Comparison(point=(1.0, 2.0), fast=fast, slow=slow, near_boundary=False)
    assert not one.agrees
    assert map_agreement._tell([one], as_json=False) == code


@pytest.mark.slow
def test_a_cell_beside_another_fate_is_near_a_boundary() -> None:
    plane = Plane(
        source=locate_problem("bouncing_ball"),
        x=Axis(name="m", lower=1.0, upper=2.0, count=4),
        y=Axis(name="g", lower=1.0, upper=2.0, count=2),
        start=(1.0, 0.0),
        until=60.0,
    )
    found = map_of_plane(plane, ExecutionPlan(place=Workers(count=1)))
    assert not any(map_agreement.near_boundary(found, k) for k in range(8))
    mixed = replace(found, attractors=(ZENO, *found.attractors[1:]))
    near = [k for k in range(8) if map_agreement.near_boundary(mixed, k)]
    assert near == [0, 1, 4, 5]
    task = map_agreement.LongRuns(plane=plane, run=LongRun(until=120.0))
    fates = [one["fate"] for one in task(plane.points()[:2])]
    assert fates == ["rest", "rest"]


@pytest.mark.parametrize(("fates", "near"), [("12", True), ("11", False), ("13", False)])
def test_a_closer_look_excuses_only_a_fate_that_it_has_seen(fates: str, near: bool) -> None:
    kinds = {name: Attractor(fate=AttractorClass.ESCAPE, escaped=f"theta{name}") for name in "123"}
    plane = Plane(
        source=locate_problem("bouncing_ball"),
        x=Axis(name="m", lower=1.0, upper=2.0, count=5),
        y=Axis(name="g", lower=9.0, upper=10.0, count=3),
        start=(1.0, 0.0),
        until=60.0,
    )
    looked: list[Plane] = []

    def fast(cells: Plane, _plan: ExecutionPlan) -> SimpleNamespace:
        looked.append(cells)
        seen = [kinds[fates[k % 2]] for k in range(len(cells.points()))]
        return SimpleNamespace(attractors=seen)

    one = map_agreement.Comparison(
        point=(1.5, 9.5), fast=kinds["1"], slow=kinds["2"], near_boundary=False
    )
    assert map_agreement.looked_at_closer(one, plane, fast).near_boundary is near
    (cells,) = looked
    assert (cells.x.lower, cells.x.upper) == (1.25, 1.75)
    assert (cells.y.lower, cells.y.upper) == (9.0, 10.0)
    settled = replace(one, slow=kinds["1"])
    assert map_agreement.looked_at_closer(settled, plane, fast) is settled
    assert len(looked) == 1
