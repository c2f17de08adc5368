"""What an end is called: the cause of what vanishes there, whichever margin led to it."""

from __future__ import annotations

from functools import cache

import pytest

from zeno_orbits.continuation import (
    ContinuationSettings,
    Family,
    FamilySteps,
    SpecialPointKind,
    family_of_orbit,
    start_orbit,
)
from zeno_orbits.model import load_problem
from zeno_orbits.orbits import Orbit

OSCILLATOR = load_problem("forced_oscillator")
DEFAULT, SHORT = FamilySteps(), FamilySteps(first=0.003, longest=0.01)
LONG = FamilySteps(first=0.1, longest=0.3)


@cache
def orbit_at(**numbers: float) -> Orbit:
    return start_orbit(OSCILLATOR, OSCILLATOR.values(parameters=numbers))


def family_in_the_force(box: tuple[float, float], steps: FamilySteps, **numbers: float) -> Family:
    settings = ContinuationSettings(steps=steps)
    followed = family_of_orbit(OSCILLATOR, orbit_at(**numbers), "A", box, settings=settings)
    (family,) = followed.families
    return family


@pytest.mark.slow
@pytest.mark.parametrize(
    ("box", "steps"),
    [
        pytest.param((0.5, 1.01), SHORT, marks=pytest.mark.slow),
        pytest.param((0.7, 1.1), DEFAULT, marks=pytest.mark.slow),
        pytest.param((0.5, 1.5), LONG, marks=pytest.mark.slow),
        ((0.79, 1.01), LONG),
    ],
)
def test_the_end_of_a_flight_has_one_name_for_every_range_and_step(
    box: tuple[float, float], steps: FamilySteps
) -> None:
    # With A = 0.8 + eps^2 the stop lets go for a time of order eps, and the acceleration at the
    # next contact is of order eps^2: in arclength it is the nearer one to vanish.
    first = family_in_the_force(box, steps, restitution=0.0).first
    assert (first.kind, first.detail) == (SpecialPointKind.RELEASE_LOST, "")
    assert abs(first.at.value - 0.8) < 10 * first.error < 1e-9


@pytest.mark.slow
def test_so_it_has_with_impacts_that_accumulate() -> None:
    first = family_in_the_force((0.7, 1.1), DEFAULT, restitution=0.5).first
    assert (first.kind, first.detail) == (SpecialPointKind.RELEASE_LOST, "")
    assert abs(first.at.value - 0.8) < 10 * first.error < 1e-9


@pytest.mark.parametrize(
    ("restitution", "top", "steps"),
    [
        (0.0, 1.1, DEFAULT),
        pytest.param(0.0, 1.01, SHORT, marks=pytest.mark.slow),
        (0.3, 3.0, LONG),
    ],
)
def test_a_motion_in_proportion_to_its_force_ends_with_its_amplitude(
    restitution: float, top: float, steps: FamilySteps
) -> None:
    # With the stop where the spring is relaxed, x(t) / A does not depend on A at all.
    family = family_in_the_force((0.0, top), steps, restitution=restitution, stop=0.0)
    assert (family.first.kind, family.first.detail) == (SpecialPointKind.AMPLITUDE_ZERO, "")
    assert abs(family.first.at.value) < 1e-12
    speeds = [point.margins["speed of the first impact"] / point.value for point in family.points]
    assert max(speeds) == pytest.approx(min(speeds), rel=1e-9)
    sizes = [point.margins["amplitude"] / point.value for point in family.points]
    # Looked at a few parts of the arcs, all at the same phases.
    assert max(sizes) == pytest.approx(min(sizes), rel=1e-9)
