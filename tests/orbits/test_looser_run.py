"""Settings of the rougher run that an error is estimated from."""

from __future__ import annotations

from dataclasses import replace

import pytest

from zeno_orbits.integrators import RungeKutta, Tolerance
from zeno_orbits.orbits import extrapolated, relaxed_settings, relaxed_tolerance
from zeno_orbits.simulation import SimulationSettings, Truncation, ZenoExtrapolation, ZenoPassage

FINE = SimulationSettings(
    engine=RungeKutta(),
    tolerance=Tolerance(relative=1e-9, absolute=1e-12),
    completion=ZenoPassage(tolerance=1e-10, resolved=1e-2),
    far=7.0,
)


def test_looser_tolerances_are_a_hundred_times_those_of_the_run_and_the_rest_stays() -> None:
    rough = relaxed_tolerance(FINE)
    assert rough.tolerance.relative == pytest.approx(1e-7, rel=1e-12)
    assert rough.tolerance.absolute == pytest.approx(1e-10, rel=1e-12)
    assert replace(rough, tolerance=FINE.tolerance) == FINE
    tenfold = relaxed_tolerance(FINE, factor=10.0).tolerance
    assert (tenfold.relative, tenfold.absolute) == pytest.approx((1e-8, 1e-11), rel=1e-12)


def test_a_looser_run_finds_its_zeno_points_less_well_too() -> None:
    rough = relaxed_settings(FINE)
    assert rough.tolerance == relaxed_tolerance(FINE).tolerance
    assert isinstance(rough.completion, ZenoExtrapolation)
    assert rough.completion.tolerance == pytest.approx(1e-8, rel=1e-12)
    assert rough.completion.resolved == 1e-2
    assert (rough.engine, rough.far) == (FINE.engine, 7.0)
    tenfold = relaxed_settings(FINE, factor=10.0)
    assert tenfold.tolerance == relaxed_tolerance(FINE, factor=10.0).tolerance
    assert isinstance(tenfold.completion, ZenoExtrapolation)
    assert tenfold.completion.tolerance == pytest.approx(1e-9, rel=1e-12)


@pytest.mark.parametrize(("resolved", "left"), [(0.01, 0.1), (0.1, 0.5), (0.7, 0.7)])
def test_impacts_are_left_out_up_to_half_the_first_speed_or_as_they_were(
    resolved: float, left: float
) -> None:
    settings = replace(FINE, completion=ZenoExtrapolation(resolved=resolved))
    rough = relaxed_settings(settings, resolved=10.0).completion
    assert isinstance(rough, ZenoExtrapolation)
    assert rough.resolved == pytest.approx(left, rel=1e-12)


def test_a_limit_is_found_impact_by_impact_as_well_as_was_asked_for() -> None:
    assert extrapolated(FINE) == ZenoExtrapolation(tolerance=1e-10, resolved=1e-2)
    own = ZenoExtrapolation(tolerance=1e-3)
    assert extrapolated(replace(FINE, completion=own)) is own
    cut = replace(FINE, completion=Truncation(delta=1e-2))
    assert extrapolated(cut) == ZenoExtrapolation()
