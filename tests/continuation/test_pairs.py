"""Pairs of special points within a step, and the errors of multipliers along a family."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import ask
from tests.support.returns import multipliers_at
from zeno_orbits.continuation import (
    ContinuationSettings,
    Family,
    FamilyPoint,
    SpecialPointKind,
    family_of_impacts,
    family_of_orbit,
    start_orbit,
)
from zeno_orbits.model import load_problem

PENDULUM = load_problem("motor_pendulum")
OSCILLATOR = load_problem("forced_oscillator")
ONE_FAMILY = ContinuationSettings(doublings=0)


def pendulum_family(kp: float, kd: float, box: tuple[float, float]) -> Family:
    orbit = start_orbit(PENDULUM, PENDULUM.values(gains={"Kp": kp, "Kd": kd}))
    return family_of_orbit(PENDULUM, orbit, "Kd", box, settings=ONE_FAMILY).families[0]


def values_of(family: Family, kind: SpecialPointKind) -> list[float]:
    return sorted(one.at.value for one in family.special if one.kind is kind)


def radius_by_itself(family: Family, point: FamilyPoint) -> float:
    """Return the spectral radius by a return that the continuation has no part in."""
    values = PENDULUM.values(gains={**family.gains, "Kd": point.value})
    start = np.array(PENDULUM.state_vector(point.state))
    return abs(multipliers_at(PENDULUM.dynamics(values), start, point.period)[0])


@pytest.mark.weekly
@pytest.mark.slow
def test_two_flips_within_one_step_are_both_found() -> None:
    family = pendulum_family(4.1957, -1.4, (-1.7, -1.3))
    # As a narrow range shows them, to the eleven digits that were published for it.
    assert values_of(family, SpecialPointKind.FLIP) == pytest.approx(
        [-1.56600335626, -1.56118264505], abs=1e-10
    )
    assert len(values_of(family, SpecialPointKind.FOLD)) == 3
    assert family.resolution < 1e-6


@pytest.mark.slow
def test_the_spectral_radius_exceeds_one_between_two_close_flips_only() -> None:
    # The flips are born near Kp = 4.1954. At this gain the excess between them is below 1e-4.
    family = pendulum_family(4.19545, -1.58, (-1.6, -1.552))
    first, second = values_of(family, SpecialPointKind.FLIP)
    assert 0.0 < second - first < 3e-3
    assert family.resolution < 1e-2 * (second - first)
    for one in family.special:
        assert radius_by_itself(family, one.at) == pytest.approx(1.0, abs=1e-8)
        # The flip is located to the accuracy of the motion.
        assert abs(one.at.spectral_radius - 1) < 1e-8
        assert one.at.multiplier_error < 1e-6
    inside = [point for point in family.points if first < point.value < second]
    assert inside
    for point in inside:
        assert 1.0 < radius_by_itself(family, point) < 1.0 + 1e-3
        assert not point.stable
    outside = [p for p in family.points if p.value < first or second < p.value]
    assert all(point.stable for point in outside)


@pytest.mark.slow
def test_multipliers_near_a_grazing_end_miss_liouville_by_no_more_than_their_errors() -> None:
    values = OSCILLATOR.values(parameters={"c": 0.1, "stop": 1.0, "restitution": 0.8})
    state = OSCILLATOR.state_vector({"speed": 1.0, "cosine": 1.0})
    (family,) = family_of_impacts(OSCILLATOR, values, state, "A", (0.05, 1.5)).families
    product = 0.8**2 * math.exp(-0.1 * 2 * math.pi)
    grazing = [point for point in family.points if point.value < 0.09999]
    assert grazing
    for point in family.points:
        first, second = (abs(mu) for mu in point.multipliers)
        found = float(np.prod(point.multipliers).real)
        error = point.multiplier_error * (first + second)
        assert abs(found - product) <= error + 1e-14
        if point.state["speed"] > 1e-4:
            assert point.multiplier_error < 1e-5 * (1 + first)
        assert point.as_json()["multiplier_error"] == point.multiplier_error


@pytest.mark.slow
def test_the_command_prints_what_it_may_have_missed(tmp_path: Path) -> None:
    output = tmp_path / "family.json"
    answer = ask("continue", "forced_oscillator", "--parameter", "A=0.9:1.1", "-o", output)
    assert answer.code == 0
    assert "closer than 2.0e-08 in A may be missed." in answer.out
    (family,) = json.loads(output.read_text())["families"]
    assert family["resolution"] == pytest.approx(2e-8)


def test_a_radius_within_its_error_of_one_is_undecided() -> None:
    def orbit(multiplier: float, error: float) -> FamilyPoint:
        return FamilyPoint(
            value=1.0,
            state={},
            period=2.0,
            multipliers=(complex(multiplier),),
            margins={},
            miss=0.0,
            multiplier_error=error,
        )

    assert orbit(0.999, 1e-6).stable
    assert not orbit(0.999, 1e-6).undecided
    close = orbit(-1 + 1e-7, 1e-6)
    assert not close.stable
    assert close.undecided
    assert not orbit(-1 - 1e-3, 1e-6).undecided
    unknown = orbit(0.5, math.inf)
    assert unknown.undecided
    assert unknown.as_json()["multiplier_error"] is None
