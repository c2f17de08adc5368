"""The closed forms themselves, against the numbers that were published."""

from __future__ import annotations

import math
from itertools import islice

import pytest

from tests.reference import closed_forms
from tests.reference.closed_forms import COCO, FORCED

PRINTED = 2e-15
"""The published numbers have 16 digits or more, the closed forms a few roundings."""


def test_the_forced_oscillator_has_the_published_impacts_and_zeno_time() -> None:
    times = [time for time, _ in islice(FORCED.impacts(), 3)]
    published = [4.6665292208296586, 4.8909848023223145, 4.9823919604720270]
    assert times == pytest.approx(published, rel=PRINTED)
    assert FORCED.zeno_time() == pytest.approx(5.06454057578434876, rel=PRINTED)


def test_the_power_series_continues_the_exact_flight() -> None:
    time, approach = FORCED.next_impact(FORCED.release_time, 0.0)
    duration, arrival = FORCED.short_flight(time, FORCED.restitution * approach)
    position, velocity = FORCED.motion(time + duration, time, -FORCED.restitution * approach)
    assert position == pytest.approx(FORCED.stop, abs=1e-14)
    assert velocity == pytest.approx(arrival, abs=1e-14)


def test_the_published_impact_of_the_coco_oscillator_repeats_after_one_turn() -> None:
    phase, velocity = 0.07595216493831239, -1.3565863500759056
    time, approach = COCO.next_impact(phase, velocity)
    assert time == pytest.approx(phase + 2 * math.pi, rel=PRINTED)
    assert -COCO.restitution * approach == pytest.approx(velocity, rel=PRINTED)


@pytest.mark.parametrize(
    ("restitution", "published"), [(0.8, 4.0637127688715790), (0.2, 0.67728546147859636)]
)
def test_the_ball_has_the_published_zeno_time(restitution: float, published: float) -> None:
    assert closed_forms.ball_zeno_time(1.0, 9.81, restitution) == pytest.approx(
        published, rel=PRINTED
    )
    far = closed_forms.ball_impact_time(1.0, 9.81, restitution, 400)
    assert far == pytest.approx(published, rel=PRINTED)
