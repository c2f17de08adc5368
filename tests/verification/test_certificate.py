"""Verdicts: one sentence, the first failure, and numbers that any JSON reader takes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest

from zeno_orbits.verification import RESIDUALS, DeltaCut, OrbitCertificate

GOOD = OrbitCertificate(
    tolerance=1e-9,
    residuals=dict.fromkeys(RESIDUALS, 1e-12),
    margins={"locked_time": 0.5, "gap_acceleration": 24.0},
    energies={"input_work": 1.0},
    multipliers=(0.5 + 0.1j, 0.5 - 0.1j),
    multiplier_error=1e-6,
    delta_sweep=(DeltaCut(delta=0.1, speed=0.05, error=1e-6),),
    delta_order=3.0,
    integration_error=1e-12,
    zeno_error=1e-13,
    period=1.8,
    n_periods=3,
    model="derived",
    shape="zeno",
)


def _with(**residuals: float) -> OrbitCertificate:
    return replace(GOOD, residuals={**GOOD.residuals, **residuals})


def _numbers(data: Any) -> list[float]:
    if isinstance(data, dict):
        return [number for value in data.values() for number in _numbers(value)]
    if isinstance(data, list):
        return [number for value in data for number in _numbers(value)]
    return [data] if isinstance(data, float) else []


def test_small_residuals_and_positive_margins_pass() -> None:
    assert GOOD.passed
    assert GOOD.failed == GOOD.lost == ()
    assert GOOD.verdict() == ("Verified: a stable Zeno periodic orbit; largest residual 1.0e-12.")


@pytest.mark.parametrize("size", [2e-9, math.inf, math.nan])
def test_one_large_residual_refuses_and_is_named(size: float) -> None:
    for name in RESIDUALS:
        seen = _with(**{name: size})
        assert seen.failed == (name,)
        assert not seen.passed
        assert seen.verdict().startswith(f"Refused: `{name}` = ")


def test_the_tolerance_itself_passes() -> None:
    assert _with(closure=1e-9).passed
    assert not _with(closure=math.nextafter(1e-9, 1.0)).passed


def test_the_first_failure_in_causal_order_explains_the_rest() -> None:
    seen = _with(closure=1.0, first_impact=1e-8, period=2.0)
    assert seen.failed == ("first_impact", "closure", "period")
    assert "`first_impact` = 1.0e-08 exceeds 1e-09" in seen.verdict()
    assert "closure" not in seen.verdict()


def test_a_residual_that_was_not_taken_does_not_fail() -> None:
    few = {name: size for name, size in GOOD.residuals.items() if name != "second_model"}
    assert replace(GOOD, residuals=few).passed


@pytest.mark.parametrize("margin", [0.0, -1e-3, math.nan])
def test_a_margin_that_is_not_positive_refuses(margin: float) -> None:
    seen = replace(GOOD, margins={**GOOD.margins, "locked_time": margin})
    assert seen.lost == ("locked_time",)
    assert not seen.passed
    assert "the margin `locked_time` = " in seen.verdict()


def test_trouble_refuses_even_without_residuals() -> None:
    seen = replace(GOOD, trouble="No release occurs within 3 s")
    assert not seen.passed
    assert seen.verdict() == "Refused: No release occurs within 3 s."
    both = replace(seen, residuals={**GOOD.residuals, "closure": math.inf})
    assert "`closure` = inf exceeds" in both.verdict()
    assert "; No release occurs within 3 s." in both.verdict()


@pytest.mark.parametrize("seen", [GOOD, _with(closure=1.0), replace(GOOD, multipliers=())])
def test_a_verdict_is_one_sentence_on_one_line(seen: OrbitCertificate) -> None:
    verdict = seen.verdict()
    assert "\n" not in verdict
    assert verdict.endswith(".")
    assert not verdict.endswith("..")


def test_the_table_of_a_certificate_has_the_residuals_that_were_taken_in_causal_order() -> None:
    pandas = pytest.importorskip("pandas", reason="the extra `tables` is not installed")
    taken = {"period": 2e-9, "closure": 1e-9, "first_impact": 3e-13}
    table = replace(GOOD, residuals=taken).to_pandas()
    assert isinstance(table, pandas.DataFrame)
    assert list(table.columns) == ["check", "name", "residual", "passed"]
    assert list(table["name"]) == ["first_impact", "closure", "period"]
    assert list(table.check) == [RESIDUALS[name] for name in table["name"]]
    assert list(table.residual) == [3e-13, 1e-9, 2e-9]
    assert list(table.passed) == [True, True, False]


# Stability.


def test_the_spectral_radius_is_the_largest_modulus() -> None:
    assert GOOD.spectral_radius == pytest.approx(math.sqrt(0.26))
    assert math.isnan(replace(GOOD, multipliers=(), multiplier_error=math.inf).spectral_radius)
    assert replace(GOOD, multipliers=()).spectral_radius == 0.0
    assert replace(GOOD, multipliers=(0.1 + 0j, -0.9 + 0j, 0.3j)).spectral_radius == 0.9


@pytest.mark.parametrize(
    ("multiplier", "error", "stable"),
    [
        (0.99, 1e-6, True),
        (0.99, 0.02, False),
        (-0.9999, 1e-6, True),
        (1.0, 0.0, False),
        (1.01, 1e-6, False),
        (0.5, math.inf, False),
        (0.5, math.nan, False),
    ],
)
def test_stability_takes_the_error_of_the_multiplier_into_account(
    multiplier: float, error: float, stable: bool
) -> None:
    seen = replace(GOOD, multipliers=(complex(multiplier),), multiplier_error=error)
    assert seen.stable is stable
    assert ("a stable" in seen.verdict()) is stable
    # An orbit need not be stable to be one.
    assert seen.passed


@pytest.mark.parametrize(
    ("multiplier", "error", "unstable"),
    [
        (1.01, 1e-6, True),
        (-3.0, 1.9, True),
        (1.01, 0.02, False),
        (1.5, 0.5, False),
        (1.0, 0.0, False),
        (0.5, 1e-6, False),
        (3.0, math.inf, False),
    ],
)
def test_instability_takes_the_error_of_the_multiplier_into_account(
    multiplier: float, error: float, unstable: bool
) -> None:
    seen = replace(GOOD, multipliers=(complex(multiplier),), multiplier_error=error)
    assert seen.unstable is unstable
    assert ("an unstable" in seen.verdict()) is unstable
    assert ("of unknown stability" in seen.verdict()) is not (unstable or seen.stable)


@pytest.mark.parametrize(
    ("shape", "named"),
    [
        ("zeno", "a stable Zeno periodic orbit;"),
        ("plastic", "a stable simple periodic orbit (plastic impacts);"),
        ("zeno*2", "a stable Zeno periodic orbit (shape zeno*2);"),
        ("impact,plastic", "a stable simple periodic orbit (shape impact,plastic);"),
        ("impact", "a stable periodic orbit without a Zeno point (shape impact);"),
        ("impact*2", "a stable periodic orbit without a Zeno point (shape impact*2);"),
    ],
)
def test_a_verdict_names_the_shape_that_is_not_the_usual_one(shape: str, named: str) -> None:
    assert named in replace(GOOD, shape=shape).verdict()


@pytest.mark.parametrize(
    ("bounce_time", "named"), [(0.0, "a stable simple"), (1e-9, "a stable Zeno")]
)
def test_impacts_accumulate_if_a_bounce_takes_time(bounce_time: float, named: str) -> None:
    ranges = {"a.bounce_time": (0.0, 0.0), "b.bounce_time": (bounce_time, bounce_time)}
    seen = replace(GOOD, shape="", events=("zeno a", "zeno b"), quantities=ranges)
    assert f"{named} periodic orbit (events: zeno a, zeno b);" in seen.verdict()


def test_a_certificate_shows_itself_by_its_verdict_and_spectral_radius() -> None:
    shown = repr(GOOD)
    assert GOOD.verdict() in shown
    assert f"spectral_radius={math.sqrt(0.26):.6g}" in shown
    assert "\n" not in shown


def test_without_multipliers_nothing_is_called_stable() -> None:
    assert not replace(GOOD, multipliers=(), multiplier_error=math.inf).stable


# JSON.


def test_a_certificate_is_plain_data_that_comes_back() -> None:
    data = GOOD.as_json()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["passed"] is True
    assert data["stable"] is True
    assert data["verdict"] == GOOD.verdict()
    assert data["residuals"] == GOOD.residuals
    assert data["floquet_multipliers"] == [[0.5, 0.1], [0.5, -0.1]]


def test_what_is_not_finite_becomes_null() -> None:
    bad = replace(
        GOOD,
        residuals=dict.fromkeys(RESIDUALS, math.inf),
        margins={"locked_time": math.nan},
        energies={"input_work": math.nan},
        multipliers=(),
        multiplier_error=math.inf,
        delta_sweep=(DeltaCut(delta=0.1, speed=math.nan, error=math.inf),),
        delta_order=math.nan,
        integration_error=math.inf,
        zeno_error=math.inf,
        period=math.nan,
        trouble="No release occurs",
    )
    data = bad.as_json()
    json.dumps(data, allow_nan=False)
    assert all(math.isfinite(number) for number in _numbers(data))
    assert data["period"] is None
    assert set(data["residuals"].values()) == {None}


def test_the_certificate_of_an_orbit_is_plain_data(certificate: OrbitCertificate) -> None:
    data = certificate.as_json()
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["failed"] == []


@pytest.mark.parametrize("multiplier", [-0.9, 0.0, 0.5, 0.99, 1.01, 3.0])
def test_the_error_of_an_orbit_bounds_its_distance_from_the_fixed_point(multiplier: float) -> None:
    """Of the map x -> multiplier x: a point at 1e-8 returns with this miss."""
    distance = 1e-8
    miss = abs(1.0 - multiplier) * distance
    seen = replace(_with(closure=miss), multipliers=(multiplier,))
    assert seen.orbit_error >= distance
    # Nor is it ever below what the other residuals miss by.
    assert seen.orbit_error >= miss


@pytest.mark.parametrize(
    "name", ["release", "first_impact", "impact_sequence", "zeno_point", "closure", "period"]
)
def test_every_residual_of_the_orbits_numbers_counts_in_its_error(name: str) -> None:
    assert GOOD.orbit_error < 1e-11
    assert _with(**{name: 1e-6}).orbit_error >= 1e-6
    assert math.isinf(_with(**{name: math.nan}).orbit_error)
    assert math.isinf(_with(**{name: math.inf}).orbit_error)


def test_an_orbit_of_unknown_or_unit_multipliers_has_an_error_without_bound() -> None:
    unknown = replace(GOOD, multipliers=(), multiplier_error=math.inf)
    assert math.isinf(unknown.orbit_error)
    assert math.isinf(replace(GOOD, multipliers=(1.0,)).orbit_error)
    assert math.isinf(replace(GOOD, residuals={}).orbit_error)
    # A section of one point has no multipliers and nothing to magnify.
    assert replace(GOOD, multipliers=()).orbit_error == pytest.approx(2e-12)


def test_a_miss_is_magnified_by_the_multiplier_nearest_to_one_alone() -> None:
    # The integration may be as far off as it says: 1e-6 + 3e-6.
    seen = replace(_with(closure=1e-6), integration_error=3e-6, multipliers=(-0.9, 0.5, 0.75))
    assert seen.orbit_error == pytest.approx(4e-6 / 0.25)
    # However strongly the orbit attracts elsewhere, its Zeno point and period miss by themselves.
    away = replace(seen, multipliers=(-0.9, -3.0, 2.5))
    assert away.orbit_error == pytest.approx(4e-6)
    assert replace(seen, multipliers=(1.5j, -0.2)).orbit_error == pytest.approx(4e-6)


@pytest.mark.parametrize("name", ["start", "phases"])
def test_an_orbit_that_starts_after_an_impact_has_an_error_by_its_own_residuals(name: str) -> None:
    # Neither a release nor a Zeno point: the error is told without.
    own = {"start", "phases", "first_impact", "impact_sequence", "closure", "period"}
    few = replace(GOOD, residuals=dict.fromkeys(own, 1e-12), multipliers=())
    assert few.orbit_error == pytest.approx(2e-12)
    assert replace(few, residuals={**few.residuals, name: 1e-6}).orbit_error >= 1e-6
    without = {key: size for key, size in few.residuals.items() if key not in ("start", "phases")}
    assert math.isinf(replace(few, residuals=without).orbit_error)


@pytest.mark.parametrize("name", ["closure", "period"])
def test_a_residual_that_every_orbit_has_leaves_no_error_where_it_lacks(name: str) -> None:
    few = {key: size for key, size in GOOD.residuals.items() if key != name}
    assert math.isinf(replace(GOOD, residuals=few).orbit_error)


@pytest.mark.parametrize("name", ["integration_error", "multiplier_error"])
@pytest.mark.parametrize("value", [math.inf, math.nan])
def test_errors_without_bound_leave_none_of_the_orbit(name: str, value: float) -> None:
    assert math.isinf(replace(GOOD, **{name: value}).orbit_error)


def test_a_verdict_names_the_first_margin_that_is_lost_only_where_nothing_else_is_wrong() -> None:
    lost = {"first_impact_speed": -0.25, "locked_time": 0.5, "gap_acceleration": -1.0}
    seen = replace(GOOD, margins=lost)
    assert "`first_impact_speed` = -2.5e-01" in seen.verdict()
    assert replace(seen, trouble="It is late").verdict() == "Refused: It is late."
    failed = replace(seen, residuals={"closure": 2e-3})
    assert "`closure` = 2.0e-03 exceeds 1e-09" in failed.verdict()
    assert failed.verdict().endswith(").")


def test_a_certificate_without_residuals_has_none_that_is_large() -> None:
    assert replace(GOOD, residuals={}).verdict().endswith("largest residual 0.0e+00.")


def test_the_largest_residual_is_told() -> None:
    assert "largest residual 5.0e-10." in _with(drift=5e-10).verdict()


def test_the_json_holds_every_number_under_its_name() -> None:
    seen = replace(
        GOOD,
        residuals={"closure": 2e-9, "period": math.inf},
        margins={"locked_time": 0.5},
        asked=({"quantity": "theta2", "kept": True},),
        trouble="it is late",
        n_periods=2,
    )
    assert seen.as_json() == {
        "passed": False,
        "stable": True,
        "verdict": seen.verdict(),
        "failed": ["closure", "period"],
        "tolerance": 1e-9,
        "residuals": {"closure": 2e-9, "period": None},
        "margins": {"locked_time": 0.5},
        "energies": {"input_work": 1.0},
        "floquet_multipliers": [[0.5, 0.1], [0.5, -0.1]],
        "multiplier_error": 1e-6,
        "delta_sweep": [{"delta": 0.1, "speed": 0.05, "error": 1e-6}],
        "delta_order": 3.0,
        "integration_error": 1e-12,
        "zeno_error": 1e-13,
        "period": 1.8,
        "n_periods": 2,
        "shape": "zeno",
        "model": "derived",
        "trouble": "it is late",
        "asked": [{"quantity": "theta2", "kept": True}],
    }
