"""Rules that complete a sequence: when they do, when not, and what they ask of the curve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from tests.support.mechanisms import fading_ball
from zeno_orbits.integrators import RungeKutta
from zeno_orbits.model import CharacteristicScales, HybridDynamics
from zeno_orbits.simulation import (
    FixedImpacts,
    TailEstimate,
    Truncation,
    ZenoExtrapolation,
    ZenoLimit,
    ZenoPassage,
)
from zeno_orbits.simulation.zeno import completion

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


@dataclass
class _Asked:
    """What the curve is asked for, in place of being followed.

    Attributes:
        settled: Numbers of impacts from which a sequence looks settled.
        calls: What was asked for.
        flights: Engine and tolerance of the flights.
    """

    settled: int = 0
    calls: list[tuple[Any, ...]] = field(default_factory=list[tuple[Any, ...]])
    flights: list[tuple[Any, ...]] = field(default_factory=list[tuple[Any, ...]])
    found: ZenoLimit = field(
        default_factory=lambda: ZenoLimit(time=1.0, state=np.zeros(4), error=0.0)
    )

    def pass_through(
        self, dynamics: HybridDynamics, _flight: object, *given: Any, most_flights: int
    ) -> ZenoLimit:
        del dynamics
        self.calls.append((*given, most_flights))
        return self.found

    def rescaled_flights(self, dynamics: HybridDynamics, *given: Any) -> None:
        del dynamics
        self.flights.append(given)

    def is_settled(
        self, estimates: Sequence[TailEstimate], e: float, own: CharacteristicScales
    ) -> bool:
        del e, own
        return len(estimates) >= self.settled


@pytest.fixture(name="asked")
def _asked(monkeypatch: pytest.MonkeyPatch) -> _Asked:
    asked = _Asked()
    for name in ("pass_through", "rescaled_flights", "is_settled"):
        monkeypatch.setattr(completion, name, getattr(asked, name))
    return asked


def _far(n: int, e: float = 0.9, **last: float) -> list[TailEstimate]:
    """Return a sequence of which nothing is told yet."""
    return _sequence(*(2.0 * e**k for k in range(n)), **last)


def test_the_curve_is_asked_for_from_the_last_impact_with_the_flights_that_are_left(
    asked: _Asked,
) -> None:
    dynamics = replace(_machine(0.9), scaling=lambda: CharacteristicScales(sizes=(1.0, 1e-3)))
    estimates = _far(6)
    engine = RungeKutta(largest_step=0.5)
    rule = ZenoPassage(tolerance=1e-9, resolved=1e-6, engine=engine)
    assert rule.limit(dynamics, estimates) is asked.found
    ((time, resting, speed, tolerance, most),) = asked.calls
    assert time == estimates[-1].impact_time
    assert resting is estimates[-1].resting
    assert speed == estimates[-1].speed
    assert tolerance == 1e-9
    # A millionth takes 131 flights at 0.9, of which five are made.
    assert most == round(math.log(1e-6) / math.log(0.9)) - 5
    ((used, fine),) = asked.flights
    assert used is engine
    assert (fine.relative, fine.absolute) == (1e-14, pytest.approx(1e-18, rel=1e-12))


@pytest.mark.parametrize(("left", "calls"), [(100, 1), (99, 0), (-30, 0)])
def test_fewer_than_a_hundred_flights_are_made_one_by_one(
    asked: _Asked, left: int, calls: int
) -> None:
    # As many flights take the speed from the last impact's to what is resolved.
    rule = ZenoPassage(resolved=0.9 ** (left + 5), tolerance=-1.0)
    found = rule.limit(_machine(0.9), _far(6))
    assert len(asked.calls) == calls
    assert (found is None) is (calls == 0)


def test_plastic_impacts_and_those_without_speed_leave_no_flights(asked: _Asked) -> None:
    rule = ZenoPassage()
    assert rule.limit(_machine(0.0), _far(6)) is None
    # The pull at the limit is another than at the impact.
    still = [*_far(5), _estimate(0.0, acceleration=-5.0)]
    assert rule.limit(_machine(0.9), still) is None
    assert asked.calls == []


@pytest.mark.parametrize("n", [5, 6, 7, 9, 10, 11, 23, 24, 25, 30, 48, 95, 96, 97])
@pytest.mark.parametrize("settled", [0, 10, 1000])
def test_the_curve_is_tried_for_when_it_settles_and_at_every_fourfold_of_six_impacts(
    asked: _Asked, n: int, settled: int
) -> None:
    asked.settled = settled
    ZenoPassage(resolved=1e-60).limit(_machine(0.9), _far(n))
    fourfold = n in {6, 24, 96} and n >= settled
    assert len(asked.calls) == int(fourfold or n == settled)


@pytest.mark.parametrize(("clock", "calls"), [(1.59, 1), (1.6, 0), (1.61, 0)])
def test_the_curve_is_tried_for_if_the_stop_holds_with_a_fifth_at_its_end(
    asked: _Asked, clock: float, calls: int
) -> None:
    ZenoPassage(resolved=1e-60).limit(_machine(0.9), _far(6, clock=clock))
    assert len(asked.calls) == calls


def test_what_is_told_by_the_impacts_is_not_asked_of_the_curve(asked: _Asked) -> None:
    rule = ZenoPassage(tolerance=0.0, resolved=1.0)
    limit = rule.limit(_machine(), _far(6, 0.5))
    assert limit is not None
    assert limit is not asked.found
    assert asked.calls == []
