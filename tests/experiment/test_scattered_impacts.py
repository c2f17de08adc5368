"""Drops whose restitution scatters from impact to impact, against their own closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

import zeno_orbits as zo
from zeno_orbits.experiment import RecordedSignal

G, NOISE = 9.81, 1.5e-3


def drop(
    seed: int, e: float, scatter: float, height: float = 0.5, first: Sequence[float] = ()
) -> zo.Recording:
    """Return a drop of a ball at 250 samples a second, each impact with its own restitution.

    Args:
        seed: Random seed.
        e: Mean restitution.
        scatter: Its relative scatter.
        height: Initial height [m].
        first: Relative deviations at the first impacts, in place of random ones.
    """
    deviations = iter(first)
    random = np.random.default_rng(seed)
    begin, speed = math.sqrt(2 * height / G), math.sqrt(2 * G * height)
    times = np.arange(0.0, begin * (1 + e) / (1 - e) + 0.1, 1 / 250)
    found = np.where(times < begin, height - G * times**2 / 2, 0.0)
    while speed > 1e-6:
        own = next(deviations, scatter * random.standard_normal())
        speed *= min(e * (1.0 + own), 0.99)
        since = times - begin
        inside = (since >= 0.0) & (since < 2 * speed / G)
        found[inside] = speed * since[inside] - G * since[inside] ** 2 / 2
        begin += 2 * speed / G
    values = found + NOISE * random.standard_normal(len(times))
    signal = RecordedSignal(name="height", unit="m", values=values)
    return zo.Recording(source=None, problem="bouncing_ball", time=times, signals=(signal,))


@cache
def _fit(seed: int, e: float, scatter: float, n: int = 1) -> zo.Identification:
    heights = 0.5 - 0.05 * np.arange(n)
    drops = [drop(seed + k, e, scatter, float(own)) for k, own in enumerate(heights)]
    return zo.identify("bouncing_ball", drops, ["restitution"], transient=True)


@pytest.mark.slow
def test_one_scattering_drop_has_an_interval_as_wide_as_its_few_impacts_allow() -> None:
    found = _fit(4, 0.75, 0.03)
    (one,) = found.fitted
    assert found.transient is not None
    assert one.low < 0.75 < one.high
    # Of n impacts the mean has the error 3 % / sqrt(n) at best. Samples alone give 0.1 %.
    most = len(found.transient.trials[0].impacts)
    assert one.high - one.low > 2 * 0.03 * 0.75 / math.sqrt(most)
    assert found.transient.tests.has_structure
    assert "a single drop cannot separate them" in found.transient.verdict
    assert 0.005 < found.transient.scatter < 0.1


@pytest.mark.slow
def test_the_values_of_the_drawn_motion_are_named_beside_the_mean_restitution() -> None:
    found = _fit(4, 0.75, 0.03)
    assert found.transient is not None
    (told,) = [one for one in found.remarks if "nearest single motion" in one]
    e = float(told.rpartition(" = ")[2])
    trial = found.transient.trials[0]
    height, rate = trial.start["height"], trial.start["speed"]
    # Up to the second impact, by the closed form of two flights.
    since = trial.time - trial.origin
    first = (rate + math.sqrt(rate**2 + 2 * G * height)) / G
    speed = e * math.sqrt(rate**2 + 2 * G * height)
    fall = height + rate * since - G * since**2 / 2
    late = since - first
    wanted = np.where(since < first, fall, speed * late - G * late**2 / 2)
    inside = late < 2 * speed / G
    assert trial.fitted[inside, 0] == pytest.approx(wanted[inside], abs=1e-4)
    assert abs(e - found.fitted[0].value) > 1e-4


def test_a_drop_without_scatter_keeps_the_interval_of_its_samples() -> None:
    found = _fit(2, 0.75, 0.0)
    (one,) = found.fitted
    assert found.transient is not None
    assert not found.transient.tests.has_structure
    assert math.isnan(found.transient.scatter)
    assert one.high - one.low < 2e-3


@pytest.mark.slow
def test_late_impacts_that_scatter_shifts_far_count_as_scattered() -> None:
    """The recorded motion is over before the last impacts of the mean restitution."""
    seen = (-0.16, 0.03, -0.11, -0.07, 0.03, 0.08, 0.15)
    found = zo.identify(
        "bouncing_ball", drop(5, 0.79, 0.1, first=seen), ["restitution"], transient=True
    )
    (one,) = found.fitted
    logs = np.log(0.79 * (1.0 + np.array(seen)))
    mean, error = math.exp(float(np.mean(logs))), float(np.std(logs, ddof=1)) / math.sqrt(7)
    # Student's quantile of six degrees of freedom is 2.4.
    assert abs(one.value - mean) < mean * error
    assert 1.5 * mean * error < (one.high - one.low) / 2 < 4.0 * mean * error
    assert one.low < 0.79 < one.high


@pytest.mark.slow
def test_the_error_of_three_impacts_is_as_long_as_their_interval() -> None:
    """Two restitutions that agree by chance are no knowledge of their scatter."""
    seen = (0.13, 0.138, -0.07, 0.03, 0.1)
    found = zo.identify(
        "bouncing_ball", drop(6, 0.53, 0.1, first=seen), ["restitution"], transient=True
    )
    (one,) = found.fitted
    assert found.transient is not None
    assert math.isfinite(found.transient.scatter)
    # A normal distribution has 95 % within 1.96 errors, and Student's with one degree in 12.7.
    assert one.error == pytest.approx((one.high - one.low) / 2 / 1.96, rel=0.05)
    assert abs(one.value - 0.53) < 4 * one.error


@pytest.mark.slow
def test_an_interval_that_rests_on_few_impacts_says_that_it_contains_no_scatter() -> None:
    """Impacts that agree by chance give an interval far from the mean restitution."""
    seen = (-0.01, -0.017, -0.025, 0.13, -0.09)
    found = zo.identify(
        "bouncing_ball", drop(7, 0.506, 0.1, first=seen), ["restitution"], transient=True
    )
    (one,) = found.fitted
    assert one.high < 0.506
    assert sum("cannot show a scatter of `restitution`" in word for word in found.remarks) == 1
    many = _fit(2, 0.75, 0.0)
    assert not any("cannot show a scatter" in word for word in many.remarks)


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [0.03, 0.1])
def test_several_drops_separate_scatter_from_a_law(scatter: float) -> None:
    found = _fit(20, 0.7, scatter, 4)
    (one,) = found.fitted
    assert found.transient is not None
    assert one.low < 0.7 < one.high
    assert one.high - one.low < 8 * scatter * 0.7 / math.sqrt(16)
    # Of about 16 impacts the standard deviation has an error of a fifth.
    assert 0.5 * scatter < found.transient.scatter < 2.0 * scatter
    assert not found.transient.tests.has_structure
    assert "from impact to impact explains the impacts" in found.transient.verdict


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [0.03, 0.1])
def test_intervals_of_scattering_drops_contain_the_truth(scatter: float) -> None:
    random = np.random.default_rng(3)
    held = 0
    for k in range(10):
        e = float(random.uniform(0.55, 0.8))
        (one,) = _fit(100 + k, e, scatter).fitted
        held += one.low <= e <= one.high
    # Fewer than 8 of 10 have a probability of 1 % if the share is 0.95.
    assert held >= 8
