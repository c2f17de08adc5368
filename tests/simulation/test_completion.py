"""Rules that complete a sequence: when they do, when not, and what they ask of the curve."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.mechanisms import fading_ball
from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation import (
    FixedImpacts,
    TailEstimate,
    Truncation,
    ZenoExtrapolation,
    ZenoPassage,
)

WEIGHT, FADING = 10.0, 5.0
"""At the clock `y` the weight is 10 - 5 y."""


def _machine(e: float = 0.5) -> HybridDynamics:
    return fading_ball(WEIGHT, FADING, e)


def _estimate(
    speed: float, *, acceleration: float = -WEIGHT, clock: float = 0.0, time: float = 0.0
) -> TailEstimate:
    return TailEstimate(
        impact_time=3.0 + speed,
        resting=np.array([0.0, -speed, 0.0, 1.0]),
        speed=speed,
        time=time,
        state=np.array([0.0, clock, 0.0, 0.0]),
        gap_acceleration=acceleration,
    )


def _sequence(*speeds: float, **last: float) -> list[TailEstimate]:
    return [_estimate(w) for w in speeds[:-1]] + [_estimate(speeds[-1], **last)]


# The paper's cut, and a number of impacts.


def test_the_cut_is_at_the_first_impact_that_is_slower_than_its_limit() -> None:
    rule = Truncation(delta=0.5)
    machine = _machine(0.25)
    # Before the impact it was 0.5.
    assert rule.limit(machine, _sequence(0.1, 0.125, 0.125)) is None
    estimates = _sequence(0.5, 0.3, 0.12, time=4.0)
    limit = rule.limit(machine, estimates)
    assert limit is not None
    assert limit.time == 3.12
    assert limit.state is estimates[-1].resting
    assert limit.error == pytest.approx(0.88, rel=1e-14)


def test_a_number_of_impacts_is_waited_for() -> None:
    rule = FixedImpacts(n_impacts=3)
    estimates = _sequence(0.5, 0.25, 0.125)
    assert rule.limit(_machine(), estimates[:2]) is None
    for more in (estimates, _sequence(0.5, 0.25, 0.125, 0.0625)):
        limit = rule.limit(_machine(), more)
        assert limit is not None
        assert limit.state.tolist() == [0.0, 0.0, 0.0, 0.0]


# The extrapolated limit.


def test_impacts_are_resolved_to_a_part_of_the_first_speed() -> None:
    # Estimates that agree have no error at all.
    rule = ZenoExtrapolation(tolerance=0.0, resolved=0.125)
    machine = _machine()
    assert rule.limit(machine, _sequence(0.5, 0.25, 0.0625)) is not None
    assert rule.limit(machine, _sequence(0.5, 0.25, 0.063)) is None
    assert rule.limit(machine, _sequence(4.0, 0.25, 0.126)) is not None


def test_a_limit_that_is_not_told_well_enough_is_waited_for() -> None:
    # Times 0 and 3 at the speeds 1 and 1/2: with -1/3 and 4/3 that is 4, after 0, of 1 + 4.
    estimates = _sequence(1.0, 0.5, time=3.0)
    for tolerance, told in ((0.81, True), (0.79, False)):
        rule = ZenoExtrapolation(tolerance=tolerance, resolved=1.0)
        limit = rule.limit(_machine(), estimates)
        assert (limit is not None) is told
        if limit is not None:
            assert limit.time == pytest.approx(4.0, rel=1e-14)
            assert limit.error == pytest.approx(0.8, rel=1e-14)


def test_a_limit_at_which_the_pull_has_changed_is_waited_for() -> None:
    # The limit is at the clock 0, and a tenth of the acceleration may change.
    rule = ZenoExtrapolation(tolerance=1.0, resolved=1.0)
    for acceleration, told in ((-9.2, True), (-9.0, False), (-11.0, True), (-11.2, False)):
        estimates = _sequence(1.0, 0.5, acceleration=acceleration)
        assert (rule.limit(_machine(), estimates) is not None) is told


def test_the_usual_limit_is_good_to_a_trillionth_at_a_thousandth_of_the_speed() -> None:
    for rule in (ZenoExtrapolation(), ZenoPassage(), ZenoPassage().one_by_one):
        assert rule.tolerance == 1e-12
        assert rule.resolved == 1e-3
    rule = ZenoPassage(tolerance=1e-6, resolved=0.5).one_by_one
    assert (rule.tolerance, rule.resolved) == (1e-6, 0.5)


# The curve of the impacts.
