"""The error of an integration, from its differences to looser integrations."""

from __future__ import annotations

import math

import pytest

from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.verification.integration import error_by_repetition

SETTINGS = SimulationSettings()


@pytest.mark.parametrize("order", [1.0, 1.3, 2.0])
def test_errors_that_grow_with_the_tolerance_are_overestimated(order: float) -> None:
    exact, tolerance = 1e-10, SETTINGS.tolerance.relative

    def difference(looser: SimulationSettings) -> float:
        return exact * ((looser.tolerance.relative / tolerance) ** order - 1.0)

    for enough in (1e-12, 1e-8):
        assert error_by_repetition(difference, SETTINGS, enough) >= exact


@pytest.mark.parametrize("far", [0.7, math.inf])
def test_a_much_looser_integration_alone_refuses_no_orbit(far: float) -> None:
    asked: list[float] = []

    def difference(looser: SimulationSettings) -> float:
        asked.append(looser.tolerance.relative)
        return far if len(asked) == 1 else 1e-9

    assert error_by_repetition(difference, SETTINGS, 1e-8) == pytest.approx(3e-9)
    assert SETTINGS.tolerance.relative < asked[1] < asked[0]


def test_a_return_that_no_integration_confirms_stays_refused() -> None:
    assert error_by_repetition(lambda _: 0.5, SETTINGS, 1e-8) == pytest.approx(0.5)
    assert error_by_repetition(lambda _: math.inf, SETTINGS, 1e-8) == math.inf
