"""Extremes of signals along simulated arcs, against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from zeno_orbits.model.library import load_problem
from zeno_orbits.simulation.execution import Arc
from zeno_orbits.simulation.signals import extent_of, least_inside, peaks
from zeno_orbits.simulation.simulator import simulate

NEAR = 1e-8


@pytest.fixture(name="clock", scope="module")
def _clock() -> Arc:
    """An arc of 9 rad of a clock, its cosine and sine in ``x[2]`` and ``x[3]``."""
    table = load_problem("vibrating_table")
    values = table.values()
    until = 9.0 / values.number("omega")
    run = simulate(table.dynamics(values), (1e3, 0.0, 1.0, 0.0), until=until)
    (arc,) = run.arcs
    return arc


def test_the_least_inside_an_arc_is_its_lowest_minimum_not_its_ends(clock: Arc) -> None:
    least = least_inside(clock, lambda x: float(x[2]), lambda x: -float(x[3]))
    assert least == pytest.approx(-1.0, abs=NEAR)
    # -cos has its one minimum inside at a whole turn, though it begins with the same value.
    turned = least_inside(clock, lambda x: -float(x[2]), lambda x: float(x[3]))
    assert turned == pytest.approx(-1.0, abs=NEAR)
    tilted = least_inside(clock, lambda x: float(x[2]) + 5.0, lambda x: -float(x[3]))
    assert tilted == pytest.approx(4.0, abs=NEAR)


def test_a_function_that_only_rises_has_no_least_value_inside(clock: Arc) -> None:
    assert least_inside(clock, lambda _: 0.0, lambda _: 1.0) is None


def test_an_arc_that_takes_no_time_has_no_inside(clock: Arc) -> None:
    moment = replace(clock, end_time=clock.start_time, trajectory=None)
    assert least_inside(moment, lambda x: float(x[2]), lambda x: -float(x[3])) is None


def test_peaks_are_the_turning_points_between_the_ends(clock: Arc) -> None:
    highest = peaks(lambda x: float(x[2]), clock, 1.0)
    lowest = peaks(lambda x: float(x[2]), clock, -1.0)
    assert max(peak.value for peak in highest) == pytest.approx(1.0, abs=NEAR)
    assert [p.value for p in lowest if 0 < p.fraction < 1] == pytest.approx([-1.0], abs=NEAR)
    (inner,) = [p for p in highest if 0.0 < p.fraction < 1.0]
    assert inner.fraction == pytest.approx(2 * math.pi / 9.0, abs=1e-4)
    extent = extent_of(lambda x: float(x[2]) - 3.0, [clock])
    assert (extent.lowest, extent.highest) == pytest.approx((-4.0, -2.0), abs=NEAR)
    assert extent.largest == pytest.approx(4.0, abs=NEAR)
